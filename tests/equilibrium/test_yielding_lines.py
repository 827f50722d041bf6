"""The oracle of contacts that yield, held against plain descents and samples of cones."""

from itertools import product

import numpy as np
import pytest
from yielding_lines import (
    HELD,
    OPEN,
    YIELDING,
    Line,
    exponential,
    lennard_jones,
    minima,
    smallest_on_cone,
)

NEAR = 1e-3


def random_line(rng, size, law, load):
    matrix = rng.normal(size=(size, size))
    if law == "exponential":
        law = exponential(rng.uniform(0, 0.6), rng.uniform(0.3, 0.6))
    else:
        law = lennard_jones(rng.uniform(0.02, 0.3), rng.uniform(0.2, 0.5))
    value = rng.uniform(-0.5, 0.5)
    return Line(
        stiffness=matrix @ matrix.T / size + 0.2 * np.eye(size),
        heights=rng.normal(size=size) / 2,
        law=law,
        hardness=rng.uniform(0.2, 1.5, size),
        indentation=np.maximum(rng.normal(size=size) * 0.3, 0),
        mean_displacement=value if load == "mean_displacement" else None,
        mean_pressure=value if load == "mean_pressure" else None,
    )


def descended(line, w, num_steps=12_000):
    """Return where proximal gradient steps under a mean pressure end, from each row."""
    curvature = line.law.curvature(line.closest + np.geomspace(1e-6, 5, 500)[:, None])
    step = 1 / (np.linalg.eigvalsh(line.stiffness)[-1] + abs(curvature).max())
    closest, jump = line.closest, step * (line.hardness + line.law.slope(line.closest))
    for _ in range(num_steps):
        displacement = w + line.heights - line.indentation
        pressure = displacement @ line.stiffness + line.mean_pressure
        w = w - step * (pressure + line.law_of(w)[1])
        w = np.where(w > closest, w, np.minimum(w + jump, closest))
    return w


@pytest.mark.parametrize("law", ["exponential", "Lennard-Jones"])
@pytest.mark.parametrize("size", [2, 3, 5])
def test_plain_descents_end_in_the_minima_and_reach_all_of_few_points(size, law):
    rng = np.random.default_rng(size)
    for _ in range(2):
        line = random_line(rng, size, law, "mean_pressure")
        states = np.array([state.w for state in minima(line)])
        grid = np.linspace(-2, 3, {2: 8, 3: 4}.get(size, 2))
        if size <= 3:
            starts = np.array(list(product(grid, repeat=size)))
        else:
            starts = rng.uniform(-2, 3, (100, size))
        ends = descended(line, starts)
        apart = abs(ends[:, None] - states).max(-1)
        # Plain steps creep along soft valleys; minima lie farther apart.
        assert apart.min(1).max() < NEAR
        if size <= 3:
            assert apart.min(0).max() < NEAR


@pytest.mark.parametrize("law", ["exponential", "Lennard-Jones"])
@pytest.mark.parametrize("load", ["mean_pressure", "mean_displacement"])
def test_no_small_perturbation_lowers_the_energy_of_a_minimum(law, load):
    rng = np.random.default_rng(7)
    seen = set()
    for _ in range(20):
        line = random_line(rng, 4, law, load)
        for state in minima(line):
            seen |= set(state.sides)
            directions = rng.normal(size=(1000, 4)) * (rng.random((1000, 4)) < 0.5)
            if load == "mean_displacement":
                directions -= directions.mean(-1, keepdims=True)
            for size in (1e-2, 1e-4):
                energies = line.energy(state.w + size * state.gap.max() * directions)
                assert energies.min() > line.energy(state.w) - 1e-13
    assert seen == ({OPEN, HELD, YIELDING} if law == "exponential" else {OPEN, YIELDING})


def test_a_minimum_obeys_the_conditions_of_equilibrium():
    rng = np.random.default_rng(3)
    for _ in range(10):
        line = random_line(rng, 4, "exponential", "mean_displacement")
        for state in minima(line):
            u, g, z = state.displacement, state.gap, state.indentation
            np.testing.assert_allclose(u, g + line.heights - z, atol=1e-13)
            np.testing.assert_allclose(u.mean(), line.mean_displacement)
            pressure = line.stiffness @ u + state.mean_pressure
            attraction = line.law.slope(g)
            np.testing.assert_allclose(pressure + attraction, state.reaction, atol=1e-10)
            assert (g >= 0).all() and not (g * state.reaction).any()
            assert (z >= line.indentation).all()
            assert (pressure <= line.hardness + 1e-10).all()
            grows = z > line.indentation
            np.testing.assert_allclose((pressure - line.hardness)[grows], 0, atol=1e-10)


def test_the_smallest_eigenvalue_on_a_cone_is_that_of_its_samples():
    rng = np.random.default_rng(5)
    bounds = np.array([(-np.inf, np.inf), (0, np.inf), (-np.inf, 0), (0, 0)])
    for fixes_mean in (False, True):
        for _ in range(20):
            matrix = rng.normal(size=(3, 3))
            matrix = matrix + matrix.T
            lower, upper = bounds[rng.integers(4, size=3)].T
            smallest = smallest_on_cone(matrix, lower, upper, fixes_mean)
            moves = (rng.random((20_000, 3)) < 0.7) & (lower != upper)
            samples = rng.normal(size=(20_000, 3)) * moves
            if fixes_mean:
                mean = samples.sum(-1, keepdims=True) / np.maximum(moves.sum(-1, keepdims=True), 1)
                samples -= moves * mean
            is_admissible = ((samples >= lower) & (samples <= upper)).all(-1)
            samples = samples[is_admissible & (abs(samples).max(-1) > 1e-3)]
            if not len(samples):
                assert smallest == np.inf
                continue
            quotients = np.einsum("bi,ij,bj->b", samples, matrix, samples)
            quotients = quotients / (samples**2).sum(-1)
            assert smallest <= quotients.min() + 1e-12
            assert quotients.min() < smallest + 0.05 * abs(matrix).max()
