"""Branches of random small contacts against dense arclength steps that take each event by itself.

Ten families of lines and grids of 3 to 36 points: half spaces and layers, exponential and Gaussian
laws and their sums, laws with a core, held gaps and displacements, springs and dead loads, grids
that resolve the law two to twelve times. A branch agrees if its turns are those of the dense curve,
in order, and each of its states lies on it. It is uncertain if it ends as such, having agreed up to
there. A branch that leaves the dense curve without a word is wrong.
"""

import argparse
import collections
import sys
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.append(str(Path(__file__).parents[1] / "tests" / "branches"))
from brute_force import matrix_of
from dense_curve import DenseCurve

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
warnings.simplefilter("ignore", js.exceptions.SurfaceWarning)

LAYER = "layer"
# Why a dense curve may be given up.
UNDECIDED = ("tie", "lost", "steps")
# Shape, solid, whether the law has a core, load.
FAMILIES = (
    ((32,), "half space", False, js.MeanDisplacement),
    ((8,), "half space", False, js.MeanGap),
    ((36,), "half space", False, js.Spring),
    ((5, 6), "half space", False, js.MeanPressure),
    ((16,), LAYER, False, js.MeanGap),
    ((6, 6), "half space", True, js.MeanGap),
    ((3,), "half space", False, js.MeanDisplacement),
    ((24,), LAYER, False, js.MeanPressure),
    ((32,), "half space", True, js.Spring),
    ((4, 5), LAYER, False, js.MeanDisplacement),
)
STATES = 200
# Steps of the dense curve, over the rms height, and how far a state may lie from its states.
STEP, DISTANCE = 0.05, 0.1


@jax.jit
def elastic(solid, field):
    return solid.with_uniform_stiffness(0).apply(field)


@jax.jit
def slope(law, gap):
    return jax.vmap(jax.grad(law))(gap)


@jax.jit
def curvature(law, gap):
    return jax.vmap(jax.grad(jax.grad(law)))(gap)


class Problem:
    """A random contact of a family, two loads, and the pieces of its dense curve."""

    def __init__(self, seed):
        shape, solid, has_core, kind = FAMILIES[seed % len(FAMILIES)]
        random = np.random.default_rng(seed)
        grid = js.Grid(shape, (1.0,) * len(shape))
        waves = np.meshgrid(*(np.fft.fftfreq(n, 1 / n) for n in shape), indexing="ij")
        wave = np.sqrt(sum(np.square(k) for k in waves))
        decay = np.where(wave > 0, np.maximum(wave, 1), np.inf) ** -random.uniform(0.8, 2.0)
        heights = np.fft.ifftn(decay * np.fft.fftn(random.normal(size=shape))).real
        self.rms = random.uniform(0.01, 0.05)
        heights *= self.rms / heights.std()
        thickness = random.uniform(0.1, 0.5)
        if solid == LAYER:
            self.solid = js.Layer(grid, 1.0, random.uniform(0, 0.4), thickness)
        else:
            self.solid = js.HalfSpace(grid, 1.0)
        self.stiffness = matrix_of(lambda field: elastic(self.solid, field), shape)
        length, resolution = random.uniform(0.05, 0.25), random.uniform(2, 12)
        share = random.choice([0.0, 1.0, random.uniform(0, 1)])
        other = random.uniform(0.5, 2) * length
        self.law = self.make_law(has_core, resolution, length, share, other)
        self.contact = js.Contact(self.solid, heights, self.law)
        self.heights = heights
        self.far = random.uniform(0.5, 1) * (3 * length + np.ptp(heights))
        self.loads, self.value = self.make_loads(kind, random)

    def make_law(self, has_core, resolution, length, share, other):
        """Return a law whose steepest fall of attraction the grid resolves so."""
        stiffest = np.linalg.eigvalsh(self.stiffness)[-1]

        def law(scale):
            if has_core:
                return js.potentials.LennardJones(scale, length)
            exponential = js.potentials.Exponential(scale * share, length)
            return exponential + js.potentials.Gaussian(scale * (1 - share), other)

        gaps = jnp.linspace(1e-3, 5, 4000) * max(length, other)
        return law(stiffest / resolution / float(-jnp.min(curvature(law(1.0), gaps))))

    def make_loads(self, kind, random):
        """Return the two loads, and how their value follows mean gap and pressure."""
        mean, rise = self.heights.mean(), np.ptp(self.heights)
        if kind is js.MeanPressure:
            first = float(self.start_at(0.05 * rise).mean_pressure)
            last = first - random.uniform(0.5, 2) * np.pi * self.rms
            return js.MeanPressure(jnp.array([first, last])), (0.0, 1.0, 0.0)
        ends = np.array([self.far, 0.05 * rise])
        if kind is js.MeanGap:
            return js.MeanGap(jnp.asarray(ends)), (1.0, 0.0, 0.0)
        if kind is js.MeanDisplacement:
            return js.MeanDisplacement(jnp.asarray(ends + mean)), (1.0, 0.0, mean)
        stiffness = 10 ** random.uniform(-1, 1.5)
        return js.Spring(jnp.asarray(ends + mean), stiffness), (1.0, -1 / stiffness, mean)

    def start_at(self, gap):
        """Return an equilibrium at a mean gap."""
        return js.equilibrate(self.contact, js.MeanGap(gap), throw=False)

    def start(self):
        """Return an equilibrium at the first load: from surfaces apart, under a pressure from near.

        A dead load would pull those that are apart further.
        """
        if isinstance(self.loads, js.MeanPressure):
            return self.start_at(0.05 * np.ptp(self.heights))
        apart = 1.0 + self.heights.max() - self.heights
        return js.equilibrate(self.contact, self.loads[0], initial=apart, throw=False)

    def dense(self, start, number):
        """Return a dense curve from a start to a few events more than so many, and its end."""
        curve = DenseCurve(
            self.stiffness,
            self.heights,
            lambda gap: np.asarray(slope(self.law, gap)),
            lambda gap: np.asarray(curvature(self.law, gap)),
            self.value,
        )
        last = float(self.loads.value[1])
        gap, pressure = np.asarray(start.gap), float(start.mean_pressure)
        end = curve.follow(gap, pressure, last, STEP * self.rms, 8000, number + 3)
        return curve, end


