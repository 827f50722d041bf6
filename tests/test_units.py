"""Units: what quantities are called and measured in, in metres and elsewhere."""

from dataclasses import replace
from pkgutil import iter_modules

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab import plots
from jaxstab.core.units import Units, unit_symbol


def flat(unit=None, heights=None, length=1e-6):
    grid = js.Grid(8, (length, length))
    heights = js.surfaces.sinusoid(grid, 1e-8) if heights is None else heights
    return js.Contact(
        js.HalfSpace(grid, 2e6), heights, js.potentials.Exponential(0.04, 1e-7), unit=unit
    )


def test_plain_heights_can_have_a_unit_and_a_topography_brings_its_own():
    assert flat().unit is None
    assert flat("m").unit == "m" and flat("um").unit == "µm"
    grid = js.Grid(8, (1e-6, 1e-6))
    heights = np.asarray(js.surfaces.sinusoid(grid, 1e-8))
    measured = js.surfaces.Topography(grid, heights, "m", is_periodic=True)
    unknown = js.surfaces.Topography(grid, heights, is_periodic=True)
    assert flat(None, measured).unit == flat("m", measured).unit == "m"
    assert flat("m", unknown).unit == "m"
    with pytest.raises(ValueError, match=r"unit is nm, the topography is in m: .*in_unit"):
        flat("nm", measured)
    with pytest.raises(ValueError, match="the unit is 'parsec': choose one of km, m"):
        flat("parsec")
    assert "unit" in repr(flat("m")) and "unit" not in repr(flat())


def test_the_names_that_python_lists_are_the_public_ones():
    names = dir(js)
    assert names == js.__all__
    assert {"plots", "potentials", "references", "surfaces", "results"} <= set(names)
    private = {module.name for module in iter_modules(js.__path__)} - set(js.__all__)
    assert "core" in private and not private & set(names)
    assert "import_module" not in names and all(hasattr(js, name) for name in names)
    rooms = [js.exceptions, js.plots, js.potentials, js.references, js.results, js.solids]
    for room in [*rooms, js.solvers, js.surfaces]:
        assert dir(room) == sorted(room.__all__)


def test_the_root_holds_few_names_and_says_where_others_are():
    assert len(js.__all__) < 65
    rooms = [js.results, js.solvers, js.exceptions, js.solids]
    classes = {name: room for room in rooms for name in room.__all__ if name not in js.__all__}
    assert {"Path", "Davidson", "SolverError", "Spectral"} <= set(classes)
    for name, room in classes.items():
        with pytest.warns(DeprecationWarning, match=rf"{name} is now {room.__name__}\.{name}\."):
            assert getattr(js, name) is getattr(room, name)
    with pytest.warns(DeprecationWarning, match=r"jaxstab\.release is now jaxstab\.relax_along"):
        assert js.release is js.relax_along
    with pytest.raises(AttributeError, match="Paths"):
        _ = js.Paths


def test_a_file_in_metres_has_si_units_and_si_numbers(tmp_path):
    contact = flat("m")
    state = js.equilibrate(contact, js.MeanGap(5e-8))
    for held in (contact, state), js.load(js.save(tmp_path / "run.nc", contact, state)):
        dataset = js.to_dataset(*held)
        units = {
            "x": "m",
            "gap": "m",
            "mean_pressure": "Pa",
            "energy": "J",
            "area": "m^2",
            "potential_surface_energy": "J/m^2",
            "law_gap": "m",
            "law_energy": "J/m^2",
            "law_attraction": "Pa",
            "solid_youngs_modulus": "Pa",
        }
        assert {name: dataset[name].units for name in units} == units
        assert float(dataset.energy) == float(state.energy)
        assert dataset.attrs["unit_of_length"] == "m"
        assert dataset.potential_surface_energy.long_name == "work of adhesion"
    assert js.to_dataset(flat(), state).energy.units == "energy"


