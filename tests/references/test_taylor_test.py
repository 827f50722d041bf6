"""The Taylor test: derivatives known by hand, wrong ones, kinks and noise, and those of jaxstab."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact

import jaxstab as js


def ruled(value, slope):
    """Return a function of one number with a rule of its own for the derivative."""
    function = jax.custom_jvp(value)
    function.defjvp(lambda points, tangents: (value(*points), slope(*points) * tangents[0]))
    return function


def test_remainders_are_those_of_taylors_theorem():
    test = js.check_derivative(jnp.exp, 2.0, 3.0)
    h = test.steps
    np.testing.assert_allclose(test.differences, np.exp(2) * np.expm1(3 * h), rtol=1e-9)
    exact = np.exp(2) * (np.expm1(3 * h) - 3 * h)
    np.testing.assert_allclose(test.remainders, exact, rtol=1e-4, atol=1e-14)
    np.testing.assert_allclose(test.rates, (1, 2), atol=0.01)
    assert test.success and test.message == ""
    assert "rates 1.00 and 2.00" in repr(test)


@pytest.mark.parametrize("mode", ["fwd", "rev"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_right_derivatives_pass(mode, dtype):
    point = {"x": jnp.arange(1, 5, dtype=dtype), "y": jnp.asarray(0.3, dtype), "name": "held"}
    functions = [
        lambda p: jnp.sin(p["x"]) * p["y"],
        lambda p: 3 * p["x"].sum() - p["y"],
        lambda p: jnp.asarray(2.0, dtype),
        lambda p: jnp.cos(p["x"] - p["y"]).sum() + p["x"].reshape(2, 2) ** 3,
    ]
    for function in functions:
        test = js.check_derivative(function, point, mode=mode)
        assert test.success, test
    # An extremum: differences fall as remainders do.
    test = js.check_derivative(jnp.cos, dtype(0), 1.0, mode=mode)
    assert test.success
    np.testing.assert_allclose(test.rates, (2, 2), atol=0.05)


@pytest.mark.parametrize("error", [-2.0, 1.0, 0.1, 0.01, 1e-4])
def test_a_rule_with_a_wrong_factor_fails(error):
    test = js.check_derivative(ruled(jnp.sin, lambda x: (1 + error) * jnp.cos(x)), 1.0)
    assert not test.success
    ends = "its rule is wrong." if error != 1e-4 else "a loose tolerance."
    assert f"by {100 * abs(error):.2g} %" in test.message and test.message.endswith(ends)
    second = ruled(lambda x: x**3, lambda x: x**2 * (3 + jnp.array([0, 3 * error])))
    for mode in ("fwd", "rev"):
        assert not js.check_derivative(second, jnp.array([1.0, 2.0]), mode=mode).success


def test_a_wrong_rule_of_reverse_mode_is_found():
    @jax.custom_vjp
    def square(x):
        return x**2

    square.defvjp(lambda x: (x**2, x), lambda x, cotangent: (x * cotangent,))
    test = js.check_derivative(square, jnp.array([1.0, 2.0]))
    assert not test.success and "by 50 %" in test.message


@pytest.mark.parametrize(
    ("function", "point", "begins"),
    [
        (lambda x: jnp.abs(x - 1), 1.0, "The function has a kink"),
        (lambda x: jnp.maximum(x - 1.0004, 0), 1.0, "The function has a kink"),
        (lambda x: jnp.abs(x - 1) ** 1.5, 1.0, "The function has a kink"),
        (lambda x: jnp.where(x > 1, x, jnp.sqrt(1 - x)), 2.0, "The derivative is NaN"),
        (jnp.log, -1.0, "The function is NaN"),
        (lambda x: jnp.sqrt(x - 1), 1.0, "The function is NaN"),
    ],
)
def test_failures_tell_their_cause(function, point, begins):
    test = js.check_derivative(function, point)
    assert not test.success and test.message.startswith(begins), test


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_told_from_errors(seed):
    random = np.random.default_rng(seed)

    def noisy(noise, factor=1.0):
        value = lambda x: jnp.sin(x) + noise * random.normal()  # noqa: E731
        return js.check_derivative(ruled(value, lambda x: factor * jnp.cos(x)), 1.0)

    assert noisy(1e-9).success and 1e-10 < noisy(1e-9).noise < 1e-8
    for noise in (1e-4, 1e-2):
        test = noisy(noise)
        assert not test.success and test.message.startswith("The values jump"), test
        assert "tighter tolerance" in test.message
    assert noisy(1e-7, 1.1).message.endswith("its rule is wrong.")


def test_single_precision_is_named_where_it_is_the_cause():
    test = js.check_derivative(lambda x: 1e6 + jnp.sin(x), np.float32(1))
    assert not test.success and test.message.endswith("use float64.")


def test_what_cannot_be_tested_is_refused():
    with pytest.raises(ValueError, match=r"\['b'\] is 0, .*give a direction"):
        js.check_derivative(lambda p: p["a"] + p["b"], {"a": 1.0, "b": 0.0})
    with pytest.raises(TypeError, match="check_derivative works on known numbers"):
        jax.jit(lambda x: js.check_derivative(jnp.sin, x).success)(1.0)
    with pytest.raises(TypeError, match="at least one floating-point number"):
        js.check_derivative(jnp.sin, "x")
    with pytest.raises(ValueError, match="mode is 'reverse': choose one of fwd, rev"):
        js.check_derivative(jnp.sin, 1.0, mode="reverse")


@pytest.mark.nightly
def test_laws_solids_and_equilibria_pass_in_any_units():
    contact = rough_contact(16, js.potentials.Exponential(0.06, 0.2), rms_height=0.05)
    law, solid, heights = contact.potential, contact.solid, contact.heights

    def mean_pressure(law):
        return js.equilibrate(js.Contact(solid, heights, law), js.MeanGap(0.1)).mean_pressure

    for function, point in (
        (law, 0.1),
        (jax.grad(law), 0.1),
        (law, 1e-9),
        (lambda u: jnp.vdot(u, solid.apply(u)), 1e-9 * heights),
        (solid.apply, heights),
        (mean_pressure, law),
    ):
        test = js.check_derivative(function, point)
        assert test.success, test
