"""Measured force curves."""

from collections.abc import Mapping
from typing import Any, Literal, Protocol, Self

from matplotlib.axes import Axes

from jaxstab.core.checks import require_one_of
from jaxstab.core.units import in_brackets
from jaxstab.plots.style import BLUE, PURPLE, VERMILION, add_legend, axes_or_new, draw_zero

_COLOURS = {"approach": BLUE, "retraction": VERMILION}
_ABSCISSAE = {"height": "height", "tip_position": "tip position", "time": "time"}


class _DrawnCurve(Protocol):
    """A `jaxstab.lab.force_curves.ForceCurve`."""

    @property
    def segments(self) -> Mapping[str, Any]: ...

    @property
    def readable(self) -> Self: ...

    @property
    def spring_constant(self) -> float | None: ...

    @property
    def unit(self) -> str: ...

    @property
    def force_unit(self) -> str: ...


def force_curve(
    curve: _DrawnCurve,
    abscissa: Literal["height", "tip_position", "time"] | None = None,
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw a measured force curve: its segments over tip position, height or time.

    A curve in metres and newtons is drawn with the prefixes that suit it, as `curve.readable`.

    Arguments:
        curve: a result of `jaxstab.lab.force_curves.read`.
        abscissa: by default the tip position, or the height if the spring constant is unknown.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for anything but a curve, such as several.
        ValueError: for another abscissa, and one that the curve lacks.

    Example:
        >>> axes = js.plots.force_curve(curve, "height")
        >>> axes.get_xlabel()
        'height [µm]'
    """
    if not isinstance(getattr(curve, "segments", None), Mapping):
        cure = "give a result of jaxstab.lab.force_curves.read"
        raise TypeError(f"{type(curve).__name__} is no force curve: {cure}.")
    if abscissa is None:
        abscissa = "tip_position"
        if curve.spring_constant is None:
            abscissa = "height"
    require_one_of("abscissa", abscissa, _ABSCISSAE)
    curve = curve.readable
    axes = axes_or_new(axes)
    for name, segment in curve.segments.items():
        x = getattr(segment, abscissa)
        if x is None:
            raise ValueError(f"The {name} has no {_ABSCISSAE[abscissa]}: its file holds none.")
        axes.plot(x, segment.force, color=_COLOURS.get(name, PURPLE), linewidth=1, label=name)
    draw_zero(axes)
    unit = "s" if abscissa == "time" else curve.unit
    axes.set(
        xlabel=f"{_ABSCISSAE[abscissa]} {in_brackets(unit)}",
        ylabel=f"force {in_brackets(curve.force_unit)}",
    )
    add_legend(axes)
    return axes
