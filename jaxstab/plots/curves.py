"""Curves: interaction laws, the steps of an eigensolver, states over the load, power spectra."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Array, Float
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from jaxstab.core.checks import parameter, require_kind, require_one_of
from jaxstab.core.units import Units
from jaxstab.loading.sweep import Sweep
from jaxstab.plots.fields import require_pair
from jaxstab.plots.paths import Quantity, of_states
from jaxstab.plots.style import (
    QUANTITIES,
    add_legend,
    axes_or_new,
    default_ordinate,
    draw_zero,
    label_axes,
    labels_or_none,
    plain_decades,
    quantity_label,
    scale_decades,
    verdict_markers,
)
from jaxstab.potentials import Potential, energy_density, slope
from jaxstab.stability import Eigenpair
from jaxstab.surfaces import PowerSpectrum

_INDICATORS = {"residual": "projected residual", "epsilon": r"$\epsilon$", "eta": r"$\eta$"}


def potential(
    laws: Potential | Sequence[Potential],
    gaps: Float[Array, " gaps"],
    *,
    labels: Sequence[str] | None = None,
    unit: str | None = None,
    pressure_unit: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw interaction laws f(g) (Rey & Bleyer, fig. 7a).

    Arguments:
        laws: one or more functions of the gap.
        gaps: the gaps to draw them at [length].
        labels: their names, by default the names of the functions or classes.
        unit, pressure_unit: the units of length and of pressure, as in `Contact`.
        axes: the axes to draw on; new ones by default.

    Example:
        >>> axes = js.plots.potential(law, np.linspace(0.0, 0.3, 50))
    """
    label = "energy per area f(g) [energy/area]"
    units = Units.of_names(unit, pressure_unit)
    return _laws(energy_density, label, laws, gaps, labels, units, axes)


