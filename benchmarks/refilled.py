"""Lane steps paid over those of use in studies of mixed contacts, with and without refilling.

Many small rough contacts, of three laws, of ranges, strengths and loads from light contact to
nearly full contact. Lanes run together, as on an accelerator, on any machine. A batch that
`jax.vmap` runs pays for each of its lanes what the slowest takes; lanes that are refilled pay until
the next exchange. Both are counted, the first from the steps of each case. Verdicts search two
linear spaces and two cones, these from twelve starts each, all of which a batch pays for. A
pull-off is hundreds of equilibria, one after another; a batch is charged for its slowest contact,
though it also waits within each of them.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js
from jaxstab.core.procedure import Procedure
from jaxstab.studies.lanes.programs import Programs
from jaxstab.studies.lanes.pull_off import Walking, unloaded
from jaxstab.studies.lanes.scheduler import Lanes

RESULTS = Path(__file__).parent / "results" / "refilled.md"
LAWS = (js.potentials.Exponential, js.potentials.Gaussian, js.potentials.Rational)
NUM_CASES = 1000
WIDTHS = (16, 64, 256)
NUM_STARTS = 12
N, RMS_HEIGHT = 32, 0.05
# Ranges of the law over the rms height, of its resolution, and mean gaps over the rms height.
LENGTHS, RESOLUTIONS, GAPS = (0.3, 2.0), (1.5, 20.0), (0.05, 4.0)


class Law(eqx.Module):
    """One of three laws, by its number."""

    number: jax.Array
    energy: jax.Array
    length: jax.Array

    def __call__(self, gap):
        energies = [law(self.energy, self.length)(gap) for law in LAWS]
        return jax.lax.select_n(self.number, *energies)


def build(seed, law, energy, length, gap):
    grid = js.Grid(N)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(seed), k_high=N // 4, rms_height=RMS_HEIGHT
    )
    law = Law(jnp.asarray(law), jnp.asarray(energy), jnp.asarray(length))
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law), js.MeanGap(gap)


def cases(count: int) -> dict[str, np.ndarray]:
    """Return the arguments of all cases."""
    random = np.random.default_rng(0)

    def between(low: float, high: float) -> np.ndarray:
        return low * (high / low) ** random.random(count)

    length = RMS_HEIGHT * between(*LENGTHS)
    stiffness = float(js.HalfSpace(js.Grid(N), 1.0).max_stiffness)
    return {
        "seed": np.arange(count),
        "law": random.integers(len(LAWS), size=count),
        "energy": stiffness * length**2 / between(*RESOLUTIONS),
        "length": length,
        "gap": RMS_HEIGHT * between(*GAPS),
    }


def run(programs: Programs, inputs: dict[str, np.ndarray], width: int) -> tuple[list[Any], Any]:
    """Return the outputs of all cases, and what was paid."""
    left = list(range(len(inputs["seed"])))

    def take(number: int, waits: bool) -> tuple[list[int], dict[str, np.ndarray]]:
        taken, left[:] = left[:number], left[number:]
        return taken, {name: values[taken] for name, values in inputs.items()}

    lanes = Lanes(programs, width, take)
    outputs = {number: outputs for number, outputs, _ in lanes.run()}
    return [outputs[number] for number in range(len(outputs))], lanes


def summary(contact: js.Contact, equilibrium: js.Equilibrium, stability: Any) -> dict[str, Any]:
    """Return the steps of each search, and of the start that won on each cone."""
    pairs = stability.pairs
    return {
        "ended": equilibrium.result,
        "assessed": stability.result,
        "verdict": stability.verdict,
        "contact_area": equilibrium.contact_area,
        "num_steps": equilibrium.num_steps,
        "spaces": pairs["lower_bound"].num_steps,
        "cone": jnp.nanmax(pairs["cone"].history.steps),
        "starts": pairs["cone"].num_steps,
    }


def paid_by(steps: np.ndarray, width: int) -> int:
    """Return the steps of all lanes where batches run to the slowest's end."""
    batches = [steps[i : i + width] for i in range(0, len(steps), width)]
    return sum(width * int(batch.max()) for batch in batches)


def column(outputs: list[Any], name: str) -> np.ndarray:
    return np.array([found[name] for found in outputs])


