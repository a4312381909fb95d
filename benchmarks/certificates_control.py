"""Certificates of control: limits of performance, the best PID controller in a box, and Youla designs.

Systems are those of the studies that ship: the modified benchmark problem of chapter 3 on five supports, and the full
truss with three mirrors.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import pairwise
from math import pi
from pathlib import Path

import common

from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.functional import LoopModel
from fosopt.relax.log_integral import logarithmic_limit
from fosopt.relax.performance_limit import performance_limit
from fosopt.relax.pid_bound import PidBound, best_pid
from fosopt.relax.pid_box import PidBox, box_of_crossovers
from fosopt.relax.riccati import riccati_limit
from fosopt.relax.youla import youla
from fosopt.study.build import build_problem, start_vector
from fosopt.study.load import load_study

STUDIES = Path(__file__).resolve().parents[1] / "studies"
TITLE = "Certificates of control"
HZ = 2 * pi
# Absolute gains of chapter 3, and those of the truss per kg m² of the mirror.
WIDE = PidBox((1.0, 1.0), (1e4, 1e8), (1e4, 1e11), (1e2, 1e5))
WIDE_PER_INERTIA = ((1e4, 1e9), (1e6, 1e13), (1e2, 1e7))
KP, KI, KD = (10.0, 6000.0), (100.0, 5e6), (1.0, 1.0)
GAIN, CROSSOVER = (100.0, 1e4), (10 * HZ, 500 * HZ)
SUPPORTS = {
    "rigid": ("structure.bodies.0.inertia=1e9 kg m^2", "structure.bodies.1.inertia=1e9 kg m^2"),
    "1 Hz": ("structure.springs.0.frequency=1 Hz",),
    "10 Hz": ("structure.springs.0.frequency=10 Hz",),
    "100 Hz": (),
    "500 Hz": ("structure.springs.0.frequency=500 Hz",),
}
MIRRORS = {"0.02 %": "0.3696 kg m^2", "0.2 %": "3.696 kg m^2", "2 %": "36.96 kg m^2"}
ORDERS = (16, 32, 64)
GAPS = (0.01, 0.001, 0.0001)
GAP, TIME_LIMIT = 0.02, 120.0
MARGIN = 0.5

NOTES = f"""\
Seconds are processor seconds of one thread, the limit of {TIME_LIMIT:g} s as well. Displacement, noise and force, and
the torques of the truss, are those of `studies/modified-benchmark.yaml` and `studies/unstable-mirror.yaml`; the latter
keep their size while the mirror's inertia changes. Jitter in µrad.

Boxes: absolute gains k_p from 1e4 to 1e8, k_i from 1e4 to 1e11 and k_d from 1e2 to 1e5 in chapter 3, from 1e4 to 1e9,
1e6 to 1e13 and 1e2 to 1e7 per kg m² of the mirror on the truss ("wide"); and what the variables of the studies span
("study": gain 100 to 10000 or crossover 10 to 500 Hz, kp 10 to 6000, ki 100 to 5e6, kd 1). "First" is the controller
found by random samples and simplices before the first box is cut, over the best one at the end; "allowance" is what
denser frequencies took off the bound. Youla designs keep |S| and |T| within 2. Then more is asked for: smaller gaps in
the wide box, a modulus margin of {MARGIN}, and disturbances that count from 0.1 Hz to 2 kHz only. The profile is
cProfile's, libraries counted to the module that called them; it slows Python code more than compiled code."""


@dataclass(frozen=True)
class Case:
    """A loop, what disturbs it, and two boxes of gains."""

    name: str
    model: LoopModel
    disturbances: tuple[Disturbance, ...]
    wide: PidBox
    study: PidBox


def case_of(name: str, file: str, overrides: tuple[str, ...], wide: PidBox | None) -> Case:
    """A case from a study that ships."""
    study = load_study(STUDIES / file, overrides)
    problem = build_problem(study)
    model = problem.evaluate(start_vector(study, problem)).model
    mirror = model.loop.mirror
    if wide is not None:
        return Case(name, model, problem.system.disturbances, wide, PidBox(GAIN, KP, KI, KD))
    inertia = float(mirror.inertia)
    kp, ki, kd = ((low * inertia, high * inertia) for low, high in WIDE_PER_INERTIA)
    crossovers = box_of_crossovers(mirror, CROSSOVER, KP, KI, KD)
    return Case(name, model, problem.system.disturbances, PidBox((1.0, 1.0), kp, ki, kd), crossovers)


def cases() -> list[Case]:
    """All of them."""
    found = [
        case_of(f"chapter 3, {name}", "modified-benchmark.yaml", overrides, WIDE)
        for name, overrides in SUPPORTS.items()
    ]
    found += [
        case_of(f"truss, J_m = {name}", "unstable-mirror.yaml", (f"mirror.inertia={inertia}",), None)
        for name, inertia in MIRRORS.items()
    ]
    return found


