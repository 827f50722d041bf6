"""Loops of loading and unloading: their energy, their cost, and every state from outside.

- Ten rough surfaces: the work around a loop, by quadrature of the load, against what jumps lose.
- Random loops: each recorded state is checked with NumPy, and some of each for stability.
- The time of a loop, over that of as many warm-started single equilibria.
"""

import argparse
import time
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.ResolutionWarning)

LAWS = (
    js.potentials.Exponential,
    js.potentials.Gaussian,
    js.potentials.Dugdale,
    js.potentials.LennardJones,
)
STATES = 4
ROOM = {"max_states": 2048, "max_jumps": 512}


def surface(size, law, seed, rms_height=0.05, k_high=8):
    grid = js.Grid(size)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(seed), k_low=2, k_high=k_high, rms_height=rms_height
    )
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law)


def loop_row(seed):
    """Return how far the work around a loop is from what its jumps lose, by three step lengths."""
    contact = surface(64, js.potentials.Exponential(0.03, 0.03), seed)
    load = js.MeanGap(jnp.array([0.4, 0.02, 0.4]))
    texts = []
    # Steps go with the cube root of what they may lose unseen.
    for share in (1e-5, 1e-5 / 8, 1e-5 / 64):
        path = js.follow(contact, load, smallest_jump=share, **ROOM)
        area = float(jnp.prod(contact.grid.lengths))
        work = -area * np.trapezoid(path.equilibrium.mean_pressure, path.load.value)
        located = float(path.jumps.dissipation.sum())
        lost = float(path.dissipation)
        texts.append(
            f"{len(path.load.value)} | {len(path.jumps)} | {100 * (work / lost - 1):+.2f} % | "
            f"{100 * (1 - located / lost):.1f} %"
        )
    return f"| {seed} | {' | '.join(texts)} |"


def random_loop(seed):
    """Return a random contact and a random programme that ends where it begins."""
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
        path = js.follow(contact, load, smallest_jump=1e-3, fields=True, throw=False, **ROOM)
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
    parser.add_argument("--output", type=Path)
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
    say("Loops at three step lengths; work by quadrature over what is lost, and what of it small")
    say("jumps lose that are not located", "")
    columns = "states | jumps | work | small |"
    say(f"| seed | {columns} {columns} {columns}", "|---" * 13 + "|")
    for seed in range(options.loops):
        say(loop_row(seed))
    if options.output:
        options.output.write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
