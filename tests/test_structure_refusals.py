"""Trusses that physics or their definition does not allow."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fosopt.errors import ModelError
from fosopt.structure import (
    PointMass,
    Spring,
    assemble,
    barker_truss,
)


def small(**changes):
    return replace(barker_truss("pinned", 2), **changes)


def with_bar(**changes):
    truss = barker_truss("pinned", 2)
    return replace(truss, bars=(replace(truss.bars[0], **changes), *truss.bars[1:]))


def with_batten(**changes):
    truss = barker_truss("pinned", 2)
    return replace(truss, battens=(*truss.battens[:2], replace(truss.battens[2], **changes)))


@pytest.mark.parametrize(
    ("truss", "message"),
    [
        (with_bar(area=0.0), "area 0.0 is not above zero"),
        (with_bar(area=float("nan")), "area nan is not above zero"),
        (with_bar(young=-1.0), "young -1.0 is not above zero"),
        (with_bar(density=float("inf")), "density inf is not above zero"),
        (with_bar(nodes=("N0a", "N1q")), "'N1q' does not exist; did you mean"),
        (with_bar(nodes=("N0a", "N0a")), "length 0.0 m; its two nodes must lie apart"),
        (with_batten(nodes=("N2a", "N9")), "'N9' does not exist"),
        (with_batten(nodes=("N2a", "N1b")), "already belongs to 'B1'"),
        (with_batten(mass=0.0), "must be above zero"),
        (with_batten(inertia=-1.0), "must be above zero"),
        (small(supports={"B9": ("x",)}), "'B9' does not exist"),
        (small(supports={"B0": ("z",)}), "no component 'z'"),
        (small(ports={"hub": ("B0", "rz")}), "port 'tip' does not exist"),
        (small(ports={"tip": ("B2", "rz")}), "port 'hub' does not exist"),
        (small(ports={"hub": ("B0", "x"), "tip": ("B2", "rz")}), "is no rotation; give one of rz"),
        (small(ports={"hub": ("B0", "rz"), "tip": ("B7", "rz")}), "'B7' does not exist"),
        (small(ports={"hub": ("B0", "rz"), "tip": ("B2", "rx")}), "no component 'rx'"),
        (small(springs=(Spring("B1", "q", 1.0),)), "no component 'q'"),
        (small(points=(PointMass("N0a", 1.0),)), "'N0a' does not exist"),
        (small(nodes={"A": (0.0, 0.0), "B": (0.0, 0.0, 0.0)}), "coordinates per node"),
        (small(nodes={"A": (0.0,)}), "coordinates per node"),
    ],
)
def test_a_truss_that_physics_does_not_allow_is_refused_with_the_way_out(truss, message):
    with pytest.raises(ModelError, match=message):
        assemble(truss, "tip")


def test_a_dissertation_truss_without_bays_or_with_another_boundary_is_refused():
    with pytest.raises(ModelError, match="0 is below one"):
        barker_truss("pinned", 0)
    with pytest.raises(ModelError, match="boundary 'clamped' does not exist"):
        barker_truss("clamped")


def test_an_unknown_port_of_a_structure_is_refused_with_the_nearest_name(fem3):
    with pytest.raises(ModelError, match="port 'tipp' does not exist; did you mean 'tip'"):
        fem3.port("tipp")