# Powers of ten of the SI brochure, and values written by hand.
@pytest.mark.parametrize(
    ("unit", "value", "text"),
    [
        ("m", 3.62e-14, "36.2 fJ"),
        ("m", 0.0, "0 J"),
        ("m", -2.5e-6, "-2.5 µJ"),
        ("m", 1e-6, "1 µJ"),
        ("m", 999e-9, "999 nJ"),
        ("m", 2e15, "2e+03 TJ"),
        ("µm", 3.62e-14, "3.62e-14"),
        (None, 2.0, "2"),
    ],
)
def test_a_value_reads_with_the_prefix_that_suits_it(unit, value, text):
    assert Units.of_names(unit, None).text(value, "energy") == text


def test_no_prefix_is_hidden_or_raised_to_a_power():
    assert Units("m", "Pa").text(1.23e-6, "length/time") == "1.23e-06"
    # A conductance is one over the resistivity that the user gave.
    assert Units("m", "Pa").text(1.23e-6, "length/resistivity") == "1.23 µm/resistivity"
    assert Units().text(1.23e-6, "length/resistivity") == "1.23e-06"
    # The square of 1 MPa µm^2 = 1e-6 N.
    assert unit_symbol(Units("µm", "MPa"), "force^2") == "1e-12 N^2"
    assert Units("m", "Pa").text(3e-12, "force^2") == "3e-12 N²"


# In SI units by hand: 1 MPa µm^2 = 1e6 * 1e-12 N, and so on. The last is no power of a thousand.
@pytest.mark.parametrize(
    ("units", "symbols"),
    [
        (("µm", "MPa"), ("µN", "pJ", "J/m^2", "N/m", "MPa/µm", "µJ/(V^2 m)", "µm^2")),
        (("nm", "GPa"), ("nN", "aJ", "J/m^2", "N/m", "GPa/nm", "nJ/(V^2 m)", "nm^2")),
        (("mm", "MPa"), ("N", "mJ", "kJ/m^2", "kN/m", "MPa/mm", "J/(V^2 m)", "mm^2")),
        (("m", "Pa"), ("N", "J", "J/m^2", "N/m", "Pa/m", "J/(V^2 m)", "m^2")),
        (
            ("Å", "GPa"),
            ("1e-11 N", "1e-21 J", "1e-1 J/m^2", "1e-1 N/m", "GPa/Å", "1e-11 J/(V^2 m)", "Å^2"),
        ),
        (("µm", "MPa", 1), ("N/m", "µJ/m", "J/m^2", "MPa", "MPa/µm", "µJ/(V^2 m)", "µm")),
    ],
)
def test_compound_units_follow_from_lengths_and_pressures(units, symbols):
    dimensions = (
        "force",
        "energy",
        "energy/area",
        "force/length",
        "pressure/length",
        "energy/(voltage^2 length)",
        "length^2",
    )
    assert tuple(unit_symbol(Units(*units), each) for each in dimensions) == symbols


def small_contact():
    grid = js.Grid(8, (3.0, 3.0))
    heights = js.surfaces.sinusoid(grid, 0.05)
    law = js.potentials.Exponential(0.01, 0.1)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law, unit="um", pressure_unit="MPa")


def test_the_unit_of_pressure_is_checked_and_is_pascal_in_metres():
    assert flat("m").pressure_unit == "Pa" and flat("nm").pressure_unit is None
    contact = small_contact()
    assert (contact.unit, contact.pressure_unit) == ("µm", "MPa")
    arguments = contact.solid, contact.heights, contact.potential
    with pytest.raises(ValueError, match="unit of pressure is 'psi': choose one of Pa, kPa, MPa"):
        js.Contact(*arguments, pressure_unit="psi")
    scan = js.surfaces.Topography(contact.grid, np.asarray(contact.heights), "um", is_periodic=True)
    from_scan = js.Contact(contact.solid, scan, contact.potential, pressure_unit="MPa")
    assert (from_scan.unit, from_scan.pressure_unit) == ("µm", "MPa")


