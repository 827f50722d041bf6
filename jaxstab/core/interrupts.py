"""Ctrl-C that waits where it would lose a result."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread

import jax


def early_ends() -> tuple[type[BaseException], ...]:
    """Return the exceptions at which a search ends early, with what it has so far: Ctrl-C.

    Among several processes there is none: each would end at another step, and the next exchange
    between them would mix two.
    """
    if jax.process_count() > 1:
        return ()
    return (KeyboardInterrupt,)


@contextmanager
def interrupts_held() -> Iterator[list[int]]:
    """Hold back the first Ctrl-C within the block, and yield a list that it enters; a second acts.

    Handlers run in the main thread, and only Python's own is replaced.
    """
    held: list[int] = []
    own = signal.default_int_handler
    if current_thread() is not main_thread() or signal.getsignal(signal.SIGINT) is not own:
        yield held
        return

    def hold(number: int, _: object) -> None:
        held.append(number)
        signal.signal(signal.SIGINT, own)

    signal.signal(signal.SIGINT, hold)
    try:
        yield held
    finally:
        signal.signal(signal.SIGINT, own)


@contextmanager
def interrupts_after() -> Iterator[None]:
    """Let a Ctrl-C act after the block, which is done whole or not at all."""
    with interrupts_held() as held:
        yield
    if held:
        raise KeyboardInterrupt
