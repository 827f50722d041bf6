"""Layers and coatings: against Airy's stress function in 60 digits, their limits, differences."""

from decimal import Decimal, getcontext

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import TIGHT

import jaxstab as js

getcontext().prec = 60
RATIOS = [0.0, 0.25, 0.3, 0.45, 0.4999, 0.5]
WAVENUMBERS = np.geomspace(1e-3, 50, 9)


def airy(z, q, nu, shear, top):
    """Return stresses and displacements of the four plane waves in a layer, at a depth z.

    phi = (A + B z) exp(q z - q top) + (C + D z) exp(-q z) times cos q x; rows are sigma_zz,
    sigma_xz, u_x and u_z, columns A to D.
    """
    columns = []
    for sign, decay in ((1, (q * (z - top)).exp()), (-1, (-q * z).exp())):
        p = sign * q
        for power in (0, 1):
            phi = z if power else Decimal(1)
            slope = p * phi + power
            curvature = p * slope + p * power
            integral = phi / p - power / p**2
            stress = [-(q**2) * phi, q * slope]
            across = ((1 - nu) * curvature + nu * q**2 * phi) / q
            along = -(1 - nu) * q**2 * integral - nu * slope
            moves = [across / (2 * shear), along / (2 * shear)]
            columns.append([decay * value for value in stress + moves])
    return [list(row) for row in zip(*columns, strict=True)]


