"""The smallest eigenvalue on a cone: LOBPCG on its faces, or else projected gradients."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.contact.hessian import Block, SymmetricOperator
from jaxstab.core import model
from jaxstab.core.accuracy import EIGENPAIR
from jaxstab.core.checks import as_array
from jaxstab.core.control_flow import choose, entry_of, on_platform, with_entry
from jaxstab.core.grid import total, totals
from jaxstab.core.history import History, Indicators
from jaxstab.core.loop import Iteration, optional_parameter
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.core.units import NUMBER
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpair import Minimum, descend, projected_residual
from jaxstab.stability.ritz import combination, least_new, orthonormal, rayleigh_ritz
from jaxstab.stability.solvers.base import ConeSolver, Eigenproblem
from jaxstab.stability.solvers.multi_start import multi_start

# Lengths of a step, each a third of the last, before it is given up.
_MAX_TRIES = 4


class _Point(eqx.Module):
    mode: Field
    product: Field
    eigenvalue: Scalar

    @classmethod
    def at(cls, operator: SymmetricOperator, mode: Field) -> "_Point":
        product = operator(mode)
        return cls(mode, product, total(mode * product))


class _ConeState(eqx.Module):
    """Where a start is, where a projected gradient step leads, and how it got there.

    `num_failures` counts the lengths of a step that failed; -1 allows one length alone.
    """

    point: _Point
    descended: Field
    move: Field
    move_product: Field
    num_failures: Int[Array, ""]
    num_applications: Int[Array, ""]

    @property
    def is_stuck(self) -> Flag:
        """Whether all lengths of a step failed, and the next begins at the descended vector."""
        return self.num_failures == _MAX_TRIES


class _ConeTrial(eqx.Module):
    point: _Point
    is_lower: Flag
    length: Scalar
    num_tries: Int[Array, ""]
    num_applications: Int[Array, ""]


class ProjectedLOBPCG(ConeSolver):
    """Locally optimal conjugate gradients on the faces of a cone, from several starts.

    A step goes to the lowest Ritz vector of x, its last move, and its residual. The residual is
    preconditioned on the face of x and of the vector of the cone nearest to y = x - (A x - lambda
    x) / b, with b the bound on |A|. The Ritz vector is projected back onto the cone, and taken, or
    a part of the way to it, if that lowers the Rayleigh quotient. Where it does not, the next step
    begins at y on the cone, which never raises the quotient. Starts compete in rounds. A start is
    out if it is nearly the same as a lower one, or above the lowest by more than its residual.
    After two rounds three may go on. The best is a local minimiser.

    Arguments:
        tolerance: the projected residual |x - P(x - (A x - lambda x) / b)| b / s of a unit vector
            to reach. P is the projection onto the cone, b the bound on |A| and s its size on the
            lower modes. By default 1e-7 in float64 and 1e-5 in float32.
        max_steps: the step limit of each start, 5000 by default.

    Example:
        >>> solver = js.solvers.ProjectedLOBPCG(tolerance=1e-6)
        >>> f"{js.assess_stability(contact, state, solver).cone.eigenvalue:.3f}"
        '-2.276'
    """

    tolerance: Annotated[Scalar, NUMBER] | None = eqx.field(
        converter=optional_parameter, default=None
    )
    max_steps: Int[Array, ""] = eqx.field(converter=as_array, default=5000)

    default_tolerance: ClassVar[Mapping[str, float]] = EIGENPAIR

    def step(self, problem: Eigenproblem, state: _ConeState) -> _ConeState:
        """Return one start after a step, or on an accelerator after one length of it.

        There no loop within a step waits for the host.
        """
        return on_platform(partial(_lower, problem), partial(_tried_once, problem), state)

    def measure(self, problem: Eigenproblem, state: _ConeState) -> Indicators:
        """Return the projected residual of one start."""
        return {"residual": projected_residual(problem.operator, state.point.mode, state.descended)}

    def solve(
        self,
        operator: SymmetricOperator,
        cone: AdmissibleCone,
        starts: Block,
        is_needed: Bool[Array, " starts"] | bool = True,
    ) -> Minimum:
        """Return the lowest minimiser that the starts lead to."""
        problem = Eigenproblem(operator, cone)
        is_needed = jnp.broadcast_to(is_needed & ~cone.is_trivial, len(starts))
        projected = jax.vmap(cone.project)(starts)
        begin = jax.vmap(_begin)(projected)
        found, is_best = multi_start(self, problem, begin, is_needed)
        best = entry_of(found, jnp.argmax(is_best))
        # All starts may lead to zero.
        is_lost = (best.result == RESULTS.successful) & ~jnp.any(is_best)
        result = RESULTS.where(is_lost, RESULTS.stagnated, best.result)
        point = best.state.point
        # A projected gradient step sets the points that the contact holds to exactly zero.
        vector = descend(operator, point.mode, point.product, point.eigenvalue)
        return Minimum(
            vector=jnp.where(cone.is_trivial, 0, vector),
            num_steps=jnp.sum(found.num_steps),
            num_applications=jnp.sum(found.state.num_applications),
            result=RESULTS.where(cone.is_trivial, RESULTS.successful, result),
            history=best.history,
        )


def _compare(old: _Point, mode: Array, product: Array) -> tuple[_Point, Flag]:
    """Return the point of a unit vector, and whether it is a lower one; zero never is.

    The Rayleigh quotients of x and x + d differ by d.((A x - lambda x) + (A (x + d) - lambda
    (x + d))), also where rounding hides it.
    """
    residual = old.product + product - old.eigenvalue * (old.mode + mode)
    eigenvalue, change, square = totals([mode * product, (mode - old.mode) * residual, mode**2])
    point = _Point(mode, product, eigenvalue / jnp.where(square > 0, square, 1))
    return point, (change <= 0) & (square > 0)


def _begin(start: Field) -> Iteration[_ConeState]:
    """Return a start on the cone before its first step."""
    nothing = jnp.zeros_like(start)
    zero = jnp.zeros((), start.dtype)
    # The first step begins at the start, as if that were where the last step led.
    point = _Point(nothing, nothing, zero)
    none = jnp.array(0)
    state = _ConeState(point, start, nothing, nothing, none + _MAX_TRIES, none)
    unknown = jnp.finfo(start.dtype).max.astype(start.dtype)
    history = History.empty(["residual"], start.dtype)
    history = history.record(none, none, {"residual": jnp.full_like(zero, jnp.nan)})
    return Iteration(state, unknown, none, RESULTS.max_steps_reached, history)


class _RitzVector(eqx.Module):
    """The lowest Ritz vector spanned by a point x, its preconditioned residual and the last move.

    Attributes:
        basis: the three vectors.
        products: the products of the operator with them.
        gram: their inner products.
        stays: the component along x, in the basis.
        moves: the other components; `at(length)` is x's plus `length` times these, normalised.
        is_rough: whether combined products have no digits left.
    """

    basis: list[Field]
    products: list[Field]
    gram: Float[Array, "vectors vectors"]
    stays: Float[Array, " vectors"]
    moves: Float[Array, " vectors"]
    is_rough: Flag

    @classmethod
    def around(cls, problem: Eigenproblem, point: _Point, state: _ConeState) -> "_RitzVector":
        """Return the Ritz vector around a point of the search."""
        operator = problem.operator
        cone = problem.domain
        face = cone.face(jnp.maximum(cone.inward(point.mode), cone.inward(state.descended)))
        residual = face.project(point.product - point.eigenvalue * point.mode)
        precondition = operator.preconditioner(point.mode, point.eigenvalue)
        steepest = face.project(precondition(residual))
        basis = [point.mode, steepest, state.move]
        products = [point.product, operator(steepest), state.move_product]
        # Both triangles, whose means have half of the error that products gather.
        pairs = [left * right for left in basis for right in (*basis, *products)]
        sums = totals([*pairs, *(product**2 for product in products)])
        gram, energies = jnp.split(sums[:-3].reshape(3, 6), 2, axis=1)
        units = jnp.eye(len(gram), dtype=gram.dtype)

        def widen(index: Array, axes: Array) -> Array:
            axis = orthonormal(entry_of(units, index), axes, gram, least_new(gram.dtype))
            return with_entry(axes, index, axis, axis=1)

        axes = jax.lax.fori_loop(0, len(gram), widen, jnp.zeros_like(gram))
        parts = rayleigh_ritz(axes, energies, 1)[1][:, 0]
        parts *= jnp.where(gram[0] @ parts < 0, -1, 1)
        # Combined products have no digits left where the basis reaches into stiff points, nor that
        # of a tiny difference.
        move = gram[-1, -1]
        is_tiny = (move > 0) & (move < jnp.finfo(move.dtype).eps)
        is_rough = is_tiny | jnp.any(sums[-3:] > operator.scale**2 * jnp.diagonal(gram))
        stays = parts * units[0]
        return cls(basis, products, gram, stays, parts - stays, is_rough)

    def at(self, length: Scalar) -> Float[Array, " vectors"]:
        """Return the unit vector that goes a part of the way, in terms of the basis."""
        part = self.stays + length * self.moves
        return part / jnp.sqrt(part @ self.gram @ part)


def _lower(problem: Eigenproblem, state: _ConeState) -> _ConeState:
    """Return a start after a step to the lowest Ritz vector that can be brought onto the cone below
    the point, or part of the way to it.
    """
    operator = problem.operator
    cone = problem.domain
    point = jax.lax.cond(
        state.is_stuck,
        lambda: _Point.at(operator, model.onto_sphere(state.descended)),
        lambda: state.point,
    )
    plane = _RitzVector.around(problem, point, state)

    def attempt(trial: _ConeTrial) -> _ConeTrial:
        part = plane.at(trial.length)
        vector = combination(part, plane.basis)
        is_new = plane.is_rough | jnp.any(cone.excludes(vector))

        def project() -> tuple[Array, Array]:
            mode = model.onto_sphere(cone.project(vector))
            return mode, operator(mode)

        mode, product = jax.lax.cond(
            is_new, project, lambda: (vector, combination(part, plane.products))
        )
        tried, is_lower = _compare(point, mode, product)
        return _ConeTrial(
            point=tried,
            is_lower=is_lower,
            length=trial.length / 3,
            num_tries=trial.num_tries + 1,
            num_applications=trial.num_applications + is_new,
        )

    none = jnp.array(0)
    trial = jax.lax.while_loop(
        lambda trial: ~trial.is_lower & (trial.num_tries < _MAX_TRIES),
        attempt,
        _ConeTrial(point, jnp.array(False), jnp.ones_like(point.eigenvalue), none, none),
    )
    point = choose(trial.is_lower, trial.point, point)
    num_failures = jnp.where(trial.is_lower, 0, _MAX_TRIES)
    return _arrive(problem, state, point, num_failures, state.is_stuck + 2 + trial.num_applications)


def _tried_once(problem: Eigenproblem, state: _ConeState) -> _ConeState:
    """Return a start after one length of a step, or after all at the descended vector."""
    operator = problem.operator
    cone = problem.domain
    plane = _RitzVector.around(problem, state.point, state)
    length = 3.0 ** -jnp.maximum(state.num_failures, 0).astype(state.move.dtype)
    vector = combination(plane.at(length), plane.basis)
    # On the cone already, its zeros stay zero: rounding in a projection would open the face there.
    is_new = plane.is_rough | jnp.any(cone.excludes(vector))
    vector = jnp.where(is_new, cone.project(vector), vector)
    mode = model.onto_sphere(jnp.where(state.is_stuck, state.descended, vector))
    tried, is_lower = _compare(state.point, mode, operator(mode))
    is_taken = is_lower | state.is_stuck
    point = choose(is_taken, tried, state.point)
    # Near rounding all lengths fail: after a step to the descended vector only one is tried.
    failures = jnp.where(state.num_failures < 0, _MAX_TRIES, state.num_failures + 1)
    num_failures = jnp.where(is_taken, jnp.where(state.is_stuck, -1, 0), failures)
    new = _arrive(problem, state, point, num_failures, 3)
    # A shorter length is one of the same plane.
    return replace(
        new,
        move=jnp.where(is_taken, new.move, state.move),
        move_product=jnp.where(is_taken, new.move_product, state.move_product),
    )


def _arrive(
    problem: Eigenproblem,
    before: _ConeState,
    point: _Point,
    num_failures: Int[Array, ""],
    num_applications: Int[Array, ""] | int,
) -> _ConeState:
    """Return the state of a start at a point."""
    old = before.point
    along = total(point.mode * old.mode)
    moved = descend(problem.operator, point.mode, point.product, point.eigenvalue)
    return _ConeState(
        point,
        problem.domain.project(moved),
        point.mode - along * old.mode,
        point.product - along * old.product,
        num_failures,
        before.num_applications + num_applications,
    )
