"""Files and stores that version 0.1.0 wrote."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray

import jaxstab as js

FOLDER = Path(__file__).parent / "written_by_0_1_0"
VALUES = json.loads((FOLDER / "values.json").read_text())


@pytest.mark.parametrize("name", ["equilibrium", "stability", "sweep", "path", "tip", "layer"])
def test_a_file_of_0_1_0_comes_back_to_the_last_bit(name):
    written = xarray.load_dataset(FOLDER / f"{name}.nc", engine="h5netcdf")
    again = js.to_dataset(*js.load(FOLDER / f"{name}.nc"))
    # The curve of the law is computed as a file is written.
    names = {str(name) for name in written.variables if not str(name).startswith("law_")}
    assert names <= {str(name) for name in again.variables}
    for variable in names:
        one, other = written[variable].to_numpy(), again[variable].to_numpy()
        assert one.shape == other.shape, variable
        assert one.tolist() == other.tolist() or one.tobytes() == other.tobytes(), variable


def test_what_they_hold_is_what_0_1_0_computed():
    found = {
        name: js.load(FOLDER / f"{name}.nc")[1]
        for name in ("equilibrium", "stability", "sweep", "path", "tip", "layer")
    }
    assert float(found["equilibrium"].mean_pressure) == VALUES["equilibrium.mean_pressure"]
    assert float(found["equilibrium"].energy) == VALUES["equilibrium.energy"]
    assert float(found["stability"].cone.eigenvalue) == VALUES["stability.cone"]
    assert len(found["path"].jumps) == VALUES["path.jumps"]
    assert len(found["path"].load.value) == VALUES["path.states"]
    assert float(found["layer"].mean_pressure) == VALUES["layer.mean_pressure"]
    contact, tip = js.load(FOLDER / "tip.nc")
    force = float(tip.mean_pressure * contact.grid.area)
    np.testing.assert_allclose(force, VALUES["tip.force"], rtol=1e-15)
    areas = found["sweep"].equilibrium.contact_area
    assert np.asarray(areas).tolist() == VALUES["sweep.contact_area"]
