"""Curves of Bruker and Nanosurf, in the form in which their programs write them."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import jaxstab as js

CONSTANT, SENSITIVITY = 0.0538362, 60e-9
RAMP = np.linspace(0, 2500, 400)
# A contact at 1500 nm of the ramp, and a pull-off at 1300 nm [pN].
EXTENSION = 20.0 * np.maximum(RAMP - 1500, 0)
RETRACTION = np.where(RAMP > 1300, 20.0 * (RAMP - 1500), 0.0)
HEADER = "\\*Force file list\n\\Spring Constant: 0.0538362\n\\*Force file list end\n"


def written(path, columns, header="", separator="\t"):
    """Write an export of NanoScope: columns of the extension and of the retraction in turn."""
    rows = zip(*columns.values(), strict=True)
    lines = [separator.join("" if np.isnan(x) else f"{x:.6f}" for x in row) for row in rows]
    path.write_text(header + separator.join(columns) + "\n" + "\n".join(lines) + "\n")
    return path


def exported(name, extension, retraction):
    """Return the columns of a ramp in nm and of a deflection, both from the far end on."""
    return {
        "Calc_Ramp_Ex_nm": RAMP,
        "Calc_Ramp_Rt_nm": RAMP,
        f"Defl_{name}_Ex": extension,
        f"Defl_{name}_Rt": retraction,
    }


@pytest.mark.parametrize(
    ("unit", "per_piconewton"),
    [("pN", 1.0), ("nm", 1e-3 / CONSTANT), ("V", 1e-12 / CONSTANT / SENSITIVITY)],
)
def test_an_export_of_nanoscope(tmp_path, unit, per_piconewton):
    columns = exported(unit, EXTENSION * per_piconewton, RETRACTION * per_piconewton)
    path = written(tmp_path / "ramp.spm.txt", columns, HEADER)
    curve = js.lab.force_curves.read(path, sensitivity=SENSITIVITY if unit == "V" else None)
    assert curve.spring_constant == pytest.approx(CONSTANT)
    assert curve.instrument == "Bruker NanoScope"
    np.testing.assert_allclose(curve.approach.force, EXTENSION * 1e-12, atol=2e-13)
    np.testing.assert_allclose(curve.approach.height, -RAMP * 1e-9, atol=1e-15)
    # The retraction goes away from the sample.
    np.testing.assert_allclose(curve.retraction.force, RETRACTION[::-1] * 1e-12, atol=2e-13)
    assert np.all(np.diff(curve.retraction.height) > 0)
    assert curve.approach.time is None


def test_times_order_an_export_and_the_sensor_is_its_height(tmp_path):
    time = np.linspace(0, 1, 400)
    short = np.where(np.arange(400) < 390, 1.0, np.nan)
    columns = {
        "Time_s_Ex": time,
        "Time_s_Rt": 1 + time[::-1],
        **exported("pN", EXTENSION * short, RETRACTION),
        "Height_Sensor_nm_Ex": RAMP + 3,
        "Height_Sensor_nm_Rt": RAMP + 3,
        "Defl_Lsb_Ex": np.zeros(400),
    }
    curve = js.lab.force_curves.read(written(tmp_path / "ramp.txt", columns), spring_constant=0.1)
    assert len(curve.approach) == 390
    np.testing.assert_allclose(curve.approach.height, -(RAMP[:390] + 3) * 1e-9, atol=1e-15)
    assert np.all(np.diff(curve.retraction.time) > 0) and np.all(
        np.diff(curve.retraction.height) > 0
    )


def test_exports_that_lack_something_are_refused(tmp_path):
    volts = exported("V", EXTENSION, RETRACTION)
    path = written(tmp_path / "ramp.txt", volts)
    with pytest.raises(ValueError, match=r"no force without the cantilever.*sensitivity=50e-9"):
        js.lab.force_curves.read(path)
    other = written(tmp_path / "other.txt", exported("pN", EXTENSION, RETRACTION), HEADER)
    with pytest.raises(ValueError, match=r"spring constant is 0\.0538362"):
        js.lab.force_curves.read(other, spring_constant=0.2)
    commas = tmp_path / "commas.txt"
    commas.write_text(other.read_text().replace(".", ","))
    with pytest.raises(ValueError, match="export it with points"):
        js.lab.force_curves.read(commas, spring_constant=0.2)
    binary = tmp_path / "ramp.spm"
    binary.write_bytes(b"\\*Force file list\r\n\\Version: 0x09400202\r\n\x1a" + bytes(range(256)))
    with pytest.raises(ValueError, match="export the curve as text"):
        js.lab.force_curves.read(binary)


def test_a_map_of_nanosurf():
    pytest.importorskip("NSFopen")
    example = Path("example") / "Force_Spectroscopy" / "spectroscopy.nid"
    path = Path(find_spec("NSFopen").origin).parent / example
    curves = js.lab.force_curves.read(path)
    assert len(curves) == 100
    # As the example of NSFopen takes them: a spring constant of 2.72 N/m, and forces up to 272 nN.
    assert curves[0].spring_constant == pytest.approx(2.72436)
    forces = [curve.approach.force.max() for curve in curves]
    np.testing.assert_allclose(forces, 2.72436e-7, rtol=0.1)
    assert all(np.ptp(curve.approach.height) > 9e-7 for curve in curves)
    assert all(curve.retraction.height[-1] > curve.retraction.height[0] for curve in curves)


def test_another_file_of_nanosurf_is_refused(tmp_path):
    path = tmp_path / "curve.nhf"
    path.write_bytes(b"\x89HDF\r\n")
    with pytest.raises(ValueError, match=r"save the curves as \.nid, or text"):
        js.lab.force_curves.read(path)
    pytest.importorskip("NSFopen")
    path = tmp_path / "curve.nid"
    path.write_bytes(b"[DataSet]\r\n")
    with pytest.raises(ValueError, match="NSFopen cannot read it"):
        js.lab.force_curves.read(path)
