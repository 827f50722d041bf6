from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lennard_jones_force
from programs import on_the_cpu

import jaxstab as js
from jaxstab.potentials import (
    as_module,
    curvature,
    energy_density,
    slope,
)
from jaxstab.potentials.jumps import law_jump

GAPS = jnp.linspace(0.0, 3.0, 25).reshape(5, 5)
# The laws f, f' and f'' are written out by hand, at gamma = 2, rho = 0.7.
CLOSED_FORMS = {
    js.potentials.Exponential: (
        lambda s: -2 * np.exp(-s),
        lambda s: 2 / 0.7 * np.exp(-s),
        lambda s: -2 / 0.7**2 * np.exp(-s),
    ),
    js.potentials.Gaussian: (
        lambda s: -2 * np.exp(-(s**2) / 2),
        lambda s: 2 / 0.7 * s * np.exp(-(s**2) / 2),
        lambda s: 2 / 0.7**2 * (1 - s**2) * np.exp(-(s**2) / 2),
    ),
    js.potentials.Rational: (
        lambda s: -2 / (1 + s**2),
        lambda s: 2 / 0.7 * 2 * s / (1 + s**2) ** 2,
        lambda s: 2 / 0.7**2 * (2 - 6 * s**2) / (1 + s**2) ** 3,
    ),
}


@pytest.mark.parametrize("law", CLOSED_FORMS)
def test_laws_and_their_derivatives_match_the_formulae_of_the_paper(law):
    potential = law(surface_energy=2.0, length=0.7)
    scaled = np.asarray(GAPS) / 0.7
    derivatives = (energy_density, slope, curvature)
    for derivative, formula in zip(derivatives, CLOSED_FORMS[law], strict=True):
        np.testing.assert_allclose(derivative(potential, GAPS), formula(scaled), atol=1e-12)


SEPARATIONS = np.linspace(0.5, 3.0, 26)


def test_lennard_jones_matches_its_formula_and_is_least_where_it_says():
    law = js.potentials.LennardJones(2.0, 0.7)
    x = 0.7 / SEPARATIONS
    np.testing.assert_allclose(energy_density(law, SEPARATIONS), x**9 - 3 * x**3)
    np.testing.assert_allclose(slope(law, SEPARATIONS), lennard_jones_force(SEPARATIONS, 2.0, 0.7))
    stiffness = 9 * (10 * x**11 - 4 * x**5) / 0.7**2
    np.testing.assert_allclose(curvature(law, SEPARATIONS), stiffness)
    assert law(0.7) == pytest.approx(-2.0)
    assert slope(law, jnp.array([0.7]))[0] == pytest.approx(0, abs=1e-12)
    assert law(0.0) == np.inf


def test_dugdales_attraction_is_even_up_to_its_range_and_then_gone():
    law = js.potentials.Dugdale(2.0, 0.7, smoothing=0.01)
    assert law(0.0) == pytest.approx(-2.0)
    assert law(2.0) == pytest.approx(0.0, abs=1e-12)
    attraction = slope(law, jnp.array([0.0, 0.35, 0.63, 0.7, 0.77]))
    expected = 2 / 0.7 * np.array([1, 1, 1, 0.5, 0])
    np.testing.assert_allclose(attraction, expected, atol=2e-4)
    edge = jnp.array([0.6, 0.7, 0.8])
    step = 1e-4
    difference = (slope(law, edge + step) - slope(law, edge - step)) / (2 * step)
    np.testing.assert_allclose(curvature(law, edge), difference, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize(
    ("law", "has_core"),
    [
        (js.potentials.LennardJones(0.05, 3e-10), True),
        (lambda gap: 1e-20 * (1 / gap) ** 2 - 1e-12 / gap, True),
        (lambda gap: -1e-3 * jnp.log(gap), True),
        (js.potentials.Exponential(0.05, 3e-10), False),
    ],
)
def test_a_core_is_seen_in_any_units_compiled_or_not(law, has_core, dtype):
    grid = js.Grid(8, 1e-6)
    contact = js.Contact(js.HalfSpace(grid, 1e9), jnp.zeros((8, 8), dtype), law)
    assert contact.has_core == has_core
    assert jax.jit(lambda contact: contact.has_core)(contact) == has_core


def test_no_adhesion_has_no_energy_force_or_curvature():
    for derivative in (energy_density, slope, curvature):
        assert not derivative(js.potentials.NoAdhesion(), GAPS).any()


def contact_with(potential):
    grid = js.Grid(4)
    return js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros(grid.shape), potential)


