"""Electrostatic and capillary laws, and sums of laws: formulae, files, fits, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import state_of
from saved import assert_same_bits

import jaxstab as js
from jaxstab.potentials import curvature, energy_density, slope

GAPS = jnp.linspace(0.0, 3.0, 25).reshape(5, 5)
ELECTRIC = js.potentials.Electrostatic(0.3, 0.8, dielectric=0.2)
EXPONENTIAL = js.potentials.Exponential(0.02, 0.3)
GAP = jnp.linspace(0.0, 0.2, 64).reshape(8, 8)
DERIVATIVES = (energy_density, slope, curvature)


def contact_of(law):
    grid = js.Grid(8)
    return js.Contact(js.HalfSpace(grid, 1.0), js.surfaces.sinusoid(grid, 0.05), law)


def assert_same_law(one, other, rtol=1e-12):
    for derivative in DERIVATIVES:
        np.testing.assert_allclose(derivative(one, GAPS), derivative(other, GAPS), rtol=rtol)


def test_electrodes_attract_as_a_capacitor():
    distance = np.asarray(GAPS) + 0.2
    strength = 0.8 * 0.3**2 / 2
    closed = (-strength / distance, strength / distance**2, -2 * strength / distance**3)
    for derivative, values in zip(DERIVATIVES, closed, strict=True):
        np.testing.assert_allclose(derivative(ELECTRIC, GAPS), values, rtol=1e-12)


def test_menisci_draw_by_laplaces_pressure_over_their_range():
    tension, angle, radius = 0.07, 0.4, 0.5
    law = js.potentials.Capillary(tension, angle, radius, smoothing=0.01)
    reach = 2 * radius * np.cos(angle)
    inside, outside = jnp.linspace(0, 0.9 * reach, 7), jnp.linspace(1.1 * reach, 3, 7)
    np.testing.assert_allclose(slope(law, inside), tension / radius, rtol=1e-4)
    np.testing.assert_allclose(slope(law, outside), 0, atol=1e-4)
    np.testing.assert_allclose(law(0.0), -2 * tension * np.cos(angle), rtol=1e-12)
    work = 2 * tension * np.cos(angle)
    smooth = js.potentials.Capillary(tension, angle, radius)
    assert_same_law(smooth, js.potentials.Dugdale(work, reach), 1e-10)


def test_menisci_of_water_have_the_published_radii_of_kelvin():
    # Israelachvili (2011), chapter 17: 0.54 nm over |ln H| at 20 degrees Celsius. In a spherical
    # meniscus, of two equal radii, it is 10, 1.6 and 0.5 nm at 90, 50 and 10 %.
    humidity = np.array([np.exp(-1), 0.9, 0.5, 0.1])
    radius = js.potentials.Capillary.at_humidity(humidity, 0.0728).radius
    assert radius[0] == pytest.approx(0.54e-9, abs=0.005e-9)
    np.testing.assert_allclose(2 * radius[1:], [10e-9, 1.6e-9, 0.5e-9], rtol=0.07)
    assert radius[2] == pytest.approx(0.777e-9, rel=2e-3)
    # Butt and Kappl, Adv. Colloid Interface Sci. 146, 48 (2009): 0.52 nm at 25 degrees.
    warm = js.potentials.Capillary.at_humidity(np.exp(-1), 0.072, temperature=298.15)
    assert warm.radius == pytest.approx(0.52e-9, abs=0.006e-9)
    # Cyclohexane at 20 degrees: 0.0253 J/m^2 and 84.16 g/mol over 0.7785 g/cm^3.
    cyclohexane = js.potentials.Capillary.at_humidity(0.7, 0.0253, molar_volume=108.1e-6)
    expected = 0.0253 * 108.1e-6 / (8.314 * 293.15 * np.log(1 / 0.7))
    assert cyclohexane.radius == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("unit", "length"), [("MPa", 1e-6), ("GPa", 1e-9), ("kPa", 1e-3)])
def test_menisci_at_a_humidity_are_the_same_in_other_units(unit, length):
    si = js.potentials.Capillary.at_humidity(0.3, 0.0728, 0.2)
    # The tension in the pressure's unit times this length has the same number as in SI.
    law = js.potentials.Capillary.at_humidity(np.float32(0.3), 0.0728, 0.2, pressure_unit=unit)
    assert law.radius * length == pytest.approx(float(si.radius), rel=1e-6)
    assert (law.tension, law.angle) == (si.tension, si.angle)
    with pytest.raises(ValueError, match="unit of pressure is 'bar': choose one of Pa"):
        js.potentials.Capillary.at_humidity(0.3, 0.0728, pressure_unit="bar")


def test_the_attraction_of_menisci_is_the_pressure_of_kelvin():
    # R T / V |ln H| whatever the tension, over a range that grows with it.
    suction = 8.314 * 293.15 / 18.05e-6 * np.log(2) / 1e6
    for tension in (0.03, 0.07):
        law = js.potentials.Capillary.at_humidity(0.5, tension, pressure_unit="MPa", smoothing=0.01)
        np.testing.assert_allclose(slope(law, jnp.array([1e-5])), suction, rtol=1e-4)


def test_a_sum_is_the_sum_however_it_is_written():
    def mine(gap):
        return -0.01 / (1 + gap) ** 2

    for law in (
        ELECTRIC + EXPONENTIAL + mine,
        mine + (ELECTRIC + EXPONENTIAL),
        js.potentials.Sum((EXPONENTIAL, mine, ELECTRIC)),
        sum([ELECTRIC, EXPONENTIAL, mine]),
    ):
        assert len(law.laws) == 3
        for derivative in DERIVATIVES:
            parts = sum(derivative(part, GAPS) for part in (ELECTRIC, EXPONENTIAL, mine))
            np.testing.assert_allclose(derivative(law, GAPS), parts, rtol=1e-12)
    assert "Electrostatic(voltage=0.3" in repr(ELECTRIC + EXPONENTIAL)


@pytest.mark.nightly
def test_a_sum_is_solved_with_in_si_units_as_in_others():
    grid = js.Grid(16, 2e-6)
    heights = js.surfaces.sinusoid(grid, 4e-8)
    metal = js.potentials.Electrostatic(10.0, 8.854e-12, 2e-8)
    menisci = js.potentials.Capillary(0.072, 0.3, 2e-9)
    contact = js.Contact(js.HalfSpace(grid, 5e9), heights, metal + menisci)
    state = js.equilibrate(contact, js.MeanDisplacement(2e-8))
    micro = js.Grid(16, 2.0)
    # In µm, MPa and V: energies per area in 1 J/m^2.
    same = js.Contact(
        js.HalfSpace(micro, 5e3),
        heights * 1e6,
        js.potentials.Electrostatic(10.0, 8.854e-6, 2e-2)
        + js.potentials.Capillary(0.072, 0.3, 2e-3),
    )
    other = js.equilibrate(same, js.MeanDisplacement(2e-2))
    np.testing.assert_allclose(1e-6 * state.mean_pressure, other.mean_pressure, rtol=1e-7)


@pytest.mark.nightly
def test_sums_come_back_from_files(tmp_path):
    energies = 0.01 + 0.01 * jax.random.uniform(jax.random.key(0), (8, 8))
    part = js.potentials.Varying(js.potentials.Exponential(energies, 0.3))
    law = ELECTRIC + part + js.potentials.Capillary(0.01, 0.2, 0.1)
    contact, state = state_of(contact_of(law), GAP)
    again, _ = js.load(js.save(tmp_path / "sum.nc", contact, state))
    assert_same_bits(again, contact)
    dataset = js.to_dataset(contact, state)
    (name,) = [name for name in dataset if str(name).endswith("voltage")]
    assert dataset[name].attrs["units"] == "voltage"


def test_of_a_function_in_a_sum_a_file_asks_for_the_law(tmp_path):
    def mine(gap):
        return -0.01 * jnp.exp(-gap)

    contact, state = state_of(contact_of(EXPONENTIAL + mine), GAP)
    with pytest.warns(UserWarning, match="no formula"):
        path = js.save(tmp_path / "mine.nc", contact, state)
    with pytest.raises(ValueError, match="the file holds values only"):
        js.equilibrate(js.load(path)[0], state.load)
    again, _ = js.load(path, potential=EXPONENTIAL + mine)
    assert_same_law(again.potential, contact.potential)


@pytest.mark.nightly
def test_electrodes_without_a_dielectric_need_a_core():
    bare = js.potentials.Electrostatic(0.01, 0.8)
    with pytest.raises(ValueError, match=r"is -inf: .* needs a `dielectric`"):
        contact_of(bare + EXPONENTIAL)
    contact = contact_of(bare + js.potentials.LennardJones(0.02, 0.3))
    assert contact.has_core
    assert js.equilibrate(contact, js.MeanGap(0.4)).gap.min() > 0.1


def test_only_functions_can_be_added():
    with pytest.raises(TypeError, match="unsupported operand"):
        EXPONENTIAL + 1.0
    with pytest.raises(TypeError, match="unsupported operand"):
        1.0 + EXPONENTIAL