@pytest.mark.nightly
def test_tables_show_the_units_of_the_contact():
    contact = small_contact()
    sweep = js.sweep(contact, js.MeanGap(jnp.array([0.3, 0.05])))
    heading = str(sweep).splitlines()[0]
    for column in ("MeanGap [µm]", "mean pressure [MPa]", "cone [MPa/µm]"):
        assert column in heading
    assert "force" not in heading
    for text, lines in (
        (str(contact), ["µm", "1 MPa,", "surface_energy=0.01 J/m², length=0.1 µm"]),
        (str(sweep[0].equilibrium), ["MeanGap(value=0.3 µm)", " MPa\n", " pJ\n", "9 µm²\n"]),
        (str(sweep[0].stability), [" MPa/µm, residual"]),
        (str(js.patches(contact, sweep[1])), [" µm²\n", " µN\n"]),
        (str(js.leakage(contact, sweep[0])), [" µm³\n"]),
        (str(js.observe(contact, sweep, js.patches)), ["true area [µm²]"]),
    ):
        assert all(line in text for line in lines), text


def test_an_error_has_one_digit_and_the_unit_of_its_number():
    units = Units("m", "Pa")
    assert units.text(3214.0, "pressure", error=38.0) == "3.21 ± 0.04 kPa"
    assert units.text(2e-4, "energy/area", error=0.0123) == "0.2 ± 10 mJ/m²"
    assert Units().text(3214.0, "pressure", error=38.0) == "3.21e+03 ± 40"


def test_forces_and_energies_are_shown_in_the_units_that_were_chosen():
    contact = small_contact()
    parts = contact.solid, contact.heights, contact.potential
    names = {"unit": "um", "pressure_unit": "MPa", "force_unit": "uN", "energy_unit": "aJ"}
    chosen = js.Contact(*parts, **names)
    assert (chosen.force_unit, chosen.energy_unit) == ("µN", "aJ")
    state = js.equilibrate(chosen, js.MeanGap(0.3))
    # Results keep their numbers, in pJ: 1 pJ is 1e6 aJ.
    assert float(state.energy) == float(js.equilibrate(contact, js.MeanGap(0.3)).energy)
    (line,) = (line for line in str(state).splitlines() if line.startswith("  energy"))
    number, unit = line.split()[1:]
    np.testing.assert_allclose(float(number), 1e6 * state.energy, rtol=1e-5)
    assert unit == "aJ" and js.to_dataset(chosen, state).energy.units == "pJ"
    # By hand: 1 MPa µm^2 is 1 µN, and a strip of a line has 1 MPa µm = 1 N/m.
    pinned = Units("µm", "MPa", force="kN", energy="fJ")
    assert pinned.text(5e12, "force") == "5e+03 kN"
    assert pinned.text(2.0, "energy") == "2e+03 fJ"
    assert pinned.text(2.0, "energy/area") == "2 J/m²"
    assert pinned._replace(sides=1).text(2e3, "force") == "2 kN/m"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"unit": "m", "force_unit": "lbf"}, "unit of force is 'lbf': choose one of aN, fN"),
        ({"unit": "m", "energy_unit": "nN"}, "unit of energy is 'nN': choose one of aJ, fJ"),
        ({"force_unit": "nN"}, "force is 'nN', but that of length is unknown: give both"),
        ({"unit": "um", "energy_unit": "pJ"}, "energy is 'pJ', but that of pressure is unknown"),
    ],
)
def test_a_unit_of_force_or_energy_needs_those_of_length_and_pressure(names, message):
    with pytest.raises(ValueError, match=message):
        Units.of_names(
            names.get("unit"), None, force=names.get("force_unit"), energy=names.get("energy_unit")
        )


@pytest.mark.nightly
def test_branches_and_their_ends_show_the_units_of_the_contact():
    contact, ends = small_contact(), js.MeanGap(jnp.array([0.3, 0.05]))
    assert "MeanGap 0.3 µm to 0.05 µm in" in str(js.continuation(contact, ends))
    assert "MPa" in str(js.critical_load(contact, ends[::-1], throw=False))


