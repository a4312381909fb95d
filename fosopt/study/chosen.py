"""One design of a run, or of a study file, to be handed over to other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.control import Sampling, SignalPath, closed_loop_state_space
from fosopt.control.sampled_closed import sampled_closed_loop_state_space
from fosopt.errors import ModelError, StudyError, did_you_mean
from fosopt.export.systems import write_systems
from fosopt.export.truss import DesignedTruss
from fosopt.interchange import systems
from fosopt.problem import Evaluation, evaluation_of
from fosopt.study.build import build_problem, start_vector
from fosopt.study.directory import run_header
from fosopt.study.load import load_study
from fosopt.study.resume import recorded_files, recorded_study
from fosopt.study.store import Store
from fosopt.study.work import opened


@dataclass(frozen=True)
class ChosenDesign:
    """A design, evaluated on the model that the run's numbers are of.

    Attributes
    ----------
    key, label
        Of its point; of a study file its stem and name.
    doubt
        Why it is not verified, if the run says so.
    provenance
        Where it came from.
    """

    evaluation: Evaluation
    key: str
    label: str
    doubt: str | None
    provenance: Mapping[str, Any]

    @property
    def truss(self) -> DesignedTruss:
        """Its truss.

        Raises
        ------
        ExportError
            If its structure has no members.
        """
        design, system = self.evaluation.design, self.evaluation.system
        sizes = design.area, design.batten_mass, design.spring_stiffness
        return DesignedTruss(system.structure, *sizes, system.mirror_port, design.mirror_mass)

    @property
    def origin(self) -> dict[str, Any]:
        """Its provenance with its key."""
        return {**self.provenance, "point": self.key}

    def write_plant(self, path: Path, period: float | None = None, delay: float | None = None) -> list[str]:
        """Write plant, controller and closed loop, continuous and where it is sampled from sample to sample.

        Parameters
        ----------
        period, delay
            To sample with in place of what the design has [s].

        Returns
        -------
        list of str
            What there is to know of them.

        Raises
        ------
        StudyError
            If a delay is given for a loop that is not sampled.
        ModelError
            If the loop cannot be sampled.
        ExportError
            If the file cannot be written.
        """
        loop, modes, port = (
            self.evaluation.design.loop,
            self.evaluation.modes,
            self.evaluation.system.mirror_port,
        )
        found = {**systems(loop, modes, port), "closed_loop": closed_loop_state_space(loop, modes, port)}
        stable = {"closed_loop": self.evaluation.poles.spectral_abscissa < 0}
        notes = [] if self.doubt is None else [f"point {self.key} is not verified: {self.doubt}"]
        if "controller" not in found:
            notes.append(
                "the controller is left out: an ideal derivative is no state space; add 'rolloff' to it"
            )
        if loop.controller.path.sampling is not None:
            notes.append("the continuous controller has a Pade approximant in place of hold and delay")
        signals = _sampled(loop.controller.path, period, delay)
        if signals.sampling is not None:
            digital = replace(loop, controller=replace(loop.controller, path=signals))
            found |= {k: s for k, s in systems(digital, modes, port).items() if s.period is not None}
            closed = sampled_closed_loop_state_space(digital, modes, port)
            found["sampled_closed_loop"] = closed
            stable["sampled_closed_loop"] = bool(np.abs(np.linalg.eigvals(closed.a)).max() < 1)
        notes += [f"the {name.replace('_', ' ')} is unstable" for name, good in stable.items() if not good]
        about: dict[str, str | bool] = {
            **{"design": self.label, "point": self.key, "modes": self.evaluation.system.model},
            **{f"{name}_stable": good for name, good in stable.items()},
            "notes": "; ".join(notes),
        }
        write_systems(found, about, self.origin, path)
        return notes


def _sampled(path: SignalPath, period: float | None, delay: float | None) -> SignalPath:
    """A signal path that samples with another period or delay."""
    known = path.sampling
    if period is None and known is None:
        if delay is not None:
            raise StudyError("a delay is that of a sampled loop, and this one is not; give a rate as well")
        return path
    sampling = known or Sampling(period or 1.0)
    sampling = replace(
        sampling,
        period=sampling.period if period is None else period,
        delay=sampling.delay if delay is None else delay,
    )
    return replace(path, sampling=sampling)


def design_of_file(path: Path) -> ChosenDesign:
    """The design of a study file of kind analysis.

    Raises
    ------
    StudyError
        If the file breaks a rule, or is of many designs.
    """
    study = load_study(path)
    if study.kind != "analysis":
        raise StudyError(
            f"a {study.kind} is of many designs; run it and export a point of the run, or give a file such as "
            "designs/000.yaml of a run",
            file=path,
        )
    problem = build_problem(study)
    evaluation = problem.evaluate(start_vector(study, problem), truth=True)
    provenance = run_header(study, problem)["provenance"]
    return ChosenDesign(evaluation, path.stem, study.name, None, provenance)


def design_of_run(record: Path, key: str | None) -> ChosenDesign:
    """A point of a run, also of one that goes on.

    Raises
    ------
    StudyError
        If the run has no such point, or of a sweep one that physics does not allow.
    """
    with Store.open(record) as store:
        header = store.header()
        if header["kind"] == "sweep":
            return _of_sweep(store, header, key)
        points = {point["key"]: point for point in store.run()["points"]}
        files = recorded_files(store)
    if key is None:
        raise StudyError(
            f"{record}: one design is wanted and a run has many; choose one with --point, {_some(points)}"
        )
    if key not in points:
        raise StudyError(f"the run has no point '{key}'; {did_you_mean(key, points)}")
    study, problem = opened(files)
    point = points[key]
    evaluation = problem.evaluate(problem.vector(point["variables"]), truth=True)
    doubt = None if point["verified"] else f"{point['status']}: {point['reason'] or 'no reason is given'}"
    return ChosenDesign(evaluation, key, f"{study.name}: {point['label']}", doubt, header["provenance"])


def _some(points: Mapping[str, object]) -> str:
    keys = list(points)
    return (
        f"one of {', '.join(keys[:8])}{', ...' if len(keys) > 8 else ''}" if keys else "once there are some"
    )


def _of_sweep(store: Store, header: Mapping[str, Any], key: str | None) -> ChosenDesign:
    # numba comes with it, and takes a while to import.
    from fosopt.study.sweep_points import Points, bench

    study, last = recorded_study(store), header["count"] - 1
    if key is None or not (key.isdecimal() and len(key) < 10 and int(key) <= last):
        what = "one design is wanted" if key is None else f"the sweep has no point '{key}'"
        raise StudyError(f"{what}; choose a point with --point, a number from 0 to {last}")
    assert study.sweep is not None
    number = int(key)
    points = Points(study.sweep)
    row = points.row(points.rows(number, number + 1)[0])
    try:
        found = bench(study, row)
        evaluation = evaluation_of(found.system, found.design(row))
    except ModelError as error:
        raise StudyError(f"point {number}: {error}") from None
    return ChosenDesign(evaluation, str(number), f"{study.name}: point {number}", None, header["provenance"])
