"""Dimensions of fields, and units of numbers.

A field states its dimension once, at its declaration:

    mean_pressure: Annotated[Scalar, PRESSURE]

Counts, flags, members of enumerations and other results need no dimension. A field lives on the
grid if its type names the last axes so, as `Field` does. The units of all dimensions follow from
the units of length and of pressure: in µm and MPa forces are in µN, energies in pJ and energies per
area in J/m^2.
"""

import re
from collections.abc import Callable, Collection, Container, Iterator
from dataclasses import fields
from functools import cache
from typing import NamedTuple, Protocol, Self, get_args

import numpy as np
from jaxtyping import Array

from jaxstab.core.checks import require_one_of
from jaxstab.core.compile import own_conventions
from jaxstab.core.equality import Comparable
from jaxstab.core.types import Scalar

_PREFIXES = dict(
    zip(range(-18, 13, 3), ["a", "f", "p", "n", "µ", "m", "", "k", "M", "G", "T"], strict=True)
)


def with_prefixes(unit: str, *prefixes: str) -> dict[str, int]:
    """Return a unit with some prefixes, or all, and the power of ten of each."""
    powers = {prefix: power for power, prefix in _PREFIXES.items()}
    return {f"{prefix}{unit}": powers[prefix] for prefix in prefixes or powers}


LENGTHS = (
    with_prefixes("m", "k", "")
    | {"cm": -2}
    | with_prefixes("m", "m", "µ", "n")
    | {"Å": -10}
    | with_prefixes("m", "p")
)
PRESSURES = with_prefixes("Pa", "", "k", "M", "G", "T")
FORCES = with_prefixes("N")
_ENERGIES = with_prefixes("J")
# Words and spellings of other programs.
_WORDS = {
    "kilo": "km",
    "": "m",
    "centi": "cm",
    "milli": "mm",
    "micro": "µm",
    "nano": "nm",
    "pico": "pm",
}
_NAMES = {
    f"{prefix}{word}{plural}": unit
    for prefix, unit in _WORDS.items()
    for word in ("meter", "metre")
    for plural in ("", "s")
}
_NAMES |= dict.fromkeys(("micron", "microns"), "µm")
_NAMES |= dict.fromkeys(("angstrom", "angstroms", "ångström", "ångströms", "ang"), "Å")
# Micro is written as a Greek letter, as a sign, or as u; the angstrom as a letter or a sign.
_SPELLINGS = {"um": "µm", "\u03bcm": "µm", "A": "Å", "\u212b": "Å"}
# SI units, with the powers of pressure and length that they are products of.
_SI = {
    "energy": ("J", 1, 3),
    "force": ("N", 1, 2),
    "area": ("m^2", 0, 2),
    "pressure": ("Pa", 1, 0),
    "length": ("m", 0, 1),
    "voltage": ("V", 0, 0),
}
_DIMENSIONS = {*_SI, "time", "temperature", "resistivity", "load"}
_WORD = re.compile(r"([a-z]+)(?:\^(\d))?")
_ON_A_LINE = {
    "energy": "energy/length",
    "force": "force/length",
    "force/length": "pressure",
    "length^2": "length",
}


