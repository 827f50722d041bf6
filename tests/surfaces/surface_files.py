"""One uneven surface, written in every format that can be read."""

import struct
import zipfile

import numpy as np
import xarray

import jaxstab as js

# 12 x 7 points on 3 x 1.4 micrometres, with no symmetry that would hide a swapped axis.
SIDES = 3.0, 1.4
x, y = np.meshgrid(np.arange(12) * SIDES[0] / 12, np.arange(7) * SIDES[1] / 7, indexing="ij")
HEIGHTS = 0.1 * x + 0.03 * y**2 + 0.02 * np.sin(5 * x * y + 1)


def as_text(path):
    np.savetxt(path, HEIGHTS, header="a line for each x")


def as_xyz(path):
    points = np.column_stack([x.ravel() + 10, y.ravel() - 3, HEIGHTS.ravel()])
    np.savetxt(path, np.random.default_rng(0).permutation(points), delimiter=";")


def as_npy(path):
    with path.open("wb") as file:
        np.save(file, HEIGHTS)


X3P = """<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
<Record1><Revision>ISO5436 - 2000</Revision><FeatureType>SUR</FeatureType><Axes>
<CX><AxisType>I</AxisType><DataType>D</DataType><Increment>0.25e-6</Increment></CX>
<CY><AxisType>I</AxisType><DataType>D</DataType><Increment>0.2e-6</Increment></CY>
<CZ><AxisType>A</AxisType><DataType>D</DataType></CZ></Axes></Record1>
<Record3><MatrixDimension><SizeX>12</SizeX><SizeY>7</SizeY><SizeZ>1</SizeZ></MatrixDimension>
<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink></Record3></p:ISO5436_2>"""


def as_x3p(path):
    # By ISO 25178-72: metres, the points of a profile along x one after another.
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("main.xml", X3P)
        archive.writestr("bindata/data.bin", (1e-6 * HEIGHTS).T.astype("<f8").tobytes())


def gwy_part(name, kind, value):
    return name.encode() + b"\0" + kind.encode() + value


def gwy_object(name, *parts):
    content = b"".join(parts)
    return name.encode() + b"\0" + struct.pack("<I", len(content)) + content


def gwy_field(heights, unit):
    # By Gwyddion's description: rows of constant y one after another, a unit each for xy and z.
    unit_xy, unit_z = (gwy_object("GwySIUnit", gwy_part("unitstr", "s", u + b"\0"))
                       for u in (b"m", unit.encode()))  # fmt: skip
    return gwy_object(
        "GwyDataField",
        gwy_part("xres", "i", struct.pack("<i", 12)),
        gwy_part("yres", "i", struct.pack("<i", 7)),
        gwy_part("xreal", "d", struct.pack("<d", 3e-6)),
        gwy_part("yreal", "d", struct.pack("<d", 1.4e-6)),
        gwy_part("si_unit_xy", "o", unit_xy),
        gwy_part("si_unit_z", "o", unit_z),
        gwy_part("data", "D", struct.pack("<I", 84) + heights.T.tobytes()),
    )


def as_gwy(path, unit="m", per_height=1e-6):
    field = gwy_part("/0/data", "o", gwy_field(per_height * HEIGHTS, unit))
    path.write_bytes(b"GWYP" + gwy_object("GwyContainer", field))


def as_npz(path):
    with path.open("wb") as file:
        np.savez(file, heights=HEIGHTS, lengths=SIDES, unit="um")


# A row for each y, in the order of the same image's .gwy file.
GWYDDION = "# Channel: Height\n# Width: 3.000 µm\n# Height: 1.400 µm\n# Value units: m\n"
ROWS = "\n".join(" ".join(f"{1e-6 * h:.17g}" for h in row) for row in HEIGHTS.T) + "\n"


def as_text_of_gwyddion(path):
    path.write_text(GWYDDION + ROWS, encoding="latin-1")


def as_netcdf(path, engine="h5netcdf"):
    # Rows from the top down, y first, heights in another unit than the sides.
    coordinates = {"x": ("x", x[:, 0], {"units": "um"}), "y": ("y", y[0], {"units": "um"})}
    heights = ("x", "y"), 1e3 * HEIGHTS, {"units": "nm"}
    data = xarray.Dataset({"z": heights, "time": 3.0}, coordinates)
    data.isel(y=slice(None, None, -1)).transpose("y", "x").to_netcdf(path, engine=engine)


def as_classic_netcdf(path):
    as_netcdf(path, engine="scipy")


def by_surface_topography(path):
    import SurfaceTopography

    topography = SurfaceTopography.Topography(HEIGHTS, SIDES, unit="µm", periodic=False)
    topography.to_netcdf(str(path))


def by_its_text(path):
    import SurfaceTopography

    topography = SurfaceTopography.Topography(HEIGHTS, SIDES, unit="µm", periodic=False)
    topography.to_matrix(str(path))


WRITERS = [
    as_text,
    as_xyz,
    as_npy,
    as_npz,
    as_x3p,
    as_gwy,
    as_text_of_gwyddion,
    as_netcdf,
    as_classic_netcdf,
    by_surface_topography,
    by_its_text,
]
SAY_NOTHING = {as_text, as_npy}
SAY_NO_UNIT = SAY_NOTHING | {as_xyz}
REMARKS = {
    as_netcdf: ("heights converted from nm to µm",),
    as_classic_netcdf: ("heights converted from nm to µm",),
}


def read_text(tmp_path, text, lengths=None):
    (tmp_path / "a.txt").write_text(text)
    return js.surfaces.read(tmp_path / "a.txt", lengths)
