"""The path of a contact under a programme of loads, through its jumps."""

import warnings
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.branches.implicit import differentiable_value
from jaxstab.branches.reason import reason_of
from jaxstab.checks import (
    integer,
    is_traced,
    known,
    parameter,
    require,
    require_finite,
    require_positive,
)
from jaxstab.contact import Contact
from jaxstab.derivatives import attach
from jaxstab.equilibrium.equilibrate import initial_gap
from jaxstab.equilibrium.state import State, state_at
from jaxstab.equilibrium.window import whole_start
from jaxstab.lanes import by_lanes
from jaxstab.loads import Load, require_load, require_same_machine
from jaxstab.paths.course import DISTURBANCE, course_of
from jaxstab.paths.path import Jump, Path, States
from jaxstab.paths.step import Walk
from jaxstab.paths.store import Event, Field, Place, Scalar, Store
from jaxstab.paths.walk import begin, go_on, travelled
from jaxstab.programs import program
from jaxstab.progress import progress_bar
from jaxstab.refusals import Obstacle
from jaxstab.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.results import KINDS, RESULTS, throw_failure

_BATCH_SECONDS = 0.5

_NO_DERIVATIVE = (
    "of a path only the loads of its jumps have one. Differentiate `path.jumps.load`, or an "
    "equilibrium at a load of the path, found by `equilibrate` from the path's gap there"
)


class PathInterrupted(UserWarning):
    """A path was interrupted; it holds the states so far."""


def follow(
    contact: Contact,
    load: Load,
    *,
    initial: ArrayLike | State | None = None,
    smallest_jump: ArrayLike = 1e-5,
    disturbance: ArrayLike = DISTURBANCE,
    fields: bool = False,
    progress: bool = False,
    max_states: int = 1024,
    max_jumps: int = 64,
    throw: bool = True,
) -> Path:
    """Return the equilibria that a contact goes through as its load goes from value to value.

    A step is predicted by the two states before it, and corrected by conjugate gradients. Where a
    branch ends, these go down in energy from its last state, to the equilibrium at a load that is
    further by a part of 1e-6 of the range of loads. An overdamped relaxation,
    g' = -(K u + p0 + f'), went to the same contact points in all of 120 jumps of rough surfaces
    (benchmarks/results/jumps.md). Jumps that lose less than `smallest_jump` are not located, but
    what they lose is counted. Surfaces that a tension has pulled apart stay so until there is a
    pressure.

    Ctrl-C ends a path after the steps in hand, about a second, and returns the states so far.

    Arguments:
        contact: the contact problem.
        load: the turning points of the programme, in order: two or more.
        initial: where the first equilibrium starts, as in `equilibrate`.
        smallest_jump: the loss from which a jump is located, over the problem's own energy: that
            of the elastic deformation in full contact and of the deepest adhesion. By default
            jumps located lost all but 0.7 % of what ten rough surfaces lost around a loop; at 1e-3
            a path has a fifth of the states.
        disturbance: the size of a random field, the same at every step, that is added to where
            each equilibrium starts, over the rms height: it leaves branches that only a symmetry
            holds. Zero for none.
        fields: whether to keep the gap of every recorded state.
        progress: show a progress bar.
        max_states: how many states and jumps there is room for.
        max_jumps: how many jumps.
        throw: raise where the path does not reach its end; otherwise look at `result`.

    Returns:
        The path. Under JAX transformations arrays have `max_states` and `max_jumps` entries, NaN
        where there is none; otherwise as many as there are. The loads of its jumps can be
        differentiated with respect to the contact, as `critical_load` can; nothing else can, and
        says so.

    Raises:
        ValueError: for a load that does not hold two finite values or more in one dimension, each
            another than the one before, or machines that differ; for room that is too small.
        SolverError: if `throw`, where an equilibrium is not found, or the store is full.
    """
    require_load(load)
    if load.value.ndim != 1 or load.value.size < 2:
        raise ValueError(
            f"follow takes the turning points of a load, two or more in one dimension, but "
            f"{type(load).__name__} holds an array of shape {load.value.shape}."
        )
    require_finite("The load", load.value)
    turns = known(load.value)
    cure = "a turning point is that of the one before: leave it out."
    require("The load", turns[1:], turns[1:] != turns[:-1], cure)
    require_same_machine(load)
    share, noise = parameter(smallest_jump), parameter(disturbance)
    require_positive("smallest_jump", share)
    require("The disturbance", noise, known(noise) >= 0, "it must not be negative.")
    sizes = integer("max_states", max_states), integer("max_jumps", max_jumps)
    require("max_states", sizes[0], sizes[0] >= 2, "a path has two states at least.")
    require("max_jumps", sizes[1], sizes[1] >= 1, "leave room for one.")
    warn_if_coarse(contact, FOR_JUMPS)
    start = initial_gap(contact, load[0], initial)
    whole, start = whole_start(contact, load[0], start)
    own, unit = whole.in_own_units()
    loads = load.in_units_of(unit)
    inputs = jax.lax.stop_gradient((own, loads, start, share, noise))
    # What was not found is NaN.
    with jax.debug_nans(False), progress_bar(100, "%", shown=progress) as bar:
        ended = _begin(sizes, fields, *inputs)
        if is_traced(ended):
            ended = _go_on(ended, None, *inputs)
        else:
            ended = _go_on_by_and_by(ended, inputs, bar)
        path = _path(fields, ended, *inputs[:2])
    if not is_traced(ended):
        path = _cut(path, int(ended.states.count), int(ended.jumps.count))
    if is_traced((contact, load)):
        others = [part for part in (start, share, noise) if part is not None]
        path = _with_derivatives(path, own, loads, others, throw)
    path = path.in_units_of(1 / unit).on_surface(whole.solid)
    if not throw or (not is_traced(path.result) and path.result == RESULTS.interrupted):
        return path
    return throw_failure(path.result, path, lambda: _describe(path, load))