class Units(NamedTuple):
    """The units of length and of pressure, None where unknown, and the sides of the grid.

    On a line, which has one side, energies, forces and areas are per length of the other side.
    Forces and energies are shown in the units `force` and `energy`, None for a prefix that suits
    their size.
    """

    length: str | None = None
    pressure: str | None = None
    sides: int = 2
    force: str | None = None
    energy: str | None = None

    @classmethod
    def of_names(
        cls,
        length: str | None,
        pressure: str | None,
        force: str | None = None,
        energy: str | None = None,
    ) -> "Units":
        """Return units by their names; pressures are in Pa by default if lengths are in metres.

        Raises:
            ValueError: for a name of no unit of length, pressure, force or energy, and for a unit
                of force or energy without those of length and pressure.
        """
        unit = None
        if length is not None:
            unit = unit_of(length)
        if pressure is None and unit == "m":
            pressure = "Pa"
        if pressure is not None:
            require_one_of("the unit of pressure", pressure, PRESSURES)
        return cls(
            unit,
            pressure,
            force=_symbol_of_choice("force", force, FORCES, unit, pressure),
            energy=_symbol_of_choice("energy", energy, _ENERGIES, unit, pressure),
        )

    def text(
        self, value: float, dimension: str, digits: int = 3, error: float | None = None
    ) -> str:
        """Return a number with a readable unit where it is known, as "36.2 fJ".

        Arguments:
            value: the number, in the units of length and pressure.
            dimension: its dimension, as "energy/area".
            digits: the number of its digits.
            error: the error of the number, in the same units; it is shown to one digit, as
                "3.21 ± 0.04 kPa".
        """
        largest = abs(value) if error is None else max(abs(value), error)
        divisor, unit = readable_unit(self, dimension, largest)
        shown = f"{value / divisor:.{digits}g}"
        if error is not None:
            # Without an exponent.
            shown += f" ± {float(f'{error / divisor:.1g}'):g}"
        return f"{shown} {shown_unit(unit)}".rstrip()


NO_UNITS = Units()


class Dimension(str):
    """The name of a dimension, as in Annotated[Array, Dimension("pressure^3 length^2")].

    Words are length, pressure, energy, force, area, time, temperature and number "1", with powers,
    in products divided by a product. Units in tables, figures and files follow from it.

    Raises:
        ValueError: for other words or powers.

    Example:
        >>> js.Dimension("pressure length^2")
        'pressure length^2'
    """

    def __new__(cls, name: str) -> Self:
        """Check the words."""
        for factor in re.split(r"[ /()]+", name):
            word, *power = factor.split("^", 1)
            is_power = power in ([], ["exponent"]) or re.fullmatch(r"\d", power[0])
            if not (factor in ("", "1") or (word in _DIMENSIONS and is_power)):
                raise ValueError(
                    f"The dimension {name!r} has the factor {factor!r}: give powers from 2 to 9 of "
                    f"{', '.join(sorted(_DIMENSIONS))}, as in 'pressure^3 length^2 / time'."
                )
        return super().__new__(cls, name)


NUMBER = Dimension("1")
LENGTH = Dimension("length")
AREA = Dimension("length^2")
VOLUME = Dimension("length^3")
TIME = Dimension("time")
PRESSURE, ENERGY, STIFFNESS = map(Dimension, ("pressure", "energy", "pressure/length"))
FORCE = Dimension("force")
VISCOSITY = Dimension("pressure time")
# The stiffness of a machine: force over displacement.
SPRING_CONSTANT = Dimension("force/length")
SURFACE_ENERGY = Dimension("energy/area")


class _HasSurface(Protocol):
    def surface(self, field: Array) -> Array: ...


class Dimensioned(Comparable):
    """A module whose fields declare their dimensions."""

    @own_conventions()
    def in_units_of(self, pressure: Scalar) -> Self:
        """Convert pressures to another unit, given in the old one; lengths keep theirs."""
        kinds = dimensions(type(self))
        return self._with_fields(
            kinds,
            lambda name, x: in_units_of(x, kinds[name], pressure),
            lambda x: x.in_units_of(pressure),
        )

    def on_surface(self, solid: _HasSurface) -> Self:
        """Restrict the fields to the part of the grid where the surface is."""
        names = on_grid(type(self))
        return self._with_fields(
            names, lambda _, x: solid.surface(x), lambda x: x.on_surface(solid)
        )

    def _with_fields(
        self,
        names: Container[str],
        change: Callable[..., Array],
        inside: "Callable[..., Dimensioned]",
    ) -> Self:
        changed = object.__new__(type(self))
        for name in [field.name for field in fields(self)]:
            value = getattr(self, name)
            if isinstance(value, Dimensioned):
                value = inside(value)
            elif name in names and value is not None:
                value = change(name, value)
            object.__setattr__(changed, name, value)
        return changed


def in_units_of(value: Array, dimension: Dimension, pressure: Scalar) -> Array:
    """Return a value of a dimension with pressures in another unit, given in the old one."""
    power = sum(sign * of_pressure for sign, of_pressure, _ in _powers(dimension))
    if power == 0:
        return value
    if power == 1:
        return value / pressure
    return value / pressure**power


