"""Both cones, searched side by side from all starts, as a stage of a case."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.core.types import Flag
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.lowest_pair import Lowest, after, again, cone_starts, on_cone
from jaxstab.stability.search import Search
from jaxstab.studies.lanes.stage import Record, Stage
from jaxstab.studies.lanes.verdict.coarser import CoarserStage, First
from jaxstab.studies.lanes.verdict.competition import Competitor, decided, entered, turned
from jaxstab.studies.lanes.verdict.ready import chosen, cone_of, cone_solver, paired, ready_in
from jaxstab.studies.lanes.verdict.spaces import SpacesStage


class _OnCone(eqx.Module):
    """A start on a cone.

    Attributes:
        number: that of the cone.
        is_answer: whether the first start is the answer.
        competitor: the start.
    """

    number: Int[Array, ""]
    is_answer: Flag
    competitor: Competitor


class ConesStage(Stage):
    """The competitions on V0+ and on the critical cone.

    Arguments:
        spaces, coarser: the stages before.
    """

    has_rounds = True
    # The first rounds, which have most starts, are multiples of it.
    pace = 4

    def __init__(self, spaces: SpacesStage, coarser: CoarserStage):
        self._spaces, self._coarser = spaces, coarser

    def begin(self, record: Record) -> _OnCone:
        """Return all starts on both cones before their first step."""
        search = ready_in(record).search
        hulls, first = self._spaces.found(record), self._coarser.found(record)
        is_needed = jnp.stack([search.touches, search.touches & search.is_weak])
        is_needed &= ~first.is_trusted

        def entries(number: int) -> _OnCone:
            cone = cone_of(search, jnp.array(number))
            before = jax.tree.map(lambda leaf: leaf[number], first.lowest)
            starts, needed, is_answer = cone_starts(
                cone_solver(), cone, hulls[number], search.random, before
            )
            all_ = entered(cone_solver(), cone, starts, needed & is_needed[number])
            shared = jnp.full(len(starts), number), jnp.full(len(starts), is_answer)
            return _OnCone(*shared, all_)

        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), entries(0), entries(1))

    def advance(self, record: Record, state: _OnCone, max_steps: ArrayLike) -> _OnCone:
        """Return a start after at most so many steps more of its round."""
        problem = _problem(ready_in(record).search, state.number)
        competitor = state.competitor.advanced(cone_solver(), *problem, max_steps)
        return replace(state, competitor=competitor)

    def is_over(self, record: Record, state: _OnCone) -> Flag:
        """Return whether the round is over for a start."""
        return state.competitor.is_over(cone_solver())

    def num_steps(self, state: _OnCone) -> Int[Array, ""]:
        """Return the number of steps taken in this round."""
        return state.competitor.loop.num_steps

    def turn(self, record: Record, states: _OnCone) -> _OnCone:
        """Return all starts in their next rounds."""
        search = ready_in(record).search

        def turn(number: Array, all_: Competitor) -> Competitor:
            return turned(cone_solver(), *_problem(search, number), all_)

        all_ = jax.vmap(turn)(jnp.arange(2), _by_cones(states).competitor)
        return replace(states, competitor=jax.tree.map(jnp.concatenate, all_))

    def found(self, record: Record) -> tuple[Lowest, Lowest]:
        """Return the lowest pairs on V0+ and on the critical cone."""
        search, (around, hull) = ready_in(record).search, self._spaces.found(record)

        def lowest(number: Array, hull: Lowest, first: First, states: _OnCone) -> Lowest:
            hessian, cone = _problem(search, number)
            found = decided(cone_solver(), hessian, cone, states.competitor)
            found = on_cone(search.hessian, cone, hull, found, states.is_answer[0])
            if first.lowest is None:
                return found
            return chosen(first.is_trusted, first.lowest, after(first.lowest, found))

        hulls, firsts = paired(around, hull), self._coarser.found(record)
        both = jax.vmap(lowest)(jnp.arange(2), hulls, firsts, _by_cones(record[5]))
        cone, critical = (jax.tree.map(lambda leaf, i=i: leaf[i], both) for i in range(2))
        critical = chosen(search.touches & search.is_weak, after(hull, critical), hull)
        return chosen(search.touches, cone, again(around)), critical


def _problem(search: Search, number: Array) -> tuple[Any, AdmissibleCone]:
    cone = cone_of(search, number)
    return search.hessian.restricted(cone.is_moving), cone


def _by_cones(states: _OnCone) -> _OnCone:
    return jax.tree.map(lambda leaf: leaf.reshape(2, -1, *leaf.shape[1:]), states)