def equilibria(inputs: dict[str, np.ndarray]) -> list[str]:
    """Return the lines on equilibria."""
    lines, steps, areas = [], np.zeros(0), np.zeros(0)
    for width in WIDTHS:
        outputs, lanes = run(js.cases.equilibrium(build).programs(), inputs, width)
        assert all(found["ended"] == "successful" for found in outputs)
        steps, areas = column(outputs, "num_steps"), column(outputs, "contact_area")
        assert lanes.useful == steps.sum()
        cells = steps.sum() / paid_by(steps, width), lanes.useful / lanes.paid
        lines.append(f"| {width} | {cells[0]:.2f} | {cells[1]:.2f} |")
    low, middle, high = np.percentile(steps, [0, 50, 100])
    light, half, heavy = np.percentile(areas, [5, 50, 95])
    return [
        f"{len(steps)} equilibria on {N} x {N} points, {', '.join(law.__name__ for law in LAWS)}",
        f"- contact area of {light:.2f}, {half:.2f}, {heavy:.2f} at 5, 50, 95 % of them",
        f"- from {low:.0f} to {high:.0f} steps, half of them up to {middle:.0f}, "
        f"{steps.sum():.0f} in all",
        "",
        "| lanes | useful over paid, without refilling | with |",
        "|---|---|---|",
        *lines,
    ]


def verdicts(inputs: dict[str, np.ndarray], width: int) -> list[str]:
    """Return the lines on verdicts."""
    outputs, lanes = run(js.cases.verdict(build, summary).programs(), inputs, width)
    words = column(outputs, "verdict")
    counts = ", ".join(f"{(words == word).sum()} {word}" for word in js.VERDICTS.names)
    # On the cones at least what the winner took, from each start and on one of the cones.
    names = {"num_steps": 1, "spaces": 1, "cone": NUM_STARTS}
    paid = sum(number * paid_by(column(outputs, name), width) for name, number in names.items())
    useful = sum(column(outputs, name).sum() for name in ("num_steps", "spaces", "starts"))
    return [
        f"Their verdicts: {counts}; {(column(outputs, 'assessed') != 'successful').sum()} failed",
        "",
        "| lanes | useful over paid, without refilling at most | with | steps paid |",
        "|---|---|---|---|",
        f"| {width} | {useful / paid:.2f} | {lanes.useful / lanes.paid:.2f} | {lanes.paid} |",
    ]


class Counted(Walking):
    """A walk, and the steps of all its searches."""

    num_steps: Any = eqx.field(kw_only=True)

    @property
    def found(self):
        return self.walk, self.num_steps

    def turned(self):
        num_steps = self.num_steps + self.loops.num_steps[0]
        return replace(super().turned(), num_steps=num_steps)


def counted(values: dict[str, Any]) -> Procedure[dict[str, Any]]:
    """Return the procedure of a pull-off that counts its steps."""
    procedure, found, num_steps = unloaded(build(**values)[0]), None, jnp.array(0)
    while True:
        try:
            request = procedure.send(found)
        except StopIteration as end:
            return {"ended": end.value.result, "steps": num_steps}
        if isinstance(request, Walking):
            found, num_steps = yield Counted(request.course, request.walk, num_steps=num_steps)
        else:
            found = yield request


def pull_offs(inputs: dict[str, np.ndarray], width: int) -> list[str]:
    """Return the lines on pull-offs."""
    outputs, lanes = run(Programs(counted), inputs, width)
    steps, ended = column(outputs, "steps"), column(outputs, "ended")
    least, middle, most = np.percentile(steps, [0, 50, 100])
    return [
        f"Pull-offs of {len(steps)} of them: {(ended != 'successful').sum()} failed",
        f"- from {least:.0f} to {most:.0f} steps, half of them up to {middle:.0f}",
        "",
        "| lanes | useful over paid, without refilling at most | with | steps paid |",
        "|---|---|---|---|",
        f"| {width} | {steps.sum() / paid_by(steps, width):.2f} "
        f"| {lanes.useful / lanes.paid:.2f} | {lanes.paid} |",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=NUM_CASES)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    inputs = cases(options.cases)
    few = {name: values[: options.cases // 5] for name, values in inputs.items()}
    lines = [
        *equilibria(inputs),
        "",
        *verdicts(inputs, WIDTHS[1]),
        "",
        *pull_offs(few, WIDTHS[0]),
    ]
    options.out.write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
