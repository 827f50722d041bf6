"""The half space under a single contact: Love, Hertz, dense algebra, differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import TIGHT
from scipy.integrate import quad

import jaxstab as js

GRIDS = [js.Grid(8), js.Grid((7, 4), (1.0, 3.0)), js.Grid((9,), (2.0,))]
NONE = js.potentials.Exponential(0.0, 1.0)


def below_a_rectangle(x, y, a, b):
    """Return the displacement by unit pressure on |x| < a, |y| < b, for E* = 1 (Love, 1929)."""

    def part(s, t):
        return s * np.log((t + np.hypot(s, t)) / np.abs(s))

    corners = [(1, 1), (-1, -1), (1, -1), (-1, 1)]
    return (
        sum(i * j * (part(x + i * a, y + j * b) + part(y + j * b, x + i * a)) for i, j in corners)
        / np.pi
    )


def coefficients(grid):
    """Return the displacement of each cell by unit pressure on each, a matrix, for E* = 1."""
    halves = np.asarray(grid.spacing) / 2
    points = np.stack([np.asarray(x).ravel() for x in grid.coordinates])
    distances = points[:, :, None] - points[:, None]
    if len(halves) == 2:
        return below_a_rectangle(*distances, *halves)
    length = float(grid.lengths[0])
    parts = [
        quad(lambda s: -2 / np.pi * np.log(s / length), lower, upper)[0]
        for r in abs(distances[0, 0])
        for lower, upper in [(abs(r - halves[0]) if r > 0 else 0, r + halves[0])]
    ]
    parts = np.array([2 * parts[0], *parts[1:]])
    return parts[np.rint(abs(distances[0]) / (2 * halves[0])).astype(int)]


def test_a_loaded_square_sinks_as_love_says():
    for n in (31, 64):
        grid = js.Grid(n, [2.0, 2.0])
        sunk = np.asarray(js.FreeHalfSpace(grid, 3.0, 0.4).displacement(jnp.ones((n, n))))
        modulus = 3.0 / (1 - 0.4**2)
        # What is given is the mean of no cell but the value in its middle.
        for i in (n // 2, 0):
            place = (2 * i + 1) / n - 1
            exact = below_a_rectangle(place, place, 1.0, 1.0) / modulus
            np.testing.assert_allclose(sunk[i, i], exact, rtol=1e-12)
    # Between the four cells in the middle of an even number lies the centre: 8 ln(1 + sqrt 2) / pi.
    centre = 8 * np.log(1 + np.sqrt(2)) / (np.pi * modulus)
    assert abs(sunk[32, 32] / centre - 1) < 1e-3


@pytest.mark.parametrize("grid", GRIDS)
def test_the_displacement_is_the_sum_over_cells_and_is_undone_by_the_pressure(grid):
    solid = js.FreeHalfSpace(grid, 2.0)
    pressure = jax.random.normal(jax.random.key(0), grid.shape)
    exact = coefficients(grid) / 2.0 @ np.asarray(pressure).ravel()
    np.testing.assert_allclose(solid.displacement(pressure).ravel(), exact, atol=1e-12)
    np.testing.assert_allclose(solid.pressure(solid.displacement(pressure)), pressure, atol=1e-9)


def sphere_contact(n, law=NONE, length=1.0, modulus=1.0, grid=None):
    grid = js.Grid(n, [length, length]) if grid is None else grid
    heights = js.surfaces.paraboloid(grid, 1.0)
    return js.Contact(js.FreeHalfSpace(grid, modulus), heights, law)


FORCE = 4 / 3 * 0.04**1.5
SPRING = js.Spring(-0.04 - FORCE / 0.1, 0.1)


@pytest.mark.parametrize(
    "load",
    [
        js.FarDisplacement(-0.04),
        pytest.param(js.MeanPressure(FORCE), marks=pytest.mark.nightly),
        pytest.param(SPRING, marks=pytest.mark.nightly),
    ],
    ids=lambda load: type(load).__name__,
)
def test_hertz_is_met_under_every_load(load):
    contact = sphere_contact(48)
    equilibrium = js.equilibrate(contact, load)
    assert equilibrium.gap.shape == (48, 48)
    far = equilibrium.displacement - contact.solid.displacement(equilibrium.pressure)
    np.testing.assert_allclose(equilibrium.force, FORCE, rtol=5e-3)
    np.testing.assert_allclose(far, -0.04, rtol=5e-3)
    np.testing.assert_allclose(np.sqrt(equilibrium.contact_area / np.pi), 0.2, rtol=2e-2)
    r = np.hypot(*(x - 0.5 for x in contact.grid.coordinates))
    inside = r < 0.15
    exact = 2 * 0.2 / np.pi * np.sqrt(1 - (r[inside] / 0.2) ** 2)
    np.testing.assert_allclose(equilibrium.pressure[inside], exact, rtol=2e-2)


LAW = js.potentials.Exponential(0.01, 0.1)


PLANE, LINE = js.Grid((5, 4), (1.0, 0.7)), js.Grid((9,), (1.0,))


@pytest.mark.parametrize(
    ("grid", "load"),
    [(PLANE, js.MeanPressure(-1e-3)), pytest.param(LINE, SPRING, marks=pytest.mark.nightly)],
)
def test_equilibrium_and_eigenvalues_agree_with_dense_algebra(grid, load):
    contact = sphere_contact(0, LAW, grid=grid)
    equilibrium = js.equilibrate(contact, load, TIGHT)
    u, g, p = (
        np.asarray(x).ravel()
        for x in (equilibrium.displacement, equilibrium.gap, equilibrium.pressure)
    )
    area = float(jnp.prod(grid.lengths))
    far = u - coefficients(grid) @ p
    np.testing.assert_allclose(far, far[0], atol=1e-9)
    attraction = 0.1 * np.exp(-g / 0.1)
    reaction = p + attraction
    np.testing.assert_allclose(np.where(g > 0, reaction, 0), 0, atol=1e-9)
    assert (reaction >= -1e-9).all()
    np.testing.assert_allclose(equilibrium.force, p.mean() * area, rtol=1e-8, atol=1e-12)
    held = {
        "FarDisplacement": far[0] + 0.04,
        "MeanPressure": p.mean() - float(load.value),
        "Spring": p.mean() - 0.1 * (far[0] - float(load.value)),
    }
    np.testing.assert_allclose(held[type(load).__name__], 0, atol=1e-9)
    # On the window the stiffness is the inverse of the coefficients, the far side held or not.
    inverse = np.linalg.inv(coefficients(grid))
    ones = np.ones(g.size)
    part = inverse @ ones
    spring = {"FarDisplacement": None, "MeanPressure": 0.0, "Spring": 0.1 * g.size}
    constant = spring[type(load).__name__]
    if constant is not None:
        inverse = inverse - np.outer(part, part) / (ones @ part + constant)
    window = inverse + np.diag(-attraction / 0.1)
    stability = js.assess_stability(contact, equilibrium)
    assert stability.cone.mode.shape == grid.shape
    # A mode that reaches beyond the window is longer there, but its energy is the same.
    exact, found = np.linalg.eigvalsh(window)[0], stability.lower_bound.eigenvalue
    assert np.sign(found) == np.sign(exact) and abs(found) <= abs(exact)


@pytest.mark.nightly
def test_batches_single_precision_and_derivatives_work():
    def force(modulus, load=-0.04):
        contact = sphere_contact(16, modulus=modulus)
        return js.equilibrate(contact, js.FarDisplacement(load), TIGHT, throw=False).force

    one = force(2.0)
    np.testing.assert_allclose(jax.jit(jax.vmap(force))(jnp.asarray([1.0, 2.0]))[1], one)
    np.testing.assert_allclose(jax.grad(force)(2.0), one / 2.0, rtol=1e-6)
    difference = (force(2.0, -0.04 + 1e-6) - force(2.0, -0.04 - 1e-6)) / 2e-6
    np.testing.assert_allclose(jax.grad(force, 1)(2.0, -0.04), difference, rtol=1e-4)
    grid = js.Grid(16, np.ones(2, np.float32))
    heights = js.surfaces.paraboloid(grid, np.float32(1.0))
    contact = js.Contact(js.FreeHalfSpace(grid, np.float32(2.0)), heights, NONE)
    single = js.equilibrate(contact, js.FarDisplacement(-0.04))
    assert single.gap.dtype == np.float32
    np.testing.assert_allclose(single.force, one, rtol=1e-3)


@pytest.mark.parametrize("size", [1e-20, 1e19])
def test_pressures_are_proportional_to_displacements_in_single_precision(size):
    solid = js.FreeHalfSpace(js.Grid(8, np.ones(2, np.float32)), np.float32(1.0))
    displacement = jax.random.normal(jax.random.key(0), (8, 8), jnp.float32)
    pressure, scaled = solid.pressure(displacement), solid.pressure(np.float32(size) * displacement)
    np.testing.assert_allclose(scaled / np.float32(size), pressure, rtol=1e-4, atol=1e-4)


@pytest.mark.nightly
def test_what_a_window_cannot_answer_is_said():
    contact = sphere_contact(16)
    for load in (js.MeanGap(0.1), js.MeanDisplacement(0.1)):
        name = type(load).__name__
        with pytest.raises(
            ValueError, match=rf"{name} cannot be held on the window of a FreeHalfSpace.*FarDisp"
        ):
            js.equilibrate(contact, load)
        with pytest.raises(
            ValueError, match=rf"{name} cannot be held on the window of a FreeHalfSpace.*FarDisp"
        ):
            js.follow(contact, type(load)(jnp.asarray([0.1, 0.2])))
    with pytest.warns(
        js.exceptions.WindowWarning, match="edges of the window the pressure exceeds 1% of"
    ):
        js.equilibrate(contact, js.FarDisplacement(-0.25))
    with pytest.raises(js.exceptions.SolverError, match="bulges around its edges"):
        js.equilibrate(contact, js.FarDisplacement(-5.0))


def test_energies_and_hessians_of_a_gap_are_those_of_the_whole():
    contact = sphere_contact(16)
    state = js.equilibrate(contact, js.FarDisplacement(-0.01))
    for ask in (contact.energy, contact.hessian, lambda gap: contact.gradient(gap)):
        with pytest.raises(TypeError, match=r"twice its points a side: use `contact\.padded`"):
            ask(state.gap)


@pytest.mark.parametrize("grid", [js.Grid(8), js.Grid((12,))])
def test_full_contact_stores_the_least_of_any_rigid_move(grid):
    solid = js.FreeHalfSpace(grid, 2.0)
    heights = jax.random.normal(jax.random.key(0), grid.shape)
    size = grid.size
    points = jnp.eye(size).reshape(size, *grid.shape)
    compliance = np.asarray(jax.vmap(solid.displacement)(points)).reshape(size, size)
    h, one = np.asarray(heights).ravel(), np.ones(size)
    pressure, rigid = np.linalg.solve(compliance, np.stack([h, one], 1)).T
    least = (h @ pressure - (one @ pressure) ** 2 / (one @ rigid)) / 2 / size
    found = js.surfaces.full_contact_energy(solid, heights)
    np.testing.assert_allclose(found, least, rtol=1e-6)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_reverse_mode_by_the_lengths_of_a_window_agrees_with_differences():
    heights = js.surfaces.paraboloid(js.Grid(8, (4.0, 4.0)), radius=2.0)

    def numbers(length):
        solid = js.FreeHalfSpace(js.Grid(8, (length, length)), 1.0)
        contact = js.Contact(solid, heights, js.potentials.Exponential(0.1, 0.5))
        state = js.equilibrate(contact, js.FarDisplacement(0.1))
        judged = js.assess_stability(contact, state)
        return jnp.stack([state.mean_pressure, state.energy, judged.critical.eigenvalue])

    found = jax.jit(jax.jacrev(numbers))(4.0)
    both = jax.jit(numbers)
    expected = (both(4.0 + 1e-4) - both(4.0 - 1e-4)) / 2e-4
    np.testing.assert_allclose(found, expected, rtol=1e-5)
