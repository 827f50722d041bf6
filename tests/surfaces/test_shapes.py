"""Single asperities: against their geometry, SciPy's interpolation and Hertz."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import jaxstab as js

GRIDS = [js.Grid((10,), (2.0,)), js.Grid((9, 6), (1.0, 3.0)), js.Grid((8, 7))]
PROFILE = np.array([0.0, 0.1, 0.3, 0.4, 0.7, 1.1, 1.7]), -np.array([0, 0.01, 0.2, 0.2, 0.9, 1, 3.0])


def distance(grid):
    sides = [np.arange(n) / n - 0.5 for n in grid.shape]
    points = np.meshgrid(*sides, indexing="ij")
    return np.sqrt(sum((x * L) ** 2 for x, L in zip(points, np.asarray(grid.lengths), strict=True)))


@pytest.mark.parametrize("grid", GRIDS)
def test_shapes_have_the_heights_that_geometry_gives_them(grid):
    r = distance(grid)
    below = np.where(r < 0.7, 0.7 * np.sin(np.arccos(np.minimum(r / 0.7, 1))), 0) - 0.7
    exact = {
        "sphere": (js.surfaces.sphere(grid, 0.7), below),
        "cone": (js.surfaces.cone(grid, 0.2), -0.2 * r),
        "hyperboloid": (
            js.surfaces.hyperboloid(grid, 0.3, 0.5),
            0.075 - np.sqrt(0.075**2 + 0.25 * r**2),
        ),
        "punch": (
            js.surfaces.flat_punch(grid, 0.3, 0.5),
            np.where(r < 0.3, 0, -((r - 0.3) ** 2)),
        ),
        "wavy": (
            js.surfaces.wavy_sphere(grid, 2.0, 0.1, 0.5),
            -(r**2) / 4 - 0.2 * np.sin(2 * np.pi * r) ** 2,
        ),
    }
    for name, (found, heights) in exact.items():
        np.testing.assert_allclose(found, heights, atol=1e-12, err_msg=name)


def test_a_small_sphere_cap_is_a_paraboloid_to_all_digits():
    grid = js.Grid((16, 16), (1e-6, 1e-6))
    difference = js.surfaces.sphere(grid, 1.0) / js.surfaces.paraboloid(grid, 1.0).at[8, 8].set(1)
    np.testing.assert_allclose(difference.at[8, 8].set(1), 1, rtol=1e-12)


@pytest.mark.parametrize("grid", GRIDS)
def test_a_tip_goes_through_its_profile_as_scipys_does(grid):
    radii, heights = PROFILE
    r = distance(grid)
    both = PchipInterpolator([*-radii[:0:-1], *radii], [*heights[:0:-1], *heights])
    inner = r <= radii[-2]
    found = np.asarray(js.surfaces.tip(grid, radii, heights))
    np.testing.assert_allclose(found[inner], both(r[inner]), atol=1e-12)
    assert (found[~inner] >= heights[-1]).all() and (found[~inner] <= heights[-2]).all()


@pytest.mark.nightly
def test_shapes_can_be_differentiated():
    grid = js.Grid(6)
    radii, heights = (jnp.asarray(x) for x in PROFILE)
    functions = [
        (lambda x: js.surfaces.sphere(grid, x), 0.4),
        (lambda x: js.surfaces.cone(js.Grid(6, jnp.stack([x, 2 * x])), x), 0.4),
        (lambda x: js.surfaces.hyperboloid(grid, x, x), 0.37),
        (lambda x: js.surfaces.flat_punch(grid, x, x), 0.37),
        (lambda x: js.surfaces.wavy_sphere(grid, x, x, x), 0.4),
        (lambda x: js.surfaces.tip(grid, radii, x * heights), 0.4),
    ]
    for function, value in functions:
        function = jax.jit(function)
        slope = jax.jit(jax.jacrev(function))(value)
        differences = (function(value + 1e-6) - function(value - 1e-6)) / 2e-6
        np.testing.assert_allclose(slope, differences, atol=1e-7)
    single = js.surfaces.sphere(js.Grid(6, np.ones(2, np.float32)), np.float32(2.0))
    assert single.dtype == np.float32


def test_a_tip_given_by_its_depths_is_named():
    radii, heights = PROFILE
    with pytest.warns(
        js.exceptions.SurfaceWarning, match="highest at its end, r = .*-profile_heights"
    ):
        js.surfaces.tip(js.Grid(6), radii, -heights)


RADII, HEIGHTS = PROFILE


@pytest.mark.parametrize(
    ("shape", "arguments", "sentence"),
    [
        ("sphere", [-1.0], r"is -1\.0: it must be positive"),
        ("cone", [-1.0], r"is -1\.0: it must be positive"),
        ("paraboloid", [np.ones(6)], r"The radius has shape \(6,\): give one number"),
        ("hyperboloid", [1.0, 0.0], r"slope is 0\.0"),
        ("flat_punch", [1.0, 0.0], r"radius of the rim is 0\.0"),
        ("wavy_sphere", [1.0, 0.1, 0.0], r"wavelength is 0\.0"),
        ("wavy_sphere", [1.0, np.inf, 1.0], r"amplitude is inf"),
        ("tip", [RADII + 0.1, HEIGHTS], "ascend from zero"),
        ("tip", [RADII[::-1], HEIGHTS], "ascend from zero"),
        ("tip", [RADII[:4], HEIGHTS[:4]], r"last radius of the profile is 0\.4: the grid reaches"),
        ("tip", [RADII, HEIGHTS[:3]], r"shape \(7,\) and heights of shape \(3,\)"),
        ("tip", [RADII, HEIGHTS * np.nan], r"profile is nan at \(0,\)"),
    ],
)
def test_what_makes_no_shape_is_refused(shape, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        getattr(js.surfaces, shape)(js.Grid(6), *arguments)


@pytest.mark.nightly
@pytest.mark.parametrize("grid", [js.Grid((32, 32), (2.0, 2.0)), js.Grid((32,), (2.0,))])
def test_the_force_is_the_sum_of_pressures_over_the_points(grid):
    heights = js.surfaces.sphere(grid, 2.0)
    contact = js.Contact(js.HalfSpace(grid, 3.0), heights, js.potentials.Exponential(0.01, 0.2))
    point = np.prod([2.0 / n for n in grid.shape])
    swept = js.sweep(contact, js.MeanGap(jnp.asarray([0.1, 0.2])), stability=False)
    total = np.asarray(swept.equilibrium.pressure).reshape(2, -1).sum(1) * point
    np.testing.assert_allclose(swept.equilibrium.force, total, rtol=1e-9)
    if len(grid.shape) == 2:
        # With fields, as other paths on such a grid are followed.
        path = js.follow(contact, js.MeanGap(jnp.asarray([0.1, 0.2])), fields=True)
        np.testing.assert_allclose(path.equilibrium.force[0], total[0], rtol=1e-6)
        assert path.equilibrium.force.shape == path.load.value.shape


@pytest.mark.nightly
def test_the_force_under_a_pressure_grows_with_the_area_of_the_cell():
    def force(length):
        grid = js.Grid((8, 8), jnp.stack([length, length]))
        heights = js.surfaces.paraboloid(grid, 2.0)
        contact = js.Contact(js.HalfSpace(grid, 3.0), heights, js.potentials.Exponential(0.01, 0.2))
        return js.equilibrate(contact, js.MeanPressure(0.01), throw=False).force

    np.testing.assert_allclose(jax.jit(jax.grad(force))(2.0), 0.01 * 2 * 2.0, rtol=1e-8)


def test_traced_radii_that_are_not_positive_give_no_surface():
    heights = jax.vmap(lambda r: js.surfaces.paraboloid(js.Grid(4), r))(jnp.array([2.0, -2.0]))
    np.testing.assert_allclose(heights[0], js.surfaces.paraboloid(js.Grid(4), 2.0))
    assert np.isnan(heights[1]).all()
