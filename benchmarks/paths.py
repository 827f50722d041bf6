"""Loops of loading and unloading: their energy, their cost, and every state from outside.

- Ten rough surfaces: the jumps of a loop and what they lose, against a march of small steps, each
  an equilibrium from the one before.
- Random loops: each recorded state is checked with NumPy, and some of each for stability.
- The time of a loop, over that of as many warm-started single equilibria.
"""

import argparse
import itertools
import time
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)

LAWS = (
    js.potentials.Exponential,
    js.potentials.Gaussian,
    js.potentials.Dugdale,
    js.potentials.LennardJones,
)
STATES = 4
# Steps of a march along a leg, and how many are computed together.
STEPS = 1200
BLOCK = 40
# Three surfaces with one law, seven with others: work of adhesion and range.
LOOPS = (
    *((seed, 0.03, 0.03) for seed in range(3)),
    (3, 0.03, 0.06),
    (4, 0.05, 0.03),
    (5, 0.05, 0.05),
    (6, 0.07, 0.04),
    (7, 0.07, 0.06),
    (8, 0.1, 0.05),
    (9, 0.1, 0.06),
)


def surface(size, law, seed, rms_height=0.05, k_high=8):
    grid = js.Grid(size)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(seed), k_low=2, k_high=k_high, rms_height=rms_height
    )
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law)


@jax.jit
def march(contact, gap, values):
    """Return the energy, the mean pressure and the gap of equilibria, each from the one before."""

    def step(gap, value):
        state = js.equilibrate(contact, js.MeanGap(value), initial=gap, throw=False)
        return state.gap, (state.energy, state.mean_pressure, state.gap)

    return jax.lax.scan(step, gap, values)[1]


def losses(values, energy, pressure):
    """Return what each step has lost: the work by the trapezoid less the change of energy."""
    return -np.diff(values) * (pressure[1:] + pressure[:-1]) / 2 - np.diff(energy)


def marched_jumps(contact, turns, least):
    """Return the loads at which a march loses more than `least`, and how much.

    A step that has lost so much is taken again in finer ones, from whose end the march goes on: a
    long step through a jump can come to another state.
    """
    gap, jumps = js.equilibrate(contact, js.MeanGap(turns[0])).gap, []
    for first, last in itertools.pairwise(turns):
        values, i = np.linspace(first, last, STEPS + 1), 0
        while i < STEPS:
            # The last load again and again, where there are no more.
            block = values[np.minimum(np.arange(i, i + BLOCK + 1), STEPS)]
            energy, pressure, gaps = map(np.asarray, march(contact, gap, block))
            jumped = np.flatnonzero(losses(block, energy, pressure) > least)
            i += jumped[0] if len(jumped) else BLOCK
            gap = gaps[jumped[0] if len(jumped) else BLOCK]
            if len(jumped):
                finer = np.linspace(values[i], values[i + 1], BLOCK + 1)
                energy, pressure, gaps = map(np.asarray, march(contact, gap, finer))
                parts = losses(finer, energy, pressure)
                jumps += [(finer[k + 1], parts[k]) for k in np.flatnonzero(parts > least / 10)]
                i, gap = i + 1, gaps[-1]
    return np.array(jumps).reshape(-1, 2)


def loop_row(seed, energy, length):
    """Return what a loop loses by its jumps and by a march, and how many jumps both have."""
    contact = surface(64, js.potentials.Exponential(energy, length), seed)
    turns = np.array([0.4, 0.02, 0.4])
    path = js.follow(contact, js.MeanGap(jnp.asarray(turns)))
    lost_by_path = float(path.dissipation)
    # What a reversible contact loses on a step is rounding.
    marched = marched_jumps(contact, turns, max(1e-3 * lost_by_path, 1e-8 * energy))
    total, near = marched[:, 1].sum(), (turns[0] - turns[1]) / STEPS
    large = marched[marched[:, 1] > 0.01 * total]
    loads, lost = np.asarray(path.jumps.load.value), np.asarray(path.jumps.dissipation)
    found = [np.any((abs(loads - load) < near) & (lost > loss / 2)) for load, loss in large]
    unlocated, error = float(path.unlocated), float(path.unlocated_error)
    difference = f"{100 * (lost_by_path / total - 1):+.1f} %" if total else "none"
    return (
        f"| {seed} | {energy} | {length} | {len(path.load.value)} | {len(loads)} | {len(large)} | "
        f"{sum(found)} | {lost_by_path:.4e} | {total:.4e} | "
        f"{difference} | {unlocated:.1e} ± {error:.0e} |"
    )


def random_loop(seed):
    """Return a random contact and a random load path that ends where it begins."""
    random = np.random.default_rng(seed)
    law = LAWS[seed % len(LAWS)]
    rms_height = 0.05
    length = rms_height * 10 ** random.uniform(-0.5, 0.7)
    energy = rms_height**2 * 10 ** random.uniform(0, 1.5)
    contact = surface(64, law(energy, length), seed, rms_height)
    # Below that, points jump one by one.
    while contact.resolution < 1:
        energy /= 2
        contact = surface(64, law(energy, length), seed, rms_height)
    far, near = 8 * rms_height, rms_height * 10 ** random.uniform(-1, 0.3)
    if law is js.potentials.LennardJones:
        # Nearer, its core takes pressures of any size.
        near = max(near, 0.8 * length)
    middle = random.uniform(near, far)
    return contact, js.MeanGap(jnp.array([far, near, middle, near, far]))


