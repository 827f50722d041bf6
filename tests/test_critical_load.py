"""The fold of a branch: against dense Newton steps, finite differences, and where there is none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import rough_contact

import jaxstab as js

BRACKET = js.MeanDisplacement(jnp.array([1.31, 1.29]))
PARAMETERS = {"gamma": 10.0, "rho": 1.0, "E": 1.0, "R": 2.0}


def paraboloid(gamma, rho, E, R):
    grid = js.Grid(32)
    heights = js.surfaces.paraboloid(grid, radius=R)
    return js.Contact(js.HalfSpace(grid, E), heights, js.potentials.Exponential(gamma, rho))


@pytest.fixture(scope="module")
def fold(hertz):
    return js.critical_load(hertz, BRACKET)


def dense_fold(heights, gamma, rho, guess):
    """Return mean(u) at the fold without contact, by NumPy and Newton's method on all conditions.

    Of gap g, pressure p0, mode x and multiplier z: K (g + h) + f'(g) + p0 = 0, A x + z = 0,
    sum(x) = 0 and x.x = 1.
    """
    n = len(heights)
    waves = np.fft.fftfreq(n, 1 / n)
    multiplier = np.pi * np.hypot(*np.meshgrid(waves, waves, indexing="ij"))
    identity = np.eye(n * n).reshape(-1, n, n)
    stiffness = np.fft.ifft2(multiplier * np.fft.fft2(identity)).real.reshape(n * n, n * n)
    h, g = heights.ravel(), guess.ravel()
    one = np.ones((n * n, 1))

    def slopes(g):
        attraction = gamma / rho * np.exp(-g / rho)
        return attraction, -attraction / rho, attraction / rho**2

    space = np.linalg.svd(one.T)[2][1:].T
    first, second, third = slopes(g)
    matrix = stiffness + np.diag(second)
    x = space @ np.linalg.eigh(space.T @ matrix @ space)[1][:, 0]
    p0, z = -np.mean(stiffness @ (g + h) + first), -np.mean(matrix @ x)
    for _ in range(20):
        first, second, third = slopes(g)
        matrix = stiffness + np.diag(second)
        residual = np.concatenate(
            [stiffness @ (g + h) + first + p0, matrix @ x + z, [x.sum()], [(x @ x - 1) / 2]]
        )
        zero, column = np.zeros((n * n, n * n)), np.zeros((n * n, 1))
        jacobian = np.block(
            [
                [matrix, one, zero, column],
                [np.diag(third * x), column, matrix, one],
                [column.T, 0, one.T, 0],
                [column.T, 0, x[None], 0],
            ]
        )
        change = np.linalg.solve(jacobian, -residual)
        g, p0 = g + change[: n * n], p0 + change[n * n]
        x, z = x + change[n * n + 1 : -1], z + change[-1]
        if np.abs(change).max() < 1e-13:
            break
    return np.mean(g + h)


def test_the_fold_of_hertz_is_that_of_dense_algebra(hertz, fold):
    guess = js.equilibrate(hertz, js.MeanDisplacement(1.2976)).gap
    exact = dense_fold(np.asarray(hertz.heights), 10.0, 1.0, np.asarray(guess))
    np.testing.assert_allclose(fold.load.value, exact, rtol=1e-8)
    assert fold.load.value == pytest.approx(1.2975, abs=1e-4)
    assert not fold.equilibrium.in_contact.any()
    assert abs(fold.critical.eigenvalue) < 1e-8
    np.testing.assert_allclose(jnp.mean(fold.equilibrium.displacement), exact, rtol=1e-8)


def test_its_derivatives_agree_with_finite_differences():
    @jax.jit
    def load(values):
        return js.critical_load(paraboloid(*values), BRACKET, throw=False).load.value

    values = jnp.array(list(PARAMETERS.values()))
    rates, forward = jax.grad(load)(values), jax.jacfwd(load)(values)
    lanes = jax.vmap(load)(values * jnp.array([[1.0], [1.001]]))
    np.testing.assert_allclose(lanes, [load(values), load(1.001 * values)], rtol=1e-9)
    for i, name in enumerate(PARAMETERS):
        h = 1e-5 * values[i]
        differences = (load(values.at[i].add(h)) - load(values.at[i].add(-h))) / (2 * h)
        assert float(rates[i]) == pytest.approx(float(differences), rel=1e-6), name
        assert float(rates[i]) == pytest.approx(float(forward[i]), rel=1e-9), name


def test_what_happens_at_the_fold_moves_with_it():
    @jax.jit
    def at_fold(radius):
        found = js.critical_load(paraboloid(10.0, 1.0, 1.0, radius), BRACKET, throw=False)
        gap, mode = found.equilibrium.gap, found.critical.mode
        return gap, mode * jnp.sign(mode[16, 16]), found.load.value

    rates = jax.jacfwd(at_fold)(2.0)
    for rate, below, above in zip(rates, at_fold(1.99), at_fold(2.01), strict=True):
        differences = np.asarray(above - below) / 0.02
        assert np.linalg.norm(rate - differences) < 1e-4 * np.linalg.norm(differences)


@pytest.mark.parametrize("ends", [(1.29, 1.31), (1.4, 1.2)])
def test_any_bracket_around_the_fold_will_do(hertz, fold, ends):
    found = js.critical_load(hertz, js.MeanDisplacement(jnp.array(ends)))
    np.testing.assert_allclose(found.load.value, fold.load.value, rtol=1e-8)


def test_the_pull_off_of_a_surface_with_a_core_is_found():
    contact = rough_contact(32, js.potentials.LennardJones(0.05, 0.15))
    found = js.critical_load(contact, js.MeanPressure(jnp.array([0.0, -1.0])))
    pull = found.load.value
    assert pull < 0
    # Where the mean gap is held instead, it is where tension is largest.
    gap = jnp.mean(found.equilibrium.gap)
    near = js.MeanGap(gap * jnp.array([0.99, 1.0, 1.01]))
    held = js.sweep(contact, near, initial=found.equilibrium.gap).equilibrium
    assert (held.result == js.RESULTS.successful).all()
    np.testing.assert_allclose(held.mean_pressure[1], pull, rtol=1e-7)
    assert (held.mean_pressure[::2] > pull).all()


def test_where_a_branch_branches_off_there_is_no_derivative():
    grid = js.Grid((16,))
    (x,) = grid.coordinates

    def load(tilt, throw):
        heights = 0.1 * (jnp.cos(4 * jnp.pi * x) - 1) + tilt * jnp.cos(2 * jnp.pi * x)
        contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.8, 0.3))
        bracket = js.MeanGap(jnp.array([1.5, 0.3]))
        return js.critical_load(contact, bracket, throw=throw).load.value

    with pytest.raises(Exception, match="does not turn back here but branches off"):
        jax.grad(lambda tilt: load(tilt, throw=True))(0.0)
    # A tilt makes a fold of it.
    rate = jax.grad(lambda tilt: load(tilt, throw=False))(1e-3)
    differences = (load(1.0001e-3, throw=False) - load(0.9999e-3, throw=False)) / 2e-7
    np.testing.assert_allclose(rate, differences, rtol=1e-4)


def test_a_failed_lane_leaves_a_masked_sum_alone(hertz):
    brackets = jnp.array([[1.31, 1.29], [jnp.nan, 1.0], [1.4, 1.35]])

    def masked(gamma):
        def find(bracket):
            return js.critical_load(
                paraboloid(gamma, 1.0, 1.0, 2.0), js.MeanDisplacement(bracket), throw=False
            )

        found = jax.vmap(find)(brackets)
        return jnp.sum(jnp.where(found.result == js.RESULTS.successful, found.load.value, 0))

    np.testing.assert_allclose(jax.grad(masked)(10.0), 0.1, rtol=1e-8)


def test_where_no_fold_is_the_user_is_told(hertz):
    bracket = js.MeanDisplacement(jnp.array([1.4, 1.35]))
    found = js.critical_load(hertz, bracket, throw=False)
    assert found.result == js.RESULTS.no_fold
    with pytest.raises(js.SolverError, match=r"No fold found between MeanDisplacement\(1.4\)"):
        js.critical_load(hertz, bracket)

    def load(gamma, throw):
        return js.critical_load(paraboloid(gamma, 1.0, 1.0, 2.0), bracket, throw=throw).load.value

    assert jnp.isnan(jax.grad(lambda gamma: load(gamma, throw=False))(10.0))
    with pytest.raises(ValueError, match="takes two loads"):
        js.critical_load(hertz, js.MeanDisplacement(1.3))
