"""A file that several commands read."""

import numpy as np
import pytest

import jaxstab as js


@pytest.fixture
def scan(tmp_path):
    """A tilted scan with a hole, of 16 x 12 points."""
    heights = np.array(js.surfaces.sinusoid(js.Grid((16, 12)), 0.1, waves=(2, 1)))
    heights += 3 * np.linspace(0, 1, 16)[:, None]
    heights[4, 5] = np.nan
    np.savetxt(tmp_path / "scan.txt", heights)
    return tmp_path / "scan.txt"
