"""A progress bar that compiled code can move."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool
from tqdm import tqdm

_bars: list[tqdm] = []


@contextmanager
def progress_bar(total: int, unit: str) -> Iterator[tqdm]:
    """Show a bar of `total` units that `advance_to` moves, until the block ends."""
    with tqdm(total=total, unit=unit) as bar:
        _bars.append(bar)
        try:
            yield bar
            jax.effects_barrier()
            _move(total)
        finally:
            _bars.remove(bar)


def advance_to(count: ArrayLike) -> None:
    """Move the bar forward to `count`; works inside compiled code."""
    jax.debug.callback(_move, count)


@dataclass(frozen=True)
class LaneReport:
    """Reports the lanes that have ended as units done, after those of earlier phases."""

    done_before: int

    def __call__(self, has_ended: Bool[Array, ""]) -> None:
        """Take one lane's state; under vmap, all of them at once."""

        @jax.custom_batching.custom_vmap
        def show(has_ended: Bool[Array, ""]) -> Bool[Array, ""]:
            return has_ended

        @show.def_vmap
        def show_lanes(axis_size: int, in_batched: Any, lanes: Bool[Array, " lanes"]) -> Any:
            advance_to(self.done_before + jnp.sum(lanes))
            return lanes, in_batched[0]

        show(has_ended)


def _move(count: Any) -> None:
    if _bars and (ahead := int(count) - _bars[-1].n) > 0:
        _bars[-1].update(ahead)
