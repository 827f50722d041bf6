"""Fourier transforms of real fields, on one device or spread over several by rows.

On several devices, each transforms rows of the field. It gets columns of the spectrum from the
others by one `all_to_all`, and transforms these. No device holds a whole field. The half spectrum
keeps its axes swapped, so that it is spread along its first axis as fields are. Extra rows, which
stand for no wave, make it fill all devices.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import AbstractMesh, Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Complex

from jaxstab.core.types import Field


def transform(field: Field, sharding: NamedSharding | None) -> Complex[Array, " *modes"]:
    """Return the half spectrum of a field, of which the devices hold rows if it is spread."""
    if sharding is None:
        return jnp.fft.rfftn(field)
    axis = sharding.spec[0]

    def transform_rows(rows: Array) -> Array:
        waves = jnp.fft.rfft(rows).T
        waves = jnp.pad(waves, [(0, num_waves(rows.shape[1], sharding) - len(waves)), (0, 0)])
        return jnp.fft.fft(jax.lax.all_to_all(waves, axis, 0, 1, tiled=True))

    return _on_parts(transform_rows, sharding)(field)


def inverse_transform(
    modes: Complex[Array, " *modes"], shape: tuple[int, ...], sharding: NamedSharding | None
) -> Field:
    """Return the field of a shape from its half spectrum."""
    if sharding is None:
        return jnp.fft.irfftn(modes, s=shape)
    axis = sharding.spec[0]

    def transform_columns(columns: Array) -> Array:
        waves = jax.lax.all_to_all(jnp.fft.ifft(columns), axis, 1, 0, tiled=True)
        return jnp.fft.irfft(waves.T, shape[1])

    return _on_parts(transform_columns, sharding)(modes)


def num_waves(num_points: int, sharding: NamedSharding | None) -> int:
    """Return how many waves along the last side a half spectrum holds."""
    count = 1 if sharding is None else sharding.mesh.shape[sharding.spec[0]]
    return -(-(num_points // 2 + 1) // count) * count


def with_leading_axes(leading: int, sharding: NamedSharding) -> NamedSharding:
    """Return the sharding of a stack of fields, with a number of axes before theirs."""
    return NamedSharding(sharding.mesh, PartitionSpec(*(None,) * leading, *sharding.spec))


def checked(sharding: Any, shape: tuple[int, ...]) -> NamedSharding:
    """Return the sharding of fields of a shape, left to the compiler outside of transforms."""
    if not isinstance(sharding, NamedSharding) or isinstance(sharding.mesh, AbstractMesh):
        raise TypeError(
            f"The sharding is {sharding!r}: give a jax.sharding.NamedSharding on a mesh of devices."
        )
    if len(shape) != 2:
        raise ValueError(f"A line of {shape[0]} points stays on one device: leave out `sharding`.")
    first, *others = [*sharding.spec, None]
    if not isinstance(first, str) or any(other is not None for other in others):
        raise ValueError(
            f"The spec of the sharding is {sharding.spec}: give one axis of the mesh, over the "
            'first side, as in jax.sharding.PartitionSpec("x").'
        )
    if shape[0] % (count := sharding.mesh.shape[first]):
        raise ValueError(
            f"{shape[0]} points along the first side cannot be divided among {count} devices: give "
            "a multiple."
        )
    # On explicit axes every operation would have to say how its result is spread.
    mesh = Mesh(sharding.mesh.devices, sharding.mesh.axis_names)
    return NamedSharding(mesh, PartitionSpec(first))


def _on_parts(
    function: Callable[[Array], Array], sharding: NamedSharding
) -> Callable[[Array], Array]:
    spec = sharding.spec
    return jax.shard_map(function, mesh=sharding.mesh, in_specs=spec, out_specs=spec)
