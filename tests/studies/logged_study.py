"""A study in a script, which leaves a line for each case that runs."""

import json
import time
from collections import Counter

# Every case leaves a line, and has an output of several chunks.
SCRIPT = """\
import sys, time
import numpy as np

def case(seed, energy):
    with open("log", "a") as log:
        log.write(f"{seed} {energy}\\n")
    time.sleep(0.003)
    if seed == 3:
        raise ValueError(f"no contact at {energy}")
    field = np.random.default_rng([seed, int(4 * energy)]).random((8, 8))
    return {"area": field.mean(), "field": field, "verdict": "stable", "number": seed}

axes = {"seed": range(6), "energy": np.arange(5) / 4}
"""


def script_in(folder):
    """Write the script and return the folder."""
    (folder / "script.py").write_text(SCRIPT)
    return folder


def runs(folder):
    """Return how often each case ran."""
    log = folder / "log"
    return Counter(log.read_text().splitlines()) if log.exists() else Counter()


def contents(store):
    """Return the files of a store, but for what says when, how long and by which process."""
    chunks = {
        str(path.relative_to(store)): path.read_bytes()
        for path in store.rglob("c*")
        if path.is_file() and path.parent.name != "seconds"
    }
    return chunks, json.loads((store / "zarr.json").read_text())["consolidated_metadata"]


def wait_until(holds, seconds=60):
    """Wait until something holds, for so long at most."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.002)
