"""Lower bounds for a structure that may turn as a rigid body.

Its elastic frequencies are at least ω where, for some hyperplane yᵀ u = 0, S(x) is positive semidefinite on it: the
second eigenvalue is the largest least one [Courant1953]. With y fixed this is convex, and the best y for a structure
is S r/rᵀ S r. Taking turns gives a structure, but no bound: other hyperplanes may do better. The bound looks at
displacements u of that structure and at t = Q/P, which is where its hyperplane cuts the plane of u and r. Structures
with t beyond an interval cost more than the one found, by linear programming duality; inside, the secant is as good
as the interval is short. What is then the worst piece is split where its secants lose most, or, where they lose
little, gets a displacement of its own from the least structure in it; spatial branch and bound [McCormick1976].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isinf, sqrt

import numpy as np

from fosopt.errors import SolverError
from fosopt.ops import Array
from fosopt.relax.arithmetic import Floating
from fosopt.relax.least_sizing import Least, entry_size, least_sizing
from fosopt.relax.multipliers import best_leaf, strongest
from fosopt.relax.proof import Judge, Leaf, Lines, Path, Proof, Split, interval, pairing
from fosopt.relax.sizing import Sizing

# The first step outward from a structure in units of a typical t, and how often it is doubled and then halved.
_FIRST, _DOUBLINGS, _HALVINGS = 1e-4, 60, 30
# Halvings where each takes a conic program.
_FEW_HALVINGS = 4
# A piece is never cut closer than this share of it to an end.
_EDGE = 0.02
# Secants that lose more than this share of what a piece lacks are worth a split.
_WORTH = 0.3
_ROUNDS = 8


@dataclass(frozen=True)
class FreeHubFloor:
    """What branch and bound left.

    Attributes
    ----------
    proof
        Of the bound.
    x
        (p,) the least structure known; None if none is.
    """

    proof: Proof
    x: Array | None


def free_hub_floor(
    sizing: Sizing, found: Least, known: Array | None, tolerance: float, pieces: int
) -> FreeHubFloor:
    """Prove a lower bound on the cost of structures that may turn.

    Parameters
    ----------
    found
        Displacements, and a structure near which to begin.
    known
        (p,) the least structure known to meet the requirements; without one the proof is that there is none.
    tolerance
        Gap to stop at, relative to the cost.
    pieces
        How often to split or to look closer, at most.

    Raises
    ------
    SolverError
        If no end of an interval can be proven, as with parameters that have no upper bound.
    """
    tree = _Tree(sizing, found, known)
    path: Path = ()
    tree.add(path)
    for u in tree.own(found).T:
        path = tree.enclose(path, u, found.outer if known is None else known)
    for _ in range(pieces - 1):
        worst = min(tree.values, key=lambda p: tree.values[p])
        structure = tree.structures[worst]
        lacking = tree.cost - tree.values[worst]
        if lacking <= (0.0 if isinf(tree.cost) else tolerance * abs(tree.cost)) or structure is None:
            break
        cut, loss = tree.loss(worst, structure)
        if loss < _WORTH * lacking:
            # The displacements fit the structure known best; those of the other half are still to be found.
            middle = tree.between(worst, structure)
            if middle is None and worst not in tree.close:
                if tree.look_closer(worst, structure):
                    continue
                break
            cut = middle or cut
        if cut is None:
            break
        for part in tree.split(worst, *cut):
            tree.add(part)
    return FreeHubFloor(tree.proof(), tree.x)


class _Tree:
    """The tree as it grows: pieces by their sides, with what each proves and its least structure."""

    def __init__(self, sizing: Sizing, found: Least, known: Array | None) -> None:
        assert sizing.turning is not None
        self.sizing, self.x, self.turning = sizing, known, sizing.turning
        self.cost = inf if known is None else sizing.value(known)
        self.bases = [
            strongest(v, entry_size(r)) for r, v in zip(sizing.requirements, found.vectors, strict=True)
        ]
        self.bases[self.turning] = np.zeros((self.bases[self.turning].shape[0], 0))
        self.directions = np.zeros((sizing.requirements[self.turning].size, 0))
        self.judge = Judge(sizing, self.directions)
        self.leaves: dict[Path, Leaf] = {}
        self.values: dict[Path, float] = {}
        self.structures: dict[Path, Array | None] = {}
        self.splits: dict[Path, tuple[int, float]] = {}
        self.close: set[Path] = set()

    def own(self, found: Least) -> Array:
        """(n, d) Displacements that the requirement on the frequency leaves."""
        requirement = self.sizing.requirements[self.turning]
        return strongest(found.vectors[self.turning], entry_size(requirement))[:-1]

    def add(self, path: Path, leaf: Leaf | None = None) -> None:
        """A piece with its best multipliers, or with those given."""
        structure = None
        if leaf is None:
            best = best_leaf(self.sizing, self.bases, self.judge.lines, path, where=True)
            leaf, structure = best.leaf, best.x
        self.leaves[path], self.structures[path] = leaf, structure
        self.values[path] = self.judge.value(path, leaf)[0]

    def split(self, path: Path, direction: int, at: float) -> tuple[Path, Path]:
        """Cut a piece in two; both are still to be added."""
        self.values.pop(path, None)
        self.splits[path] = (direction, at)
        return (*path, (direction, at, False)), (*path, (direction, at, True))

    def proof(self) -> Proof:
        """The tree as it stands."""

        def node(path: Path) -> Leaf | Split:
            if path not in self.splits:
                return self.leaves[path]
            k, at = self.splits[path]
            return Split(k, at, node((*path, (k, at, False))), node((*path, (k, at, True))))

        return Proof(node(()), self.directions)

    def enclose(self, path: Path, u: Array, x: Array) -> Path:
        """Split a piece by a new displacement: two ends that cost enough, and what is between them."""
        k = self.directions.shape[1]
        self.directions = np.column_stack([self.directions, u])
        self.judge = Judge(self.sizing, self.directions)
        inside = path
        for above in (True, False):
            at, leaf = self._end(path, k, x, above)
            below_path, above_path = self.split(inside, k, at)
            inside, outside = (below_path, above_path) if above else (above_path, below_path)
            # The end was proven without the other end's side.
            unused = np.zeros(len(outside) - leaf.sides.size)
            self.add(outside, replace(leaf, sides=np.concatenate([leaf.sides[:-1], unused, leaf.sides[-1:]])))
        self.add(inside)
        return inside

    def _end(self, path: Path, k: int, x: Array, above: bool) -> tuple[float, Leaf]:
        """The nearest t found beyond which a piece costs enough, with the multipliers that say so."""
        requirement = self.sizing.requirements[self.turning]
        assert requirement.inertial is not None
        line, u = self.judge.lines[k], self.directions[:, [k]]
        mass = pairing(requirement.inertial, u, u, Floating())
        unit = requirement.rate * sqrt(float(mass[0] + mass[1] @ x) / float(line.p[0] + line.p[1] @ x))
        here, sign = _at(line, x), 1.0 if above else -1.0
        # The whole box has this one inequality, and its multiplier a closed form.
        bases = self.bases if path else [basis[:, :0] for basis in self.bases]

        def beyond(distance: float) -> tuple[float, Leaf, float]:
            side = (k, here + sign * distance, above)
            leaf = best_leaf(self.sizing, bases, self.judge.lines, (*path, side)).leaf
            return side[1], leaf, self.judge.value((*path, side), leaf)[0]

        far = near = 0.0
        found = beyond(far)
        for doubling in range(_DOUBLINGS):
            if found[2] >= self.cost:
                break
            near, far = far, _FIRST * unit * 2.0**doubling
            found = beyond(far)
        else:
            raise SolverError(
                f"{requirement.name}: an interval of hyperplanes has no end; give every parameter an upper bound"
            )
        for _ in range((_FEW_HALVINGS if path else _HALVINGS) if far > 0 else 0):
            trial = beyond((near + far) / 2)
            if trial[2] >= self.cost:
                far, found = (near + far) / 2, trial
            else:
                near = (near + far) / 2
        return found[0], found[1]

    def loss(self, path: Path, x: Array) -> tuple[tuple[int, float] | None, float]:
        """The direction whose secant loses most at a structure and where that stands, and what all secants lose."""
        most, total, cut = 0.0, 0.0, None
        for k, weight in enumerate(self.leaves[path].secants):
            if not weight:
                continue
            low, high = interval(path, k)
            line = self.judge.lines[k]
            edge = _EDGE * (high - low)
            t = min(max(_at(line, x), low + edge), high - edge)
            loss = float(weight) * float(line.p[0] + line.p[1] @ x) * (t - low) * (high - t)
            total += loss
            if loss > most:
                most, cut = loss, (k, t)
        return cut, total

    def between(self, path: Path, x: Array) -> tuple[int, float] | None:
        """The middle between the structure known best and a piece's own, by the direction that tells them best apart.

        None where the structure known best lies elsewhere.
        """
        best = self.x
        if best is None or any((_at(self.judge.lines[k], best) > at) != above for k, at, above in path):
            return None
        most, cut = 0.0, None
        for k, weight in enumerate(self.leaves[path].secants):
            here, there = _at(self.judge.lines[k], best), _at(self.judge.lines[k], x)
            low, high = interval(path, k)
            apart = float(weight) * (there - here) ** 2
            if apart > most and low < (here + there) / 2 < high:
                most, cut = apart, (k, (here + there) / 2)
        return cut

    def look_closer(self, path: Path, x: Array) -> bool:
        """Prove a piece by the displacements of its own least structure; whether there were any.

        That structure may be the least of all.
        """
        cuts = [self.judge.lines[k].side(at, above, Floating()) for k, at, above in path]
        sizing = replace(
            self.sizing,
            normals=np.vstack([self.sizing.normals, *(-gradient for _, gradient in cuts)]),
            limits=np.concatenate([self.sizing.limits, [float(constant) for constant, _ in cuts]]),
        )
        found = least_sizing(sizing, x, rounds=_ROUNDS)
        if found.x is not None and self.sizing.margin(found.x) >= 0 and sizing.value(found.x) < self.cost:
            self.x, self.cost = found.x, sizing.value(found.x)
        # What other requirements are pressed by in this piece is a displacement of its own too.
        gained = False
        for i, vectors in enumerate(found.vectors):
            if i != self.turning and vectors.shape[1]:
                both = np.hstack([self.bases[i], vectors])
                self.bases[i] = strongest(both, entry_size(self.sizing.requirements[i]))
                gained = True
        own = self.own(found)
        if own.shape[1]:
            self.close.add(self.enclose(path, own[:, 0], found.outer))
        elif gained:
            self.close.add(path)
            self.add(path)
        return gained or bool(own.shape[1])


def _at(line: Lines, x: Array) -> float:
    """Where a structure stands, t = Q/P."""
    return float((line.q[0] + line.q[1] @ x) / (line.p[0] + line.p[1] @ x))
