"""From a study that has been understood to the problem it poses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from fnmatch import fnmatchcase
from math import inf
from typing import Any

import numpy as np

from fosopt.actuators import (
    BICOLLOCATED,
    Mirror,
    MirrorReactionMass,
    Placement,
    ReactionMassActuator,
)
from fosopt.control import Loop, gain_for_crossover
from fosopt.control.discrete import discrete_controller
from fosopt.control.free_body import refuse_turning
from fosopt.errors import FosoptError, StudyError
from fosopt.expressions import Expression
from fosopt.metrics import disturbances as shaping
from fosopt.metrics.peaks import torque_at_once
from fosopt.metrics.sampled import SampledModel
from fosopt.metrics.step import StepCommand
from fosopt.modes import Damping, Hub, modes_below
from fosopt.ops import Array
from fosopt.problem import LARGE, Constraint, Definitions, Design, ModeSelection, Problem, System, Variable
from fosopt.structure import (
    Bar,
    Batten,
    Beam,
    Chain,
    PointMass,
    Spring,
    Structure,
    Truss,
    assemble,
    assemble_beam,
    assemble_chain,
    barker_truss,
    structural_mass,
    structure_inertia,
    two_body_stiffness,
)
from fosopt.structure.imported import ImportedModes
from fosopt.study import schema, schema_structures, schema_truss
from fosopt.study.axes import check_other_axis, second_axis, second_axis_definitions
from fosopt.study.build_disturbances import disturbance_of
from fosopt.study.build_loop import controller_of, mirror_limits
from fosopt.study.files import read_damping
from fosopt.study.imports import imported_damping, imported_structure, read_imported, refuse_riding
from fosopt.study.requirement import requirement_line
from fosopt.study.schema_imports import Imported
from fosopt.study.schema_names import MEMBERS

# Modes that a large truss keeps where the study says nothing: those below twice the mirror's frequency and somewhat
# beyond the crossover, where the margin is decided, but of a number that tells something and that the judge, whose
# time grows with its cube, can be waited for.
_BEYOND, _BEYOND_CROSSOVER = 2.0, 1.25
_FEWEST, _MOST = 100, 400


def build_problem(study: schema.Study) -> Problem:
    """The co-design problem of a study, checked at its start as far as can be without solving it.

    Raises
    ------
    StudyError
        For what physics does not allow, with the line of the section at fault.
    """
    with _at(study, "structure"):
        imported = read_imported(study)
        structure = _structure(study.structure, imported, study.mirror.port)
    base = _base(study, structure)
    with _at(study, "mirror", "mass"):
        refuse_riding(study, structure, base.mirror_mass)
    with _at(study, "damping"):
        damping = _damping(study, imported)
    hub = Hub(study.hub.type, study.hub.bandwidth or 0.0, study.hub.damping_ratio or 0.0)
    disturbances = []
    for k, each in enumerate(study.disturbances):
        with _at(study, "disturbances", k):
            disturbances.append(disturbance_of(study, each))
    step = None
    if study.step is not None:
        with _at(study, "step"):
            step = StepCommand(study.step.command, study.step.window)
    with _at(study, "modes"):
        selection = _selection(study, structure, base)
    system = System(structure, study.mirror.port, hub, damping, tuple(disturbances), step, selection)
    system = replace(system, two_axes=study.second_axis is not None)
    with _at(study, "modes"):
        _ = system.truncated
    variables = tuple(_variable(study, structure, base, k) for k in range(len(study.variables)))
    retargeting, checks = mirror_limits(study)
    # Sweeps optimize nothing: they see the loop as built at once.
    system = replace(system, retargeting=retargeting, as_built=study.kind == "sweep")
    with _at(study, "requirement_line"):
        system = replace(system, requirement_line=requirement_line(study))
    crossover, second = study.controller.crossover, second_axis_definitions(study)
    definitions = Definitions(study.mirror.inertia_ratio, crossover, second)
    constraints = []
    for k, given in enumerate(study.constraints):
        with _at(study, "constraints", k):
            lower = -inf if given.lower is None else given.lower
            upper = inf if given.upper is None else given.upper
            constraints.append(Constraint(given.metric, lower, upper))
    objectives: tuple[Expression, ...] = tuple(o.minimize for o in study.objectives)
    with _at(study, "variables"):
        problem = Problem(system, base, variables, objectives, tuple(constraints), definitions, checks)
    _check_start(study, problem)
    return problem


def start_vector(study: schema.Study, problem: Problem) -> Array:
    """(n,) Values of all variables where the study starts: its ``design``, else the variables' starts.

    Raises
    ------
    StudyError
        If a list in ``design`` has a wrong number of values.
    """
    with _at(study, "design"):
        return problem.vector(study.design)


@contextmanager
def _at(study: schema.Study, *path: str | int) -> Iterator[None]:
    """Say where in the study file an error of physics stands."""
    try:
        yield
    except StudyError:
        raise
    except FosoptError as error:
        raise study.error(str(error), *path) from error


def _check_start(study: schema.Study, problem: Problem) -> None:
    """What the start already shows to be wrong: mechanisms, mode selections, infinite variances."""
    evaluation = problem.evaluate(start_vector(study, problem))
    with _at(study, "structure"):
        drifting = evaluation.frame.n_rigid > 0 and study.hub.type == "free"
    with _at(study, "hub"):
        frequencies = evaluation.all_modes.natural_frequency
    with _at(study, "modes"):
        problem.system.selection.of(frequencies)
    if study.mirror.other_axis is not None:
        with _at(study, "mirror", "other_axis"):
            check_other_axis(study.mirror.other_axis, problem, start_vector(study, problem))
    with _at(study, "placement"):
        refuse_turning(evaluation.design.loop, evaluation.modes, problem.system.mirror_port)
    for k, disturbance in enumerate(problem.system.disturbances):
        with _at(study, "disturbances", k):
            shaping.refuse_infinite_variance(disturbance, evaluation.design.loop, drifting)
    if study.controller.sampling is not None:
        sampled = SampledModel(evaluation.design.loop, evaluation.modes, problem.system.mirror_port)
        with _at(study, "controller", "sampling"):
            _ = sampled.bare
        for k, disturbance in enumerate(problem.system.disturbances):
            with _at(study, "disturbances", k):
                replace(sampled, disturbances=(disturbance,)).refuse_infinite()


def _structure(
    given: schema_structures.Structure, imported: ImportedModes | None, mirror_port: str
) -> Structure:
    if isinstance(given, Imported):
        assert imported is not None
        return imported_structure(given, imported, mirror_port)
    if isinstance(given, schema_structures.Beam):
        beam = Beam(
            given.length,
            given.mass_per_length,
            given.bending_stiffness,
            given.axial_stiffness,
            given.boundary,
        )
        modes = given.lateral_modes, given.longitudinal_modes
        return assemble_beam(beam, mirror_port, *modes, given.stations)
    if isinstance(given, schema_structures.Chain):
        inertias = [body.inertia for body in given.bodies]
        springs = map(_spring_stiffness, given.springs, inertias[:-1], inertias[1:])
        names = (body.name for body in given.bodies)
        chain = Chain(dict(zip(names, inertias, strict=True)), tuple(springs), given.held)
        return assemble_chain(chain, mirror_port)
    return assemble(_truss(given), mirror_port)


def _spring_stiffness(spring: schema_structures.ChainSpring, first: float, second: float) -> float:
    if spring.stiffness is not None:
        return spring.stiffness
    return float(two_body_stiffness(spring.frequency, first, second))


def _truss(given: schema_truss.BarkerTruss | schema_truss.Truss) -> Truss:
    if isinstance(given, schema_truss.BarkerTruss):
        sizes = {
            name: value
            for name in ("longeron_area", "diagonal_area", "batten_mass")
            if (value := getattr(given, name)) is not None
        }
        return barker_truss(given.boundary, given.bays, **sizes)
    bars = tuple(
        Bar(
            bar.name or f"{bar.nodes[0]}-{bar.nodes[1]}",
            bar.nodes,
            bar.area,
            bar.young,
            bar.density,
            bar.kind,
            bar.bay or 0,
        )
        for bar in given.bars
    )
    battens = tuple(Batten(b.name, b.nodes, b.mass, b.inertia, b.center) for b in given.battens)
    points = tuple(PointMass(str(p.node or p.batten), p.mass, p.inertia) for p in given.points)
    springs = tuple(
        Spring(str(s.node or s.batten), s.component, s.stiffness, s.name or "") for s in given.springs
    )
    return Truss(given.nodes, bars, given.ports, given.supports, battens, points, springs)


def _base(study: schema.Study, structure: Structure) -> Design:
    given = study.mirror
    area, batten_mass = structure.area, structure.batten_mass
    mass = float(structural_mass(structure, area, batten_mass))
    if given.mass is not None:
        mirror_mass = given.mass
    else:
        assert given.mass_fraction is not None
        mirror_mass = mass * given.mass_fraction / (1 - given.mass_fraction)
    inertia = given.inertia
    if inertia is None:
        assert given.inertia_ratio is not None
        inertia = given.inertia_ratio * float(structure_inertia(structure, area, batten_mass))
    frequency = given.frequency
    if frequency is None:
        assert given.stiffness is not None
        frequency = float(np.sqrt(given.stiffness / inertia))
    with _at(study, "mirror"):
        shares = given.reaction_mass
        counter = None if shares is None else MirrorReactionMass(**shares.model_dump())
        mirror = Mirror(inertia, frequency, given.damping_ratio, counter)
    controller = controller_of(study, study.controller, mirror, "controller")
    if controller.path.sampling is not None:
        with _at(study, "controller", "sampling"):
            discrete_controller(controller)
    elif (
        study.limits is not None and study.limits.torque is not None and np.isinf(torque_at_once(controller))
    ):
        raise study.error(
            "without a roll-off of the derivative a step asks for an infinite torque; add 'rolloff' to the controller",
            *("limits", "torque"),
        )
    actuators, beside = tuple(_actuators(study, structure)), second_axis(study, mirror, controller)
    loop = Loop(mirror, controller, _placement(study, structure), actuators, beside)
    return Design(area, batten_mass, structure.spring_stiffness, mirror_mass, loop)


def _placement(study: schema.Study, structure: Structure) -> Placement:
    given = study.placement
    if given is None:
        return BICOLLOCATED
    own = structure.port(study.mirror.port)
    for key in ("reaction", "sensor", "action"):
        port = getattr(given, key)
        if port is None:
            continue
        with _at(study, "placement", key):
            row = structure.port(port)
        reacting = own if given.reaction is None else structure.port(given.reaction)
        if key == "action" and np.array_equal(row, reacting):
            raise study.error(
                f"the torque acts and reacts at '{port}' and moves nothing; choose two places",
                *("placement", key),
            )
    # A reaction at the mirror's own port by another name is the usual one.
    named = given.reaction is not None and np.array_equal(structure.port(given.reaction), own)
    return Placement(None if named else given.reaction, given.sensor, given.action)


def _actuators(study: schema.Study, structure: Structure) -> Iterator[ReactionMassActuator]:
    for k, given in enumerate(study.actuators):
        with _at(study, "actuators", k, "port"):
            structure.port(given.port)
        with _at(study, "actuators", k):
            rotary = given.inertia is not None
            mass = given.inertia if given.inertia is not None else given.mass
            assert mass is not None
            yield ReactionMassActuator(
                given.port, mass, given.frequency, given.damping_ratio, given.rate_gain, rotary
            )


def _damping(study: schema.Study, imported: ImportedModes | None) -> Damping:
    given = _given_damping(study)
    if imported is not None:
        return imported_damping(imported, given)
    assert given is not None
    return given


def _given_damping(study: schema.Study) -> Damping | None:
    """The damping model the study states; None where the structure's file has it."""
    given = study.damping
    if given.imported:
        return None
    if given.uniform is not None:
        return Damping((given.uniform,))
    if given.per_mode is not None:
        return Damping(given.per_mode)
    table = read_damping(study)
    return Damping(table.damping_ratio, table.frequency)


