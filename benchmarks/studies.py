"""Studies: what they cost over a plain loop, and what is left of one that is killed or damaged.

- Cases of 50 ms, alone and in a study, to a new folder: seconds, and processor time.
- Cases that take no time, in this process and on two workers of Dask; 10 000 of them read back.
- 200 cases in two processes, of which one, the one that deals them out, or all are killed at random
  moments: how often each case ran, and whether the files are, bit for bit, those of one process.
- Seven kinds of damage, each to 20 files: how many are named, and how many numbers are wrong.
"""

import argparse
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import xarray

import jaxstab as js
from jaxstab.studies.cases import Cases

AXES = {"seed": np.arange(20), "energy": np.linspace(0, 1, 10)}
COST = """| medians of {} rounds | seconds | over the loop |
|---|---|---|
| loop | {:.2f} | |
| study | {:.2f} | {:+.1f} % |

A case of 50 ms costs {:.1f} ms of processor time more in a study, {:.1f} % of it."""


def timed_case(seed, energy):
    time.sleep(0.05)
    field = np.full((64, 64), energy)
    return {"area": 0.1 * seed, "force": energy, "gap": field, "verdict": "stable", "steps": seed}


def logged_case(seed, energy):
    with open("log", "a") as log:
        log.write(f"{seed} {energy}\n")
    time.sleep(0.04)
    if seed == 3:
        raise ValueError(f"no contact at {energy}")
    field = np.random.default_rng([seed, int(9 * energy)]).random((32, 32))
    return {"area": field.mean(), "gap": field, "verdict": "stable"}


def timed(function):
    start = time.perf_counter()
    result = function()
    return result, time.perf_counter() - start


def cost(folder, rounds=7):
    """Return a table of cases of 50 ms, in a plain loop and in a study, one after the other."""
    # What is imported late is no part of a case.
    js.study(timed_case, {"seed": [0], "energy": [0.0]}, folder / "first")
    axes = {name: values[:6].tolist() for name, values in AXES.items()}
    cases = [dict(zip(axes, case, strict=True)) for case in itertools.product(*axes.values())]

    def both(function):
        wall, processor = time.perf_counter(), time.process_time()
        function()
        return time.perf_counter() - wall, time.process_time() - processor

    seconds = []
    for i in range(rounds):
        loop = both(lambda: [timed_case(**case) for case in cases])
        study = both(lambda i=i: js.study(timed_case, axes, folder / f"cost{i}"))
        seconds.append([*loop, *study])
    loop, _, study, _ = np.median(seconds, axis=0)
    _, before, _, after = np.transpose(seconds)
    more = 1000 * np.median(after - before) / len(cases)
    return COST.format(rounds, loop, study, 100 * (study / loop - 1), more, more / 0.5)


def trivial_case(seed):
    return {"twice": 2 * seed}


def engines(folder):
    """Return lines on cases that take no time."""
    from distributed import Client, LocalCluster

    axes = {"seed": range(1000)}
    here = timed(lambda: js.study(trivial_case, axes, folder / "here"))[1]
    # Its processes start within the time, those of Dask before.
    pool = timed(lambda: js.study(trivial_case, axes, folder / "pool", executor=2))[1]
    with LocalCluster(n_workers=2, threads_per_worker=1) as cluster, Client(cluster) as client:
        dask = timed(lambda: js.study(trivial_case, axes, folder / "dask", executor=client))[1]
    many = {"seed": range(10_000)}
    js.study(trivial_case, many, folder / "many")
    study, back = timed(lambda: js.study(trivial_case, many, folder / "many"))
    assert (study["twice"] == 2 * study["seed"]).all()
    return [
        f"1000 cases that take no time: {here:.1f} s in one process, {pool:.1f} s in two, "
        f"{dask:.1f} s on Dask; 10 000 read back in {back:.1f} s",
    ]


