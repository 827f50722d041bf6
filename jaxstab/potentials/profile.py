"""A law over all gaps, and the check that it is smooth enough to be solved."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.checks import require, where_known
from jaxstab.core.compile import program
from jaxstab.core.types import Flag, Scalar
from jaxstab.potentials.evaluation import derivatives
from jaxstab.potentials.varying import Potential, varying_fields, with_fields

# Gaps run from the largest to the smallest, as multiples of the size of the grid.
_OCTAVES = (10, -40)
_PER_OCTAVE = 64
# The relative difference of the slopes at zero gap and right above it that counts as a jump.
_JUMP = 0.25
# An attraction below this part of the largest one is taken for none: surfaces are far apart.
HARDLY_ANY = 1e-3
# A repulsion at zero gap below this part of the largest attraction is taken for none.
_NO_REPULSION = 1e-3
# A repulsion that has fallen by this factor over an octave of gaps has faded.
_FADED = 1e-12
# The number of surface points at which a varying law is evaluated, beside its extremes.
_NUM_POINTS = 64


class Profile(eqx.Module):
    """A potential at gaps from a thousand times the size of a grid to a trillionth of it, and zero.

    A law that varies over the surface is represented by extremes over many of its points: the least
    value, the largest slope and the curvature of the largest magnitude.

    Attributes:
        gaps: from the largest to the smallest [length].
        values: f [energy/area].
        slopes: f' [pressure].
        curvatures: f'' [pressure/length].
        has_core: whether f is infinite at zero gap, and positive and repulsive at small gaps.
        contact_gap: the first of these gaps beyond the largest attraction of a law that repels at
            zero gap; the largest over the points; zero for any other law [length].
        repels_throughout: whether f' is negative at all gaps, or fades to zero beyond all bounds.
        range: the length over which the attraction varies, the largest f' over the largest |f''|
            at these gaps where f attracts; infinite without attraction [length].
    """

    gaps: Float[Array, " gaps"]
    values: Float[Array, " gaps"]
    slopes: Float[Array, " gaps"]
    curvatures: Float[Array, " gaps"]
    has_core: Flag
    contact_gap: Scalar
    repels_throughout: Flag
    range: Scalar

    def __init__(self, potential: Potential, lengths: Float[Array, "..."]):
        self.gaps = gaps_of(lengths)
        values, slopes, curvatures = derivatives(at_some_points(potential), self.gaps)
        # A law may be undefined at gaps that are larger than the grid.
        counts = (slopes >= 0) & jnp.isfinite(curvatures)
        sharpest = jnp.max(jnp.where(counts, jnp.abs(curvatures), 0))
        contact_gaps, repel = jax.vmap(self._contact_gap)(jnp.atleast_2d(slopes))
        self.contact_gap = jnp.max(contact_gaps)
        self.repels_throughout = jnp.any(repel)
        if values.ndim == 2:
            values = jnp.min(values, 0)
            slopes = jnp.max(slopes, 0)
            strongest = jnp.argmax(jnp.abs(curvatures), 0)
            curvatures = jnp.take_along_axis(curvatures, strongest[None], 0)[0]
        self.values = values
        self.slopes = slopes
        self.curvatures = curvatures
        finite = jnp.isfinite(self.values) & jnp.isfinite(self.slopes)
        last = jnp.max(jnp.where(finite, jnp.arange(finite.size), 0))
        rises = (self.values[last] > 0) & (self.slopes[last] < 0)
        self.has_core = rises & ~jnp.isfinite(self.values[-1])
        is_curved = (self.max_attraction > 0) & (sharpest > 0)
        self.range = jnp.where(
            is_curved, self.max_attraction / jnp.where(is_curved, sharpest, 1), jnp.inf
        )

    def _contact_gap(self, slopes: Float[Array, " gaps"]) -> tuple[Scalar, Flag]:
        """Return `contact_gap` and `repels_throughout` of a law, from its slopes."""
        at_zero = slopes[-1]
        slopes = jnp.where(jnp.isfinite(slopes), slopes, -jnp.inf)
        # The innermost of equal ones.
        peak = slopes.size - 1 - jnp.argmax(slopes[::-1])
        largest = slopes[peak]
        # The slope of a core may be no number at zero gap.
        repels = ~(at_zero >= -_NO_REPULSION * jnp.maximum(largest, 0))
        # A law that ends at a gap falls to zero there by a power of the distance.
        fades = slopes[peak + 1] >= _FADED * slopes[peak + _PER_OCTAVE]
        throughout = repels & ((largest < 0) | ((largest == 0) & fades))
        gap = self.gaps[jnp.maximum(peak - 1, 0)]
        return jnp.where(repels & ~throughout, gap, 0), throughout

    @property
    def max_attraction(self) -> Scalar:
        """The largest f' [pressure]."""
        return jnp.max(jnp.where(jnp.isfinite(self.slopes), self.slopes, 0))

    @property
    def repels_far(self) -> Flag:
        """Whether f' is negative at the largest gap at which it is not zero."""
        return self.slopes[jnp.argmax(self.slopes != 0)] < 0

    @property
    def outermost_attraction(self) -> Scalar:
        """The largest gap at which f' is positive, or zero [length]."""
        return jnp.max(jnp.where(self.slopes > 0, self.gaps, 0))

    def outermost_gap(self, attraction: Scalar) -> Scalar:
        """Return the largest gap at which f' is not below an attraction, or zero [length]."""
        return jnp.max(jnp.where(self.slopes >= attraction, self.gaps, 0))


