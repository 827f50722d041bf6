"""Paths of surfaces that yield: the balance of their work, and the surface that is left."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness

import jaxstab as js

GRID = js.Grid((12,), (1.0,))
X = np.asarray(GRID.coordinates[0])
HEIGHTS = -0.2 * (X - 0.5) ** 2


def contact_of(hardness=0.08):
    law = js.potentials.NoAdhesion()
    return js.Contact(js.HalfSpace(GRID, 1.0), HEIGHTS, law, hardness=hardness)


def adhesive_contact():
    law = js.potentials.Exponential(0.006, 0.03)
    return js.Contact(js.HalfSpace(GRID, 1.0), 5 * HEIGHTS, law, hardness=0.25)


def rough(path_of=js.follow, **options):
    """Follow a path without locating its smallest jumps, which it does not have."""
    return path_of(smallest_jump=1e-4, disturbance=0.0, **options)


@pytest.fixture(scope="module")
def loop():
    turns = js.MeanDisplacement(jnp.array([0.01, -0.02, 0.01, -0.02]))
    return rough(contact=contact_of(), load=turns, fields=True)


def test_a_second_loop_yields_nothing_more_and_retraces_the_first(loop):
    states = loop.equilibrium
    turns = np.flatnonzero(np.diff(np.sign(np.diff(loop.load.value))) != 0) + 1
    first, back = turns
    plastic = np.asarray(states.plastic_work)
    assert plastic[first] > 0
    np.testing.assert_allclose(plastic[first:], plastic[first], rtol=1e-9)
    np.testing.assert_allclose(states.mean_pressure[-1], states.mean_pressure[first], rtol=1e-9)
    np.testing.assert_allclose(states.gap[-1], states.gap[first], atol=1e-9)
    # The surface that is left lies lower: it carries less at the same displacement.
    on, off = (slice(None, first + 1), slice(first, back + 1))
    loads = np.asarray(loop.load.value)
    loading = np.interp(0.015, -loads[on], states.mean_pressure[on])
    unloading = np.interp(-0.015, loads[off], states.mean_pressure[off])
    assert unloading < loading


def test_the_indentation_never_falls_and_the_surface_left_is_the_one_before_less_it(loop):
    depth = np.asarray(loop.equilibrium.indentation)
    assert (np.diff(depth, axis=0) >= 0).all()
    np.testing.assert_array_equal(loop[-1].indentation, depth[-1])
    np.testing.assert_array_equal(loop[3].indentation, depth[3])
    np.testing.assert_allclose(loop.contact.heights, HEIGHTS - depth[-1], atol=1e-15)
    np.testing.assert_allclose(
        loop.plastic_work, 0.08 * depth[-1].mean() - 0.08 * depth[0].mean(), rtol=1e-9
    )


def test_the_work_is_the_energy_and_the_plastic_work(loop):
    states = loop.equilibrium
    assert len(loop.jumps) == 0
    # By quadrature of the pressures, which the energies do not know of.
    increments = np.diff(loop.load.value)
    pressures = np.asarray(states.mean_pressure)
    work = -(increments * (pressures[1:] + pressures[:-1]) / 2).sum()
    np.testing.assert_allclose(loop.work, work, rtol=2e-3)
    np.testing.assert_allclose(
        loop.work, states.energy[-1] - states.energy[0] + loop.plastic_work, rtol=1e-9
    )
    assert "plastic work" in repr(loop)


def test_a_path_goes_on_over_the_surface_that_is_left(loop):
    on = rough(
        contact=loop.contact,
        load=js.MeanDisplacement(jnp.array([-0.02, -0.024])),
        initial=loop[-1],
    )
    whole = rough(
        contact=contact_of(), load=js.MeanDisplacement(jnp.array([0.01, -0.024])), fields=True
    )
    np.testing.assert_allclose(on.contact.heights, whole.contact.heights, atol=2e-4)
    assert on.plastic_work > 0
    # A mean gap counts from the surface with which the path begins.
    shift = HEIGHTS.mean()
    gaps = js.MeanGap(jnp.array([0.01, -0.02]) - shift)
    same = rough(contact=contact_of(), load=gaps)
    np.testing.assert_allclose(same.equilibrium.mean_pressure[-1], whole_pressure(loop), rtol=1e-4)


def whole_pressure(path):
    lowest = np.argmin(path.load.value)
    return path.equilibrium.mean_pressure[lowest]


def test_a_state_of_a_path_is_one_of_the_surface_that_it_leaves(loop):
    contact = contact_of()
    first = int(np.argmin(loop.load.value))
    left = contact.after(loop[first])
    state = js.equilibrate(left, js.MeanDisplacement(-0.02), initial=loop[first])
    assert state.indentation.max() < 1e-9
    np.testing.assert_allclose(state.mean_pressure, loop.equilibrium.mean_pressure[first])
    stability = js.assess_stability(left, state)
    assert stability.verdict == "stable"


@pytest.mark.nightly
def test_adhesion_makes_jumps_whose_plastic_work_is_told_apart():
    contact = adhesive_contact()
    turns = js.MeanPressure(jnp.array([0.0, 0.1, -0.15]))
    path = rough(contact=contact, load=turns)
    assert len(path.jumps) == 2
    # The last pulls the surfaces off.
    assert np.isnan(path.jumps.dissipation[1])
    assert path.jumps.dissipation[0] > 0
    assert path.plastic_work > 0
    np.testing.assert_allclose(path.jumps.plastic_work, 0, atol=1e-12)
    states = path.equilibrium
    number = int(path.jumps[1].state)
    # A dead load works by the mean displacement.
    pressures = np.asarray(states.mean_pressure)[: number + 1]
    depth = np.asarray(states.plastic_work)[: number + 1] / 0.25
    heights = np.asarray(states.mean_gap)[: number + 1] - depth
    work = -(np.diff(heights) * (pressures[1:] + pressures[:-1]) / 2).sum()
    np.testing.assert_allclose(states.work[number], work, rtol=1e-2)
    for jump in path.jumps:
        stability = js.assess_stability(contact, jump.before)
        assert stability.verdict.name in ("stable", "held_by_contact", "undecided")
    elastic = rough(contact=contact.elastic, load=turns)
    # A flattened surface holds more.
    assert path.jumps[-1].load.value < elastic.jumps[-1].load.value


def test_files_keep_the_indentation(loop, tmp_path):
    js.save(tmp_path / "path.nc", contact_of(), loop)
    contact, again = js.load(tmp_path / "path.nc", potential=js.potentials.NoAdhesion())
    np.testing.assert_array_equal(contact.hardness, 0.08)
    np.testing.assert_array_equal(again.equilibrium.indentation, loop.equilibrium.indentation)
    np.testing.assert_array_equal(again.contact.heights, loop.contact.heights)
    state = js.equilibrate(contact_of(), js.MeanPressure(0.03))
    js.save(tmp_path / "state.nc", contact_of(), state)
    _, same = js.load(tmp_path / "state.nc")
    np.testing.assert_array_equal(same.indentation, state.indentation)


@pytest.mark.nightly
def test_a_path_within_a_program_is_the_same(loop):
    turns = js.MeanDisplacement(jnp.array([0.01, -0.02, 0.01, -0.02]))

    @jax.jit
    def path_of(contact):
        return rough(contact=contact, load=turns, max_states=256, max_jumps=1)

    found = path_of(contact_of())
    np.testing.assert_allclose(found.plastic_work, loop.plastic_work, rtol=1e-9)
    np.testing.assert_allclose(found.contact.heights, loop.contact.heights, atol=1e-12)


def test_other_functions_ask_for_a_surface_that_stays_as_it_is():
    contact = adhesive_contact()
    for call in (
        lambda: js.pull_off(contact),
        lambda: js.continuation(contact, js.MeanGap(jnp.array([0.1, 0.05]))),
        lambda: js.critical_load(contact, js.MeanPressure(jnp.array([0.0, -0.1]))),
    ):
        with pytest.raises(ValueError, match=r"takes no surface that yields: give contact.after"):
            call()
    state = js.equilibrate(contact, js.MeanPressure(0.1))
    pull = js.pull_off(contact.after(state).elastic, initial=state)
    assert pull.load.value < 0


def random_line(seed):
    """Return a line of ten points under growing pressures, which yields and jumps into contact."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 0.1, 10)
    law = js.potentials.Exponential(rng.uniform(0.005, 0.03), rng.uniform(0.02, 0.06))
    hardness = rng.uniform(0.3, 1.0) + law.surface_energy / law.length / 2
    grid = js.Grid((10,), (1.0,))
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, law, hardness=hardness)
    return contact, js.MeanPressure(jnp.array([0.01, 0.6]) * hardness)


