"""How far proofs of stability reach, and whether any of them is wrong.

- The paper's surface under a held gap, nearly closed: what is proved of the cone's eigenvalue.
- Small problems with 60 to 80 % of 16 points closed, against every face of the cone: no bound may
  be above the exact minimum, and no verdict called proved may differ from the exact one.
- The same with 70 to 98 % of 64 points closed, against a search from many more starts.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from faces import smallest_on_cone

import jaxstab as js

jax.config.update("jax_enable_x64", True)

GAPS = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3)
NUM_KEYS = 8


def reach(size):
    """Yield a row for each gap of the paper's surface."""
    grid = js.Grid(size)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=32, rms_height=0.1)
    law = js.potentials.Exponential(1e-2, 1.0)
    contact = js.Contact(js.HalfSpace(grid, 1e-3), heights, law)
    for gap in GAPS:
        state = js.equilibrate(contact, js.MeanGap(gap))
        stability = js.assess_stability(contact, state)
        cone = stability.cone
        yield (
            f"| {size}² | {gap:.0e} | {100 * float(state.contact_area):.2f} % | "
            f"{float(stability.lower_bound.eigenvalue):+.5f} | {float(cone.bound):+.5f} | "
            f"{float(cone.eigenvalue):+.5f} | {stability.verdict.name} | "
            f"{'yes' if stability.proved else 'no'} |"
        )


def nearly_closed(seed, side, shares):
    """Return a contact of a part of its points, softer than its softest waves, in equilibrium."""
    random = np.random.default_rng(seed)
    num_closed = round(side**2 * random.uniform(*shares))
    gap = np.zeros((side, side))
    is_scattered = seed % 2
    distance = np.hypot(*np.meshgrid(np.arange(side) - 1, np.arange(side) - 1))
    order = (
        random.random(gap.size) if is_scattered else (distance + random.random(gap.shape)).ravel()
    )
    opened = np.argsort(order)[: gap.size - num_closed]
    gap.flat[opened] = random.uniform(0.02, 0.6, opened.size)
    solid = js.HalfSpace(js.Grid(side), 1.0)
    length = 0.3
    energy = random.uniform(0.8, 2.0) * float(solid.min_stiffness) * length**2
    law = js.potentials.Exponential(energy, length)
    pressure = np.where(gap == 0, 1.0, 0.0) - energy / length * np.exp(-gap / length)
    displacement = solid.displacement(jnp.asarray(pressure))
    contact = js.Contact(solid, displacement - gap, law)
    return contact, js.equilibrate(contact, js.MeanGap(gap.mean()), initial=gap)


def exact_minimum(contact, state):
    size = state.gap.size
    hessian = contact.hessian(state.gap)
    matrix = np.asarray(jax.vmap(hessian)(jnp.eye(size).reshape(size, *state.gap.shape)))
    touches = np.asarray(state.in_contact).ravel()
    return smallest_on_cone(matrix.reshape(size, size), touches, np.zeros_like(touches), True)


def searched_minimum(contact, state):
    keys = map(jax.random.key, range(1, 1 + NUM_KEYS))
    found = [js.assess_stability(contact, state, key=key, throw=False) for key in keys]
    return min(float(stability.cone.eigenvalue) for stability in found)


def small(number, side, shares, minimum):
    """Return a row on a number of small problems."""
    stable = proved = certified = wrong = above = 0
    for seed in range(number):
        contact, state = nearly_closed(seed, side, shares)
        stability = js.assess_stability(contact, state, throw=False)
        exact = minimum(contact, state)
        size = float(contact.solid.max_stiffness)
        above += float(stability.cone.bound) > exact + 1e-9 * size
        is_stable = stability.verdict == "stable"
        stable += bool(is_stable)
        proved += bool(is_stable & stability.proved)
        certified += bool(is_stable & stability.proved & (stability.lower_bound.eigenvalue < 0))
        wrong += bool(is_stable & stability.proved) and exact <= 0
    return f"| {number} | {side}² | {stable} | {proved} | {certified} | {above} | {wrong} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []

    def say(*lines):
        rows.extend(lines)
        print(*lines, sep="\n", flush=True)

    say("| points | mean gap | contact | lower bound | proved | found | verdict | proved |")
    say("|---" * 8 + "|")
    for size in (128, 256):
        for row in reach(size):
            say(row)
    say("", "Small problems: how many are stable, of these proved, of these by a certificate; and")
    say(
        "bounds above the minimum, and proofs that are wrong. At 4² the minimum is exact, at 8² the"
    )
    say(f"lowest of {NUM_KEYS} searches.", "")
    say("| problems | points | stable | proved | certified | above | wrong |", "|---" * 7 + "|")
    say(small(options.number, 4, (0.6, 0.8), exact_minimum))
    say(small(options.number, 8, (0.7, 0.98), searched_minimum))
    if options.out:
        options.out.write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
