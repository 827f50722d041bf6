"""What the coarser grid leads to on both cones, as a stage of a case: of large grids alone."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.core.types import Flag
from jaxstab.stability.coarse_start import is_large
from jaxstab.stability.lowest_pair import Lowest
from jaxstab.stability.search import on_cone_by_coarser
from jaxstab.studies.lanes.stage import Record, Stage
from jaxstab.studies.lanes.verdict.ready import cone_of, cone_solver, paired, ready_in
from jaxstab.studies.lanes.verdict.spaces import SpacesStage


class First(eqx.Module):
    """What the mode of the coarser problem leads to on a cone.

    Attributes:
        lowest: the pair; None where the grid is not large.
        is_trusted: whether no other start need be looked at.
    """

    lowest: Lowest | None
    is_trusted: Flag


class CoarserStage(Stage):
    """The first searches of V0+ and of the critical cone, which do not pause.

    Arguments:
        spaces: the stage before.
    """

    def __init__(self, spaces: SpacesStage):
        self._spaces = spaces

    def begin(self, record: Record) -> First:
        """Return what was found on both cones."""
        search = ready_in(record).search
        if not is_large(search.hessian):
            return First(None, jnp.zeros(2, bool))

        def first(number: Array, hull: Lowest) -> First:
            problem = search.hessian, cone_of(search, number), hull, search.random
            return First(*on_cone_by_coarser(cone_solver(), *problem))

        return jax.vmap(first)(jnp.arange(2), paired(*self._spaces.found(record)))

    def advance(self, record: Record, state: First, max_steps: ArrayLike) -> First:
        """Return the state as it is."""
        return state

    def is_over(self, record: Record, state: First) -> Flag:
        """Return that it is."""
        return jnp.array(True)

    def num_steps(self, state: First) -> Int[Array, ""]:
        """Return none, as they are not those of a lane."""
        return jnp.array(0)

    def found(self, record: Record) -> First:
        """Return what was found on both cones, along a leading axis."""
        return record[4]
