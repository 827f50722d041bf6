"""Which closed form describes a sphere: Hertz, JKR, DMT or Maugis, beside the solution of Maugis.

D. Tabor, J. Colloid Interface Sci. 58, 2 (1977); D. Maugis, J. Colloid Interface Sci. 150, 243
(1992); K. L. Johnson, J. A. Greenwood, J. Colloid Interface Sci. 192, 326 (1997).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jaxstab.core import display
from jaxstab.references import maugis
from jaxstab.references.arguments import Array, ArrayLike, positive

# The radius, contact modulus and work of adhesion of which all of `jkr.units` are one.
_UNIT_SPHERE = 1.0, 3 / 4, 1 / np.pi
# Pull-off forces over pi w R; Hertz' sphere has none.
_PULL_OFFS = {"hertz": 0.0, "jkr": 1.5, "dmt": 2.0}
_TOLERANCES = 0.01, 0.05, 0.2


@dataclass(frozen=True)
class AdhesionRegime:
    """The adhesion parameters of a sphere, and the errors of closed forms; print it for a table.

    Attributes:
        tabor: Tabor's parameter mu [1].
        maugis: Maugis' parameter lambda = 1.127 mu [1].
        pull_off: F / (pi w R) of Maugis' solution under dead load, from -2 to -3/2 [1].
        errors: for each of hertz, jkr, dmt and maugis, the relative error of the pull-off force.

    Example:
        >>> f"{js.references.regime(1.0, 1.0, 1e-3, 1e-2).tabor:.3f}"
        '1.000'
    """

    tabor: Array
    maugis: Array
    pull_off: Array
    errors: Mapping[str, Array]

    def __repr__(self) -> str:
        numbers = {"Tabor": self.tabor, "Maugis": self.maugis, "pull-off / (pi w R)": self.pull_off}
        columns = {name: display.column(x, "{:.4g}".format) for name, x in numbers.items()}
        for model, error in self.errors.items():
            columns[f"error of {model}"] = display.column(error, "{:.2%}".format)
        lines = [display.table(columns)]
        if np.ndim(self.tabor) == 0:
            for tolerance in _TOLERANCES:
                models = [model for model, error in self.errors.items() if error <= tolerance]
                lines.append(f"Pull-off within {100 * tolerance:.0f} %: {', '.join(models)}.")
        return "\n".join(lines)


def regime(
    radius: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike, range: ArrayLike
) -> AdhesionRegime:
    """Return the parameters of Tabor and Maugis, and the errors of the closed forms' pull-off.

    mu = (R w^2 / (E*^2 z0^3))^(1/3) (Tabor 1977). Maugis' tension s acts up to the range,
    s = w / z0, so that lambda = 2 s / (pi w K^2 / R)^(1/3) = (9 / (2 pi))^(1/3) mu, K = 4 E* / 3.
    With s of the same peak as the law of Lennard-Jones, 1.03 w / z0, it would be 1.157 mu.

    Errors are |F - F_Maugis| / |F_Maugis| under dead load, of JKR's -(3/2) pi w R, of DMT's
    -2 pi w R, and of Hertz' sphere, which does not adhere: its error is always 1. Maugis' solution
    is the reference, of error 0.

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        range: z0, up to which the attraction acts [length].

    Raises:
        ValueError: for an argument that is not positive and finite.

    Example:
        >>> regime = js.references.regime(
        ...     radius=1.0, contact_modulus=1.0, work_of_adhesion=1e-3, range=1e-2
        ... )
        >>> f"{regime.tabor:.3f}, {regime.maugis:.3f}"
        '1.000, 1.127'
    """
    radius, contact_modulus, work, z0 = positive(
        radius=radius,
        contact_modulus=contact_modulus,
        work_of_adhesion=work_of_adhesion,
        range=range,
    )
    # Powers of each factor: the cube of a range in metres underflows in a product of several.
    tabor = np.cbrt(radius / z0) * np.cbrt(work / (contact_modulus * z0)) ** 2
    parameter = np.cbrt(9 / (2 * np.pi)) * tabor
    pull_off = maugis.pull_off(*_UNIT_SPHERE, parameter / 2).force
    errors = {name: abs(force / -pull_off - 1) for name, force in _PULL_OFFS.items()}
    return AdhesionRegime(tabor, parameter, pull_off, {**errors, "maugis": np.zeros_like(pull_off)})


def contact_radius_errors(parameter: Array, load: Array) -> dict[str, Array]:
    """Return the relative errors of the contact radius of hertz, jkr and dmt, beside Maugis'.

    Arguments:
        parameter: Maugis' lambda, one for each row [1].
        load: P / (pi w R) > 0, in compression, one for each column [1].
    """
    # The load rises with the radius where it is positive; it is A^3 of Hertz, less at most A^3.
    radius = np.geomspace(1, 2 + np.cbrt(np.max(load) + 2), 200)
    states = maugis.curve(radius, *_UNIT_SPHERE, parameter[:, None] / 2)
    radius = np.array([np.interp(load, forces, radius) for forces in states.force])
    # Of JKR the stable branch of F = A^3 - sqrt(6 A^3).
    cubes = {"hertz": load, "jkr": (np.sqrt(1.5) + np.sqrt(1.5 + load)) ** 2, "dmt": load + 2}
    return {name: abs(np.cbrt(x) / radius - 1) for name, x in cubes.items()}
