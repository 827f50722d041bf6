"""The eigensolvers on problems whose answers are known from elsewhere."""

from functools import partial
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import dense_hessian, smallest_on_zero_mean, zero_mean_basis
from problems import rough_contact, state_of

import jaxstab as js
from jaxstab.contact.hessian import Hessian, SymmetricOperator
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import eigenpair_of
from jaxstab.stability.lowest_pair import cone_starts, mode_on_cone
from jaxstab.stability.solvers.base import ConeProblem, noise
from jaxstab.stability.solvers.davidson import Span
from jaxstab.stability.solvers.multi_start import is_before


class Dense(SymmetricOperator):
    """A matrix, and the inverse of another one near to it."""

    matrix: jax.Array
    inverse: jax.Array

    def __call__(self, field):
        return self.matrix @ field

    @property
    def bound(self):
        return jnp.linalg.norm(self.matrix, 2)

    @property
    def scale(self):
        return self.bound

    def preconditioner(self, mode, eigenvalue):
        return lambda field: self.inverse @ field


def damage_operator(points, a, bc2):
    """Return the matrix of [a |beta'|^2 + b c^2 (mean beta)^2] / |beta|^2 on (0, 1).

    It is the cone problem of A. A. Leon Baldelli & C. Maurini's bar with damage beta once the
    displacement is eliminated: v' = c (beta - mean beta).
    """
    h = 1 / points
    difference = np.diff(np.eye(points), axis=0) / h
    stiffness = a * difference.T @ difference
    inverse = np.linalg.inv(stiffness + np.pi**2 * a * np.eye(points))
    return Dense(jnp.asarray(stiffness + bc2 * h * np.ones((points, points))), jnp.asarray(inverse))


@jax.jit
def smallest_damage_modes(operator):
    points = len(operator.matrix)
    everywhere = jnp.ones(points, bool)
    random = jax.random.normal(jax.random.key(0), (4, points))
    space = Subspace(everywhere, fixes_mean=False)
    found = js.solvers.Davidson(1e-9).solve(operator, space, random)
    modes = found.vector
    free = eigenpair_of(operator, space, found, modes[0])
    cone = AdmissibleCone(everywhere, fixes_mean=False)
    starts = jnp.concatenate([modes[:2], -modes[:2], random])
    found = js.solvers.ProjectedLOBPCG(1e-9).solve(operator, cone, starts)
    return free, eigenpair_of(operator, cone, found, found.vector)


class Counted(Dense):
    """Such a matrix, which counts how often it and the inverse are applied."""

    applications: ClassVar = []

    def __call__(self, field):
        jax.debug.callback(lambda: self.applications.append("A"))
        return super().__call__(field)

    def preconditioner(self, mode, eigenvalue):
        apply = super().preconditioner(mode, eigenvalue)

        def counted(field):
            jax.debug.callback(lambda: self.applications.append("inverse"))
            return apply(field)

        return counted


@pytest.mark.parametrize(
    ("solver", "domain"),
    [
        (js.solvers.Davidson(1e-9), Subspace),
        (js.solvers.ProjectedLOBPCG(1e-9), AdmissibleCone),
        (js.ProximalIteration(1e-5), AdmissibleCone),
    ],
)
def test_each_application_of_the_operator_is_counted(solver, domain):
    dense = damage_operator(20, 0.01, 4.0)
    operator = Counted(dense.matrix, dense.inverse)
    space = domain(jnp.ones(20, bool), fixes_mean=False)

    @jax.jit
    def number(starts):
        found = solver.solve(operator, space, starts)
        vector = found.vector[0] if domain is Subspace else found.vector
        return eigenpair_of(operator, space, found, vector).num_applications

    Counted.applications.clear()
    found = number(jax.random.normal(jax.random.key(0), (4, 20)))
    jax.effects_barrier()
    assert found == len(Counted.applications)