def check_jumps(seed):
    """Hold each jump of a line against dense algebra; return kinds, and yielding points before."""
    contact, load = random_line(seed)
    path = js.follow(contact, load, disturbance=0.0)
    assert path.result == "successful"
    stiffness = periodic_stiffness((10,), (1.0,), 1.0)
    law, heights = contact.potential, np.asarray(contact.heights)
    hardness = float(contact.hardness)
    largest = hardness + float(law.surface_energy / law.length)

    def potential(state, pressure):
        """Return the energy, the plastic work and the work of the load by NumPy, over the area."""
        depth = np.asarray(state.indentation)
        u = state.gap - depth + heights
        adhesion = -law.surface_energy * np.exp(-state.gap / law.length)
        return (u @ stiffness @ u / 2 + (adhesion + hardness * depth + pressure * u).sum()) / 10

    found = []
    for jump in path.jumps:
        gap, reaction = np.asarray(jump.before.gap), np.asarray(jump.before.reaction)
        is_open, mode = gap > 0, np.asarray(jump.mode)
        yields = ~is_open & (reaction > (1 - 1e-6) * largest)
        free = is_open | yields
        pull = law.surface_energy / law.length**2 * np.exp(-gap / law.length)
        matrix = stiffness - np.diag(np.where(is_open, pull, 0))
        least = np.argmin(np.where(free, np.inf, largest - reaction))
        if jump.kind == "yielding":
            # It reaches the hardness at a load as near as jumps are located.
            assert largest - reaction[least] < 1e-4 * largest
            assert np.linalg.eigvalsh(matrix[np.ix_(free, free)])[0] > 0.01
            free[least] = True
            assert mode[least] < 0
        assert not mode[~free].any()
        values, modes = np.linalg.eigh(matrix[np.ix_(free, free)])
        np.testing.assert_allclose(abs(modes[:, 0] @ mode[free]), 1, atol=1e-3)
        if jump.kind == "fold":
            # It vanishes as the root of a distance of 1e-6.
            assert 0 < values[0] < 0.05
        elif jump.kind == "yielding":
            assert values[0] < -0.05
        pressure = float(jump.after.load.value)
        work = hardness * (jump.after.indentation - jump.before.indentation).mean()
        np.testing.assert_allclose(jump.plastic_work, work, rtol=1e-9)
        loss = potential(jump.before, pressure) - potential(jump.after, pressure)
        np.testing.assert_allclose(jump.dissipation, loss, rtol=2e-2)
        found.append((jump.kind.name, int(yields.sum())))
    return found


