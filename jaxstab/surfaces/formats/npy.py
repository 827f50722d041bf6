"""NumPy's files of one array."""

from io import BytesIO

import numpy as np

from jaxstab.surfaces.formats.scan import Scan, on_a_side_or_two


def read_npy(content: bytes) -> Scan:
    """Return the surface that `numpy.save(path, heights)` wrote."""
    try:
        values = np.load(BytesIO(content), allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise ValueError(
            f"this .npy file is truncated, or holds no plain array of numbers ({error})."
        ) from None
    return Scan(on_a_side_or_two(values))
