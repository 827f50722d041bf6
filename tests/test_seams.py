"""A solid, loads and solvers of one's own, through every call that takes ours."""

from collections.abc import Callable
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import smallest_on_zero_mean
from descent import Descent
from jaxtyping import Array
from problems import TIGHT, DenseSolid, rough_contact

import jaxstab as js


class Undeclared(js.loads.Load):
    value: Annotated[Array, js.Dimension("length")] = eqx.field(converter=jnp.asarray)
    bulk_modulus: Array = eqx.field(converter=jnp.asarray)

    def control(self, solid, heights):
        raise NotImplementedError


class Sealed(Undeclared):
    bulk_modulus: Annotated[Array, js.Dimension("pressure")] = eqx.field(converter=jnp.asarray)


class Changed(DenseSolid):
    """A solid whose pressure is changed by a function."""

    change: Callable[[Array], Array] = eqx.field(static=True)

    def apply(self, displacement):
        return self.change(super().apply(displacement))


SHAPE = (4, 5)
SIZE = 20
FAR = 0.7


def matrix_of(modulus):
    """Return a stiffness that no Fourier multiplier has; FAR times the modulus on constants."""
    random = np.random.default_rng(0)
    basis = np.linalg.qr(np.column_stack([np.ones(SIZE), random.normal(size=(SIZE, SIZE - 1))]))[0]
    stiffnesses = np.array([FAR, *np.linspace(1, 9, SIZE - 1)])
    return modulus * ((basis * stiffnesses) @ basis.T)


def dense_contact(modulus=1.0, energy=0.1):
    solid = DenseSolid(
        js.Grid(SHAPE), jnp.asarray(matrix_of(1.0)) * modulus, 9.0 * modulus, 1.0 * modulus
    )
    heights = 0.3 * jnp.asarray(np.random.default_rng(1).normal(size=SHAPE))
    return js.Contact(solid, heights, js.potentials.Exponential(energy, 0.4))


LOADS = {
    "gap": js.MeanGap(0.2),
    "pressure": js.MeanPressure(0.1),
    "far": js.FarDisplacement(0.1),
    "spring": js.Spring(0.0, 0.5),
}


@pytest.mark.parametrize(
    "name",
    [
        "gap",
        pytest.param("pressure", marks=pytest.mark.nightly),
        pytest.param("far", marks=pytest.mark.nightly),
        pytest.param("spring", marks=pytest.mark.nightly),
    ],
)
def test_a_solid_of_ones_own_agrees_with_dense_algebra(name):
    contact, load = dense_contact(), LOADS[name]
    equilibrium = js.equilibrate(contact, load, TIGHT)
    u, g, mu = (
        np.asarray(field).ravel()
        for field in (equilibrium.displacement, equilibrium.gap, equilibrium.reaction)
    )
    touching = g == 0
    assert 0 < touching.sum() < SIZE
    assert (mu >= -1e-12).all() and not mu[~touching].any()
    # The far side moves until the mean pressure is the load's.
    p0 = float(equilibrium.mean_pressure)
    attraction = 0.1 / 0.4 * np.exp(-g / 0.4)
    residual = matrix_of(1.0) @ (u - u.mean()) + p0 + attraction - mu
    np.testing.assert_allclose(residual, 0, atol=1e-10)
    held = {
        "gap": g.mean() - 0.2,
        "pressure": p0 - 0.1,
        "far": p0 - FAR * (u.mean() - 0.1),
        # The spring and the solid's far side in series.
        "spring": p0 * (1 / FAR + 1 / 0.5) - u.mean(),
    }
    np.testing.assert_allclose(held[name], 0, atol=1e-10)

    stiffness = {"gap": 0, "pressure": 0, "far": FAR, "spring": 1 / (1 / FAR + 1 / 0.5)}[name]
    matrix = matrix_of(1.0) + (stiffness - FAR) / SIZE - np.diag(attraction / 0.4)
    free = ~touching
    smallest = smallest_on_zero_mean if name == "gap" else lambda m: np.linalg.eigvalsh(m)[0]
    stability = js.assess_stability(contact, equilibrium)
    found = stability.lower_bound.eigenvalue, stability.critical.eigenvalue
    exact = smallest(matrix), smallest(matrix[np.ix_(free, free)])
    np.testing.assert_allclose(found, exact, atol=1e-8)
    assert found[0] - 1e-12 <= stability.cone.eigenvalue <= found[1] + 1e-12


def unit(cone, vector):
    vector = cone.project(vector)
    return vector / jnp.linalg.norm(vector)


def descended(operator, x):
    product = operator(x)
    return x - (product - jnp.sum(x * product) * x) / operator.bound


class PowerIteration(js.solvers.ConeSolver):
    """Steps down the Rayleigh quotient and back onto the cone, from the last start."""

    tolerance: Array = 1e-6
    max_steps: Array = 20_000
    patience = 5_000

    def init(self, problem, start):
        return unit(problem.domain, jnp.abs(start[-1]))

    def step(self, problem, state):
        return unit(problem.domain, descended(problem.operator, state))

    def measure(self, problem, state):
        operator = problem.operator
        moved = jnp.linalg.norm(state - problem.domain.project(descended(operator, state)))
        return {"residual": moved * operator.bound / operator.scale}

    def minimum(self, problem, found):
        vector, steps = descended(problem.operator, found.state), found.num_steps
        return js.solvers.Minimum(vector, steps, 2 * steps, found.result, found.history)