@jax.jit
def slopes_of(law, gaps):
    return jax.vmap(jax.grad(law))(gaps)


def missed(contact, gap, pressure):
    """Return the rms of what is out of balance over that of the elastic pressures, by NumPy.

    Or over a hundredth of what full contact takes, where this is more.
    """
    n = gap.shape[0]
    waves = np.fft.fftfreq(n, 1 / n)
    multiplier = np.pi * np.hypot(*np.meshgrid(waves, waves, indexing="ij"))
    heights = np.asarray(contact.heights)
    elastic = np.fft.ifft2(multiplier * np.fft.fft2(gap + heights)).real
    conforming = np.fft.ifft2(multiplier * np.fft.fft2(heights)).real
    slopes = np.asarray(slopes_of(contact.potential, gap.ravel()))
    net = elastic + pressure + slopes.reshape(gap.shape)
    off = np.where(gap > 0, net, np.minimum(net, 0))
    scale = max(np.mean(elastic**2), 1e-4 * np.mean(conforming**2))
    return np.sqrt(np.mean(off**2) / scale)


def random_loops(number):
    worst, unstable, undecided, checked, rises, num_states, num_jumps = 0, 0, 0, 0, 0, 0, 0
    lost, results = 0.0, {}
    for seed in range(number):
        contact, load = random_loop(seed)
        path = js.follow(contact, load, smallest_jump=1e-3, fields=True, throw=False)
        results[path.result.name] = results.get(path.result.name, 0) + 1
        if path.result != "successful":
            print(f"seed {seed}: {path.result.name} at {path.load.value[-1]:.4g}", flush=True)
            continue
        states = path.equilibrium
        num_states, num_jumps = num_states + len(states.mean_gap), num_jumps + len(path.jumps)
        for gap, pressure in zip(states.gap, states.mean_pressure, strict=True):
            worst = max(worst, missed(contact, np.asarray(gap), float(pressure)))
        for i in np.random.default_rng(seed).choice(len(states.mean_gap), STATES, replace=False):
            start = states.gap[i]
            state = js.equilibrate(contact, js.MeanGap(path.load.value[i]), initial=start)
            verdict = js.assess_stability(contact, state, verdict_only=True, throw=False).verdict
            unstable += bool(verdict == "unstable")
            undecided += bool(verdict == "undecided")
            checked += 1
        rises += int((path.jumps.dissipation <= 0).sum())
        # Where no jump is located the way back is, but for small ones, the way there.
        if len(path.jumps) == 0:
            lost = max(lost, abs(float(path.work)) / float(jnp.ptp(states.energy)))
    return [
        f"{number} random loops of 64² points: {results}; {num_states} states, {num_jumps} jumps",
        f"- largest residual by NumPy {worst:.1e}",
        f"- of {checked} states assessed {unstable} unstable, {undecided} undecided",
        f"- {rises} jumps that do not lose energy",
        f"- at most {lost:.1e} of the energy's range lost in loops without a located jump",
    ]


def cost(size):
    """Return the time of a loop, and of as many warm-started equilibria at its loads."""
    contact = surface(size, js.potentials.Exponential(0.03, 0.03), 0)
    load = js.MeanGap(jnp.array([0.3, 0.05, 0.3]))
    path, seconds = timed(lambda: js.follow(contact, load, smallest_jump=1e-3))

    def singles():
        state = None
        for value in path.load.value:
            state = js.equilibrate(contact, js.MeanGap(value), initial=state)
        return state

    _, single = timed(singles)
    return (
        f"| {size}² | {len(path.load.value)} | {len(path.jumps)} | {seconds:.1f} | {single:.1f} | "
        f"{seconds / single:.1f} |"
    )


def timed(function):
    jax.block_until_ready(function())
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return result, time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=10)
    parser.add_argument("--random", type=int, default=200)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []

    def say(*lines):
        rows.extend(lines)
        print(*lines, sep="\n", flush=True)

    say(
        "| points | states | jumps | seconds | as many equilibria | ratio |",
        "|---|---|---|---|---|---|",
    )
    for size in (64, 128, 256):
        say(cost(size))
    say("", *random_loops(options.random), "")
    say("Loops against a march of 1200 steps a leg; large jumps lose 1 % of it or more", "")
    columns = (
        "seed",
        "w",
        "range",
        "states",
        "jumps",
        "large jumps",
        "of these found",
        "lost [E L³]",
    )
    columns += "by the march", "difference", "not located"
    say(f"| {' | '.join(columns)} |", "|---" * len(columns) + "|")
    for loop in LOOPS[: options.loops]:
        say(loop_row(*loop))
    if options.out:
        options.out.write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
