"""The two linear spaces, searched side by side, as a stage of a case."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Int

from jaxstab.iterate import Loop
from jaxstab.pause import Pause
from jaxstab.stability.cones import Subspace
from jaxstab.stability.lowest import Lowest, again, on_space
from jaxstab.stability.modes import BLOCK_SIZE
from jaxstab.stability.search import Search
from jaxstab.stability.stages.ready import chosen, ready_in, space_solver
from jaxstab.stage import Record, Stage


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
        search = ready_in(record).search
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
            self._lowest(ready_in(record).search, state.is_moving)
        return replace(state, loop=pause.loop)

    def is_over(self, record: Record, state: _OnSpace) -> Bool[Array, ""]:
        """Return whether a search has ended, or is not needed."""
        return ~state.is_needed | space_solver(state.loop.residual.dtype).is_over(state.loop)

    def num_steps(self, state: _OnSpace) -> Int[Array, ""]:
        """Return the number of steps taken."""
        return state.loop.num_steps

    def found(self, record: Record) -> tuple[Lowest, Lowest]:
        """Return the lowest pairs of the two."""
        search, states = ready_in(record).search, record[3]

        def lowest(state: _OnSpace) -> Lowest:
            with Pause(state.loop):
                return self._lowest(search, state.is_moving)

        both = jax.vmap(lowest)(states)
        around, hull = (jax.tree.map(lambda leaf, i=i: leaf[i], both) for i in range(2))
        return around, chosen(search.touches, hull, again(around))

    def _lowest(self, search: Search, is_moving: Bool[Array, " *grid"]) -> Lowest:
        space = Subspace(is_moving, search.cone.fixes_mean)
        start = search.random[:BLOCK_SIZE]
        return on_space(space_solver(start.dtype), search.hessian, space, start)
