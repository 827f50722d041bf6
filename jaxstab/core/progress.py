"""Progress bars, which compiled code can move too."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer
from time import time

import jax
from jaxtyping import Array, PyTree
from tqdm import tqdm

from jaxstab.core.checks import is_traced, is_transformed
from jaxstab.core.warn import warn

# Work that takes longer shows a bar by itself, where somebody sees it [s].
_DELAY = 2.0


class Bar(tqdm):
    """A bar that says "compiling" until its first step, most of whose time that is."""

    def update(self, n: float | None = 1) -> bool | None:
        """Move by a number of units."""
        if not self.disable and self.desc:
            self.set_description(refresh=not self.delay)
        return super().update(n)

    def appear(self) -> None:
        """Show the bar before its first step."""
        # By these it knows that there is something to clear.
        self.delay, self.last_print_t = 0, time()
        self.refresh()


_bars: list[Bar] = []


@contextmanager
def progress_bar(
    total: int, unit: str, *, shown: bool | None = True, done: int = 0
) -> Iterator[Bar]:
    """Show a bar of `total` units, some `done` before, that `advance` moves, to the block's end.

    If `shown` is None it appears after a while in a terminal or a notebook, but not within another
    one, and does not stay.
    """
    is_late = shown is None
    is_hidden = bool(_bars) or not is_watched() if is_late else not shown
    style = {"delay": _DELAY, "leave": False} if is_late else {}
    with Bar(
        total=total, unit=unit, desc="compiling", disable=is_hidden, initial=done, **style
    ) as bar:
        timer = Timer(_DELAY, bar.appear)
        timer.daemon = True
        _bars.append(bar)
        try:
            if is_late and not is_hidden:
                timer.start()
            yield bar
            jax.effects_barrier()
        finally:
            _bars.remove(bar)
            timer.cancel()
            if timer.is_alive():
                timer.join()


def is_watched() -> bool:
    """Whether standard error is a terminal or belongs to a notebook.

    The variable TQDM_DISABLE of the environment silences both.
    """
    if os.environ.get("TQDM_DISABLE"):
        return False
    return sys.stderr.isatty() or type(sys.stderr).__module__.startswith("ipykernel")


def can_be_shown(progress: bool | None, inputs: PyTree) -> bool | None:
    """Return how a bar is to be shown: not under transformations, where one cannot be asked for."""
    if not is_transformed(inputs):
        return progress
    if progress:
        warn("Inside of JAX transformations no progress is shown.")
    return False


def advance_if_known(after: PyTree) -> None:
    """Move the bar by one unit once `after` is computed; inside of a trace do nothing."""
    if _bars and not is_traced(after):
        jax.block_until_ready(after)
        _bars[-1].update()


def advance_to(done: Callable[[], int]) -> None:
    """Move the bar to a number of units, which is computed only where the bar is shown."""
    if _bars and not _bars[-1].disable:
        _bars[-1].update(done() - _bars[-1].n)


def advance(after: Array) -> None:
    """Move the bar by one unit once `after` is known; works inside compiled code."""
    jax.debug.callback(_advance, after)


def _advance(_: Array) -> None:
    # The program is still running: here nothing may wait for the device.
    if _bars:
        _bars[-1].update()
