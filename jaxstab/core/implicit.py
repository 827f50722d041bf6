"""Derivatives of solutions, by the implicit function theorem.

Under a small change the points in contact stay there, and the free ones stay free. On the free
points (K + D) dg = -d(K u + p0 + f') at a fixed gap. The same operator, less an eigenvalue, moves a
mode.

Solvers run without derivatives; `attach` adds them to the solution. A derivative that does not
exist is NaN in both modes, and zero if nothing changes: a tangent, or in reverse mode a cotangent,
of zero. So a batch entry without a derivative leaves the others as they are.
"""

from collections.abc import Callable
from functools import partial, wraps
from typing import Concatenate, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, PyTree

from jaxstab.core.checks import is_traced
from jaxstab.core.compile import own_conventions
from jaxstab.core.types import Flag

Given = ParamSpec("Given")
Tree = TypeVar("Tree")
# A rule maps values, constants, inputs and tangents of the inputs (None for a zero one) to the
# tangents of the values, linearly, and to flags of undefined derivatives: one for all or for each.
Rule = Callable[[PyTree, PyTree, PyTree, PyTree], tuple[PyTree, PyTree]]


def where_traced(
    with_derivatives: Callable[Concatenate[Tree, PyTree, Given], Tree],
) -> Callable[Concatenate[Tree, PyTree, Given], Tree]:
    """Return a function that attaches derivatives to a solution, given its inputs.

    Where JAX traces no input, it returns the solution as it is.
    """

    @wraps(with_derivatives)
    def call(solution: Tree, inputs: PyTree, *args: Given.args, **kwargs: Given.kwargs) -> Tree:
        if not is_traced(inputs):
            return solution
        return with_derivatives(solution, inputs, *args, **kwargs)

    return call


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def attach(rule: Rule, values: Tree, known: PyTree, inputs: PyTree) -> Tree:
    """Attach derivatives to the solution of a solver, as a function of the solver's inputs.

    Arguments:
        rule: the tangents of the values. They must be finite also without a solution, since zero
            times infinity is NaN.
        values: the solution, floating-point arrays.
        known: constants of the rule.
        inputs: the arguments that the values depend on.
    """
    # Reverse mode drops the rule in a loop, once the first derivative is taken: the second one is
    # NaN rather than wrong.
    return _without_slopes(values, eqx.filter(inputs, eqx.is_inexact_array))


# A program of its own too.
@own_conventions()
@jax.jit
def _without_slopes(values: Tree, inputs: PyTree) -> Tree:
    """Return values whose derivatives with respect to the inputs are NaN."""
    zero = sum(map(_zero_without_slope, jax.tree.leaves(inputs)))
    return jax.tree.map(lambda value: value + jnp.asarray(zero, value.dtype), values)


def _zero_without_slope(leaf: Array) -> Array:
    """Return a zero whose derivative is NaN."""
    return jnp.sqrt(jnp.sum(0 * jnp.where(jnp.isfinite(leaf), leaf, 0)))


@partial(attach.defjvp, symbolic_zeros=True)
def _differentiate(rule: Rule, primals: tuple, tangents: tuple) -> tuple[Tree, Tree]:
    _, known, inputs = primals
    values = attach(rule, *primals)
    changes = eqx.filter(
        tangents[2],
        lambda tangent: not isinstance(tangent, SymbolicZero),
    )
    return values, _changes(rule, values, known, inputs, changes)


# A program of its own, so that few programs run where derivatives are taken outside of `jax.jit`.
@own_conventions()
@partial(jax.jit, static_argnums=0)
def _changes(rule: Rule, values: Tree, known: PyTree, inputs: PyTree, changes: PyTree) -> Tree:
    moved, is_undefined = rule(values, known, inputs, changes)

    def with_nan(undefined: Flag, moved: Tree) -> Tree:
        def cause(change: Array | None, leaf: Array) -> Array | None:
            if change is None:
                return None
            # The factor depends on the input, so that second derivatives are NaN too.
            factor = jnp.where(jnp.isfinite(leaf), leaf, 0)
            return jnp.sum(nan_if(undefined, change) * factor)

        causes = jax.tree.leaves(jax.tree.map(cause, changes, inputs, is_leaf=_is_none))

        def defined_leaf(leaf: Array) -> Array:
            total = sum((x.astype(leaf.dtype) for x in causes), jnp.zeros((), leaf.dtype))
            return nan_if(undefined, jnp.where(undefined, total, leaf))

        return jax.tree.map(defined_leaf, moved)

    return jax.tree.map(with_nan, is_undefined, moved)


def nan_where(is_undefined: Flag, cause: Array, effect: Array) -> Array:
    """Return an effect, linear in its cause, or NaN if undefined and the cause is nonzero."""
    return jnp.where(is_undefined & jnp.any(cause != 0), jnp.nan, effect)


def nan_if(is_undefined: Flag, change: Array) -> Array:
    """Return a tangent or a cotangent, or NaN if it is undefined and nonzero."""
    # JAX takes this for a linear function that is its own transpose.
    return jax.lax.custom_linear_solve(
        lambda x: x, change, lambda _, b: nan_where(is_undefined, b, b), symmetric=True
    )


def no_derivatives(values: Tree, _: PyTree, inputs: PyTree, changes: PyTree) -> tuple[Tree, Flag]:
    """Return no derivatives: a rule for `attach`."""
    return jax.tree.map(jnp.zeros_like, values), jnp.array(True)


def refuse_derivatives(tree: Tree) -> Tree:
    """Return `tree`, and raise where its derivatives are taken."""
    return _without_derivatives(tree)  # pyright: ignore[reportReturnType]


@jax.custom_jvp
def _without_derivatives(tree: Tree) -> Tree:
    return tree


@_without_derivatives.defjvp
def _refuse(primals: tuple[Tree], tangents: tuple[Tree]) -> tuple[Tree, Tree]:
    raise NotImplementedError(
        "lowest_modes and continuation cannot be differentiated: apply "
        "jax.lax.stop_gradient to the arguments, or take the derivatives of equilibrate, "
        "assess_stability or critical_load."
    )


def tangent_of(function: Callable[..., Tree], inputs: tuple, changes: tuple) -> Tree:
    """Return the tangent of a function, given tangents of its inputs, None for a zero one."""
    is_moving = jax.tree.map(lambda change: change is not None, changes, is_leaf=_is_none)
    moving, still = eqx.partition(inputs, is_moving)
    return jax.jvp(lambda moved: function(*eqx.combine(moved, still)), (moving,), (changes,))[1]


def _is_none(leaf: object) -> bool:
    return leaf is None


def finite(is_found: Flag, tree: Tree) -> Tree:
    """Return a tree unchanged, or with placeholders for its numbers if there is no solution.

    The placeholders are valid parameters of a law or a solid, and a field without symmetry.
    """

    def choose(leaf: Array) -> Array:
        if not jnp.issubdtype(leaf.dtype, jnp.floating):
            return leaf
        places = jnp.arange(leaf.size, dtype=leaf.dtype).reshape(leaf.shape)
        return jnp.where(is_found, leaf, 0.25 + 0.05 * jnp.cos(places))

    return jax.tree.map(choose, tree)
