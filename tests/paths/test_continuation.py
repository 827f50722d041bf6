"""Branches of equilibria, stable or not, around their folds and corners."""

import itertools
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve

import jaxstab as js
from jaxstab.paths.curve import morse_index
from jaxstab.references import maugis

HERTZ = js.Grid(32)


def hertz(dtype=jnp.float64):
    heights = js.surfaces.paraboloid(HERTZ, radius=2.0).astype(dtype)
    solid = js.HalfSpace(HERTZ, youngs_modulus=1.0, poisson_ratio=0.0)
    return js.Contact(solid, heights, js.potentials.Exponential(10.0, 1.0))


def dense_stiffness(grid, modulus):
    """Return K as a matrix, from its symbol and NumPy's transforms."""
    sides = zip(grid.shape, grid.lengths, strict=True)
    q = [2 * np.pi * np.fft.fftfreq(n, 1 / n) / length for n, length in sides]
    symbol = modulus / 2 * np.sqrt(sum(np.square(k) for k in np.meshgrid(*q, indexing="ij")))
    unit = np.eye(grid.size).reshape(grid.size, *grid.shape)
    axes = tuple(range(1, unit.ndim))
    columns = np.fft.ifftn(symbol * np.fft.fftn(unit, axes=axes), axes=axes).real
    return columns.reshape(grid.size, grid.size)


def test_it_goes_on_around_a_fold_and_counts_the_ways_down():
    contact = hertz()
    branch = js.continuation(
        contact, js.MeanDisplacement(jnp.array([1.6, 1.0])), fields=True, max_states=22
    )
    fold = branch.turns[0]
    # Where the contact-free branch ends, by the dense algebra of another test.
    np.testing.assert_allclose(fold.load.value, 1.2974855, atol=1e-7)
    assert fold.kind == "fold"
    assert branch.end == "states"
    stiffness = dense_stiffness(HERTZ, 1.0)
    for gap, index in zip(branch.equilibrium.gap[::5], branch.index[::5], strict=True):
        free = np.asarray(gap).ravel() > 0
        hessian = stiffness + np.diag(-10.0 * np.exp(-np.asarray(gap).ravel()))
        hessian = hessian[np.ix_(free, free)]
        plane = np.linalg.svd(np.ones((1, free.sum())))[2][1:]
        values = np.linalg.eigvalsh(plane @ hessian @ plane.T)
        assert index == np.sum(values < 0)
    assert set(np.asarray(branch.index)) == {0, 1}


def test_an_index_that_is_not_found_is_not_a_number_of_ways(monkeypatch):
    contact = hertz()
    load = js.MeanDisplacement(1.4)
    gap = 1.4 - contact.heights
    found, _ = morse_index.index_of(contact, load, gap, morse_index.some_modes(gap))
    assert found == 0
    branch = js.continuation(contact, js.MeanDisplacement(jnp.array([1.6, 1.4])))
    assert "unknown" not in repr(branch)
    monkeypatch.setattr(morse_index, "_Signs", partial(morse_index._Signs, max_steps=2))
    found, _ = morse_index.index_of(contact, load, gap, morse_index.some_modes(gap))
    assert found == -1
    assert "1 of unknown index, " in repr(replace(branch, index=branch.index.at[2].set(found)))


@pytest.mark.nightly
def test_ways_down_that_the_modes_of_the_state_before_lack_are_counted():
    grid = js.Grid(4)
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=2, rms_height=0.1)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.2, 0.05))
    branch = js.continuation(contact, js.MeanGap(jnp.array([0.6, 0.02])), fields=True)
    stiffness = dense_stiffness(grid, 1.0)
    for gap, index in zip(np.asarray(branch.equilibrium.gap), branch.index, strict=True):
        free = gap.ravel() > 0
        hessian = stiffness + np.diag(-0.2 / 0.05**2 * np.exp(-gap.ravel() / 0.05))
        plane = np.linalg.svd(np.ones((1, free.sum())))[2][1:]
        values = np.linalg.eigvalsh(plane @ hessian[np.ix_(free, free)] @ plane.T)
        assert index == np.sum(values < 0)
    assert max(branch.index) >= 3


LINE = js.Grid((6,), (1.0,))
PROFILE = np.array([0.00, -0.05, -0.12, -0.03, -0.09, -0.16])
STRENGTH, RANGE = 0.06, 0.05


