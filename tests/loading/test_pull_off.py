"""The pull-off: against bisection, differences of itself, Johnson's wave, and soft machines."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import bisected, rough_contact, sphere_on_window
from scipy.optimize import minimize_scalar

import jaxstab as js
from jaxstab.branches.limit import limit_ahead
from jaxstab.equilibrium.posing import pose

LAWS = {
    "exponential": js.potentials.Exponential(0.02, 0.08),
    "core": js.potentials.LennardJones(0.02, 0.08),
}
NO_ATTRACTION = r"No pull-off found .* the law attracts nowhere"


def surface(law):
    """Return a contact of few points, of which no two are alike."""
    grid = js.Grid(8)
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=4, rms_height=0.05)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law)


@pytest.fixture(
    scope="module", params=["exponential", pytest.param("core", marks=pytest.mark.nightly)]
)
def case(request):
    contact = surface(LAWS[request.param])
    return request.param, contact, js.pull_off(contact)


def test_it_is_where_bisection_ends(case):
    name, contact, pull = case
    np.testing.assert_allclose(
        pull.load.value, bisected(contact, js.MeanPressure, 0.0, -4e-3), rtol=1e-6
    )
    # A wall lets go by a point's reaction, a core by an eigenvalue.
    assert pull.kind == ("fold" if name == "core" else "release")
    assert isinstance(pull.load, js.MeanPressure)
    sign = pull.critical.eigenvalue / contact.solid.min_stiffness
    assert abs(sign) < 1e-6 if name == "core" else sign < -1e-3
    assert pull.after.result == "pulled_off" and jnp.isnan(pull.after.energy)
    np.testing.assert_allclose(pull.equilibrium.mean_pressure, pull.load.value, rtol=1e-9)


def strength(parts, throw=True):
    """Return the load at the pull-off as a function of all of the contact."""
    modulus, heights, law = parts
    contact = js.Contact(js.HalfSpace(js.Grid(8), modulus), heights, law)
    return js.pull_off(contact, throw=throw).load.value


def changes_of(case):
    """Return a contact's parts, and two of their numbers: an energy and a free point's height."""
    _, contact, pull = case
    state, parts = pull.equilibrium, (jnp.array(1.0), contact.heights, contact.potential)
    point = np.unravel_index(np.argmin(np.where(state.in_contact, np.inf, state.gap)), (8, 8))
    return parts, (lambda parts: parts[2].surface_energy, lambda parts: parts[1][point])


@pytest.mark.nightly
def test_its_derivatives_are_those_of_differences(case):
    parts, (energy, height) = changes_of(case)
    rates = jax.grad(strength)(parts)
    for pick, step in ((energy, 1e-8), (height, 1e-6)):
        # Of a pick the gradient is one in its place.
        change = jax.tree.map(partial(jnp.multiply, step), jax.grad(pick)(parts))
        above, below = (jax.tree.map(move, parts, change) for move in (jnp.add, jnp.subtract))
        difference = (strength(above) - strength(below)) / (2 * step)
        np.testing.assert_allclose(pick(rates), difference, rtol=1e-4, atol=1e-6)


@pytest.mark.nightly
def test_its_derivatives_are_the_same_in_both_modes(case):
    parts, picks = changes_of(case)
    rates = jax.jit(jax.grad(partial(strength, throw=False)))(parts)
    push = jax.jit(lambda change: jax.jvp(partial(strength, throw=False), (parts,), (change,))[1])
    for pick in picks:
        np.testing.assert_allclose(push(jax.grad(pick)(parts)), pick(rates), rtol=1e-8)


def test_from_full_contact_the_point_under_the_largest_tension_lets_go():
    heights = 0.002 * np.random.default_rng(0).normal(size=(8, 8))
    law = js.potentials.Exponential(0.02, 0.03)
    parts = jnp.array(1.0), jnp.array(heights), law
    # Reactions are K h + w / l + p0, of which the least is zero.
    waves = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(8, 1 / 8)], indexing="ij"))
    pressures = np.fft.ifft2(np.pi * waves * np.fft.fft2(heights)).real
    value, (by_modulus, _, by_law) = jax.value_and_grad(strength)(parts)
    np.testing.assert_allclose(value, -0.02 / 0.03 - pressures.min(), rtol=1e-12)
    rates = by_law.surface_energy, by_law.length, by_modulus
    np.testing.assert_allclose(rates, [-1 / 0.03, 0.02 / 0.03**2, -pressures.min()], rtol=1e-9)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.WindowWarning")
def test_on_a_window_a_sphere_comes_off_where_the_pull_of_a_held_far_side_is_largest():
    contact = sphere_on_window()

    def pull(displacement):
        return float(js.equilibrate(contact, js.FarDisplacement(displacement)).mean_pressure)

    found = js.pull_off(contact)
    largest = minimize_scalar(pull, bounds=(0.2, 0.5), method="bounded").fun
    np.testing.assert_allclose(found.load.value, largest, rtol=1e-9)
    # There held states go on, and lose nothing.
    assert found.kind == "fold"


@pytest.mark.nightly
def test_flat_surfaces_come_off_at_the_largest_attraction_wherever_it_is():
    gaps = np.linspace(0.0, 0.5, 1_000_001)
    strongest = (0.02 * gaps / 0.1**2 * np.exp(-(gaps**2) / (2 * 0.1**2))).max()
    for roughness in (0.0, 1e-3):
        contact = rough_contact(32, js.potentials.Gaussian(0.02, 0.1), rms_height=0.05)
        flat = eqx.tree_at(lambda x: x.heights, contact, roughness * contact.heights)
        np.testing.assert_allclose(js.pull_off(flat).load.value, -strongest, rtol=1e-6)


@pytest.mark.nightly
def test_entries_of_a_batch_are_those_alone():
    contact = rough_contact(32, LAWS["exponential"], rms_height=0.05)

    def value(energy):
        law = eqx.tree_at(lambda law: law.surface_energy, contact.potential, energy)
        return js.pull_off(js.Contact(contact.solid, contact.heights, law), throw=False).load.value

    energies = jnp.array([0.02, 0.021])
    together = jax.jit(jax.vmap(value))(energies)
    np.testing.assert_allclose(together, [value(energy) for energy in energies], rtol=1e-9)


@pytest.mark.nightly
def test_a_soft_machine_lets_go_like_a_dead_load_and_a_stiff_one_without_a_jump():
    contact = rough_contact(32, LAWS["exponential"], rms_height=0.05)
    dead = js.pull_off(contact)
    soft = js.pull_off(contact, spring=1e-3)
    assert isinstance(soft.load, js.Spring)
    np.testing.assert_allclose(soft.equilibrium.mean_pressure, dead.load.value, rtol=1e-3)
    path = js.follow(
        contact, js.Spring(jnp.stack([0.0, soft.load.value * 1.5]), 1e-3), initial=dead.equilibrium
    )
    np.testing.assert_allclose(path.jumps.load.value[-1], soft.load.value, rtol=1e-5)
    # The state that remains hangs on the machine alone.
    assert not soft.after.in_contact.any()
    assert -1e-2 < soft.after.mean_pressure / dead.load.value < 1e-2
    with pytest.raises(
        js.exceptions.SolverError, match=r"No pull-off found from Spring.*without a jump"
    ):
        js.pull_off(contact, spring=1e2)
    rate = jax.grad(lambda k: js.pull_off(contact, spring=k).load.value)(1e-3)
    step = 1e-8
    ends = [js.pull_off(contact, spring=1e-3 + sign * step).load.value for sign in (1, -1)]
    np.testing.assert_allclose(rate, (ends[0] - ends[1]) / (2 * step), rtol=1e-5)


def test_it_starts_where_it_is_told_to(case):
    _, contact, pull = case
    pressed = js.equilibrate(contact, js.MeanPressure(0.3))
    loaded = js.pull_off(contact, initial=pressed)
    # Contact that was made under pressure holds no less.
    assert loaded.load.value <= pull.load.value * (1 - 1e-9) or loaded.load.value == pytest.approx(
        pull.load.value, rel=1e-6
    )
    again = js.pull_off(contact, initial=pull.equilibrium)
    np.testing.assert_allclose(again.load.value, pull.load.value, rtol=1e-6)


@pytest.mark.nightly
def test_a_start_in_a_core_under_tension_is_not_lifted_off():
    contact = rough_contact(32, LAWS["core"], rms_height=0.05)
    near = js.pull_off(contact).equilibrium
    again = js.equilibrate(contact, js.MeanPressure(0.999 * near.load.value), initial=near)
    np.testing.assert_allclose(again.mean_pressure, 0.999 * near.load.value, rtol=1e-8)
    assert jnp.abs(again.gap - near.gap).max() < 0.2 * jnp.mean(near.gap)


@pytest.mark.nightly
def test_a_flat_surface_without_attraction_has_no_pull_off_from_a_spring():
    # Unlike a rough surface it has an equilibrium at zero pressure.
    law = js.potentials.Exponential(0.0, 0.06)
    flat = js.Contact(js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), law)
    with pytest.raises(js.exceptions.SolverError, match=NO_ATTRACTION):
        js.pull_off(flat, spring=1.0)


def test_what_has_no_pull_off_is_told():
    repelling = surface(js.potentials.Exponential(0.0, 0.06))
    with pytest.raises(js.exceptions.SolverError, match=NO_ATTRACTION):
        js.pull_off(repelling)
    none = js.pull_off(repelling, throw=False)
    assert none.result != "successful"
    numbers = none.load.value, none.critical.eigenvalue, none.equilibrium.gap, none.after.energy
    assert all(jnp.isnan(number).all() for number in numbers)
    with pytest.raises(ValueError, match="The stiffness of the spring is -1"):
        js.pull_off(surface(LAWS["exponential"]), spring=-1.0)
    with pytest.raises(ValueError, match=r"spring has shape \(2,\): .* use jax.vmap"):
        js.pull_off(surface(LAWS["exponential"]), spring=jnp.ones(2))


@pytest.mark.nightly
def test_the_point_that_lets_go_is_found_where_the_last_state_lies_before_it():
    # Load stepping stops so far before the release that no reaction there is zero yet.
    random = np.random.default_rng(100)
    random.random(5)
    rms = random.uniform(0.03, 0.08)
    wave = np.fft.fftfreq(8, 1 / 8)
    wave = np.hypot(*np.meshgrid(wave, wave, indexing="ij"))
    filtered = np.where((wave > 0) & (wave <= 2), np.where(wave > 0, wave, 1) ** -1.8, 0)
    heights = np.fft.ifft2(filtered * np.fft.fft2(random.normal(size=(8, 8)))).real
    heights *= rms / heights.std()
    moduli = (1.7524724457530134, 0.2684493121355493), (0.3202643979437919, 0.4868271975531071)
    solid = js.CoatedHalfSpace(js.Grid(8), moduli[0], 0.17998845876104164, moduli[1])

    def found(energy):
        law = js.potentials.Exponential(energy, 0.06784180476343009)
        return js.pull_off(js.Contact(solid, heights, law))

    energy = 0.014722077623478123
    pull = found(energy)
    assert pull.kind == "release"
    # By a dense Newton's method for the reaction, and its differences.
    np.testing.assert_allclose(pull.load.value, -0.0628330269692, rtol=1e-10)
    np.testing.assert_allclose(pull.critical.eigenvalue, -0.0869, rtol=1e-3)
    rate = jax.grad(lambda energy: found(energy).load.value)(energy)
    np.testing.assert_allclose(rate, -4.58231, rtol=1e-5)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_in_single_precision_a_release_is_found_from_states_past_it():
    random, phase = np.random.default_rng(4), 2 * np.pi * np.arange(16) / 16
    waves = [
        np.cos(k * phase + 6 * random.uniform()) * random.uniform(0.5, 1.5) / k for k in (1, 2, 3)
    ]
    grid, heights = js.Grid((16,)), 0.05 * sum(waves)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.01, 0.03))
    pull = js.pull_off(contact)
    assert pull.kind == "release"
    gap, mode = np.asarray(pull.equilibrium.gap), np.asarray(pull.critical.mode)
    move = mode / mode[(gap == 0) & (mode != 0)]
    single = js.Contact(contact.solid, heights.astype("float32"), contact.potential)
    problem = pose(single, js.MeanPressure(pull.load.value.astype("float32")))
    unit = problem.unit
    ahead = jnp.asarray(-1e-6, "float32")
    find = jax.jit(lambda gap: limit_ahead(problem.contact, problem.load, gap, ahead))
    for opening in (1e-8, 1e-7, 1e-6, 1e-5):
        limit = find(jnp.maximum(gap + opening * move, 0).astype("float32"))
        assert limit.kind == "release"
        np.testing.assert_allclose(limit.load.value * unit, pull.load.value, rtol=2e-6)
        eigenvalue = limit.critical.eigenvalue * unit
        np.testing.assert_allclose(eigenvalue, pull.critical.eigenvalue, rtol=1e-4)


@pytest.mark.nightly
@pytest.mark.parametrize("spring", [None, 0.02])
def test_in_single_precision_it_is_that_of_double(spring):
    double = surface(LAWS["exponential"])
    single = js.Contact(double.solid, double.heights.astype("float32"), double.potential)
    found, exact = (js.pull_off(contact, spring=spring) for contact in (single, double))
    assert found.kind == exact.kind == "release"
    np.testing.assert_allclose(found.load.value, exact.load.value, rtol=1e-6)


def test_a_release_is_found_where_the_solver_has_let_go_a_little_before_it():
    random, side = np.random.default_rng(6), np.abs(np.fft.fftfreq(8) * 8)
    waves = np.hypot(*np.meshgrid(side, side, indexing="ij"))
    spectrum = np.where((waves > 0) & (waves <= 4), np.maximum(waves, 1) ** -1.8, 0)
    noise = np.fft.ifftn(np.fft.fftn(random.normal(size=(8, 8))) * spectrum).real
    heights = noise * random.uniform(0.03, 0.08) / noise.std()
    length = random.uniform(0.05, 0.2)
    law = js.potentials.Exponential(random.uniform(1, 8) * length**2, length)
    contact = js.Contact(js.HalfSpace(js.Grid(8), 1.0), heights, law)
    pull = js.pull_off(contact)
    assert pull.kind == "release" and pull.critical.eigenvalue < -0.1
    end = bisected(contact, js.MeanPressure, -0.5, -0.7)
    np.testing.assert_allclose(pull.load.value, end, rtol=1e-6)
