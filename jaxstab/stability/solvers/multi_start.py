"""Multi-start with successive halving: of many starts the lowest few go on to convergence."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from jaxstab.core.control_flow import entry_of, on_platform, with_entry
from jaxstab.core.loop import NO_LIMIT, Iteration, IterativeSolver
from jaxstab.stability.solvers.base import Eigenproblem

# The steps of the first round. Each further one has twice as many, but the last has no limit.
_FIRST_LENGTH = 4
_NUM_ROUNDS = 6
# The starts that go on from each round but the first, and one at last.
_FEW = 3
_LENGTHS = *(_FIRST_LENGTH << number for number in range(_NUM_ROUNDS - 1)), NO_LIMIT
_NUM_KEPT = NO_LIMIT, *[_FEW] * (_NUM_ROUNDS - 2), 1
# The round from which on no more than a few starts are left.
_FEW_FROM = _NUM_KEPT.index(_FEW) + 1
# The inner product from which two unit vectors are taken to lead to the same minimiser.
_SAME = 0.95


def multi_start(
    solver: IterativeSolver,
    problem: Eigenproblem,
    starts: Iteration,
    is_needed: Bool[Array, " starts"],
) -> tuple[Iteration, Bool[Array, " starts"]]:
    """Return the iterations at their ends, and which is the lowest; none is if all failed.

    After each round a start is discarded if it is nearly the same vector as a lower one, or above
    the lowest by more than its residual, or not among the first few. States of the solver have a
    `point` with a `mode` and an `eigenvalue`; `starts` are iterations before their first step.
    """
    if len(is_needed) == 1:
        # There is nothing to compete with.
        only = jax.tree.map(lambda leaf: leaf[0], starts)
        found = solver.resume(problem, only, jnp.where(is_needed[0], NO_LIMIT, 0))
        found = jax.tree.map(lambda leaf: leaf[None], found)
        return found, ~_is_out(found, is_needed)
    rounds = partial(_rounds, solver, problem)

    def narrow(*starts: PyTree) -> tuple[Iteration, Array]:
        # Together all starts cost as much as those that are on: the few that go on move closer.
        found = rounds(slice(_FEW_FROM), *starts)
        ahead = jnp.argsort(~found[1])[:_FEW]
        few = rounds(slice(_FEW_FROM, None), *jax.tree.map(lambda leaf: leaf[ahead], found))
        return jax.tree.map(lambda leaf, end: leaf.at[ahead].set(end), found, few)

    return on_platform(partial(rounds, slice(None)), narrow, starts, is_needed)


def _rounds(
    solver: IterativeSolver,
    problem: Eigenproblem,
    part: slice,
    starts: Iteration,
    is_on: Bool[Array, " starts"],
) -> tuple[Iteration, Bool[Array, " starts"]]:
    """Return the iterations after some of the rounds, and which of them go on."""
    lengths = jnp.array(_LENGTHS[part])
    num_kept = jnp.array(_NUM_KEPT[part])

    def goes_on(state: tuple[Array, Iteration, Array]) -> Array:
        number, _, is_on = state
        return jnp.any(is_on) & (number < len(lengths))

    def round_after(state: tuple[Array, Iteration, Array]) -> tuple:
        number, found, is_on = state
        limits = jnp.where(is_on, entry_of(lengths, number), 0)
        found = _advance(solver, problem, found, limits)
        wins = _ranks(problem, found, is_on) < entry_of(num_kept, number)
        return number + 1, found, wins

    return jax.lax.while_loop(goes_on, round_after, (jnp.array(0), starts, is_on))[1:]


def _advance(
    solver: IterativeSolver, problem: Eigenproblem, found: Iteration, limits: Int[Array, " starts"]
) -> Iteration:
    """Return iterations after at most so many steps more, one after another on a CPU."""
    resume = partial(solver.resume, problem)

    def advance_next(state: tuple[Iteration, Array]) -> tuple[Iteration, Array]:
        found, left = state
        i = jnp.argmax(left)
        entry = resume(entry_of(found, i), entry_of(left, i))
        return with_entry(state, i, (entry, jnp.zeros((), left.dtype)))

    def one_by_one(found: Iteration, limits: Int[Array, " starts"]) -> Iteration:
        # A start without steps is not even copied.
        begin = found, limits
        return jax.lax.while_loop(lambda state: jnp.any(state[1] > 0), advance_next, begin)[0]

    return on_platform(one_by_one, jax.vmap(resume), found, limits)


def _ranks(
    problem: Eigenproblem, found: Iteration, is_on: Bool[Array, " starts"]
) -> Int[Array, " starts"]:
    """Return the rank of each start, from 0 for the lowest."""
    modes = found.state.point.mode
    axes = tuple(range(1, modes.ndim))
    is_out = _is_out(found, is_on)
    lowest = jnp.where(is_out, jnp.inf, found.state.point.eigenvalue)
    precedes = is_before(lowest)
    is_alike = jnp.tensordot(modes, modes, (axes, axes)) > _SAME
    is_copy = jnp.any(precedes & is_alike, axis=0)
    is_higher = lowest - problem.operator.scale * found.residual > jnp.min(lowest)
    is_kept = ~(is_out | is_copy | is_higher)
    rank = jnp.sum(precedes & is_kept[:, None], axis=0)
    return jnp.where(is_kept, rank, NO_LIMIT)


def _is_out(found: Iteration, is_on: Bool[Array, " starts"]) -> Bool[Array, " starts"]:
    """Return which starts are not on, or failed; zero may be the nearest vector of the cone."""
    modes = found.state.point.mode
    is_zero = jnp.all(modes == 0, axis=tuple(range(1, modes.ndim)))
    return ~is_on | jnp.isnan(found.residual) | is_zero


def is_before(values: Float[Array, " starts"]) -> Bool[Array, "starts starts"]:
    """Return whether the value of a row is before the one of a column, ties in their order."""
    places = jnp.arange(len(values))
    others = values[:, None]
    return (others < values) | ((others == values) & (places[:, None] < places))
