"""Persson and Brener (2005): the work to open a viscoelastic crack, as a function of its speed.

A long crack opens steadily in a solid of moduli 1 + sum r_k exp(-t / t_k), over the relaxed one.
The solid dissipates around the tip, outside a tip radius a. The stress there is the strength
of the law, so that the radius grows with the work: a = a0 w / w0. The solid is relaxed far from the
tip, and glassy at the tip of a fast crack, where the work tends to w0 (1 + sum r_k).

B. N. J. Persson, E. A. Brener, Phys. Rev. E 71, 036123 (2005).
"""

import numpy as np

from jaxstab.core.checks import require
from jaxstab.core.roots import bisect
from jaxstab.references.arguments import Array, ArrayLike, not_negative, positive


def tip_radius(
    work_of_adhesion: ArrayLike, strength: ArrayLike, contact_modulus: ArrayLike
) -> Array:
    """Return a0 = E* w0 / (pi s^2), where the stress K / sqrt(2 pi a0) is the strength s [length].

    K^2 = 2 E* w0 for a crack between an elastic and a rigid solid.

    Arguments:
        work_of_adhesion: w0 [energy/area].
        strength: s, the largest attraction of the law [pressure].
        contact_modulus: E* of the relaxed solid [pressure].

    Raises:
        ValueError: if an argument is not positive and finite.

    Example:
        >>> radius = js.references.persson_brener.tip_radius(1e-3, 0.1, contact_modulus=1.0)
        >>> f"{radius * np.pi:.2f}"
        '0.10'
    """
    w, s, modulus = positive(
        work_of_adhesion=work_of_adhesion, strength=strength, contact_modulus=contact_modulus
    )
    return modulus * w / (np.pi * s**2)


def work(speed: ArrayLike, ratios: ArrayLike, times: ArrayLike, tip_radius: ArrayLike) -> Array:
    """Return w / w0 of a crack that opens at a speed.

    w0 / w = 1 - (2 / pi) E_0 int_0^W (dq / q) sqrt(1 - (q / W)^2) Im 1 / E(q), with W = 2 pi v / a
    and E_0 the relaxed modulus. With the creep compliance J_j, T_j of the Prony series the integral
    is sum J_j (sqrt(1 + b^2) - 1) / b, b = W T_j.

    Arguments:
        speed: v of the edge [length/time], one or an array.
        ratios: r_k, as of `jaxstab.Viscoelastic`.
        times: t_k, one for each ratio [time].
        tip_radius: a0 [length].

    Raises:
        ValueError: for ratios and times of different numbers, a negative or infinite ratio, and
            another argument that is not positive and finite.

    Example:
        >>> speeds = np.array([1e-6, 1e6])
        >>> found = js.references.persson_brener.work(speeds, (1.0,), times=(1.0,), tip_radius=1.0)
        >>> [f"{w:.3f}" for w in found]
        ['1.000', '2.000']
    """
    (speed,) = positive(speed=speed)
    (times,) = positive(relaxation_time=times)
    (radius,) = positive(tip_radius=tip_radius)
    ratios, times = np.atleast_1d(not_negative("ratio", ratios), times)
    require("A ratio", ratios, np.isfinite(ratios), "give a finite number.")
    if ratios.ndim != 1 or ratios.shape != times.shape:
        raise ValueError(
            f"The ratios have shape {ratios.shape}, the relaxation times {times.shape}: give a "
            "time for each ratio."
        )
    # The poles of 1 / E(s) are eigenvalues of the branches under a held stress.
    glassy = 1 + ratios.sum()
    root = np.sqrt(ratios / times)
    rates, modes = np.linalg.eigh(np.diag(1 / times) - np.outer(root, root) / glassy)
    compliances = (root @ modes) ** 2 / (glassy**2 * rates)

    def relative_work(turns: Array) -> Array:
        b = turns[..., None] / rates
        return 1 / (1 - (b / (np.sqrt(1 + b**2) + 1)) @ compliances)

    def missing(turns: Array) -> Array:
        return turns * radius * relative_work(turns) / (2 * np.pi) - speed

    slowest = 2 * np.pi * speed / radius / glassy
    return relative_work(bisect(missing, slowest, slowest * glassy))
