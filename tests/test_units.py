"""Units: what quantities are called and measured in, in metres and elsewhere."""

from pkgutil import iter_modules

import numpy as np
import pytest

import jaxstab as js
from jaxstab.files.labels import measured


def flat(unit=None, heights=None, length=1e-6):
    grid = js.Grid(8, (length, length))
    heights = js.surfaces.sinusoid(grid, 1e-8) if heights is None else heights
    return js.Contact(
        js.HalfSpace(grid, 2e6), heights, js.potentials.Exponential(0.04, 1e-7), unit=unit
    )


def test_plain_heights_can_have_a_unit_and_a_topography_brings_its_own():
    assert flat().unit is None
    assert flat("m").unit == "m" and flat("um").unit == flat("micrometer").unit == "µm"
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
    assert set(names) == {*js.__all__, "__version__"}
    assert {"plots", "potentials", "references", "surfaces", "cases", "files"} <= set(names)
    private = {module.name for module in iter_modules(js.__path__)} - set(js.__all__)
    assert "core" in private and not private & set(names)
    assert "import_module" not in names and all(hasattr(js, name) for name in names)


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


def test_a_file_of_a_line_in_metres_has_joules_per_metre():
    line, square = js.Grid((16,), (1e-6,)), js.Grid(8, (1e-6, 1e-6))
    law = js.potentials.Exponential(0.04, 1e-7)
    for grid, energy, area in ((line, "J/m", "m"), (square, "J", "m^2")):
        heights = js.surfaces.sinusoid(grid, 1e-8)
        contact = js.Contact(js.HalfSpace(grid, 2e6), heights, law, unit="m")
        state = js.equilibrate(contact, js.MeanGap(5e-8))
        dataset = js.to_dataset(contact, js.assess_stability(contact, state))
        assert dataset.cone_eigenvalue.units == "Pa/m"
        assert dataset.barrier_height.units == energy
        assert js.to_dataset(contact, state).area.units == area


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
        ("µm", 3.62e-14, "3.62e-14 [energy]"),
        (None, 2.0, "2 [energy]"),
    ],
)
def test_a_value_reads_with_the_prefix_that_suits_it(unit, value, text):
    assert measured(unit, value, "energy") == text


def test_dimensions_read_in_units_that_are_known():
    assert measured("m", 4e11, "pressure/length") == "400 GPa/m"
    assert measured("m", 0.042, "energy/area") == "42 mJ/m^2"
    assert measured("µm", 2.0, "length") == "2 µm"
    assert measured("µm", 2.0, "pressure/length") == "2 [pressure/µm]"