@cache
def dimensions(module: type[Dimensioned]) -> dict[str, Dimension]:
    """Return the dimension of each field that declares one."""
    return {name: parts[0] for name, parts in declared_dimensions(module).items()}


@cache
def declared_dimensions(module: type) -> dict[str, tuple[Dimension, ...]]:
    """Return the declared dimensions of each field, several for a tuple."""
    found = {}
    for field in fields(module):
        if parts := [part for part in _parts(field.type) if isinstance(part, Dimension)]:
            found[field.name] = tuple(parts)
    return found


@cache
def axes_of(module: type) -> dict[str, tuple[str, ...]]:
    """Return the names of the axes of each field that is an array, as its type declares them."""
    parts = ((field.name, part) for field in fields(module) for part in _parts(field.type))
    return {
        name: tuple(axes.replace("*", "").split())
        for name, part in parts
        if (axes := getattr(part, "dim_str", None)) is not None
    }


@cache
def on_grid(module: type) -> set[str]:
    """Return the names of the fields whose last axes are the axes of the grid."""
    return {name for name, axes in axes_of(module).items() if "".join(axes).endswith("grid")}


def _parts(kind: object) -> list[object]:
    return [part for one in get_args(kind) for part in _parts(one)] or [kind]


def unit_of(name: object) -> str:
    """Return the usual symbol of a unit of length.

    Raises:
        ValueError: for any other text.

    Example:
        >>> js.units.unit_of("micron")
        'µm'
    """
    unit = _SPELLINGS.get(str(name), str(name))
    unit = _NAMES.get(unit.strip().lower(), unit)
    if unit not in LENGTHS:
        raise ValueError(
            f"the unit is {name!r}: choose one of {', '.join(LENGTHS)}, and convert the lengths to "
            "it, as from inches to mm."
        )
    return unit


def _symbol_of_choice(
    name: str, given: str | None, known: Collection[str], length: str | None, pressure: str | None
) -> str | None:
    """Return the usual symbol of a unit of force or energy that a user has chosen."""
    if given is None:
        return None
    symbol = symbol_of(name, given, known)
    unknown = [name for name, x in (("length", length), ("pressure", pressure)) if x is None]
    if unknown:
        raise ValueError(
            f"The unit of {name} is {given!r}, but that of {unknown[0]} is unknown: give both, as "
            'in unit="nm", pressure_unit="GPa".'
        )
    return symbol


def symbol_of(name: str, given: object, known: Collection[str]) -> str:
    """Return the usual symbol of a derived unit, one of those known.

    Raises:
        ValueError: for any other text.
    """
    # Micro is written as u, or as a Greek letter.
    symbol = re.sub("^(u|\u03bc)", "µ", str(given))
    require_one_of(f"the unit of {name}", symbol, known)
    return symbol


def convert_lengths(value: np.ndarray, unit: str, other: str) -> np.ndarray:
    """Return lengths in another unit, rounded once: units are whole powers of ten apart."""
    exponent = LENGTHS[unit] - LENGTHS[other]
    if exponent < 0:
        # A negative power of ten is rounded itself.
        return value / 10.0**-exponent
    return value * 10.0**exponent


def unit_symbol(units: Units, dimension: str) -> str:
    """Return the unit of the numbers of a dimension, as "MPa/µm"; it keeps words without a unit."""
    exponent, text = _in_si(units, dimension)
    if exponent is None:
        return text
    if exponent == 0 or (exponent in _PREFIXES and _takes_prefix(text)):
        return _PREFIXES[exponent] + text
    return f"1e{exponent} {text}"


