"""Laws that can be added."""

from collections.abc import Callable
from typing import Any

import equinox as eqx

from jaxstab.core.display import inline
from jaxstab.core.types import Scalar


class Law(eqx.Module):
    """A law that can be added to another, or to a bare function of the gap.

    Example:
        >>> class Linear(js.potentials.Law):
        ...     def __call__(self, gap):
        ...         return jnp.minimum(0.1 * gap - 0.02, 0)
        >>> f"{(Linear() + law)(0.0):.2f}"
        '-0.05'
    """

    def __add__(self, other: object) -> "Sum":
        if not callable(other):
            return NotImplemented
        return Sum((*_parts(self), *_parts(other)))

    def __radd__(self, other: object) -> "Law":
        if isinstance(other, int) and other == 0:
            # `sum` starts with zero.
            return self
        if not callable(other):
            return NotImplemented
        return Sum((*_parts(other), *_parts(self)))


class Sum(Law):
    """The sum of laws, as `a + b` makes it.

    Arguments:
        laws: the laws, each a function of the gap; some may be `Varying`.

    Raises:
        ValueError: for no law, or one that is no function.

    Example:
        >>> both = law + js.potentials.Electrostatic(0.1, permittivity=1.0, dielectric=0.5)
        >>> type(both).__name__, f"{both(0.0):.2f}"
        ('Sum', '-0.04')
    """

    laws: tuple[Callable[[Scalar], Scalar], ...]

    __repr__ = inline

    def __check_init__(self) -> None:
        if not (self.laws and all(map(callable, self.laws))):
            raise ValueError(f"The laws are {self.laws!r}: give functions of the gap.")

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        first, *rest = (law(gap) for law in self.laws)
        return sum(rest, first)


def _parts(law: Any) -> tuple[Callable[[Scalar], Scalar], ...]:
    return law.laws if isinstance(law, Sum) else (law,)
