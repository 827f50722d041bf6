"""Branches against a dense curve that takes every change of contact by itself."""

import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness
from dense_curve import DenseCurve, exponential

import jaxstab as js
from jaxstab.branches.curve import BorderedVector, Curve

# Heights at which a step over several changes of contact was seen to cross to another branch.
HEIGHTS = 1e-4 * np.fromstring(
    "206 258 218 90 -14 -28 8 46 49 122 216 265 342 230 -68 -234 "
    "-355 -375 -318 -361 -342 -234 -122 -104 -46 67 101 116 105 22 53 87",
    sep=" ",
)
EIGHT = np.array([0.0265, 0.0055, -0.0643, 0.0301, 0.0105, -0.0316, 0.0162, 0.007])


def line(heights, energy, length, of_length=1.0, of_pressure=1.0):
    grid = js.Grid((len(heights),), (of_length,))
    law = js.potentials.Exponential(energy * of_pressure * of_length, length * of_length)
    return js.Contact(js.HalfSpace(grid, of_pressure), heights * of_length, law)


def dense(heights, energy, length, contact, ends):
    """Return a dense curve under a held displacement, followed from the same equilibrium."""
    stiffness = periodic_stiffness((len(heights),), (1.0,), 1.0)
    load = 1.0, 0.0, np.mean(heights)
    curve = DenseCurve(stiffness, heights, *exponential(energy, length), load)
    start = js.equilibrate(contact, js.MeanDisplacement(ends[0]))
    end = curve.follow(np.asarray(start.gap), float(start.mean_pressure), ends[1], 2e-3)
    return curve, end


def assert_same(branch, curve):
    assert list(branch.turns.kind.name) == [kind for kind, _ in curve.events]
    values = [value for _, value in curve.events]
    np.testing.assert_allclose(branch.turns.load.value, values, rtol=1e-7)


def test_the_size_of_pressures_is_that_of_a_dense_operator_in_any_unit():
    state = js.equilibrate(line(EIGHT, 0.466, 0.2), js.MeanGap(0.4))
    assert not state.in_contact.any()
    elastic = periodic_stiffness((8,), (1.0,), 1.0) @ np.asarray(state.gap + EIGHT)
    least = []
    for unit in (1.0, 1e3):
        curve, flat = (
            Curve.of(line(heights, 0.466, 0.2, of_pressure=unit), js.MeanGap(0.4))
            for heights in (EIGHT, 0 * EIGHT)
        )
        at = BorderedVector(state.gap, state.mean_pressure * unit)
        # Elastic pressures balance the others.
        size = curve.forces(at, state.gap > 0).scale
        np.testing.assert_allclose(size, unit * np.sqrt(2 * np.mean(elastic**2)), rtol=1e-6)
        least.append([curve.least_scale / unit, flat.least_scale / unit])
    np.testing.assert_allclose(least[1], least[0])
    assert np.min(least) > 0


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_it_crosses_to_no_other_branch_depends_on_no_unit_and_ends_where_a_point_touches():
    ends = jnp.array([0.4342, 0.0042])
    contact = line(HEIGHTS, 0.0939, 0.1)
    branch = js.continuation(contact, js.MeanDisplacement(ends))
    curve, end = dense(HEIGHTS, 0.0939, 0.1, contact, ends)
    assert branch.end == end == "load"
    assert len(curve.events) == 12
    assert_same(branch, curve)
    length, pressure = 1e-6, 1e9
    other = js.continuation(
        line(HEIGHTS, 0.0939, 0.1, length, pressure), js.MeanDisplacement(ends * length)
    )
    assert len(other.index) == len(branch.index)
    scaled = np.asarray(other.turns.load.value) / length
    np.testing.assert_allclose(scaled, branch.turns.load.value, rtol=1e-8)
    # Also the first load at which a point touches is an end.
    touch = branch.load.value[int(np.argmax(branch.equilibrium.contact_area > 0))]
    found = js.continuation(contact, js.MeanDisplacement(jnp.stack([ends[0], touch])))
    assert found.end == "load"
    np.testing.assert_allclose(found.load.value[-1], touch, rtol=1e-12)