def limits(case: Case) -> list[str]:
    """The limit of performance by three routes."""
    given = case.model, case.disturbances
    times = [time.process_time()]
    limit = performance_limit(*given)
    times.append(time.process_time())
    logarithm = logarithmic_limit(*given)
    times.append(time.process_time())
    riccati = riccati_limit(*given)
    times.append(time.process_time())
    value = limit.bound.value
    return [
        case.name,
        f"{1e6 * value:.4f}",
        f"{1e6 * limit.noncausal:.3f}",
        f"{logarithm / value - 1:.0e}",
        f"{riccati / value - 1:.0e}",
        " / ".join(f"{1e3 * (end - begin):.0f}" for begin, end in pairwise(times)),
    ]


def certified(
    name: str, case: Case, box: PidBox, gap: float = GAP, margin: float = 0.0
) -> tuple[list[str], PidBound]:
    """A row of the table of PID controllers, and what it says."""
    found = best_pid(
        case.model, case.disturbances, box, gap=gap, modulus_margin=margin, time_limit=TIME_LIMIT
    )
    row = [
        name,
        f"{1e6 * found.jitter:.3f}",
        f"{1e6 * found.bound.value:.3f}",
        f"{100 * found.gap:.2f} %",
        f"{found.jitter / found.limit.bound.value:.4f}",
        f"{found.bound.allowance / found.bound.value:.0e}",
        str(found.boxes),
        f"{found.seconds:.1f}" + ("" if found.finished else ", stopped"),
    ]
    return row, found


def best(case: Case, box: str) -> list[str]:
    """The best PID controller in a box, certified, and how good the first ones were."""
    ranges = getattr(case, box)
    row, found = certified(f"{case.name}, {box}", case, ranges)
    # With a wide gap and no time nothing is cut.
    first = best_pid(case.model, case.disturbances, ranges, gap=0.99, time_limit=0.0)
    return [*row[:5], f"{first.jitter / found.jitter:.4f}", *row[5:]]


def designs(case: Case) -> list[str]:
    """Youla designs of several orders over the limit."""
    row = [case.name]
    for order in ORDERS:
        begin = time.process_time()
        design = youla(case.model, case.disturbances, order=order, ms=2.0, mt=2.0)
        seconds = time.process_time() - begin
        row.append(f"{design.jitter / design.limit.bound.value:.4f} ({seconds:.2f} s)")
    return row


def harder(hard: list[Case]) -> list[list[str]]:
    """Smaller gaps, a margin and finite bands."""
    rows = []
    for case in hard:
        rows += [certified(f"{case.name}, gap {100 * gap:g} %", case, case.wide, gap)[0] for gap in GAPS]
        rows.append(certified(f"{case.name}, margin {MARGIN}", case, case.wide, margin=MARGIN)[0])
        banded = tuple(replace(d, band=(0.1 * HZ, 2000 * HZ)) for d in case.disturbances)
        rows.append(certified(f"{case.name}, bands", replace(case, disturbances=banded), case.wide)[0])
    return rows


def profile(case: Case) -> list[tuple[str, str]]:
    """Where the search for the best PID controller spends its time."""
    return common.profile_by_module(
        lambda: best_pid(case.model, case.disturbances, case.wide, gap=GAP, time_limit=TIME_LIMIT)
    )


def main() -> None:
    """Measure, print and write the section."""
    every = cases()
    of_pid = ["", "best found", "bound", "gap", "best / any", "allowance", "boxes", "s"]
    with_first = [*of_pid[:5], "first", *of_pid[5:]]
    body = [
        "Limit of performance of any linear controller, by projection; logarithmic and Riccati form against it.",
        common.table(
            ["", "limit", "noncausal", "logarithm", "Riccati", "ms"], [limits(case) for case in every]
        ),
        f"Best PID controller, certified by branch and bound to {100 * GAP:g} %.",
        common.table(with_first, [best(case, box) for case in every for box in ("wide", "study")]),
        "Youla designs over the limit.",
        common.table(["", *(f"order {order}" for order in ORDERS)], [designs(case) for case in every]),
        "Asked for more.",
        common.table(of_pid, harder([every[2], *every[-len(MIRRORS) :]])),
        f"Time of the best PID controller to {100 * GAP:g} %, {every[-1].name}, wide.",
        common.table(["", "share"], profile(every[-1])),
        NOTES,
    ]
    text = "\n\n".join(body)
    print(text)
    common.write_section(TITLE, text)


if __name__ == "__main__":
    common.one_thread()
    main()