def _selection(study: schema.Study, structure: Structure, base: Design) -> ModeSelection:
    """The modes to keep; of a large truss always a number, fixed at the start design."""
    modes = study.modes
    large = len(structure.dofs) > LARGE and bool(structure.truss.bars)
    if modes is None and not large:
        return ModeSelection()
    if modes is not None and (modes.below is None or not large):
        keep = None if modes.keep is None else tuple(k - 1 for k in modes.keep)
        return ModeSelection(modes.count, modes.below, keep)
    if modes is None:
        mirror_needs = _BEYOND * base.loop.mirror.natural_frequency
        below = max(mirror_needs, _BEYOND_CROSSOVER * _rigid_crossover(base.loop))
    else:
        assert modes.below is not None
        below = modes.below
    sizes = base.area, base.batten_mass, base.mirror_mass
    count = modes_below(structure, *sizes, below)
    if modes is not None:
        return ModeSelection(count)
    return ModeSelection(min(max(count, _FEWEST), _MOST))


def _rigid_crossover(loop: Loop) -> float:
    """About the highest frequency at which the loop of the rigidly supported mirror has a gain of one [rad/s]."""
    pid, frequency = loop.controller, np.geomspace(1e-2, 1e6, 2000)
    needed = gain_for_crossover(frequency, loop.mirror, pid.kp, pid.ki, pid.kd, pid.rolloff_time, pid.path)
    return float(frequency[needed <= pid.gain].max(initial=0.0))


