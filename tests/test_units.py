"""Units: what quantities are called and measured in, in metres and elsewhere."""

from pkgutil import iter_modules

import numpy as np
import pytest

import jaxstab as js


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
    assert "balance" in private and not private & set(names)
    assert "import_module" not in names and all(hasattr(js, name) for name in names)