@pytest.mark.parametrize(
    ("potential", "message"),
    [
        (
            lambda gap: jnp.array([gap, gap]),
            r"maps f64\[\] to f64\[2\]: it must return one real scalar",
        ),
        (lambda gap: 1j * gap, "must return one real scalar"),
        (lambda gap: (gap, gap), "must return one real scalar"),
        (lambda gap: gap**-3 - gap**-9, "value at zero gap is nan.*or else rise without bound"),
        (lambda gap: jnp.log(gap), "value at zero gap is -inf"),
        (lambda gap: jnp.sqrt(gap), "slope value at zero gap is inf"),
        (lambda gap: gap**1.5, "curvature value at zero gap is inf"),
        (3.0, "give a function of the gap"),
        (js.potentials.Gaussian, r"the class Gaussian: give a law with its numbers, Gaussian\("),
        (lambda gap: np.exp(-gap), "jax.numpy in place of NumPy"),
        (lambda gap: -1.0 if gap < 1 else 0.0, "jnp.where in place of `if`"),
        (lambda gap: jnp.sqrt(0.5 - gap), r"value at a gap of 0.50\d* is nan"),
        (
            lambda gap: -jnp.maximum(1 - gap, 0),
            r"piecewise linear.*from 0 to 1\. Give a smooth fit",
        ),
        (lambda gap: jnp.interp(gap, jnp.arange(3.0), jnp.array([-3.0, -1.0, 0.0])), "piecewise"),
        (lambda gap: -jnp.exp(-jnp.maximum(gap, 0)), "slope is 0.5 at zero gap and 1 right above"),
        (lambda gap: -jnp.exp(-jax.nn.relu(gap)), "slope is 0 at zero gap and 1 right above"),
    ],
)
def test_a_potential_that_cannot_be_used_is_refused(potential, message):
    with pytest.raises((ValueError, TypeError), match=message):
        contact_with(potential)


@pytest.mark.parametrize(
    "law",
    [
        lambda gap: -0.3 * gap,
        lambda gap: -1.0,
        lambda gap: (-jnp.exp(-gap)).astype(jnp.float16),
        lambda gap: jnp.asarray(-jnp.exp(-gap), jnp.float32),
        lambda gap: -1 / jnp.cosh(gap / 0.01),
        lambda gap: -jnp.exp(-(gap**2)),
        lambda gap: -jnp.exp(-gap / 1e-12),
        lambda gap: -(jnp.maximum(1 - gap, 0) ** 2),
    ],
)
def test_laws_that_only_look_odd_are_accepted(law):
    contact = contact_with(law)
    assert contact.has_core == False  # noqa: E712
    assert slope(contact.potential, GAPS).dtype == GAPS.dtype


def wall(gap):
    return 0.002 * (0.5 * (0.05 / gap) ** 9 - 1.5 * (0.05 / gap) ** 3)


def sticky(gap):
    return -0.02 * jnp.exp(-gap / 0.05)


JUMPS = {
    "cut": (lambda gap: jnp.where(gap < 0.12, wall(gap), 0.0), "value jumps from .* gap of 0.12"),
    "shifted": (
        lambda gap: jnp.where(gap < 0.12, wall(gap) - wall(0.12), 0.0),
        "slope jumps from .* gap of 0.12",
    ),
    "far": (lambda gap: jnp.where(gap < 0.3, sticky(gap), 0.0), "value jumps .* gap of 0.3"),
    "well": (lambda gap: jnp.where((gap > 0.1) & (gap < 0.2), -0.01, 0.0), "value jumps"),
    "kink": (lambda gap: sticky(jnp.abs(gap - 0.1)), "slope jumps from -0.4 to 0.4 at .* 0.1"),
    "small": (lambda gap: sticky(gap) - 0.001 * jnp.maximum(0.08 - gap, 0), "slope jumps"),
    "zero": (lambda gap: jnp.where(gap > 0, sticky(gap), -0.03), "slope is 0 at zero gap"),
    "table": (
        lambda gap: jnp.interp(gap, jnp.arange(3.0), jnp.array([-3.0, -1.0, 0.0])) + sticky(gap),
        "slope jumps .*spline",
    ),
}


