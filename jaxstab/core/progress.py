"""Progress bars, which compiled code can move too."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import jax
from jaxtyping import Array

from jaxstab.core.checks import is_transformed
from jaxstab.core.warn import warn

if TYPE_CHECKING:
    from tqdm import tqdm

# Takes what was computed last.
Report = Callable[[Any], object]

_bars: list[tqdm] = []


@contextmanager
def progress_bar(total: int, unit: str, *, shown: bool = True, done: int = 0) -> Iterator[tqdm]:
    """Show a bar of `total` units, some `done` before, that `advance` moves, to the block's end.

    It says "compiling" until the first step, most of whose time that is.
    """
    from tqdm import tqdm

    class Bar(tqdm):
        def update(self, n: float | None = 1) -> bool | None:
            if not self.disable and self.desc:
                self.set_description()
            return super().update(n)

    with Bar(total=total, unit=unit, disable=not shown, initial=done, desc="compiling") as bar:
        _bars.append(bar)
        try:
            yield bar
            jax.effects_barrier()
        finally:
            _bars.remove(bar)


def can_be_shown(progress: bool, inputs: Any) -> bool:
    """Return whether to show a requested bar; under JAX transformations warn instead."""
    is_shown = progress and not is_transformed(inputs)
    if progress and not is_shown:
        warn("Inside of JAX transformations no progress is shown.")
    return is_shown


def unseen(after: Any) -> None:
    """Report nothing, as inside of a trace, where nothing is known yet."""


@contextmanager
def searches_bar(total: int, *, shown: bool) -> Iterator[Report]:
    """Show a bar of searches one after another; to its end it takes that not all are needed."""
    with progress_bar(total, "search", shown=shown) as bar:

        def report(after: Any) -> None:
            jax.block_until_ready(after)
            bar.update()

        yield report
        bar.update(total - bar.n)


def advance(after: Array) -> None:
    """Move the bar by one unit once `after` is known; works inside compiled code."""
    jax.debug.callback(_advance, after)


def _advance(_: Array) -> None:
    if _bars:
        _bars[-1].update()
