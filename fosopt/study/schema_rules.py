"""Rules of the study file that join several of its sections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from fosopt.errors import did_you_mean
from fosopt.expressions import Expression, Reference, parse_expression
from fosopt.study.schema_axes import check_second_axis
from fosopt.study.schema_base import KeyPath, RuleError, unique
from fosopt.study.schema_imports import Imported
from fosopt.study.schema_loop import check_loop
from fosopt.study.schema_names import BY_AXIS, JITTER, MEMBERS, METRICS, QUANTITIES, Metric
from fosopt.study.schema_sweep import check_sweep
from fosopt.study.schema_truss import BarkerTruss, Truss
from fosopt.units import DIMENSIONS, Vector, exponents, parse_quantity, quote, show

if TYPE_CHECKING:
    from fosopt.study.schema import SpringStiffnessVariable, Study, Variable

_EXCLUSIVE = {
    "gain": ("crossover", "controller"),
    "crossover": ("gain", "controller"),
    "mirror_inertia": ("mirror_inertia_ratio", "mirror"),
    "mirror_inertia_ratio": ("mirror_inertia", "mirror"),
    "mirror_frequency": ("stiffness", "mirror"),
}
"""Quantity that is fixed by another one, and the section that says by which."""


def known_metrics(study: Study) -> dict[str, Metric]:
    """The metrics this study has: jitter needs disturbances, step metrics a step, peaks of the mirror its limits."""
    known = {name: metric for name, metric in METRICS.items() if study.step or not name.startswith("step_")}
    if study.limits is None:
        known = {name: metric for name, metric in known.items() if not name.startswith("peak_")}
    if study.second_axis is not None:
        known |= BY_AXIS
    if not study.disturbances:
        known = {name: metric for name, metric in known.items() if not name.startswith("jitter_")}
    return known | {f"jitter_{disturbance.name}": JITTER for disturbance in study.disturbances}


def dimension_of(study: Study, name: str) -> str:
    """Name of the dimension of a metric or variable; a metric wins over a variable of its name."""
    metric = known_metrics(study).get(name)
    if metric is not None:
        return metric.dimension
    return next(variable_dimension(study, variable) for variable in study.variables if variable.name == name)


def variable_dimension(study: Study, variable: Variable) -> str:
    """Name of the dimension of a variable."""
    if variable.quantity == "spring_stiffness":
        assert isinstance(study.structure, BarkerTruss | Truss)
        return _stiffness_dimension(_springs(study.structure, variable)[0][1])
    known = QUANTITIES[variable.quantity]
    assert known is not None
    return known


def _stiffness_dimension(component: str) -> str:
    return "rotational_stiffness" if component.startswith("r") else "stiffness"


def _springs(structure: BarkerTruss | Truss, variable: SpringStiffnessVariable) -> list[tuple[str, str]]:
    """Name and component of each spring a variable sets."""
    patterns = ("*",) if variable.groups is None else [p for each in variable.groups.values() for p in each]
    return [
        (name, component)
        for name, component in structure.ground_springs
        if (variable.components is None or component in variable.components)
        and any(fnmatchcase(name, pattern) for pattern in patterns)
    ]


def expression_dimension(study: Study, expression: Expression) -> Vector | None:
    """Exponents of an expression's unit, or None where a plain number gives it any."""
    return expression.dimension(lambda name: exponents(dimension_of(study, name)))


def check_study(study: Study, data: Mapping[str, Any]) -> None:
    """Refuse a study whose sections do not fit together; ``data`` is what they were made of."""
    _check_ports(study)
    _check_mirror_mass(study)
    check_second_axis(study)
    check_loop(study)
    _check_disturbances(study)
    _check_variables(study, data)
    _check_purpose(study)
    for k, objective in enumerate(study.objectives):
        _check_expression(study, objective.minimize, ("objectives", k, "minimize"))
    for k, constraint in enumerate(study.constraints):
        vector = _check_expression(study, constraint.metric, ("constraints", k, "metric"))
        for key in ("lower", "upper"):
            value = _written(data["constraints"][k], key)
            if value is not None:
                _check_unit(value, vector, "constraints", k, key)
    for name in study.requirements:
        at: KeyPath = ("requirements", name)
        with _placed(*at, of_key=True):
            reference = parse_expression(name).reference
            if reference is None or reference[0] not in known_metrics(study):
                raise RuleError(f"{quote(name)} is no metric; {did_you_mean(name, known_metrics(study))}")
            _check_reference(study, reference)
        _check_unit(data["requirements"][name], exponents(dimension_of(study, reference[0])), *at)
    _check_design(study, data)
    _check_cases(study)


