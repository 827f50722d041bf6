"""Preconditioned projected conjugate gradients whose energy never rises."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxstab.contact.contact import Contact
from jaxstab.contact.residual import Balance
from jaxstab.core import model
from jaxstab.core.accuracy import EQUILIBRIUM
from jaxstab.core.checks import as_array, concrete, parameter, require
from jaxstab.core.control_flow import either, on_platform
from jaxstab.core.grid import total, totals
from jaxstab.core.history import Indicators
from jaxstab.core.loop import optional_parameter
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium.solvers.base import EquilibriumSolver, Problem
from jaxstab.loads.load import Control
from jaxstab.solids.solid import Solid

# A `max_move` for the way to another branch: with longer moves it came to other minima than an
# overdamped relaxation.
MAX_MOVE_IN_JUMP = 0.03
# Cuts of a step to a third before it is given up.
_MAX_CUTS = 40
# The least part of the fall of energy that the slope promises.
_ARMIJO = 1e-4
# A point moves by its own stiffness from this curvature on, over the stiffest wave.
_STIFF = 0.1


class _LineSearch(eqx.Module):
    """A direction of descent, how far to go along it, and the force that it was made for."""

    direction: Field
    force: Field
    force_norm: Scalar
    is_convex: Flag
    length: Scalar
    num_cuts: Int[Array, ""]


class _DescentState(eqx.Module):
    gap: Field
    balance: Balance
    search: _LineSearch
    reach: Scalar


class _DescentTrial(eqx.Module):
    gap: Field
    balance: Balance
    is_last: Flag
    length: Scalar
    num_cuts: Int[Array, ""]


class PreconditionedConjugateGradient(EquilibriumSolver):
    """Projected conjugate gradients on the gap, preconditioned in Fourier space.

    A step moves the points out of contact, and those in contact that are pulled off it. Its
    direction follows Polak and Ribiere, never less than zero, with the preconditioner 1 / (K + c)
    masked to those points (`preconditioner_of`, once for each start). Its length minimises the
    energy along the direction to second order. It is cut until the energy falls, with the gap cut
    at zero and brought back under the load. Where the curvature is negative, lengths grow for as
    long as they succeed.

    Arguments:
        tolerance: relative optimality residual to reach; by default 1e-9 in float64 and 1e-4 in
            float32.
        max_steps: the step limit, 20 000 by default.
        max_move: how far a step may move a point, over its gap and the range of the law. With 0.1,
            as on paths under tension, no step was seen to leap over a minimum. By default as far as
            the energy falls.
        least_energy: stop, and report no result, once energy and potential of the load fall below
            this value. It is summed over the points [pressure length, in the contact's
            characteristic pressure]. By default never.

    Raises:
        ValueError: if `max_move` is not positive.

    Example:
        >>> solver = js.solvers.PreconditionedConjugateGradient(1e-10)
        >>> found = js.equilibrate(contact, js.MeanGap(0.05), solver)
        >>> bool(found.residual < 1e-10)
        True
    """

    tolerance: Scalar | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=as_array, default=20_000)
    max_move: Scalar = eqx.field(converter=parameter, default=np.inf)
    least_energy: Scalar = eqx.field(converter=parameter, default=-np.inf)

    default_tolerance: ClassVar[Mapping[str, float]] = EQUILIBRIUM

    def __check_init__(self) -> None:
        require("max_move", self.max_move, concrete(self.max_move) > 0, "it must be positive.")

    def prepared(self, problem: Problem, start: Field) -> "_Prepared":
        """Return the problem with its preconditioner, made for a start."""
        contact = problem.contact
        control = problem.control
        stiffness = 0
        if control.stiffness is not None:
            stiffness = control.stiffness
        solid = contact.solid.with_uniform_stiffness(stiffness)
        return _Prepared(
            contact,
            control,
            problem.balance,
            solid,
            preconditioner_of(contact, solid, start),
            _shortening(contact, self.max_move),
        )

    def init(self, problem: "_Prepared", start: Field) -> _DescentState:
        """Return the state of a gap that meets the load."""
        one = jnp.ones((), start.dtype)
        nothing = jnp.zeros_like(start)
        no = jnp.array(False)
        search = _LineSearch(nothing, nothing, one, no, one, jnp.array(0))
        return _DescentState(start, problem.balance(start), search, one)

    def step(self, problem: "_Prepared", state: _DescentState) -> _DescentState:
        """Return the state after a step along a direction of conjugate gradients.

        A step on a CPU tries ever shorter lengths. One on an accelerator tries a single length, so
        that no loop within it waits for the host.
        """
        return on_platform(partial(_search_line, problem), partial(_try_once, problem), state)

    def measure(self, problem: "_Prepared", state: _DescentState) -> Indicators:
        """Return residual and energy; the residual is infinite where nothing is to be found."""
        balance = state.balance
        energy = problem.energy(state.balance)
        has_left = balance.has_escaped | (energy < self.least_energy)
        residual = jnp.where(has_left, jnp.inf, balance.residual)
        return {"residual": residual, "energy": energy}


@dataclass(frozen=True)
class _Prepared(Problem):
    """A problem with the data that all steps share; its solid is held as the load holds it."""

    solid: Solid
    precondition: Callable[[Field, Field], Field]
    shorten_step: Callable[..., Array]

    def energy(self, balance: Balance) -> Scalar:
        """Return the energy of a state and of the load, summed over the points."""
        work = balance.net.size * self.control.energy(balance.mean_gap)
        return balance.potential + work


def _begin_search(problem: _Prepared, state: _DescentState) -> _LineSearch:
    """Return the search along a new direction."""
    control = problem.control
    net = state.balance.net
    before = state.search
    is_moving = control.moving(state.gap, net)
    force = control.project(_force(control, state.gap, net, net), is_moving)
    inverse = partial(problem.precondition, state.balance.curvature)
    steepest = control.precondition(inverse, force, is_moving)
    force_norm, overlap, slope = totals(
        [force * steepest, before.force * steepest, force * before.direction]
    )
    momentum = jnp.maximum(force_norm - overlap, 0) / _nonzero(before.force_norm)
    descent = force_norm + momentum * slope
    momentum = jnp.where(descent > 0, momentum, 0)
    descent = jnp.where(descent > 0, descent, force_norm)
    direction = control.project(steepest + momentum * before.direction, is_moving)

    softening = state.balance.curvature * direction
    curvature = total(direction * (problem.solid.apply(direction) + softening))
    is_convex = curvature > 0
    # To the preconditioner, which knows no negative curvature, the length is 1.
    length = jnp.where(is_convex, descent / _nonzero(curvature), state.reach)
    length = problem.shorten_step(length, state.gap, direction)
    return _LineSearch(direction, force, force_norm, is_convex, length, jnp.array(0))


def _force(control: Control, gap: Field, net: Field, pressure: Field) -> Field:
    """Return the force by a net pressure on the sides of zero that a gap is on, or leaves to."""
    side = control.side(gap, net)
    if side is None:
        return pressure
    return model.on_side(pressure, side, control.largest_reaction)


def _attempt(problem: _Prepared, state: _DescentState, search: _LineSearch) -> _DescentTrial:
    """Return the gap at the length of a search, and whether that is where it ends."""
    control = problem.control
    energy = problem.energy(state.balance)
    net = state.balance.net
    side = control.side(state.gap, net)
    gap = control.admissible(state.gap - search.length * search.direction, side)
    balance = problem.balance(gap)
    change = gap - state.gap
    forces = (_force(control, state.gap, net, each) for each in (net, balance.net))
    before, after, force = totals([*(force * change for force in forces), net])
    # The work of a load that is nearly nothing, as at a spring that has relaxed, is no more certain
    # than the mean gap, nor is the work of the net pressures, as where surfaces just touch.
    mean_gap = state.balance.mean_gap
    works = state.gap.size * mean_gap * jax.grad(control.energy)(mean_gap), mean_gap * force
    terms = state.balance.elastic_energy, state.balance.adhesion, energy, *works
    noise = 100 * jnp.finfo(state.gap.dtype).eps * sum(map(jnp.abs, terms))
    gain = problem.energy(balance) - energy
    promised = _ARMIJO * jnp.minimum(before, 0)
    # Where rounding hides the gain, the slopes at both ends still show it.
    is_hidden = (gain <= noise) & ((before + after) / 2 <= promised)
    is_accepted = (gain <= promised) | is_hidden
    num_cuts = search.num_cuts + ~is_accepted
    # A third of the last length; the last cut leaves the gap where it is.
    shorter = jnp.where(search.num_cuts < _MAX_CUTS - 1, search.length / 3, 0)
    return _DescentTrial(gap, balance, is_accepted | (num_cuts > _MAX_CUTS), shorter, num_cuts)


def _end_search(state: _DescentState, search: _LineSearch, trial: _DescentTrial) -> _DescentState:
    """Return the state at the end of a search."""
    grows = ~search.is_convex & (trial.num_cuts == 0)
    reach = jnp.where(grows, 2 * state.reach, 1)
    return _DescentState(trial.gap, trial.balance, replace(search, num_cuts=jnp.array(0)), reach)


def _search_line(problem: _Prepared, state: _DescentState) -> _DescentState:
    """Return the state after a step that is cut until the energy falls."""
    search = _begin_search(problem, state)

    def shorter(trial: _DescentTrial) -> _DescentTrial:
        cut = replace(search, length=trial.length, num_cuts=trial.num_cuts)
        return _attempt(problem, state, cut)

    no = jnp.array(False)
    first = _DescentTrial(state.gap, state.balance, no, search.length, search.num_cuts)
    trial = jax.lax.while_loop(lambda trial: ~trial.is_last, shorter, first)
    return _end_search(state, search, trial)


def _try_once(problem: _Prepared, state: _DescentState) -> _DescentState:
    """Return the state after one length, at which the search ends or after which it goes on."""
    # A search that goes on begins again at the same direction: that costs no more fields.
    num_cuts = state.search.num_cuts
    search = _begin_search(problem, state)
    length = jnp.where(num_cuts < _MAX_CUTS, search.length / 3.0**num_cuts, 0)
    search = replace(search, length=length, num_cuts=num_cuts)
    trial = _attempt(problem, state, search)
    goes_on = replace(state, search=replace(state.search, num_cuts=trial.num_cuts))
    ended = _end_search(state, search, trial)
    return jax.tree.map(partial(jnp.where, trial.is_last), ended, goes_on)


def preconditioner_of(
    contact: Contact, solid: Solid, gap: Field
) -> Callable[[Field, Field], Field]:
    """Return the map from f'' and a force to 1 / (K + c) times the force.

    The constant c is the stiffness of the softest wave and the mean one of the adhesion; the first
    keeps it positive without adhesion. The search for barriers uses the map as well. Points that
    sit on a core, stiffer than any wave, move by their own stiffness instead.
    """
    stiff = _STIFF * solid.max_stiffness

    def softness(curvature: Field) -> Field:
        return stiff / (stiff + jnp.maximum(curvature, 0))

    curvature = contact.curvature(gap)
    adhesion = total(jnp.maximum(curvature, 0) * softness(curvature)) / gap.size
    inverse = solid.precondition(solid.mean_over_grid(solid.min_stiffness) + adhesion)

    def by_waves(_: Array, force: Field) -> Field:
        return inverse(force)

    def by_waves_and_points(curvature: Field, force: Field) -> Field:
        share = softness(curvature)
        waves = jnp.sqrt(share) * inverse(jnp.sqrt(share) * force)
        return waves + share * (1 - share) / stiff * force

    return partial(either, contact.has_core, by_waves_and_points, by_waves)


def _shortening(contact: Contact, max_move: Scalar) -> Callable[..., Array]:
    """Return the map from the length of a step, a gap and a direction to one that is allowed."""
    law_range = contact.profile.range

    def shorten_step(length: Scalar, gap: Field, direction: Field) -> Scalar:
        moves = direction != 0
        rooms = (law_range + contact.open_gap(gap)) / jnp.where(moves, jnp.abs(direction), 1)
        room = max_move.astype(length.dtype) * jnp.min(jnp.where(moves, rooms, jnp.inf))
        return jnp.minimum(length, room)

    def keep_step(length: Scalar, *_: Field) -> Scalar:
        return length

    return partial(either, jnp.isfinite(max_move), shorten_step, keep_step)


def _nonzero(value: Scalar) -> Scalar:
    return jnp.where(value == 0, 1, value)
