"""The open set of test problems: its laws, its residual, and its table."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

LAWS = {
    "exponential": js.potentials.Exponential,
    "gaussian": js.potentials.Gaussian,
    "rational": js.potentials.Rational,
    "lennard-jones": js.potentials.LennardJones,
    "none": lambda energy, length: js.potentials.NoAdhesion(),
}


@pytest.fixture(scope="module")
def problems():
    path = Path(__file__).parents[2] / "benchmarks" / "problems.py"
    with pytest.MonkeyPatch.context() as patch:
        # It pins threads for its own process.
        for name in ("JAX_PLATFORMS", "OMP_NUM_THREADS", "XLA_FLAGS"):
            patch.setenv(name, "")
        spec = spec_from_file_location("benchmark_problems", path)
        module = module_from_spec(spec)
        patch.setitem(__import__("sys").modules, "benchmark_problems", module)
        spec.loader.exec_module(module)
        yield module


def problem(module, law, control, value):
    heights = js.surfaces.self_affine(js.Grid(16), jax.random.key(0), k_high=4, rms_height=0.05)
    return module.Problem("rough", np.asarray(heights), 2.0, law, 0.05, 0.1, control, value)


@pytest.mark.parametrize("law", LAWS)
def test_laws_are_those_of_jaxstab(problems, law):
    gap = np.linspace(0.05, 0.4, 7)
    ours = LAWS[law](0.05, 0.1)
    of_one = jax.vmap(lambda x: (ours(x), jax.grad(ours)(x), jax.grad(jax.grad(ours))(x)))
    found = problem(problems, law, "gap", 0.1).law_and_derivatives(gap)
    np.testing.assert_allclose(found, of_one(jnp.asarray(gap)), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("law", "control", "value"),
    [
        ("none", "gap", 0.05),
        pytest.param("none", "pressure", 0.1, marks=pytest.mark.nightly),
        pytest.param("exponential", "gap", 0.05, marks=pytest.mark.nightly),
        pytest.param("rational", "pressure", 0.1, marks=pytest.mark.nightly),
        pytest.param("lennard-jones", "gap", 0.1, marks=pytest.mark.nightly),
    ],
)
def test_the_residual_vanishes_in_equilibria_alone(problems, law, control, value):
    case = problem(problems, law, control, value)
    contact = js.Contact(js.HalfSpace(js.Grid(16), 2.0), case.heights, LAWS[law](0.05, 0.1))
    load = {"gap": js.MeanGap, "pressure": js.MeanPressure}[control](value)
    solver = js.solvers.PreconditionedConjugateGradient(1e-12)
    gap = np.asarray(js.equilibrate(contact, load, solver).gap)
    assert case.is_met(gap) and case.residual(gap) < 1e-10
    # A wave on it, of which the points in contact take no part, keeps the mean gap.
    moves = np.where(gap > 0, np.random.default_rng(0).normal(size=gap.shape), 0)
    moves[gap > 0] -= moves[gap > 0].mean()
    amount = 1e-4 * gap[gap > 0].min() / np.abs(moves).max()
    assert case.is_met(gap + amount * moves)
    assert case.residual(gap + amount * moves) > 1e3 * case.residual(gap)
    # Points in contact pulled off: a reaction without contact.
    lifted = np.where(gap == 0, 1e-3, gap)
    assert case.residual(lifted) > 1e-4 or law == "lennard-jones"
    assert not case.is_met(gap - 1e-3)


def test_solvers_are_given_tolerances_until_they_are_right(problems):
    case = problem(problems, "exponential", "gap", 0.05)
    contact = js.Contact(js.HalfSpace(js.Grid(16), 2.0), case.heights, LAWS[case.law](0.05, 0.1))
    exact = np.asarray(js.equilibrate(contact, js.MeanGap(0.05)).gap)
    rough = np.maximum(exact.mean() + 0 * exact, 0)
    asked = []

    def solve(_, tolerance):
        asked.append(tolerance)
        return (exact if tolerance < 1e-7 else rough), tolerance

    assert problems.run(solve, case).end == "solved" and asked == [1e-6, 1e-8]
    assert problems.run(solve, case).seconds == 1e-8
    assert problems.run(lambda *_: (rough, 0.1), case).end == "failed"
    assert problems.run(lambda *_: (exact, 21.0), case).end == "failed"
    assert problems.run(lambda *_: (-exact, 0.1), case).end == "failed"
    assert problems.run(lambda *_: 1 / 0, case).end == "failed"

    def none(*_):
        raise NotImplementedError

    assert problems.run(none, case).end == "not offered"
    np.testing.assert_allclose(
        problems.shifted_geometric_mean(np.array([0.09, 0.99])), np.sqrt(0.1) - 0.01
    )
    mine = [problems.Outcome("solved", 0.1, 1e-8), problems.Outcome("failed", 20.0, 1.0)]
    lines = list(problems.table({"mine": mine, "other": mine[::-1]}, ["random 0", "random 1"]))
    # None of the rough ones is offered.
    assert lines[2].startswith("| 2 random | mine | 2 | 1 | 1e-08, 1e-08 | 1.4") and len(lines) == 4
    assert lines[2].endswith("| 0.1, 0.1 (1 problems) |") and "(0 problems)" in lines[3]