@partial(program, static_argnums=(0, 1))
def _begin(sizes: tuple[int, int], fields: bool, *inputs: Any) -> Walk[Store]:
    def first(
        contact: Contact, load: Load, start: Field | None, share: Scalar, disturbance: Scalar
    ) -> Walk[Store]:
        if start is None:
            start = contact.control(load[0]).starting_gap(contact.heights)
        course, (num_states, num_jumps) = course_of(contact, load, share, disturbance), sizes
        states = partial(Store.empty, size=num_states, fields=fields)
        return begin(course, start, states, partial(Store.empty, size=num_jumps, fields=True))

    return by_lanes(first)(*inputs)


@program
def _go_on(walk: Walk[Store], num_steps: int | None, *inputs: Any) -> Walk[Store]:
    def further(
        walk: Walk[Store],
        num_steps: Int[Array, ""] | None,
        contact: Contact,
        load: Load,
        _: Field | None,
        share: Scalar,
        disturbance: Scalar,
    ) -> Walk[Store]:
        return go_on(course_of(contact, load, share, disturbance), walk, num_steps)

    return by_lanes(further)(walk, num_steps, *inputs)


def _go_on_by_and_by(walk: Walk[Store], inputs: Any, bar: Any) -> Walk[Store]:
    """Go on to the end, or until interrupted, in batches of steps of about a second each."""
    load, num_steps = inputs[1], 1
    try:
        while walk.is_open(load):
            start = perf_counter()
            # While it waits, an interrupt stays pending.
            walk = jax.block_until_ready(_go_on(walk, num_steps, *inputs))
            bar.update(int(100 * travelled(load, walk)) - bar.n)
            # The first time it is compiled.
            num_steps = 2 * num_steps if perf_counter() - start < _BATCH_SECONDS else num_steps
    except KeyboardInterrupt:
        message = f"The path was interrupted at {100 * float(travelled(load, walk)):.0f} %."
        warnings.warn(message, PathInterrupted, stacklevel=3)
        walk = replace(walk, result=RESULTS.interrupted)
    return walk


