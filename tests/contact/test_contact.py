import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact

import jaxstab as js
from jaxstab.equilibrium.posing import pose

POTENTIALS = [js.potentials.Gaussian(0.3, 0.2), js.potentials.NoAdhesion()]


@jax.jit
def residual_of(contact, gap):
    return contact.balance(contact.control(js.MeanGap(gap.mean())))(gap).residual


@pytest.fixture(scope="module", params=POTENTIALS, ids=lambda law: type(law).__name__)
def contact(request):
    return rough_contact(16, request.param)


@pytest.fixture(scope="module")
def gap():
    return jnp.abs(jax.random.normal(jax.random.key(1), (16, 16)))


def test_the_gradient_is_that_of_the_energy(contact, gap):
    by_autodiff = jax.grad(contact.energy)(gap) / contact.grid.cell_area
    np.testing.assert_allclose(contact.gradient(gap), by_autodiff, atol=1e-10)


def test_the_hessian_is_the_derivative_of_the_gradient(contact, gap):
    perturbation = jax.random.normal(jax.random.key(2), gap.shape)
    _, by_autodiff = jax.jvp(contact.gradient, (gap,), (perturbation,))
    np.testing.assert_allclose(contact.hessian(gap)(perturbation), by_autodiff, atol=1e-9)


def test_the_energy_is_that_of_equation_15_times_the_cell_area(contact, gap):
    n = gap.size
    stiffness = jax.vmap(contact.solid.apply)(jnp.eye(n).reshape(n, *gap.shape))
    u = np.asarray(contact.displacement(gap)).ravel()
    elastic = u @ np.asarray(stiffness).reshape(n, n) @ u / 2
    adhesive = sum(float(contact.potential(g)) for g in gap.ravel())
    expected = (elastic + adhesive) * contact.grid.cell_area
    np.testing.assert_allclose(contact.energy(gap), expected)


def test_numbers_of_either_byte_order_are_taken():
    grid, heights = js.Grid(4), np.arange(16.0).reshape(4, 4)
    solid, law = js.HalfSpace(grid, np.array(2, ">f8")), js.potentials.NoAdhesion()
    for dtype in (">f8", "<f8"):
        contact = js.Contact(solid, heights.astype(dtype), law)
        assert contact.heights.dtype == jnp.float64
        np.testing.assert_array_equal(contact.heights, heights)
    assert contact.solid.youngs_modulus == 2.0


@pytest.mark.parametrize(
    ("law", "has_core"),
    [(js.potentials.LennardJones(0.1, 0.5), True), (js.potentials.Exponential(0.1, 0.5), False)],
)
def test_a_contact_knows_in_any_unit_whether_its_law_has_a_core(law, has_core):
    contact = js.Contact(js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), law)
    assert contact.known_core is has_core
    assert pose(contact, js.MeanGap(0.1)).contact.known_core is has_core


def test_the_force_on_a_window_is_the_sum_over_it():
    window = js.Grid(16, 8.0)
    tip = js.surfaces.paraboloid(window, 4.0)
    contact = js.Contact(js.FreeHalfSpace(window, 1.0), tip, js.potentials.NoAdhesion())
    state = js.equilibrate(contact, js.FarDisplacement(-0.2))
    assert state.force > 0
    np.testing.assert_allclose(state.force, jnp.sum(state.pressure) / 4, rtol=1e-6)


def test_the_residual_sees_every_way_to_miss_equilibrium(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    exact = equilibrium.gap
    assert residual_of(hertz, exact) <= 1e-8
    # Unbalanced where free.
    assert residual_of(hertz, exact * (1 + 1e-3 * hertz.grid.coordinates[0])) > 1e-6
    # Held apart where contact should be.
    lifted = jnp.where(equilibrium.in_contact, 1e-3, exact)
    assert residual_of(hertz, lifted) > 1e-3
    # Stuck together where the surfaces should part.
    stuck = jnp.where(exact < 0.05, 0.0, exact)
    assert (stuck == 0).sum() > equilibrium.in_contact.sum()
    assert residual_of(hertz, stuck) > 1e-3


def test_flat_surfaces_without_adhesion_are_in_balance():
    grid = js.Grid(8)
    contact = js.Contact(
        js.HalfSpace(grid, 1.0), jnp.full(grid.shape, 0.1), js.potentials.NoAdhesion()
    )
    assert residual_of(contact, jnp.full(grid.shape, 0.3)) == 0


@pytest.mark.nightly
def test_between_flat_surfaces_the_residual_is_relative_to_attraction_and_load():
    contact = js.Contact(
        js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), js.potentials.Exponential(1.0, 1.0)
    )
    balance = contact.balance(contact.control(js.MeanPressure(-0.5)))
    attraction = np.exp(-0.5)
    expected = (attraction - 0.5) / (attraction + 0.5)
    np.testing.assert_allclose(balance(jnp.full((8, 8), 0.5)).residual, expected)


def test_the_residual_of_rounding_does_not_depend_on_the_unit_of_length():
    wave = 1 + 1e-8 * np.cos(2 * np.pi * np.arange(8) / 8)[:, None] * np.ones(8)

    def residual(unit):
        solid = js.HalfSpace(js.Grid(8, unit), 1.0)
        contact = js.Contact(solid, jnp.zeros((8, 8)), js.potentials.NoAdhesion())
        return residual_of(contact, jnp.asarray(unit * wave))

    assert 1e-9 < residual(1.0) < 0.1
    np.testing.assert_allclose(residual(1e3), residual(1.0), rtol=1e-6)