@pytest.mark.nightly
def test_jumps_while_points_yield_are_those_of_dense_algebra():
    # The first jump begins where a point begins to yield, the others are folds of one that yields.
    assert check_jumps(3) == [("yielding", 0), ("fold", 1), ("fold", 1), ("fold", 3)]


@pytest.mark.nightly
def test_an_infinite_hardness_of_points_that_never_yield_changes_no_jump():
    contact, load = random_line(3)
    path = js.follow(contact, load, disturbance=0.0)
    stays = np.asarray(path.last_indentation) == 0
    assert 0 < stays.sum() < 10
    hardness = np.where(stays, np.inf, contact.hardness)
    other = js.Contact(contact.solid, contact.heights, contact.potential, hardness=hardness)
    same = js.follow(other, load, disturbance=0.0)
    assert list(same.jumps.kind.name) == list(path.jumps.kind.name)
    np.testing.assert_allclose(same.jumps.mode, path.jumps.mode, atol=1e-6)
    np.testing.assert_allclose(same.plastic_work, path.plastic_work, rtol=1e-9)


@pytest.mark.nightly
def test_kinds_of_sixty_jumps_while_points_yield_are_those_of_dense_algebra():
    found = [jump for seed in range(1, 60, 2) for jump in check_jumps(seed)]
    kinds = [kind for kind, _ in found]
    assert len(found) > 60
    assert sum(number > 0 for _, number in found) > 20
    assert kinds.count("yielding") >= 2
    assert kinds.count("uncertain") < 3