@pytest.mark.parametrize("name", JUMPS)
def test_a_law_that_jumps_is_refused_with_the_gap(name):
    law, message = JUMPS[name]
    with pytest.raises(ValueError, match=message):
        contact_with(law)


def test_a_law_that_jumps_is_told_by_the_result_where_no_error_can_be_raised():
    @jax.jit
    def result(end):
        contact = contact_with(lambda gap: jnp.where(gap < end, sticky(gap), 0.0))
        return js.equilibrate(contact, js.MeanGap(0.2), throw=False).result

    assert result(0.15) == "invalid_contact"
    # A law without a value is smooth.
    assert result(0.9) == "successful"


def steep_and_smooth(energy, length):
    laws = js.potentials
    return {
        "exponential": laws.Exponential(energy, length),
        "gaussian": laws.Gaussian(energy, length),
        "rational": laws.Rational(energy, length),
        "dugdale": laws.Dugdale(energy, length, 1e-6),
        "lennard_jones": laws.LennardJones(energy, length),
        "electrostatic": laws.Electrostatic(1.0, energy * length, length / 10),
        "capillary": laws.Capillary(energy, 0.3, length),
        "none": laws.NoAdhesion(),
        "morse": lambda gap: energy * jnp.expm1(1 - 5 * gap / length) ** 2 - energy,
        "sum": laws.LennardJones(energy, length) + laws.Electrostatic(1.0, energy * length / 5),
        "cut off": laws.CutOff(laws.LennardJones(energy, length), 3 * length),
        "varying": laws.Varying(laws.Dugdale(energy * jnp.eye(8), length)),
    }


@pytest.mark.parametrize("length", [0.3, 1e-4])
@pytest.mark.parametrize("name", steep_and_smooth(1.0, 1.0))
def test_no_law_that_is_smooth_is_taken_for_one_that_jumps(name, length):
    unit, dtype = 1e-6, jnp.float32
    law = as_module(steep_and_smooth(0.02 * unit, length * unit)[name], dtype)
    # Rounding of half of the steepest slope of them is far below what counts.
    assert law_jump(law, jnp.array([unit, unit], dtype)).size.max() < 1e-5


def test_a_law_that_is_cut_off_is_zero_beyond_and_twice_differentiable():
    whole, radius = js.potentials.Exponential(0.02, 0.05), 0.2
    law = js.potentials.CutOff(whole, radius)
    near, far = jnp.linspace(0, radius / 2, 9), jnp.linspace(1.001 * radius, 1, 9)
    for derivative in (energy_density, slope, curvature):
        np.testing.assert_allclose(derivative(law, near), derivative(whole, near), rtol=1e-12)
        assert (derivative(law, far) == 0).all()
    gaps, step = jnp.linspace(0.09, 0.21, 50), 1e-6
    for lower, upper in ((energy_density, slope), (slope, curvature)):
        difference = (lower(law, gaps + step) - lower(law, gaps - step)) / (2 * step)
        np.testing.assert_allclose(upper(law, gaps), difference, atol=3e-5)
    # Below its end the formula is S(x) f, beyond it is not asked.
    x = 0.4
    switch = 1 - 10 * x**3 + 15 * x**4 - 6 * x**5
    np.testing.assert_allclose(law(0.14), switch * whole(0.14), rtol=1e-12)
    table = js.potentials.CutOff(lambda gap: jnp.where(gap > radius, jnp.nan, whole(gap)), radius)
    assert (slope(table, far) == 0).all()
    assert contact_with(js.potentials.CutOff(wall, 0.12)).has_core
    with pytest.raises(ValueError, match="radius of the cut-off is 0"):
        js.potentials.CutOff(whole, 0.0)
    with pytest.raises(ValueError, match=r"The law is 3: give a function"):
        js.potentials.CutOff(3, 1.0)


