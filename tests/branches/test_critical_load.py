"""The fold of a branch: against dense Newton steps, finite differences, and where there is none."""

from dataclasses import replace
from functools import partial
from importlib import import_module

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness, smallest_on_critical_cone
from dense_curve import DenseCurve, exponential
from problems import bisected
from programs import compilations

import jaxstab as js

ENDS = jnp.array([1.31, 1.29])
# Surface energy and range, Young's modulus, radius.
VALUES = jnp.array([10.0, 1.0, 1.0, 2.0])


@jax.jit
def paraboloid(values):
    energy, length, modulus, radius = values
    grid = js.Grid(32)
    heights = js.surfaces.paraboloid(grid, radius)
    law = js.potentials.Exponential(energy, length)
    return js.Contact(js.HalfSpace(grid, modulus), heights, law)


def find(values, ends=ENDS, throw=False):
    return js.critical_load(paraboloid(values), js.MeanDisplacement(ends), throw=throw)


@pytest.fixture(scope="module")
def fold():
    return find(VALUES, throw=True)


def dense_fold(heights, gamma, rho, guess):
    """Return mean(u) at the fold without contact, by NumPy and Newton's method on all conditions.

    Of gap g, pressure p0, mode x and multiplier z: K (g + h) + f'(g) + p0 = 0, A x + z = 0,
    sum(x) = 0 and x.x = 1.
    """
    n = len(heights)
    stiffness = periodic_stiffness(heights.shape, (1.0, 1.0), 1.0)
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
        if np.abs(change).max() < 1e-9:
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


def at_fold(values):
    found = find(values)
    gap, mode = found.equilibrium.gap, found.critical.mode
    return {"load": found.load.value, "gap": gap, "mode": mode * jnp.sign(mode[16, 16])}


@pytest.mark.parametrize("i", range(4), ids=["energy", "length", "modulus", "radius"])
def test_its_derivatives_agree_with_finite_differences(i):
    step = 1e-5 * VALUES[i]
    change = jnp.zeros(4).at[i].set(1)
    above, below = at_fold(VALUES + step * change), at_fold(VALUES - step * change)
    rates = jax.jvp(at_fold, (VALUES,), (change,))[1]
    for name, rtol in (("load", 1e-6), ("gap", 1e-4), ("mode", 1e-4)):
        differences = np.asarray(above[name] - below[name]) / (2 * step)
        # The mode only changes with the ratio of lengths.
        size = np.linalg.norm(differences) + np.linalg.norm(above[name]) / VALUES[i]
        assert np.linalg.norm(rates[name] - differences) <= rtol * size, name
    reverse = jax.grad(lambda values: find(values).load.value)(VALUES)
    np.testing.assert_allclose(reverse[i], rates["load"], rtol=1e-9)


@pytest.mark.nightly
def test_its_second_derivatives_are_differences_of_first_ones():
    rates = jax.grad(lambda values: find(values).load.value)
    found = jax.grad(lambda values: rates(values)[1])(VALUES)
    step = jnp.array([0.0, 1e-3, 0.0, 0.0])
    differences = (rates(VALUES + step) - rates(VALUES - step)) / 2e-3
    np.testing.assert_allclose(found, differences, rtol=1e-5)


@pytest.mark.nightly
def test_at_the_fold_an_equilibrium_has_no_derivative_and_beside_it_it_has(fold):
    tight = js.solvers.PreconditionedConjugateGradient(tolerance=1e-11)
    contact = paraboloid(VALUES)

    def pressure(value, start, solver=tight):
        load = js.MeanDisplacement(value)
        return js.equilibrate(contact, load, solver, initial=start).mean_pressure

    def pressure_at_fold(value):
        # A solver that stays where it is put.
        return pressure(value, fold.equilibrium.gap, js.solvers.SaddleNewton())

    load = fold.load.value
    assert jnp.isnan(jax.grad(pressure_at_fold)(load))
    near = load + 1e-4
    start = js.equilibrate(contact, js.MeanDisplacement(near), tight).gap
    differences = (pressure(near + 1e-8, start) - pressure(near - 1e-8, start)) / 2e-8
    np.testing.assert_allclose(jax.grad(pressure)(near, start), differences, rtol=1e-5)