@pytest.fixture(scope="module")
def probe():
    grid = js.Grid(16, (60.0, 60.0))
    tip, law = js.surfaces.paraboloid(grid, 20.0), js.potentials.Exponential(0.05, 1.5)
    solid = js.FreeHalfSpace(grid, 0.1)
    return js.Contact(solid, tip, law, unit="nm", pressure_unit="GPa")


def test_a_window_shows_forces_in_a_readable_unit(probe):
    sweep = js.sweep(probe, js.FarDisplacement(jnp.array([4.0, 2.0])), stability=False)
    assert "force [nN]" in str(sweep).splitlines()[0] and "mean pressure [GPa]" in str(sweep)
    state = sweep[1].equilibrium
    (line,) = (line for line in str(state).splitlines() if line.startswith("  force"))
    number, unit = line.split()[1:]
    # The area of the cell is 3600 nm^2, and 1 GPa nm^2 is 1 nN.
    np.testing.assert_allclose(float(number), 3600 * state.mean_pressure, rtol=1e-5)
    assert unit == "nN"
    # In a trace there is no number.
    texts = []
    jax.eval_shape(lambda state: texts.append(str(state)) or state.force, state)
    assert "  mean_pressure" in texts[0] and "  force" not in texts[0]


def check_drawn_forces(path):
    axes = plots.path(path)
    assert axes.get_ylabel() == "force [nN]" and axes.get_xlabel().endswith("[nm]")
    drawn = np.concatenate([line.get_ydata() for line in axes.lines if line.get_marker() == "."])
    np.testing.assert_allclose(drawn.min(), path.equilibrium.force.min())
    assert plots.path(path, y="mean_pressure").get_ylabel() == "mean pressure $p_0$ [GPa]"
    soft = replace(path, equilibrium=replace(path.equilibrium, units=Units("nm", "kPa")))
    assert plots.path(soft).get_ylabel() == "force [fN]"


def test_a_path_on_a_window_is_drawn_by_its_forces(loop):
    # Another contact's path, which other tests have followed, as if it were one.
    area = jnp.full_like(loop.equilibrium.mean_pressure, 2.0)
    states = replace(loop.equilibrium, is_window=True, area=area, units=Units("nm", "GPa"))
    load = js.FarDisplacement(loop.load.value)
    np.testing.assert_allclose(states.force, 2 * states.mean_pressure)
    check_drawn_forces(replace(loop, load=load, equilibrium=states))


@pytest.mark.nightly
def test_a_window_is_followed_and_its_path_drawn_by_its_forces(probe):
    check_drawn_forces(js.follow(probe, js.FarDisplacement(jnp.array([4.0, 2.0, 4.0]))))


def test_files_keep_both_units(tmp_path, probe):
    state = js.equilibrate(probe, js.FarDisplacement(3.0))
    dataset = js.to_dataset(probe, state)
    assert dataset.attrs["unit_of_length"] == "nm" and dataset.attrs["unit_of_pressure"] == "GPa"
    assert dataset.energy.units == "aJ" and dataset.solid_youngs_modulus.units == "GPa"
    assert dataset.potential_surface_energy.units == "J/m^2"
    assert dataset.contact_area.units == "1"
    contact, loaded = js.load(js.save(tmp_path / "run.nc", probe, state))
    assert (contact.unit, contact.pressure_unit) == ("nm", "GPa")
    assert str(loaded) == str(state) and "nN" in str(loaded)


@pytest.mark.parametrize(
    ("largest", "expected"),
    [
        (4.2e4, (1e3, "kPa")),
        (-999.0, (1.0, "Pa")),
        (1e9, (1e9, "GPa")),
        (0.0, (1.0, "Pa")),
        (np.nan, (1.0, "Pa")),
        (3e-20, (1e-18, "aPa")),
        (1e17, (1e12, "TPa")),
    ],
)
def test_a_prefix_suits_the_largest_number(largest, expected):
    assert js.units.prefixed(largest, "Pa") == expected