class NotANumber(PowerIteration):
    def minimum(self, problem, found):
        return js.solvers.Minimum(jnp.nan * found.state, 1, 1, found.result, found.history)


@pytest.fixture(scope="module")
def contact():
    return rough_contact(16, js.potentials.Exponential(0.01, 0.1))


@pytest.mark.nightly
def test_a_solver_of_ones_own_finds_equilibria_in_every_call(contact):
    load, solver = js.MeanGap(0.08), Descent()
    expected = js.equilibrate(contact, load)
    found = js.equilibrate(contact, load, solver)
    assert found.num_steps > 2 * expected.num_steps
    np.testing.assert_allclose(found.gap, expected.gap, atol=1e-6)
    swept = js.sweep(contact, js.MeanGap(jnp.array([0.08, 0.1])), equilibrium_solver=solver)
    assert (swept[0].equilibrium.gap == found.gap).all()
    mode = js.assess_stability(contact, found).critical.mode
    released = js.relax_along(contact, found, mode, solver=solver)
    np.testing.assert_allclose(released.gap, expected.gap, atol=1e-6)
    batch = jax.vmap(lambda value: js.equilibrate(contact, js.MeanGap(value), solver, throw=False))
    together = batch(jnp.array([0.08, 0.1])).gap
    np.testing.assert_allclose(together, swept.equilibrium.gap, rtol=1e-12, atol=1e-15)
    short = js.equilibrate(contact, load, Descent(max_steps=3), throw=False)
    assert short.result == js.RESULTS.max_steps_reached

    def pressure(value, solver):
        return js.equilibrate(contact, js.MeanGap(value), solver, throw=False).mean_pressure

    slopes = [jax.grad(pressure)(0.08, method) for method in (solver, None)]
    np.testing.assert_allclose(*slopes, rtol=1e-4)


@pytest.mark.nightly
def test_a_solver_of_ones_own_finds_the_cones_eigenvalue_in_every_call(contact):
    load, solver = js.MeanGap(0.08), PowerIteration()
    state = js.equilibrate(contact, load)
    assert state.in_contact.any()
    expected = js.assess_stability(contact, state).cone
    found = js.assess_stability(contact, state, solver).cone
    assert found.num_steps > expected.num_steps
    np.testing.assert_allclose(found.eigenvalue, expected.eigenvalue, rtol=1e-5)
    swept = js.sweep(contact, js.MeanGap(jnp.array([0.08, 0.1])), stability_solver=solver)
    assert swept[0].stability.cone.eigenvalue == found.eigenvalue
    failed = js.assess_stability(contact, state, PowerIteration(max_steps=1), throw=False)
    assert failed.cone.result == js.RESULTS.max_steps_reached
    assert failed.verdict == "undecided"
    with pytest.raises(js.exceptions.SolverError, match="nonfinite"):
        js.assess_stability(contact, state, NotANumber(tolerance=1e9))


@pytest.mark.parametrize("change", [lambda pressure: pressure[0], lambda p: p.astype("float32")])
def test_a_pressure_of_another_shape_or_precision_is_refused(change):
    solid = Changed(js.Grid(SHAPE), jnp.asarray(matrix_of(1.0)), 9.0, 1.0, change)
    contact = js.Contact(solid, jnp.zeros(SHAPE), js.potentials.Exponential(0.1, 0.4))
    with pytest.raises(TypeError, match=r"`apply` of Changed maps f64\[4,5\] to f(64\[5|32)"):
        js.equilibrate(contact, js.MeanGap(0.2))


def test_numbers_of_a_load_without_a_dimension_or_of_differing_shapes_are_refused(contact):
    with pytest.raises(TypeError, match=r"bulk_modulus of Undeclared has no dimension"):
        js.equilibrate(contact, Undeclared(0.1, 2.0))
    with pytest.raises(ValueError, match=r"bulk_modulus=2\), its value of shape \(2,\)"):
        js.sweep(contact, Sealed([0.1, 0.2], 2.0))


def test_what_is_no_solver_of_the_kind_is_refused_by_name(contact):
    load = js.MeanGap(0.1)
    state = js.equilibrate(contact, load)
    of_state = r"solver is Equilibrium: give an instance of EquilibriumSolver, as Prec"
    with pytest.raises(TypeError, match=of_state):
        js.equilibrate(contact, load, state)
    with pytest.raises(TypeError, match=r"solver is PolonskyKeerRey: give an instance"):
        js.equilibrate(contact, load, js.solvers.PolonskyKeerRey)
    with pytest.raises(TypeError, match=r"is Davidson: .*ConeSolver, as ProjectedLOBPCG"):
        js.assess_stability(contact, state, js.solvers.Davidson())
    with pytest.raises(TypeError, match=r"is ProjectedLOBPCG: .*SpaceSolver, as Davidson"):
        js.lowest_modes(contact, state, 2, solver=js.solvers.ProjectedLOBPCG())
    with pytest.raises(TypeError, match=r"key is \d: give a random key"):
        js.assess_stability(contact, state, key=1)
