"""NumPy's files of one array or several, which never run code."""

from io import BytesIO

import numpy as np

from jaxstab.core.units import unit_of
from jaxstab.surfaces.formats.scan import Scan, chosen_array, on_a_side_or_two


def read_arrays(content: bytes, channel: str | None) -> Scan:
    """Return the surface in a file of `numpy.save` or `numpy.savez`, whose arrays are channels."""
    try:
        data = np.load(BytesIO(content), allow_pickle=False)
        if isinstance(data, np.ndarray):
            data = {"heights": data}
        arrays = dict(data)
    except Exception as error:
        raise ValueError(
            f"this file of NumPy is damaged, or holds more than plain arrays of numbers ({error})."
        ) from None
    lengths = arrays.pop("lengths", None)
    unit = arrays.pop("unit", None)
    if not arrays:
        raise ValueError("it has no array of heights: save it as `heights`.")
    name, remarks = chosen_array(arrays, channel)
    if unit is not None:
        unit = unit_of(str(unit))
    return Scan(on_a_side_or_two(arrays[name]), lengths, unit, remarks)