@pytest.mark.parametrize(("a", "bc2"), [(0.01, 4.0), (0.002, 1.0), (1.0, 2.0), (0.5, 0.1)])
def test_the_cone_problem_with_a_closed_form(a, bc2):
    diffusion = np.pi**2 * a
    localises = diffusion < bc2
    exact = diffusion ** (1 / 3) * bc2 ** (2 / 3) if localises else bc2
    errors = []
    for points in (50, 200):
        free, pair = smallest_damage_modes(damage_operator(points, a, bc2))
        assert free.eigenvalue == pytest.approx(min(bc2, diffusion), rel=0.01)
        errors.append(abs(float(pair.eigenvalue) / exact - 1))
        assert float(pair.mode.min()) >= 0
        assert pair.result == js.RESULTS.successful
    assert errors[-1] < 0.01
    assert errors[0] > 3 * errors[-1] or errors[0] < 1e-9
    support = float(jnp.mean(pair.mode > 0))
    expected = (diffusion / bc2) ** (1 / 3) if localises else 1.0
    assert support == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("seed", range(8))
def test_on_a_line_without_a_fixed_mean_the_cone_costs_nothing(seed):
    """No two points of a line push each other up, so |x| has no larger quotient than x."""
    random = np.random.default_rng(seed)
    grid = js.Grid((64,), (1.0,))
    law = js.potentials.Exponential(10 ** random.uniform(-1, 1), 0.5)
    contact = js.Contact(js.HalfSpace(grid, 1.0), np.zeros(64), law)
    gap = jnp.asarray(random.uniform(0.01, 2.0, 64) * (random.random(64) > random.random()))
    contact, state = state_of(contact, gap, load=js.MeanPressure)
    stability = js.assess_stability(contact, state)
    matrix = dense_hessian(contact, gap)
    assert (matrix - np.diag(np.diag(matrix))).max() <= 1e-12
    exact = np.linalg.eigvalsh(matrix)[0]
    assert stability.lower_bound.eigenvalue == pytest.approx(exact, abs=1e-8)
    assert stability.cone.eigenvalue == pytest.approx(exact, abs=1e-8)


@pytest.mark.parametrize(("space", "count"), [("critical", 1), ("lower_bound", 12)])
def test_the_lowest_modes_equal_those_of_a_dense_eigensolver(unloading, space, count):
    equilibrium = js.equilibrate(unloading, js.MeanGap(0.5))
    pairs = js.lowest_modes(unloading, equilibrium, count, space=space)
    keeps = np.asarray(equilibrium.in_contact).ravel() & (space == "critical")
    matrix = dense_hessian(unloading, equilibrium.gap)[np.ix_(~keeps, ~keeps)]
    basis = zero_mean_basis(len(matrix))
    exact = np.linalg.eigvalsh(basis @ matrix @ basis.T)[:count]
    np.testing.assert_allclose(pairs.eigenvalue, exact, rtol=0, atol=1e-8)
    modes = np.asarray(pairs.mode).reshape(count, -1)
    np.testing.assert_allclose(modes @ modes.T, np.eye(count), atol=1e-5)
    assert np.abs(modes[:, keeps]).max(initial=0) == 0


def test_more_modes_than_the_space_has_are_infinite_and_refused():
    contact = rough_contact(8, js.potentials.Exponential(1.0, 1.0))
    gap = jnp.zeros((8, 8)).at[2:4, 3].set(0.3).at[6, 6].set(0.1)
    state = state_of(contact, gap)
    lowest = partial(js.lowest_modes, count=4, space="critical", throw=False)
    pairs = lowest(*state)
    keeps = np.asarray(gap == 0).ravel()
    exact = smallest_on_zero_mean(dense_hessian(contact, gap)[np.ix_(~keeps, ~keeps)])
    assert pairs.eigenvalue[0] == pytest.approx(exact, rel=1e-9)
    np.testing.assert_array_equal(np.isinf(pairs.eigenvalue), [False, False, True, True])
    for found in (pairs, jax.jit(lowest)(*state)):
        results = ["successful"] * 2 + ["too_many_modes"] * 2
        np.testing.assert_array_equal(found.result.name, results)
        np.testing.assert_array_equal(found.proved, [True, True, False, False])
    message = r"4 lowest modes .* among 2 admissible directions: too_many_modes"
    with pytest.raises(js.exceptions.SolverError, match=message):
        js.lowest_modes(*state, 4, space="critical")
    assert (js.lowest_modes(*state, 2, space="critical").result == "successful").all()