def test_a_law_may_vary_from_nothing_on():
    kind = js.potentials.Exponential
    energies = jnp.where(jnp.arange(8) % 2 == 0, 0.02, 0.0) * jnp.ones((8, 1))
    law = js.potentials.Varying(kind(energies, 0.07))
    contact = js.Contact(js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), law)
    state = js.equilibrate(contact, js.MeanGap(0.1))
    waves = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(8, 1 / 8)]))
    elastic = np.fft.ifft2(np.pi * waves * np.fft.fft2(state.displacement)).real
    attraction = np.stack(
        [
            jax.vmap(jax.grad(kind(energy, 0.07)))(gaps)
            for energy, gaps in zip(energies[0], state.gap.T, strict=True)
        ]
    ).T
    assert (attraction[:, 1::2] == 0).all()
    np.testing.assert_allclose(elastic + state.mean_pressure + attraction, 0, atol=1e-9)


def test_a_law_with_a_loop_has_its_derivatives():
    def law(gap):
        def further(state):
            return state[0] + 1, state[1] * jnp.exp(-gap / 0.6)

        return (
            -0.02 * jax.lax.while_loop(lambda state: state[0] < 3, further, (0, 1.0 + 0 * gap))[1]
        )

    looped, closed = contact_with(law).potential, js.potentials.Exponential(0.02, 0.2)
    for derivative in (energy_density, slope, curvature):
        np.testing.assert_allclose(derivative(looped, GAPS), derivative(closed, GAPS), rtol=1e-9)


@on_the_cpu
def test_weak_and_long_ranged_laws_are_not_taken_for_piecewise_linear():
    # Their curvature underflows, and so would any change of the slope over the grid.
    law = js.potentials.Exponential(1e-25, 1e10)
    solid = js.HalfSpace(js.Grid(4, 1e10), 1.0)
    profile = js.Contact(solid, jnp.zeros((4, 4), jnp.float32), law).profile
    assert profile.slopes.max() > 2 * profile.slopes.min()
    assert not profile.curvatures.any()


def test_a_formula_that_leaves_the_range_of_single_precision_is_refused():
    def law(gap):
        return 1e-20 / gap**2 - 1e-12 / gap

    solid = js.HalfSpace(js.Grid(8, 1e-6), 1e9)
    assert js.Contact(solid, jnp.zeros((8, 8)), law).has_core
    with pytest.raises(ValueError, match=r"curvature value at a gap of .* is inf.*use float64"):
        js.Contact(solid, jnp.zeros((8, 8), jnp.float32), law)


def test_a_potential_may_branch_on_the_scalar_gap():
    def law(gap):
        return jax.lax.cond(gap < 1, lambda g: -((1 - g) ** 3), lambda g: 0 * g, gap)

    np.testing.assert_allclose(energy_density(law, GAPS), -(np.maximum(1 - GAPS, 0) ** 3))
    np.testing.assert_allclose(curvature(law, GAPS), -6 * np.maximum(1 - GAPS, 0), atol=1e-12)


def varying(energies):
    grid = js.Grid((24, 16), (1.0, 0.8))
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=7, rms_height=0.1)
    law = js.potentials.Varying(js.potentials.Exponential(energies, 0.2))
    return js.Contact(js.HalfSpace(grid, 0.05), heights, law)


def stripes():
    x, _ = js.Grid((24, 16)).coordinates
    return 0.01 + 0.008 * jnp.cos(4 * jnp.pi * x)


def test_a_law_that_varies_balances_at_every_point_by_its_own_parameters():
    energies = stripes()
    contact = varying(energies)
    state = js.equilibrate(contact, js.MeanGap(0.12))
    n, m = contact.grid.shape
    waves = np.hypot(np.fft.fftfreq(n, 1 / n)[:, None], np.fft.fftfreq(m, 0.8 / m))
    elastic = np.fft.ifft2(0.05 * np.pi * waves * np.fft.fft2(state.displacement)).real
    net = elastic + float(state.mean_pressure) + energies / 0.2 * np.exp(-state.gap / 0.2)
    assert state.in_contact.any() and not state.in_contact.all()
    assert np.abs(np.where(state.in_contact, np.minimum(net, 0), net)).max() < 1e-8 * 0.09
    # The stickiest point has the largest curvature.
    stiffest = contact.solid.max_stiffness
    expected = stiffest / (energies.max() / 0.2**2)
    np.testing.assert_allclose(contact.resolution, expected, rtol=1e-6)


