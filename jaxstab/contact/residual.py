"""The pressures at a gap, and how far they are from equilibrium."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core import model
from jaxstab.core.accuracy import EQUILIBRIUM
from jaxstab.core.grid import mean, totals
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.loads.load import Control
from jaxstab.potentials.evaluation import derivatives
from jaxstab.potentials.varying import Potential
from jaxstab.solids.solid import Solid

# An imbalance of this part of the elastic pressures of full contact moves no point by a part of the
# heights.
_LEAST_SCALE = 1e-2
# How much the mean of the imbalance counts beside its rms.
_MEAN_SHARE = 1e-2
# A surface is nearly flat if its heights spread by less than this part of the mean gap.
_FLAT = 1e-2


class Pressures(eqx.Module):
    """The pressures at a gap on which no load acts, and the terms of its energy.

    Attributes:
        displacement: u less its value at one point [length].
        elastic: K u [pressure].
        density: f(g) [energy/area].
        attraction: f'(g) [pressure].
        curvature: f''(g), zero where the surface yields [pressure/length].
        plastic: H z, the plastic work of the indentation z; None on a surface that does not yield
            [energy/area].
    """

    displacement: Field
    elastic: Field
    density: Field
    attraction: Field
    curvature: Field
    plastic: Field | None

    @property
    def gradient(self) -> Field:
        """K u + f'(g) [pressure]."""
        return model.gradient(self.elastic, self.attraction)

    @property
    def energy(self) -> Scalar:
        """u.Ku / 2 + sum f(g) (Rey & Bleyer, eq. 15) [energy/area]."""
        return model.energy(self.displacement, self.elastic, self.density)


class Balance(eqx.Module):
    """How far a gap is from equilibrium (Rey & Bleyer, eqs. 9 and 10).

    In equilibrium the net pressure K u + p0 + f'(g) is zero where g > 0 and not negative where g =
    0. On a surface of hardness H the gap is signed, g less the indentation z: the net pressure is
    not above H + f'(0) where it is zero, and equal to that where it is negative. The imbalance is
    the part of the net pressure that violates this. The residual is the rms of
    the imbalance over a scale. The scale is the rms of K u and, where g > 0, of the attraction that
    the load does not balance by itself. Under a held mean gap that is f' less its mean, otherwise
    f' + p0. It is at least a hundredth of the rms of K h, in single precision a tenth, since that
    resolves no less. It is at least the pressure by which rounding of the gap moves the stiffest
    wave, over the default tolerance. Where a core is stiffer than any wave, f' and the imbalance
    are scaled down by the ratio. Under a held pressure the residual is at least a hundredth of the
    mean imbalance over the mean of p0 and f'. Over a nearly flat surface it is at least the whole.

    Attributes:
        net: K u + p0 + f'(g) [pressure].
        curvature: f''(g) [pressure/length].
        elastic_energy: u.Ku / 2 (Rey & Bleyer, eq. 15) [energy/area].
        adhesion: sum f(g) [energy/area].
        plastic_work: sum H z; None on a surface that does not yield [energy/area].
        mean_gap: the mean of g - z on which the load does its work [length].
        residual: the relative optimality residual.
        has_escaped: whether the load has separated the surfaces for good.
    """

    net: Field
    curvature: Field
    elastic_energy: Scalar
    adhesion: Scalar
    plastic_work: Scalar | None
    mean_gap: Scalar
    residual: Scalar
    has_escaped: Flag

    @property
    def energy(self) -> Scalar:
        """u.Ku / 2 + sum f(g), as `Pressures.energy`, of sums that share a pass [energy/area]."""
        return self.elastic_energy + self.adhesion

    @property
    def potential(self) -> Scalar:
        """The energy and the plastic work, of which a state is a minimum [energy/area]."""
        if self.plastic_work is None:
            return self.energy
        return self.energy + self.plastic_work


def pressures_of(
    solid: Solid, heights: Field, potential: Potential, hardness: Array | None
) -> Callable[[Field], Pressures]:
    """Return the map from a gap to its pressures, with K prepared once, here.

    On a surface with a hardness the gap is signed.
    """
    K = solid.with_uniform_stiffness(0).apply
    # K ignores a constant, but loses digits to it.
    heights = _from_first(heights)

    def pressures(gap: Field) -> Pressures:
        displacement = _from_first(gap) + heights
        elastic = K(displacement)
        if hardness is None:
            return Pressures(displacement, elastic, *derivatives(potential, gap), None)
        yields = gap < 0
        density, attraction, curvature = derivatives(potential, model.open_part(gap))
        # An infinite hardness, where nothing yields, is no number to be multiplied by zero.
        plastic = jnp.where(yields, hardness, 0) * model.closed_part(gap)
        curvature = jnp.where(yields, 0, curvature)
        return Pressures(displacement, elastic, density, attraction, curvature, plastic)

    return pressures


