"""Files with several channels: which is read, and the remark on it."""

import numpy as np
import pytest
import xarray
from surface_files import HEIGHTS, SIDES, as_npy, as_text, gwy_field, gwy_object, gwy_part, x, y

import jaxstab as js
from jaxstab.__main__ import main


def gwy_of(*channels):
    """Return a file of Gwyddion: of each channel title, unit, values."""
    parts = []
    for i, (title, unit, values) in enumerate(channels):
        parts.append(gwy_part(f"/{i}/data", "o", gwy_field(values, unit)))
        parts.append(gwy_part(f"/{i}/data/title", "s", title.encode() + b"\0"))
    return b"GWYP" + gwy_object("GwyContainer", *parts)


THREE = gwy_of(
    ("Phase", "deg", 7 * HEIGHTS),
    ("Trace", "m", 1e-6 * HEIGHTS),
    ("Retrace", "m", 2e-6 * HEIGHTS),
)


def test_of_an_instrument_the_first_channel_of_heights_is_read_and_any_can_be_chosen(tmp_path):
    path = tmp_path / "a.gwy"
    path.write_bytes(THREE)
    default = js.surfaces.read(path)
    np.testing.assert_allclose(default.in_unit("µm").heights, HEIGHTS, rtol=1e-14)
    said = "channel 'Trace' of 'Trace', 'Retrace', chosen by default: give another as `channel=`"
    assert default.remarks == (said,)
    assert said in str(default)
    for name, factor in {"Trace": 1, "Retrace": 2}.items():
        topography = js.surfaces.read(path, channel=name)
        np.testing.assert_allclose(topography.in_unit("µm").heights, factor * HEIGHTS, rtol=1e-14)
        assert topography.remarks == (f"channel '{name}' of 'Trace', 'Retrace'",)
    for name in ("Height", "Phase", ""):
        message = rf"a\.gwy: it has no channel '{name}' of heights: .* 'Trace', 'Retrace'\."
        with pytest.raises(ValueError, match=message):
            js.surfaces.read(path, channel=name)


def test_a_file_without_heights_is_refused(tmp_path):
    (tmp_path / "a.gwy").write_bytes(gwy_of(("Phase", "deg", HEIGHTS), ("Bias", "V", HEIGHTS)))
    with pytest.raises(ValueError, match=r"a\.gwy: .*it has no channel of heights"):
        js.surfaces.read(tmp_path / "a.gwy")


def test_values_of_no_length_are_no_heights(tmp_path, monkeypatch):
    # As SurfaceTopography has phases of .di files: as heights, with a pair of units.
    from SurfaceTopography.IO.Reader import ChannelInfo

    (tmp_path / "a.gwy").write_bytes(THREE)
    unit = property(lambda self: ("m", None) if self.name == "Trace" else "m")
    monkeypatch.setattr(ChannelInfo, "unit", unit)
    topography = js.surfaces.read(tmp_path / "a.gwy")
    np.testing.assert_allclose(topography.in_unit("µm").heights, 2 * HEIGHTS, rtol=1e-14)
    with pytest.raises(ValueError, match="no channel 'Trace' of heights: choose from 'Retrace'"):
        js.surfaces.read(tmp_path / "a.gwy", channel="Trace")


def test_channels_of_one_name_are_told_apart(tmp_path):
    (tmp_path / "a.gwy").write_bytes(gwy_of(("Z", "m", 1e-6 * HEIGHTS), ("Z", "m", 3e-6 * HEIGHTS)))
    topography = js.surfaces.read(tmp_path / "a.gwy", channel="Z#2")
    np.testing.assert_allclose(topography.in_unit("µm").heights, 3 * HEIGHTS, rtol=1e-14)


def test_variables_of_netcdf_are_channels(tmp_path):
    coordinates = {"x": ("x", x[:, 0], {"units": "um"}), "y": ("y", y[0], {"units": "um"})}
    maps = {"first": (("x", "y"), HEIGHTS), "second": (("x", "y"), 2 * HEIGHTS)}
    xarray.Dataset(maps, coordinates).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=r"several arrays, first, second: name .* or choose"):
        js.surfaces.read(tmp_path / "a.nc")
    with pytest.raises(ValueError, match=r"no channel 'third' of heights: .* 'first', 'second'"):
        js.surfaces.read(tmp_path / "a.nc", channel="third")
    second = js.surfaces.read(tmp_path / "a.nc", channel="second")
    np.testing.assert_array_equal(second.heights, 2 * HEIGHTS)
    assert second.remarks[0] == "channel 'second' of 'first', 'second'"
    maps["heights"] = maps.pop("first")
    xarray.Dataset(maps, coordinates).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    default = js.surfaces.read(tmp_path / "b.nc")
    np.testing.assert_array_equal(default.heights, HEIGHTS)
    assert "channel 'heights' of 'second', 'heights', chosen by default" in str(default)


def test_arrays_of_npz_are_channels(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, heights=HEIGHTS, other=2 * HEIGHTS, lengths=SIDES)
    default = js.surfaces.read(path, unit="nm")
    np.testing.assert_array_equal(default.heights, HEIGHTS)
    assert (default.unit, default.grid.shape) == ("nm", HEIGHTS.shape)
    np.testing.assert_array_equal(js.surfaces.read(path, channel="other").heights, 2 * HEIGHTS)
    with pytest.raises(ValueError, match="no channel 'up' of heights: choose from 'heights', 'oth"):
        js.surfaces.read(path, channel="up")
    np.savez(path, lengths=SIDES)
    with pytest.raises(ValueError, match=r"a\.npz: it has no array of heights"):
        js.surfaces.read(path)
    np.savez(path, x=x, y=y, z=HEIGHTS, lengths=SIDES)
    with pytest.raises(ValueError, match=r"several arrays, x, y, z: name .* or choose one as"):
        js.surfaces.read(path)
    np.testing.assert_array_equal(js.surfaces.read(path, channel="z").heights, HEIGHTS)
    np.savez(path, HEIGHTS[:7], lengths=1.4)
    np.testing.assert_allclose(js.surfaces.read(path).lengths, [1.4, 1.4])


@pytest.mark.parametrize("write", [as_text, as_npy])
def test_a_file_of_one_surface_has_no_channels(tmp_path, write):
    write(tmp_path / "a")
    with pytest.raises(ValueError, match="no channel 'Z' of heights: choose from 'heights'"):
        js.surfaces.read(tmp_path / "a", SIDES, channel="Z")


def test_the_command_line_reads_a_channel(tmp_path, capsys):
    (tmp_path / "a.gwy").write_bytes(THREE)
    main(["info", str(tmp_path / "a.gwy"), "--channel", "Retrace"])
    assert "channel 'Retrace' of 'Trace', 'Retrace'" in capsys.readouterr().out
    for option, message in {"--channel": "choose from 'Trace'", "--import": "a surface"}.items():
        with pytest.raises(SystemExit):
            main(["info", str(tmp_path / "a.gwy"), option, "json"])
        assert message in capsys.readouterr().err


@pytest.mark.nightly
def test_heights_of_a_result_count_from_zero(tmp_path):
    grid = js.Grid((8, 12), (2.0, 3.0))
    heights = 10 + 0.1 * np.cos(2 * np.pi * np.arange(8) / 8)[:, None] * np.ones(12)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion())
    assert contact.datum != 0
    js.save(tmp_path / "a.nc", contact, js.equilibrate(contact, js.MeanGap(0.2)))
    read = js.surfaces.read(tmp_path / "a.nc").heights
    np.testing.assert_allclose(read, heights, rtol=1e-14)
