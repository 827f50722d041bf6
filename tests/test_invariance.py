"""What must not change with the units, the place and the order in which a problem is given.

Hypothesis chooses the surfaces and the changes. All are of one shape, and compiled once.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxstab as js

N = 6
SIDES = np.array([1.0, 1.5])
seeds = st.integers(0, 2**32)
scales = st.floats(-6, 6).map(lambda power: 10.0**power)
many = settings(max_examples=8)
few = settings(max_examples=3)


@dataclass(frozen=True)
class Change:
    """Another way to give a problem: in other units, moved over the cell, and at another height.

    `length`, `pressure` and `time` are the old units in the new ones, and `datum` is the height of
    the origin.
    """

    length: float = 1.0
    pressure: float = 1.0
    time: float = 1.0
    datum: float = 0.0
    shift: tuple[int, int] = (0, 0)
    flips: tuple[bool, bool] = (False, False)
    transposes: bool = False

    @property
    def work(self):
        """The old unit of energies per area."""
        return self.pressure * self.length

    @property
    def energy(self):
        return self.pressure * self.length**3

    def moved(self, field):
        field = np.roll(field, self.shift, (0, 1))
        field = np.flip(field, [axis for axis in (0, 1) if self.flips[axis]])
        return field.T if self.transposes else field

    def height(self, value):
        return self.length * (value + self.datum)

    def displacement(self, values):
        return js.MeanDisplacement(self.height(jnp.asarray(values)))

    def contact(self, surface, strength=1.0, is_viscoelastic=False):
        sides = SIDES[::-1] if self.transposes else SIDES
        solid = js.HalfSpace(js.Grid((N, N), self.length * sides), self.pressure)
        if is_viscoelastic:
            solid = js.Viscoelastic(solid, (1.0, 2.0), (0.3 * self.time, 2.0 * self.time))
        law = js.potentials.Exponential(0.05 * strength * self.work, 0.1 * self.length)
        return js.Contact(solid, self.height(self.moved(surface)), law)


AS_GIVEN = Change()
changes = st.builds(
    Change,
    length=scales,
    pressure=scales,
    time=scales,
    datum=st.floats(-10, 10),
    shift=st.tuples(st.integers(0, N - 1), st.integers(0, N - 1)),
    flips=st.tuples(st.booleans(), st.booleans()),
    transposes=st.booleans(),
)


def rough(seed):
    """Return heights on which the law of `Change.contact` jumps, at a tenth of its strength not."""
    heights = 0.05 * np.random.default_rng(seed).normal(size=(N, N))
    return heights - heights.mean()


surfaces = seeds.map(rough)


def assert_same(found, expected, rtol=1e-6):
    """Compare numbers with each other, relative to the largest of each kind."""
    for name, value in expected.items():
        atol = rtol * np.max(np.abs(value), initial=0)
        np.testing.assert_allclose(found[name], value, rtol=0, atol=atol, err_msg=name)


def equilibrium(surface, change):
    load = change.displacement(0.05)
    solver = js.solvers.PreconditionedConjugateGradient(1e-12)
    state = js.equilibrate(change.contact(surface), load, solver)
    return {
        "pressure": state.mean_pressure / change.pressure,
        "area": state.contact_area,
        "energy": state.energy / change.energy,
        # Sorted, they are the same in every place.
        "gaps": np.sort(state.gap, axis=None) / change.length,
        "reactions": np.sort(state.reaction, axis=None) / change.pressure,
    }


def verdict(surface, change):
    contact = change.contact(surface)
    state = js.equilibrate(contact, js.MeanPressure(0.02 * change.pressure))
    found = js.assess_stability(contact, state)
    eigenvalues = np.array([pair.eigenvalue for pair in found.pairs.values()])
    # Far beyond the strength of the law.
    apart = js.equilibrate(contact, js.MeanPressure(-10 * change.pressure), throw=False)
    return {
        "apart": apart.result.code,
        "gap apart": jnp.mean(apart.gap) / change.length,
        "verdict": found.verdict.code,
        "eigenvalues": eigenvalues * change.length / change.pressure,
        "complementarity": found.complementarity,
    }


def branch(surface, change):
    found = js.continuation(change.contact(surface), change.displacement([0.4, 0.1]))
    turns = found.turns
    return {
        "kinds": turns.kind.code,
        "loads": turns.load.value / change.length - change.datum,
        "pressures": turns.equilibrium.mean_pressure / change.pressure,
        "end": found.end.code,
    }


def evolution(surface, change):
    contact = change.contact(surface, is_viscoelastic=True)
    load = change.displacement([0.3, 0.05, 0.05, 0.4])
    found = js.evolve(contact, load, change.time * np.array([0.0, 1.0, 2.0, 2.5]))
    return {
        "pressures": found.mean_pressure / change.pressure,
        "dissipated": found.dissipated / change.energy,
        "losses": found.dissipation / change.energy,
        "times": found.jump_times / change.time,
    }


def fit(surface, change, order=range(8)):
    """Fit a curve without jumps, measured in any order."""
    values = np.linspace(0.06, 0.3, 8)
    exact = js.sweep(
        change.contact(surface, 0.1),
        change.displacement(values),
        order="independent",
        stability=False,
    )
    noise = 1e-4 * change.pressure * np.cos(100 * values)
    measured = np.asarray(exact.equilibrium.mean_pressure) + noise
    places = list(order)
    found = js.calibrate(
        change.contact(surface, 0.15),
        change.displacement(values[places]),
        measured[places],
        order="independent",
        starts=1,
    )
    law, modulus = found.parameters
    errors, _ = found.standard_errors
    return {
        "work": law.surface_energy / change.work,
        "range": law.length / change.length,
        "modulus": modulus / change.pressure,
        "error": errors.surface_energy / change.work,
    }


@pytest.mark.nightly
@many
@given(surfaces, changes)
def test_an_equilibrium_is_the_same_however_it_is_given(surface, change):
    assert_same(equilibrium(surface, change), equilibrium(surface, AS_GIVEN))


@pytest.mark.nightly
@many
@given(surfaces, changes)
def test_a_verdict_is_the_same_however_its_state_is_given(surface, change):
    assert_same(verdict(surface, change), verdict(surface, AS_GIVEN))


@pytest.mark.nightly
@few
@given(surfaces, changes)
def test_a_branch_is_the_same_however_it_is_given(surface, change):
    assert_same(branch(surface, change), branch(surface, AS_GIVEN))


@pytest.mark.nightly
@many
@given(surfaces, changes)
def test_an_evolution_is_the_same_however_it_is_given(surface, change):
    assert_same(evolution(surface, change), evolution(surface, AS_GIVEN), rtol=1e-5)


@pytest.mark.nightly
@few
@given(surfaces, changes)
def test_a_fit_is_the_same_however_it_is_given(surface, change):
    assert_same(fit(surface, change), fit(surface, AS_GIVEN), rtol=1e-4)


# The loads of jumps are located to this, a part of the range of the load.
RESOLUTION = 1e-6


def path(surface, change, turns, initial=None):
    contact = change.contact(surface)
    return js.follow(contact, change.displacement(turns), initial=initial, smallest_jump=1e-6)


def jumps_of(paths, change, least):
    """Return load, kind, loss and difference of force of the jumps with more than the least loss.

    One with a smaller loss may be passed over.
    """
    columns = []
    for jumps in (each.jumps for each in paths):
        load = jumps.load.value / change.length - change.datum
        force = jumps.after.force - jumps.before.force
        columns.append([load, jumps.kind.code, jumps.dissipation, force])
    load, kind, loss, force = np.concatenate(columns, axis=1)
    counts = loss > least * change.energy
    scales = change.energy, change.pressure * change.length**2
    return load[counts], kind[counts], loss[counts] / scales[0], force[counts] / scales[1]


def assert_same_jumps(paths, change, expected):
    """Compare the jumps of a path, given in pieces, with those of another one."""
    errors = [float(each.unlocated_error) / change.energy for each in paths]
    least = max(*errors, float(expected.unlocated_error))
    load, kind, loss, force = jumps_of([expected], AS_GIVEN, least)
    found_load, found_kind, found_loss, _ = jumps_of(paths, change, least)
    assert found_kind.tolist() == kind.tolist()
    resolution = RESOLUTION * np.ptp(expected.load.value)
    np.testing.assert_allclose(found_load, load, rtol=0, atol=resolution)
    # As the load of a jump is shifted, its loss changes by the difference of the forces.
    assert np.all(np.abs(found_loss - loss) <= resolution * np.abs(force) + 1e-9 * loss)
    last = paths[-1].equilibrium.mean_pressure[-1] / change.pressure
    np.testing.assert_allclose(last, expected.equilibrium.mean_pressure[-1], rtol=1e-6)


@pytest.mark.nightly
@few
@given(surfaces, changes)
def test_a_path_is_the_same_however_it_is_given(surface, change):
    turns = np.array([0.4, 0.1, 0.3])
    found = path(surface, change, turns)
    assert_same_jumps([found], change, path(surface, AS_GIVEN, turns))


@pytest.mark.nightly
@few
@given(surfaces, st.floats(0.15, 0.35))
def test_a_path_in_two_pieces_has_the_jumps_of_the_whole(surface, middle):
    first = path(surface, AS_GIVEN, [0.4, middle])
    rest = path(surface, AS_GIVEN, [middle, 0.1], first[-1])
    assert_same_jumps([first, rest], AS_GIVEN, path(surface, AS_GIVEN, [0.4, 0.1]))


@pytest.mark.nightly
@few
@given(surfaces, st.floats(0.1, 0.9))
def test_a_branch_goes_on_from_any_state_before_its_first_turn(surface, part):
    contact = AS_GIVEN.contact(surface)
    whole = js.continuation(contact, AS_GIVEN.displacement([0.4, 0.1]), fields=True)
    before = len(whole) if len(whole.turns) == 0 else int(whole.turns.state[0])
    start = whole[int(part * (before - 1))]
    loads = js.MeanDisplacement(jnp.stack([start.load.value, jnp.asarray(0.1)]))
    rest = js.continuation(contact, loads, initial=start)
    assert rest.turns.kind.code.tolist() == whole.turns.kind.code.tolist()
    np.testing.assert_allclose(rest.turns.load.value, whole.turns.load.value, atol=1e-9)


@pytest.mark.nightly
@many
@given(surfaces, st.permutations(range(5)))
def test_the_states_of_a_sweep_do_not_depend_on_their_order(surface, order):
    contact = AS_GIVEN.contact(surface)
    values = np.linspace(0.05, 0.3, 5)
    sweep, other = (
        js.sweep(contact, AS_GIVEN.displacement(values[list(places)]), order="independent")
        for places in (range(5), order)
    )
    for each in (lambda s: s.equilibrium.gap, lambda s: s.stability.cone.eigenvalue):
        np.testing.assert_allclose(each(other), np.asarray(each(sweep))[list(order)], rtol=1e-9)


@pytest.mark.nightly
@few
@given(surfaces, st.permutations(range(8)))
def test_a_fit_of_loads_without_hysteresis_does_not_depend_on_their_order(surface, order):
    assert_same(fit(surface, AS_GIVEN, order), fit(surface, AS_GIVEN), rtol=1e-4)


def tiled(surface):
    """Return a surface of weak adhesion once, and twice on each side."""
    law = js.potentials.Exponential(0.005, 0.1)
    for number in (1, 2):
        grid = js.Grid((number * N, number * N), number * SIDES)
        yield js.Contact(js.HalfSpace(grid, 1.0), np.tile(surface, (number, number)), law)


@pytest.mark.nightly
@many
@given(surfaces)
def test_a_repeated_surface_has_a_repeated_equilibrium_and_no_higher_eigenvalues(surface):
    found = []
    for contact in tiled(surface):
        state = js.equilibrate(
            contact, js.MeanGap(0.05), js.solvers.PreconditionedConjugateGradient(1e-12)
        )
        found.append((state, js.assess_stability(contact, state)))
    (one, of_one), (four, of_four) = found
    np.testing.assert_allclose(four.mean_pressure, one.mean_pressure, rtol=1e-8)
    np.testing.assert_allclose(four.gap, np.tile(one.gap, (2, 2)), atol=1e-9)
    np.testing.assert_allclose(four.energy, 4 * one.energy, rtol=1e-8)
    for name, pair in of_four.pairs.items():
        assert pair.eigenvalue <= of_one.pairs[name].eigenvalue + 1e-7
