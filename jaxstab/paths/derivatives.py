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
from jaxstab.core.types import Flag, Scalar
from jaxstab.loads import Load
from jaxstab.paths.curve.limit_derivatives import differentiable_value
from jaxstab.paths.path import Jump, Path


def with_derivatives(
    others: tuple[Array | None, ...], contact: Contact, load: Load, path: Path
) -> Path:
    """Return a path with derivatives of the loads of its jumps; all others are NaN."""
    if not is_traced((contact, load)):
        return path
    jumps = path.jumps

    def value(jump: Jump) -> Scalar:
        shared, ahead = load[0].at(jump.load.value), jump.after.load.value - jump.load.value
        return differentiable_value(shared, jump.before.gap, ahead, contact)

    values = jax.lax.map(value, jumps)
    numbers, rest = eqx.partition(path, eqx.is_inexact_array)
    path = eqx.combine(attach(_undefined, numbers, None, (contact, load, others)), rest)
    return replace(path, jumps=replace(path.jumps, load=jumps.load.at(values)))


def _undefined(path: Path, _: None, inputs: Any, changes: Any) -> tuple[Path, Flag]:
    return jax.tree.map(jnp.zeros_like, path), jnp.array(True)