@pytest.mark.parametrize(
    ("heights", "message"),
    [
        (jnp.zeros((8, 9)), r"shape \(8, 9\).*grid \(8, 8\)"),
        (jnp.zeros(64), r"shape \(64,\).*grid \(8, 8\)"),
        (
            jnp.zeros((8, 8)).at[2, 3].set(jnp.nan),
            r"height is nan at \(2, 3\): fill.*\.filled",
        ),
        (jnp.zeros((8, 8)).at[0, 1].set(-jnp.inf), r"-inf at \(0, 1\)"),
        (jnp.zeros((8, 8), jnp.float16), "float16: give them in float32 or float64"),
        (jnp.zeros((8, 8), jnp.bfloat16), "bfloat16: give them in float32 or float64"),
        (1j * np.ones((8, 8)), "heights is complex128: give real numbers"),
        (np.ma.masked_less(np.eye(8), 0.5), r"56 of 64 are missing: fill.* `js.*\.filled\(\)`"),
        (js.Grid(8), "heights is a Grid: give real numbers"),
    ],
)
def test_heights_that_cannot_be_used_are_refused(heights, message):
    with pytest.raises((ValueError, TypeError), match=message):
        js.Contact(js.HalfSpace(js.Grid(8), 1.0), heights, js.potentials.NoAdhesion())


@pytest.mark.parametrize("solid", [js.Grid(8), jnp.zeros((8, 8)), None])
def test_what_is_not_a_solid_is_refused(solid):
    with pytest.raises(TypeError, match=f"solid is a {type(solid).__name__}: give.*first, then"):
        js.Contact(solid, js.HalfSpace(js.Grid(8), 1.0), js.potentials.NoAdhesion())


def test_a_contact_keeps_heights_that_their_owner_changes():
    measured = np.zeros((64, 64))
    contact = js.Contact(js.HalfSpace(js.Grid(64), 1.0), measured, js.potentials.NoAdhesion())
    measured[:] = 1
    assert not contact.heights.any()


@pytest.mark.nightly
def test_a_contact_takes_the_precision_of_its_heights():
    contact = rough_contact(8, js.potentials.Exponential(0.3, 0.2))
    single = js.Contact(contact.solid, contact.heights.astype(jnp.float32), lambda gap: -0.3 * gap)
    for contact in (single, js.Contact(single.solid, single.heights, POTENTIALS[0])):
        gap = jnp.ones(contact.grid.shape, jnp.float32)
        fields = contact.gradient(gap), contact.curvature(gap), contact.energy(gap)
        assert all(field.dtype == jnp.float32 for field in fields)


LOADS = js.MeanGap(np.ones(2))
CONTACTS = {
    "equilibrate": lambda contact, load, state: js.equilibrate(contact, load),
    "assess_stability": lambda contact, load, state: js.assess_stability(contact, state),
    "lowest_modes": lambda contact, load, state: js.lowest_modes(contact, state, 2),
    "release": lambda contact, load, state: js.relax_along(contact, state, state.gap),
    "sweep": lambda contact, load, state: js.sweep(contact, LOADS),
    "follow": lambda contact, load, state: js.follow(contact, LOADS),
    "continuation": lambda contact, load, state: js.continuation(contact, LOADS),
    "critical_load": lambda contact, load, state: js.critical_load(contact, LOADS),
    "pull_off": lambda contact, load, state: js.pull_off(contact),
    "transition": lambda contact, load, state: js.transition(contact, load, state, state),
    "easiest_exit": lambda contact, load, state: js.easiest_exit(contact, state),
    "patches": lambda contact, load, state: js.patches(contact, state),
    "conductance": lambda contact, load, state: js.conductance(contact, state),
    "leakage": lambda contact, load, state: js.leakage(contact, state),
    "observe": lambda contact, load, state: js.observe(contact, state, js.patches),
    "evolve": lambda contact, load, state: js.evolve(contact, LOADS, jnp.ones(2)),
    "lifetime": lambda contact, load, state: js.lifetime(contact, load),
    "plot": lambda contact, load, state: js.plots.gap(contact, state),
    "summary": lambda contact, load, state: js.plots.summary(contact, state),
}


@pytest.fixture(scope="module")
def two_contacts():
    """Return a stack of two contacts, and a state of one."""
    grid = js.Grid(8)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), (1.0,), (1.0,))
    contact = js.Contact(solid, 0.1 * jnp.eye(8), js.potentials.Exponential(0.1, 0.1))
    state = js.equilibrate(contact, js.MeanGap(0.2))
    return jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), contact), state


@pytest.mark.parametrize("call", CONTACTS.values(), ids=CONTACTS)
def test_several_contacts_at_once_are_refused_with_the_cure(two_contacts, call):
    contacts, state = two_contacts
    with pytest.raises(ValueError, match=r"several contacts, a batch of shape \(2,\): .*jax\.vmap"):
        call(contacts, js.MeanGap(0.2), state)


def test_a_contact_in_double_precision_is_refused_while_jax_is_set_to_single(contact):
    with jax.enable_x64(False):
        for call in (
            lambda: js.equilibrate(contact, js.MeanGap(0.5)),
            lambda: js.follow(contact, js.MeanGap(np.array([0.5, 0.1]))),
            lambda: js.plots.surface(contact),
        ):
            with pytest.raises(ValueError, match=r"double precision.*jax_enable_x64"):
                call()
