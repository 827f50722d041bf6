"""The smallest eigenvalue on a cone: LOBPCG on its faces, or else projected gradients."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.grid import total
from jaxstab.hessian import Block, SymmetricOperator
from jaxstab.iterate import History, Indicators, Iteration, IterativeSolver, optional_parameter
from jaxstab.lanes import by_lanes
from jaxstab.results import RESULTS
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpairs import Minimiser, descended, projected_residual, unit_vector
from jaxstab.stability.lobpcg import combine, inner_products, normalised, norms, rayleigh_ritz

# Steps in each round of the competition between starts, and how many may go on to the next.
_ROUNDS = ((4, 12), (8, 3), (10, 3), (15, 3), (25, 3), (40, 3), (60, 3))
# The inner product from which two unit vectors are taken to lead to the same minimiser.
_SAME = 0.95
# Lengths of a step, each a third of the last, before it is given up.
_MAX_TRIES = 4


class _Point(eqx.Module):
    mode: Float[Array, " *grid"]
    product: Float[Array, " *grid"]
    eigenvalue: Float[Array, ""]

    @classmethod
    def at(cls, operator: SymmetricOperator, mode: Float[Array, " *grid"]) -> "_Point":
        product = operator(mode)
        return cls(mode, product, jnp.sum(mode * product))


class _State(eqx.Module):
    point: _Point
    descended: Float[Array, " *grid"]
    move: Float[Array, " *grid"]
    move_product: Float[Array, " *grid"]
    is_stuck: Bool[Array, ""]
    num_applications: Int[Array, ""]

    @classmethod
    def after(
        cls,
        operator: SymmetricOperator,
        cone: AdmissibleCone,
        old: _Point,
        new: _Point,
        is_stuck: Array,
        num_applications: Array,
    ) -> "_State":
        descent = descended(operator, new.mode, new.product, new.eigenvalue)
        along = jnp.sum(new.mode * old.mode)
        move = new.mode - along * old.mode
        move_product = new.product - along * old.product
        moved = cone.project(descent)
        return cls(new, moved, move, move_product, is_stuck, num_applications)


class _Trial(eqx.Module):
    point: _Point
    is_lower: Bool[Array, ""]
    length: Float[Array, ""]
    num_tries: Int[Array, ""]
    num_applications: Int[Array, ""]


class ProjectedLOBPCG(IterativeSolver):
    """Locally optimal conjugate gradients on the faces of a cone, from several starts.

    A step goes to the lowest Ritz vector of x, its last move, and its residual, preconditioned on
    the face where x and the nearest vector of the cone to y = x - (A x - lambda x) / b lie, b the
    bound on |A|. It is projected back onto the cone, and taken if that lowers the Rayleigh
    quotient, or part of the way. Where it does not, the next step begins at y on the cone, which
    never raises the quotient. Starts compete in rounds: one that is alike a lower one, or above
    the lowest by more than its residual, is taken to be beaten; after two rounds three may go on.
    The best is a local minimiser.

    Arguments:
        tolerance: the projected residual |x - P(x - (A x - lambda x) / b)| b / s of a unit vector
            to reach, P the projection onto the cone, b the bound on |A| and s its size on the
            lower modes; by default 1e-7 in float64 and 1e-5 in float32.
        max_steps: the step limit of the last part, 5000 by default.
    """

    tolerance: Float[Array, ""] | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=5000)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-7, "float32": 1e-5}
    patience: ClassVar[int] = 300

    def solve(self, operator: SymmetricOperator, cone: AdmissibleCone, starts: Block) -> Minimiser:
        """Return the best minimiser of the Rayleigh quotient that the starts lead to.

        Arguments:
            operator: A.
            cone: where perturbations must lie.
            starts: vectors to start from, each brought onto the cone.
        """

        def compete(
            starts: Iteration[_State], limits: tuple[Array, Array]
        ) -> tuple[Iteration[_State], Iteration[_State]]:
            max_steps, num_kept = limits
            solver = ProjectedLOBPCG(self.tolerance, max_steps)
            lanes = jax.vmap(by_lanes(_descend), (None, None, None, 0))
            found: Iteration[_State] = lanes(solver, operator, cone, starts)
            places = _places(found, operator, cone)
            best = jax.tree.map(lambda leaf: leaf[jnp.argmin(places)], found)
            # From NaN, a lane ends at once.
            stop = jax.vmap(lambda place, field: jnp.where(place < num_kept, field, jnp.nan))
            kept = stop(places, found.state.descended)
            return replace(found, state=replace(found.state, descended=kept)), best

        first = jax.vmap(partial(_start, operator, cone))(starts)
        max_steps, num_kept = zip(*_ROUNDS, strict=True)
        max_steps = jnp.append(jnp.minimum(jnp.array(max_steps), self.max_steps), self.max_steps)
        all_found, bests = jax.lax.scan(compete, first, (max_steps, jnp.array([*num_kept, 1])))
        best = jax.tree.map(lambda leaf: leaf[-1], bests)
        point = best.state.point
        return Minimiser(
            # Brought onto the cone, once, this is exactly zero where the contact holds.
            vector=descended(operator, point.mode, point.product, point.eigenvalue),
            num_steps=jnp.sum(all_found.num_steps),
            num_applications=jnp.sum(all_found.state.num_applications),
            result=best.result,
            history=best.history,
        )


def _places(
    found: Iteration[_State], operator: SymmetricOperator, cone: AdmissibleCone
) -> Float[Array, " starts"]:
    """Return the place of each start, from 0 for the lowest; inf for those beaten."""
    modes = found.state.point.mode
    is_empty = jnp.all(modes == 0, axis=range(1, modes.ndim))
    is_out = jnp.isnan(found.residual) | (is_empty & ~cone.is_trivial)
    lowest = jnp.where(is_out | is_empty, jnp.inf, found.state.point.eigenvalue)
    is_alike = inner_products(modes, modes) > _SAME
    order = _order(lowest)
    is_copy = jnp.any((order[:, None] < order) & is_alike, axis=0)
    is_higher = lowest - operator.scale * found.residual > jnp.min(lowest)
    is_beaten = is_out | is_copy | is_higher
    return jnp.where(is_beaten, jnp.inf, _order(jnp.where(is_beaten, jnp.inf, lowest)))


def _order(values: Float[Array, " starts"]) -> Int[Array, " starts"]:
    """Return how many values come before each one, ties in the order they have."""
    return jnp.argsort(jnp.argsort(values))


def _start(
    operator: SymmetricOperator, cone: AdmissibleCone, start: Float[Array, " *grid"]
) -> Iteration[_State]:
    point = _Point.at(operator, unit_vector(cone, start))
    state = _State.after(operator, cone, point, point, jnp.array(False), jnp.array(1))
    residual = projected_residual(operator, point.mode, state.descended)
    history = History.empty({"residual": residual})
    return Iteration(state, residual, jnp.array(0), RESULTS.max_steps_reached, history)


def _descend(
    solver: ProjectedLOBPCG,
    operator: SymmetricOperator,
    cone: AdmissibleCone,
    start: Iteration[_State],
) -> Iteration[_State]:
    """Return what one start leads to."""

    def step(state: _State) -> _State:
        point = jax.lax.cond(
            state.is_stuck,
            lambda: _Point.at(operator, normalised(state.descended[None])[0]),
            lambda: state.point,
        )
        trial = _lower(operator, cone, point, state)
        point = jax.tree.map(partial(jnp.where, trial.is_lower), trial.point, point)
        num_applications = state.num_applications + state.is_stuck + 2 + trial.num_applications
        return _State.after(operator, cone, state.point, point, ~trial.is_lower, num_applications)

    def measure(state: _State) -> Indicators:
        return {"residual": projected_residual(operator, state.point.mode, state.descended)}

    return solver.iterate(step, measure, start.state, start)


def _lower(
    operator: SymmetricOperator, cone: AdmissibleCone, point: _Point, state: _State
) -> _Trial:
    """Return the lowest Ritz vector around a point, if that can be brought onto the cone below
    the point, or part of the way to it.
    """
    face = cone.face(jnp.maximum(point.mode, state.descended))
    residual = face.project(point.product - point.eigenvalue * point.mode)
    steepest = operator.precondition(residual, point.mode, point.eigenvalue)
    steepest = normalised(face.project(steepest)[None])[0]
    basis = jnp.stack([point.mode, steepest, state.move])
    products = jnp.stack([point.product, operator(steepest), state.move_product])
    _, parts = rayleigh_ritz(basis, products, 1)
    parts *= jnp.where(total(combine(parts, basis)[0] * point.mode) < 0, -1, 1)
    stays, moves = parts.at[1:].set(0), parts.at[0].set(0)
    # Combined products have no digits left where the basis reaches into stiff points, nor that of
    # a tiny difference.
    lengths = norms(basis)
    is_tiny = (lengths > 0) & (lengths < jnp.sqrt(jnp.finfo(lengths.dtype).eps))
    is_rough = jnp.any(is_tiny | (norms(products / operator.scale) > lengths))

    def attempt(trial: _Trial) -> _Trial:
        part = stays + trial.length * moves
        vector, product = combine(part, basis)[0], combine(part, products)[0]
        norm = jnp.sqrt(jnp.sum(vector**2))
        is_new = is_rough | jnp.any(cone.one_sided & (vector < 0))
        tried = jax.lax.cond(
            is_new,
            lambda: _Point.at(operator, unit_vector(cone, vector)),
            lambda: _Point(vector / norm, product / norm, jnp.sum(vector * product) / norm**2),
        )
        return _Trial(
            point=tried,
            # Zero may be the nearest vector of the cone.
            is_lower=(tried.eigenvalue <= point.eigenvalue) & jnp.any(tried.mode != 0),
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