def balance_of(
    solid: Solid,
    heights: Field,
    potential: Potential,
    hardness: Array | None,
    control: Control,
    escape: Scalar,
) -> Callable[[Field], Balance]:
    """Return the map from a gap, nowhere negative or signed, to how far it is from equilibrium."""
    pressures_at = pressures_of(solid, heights, potential, hardness)
    stiffest = solid.max_stiffness
    conforming = conforming_pressure(solid, heights)
    smallest_scale = least_scale(conforming)
    spread = jnp.max(jnp.abs(_from_first(heights)))

    def balance(gap: Field) -> Balance:
        pressures = pressures_at(gap)
        elastic = pressures.elastic
        attraction = pressures.attraction
        curvature = pressures.curvature
        net = control.net_pressure(pressures.gradient, gap)
        imbalance = control.imbalance(net, gap)
        # Between flat surfaces only attraction and p0 tell how much is little.
        whole = jnp.abs(attraction) + jnp.abs(net - elastic - attraction)
        resisting = control.resisting(attraction, gap)
        resisting = jnp.where(conforming > 0, resisting, whole)
        # On a core stiffer than any wave, a point is as far off as its own stiffness says, unless
        # that is beyond all numbers.
        ratio = jnp.where(curvature == jnp.inf, 1, stiffest / jnp.maximum(curvature, stiffest))
        squares = elastic**2 + (ratio * resisting) ** 2, (ratio * imbalance) ** 2, gap**2
        work = pressures.displacement * elastic
        fields = [work, pressures.density, gap, *squares]
        if pressures.plastic is not None:
            fields.append(pressures.plastic)
        sums = totals(fields)
        twice_elastic = sums[0]
        adhesion = sums[1]
        plastic_work = None
        if pressures.plastic is not None:
            plastic_work = sums[6]
        level = sums[2] / gap.size
        mean_gap = level
        if solid.punch is not None:
            mean_gap = control.mean_gap_of(gap)
        balancing, imbalance_rms, gap_rms = jnp.sqrt(sums[3:6] / gap.size)
        scale = scale_of(balancing, smallest_scale, stiffest, gap_rms)
        is_nearly_flat = (spread > 0) & (spread < _FLAT * level)
        residual = jnp.where(
            imbalance_rms == 0, 0, imbalance_rms / jnp.where(imbalance_rms == 0, 1, scale)
        )
        # A light load is all that keeps the surfaces where they are.
        # So it counts in full where the scale is rounding, which has no mean.
        weight = jnp.where(is_nearly_flat, 1, _MEAN_SHARE)
        mean_imbalance = weight * control.mean_imbalance(imbalance, attraction, gap)
        return Balance(
            net=net,
            curvature=curvature,
            elastic_energy=twice_elastic / 2,
            adhesion=adhesion,
            plastic_work=plastic_work,
            mean_gap=mean_gap,
            residual=jnp.maximum(residual, mean_imbalance),
            has_escaped=control.has_escaped(gap, escape),
        )

    return balance


def _from_first(field: Field) -> Field:
    """Return a field less its value at one point."""
    return field - field.ravel()[0]


def least_scale(conforming: Scalar) -> Scalar:
    """Return the least scale of an imbalance, given the pressure that full contact takes."""
    return conforming * max(_LEAST_SCALE, 1e6 * float(jnp.finfo(conforming.dtype).eps))


def scale_of(balancing: Scalar, least: Scalar, stiffest: Scalar, gap: Scalar) -> Scalar:
    """Return the scale of an imbalance [pressure].

    It is at least what rounding allows: the part of a gap that rounding hides, over the default
    tolerance. To reach that takes no more than that the stiffest wave is rounded as gaps are. Its
    pressure outweighs others from a few thousand points a side in float32.

    Arguments:
        balancing: the rms of the pressures that balance each other [pressure].
        least: the least scale, `least_scale` [pressure].
        stiffest: the stiffness of the stiffest wave [pressure/length].
        gap: the rms of the gap [length].
    """
    precision = float(jnp.finfo(gap.dtype).eps)
    rounding = precision / EQUILIBRIUM[gap.dtype.name] * stiffest * gap
    return jnp.maximum(jnp.maximum(balancing, least), rounding)


def conforming_pressure(solid: Solid, heights: Field) -> Scalar:
    """Return the rms elastic pressure that full contact takes, |K h| [pressure]."""
    heights = solid.conforming(heights)
    pressure = solid.with_uniform_stiffness(0).apply(heights - mean(heights))
    return jnp.sqrt(mean(pressure**2))
