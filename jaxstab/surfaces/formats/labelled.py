"""Heights with named axes, as xarray and NetCDF have them."""

from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxstab.core.optional_packages import NETCDF, require_packages
from jaxstab.core.units import convert_lengths, unit_of
from jaxstab.surfaces.formats.scan import (
    Scan,
    UnknownContent,
    are_pixels,
    chosen_array,
    on_a_side_or_two,
    on_lattice,
)

if TYPE_CHECKING:
    import xarray


def read_netcdf(content: bytes, channel: str | None) -> Scan:
    """Return the heights of a data set in a file, classic or on HDF5."""
    require_packages("NetCDF files", "data", *NETCDF)
    import xarray

    try:
        data = xarray.load_dataset(BytesIO(content), decode_times=False)
    except Exception as error:
        raise UnknownContent(f"this NetCDF file is truncated or damaged ({error}).") from None
    return scan_of_dataset(data, channel)


def scan_of_dataset(data: "xarray.Dataset", channel: str | None = None) -> Scan:
    """Return the surface of the variable `heights`, the requested one, or the only one over x, y.

    A variable `mask`, as SurfaceTopography writes it, marks missing points.
    """
    names = [str(name) for name, variable in data.items() if _sides(variable) and name != "mask"]
    if not names:
        found = ", ".join(f"{name}{tuple(v.dims)}" for name, v in data.items()) or "no variable"
        raise UnknownContent(f"it has no variable over the dimensions x and y, but {found}.")
    name, remarks = chosen_array(names, channel)
    heights = data[name]
    if "mask" in data:
        heights = heights.where(data["mask"] == 0)
    if name == "heights" and "datum" in data:
        # Files of results hold heights relative to the datum.
        heights = heights.copy(data=heights.values.astype(float) + float(data["datum"]))
    return scan_of_array(heights, remarks)


def scan_of_array(array: "xarray.DataArray", remarks: tuple[str, ...] = ()) -> Scan:
    """Return the surface of an array with dimensions x and y, in either order, or x alone.

    Side lengths are the number of points times the spacing of the coordinates. Units are the
    attributes `units` or `unit`; heights come in the unit of the coordinates. An attribute
    `periodic` of the coordinates says that edges meet.
    """
    sides = _sides(array)
    if not sides:
        raise ValueError(
            f"its dimensions are {', '.join(map(repr, array.dims))}: name them 'x' and 'y', as in "
            "array.rename(row='y', column='x')."
        )
    heights = on_a_side_or_two(array.transpose(*sides).values)
    lengths = []
    units = set()
    coordinates = []
    if all(side in array.coords for side in sides):
        coordinates = [array[side] for side in sides]
    for axis, places in enumerate(coordinates):
        side = on_lattice(np.asarray(places.values, float))
        if side is None or np.unique(side[0]).size != places.size:
            raise ValueError(f"its coordinates {places.name} are not evenly spaced.")
        heights = heights.take(np.argsort(side[0]), axis)
        lengths.append(places.size * side[2])
        units.add(_unit(places))
    is_counted = bool(lengths) and units <= {None}
    is_counted &= all(are_pixels(places.values) for places in coordinates)
    units -= {None}
    if len(units) > 1:
        raise ValueError(f"x and y are in different units, {' and '.join(sorted(units))}.")
    is_periodic = bool(lengths) and all(c.attrs.get("periodic", 0) == 1 for c in coordinates)
    own = _unit(array)
    unit = next(iter(units), own)
    if own and unit and own != unit:
        heights = convert_lengths(heights, own, unit)
        remarks = (*remarks, f"heights converted from {own} to {unit}")
    return Scan(heights, tuple(lengths) or None, unit, remarks, is_periodic, is_counted)


def scan_of_table(table: Any) -> Scan | None:
    """Return the surface of a table or a series of pandas, whose labels name x and y.

    A series that only counts its points is a plain array: None.
    """
    axes = [table.index]
    cure = 'rename_axis("x")'
    if table.ndim == 2:
        axes.append(table.columns)
        cure = 'table.rename_axis(index="y", columns="x")'
    names = [axis.name for axis in axes]
    if names == [None] and are_pixels(np.asarray(table.index)):
        return None
    if set(names) not in ({"x", "y"}, {"x"}):
        raise ValueError(
            f"its labels are {', '.join(map(repr, names))}: say which are x and y, as in {cure}, "
            "or give `.to_numpy()`, whose first axis is x."
        )
    require_packages("Tables", "data", "xarray")
    import xarray

    return scan_of_array(xarray.DataArray(table))


def _sides(array: "xarray.DataArray") -> list[str]:
    """Return the dimensions x and y or x, in this order; none for an array of other dimensions."""
    if set(array.dims) not in ({"x", "y"}, {"x"}):
        return []
    return sorted(map(str, array.dims))


def _unit(array: "xarray.DataArray") -> str | None:
    unit = array.attrs.get("units", array.attrs.get("unit"))
    # The files of results name the dimension of a length that has no unit.
    if not unit or unit == "length":
        return None
    return unit_of(str(unit))
