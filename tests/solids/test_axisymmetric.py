"""Rings against closed forms: Hertz, Sneddon, JKR, a tilted punch, layers, and dense algebra."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipe, ellipk

import jaxstab as js
from jaxstab.potentials import Exponential, NoAdhesion

N = 120


@pytest.fixture(scope="module")
def rings():
    return js.Rings(N, 2.0)


@pytest.fixture(scope="module")
def solid(rings):
    return js.solids.AxisymmetricHalfSpace(rings, 3.0, 0.3)


@pytest.fixture(scope="module")
def sticky(solid, rings):
    return js.Contact(solid, js.surfaces.paraboloid(rings, 4.0), Exponential(0.002, 0.03))


def test_a_uniform_pressure_on_the_disc_gives_johnsons_displacement(solid, rings):
    found = solid.displacement(jnp.ones(N))
    r = np.asarray(rings.radii) / 2
    exact = 4 * 2.0 / (np.pi * float(solid.contact_modulus)) * ellipe(r**2)
    # A mean over a ring is the value at the mean of r^2, but at the rim.
    np.testing.assert_allclose(found[:-3], exact[:-3], rtol=2e-4)


def test_a_single_ring_gives_the_integral_of_point_forces(solid, rings):
    edges = np.asarray(rings.edges)
    pressure = jnp.zeros(N).at[30].set(1.0)
    found = np.asarray(solid.displacement(pressure))

    def kernel(s, r):
        m = 4 * r * s / (r + s) ** 2
        return 4 * s / (np.pi * float(solid.contact_modulus)) * ellipk(m) / (r + s)

    for i in (2, 80):
        inner, outer = edges[i], edges[i + 1]
        r = np.sqrt((inner**2 + outer**2) / 2)
        exact = quad(kernel, edges[30], edges[31], args=(r,))[0]
        np.testing.assert_allclose(found[i], exact, rtol=1e-4)


def test_stiffness_compliance_and_preconditioner_are_inverses(solid):
    pressure = jax.random.normal(jax.random.key(0), (N,))
    modes = solid.modes
    np.testing.assert_allclose(solid.apply(solid.displacement(pressure)), pressure, atol=1e-9)
    dense = jax.vmap(modes.apply)(jnp.eye(N))
    np.testing.assert_allclose(dense, dense.T, atol=1e-10)
    exact = np.linalg.solve(dense + 0.7 * np.eye(N), pressure)
    np.testing.assert_allclose(modes.precondition(0.7)(pressure), exact, atol=1e-10)
    # Where the far side follows a uniform displacement takes no pressure.
    held = modes.with_uniform_stiffness(0)
    np.testing.assert_allclose(held.apply(jnp.ones(N)), 0, atol=1e-10)
    np.testing.assert_allclose(jnp.mean(held.apply(pressure)), 0, atol=1e-10)


def test_a_uniform_displacement_takes_the_force_of_a_flat_punch(rings, solid):
    force = float(solid.uniform_stiffness * rings.area)
    assert force == pytest.approx(2 * float(solid.contact_modulus) * 2.0, rel=1e-3)


def test_a_tilt_takes_the_moment_of_a_tilted_punch(rings, solid):
    pressure = solid.stiffness_of_order(1) @ rings.radii
    moment = float(rings.area) / 2 * float(jnp.mean(pressure * rings.radii))
    # M = 4 E* a^3 / 3 times the tilt; the rings err by 1 / N.
    exact = 4 / 3 * float(solid.contact_modulus) * 2.0**3
    assert moment == pytest.approx(exact, rel=3e-3)


def test_the_kernels_of_higher_orders_are_integrals_over_the_angle():
    from jaxstab.solids.axisymmetric import _kernel_less_that_of_order_zero

    for r, s, m in ((0.5, 0.52, 2), (0.1, 0.9, 1), (0.3, 0.2, 5)):

        def integrand(t, r=r, s=s, m=m):
            return (np.cos(m * t) - 1) / np.sqrt(r * r + s * s - 2 * r * s * np.cos(t))

        exact = 2 / np.pi * quad(integrand, 0, np.pi, limit=200, epsabs=1e-12)[0]
        found = _kernel_less_that_of_order_zero(np.array([[r]]), np.array([s]), m)
        np.testing.assert_allclose(found, exact, rtol=1e-10)


@pytest.mark.parametrize("load", ["displacement", "force", "spring"])
def test_hertz_under_each_load(solid, rings, load):
    contact = js.Contact(solid, js.surfaces.paraboloid(rings, 4.0), NoAdhesion())
    modulus = float(solid.contact_modulus)
    approach = 0.09
    force = 4 / 3 * modulus * 4**0.5 * approach**1.5
    pressure = force / float(rings.area)
    given = {
        "displacement": js.FarDisplacement(-approach),
        "force": js.MeanPressure(pressure),
        "spring": js.Spring(-approach - pressure / 5.0, 5.0),
    }[load]
    state = js.equilibrate(contact, given)
    assert float(state.force) == pytest.approx(force, rel=4e-4)
    # a^2 = R d, by a number of rings.
    assert float(state.contact_area) == pytest.approx(4 * approach / 4, abs=1 / N)
    deformation = solid.displacement(state.pressure)
    far = state.displacement - deformation
    np.testing.assert_allclose(far, -approach, rtol=1e-3)


def test_a_cone_and_a_punch_take_the_forces_of_sneddon(solid, rings):
    modulus = float(solid.contact_modulus)
    cone = js.Contact(solid, js.surfaces.cone(rings, 0.2), NoAdhesion())
    state = js.equilibrate(cone, js.FarDisplacement(-0.3))
    assert float(state.force) == pytest.approx(2 * modulus * 0.3**2 / (np.pi * 0.2), rel=1e-3)
    edges = np.asarray(rings.edges)
    heights = jnp.where(rings.radii < edges[40], 0.0, -50.0)
    punch = js.equilibrate(js.Contact(solid, heights, NoAdhesion()), js.FarDisplacement(-0.1))
    assert float(punch.force) == pytest.approx(2 * modulus * edges[40] * 0.1, rel=5e-3)


@pytest.mark.nightly
def test_eigenvalues_agree_with_dense_algebra(sticky, rings):
    state = js.equilibrate(sticky, js.FarDisplacement(-0.05))
    stability = js.assess_stability(sticky, state, orders=2)
    K = np.linalg.inv(jax.vmap(sticky.solid.displacement)(jnp.eye(N)))
    A = K + np.diag(sticky.curvature(state.gap))
    free = np.asarray(state.gap > 0)
    lowest = np.linalg.eigvalsh(A[np.ix_(free, free)])[0]
    assert float(stability.critical.eigenvalue) == pytest.approx(lowest, rel=1e-6)
    assert float(stability.lower_bound.eigenvalue) == pytest.approx(
        np.linalg.eigvalsh(A)[0], rel=1e-6
    )
    for mode in stability.angular:
        dense = np.asarray(sticky.solid.stiffness_of_order(int(mode.order)))
        dense = dense + np.diag(sticky.curvature(state.gap))
        exact = np.linalg.eigvalsh(dense[np.ix_(free, free)])[0]
        assert float(mode.eigenvalue) == pytest.approx(exact, rel=1e-8)
    # A sphere peels evenly.
    lowest = [float(stability.critical.eigenvalue), *stability.angular.eigenvalue]
    assert np.all(np.diff(lowest) > 0)


@pytest.mark.nightly
def test_pull_off_is_between_the_limits_of_maugis(sticky):
    end = js.pull_off(sticky)
    force = -float(end.equilibrium.force) / (np.pi * 0.002 * 4.0)
    assert 1.5 < force < 2.0
    # The same contact on squares of a window agrees within the error of its grid.
    grid = js.Grid(48, (2.4, 2.4))
    squares = js.Contact(
        js.FreeHalfSpace(grid, 3.0, 0.3), js.surfaces.paraboloid(grid, 4.0), sticky.potential
    )
    other = js.equilibrate(squares, js.FarDisplacement(-0.05))
    same = js.equilibrate(sticky, js.FarDisplacement(-0.05))
    assert float(same.force) == pytest.approx(float(other.force), rel=0.02)


def test_a_thin_layer_is_an_elastic_foundation(rings):
    layer = js.Layer(js.Grid(4), 1.0, 0.3, 0.01)
    pressure = js.solids.Axisymmetric(rings, layer).apply(jnp.ones(N))
    np.testing.assert_allclose(pressure[: N // 2], layer.uniform_stiffness, rtol=1e-3)


@pytest.mark.nightly
def test_a_layer_agrees_with_its_hankel_transform(rings):
    layer = js.Layer(js.Grid(4), 1.0, 0.3, 0.5)
    found = js.solids.Axisymmetric(rings, layer).displacement(jnp.ones(N))[0]

    def integrand(q):
        # u(0) under a uniform pressure on a disc: R int J_1(q R) / K dq.
        from scipy.special import j1

        return 2.0 * j1(2.0 * q) / float(layer.stiffness_at(jnp.asarray(q)))

    half = 1 / (1 - 0.3**2)

    def difference(q):
        from scipy.special import j1

        return 2.0 * j1(2.0 * q) * (1 / float(layer.stiffness_at(jnp.asarray(q))) - 2 / (half * q))

    exact = 2 * 2.0 / half + quad(difference, 1e-9, 30, limit=200)[0]
    # The first ring is a disc.
    np.testing.assert_allclose(found, exact, rtol=1e-3)


@pytest.mark.nightly
def test_derivatives_agree_with_differences(rings):
    def force(modulus, radius):
        disc = js.Rings(60, radius)
        solid = js.solids.AxisymmetricHalfSpace(disc, modulus)
        contact = js.Contact(solid, js.surfaces.paraboloid(disc, 4.0), Exponential(0.002, 0.05))
        return js.equilibrate(contact, js.FarDisplacement(-0.05)).force

    point = (1.0, 2.0)
    found = jax.grad(force, (0, 1))(*point)
    for i, derivative in enumerate(found):
        step = 1e-5 * np.eye(2)[i]
        ends = [force(*(np.array(point) + sign * step)) for sign in (-1, 1)]
        assert float(derivative) == pytest.approx(float(ends[1] - ends[0]) / 2e-5, rel=1e-4)


@pytest.mark.nightly
def test_single_precision_and_batches_agree(sticky):
    single = js.Contact(sticky.solid, sticky.heights.astype(jnp.float32), sticky.potential)
    loads = js.FarDisplacement(jnp.array([-0.02, -0.05]))
    batch = jax.jit(jax.vmap(lambda load: js.equilibrate(sticky, load, throw=False).force))(loads)
    for i, value in enumerate(loads.value):
        found = js.equilibrate(single, js.FarDisplacement(float(value)))
        assert found.gap.dtype == jnp.float32
        assert float(found.force) == pytest.approx(float(batch[i]), rel=1e-3)


def test_a_path_and_a_file_hold_rings(sticky, tmp_path):
    path = js.follow(sticky, js.FarDisplacement(jnp.array([0.0, -0.05])))
    js.save(tmp_path / "path.nc", sticky, path)
    contact, loaded = js.load(tmp_path / "path.nc")
    assert contact.grid.num_points == N
    force = path.equilibrium.mean_pressure
    np.testing.assert_array_equal(loaded.equilibrium.mean_pressure, force)
    dataset = js.to_dataset(sticky, js.equilibrate(sticky, js.MeanPressure(0.0)))
    np.testing.assert_array_equal(dataset.coords["r"], sticky.grid.radii)
    assert dataset.gap.dims == ("r",)


@pytest.mark.nightly
def test_a_growing_contact_of_a_viscoelastic_half_space_is_that_of_lee_and_radok(solid, sticky):
    viscoelastic = js.Viscoelastic(solid, ratios=[1.5], times=[0.7])
    contact = js.Contact(viscoelastic, sticky.heights, NoAdhesion())
    load = js.FarDisplacement(jnp.array([0.0, -0.09]))
    evolution = js.evolve(contact, load, [0.0, 1.0])
    # F = 4 / (3 R) int E*(t - s) d(a^3), a^2 = R d: Lee and Radok (1960).
    modulus = float(solid.contact_modulus)

    def rate(s):
        relaxation = modulus * (1 + 1.5 * np.exp(-(1 - s) / 0.7))
        return 4 / (3 * 4.0) * relaxation * 1.5 * (4 * 0.09) ** 1.5 * s**0.5

    exact = quad(rate, 0, 1)[0]
    assert float(evolution.force[-1]) == pytest.approx(exact, rel=5e-3)


@pytest.mark.nightly
def test_a_branch_through_unstable_states_lies_on_the_curve_of_maugis():
    sphere = (1.0, 1.0, 1e-3)
    unit = js.references.jkr.units(*sphere)
    strength = 1 / float(js.references.maugis.transition_parameter(*sphere, 1.0))
    rings = js.Rings(200, 2.2 * float(unit.contact_radius))
    law = js.potentials.Dugdale(1e-3, 1e-3 / strength, 0.05)
    solid = js.solids.AxisymmetricHalfSpace(rings, 1.0)
    contact = js.Contact(solid, js.surfaces.paraboloid(rings, 1.0), law)
    ends = js.FarDisplacement(jnp.array([0.2, 1.8]) * float(unit.displacement))
    branch = js.continuation(contact, ends, initial=js.equilibrate(contact, ends[0]))
    assert branch.end.name == "load"
    radii = np.geomspace(1e-3, 3, 4000) * unit.contact_radius
    outer = float(js.references.maugis.first_touch(*sphere, strength).outer_radius)
    curves = [
        js.references.maugis.curve(radii, *sphere, strength),
        js.references.maugis.without_contact(np.linspace(0, outer, 4000), *sphere, strength),
    ]
    touches = np.asarray(branch.equilibrium.contact_area) > 0
    is_unstable = np.asarray(branch.index) > 0
    places = -np.asarray(branch.load.value) / unit.displacement
    forces = np.asarray(branch.equilibrium.force) / unit.force
    # Without contact the edge of the law, which is smoothed, acts.
    chosen = ((touches, 0.003), (is_unstable & ~touches, 0.02))
    for exact, (some, close) in zip(curves, chosen, strict=True):
        assert some.sum() > 10
        d, f = exact.displacement / unit.displacement, exact.force / unit.force
        for place, force in zip(places[some], forces[some], strict=True):
            assert np.hypot(d - place, f - force).min() < close


def test_rings_are_chosen_for_a_contact():
    def profile(r):
        return -(r**2) / 2e-5

    chosen = js.Rings.for_contact(profile, 1e6, force=1e-8, work_of_adhesion=0.05, length=40e-9)
    solid = js.solids.AxisymmetricHalfSpace(chosen, 1e6)
    contact = js.Contact(solid, profile(chosen.radii), Exponential(0.05, 40e-9))
    state = js.equilibrate(contact, js.MeanPressure(1e-8 / float(chosen.area)))
    radius = float(chosen.radius) * float(state.contact_area) ** 0.5
    assert 0.5 < radius / float(chosen.radius) < 0.75
    assert contact.resolution > 4
    # Eight ranges take a larger disc, with as many rings within JKR's contact at pull-off.
    wide = js.Rings.for_contact(profile, 1e6, force=1e-8, work_of_adhesion=0.05, length=4e-7)
    assert float(wide.radius) > 1.3 * float(chosen.radius)
    smallest = (9 * np.pi * 0.05 * 1e-5**2 / (8 * 1e6)) ** (1 / 3)
    assert float(np.sum(wide.edges[1:] < smallest)) == pytest.approx(30, abs=3)


def test_a_disc_conducts_as_holm_says(rings, solid):
    edge = float(rings.edges[60])
    heights = jnp.where(rings.radii < edge, 0.0, -1.0)
    contact = js.Contact(solid, heights, NoAdhesion())
    state = js.equilibrate(contact, js.FarDisplacement(-0.1))
    found = js.conductance(contact, state, (0.3, 0.7))
    assert float(found.conductance) == pytest.approx(4 * edge, rel=2e-3)
    places = np.flatnonzero(state.in_contact)
    columns = np.asarray(jax.vmap(solid.displacement)(jnp.eye(N)))
    pressure = np.linalg.solve(columns[np.ix_(places, places)], np.ones(places.size))
    stiffness = pressure.sum() * float(rings.cell_area)
    assert float(found.incremental_stiffness) == pytest.approx(stiffness, rel=1e-8)


def test_patches_and_leakage_say_why_not(sticky):
    state = js.equilibrate(sticky, js.FarDisplacement(-0.05))
    with pytest.raises(ValueError, match="a disc and annuli"):
        js.patches(sticky, state)
    with pytest.raises(ValueError, match="a window that does not repeat"):
        js.leakage(sticky, state)
    with pytest.raises(TypeError, match="not periodic"):
        js.surfaces.rms_slope(sticky.grid, sticky.heights)


def test_figures_are_drawn_over_the_radius(sticky):
    state = js.equilibrate(sticky, js.FarDisplacement(-0.05))
    axes = js.plots.contact_map(sticky, state)
    (area,) = axes.collections
    filled = np.concatenate([path.vertices for path in area.get_paths()])
    # Up to the edge of the outermost ring in contact.
    edge = float(sticky.grid.edges[int(np.sum(state.in_contact))])
    np.testing.assert_allclose([filled[:, 0].min(), filled[:, 0].max()], [0, edge])
    assert axes.get_xlabel() == "r [length]"
    figure = js.plots.summary(sticky, state, js.assess_stability(sticky, state))
    # Surface, gap, pressure and mode.
    assert [axes.get_xlabel() for axes in figure.axes].count("r [length]") == 4
    # The disc beside a profile: of the pixels within a radius as many as its share of the area.
    (disc,) = js.plots.pressure(sticky, state, axes=plt.figure().gca()).child_axes
    seen = disc.images[0].get_array()
    assert np.mean(~seen.mask) == pytest.approx(np.pi / 4, abs=0.01)
    share = float(jnp.mean(state.pressure > 0))
    assert np.sum(seen > 0) / np.sum(~seen.mask) == pytest.approx(share, abs=0.01)
    plt.close("all")


def test_a_hyperboloid_takes_sneddons_force(rings, solid):
    a, slope, apex = 0.9, 0.5, 0.3
    contact = js.Contact(solid, js.surfaces.hyperboloid(rings, apex, slope), NoAdhesion())

    def fall(r):
        return r / apex / (1 + (r / (slope * apex)) ** 2) ** 0.5

    approach = quad(lambda t: a * fall(a * np.sin(t)), 0, np.pi / 2)[0]
    integral = quad(lambda t: (a * np.sin(t)) ** 2 * fall(a * np.sin(t)), 0, np.pi / 2)[0]
    state = js.equilibrate(contact, js.FarDisplacement(-approach))
    exact = 2 * float(solid.contact_modulus) * integral
    assert float(state.force) == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"force": -1.0}, "The force is -1"),
        ({"force": 0.0}, "no contact radius of this tip"),
        ({"force": 0.0, "work_of_adhesion": 0.01}, "The range of the law is 0"),
        ({"force": 0.0, "work_of_adhesion": 0.01, "length": 1e-4}, "A range of .* takes 4000"),
        ({"force": 30.0, "work_of_adhesion": 0.01, "length": 0.3}, "The force is 30.* smaller"),
    ],
)
def test_a_choice_that_is_impossible_is_told(arguments, message):
    with pytest.raises(ValueError, match=message):
        js.Rings.for_contact(lambda r: -(r**2) / 2, 1.0, **arguments)


def test_mistakes_are_told(rings, solid, sticky):
    with pytest.raises(ValueError, match="The number of rings is 1"):
        js.Rings(1, 1.0)
    with pytest.raises(ValueError, match="radius of the disc is -1"):
        js.Rings(10, -1.0)
    with pytest.raises(TypeError, match="AxisymmetricHalfSpace"):
        js.HalfSpace(rings, 1.0)
    with pytest.raises(TypeError, match="AxisymmetricHalfSpace"):
        js.FreeHalfSpace(rings, 1.0)
    with pytest.raises(TypeError, match="give a function that returns the height"):
        js.Rings.for_contact(np.zeros(4), 1.0, force=1.0)
    with pytest.raises(TypeError, match="no rings"):
        js.solids.AxisymmetricHalfSpace(js.Grid(8), 1.0)
    with pytest.raises(TypeError, match="stiffness for every wavenumber"):
        js.solids.Axisymmetric(rings, solid)
    with pytest.raises(ValueError, match="FarDisplacement"):
        js.equilibrate(sticky, js.MeanGap(0.1))
    grid = js.Grid(8)
    flat = js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros((8, 8)), NoAdhesion())
    with pytest.raises(ValueError, match="orders"):
        js.assess_stability(flat, js.equilibrate(flat, js.MeanGap(0.1)), orders=2)
    with pytest.raises(ValueError, match=r"give `ranges` from 0\.\d+ sqrt\(R / a\) on"):
        js.extrapolate(lambda contact: js.pull_off(contact).load.value, sticky)
    with pytest.warns(js.exceptions.WindowWarning, match="rim of the disc"):
        js.equilibrate(sticky, js.FarDisplacement(-1.2))


def test_areas_forces_and_energies_of_a_disc_have_the_units_of_a_surface(sticky):
    contact = js.Contact(
        sticky.solid, sticky.heights, sticky.potential, unit="um", pressure_unit="MPa"
    )
    dataset = js.to_dataset(contact, js.equilibrate(contact, js.MeanPressure(0.0)))
    assert dataset.area.units == "µm^2"
    assert dataset.energy.units == "pJ"