profile_of = program(Profile)


def gaps_of(lengths: Float[Array, "..."]) -> Float[Array, " gaps"]:
    """Return gaps at which to evaluate a law, in falling order, and zero [length]."""
    size = jnp.max(lengths)
    first, last = _OCTAVES
    octaves = np.linspace(first, last, (first - last) * _PER_OCTAVE + 1)
    return size * jnp.asarray(np.append(2.0**octaves, 0), size.dtype)


def at_some_points(potential: Potential) -> Potential:
    """Return a varying law at a sample of points of the surface and at its extremes."""
    fields = varying_fields(potential)
    if not fields:
        return potential
    flat = [field.ravel() for field in jnp.broadcast_arrays(*fields)]
    size = flat[0].size
    _, slopes, curvatures = derivatives(with_fields(potential, flat), jnp.zeros_like(flat[0]))
    numbers = [*flat, jnp.nan_to_num(slopes), jnp.nan_to_num(jnp.abs(curvatures))]
    extreme = [pick(values) for values in numbers for pick in (jnp.argmin, jnp.argmax)]
    spread = np.linspace(0, size - 1, min(size, _NUM_POINTS)).astype(int)
    chosen = jnp.concatenate([jnp.asarray(spread), jnp.stack(extreme)])
    return with_fields(potential, [field[chosen][:, None] for field in flat])


def innermost_gap(profile: Profile) -> float:
    """Return the gap of least energy of a law with a core, zero for any other law [length]."""
    if not profile.has_core:
        return 0.0
    return float(profile.gaps[np.nanargmin(profile.values)])


@where_known
def require_smooth(profile: Profile) -> None:
    """Raise `ValueError` if a known law is not smooth enough to be solved.

    The law and its first two derivatives must be finite at gaps up to the size of the grid, except
    inside of a core. A slope that jumps at zero gap, where contact points are, is refused, and so
    is a piecewise linear law.
    """
    profile = jax.tree.map(np.asarray, profile)
    innermost = innermost_gap(profile)
    fields = {"": profile.values, " slope": profile.slopes, " curvature": profile.curvatures}
    # A derivative is NaN where the energy is not: the usual cause is a branch that is not selected.
    needed = "with its first two derivatives it must be finite there"
    branch = (
        f"{needed}. The energy itself is finite: JAX differentiates both branches of jnp.where, "
        "and a NaN of the one that is not selected spoils the derivative. Give that branch a "
        "harmless gap, as in jnp.where(is_near, f(jnp.where(is_near, gap, 1.0)), 0.0)."
    )
    at_zero = (
        f"{needed}, or else rise without bound as the gap closes. An Electrostatic law needs a "
        "`dielectric`."
    )
    for name, field in fields.items():
        is_sound = np.isfinite(field[-1]) | profile.has_core
        is_branch = np.isnan(field[-1]) and np.isfinite(profile.values[-1])
        cure = branch if is_branch else at_zero
        require(f"The potential's{name} value at zero gap", field[-1], is_sound, cure)

    matters = (profile.gaps >= innermost) & (profile.gaps <= profile.gaps[0] / 2.0 ** _OCTAVES[0])
    for name, field in fields.items():
        undefined = matters & ~np.isfinite(field)
        if undefined.any():
            gap = profile.gaps[undefined][-1]
            value = field[undefined][-1]
            is_branch = np.isnan(value) and np.isfinite(profile.values[undefined][-1])
            cure = branch if is_branch else f"{needed}."
            if profile.gaps.dtype == np.float32:
                cure += (
                    " In single precision a formula can leave the range where its value does not: "
                    "use `float64`, or write it by ratios of lengths."
                )
            raise ValueError(
                f"The potential's{name} value at a gap of {gap:.6g} is {value}: {cure}"
            )

    # A change of the slope below these may be a curvature that underflows.
    steps = -np.diff(profile.gaps) * np.finfo(profile.gaps.dtype).tiny
    jumps = not profile.curvatures.any() and np.abs(np.diff(profile.slopes)) > steps
    if np.any(jumps):
        raise ValueError(
            "The potential is piecewise linear: its curvature is zero at every gap, while its "
            "slope jumps, from "
            f"{profile.slopes.min():.6g} to {profile.slopes.max():.6g}. Give a smooth fit of it, "
            "as a spline of third order."
        )

    if profile.has_core:
        return
    above, at_zero = profile.slopes[-2:]
    bends = 2 * profile.gaps[-2] * np.abs(profile.curvatures[-2:]).max()
    jump = np.abs(above - at_zero) - bends
    if jump > _JUMP * max(abs(above), abs(at_zero)):
        raise ValueError(
            f"The potential's slope is {at_zero:.6g} at zero gap and {above:.6g} right above it, "
            "so contact points would feel another attraction than their neighbours. Gaps are never "
            "negative: leave out jnp.maximum(gap, 0), jnp.clip, jax.nn.relu or jnp.where that "
            "change there, whose derivatives at zero are halved or none."
        )
