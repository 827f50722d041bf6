"""Laws that have a core, are refused or are NaN, and those that only look as if they were unfit."""

from operator import attrgetter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import flat_contact
from programs import on_the_cpu

import jaxstab as js
from jaxstab.potentials import as_module, slope
from jaxstab.potentials.jumps import law_jump


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
            lambda gap: jnp.where(gap < 0.5, -(jnp.sqrt(0.5 - gap) ** 5), 0.0),
            r"slope value at a gap of 0.5\d* is nan.*branches of jnp.where(?!.*precision)",
        ),
        (
            lambda gap: jnp.where(gap > 0.5, -(jnp.sqrt(gap - 0.5) ** 5) * jnp.exp(-gap), 0.0),
            r"slope value at zero gap is nan.*branches of jnp.where(?!.*Electrostatic)",
        ),
        (
            lambda gap: -jnp.maximum(1 - gap, 0),
            r"piecewise linear.*from 0 to 1\. Give a smooth fit",
        ),
        (lambda gap: jnp.interp(gap, jnp.arange(3.0), jnp.array([-3.0, -1.0, 0.0])), "piecewise"),
        (
            # Not a number at zero gap alone.
            lambda gap: jnp.where(gap > 0, gap * jnp.log(gap), 0.0),
            r"slope value at zero gap is nan.*branches of jnp.where",
        ),
        (lambda gap: -jnp.exp(-jnp.maximum(gap, 0)), "slope is 0.5 at zero gap and 1 right above"),
        (lambda gap: -jnp.exp(-jax.nn.relu(gap)), "slope is 0 at zero gap and 1 right above"),
    ],
)
def test_a_potential_that_cannot_be_used_is_refused(potential, message):
    with pytest.raises((ValueError, TypeError), match=message):
        flat_contact(potential)


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
    contact, gaps = flat_contact(law), jnp.linspace(0.0, 3.0, 5)
    assert contact.has_core == False  # noqa: E712
    assert slope(contact.potential, gaps).dtype == gaps.dtype


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
        flat_contact(law)


@pytest.mark.nightly
def test_a_law_that_jumps_is_told_by_the_result_where_no_error_can_be_raised():
    @jax.jit
    def result(end):
        contact = flat_contact(lambda gap: jnp.where(gap < end, sticky(gap), 0.0))
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
        "repulsive": laws.CutOff(lambda gap: energy * jnp.exp(-gap / length), 3 * length),
        "varying": laws.Varying(laws.Dugdale(energy * jnp.eye(8), length)),
    }


@pytest.mark.parametrize("length", [0.3, 1e-4])
@pytest.mark.parametrize("name", steep_and_smooth(1.0, 1.0))
def test_no_law_that_is_smooth_is_taken_for_one_that_jumps(name, length):
    unit, dtype = 1e-6, jnp.float32
    law = as_module(steep_and_smooth(0.02 * unit, length * unit)[name], dtype)
    # Rounding of half of the steepest slope of them is far below what counts.
    assert law_jump(law, jnp.array([unit, unit], dtype)).size.max() < 1e-5


@on_the_cpu
def test_weak_and_long_ranged_laws_are_not_taken_for_piecewise_linear():
    # Their curvature underflows, and so would any change of the slope over the grid.
    law = js.potentials.Exponential(1e-25, 1e10)
    solid = js.HalfSpace(js.Grid(4, 1e10), 1.0)
    profile = js.Contact(solid, jnp.zeros((4, 4), jnp.float32), law).profile
    assert profile.slopes.max() > 2 * profile.slopes.min()
    assert not profile.curvatures.any()


def test_a_branch_with_a_harmless_gap_has_the_slope_of_the_other():
    def law(gap):
        is_near = gap < 0.5
        return jnp.where(is_near, -(jnp.sqrt(jnp.where(is_near, 0.5 - gap, 1.0)) ** 5), 0.0)

    contact = js.Contact(js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), law)
    slopes, gaps = contact.profile.slopes, contact.profile.gaps
    np.testing.assert_allclose(slopes, 2.5 * np.clip(0.5 - gaps, 0, None) ** 1.5, atol=1e-12)