@partial(program, static_argnums=0)
def _path(fields: bool, ended: Walk[Store], contact: Contact, load: Load) -> Path:
    return by_lanes(partial(_path_of, fields))(ended, contact, load)


def _path_of(fields: bool, ended: Walk[Store], contact: Contact, load: Load) -> Path:
    states, one = ended.states.rows, load[0]
    place = states.place

    def loads(values: Array) -> Load:
        # What else a load has is the same all along.
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, values.shape), one).at(values)

    def work(place: Place, supplied: Array) -> Array:
        # A dead weight is no part of what is worked on.
        start = states.place.stored[0] - states.place.potential[0]
        return supplied + (place.stored - place.potential) - start

    def jump(event: Event) -> Jump:
        before, after = event.before, event.after
        load = one.at(before.value)
        kind, mode = jax.lax.cond(
            jnp.isfinite(before.value),
            lambda: reason_of(contact, load, before.gap, event.ahead),
            lambda: (KINDS.fold, jnp.full_like(before.gap, jnp.nan)),
        )
        return Jump(
            load=load,
            kind=KINDS.where(event.is_touch, KINDS.touch, kind),
            before=state_at(contact, load, before.gap),
            after=state_at(contact, one.at(after.value), after.gap),
            mode=mode,
            dissipation=event.dissipation,
            state=event.state,
        )

    return Path(
        load=loads(place.value),
        equilibrium=States(
            place.mean_gap,
            place.mean_pressure,
            place.contact_area,
            jnp.broadcast_to(contact.area, place.energy.shape),
            place.energy,
            work(place, states.supplied),
            states.dissipation,
            place.gap if fields else None,
        ),
        jumps=jax.lax.map(jump, ended.jumps.rows),
        work=work(ended.here.place, ended.here.supplied),
        dissipation=ended.here.dissipation,
        result=ended.result,
    )


def _with_derivatives(
    path: Path, contact: Contact, load: Load, others: list[Array], throw: bool
) -> Path:
    """Return a path with derivatives of the loads of its jumps, and a refusal of all others."""
    jumps = path.jumps

    def value(jump: Jump) -> Scalar:
        shared, ahead = load[0].at(jump.load.value), jump.after.load.value - jump.load.value
        return differentiable_value(shared, jump.before.gap, jump.kind, ahead, contact, throw)

    if is_traced(jumps.state):
        values = jax.lax.map(value, jumps)
    else:
        # One by one, so that a refusal can be read.
        values = jnp.asarray([value(jump) for jump in jumps], jumps.load.value.dtype)
    numbers, rest = eqx.partition(path, eqx.is_inexact_array)
    path = eqx.combine(attach(_refuse, throw, numbers, None, (contact, load, others)), rest)
    return replace(path, jumps=replace(path.jumps, load=jumps.load.at(values)))


def _refuse(path: Path, _: None, inputs: Any, changes: Any) -> tuple[Path, list[Obstacle]]:
    nothing = jax.tree.map(jnp.zeros_like, path)
    return nothing, [Obstacle(jnp.array(True), _NO_DERIVATIVE)]


def _cut(path: Path, num_states: int, num_jumps: int) -> Path:
    """Return a path with as many entries as there are."""

    def first(tree: Any, number: int) -> Any:
        return jax.tree.map(lambda leaf: jax.device_put(known(leaf)[:number]), tree)

    load, equilibrium = first((path.load, path.equilibrium), num_states)
    return replace(path, load=load, equilibrium=equilibrium, jumps=first(path.jumps, num_jumps))


def _describe(path: Path, load: Load) -> str:
    last = float(path.load.value[-1]) if len(path.load.value) else float(load.value[0])
    return (
        f"The path ended at {type(load).__name__}({last:.6g}) after {len(path.load.value)} states "
        f"and {len(path.jumps.state)} jumps"
    )
