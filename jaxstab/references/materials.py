"""Measured elastic constants of crystals at room temperature, in GPa, with their sources.

In Voigt's notation (xx, yy, zz, yz, xz, xy): `silicon`, `gallium_arsenide`, `copper` and `gold` are
cubic. `quartz` is alpha quartz with z along its threefold axis and x along a twofold one; the sign
of c14 is that of its source, and the other one for the opposite direction of y.
`Anisotropic(grid, silicon)` takes them as they are; 1e3 * silicon is in MPa.
"""

import numpy as np

from jaxstab.references.arguments import Array


def _cubic(c11: float, c12: float, c44: float) -> Array:
    stiffness = np.diag([c11 - c12] * 3 + [c44] * 3)
    stiffness[:3, :3] += c12
    return stiffness


def _trigonal(c11: float, c12: float, c13: float, c14: float, c33: float, c44: float) -> Array:
    stiffness = np.diag([c11, c11, c33, c44, c44, (c11 - c12) / 2])
    for i, j, constant in ((0, 1, c12), (0, 2, c13), (1, 2, c13), (0, 3, c14), (1, 3, -c14)):
        stiffness[i, j] = stiffness[j, i] = constant
    stiffness[4, 5] = stiffness[5, 4] = c14
    return stiffness


# J. J. Hall, Phys. Rev. 161, 756 (1967), and for 25 degrees Celsius C. Bourgeois et al., Proc. IEEE
# Int. Frequency Control Symp., 791 (1997).
silicon = _cubic(165.64, 63.94, 79.51)
# H. J. McSkimin, A. Jayaraman and P. Andreatch, J. Appl. Phys. 38, 2362 (1967).
gallium_arsenide = _cubic(118.77, 53.72, 59.44)
# W. C. Overton and J. Gaffney, Phys. Rev. 98, 969 (1955).
copper = _cubic(168.4, 121.4, 75.4)
# Y. Hiki and A. V. Granato, Phys. Rev. 144, 411 (1966).
gold = _cubic(192.9, 163.8, 41.5)
# H. J. McSkimin, P. Andreatch and R. N. Thurston, J. Appl. Phys. 36, 1624 (1965).
quartz = _trigonal(86.80, 7.04, 11.91, -18.04, 105.75, 58.20)

for _constants in (silicon, gallium_arsenide, copper, gold, quartz):
    _constants.flags.writeable = False
