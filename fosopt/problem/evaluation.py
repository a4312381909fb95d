"""A system at one design, evaluated once with all metrics and derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from fosopt.control import ClosedLoopPoles, OpenLoopPoles, closed_loop_poles, modal_matrices
from fosopt.errors import ModelError, SolverError, did_you_mean
from fosopt.metrics import inertias, margins
from fosopt.metrics.functional import Functional, LoopModel, Points
from fosopt.metrics.inertias import ModalFunctional
from fosopt.metrics.jitter import Variance, jitter_variances
from fosopt.metrics.peaks import peaks
from fosopt.metrics.sampled import SampledModel
from fosopt.metrics.step import step_metrics
from fosopt.modes import ModalFrame, ModalSet, receptance_functional
from fosopt.ops import Array, ComplexArray
from fosopt.plant import CoupledModes, coupled_modes, modes_of_matrices
from fosopt.problem.as_built import AsBuilt, no_gradient
from fosopt.problem.found import Found, Valued
from fosopt.problem.linear import linear_metric
from fosopt.problem.system import INDEXED, Design, System
from fosopt.symbolic import layout_of, loop_differential

# Metrics that are the least or the largest of several branches, and how many of these enter a constraint one by one.
BRANCHES = {"first_elastic_frequency": 4, "modulus_margin": 6, "spectral_abscissa": 6}


class Evaluation:
    """A system at one design: modes, poles, metrics and gradients, each computed once when first asked for.

    A metric comes as (value, gradient) with the gradient over `Design.parameters`. Loop metrics of an unstable
    loop raise `UnstableError`.

    Parameters
    ----------
    shift
        Jitter is that of H(s + shift), see `metrics.jitter.jitter_variance` [rad/s].
    """

    def __init__(self, system: System, design: Design, shift: float = 0.0) -> None:
        self.system, self.design, self.shift = system, design, shift
        self._known: dict[tuple[str, int | None], Found] = {}
        self._near: ClosedLoopPoles | None = None
        self._shared: OpenLoopPoles | None = None

    def neighbor(self, design: Design) -> Evaluation:
        """Evaluation of a design that differs in mirror and controller only: it shares the modes of this one.

        Its poles are found from those of this one where these are known.
        """
        beside = type(self)(self.system, design, self.shift)
        beside.frame, beside.all_modes, beside.kept, beside.modes = (
            self.frame,
            self.all_modes,
            self.kept,
            self.modes,
        )
        beside._near, beside._shared = self.__dict__.get("poles", self._near), self._shared
        return beside

    def neighbors(self, designs: Sequence[Design]) -> list[Evaluation]:
        """Evaluations of designs that differ in mirror and controller only, with their poles and jitter found together.

        What cannot be found together is left to each of them.
        """
        # numba takes a while to import, and only this needs it.
        from fosopt.control.many import many_closed_loop_poles, shared_open_loop
        from fosopt.metrics.jitter_many import many_jitter_variances

        beside = [self.neighbor(design) for design in designs]
        port, disturbances = self.system.mirror_port, self.system.disturbances
        if self._shared is None:
            self._shared = shared_open_loop(self.design.loop, self.modes, port)
        loops = [design.loop for design in designs]
        found = many_closed_loop_poles(loops, self.modes, port, self.poles, self._shared)
        good = []
        for k, known in enumerate(found):
            if known is not None:
                good.append(k)
                beside[k].poles = known
        if not good or not disturbances:
            return beside
        loops, poles = [loops[k] for k in good], [beside[k].poles for k in good]
        squares = many_jitter_variances(loops, poles, disturbances)
        for k, row in zip(good, squares.tolist(), strict=True):
            if not any(np.isnan(row)):
                beside[k].mean_squares = {
                    f"jitter_{d.name}": x for d, x in zip(disturbances, row, strict=True)
                }
        return beside

    @cached_property
    def frame(self) -> ModalFrame:
        """Eigenbasis of the structure; of a large one its lowest modes, with residual flexibility."""
        return self.system.frame(self.design)

    @cached_property
    def all_modes(self) -> ModalSet:
        """Modal set with every mode."""
        ports = ("hub", self.system.mirror_port, *self.design.loop.other_ports)
        return self.frame.modal_set(self.system.hub, self.system.damping, ports)

    @cached_property
    def kept(self) -> NDArray[np.intp]:
        """Indices of the modes the design model keeps."""
        if self.frame.outside is not None:
            return np.arange(self.frame.eigenvalue.size)
        return self.system.selection.of(self.all_modes.natural_frequency)

    @cached_property
    def modes(self) -> ModalSet:
        """Modal set of the design model."""
        return (
            self.all_modes if self.kept.size == self.frame.eigenvalue.size else self.all_modes.keep(self.kept)
        )

    @property
    def _mirror_ports(self) -> tuple[str, ...]:
        return (self.system.mirror_port,)

    @cached_property
    def model(self) -> LoopModel:
        """The loop on the design model."""
        return LoopModel(self.design.loop, self.modes, self.system.mirror_port)

    @cached_property
    def coupled(self) -> CoupledModes:
        """Undamped modes of structure, mirror and actuators together."""
        loop, port = self.design.loop, self.system.mirror_port
        if loop.plain:
            return coupled_modes(self.modes, loop.mirror, port)
        return modes_of_matrices(modal_matrices(loop, self.modes, port), loop.mirror)

    @cached_property
    def poles(self) -> ClosedLoopPoles:
        """Closed-loop poles."""
        return closed_loop_poles(self.design.loop, self.modes, self.system.mirror_port, self._near)

    @cached_property
    def sampled(self) -> AsBuilt | None:
        """The sampled loop, where the system is taken as built and the loop is sampled."""
        loop, system = self.design.loop, self.system
        if not system.as_built or loop.controller.path.sampling is None:
            return None
        return AsBuilt(SampledModel(loop, self.modes, system.mirror_port, system.disturbances), system)

    @property
    def stable(self) -> bool:
        """Whether all closed-loop poles decay."""
        return self.poles.spectral_abscissa < 0 if self.sampled is None else self.sampled.model.stable

    def value(self, name: str, index: int | None = None) -> float:
        """Value of a metric, SI units, without the work of its gradient; raises what `metric` raises."""
        return self._found(name, index).value

    def metric(self, name: str, index: int | None = None) -> Valued:
        """Value of a metric and its gradient over `Design.parameters`.

        Parameters
        ----------
        index
            Which mode, from one, for the metrics in `INDEXED`.

        Raises
        ------
        ModelError
            For an unknown name, or an index out of range.
        UnstableError
            For jitter and step metrics of an unstable loop.
        """
        return self._found(name, index).valued

    def _found(self, name: str, index: int | None) -> Found:
        key = (name, index)
        if key not in self._known:
            self._known[key] = self._compute(name, index)
        return self._known[key]

    def branches(self, name: str) -> list[Valued]:
        """The outermost branches of a metric that is a least or a largest one, for constraints."""
        if name == "first_elastic_frequency":
            elastic = np.arange(self.frame.n_rigid, self.frame.n_exact)[: BRANCHES[name]]
            return [self._frequency(int(k)).valued for k in elastic]
        return [each.valued for each in (self._margins if name == "modulus_margin" else self._decays)]

    def _compute(self, name: str, index: int | None) -> Found:
        if name in INDEXED:
            if index is None:
                raise ModelError(f"metric '{name}' needs the number of a mode, such as {name}[1]")
            return self._modal(name, index)
        if index is not None:
            raise ModelError(f"metric '{name}' takes no mode number")
        if name not in self.system.metric_names:
            raise ModelError(
                f"metric '{name}' does not exist; {did_you_mean(name, (*self.system.metric_names, *INDEXED))}"
            )
        if self.sampled is not None and self.sampled.has(name):
            return Found(self.sampled.value(name), partial(no_gradient, name))
        if name.startswith("peak_"):
            if np.isinf(self._peaks[name]):
                raise ModelError(f"{name} is infinite: the derivative does not roll off; add a roll-off")
            return Found(self._peaks[name], partial(no_gradient, name))
        if name == "jitter_total":
            return self._jitter([f"jitter_{d.name}" for d in self.system.disturbances])
        if name.startswith("jitter_"):
            return self._jitter([name])
        if name.startswith("step_"):
            return self._step[name]
        if name == "modulus_margin":
            return self._margins[0]
        if name == "first_elastic_frequency":
            return self._frequency(self.frame.n_rigid)
        if name == "reference_inertia":
            return self._reference_inertia()
        if name == "loop_crossover":
            frequency, functional = margins.crossover(self.model, self.poles)
            return Found(frequency, lambda: self._loop_gradient([functional]))
        if name == "spectral_abscissa":
            return Found(self.poles.spectral_abscissa, lambda: self._decays[0].gradient)
        value, gradient = linear_metric(self.system.structure, self.design, name)
        return Found(value, lambda: gradient)

    def _reference_inertia(self) -> Found:
        port, outside = self.system.mirror_port, self.frame.outside
        if outside is None:
            value = inertias.reference_inertia(self.modes, port)
            parts = self.frame, self.all_modes, self.kept, port
            return Found(value, lambda: self._modal_gradient(inertias.reference_inertia_functional(*parts)))
        # 1/J_ref = eᵀ M⁻¹ e of the whole structure: that of a few modes says little about it.
        value, still = 1 / outside.mobility, np.zeros(self.system.structure.stiffness_rows.shape[0])
        return Found(value, lambda: self._weights_gradient(still, (value * outside.impulse_shapes) ** 2))

    @cached_property
    def _decays(self) -> list[Found]:
        rightmost = margins.rightmost_poles(self.model, self.poles, BRANCHES["spectral_abscissa"])
        return [Found(real, partial(self._decay_gradient, real, f)) for real, f in rightmost]

    def _decay_gradient(self, real: float, functional: Functional | None) -> Array:
        if functional is not None:
            return self._loop_gradient([functional])
        ports, damping = self._mirror_ports, self.system.damping
        hidden = margins.decay_functional(
            self.frame.eigenvalue, self.all_modes, damping, ports, self.kept, real
        )
        return self._modal_gradient(hidden)

    def _frequency(self, mode: int) -> Found:
        value = float(np.sqrt(self.frame.eigenvalue[mode]))
        return Found(
            value, lambda: self._weights_gradient(*self.frame.eigenvalue_gradient(mode)) / (2 * value)
        )

    def _modal(self, name: str, index: int) -> Found:
        own = name in ("structure_frequency", "modal_inertia")
        count = self.modes.natural_frequency.size + (0 if own else 1)
        if own and self.frame.outside is not None:
            count = self.frame.n_exact
        if not 1 <= index <= count:
            raise ModelError(f"{name}[{index}]: the model has modes 1 to {count}")
        k = index - 1
        port, mirror = self.system.mirror_port, self.design.loop.mirror
        if own:
            mode = int(self.kept[k])
            if name == "structure_frequency":
                if self.frame.eigenvalue[mode] == 0:
                    return Found(float(self.modes.natural_frequency[k]), self._no_gradient)
                return self._frequency(mode)
            return Found(
                float(inertias.modal_inertia(self.modes, port)[k]),
                lambda: self._modal_gradient(
                    inertias.modal_inertia_functional(self.frame, self.all_modes, port, mode)
                ),
            )
        if not self.design.loop.plain:
            raise ModelError(
                f"{name}[{index}] is a metric of a bicollocated mirror without reaction masses only; "
                "the report's table of modes has its value"
            )
        coupled = self.coupled
        reaction = float(coupled.effective_modal_reaction_inertia[k])
        if reaction == 0.0:
            return self._unmoved(name, index, k)
        if name == "modal_reaction_inertia":
            value = float(mirror.inertia) / reaction
        elif name in ("pole_zero_separation", "participation") and np.isnan(coupled.zero[k]):
            raise ModelError(
                f"{name}[{index}]: this is the mirror mode, which has no zero; choose another mode"
            )
        else:
            value = float(getattr(coupled, name)[k])
        return Found(value, lambda: self._coupled_gradient(name, index, k))

    def _coupled_gradient(self, name: str, index: int, k: int) -> Array:
        """Gradient of a metric of coupled mode k, counted from zero, that the mirror moves."""
        if self.kept.size < self.frame.eigenvalue.size:
            raise SolverError(
                f"{name}[{index}]: coupled modes of a truncated model have no gradient; keep all modes"
            )
        coupled, mirror, port = self.coupled, self.design.loop.mirror, self.system.mirror_port
        parts = inertias.coupled_functionals(self.frame, self.all_modes, coupled, mirror, port, k)
        if name in ("effective_modal_reaction_inertia", "modal_reaction_inertia"):
            by_reaction = self._modal_gradient(parts["effective_modal_reaction_inertia"])
            if name == "effective_modal_reaction_inertia":
                return by_reaction
            reaction = float(coupled.effective_modal_reaction_inertia[k])
            gradient = -float(mirror.inertia) / reaction**2 * by_reaction
            gradient[self.design.loop_start] += 1 / reaction
            return gradient
        by_eigenvalue = self._modal_gradient(parts["eigenvalue"])
        if name == "natural_frequency":
            return by_eigenvalue / (2 * float(coupled.natural_frequency[k]))
        zero = float(coupled.zero[k])
        paired = int(self.kept[np.argmin(np.abs(self.modes.stiffness - zero))])
        if self.frame.eigenvalue[paired] > 0:
            by_zero = self._weights_gradient(*self.frame.eigenvalue_gradient(paired))
        else:
            by_zero = np.zeros_like(by_eigenvalue)
        gradient = (by_eigenvalue - float(coupled.participation[k]) * by_zero) / zero
        return (
            gradient if name == "participation" else gradient / (2 * float(coupled.pole_zero_separation[k]))
        )

    def _no_gradient(self) -> Array:
        return np.zeros(self.design.parameters.size)

    def _unmoved(self, name: str, index: int, k: int) -> Found:
        """A mode the mirror cannot move: a free rigid body, or a node at the port."""
        if name == "modal_reaction_inertia":
            raise ModelError(
                f"{name}[{index}] is infinite: the mirror cannot move this mode; use effective_{name}"
            )
        if name == "effective_modal_reaction_inertia":
            return Found(0.0, self._no_gradient)
        if name in ("pole_zero_separation", "participation"):
            return Found(1.0, self._no_gradient)
        eigenvalue = self.coupled.eigenvalue[k]
        if eigenvalue == 0:
            return Found(0.0, self._no_gradient)
        return self._frequency(int(np.argmin(np.abs(self.frame.eigenvalue - eigenvalue))))

    @cached_property
    def variances(self) -> dict[str, Variance]:
        """Mean square jitter of each disturbance with its differential, by metric name [rad²]."""
        disturbances = self.system.disturbances
        found = jitter_variances(self.model, self.poles, disturbances, self.shift)
        return {f"jitter_{d.name}": variance for d, variance in zip(disturbances, found, strict=True)}

    @cached_property
    def mean_squares(self) -> dict[str, float]:
        """Mean square jitter of each disturbance, by metric name [rad²]."""
        return {name: variance.value for name, variance in self.variances.items()}

    def _jitter(self, names: Sequence[str]) -> Found:
        rms = float(np.sqrt(sum(self.mean_squares[name] for name in names)))
        if rms == 0:
            # A disturbance that cannot reach the line of sight has no jitter, and no slope of its own.
            return Found(rms, self._no_gradient)
        return Found(
            rms,
            lambda: (
                self._loop_gradient([f for name in names for f in self.variances[name].functionals])
                / (2 * rms)
            ),
        )

    @cached_property
    def _margins(self) -> list[Found]:
        values, functionals = margins.modulus_margins(self.model, self.poles, BRANCHES["modulus_margin"])
        return [
            Found(float(v), partial(self._loop_gradient, [f]))
            for v, f in zip(values, functionals, strict=True)
        ]

    @cached_property
    def _step(self) -> dict[str, Found]:
        if self.system.step is None:
            raise ModelError("step metrics need a step command; add one to the system")
        found = step_metrics(self.model, self.poles, self.system.step)
        return {name: Found(value, partial(self._loop_gradient, [f])) for name, (value, f) in found.items()}

    @cached_property
    def _peaks(self) -> dict[str, float]:
        retargeting = self.system.retargeting
        assert retargeting is not None
        return peaks(self.model, self.poles, retargeting)

    def _weights_gradient(self, stiffness: Array, mass: Array) -> Array:
        """From derivatives for the row weights of K and M to one over `Design.parameters`."""
        by_members = self.system.structure.weight_gradients @ np.concatenate([stiffness, mass])
        return np.concatenate([by_members, np.zeros(layout_of(self.design.loop).size)])

    def _modal_gradient(self, functional: ModalFunctional) -> Array:
        by_rows = self.frame.contract(functional.stiffness, functional.mass, functional.motion)
        gradient = self._weights_gradient(*by_rows)
        first = self.design.loop_start
        gradient[first] = functional.mirror_inertia
        gradient[first + 1] = functional.mirror_frequency
        return gradient

    def _loop_gradient(self, functionals: Sequence[Functional]) -> Array:
        """Gradient of Σ Re Σ w dR(s): through the receptances to the structure, and directly to the loop."""
        shared: dict[int, tuple[Points, dict[str, ComplexArray]]] = {}
        for f in functionals:
            _, weights = shared.setdefault(id(f.points), (f.points, {}))
            weights[f.response] = weights[f.response] + f.weight if f.response in weights else f.weight
        by_loop: Array = np.zeros(layout_of(self.design.loop).size)
        # Points that models of several axes share are places of the structure that are looked at once.
        places: dict[int, tuple[Points, dict[tuple[str, str], ComplexArray]]] = {}
        for at, weights in shared.values():
            differential = loop_differential(weights, at.model.loop, at.s, at.bare)
            by_loop += self._in_order(at.model, differential.parameters)
            _, coefficients = places.setdefault(id(at.modal), (at, {}))
            for pair, row in zip(at.model.port_names, differential.receptances, strict=True):
                pair = pair if pair[::-1] not in coefficients else pair[::-1]
                coefficients[pair] = coefficients[pair] + row if pair in coefficients else row
        pairs = dict.fromkeys(pair for _, of in places.values() for pair, row in of.items() if row.any())
        stiffness, mass = receptance_functional(
            self.frame,
            self.all_modes,
            self.system.damping,
            self.kept,
            np.concatenate([at.s for at, _ in places.values()]),
            np.concatenate([at.modal for at, _ in places.values()]),
            {
                pair: np.concatenate([of.get(pair, np.zeros(at.s.size)) for at, of in places.values()])
                for pair in pairs
            },
        )
        gradient = self._weights_gradient(stiffness, mass)
        gradient[self.design.loop_start :] = by_loop
        return gradient

    def _in_order(self, model: LoopModel, parameters: Array) -> Array:
        """Derivatives for the parameters of a model's loop in the order of `Design.parameters`."""
        return parameters
