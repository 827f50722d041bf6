"""What `print` and a notebook show of contacts and results: numbers in a few aligned lines.

Fields are shown by shape and range, and what JAX is tracing by shape alone.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from textwrap import shorten
from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from jaxstab.core.checks import are_finite, is_spread, known

# What reading raises where JAX traces, or where a transformation left no numbers or other ones.
UNREADABLE = (AttributeError, IndexError, TypeError, ValueError, RuntimeError)
# A table of more rows is shortened in its middle to this many.
_MOST_ROWS = 60
# Where the text of one field is cut.
_LONGEST_TEXT = 120


def inline(self: Any) -> str:
    """Return a module on one line, without fields on a grid and history: a `__repr__`."""
    return _line(self, with_grids=False)


def whole(self: Any) -> str:
    """Return a module on one line with all of its fields: a `__repr__`."""
    return _line(self, with_grids=True)


def _line(module: Any, with_grids: bool) -> str:
    arguments = [f"{name}={text(value)}" for name, value in _named(module, with_grids)]
    return f"{type(module).__name__}({', '.join(arguments)})"


def block(self: Any) -> str:
    """Return a module as one aligned line for each field: a `__repr__`."""
    rows = {
        name: shorten(text(value), _LONGEST_TEXT, placeholder=" ...")
        for name, value in _named(self, with_grids=True)
        if value is not None
    }
    width = max(map(len, rows), default=0)
    return "\n".join([type(self).__name__, *(f"  {k:<{width}}  {v}" for k, v in rows.items())])


def history(self: Any) -> str:
    """Return the first and last of a solver's indicators, on one line: a `__repr__`."""
    try:
        used = np.flatnonzero(np.isfinite(self.steps))
        recorded = {name: np.asarray(values)[used] for name, values in self.values.items()}
        ends = [f"{name}={x[0]:.3g} to {x[-1]:.3g}" for name, x in recorded.items()]
        return f"History({', '.join([f'{used.size} records', *ends])})"
    except UNREADABLE:
        return f"History({', '.join(self.names)})"


def sweep(self: Any) -> str:
    """Return a table with one line for each load: a `__repr__`."""
    try:
        return _table(_columns(self))
    except UNREADABLE:
        return block(self)


def path(self: Any) -> str:
    """Return what a path is in lines, and a table with one line for each of its jumps."""
    try:
        loads, jumps = np.asarray(self.load.value), self.jumps
        name = type(self.load).__name__
        lines = [
            f"Path: {name} {_number(loads[0])} to {_number(loads[-1])} in {loads.size} states, "
            f"{len(jumps)} jumps; {self.result.name}",
            *_energies(self),
        ]
        return "\n".join([*lines, _table(_jumps(name, jumps))] if len(jumps) else lines)
    except UNREADABLE:
        return block(self)


def _energies(path: Any) -> list[str]:
    """Return the lines on the work along a path and on what it has lost."""
    work, losses = np.asarray(path.equilibrium.work), np.asarray(path.jumps.dissipation)
    if np.isfinite(path.work):
        lines = [
            f"  work  {described(path.work)}",
            f"  lost in {len(losses)} jumps  {_number(losses.sum())}",
        ]
    else:
        known, number = work[np.isfinite(work)][-1], np.isfinite(np.cumsum(losses)).sum()
        lines = [
            f"  work until the surfaces fall apart  {_number(known)}",
            f"  lost in {number} jumps before  {_number(losses[:number].sum())}",
            "  after that neither is known: a dead load pulls surfaces apart without end",
        ]
    if path.unlocated is None:
        lines[0] += " by quadrature, as version 0.1.0 had it"
    elif path.unlocated > path.unlocated_error:
        amount, error = float(path.unlocated), float(path.unlocated_error)
        lines.append(f"  lost in jumps not located  {amount:.2g} ± {error:.1g}")
    return lines


def _jumps(name: str, jumps: Any) -> dict[str, list[str]]:
    areas = [state.contact_area for state in (jumps.before, jumps.after)]
    before, after = (_column(area, lambda part: f"{100 * part:.2f} %") for area in areas)
    return {
        name: _column(jumps.load.value, "{:.8g}".format),
        "kind": _column(jumps.kind.name, str),
        "dissipation": _column(jumps.dissipation, "{:.4e}".format),
        "mean pressure": _column(jumps.before.mean_pressure, "{:+.4e}".format),
        "contact area": before,
        "after": after,
    }