def force(
    laws: Potential | Sequence[Potential],
    gaps: Float[Array, " gaps"],
    *,
    labels: Sequence[str] | None = None,
    unit: str | None = None,
    pressure_unit: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw the attraction f'(g) of interaction laws (Rey & Bleyer, fig. 7b), as `potential`.

    Example:
        >>> axes = js.plots.force(law, np.linspace(0.0, 0.3, 50))
    """
    units = Units.of_names(unit, pressure_unit)
    return _laws(slope, "attraction f'(g) [pressure]", laws, gaps, labels, units, axes)


def convergence(pair: Eigenpair, *, axes: Axes | None = None) -> Axes:
    """Draw the indicators of the eigensolver over its steps (Rey & Bleyer, fig. 5).

    Example:
        >>> axes = js.plots.convergence(js.assess_stability(contact, state).cone)
    """
    require_pair(pair)
    axes = axes_or_new(axes)
    for name, values in pair.history.values.items():
        label = _INDICATORS.get(name, name)
        # At the start epsilon and eta are zero by construction.
        axes.semilogy(pair.history.steps[1:], values[1:], ".-", label=label)
    axes.set(xlabel="step", ylabel="indicator")
    plain_decades(axes.yaxis)
    add_legend(axes)
    return axes


def stability_curve(
    sweep: Sweep,
    quantity: Quantity | None = None,
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw a quantity over the load, with filled markers for stable states (Rey & Bleyer, fig. 12).

    No line joins the states, as a jump may lie between two. Diamonds are stable, but not proved.
    States that were not found are left out.

    Arguments:
        sweep: the states.
        quantity: a field of `Equilibrium` that is one number for each load; by default the mean
            pressure, or on a window the force; over a dead load the mean gap.
        axes: the axes to draw on; new ones by default.

    Raises:
        ValueError: for a quantity that cannot be drawn, a single state, or a sweep without
            stability.

    Example:
        >>> axes = js.plots.stability_curve(js.sweep(contact, js.MeanGap([0.05, 0.1])))
    """
    require_one_of("quantity", quantity or "force", QUANTITIES)
    if not isinstance(sweep, Sweep) or len(sweep.stack_shape) != 1:
        raise ValueError(
            f"This {type(sweep).__name__} is no sweep over one axis of loads: give a whole "
            "result of jaxstab.sweep. A path is drawn by jaxstab.plots.path."
        )
    if sweep.stability is None:
        raise ValueError("This sweep left stability out: run it with stability=True.")
    axes = axes_or_new(axes)
    is_window = sweep.equilibrium.is_window
    quantity = quantity or default_ordinate(sweep.load, is_window, "load")
    load = of_states(sweep, "load")
    values = of_states(sweep, quantity)
    verdicts = np.where(sweep.stability.is_local, "stable, locally", sweep.stability.verdict.name)
    is_found = np.asarray(sweep.equilibrium.result == "successful")
    for name, marker in verdict_markers(axes).items():
        chosen = (verdicts == name) & is_found
        if chosen.any():
            axes.scatter(load[chosen], values[chosen], label=name.replace("_", " "), **marker)
    scale_decades(axes.xaxis, load)
    scale_decades(axes.yaxis, values[is_found])
    x, y = (quantity_label(name, sweep.load) for name in ("load", quantity))
    label_axes(axes, x, y, sweep.equilibrium.units)
    add_legend(axes)
    return axes


def spectrum(
    spectrum: PowerSpectrum | Sequence[PowerSpectrum],
    *,
    labels: Sequence[str] | None = None,
    unit: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw power spectra of surfaces over the wavenumber, both on logarithmic axes.

    Rings without waves are left out, and those whose density is zero but for rounding.

    Arguments:
        spectrum: one or more results of `jaxstab.surfaces.power_spectrum`.
        labels: their names, shown in a legend.
        unit: the unit of length, as `topography.unit`.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for anything but spectra.
        ValueError: for a stack of spectra, a spectrum that is zero, and another number of labels.

    Example:
        >>> axes = js.plots.spectrum(js.surfaces.power_spectrum(grid, heights))
    """
    if isinstance(spectrum, PowerSpectrum):
        spectrum = [spectrum]
    spectra = list(spectrum)
    names = labels_or_none(labels, len(spectra))
    axes = axes_or_new(axes)
    for each, name in zip(spectra, names, strict=True):
        axes.loglog(*_rings(each), ".-", label=name)
    # Labels of other ticks would overlap.
    axes.xaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    # A ring on a line holds a wave and its mirror image.
    are_lines = all(np.asarray(each.num_waves).max() <= 2 for each in spectra)
    density = f"power spectral density [length^{4 - are_lines}]"
    label_axes(axes, "wavenumber q [1/length]", density, Units.of_names(unit, None))
    for axis in (axes.xaxis, axes.yaxis):
        plain_decades(axis)
    if labels is not None:
        add_legend(axes)
    return axes


def _rings(spectrum: PowerSpectrum) -> tuple[np.ndarray, np.ndarray]:
    """Return wavenumber and density of the rings that can be drawn."""
    cure = "give a result of jaxstab.surfaces.power_spectrum."
    require_kind(spectrum, PowerSpectrum, f"not a spectrum: {cure}")
    density = np.asarray(spectrum.density)
    if density.ndim != 1:
        raise ValueError(f"This is a stack of {len(density)} spectra: give them as a list.")
    # In each amplitude heights and transforms leave a few eps of the largest.
    rounding = (8 * np.finfo(density.dtype).eps) ** 2 * density.max()
    drawn = (np.asarray(spectrum.num_waves) > 0) & (density > rounding)
    if not drawn.any():
        raise ValueError("The spectrum is zero: a flat surface has none to draw.")
    return np.asarray(spectrum.wavenumber)[drawn], density[drawn]


def _laws(
    derivative: Callable[[Potential, Float[Array, " gaps"]], Float[Array, " gaps"]],
    ylabel: str,
    laws: Potential | Sequence[Potential],
    gaps: Float[Array, " gaps"],
    labels: Sequence[str] | None,
    units: Units,
    axes: Axes | None,
) -> Axes:
    axes = axes_or_new(axes)
    if not isinstance(laws, Sequence):
        laws = [laws]
    for law in laws:
        if not callable(law):
            raise TypeError(
                f"The law is a {type(law).__name__}: give a function of the gap, as "
                "`contact.potential`."
            )
    gaps = parameter(gaps, "The gaps")
    names = labels_or_none(labels, len(laws))
    for law, name in zip(laws, names, strict=True):
        label = name or getattr(law, "__name__", type(law).__name__)
        axes.plot(np.asarray(gaps), np.asarray(derivative(law, gaps)), label=label)
    draw_zero(axes)
    label_axes(axes, "gap g [length]", ylabel, units)
    add_legend(axes)
    return axes