@pytest.mark.parametrize(
    "ends", [(1.29, 1.31), pytest.param((1.4, 1.2), marks=pytest.mark.nightly)]
)
def test_any_bracket_around_the_fold_will_do(fold, ends):
    found = find(VALUES, jnp.array(ends), throw=True)
    np.testing.assert_allclose(found.load.value, fold.load.value, rtol=1e-8)


@pytest.mark.nightly
def test_the_first_fold_is_found_where_a_long_step_could_leap_over_it():
    n, energy, length = 32, 1.04, 0.31
    x = np.arange(n) / n
    waves = [(0.176, 3.7), (0.143, 2.2), (0.076, 3.4)]
    heights = -sum(a * np.cos(2 * np.pi * (k + 1) * x + b) for k, (a, b) in enumerate(waves))
    law = js.potentials.Exponential(energy, length)
    contact = js.Contact(js.HalfSpace(js.Grid((n,)), 1.0), jnp.asarray(heights), law)
    found = js.critical_load(contact, js.MeanGap(jnp.array([1.11, 0.1])))

    # The branch without contact, by dense Newton steps at loads on either side of its end.
    stiffness = np.pi * np.abs(np.fft.fftfreq(n, 1 / n))
    stiffness = np.fft.ifft(stiffness * np.fft.fft(np.eye(n)), axis=1).real
    space = np.linalg.svd(np.ones((1, n)))[2][1:].T
    gap, end = 1.11 - heights + heights.mean(), float(found.load.value)
    for mean_gap in [*np.linspace(1.11, 0.76, 36), *np.linspace(0.75, end + 1e-6, 12)]:
        gap += mean_gap - gap.mean()
        for _ in range(30):
            attraction = energy / length * np.exp(-gap / length)
            hessian = space.T @ (stiffness - np.diag(attraction / length)) @ space
            imbalance = space.T @ (stiffness @ (gap + heights) + attraction)
            gap -= space @ np.linalg.solve(hessian, imbalance)
        assert np.abs(imbalance).max() < 1e-9 and gap.min() > 0
        lowest = np.linalg.eigvalsh(hessian)[0]
        assert lowest > 0
    # It goes with the root of the distance, here 1e-6, and is 0.08 at a distance of 8e-5.
    assert lowest < 0.02
    np.testing.assert_allclose(found.equilibrium.gap, gap, atol=1e-2)


def two_waves(tilt):
    """Return a line of two summits, one of them higher by twice the tilt."""
    grid = js.Grid((32,))
    (x,) = grid.coordinates
    heights = 0.1 * (jnp.cos(4 * jnp.pi * x) - 1) + tilt * jnp.cos(2 * jnp.pi * x)
    law = js.potentials.Exponential(jnp.array(0.8), jnp.array(0.3))
    return js.Contact(js.HalfSpace(grid, jnp.array(1.0)), heights, law)


def fold_of_two_waves(tilt, ends, start, throw=False):
    bracket = js.MeanGap(jnp.array(ends))
    return js.critical_load(two_waves(tilt), bracket, initial=start, throw=throw)


@pytest.mark.nightly
def test_where_a_branch_branches_off_there_is_no_derivative():
    def load(tilt):
        start = 1.5 - two_waves(tilt).heights
        return fold_of_two_waves(tilt, (1.5, 0.3), start).load.value

    assert jnp.isnan(jax.grad(load)(0.0))
    # A tilt makes a fold of it.
    rate = jax.grad(load)(1e-3)
    differences = (load(1.0001e-3) - load(0.9999e-3)) / 2e-7
    np.testing.assert_allclose(rate, differences, rtol=1e-4)


@pytest.mark.nightly
def test_a_bifurcation_lies_where_a_dense_eigenvalue_changes_its_sign(hertz):
    limit = js.critical_load(hertz, js.MeanDisplacement(jnp.array([1.1, 1.0])))

    def lowest(value):
        load = js.MeanDisplacement(value)
        state = js.equilibrate(hertz, load, initial=limit.equilibrium)
        return smallest_on_critical_cone(hertz, state)

    assert limit.kind == "bifurcation"
    assert lowest(limit.load.value + 1e-4) > 0 > lowest(limit.load.value - 1e-4)


