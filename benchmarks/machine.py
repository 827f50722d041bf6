"""The machine that a table was measured on, as far as its figures depend on it."""

import os
import time

import numpy as np

_NUM_BYTES, _REPEATS = 2**27, 10


def machine() -> str:
    """Return the number of cores, and how fast one of them copies memory, for a heading."""
    source = np.ones(_NUM_BYTES // 8)
    target = np.empty_like(source)
    seconds = []
    for _ in range(_REPEATS):
        start = time.perf_counter()
        np.copyto(target, source)
        seconds.append(time.perf_counter() - start)
    # Each byte is read and written.
    speed = 2e-9 * _NUM_BYTES / min(seconds)
    return f"{os.cpu_count()} cores, of which one copies {speed:.1f} GB/s read and written"
