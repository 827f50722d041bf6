"""The smallest eigenvalue on a cone: LOBPCG on its faces, or else projected gradients."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.contact.hessian import Block, SymmetricOperator
from jaxstab.core import model
from jaxstab.core.batching import by_entries, entry_of
from jaxstab.core.grid import total, totals
from jaxstab.core.history import History, Indicators
from jaxstab.core.loop import Iteration, integer_parameter, optional_parameter
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpair import Minimum, descended, projected_residual
from jaxstab.stability.ritz import combination, rayleigh_ritz
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


class _State(eqx.Module):
    point: _Point
    descended: Field
    move: Field
    move_product: Field
    is_stuck: Flag
    num_applications: Int[Array, ""]


class _Trial(eqx.Module):
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
    """

    tolerance: Scalar | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=integer_parameter, default=5000)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-7, "float32": 1e-5}

    def step(self, problem: Eigenproblem, state: _State) -> _State:
        """Return one start after a step."""
        operator, cone, old = problem.operator, problem.domain, state.point
        point = jax.lax.cond(
            state.is_stuck,
            lambda: _Point.at(operator, model.onto_sphere(state.descended)),
            lambda: old,
        )
        trial = _lower(operator, cone, point, state)
        point = jax.tree.map(partial(jnp.where, trial.is_lower), trial.point, point)
        along = total(point.mode * old.mode)
        return _State(
            point,
            cone.project(descended(operator, point.mode, point.product, point.eigenvalue)),
            point.mode - along * old.mode,
            point.product - along * old.product,
            ~trial.is_lower,
            state.num_applications + state.is_stuck + 2 + trial.num_applications,
        )

    def measure(self, problem: Eigenproblem, state: _State) -> Indicators:
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
        begin = jax.vmap(by_entries(_begin), (None, 0))(cone, starts)
        found, wins = multi_start(self, problem, begin, is_needed)
        best = entry_of(found, jnp.argmax(wins))
        # All starts may lead to zero.
        is_lost = (best.result == RESULTS.successful) & ~jnp.any(wins)
        result = RESULTS.where(is_lost, RESULTS.stagnated, best.result)
        point = best.state.point
        # A projected gradient step sets to exactly zero what the contact holds.
        vector = descended(operator, point.mode, point.product, point.eigenvalue)
        return Minimum(
            vector=jnp.where(cone.is_trivial, 0, vector),
            num_steps=jnp.sum(found.num_steps),
            num_applications=jnp.sum(found.state.num_applications),
            result=RESULTS.where(cone.is_trivial, RESULTS.successful, result),
            history=best.history,
        )


def _inner_products(
    basis: Sequence[Field], products: Sequence[Field]
) -> tuple[
    Float[Array, "vectors vectors"], Float[Array, "vectors vectors"], Float[Array, " vectors"]
]:
    """Return those of the vectors of a basis with each other and with A times each, and A x.A x."""
    size = len(basis)
    # Both triangles, whose means have half of the error that products gather.
    pairs = [left * right for left in basis for right in (*basis, *products)]
    sums = totals([*pairs, *(product**2 for product in products)])
    gram, energies = jnp.split(sums[:-size].reshape(size, 2 * size), 2, axis=1)
    return gram, energies, sums[-size:]


def _compared(old: _Point, mode: Array, product: Array) -> tuple[_Point, Flag]:
    """Return the point of a unit vector, and whether it is a lower one; zero never is.

    The Rayleigh quotients of x and x + d differ by d.((A x - lambda x) + (A (x + d) - lambda
    (x + d))), also where rounding hides it.
    """
    missed = old.product + product - old.eigenvalue * (old.mode + mode)
    eigenvalue, change, square = totals([mode * product, (mode - old.mode) * missed, mode**2])
    point = _Point(mode, product, eigenvalue / jnp.where(square > 0, square, 1))
    return point, (change <= 0) & (square > 0)


def _begin(cone: AdmissibleCone, start: Field) -> Iteration[_State]:
    """Return a start before its first step."""
    nothing, zero = jnp.zeros_like(start), jnp.zeros((), start.dtype)
    # The first step begins at the projected start, as if that were where the last step led.
    point, none = _Point(nothing, nothing, zero), jnp.array(0)
    state = _State(point, cone.project(start), nothing, nothing, jnp.array(True), none)
    unknown = jnp.finfo(start.dtype).max.astype(start.dtype)
    history = History.empty(["residual"], start.dtype)
    history = history.record(none, none, {"residual": jnp.full_like(zero, jnp.nan)})
    return Iteration(state, unknown, none, RESULTS.max_steps_reached, history)


def _lower(
    operator: SymmetricOperator, cone: AdmissibleCone, point: _Point, state: _State
) -> _Trial:
    """Return the lowest Ritz vector around a point, if that can be brought onto the cone below
    the point, or part of the way to it.
    """
    face = cone.face(jnp.maximum(point.mode, state.descended))
    residual = face.project(point.product - point.eigenvalue * point.mode)
    precondition = operator.preconditioner(point.mode, point.eigenvalue)
    steepest = face.project(precondition(residual))
    basis = [point.mode, steepest, state.move]
    products = [point.product, operator(steepest), state.move_product]
    gram, energies, squares = _inner_products(basis, products)
    parts = rayleigh_ritz(gram, energies, 1)[1][:, 0]
    parts *= jnp.where(gram[0] @ parts < 0, -1, 1)
    stays, moves = parts.at[1:].set(0), parts.at[0].set(0)
    # Combined products have no digits left where the basis reaches into stiff points, nor that of
    # a tiny difference.
    lengths = jnp.sqrt(jnp.diagonal(gram))
    move = lengths[-1]
    is_tiny = (move > 0) & (move < jnp.sqrt(jnp.finfo(move.dtype).eps))
    is_rough = is_tiny | jnp.any(jnp.sqrt(squares) > operator.scale * lengths)

    def attempt(trial: _Trial) -> _Trial:
        part = stays + trial.length * moves
        part /= jnp.sqrt(part @ gram @ part)
        vector = combination(part, basis)
        is_new = is_rough | jnp.any(cone.one_sided & (vector < 0))

        def projected() -> tuple[Array, Array]:
            mode = model.onto_sphere(cone.project(vector))
            return mode, operator(mode)

        mode, product = jax.lax.cond(
            is_new, projected, lambda: (vector, combination(part, products))
        )
        tried, is_lower = _compared(point, mode, product)
        return _Trial(
            point=tried,
            is_lower=is_lower,
            length=trial.length / 3,
            num_tries=trial.num_tries + 1,
            num_applications=trial.num_applications + is_new,
        )

    none = jnp.array(0)
    return jax.lax.while_loop(
        lambda trial: ~trial.is_lower & (trial.num_tries < _MAX_TRIES),
        attempt,
        _Trial(point, jnp.array(False), jnp.ones_like(point.eigenvalue), none, none),
    )
