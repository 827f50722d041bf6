"""NetCDF files with checksums: they are read as written, by HDF5 and xarray too."""

import h5py
import numpy as np
import pytest
import xarray

from jaxstab.core.checked_netcdf import Content, Damaged, Variable, read, write

DIMS = ("seed", "x", "y")
VARIABLES = {
    "field": Variable(DIMS, np.random.default_rng(0).random((1, 3, 4)), {"units": "µm"}),
    "flag": Variable(DIMS[:1], np.array([True])),
    "word": Variable(DIMS[:2], np.array([["ä", "", "ccc"]])),
    "x": Variable(("x",), np.arange(3.0)),
    "large": Variable(("long",), np.arange(2000)),
    "scalar": Variable((), np.array(1.5)),
    "scalar_word": Variable((), np.array("ä")),
    "none": Variable(("no",), np.zeros(0)),
}
CONTENT = Content(VARIABLES, {"title": "a file", "format": 7, "empty": "", "long": "é" * 70_000})


@pytest.mark.parametrize("step", [97, pytest.param(1, marks=pytest.mark.nightly)])
def test_every_changed_byte_of_a_file_is_found(step, tmp_path):
    file = tmp_path / "case.nc"
    write(file, CONTENT)
    content = file.read_bytes()
    found, attrs = read(file)
    assert attrs == CONTENT.attrs
    assert found.keys() == VARIABLES.keys()
    for name, (dims, values, attrs) in VARIABLES.items():
        assert found[name].dims == dims and found[name].attrs == attrs
        np.testing.assert_array_equal(found[name].values, values, strict=True)
    for place in range(0, len(content), step):
        changed = bytearray(content)
        changed[place] ^= 1 << place % 8
        file.write_bytes(changed)
        with pytest.raises(Damaged, match=file.name):
            read(file)


def test_hdf5_itself_finds_a_changed_number_of_any_variable(tmp_path):
    file, places = tmp_path / "case.nc", {}
    write(file, CONTENT)
    content = file.read_bytes()
    with h5py.File(file) as opened:
        # Words and scalars have no checksum but the digest of the file.
        for name in VARIABLES.keys() - {"word", "scalar", "scalar_word", "none"}:
            places[name] = opened[name].id.get_chunk_info(0).byte_offset
    for name, place in places.items():
        changed = bytearray(content)
        changed[place] ^= 1
        file.write_bytes(changed)
        with h5py.File(file) as opened, pytest.raises(OSError, match=r"(?i)fletcher32|filter"):
            opened[name][()]


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray_reads_the_variables(engine, tmp_path):
    if engine == "netcdf4":
        pytest.importorskip("netCDF4")
    write(tmp_path / "case.nc", CONTENT)
    dataset = xarray.load_dataset(tmp_path / "case.nc", engine=engine)
    assert {name: dataset.attrs[name] for name in CONTENT.attrs} == CONTENT.attrs
    assert set(dataset.coords) == {"x"} and dataset["field"].attrs == {"units": "µm"}
    for name, (dims, values, _) in VARIABLES.items():
        assert dataset[name].dims == dims
        np.testing.assert_array_equal(dataset[name], values)
