"""One contact held by several processes of this machine, started by one command.

    python benchmarks/processes.py 2 --points 256 --path

An equilibrium and its verdict, with `--path` also a path of three jumps, are compared with those of
one process: on as many virtual devices, where the exchange alone differs, and on one device. The
difference is the largest of all numbers and fields, each relative to its largest entry. On one
device sums are rounded in another way, and the steps of a path depend on that; the last column does
not count it.

`MB` and exchanges are those of the compiled program of an equilibrium in each process, and of one
of its steps with all branches, as in `sharded.py`. `peak MB` is the resident memory of a process at
its most, compilation included. `MB sent` is what a process sends in a step, of all that Linux
counts on the loopback device, and `s` the time of an equilibrium once it is compiled.
"""

import argparse
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import jax
import numpy as np
import sharded
from jax.experimental.multihost_utils import process_allgather
from jax.sharding import NamedSharding, PartitionSpec

import jaxstab as js

MEAN_GAP = 0.1
TURNS = (0.14, 0.09, 0.12)
HEAD = (
    "| processes | MB | peak MB | all-to-all | all-reduce | MB sent | s | as many devices | "
    "one device |\n|---|---|---|---|---|---|---|---|---|"
)
# Within this time a process notices that another one is gone, if not at the next exchange [s].
HEARTBEAT = 10


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("counts", type=int, nargs="+", help="numbers of processes")
    parser.add_argument("--points", type=int, default=256, help="along a side")
    parser.add_argument("--path", action="store_true", help="also a path of three jumps")
    parser.add_argument("--out", type=Path, help="a file for the table")
    options = parser.parse_args()
    turns = TURNS if options.path else ()
    (alone,) = found_by(1, 1, options.points, turns)
    lines = [f"{options.points}² points", "", HEAD]
    print(*lines, sep="\n", flush=True)
    for count in options.counts:
        (one,) = found_by(1, count, options.points, turns)
        several = found_by(count, 1, options.points, turns)
        lines.append(row(several, one, alone))
        print(lines[-1], flush=True)
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def row(several, one, alone):
    steady = {name: value for name, value in alone.items() if not name.startswith("path")}
    as_many = np.max([difference(each, one) for each in several])
    from_one = np.max([difference(each, steady) for each in several])
    peak = max(each["cost"][1] for each in several)
    taken, _, *exchange, sent, seconds = several[0]["cost"]
    kinds = " | ".join(f"{number:.0f}" for number in exchange)
    return (
        f"| {len(several)} | {taken:.1f} | {peak:.0f} | {kinds} | {sent:.2f} | {seconds:.2f} | "
        f"{as_many:.1e} | {from_one:.1e} |"
    )


def difference(found, expected):
    """Return the largest relative difference; infinite for other words or shapes, NaN for NaN."""
    differences = [0.0]
    for name, value in expected.items():
        if value.dtype.kind == "U":
            differences.append(0.0 if np.array_equal(value, found[name]) else np.inf)
        elif value.shape != found[name].shape:
            differences.append(np.inf)
        elif name != "cost":
            differences.append(np.max(np.abs(found[name] - value)) / np.max(np.abs(value)))
    return np.max(differences)


def found_by(num_processes, num_devices, points, turns):
    """Return what each of several processes has found, with a number of devices each."""
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder, f"{number}.npz") for number in range(num_processes)]
        run_together(commands(files, num_devices, points, turns))
        return [dict(np.load(file)) for file in files]


def commands(files, num_devices, points, turns):
    """Return the commands of processes, each of which writes what it has found to a file."""
    with socket.socket() as listener:
        listener.bind(("localhost", 0))
        address = f"localhost:{listener.getsockname()[1]}"
    shared = len(files), num_devices, points, address, *turns
    return [
        list(map(str, [sys.executable, __file__, "--worker", file, number, *shared]))
        for number, file in enumerate(files)
    ]