@contextmanager
def _placed(*at: str | int, of_key: bool = False) -> Iterator[None]:
    """Say where an error of a value stands."""
    try:
        yield
    except RuleError as error:
        raise RuleError(str(error), *(error.at or at), of_key=error.of_key or of_key) from None
    except ValueError as error:
        raise RuleError(str(error), *at, of_key=of_key) from None


def _written(section: object, key: str) -> object:
    """What stands at a key of a section, before it was converted."""
    return section.get(key) if isinstance(section, Mapping) else getattr(section, key)


def _check_unit(value: object, dimension: str | Vector | None, *at: str | int) -> None:
    with _placed(*at):
        parse_quantity(value, dimension)


def _check_ports(study: Study) -> None:
    ports = study.structure.ports
    if study.mirror.port not in ports:
        raise RuleError(
            f"unknown port '{study.mirror.port}'; {did_you_mean(study.mirror.port, ports)}", "mirror", "port"
        )
    certified = None if study.certificates is None else study.certificates.receptance
    if certified is not None and certified.port not in ports:
        raise RuleError(
            f"unknown port '{certified.port}'; {did_you_mean(certified.port, ports)}",
            *("certificates", "receptance", "port"),
        )
    if isinstance(ports, Mapping):
        component = ports[study.mirror.port][1]
        if not component.startswith("r"):
            truss = study.structure.type != "beam"
            use = "rx, ry or rz of a batten" if study.structure.type == "truss" else "rx, ry or rz"
            raise RuleError(
                f"the mirror turns, but its port moves along '{component}'; use {use}",
                *("structure", "ports" if truss else "stations", study.mirror.port, 1),
            )
    if "hub" not in ports:
        needed: list[KeyPath] = [
            ("disturbances", k, "at") for k, d in enumerate(study.disturbances) if d.at == "hub_torque"
        ]
        if study.mirror.inertia_ratio is not None:
            needed.insert(0, ("mirror", "inertia_ratio"))
        if study.hub.type != "free":
            needed.insert(0, ("hub", "type"))
        if needed:
            raise RuleError(
                "this needs the port 'hub'; add 'hub: [batten, rz]' to structure.ports", *needed[0]
            )


def _check_mirror_mass(study: Study) -> None:
    if study.damping.imported and not isinstance(study.structure, Imported):
        raise RuleError("no file tells this structure's damping; give 'uniform'", "damping", "imported")
    if study.structure.type == "chain" and study.mirror.mass_fraction is not None:
        raise RuleError(
            "a chain has no mass the mirror could be a fraction of; give 'mass', of which 0 kg is right as well",
            *("mirror", "mass_fraction"),
            of_key=True,
        )


def _check_disturbances(study: Study) -> None:
    unique(((d.name, ("disturbances", k, "name")) for k, d in enumerate(study.disturbances)), "disturbance")
    for k, disturbance in enumerate(study.disturbances):
        if disturbance.name == "total":
            raise RuleError(
                "'total' is taken by jitter_total; choose another name", "disturbances", k, "name"
            )