def _columns(sweep: Any) -> dict[str, list[str]]:
    equilibrium, stability = sweep.equilibrium, sweep.stability
    pairs = {} if stability is None else stability.pairs
    columns = {
        type(sweep.load).__name__: _column(sweep.load.value, "{:.6g}".format),
        "mean pressure": _column(equilibrium.mean_pressure, "{:+.4e}".format),
        "contact area": _column(equilibrium.contact_area, lambda part: f"{100 * part:.2f} %"),
        **{k.replace("_", " "): _column(x.eigenvalue, "{:+.4e}".format) for k, x in pairs.items()},
    }
    solvers = _column(equilibrium.result.name, str)
    if stability is not None:
        is_local = np.atleast_1d(stability.is_local)
        names = zip(_column(stability.verdict.name, str), is_local, strict=True)
        columns["verdict"] = [f"{name}, locally" if local else name for name, local in names]
        judged = _column(stability.result.name, str)
        solvers = [x if x != "successful" else y for x, y in zip(solvers, judged, strict=True)]
    steps = [_column(x.num_steps, str) for x in (equilibrium, *pairs.values())]
    return columns | {"steps": list(map(" + ".join, zip(*steps, strict=True))), "solvers": solvers}


def _column(values: Any, form: Callable[[Any], str]) -> list[str]:
    return [form(value) for value in np.atleast_1d(values).tolist()]


def _table(columns: Mapping[str, Iterable[str]]) -> str:
    rows = list(zip(*columns.values(), strict=True))
    if len(rows) > _MOST_ROWS:
        half = _MOST_ROWS // 2
        rows = [*rows[:half], ("...",) * len(columns), *rows[-half:]]
    lines = [tuple(columns), *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = ["  ".join(map(str.rjust, line, widths)) for line in lines]
    return "\n".join([texts[0], "-" * len(texts[0]), *texts[1:]])


def described(value: Any) -> str:
    """Return dtype and shape of an array, and its range if known; of a scalar the number."""
    if not _is_readable(value):
        return f"traced {_kind(value)}" if isinstance(value, jax.core.Tracer) else _kind(value)
    numbers = known(value)
    if numbers.size <= 3 and numbers.ndim <= 1:
        texts = [_number(number) for number in numbers.ravel().tolist()]
        return texts[0] if numbers.ndim == 0 else f"[{', '.join(texts)}]"
    return f"{_kind(value)} {_range(numbers)}"


def _named(module: Any, with_grids: bool) -> Iterator[tuple[str, Any]]:
    """Yield the fields of a module; what lives on a grid has more axes than its numbers."""
    shown = [f.name for f in fields(module) if f.repr and hasattr(module, f.name)]
    values = {name: getattr(module, name) for name in shown}
    axes = {name: value.ndim for name, value in values.items() if _is_array(value)}
    fewest = min(axes.values(), default=0)
    for name, value in values.items():
        is_long = axes.get(name, 0) > fewest or type(value).__repr__ is history
        if with_grids or not is_long:
            yield name, value


def text(value: Any) -> str:
    """Return what is shown of a field: of an array its range, of a number itself."""
    if _is_array(value):
        return described(value)
    if isinstance(value, int | float | complex):
        return _number(value)
    if isinstance(value, eqx.Module) and type(value).__repr__ in (eqx.Module.__repr__, block):
        return inline(value)
    if isinstance(value, tuple | list | dict):
        words = jax.tree.map(lambda part: _Word(text(part)), value, is_leaf=_is_content)
        return repr(words)
    return " ".join(repr(value).split())


class _Word(str):
    """A text that containers show without quotes."""

    __repr__ = str.__str__


def _is_content(value: Any) -> bool:
    return not isinstance(value, tuple | list | dict)


def _is_array(value: Any) -> bool:
    return all(hasattr(value, name) for name in ("dtype", "shape", "ndim"))


def _number(value: Any) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def _kind(value: Any) -> str:
    if not _is_array(value):
        return type(value).__name__
    return f"{value.dtype}[{', '.join(map(str, value.shape))}]"


def _range(numbers: Any) -> str:
    if numbers.dtype == bool:
        return f"with {numbers.sum()} true"
    xp, finite = jnp if is_spread(numbers) else np, are_finite(numbers)
    missing = f"with {numbers.size - finite.sum()} not finite"
    if not finite.any():
        return missing
    # Of a negative zero nothing is to be read.
    least, most = (
        float(reduce(numbers + 0.0, where=finite, initial=far)) + 0.0
        for reduce, far in ((xp.min, np.inf), (xp.max, -np.inf))
    )
    ends = f"from {least:.4g} to {most:.4g}"
    return ends if finite.all() else f"{ends}, {missing}"


def _is_readable(leaf: Any) -> bool:
    if isinstance(leaf, jax.core.Tracer) or not isinstance(leaf, np.ndarray | jax.Array):
        return False
    if isinstance(leaf, jax.Array):
        # What other processes hold they would have to be asked for at the same time.
        is_here = leaf.is_fully_addressable or leaf.is_fully_replicated
        if leaf.is_deleted() or not is_here:
            return False
    return any(jnp.issubdtype(leaf.dtype, kind) for kind in (np.number, np.bool_))
