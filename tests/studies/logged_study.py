"""A study in a script, which leaves a line for each case that runs."""

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