def all_equilibria(mean_gap):
    """Return the gaps of all equilibria at a mean gap: every set of contact points, many starts."""
    stiffness, number = dense_stiffness(LINE, 1.0), LINE.size
    random = np.random.default_rng(0)
    found = []
    for size in range(number):
        for touching in itertools.combinations(range(number), size):
            free = np.setdiff1d(np.arange(number), touching)

            def net(free_gap, pressure, free=free):
                gap = np.zeros(number)
                gap[free] = free_gap
                return (
                    stiffness @ (gap + PROFILE)
                    - (-STRENGTH / RANGE * np.exp(-gap / RANGE))
                    + pressure
                )

            def missed(x, free=free, net=net):
                return np.append(net(x[:-1], x[-1])[free], np.sum(x[:-1]) - number * mean_gap)

            for _ in range(40):
                start = random.uniform(0, 2.5 * mean_gap, len(free))
                x, _, ok, _ = fsolve(missed, np.append(start, 0.0), full_output=True, xtol=1e-12)
                is_one = ok == 1 and np.all(x[:-1] > 0) and np.max(np.abs(missed(x))) < 1e-9
                if is_one and np.all(net(x[:-1], x[-1])[list(touching)] >= 0):
                    gap = np.zeros(number)
                    gap[free] = x[:-1]
                    if not any(np.allclose(gap, other, atol=1e-6) for other in found):
                        found.append(gap)
    return found


@pytest.mark.nightly
def test_what_it_passes_at_a_load_is_among_all_equilibria_there():
    solid = js.HalfSpace(LINE, youngs_modulus=1.0, poisson_ratio=0.0)
    contact = js.Contact(solid, PROFILE, js.potentials.Exponential(STRENGTH, RANGE))
    loads = js.MeanGap(jnp.array([0.6, 0.01]))
    steps = {"max_step": 0.004, "max_states": 4096}
    branch = js.continuation(contact, loads, fields=True, **steps)
    assert branch.end == "load"
    assert np.max(branch.index) == 2
    value, loads = 0.05, np.asarray(branch.load.value)
    exact, solver = all_equilibria(value), js.SaddleNewton()
    number = 0
    passed = np.flatnonzero((loads[1:] - value) * (loads[:-1] - value) < 0)
    assert len(passed) >= 3
    for i in passed:
        near = branch.equilibrium.gap[i + (abs(loads[i + 1] - value) < abs(loads[i] - value))]
        state = js.equilibrate(contact, js.MeanGap(value), solver, initial=near)
        assert min(np.max(np.abs(state.gap - gap)) for gap in exact) < 1e-6
    # Equilibria that it does not pass lie on branches of their own, some of them closed.
    for gap in exact:
        state = js.equilibrate(contact, js.MeanGap(value), solver, initial=gap)
        ends = js.MeanGap(jnp.array([value, 9.0]))
        other = js.continuation(contact, ends, initial=state, max_states=200, throw=False)
        number += other.end == "loop"
    assert number > 3


@pytest.mark.nightly
@pytest.mark.parametrize(("alpha", "number"), [(0.3, 512), (0.5, 2048)])
def test_it_is_johnsons_wave_beyond_its_greatest_pressure(alpha, number):
    height, grid = 0.02, js.Grid((number,), (1.0,))
    work = alpha**2 * np.pi**2 * height**2 / 2
    heights = height * jnp.cos(2 * np.pi * (jnp.arange(number) / number - 0.5))
    solid = js.HalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0)
    contact = js.Contact(solid, heights, js.potentials.Dugdale(work, 0.1 * height))
    start = js.equilibrate(contact, js.MeanGap(0.06 * height))
    # Towards full contact the pressure falls, which no dead load holds.
    pressures = start.mean_pressure + jnp.array([0.0, -0.03]) * np.pi * height
    branch = js.continuation(contact, js.MeanPressure(pressures), initial=start)
    assert branch.end == "load"
    assert np.mean(np.asarray(branch.index) == 1) > 0.7
    theta = np.linspace(0.6, 0.98, 5000) * np.pi / 2
    pressure = np.pi * height * (np.sin(theta) ** 2 - alpha * np.sqrt(np.tan(theta)))
    gap = height * np.cos(theta) ** 2 + 2 * pressure / np.pi * np.log(np.sin(theta))
    expected = np.interp(branch.equilibrium.mean_gap, gap[::-1], pressure[::-1])
    np.testing.assert_allclose(branch.load.value, expected, rtol=2e-2)


