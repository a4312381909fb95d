"""The metrics and variables an expression of a study may name, with their dimensions."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """A number fosopt computes for a design; an indexed one has one value per mode, counted from one."""

    dimension: str
    label: str
    indexed: bool = False


METRICS: dict[str, Metric] = {
    "structural_mass": Metric("mass", "structural mass"),
    "total_mass": Metric("mass", "total mass"),
    "structure_inertia": Metric("inertia", "structure inertia about the hub"),
    "mirror_inertia": Metric("inertia", "mirror inertia"),
    "inertia_ratio": Metric("ratio", "inertia ratio"),
    "reference_inertia": Metric("inertia", "reference inertia"),
    "first_elastic_frequency": Metric("frequency", "first elastic frequency"),
    "spectral_abscissa": Metric("decay", "spectral abscissa"),
    "modulus_margin": Metric("ratio", "modulus margin"),
    "loop_crossover": Metric("frequency", "loop crossover"),
    "jitter_total": Metric("angle", "total jitter"),
    "step_offset": Metric("angle", "step offset"),
    "step_rms": Metric("angle", "step rms error"),
    "structure_frequency": Metric("frequency", "structure frequency", True),
    "natural_frequency": Metric("frequency", "natural frequency", True),
    "modal_inertia": Metric("inertia", "modal inertia", True),
    "modal_reaction_inertia": Metric("inertia", "modal reaction inertia", True),
    "effective_modal_reaction_inertia": Metric("ratio", "effective modal reaction inertia", True),
    "pole_zero_separation": Metric("ratio", "pole-zero separation", True),
    "participation": Metric("ratio", "participation", True),
}
"""Every metric but ``jitter_<disturbance>``."""

JITTER = Metric("angle", "jitter")

BOUNDS: dict[str, Metric] = {
    "mass_lower_bound": Metric("mass", "least mass for the requirements"),
    "mass_lower_bound_same_frequency": Metric("mass", "least mass for this first frequency"),
    "jitter_bound_pid": Metric("angle", "least jitter with a PID in the box"),
    "jitter_bound_any": Metric("angle", "least jitter with any controller"),
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
