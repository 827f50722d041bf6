"""Passes from a state to detached surfaces, under dead loads that pull."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness
from problems import rough_contact

import jaxstab as js
from jaxstab.transitions.branch_pass import passes_out

WORK, RANGE = 0.03, 0.2
PARTS = 0.3, 0.5, 0.9, 0.98


def branch_around(contact):
    """Return the branch from no load around the pull-off and back, and the pull-off."""
    options = {"fields": True, "max_step": 0.003, "max_states": 150}
    branch = js.continuation(contact, js.MeanPressure(jnp.array([0.0, -1.0])), **options)
    return branch, float(branch.turns.load.value.min())


@pytest.fixture(scope="module")
def pulled(detaching):
    contact, _ = detaching
    return contact, *branch_around(contact)


def stable_at(contact, value):
    """Return the state at a load on the branch from no load."""
    loads = js.MeanPressure(jnp.array([0.0, value]))
    branch = js.continuation(contact, loads, fields=True)
    assert branch.end == "load" and branch.index[-1] == 0
    return branch[-1]


def unstable_at(contact, branch, value):
    """Return the state at a load on a branch beyond its only turn."""
    values, (turn,) = np.asarray(branch.load.value), np.asarray(branch.turns.state)
    beyond = np.arange(turn + 1, len(branch))
    last = beyond[values[beyond] < value][-1]
    loads = js.MeanPressure(jnp.array([values[last], value]))
    rest = js.continuation(contact, loads, initial=branch[last], fields=True)
    assert rest.end == "load" and rest.index[-1] == 1
    return rest[-1]


def potential(state, value):
    """Return E + p0 mean(g) A."""
    return state.equilibrium.energy + value * state.equilibrium.mean_gap * state.equilibrium.area


@pytest.mark.nightly
@pytest.mark.parametrize("part", PARTS)
def test_the_pass_is_the_unstable_state_of_the_branch_at_the_same_load(pulled, part):
    contact, branch, strongest = pulled
    load = js.MeanPressure(part * strongest)
    stable = stable_at(contact, part * strongest)
    unstable = unstable_at(contact, branch, part * strongest)
    found = js.transition(contact, load, stable, None)
    height = potential(unstable, load.value) - potential(stable, load.value)
    np.testing.assert_allclose(found.barrier.there, height, rtol=1e-6)
    np.testing.assert_allclose(found.saddle.gap, unstable.equilibrium.gap, atol=1e-7)
    near, far = found.minima
    np.testing.assert_allclose(near.gap, found.start.gap, atol=1e-7)
    assert far.result == found.end.result == "pulled_off"
    assert found.barrier.back == np.inf and far.contact_area == found.end.contact_area == 0
    for state in far, found.end:
        assert all(np.isnan(x).all() for x in (state.gap, state.energy, state.mean_pressure))
    # The branch leads up to the saddle.
    assert (np.diff(found.energies) > 0).all() and len(found.images) <= 16
    np.testing.assert_allclose(found.energies[-1], found.there, rtol=1e-6)
    np.testing.assert_allclose(found.images[0], found.start.gap, atol=1e-12)


class Dense:
    """The line by matrices, under a dead load."""

    def __init__(self, contact, pressure):
        self.stiffness = periodic_stiffness((12,), (1.0,), 1.0)
        self.heights, self.pressure = np.asarray(contact.heights), pressure

    def energy(self, gap):
        u = gap + self.heights
        elastic = u @ self.stiffness @ u / 2
        return (elastic + np.sum(self.pressure * gap - WORK * np.exp(-gap / RANGE))) / 12

    def net(self, gap):
        pull = WORK / RANGE * np.exp(-gap / RANGE)
        return self.stiffness @ (gap + self.heights) + self.pressure + pull

    def hessian(self, gap):
        return self.stiffness - np.diag(WORK / RANGE**2 * np.exp(-gap / RANGE))

    def refined(self, gap):
        """Return the gap after Newton's method on its free points."""
        free, gap = gap > 0, gap.copy()
        for _ in range(20):
            gap[free] -= np.linalg.solve(self.hessian(gap)[np.ix_(free, free)], self.net(gap)[free])
        assert (gap >= 0).all() and (self.net(gap)[~free] >= 0).all()
        assert np.abs(self.net(gap)[free]).max() < 1e-14
        return gap

    def descended(self, gap):
        """Return where the energy leads by small steps, or a gap that is far away."""
        step = 1 / np.linalg.eigvalsh(self.stiffness)[-1]
        for _ in range(200_000):
            new = np.maximum(gap - step * self.net(gap), 0)
            if new.min() > 2 or np.abs(new - gap).max() < 1e-13:
                return new
            gap = new
        raise AssertionError


