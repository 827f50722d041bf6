"""Anisotropic half spaces: against the integral of Barnett and Lothe, isotropy, a sphere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth_columns import (
    barnett_lothe_stiffness,
    isotropic,
    random_axes,
    random_stiffness,
    tensor_of,
)

import jaxstab as js

COPPER = (168.4, 121.4, 75.4)
ON_110 = ((0, 0, 1), (1, -1, 0), (1, 1, 0))
ON_111 = ((1, -1, 0), (1, 1, -2), (1, 1, 1))


def vectors_of(number, seed=0):
    return np.random.default_rng(seed).normal(size=(2, number))


@pytest.mark.parametrize("seed", range(4))
def test_any_crystal_is_as_stiff_as_the_integral_of_barnett_and_lothe(seed):
    random = np.random.default_rng(seed)
    stiffness, axes = random_stiffness(random), random_axes(random)
    solid = js.solids.Anisotropic(js.Grid(8), stiffness, axes)
    vectors = vectors_of(6, seed)
    tensor = tensor_of(stiffness, axes)
    exact = [barnett_lothe_stiffness(tensor, vector) for vector in vectors.T]
    np.testing.assert_allclose(solid.stiffness_at(jnp.asarray(vectors)), exact, rtol=1e-10)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e11])
def test_isotropic_constants_are_a_half_space(dtype, unit):
    grid = js.Grid((16, 12), np.asarray([1.0, 2.0], dtype))
    axes = np.asarray(random_axes(np.random.default_rng(0)), dtype)
    constants = np.asarray(isotropic(2.0 * unit, 0.3), dtype)
    found = js.solids.Anisotropic(grid, constants, axes).waves.multiplier
    exact = js.HalfSpace(grid, 2.0 * unit, 0.3).waves.multiplier
    assert found.dtype == dtype
    error = abs(found - exact).ravel()[1:] / exact.ravel()[1:]
    assert error.max() < 50 * np.finfo(dtype).eps


@pytest.mark.parametrize("grid", [js.Grid((9,)), js.Grid((8, 6)), js.Grid((7, 5), (1.0, 3.0))])
def test_the_operator_of_a_crystal_is_symmetric_and_its_inverse_known(grid):
    random = np.random.default_rng(1)
    solid = js.solids.Anisotropic(grid, random_stiffness(random), random_axes(random))
    dense = jax.vmap(solid.pressure)(jnp.eye(grid.size).reshape(-1, *grid.shape))
    dense = dense.reshape(grid.size, grid.size)
    np.testing.assert_allclose(dense, dense.T, atol=1e-12)
    eigenvalues = np.linalg.eigvalsh(dense)[[1, -1]]
    np.testing.assert_allclose(eigenvalues, [solid.min_stiffness, solid.max_stiffness])
    field = jax.random.normal(jax.random.key(0), grid.shape)
    back = solid.displacement(solid.pressure(field))
    np.testing.assert_allclose(back, field - field.mean(), atol=1e-12)


@pytest.mark.nightly
def test_a_surface_turned_with_its_crystal_is_the_same():
    grid = js.Grid(16)
    solid = js.solids.Anisotropic(grid, COPPER, ON_110)
    x, y, z = map(np.array, ON_110)
    turned = js.solids.Anisotropic(grid, COPPER, (y, -x, z))
    wave = jnp.cos(2 * jnp.pi * (2 * grid.coordinates[0] + grid.coordinates[1]))
    # Both wave vectors point along 2 x / |x| + y / |y|.
    other = jnp.cos(2 * jnp.pi * (grid.coordinates[0] - 2 * grid.coordinates[1]))
    first = solid.pressure(wave)[0, 0]
    np.testing.assert_allclose(turned.pressure(other)[0, 0], first, rtol=1e-12)
    # Of another direction K is another.
    assert abs(solid.pressure(other)[0, 0] / first - 1) > 1e-3


@pytest.mark.nightly
def test_derivatives_by_the_constants_agree_with_differences():
    vectors = jnp.asarray(vectors_of(5))

    @jax.jit
    def stiffness(constants):
        solid = js.solids.Anisotropic(js.Grid(8), constants, ON_110)
        return jnp.append(solid.stiffness_at(vectors), solid.indentation.modulus)

    point, step = np.array(COPPER), 1e-3
    slopes = jax.jacrev(stiffness)(point)
    for i, unit in enumerate(np.eye(3)):
        difference = (stiffness(point + step * unit) - stiffness(point - step * unit)) / (2 * step)
        np.testing.assert_allclose(slopes[:, i], difference, rtol=1e-6, atol=1e-9)


def pressed_sphere(axes, points=128):
    """Return force over (4/3) a b sqrt(a b) / R, and the two semi-axes, of a sphere on copper."""
    grid = js.Grid(points)
    radius = 2.0
    contact = js.Contact(
        js.solids.Anisotropic(grid, COPPER, axes),
        js.surfaces.paraboloid(grid, radius),
        js.potentials.NoAdhesion(),
    )
    state = js.equilibrate(contact, js.MeanPressure(0.05))
    x, y = (np.asarray(x) - 0.5 for x in grid.coordinates)
    weights = np.asarray(state.reaction) / np.sum(state.reaction)
    moments = [np.sum(weights * a * b) for a, b in ((x, x), (y, y), (x, y))]
    return float(state.force), radius, moments


@pytest.mark.parametrize(
    ("axes", "modulus"), [(np.eye(3), 134.0130), (ON_110, 147.539), (ON_111, 151.5845)]
)
def test_a_sphere_presses_the_ellipse_of_willis_into_copper(axes, modulus):
    force, radius, (xx, yy, xy) = pressed_sphere(axes)
    found = js.solids.Anisotropic(js.Grid(8), COPPER, axes).indentation
    np.testing.assert_allclose(found.modulus, modulus, rtol=1e-5)
    # Moments of p0 sqrt(1 - rho^2) are a fifth of the squared semi-axes.
    wide, narrow = np.linalg.eigvalsh([[xx, xy], [xy, yy]])[::-1]
    np.testing.assert_allclose(np.sqrt(wide / narrow), found.aspect_ratio, rtol=4e-3)
    mean = np.sqrt(5) * (wide * narrow) ** 0.25
    np.testing.assert_allclose(force, 4 / 3 * modulus * mean**3 / radius, rtol=1e-2)


def fibre(along, across, shear, nu_across, nu_along):
    """Return the constants of a fibre along z, isotropic across it."""
    compliance = np.zeros((6, 6))
    compliance[range(5), range(5)] = 1 / np.array([across, across, along, shear, shear])
    compliance[5, 5] = 2 * (1 + nu_across) / across
    compliance[[0, 1], [1, 0]] = -nu_across / across
    compliance[[0, 2, 1, 2], [2, 0, 2, 1]] = -nu_along / along
    return np.linalg.inv(compliance)


@pytest.mark.parametrize("moduli", [(55.0, 10.0, 3.0), (1.0, 2.0, 5.0), (100.0, 1.0, 0.3)])
def test_a_fibre_along_the_normal_has_a_modulus_in_closed_form(moduli):
    constants = fibre(*moduli, 0.25, 0.2)
    c11, c13, c33, c44 = constants[[0, 0, 2, 3], [0, 2, 2, 3]]
    mean = np.sqrt(c11 * c33)
    # Delafargue and Ulm, Int. J. Solids Struct. 41, 7351 (2004), eq. 9.
    exact = 2 * np.sqrt((mean**2 - c13**2) / c11 / (1 / c44 + 2 / (mean + c13)))
    found = js.solids.Anisotropic(js.Grid(8), constants).indentation
    np.testing.assert_allclose(found.modulus, exact, rtol=1e-12)
    np.testing.assert_allclose(found.aspect_ratio, 1, rtol=1e-9)


def test_the_wall_of_a_wood_cell_is_as_stiff_as_published():
    # Jaeger et al., Composites A 42, 677 (2011), fig. 4, by the method of Vlassak and Nix: 23.5 GPa
    # along its fibres and 10.1 GPa across.
    constants = fibre(55.0, 10.0, 3.0, 0.25, 0.25)
    for axes, modulus in ((None, 23.50), (((0, 0, 1), (0, 1, 0), (-1, 0, 0)), 10.09)):
        found = js.solids.Anisotropic(js.Grid(8), constants, axes).indentation.modulus
        np.testing.assert_allclose(found, modulus, rtol=4e-3)


def test_two_thirds_of_a_turn_leave_the_surface_111_as_it_is():
    found = js.solids.Anisotropic(js.Grid(8), COPPER, ON_111).indentation
    np.testing.assert_allclose(found.aspect_ratio, 1, atol=1e-9)
    assert found.angle == 0
    # The longer axis of the ellipse turns with the surface.
    x, y, z = map(np.array, ON_110)
    for angle in (0.3, 1.2):
        along = np.cos(angle) * x / np.linalg.norm(x) + np.sin(angle) * y / np.linalg.norm(y)
        turned = js.solids.Anisotropic(js.Grid(8), COPPER, (along, np.cross(z, along), z))
        expected = np.exp(2j * (np.pi / 2 - angle))
        np.testing.assert_allclose(np.exp(2j * turned.indentation.angle), expected, atol=1e-9)


def test_what_is_no_crystal_is_refused():
    grid = js.Grid(8)
    with pytest.raises(ValueError, match=r"shape \(2,\).*Voigt"):
        js.solids.Anisotropic(grid, (1.0, 2.0))
    with pytest.raises(ValueError, match=r"not positive definite.*c11 > \|c12\|"):
        js.solids.Anisotropic(grid, (1.0, 2.0, 0.5))
    wrong = np.eye(6)
    wrong[0, 1] = 0.1
    with pytest.raises(ValueError, match=r"0.1 at \(0, 1\).*both sides of the diagonal"):
        js.solids.Anisotropic(grid, wrong)
    with pytest.raises(ValueError, match=r"three directions at right angles"):
        js.solids.Anisotropic(grid, COPPER, ((1, 0, 0), (1, 1, 0), (0, 0, 1)))
    with pytest.raises(ValueError, match=r"axes have shape \(3,\)"):
        js.solids.Anisotropic(grid, COPPER, (1, 1, 0))
    with pytest.raises(TypeError, match=r"Grid"):
        js.solids.Anisotropic(COPPER, COPPER)
    with pytest.raises(ValueError, match=r"direction of a wave.*indentation.modulus"):
        js.solids.Axisymmetric(js.Rings(16, 1.0), js.solids.Anisotropic(grid, COPPER))

    @jax.jit
    def is_valid(c12):
        return js.solids.Anisotropic(grid, jnp.stack([1.0, c12, 0.5])).is_valid

    assert is_valid(0.3) and not is_valid(2.0)
