"""Studies: what they cost over a plain loop, and what is left of one that is killed 20 times.

- Cases of 50 ms, alone and in a study, to a new store; and the same study once all is done.
- Cases that take no time, in two processes and on two workers of Dask.
- 200 cases in two processes, of which one, the one that deals them out, or all are killed at random
  moments: how often each case ran, and whether the store is, bit for bit, that of a single process.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from functools import partial
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
        log.write(f"c.{seed}.{round(9 * energy)}\n")
    time.sleep(0.04)
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


def trivial_case(seed):
    return {"twice": 2 * seed}


def engines(folder):
    """Return lines on 1000 cases that take no time."""
    from distributed import Client, LocalCluster

    axes = {"seed": range(1000)}
    # Its processes start within the time, those of Dask before.
    pool = timed(lambda: js.study(trivial_case, axes, folder / "pool", executor=2))[1]
    with LocalCluster(n_workers=2, threads_per_worker=1) as cluster, Client(cluster) as client:
        dask = timed(lambda: js.study(trivial_case, axes, folder / "dask", executor=client))[1]
    return f"1000 cases that take no time: {pool:.1f} s in two processes, {dask:.1f} s on Dask"


def kills(folder, number):
    """Return lines on a study that was killed, beside one that was not."""
    generator = np.random.default_rng(0)
    alone, killed = folder / "alone", folder / "killed"
    for place in (alone, killed):
        place.mkdir()
    run(alone, "--one").wait()
    process, finished, kinds = run(killed, "--two"), {}, Counter()
    while kinds.total() < number:
        before = runs(killed).total()
        while runs(killed).total() < before + 4 and process.poll() is None:
            time.sleep(0.001)
        if process.poll() is not None:
            break
        time.sleep(generator.uniform(0, 0.1))
        kind = ("worker", "driver", "both")[kinds.total() % 3]
        workers = children(process.pid)
        kinds[kind] += 1
        if kind == "worker":
            if workers:
                os.kill(generator.choice(workers).item(), signal.SIGKILL)
        else:
            (process.kill if kind == "driver" else partial(os.killpg, process.pid, 9))()
            process.wait()
            while any(map(is_alive, workers)):
                time.sleep(0.01)
        done = [file.name for file in (killed / "study.zarr" / "result").glob("c.*")]
        counts = runs(killed)
        finished = {name: counts[name] for name in done if "part" not in name} | finished
        if kind != "worker":
            process = run(killed, "--two")
    process.wait()
    counts = runs(killed)
    again = sum(counts[name] > count for name, count in finished.items())
    files = [contents(place / "study.zarr") for place in (alone, killed)]
    are_same = "the same, bit for bit" if files[0] == files[1] else "NOT THE SAME"
    return [
        f"{kinds.total()} kills ({kinds['worker']} of a worker, {kinds['driver']} of the driver, "
        f"{kinds['both']} of both): {len(counts)} cases, {counts.total() - len(counts)} runs more",
        f"- of any one case at most {max(counts.values())}, of one that was done {again}",
        f"- the files of the two stores, without times: {are_same}",
    ]


def runs(folder):
    """Return how often each case ran, by the name of its file."""
    log = folder / "log"
    return Counter(log.read_text().splitlines() if log.exists() else [])


def run(folder, how):
    command = [sys.executable, str(Path(__file__).resolve()), how]
    return subprocess.Popen(command, cwd=folder, start_new_session=True, stderr=subprocess.DEVNULL)


def children(process):
    listed = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True).stdout
    pairs = [tuple(map(int, line.split())) for line in listed.splitlines()]
    return [child for child, parent in pairs if parent == process]


def is_alive(process):
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(process)], capture_output=True)
    return state.stdout.strip()[:1] not in (b"", b"Z")


def contents(store):
    """Return the files of a store, but for what says when and how long."""
    files = [path for path in store.rglob("c*") if path.is_file()]
    kept = {
        str(path.relative_to(store)): path.read_bytes()
        for path in files
        if path.parent.name != "seconds"
    }
    root = json.loads((store / "zarr.json").read_text())
    return kept, root["consolidated_metadata"]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--two", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one or options.two:
        executor = 2 if options.two else None
        js.study(logged_case, AXES, "study.zarr", executor=executor)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lines = [cost(folder), "", engines(folder), "", *kills(folder, options.kills)]
    print(*lines, sep="\n")
    if options.output:
        options.output.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
