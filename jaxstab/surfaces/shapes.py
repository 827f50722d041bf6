"""Single asperities, their summit in the middle of the cell: spheres, cones, punches and tips.

On rings they are functions of the radius. On a line they are the profiles of cylinders, wedges and
so on.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.checks import (
    concrete,
    parameter,
    positive_scalar,
    require,
    require_finite,
    scalar_parameter,
    where_known,
)
from jaxstab.core.compile import program
from jaxstab.core.grid import Mesh, require_mesh
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.surfaces import faults


def paraboloid(grid: Mesh, radius: ArrayLike) -> Field:
    """Return h = -r^2 / (2 R), its summit in the middle of the cell (Rey & Bleyer, eq. 40).

    It is zero at the summit [length].

    Arguments:
        grid: the grid; on a line the shape is the profile of a cylinder, a wedge and so on.
        radius: R, the radius of curvature at the summit [length].

    Raises:
        ValueError: if the radius is not positive.

    Example:
        >>> f"{js.surfaces.paraboloid(grid, radius=2.0).min():.4f}"
        '-0.1250'
    """
    require_mesh(grid)
    return _paraboloid(grid, positive_scalar(radius, "The radius"))


@program
def _paraboloid(grid: Mesh, radius: Scalar) -> Field:
    return -grid.squared_distances / (2 * radius)


def sphere(grid: Mesh, radius: ArrayLike) -> Field:
    """Return h = sqrt(R^2 - r^2) - R up to r = R, and beyond it flat at -R.

    It is zero at the summit [length].

    Arguments:
        grid: the grid; on a line the shape is the profile of a cylinder, a wedge and so on.
        radius: R [length].

    Raises:
        ValueError: if the radius is not positive.

    Example:
        >>> f"{js.surfaces.sphere(grid, radius=0.4).min():.1f}"
        '-0.4'
    """
    require_mesh(grid)
    return _sphere(grid, positive_scalar(radius, "The radius"))


@program
def _sphere(grid: Mesh, radius: Scalar) -> Field:
    share = grid.squared_distances / radius**2
    is_inside = share < 1
    # As R - sqrt(R^2 - r^2) it would lose digits near the summit.
    depth = radius * share / (1 + jnp.sqrt(1 - jnp.where(is_inside, share, 0)))
    return -jnp.where(is_inside, depth, radius)


def cone(grid: Mesh, slope: ArrayLike) -> Field:
    """Return h = -s r.

    It is zero at the apex [length].

    Arguments:
        grid: the grid; on a line the shape is the profile of a cylinder, a wedge and so on.
        slope: s, the tangent of the angle between flank and plane.

    Raises:
        ValueError: if the slope is not positive.

    Example:
        >>> f"{js.surfaces.cone(grid, slope=0.1).min():.4f}"
        '-0.0707'
    """
    require_mesh(grid)
    return _cone(grid, positive_scalar(slope, "The slope"))


@program
def _cone(grid: Mesh, slope: Scalar) -> Field:
    return -slope * _distance(grid)


def hyperboloid(grid: Mesh, radius: ArrayLike, slope: ArrayLike) -> Field:
    """Return h = s^2 R (1 - sqrt(1 + r^2 / (s R)^2)), a cone with a rounded apex.

    It is zero at the apex [length]. A cone of half angle alpha has the slope s = cot(alpha).

    Arguments:
        grid: the grid; on a line the shape is the profile of a cylinder, a wedge and so on.
        radius: R, the radius of curvature at the apex [length].
        slope: s far from the apex, the tangent of the angle between flank and plane.

    Raises:
        ValueError: if radius or slope are not positive.

    Example:
        >>> f"{js.surfaces.hyperboloid(grid, radius=0.1, slope=0.5).min():.4f}"
        '-0.3294'
    """
    require_mesh(grid)
    radius = positive_scalar(radius, "The radius")
    return _hyperboloid(grid, radius, positive_scalar(slope, "The slope"))


@program
def _hyperboloid(grid: Mesh, radius: Scalar, slope: Scalar) -> Field:
    # The difference of the root and one would lose digits near the apex.
    steepness = grid.squared_distances / (slope * radius) ** 2
    return -grid.squared_distances / radius / (1 + jnp.sqrt(1 + steepness))


def flat_punch(grid: Mesh, radius: ArrayLike, rim_radius: ArrayLike) -> Field:
    """Return a flat of radius a with a rounded rim: h = 0, beyond it -(r - a)^2 / (2 R).

    It is zero on the flat [length].

    Arguments:
        grid: the grid; on a line the shape is the profile of a cylinder, a wedge and so on.
        radius: a, of the flat [length].
        rim_radius: R, the radius of curvature of its rim [length].

    Raises:
        ValueError: if a radius is not positive.

    Example:
        >>> punch = js.surfaces.flat_punch(grid, radius=0.2, rim_radius=0.1)
        >>> int((punch == 0).sum())
        37
    """
    require_mesh(grid)
    radius = positive_scalar(radius, "The radius")
    return _flat_punch(grid, radius, positive_scalar(rim_radius, "The radius of the rim"))


@program
def _flat_punch(grid: Mesh, radius: Scalar, rim_radius: Scalar) -> Field:
    return -(jnp.maximum(_distance(grid) - radius, 0) ** 2) / (2 * rim_radius)


def wavy_sphere(
    grid: Mesh, radius: ArrayLike, amplitude: ArrayLike, wavelength: ArrayLike
) -> Field:
    """Return h = -r^2 / (2 R) - A (1 - cos(2 pi r / l)), a sphere with concentric waves (Guduru).

    P. R. Guduru, J. Mech. Phys. Solids 55, 445 (2007).

    It is zero at the summit [length].

    Arguments:
        grid: the grid; on a line the shape is the profile of a cylinder, a wedge and so on.
        radius: R of the paraboloid [length].
        amplitude: A, half the height of a wave from trough to crest [length].
        wavelength: l [length].

    Raises:
        ValueError: if radius or wavelength are not positive, or the amplitude not finite.

    Example:
        >>> wavy = js.surfaces.wavy_sphere(grid, radius=2.0, amplitude=0.01, wavelength=0.25)
        >>> f"{wavy[8, 8] - wavy[8, 6]:.4f}"
        '0.0239'
    """
    require_mesh(grid)
    amplitude = scalar_parameter(amplitude, "The amplitude")
    require("The amplitude", amplitude, abs(concrete(amplitude)) < np.inf, "it must be finite.")
    radius = positive_scalar(radius, "The radius")
    return _wavy_sphere(grid, radius, amplitude, positive_scalar(wavelength, "The wavelength"))


@program
def _wavy_sphere(grid: Mesh, radius: Scalar, amplitude: Scalar, wavelength: Scalar) -> Field:
    waves = 1 - jnp.cos(2 * jnp.pi * _distance(grid) / wavelength)
    return _paraboloid(grid, radius) - amplitude * waves


def tip(grid: Mesh, profile_radii: ArrayLike, profile_heights: ArrayLike) -> Field:
    """Return an axisymmetric tip of a measured profile, by monotone cubic interpolation.

    F. N. Fritsch and J. Butland, SIAM J. Sci. Stat. Comput. 5, 300 (1984); the slope at r = 0 is
    zero.

    Arguments:
        grid: the grid.
        profile_radii: r, ascending from zero to the corners of the cell, or the rim of the disc, or
            beyond [length].
        profile_heights: h there, the summit pointing towards the solid, upwards [length].

    Returns:
        Field [length].

    Raises:
        ValueError: for radii that do not ascend from zero, or end before the corners; for heights
            of another shape, or not finite.

    Warns:
        SurfaceWarning: for a profile that is highest at its end, as depths below the summit are.

    Example:
        >>> tip = js.surfaces.tip(grid, np.array([0.0, 0.5, 1.0]), np.array([0.0, -0.2, -0.8]))
        >>> f"{tip.max():.1f}, {tip[8, 0]:.1f}"
        '0.0, -0.2'
    """
    require_mesh(grid)
    radii = parameter(profile_radii, "The array of radii")
    heights = parameter(profile_heights, "The array of heights")
    if radii.ndim != 1 or radii.size < 2 or radii.shape != heights.shape:
        raise ValueError(
            f"The profile has radii of shape {radii.shape} and heights of shape {heights.shape}: "
            "give as many heights as radii, two or more."
        )
    require_finite("The profile", heights)
    r = concrete(radii)
    require("The profile", r, (r[0] == 0) & (r[1:] > r[:-1]).all(), "radii must ascend from zero.")
    corner = (concrete(grid.lengths) ** 2).sum() ** 0.5 / 2
    cure = f"the grid reaches to r = {corner}; continue the profile, or take a smaller grid."
    # Rounding must not decide whether it reaches them.
    require("The last radius of the profile", r[-1], r[-1] >= corner * (1 - 1e-6), cure)
    _warn_of_depths(r, heights)
    return _tip(grid, radii, heights)


@where_known
def _warn_of_depths(radii: np.ndarray, heights: Float[Array, " n"]) -> None:
    """Warn of a profile that is highest at its end."""
    if heights[-1] == heights.max() > heights[0]:
        faults.warn(
            [
                f"the profile of the tip is highest at its end, r = {radii[-1]:.4g}: a summit has "
                "the largest height. Give depths as negative heights, -profile_heights."
            ]
        )


@program
def _tip(grid: Mesh, radii: Float[Array, " n"], heights: Float[Array, " n"]) -> Field:
    widths = jnp.diff(radii)
    secants = jnp.diff(heights) / jnp.diff(radii)
    before = secants[:-1]
    after = secants[1:]
    # The harmonic mean, weighted by widths; zero at a summit or in a trough.
    rises = before * after > 0
    first = 2 * widths[1:] + widths[:-1]
    last = widths[1:] + 2 * widths[:-1]
    inverse = first / jnp.where(rises, before, 1) + last / jnp.where(rises, after, 1)
    inner = jnp.where(rises, (first + last) / inverse, 0)
    slopes = jnp.concatenate([jnp.zeros(1, inner.dtype), inner, secants[-1:]])

    r = jnp.minimum(_distance(grid), radii[-1])
    i = jnp.clip(jnp.searchsorted(radii, r, side="right") - 1, 0, radii.size - 2)
    t = (r - radii[i]) / widths[i]
    # Hermite's cubics.
    level = heights[i] + (3 - 2 * t) * t**2 * (heights[i + 1] - heights[i])
    bend = (1 - t) * slopes[i] - t * slopes[i + 1]
    return level + widths[i] * t * (1 - t) * bend


def _distance(grid: Mesh) -> Field:
    """Return the distance from the middle, with zero derivatives by the lengths there."""
    squared = grid.squared_distances
    return jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1)), 0)
