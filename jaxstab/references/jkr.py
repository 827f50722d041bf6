"""Johnson, Kendall and Roberts (1971): an elastic sphere with adhesion of no range.

A rigid paraboloid r^2 / (2 R) on an elastic half space of contact modulus E*; outside the contact,
of radius a, nothing acts, and opening the contact costs w per area.

Signs: forces are positive in compression; displacements count the approach of the bodies from
where the undeformed ones would touch in a point, positive into contact. Numbers may be arrays, of
shapes that broadcast.

K. L. Johnson, K. Kendall, A. D. Roberts, Proc. R. Soc. A 324, 301 (1971); D. Maugis, M. Barquins,
J. Phys. D 11, 1989 (1978), for contact through a spring.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxstab.core.docstrings import described
from jaxstab.references.arguments import (
    POSITIVE,
    SPHERE,
    Array,
    not_negative,
    or_not_positive,
    positive,
    require,
)
from jaxstab.references.roots import bisect

_SQRT_6 = np.sqrt(6)


class State(NamedTuple):
    """One equilibrium, or as many as the arrays have entries.

    Attributes:
        force: F, positive in compression [force].
        displacement: d, the approach, positive into contact [length].
        contact_radius: a [length].
    """

    force: Array
    displacement: Array
    contact_radius: Array


class Units(NamedTuple):
    """The units in which the curve is the same for all spheres.

    Attributes:
        force: F0 = pi w R [force].
        displacement: d0 = (pi^2 w^2 R / K^2)^(1/3) [length].
        contact_radius: a0 = (pi w R^2 / K)^(1/3) [length].
    """

    force: Array
    displacement: Array
    contact_radius: Array


@described(SPHERE, POSITIVE)
def units(radius: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike) -> Units:
    """Return F0, d0 and a0, with K = 4 E* / 3 (D. Maugis, J. Colloid Interface Sci. 150, 1992)."""
    radius, contact_modulus, work = positive(
        radius=radius, contact_modulus=contact_modulus, work_of_adhesion=work_of_adhesion
    )
    contact_radius = np.cbrt(np.pi * work * radius**2 / (4 / 3 * contact_modulus))
    return Units(np.pi * work * radius, contact_radius**2 / radius, contact_radius)


@described(SPHERE, POSITIVE)
def force(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> Array:
    """Return F = 4 E* a^3 / (3 R) - sqrt(8 pi w E* a^3) (Johnson, Kendall & Roberts 1971) [force].

    Hertz's force, less a flat punch's whose energy release rate is w.
    """
    return curve(contact_radius, radius, contact_modulus, work_of_adhesion).force


@described(SPHERE, POSITIVE)
def displacement(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> Array:
    """Return d = a^2 / R - sqrt(2 pi w a / E*) (Maugis & Barquins 1978) [length]."""
    return curve(contact_radius, radius, contact_modulus, work_of_adhesion).displacement


@described(SPHERE, POSITIVE)
def curve(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> State:
    """Return `force` and `displacement` together, of all equilibria, stable and unstable ones."""
    a, radius, contact_modulus, work = positive(
        contact_radius=contact_radius,
        radius=radius,
        contact_modulus=contact_modulus,
        work_of_adhesion=work_of_adhesion,
    )
    hertz = 4 * contact_modulus * a**3 / (3 * radius)
    return State(
        hertz - np.sqrt(8 * np.pi * work * contact_modulus * a**3),
        a**2 / radius - np.sqrt(2 * np.pi * work * a / contact_modulus),
        a,
    )


@described(SPHERE, POSITIVE)
def energy(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> Array:
    """Return U = F0 d0 (2 A^5 / 5 - (2 sqrt(6) / 3) A^(7/2) + A^2), A = a / a0.

    The integral of F over d along `curve`: the elastic energy, less w for each area in
    contact, zero without any [energy].
    """
    (a,) = positive(contact_radius=contact_radius)
    unit = units(radius, contact_modulus, work_of_adhesion)
    ratio = a / unit.contact_radius
    number = 2 / 5 * ratio**5 - 2 * _SQRT_6 / 3 * ratio**3.5 + ratio**2
    return unit.force * unit.displacement * number


@described(SPHERE, or_not_positive("k is negative"))
def pull_off(
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    stiffness: ArrayLike = 0.0,
) -> State:
    """Return the state where contact is lost: dF/dd = -k, pulled through a spring.

    Under dead load, k = 0, F = -(3/2) pi w R (Johnson, Kendall & Roberts 1971); under held
    displacement, k infinite, F = -(5/6) pi w R; between them Maugis & Barquins (1978).
    """
    # d(F + k d)/dA, where root = A^(3/2), without a positive factor.
    return _where_zero(
        lambda root: 1.5 * np.cbrt(root**2) * (2 * root - _SQRT_6),
        lambda root: 2 * root - _SQRT_6 / 3,
        (_SQRT_6 / 6, _SQRT_6 / 2),
        (radius, contact_modulus, work_of_adhesion),
        stiffness,
    )


@described(
    SPHERE,
    or_not_positive("k is negative"),
    stiffness="k of the spring through which the sphere is pressed [force/length]",
)
def jump_in(
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    stiffness: ArrayLike = np.inf,
) -> State:
    """Return the state into which surfaces jump when they first touch, at d = 0: F + k d = 0.

    Without range, nothing acts before. Under held displacement F = -(4/3) pi w R and
    a^3 = 2 pi w R^2 / E*; under dead load F = 0 (Johnson, Kendall & Roberts 1971).
    """
    # F + k d, where root = A^(3/2).
    return _where_zero(
        lambda root: root * (root - _SQRT_6),
        lambda root: np.cbrt(root) * (root - 2 * _SQRT_6 / 3),
        (2 * _SQRT_6 / 3, _SQRT_6),
        (radius, contact_modulus, work_of_adhesion),
        stiffness,
    )


@described(
    SPHERE,
    or_not_positive("k is not positive"),
    stiffness="k of the spring [force/length]; infinite under held displacement",
)
def loop_loss(
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    stiffness: ArrayLike = np.inf,
) -> Array:
    """Return the energy lost from `jump_in` to `pull_off` and back, what both jumps let go.

    Under held displacement 7.0922 (w^5 R^4 / E*^2)^(1/3), the difference of `energy`; a spring of
    stiffness k adds the difference of its F^2 / (2 k) [energy].
    """
    stiffness = np.asarray(stiffness)
    require("stiffness", stiffness, stiffness > 0, "a positive number")
    sphere = radius, contact_modulus, work_of_adhesion
    leaving, entering = pull_off(*sphere, stiffness), jump_in(*sphere, stiffness)
    contact = energy(leaving.contact_radius, *sphere) - energy(entering.contact_radius, *sphere)
    return contact + (leaving.force**2 - entering.force**2) / (2 * stiffness)


def spring_weights(stiffness: ArrayLike, unit: Units) -> tuple[Array, Array]:
    """Return 1 / (1 + k) and k / (1 + k), what F and d weigh, for k in units of `Units`.

    That of a spring, which may be infinite, but is never negative.
    """
    stiffness = not_negative("stiffness", stiffness) * unit.displacement / unit.force
    return 1 / (1 + stiffness), 1 - 1 / (1 + stiffness)


def _where_zero(
    f: Callable[[Array], Array],
    d: Callable[[Array], Array],
    between: tuple[float, float],
    sphere: tuple[ArrayLike, ArrayLike, ArrayLike],
    stiffness: ArrayLike,
) -> State:
    """Return the state where f + k d is zero, both functions of A^(3/2) in units of `Units`."""
    unit = units(*sphere)
    dead, held = spring_weights(stiffness, unit)
    root = bisect(lambda root: dead * f(root) + held * d(root), *between)
    return curve(np.cbrt(root**2) * unit.contact_radius, *sphere)