def solved(matrix, right):
    """Return the solution of a linear system by elimination with pivots."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    n = len(rows)
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(rows[k][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for k in range(n):
            if k != i:
                factor = rows[k][i] / rows[i][i]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return [rows[i][n] / rows[i][i] for i in range(n)]


def stiffness_by_airy(q, thickness, layer, base=None):
    """Return -sigma_zz / -u_z at the top of a layer on a rigid base, or on a half space."""
    q, h, modulus, nu = (Decimal(float(x)) for x in (q, thickness, *layer))
    shear = modulus / (2 * (1 + nu))
    bottom = airy(Decimal(0), q, nu, shear, h)
    top = airy(h, q, nu, shear, h)
    if base is None:
        matrix, right = [*bottom[2:], top[1], top[0]], [Decimal(0)] * 3 + [Decimal(1)]
    else:
        modulus, nu = (Decimal(float(x)) for x in base)
        below = airy(Decimal(0), q, nu, modulus / (2 * (1 + nu)), Decimal(0))
        # Of the base only what decays downwards, exp(q z), is there.
        match = [
            [*row, *(-value for value in other[:2])]
            for row, other in zip(bottom, below, strict=True)
        ]
        surface = [[*top[i], Decimal(0), Decimal(0)] for i in (1, 0)]
        matrix, right = [*match, *surface], [Decimal(0)] * 5 + [Decimal(1)]
    amplitudes = solved(matrix, right)
    move = sum(a * b for a, b in zip(top[3], amplitudes, strict=False))
    return float(1 / move)


@pytest.mark.parametrize("nu", RATIOS)
def test_a_layer_is_as_stiff_as_airys_stress_function_says(nu):
    thickness = 0.02
    solid = js.Layer(js.Grid(8), 2.0, nu, thickness)
    q = WAVENUMBERS / thickness
    exact = [stiffness_by_airy(one, thickness, (2.0, nu)) for one in q]
    np.testing.assert_allclose(solid.stiffness_at(jnp.asarray(q)), exact, rtol=1e-12)


@pytest.mark.parametrize("nu", [(0.0, 0.5), (0.5, 0.2), (0.3, 0.3), (0.5, 0.5)])
@pytest.mark.parametrize("ratio", [1e-8, 0.03, 1.0, 50.0, 1e8])
def test_a_coating_is_as_stiff_as_airys_stress_function_says(nu, ratio):
    layer, base = (2.0, nu[0]), (2.0 / ratio, nu[1])
    solid = js.CoatedHalfSpace(js.Grid(8), layer, 0.5, base)
    q = WAVENUMBERS / 0.5
    exact = [stiffness_by_airy(one, 0.5, layer, base) for one in q]
    np.testing.assert_allclose(solid.stiffness_at(jnp.asarray(q)), exact, rtol=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("nu", RATIOS)
def test_no_digits_are_lost_from_thin_to_thick(nu, dtype):
    q = np.geomspace(1e-6, 1e4, 21).astype(dtype)
    constants = [np.asarray(x, dtype) for x in (2.0, nu, 3.0, 0.1)]
    grid = js.Grid(8, np.ones(2, dtype))
    modulus, ratio, *base = constants
    layer = js.Layer(grid, modulus, ratio, np.asarray(1.0, dtype))
    coated = js.CoatedHalfSpace(grid, (modulus, ratio), np.asarray(1.0, dtype), tuple(base))
    for solid, below in ((layer, None), (coated, base)):
        found = jax.jit(type(solid).stiffness_at)(solid, jnp.asarray(q))
        assert found.dtype == dtype
        # Of exp(-2 x h) thick layers do not even have a trace.
        near = q[q <= 50]
        exact = [stiffness_by_airy(one, 1.0, (modulus, ratio), below) for one in near]
        np.testing.assert_allclose(found[: near.size], exact, rtol=20 * np.finfo(dtype).eps)
        thick = js.HalfSpace(grid, modulus, ratio).stiffness_at(jnp.asarray(q[near.size :]))
        np.testing.assert_allclose(found[near.size :], thick, rtol=20 * np.finfo(dtype).eps)


SOLIDS = {
    "layer": lambda grid, h: js.Layer(grid, 1.0, 0.3, h),
    "incompressible": lambda grid, h: js.Layer(grid, 1.0, 0.5, h),
    "coating": lambda grid, h: js.CoatedHalfSpace(grid, (1.0, 0.4), h, (0.2, 0.3)),
}


def contact_on(name, thickness=0.1):
    grid = js.Grid(32)
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=8, rms_height=0.02)
    law = js.potentials.Exponential(0.002, 0.02)
    return js.Contact(SOLIDS[name](grid, thickness), heights, law)


@pytest.mark.nightly
def test_the_derivative_by_thickness_agrees_with_differences():
    def pressure(thickness):
        contact = contact_on("coating", thickness)
        return js.equilibrate(contact, js.MeanGap(0.03), TIGHT, throw=False).mean_pressure

    both = jax.jit(jax.value_and_grad(pressure))
    difference = (both(0.1 + 1e-5)[0] - both(0.1 - 1e-5)[0]) / 2e-5
    np.testing.assert_allclose(both(0.1)[1], difference, rtol=1e-5)


@pytest.mark.nightly
def test_the_base_of_a_layer_can_be_held():
    contact = contact_on("layer")
    stiffness = 1.0 * 0.7 / (1.3 * 0.4 * 0.1)
    held = js.equilibrate(contact, js.FarDisplacement(-0.002))
    pressure = stiffness * (held.displacement.mean() + 0.002)
    np.testing.assert_allclose(held.mean_pressure, pressure, rtol=1e-8)
    whole = contact.solid.pressure(held.displacement + 0.002)
    np.testing.assert_allclose(held.pressure, whole, atol=1e-9)


@pytest.mark.nightly
def test_an_incompressible_layer_gives_a_spring_nothing_and_holds_no_base():
    contact = contact_on("incompressible")
    with pytest.raises(js.exceptions.SolverError, match=r"not incompressible.*mean displacement"):
        js.equilibrate(contact, js.FarDisplacement(0.0))
    spring = js.equilibrate(contact, js.Spring(0.0, 2.0))
    np.testing.assert_allclose(spring.mean_pressure, 2.0 * spring.displacement.mean(), rtol=1e-8)

    def pressure(nu):
        solid = js.Layer(contact.grid, 1.0, nu, 0.1)
        stretched = eqx.tree_at(lambda contact: contact.solid, contact, solid)
        return js.equilibrate(stretched, js.MeanGap(0.03), TIGHT, throw=False).mean_pressure

    # A load that holds the mean does not feel the infinite stiffness.
    both = jax.jit(jax.value_and_grad(pressure))
    value, slope = both(0.5)
    np.testing.assert_allclose(slope, (value - both(0.5 - 1e-6)[0]) / 1e-6, rtol=1e-4)


def test_an_incompressible_layer_presses_on_a_wave_alone():
    # Its K at q = 0 is infinite, and the mean of a wave on the grid is a rounding off zero.
    grid = js.Grid(32)
    layer = js.Layer(grid, 1.0, 0.5, 0.2)
    wave, stiffness = jnp.cos(2 * jnp.pi * grid.coordinates[0]), 12.0047777296957
    for solid in (layer, js.solids.Solid.with_uniform_stiffness(layer, jnp.inf)):
        for displacement in (wave, wave + 3):
            pressure = solid.pressure(displacement)
            # By Johnson's formula in 60 digits.
            np.testing.assert_allclose(pressure, stiffness * wave, atol=1e-9)
            np.testing.assert_allclose(solid.energy(displacement), stiffness / 4, rtol=1e-10)
            energy = jax.grad(solid.energy)(displacement)
            np.testing.assert_allclose(energy * 32**2, pressure, atol=1e-9)
    np.testing.assert_allclose(layer.displacement(stiffness * wave), wave, atol=1e-9)
    # A layer that nearly keeps its volume, on a wave without a mean.
    nearly = js.Layer(grid, 1.0, 0.5 - 1e-9, 0.2).pressure(wave - jnp.mean(wave))
    np.testing.assert_allclose(layer.pressure(wave), nearly, atol=1e-6)


def test_what_makes_no_layer_is_refused():
    grid = js.Grid(8)
    with pytest.raises(ValueError, match=r"thickness is -1.0: it must be positive"):
        js.Layer(grid, 1.0, 0.3, -1.0)
    with pytest.raises(ValueError, match=r"Young's modulus is 0.0"):
        js.Layer(grid, 0.0, 0.3, 1.0)
    with pytest.raises(ValueError, match=r"thickness has shape \(2,\).*vmap"):
        js.Layer(grid, 1.0, 0.3, [1.0, 2.0])
    with pytest.raises(ValueError, match=r"Poisson's ratio of the base is 0.6"):
        js.CoatedHalfSpace(grid, (1.0, 0.3), 1.0, (1.0, 0.6))
    with pytest.raises(ValueError, match=r"layer is 1.0: give its Young's modulus and"):
        js.CoatedHalfSpace(grid, 1.0, 1.0, (1.0, 0.3))
    contact = contact_on("layer")

    @jax.jit
    def result(thickness):
        solid = js.Layer(contact.grid, 1.0, 0.3, thickness)
        traced = eqx.tree_at(lambda contact: contact.solid, contact, solid)
        return js.equilibrate(traced, js.MeanGap(0.03), throw=False).result

    assert result(-1.0) == "invalid_contact"
    pressed = jax.value_and_grad(
        lambda t: js.Layer(contact.grid, 1.0, 0.3, t).pressure(contact.heights)[1, 2]
    )
    with pytest.raises(ValueError, match=r"thickness is -1.0: it must be positive"):
        pressed(-1.0)
    assert np.isfinite(pressed(1.0)).all() and np.isnan(jax.jit(pressed)(-1.0)).all()
