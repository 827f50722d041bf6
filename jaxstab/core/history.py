"""The history of a solver: indicators at a bounded number of steps."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from jaxstab.core.control_flow import with_entry
from jaxstab.core.display import Outcome
from jaxstab.core.types import Scalar
from jaxstab.core.units import NUMBER

Indicators = dict[str, Scalar]

_HISTORY_LENGTH = 512


class History(Outcome):
    """Indicators of a solver at a bounded number of steps: all at first, then ever sparser.

    Attributes:
        table: a row for each record, NaN where unused: the step, and the indicators by name.
        names: of the indicators, in order.

    Example:
        >>> state.history.names
        ('energy', 'residual')
    """

    table: Annotated[Float[Array, "records columns"], NUMBER]
    names: tuple[str, ...] = eqx.field(static=True)

    def __repr__(self) -> str:
        return f"History({', '.join(self.names)})"

    @property
    def stack_shape(self) -> tuple[int, ...]:
        """The leading axes of a stack of histories."""
        return self.table.shape[:-2]

    @classmethod
    def empty(cls, names: Iterable[str], dtype: DTypeLike = float) -> "History":
        """Return a history without records for indicators of these names."""
        names = tuple(sorted(names))
        return cls(jnp.full((_HISTORY_LENGTH, 1 + len(names)), jnp.nan, dtype), names)

    @property
    def steps(self) -> Float[Array, " records"]:
        """The steps that are on record."""
        return self.table[..., 0]

    @property
    def values(self) -> dict[str, Float[Array, " records"]]:
        """The indicators at these steps."""
        return {name: self.table[..., 1 + i] for i, name in enumerate(self.names)}

    def in_units_of(self, pressure: Scalar) -> "History":
        """Convert the energy among the indicators to another unit of pressure."""
        if "energy" not in self.names:
            return self
        is_energy = np.array([name == "energy" for name in ("step", *self.names)])
        factors = jnp.where(is_energy, 1 / pressure, 1).astype(self.table.dtype)
        return replace(self, table=self.table * factors)

    def record(self, count: Int[Array, ""], step: Int[Array, ""], new: Indicators) -> "History":
        """Return the history with the `count`-th measurement, taken at `step`, added.

        The first 256 measurements have a row each. Each further doubling of the count has 32 rows,
        and a row keeps the last of the measurements that share it.
        """
        # The exponent and five digits of a float make the 32 rows of each doubling.
        shared = (jax.lax.bitcast_convert_type(count.astype(jnp.float32), jnp.int32) >> 18) - 4064
        row = jnp.minimum(jnp.where(count < 256, count, shared), _HISTORY_LENGTH - 1)
        values = jnp.stack([step, *(new[name] for name in self.names)]).astype(self.table.dtype)
        return replace(self, table=with_entry(self.table, row, values))