def test_on_many_points_a_step_passes_several_changes_and_stays_on_the_curve():
    x = 2 * np.pi * np.arange(128) / 128
    heights = -0.02 * (np.cos(x) + 0.3 * np.cos(2 * x + 1))
    contact = line(heights, 1e-4, 0.1)
    branch = js.continuation(contact, js.MeanGap(jnp.array([0.002, 0.004])), fields=True)
    touching = np.sum(branch.equilibrium.gap == 0, axis=1)
    assert branch.end == "load" and touching[0] - touching[-1] > 10
    assert np.abs(np.diff(touching)).max() == 2
    last = js.equilibrate(contact, js.MeanGap(0.004))
    np.testing.assert_allclose(branch.equilibrium.gap[-1], last.gap, atol=1e-7)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_random_lines_stay_on_their_branches():
    same = 0
    for seed in range(12):
        random = np.random.default_rng(seed)
        wave = np.abs(np.fft.fftfreq(32, 1 / 32))
        keep = np.where((wave > 0) & (wave <= random.integers(4, 16)), np.maximum(wave, 1), np.inf)
        spectrum = np.fft.fft(random.normal(size=32)) * keep ** -random.uniform(0.8, 2.0)
        heights = np.fft.ifft(spectrum).real
        heights *= random.uniform(0.01, 0.05) / heights.std()
        length, resolution = random.uniform(0.05, 0.25), random.uniform(2, 6)
        # The stiffness of the shortest wave over the largest curvature of the law.
        energy = np.pi * 16 * length**2 / resolution
        far = random.uniform(0.5, 1) * (3 * length + np.ptp(heights))
        ends = jnp.array([far, 0.05 * np.ptp(heights)])
        contact = line(heights, energy, length)
        loads = js.MeanDisplacement(ends)
        branch = js.continuation(contact, loads, throw=False, max_states=300)
        curve, end = dense(heights, energy, length, contact, ends)
        number = len(branch.turns)
        assert branch.end in ("load", "states", "loop", "uncertain")
        assert list(branch.turns.kind.name) == [kind for kind, _ in curve.events][:number]
        values = [value for _, value in curve.events][:number]
        np.testing.assert_allclose(branch.turns.load.value, values, rtol=1e-6)
        same += branch.end.name == end
        assert branch.end != "load" or (end == "load" and len(curve.events) == number)
    assert same >= 4


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_full_contact_is_a_start_and_an_end():
    heights = 0.01 * np.cos(2 * np.pi * np.arange(16) / 16)
    contact = line(heights, 0.02, 0.1)
    branch = js.continuation(contact, js.MeanPressure(jnp.array([0.0, -0.25])), max_states=30)
    area = np.asarray(branch.equilibrium.contact_area)
    last = np.argmax(area < 1)
    # The first step is a fifth of the longest, a tenth of the way from load to load.
    np.testing.assert_allclose(branch.load.value[:2], [0, -0.25 / 50], rtol=1e-9)
    # The first reaction vanishes in the trough: K h there is pi times the height.
    np.testing.assert_allclose(branch.load.value[last - 1], np.pi * 0.01 - 0.2, rtol=1e-9)
    assert np.all(area[:last] == 1) and np.all(branch.index[:last] == 0)
    near = js.equilibrate(contact, js.MeanGap(0.005))
    closing = js.continuation(contact, js.MeanGap(jnp.array([0.005, -0.01])), initial=near)
    assert closing.end == "full_contact"
    assert closing.equilibrium.contact_area[-1] == 1 and closing.load.value[-1] == 0


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_steps_that_may_not_be_short_end_as_uncertain():
    contact = line(HEIGHTS, 0.0939, 0.1)
    loads = js.MeanDisplacement(jnp.array([0.4342, 0.0042]))
    steps = {"max_step": 0.02, "min_step": 0.01}
    branch = js.continuation(contact, loads, throw=False, **steps)
    assert branch.end == "uncertain" and branch.result == "lost_branch"
    assert len(branch.index) > 1
    with pytest.raises(js.exceptions.SolverError, match=r"steps of the least length.*min_step"):
        js.continuation(contact, loads, **steps)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_a_branch_to_infinite_gaps_ends_as_separated():
    contact = line(EIGHT, 0.466, 0.2)
    apart = js.equilibrate(contact, js.MeanGap(1.0))
    ends = jnp.array([1.0, -2.0]) * apart.mean_pressure
    branch = js.continuation(contact, js.MeanPressure(ends), initial=apart)
    assert branch.end == "separated" and len(branch.turns) == 0
    # Far apart it is that of flat surfaces at the mean attraction.
    last = branch.equilibrium.mean_gap[-1]
    factor = np.mean(np.exp(EIGHT / 0.2))
    pull = -0.466 / 0.2 * np.exp(-(last + np.mean(EIGHT)) / 0.2) * factor
    np.testing.assert_allclose(branch.load.value[-1], pull, rtol=1e-3)
    # A load on the way there is reached.
    near = js.continuation(contact, js.MeanPressure(jnp.array([1.0, 0.5]) * ends[0]), initial=apart)
    assert near.end == "load"
