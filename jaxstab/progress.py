"""A progress bar that compiled code can move."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import jax
from jaxtyping import Array

if TYPE_CHECKING:
    from tqdm import tqdm

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


def advance(after: Array) -> None:
    """Move the bar by one unit once `after` is known; works inside compiled code."""
    jax.debug.callback(_advance, after)


def _advance(_: Array) -> None:
    if _bars:
        _bars[-1].update()
