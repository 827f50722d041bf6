"""Programs for accelerators and their numbers, without an accelerator."""

import re
from contextlib import nullcontext

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import dense_hessian, smallest_on_cone, smallest_on_zero_mean
from problems import rough_contact
from programs import beside_an_accelerator
from step_counts import as_on_an_accelerator, measured_step, solver_runs, waits

import jaxstab as js
from jaxstab.stability.cones import AdmissibleCone

N, LANES = 16, 3


def solve(heights):
    """Return a state and its stability, as arrays of the precision of the heights."""
    dtype = heights.dtype
    solid = js.HalfSpace(js.Grid(N, jnp.ones((), dtype)), jnp.ones((), dtype))
    law = js.potentials.Exponential(jnp.array(0.01, dtype), jnp.array(0.1, dtype))
    contact = js.Contact(solid, heights, law)
    equilibrium = js.equilibrate(contact, js.MeanGap(jnp.array(0.1, dtype)), throw=False)
    stability = js.assess_stability(contact, equilibrium, throw=False)
    pairs = stability.pairs.values()
    return {
        "gap": equilibrium.gap,
        "mean_pressure": equilibrium.mean_pressure,
        "eigenvalues": jnp.stack([pair.eigenvalue for pair in pairs]),
        "errors": jnp.stack([pair.error for pair in pairs]),
        "verdict": stability.verdict.code,
    }


def surfaces(dtype):
    grid = js.Grid(N)
    keys = jax.random.split(jax.random.key(0), LANES)
    heights = [js.surfaces.self_affine(grid, key, k_high=4, rms_height=0.1) for key in keys]
    return jnp.stack(heights).astype(dtype)


def cuda_program(function, *arguments):
    """Return the text of the program for CUDA."""
    return jax.export.export(jax.jit(function), platforms=["cuda"])(*arguments).mlir_module()


@pytest.fixture(
    scope="module", params=["alone", pytest.param("together", marks=pytest.mark.nightly)]
)
def program(request):
    heights = surfaces(jnp.float32)
    with beside_an_accelerator():
        if request.param == "alone":
            return cuda_program(solve, heights[0])
        return cuda_program(jax.vmap(solve), heights)


@pytest.mark.nightly
def test_without_throw_a_program_for_cuda_never_calls_the_host(program):
    assert "stablehlo.while" in program
    assert "callback" not in program


def test_a_program_in_single_precision_computes_nothing_in_double(program):
    # Constants and the tolerance, a number for each entry, may wait in double to be converted.
    shapes = set(re.findall(r"tensor<([0-9x]*)f64>", program))
    assert shapes <= {"", f"{LANES}x"}
    assert not re.search(r"f32>\) -> tensor<[0-9x]*f64>", program)
    assert "complex<f64>" not in program


def test_matrices_are_multiplied_with_all_digits(program):
    # By default a GPU takes three in float32.
    products = re.findall("stablehlo.dot_general.*", program)
    assert len(products) > 100
    assert all("precision = [HIGHEST, HIGHEST]" in product for product in products)


def test_cuda_never_decomposes_a_single_small_matrix(program):
    # One alone takes as long as hundreds together.
    found = re.findall(r"@cusolver_syevd_ffi\(.*\) -> \(tensor<([0-9x]*)xf32>", program)
    shapes = [[int(n) for n in shape.split("x")] for shape in found]
    assert shapes
    assert all(np.prod(shape[:-2]) > 1 for shape in shapes)


@pytest.mark.nightly
def test_batch_entries_together_give_what_each_gives_alone():
    heights = surfaces(jnp.float64)
    apart = jax.jit(jax.vmap(solve))(heights)
    with as_on_an_accelerator():
        joint = jax.jit(jax.vmap(solve))(heights)
    np.testing.assert_array_equal(joint["verdict"], apart["verdict"])
    # Both stop at a residual of 1e-9.
    np.testing.assert_allclose(joint["gap"], apart["gap"], atol=1e-8)
    np.testing.assert_allclose(joint["mean_pressure"], apart["mean_pressure"], rtol=1e-8)
    off = abs(joint["eigenvalues"] - apart["eigenvalues"])
    assert (off <= joint["errors"] + apart["errors"]).all()


