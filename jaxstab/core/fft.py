"""Fourier transforms of real fields, on one device or sharded over several by rows.

Each device transforms its rows of the field, exchanges them for columns of the spectrum by one
`all_to_all`, and transforms these. No device holds a whole field. The half spectrum has its axes
swapped, so that it is sharded along its first axis as fields are. Modes of multiplicity zero fill
it up to a multiple of the number of devices.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.sharding import AbstractMesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Complex

from jaxstab.core.checks import with_automatic_mesh
from jaxstab.core.types import Field


def transform(field: Field, sharding: NamedSharding | None) -> Complex[Array, " *modes"]:
    """Return the half spectrum of a field, sharded by rows if the field is."""
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
    """Return the field of a given shape from its half spectrum."""
    if sharding is None:
        return jnp.fft.irfftn(modes, s=shape)
    axis = sharding.spec[0]

    def transform_columns(columns: Array) -> Array:
        waves = jax.lax.all_to_all(jnp.fft.ifft(columns), axis, 1, 0, tiled=True)
        return jnp.fft.irfft(waves.T, shape[1])

    return _on_parts(transform_columns, sharding)(modes)


def num_waves(num_points: int, sharding: NamedSharding | None) -> int:
    """Return the number of modes along the last side of a half spectrum, with repeated ones."""
    num_modes = num_points // 2 + 1
    if sharding is None:
        return num_modes
    num_devices = sharding.mesh.shape[sharding.spec[0]]
    return -(-num_modes // num_devices) * num_devices


def automatic_sharding(sharding: object, shape: tuple[int, ...]) -> NamedSharding:
    """Return the sharding of fields of a shape, on axes that the compiler propagates.

    Raises:
        TypeError: for anything but a `NamedSharding` on a mesh of devices.
        ValueError: for a line, another spec, or a first side that the devices do not divide.
    """
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
    # With explicit axes every operation would have to state the sharding of its result.
    return NamedSharding(with_automatic_mesh(sharding).mesh, PartitionSpec(first))


def _on_parts(
    function: Callable[[Array], Array], sharding: NamedSharding
) -> Callable[[Array], Array]:
    spec = sharding.spec
    return jax.shard_map(function, mesh=sharding.mesh, in_specs=spec, out_specs=spec)
