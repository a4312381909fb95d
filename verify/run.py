"""Compare fosopt with independent programs and write docs/verification.md: what `make verify` runs.

Octave's control package finds modes, poles, frequency responses and norms of random systems from physical data;
CalculiX finds matrices and frequencies of random trusses. The page holds the worst disagreement of each kind.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from systems import RandomSystem

PAGE = Path(__file__).resolve().parents[1] / "docs" / "verification.md"
SYSTEMS = 60
PAIRS = 20
KINDS = {"planar joints": range(0, 20, 2), "spatial joints": range(1, 20, 2), "rigid battens": range(10)}

DIGITS = "14 digits are stored"
POLES = "dense eigenvalues err by rounding of the largest pole, which is up to 1e10 times the slowest"
BODE = "state-space solves against sums over modes"
SHORT = "Octave stops short of some peaks; a grid of 400,000 frequencies finds fosopt's to 1e-11"
SHORT = "Octave stops short of some peaks; a grid of 400,000 frequencies finds those of fosopt to 1e-11"
ROUTES = "residues against quadrature, both of fosopt; residues cancel where poles spread over 1e7"
NORM = "Lyapunov equations of stiff state matrices, see the last row"

_HEAD = """\
# Verification

fosopt against programs that share no code with it: {versions}. `make verify` computes this page anew.

Each program gets physical data alone and does the rest itself. Systems are random, but the same in every run:
planar trusses with rigid battens and clamped spatial masts, hubs held, free and fixed, damping ratios from 0.1 to 2 %,
mirror inertias from 1e-5 to 1e-1 of the structure's, PID with a filtered derivative; a fifth each with the mirror
alone, with the reaction at another port, with an imperfect reactionless mirror, with a reaction-mass actuator, and
with sensor and action on the structure. All are closed a second time by a digital controller with a computation
delay. {unstable} of the {systems} loops are unstable, for both sides the same.