def readable_unit(units: Units, dimension: str, largest: float) -> tuple[float, str]:
    """Return a divisor of values up to the largest, and the unit with the prefix that suits them.

    Only derived units, as of forces, and metres and pascals take a prefix: another unit of length
    or pressure is the user's choice, and so is a unit of force or energy that was given.
    """
    if _power_of_choice(units, dimension) is not None:
        return chosen_unit(units, dimension)
    exponent, text = _in_si(units, dimension)
    if exponent is None and re.match(r"(m|Pa)(/|$)", text):
        exponent = 0
    # A number without its unit must not be divided by a prefix.
    takes_prefix = shown_unit(text) and _takes_prefix(text)
    if exponent is None or not takes_prefix or not 0 < largest < np.inf:
        return 1.0, unit_symbol(units, dimension)
    power, prefix = suitable_prefix(largest, exponent)
    return 10.0 ** (power - exponent), prefix + text


def suitable_prefix(largest: float, exponent: int = 0) -> tuple[int, str]:
    """Return the power of ten and the prefix that suit a positive number times 10^exponent."""
    power = int(3 * np.floor((np.log10(largest) + exponent + 1e-9) / 3))
    power = min(max(power, min(_PREFIXES)), max(_PREFIXES))
    return power, _PREFIXES[power]


def chosen_unit(units: Units, dimension: str) -> tuple[float, str]:
    """Return a divisor of the numbers of a dimension, and the unit that the user chose for them.

    Without a choice this is the unit of the numbers, with the divisor 1.
    """
    power = _power_of_choice(units, dimension)
    exponent, text = _in_si(units, dimension)
    if power is None or exponent is None:
        return 1.0, unit_symbol(units, dimension)
    return 10.0 ** (power - exponent), _PREFIXES[power] + text


def _power_of_choice(units: Units, dimension: str) -> int | None:
    """Return the power of ten of a unit of force or energy that the user chose, if any."""
    if dimension == FORCE and units.force is not None:
        return FORCES[units.force]
    if dimension == ENERGY and units.energy is not None:
        return _ENERGIES[units.energy]
    return None


def shown_unit(unit: str) -> str:
    """Return a unit as it stands beside a number; nothing where it is unknown, even in a part.

    A resistivity has the unit in which the user gave it, and stands for it.
    """
    is_known = (_DIMENSIONS - {"resistivity"}).isdisjoint(re.findall("[a-z]+", unit))
    if not is_known or unit == "1":
        return ""
    return typeset(unit)


def named_with_unit(name: str, unit: str) -> str:
    """Return the title of a column, with the unit in brackets if there is one."""
    if not unit:
        return name
    return f"{name} [{unit}]"


def in_brackets(unit: str) -> str:
    """Return a unit for a label, in brackets; nothing for a plain number."""
    if unit in ("", "1"):
        return ""
    return f"[{typeset(unit)}]"


def typeset(unit: str) -> str:
    """Return a unit with raised powers."""
    return re.sub(r"\^(\d)", lambda power: "⁰¹²³⁴⁵⁶⁷⁸⁹"[int(power[1])], unit)


def _takes_prefix(unit: str) -> bool:
    # The prefix of a unit with a power is raised to the power too.
    return not re.match(r"\w+\^|1", unit)


def _in_si(units: Units, dimension: str) -> tuple[int | None, str]:
    """Return a derived SI unit and the power of ten before it, or no power and the users' units."""
    length = units.length
    pressure = units.pressure
    sides = units.sides
    if sides == 1:
        dimension = _ON_A_LINE.get(dimension, dimension)
    if length is None or pressure is None or not re.search("energy|force|voltage", dimension):
        known = {"length": length, "pressure": pressure}
        return None, re.sub("[a-z]+", lambda word: known.get(word[0]) or word[0], dimension)
    exponent = 0
    for sign, of_pressure, of_length in _powers(dimension):
        exponent += sign * (of_pressure * PRESSURES[pressure] + of_length * LENGTHS[length])
    return exponent, re.sub("[a-z]+", lambda word: _SI.get(word[0], word)[0], dimension)


def _powers(dimension: str) -> Iterator[tuple[int, int, int]]:
    """Yield for each factor of a dimension its sign, and its powers of pressure and length."""
    for part, sign in zip(dimension.partition("/")[::2], (1, -1), strict=True):
        for word, power in _WORD.findall(part):
            _, of_pressure, of_length = _SI.get(word, ("", 0, 0))
            yield sign * int(power or 1), of_pressure, of_length
