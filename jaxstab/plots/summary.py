"""The summary of a state in one figure."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstab.contact import Contact
from jaxstab.core.checks import require_kind
from jaxstab.core.stack import require_single
from jaxstab.core.units import in_brackets, readable_unit
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrium import State, found_equilibrium
from jaxstab.loads import MeanPressure
from jaxstab.plots.fields import gap, mode, outline_contact, pressure, surface
from jaxstab.plots.style import Panels, quantity_label
from jaxstab.stability import Eigenpair, Stability

_PANELS: Panels = [["surface", "gap", "numbers"], ["pressure", "mode", "numbers"]]
# In sizes of the font.
_LINE_SPACING = 1.7


def summary(contact: Contact, equilibrium: State, stability: Stability | None = None) -> Figure:
    """Draw a state in one figure: surface, gap, pressure, the cone's mode, and its numbers.

    The contact is outlined on gap and mode, or on a line shaded.

    Arguments:
        contact: the contact problem.
        equilibrium: the state; an entry of a sweep holds its stability too.
        stability: a result of `assess_stability` for it.

    Returns:
        The figure.

    Raises:
        TypeError: for something that is not a state, or a stability that is not one.
        ValueError: for a stack, a state without its stability, or one on another grid.

    Example:
        >>> figure = js.plots.summary(contact, state, js.assess_stability(contact, state))
    """
    state = found_equilibrium(contact, equilibrium)
    known = stability
    if known is None:
        known = getattr(equilibrium, "stability", None)
    if known is None:
        raise ValueError(
            "The stability of this state is missing: give it, as in summary(contact, equilibrium, "
            "jaxstab.assess_stability(contact, equilibrium))."
        )
    cure = "give a result of jaxstab.assess_stability."
    require_kind(known, Stability, f"not a stability: {cure}")
    require_single(known)
    figure = plt.figure(figsize=(11, 5.2), layout="constrained")
    panels = figure.subplot_mosaic(_PANELS, width_ratios=[1, 1, 1.4])
    surface(contact, axes=panels["surface"])
    gap(contact, state, axes=panels["gap"])
    outline_contact(panels["gap"], contact, state.in_contact, "white")
    pressure(contact, state, axes=panels["pressure"])
    mode(contact, known.cone, state, axes=panels["mode"]).set_title("")
    _write(panels["numbers"], _numbers(state, known))
    return figure


def _numbers(state: Equilibrium, stability: Stability) -> list[tuple[str, str]]:
    load = state.load
    pairs = stability.pairs
    units = state.units
    eigenvalues = np.array([float(pair.eigenvalue) for pair in pairs.values()])
    largest = np.abs(eigenvalues[np.isfinite(eigenvalues)]).max(initial=0)
    divisor, stiffness = readable_unit(units, "pressure/length", largest)
    verdict = stability.verdict.name.replace("_", " ")
    if stability.is_local:
        verdict = "stable, locally"
    value = float(load.value)
    # The symbol is left out, since its index would shift the lines below.
    quantity = quantity_label("load", load).partition(" [")[0].split(" $")[0]
    text = f"{value:.4g}"
    if load.unit:
        text = units.text(value, load.unit, digits=4)
    lines = [(quantity, text)]
    if state.is_window:
        lines.append(("force", units.text(float(state.force), "force", digits=4)))
    if not isinstance(load, MeanPressure):
        lines.append(("mean pressure", units.text(float(state.mean_pressure), "pressure")))
    lines += [
        ("contact area", f"{100 * float(state.contact_area):.1f} %"),
        ("", ""),
        ("eigenvalues", in_brackets(stiffness)),
        *((name.replace("_", " "), _value(pair, divisor)) for name, pair in pairs.items()),
        ("", ""),
        ("verdict", verdict),
    ]
    barrier = stability.barrier
    if np.isfinite(barrier.height):
        lines += [
            ("barrier", units.text(float(barrier.height), "energy")),
            ("at amplitude", units.text(float(barrier.amplitude), "length")),
        ]
    for part in (state, stability):
        if part.result != "successful":
            lines.append((type(part).__name__.lower(), part.result.name.replace("_", " ")))
    return lines


def _value(pair: Eigenpair, divisor: float) -> str:
    """Return the text of an eigenvalue with its error over a divisor, or of its failure."""
    if pair.result != "successful":
        return pair.result.name.replace("_", " ")
    value = float(pair.eigenvalue) / divisor
    if not np.isfinite(value):
        return "none admissible"
    return f"{value:.3g} ± {float(pair.error) / divisor:.1g}"


def _write(axes: Axes, lines: list[tuple[str, str]]) -> None:
    axes.axis("off")
    for row, line in enumerate(lines, start=1):
        for side, (text, alignment) in enumerate(zip(line, ("left", "right"), strict=True)):
            axes.annotate(
                text,
                (side, 1),
                (0, -_LINE_SPACING * row),
                xycoords="axes fraction",
                textcoords="offset fontsize",
                ha=alignment,
            )