def test_a_formula_that_leaves_the_range_of_single_precision_is_refused():
    def law(gap):
        return 1e-20 / gap**2 - 1e-12 / gap

    solid = js.HalfSpace(js.Grid(8, 1e-6), 1e9)
    assert js.Contact(solid, jnp.zeros((8, 8)), law).has_core
    with pytest.raises(ValueError, match=r"curvature value at a gap of .* is inf.*use `float64`"):
        js.Contact(solid, jnp.zeros((8, 8), jnp.float32), law)


@pytest.mark.parametrize(
    ("law", "values", "sentence"),
    [
        ("Exponential", (-1.0, 1.0), "surface energy is -1"),
        ("Exponential", (np.nan, 1.0), "surface energy is nan"),
        ("Exponential", (1.0, 0.0), "length of the potential is 0"),
        ("LennardJones", (0.0, 1.0), r"surface energy of a law with a core is 0\.0"),
        ("Dugdale", (1.0, 1.0, 0.0), r"smoothing of the potential is 0\.0"),
        ("Electrostatic", (np.inf, 1.0), r"voltage is inf: it must be finite"),
        ("Electrostatic", (1.0, 0.0), r"permittivity is 0\.0: it must be positive"),
        ("Electrostatic", (1.0, 1.0, -1.0), r"dielectric is -1\.0: it must be finite and not neg"),
        ("Capillary", (-1.0, 0.0, 1.0), r"surface tension is -1\.0: it must be finite"),
        ("Capillary", (1.0, 60.0, 1.0), r"contact angle is 60\.0: give radians"),
        ("Capillary", (1.0, 0.0, 0.0), r"radius of the meniscus is 0\.0"),
        ("Sum", ((),), r"The laws are \(\): give functions of the gap"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(law, values, sentence):
    with pytest.raises(ValueError, match=sentence):
        getattr(js.potentials, law)(*values)


@pytest.mark.parametrize(
    ("law", "values", "sentence"),
    [
        ("LennardJones.from_hamaker", (-1e-20, 0.2), "Hamaker constant is -1e-20: it must be"),
        ("LennardJones.from_hamaker", (1.0, 0.0), r"equilibrium distance is 0\.0"),
        ("Capillary.at_humidity", (50.0, 0.07), r"humidity is 50\.0: give .* 0\.5 for 50 %"),
        ("Capillary.at_humidity", (1.0, 0.07), r"relative humidity is 1\.0: give"),
        ("Capillary.at_humidity", (0.0, 0.07), r"relative humidity is 0\.0: give"),
        ("Capillary.at_humidity", (np.nan, 0.07), "relative humidity is nan"),
        ("Capillary.at_humidity", (0.5, 0.0), r"surface tension is 0\.0: it must be positive"),
        ("Capillary.at_humidity", (0.5, 0.07, 2.0), r"contact angle is 2\.0: give radians"),
    ],
)
def test_physical_constants_that_make_no_law_are_refused(law, values, sentence):
    with pytest.raises(ValueError, match=sentence):
        attrgetter(law)(js.potentials)(*values)


@pytest.mark.parametrize(
    "law",
    [
        lambda x: js.potentials.Exponential(0.01 * x, 0.2),
        lambda x: js.potentials.Exponential(0.01, 0.2 * x),
        lambda x: js.potentials.Dugdale(0.01, 0.2, 0.1 * x),
        lambda x: js.potentials.LennardJones(0.01 * x, 0.2),
        lambda x: js.potentials.Electrostatic(1.0, 0.01, 0.2 * x),
        lambda x: js.potentials.Capillary(0.01, 0.5 * x, 0.2),
        lambda x: js.potentials.LennardJones.from_hamaker(0.01 * x, 0.2),
        lambda x: js.potentials.LennardJones.from_hamaker(0.01, 0.2 * x),
        lambda x: js.potentials.Capillary.at_humidity(0.5 * x, 0.07, pressure_unit="GPa"),
        lambda x: js.potentials.Capillary.at_humidity(0.5, 0.07 * x, pressure_unit="GPa"),
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
