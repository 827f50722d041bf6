"""NetCDF, classic and on HDF5, also as SurfaceTopography writes it."""

from io import BytesIO
from typing import Any, Literal

import numpy as np

from jaxstab.core.optional_packages import NETCDF, require_packages
from jaxstab.surfaces.formats.scan import (
    Scan,
    UnknownContent,
    chosen,
    even_spacing,
    on_a_side_or_two,
)
from jaxstab.surfaces.units import unit_of

# The relative error that sizes in single precision have.
_SINGLE = 1e-6


def read_netcdf(content: bytes, engine: Literal["scipy", "h5netcdf"], channel: str | None) -> Scan:
    """Return the heights of a data set over the dimensions x and y, in either order, or x alone.

    That is the requested variable, `heights`, or the only one over these. Side lengths are the
    number of points times the spacing of the coordinates, in double precision, or their attribute
    `length`. Units are the attributes `units` or `unit`. Heights are converted to the unit of the
    coordinates. A missing unit is taken from the other, with a remark. A variable `mask` marks
    missing points, an attribute `periodic` of the coordinates edges that meet.
    """
    data = _loaded(content, engine)
    name, choice = _name(data, channel)
    variable = data[name]
    sides = [name for name in ("x", "y") if name in variable.dims]
    if "mask" in data:
        variable = variable.where(data["mask"] == 0)
    heights = on_a_side_or_two(variable.transpose(*sides).values)
    spacings = [_spacing(data, side) for side in sides]
    for axis, spacing in enumerate(spacings):
        heights = np.flip(heights, axis) if spacing and spacing < 0 else heights
    lengths = [_length(data, side, spacing) for side, spacing in zip(sides, spacings, strict=True)]
    scan = Scan(
        heights,
        None if None in lengths else tuple(length for length in lengths if length),
        remarks=choice,
        is_periodic=all(s in data and data[s].attrs.get("periodic", 0) == 1 for s in sides),
    )
    return scan.in_units(_unit(variable), _unit_of_sides(data, sides))


def _loaded(content: bytes, engine: Literal["scipy", "h5netcdf"]) -> Any:
    packages = NETCDF if engine == "h5netcdf" else ("xarray", engine)
    require_packages("NetCDF files", "data", *packages)
    import xarray

    try:
        return xarray.load_dataset(BytesIO(content), engine=engine, decode_times=False)
    except Exception as error:
        raise UnknownContent(f"this NetCDF file is truncated or damaged ({error}).") from None


def _name(data: Any, channel: str | None) -> tuple[str, tuple[str, ...]]:
    names = [str(name) for name, v in data.items() if set(v.dims) in ({"x", "y"}, {"x"})]
    names = [name for name in names if name != "mask"]
    maps = [name for name in names if data[name].ndim == 2] or names
    if not maps:
        found = ", ".join(f"{name}{tuple(v.dims)}" for name, v in data.items()) or "no variable"
        raise UnknownContent(
            f"this NetCDF file has no variable over the dimensions x and y, but {found}."
        )
    if "heights" not in names and channel is None and len(maps) > 1:
        raise ValueError(
            f"it has several maps, {', '.join(maps)}: name the surface `heights`, or choose one as "
            "`channel=`."
        )
    return chosen(names, channel, "heights" if "heights" in names else maps[0])


def _spacing(data: Any, side: str) -> float | None:
    if side not in data.coords:
        return None
    spacing = even_spacing(np.asarray(data[side].values, float))
    if spacing is None:
        raise ValueError(f"its coordinates {side} are not evenly spaced.")
    return spacing


def _length(data: Any, side: str, spacing: float | None) -> float | None:
    if spacing is None:
        return None
    length = abs(spacing) * data.sizes[side]
    said = float(data[side].attrs.get("length", length))
    if abs(said - length) > _SINGLE * length:
        raise ValueError(
            f"its length of {side} is {said:g}, but its coordinates say {length:g}: "
            f"{data.sizes[side]} points {abs(spacing):g} apart."
        )
    return length


def _unit(variable: Any) -> str | None:
    unit = variable.attrs.get("units", variable.attrs.get("unit"))
    # Where a length has no unit, files of results say that it is one.
    return unit_of(str(unit)) if unit and unit != "length" else None


def _unit_of_sides(data: Any, sides: list[str]) -> str | None:
    units = {_unit(data[side]) for side in sides if side in data.coords} - {None}
    if len(units) > 1:
        raise ValueError(
            f"x and y are in different units, {' and '.join(sorted(map(str, units)))}."
        )
    return next(iter(units), None)
