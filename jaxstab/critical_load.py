"""The load at which a stable branch of equilibria ends in a fold.

There the smallest eigenvalue on the free points vanishes, and the branch turns back. The branch is
followed towards the fold by the square of the eigenvalue, which falls linearly with the load. Then
Newton's method takes both conditions together,

    K u + p0 + f'(g) = 0 on the free points,   lambda(g) = 0,

with A + s x x^T in place of A, x being the mode: at a simple fold that is not singular.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import ClassVar, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxstab.contact import Contact
from jaxstab.derivatives import FieldMap, LinearSystem, Obstacle, unless
from jaxstab.elasticity import softest_wave
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find_equilibrium, initial_gap
from jaxstab.equilibrium.implicit import fields_of, third_derivative, verge_of_contact
from jaxstab.grid import total
from jaxstab.hessian import Block
from jaxstab.iterate import Indicators, Iteration, IterativeSolver
from jaxstab.loads import Load, require_load
from jaxstab.resolution import warn_if_coarse
from jaxstab.results import RESULTS, throw_failure
from jaxstab.stability import LOBPCG, Eigenpair
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpairs import measured
from jaxstab.stability.implicit import differentiable as differentiable_pair
from jaxstab.stability.modes import BLOCK_SIZE, noise

Field = Float[Array, " *grid"]
Scalar = Float[Array, ""]
Tree = TypeVar("Tree")

# The part that a step goes of the way to where the fold is foreseen.
_SHARE = 0.75
# How much more than foreseen the gap may change on the same branch; a fold asks for 4 / 3.
_SURPRISE = 2
# The residual of a mode: derivatives of the eigenvalue are as good as it is.
_MODE_TOLERANCE = {"float64": 1e-9, "float32": 1e-5}
_LEAST_COSINE = {"float64": 1e-6, "float32": 1e-3}
_BIFURCATION = (
    "the branch does not turn back here but branches off, into states without its symmetry. "
    "Differentiate another quantity, or break the symmetry of the surface"
)
_NOT_FOUND = "no fold was found (look at its result)"


class CriticalLoad(eqx.Module):
    """A fold, where a branch of equilibria ends; by symmetry it can branch off there instead.

    Attributes:
        equilibrium: the equilibrium there, with its load.
        critical: the smallest eigenvalue on the free points, which is zero, and its mode.
        result: a member of `RESULTS`: how the search ended.
    """

    equilibrium: Equilibrium
    critical: Eigenpair
    result: RESULTS

    @property
    def load(self) -> Load:
        """The critical load."""
        return self.equilibrium.load


def critical_load(
    contact: Contact,
    bracket: Load,
    *,
    initial: ArrayLike | Equilibrium | None = None,
    throw: bool = True,
) -> CriticalLoad:
    """Return the load at which the critical eigenvalue vanishes, on the way between two loads.

    Arguments:
        contact: the contact problem.
        bracket: a load that holds two values: one at which the branch is stable, and one beyond
            its end. If the branch from the first does not end before the second, that from the
            second is followed towards the first.
        initial: where equilibria at both loads start, as in `equilibrate`.
        throw: raise where no fold is found; otherwise look at `result`.

    Returns:
        The fold. Its load, equilibrium and mode can be differentiated with respect to the contact:
        dl = -(x.dr) / (x.dr/dl), r being the imbalance on the free points. Where the branch does
        not end but branches off, by symmetry, there is no derivative.

    Raises:
        ValueError: for other than two loads, or an initial gap that `equilibrate` refuses.
        SolverError: if `throw`, where the first load has no stable equilibrium, or the eigenvalue
            does not vanish in the bracket.
    """
    require_load(bracket)
    if bracket.value.shape != (2,):
        raise ValueError(
            f"critical_load takes two loads, but {type(bracket).__name__} holds an array of shape "
            f"{bracket.value.shape}: give one on the stable branch and one beyond its end."
        )
    warn_if_coarse(contact)
    found = find_fold(contact, bracket, initial_gap(contact, bracket, initial), throw)
    if not throw:
        return found
    return throw_failure(found.result, found, lambda: _describe(bracket, found))


@partial(jax.jit, static_argnames="throw")
def find_fold(
    contact: Contact, bracket: Load, initial: Field | None, throw: bool = False
) -> CriticalLoad:
    """Do what `critical_load` does, on checked arguments; only derivatives can raise."""
    fixed, loads, start = jax.lax.stop_gradient((contact, bracket, initial))
    ways = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf[::-1]]), loads)
    searches = jax.lax.map(lambda loads: _search(fixed, loads, start), ways)
    successes = searches.result == RESULTS.successful
    found = jax.tree.map(lambda leaf: leaf[jnp.argmax(successes)], searches)

    point = found.point
    pair = replace(point.pair, result=found.result)
    load, gap = _differentiable(throw, point.load, point.gap, pair, contact)
    space = _space(contact, load, gap)
    is_found = found.result == RESULTS.successful
    fields, _ = fields_of(contact, *_where_found(is_found, (load, gap)))
    not_found = [Obstacle(~is_found, _NOT_FOUND)]
    fields = {
        name: unless(not_found, jnp.where(is_found, field, jnp.nan), throw)
        for name, field in fields.items()
    }
    return CriticalLoad(
        equilibrium=Equilibrium(
            load=load,
            in_contact=gap == 0,
            contact_area=jnp.mean(gap == 0),
            residual=found.newton.residual,
            num_steps=found.num_steps,
            result=found.result,
            history=found.newton.history,
            **fields,
        ),
        critical=differentiable_pair(pair, space, contact, gap, throw),
        result=found.result,
    )


class _Point(eqx.Module):
    """A state of a branch, with the lowest modes on its free points."""

    load: Load
    gap: Field
    modes: Block
    pair: Eigenpair


class _Search(eqx.Module):
    point: _Point
    newton: Iteration
    num_steps: Int[Array, ""]
    result: RESULTS


def _search(contact: Contact, loads: Load, start: Field | None) -> _Search:
    """Follow the branch from the first load towards the second, to its fold."""
    first, last = (jax.tree.map(lambda leaf, i=i: leaf[i], loads) for i in (0, 1))
    equilibrium = find_equilibrium(contact, first, PreconditionedConjugateGradient(), start)
    is_found = equilibrium.result == RESULTS.successful
    gap = jnp.where(is_found, equilibrium.gap, jnp.nan)
    point = _point_at(contact, first, gap, noise(jax.random.key(0), BLOCK_SIZE, gap))
    approach = _Approach().solve(contact, point, last)
    newton = _FoldNewton().solve(contact, approach.state.point)
    end = newton.state.load.value
    is_between = (end - first.value) * (last.value - end) >= 0
    is_fold = (newton.result == RESULTS.successful) & is_between
    result = RESULTS.where(is_fold, RESULTS.successful, RESULTS.no_fold)
    return _Search(
        newton.state,
        newton,
        equilibrium.num_steps + approach.num_steps + newton.num_steps,
        RESULTS.where(is_found, result, equilibrium.result),
    )


def _point_at(contact: Contact, load: Load, gap: Field, modes: Block) -> _Point:
    space = _space(contact, load, gap)
    hessian = contact.hessian(gap).restricted(space.is_moving)
    found = LOBPCG(_MODE_TOLERANCE[gap.dtype.name]).solve(hessian, space, modes)
    pair = measured(hessian, space, found.at(found.vector[0]))
    return _Point(load, gap, found.vector, pair)


def _space(contact: Contact, load: Load, gap: Field) -> Subspace:
    return Subspace(gap > 0, load.control(contact.heights).fixes_mean)


class _Linear(NamedTuple):
    """A point of a branch to first order, in the load and in the free points.

    Attributes:
        imbalance: the net pressure of the free points, up to what the load takes.
        gap_rate: how the gap follows the load where the free points do not move by themselves.
        imbalance_rate: how the imbalance of the free points does.
        eigenvalue_slope: the gradient of the eigenvalue with respect to the gap.
        operator: A.
        precondition: roughly the inverse of A, without its lowest mode.
        project: the projection onto the moves of the free points that the load allows.
    """

    imbalance: Field
    gap_rate: Field
    imbalance_rate: Field
    eigenvalue_slope: Field
    operator: FieldMap
    precondition: FieldMap
    project: FieldMap

    def system(self, stiffening: Scalar | float, mode: Field) -> LinearSystem:
        """Return A + s x x^T, s being the stiffening, as a system."""

        def operator(field: Field) -> Field:
            return self.operator(field) + stiffening * total(mode * field) * mode

        return LinearSystem(operator, self.precondition, self.project)


def _linearised(contact: Contact, load: Load, gap: Field, pair: Eigenpair) -> _Linear:
    space = _space(contact, load, gap)
    hessian = contact.hessian(gap).restricted(space.is_moving)

    def at(load: Load) -> tuple[Field, Field]:
        fields, net = fields_of(contact, load, gap)
        return fields["gap"], space.project(net)

    (_, imbalance), rates = jax.jvp(at, (load,), (jax.tree.map(jnp.ones_like, load),))
    return _Linear(
        imbalance,
        *rates,
        eigenvalue_slope=third_derivative(contact, gap) * pair.mode**2,
        operator=hessian,
        precondition=lambda field: hessian.precondition(field, pair.mode, pair.eigenvalue),
        project=space.project,
    )


class _Approaching(eqx.Module):
    point: _Point
    rate: Field
    distance: Scalar
    fraction: Scalar


class _Approach(IterativeSolver):
    """Steps along a stable branch, from load to load, to near the fold ahead of it."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=100)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-3, "float32": 1e-2}
    patience: ClassVar[int] = 15

    def solve(self, contact: Contact, point: _Point, last: Load) -> Iteration[_Approaching]:
        """Go from a point of the branch towards a load beyond its end."""
        width = jnp.abs(last.value - point.load.value)

        def foresee(point: _Point, fraction: Scalar) -> _Approaching:
            linear = _linearised(contact, point.load, point.gap, point.pair)
            moved, _ = linear.system(0, point.pair.mode).solution(-linear.imbalance_rate)
            rate = moved + linear.gap_rate
            slope = total(linear.eigenvalue_slope * rate)
            return _Approaching(point, rate, -point.pair.eigenvalue / (2 * slope), fraction)

        def is_ahead(state: _Approaching) -> Bool[Array, ""]:
            left = last.value - state.point.load.value
            return (state.distance * left > 0) & (jnp.abs(state.distance) < jnp.abs(left))

        def step(state: _Approaching) -> _Approaching:
            old = state.point
            left = last.value - old.load.value
            stride = jnp.where(is_ahead(state), _SHARE * state.distance, left) * state.fraction
            load = _shifted(old.load, stride)
            start = jnp.maximum(old.gap + stride * state.rate, 0)
            solver = PreconditionedConjugateGradient()
            equilibrium = find_equilibrium(contact, load, solver, start)
            is_found = equilibrium.result == RESULTS.successful
            new = _point_at(contact, load, jnp.where(is_found, equilibrium.gap, 1), old.modes)
            change = jnp.sqrt(total((new.gap - old.gap) ** 2))
            foreseen = _SURPRISE * jnp.abs(stride) * jnp.sqrt(total(state.rate**2))
            is_same = is_found & (change <= foreseen) & (new.pair.eigenvalue > 0)
            point = jax.tree.map(partial(jnp.where, is_same), new, old)
            fraction = jnp.where(is_same, jnp.minimum(2 * state.fraction, 1), state.fraction / 3)
            return foresee(point, fraction)

        def measure(state: _Approaching) -> Indicators:
            return {"residual": jnp.where(is_ahead(state), jnp.abs(state.distance) / width, 1)}

        return self.iterate(step, measure, foresee(point, jnp.ones_like(width)))