@pytest.mark.parametrize("load, most", [(js.MeanGap, 63), (js.MeanPressure, 64)])
def test_more_modes_than_the_load_allows_are_refused(load, most):
    contact = rough_contact(8, js.potentials.Exponential(1.0, 1.0))
    gap = jnp.zeros((8, 8)).at[2:, :].set(0.3)
    state = state_of(contact, gap, load=load)
    if load is js.MeanGap:
        assert np.isfinite(js.lowest_modes(*state, most).eigenvalue).all()
    message = rf"count is {most + 1}: {most} directions are admissible: ask for fewer\."
    for lowest in (js.lowest_modes, jax.jit(js.lowest_modes, static_argnums=2)):
        with pytest.raises(ValueError, match=message):
            lowest(*state, most + 1)


def test_lowest_modes_refuses_what_makes_no_sense(unloading):
    equilibrium = js.equilibrate(unloading, js.MeanGap(0.5))
    with pytest.raises(ValueError, match="count is 0"):
        js.lowest_modes(unloading, equilibrium, 0)
    with pytest.raises(TypeError, match=r"count is 2\.0: give an integer"):
        js.lowest_modes(unloading, equilibrium, 2.0)
    with pytest.raises(TypeError, match=r"key is \d: give a random key"):
        js.lowest_modes(unloading, equilibrium, 2, key=0)
    with pytest.raises(ValueError, match="space is 'cone'"):
        js.lowest_modes(unloading, equilibrium, 1, space="cone")
    with pytest.raises(js.exceptions.SolverError, match="max_steps_reached"):
        js.lowest_modes(unloading, equilibrium, 1, solver=js.solvers.Davidson(max_steps=2))


@pytest.mark.parametrize("tolerance", [None, 1e20])
def test_no_search_ends_before_its_first_vectors_or_while_its_residual_falls(tolerance):
    # Stiff points, whose residuals begin far above one.
    generator = np.random.default_rng(1)
    curvature = np.where(
        generator.random((16, 16)) < 0.3, 10 ** (7 * generator.random((16, 16))), 1e-2
    )
    solid = js.HalfSpace(js.Grid(16), 1.0)
    space = Subspace(jnp.ones((16, 16), bool))
    starts = noise(jax.random.key(0), 32, jnp.zeros((16, 16)))
    solve = jax.jit(
        lambda: js.solvers.Davidson(tolerance).solve(Hessian(solid, curvature), space, starts, 30)
    )
    found = solve()
    assert found.result == "successful"
    assert np.isnan(found.history.values["residual"][0])
    np.testing.assert_allclose(np.linalg.norm(found.vector.reshape(32, -1), axis=1), 1)


def test_algorithm_1_without_a_fixed_mean_has_no_multiplier_of_it():
    # Under a pressure the mean may move; without contact the least eigenvalue is found.
    contact = rough_contact(8, lambda gap: 3 * gap**2)
    operator = Hessian(contact.solid, jnp.full((8, 8), 6.0).at[2, 3].set(2.0))
    cone = AdmissibleCone(jnp.zeros((8, 8), bool), fixes_mean=False)
    found = js.ProximalIteration().solve(
        operator, cone, jax.random.normal(jax.random.key(0), (1, 8, 8))
    )
    dense = jax.vmap(operator)(jnp.eye(64).reshape(64, 8, 8)).reshape(64, 64)
    lowest = np.linalg.eigvalsh(dense)[0]
    pair = eigenpair_of(operator, cone, found, found.vector)
    assert found.result == js.RESULTS.successful
    assert pair.eigenvalue == pytest.approx(lowest, rel=1e-6)


def test_a_cone_is_searched_from_the_lowest_modes_of_both_signs_and_random_vectors():
    modes, random = np.random.default_rng(0).normal(size=(2, 4, 5, 6))
    cone = AdmissibleCone(jnp.ones((5, 6), bool))
    starts, is_needed, is_answer = cone_starts(
        js.solvers.ProjectedLOBPCG(),
        cone,
        js.RESULTS.successful,
        jnp.asarray(modes),
        jnp.asarray(random),
    )
    np.testing.assert_array_equal(starts, [*modes[:2], *-modes[:2], *random])
    # No mode of both signs lies in the cone.
    assert is_needed.all() and not is_answer