@pytest.mark.nightly
def test_a_fold_in_contact_is_found_from_a_state_in_contact():
    tilt, ends = 0.05, (0.52, 0.19)
    contact = two_waves(tilt)
    apart, touching = 1.5 - contact.heights, js.equilibrate(contact, js.MeanGap(0.5)).gap
    # From afar it ends where the higher summit jumps into contact,
    far = fold_of_two_waves(tilt, ends, apart, throw=True)
    assert ends[1] < far.load.value < ends[0] and not far.equilibrium.in_contact.any()
    # and from there where the lower one is about to.
    found = fold_of_two_waves(tilt, ends, touching, throw=True)
    equilibrium = found.equilibrium
    touches = equilibrium.in_contact
    assert ends[1] < found.load.value < far.load.value
    assert touches.any() and not touches[8:24].any()
    assert equilibrium.contact_area == touches.mean()
    # It balances, presses what touches, and its Hessian is singular on the free points.
    net = contact.gradient(equilibrium.gap) + equilibrium.mean_pressure
    np.testing.assert_allclose(net, equilibrium.reaction, atol=1e-8)
    assert (equilibrium.reaction[touches] > 1e-3).all()
    assert abs(smallest_on_critical_cone(contact, equilibrium)) < 1e-8

    def load(tilt):
        return fold_of_two_waves(tilt, ends, touching).load.value

    differences = (load(tilt + 1e-6) - load(tilt - 1e-6)) / 2e-6
    np.testing.assert_allclose(jax.grad(load)(tilt), differences, rtol=1e-5)


@pytest.mark.nightly
def test_entries_of_a_batch_are_those_alone_and_a_failed_one_harms_no_other(fold):
    ends = jnp.array([ENDS, ENDS, [jnp.nan, 1.0], [1.4, 1.35]])
    near = 1.001 * VALUES

    def masked(values):
        found = jax.vmap(find)(jnp.stack([values, near, values, values]), ends)
        is_found = found.result == js.RESULTS.successful
        return jnp.sum(jnp.where(is_found, found.load.value, 0)), found.load.value

    differentiated = jax.value_and_grad(masked, has_aux=True)
    (_, loads), rates = differentiated(VALUES)
    np.testing.assert_allclose(loads[:2], [fold.load.value, find(near).load.value], rtol=1e-9)
    alone = jax.grad(lambda values: find(values).load.value)(VALUES)
    np.testing.assert_allclose(rates, alone, rtol=1e-8)
    np.testing.assert_allclose(rates[0], 0.1, rtol=1e-8)
    # Lanes are compiled once, also outside of jit.
    with compilations() as compiled:
        differentiated(near)
    assert compiled == []


@pytest.mark.nightly
def test_equilibria_and_modes_are_found_by_one_program_each():
    # A grid of a shape that no other test has, so that nothing is compiled before.
    heights = 0.01 * jnp.cos(2 * jnp.pi * jnp.arange(11) / 11)[:, None] * jnp.ones(9)
    contact = js.Contact(
        js.HalfSpace(js.Grid((11, 9)), 1.0), heights, js.potentials.Exponential(0.01, 0.1)
    )
    js.equilibrate(contact, js.MeanPressure(0.0))
    with compilations() as compiled:
        js.critical_load(contact, js.MeanPressure(jnp.array([0.0, -0.2])))
    # The start shares its program with `equilibrate`, the mode of the end with the Morse index.
    names = ("_found", "_lowest_modes", "_newton")
    assert [compiled.count(f"jit({name})") for name in names] == [0, 1, 1]


def test_where_no_fold_is_the_user_is_told():
    ends = jnp.array([1.4, 1.35])
    found = find(VALUES, ends)
    assert found.result == js.RESULTS.no_fold
    assert jnp.isnan(found.equilibrium.contact_area)
    with pytest.raises(
        js.exceptions.SolverError, match=r"No end of a branch found between Mean.*\(1.4\)"
    ):
        find(VALUES, ends, throw=True)
    assert jnp.isnan(jax.grad(lambda values: find(values, ends).load.value)(VALUES)).all()
    with pytest.raises(ValueError, match="takes two loads"):
        find(VALUES, 1.3)