def run_together(commands):
    """Run commands at the same time. If one fails, end the others.

    Raises:
        RuntimeError: which of them failed, how, and the end of what the first one wrote.
    """
    with ExitStack() as stack:
        outputs = [stack.enter_context(tempfile.TemporaryFile("w+")) for _ in commands]
        processes = []
        try:
            for command, output in zip(commands, outputs, strict=True):
                started = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
                processes.append(started)
            while True:
                codes = [process.poll() for process in processes]
                failed = {number: code for number, code in enumerate(codes) if code}
                if failed or None not in codes:
                    break
                time.sleep(0.05)
        finally:
            for process in processes:
                process.kill()
                process.wait()
        if failed:
            ends = ", ".join(f"{number} by {how(code)}" for number, code in failed.items())
            first = min(failed)
            outputs[first].seek(0)
            raise RuntimeError(
                f"Of {len(commands)} processes these failed: {ends}. All others were ended. "
                f"Process {first} wrote last:\n{outputs[first].read()[-4000:]}"
            )


def how(code):
    return signal.Signals(-code).name if code < 0 else f"exit status {code}"


def worker(file, number, num_processes, num_devices, points, address, *turns):
    """Write what one of several processes finds to a file of NumPy's."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", int(num_devices))
    count = int(num_processes)
    if count > 1:
        process = int(number)
        jax.distributed.initialize(address, count, process, heartbeat_timeout_seconds=HEARTBEAT)
    contact = contact_on(grid_of(int(points)))
    found = found_for(contact, list(map(float, turns)))
    np.savez(file, cost=cost(contact), **found)


def grid_of(points):
    count = jax.device_count()
    mesh = jax.make_mesh((count,), ("x",))
    sharding = NamedSharding(mesh, PartitionSpec("x"))
    return js.Grid(points, sharding=sharding if count > 1 else None)


def contact_on(grid):
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.05)
    law = js.potentials.Exponential(surface_energy=0.06, length=0.06)
    return js.Contact(js.HalfSpace(grid, youngs_modulus=1.0), heights, law)


def found_for(contact, turns=()):
    """Return numbers and fields by name, with turning points those of a path; all processes do."""
    equilibrium = js.equilibrate(contact, js.MeanGap(MEAN_GAP))
    stability = js.assess_stability(contact, equilibrium)
    found = {
        "mean_pressure": equilibrium.mean_pressure,
        "energy": equilibrium.energy,
        "gap": whole(equilibrium.gap),
        "reaction": whole(equilibrium.reaction),
        "verdict": stability.verdict.name,
    }
    found |= {name: pair.eigenvalue for name, pair in stability.pairs.items()}
    if turns:
        found |= path_of(contact, turns)
    return {name: np.asarray(value) for name, value in found.items()}


def path_of(contact, turns):
    path = js.follow(contact, js.MeanGap(turns), fields=True)
    found = {
        "loads": path.load.value,
        "pressures": path.equilibrium.mean_pressure,
        "energies": path.equilibrium.energy,
        "gaps": whole(path.equilibrium.gap),
        "jumps": path.jumps.load.value,
        "kinds": path.jumps.kind.name,
        "losses": path.jumps.dissipation,
    }
    return {f"path_{name}": value for name, value in found.items()}


def whole(field):
    return process_allgather(field, tiled=True)


def cost(contact):
    """Return megabytes of an equilibrium, and of the process; exchanges, megabytes sent, time."""
    count = jax.device_count()
    start = time.perf_counter(), bytes_on_loopback()
    equilibrium = jax.block_until_ready(js.equilibrate(contact, js.MeanGap(MEAN_GAP)))
    seconds = time.perf_counter() - start[0]
    sent = (bytes_on_loopback() - start[1]) / jax.process_count() / int(equilibrium.num_steps)
    program = sharded.lowered(contact.grid.shape[0], count)["equilibrium"].compile()
    kinds, _ = sharded.step(program.as_text(), count)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    exchanges = kinds["all-to-all"], kinds["all-reduce"]
    return [sharded.memory(program) / 1e6, peak, *exchanges, sent / 1e6, seconds]


def bytes_on_loopback():
    """Return how many bytes went over the loopback device so far, where Linux counts them."""
    if not (counters := Path("/proc/net/dev")).exists():
        return np.nan
    (own,) = (line for line in counters.read_text().splitlines() if line.strip().startswith("lo:"))
    return int(own.split(":")[1].split()[8])


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        main()
