"""Derivatives of a path: the loads of its jumps have some, and nothing else has."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.contact import Contact
from jaxstab.core.checks import is_traced
from jaxstab.core.implicit import attach
from jaxstab.core.no_derivative import Obstacle
from jaxstab.core.types import Scalar
from jaxstab.loads import Load
from jaxstab.paths.branch_end.derivatives import differentiable_value
from jaxstab.paths.path import Jump, Path

_NO_DERIVATIVE = (
    "of a path only the loads of its jumps have one. Differentiate `path.jumps.load`, or an "
    "equilibrium at a load of the path, found by `equilibrate` from the path's gap there"
)


def with_derivatives(
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