class _FoldNewton(IterativeSolver):
    """Newton's method for a balance of pressures and an eigenvalue of zero."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=30)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-9, "float32": 1e-4}
    patience: ClassVar[int] = 8

    def solve(self, contact: Contact, point: _Point) -> Iteration[_Point]:
        """Go from a point of the branch to the fold."""

        def step(point: _Point) -> _Point:
            linear = _linearised(contact, point.load, point.gap, point.pair)
            conditions = linear.imbalance, point.pair.eigenvalue
            stiffened = linear.system(_stiffening(contact), point.pair.mode)
            change, move = _newton_step(
                contact, linear, point.pair, conditions, lambda b: stiffened.solution(b)[0]
            )
            # No free point closes.
            limit = jnp.min(jnp.where(move < 0, -point.gap / jnp.where(move < 0, move, 1), jnp.inf))
            length = jnp.minimum(1, 0.9 * limit)
            load = _shifted(point.load, length * change)
            gap = load.control(contact.heights).restore(point.gap + length * move)
            return _point_at(contact, load, gap, point.modes)

        def measure(point: _Point) -> Indicators:
            balance = contact.balance(point.load.control(contact.heights))(point.gap)
            eigenvalue = jnp.abs(point.pair.eigenvalue) / _stiffening(contact)
            return {"residual": jnp.maximum(balance.residual, eigenvalue)}

        return self.iterate(step, measure, point)


def _newton_step(
    contact: Contact,
    linear: _Linear,
    pair: Eigenpair,
    conditions: tuple[Field, Scalar],
    solve: FieldMap,
) -> tuple[Scalar, Field]:
    """Return the changes of load and gap that cancel an imbalance and an eigenvalue.

    With B = A + s x x^T the gap moves by B^-1 (s (x.d) x - r - l dr/dl), where d is that move, and
    the two numbers x.d and l follow from their definition and from the eigenvalue.
    """
    imbalance, eigenvalue = conditions
    stiffening = _stiffening(contact)
    mode, slope = pair.mode, linear.eigenvalue_slope
    stiffness = pair.eigenvalue + stiffening
    still, moved = -solve(imbalance), -solve(linear.imbalance_rate)
    rate = moved + linear.gap_rate
    matrix = (
        (stiffening * total(mode * moved), -pair.eigenvalue / stiffness),
        (total(slope * rate), total(slope * mode) / stiffness),
    )
    first, second = -stiffening * total(mode * still), -eigenvalue - total(slope * still)
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    change = (first * d - b * second) / determinant
    along_mode = (a * second - c * first) / determinant
    return change, still + change * rate + along_mode * mode / stiffness


def _stiffening(contact: Contact) -> Scalar:
    multiplier = contact.solid.multiplier.astype(contact.heights.dtype)
    return softest_wave(multiplier)


def _shifted(load: Load, change: Scalar) -> Load:
    return eqx.tree_at(lambda load: load.value, load, load.value + change)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _differentiable(
    throw: bool, load: Load, gap: Field, pair: Eigenpair, contact: Contact
) -> tuple[Load, Field]:
    """Return load and gap of a fold as differentiable functions of the contact."""
    return load, gap


@_differentiable.defjvp
def _differentiate(
    throw: bool, primals: tuple, tangents: tuple
) -> tuple[tuple[Load, Field], tuple[Load, Field]]:
    _, _, pair, contact = primals
    fold = _differentiable(throw, *primals)
    is_found = pair.result == RESULTS.successful
    pair, (load, gap) = _where_found(is_found, pair), _where_found(is_found, fold)
    pair = differentiable_pair(pair, _space(contact, load, gap), contact, gap, throw)
    linear = _linearised(contact, load, gap, pair)

    def conditions(contact: Contact) -> tuple[Field, Field, Scalar]:
        fields, net = fields_of(contact, load, gap)
        moved = contact.hessian(fields["gap"])(pair.mode)
        return fields["gap"], linear.project(net), total(pair.mode * moved)

    _, (shift, *change) = jax.jvp(conditions, (contact,), tangents[-1:])
    stiffened = linear.system(_stiffening(contact), pair.mode)
    _, net = fields_of(contact, load, gap)
    obstacles = [
        Obstacle(~is_found, _NOT_FOUND),
        Obstacle(_is_bifurcation(linear, pair.mode), _BIFURCATION),
        verge_of_contact(net, gap, contact.hessian(gap)),
    ]
    change, move = _newton_step(
        contact,
        linear,
        pair,
        tuple(change),
        lambda b: stiffened.differentiable_solution(b, obstacles, throw),
    )
    change, move = (unless(obstacles, tangent, throw) for tangent in (change, shift + move))
    return fold, (jax.tree.map(lambda _: change, load), move)


def _where_found(is_found: Bool[Array, ""], tree: Tree) -> Tree:
    """Return finite stand-ins where nothing was found, so that a failed lane does no harm."""

    def choose(leaf: Array) -> Array:
        is_float = jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.where(is_found, leaf, 1) if is_float else leaf

    return jax.tree.map(choose, tree)


def _is_bifurcation(linear: _Linear, mode: Field) -> Bool[Array, ""]:
    """Whether the load does not act on the mode, or the eigenvalue does not change along it."""

    def cosine(field: Field) -> Scalar:
        return jnp.abs(total(mode * field)) / jnp.sqrt(total(field**2))

    least = jnp.minimum(cosine(linear.imbalance_rate), cosine(linear.eigenvalue_slope))
    return ~(least > _LEAST_COSINE[mode.dtype.name])


def _describe(bracket: Load, found: CriticalLoad) -> str:
    first, last = (float(value) for value in jax.lax.stop_gradient(bracket.value))
    equilibrium = jax.lax.stop_gradient(found.equilibrium)
    return (
        f"No fold found between {type(bracket).__name__}({first:.6g}) and ({last:.6g}): the search "
        f"ended at {float(equilibrium.load.value):.6g} with a residual of "
        f"{float(equilibrium.residual):.3g}"
    )
