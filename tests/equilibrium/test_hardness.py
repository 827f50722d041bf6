"""Contacts that yield: the conditions of equilibrium looked at field by field, and their loads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness

import jaxstab as js

GRID = js.Grid((8, 6))
HEIGHTS = js.surfaces.self_affine(
    GRID, jax.random.key(1), k_low=1, k_rolloff=1, k_high=3, rms_height=0.05
)
LAW = js.potentials.Exponential(0.004, 0.1)
# The law pulls by 0.04 at zero gap.
HARDNESS = 0.15


def contact_of(solid=None, hardness=HARDNESS, heights=HEIGHTS, law=LAW):
    if solid is None:
        solid = js.HalfSpace(GRID, 1.0)
    return js.Contact(solid, heights, law, hardness=hardness)


def check_yielding(state, hardness, accuracy=1e-8):
    """Assert the bounds of the pressure, each where it must hold."""
    pressure, gap, depth = (
        np.asarray(x, float) for x in (state.pressure, state.gap, state.indentation)
    )
    hardness = np.broadcast_to(hardness, gap.shape)
    attraction = 0.04 * np.exp(-gap / 0.1)
    scale = hardness.min()
    assert (gap >= 0).all()
    assert (depth >= 0).all()
    assert not (gap * depth).any()
    np.testing.assert_array_equal(state.is_yielding, depth > 0)
    np.testing.assert_allclose(state.yielded_area, (depth > 0).mean(), rtol=1e-6)
    assert 0 < state.yielded_area < state.contact_area < 1
    np.testing.assert_allclose(pressure[gap > 0], -attraction[gap > 0], atol=accuracy * scale)
    np.testing.assert_allclose(pressure[depth > 0], hardness[depth > 0], rtol=accuracy)
    held = (gap == 0) & (depth == 0)
    assert (pressure[held] >= -0.04 - accuracy * scale).all()
    assert (pressure <= hardness * (1 + accuracy)).all()
    np.testing.assert_allclose(state.reaction[gap == 0], pressure[gap == 0] + 0.04, atol=accuracy)
    np.testing.assert_allclose(pressure.mean(), state.mean_pressure, rtol=1e-5)


@pytest.mark.parametrize(
    "load",
    [
        js.MeanGap(0.02),
        js.MeanDisplacement(0.02),
        js.MeanPressure(0.03),
        js.Spring(-0.05, 0.5),
        js.Spring(0.015, 100.0),
    ],
    ids=lambda load: f"{type(load).__name__}{float(load.value)}",
)
def test_pressures_stay_within_their_bounds_under_every_load(load):
    state = js.equilibrate(contact_of(), load)
    check_yielding(state, HARDNESS)
    np.testing.assert_allclose(state.displacement, state.signed_gap + HEIGHTS, atol=1e-15)
    stiffness = periodic_stiffness(GRID.shape, (1.0, 1.0), 1.0)
    elastic = (stiffness @ np.ravel(state.displacement)).reshape(GRID.shape)
    np.testing.assert_allclose(elastic + state.mean_pressure, state.pressure, atol=1e-9)
    np.testing.assert_allclose(
        state.plastic_work, HARDNESS * state.indentation.sum() / GRID.size, rtol=1e-9
    )
    u, g = np.ravel(state.displacement), np.asarray(state.gap)
    energy = u @ stiffness @ u / 2 - 0.004 * np.exp(-g / 0.1).sum()
    np.testing.assert_allclose(state.energy, energy / GRID.size, rtol=1e-8)
    if isinstance(load, js.MeanGap):
        np.testing.assert_allclose((state.displacement - HEIGHTS).mean(), 0.02)


def test_an_infinite_hardness_is_none():
    elastic = js.Contact(js.HalfSpace(GRID, 1.0), HEIGHTS, LAW)
    same = contact_of(hardness=jnp.inf)
    assert same.hardness is None
    assert jax.tree.structure(same) == jax.tree.structure(elastic)
    assert contact_of(hardness=np.full(GRID.shape, np.inf)).hardness is None
    assert js.equilibrate(elastic, js.MeanPressure(0.03)).indentation is None


def test_a_hardness_beyond_all_pressures_changes_nothing():
    load = js.MeanPressure(0.03)
    state, elastic = (js.equilibrate(contact_of(hardness=h), load) for h in (1e3, None))
    np.testing.assert_allclose(state.gap, elastic.gap, atol=1e-9)
    assert not state.indentation.any()
    assert state.num_steps == elastic.num_steps


@pytest.mark.nightly
def test_points_of_infinite_hardness_do_not_yield_among_others():
    hardness = np.where(np.arange(GRID.size).reshape(GRID.shape) % 2, np.inf, HARDNESS)
    state = js.equilibrate(contact_of(hardness=hardness), js.MeanPressure(0.03))
    assert state.is_yielding.any()
    assert not state.is_yielding[hardness == np.inf].any()
    assert state.pressure[hardness == np.inf].max() > HARDNESS
    assert state.pressure[hardness < np.inf].max() <= HARDNESS * (1 + 1e-8)


def test_all_of_the_surface_yields_where_the_load_closes_it():
    state = js.equilibrate(contact_of(), js.MeanGap(-0.3))
    assert state.is_yielding.all()
    np.testing.assert_allclose(state.mean_pressure, HARDNESS)
    np.testing.assert_allclose(state.displacement, state.displacement.mean(), atol=1e-8)


def test_a_rough_contact_converges_up_to_the_mean_pressure_of_its_hardness():
    # The case in which a method of others diverges: rms gradient 0.08, H = 0.1 E*.
    grid = js.Grid(32)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=8, rms_height=0.1)
    slopes = np.gradient(np.asarray(heights), 1 / 32)
    heights = heights * 0.08 / np.sqrt(np.mean(np.square(slopes).sum(0)))
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion(), hardness=0.1)
    for pressure in (0.01, 0.05, 0.07, 0.08, 0.09, 0.095):
        state = js.equilibrate(contact, js.MeanPressure(pressure))
        assert state.residual <= 1e-9
        np.testing.assert_allclose(state.mean_pressure, pressure, rtol=1e-6)
        assert state.num_steps < 60


@pytest.mark.parametrize(
    ("solid", "hardness"),
    [
        (js.FreeHalfSpace(GRID, 1.0), 0.15),
        (js.solids.Layer(GRID, 1.0, 0.3, thickness=0.3), 0.4),
    ],
    ids=["FreeHalfSpace", "Layer"],
)
def test_windows_and_layers_yield(solid, hardness):
    x, y = GRID.coordinates
    dome = -((x - 0.5) ** 2 + (y - 0.5) ** 2)
    contact = contact_of(solid, heights=dome, hardness=hardness, law=js.potentials.NoAdhesion())
    state = js.equilibrate(contact, js.FarDisplacement(-0.15))
    assert 0 < state.yielded_area < state.contact_area
    np.testing.assert_allclose(state.pressure.max(), hardness, rtol=1e-7)
    np.testing.assert_allclose(state.displacement, state.signed_gap + dome, atol=1e-12)
    again = js.equilibrate(contact, js.FarDisplacement(-0.15), initial=state)
    assert again.num_steps == 0


@pytest.mark.nightly
def test_rings_yield_as_a_sphere_does():
    # First yield: p0 = H at F = pi^3 R^2 H^3 / (6 E*^2) (Johnson, Contact Mechanics, 1985).
    radius, hardness = 1.0, 0.1
    force = np.pi**3 * radius**2 * hardness**3 / 6
    rings = js.Rings(400, 0.5)
    heights = -(rings.radii**2) / (2 * radius)
    law = js.potentials.NoAdhesion()
    solid = js.solids.AxisymmetricHalfSpace(rings, 1.0)
    contact = js.Contact(solid, heights, law, hardness=hardness)
    areas = []
    for share in (0.95, 1.1):
        pressure = share * force / (np.pi * 0.5**2)
        state = js.equilibrate(contact, js.MeanPressure(pressure))
        areas.append(float(state.yielded_area))
    assert areas[0] == 0
    assert areas[1] > 0


@pytest.mark.nightly
def test_jit_vmap_and_single_precision_agree():
    loads = js.MeanPressure(jnp.array([0.01, 0.03]))
    many = jax.jit(jax.vmap(lambda load: js.equilibrate(contact_of(), load, throw=False)))(loads)
    one = js.equilibrate(contact_of(), loads[1])
    np.testing.assert_allclose(many.indentation[1], one.indentation, atol=1e-9)
    assert many.yielded_area.shape == (2,)
    single = js.Contact(js.HalfSpace(GRID, 1.0), HEIGHTS.astype(np.float32), LAW, hardness=HARDNESS)
    rough = js.equilibrate(single, js.MeanPressure(0.03))
    assert rough.indentation.dtype == np.float32
    np.testing.assert_allclose(rough.indentation, one.indentation, atol=2e-5)


def test_units_of_length_and_pressure_scale_alike():
    state = js.equilibrate(contact_of(), js.MeanPressure(0.03))
    grid = js.Grid(GRID.shape, (1e3, 1e3))
    law = js.potentials.Exponential(0.004e6, 100.0)
    scaled = js.Contact(js.HalfSpace(grid, 1e3), HEIGHTS * 1e3, law, hardness=HARDNESS * 1e3)
    other = js.equilibrate(scaled, js.MeanPressure(30.0))
    np.testing.assert_allclose(other.indentation, state.indentation * 1e3, rtol=1e-6, atol=1e-9)
    assert other.num_steps == state.num_steps


def test_the_surface_that_is_left_bears_the_load_without_yielding_more():
    contact = contact_of()
    state = js.equilibrate(contact, js.MeanPressure(0.03))
    left = contact.after(state)
    np.testing.assert_allclose(left.heights, HEIGHTS - state.indentation)
    again = js.equilibrate(left, js.MeanPressure(0.03), initial=state.gap)
    assert again.indentation.max() <= 1e-9
    np.testing.assert_allclose(again.displacement, state.displacement, atol=1e-8)
    unloaded = js.equilibrate(left, js.MeanPressure(0.02), initial=again)
    assert not unloaded.indentation.any()
    assert contact_of(hardness=None).after(state).hardness is None


@pytest.mark.parametrize("hardness", [0.0, -1.0, np.nan, [[1.0]], np.full(GRID.shape, -1.0)])
def test_an_impossible_hardness_is_refused(hardness):
    with pytest.raises(ValueError, match="hardness"):
        contact_of(hardness=np.asarray(hardness))


@pytest.mark.nightly
def test_a_hardness_below_the_repulsion_of_the_law_is_refused():
    with pytest.raises(ValueError, match="repels by 2, so that it allows no contact"):
        contact_of(hardness=1.0, law=lambda gap: jnp.exp(-2 * gap))
    with pytest.raises(ValueError, match="repels without bound, so that it allows no contact"):
        contact_of(law=js.potentials.LennardJones(0.01, 0.1))
    traced = jax.jit(
        lambda h: js.equilibrate(contact_of(hardness=h), js.MeanPressure(0.03), throw=False)
    )
    assert traced(-1.0).result == "invalid_contact"


@pytest.mark.parametrize("hardness", [HARDNESS, np.where(np.arange(6) < 3, 0.1, 0.2)])
def test_no_mean_pressure_is_above_the_mean_hardness(hardness):
    contact = contact_of(hardness=np.broadcast_to(hardness, GRID.shape))
    borne = js.equilibrate(contact, js.MeanPressure(0.99 * 0.15))
    np.testing.assert_allclose(borne.mean_pressure, 0.99 * 0.15)
    with pytest.raises(js.exceptions.SolverError, match="below the mean hardness of a surface"):
        js.equilibrate(contact, js.MeanPressure(1.01 * 0.15))


def test_a_viscoelastic_solid_has_no_hardness():
    solid = js.Viscoelastic(js.HalfSpace(GRID, 1.0), ratios=(1.0,), times=(1.0,))
    with pytest.raises(ValueError, match="Viscoelastic and has a hardness"):
        contact_of(solid)


def test_other_solvers_find_the_state_or_say_why_not():
    load = js.MeanGap(0.02)
    state = js.equilibrate(contact_of(), load)
    other = js.equilibrate(contact_of(), load, js.solvers.SaddleNewton(), initial=state.gap + 1e-3)
    np.testing.assert_allclose(other.indentation, state.indentation, atol=1e-8)
    with pytest.raises(ValueError, match="knows no hardness"):
        js.equilibrate(contact_of(), load, js.solvers.PolonskyKeerRey())


def derivative_case(numbers):
    hardness, modulus, energy, height, pressure = numbers
    contact = js.Contact(
        js.HalfSpace(GRID, modulus),
        HEIGHTS * height,
        js.potentials.Exponential(energy, 0.1),
        hardness=hardness,
    )
    solver = js.solvers.PreconditionedConjugateGradient(tolerance=1e-12)
    state = js.equilibrate(contact, js.MeanPressure(pressure), solver)
    weights = jnp.cos(jnp.arange(GRID.size)).reshape(GRID.shape)
    return jnp.stack(
        [
            jnp.sum(weights * state.indentation),
            jnp.sum(weights * state.gap),
            jnp.sum(weights * state.pressure),
            state.energy,
            state.plastic_work,
            jnp.mean(state.displacement),
        ]
    )


@pytest.mark.nightly
def test_derivatives_by_hardness_heights_modulus_and_law_are_those_of_differences():
    point = jnp.array([0.15, 1.0, 0.004, 1.0, 0.03])
    forward = np.asarray(jax.jacfwd(derivative_case)(point))
    step = 1e-6
    for i in range(point.size):
        above, below = (derivative_case(point.at[i].multiply(1 + s * step)) for s in (1, -1))
        differences = np.asarray(above - below) / (2 * step * float(point[i]))
        np.testing.assert_allclose(forward[:, i], differences, rtol=2e-5, atol=1e-7)
    backward = jax.grad(lambda point: derivative_case(point)[0])(point)
    np.testing.assert_allclose(backward, forward[0], rtol=1e-7, atol=1e-10)


def test_a_derivative_is_nan_where_points_just_begin_to_yield():
    contact = contact_of()
    state = js.equilibrate(contact, js.MeanPressure(0.03))

    def pressed(pressure):
        left = contact.after(state)
        return js.equilibrate(left, js.MeanPressure(pressure), initial=state.gap).displacement.sum()

    assert np.isnan(jax.grad(pressed)(0.03))
    assert np.isfinite(jax.grad(pressed)(0.029))


@pytest.mark.nightly
def test_a_hardness_that_is_impossible_in_a_trace_gives_no_state():
    @jax.vmap
    def state(hardness):
        return js.equilibrate(contact_of(hardness=hardness), js.MeanPressure(0.03), throw=False)

    found = state(jnp.array([HARDNESS, -1.0]))
    assert list(found.result.name) == ["successful", "invalid_contact"]
    assert 0 < found.yielded_area[0] < 1
    assert np.isnan(found.yielded_area[1])
    for name in ("gap", "indentation", "pressure", "plastic_work"):
        assert np.isnan(getattr(found, name)[1]).all(), name
