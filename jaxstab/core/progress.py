"""Progress bars."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
from jaxtyping import PyTree
from tqdm import tqdm

from jaxstab.core.checks import is_transformed, where_known

# A step after this time shows a bar by itself, where somebody sees it [s].
DELAY = 2.0
_bars: list[tqdm] = []


@contextmanager
def progress_bar(
    name: str,
    total: int,
    unit: str,
    *,
    shown: bool | None,
    inputs: PyTree = (),
    done: int = 0,
) -> Iterator[tqdm]:
    """Show a named bar of `total` units, some `done` before, that `advance` moves.

    It ends with the block. If `shown` is None it appears after a while in a terminal or a
    notebook, but not within another one, and does not stay. Where JAX transforms computations with
    the `inputs` none is shown.
    """
    style: dict[str, Any] = {"desc": name}
    if shown is None:
        shown = is_watched() and not _bars
        style.update(delay=DELAY, leave=False)
    is_hidden = not shown or is_transformed(inputs)
    with tqdm(total=total, unit=unit, disable=is_hidden, initial=done, **style) as bar:
        _bars.append(bar)
        try:
            yield bar
            jax.effects_barrier()
        finally:
            _bars.remove(bar)


def is_watched() -> bool:
    """Whether standard error is a terminal or belongs to a notebook.

    The variable TQDM_DISABLE of the environment silences both.
    """
    if os.environ.get("TQDM_DISABLE"):
        return False
    return sys.stderr.isatty() or type(sys.stderr).__module__.startswith("ipykernel")


@where_known
def advance_if_known(after: PyTree) -> None:
    """Move the bar by one unit once `after` is computed; inside of a trace do nothing."""
    if _bars:
        jax.block_until_ready(after)
        _bars[-1].update()


def advance_to(done: Callable[[], int]) -> None:
    """Move the bar to a number of units, which is computed only where the bar is shown."""
    if _bars and not _bars[-1].disable:
        _bars[-1].update(done() - _bars[-1].n)