def _check_variables(study: Study, data: Mapping[str, Any]) -> None:
    unique(((v.name, ("variables", k, "name")) for k, v in enumerate(study.variables)), "variable")
    scalars = [
        (f"second {v.quantity}" if v.of_second_axis else v.quantity, ("variables", k, "quantity"))
        for k, v in enumerate(study.variables)
        if v.quantity not in MEMBERS
    ]
    unique(scalars, "quantity")
    for k, variable in enumerate(study.variables):
        at: KeyPath = ("variables", k)
        if variable.name != variable.quantity and variable.name in known_metrics(study):
            raise RuleError(f"'{variable.name}' is the name of a metric; choose another name", *at, "name")
        if variable.quantity in MEMBERS:
            _check_members(study, variable, data["variables"][k], at)
            continue
        default = study.given(variable.quantity, variable.of_second_axis)
        if default is None:
            other, section = _EXCLUSIVE[variable.quantity]
            raise RuleError(
                f"'{variable.quantity}' cannot vary while the {section} is given by its "
                f"{other.removeprefix('mirror_')}; give one in place of the other in '{section}'",
                *(*at, "quantity"),
            )
        if (
            variable.start is None
            and variable.name not in study.design
            and not variable.lower <= default <= variable.upper
        ):
            shown = show(default, variable_dimension(study, variable))
            raise RuleError(
                f"the start {shown} of the {variable.quantity} lies outside the bounds; add a 'start'", *at
            )


def _check_members(study: Study, variable: Variable, raw: object, at: KeyPath) -> None:
    structure = study.structure
    if isinstance(structure, Imported):
        raise RuleError(
            "an imported structure is known by its modes, not its members; remove the variable or describe a truss",
            *(*at, "quantity"),
        )
    if structure.type == "beam" or structure.type == "chain":
        raise RuleError(
            f"a {structure.type} has neither bars nor battens nor springs to ground; remove the variable or "
            "describe a truss",
            *(*at, "quantity"),
        )
    if variable.quantity == "spring_stiffness":
        _check_springs(structure, variable, raw, at)
        return
    if variable.quantity == "batten_mass" and structure.type == "truss" and not structure.battens:
        raise RuleError("the structure has no battens; remove the variable or add battens", *at, "quantity")
    if variable.quantity != "area":
        return
    for k, kind in enumerate(variable.kinds or ()):
        if kind not in structure.kinds:
            raise RuleError(f"unknown kind '{kind}'; {did_you_mean(kind, structure.kinds)}", *at, "kinds", k)
    if variable.group_by == "bay" and structure.type == "truss":
        without = [k for k, bar in enumerate(structure.bars) if bar.bay is None]
        if without:
            raise RuleError(
                f"grouping by bay, but bar {without[0]} has none; add 'bay' to each bar or use 'groups'",
                *(*at, "group_by"),
            )


def _check_springs(
    structure: BarkerTruss | Truss, variable: SpringStiffnessVariable, raw: object, at: KeyPath
) -> None:
    known = dict(structure.ground_springs)
    if not known:
        way_out = "add springs" if structure.type == "truss" else "write 'boundary: table'"
        raise RuleError(
            f"the structure has no springs to ground; remove the variable or {way_out}", *at, "quantity"
        )
    for k, held in enumerate(variable.components or ()):
        if held not in known.values():
            there = did_you_mean(held, set(known.values()))
            raise RuleError(f"no spring resists the component '{held}'; {there}", *at, "components", k)
    for name, patterns in (variable.groups or {}).items():
        for pattern in patterns:
            if not any(fnmatchcase(each, pattern) for each, _ in _springs(structure, variable)):
                raise RuleError(
                    f"'{pattern}' matches no spring; springs are named {', '.join(list(known)[:6])}",
                    *(*at, "groups", name),
                )
    first, *others = _springs(structure, variable)
    dimension = _stiffness_dimension(first[1])
    for name, component in others:
        if (other := _stiffness_dimension(component)) != dimension:
            raise RuleError(
                f"the springs '{first[0]}' [{DIMENSIONS[dimension].unit}] and '{name}' [{DIMENSIONS[other].unit}] have "
                "no unit in common; give each a variable of its own, with 'components' or 'groups'",
                *at,
            )
    for key in ("lower", "upper", "start"):
        value = _written(raw, key)
        if value is not None:
            _check_unit(value, dimension, *at, key)


