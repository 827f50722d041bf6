"""Contact under a pressure that a hardness H limits: spheres, and rough metals.

The pressure never exceeds H, and where it is H the solid is flattened for good; otherwise it is a
half space of contact modulus E*. A sphere is a rigid paraboloid r^2 / (2 R). Forces are positive in
compression, and displacements are the approach from where the undeformed bodies touch in a point.
Numbers may be arrays, of shapes that broadcast.

K. L. Johnson, *Contact Mechanics* (1985), sections 3.4 and 6.3; S. Dj. Mesarovic, K. L. Johnson,
J. Mech. Phys. Solids 48, 2009 (2000), for the unloading of a sphere whose contact has yielded;
B. N. J. Persson, Phys. Rev. Lett. 87, 116101 (2001), for rough surfaces; M. G. Cooper, B. B. Mikic,
M. M. Yovanovich, Int. J. Heat Mass Transfer 12, 279 (1969), for their conductance.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import erfc

from jaxstab.core.checks import require
from jaxstab.core.roots import bisect
from jaxstab.references.arguments import Array, ArrayLike, not_negative, positive
from jaxstab.references.jkr import SphereState


class AreaFractions(NamedTuple):
    """Parts of the surface.

    Attributes:
        elastic: in contact, at a pressure below H.
        yielding: at the pressure H.

    Example:
        >>> found = js.references.elastic_plastic.area_fractions(1e-3, 0.1, 1.0, hardness=10.0)
        >>> f"{found.yielding:.1f}"
        '0.0'
    """

    elastic: Array
    yielding: Array


def first_yield(radius: ArrayLike, contact_modulus: ArrayLike, hardness: ArrayLike) -> SphereState:
    """Return Hertz's contact whose largest pressure is H: F = pi^3 R^2 H^3 / (6 E*^2).

    a = pi R H / (2 E*) and d = a^2 / R (Johnson 1985, eq. 6.10).

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        hardness: H [pressure].

    Raises:
        ValueError: if an argument is not positive and finite.

    Example:
        >>> found = js.references.elastic_plastic.first_yield(1.0, 1.0, hardness=0.1)
        >>> f"{found.contact_radius / (np.pi * 0.1 / 2):.2f}"
        '1.00'
    """
    radius, modulus, hardness = positive(
        radius=radius, contact_modulus=contact_modulus, hardness=hardness
    )
    a = np.pi * radius * hardness / (2 * modulus)
    return SphereState(2 / 3 * np.pi * a**2 * hardness, a**2 / radius, a)


def fully_plastic(
    contact_radius: ArrayLike, radius: ArrayLike, contact_modulus: ArrayLike, hardness: ArrayLike
) -> SphereState:
    """Return the limit E* a >> H R, in which all of the contact yields: F = pi a^2 H.

    d = a^2 / (2 R) + 4 H a / (pi E*): the height of the cap, and the displacement of an elastic
    half space at the edge of a disc of uniform pressure (Johnson 1985, eq. 3.29).

    Arguments:
        contact_radius: a [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        hardness: H [pressure].

    Raises:
        ValueError: if an argument is not positive and finite.

    Example:
        >>> found = js.references.elastic_plastic.fully_plastic(0.5, 1.0, 1.0, hardness=0.01)
        >>> f"{found.force / (np.pi * 0.5**2 * 0.01):.2f}"
        '1.00'
    """
    a, radius, modulus, hardness = positive(
        contact_radius=contact_radius,
        radius=radius,
        contact_modulus=contact_modulus,
        hardness=hardness,
    )
    displacement = a**2 / (2 * radius) + 4 * hardness * a / (np.pi * modulus)
    return SphereState(np.pi * a**2 * hardness, displacement, a)


def unloading(
    contact_radius: ArrayLike,
    largest_radius: ArrayLike,
    contact_modulus: ArrayLike,
    hardness: ArrayLike,
    work_of_adhesion: ArrayLike = 0.0,
) -> SphereState:
    """Return the elastic unloading of a contact all of which has yielded.

    The surface left is flat under the uniform pressure H on the largest contact, of radius a0. With
    x = a / a0 and w the work of adhesion, of no range,

        F = 2 H a0^2 (arcsin x - x sqrt(1 - x^2)) - sqrt(8 pi w E* a^3)
        d = (2 H a0 / E*) (1 - sqrt(1 - x^2)) - sqrt(2 pi w a / E*),

    the approach from where the flattened surface is touched: Sneddon's solution for the profile
    that a uniform pressure leaves, and the flat punch of Johnson, Kendall & Roberts.

    Arguments:
        contact_radius: a, at most a0 [length].
        largest_radius: a0 [length].
        contact_modulus: E* [pressure].
        hardness: H [pressure].
        work_of_adhesion: w [energy/area].

    Raises:
        ValueError: for a > a0, a negative w, and another argument that is not positive and finite.

    Example:
        >>> found = js.references.elastic_plastic.unloading(0.5, 0.5, 1.0, hardness=0.01)
        >>> f"{found.force / (np.pi * 0.5**2 * 0.01):.2f}"
        '1.00'
    """
    work = not_negative("work of adhesion", work_of_adhesion)
    a, largest, modulus, hardness = positive(
        contact_radius=contact_radius,
        largest_radius=largest_radius,
        contact_modulus=contact_modulus,
        hardness=hardness,
    )
    x = a / largest
    require("The contact radius", a, x <= 1, "give at most the largest radius.")
    cosine = np.sqrt(1 - x**2)
    force = 2 * hardness * largest**2 * (np.arcsin(x) - x * cosine)
    displacement = 2 * hardness * largest / modulus * (1 - cosine)
    return SphereState(
        force - np.sqrt(8 * np.pi * work * modulus * a**3),
        displacement - np.sqrt(2 * np.pi * work * a / modulus),
        a * np.ones_like(force - work),
    )


def pull_off(
    largest_radius: ArrayLike,
    contact_modulus: ArrayLike,
    hardness: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> SphereState:
    """Return the state of `unloading` at which a dead load loses contact: dF/da = 0.

    x^3 = e^2 (1 - x^2) with e = (3/8) sqrt(8 pi w E* / (H^2 a0)). For large contacts the flattened
    sphere has the radius E* a0 / H, and F = -(3/2) pi w E* a0 / H rises as the root of the load
    before; small ones are pulled off as a flat punch, F = pi a0^2 H - sqrt(8 pi w E* a0^3).

    Arguments:
        largest_radius: a0 [length]; a0 = sqrt(F / (pi H)) after a load F.
        contact_modulus: E* [pressure].
        hardness: H [pressure].
        work_of_adhesion: w [energy/area].

    Raises:
        ValueError: if an argument is not positive and finite.

    Example:
        >>> lost = js.references.elastic_plastic.pull_off(0.5, 1.0, 0.01, work_of_adhesion=1e-5)
        >>> bool(lost.force < 0)
        True
    """
    largest, modulus, hardness, work = positive(
        largest_radius=largest_radius,
        contact_modulus=contact_modulus,
        hardness=hardness,
        work_of_adhesion=work_of_adhesion,
    )
    square = 9 / 8 * np.pi * work * modulus / (hardness**2 * largest)
    x = bisect(lambda x: x**3 - square * (1 - x**2), 0 * square, 1 + 0 * square)
    return unloading(x * largest, largest, modulus, hardness, work)


def area_fractions(
    pressure: ArrayLike, rms_slope: ArrayLike, contact_modulus: ArrayLike, hardness: ArrayLike
) -> AreaFractions:
    """Return the contact of a random rough surface in Persson's theory, without adhesion.

    The pressure at a point diffuses from the mean P as roughness is added, up to the variance
    s^2 = (E* h' / 2)^2, and ends at 0, where contact is lost, or at H (Persson 2001; Y. Xu, X. Li,
    D. M. Mulvihill, arXiv 2208.02665). With c(x) = erfc(x / (sqrt(2) s)),

        yielding = sum over k >= 0 of c((2 k + 1) H - P) - c((2 k + 1) H + P)
        open = sum over k >= 0 of c(2 k H + P) - c(2 (k + 1) H - P).

    For H >> s the elastic part is erf(sqrt(2) P / (E* h')), for H << s the yielding part P / H.

    Arguments:
        pressure: P, the mean [pressure].
        rms_slope: h', the rms of the gradient.
        contact_modulus: E* [pressure].
        hardness: H [pressure].

    Raises:
        ValueError: for P > H, and if an argument is not positive and finite.

    Example:
        >>> found = js.references.elastic_plastic.area_fractions(0.001, 0.1, 1.0, hardness=0.05)
        >>> bool(found.yielding > found.elastic)
        True
    """
    pressure, slope, modulus, hardness = positive(
        pressure=pressure, rms_slope=rms_slope, contact_modulus=contact_modulus, hardness=hardness
    )
    require("The pressure", pressure, pressure <= hardness, "give at most the hardness.")
    root = np.sqrt(2) * modulus * slope / 2
    # c falls below rounding beyond six roots of twice the variance.
    k = np.arange(int(np.ceil(np.max(3 * root / hardness))) + 2)
    k = k.reshape(-1, *[1] * pressure.ndim)

    def absorbed_share(near: Array, far: Array) -> Array:
        return np.sum(erfc((2 * k * hardness + near) / root), 0) - np.sum(
            erfc((2 * k * hardness + far) / root), 0
        )

    yielding = absorbed_share(hardness - pressure, hardness + pressure)
    is_open = absorbed_share(pressure, 2 * hardness - pressure)
    return AreaFractions(1 - yielding - is_open, yielding)


def conductance(
    pressure: ArrayLike,
    hardness: ArrayLike,
    rms_height: ArrayLike,
    mean_slope: ArrayLike,
    conductivity: ArrayLike,
) -> Array:
    """Return 1.25 k (m / sigma) (P / H)^0.95 of a nominal area [conductivity/length].

    The plastic contact of Cooper, Mikic & Yovanovich (1969), whose own fit is 1.45 (P / H)^0.985,
    in the form of M. M. Yovanovich, *New contact and gap correlations for conforming rough
    surfaces* (AIAA 81-1164, 1981).

    Arguments:
        pressure: P, of the nominal area [pressure].
        hardness: H of the softer body [pressure].
        rms_height: sigma of both surfaces together [length].
        mean_slope: m, the mean of |dh/dx| along a profile, of both surfaces together: for a
            Gaussian isotropic surface the rms gradient over sqrt(pi).
        conductivity: k = 2 k1 k2 / (k1 + k2), electrical or thermal.

    Raises:
        ValueError: if an argument is not positive and finite.

    Example:
        >>> f"{js.references.elastic_plastic.conductance(0.01, 1.0, 1e-6, 0.1, 200.0):.3g}"
        '3.15e+05'
    """
    pressure, hardness, height, slope, conductivity = positive(
        pressure=pressure,
        hardness=hardness,
        rms_height=rms_height,
        mean_slope=mean_slope,
        conductivity=conductivity,
    )
    return 1.25 * conductivity * slope / height * (pressure / hardness) ** 0.95