def sticky_line(unit=1.0):
    x = 2 * np.pi * np.arange(16) / 16
    heights = -0.05 * (1 + np.cos(x + 0.2) + 0.3 * np.cos(2 * x))
    law = js.potentials.Exponential(0.05 * unit, 0.05 * unit)
    return js.Contact(js.HalfSpace(js.Grid((16,), (unit,)), 1.0), heights * unit, law)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
@pytest.mark.parametrize("unit", [1.0, 1e-9])
def test_in_any_unit_a_release_lies_where_the_dense_curve_turns(unit):
    contact = sticky_line(unit)
    ends = jnp.array([0.1, 0.25]) * unit
    found = js.critical_load(contact, js.MeanGap(ends))
    stiffness = periodic_stiffness((16,), (1.0,), 1.0)
    heights = np.asarray(contact.heights) / unit
    curve = DenseCurve(stiffness, heights, *exponential(0.05, 0.05), (1, 0, 0))
    start = js.equilibrate(contact, js.MeanGap(ends[0]))
    gap = np.asarray(start.gap) / unit
    curve.follow(gap, float(start.mean_pressure), 0.25, 1e-3, max_events=1)
    ((kind, value),) = curve.events
    assert found.kind.name == kind == "release"
    np.testing.assert_allclose(found.load.value / unit, value, rtol=1e-8)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_a_release_is_uncertain_while_a_reaction_is_left(monkeypatch):
    module = import_module("jaxstab.branches.limit")
    judge = module.limit_between
    judged = []

    def kept(*inputs):
        judged.append(inputs)
        return judge(*inputs)

    monkeypatch.setattr(module, "limit_between", kept)
    assert js.critical_load(sticky_line(), js.MeanGap(jnp.array([0.1, 0.25]))).kind == "release"
    *before, seen, pair = judged[-1]
    # With no free points the pressures balance at any mean pressure.
    closed = replace(seen, is_free=jnp.zeros(16, bool))
    assert judge(*before, closed, pair).kind == "release"
    pressed = replace(closed, at=replace(seen.at, pressure=seen.at.pressure + 1e-3))
    assert judge(*before, pressed, pair).kind == "uncertain"


def is_left(contact, before, after):
    """Return whether the branch from an end is given up where another state is found beyond."""
    module = import_module("jaxstab.branches.critical_load")
    loads = before.load.at(jnp.stack([before.load.value, after.load.value]))
    search = module.search_from(contact, loads, before.gap)
    end = replace(search.limit, load=loads[0], gap=before.gap, result=js.RESULTS.successful)
    search = replace(search, limit=end, number=search.number + 1)
    result, is_left = module.leaves_branch(contact, search, after)
    assert result == "successful"
    return bool(is_left)


def test_energy_is_lost_in_a_jump_and_not_along_a_branch():
    contact = two_waves(0.05)
    one, other = (js.equilibrate(contact, js.MeanGap(value)) for value in (0.55, 0.552))
    # The work between them exceeds the loss that counts; its error, from one end, does not.
    assert not is_left(contact, one, other) and not is_left(contact, other, one)
    load = js.MeanGap(0.53)
    apart = js.equilibrate(contact, load, initial=1.5 - contact.heights)
    touching = js.equilibrate(contact, load, initial=js.equilibrate(contact, js.MeanGap(0.5)))
    assert touching.in_contact.any() and touching.energy > apart.energy
    assert is_left(contact, touching, apart) and not is_left(contact, apart, touching)


@pytest.mark.nightly
def test_a_long_step_to_another_branch_ends_no_search(hertz):
    # It leads to a state without twelve of the contact points, where two eigenvalues are negative.
    heights = hertz.heights + 1e-3 * jax.random.normal(jax.random.key(0), hertz.heights.shape)
    contact = js.Contact(hertz.solid, heights, js.potentials.Exponential(10.001, 1.0))
    found = js.critical_load(contact, js.MeanDisplacement(jnp.array([1.2, 1.6])))
    assert found.kind == "release"
    value = bisected(contact, js.MeanDisplacement, 1.2, 0.01, lambda state: state.in_contact.any())
    np.testing.assert_allclose(found.load.value, value, atol=1e-7)