def test_equal_starts_keep_their_order():
    values = np.array([2.0, np.inf, 1.0, 2.0, np.inf, 1.0, 3.0])
    ranks = np.argsort(np.argsort(values, kind="stable"))
    np.testing.assert_array_equal(is_before(jnp.asarray(values)), ranks[:, None] < ranks)


@pytest.mark.parametrize("sign", [1, -1])
def test_where_the_lowest_mode_lies_in_the_cone_it_is_the_answer(sign):
    curvature = jnp.asarray(np.random.default_rng(0).uniform(-3, 1, (4, 4)))
    hessian = Hessian(js.HalfSpace(js.Grid(4), 1.0), curvature)
    dense = jax.vmap(hessian)(jnp.eye(16).reshape(16, 4, 4)).reshape(16, 16)
    values, vectors = np.linalg.eigh(dense)
    modes = sign * vectors.T[:2].reshape(2, 4, 4)
    # The next mode, from which no search would go on, lies in it as well.
    cone = AdmissibleCone(jnp.asarray((sign * modes > 0).all(axis=0)), fixes_mean=False)
    assert cone.one_sided.sum() > 2
    random = jax.random.normal(jax.random.key(0), (2, 4, 4))
    solver = js.solvers.ProjectedLOBPCG()
    problem = ConeProblem.of(hessian, cone)
    found, is_answer = mode_on_cone(
        solver, problem, js.RESULTS.successful, jnp.asarray(modes), random
    )
    assert is_answer
    pair = eigenpair_of(hessian, cone, found, found.vector)
    assert pair.eigenvalue == pytest.approx(values[0], rel=1e-12)
    np.testing.assert_allclose(pair.mode, sign * modes[0], atol=1e-8)


def test_of_a_vector_that_may_be_noise_the_part_apart_from_a_space_is_kept():
    random = np.random.default_rng(0)
    basis = np.linalg.qr(random.normal(size=(20, 5)))[0]
    matrix = jnp.eye(5)
    block = jnp.asarray(basis.T)
    span = Span(block, block, matrix, matrix, matrix)
    vector = random.normal(size=20)
    rest = vector - basis @ (basis.T @ vector)
    for sign in (1, -1):
        np.testing.assert_allclose(span.apart_from(sign * vector), sign * rest, atol=1e-12)
    # Nothing is left of one within the space but rounding.
    np.testing.assert_array_equal(span.apart_from(basis @ random.normal(size=5)), 0)


def test_a_step_of_davidsons_method_is_the_dense_one():
    random = np.random.default_rng(0)
    matrix = random.normal(size=(20, 20))
    matrix += matrix.T
    inverse = np.diag(random.uniform(0.1, 1, 20))
    start = random.normal(size=20)
    basis = start[:, None]
    # The start, and three preconditioned residuals, one after another.
    for _ in range(4):
        axes = np.linalg.qr(basis)[0]
        values, parts = np.linalg.eigh(axes.T @ matrix @ axes)
        lowest = axes @ parts[:, 0]
        residual = matrix @ lowest - values[0] * lowest
        basis = np.column_stack([basis, inverse @ residual])
    operator = Dense(jnp.asarray(matrix), jnp.asarray(inverse))
    space = Subspace(jnp.ones(20, bool), fixes_mean=False)
    found = js.solvers.Davidson(max_steps=2).solve(operator, space, jnp.asarray(start)[None])
    vector = found.vector[0]
    np.testing.assert_allclose(vector * np.sign(vector @ lowest), lowest, atol=1e-10)
    left = np.linalg.norm(residual) / np.linalg.norm(matrix, 2)
    np.testing.assert_allclose(found.history.values["residual"][2], left, rtol=1e-8)


@pytest.mark.parametrize(
    "kind", [js.solvers.PreconditionedConjugateGradient, js.solvers.ProjectedLOBPCG]
)
def test_a_solver_prints_its_numbers(kind):
    shown = repr(kind(tolerance=1e-3, max_steps=7))
    assert shown.startswith(f"{kind.__name__}(tolerance=0.001, max_steps=7")
