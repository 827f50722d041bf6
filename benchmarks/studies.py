"""Studies: what they cost over a plain loop, and what is left of one that is killed 20 times.

- Cases of 50 ms, alone and in a study, to a new store; and the same study once all is done.
- 200 cases in processes that are killed at random moments: how often each case ran, and whether
  the store is, bit for bit, that of a process that was left alone.
"""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

import jaxstab as js

AXES = {"seed": np.arange(20), "energy": np.linspace(0, 1, 10)}
COST = """| | seconds | over the loop |
|---|---|---|
| loop | {:.2f} | |
| study | {:.2f} | {:+.1f} % |
| the same study again | {:.2f} | |
| its data set in full | {:.2f} | |"""


def timed_case(seed, energy):
    time.sleep(0.05)
    field = np.full((64, 64), energy)
    return {"area": 0.1 * seed, "force": energy, "gap": field, "verdict": "stable", "steps": seed}


def logged_case(seed, energy):
    with open("log", "a") as log:
        log.write(f"{seed} {energy}\n")
    time.sleep(0.005)
    if seed == 3:
        raise ValueError(f"no contact at {energy}")
    field = np.random.default_rng([seed, int(9 * energy)]).random((32, 32))
    return {"area": field.mean(), "gap": field, "verdict": "stable"}


def timed(function):
    start = time.perf_counter()
    result = function()
    return result, time.perf_counter() - start


def cost(folder):
    """Return a table of the seconds of 200 cases of 50 ms."""
    # What is imported late is no part of a case.
    js.study(timed_case, {"seed": [0], "energy": [0.0]}, folder / "first.zarr").load()

    def loop():
        for seed in AXES["seed"].tolist():
            for energy in AXES["energy"].tolist():
                timed_case(seed, energy)

    path = folder / "cost.zarr"
    plain = timed(loop)[1]
    study = timed(lambda: js.study(timed_case, AXES, path))[1]
    dataset, again = timed(lambda: js.study(timed_case, AXES, path))
    full = timed(dataset.load)[1]
    return COST.format(plain, study, 100 * (study / plain - 1), again, full)


def kills(folder, number):
    """Return lines on a study that was killed, beside one that was not."""
    generator = np.random.default_rng(0)
    alone, killed = folder / "alone", folder / "killed"
    for place in (alone, killed):
        place.mkdir()
        (place / "log").touch()
    run(alone).wait()
    for kill in range(number):
        before = (killed / "log").stat().st_size
        process = run(killed)
        # Every other one may die as it opens the store.
        while kill % 2 and (killed / "log").stat().st_size == before and process.poll() is None:
            time.sleep(0.001)
        time.sleep(generator.uniform(0, 0.2) if kill % 2 else generator.uniform(0.8, 1.6))
        process.send_signal(signal.SIGKILL)
        process.wait()
    run(killed).wait()
    counts = Counter((killed / "log").read_text().splitlines())
    again = sum(counts.values()) - len(counts)
    files = [contents(place / "study.zarr") for place in (alone, killed)]
    are_same = "the same, bit for bit" if files[0] == files[1] else "NOT THE SAME"
    return [
        f"{number} kills: {len(counts)} cases, {again} runs more than that",
        f"- of any one case at most {max(counts.values())}",
        f"- the files of the two stores, without times: {are_same}",
    ]


def run(folder):
    command = [sys.executable, str(Path(__file__).resolve()), "--one"]
    return subprocess.Popen(command, cwd=folder)


def contents(store):
    """Return the files of a store, but for what says when and how long."""
    files = [path for path in store.rglob("*") if path.is_file()]
    kept = {
        str(path.relative_to(store)): path.read_bytes()
        for path in files
        if path.parent.name != "seconds" and path != store / "zarr.json"
    }
    root = json.loads((store / "zarr.json").read_text())
    return kept, root["consolidated_metadata"]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        js.study(logged_case, AXES, "study.zarr")
        return
    with tempfile.TemporaryDirectory() as folder:
        lines = [cost(Path(folder)), "", *kills(Path(folder), options.kills)]
    print(*lines, sep="\n")
    if options.output:
        options.output.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