def outcome(seed):
    """Return how a branch compares with its dense curve, and the reason if it does not agree."""
    problem = Problem(seed)
    start = problem.start()
    if start.result != "successful":
        return "no start", start.result.name
    branch = js.continuation(
        problem.contact, problem.loads, initial=start, fields=True, max_states=STATES, throw=False
    )
    end, number = branch.end.name, len(branch.turns)
    try:
        curve, dense_end = problem.dense(start, number)
    except np.linalg.LinAlgError:
        return "dense undecided", f"{number} turns, a singular matrix in the dense steps"
    shared = min(number, len(curve.events))
    kinds = list(branch.turns.kind.name)[:shared] if number else []
    values = np.asarray(branch.turns.load.value)[:shared]
    span = abs(float(np.diff(problem.loads.value)[0]))
    for i, (kind, value) in enumerate(curve.events[:shared]):
        if kind != kinds[i] or abs(value - values[i]) > 1e-6 * span:
            return "wrong", f"turn {i}: {kinds[i]} {values[i]:.9g}, dense {kind} {value:.9g}"
    states = np.array([state[:-1] for state in curve.states])
    is_whole = dense_end == "load" and shared == len(curve.events)
    last = int(branch.turns.state[shared - 1]) if shared and not is_whole else len(branch.index)
    gaps = np.asarray(branch.equilibrium.gap).reshape(len(branch.index), -1)[:last]
    away = np.array([np.sqrt(np.mean((states - gap) ** 2, axis=1)) for gap in gaps])
    away = away.reshape(len(gaps), len(states))
    # States nearest to the end of a dense curve that was given up may lie beyond it.
    counts = (away.argmin(axis=1) < len(states) - 1) | (dense_end not in UNDECIDED)
    far = away.min(axis=1)[counts].max(initial=0)
    if far > DISTANCE * problem.rms:
        return "wrong", f"a state lies {far / problem.rms:.2g} rms heights from the dense curve"
    if number > shared:
        word = "dense undecided" if dense_end in UNDECIDED else "wrong"
        return word, f"{number} turns, dense {shared} to its end: {dense_end}"
    if end in ("uncertain", "lost"):
        return "uncertain", f"{end} after {number} turns and {len(branch.index)} states"
    if end == "load" and not is_whole:
        word = "dense undecided" if dense_end in UNDECIDED else "wrong"
        return word, f"at the load after {number} turns, dense {len(curve.events)}: {dense_end}"
    return "agreed", end


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 300), help="first, last + 1")
    parser.add_argument("--family", type=int, choices=range(len(FAMILIES)), help="of all, one")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    counts, rows = collections.Counter(), []
    # Family by family, since each is compiled once.
    for seed in sorted(range(*options.seeds), key=lambda seed: seed % len(FAMILIES)):
        if options.family not in (None, seed % len(FAMILIES)):
            continue
        word, reason = outcome(seed)
        counts[word] += 1
        if word != "agreed":
            rows.append(f"| {seed} | {word} | {reason} |")
            print(rows[-1], flush=True)
    table = ["| outcome | branches |", "|---|---|"]
    table += [f"| {word} | {number} |" for word, number in counts.most_common()]
    table += ["", "| seed | outcome | reason |", "|---|---|---|", *rows]
    print("\n".join(table))
    if options.out:
        options.out.write_text("\n".join(table) + "\n")


if __name__ == "__main__":
    main()