# Of a pull-off the same is tested daily.
@pytest.mark.nightly
def test_a_branch_that_a_contact_point_ends_is_found_with_its_derivative(hertz):
    # Points that are mirror images of each other would let go at once.
    heights = hertz.heights + 1e-3 * jax.random.normal(jax.random.key(0), hertz.heights.shape)
    bracket = js.MeanDisplacement(jnp.array([1.2, 1.6]))

    @jax.jit
    @partial(jax.value_and_grad, has_aux=True)
    def release(energy):
        law = js.potentials.Exponential(energy, 1.0)
        found = js.critical_load(js.Contact(hertz.solid, heights, law), bracket)
        return found.load.value, found

    (_, found), rate = release(10.0)
    assert found.kind == "release" and found.after is None
    assert found.equilibrium.in_contact.any()
    contact = js.Contact(hertz.solid, heights, hertz.potential)
    value = bisected(contact, js.MeanDisplacement, 1.2, 0.01, lambda state: state.in_contact.any())
    np.testing.assert_allclose(found.load.value, value, atol=1e-7)
    reaction = jnp.where(found.equilibrium.in_contact, found.equilibrium.reaction, jnp.inf)
    assert jnp.abs(reaction).min() < 1e-8 < jnp.sort(reaction.ravel())[1]
    assert found.critical.eigenvalue < -1e-3
    ends = [release(10.0 + sign * 1e-3)[0][0] for sign in (1, -1)]
    np.testing.assert_allclose(rate, (ends[0] - ends[1]) / 2e-3, rtol=1e-6)


# The solver has not left the release; other releases before it lose little.
@pytest.mark.nightly
@pytest.mark.parametrize(
    ("shape", "key", "k_high", "law", "rtol"),
    [((16, 16), 9, 4, (0.069, 0.04), 1e-4), ((32,), 18, 8, (0.043, 0.055), 1e-5)],
)
def test_in_single_precision_the_release_is_that_of_double(shape, key, k_high, law, rtol):
    key = jax.random.key(key)
    heights = js.surfaces.self_affine(js.Grid(shape), key, k_high=k_high, rms_height=0.05)

    def end(dtype):
        solid = js.HalfSpace(js.Grid(shape, jnp.ones(len(shape), dtype)), jnp.ones((), dtype))
        potential = js.potentials.Exponential(*jnp.array(law, dtype))
        contact = js.Contact(solid, heights.astype(dtype), potential)
        return js.critical_load(contact, js.MeanGap(jnp.array([0.02, 0.35], dtype)))

    single, double = end("float32"), end("float64")
    assert single.kind == double.kind == "release"
    np.testing.assert_allclose(single.load.value, double.load.value, rtol=rtol)
    np.testing.assert_allclose(single.critical.eigenvalue, double.critical.eigenvalue, rtol=1e-3)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [0, 3, 12])
def test_in_single_precision_a_branch_ends_where_it_does_in_double(seed, hertz):
    noise = 1e-3 * jax.random.normal(jax.random.key(seed), hertz.heights.shape)

    def end(dtype):
        grid = js.Grid(32, jnp.ones((), dtype))
        law = js.potentials.Exponential(jnp.array(10, dtype), jnp.array(1, dtype))
        heights = (hertz.heights + noise).astype(dtype)
        contact = js.Contact(js.HalfSpace(grid, jnp.ones((), dtype)), heights, law)
        bracket = js.MeanDisplacement(jnp.array([1.2, 1.6], dtype))
        return js.critical_load(contact, bracket, throw=False)

    single, double = end("float32"), end("float64")
    assert single.kind == double.kind == "release"
    np.testing.assert_allclose(single.load.value, double.load.value, rtol=1e-6)
    # Of two points that let go at once it may take the one that ends no branch, and says so.
    is_negative = single.critical.eigenvalue + single.critical.error < 0
    off = abs(single.critical.eigenvalue - double.critical.eigenvalue)
    assert single.critical.sign == 0 or (is_negative and off < single.critical.error)