def _variable(study: schema.Study, structure: Structure, base: Design, k: int) -> Variable:
    given = study.variables[k]
    log = given.scale == "log"
    if given.quantity not in MEMBERS:
        start = given.start
        if start is None:
            start = study.given(given.quantity, given.of_second_axis)
        if start is None:
            raise study.error(f"'{given.quantity}' has no start; add 'start' to the variable", "variables", k)
        with _at(study, "variables", k):
            lower, upper, first = (np.array([v], dtype=float) for v in (given.lower, given.upper, start))
            found = Variable(given.name, given.quantity, lower, upper, first, log)
            return replace(found, axis="second") if given.of_second_axis else found
    groups, labels = _groups(study, structure, k)
    values = getattr(base, given.quantity)
    starts = [given.start if given.start is not None else float(np.mean(values[list(g)])) for g in groups]
    n = len(groups)
    with _at(study, "variables", k):
        return Variable(
            given.name,
            given.quantity,
            np.full(n, given.lower),
            np.full(n, given.upper),
            np.array(starts),
            log,
            groups,
            labels,
        )


def _groups(
    study: schema.Study, structure: Structure, k: int
) -> tuple[tuple[tuple[int, ...], ...], tuple[str, ...]]:
    """Members of each group of a member variable, and the groups' names."""
    given: Any = study.variables[k]
    truss = structure.truss
    members: Any = dict(zip(MEMBERS, (truss.bars, truss.battens, truss.springs), strict=True))[given.quantity]
    sort = "component" if given.quantity == "spring_stiffness" else "kind"
    only = getattr(given, f"{sort}s", None)
    chosen = [(i, m) for i, m in enumerate(members) if only is None or getattr(m, sort) in only]
    groups: dict[str, list[int]] = {}
    if given.groups is not None:
        owner: dict[int, str] = {}
        for name, patterns in given.groups.items():
            for pattern in patterns:
                matched = [i for i, m in chosen if fnmatchcase(m.name, pattern)]
                if not matched:
                    names = ", ".join(m.name for _, m in chosen[:6])
                    raise study.error(
                        f"'{pattern}' matches no member; members are named {names}, ...",
                        *("variables", k, "groups", name),
                    )
                for i in matched:
                    if owner.setdefault(i, name) != name:
                        raise study.error(
                            f"member '{members[i].name}' belongs to '{owner[i]}' and '{name}'; keep one",
                            *("variables", k, "groups", name),
                        )
                    if i not in groups.setdefault(name, []):
                        groups[name].append(i)
    else:
        for i, member in chosen:
            groups.setdefault(_label(member, given.group_by), []).append(i)
    taken = {
        i: other.name
        for j, other in enumerate(study.variables[:k])
        if other.quantity == given.quantity
        for group in _groups(study, structure, j)[0]
        for i in group
    }
    for i in (i for group in groups.values() for i in group):
        if i in taken:
            raise study.error(
                f"member '{members[i].name}' is already set by variable '{taken[i]}'; restrict one of them",
                *("variables", k),
            )
    if not groups:
        raise study.error("the structure has no such members; remove the variable", "variables", k)
    return tuple(tuple(sorted(group)) for group in groups.values()), tuple(groups)


def _label(member: Any, group_by: str) -> str:
    """Name of the group of a member where it is grouped by what it is."""
    if group_by == "all":
        return "all"
    if group_by == "bay":
        return f"bay {member.bay}"
    return str(getattr(member, "name" if group_by == "member" else group_by))