{pairs} spatial masts of random bars carry a mirror with two axes, whose loops are closed at once.
Whether the tests would notice a wrong formula is a question of its own: [Mutants](mutants.md).
"""


@dataclass
class Quantity:
    """A kind of number that is compared, with its worst disagreement so far.

    Attributes
    ----------
    name, measure
        What, and how a disagreement is counted.
    limit
        Above this the run fails: what rounding in either program explains.
    why
        What it comes from.
    failed
        How often the other program gave no answer.
    """

    name: str
    measure: str
    limit: float
    why: str
    worst: float = 0.0
    where: str = ""
    count: int = 0
    failed: int = 0

    def add(self, apart: float, where: str) -> None:
        """Count one comparison."""
        self.count += 1
        if not apart <= self.worst:
            self.worst, self.where = apart, where


def with_octave() -> tuple[list[Quantity], int]:
    """Compare random loops, and count the unstable ones."""
    import numpy as np
    import octave
    from systems import RESPONSES, random_system

    systems = [random_system(number) for number in range(SYSTEMS)]
    ours = [system.answers() for system in systems]
    theirs = octave.answers([system.for_others() for system in systems])
    frequency = Quantity(
        "natural frequency", "relative", 1e-11, "eigenvalues of K and M to rounding of the largest"
    )
    poles = Quantity("closed-loop pole", "over its size", 1e-6, POLES)
    response = {
        name: Quantity(f"response to {name.replace('_', ' ')}", "over the largest of 25", 1e-9, BODE)
        for name in RESPONSES
    }
    rms = {name: Quantity(f"H2 norm, {name}", "relative", 2e-6, NORM) for name in ("air", "noise", "torque")}
    peak = Quantity(
        "H-infinity norm of the sensitivity", "relative", 1e-10, "the same peak, found in two ways"
    )
    routes = Quantity("the H2 norms again", "relative", 1e-9, ROUTES)
    sampled = [
        Quantity(
            "pole of the sampled loop",
            "absolute",
            1e-7,
            "dense eigenvalues, multiple ones of the delay at zero",
        ),
        Quantity("sampled loop transfer function", "over the largest of 25", 1e-8, BODE),
        Quantity("H-infinity norm of the sampled sensitivity", "relative", 1e-3, SHORT),
    ]
    for system, we, they in zip(systems, ours, theirs, strict=True):
        compare_sampled(sampled, system, they["sampled"])
        where = f"{system.number}: {system.kind}"
        if bool(we["stable"]) != bool(they["stable"]):
            raise AssertionError(f"system {where}: stable {we['stable']} against {they['stable']}")
        frequency.add(octave.each_apart(we["frequency"], np.sort(they["frequency"])), where)
        poles.add(
            octave.poles_apart(we["poles"], they["poles"], 2 if system.hub.type == "free" else 0), where
        )
        for name, one, other in zip(RESPONSES, we["responses"], they["responses"], strict=True):
            response[name].add(octave.apart(one, other), where)
        if we["stable"]:
            for name, one, other in zip(rms, we["rms"], they["rms"], strict=False):
                rms[name].add(octave.each_apart(one, other), where)
            routes.add(octave.each_apart(we["rms"], we["rms_by_quadrature"]), where)
            if np.isnan(they["largest_sensitivity"]):
                peak.failed += 1
                continue
            peak.add(octave.each_apart(we["largest_sensitivity"], they["largest_sensitivity"]), where)
    unstable = sum(not we["stable"] for we in ours)
    return [frequency, poles, *response.values(), *rms.values(), peak, routes, *sampled], unstable


def with_two_axes() -> list[Quantity]:
    """Compare mirrors with two axes, both loops closed at once."""
    import octave
    from two_axes import INPUTS, two_axis_system

    systems = [two_axis_system(number) for number in range(PAIRS)]
    theirs = octave.answers([system.for_others() for system in systems], "two_axes.m")
    poles = Quantity(
        "closed-loop pole", "over its size", 1e-9, "dense eigenvalues on both sides, ours polished"
    )
    response = [
        Quantity(f"responses of both axes to {name.replace('_', ' ')}", "over the largest of 100", 1e-8, BODE)
        for name in INPUTS
    ]
    rms = [
        Quantity(f"H2 norm of both axes, {name}", "relative", 2e-6, "quadrature against Lyapunov equations")
        for name in ("air", "noise", "hub")
    ]
    peak = Quantity(
        "H-infinity norm of the (2, 2) sensitivity", "relative", 1e-10, "the same peak, found in two ways"
    )
    for system, they in zip(systems, theirs, strict=True):
        we, where = system.answers(), f"mast {system.number}"
        if bool(we["stable"]) != bool(they["stable"]):
            raise AssertionError(f"{where}: stable {we['stable']} against {they['stable']}")
        poles.add(octave.poles_apart(we["poles"], they["poles"], 0), where)
        for k, quantity in enumerate(response):
            both = slice(2 * k, 2 * k + 2)
            quantity.add(octave.apart(we["responses"][:, both], they["responses"][:, both]), where)
        if we["stable"]:
            for quantity, one, other in zip(rms, we["rms"], they["rms"], strict=True):
                quantity.add(octave.each_apart(one, other), where)
            peak.add(octave.each_apart(we["largest_sensitivity"], they["largest_sensitivity"]), where)
    return [poles, *response, *rms, peak]


def compare_sampled(found: Sequence[Quantity], system: RandomSystem, they: dict[str, Any]) -> None:
    """Compare one loop with a digital controller."""
    import numpy as np
    import octave

    poles, transfer, peak = found
    we, where = system.sampled_answers(), f"{system.number}: {system.kind}"
    others = np.asarray(they["poles"]).ravel()
    if system.hub.type == "free":
        # The drift, two poles at one that no torque from within moves.
        others = np.delete(others, np.argsort(np.abs(others - 1))[:2])
    poles.add(octave.farthest_pole(we["poles"], others), where)
    transfer.add(octave.apart(we["loop"], they["loop"]), where)
    if np.isnan(we["largest_sensitivity"]):
        return
    if np.isnan(they["largest_sensitivity"]):
        peak.failed += 1
        return
    peak.add(octave.each_apart(we["largest_sensitivity"], they["largest_sensitivity"]), where)


def with_calculix() -> list[Quantity]:
    """Compare random trusses: joints in a plane and in space, and rigid battens."""
    import calculix
    import numpy as np
    from scipy import linalg

    from fosopt.structure import assemble, mass_matrix, stiffness_matrix

    found = []
    for kind, chosen in KINDS.items():
        stiffness = Quantity(f"stiffness matrix, {kind}", "over the largest entry", 1e-13, DIGITS)
        mass = Quantity(f"mass matrix, {kind}", "over the largest entry", 1e-13, DIGITS)
        frequency = Quantity(f"four lowest frequencies, {kind}", "relative", 5e-7, "seven digits are printed")
        for number in chosen:
            truss = calculix.random_truss(number, rigid=kind == "rigid battens")
            of = assemble(truss, "tip")
            ours = (stiffness_matrix(of, of.area), mass_matrix(of, of.area, of.batten_mass, 0.0))
            squares = linalg.eigh(*ours, eigvals_only=True)
            theirs = calculix.matrices(truss, of)
            printed = calculix.frequencies(truss)
            for quantity, one, other in zip((stiffness, mass), ours, theirs, strict=True):
                quantity.add(float(np.abs(one - other).max() / np.abs(one).max()), f"truss {number}")
            frequency.add(
                float(np.abs(printed / np.sqrt(squares[: printed.size]) - 1).max()), f"truss {number}"
            )
        found += [stiffness, mass, frequency]
    return found


def main() -> int:
    """Run all comparisons; 0 if all agree to what rounding explains."""
    import calculix
    import octave

    lacking = [line for line in (octave.missing(), calculix.missing()) if line]
    if lacking:
        print("\n".join(lacking), file=sys.stderr)
        return 2
    loops, unstable = with_octave()
    pairs = with_two_axes()
    trusses = with_calculix()
    head = _HEAD.format(
        versions=f"{octave.version()}, and {calculix.version()}",
        unstable=unstable,
        systems=SYSTEMS,
        pairs=PAIRS,
    )
    PAGE.write_text(
        f"{head}\n{_section('Loops: Octave', loops)}\n{_section('Mirrors with two axes: Octave', pairs)}\n"
        f"{_section('Structures: CalculiX', trusses)}"
    )
    print(PAGE.read_text())
    wrong = [each for each in (*loops, *pairs, *trusses) if not each.worst <= each.limit]
    for each in wrong:
        print(
            f"{each.name}: {each.worst:.1e} apart at {each.where}; at most {each.limit:.0e} is rounding",
            file=sys.stderr,
        )
    return 1 if wrong else 0


def _section(title: str, quantities: Iterable[Quantity]) -> str:
    rows = []
    for q in quantities:
        count = f"{q.count} ({q.failed} without an answer)" if q.failed else str(q.count)
        rows.append(f"| {q.name} | {q.measure} | {count} | {q.worst:.0e} | {q.where} | {q.why} |")
    head = ["| quantity | measure | compared | worst | where | comes from |", "|---|---|---|---|---|---|"]
    return "\n".join([f"## {title}", "", *head, *rows, ""])


if __name__ == "__main__":
    sys.exit(main())
