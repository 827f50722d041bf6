"""Elastic constants of crystals: their symmetry, and what others have derived from them."""

import numpy as np
import pytest

import jaxstab as js

MATERIALS = js.references.materials
NAMES = "silicon", "gallium_arsenide", "copper", "gold", "quartz"


@pytest.mark.parametrize("name", NAMES)
def test_constants_are_those_of_a_stable_crystal_and_are_not_changed(name):
    stiffness = getattr(MATERIALS, name)
    np.testing.assert_array_equal(stiffness, stiffness.T)
    assert np.linalg.eigvalsh(stiffness)[0] > 0
    with pytest.raises(ValueError, match="read-only"):
        stiffness[0, 0] = 1.0
    solid = js.solids.Anisotropic(js.Grid(4), stiffness)
    assert solid.is_valid


def youngs_modulus(stiffness, direction):
    """Return Young's modulus along a direction: strains of a tension are a column of S."""
    x, y, z = np.array(direction) / np.linalg.norm(direction)
    tension = np.array([x * x, y * y, z * z, y * z, x * z, x * y])
    return 1 / (tension @ np.linalg.inv(stiffness) @ tension)


def test_silicon_is_as_stiff_along_its_axes_as_is_known():
    # Hopcroft, Nix and Kenny (2010): 130, 169 and 188 GPa.
    directions = (1, 0, 0), (1, 1, 0), (1, 1, 1)
    found = [youngs_modulus(MATERIALS.silicon, direction) for direction in directions]
    np.testing.assert_allclose(found, [130, 169, 188], atol=0.6)


@pytest.mark.nightly
def test_quartz_has_a_threefold_axis():
    angle = 2 * np.pi / 3
    cosine, sine = np.cos(angle), np.sin(angle)
    axes = ((cosine, sine, 0), (-sine, cosine, 0), (0, 0, 1))
    vectors = np.random.default_rng(0).normal(size=(2, 5))
    grid = js.Grid(4)
    first = js.solids.Anisotropic(grid, MATERIALS.quartz).stiffness_at(vectors)
    second = js.solids.Anisotropic(grid, MATERIALS.quartz, axes).stiffness_at(vectors)
    np.testing.assert_allclose(first, second, rtol=1e-12)