def _check_purpose(study: Study) -> None:
    """Objectives, front and cases fit each other and the kind of study."""
    check_sweep(study, lambda expression, at: _check_expression(study, expression, at))
    if study.kind == "sweep":
        return
    if study.kind == "analysis":
        for key in ("front", "cases"):
            if getattr(study, key):
                raise RuleError(
                    f"an analysis has no '{key}'; remove it or write 'kind: codesign'", key, of_key=True
                )
        return
    for key in ("variables", "objectives"):
        if not getattr(study, key):
            raise RuleError(f"a co-design needs '{key}'; add at least one or write 'kind: analysis'", key)
    two = len(study.objectives) == 2
    if study.front and not two:
        raise RuleError("a front needs two objectives; add one or remove 'front'", "front", of_key=True)
    if two and not study.front:
        raise RuleError(
            "two objectives need 'front'; add 'front: {points: 12}' or remove one", "objectives", 1
        )
    if study.solve.compare and not study.front:
        raise RuleError(
            "strategies are compared along a front; add 'front' or remove 'compare'", "solve", "compare"
        )
    if study.cases and two:
        raise RuleError(
            "cases need a single objective; remove one objective or 'cases'", "cases", of_key=True
        )


def _check_expression(study: Study, expression: Expression, at: KeyPath) -> Vector | None:
    with _placed(*at):
        for reference in sorted(
            expression.references, key=lambda each: (expression.text.find(each[0]), each[1] or 0)
        ):
            _check_reference(study, reference)
        return expression_dimension(study, expression)


def _check_reference(study: Study, reference: Reference) -> None:
    name, index = reference
    metrics = known_metrics(study)
    variable = study.variable(name)
    if name in metrics:
        indexed, most, what = metrics[name].indexed, None, "mode"
    elif variable is not None:
        groups = getattr(variable, "groups", None)
        indexed, most, what = not variable.is_scalar, len(groups) if groups else None, "group"
    elif name == "jitter_total":
        raise RuleError("'jitter_total' needs disturbances; add the section 'disturbances'")
    elif name in BY_AXIS:
        raise RuleError(f"'{name}' is a metric of a mirror with two axes; add the section 'second_axis'")
    elif name in METRICS:
        raise RuleError(f"'{name}' needs a step command; add the section 'step'")
    else:
        known = {*metrics, *(each.name for each in study.variables)}
        raise RuleError(f"unknown metric '{name}'; {did_you_mean(name, known)}")
    if indexed and index is None:
        raise RuleError(f"'{name}' has one value per {what}; write {name}[1] for the first")
    if not indexed and index is not None:
        raise RuleError(f"'{name}' is a single value; write it without [{index}]")
    if index is not None and most is not None and index > most:
        raise RuleError(f"'{name}[{index}]' goes beyond the {most} groups; use at most {most}")


def _check_design(study: Study, data: Mapping[str, Any]) -> None:
    for name, value in study.design.items():
        variable = study.variable(name)
        if variable is None:
            known = (
                did_you_mean(name, (each.name for each in study.variables))
                if study.variables
                else "there are none"
            )
            raise RuleError(f"unknown variable '{name}'; {known}", "design", name, of_key=True)
        raw = data["design"][name]
        several = isinstance(raw, list | tuple)
        items = [((k,), each) for k, each in enumerate(raw)] if several else [((), raw)]
        if variable.is_scalar and len(items) > 1:
            raise RuleError(
                f"'{name}' is a single value, but {len(items)} are given; give one", "design", name
            )
        numbers = value if isinstance(value, tuple) else (value,)
        for (k, each), number in zip(items, numbers, strict=True):
            _check_unit(each, variable_dimension(study, variable), "design", name, *k)
            inside = variable.lower <= number <= variable.upper
            if study.kind == "codesign" and not inside:
                raise RuleError(
                    f"{quote(each)} lies outside the variable's bounds; change it or the bounds",
                    "design",
                    name,
                    *k,
                )


def _check_cases(study: Study) -> None:
    unique(((case.name, ("cases", k, "name")) for k, case in enumerate(study.cases)), "case")
    names = [variable.name for variable in study.variables]
    for k, case in enumerate(study.cases):
        for i, name in enumerate(case.free if isinstance(case.free, tuple) else ()):
            if name not in names:
                raise RuleError(
                    f"unknown variable '{name}'; {did_you_mean(name, names)}", "cases", k, "free", i
                )
        if isinstance(case.free, tuple):
            unique(((name, ("cases", k, "free", i)) for i, name in enumerate(case.free)), "variable")