@pytest.mark.parametrize("part", PARTS)
def test_by_matrices_it_is_a_saddle_between_the_start_and_nothing(pulled, part):
    contact, _, strongest = pulled
    stable = stable_at(contact, part * strongest)
    found = js.transition(contact, js.MeanPressure(part * strongest), stable, None)
    dense = Dense(contact, part * strongest)
    start, top = (dense.refined(np.asarray(x.gap)) for x in (found.start, found.saddle))
    np.testing.assert_allclose(top, found.saddle.gap, atol=1e-8)
    np.testing.assert_allclose(found.there, dense.energy(top) - dense.energy(start), rtol=1e-7)
    free = top > 0
    values, vectors = np.linalg.eigh(dense.hessian(top)[np.ix_(free, free)])
    assert values[0] < 0 < values[1]
    mode = np.zeros_like(top)
    mode[free] = vectors[:, 0]
    np.testing.assert_allclose(abs(mode @ found.mode), 1, rtol=1e-6)
    ends = [dense.descended(np.maximum(top + t * mode, 0)) for t in (-1e-3, 1e-3)]
    near, far = sorted(ends, key=np.mean)
    np.testing.assert_allclose(near, start, atol=1e-8)
    assert far.min() > 2


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
@pytest.mark.parametrize(
    ("law", "kind", "exponent"),
    [
        (js.potentials.Exponential(WORK, RANGE), "release", 2),
        pytest.param(
            js.potentials.LennardJones(WORK, 0.15), "fold", 1.5, marks=pytest.mark.nightly
        ),
    ],
    ids=["release", "fold"],
)
def test_near_the_pull_off_it_follows_the_law_of_the_jump(detaching, law, kind, exponent):
    line, _ = detaching
    contact = js.Contact(line.solid, line.heights, law)
    _, strongest = branch_around(contact)
    (*_, jump) = js.follow(contact, js.MeanPressure(jnp.array([0.0, 1.1 * strongest]))).jumps
    assert jump.kind == kind and jump.barrier_law.exponent == exponent
    for distance in (1e-2, 1e-3, 1e-4, 1e-5):
        load = js.MeanPressure((1 - distance) * strongest)
        there = js.transition(contact, load, stable_at(contact, load.value), None).there
        # The next power of the distance is left.
        expected = jump.barrier_law.barrier(distance * strongest)
        np.testing.assert_allclose(there, expected, rtol=max(10 * distance, 1e-3))


def test_flat_surfaces_come_apart_over_the_barrier_of_the_law_alone(detaching):
    line, _ = detaching
    contact = js.Contact(line.solid, jnp.zeros(12), line.potential)
    pull = 0.05
    load = js.MeanPressure(-pull)
    found = js.transition(contact, load, js.equilibrate(contact, load), None)
    # Where the attraction has fallen to the pull.
    gap = RANGE * np.log(WORK / RANGE / pull)
    np.testing.assert_allclose(found.saddle.gap, gap, rtol=1e-8)
    np.testing.assert_allclose(found.there, WORK - RANGE * pull - pull * gap, rtol=1e-9)
    np.testing.assert_allclose(np.abs(found.mode), 12**-0.5, rtol=1e-6)


@pytest.mark.nightly
def test_its_barrier_has_the_derivatives_of_differences(detaching):
    contact, found = detaching

    def there(work, value, heights):
        other = js.Contact(contact.solid, heights, js.potentials.Exponential(work, RANGE))
        return js.transition(other, js.MeanPressure(value), found.start, None).there

    at = WORK, float(found.start.load.value), contact.heights
    value, rates = jax.value_and_grad(there, (0, 1, 2))(*at)
    np.testing.assert_allclose(value, found.there, rtol=1e-9)
    # By d(E + p0 mean(g) A) at constant gaps.
    gaps = [np.asarray(state.gap) for state in (found.saddle, found.start)]
    adhesion, mean_gap, elastic = (
        f(gaps[0]) - f(gaps[1])
        for f in (
            lambda gap: -np.mean(np.exp(-gap / RANGE)),
            np.mean,
            lambda gap: periodic_stiffness((12,), (1.0,), 1.0) @ gap / 12,
        )
    )
    for rate, expected in zip(rates, (adhesion, mean_gap, elastic), strict=True):
        np.testing.assert_allclose(rate, expected, rtol=1e-6, atol=1e-9)
    low, high = (there(WORK + step, *at[1:]) for step in (-1e-6, 1e-6))
    np.testing.assert_allclose(rates[0], (high - low) / 2e-6, rtol=1e-6)
    assert np.isnan(jax.grad(jax.grad(there))(*at))
    ahead = jax.jvp(partial(there, WORK, heights=at[2]), at[1:2], (1.0,))[1]
    np.testing.assert_allclose(ahead, rates[1], rtol=1e-9)


