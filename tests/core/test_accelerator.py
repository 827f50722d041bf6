"""Programs for accelerators and their numbers, without an accelerator."""

import re

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest
from programs import beside_an_accelerator

import jaxstab as js
from jaxstab.core import batching

N, LANES = 16, 3


def solve(heights, throw=False):
    """Return a state and its stability, as arrays of the precision of the heights."""
    dtype = heights.dtype
    solid = js.HalfSpace(js.Grid(N, jnp.ones((), dtype)), jnp.ones((), dtype))
    law = js.potentials.Exponential(jnp.array(0.01, dtype), jnp.array(0.1, dtype))
    contact = js.Contact(solid, heights, law)
    equilibrium = js.equilibrate(contact, js.MeanGap(jnp.array(0.1, dtype)), throw=throw)
    if throw:
        return equilibrium.gap
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


def test_what_throws_calls_the_host():
    raising = jax.jit(lambda heights: solve(heights, throw=True))
    assert "callback" in raising.lower(surfaces(jnp.float32)[0]).as_text()


def test_a_program_in_single_precision_computes_nothing_in_double(program):
    # Constants and the tolerance, a number for each lane, may wait in double to be converted.
    shapes = set(re.findall(r"tensor<([0-9x]*)f64>", program))
    assert shapes <= {"", f"{LANES}x"}
    assert not re.search(r"f32>\) -> tensor<[0-9x]*f64>", program)
    assert "complex<f64>" not in program


def test_cuda_never_decomposes_a_single_small_matrix(program):
    # One alone takes as long as hundreds together.
    found = re.findall(r"@cusolver_syevd_ffi\(.*\) -> \(tensor<([0-9x]*)xf32>", program)
    shapes = [[int(n) for n in shape.split("x")] for shape in found]
    assert shapes
    assert all(np.prod(shape[:-2]) > 1 for shape in shapes)


@pytest.mark.nightly
def test_lanes_together_give_what_each_gives_alone(monkeypatch):
    heights = surfaces(jnp.float64)
    apart = jax.jit(jax.vmap(solve))(heights)
    jax.clear_caches()
    mapped = []

    def run_elsewhere(on_cpu, elsewhere, *args):
        mapped.append(args)
        return elsewhere(*args)

    monkeypatch.setattr(batching, "on_platform", run_elsewhere)
    joint = jax.jit(jax.vmap(solve))(heights)
    # Or the next test gets this one's programs.
    jax.clear_caches()
    assert mapped
    np.testing.assert_array_equal(joint["verdict"], apart["verdict"])
    # Both stop at a residual of 1e-9.
    np.testing.assert_allclose(joint["gap"], apart["gap"], atol=1e-8)
    np.testing.assert_allclose(joint["mean_pressure"], apart["mean_pressure"], rtol=1e-8)
    off = abs(joint["eigenvalues"] - apart["eigenvalues"])
    assert (off <= joint["errors"] + apart["errors"]).all()
