"""Pauses: how the loop of any solver is run in pieces, with nothing said to the solver."""

from collections.abc import Callable
from contextvars import ContextVar
from typing import Any

from jaxtyping import ArrayLike


class Pause:
    """Lets the loop of a solver pause, whatever is done before it and after it.

    In a block `with Pause(loop, max_steps) as pause:` a call of `iterate` or `resume` goes on from
    a loop, if one is given, by at most so many steps, and returns what it has come to; `pause.loop`
    is where it is then. There must be one such call, traced anew each time.

    Arguments:
        loop: where to go on from, None for the beginning.
        max_steps: after how many steps to pause.
    """

    def __init__(self, loop: Any | None = None, max_steps: ArrayLike = 0):
        self._loop, self._max_steps = loop, max_steps

    def __enter__(self) -> "Pause":
        self._outer = _pause.set(self)
        return self

    def __exit__(self, *_: object) -> None:
        _pause.reset(self._outer)

    @staticmethod
    def current() -> "Pause | None":
        """Return that of the block, if there is one."""
        return _pause.get()

    @property
    def loop(self) -> Any:
        """Where the loop is, None if there was none."""
        return self._loop

    def go_on(self, advance: Callable[..., Any], begin: Callable[[], Any]) -> Any:
        """Return where a loop is when it pauses."""
        # Loops within its steps run to their ends.
        outer = _pause.set(None)
        loop = begin() if self._loop is None else self._loop
        # What takes no step need not be compiled.
        takes_steps = not isinstance(self._max_steps, int) or self._max_steps > 0
        self._loop = advance(loop, self._max_steps) if takes_steps else loop
        _pause.reset(outer)
        return self._loop


_pause: ContextVar[Pause | None] = ContextVar("pause", default=None)