def test_other_loads_and_transformations_are_refused_with_the_cure(detaching):
    contact, found = detaching
    for load in js.MeanGap(0.1), js.MeanPressure(0.0), js.MeanPressure(0.1), js.Spring(0.1, 1.0):
        with pytest.raises(ValueError, match=r"end is None.*MeanPressure below zero.*separated"):
            js.transition(contact, load, found.start, None)
    with pytest.raises(ValueError, match="takes one load"):
        js.transition(contact, js.MeanPressure(-jnp.ones(2)), found.start, None)

    def there(value):
        return js.transition(contact, js.MeanPressure(value), found.start.gap, None).there

    for transformed in jax.jit(there), lambda value: jax.vmap(there)(value[None]):
        with pytest.raises(TypeError, match=r"detached surfaces works on known numbers"):
            transformed(found.start.load.value)
    with pytest.raises(
        js.exceptions.SolverError, match=r"No pass to detached surfaces.*: pulled_off: "
    ):
        js.transition(contact, js.MeanPressure(-1.0), found.start, None)


def test_it_is_the_same_in_other_units(detaching):
    contact, found = detaching
    solid = js.HalfSpace(js.Grid((12,), (1e3,)), 1e-6)
    law = js.potentials.Exponential(1e-3 * WORK, 1e3 * RANGE)
    scaled = js.Contact(solid, 1e3 * contact.heights, law)
    load = js.MeanPressure(1e-6 * found.start.load.value)
    again = js.transition(scaled, load, 1e3 * found.start.gap, None)
    np.testing.assert_allclose(again.there, found.there, rtol=1e-6)
    np.testing.assert_allclose(again.energies, found.energies, rtol=1e-6, atol=1e-12)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_between_further_minima_the_pass_is_the_highest_of_the_lowest_way():
    grid = js.Grid((12,), (1.0,))
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.05)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.06, 0.06))
    path = js.follow(contact, js.MeanPressure(jnp.array([0.0, -0.43])), fields=True)
    load = js.MeanPressure(-0.43)
    found = js.transition(contact, load, path[-1], None)
    near, other = found.minima
    np.testing.assert_allclose(near.gap, found.start.gap, atol=1e-6)
    assert other.result == "successful" and other.mean_gap > 1.1 * near.mean_gap
    # From the minimum between, lower passes lead on.
    rest = js.transition(contact, load, other, None)
    assert rest.minima[1].result == "pulled_off"
    assert rest.saddle.energy + load.value * rest.saddle.mean_gap < (
        found.saddle.energy + load.value * found.saddle.mean_gap
    )


@pytest.mark.nightly
@pytest.mark.parametrize("part", PARTS)
def test_on_a_rough_surface_it_agrees_with_its_branch(part):
    contact = rough_contact(16, js.potentials.Exponential(0.03, 0.2), rms_height=0.05)
    branch, strongest = branch_around(contact)
    stable = stable_at(contact, part * strongest)
    unstable = unstable_at(contact, branch, part * strongest)
    found = js.transition(contact, js.MeanPressure(part * strongest), stable, None)
    height = potential(unstable, part * strongest) - potential(stable, part * strongest)
    np.testing.assert_allclose(found.barrier.there, height, rtol=1e-6)
    assert [state.result.name for state in found.minima] == ["successful", "pulled_off"]


def log_of_median_life(wells, saddles, sides, thermal_energy):
    """Return it, from state 1 to 0 by the rates over saddles, within a factor of two.

    Chances after one step are squared, so that they are sums of positive numbers.
    """
    chances = np.zeros((len(wells) + 1,) * 2)
    for energy, (one, other) in zip(saddles, sides, strict=True):
        for here, there in (one, other), (other, one):
            if here:
                chances[here, there] += np.exp((wells[here - 1] - energy) / thermal_energy)
    step = 0.1 / chances.sum(axis=1).max()
    chances *= step
    for doublings in range(3000):
        np.fill_diagonal(chances, 0)
        np.fill_diagonal(chances, 1 - chances.sum(axis=1))
        if chances[1, 0] > 0.5:
            return np.log(step) + doublings * np.log(2)
        chances = chances @ chances
    raise AssertionError


def test_the_largest_climb_on_the_way_is_the_exponent_of_the_median_life():
    random = np.random.default_rng(0)
    energy = 3e-3
    above = 0
    for _ in range(100):
        wells = random.uniform(0, 1, 5)
        sides = [random.choice(6, 2, replace=False).tolist() for _ in range(7)]
        sides += [[0, 5], [1, 2], [2, 3], [3, 4], [4, 5]]
        saddles = [max(wells[i - 1] for i in pair if i) for pair in sides]
        saddles = np.array(saddles) + random.uniform(0.05, 1, len(sides))
        passes = passes_out(saddles, sides)
        climbs = {state: saddles[number] - wells[state - 1] for state, number in passes.items()}
        exponent = energy * log_of_median_life(wells, saddles, sides, energy)
        np.testing.assert_allclose(max(climbs.values()), exponent, atol=4 * energy)
        above += max(climbs.values()) > climbs[1] + 10 * energy
    assert above > 20
    assert passes_out([1.0, 2.0], [(1, 2), (3, 0)]) == {}