def kills(folder, number):
    """Return lines on a study that was killed, beside one that was not."""
    generator = np.random.default_rng(0)
    alone, killed = folder / "alone", folder / "killed"
    for place in (alone, killed):
        place.mkdir()
    run(alone, "--one").wait()
    files = Cases(killed, tuple(AXES), tuple(AXES)).files({n: x.tolist() for n, x in AXES.items()})
    names = {file.name: f"{x['seed']} {x['energy']}" for file, x in files.items()}
    process, finished, kinds, files = run(killed, "--two"), {}, Counter(), {}
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
        done = {file.name: file.read_bytes() for file in (killed / "study").glob("*.nc")}
        counts, files = runs(killed), done | files
        finished = {names[name]: counts[names[name]] for name in done} | finished
        if kind != "worker":
            process = run(killed, "--two")
    process.wait()
    counts = runs(killed)
    again = sum(counts[name] > count for name, count in finished.items())
    changed = [x for x, content in files.items() if (killed / "study" / x).read_bytes() != content]
    # To a failed case the outputs of the others are added, without values.
    changed = [name for name in changed if not names[name].startswith("3 ")]
    one, other = (contents(place / "study") for place in (alone, killed))
    are_same = "the same, bit for bit" if one == other else "NOT THE SAME"
    return [
        f"{kinds.total()} kills ({kinds['worker']} of a worker, {kinds['driver']} of the driver, "
        f"{kinds['both']} of both): {len(counts)} cases, {counts.total() - len(counts)} runs more",
        f"- of any one case at most {max(counts.values())}, of one that was done {again}; "
        f"files of finished cases that changed: {len(changed)}",
        f"- the files of the two studies, without times: {are_same}",
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


def contents(study):
    """Return the files of a study, without how long each case took."""
    files = {x.name: xarray.load_dataset(x).drop_vars("seconds") for x in study.glob("*.nc")}
    return {name: repr(dataset.to_dict()) for name, dataset in files.items()}


def damages(folder):
    """Return a line on each kind of damage."""
    lines, generator = [], np.random.default_rng(1)

    def flip(file, other):
        content = bytearray(file.read_bytes())
        content[generator.integers(len(content))] ^= 1 << generator.integers(8)
        file.write_bytes(content)

    kinds = {
        "cut": lambda file, other: os.truncate(file, generator.integers(1, file.stat().st_size)),
        "emptied": lambda file, other: os.truncate(file, 0),
        "a byte changed": flip,
        "deleted": lambda file, other: file.unlink(),
        "another case's file": lambda file, other: file.write_bytes(other.read_bytes()),
        "renamed": lambda file, other: file.rename(file.with_suffix(".copy.nc")),
        "a folder in its place": lambda file, other: (file.unlink(), file.mkdir()),
    }
    path, axes = folder / "damaged", {"seed": range(4), "energy": np.linspace(0, 1, 5)}
    expected = js.study(damaged_case, axes, path).drop_vars("seconds")
    for kind, damage in kinds.items():
        found = wrong = 0
        files = sorted(path.glob("*.nc"))
        for file, other in zip(files, files[1:] + files[:1], strict=True):
            RUNS.clear()
            damage(file, other)
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                study = js.study(damaged_case, axes, path).drop_vars("seconds")
            found += bool(RUNS) or any(file.name in str(x.message) for x in said)
            wrong += not study.identical(expected)
        lines.append(f"- {kind}: {found} of {len(files)} found, {wrong} wrong data sets")
    return ["Damage:", *lines]


RUNS = []


def damaged_case(seed, energy):
    RUNS.append(seed)
    return {
        "field": np.random.default_rng([seed, int(9 * energy)]).random((8, 8)),
        "word": "stable",
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--two", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one or options.two:
        executor = 2 if options.two else None
        js.study(logged_case, AXES, "study", executor=executor)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lines = [
            cost(folder),
            "",
            *engines(folder),
            "",
            *kills(folder, options.kills),
            "",
            *damages(folder),
        ]
    print(*lines, sep="\n")
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
