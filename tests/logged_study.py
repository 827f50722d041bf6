"""A study in a script, which leaves a line for each case that runs."""

import subprocess
import sys
import time
from collections import Counter

import h5py
import numpy as np

SCRIPT = """\
import sys, time
import numpy as np
import jaxstab as js

def case(seed, energy):
    with open("log", "a") as log:
        log.write(f"{seed} {energy}\\n")
    time.sleep(0.02)
    if seed == 3:
        raise ValueError(f"no contact at {energy}")
    field = np.random.default_rng([seed, int(4 * energy)]).random((8, 8))
    return {"area": field.mean(), "field": field, "verdict": "stable", "number": seed}

axes = {"seed": range(6), "energy": np.arange(5) / 4}

if __name__ == "__main__":
    js.study(case, axes, "study", executor=int(sys.argv[1]) or None)
"""


def case_in(folder, dies=lambda count: None, dying=2):
    """Return a case that leaves a line in a log, and one that comes to an end at times."""
    log = str(folder / "log")

    def case(seed, energy):
        with open(log, "a") as file:
            file.write(f"{seed} {energy}\n")
        if seed == 3:
            raise ValueError(f"no contact at {energy}")
        with open(log) as file:
            count = file.read().splitlines().count(f"{seed} {energy}")
        if seed == dying and energy == 0.5:
            dies(count)
        field = np.random.default_rng([seed, int(4 * energy)]).random((8, 8))
        return {"area": field.mean(), "field": field, "verdict": "stable", "number": seed}

    return case


def started(folder, *command):
    """Start a Python process in a group of its own, as a shell does."""
    (folder / "script.py").write_text(SCRIPT)
    command = [sys.executable, *command]
    return subprocess.Popen(command, cwd=folder, start_new_session=True, stderr=subprocess.PIPE)


def runs(folder):
    """Return how often each case ran."""
    log = folder / "log"
    return Counter(log.read_text().splitlines()) if log.exists() else Counter()


def contents(study):
    """Return the numbers in the files of a study, but for how long each case took."""
    found = {}
    for path in study.glob("*.nc"):
        with h5py.File(path) as file:
            arrays = {name: file[name][()] for name in file if name != "seconds"}
        # The bytes of words are addresses.
        parts = {n: x.tolist() if x.dtype.hasobject else x.tobytes() for n, x in arrays.items()}
        found[path.name] = {n: (x.dtype, x.shape, parts[n]) for n, x in arrays.items()}
    return found


def assert_same(one, other):
    """Compare two folders bit for bit."""
    assert contents(one) == contents(other) and contents(one)


def wait_until(holds, seconds=60):
    """Wait until something holds, for so long at most."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.002)
