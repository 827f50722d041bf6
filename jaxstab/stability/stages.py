"""A verdict as stages of a case: what `assess_stability` does by default, with pauses.

The two linear spaces are searched side by side, and so are both cones, from all starts.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxstab.contact import Contact
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.stage import EquilibriumStage
from jaxstab.hessian import Block
from jaxstab.iterate import Loop
from jaxstab.pause import Pause
from jaxstab.refill import Record, Stage
from jaxstab.stability.assess import prepared, stability_of
from jaxstab.stability.certificate import SHARES, bound_by, is_sought
from jaxstab.stability.competition import Competitor, decided, entered, turned
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.davidson import Davidson
from jaxstab.stability.lowest import Lowest, after, again, cone_starts, on_cone, on_space
from jaxstab.stability.modes import BLOCK_SIZE
from jaxstab.stability.projected import ProjectedLOBPCG
from jaxstab.stability.search import Search, with_bound
from jaxstab.stability.verdict import Stability


def _cone_solver() -> ProjectedLOBPCG:
    return ProjectedLOBPCG()


def _space_solver(dtype: Any) -> Davidson:
    return Davidson(_cone_solver().tolerance_in(dtype))


class _Ready(eqx.Module):
    """An equilibrium, and what is known before its eigenvalues are."""

    equilibrium: Equilibrium
    search: Search
    known: Any


def _ready(record: Record) -> _Ready:
    return jax.tree.map(lambda leaf: leaf[0], record[2])


class ReadyStage(Stage):
    """What comes before the searches, without a step.

    Arguments:
        equilibria: the stage before.
    """

    def __init__(self, equilibria: EquilibriumStage):
        self.equilibria = equilibria

    def begin(self, record: Record) -> _Ready:
        """Return the search at an equilibrium."""
        contact, found = self.equilibria.found(record)
        search, known = prepared(contact.whole, found, jax.random.key(0), False)
        return jax.tree.map(lambda leaf: leaf[None], _Ready(found, search, known))

    def advance(self, record: Record, state: _Ready, max_steps: ArrayLike) -> _Ready:
        """Return the state as it is."""
        return state

    def is_over(self, record: Record, state: _Ready) -> Bool[Array, ""]:
        """Return that it is."""
        return jnp.array(True)

    def num_steps(self, state: _Ready) -> Int[Array, ""]:
        """Return none."""
        return jnp.array(0)


class _OnSpace(eqx.Module):
    is_moving: Bool[Array, " *grid"]
    is_needed: Bool[Array, ""]
    loop: Loop[Any]


class SpacesStage(Stage):
    """The linear spaces around V0+ and around the critical cone."""

    # A search is a dozen steps long.
    pace = 2

    def begin(self, record: Record) -> _OnSpace:
        """Return both searches before their first step."""
        search = _ready(record).search
        hulls = search.cone.hull.is_moving, search.critical_cone.hull.is_moving

        def begun(is_moving: Array, is_needed: Array) -> _OnSpace:
            with Pause() as pause:
                self._lowest(search, is_moving)
            return _OnSpace(is_moving, is_needed, pause.loop)

        is_needed = jnp.stack([jnp.array(True), search.touches])
        return jax.vmap(begun)(jnp.stack(hulls), is_needed)

    def advance(self, record: Record, state: _OnSpace, max_steps: ArrayLike) -> _OnSpace:
        """Return a search after at most so many steps more."""
        with Pause(state.loop, max_steps) as pause:
            self._lowest(_ready(record).search, state.is_moving)
        return replace(state, loop=pause.loop)

    def is_over(self, record: Record, state: _OnSpace) -> Bool[Array, ""]:
        """Return whether a search has ended, or is not needed."""
        return ~state.is_needed | _space_solver(state.loop.residual.dtype).is_over(state.loop)

    def num_steps(self, state: _OnSpace) -> Int[Array, ""]:
        """Return the number of steps taken."""
        return state.loop.num_steps

    def found(self, record: Record) -> tuple[Lowest, Lowest]:
        """Return the lowest pairs of the two."""
        search, states = _ready(record).search, record[3]

        def lowest(state: _OnSpace) -> Lowest:
            with Pause(state.loop):
                return self._lowest(search, state.is_moving)

        both = jax.vmap(lowest)(states)
        around, hull = (jax.tree.map(lambda leaf, i=i: leaf[i], both) for i in range(2))
        return around, _where(search.touches, hull, again(around))

    def _lowest(self, search: Search, is_moving: Bool[Array, " *grid"]) -> Lowest:
        space = Subspace(is_moving, search.cone.fixes_mean)
        start = search.random[:BLOCK_SIZE]
        return on_space(_space_solver(start.dtype), search.hessian, space, start)


class _OnCone(eqx.Module):
    """A start on a cone.

    Attributes:
        number: that of the cone.
        is_answer: whether the first start is the answer.
        competitor: the start.
    """

    number: Int[Array, ""]
    is_answer: Bool[Array, ""]
    competitor: Competitor


class ConesStage(Stage):
    """The competitions on V0+ and on the critical cone.

    Arguments:
        spaces: the stage before.
    """

    has_rounds = True
    # The first rounds, which have most starts, are multiples of it.
    pace = 4

    def __init__(self, spaces: SpacesStage):
        self._spaces = spaces

    def begin(self, record: Record) -> _OnCone:
        """Return all starts on both cones before their first step."""
        search = _ready(record).search
        hulls = self._spaces.found(record)
        is_needed = search.touches, search.touches & search.is_weak

        def entries(number: int) -> _OnCone:
            cone = _cone(search, jnp.array(number))
            starts, needed, is_answer = cone_starts(
                _cone_solver(), cone, hulls[number], search.random
            )
            all_ = entered(_cone_solver(), cone, starts, needed & is_needed[number])
            shared = jnp.full(len(starts), number), jnp.full(len(starts), is_answer)
            return _OnCone(*shared, all_)

        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), entries(0), entries(1))

    def advance(self, record: Record, state: _OnCone, max_steps: ArrayLike) -> _OnCone:
        """Return a start after at most so many steps more of its round."""
        problem = _problem(_ready(record).search, state.number)
        competitor = state.competitor.advanced(_cone_solver(), *problem, max_steps)
        return replace(state, competitor=competitor)

    def is_over(self, record: Record, state: _OnCone) -> Bool[Array, ""]:
        """Return whether the round is over for a start."""
        return state.competitor.is_over(_cone_solver())

    def num_steps(self, state: _OnCone) -> Int[Array, ""]:
        """Return the number of steps taken in this round."""
        return state.competitor.loop.num_steps

    def turn(self, record: Record, states: _OnCone) -> _OnCone:
        """Return all starts in their next rounds."""
        search = _ready(record).search

        def turn(number: Array, all_: Competitor) -> Competitor:
            return turned(_cone_solver(), *_problem(search, number), all_)

        all_ = jax.vmap(turn)(jnp.arange(2), _by_cones(states).competitor)
        return replace(states, competitor=jax.tree.map(jnp.concatenate, all_))

    def found(self, record: Record) -> tuple[Lowest, Lowest]:
        """Return the lowest pairs on V0+ and on the critical cone."""
        search, (around, hull) = _ready(record).search, self._spaces.found(record)

        def lowest(number: Array, hull: Lowest, states: _OnCone) -> Lowest:
            hessian, cone = _problem(search, number)
            found = decided(_cone_solver(), hessian, cone, states.competitor)
            return on_cone(search.hessian, cone, hull, found, states.is_answer[0])

        hulls = jax.tree.map(lambda *leaves: jnp.stack(leaves), around, hull)
        both = jax.vmap(lowest)(jnp.arange(2), hulls, _by_cones(record[4]))
        cone, critical = (jax.tree.map(lambda leaf, i=i: leaf[i], both) for i in range(2))
        critical = _where(search.touches & search.is_weak, after(hull, critical), hull)
        return _where(search.touches, cone, again(around)), critical


class _Bounding(eqx.Module):
    """A bound that is sought.

    Attributes:
        eigenvalue: the smallest found on the cone.
        modes: those of the space around it.
        number: that of the share.
        is_needed: whether a bound is of use.
        best, cost: what is known so far, and at what cost.
        loop: where the search is; None where the solid knows of no bound.
    """

    eigenvalue: Float[Array, ""]
    modes: Block
    number: Int[Array, ""]
    is_needed: Bool[Array, ""]
    best: Float[Array, ""]
    cost: Int[Array, ""]
    loop: Loop[Any] | None


class BoundStage(Stage):
    """The proof that the eigenvalue on V0+ is positive, where that is open.

    Arguments:
        spaces, cones: the stages before.
    """

    has_rounds = True
    pace = 2

    def __init__(self, spaces: SpacesStage, cones: ConesStage):
        self._spaces, self._cones = spaces, cones

    def begin(self, record: Record) -> _Bounding:
        """Return the search for the first bound."""
        search, (around, _) = _ready(record).search, self._spaces.found(record)
        cone, _ = self._cones.found(record)
        is_open = (cone.sign > 0) & (around.sign <= 0) & ~cone.pair.proved
        eigenvalue, none = cone.pair.eigenvalue, jnp.array(0)
        state = _Bounding(
            eigenvalue,
            around.modes,
            none,
            search.touches & is_open & ~search.is_doubtful,
            jnp.full_like(eigenvalue, -jnp.inf),
            none,
            None,
        )
        return jax.tree.map(lambda leaf: leaf[None], self._begun(search, state))

    def advance(self, record: Record, state: _Bounding, max_steps: ArrayLike) -> _Bounding:
        """Return the search after at most so many steps more."""
        with Pause(state.loop, max_steps) as pause:
            self._bound(_ready(record).search, state)
        return replace(state, loop=pause.loop)

    def is_over(self, record: Record, state: _Bounding) -> Bool[Array, ""]:
        """Return whether the search has ended, or is not needed."""
        if state.loop is None:
            return jnp.array(True)
        return ~state.is_needed | _space_solver(state.best.dtype).is_over(state.loop)

    def num_steps(self, state: _Bounding) -> Int[Array, ""]:
        """Return the number of steps taken."""
        return jnp.array(0) if state.loop is None else state.loop.num_steps

    def turn(self, record: Record, states: _Bounding) -> _Bounding:
        """Return the search for the next bound, where one is needed."""
        search, state = _ready(record).search, jax.tree.map(lambda leaf: leaf[0], states)
        with Pause(state.loop):
            bound, cost = self._bound(search, state)
        best = jnp.where(state.is_needed, jnp.maximum(state.best, bound), state.best)
        turned = replace(
            state,
            number=state.number + 1,
            best=best,
            cost=state.cost + jnp.where(state.is_needed, cost, 0),
            is_needed=state.is_needed & is_sought(state.number + 1, best),
        )
        return jax.tree.map(lambda leaf: leaf[None], self._begun(search, turned))

    def _begun(self, search: Search, state: _Bounding) -> _Bounding:
        with Pause() as pause:
            self._bound(search, state)
        return replace(state, loop=pause.loop)

    def _bound(self, search: Search, state: _Bounding) -> tuple[Array, Array]:
        solver = _space_solver(state.best.dtype)
        number = jnp.minimum(state.number, len(SHARES) - 1)
        return bound_by(solver, search.hessian, search.cone, state.eigenvalue, state.modes, number)


class VerdictStages:
    """The stages of a verdict, after that of the equilibrium.

    Arguments:
        equilibria: the stage of the equilibrium.
    """

    def __init__(self, equilibria: EquilibriumStage):
        self._equilibria = equilibria
        self._spaces = SpacesStage()
        self._cones = ConesStage(self._spaces)
        self.all = [
            equilibria,
            ReadyStage(equilibria),
            self._spaces,
            self._cones,
            BoundStage(self._spaces, self._cones),
        ]

    def found(self, record: Record) -> tuple[Contact, Equilibrium, Stability]:
        """Return the contact of a case, its equilibrium and its stability."""
        contact, _ = self._equilibria.build(**record[0])
        ready, state = _ready(record), jax.tree.map(lambda leaf: leaf[0], record[5])
        around, hull = self._spaces.found(record)
        cone, critical = self._cones.found(record)
        # There is a cost where one was needed.
        cone = _where(state.cost > 0, with_bound(cone, state.best, state.cost), cone)
        no = jnp.array(False)
        found = ready.search.concluded(around, cone, critical, hull, no, no)
        stability = stability_of(ready.equilibrium, ready.known, found)
        surface = contact.whole.solid
        return contact, ready.equilibrium.on_surface(surface), stability.on_surface(surface)


def _cone(search: Search, number: Array) -> AdmissibleCone:
    """Return V0+ or the critical cone, by its number."""
    one, other = search.cone, search.critical_cone
    return jax.tree.map(lambda x, y: jnp.where(number == 0, x, y), one, other)


def _problem(search: Search, number: Array) -> tuple[Any, AdmissibleCone]:
    cone = _cone(search, number)
    return search.hessian.restricted(cone.is_moving), cone


def _by_cones(states: _OnCone) -> _OnCone:
    return jax.tree.map(lambda leaf: leaf.reshape(2, -1, *leaf.shape[1:]), states)


def _where(condition: Bool[Array, ""], one: Lowest, other: Lowest) -> Lowest:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), one, other)
