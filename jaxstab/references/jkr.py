"""Johnson, Kendall and Roberts (1971): an elastic sphere with adhesion of zero range.

A rigid paraboloid r^2 / (2 R) on an elastic half space of contact modulus E*. Nothing acts outside
the contact, which has the radius a. Opening it costs w per area.

Signs: forces are positive in compression; displacements count the approach of the bodies from
where the undeformed ones would touch in a point, positive into contact. Numbers may be arrays, of
shapes that broadcast. A `ValueError` names an argument that is not positive and finite; the
stiffness of a spring may be zero or infinite, but for `loop_loss` not zero.

K. L. Johnson, K. Kendall, A. D. Roberts, Proc. R. Soc. A 324, 301 (1971); D. Maugis, M. Barquins,
J. Phys. D 11, 1989 (1978), for contact through a spring.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxstab.core.checks import require
from jaxstab.core.roots import bisect
from jaxstab.references.arguments import Array, ArrayLike, not_negative, positive

_SQRT_6 = np.sqrt(6)


class SphereState(NamedTuple):
    """One equilibrium, or as many as the arrays have entries.

    Attributes:
        force: F, positive in compression [force].
        displacement: d, the approach, positive into contact [length].
        contact_radius: a [length].

    Example:
        >>> found = js.references.jkr.curve(0.3, 1.0, 1.0, 1e-3)
        >>> f"{found.force:.4f}, {found.displacement:.4f}, {found.contact_radius:.1f}"
        '0.0100, 0.0466, 0.3'
    """

    force: Array
    displacement: Array
    contact_radius: Array


class Scales(NamedTuple):
    """Characteristic quantities, in units of which all spheres have one curve.

    Attributes:
        force: F0 = pi w R [force].
        displacement: d0 = (pi^2 w^2 R / K^2)^(1/3) [length].
        contact_radius: a0 = (pi w R^2 / K)^(1/3) [length].

    Example:
        >>> scales = js.references.jkr.units(radius=1.0, contact_modulus=1.0, work_of_adhesion=1e-3)
        >>> f"{scales.force:.5f}, {scales.displacement:.5f}, {scales.contact_radius:.4f}"
        '0.00314, 0.01771, 0.1331'
    """

    force: Array
    displacement: Array
    contact_radius: Array


class Barriers(NamedTuple):
    """Energy barriers between contact and separation at a held displacement.

    Attributes:
        detach: the energy of the pass less the energy of the contact [energy].
        jump_in: the energy of the pass less the energy of the separated bodies, zero [energy].

    Example:
        >>> found = js.references.jkr.barriers(-0.005, 1.0, 1.0, 1e-3)
        >>> f"{found.detach:.2e}, {found.jump_in:.2e}"
        '4.20e-05, 4.99e-08'
    """

    detach: Array
    jump_in: Array


def units(radius: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike) -> Scales:
    """Return F0, d0 and a0, with K = 4 E* / 3 (D. Maugis, J. Colloid Interface Sci. 150, 1992).

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Example:
        >>> unit = js.references.jkr.units(radius=1.0, contact_modulus=1.0, work_of_adhesion=1e-3)
        >>> f"{unit.force / (np.pi * 1e-3):.1f}"
        '1.0'
    """
    radius, contact_modulus, work = positive(
        radius=radius, contact_modulus=contact_modulus, work_of_adhesion=work_of_adhesion
    )
    contact_radius = np.cbrt(np.pi * work * radius**2 / (4 / 3 * contact_modulus))
    return Scales(np.pi * work * radius, contact_radius**2 / radius, contact_radius)


def curve(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> SphereState:
    """Return force and displacement of all equilibria, stable and unstable.

    Arguments:
        contact_radius: a [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Example:
        >>> found = js.references.jkr.curve(np.array([0.2, 0.3]), 1.0, 1.0, 1e-3)
        >>> [f"{x:.4f}" for x in found.force]
        ['-0.0035', '0.0100']
    """
    a, radius, contact_modulus, work = positive(
        contact_radius=contact_radius,
        radius=radius,
        contact_modulus=contact_modulus,
        work_of_adhesion=work_of_adhesion,
    )
    hertz = 4 * contact_modulus * a**3 / (3 * radius)
    return SphereState(
        hertz - np.sqrt(8 * np.pi * work * contact_modulus * a**3),
        a**2 / radius - np.sqrt(2 * np.pi * work * a / contact_modulus),
        a,
    )


def energy(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> Array:
    """Return U = F0 d0 (2 A^5 / 5 - (2 sqrt(6) / 3) A^(7/2) + A^2), A = a / a0.

    The integral of F over d along `curve`: the elastic energy, less w for each area in
    contact, zero without any [energy].

    Arguments:
        contact_radius: a [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Example:
        >>> f"{js.references.jkr.energy(0.3, 1.0, 1.0, 1e-3):.2e}"
        '1.58e-05'
    """
    (a,) = positive(contact_radius=contact_radius)
    unit = units(radius, contact_modulus, work_of_adhesion)
    ratio = a / unit.contact_radius
    number = 2 / 5 * ratio**5 - 2 * _SQRT_6 / 3 * ratio**3.5 + ratio**2
    return unit.force * unit.displacement * number


def states_at(
    displacement: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> tuple[SphereState, SphereState]:
    """Return the stable contact at a held displacement, and the unstable one, the pass.

    They lie between pull-off and first touch, d = -0.90856 d0 and 0; elsewhere both are NaN.

    Arguments:
        displacement: d, the approach, positive into contact [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Example:
        >>> stable, pass_ = js.references.jkr.states_at(-0.005, 1.0, 1.0, 1e-3)
        >>> f"{stable.force:.4f}, {pass_.force:.4f}"
        '-0.0046, -0.0000'
    """
    sphere = radius, contact_modulus, work_of_adhesion
    unit = units(*sphere)
    number = np.asarray(displacement) / unit.displacement
    # d in units of d0, where root = A^(1/2); it is least at A^(3/2) = 6^(1/2) / 6.
    lowest = np.cbrt(_SQRT_6 / 6)
    first = np.cbrt(2 * _SQRT_6 / 3)

    def short(root: Array) -> Array:
        return root**4 - 2 * _SQRT_6 / 3 * root - number

    large = bisect(short, lowest, first)
    small = bisect(short, lowest, 0)
    is_between = (short(np.asarray(lowest)) <= 0) & (number <= 0)
    states = []
    for root in (large, small):
        found = curve(np.where(is_between, root, 1) ** 2 * unit.contact_radius, *sphere)
        states.append(SphereState(*(np.where(is_between, value, np.nan) for value in found)))
    return states[0], states[1]


def barriers(
    displacement: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> Barriers:
    """Return the barriers to detach and to jump into contact at a held displacement.

    Adhesion has no range, so that the bodies apart are always stable below first touch. NaN where
    there is no pass, beyond pull-off and after first touch.

    Arguments:
        displacement: d, the approach, positive into contact [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Example:
        >>> found = js.references.jkr.barriers(-0.005, 1.0, 1.0, 1e-3)
        >>> f"{found.detach:.2e}, {found.jump_in:.2e}"
        '4.20e-05, 4.99e-08'
    """
    sphere = radius, contact_modulus, work_of_adhesion
    unit = units(*sphere)
    heights = []
    for state in states_at(displacement, *sphere):
        is_one = np.isfinite(state.contact_radius)
        safe = np.where(is_one, state.contact_radius, unit.contact_radius)
        heights.append(np.where(is_one, energy(safe, *sphere), np.nan))
    contact, top = heights
    return Barriers(top - contact, top)


def pull_off(
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    stiffness: ArrayLike = 0.0,
) -> SphereState:
    """Return the state where contact is lost: dF/dd = -k, pulled through a spring.

    Under dead load, k = 0, F = -(3/2) pi w R (Johnson, Kendall & Roberts 1971); under held
    displacement, k infinite, F = -(5/6) pi w R; between them Maugis & Barquins (1978).

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        stiffness: k of the spring [force/length].

    Example:
        >>> lost = js.references.jkr.pull_off(1.0, 1.0, work_of_adhesion=1e-3)
        >>> f"{lost.force / (np.pi * 1e-3):.2f}"
        '-1.50'
    """
    # The functions are d(F + k d)/dA of root = A^(3/2), up to a positive factor.
    return _where_zero(
        lambda root: 1.5 * np.cbrt(root**2) * (2 * root - _SQRT_6),
        lambda root: 2 * root - _SQRT_6 / 3,
        (_SQRT_6 / 6, _SQRT_6 / 2),
        (radius, contact_modulus, work_of_adhesion),
        stiffness,
    )


def jump_in(
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    stiffness: ArrayLike = np.inf,
) -> SphereState:
    """Return the state into which surfaces jump when they first touch, at d = 0: F + k d = 0.

    Adhesion of no range does not act before contact. Under held displacement F = -(4/3) pi w R
    and a^3 = 2 pi w R^2 / E*; under dead load F = 0 (Johnson, Kendall & Roberts 1971).

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        stiffness: k of the spring through which the sphere is pressed [force/length].

    Example:
        >>> found = js.references.jkr.jump_in(1.0, 1.0, work_of_adhesion=1e-3)
        >>> f"{found.force / (np.pi * 1e-3):.4f}"
        '-1.3333'
    """
    # The functions are F + k d of root = A^(3/2).
    return _where_zero(
        lambda root: root * (root - _SQRT_6),
        lambda root: np.cbrt(root) * (root - 2 * _SQRT_6 / 3),
        (2 * _SQRT_6 / 3, _SQRT_6),
        (radius, contact_modulus, work_of_adhesion),
        stiffness,
    )


def loop_loss(
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    stiffness: ArrayLike = np.inf,
) -> Array:
    """Return the energy dissipated by both jumps of a loop, `jump_in` and `pull_off`.

    Under held displacement 7.0922 (w^5 R^4 / E*^2)^(1/3), the difference of `energy`; a spring of
    stiffness k adds the difference of its F^2 / (2 k) [energy].

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        stiffness: k of the spring [force/length]; infinite under held displacement.

    Example:
        >>> f"{js.references.jkr.loop_loss(1.0, 1.0, work_of_adhesion=1e-3):.3e}"
        '7.092e-05'
    """
    stiffness = np.asarray(stiffness)
    require("The stiffness", stiffness, stiffness > 0, "give a positive number.")
    sphere = radius, contact_modulus, work_of_adhesion
    leaving = pull_off(*sphere, stiffness)
    entering = jump_in(*sphere, stiffness)
    contact = energy(leaving.contact_radius, *sphere) - energy(entering.contact_radius, *sphere)
    return contact + (leaving.force**2 - entering.force**2) / (2 * stiffness)


def spring_weights(stiffness: ArrayLike, unit: Scales) -> tuple[Array, Array]:
    """Return the weights 1 / (1 + k) of F and k / (1 + k) of d; k in `Scales` may be infinite.

    Example:
        >>> unit = js.references.jkr.units(1.0, 1.0, 1e-3)
        >>> [f"{x:.1f}" for x in js.references.jkr.spring_weights(np.inf, unit)]
        ['0.0', '1.0']
    """
    stiffness = not_negative("stiffness", stiffness) * unit.displacement / unit.force
    return 1 / (1 + stiffness), 1 - 1 / (1 + stiffness)


def _where_zero(
    f: Callable[[Array], Array],
    d: Callable[[Array], Array],
    between: tuple[float, float],
    sphere: tuple[ArrayLike, ArrayLike, ArrayLike],
    stiffness: ArrayLike,
) -> SphereState:
    """Return the state where f + k d is zero, both functions of A^(3/2) in units of `Scales`."""
    unit = units(*sphere)
    of_force, of_displacement = spring_weights(stiffness, unit)
    root = bisect(lambda root: of_force * f(root) + of_displacement * d(root), *between)
    return curve(np.cbrt(root**2) * unit.contact_radius, *sphere)
