"""Helpers for tests of closed forms."""

import numpy as np
from scipy.integrate import quad

from jaxstab.references import jkr, maugis

# R, E*, w without any unit of their own equal to one; A, L of waves and of a periodic surface.
SPHERE = 2.0, 3.0, 0.7
WAVES = 0.02, 0.15
UNITS = jkr.units(*SPHERE)
STIFFNESSES = 0.0, 0.3, 2.0, 30.0, np.inf


def wave(alpha, amplitude=0.3, length=2.0, contact_modulus=5.0):
    """Return Johnson's arguments of given alpha."""
    work = (alpha * np.pi * amplitude) ** 2 * contact_modulus / (2 * length)
    return amplitude, length, contact_modulus, work


def strength(parameter):
    """Return the tension of Maugis' sphere of given lambda."""
    return parameter / maugis.transition_parameter(*SPHERE, 1.0)


def derivative(function, x, step=1e-3):
    """Return f'(x) from six values, with an error of order step^6."""
    h = step * x
    differences = [(function(x + i * h) - function(x - i * h)) / (2 * i * h) for i in (1, 2, 3)]
    return np.dot([1.5, -0.6, 0.1], differences)


class Profile:
    """Contact with any axisymmetric profile, by quadrature of its slope.

    A pressure whose transform is g(x), from the middle to x = a, has the force 2 int g and the
    elastic energy int g^2 / E*; over the contact g = E* (d - Hertz's displacement at radius x).
    """

    def __init__(self, slope, contact_modulus, work):
        self.slope, self.contact_modulus, self.work = slope, contact_modulus, work

    def smooth(self, x):
        """The displacement at which contact without adhesion has the radius x (Sneddon 1965)."""
        return x * quad(lambda phi: self.slope(x * np.sin(phi)), 0, np.pi / 2, epsabs=1e-13)[0]

    def transform(self, x, displacement):
        return self.contact_modulus * (displacement - self.smooth(x))

    def force(self, a, displacement):
        return 2 * quad(self.transform, 0, a, displacement, epsabs=1e-12, limit=200)[0]

    def energy(self, a, displacement):
        squares = quad(lambda x: self.transform(x, displacement) ** 2, 0, a, limit=200)[0]
        return squares / self.contact_modulus - np.pi * a**2 * self.work


PARABOLOID = Profile(lambda r: r / SPHERE[0], *SPHERE[1:])