@pytest.mark.nightly
def test_a_spheres_unstable_branch_is_that_of_maugis():
    # In units of JKR: contact radius 1, displacement 0.01.
    radius, unit = 100.0, 0.01
    work = 4 / (3 * np.pi * radius**2)
    strength = 0.5 * (np.pi * work * (4 / 3) ** 2 / radius) ** (1 / 3)
    grid = js.Grid((128, 128), (6.0, 6.0))
    solid = js.FreeHalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0)
    law = js.potentials.Dugdale(work, work / strength, 0.07)
    contact = js.Contact(solid, js.surfaces.paraboloid(grid, radius), law)
    branch = js.continuation(contact, js.FarDisplacement(jnp.array([1.3, 0.2]) * unit))
    sphere = radius, 1.0, work, strength
    fold = maugis.pull_off(*sphere, stiffness=np.inf)
    np.testing.assert_allclose(branch.turns[1].load.value, -fold.displacement, rtol=5e-3)
    touch = maugis.first_touch(*sphere)
    curves = [
        maugis.without_contact(np.linspace(1e-3, 1, 500) * touch.outer_radius, *sphere),
        maugis.curve(np.linspace(1e-3, fold.contact_radius, 500), *sphere),
    ]
    displacement, force = (
        np.concatenate([getattr(c, name) for c in curves]) for name in ("displacement", "force")
    )
    index, loads = np.asarray(branch.index), -np.asarray(branch.load.value)
    unstable = np.flatnonzero(index == 1)
    assert np.all(np.diff(unstable) == 1) and set(index) == {0, 1}
    for wanted in np.array([-0.88, -0.9, -0.92, -0.94, -0.96]) * unit:
        nearest = unstable[np.argmin(np.abs(loads[unstable] - wanted))]
        exact = force[np.argmin(np.abs(displacement - loads[nearest]))]
        np.testing.assert_allclose(branch.equilibrium.force[nearest], exact, rtol=2e-2)


@pytest.mark.nightly
@pytest.mark.parametrize("load", [js.MeanPressure, js.Spring])
def test_under_any_load_and_in_single_precision_it_is_the_same_curve(load):
    contact = hertz(jnp.float32)
    start = js.equilibrate(contact, js.MeanDisplacement(1.6))
    pressure = float(start.mean_pressure)
    if load is js.Spring:
        stiff = 20.0
        ends = [1.6 - pressure / stiff, 1.2 - 1.5 * pressure / stiff]
        loads = js.Spring(jnp.array(ends, jnp.float32), stiff)
    else:
        loads = js.MeanPressure(jnp.array([pressure, 1.5 * pressure], jnp.float32))
    branch = js.continuation(contact, loads, initial=start, max_states=12)
    assert branch.equilibrium.mean_pressure.dtype == jnp.float32
    exact = js.continuation(hertz(), js.MeanDisplacement(jnp.array([1.6, 1.2])), max_states=40)
    gap, pressures = exact.equilibrium.mean_gap, exact.equilibrium.mean_pressure
    last = int(np.argmin(gap))
    found = branch.equilibrium.mean_gap
    is_before = np.asarray(found) > float(gap[last]) * 1.01
    assert np.sum(is_before) > 5
    expected = np.interp(found[is_before], gap[:last][::-1], pressures[:last][::-1])
    np.testing.assert_allclose(branch.equilibrium.mean_pressure[is_before], expected, rtol=5e-3)


@pytest.mark.nightly
def test_under_jit_it_is_the_same():
    contact, loads = hertz(), js.MeanDisplacement(jnp.array([1.6, 1.0]))
    alone = js.continuation(contact, loads, max_states=24)
    within = jax.jit(lambda c: js.continuation(c, loads, max_states=24, throw=False))(contact)
    np.testing.assert_allclose(within.load.value, alone.load.value, rtol=1e-8)
    np.testing.assert_array_equal(within.index, alone.index)
    np.testing.assert_allclose(within.turns.load.value[0], alone.turns.load.value[0], rtol=1e-9)


def test_bad_loads_are_refused():
    contact = hertz()
    with pytest.raises(ValueError, match="takes two loads"):
        js.continuation(contact, js.MeanDisplacement(1.6))
    with pytest.raises(ValueError, match="two loads that differ"):
        js.continuation(contact, js.MeanDisplacement(jnp.array([1.6, 1.6])))
    with pytest.raises(ValueError, match="max_states"):
        js.continuation(contact, js.MeanDisplacement(jnp.array([1.6, 1.0])), max_states=1)


@pytest.mark.nightly
def test_it_does_not_come_back_on_its_own_way_where_the_curve_turns_at_a_sharp_corner():
    grid = js.Grid((24,), (1.0,))
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=6, rms_height=0.05)
    solid = js.HalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0)
    contact = js.Contact(solid, heights, js.potentials.Exponential(0.06, 0.05))
    loads = js.MeanGap(jnp.array([0.6, 0.01]))
    branch = js.continuation(contact, loads, max_states=150)
    values = np.asarray(branch.turns.load.value)
    assert len(np.unique(np.round(values, 6))) == len(values) >= 10
    # At the touch where it turns, the curve goes back at less than 30 degrees to where it came.
    assert np.any(np.isclose(values, 0.17619861, atol=1e-7))