@pytest.mark.nightly
def test_a_law_that_varies_has_a_derivative_by_each_of_its_numbers():
    def pressure(energies):
        return js.equilibrate(varying(energies), js.MeanGap(0.12)).mean_pressure

    energies = stripes()
    move = 1e-7 * jax.random.normal(jax.random.key(1), energies.shape)
    slope = jnp.sum(jax.jit(jax.grad(pressure))(energies) * move)
    difference = (pressure(energies + move) - pressure(energies - move)) / 2
    np.testing.assert_allclose(slope, difference, rtol=1e-4)
    lanes = jax.vmap(pressure)(jnp.stack([energies, energies + move]))
    np.testing.assert_allclose(lanes, [pressure(energies), pressure(energies + move)], rtol=1e-9)


def test_a_law_that_varies_over_other_points_is_refused():
    with pytest.raises(ValueError, match=r"varies has shape \(4, 16\), the grid"):
        varying(jnp.full((4, 16), 0.01))
    law = js.potentials.Varying(js.potentials.Exponential(stripes(), 0.2))
    with pytest.raises(ValueError, match=r"shape \(24, 16\), but the gaps have shape \(5,\)"):
        js.plots.force(law, jnp.linspace(0, 1, 5))
    np.testing.assert_allclose(law(0.0), -0.01)


def test_a_function_cannot_vary_and_says_so():
    field = jnp.full((8, 8), 0.03)
    with pytest.raises(TypeError, match="A function has no parameters that can vary"):
        js.potentials.Varying(lambda gap: -field * jnp.exp(-gap))


class WithAnother(eqx.Module):
    first: Callable
    second: Callable

    def __call__(self, gap):
        return self.first(gap) + self.second(gap)


def test_a_law_that_hides_that_it_varies_is_refused_and_one_that_shows_it_is_not():
    law = js.potentials.Varying(js.potentials.Exponential(stripes(), 0.2))
    grid = js.Grid((24, 16))
    flat = jnp.zeros(grid.shape)

    def contact(potential):
        return js.Contact(js.HalfSpace(grid, 0.05), flat, potential)

    for hidden in (lambda gap: law(gap), WithAnother(law, lambda gap: -1e-3 * jnp.exp(-gap))):
        with pytest.raises(ValueError, match="would be its mean everywhere: make all of it one"):
            contact(hidden)
    shown = contact(WithAnother(law, js.potentials.Exponential(1e-3, 1.0)))
    expected = -np.mean(stripes() * np.exp(-0.5) + 1e-3 * np.exp(-0.1))
    np.testing.assert_allclose(shown.energy(jnp.full(grid.shape, 0.1)), expected)


@pytest.mark.parametrize(
    "law",
    [
        lambda x: js.potentials.Exponential(0.01 * x, 0.2),
        lambda x: js.potentials.Exponential(0.01, 0.2 * x),
        lambda x: js.potentials.Dugdale(0.01, 0.2, 0.1 * x),
        lambda x: js.potentials.LennardJones(0.01 * x, 0.2),
        lambda x: js.potentials.Electrostatic(1.0, 0.01, 0.2 * x),
        lambda x: js.potentials.Capillary(0.01, 0.5 * x, 0.2),
        lambda x: js.potentials.CutOff(lambda gap: -0.01 * jnp.exp(-gap), x),
    ],
)
def test_traced_parameters_that_are_refused_otherwise_are_nan(law):
    with pytest.raises(ValueError, match="-"):
        law(-1.0)
    energies = jax.vmap(jax.value_and_grad(lambda x: law(x)(0.3)))(jnp.array([1.0, -1.0]))
    np.testing.assert_allclose(energies[0][0], law(1.0)(0.3), rtol=1e-12)
    assert np.isfinite(energies[1][0])
    assert np.isnan([energies[0][1], energies[1][1]]).all()
