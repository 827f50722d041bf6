"""The zeros that an instrument adds to the loads and forces of a contact."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxstab.calibration.least_squares import Curve, Rows, Values
from jaxstab.core.checks import array
from jaxstab.core.types import Scalar
from jaxstab.loads import Load

# The zero of the loads, that of the forces with its slope, and how far the zero of the loads moves.
KINDS = ("offset", "baseline", "tilt", "drift")


class Zeros(eqx.Module):
    """The zeros of loads and forces, which are unknowns of a fit.

    A force F(load) is measured as F + e, with the baseline e = baseline + tilt x at a height x. The
    load is measured as load + offset + drift t, and as larger by e / k if it is the position of a
    tip, which follows from the force.

    Attributes:
        heights: x [loads].
        is_in: a mask for each baseline, of the measurements that have it [baselines, loads].
        clocks: t, which grows by one from the first measurement to the last [loads].
        compliance: 1 / k of a tip position, zero for loads that do not follow from the force.
        drift_error: the standard error of a drift that is not fitted, None of one that is.
        segments: the names of segments with baselines of their own, empty if there is one baseline.
    """

    heights: Curve
    is_in: Bool[Array, "baselines loads"]
    clocks: Curve
    compliance: Scalar
    drift_error: Scalar | None
    segments: tuple[str, ...] = eqx.field(static=True, default=())

    @classmethod
    def over(cls, load: Load) -> "Zeros":
        """Return the zeros of measurements with one baseline, a line over the load."""
        number = load.value.size
        zero = array(0.0)
        is_in = array(np.ones((1, number), bool))
        return cls(load.value, is_in, array(np.zeros(number)), zero, zero)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kind of each zero."""
        return tuple(map(kind_of, self.names))

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each zero: its kind, after its segment if each has a baseline of its own."""
        before = [f"{segment}." for segment in self.segments] or [""]
        baselines = [f"{segment}baseline" for segment in before]
        tilts = [f"{segment}tilt" for segment in before]
        return "offset", *baselines, *tilts, "drift"

    def by_kind(self, numbers: Values) -> dict[str, Array]:
        """Return numbers, one for each zero, by kind: one for each segment of several baselines."""
        count = len(self.is_in)
        offset, baseline, tilt, drift = jnp.split(numbers, np.cumsum([1, count, count]))
        if not self.segments:
            baseline = baseline[0]
            tilt = tilt[0]
        return dict(zip(KINDS, (offset[0], baseline, tilt, drift[0]), strict=True))

    def responses(self) -> tuple[Rows, Rows]:
        """Return the changes of the loads and of the forces for one unit of each zero."""
        levels = jnp.where(self.is_in.T, 1.0, 0.0)
        lines = jnp.concatenate([levels, levels * self.heights[:, None]], axis=1)
        ones = jnp.ones_like(lines[:, :1])
        loads = jnp.concatenate([ones, self.compliance * lines, self.clocks[:, None]], axis=1)
        return loads, jnp.pad(lines, ((0, 0), (1, 1)))


def kind_of(name: str) -> str:
    """Return the kind of a zero, the last part of its name."""
    return name.rpartition(".")[-1]
