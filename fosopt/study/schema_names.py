"""The metrics and variables an expression of a study may name, with their dimensions."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """A number fosopt computes for a design; an indexed one has one value per mode, counted from one."""

    dimension: str
    label: str
    meaning: str
    indexed: bool = False


METRICS: dict[str, Metric] = {
    "structural_mass": Metric("mass", "structural mass", "Bars, battens and added masses."),
    "total_mass": Metric("mass", "total mass", "Structure, mirror and proof masses together."),
    "structure_inertia": Metric(
        "inertia",
        "structure inertia about the hub",
        "Rotary inertia of the structure about the hub, without the mirror.",
    ),
    "mirror_inertia": Metric("inertia", "mirror inertia", "J_m."),
    "inertia_ratio": Metric("ratio", "inertia ratio", "Mirror inertia over structure inertia."),
    "reference_inertia": Metric(
        "inertia", "reference inertia", "J_ref, what a sudden torque at the mirror's port turns."
    ),
    "first_elastic_frequency": Metric(
        "frequency",
        "first elastic frequency",
        "Lowest natural frequency of the structure with the mirror's mass that is no rigid-body mode.",
    ),
    "spectral_abscissa": Metric(
        "decay",
        "spectral abscissa",
        "Largest real part of a closed-loop pole; below zero the loop is stable.",
    ),
    "modulus_margin": Metric(
        "ratio", "modulus margin", "Least distance of the loop's frequency response from -1."
    ),
    "loop_crossover": Metric(
        "frequency", "loop crossover", "Highest frequency at which the loop gain is one."
    ),
    "jitter_total": Metric(
        "angle", "total jitter", "Rms line-of-sight error of all disturbances, root sum square."
    ),
    "step_offset": Metric("angle", "step offset", "Size of the mean error after the step, over the window."),
    "step_rms": Metric(
        "angle", "step rms error", "Rms of the error after the step about its mean, over the window."
    ),
    "peak_stroke": Metric(
        "angle", "peak mirror stroke", "Largest angle of the mirror against its port over the repeated steps."
    ),
    "peak_rate": Metric(
        "angular_rate",
        "peak mirror rate",
        "Largest rate of the mirror against its port over the repeated steps.",
    ),
    "peak_torque": Metric("torque", "peak control torque", "Largest control torque over the repeated steps."),
    "structure_frequency": Metric(
        "frequency",
        "structure frequency",
        "Natural frequency of a mode of the structure with the mirror's mass, its inertia apart.",
        True,
    ),
    "natural_frequency": Metric(
        "frequency",
        "natural frequency",
        "Undamped natural frequency of a mode of structure and mirror together.",
        True,
    ),
    "modal_inertia": Metric(
        "inertia", "modal inertia", "Inertia a mode of the structure has at the mirror's port.", True
    ),
    "modal_reaction_inertia": Metric(
        "inertia",
        "modal reaction inertia",
        "J_k, the inertia a coupled mode has for a torque between mirror and port.",
        True,
    ),
    "effective_modal_reaction_inertia": Metric(
        "ratio",
        "effective modal reaction inertia",
        "J_m/J_k, the share of a coupled mode in the mirror's motion; all sum to one.",
        True,
    ),
    "pole_zero_separation": Metric(
        "ratio",
        "pole-zero separation",
        "Natural frequency of a coupled mode over that of the zero it goes with; one if they cancel.",
        True,
    ),
    "participation": Metric("ratio", "participation", "Square of the pole-zero separation.", True),
}
"""Every metric but ``jitter_<disturbance>``."""

BY_AXIS: dict[str, Metric] = {
    "jitter_first_axis": Metric(
        "angle", "jitter about the first axis", "Rms line-of-sight error about it, root sum square."
    ),
    "jitter_second_axis": Metric(
        "angle", "jitter about the second axis", "Rms line-of-sight error about it, root sum square."
    ),
    "modulus_margin_first_axis": Metric(
        "ratio", "modulus margin, first axis", "Of the loop about it, with the other one closed."
    ),
    "modulus_margin_second_axis": Metric(
        "ratio", "modulus margin, second axis", "Of the loop about it, with the other one closed."
    ),
    "modulus_margin_multivariable": Metric(
        "ratio",
        "modulus margin, both loops at once",
        "Least singular value of one plus the loop transfer matrix; no gradient.",
    ),
    "loop_crossover_first_axis": Metric(
        "frequency", "loop crossover, first axis", "Of the loop about it, with the other one closed."
    ),
    "loop_crossover_second_axis": Metric(
        "frequency", "loop crossover, second axis", "Of the loop about it, with the other one closed."
    ),
}
"""Metrics of a mirror with a second axis, beside those of every mirror: its `jitter_total` is that about both axes
together, its `modulus_margin` and `loop_crossover` are the least of both."""

JITTER = Metric("angle", "jitter", "Rms line-of-sight error of one disturbance.")

BOUNDS: dict[str, Metric] = {
    "mass_lower_bound": Metric(
        "mass",
        "least mass for the requirements",
        "No structure in the box that meets the constraints on the structure is lighter.",
    ),
    "mass_lower_bound_same_frequency": Metric(
        "mass",
        "least mass for this first frequency",
        "None of at least this design's first frequency is lighter.",
    ),
    "mass_lower_bound_same_receptance": Metric(
        "mass",
        "least mass for this receptance",
        "None that is no softer at the stated port and frequency is lighter.",
    ),
    "jitter_bound_pid": Metric(
        "angle",
        "least jitter with a PID in the box",
        "No PID in the box of gains has less jitter on this structure.",
    ),
    "jitter_bound_any": Metric(
        "angle", "least jitter with any controller", "No linear controller has less jitter on this structure."
    ),
}
"""Bounds that go with a point, on its structure alone and on its controller alone."""

MEMBERS = ("area", "batten_mass", "spring_stiffness")
"""Quantities that have one value per member of the structure; the others have one value."""

QUANTITIES: dict[str, str | None] = {
    "area": "area",
    "batten_mass": "mass",
    "spring_stiffness": None,
    "mirror_inertia": "inertia",
    "mirror_inertia_ratio": "ratio",
    "mirror_frequency": "frequency",
    "gain": "control_gain",
    "crossover": "frequency",
    "kp": "rate",
    "ki": "rate_squared",
    "kd": "ratio",
}
"""Dimension of each quantity that can be a design variable; that of a stiffness follows from the springs."""

SIGNAL: dict[str, str] = {
    "mirror_torque": "torque",
    "hub_torque": "torque",
    "line_of_sight": "angle",
    "sensor_noise": "angle",
}
"""Dimension of what a disturbance adds, by the place where it acts."""