@pytest.mark.nightly
def test_within_a_step_the_host_waits_for_nothing():
    runs = solver_runs(N)

    def num_waits(name, platform):
        run, depth = runs[name]
        return measured_step(lambda loop, step: sum(map(waits, step)), run, platform, depth)

    # On a CPU the line search is a loop of its own, and the limit of a move a branch.
    assert num_waits("PreconditionedConjugateGradient", "cpu") == 2
    with as_on_an_accelerator():
        found = {name: num_waits(name, "cuda") for name in runs}
    # Newton's method solves a linear system in each step, by a loop of its own. Two projections
    # onto the cone each look once whether the climbs that are written out were enough.
    expected = dict.fromkeys(runs, 0)
    expected |= {"SaddleNewton": 1, "ProjectedLOBPCG": 2, "ProximalIteration": 2}
    assert found == expected and len(found) == 6


@pytest.mark.parametrize("platform", [nullcontext, as_on_an_accelerator])
def test_the_projection_is_the_nearest_admissible_field(platform):
    rng = np.random.default_rng(0)
    masks, fields = rng.random((20, 6, 7)) < rng.random((20, 1, 1)), rng.normal(size=(20, 6, 7))
    with platform():
        project = jax.jit(lambda mask, field: AdmissibleCone(mask).project(field))
        found = [project(mask, field) for mask, field in zip(masks, fields, strict=True)]
    for in_contact, field, projected in zip(masks, fields, map(np.asarray, found), strict=True):
        assert abs(projected.sum()) < 1e-12
        assert projected[in_contact].min(initial=0) >= 0
        # field - projected = s + y, with one s everywhere and y <= 0 only where x touches zero.
        rest = field - projected
        moving = (projected > 0) | ~in_contact
        shift = rest[moving].mean() if moving.any() else rest.max()
        np.testing.assert_allclose(rest[moving], shift, atol=1e-12)
        assert (rest[~moving] <= shift + 1e-12).all()


@pytest.mark.nightly
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_steps_of_an_accelerator_find_a_face_down_to_rounding(precision):
    grid = js.Grid(7, jnp.ones((), precision))
    heights = js.surfaces.sinusoid(grid, 0.05).astype(precision)
    law = js.potentials.Exponential(*jnp.array([0.05, 0.1], precision))
    contact = js.Contact(js.HalfSpace(grid, jnp.ones((), precision)), heights, law)
    load = js.MeanGap(jnp.array(0.1, precision))
    state = js.equilibrate(contact, load)
    tolerance = {"float64": 1e-11, "float32": 1e-5}[precision]
    with as_on_an_accelerator():
        there = js.equilibrate(contact, load)
        stability = js.assess_stability(contact, state, js.solvers.ProjectedLOBPCG(tolerance))
    touching = np.asarray(state.in_contact).ravel()
    assert touching.sum() == 7
    matrix = dense_hessian(contact, state.gap)
    exact = {
        "lower_bound": smallest_on_zero_mean(matrix),
        "cone": smallest_on_cone(matrix, touching),
        "critical": smallest_on_zero_mean(matrix[np.ix_(~touching, ~touching)]),
    }
    tolerance = {"float64": 1e-9, "float32": 1e-5}[precision]
    for name, pair in stability.pairs.items():
        assert abs(pair.eigenvalue - exact[name]) < tolerance, name
    np.testing.assert_allclose(there.gap, state.gap, atol=tolerance)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("law", "load"),
    [
        # All searches start where the energy falls for many steps, and lengths are cut.
        (js.potentials.Exponential(0.05, 0.05), js.MeanPressure(0.02)),
        (js.potentials.LennardJones(0.01, 0.1), js.MeanGap(0.2)),
        (js.potentials.Exponential(0.01, 0.05), js.Spring(0.1, 1.0)),
    ],
    ids=["pressure", "core", "spring"],
)
def test_steps_of_an_accelerator_lead_to_the_same_states_and_eigenvalues(law, load):
    contact = rough_contact(N, law)
    state = js.equilibrate(contact, load)
    stability = js.assess_stability(contact, state)
    with as_on_an_accelerator():
        there = js.equilibrate(contact, load)
        stability_there = js.assess_stability(contact, there)
    np.testing.assert_allclose(there.gap, state.gap, atol=1e-8)
    assert stability_there.verdict == stability.verdict
    for name, pair in stability.pairs.items():
        other = stability_there.pairs[name]
        assert abs(other.eigenvalue - pair.eigenvalue) <= pair.error + other.error, name
    more = stability_there.cone.num_steps - stability.cone.num_steps
    assert abs(more) <= 0.2 * stability.cone.num_steps
