"""Guduru (2007): an elastic sphere with concentric waves and adhesion of zero range.

A rigid surface r^2 / (2 R) + A (1 - cos(2 pi r / L)) on an elastic half space of contact modulus
E*, in contact everywhere up to the radius a. Outside nothing acts. Opening the contact costs w per
area. The contact is connected after enough pressing, and at once if the profile rises everywhere,
4 pi^2 A R / L^2 < 4.603. A connected contact is assumed, not checked.

Signs: forces are positive in compression; displacements count the approach of the bodies from
where the undeformed ones would touch in the middle, positive into contact. Numbers may be arrays,
of shapes that broadcast. A `ValueError` names an amplitude that is negative, or another argument
that is not positive and finite.

P. R. Guduru, J. Mech. Phys. Solids 55, 445 (2007); H. Kesari, A. J. Lew, J. Mech. Phys. Solids 59,
2488 (2011), for the envelope.
"""

import numpy as np

from jaxstab.references import jkr
from jaxstab.references.arguments import Array, ArrayLike, not_negative, positive


def curve(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    amplitude: ArrayLike,
    length: ArrayLike,
) -> jkr.SphereState:
    """Return the state of JKR's sphere, and the contribution of the waves.

    F = F_JKR + (2 pi^2 E* A a^2 / L) (H0(q) - H1(q) / q) and d = d_JKR + (pi^2 A a / L) H0(q),
    where q = 2 pi a / L and H0, H1 are Struve's functions (Guduru 2007).

    Arguments:
        contact_radius: a [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        amplitude: A [length].
        length: the wavelength L [length].

    Example:
        >>> found = js.references.guduru.curve(0.3, 1.0, 1.0, 1e-3, amplitude=1e-3, length=0.1)
        >>> f"{found.force:.4f}"
        '0.0077'
    """
    smooth = jkr.curve(contact_radius, radius, contact_modulus, work_of_adhesion)
    (length,) = positive(length=length)
    steepness = np.pi**2 * not_negative("amplitude", amplitude) / length
    depth = steepness * smooth.contact_radius
    h0, difference = _struve(2 * np.pi * smooth.contact_radius / length)
    force = 2 * np.asarray(contact_modulus) * smooth.contact_radius * depth * difference
    return jkr.SphereState(
        smooth.force + force, smooth.displacement + depth * h0, smooth.contact_radius + 0 * depth
    )


def envelope_work(
    contact_modulus: ArrayLike, work_of_adhesion: ArrayLike, amplitude: ArrayLike, length: ArrayLike
) -> Array:
    """Return w (1 + 1 / (sqrt(pi) alpha))^2, with which a smooth sphere has the curve's envelope.

    alpha = sqrt(2 w L / (pi^2 E* A^2)) is `johnson.adhesion_parameter` (Kesari & Lew 2011). It is
    the work of adhesion while contact opens [energy/area].

    Arguments:
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        amplitude: A [length].
        length: the wavelength L [length].

    Example:
        >>> f"{js.references.guduru.envelope_work(1.0, 1e-3, amplitude=1e-3, length=0.1):.2e}"
        '1.27e-03'
    """
    contact_modulus, work, length = positive(
        contact_modulus=contact_modulus, work_of_adhesion=work_of_adhesion, length=length
    )
    amplitude = not_negative("amplitude", amplitude)
    return (np.sqrt(work) + amplitude * np.sqrt(np.pi * contact_modulus / (2 * length))) ** 2


def envelope(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    amplitude: ArrayLike,
    length: ArrayLike,
) -> jkr.SphereState:
    """Return the lower envelope of `curve` for short waves, L << a: JKR's with `envelope_work`.

    Touched, not crossed, wherever contact opens (Kesari & Lew 2011).

    Arguments:
        contact_radius: a [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        amplitude: A [length].
        length: the wavelength L [length].

    Example:
        >>> found = js.references.guduru.envelope(0.3, 1.0, 1.0, 1e-3, amplitude=1e-3, length=0.1)
        >>> f"{found.force:.4f}"
        '0.0067'
    """
    work = envelope_work(contact_modulus, work_of_adhesion, amplitude, length)
    smooth = jkr.curve(contact_radius, radius, contact_modulus, work)
    # The mean of the waves lies A below the central crest, since H0 has a mean of 2 / (pi q).
    return smooth._replace(displacement=smooth.displacement + np.asarray(amplitude))


def envelope_pull_off(
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    amplitude: ArrayLike,
    length: ArrayLike,
) -> jkr.SphereState:
    """Return the lowest state of `envelope`: F = -(3/2) pi w R (1 + 1 / (sqrt(pi) alpha))^2.

    The pull-off under dead load for short waves, L << a (Kesari & Lew 2011).

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        amplitude: A [length].
        length: the wavelength L [length].

    Example:
        >>> lowest = js.references.guduru.envelope_pull_off(1.0, 1.0, 1e-3, 1e-3, length=0.1)
        >>> f"{lowest.force:.4f}"
        '-0.0060'
    """
    work = envelope_work(contact_modulus, work_of_adhesion, amplitude, length)
    lowest = jkr.pull_off(radius, contact_modulus, work).contact_radius
    return envelope(lowest, radius, contact_modulus, work_of_adhesion, amplitude, length)


def _struve(argument: Array) -> tuple[Array, Array]:
    """Return H0(q) and H0(q) - H1(q) / q.

    (2 / pi) times the integrals, over a quarter of a turn, of sin(q s) and s^2 sin(q s), where s is
    the sine: Sneddon's, of a profile whose slope is a sine.
    """
    # Sixteen Gauss points resolve the two waves that a panel spans at most.
    nodes, weights = np.polynomial.legendre.leggauss(16)
    panels = int(np.max(argument, initial=0) / 8) + 1
    width = np.pi / 2 / panels
    phi = width * (np.arange(panels)[:, None] + (nodes + 1) / 2).ravel()
    weights = np.tile(weights, panels) * width / np.pi
    sine = np.sin(phi)
    waves = np.sin(np.asarray(argument)[..., None] * sine)
    return waves @ weights, waves @ (weights * sine**2)
