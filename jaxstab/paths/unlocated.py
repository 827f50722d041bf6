"""What the steps of a path may have lost between its jumps: work by quadrature less the energy."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.core.types import Scalar

Values = Float[Array, " states"]


def unlocated_loss(
    load: Values, potential: Values, force: Values, is_branch: Bool[Array, " steps"]
) -> tuple[Scalar, Scalar]:
    """Return what steps along branches have lost, and the error of the quadrature of their work.

    On each step F is the mean of the two parabolas through its ends and the state before, or the
    one after. Half of the difference of their integrals is the error; where there is only one of
    them, all that it takes from the trapezoid.

    Arguments:
        load: the values of the load.
        potential: E + W [energy].
        force: F, how the potential follows the load on a branch [energy over that of the load].
        is_branch: whether each step from a state to the next is one along a branch.
    """
    step = jnp.diff(load)
    slope = jnp.diff(force) / jnp.where(step == 0, 1, step)
    pair = step[1:] + step[:-1]
    # Through three states, where these lie on one branch and in the order of their loads.
    is_known = is_branch[1:] & is_branch[:-1] & (step[1:] * step[:-1] > 0)
    turn = jnp.where(is_known, jnp.diff(slope) / jnp.where(pair == 0, 1, pair), 0)
    before, after = jnp.pad(turn, (1, 0)), jnp.pad(turn, (0, 1))
    number = jnp.pad(is_known, (1, 0)).astype(int) + jnp.pad(is_known, (0, 1))
    cubes = step**3 / 6
    work = step * (force[1:] + force[:-1]) / 2 - cubes * (before + after) / jnp.maximum(number, 1)
    error = jnp.where(number == 2, (before - after) / 2, before + after)
    error = jnp.where(number == 0, slope * step**2 / 2, cubes * error)
    lost = jnp.sum(jnp.where(is_branch, work - jnp.diff(potential), 0))
    return lost, jnp.sum(jnp.where(is_branch, jnp.abs(error), 0))
