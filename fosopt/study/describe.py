"""A study as mathematics, for ``fosopt check``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from fosopt.expressions import Expression, parse_expression
from fosopt.study.schema import Study, Variable
from fosopt.study.schema_actuators import Actuator
from fosopt.study.schema_axes import SecondAxis
from fosopt.study.schema_certificates import Certificates
from fosopt.study.schema_imports import structure_files
from fosopt.study.schema_names import MEMBERS, SIGNAL
from fosopt.study.schema_rules import dimension_of, expression_dimension, variable_dimension
from fosopt.study.schema_structures import Structure
from fosopt.study.schema_sweep import AXES, Sweep
from fosopt.study.schema_system import Controller, Disturbance, Filter
from fosopt.units import DIMENSIONS, HZ, dimension_name, display, show

_INDENT = "  "


def describe_study(study: Study) -> list[str]:
    """Lines of plain text that state the problem: what is minimized, over what, subject to what."""
    lines = [study.name]
    lines += [line.rstrip() for line in study.description.splitlines() if line.strip()]
    if study.sweep is not None:
        lines += ["", *_block("sweep", _sweep(study.sweep))]
    else:
        lines += ["", *_block("problem" if study.kind == "codesign" else "analysis", _problem(study))]
        lines += ["", *_block("variables", (_variable(study, each) for each in study.variables))]
    lines += ["", *_block("system", _system(study))]
    lines += ["", *_block("disturbances", (_disturbance(study, each) for each in study.disturbances))]
    return lines


def _block(title: str, lines: Iterable[str]) -> list[str]:
    body = [_INDENT + line for line in lines]
    return [title, *(body or [f"{_INDENT}none"])]


def _amount(study: Study, expression: Expression, value: float) -> str:
    """A value of an expression in the unit people read, or bare where the unit has no name."""
    if expression.reference is not None:
        return show(value, dimension_of(study, expression.reference[0]))
    vector = expression_dimension(study, expression)
    dimension = None if vector is None else dimension_name(vector)
    return f"{value:.6g}" if dimension is None else show(value, dimension)


def _problem(study: Study) -> Iterator[str]:
    for k, objective in enumerate(study.objectives):
        front = f"   (Pareto front, {study.front.points} points)" if study.front and k else ""
        name = "" if objective.label is None else f"{objective.label}: "
        yield f"{'minimize' if k == 0 else 'and':<12}{name}{objective.minimize}{front}"
    for k, constraint in enumerate(study.constraints):
        metric = constraint.metric
        lower = None if constraint.lower is None else _amount(study, metric, constraint.lower)
        upper = None if constraint.upper is None else _amount(study, metric, constraint.upper)
        if lower is not None and upper is not None:
            text = f"{metric} = {lower}" if lower == upper else f"{lower} ≤ {metric} ≤ {upper}"
        else:
            text = f"{metric} ≥ {lower}" if upper is None else f"{metric} ≤ {upper}"
        name = "" if constraint.label is None else f"{constraint.label}: "
        yield f"{'' if k else 'subject to':<12}{name}{text}"
    if study.kind == "codesign":
        yield f"{'over':<12}{', '.join(_indexed(each) for each in study.variables)}"
        solve = study.solve
        compared = f", compared with {', '.join(solve.compare)}" if solve.compare else ""
        starts = f"{solve.starts} start{'s' if solve.starts > 1 else ''}"
        limit = f"at most {solve.time_limit:g} s per point"
        yield f"{'by':<12}{solve.strategy} optimization{compared}, {starts}, {limit}"
    for case in study.cases:
        free = case.free if isinstance(case.free, str) else ", ".join(case.free) or "none"
        yield f"{'case':<12}{case.name}: free {free}"
    for name, value in study.requirements.items():
        yield f"{'required':<12}{name} ≤ {_amount(study, parse_expression(name), value)}"
    if study.requirement_line is not None:
        yield f"{'required':<12}cumulative jitter below the line of {study.requirement_line}"
    if study.certificates is not None:
        for k, text in enumerate(_bounds(study.certificates)):
            yield f"{'' if k else 'bounded':<12}{text}"


def _bounds(asked: Certificates) -> Iterator[str]:
    if asked.structure:
        yield "mass by requirements and by first frequency"
    if asked.receptance is not None:
        at = show(asked.receptance.frequency, "frequency") if asked.receptance.frequency else "zero frequency"
        yield f"mass by receptance of port {asked.receptance.port} at {at}"
    if asked.any_controller:
        yield "jitter of any controller"
    if asked.pid is not None:
        yield f"jitter of any PID in the box to {100 * asked.pid.gap:g} %, {asked.pid.time_limit:g} s per point"


def _sweep(sweep: Sweep) -> Iterator[str]:
    for k, axis in enumerate(sweep.ordered):
        dimension = AXES[axis.quantity].dimension if axis.quantity in AXES else None
        shown = [show(x, dimension) if dimension else str(x) for x in axis.list or axis.ends]
        if axis.list is not None:
            text = ", ".join(shown[:8]) + (f", ... ({len(shown)})" if len(shown) > 8 else "")
        else:
            points = f", {axis.span.points} points" if axis.span.points else ""
            text = f"{shown[0]} to {shown[1]}, {'equal ratios' if axis.log else 'equal steps'}{points}"
        yield f"{'' if k else 'over':<12}{axis.name}: {text}"
    how = (
        "the full grid"
        if sweep.sampling == "grid"
        else f"{sweep.sampling.replace('_', ' ')}, seed {sweep.seed}"
    )
    yield f"{'points':<12}{sweep.count}, {how}"
    yield f"{'outputs':<12}{', '.join(each.text for each in sweep.outputs)}"
    if sweep.boundary is not None:
        yield f"{'boundaries':<12}of stability along {sweep.boundary.along}"


def _indexed(variable: Variable) -> str:
    return variable.name if variable.is_scalar else f"{variable.name}[k]"


def _variable(study: Study, variable: Variable) -> str:
    factor, unit = display(variable_dimension(study, variable))
    lower, upper = (f"{bound * factor:.6g}" for bound in (variable.lower, variable.upper))
    bounds = f"{lower} ≤ {_indexed(variable)} ≤ {upper} {unit}".rstrip()
    start = _start(study, variable)
    groups = getattr(variable, "groups", None)
    group_by = getattr(variable, "group_by", None)
    only = getattr(variable, "kinds", None) or getattr(variable, "components", None)
    parts = [bounds, f"start {start}", f"{variable.scale} scale"]
    if variable.name != variable.quantity:
        axis = " about the second axis" if variable.of_second_axis else ""
        parts.append(f"the {variable.quantity.replace('_', ' ')}{axis}")
    if groups:
        parts.append(
            "one per group: "
            + "; ".join(f"{name} = {', '.join(members)}" for name, members in groups.items())
        )
    elif group_by:
        parts.append("one for all" if group_by == "all" else f"one per {group_by}")
    if only:
        parts.append(f"{', '.join(only)} only")
    return ", ".join(parts)


def _start(study: Study, variable: Variable) -> str:
    given = study.design.get(variable.name)
    if isinstance(given, tuple):
        return f"from {len(given)} values of the design"
    value = given if given is not None else variable.start
    if value is None and variable.quantity not in MEMBERS:
        value = study.given(variable.quantity, variable.of_second_axis)
    return "from the structure" if value is None else show(value, variable_dimension(study, variable))


def _system(study: Study) -> Iterator[str]:
    mirror, controller, hub = study.mirror, study.controller, study.hub
    yield f"structure   {_structure(study.structure)}"
    if hub.bandwidth is not None and hub.damping_ratio is not None:
        held = show(hub.bandwidth, "frequency")
        yield f"hub         held, bandwidth {held}, damping ratio {hub.damping_ratio:g}"
    else:
        yield f"hub         {hub.type}"
    yield f"damping     {_damping(study)}"
    yield f"modes       {_modes(study)}"
    mass = (
        show(mirror.mass, "mass")
        if mirror.mass is not None
        else f"{mirror.mass_fraction:g} of the total mass"
    )
    if mirror.inertia is not None:
        inertia = show(mirror.inertia, "inertia")
    else:
        inertia = f"{100 * (mirror.inertia_ratio or 0):g} % of the structure's inertia"
    if mirror.frequency is not None:
        flexure = f"flexure at {show(mirror.frequency, 'frequency')}"
    else:
        flexure = f"flexure of {show(mirror.stiffness or 0, 'rotational_stiffness')}"
    damping = f"damping ratio {mirror.damping_ratio:g}"
    yield f"mirror      at port {mirror.port}: mass {mass}, inertia {inertia}, {flexure}, {damping}"
    if mirror.other_axis is not None:
        other = mirror.other_axis.port
        yield f"            as well about {other}: alike and uncoupled, verified; √2 of the jitter in both"
    shares = mirror.reaction_mass
    if shares is not None:
        yield (
            f"            reactionless: inertia {shares.inertia_ratio:g}, stiffness {shares.stiffness_ratio:g} and "
            f"torque {shares.torque_ratio:g} of the mirror's"
        )
    yield f"controller  K(s) = gain (kd s² + kp s + ki)/s: {_controller(controller)}"
    if study.second_axis is not None:
        yield f"second axis {_second_axis(study.second_axis)}"
    place = study.placement
    if place is not None:
        named = {key: port for key, port in place.model_dump().items() if port is not None}
        yield "placement   " + ", ".join(f"{key} at {port}" for key, port in named.items())
    for actuator in study.actuators:
        yield f"actuator    {_actuator(actuator)}"
    if study.step is not None:
        start, end = (show(1e3 * time, "ratio") for time in study.step.window)
        yield f"step        {show(study.step.command, 'angle')}, judged from {start} to {end} ms"


def _controller(controller: Controller) -> str:
    gain = f"gain {show(controller.gain, 'control_gain')}" if controller.gain is not None else ""
    gain = (
        f"crossover {show(controller.crossover, 'frequency')}" if controller.crossover is not None else gain
    )
    rolloff = f", roll-off {show(controller.rolloff, 'frequency')}" if controller.rolloff is not None else ""
    return f"kd {controller.kd:g}, kp {controller.kp:g}, ki {controller.ki:g}, {gain}{rolloff}"


def _second_axis(given: SecondAxis) -> str:
    parts = [f"both loops are closed; the mirror at port {given.port}"]
    parts += [f"hub at port {given.hub}"] if given.hub is not None else []
    parts += [f"inertia {show(given.inertia, 'inertia')}"] if given.inertia is not None else []
    parts += [f"flexure at {show(given.frequency, 'frequency')}"] if given.frequency is not None else []
    parts += [f"damping ratio {given.damping_ratio:g}"] if given.damping_ratio is not None else []
    parts += [f"controller {_controller(given.controller)}"] if given.controller is not None else []
    return ", ".join([*parts, "the rest as about the first"])


def _actuator(actuator: Actuator) -> str:
    if actuator.mass is not None:
        body, damper = show(actuator.mass, "mass"), "damper"
    else:
        body, damper = show(actuator.inertia or 0.0, "inertia"), "rotational_damper"
    feedback = f", rate gain {show(actuator.rate_gain, damper)}" if actuator.rate_gain else ""
    spring = f"{show(actuator.frequency, 'frequency')}, damping ratio {actuator.damping_ratio:g}"
    return f"at port {actuator.port}: proof mass {body}, {spring}{feedback}"


def _structure(structure: Structure) -> str:
    match structure.type:
        case "barker_truss":
            return f"planar truss of {structure.bays} bays, {structure.boundary}"
        case "truss":
            dimension = "planar" if len(next(iter(structure.nodes.values()))) == 2 else "spatial"
            counts = (
                f"{len(structure.nodes)} nodes, {len(structure.bars)} bars, {len(structure.battens)} battens"
            )
            return f"{dimension} truss of {counts}"
        case "beam":
            size = f"{show(structure.length, 'length')}, {show(structure.mass_per_length, 'mass_per_length')}"
            modes = f"{structure.lateral_modes} lateral and {structure.longitudinal_modes} longitudinal modes"
            return f"uniform beam of {size}, {structure.boundary}, {modes}"
        case "modal_set" | "matrices":
            kind = "modal set" if structure.type == "modal_set" else "matrices"
            files = " and ".join(dict.fromkeys(structure_files(structure)))
            return f"{kind} of {files}, {show(structure.structural_mass, 'mass')}"
        case _:
            bodies = " - ".join(f"{body.name} {show(body.inertia, 'inertia')}" for body in structure.bodies)
            return f"chain of bodies and springs, {'held' if structure.held else 'free'}: {bodies}"


def _damping(study: Study) -> str:
    damping = study.damping
    if damping.uniform is not None:
        return f"ratio {damping.uniform:g} of every structural mode"
    if damping.per_mode is not None:
        return f"ratios of {len(damping.per_mode)} modes"
    if damping.imported:
        return "ratios of the structure's file"
    return (
        f"table {damping.table}"
        if isinstance(damping.table, str)
        else f"table of {len(damping.table or ())} rows"
    )


def _modes(study: Study) -> str:
    modes = study.modes
    if modes is None:
        return "all; of a large truss the lowest, with residual flexibility"
    if modes.keep is not None:
        return ", ".join(str(k) for k in modes.keep)
    return (
        f"the first {modes.count}"
        if modes.count is not None
        else f"below {show(modes.below or 0, 'frequency')}"
    )


def _disturbance(study: Study, disturbance: Disturbance) -> str:
    spectrum = (
        f"{'PSD' if disturbance.psd else 'cumulative rms'} of {disturbance.table}"
        if disturbance.filter is None
        else _filter(disturbance.filter, disturbance.at)
    )
    band = "all frequencies"
    if disturbance.band is not None:
        lower, upper = (edge / HZ for edge in disturbance.band)
        band = f"{lower:.6g} to {upper:.6g} Hz"
    elif disturbance.table is not None:
        band = "the table's range"
    about = ""
    if study.second_axis is not None:
        both = disturbance.axis in (None, "both")
        about = " about both axes, independent" if both else f" about the {disturbance.axis} axis"
    return f"{disturbance.name}: {disturbance.at.replace('_', ' ')}{about}, {spectrum}, over {band}"


def _filter(spectrum: Filter, at: str) -> str:
    signal = SIGNAL[at]
    match spectrum.type:
        case "low_pass":
            kind = f"low pass of order {spectrum.order} at {show(spectrum.corner, 'frequency')}"
            return f"{kind}, rms {show(spectrum.rms, signal)}"
        case "high_pass":
            kind = f"high pass of order {spectrum.order} at {show(spectrum.corner, 'frequency')}"
            return f"{kind}, density {show(spectrum.density, f'{signal}_density')}"
        case "band_pass":
            edges = f"{spectrum.lower / HZ:.6g} to {spectrum.upper / HZ:.6g} Hz"
            return f"band pass of order {spectrum.order} from {edges}, rms {show(spectrum.rms, signal)}"
        case "white":
            return f"white, density {show(spectrum.density, f'{signal}_density')}"
        case _:
            ratio = f"({_polynomial(spectrum.numerator)})/({_polynomial(spectrum.denominator)})"
            return f"H(s) = {ratio} {DIMENSIONS[signal].unit} on white noise"


def _polynomial(coefficients: tuple[float, ...]) -> str:
    degree = len(coefficients) - 1
    powers = [
        "" if degree == k else " s" if degree == k + 1 else f" s^{degree - k}" for k in range(degree + 1)
    ]
    return " + ".join(f"{c:g}{power}" for c, power in zip(coefficients, powers, strict=True) if c) or "0"
