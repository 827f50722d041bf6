"""Derivatives of eigenvalues and modes: against finite differences, and where none exist."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import TIGHT, rough_contact, with_parameters

import jaxstab as js
from jaxstab.stability.barrier import pressure_scale


@pytest.fixture(scope="module")
def contact():
    return rough_contact(16, js.potentials.Exponential(0.02, 0.1))


@pytest.mark.parametrize(
    "load",
    [
        js.MeanGap(jnp.array(0.1)),
        pytest.param(js.MeanPressure(jnp.array(0.05)), marks=pytest.mark.nightly),
    ],
)
def test_eigenvalues_modes_and_margins_agree_with_finite_differences(contact, load):
    solver = js.solvers.ProjectedLOBPCG(tolerance=1e-11)

    def judge(x):
        held = eqx.tree_at(lambda load: load.value, load, x[3])
        other = with_parameters(contact, *x[:3])
        equilibrium = js.equilibrate(other, held, TIGHT, throw=False)
        found = js.assess_stability(other, equilibrium, solver, throw=False)
        values = {name: pair.eigenvalue for name, pair in found.pairs.items()}
        values["mode"] = jnp.sum(jnp.sin(jnp.arange(256.0)).reshape(16, 16) * found.cone.mode)
        values["complementarity"] = found.complementarity
        values["height"] = found.barrier.height
        values["amplitude"] = found.barrier.amplitude
        return values, found

    x = jnp.array([0.06, 0.1, 1.0, load.value])
    values, pull, found = jax.vjp(judge, x, has_aux=True)
    assert found.result == js.RESULTS.successful
    assert found.verdict == js.VERDICTS.held_by_contact
    nothing = dict.fromkeys(values, jnp.array(0.0))
    reverse = {name: pull({**nothing, name: jnp.array(1.0)})[0] for name in values}
    # One direction, in which no two parameters compensate each other.
    move = x * jnp.array([1.0, -0.7, 0.4, 1.3])
    forward = jax.jvp(lambda x: judge(x)[0], (x,), (move,))[1]
    above, below = judge(x + 1e-4 * move)[0], judge(x - 1e-4 * move)[0]
    for name, value in values.items():
        differences = (above[name] - below[name]) / 2e-4
        rtol = 1e-3 if name == "mode" else 1e-5
        assert abs(forward[name] - differences) < rtol * max(abs(differences), abs(value)), name
        assert abs(forward[name] - reverse[name] @ move) < 1e-8 * abs(value), name


@pytest.mark.nightly
def test_a_mode_has_its_derivative_in_single_precision_in_si_units(contact):
    def number(ratio, length=1e-6, pressure=1e11, dtype=jnp.float32):
        cell = js.Grid(16, np.full(2, length, dtype))
        solid = js.HalfSpace(cell, jnp.asarray(pressure, dtype))
        law = js.potentials.Exponential(
            jnp.asarray(0.02 * length * pressure, dtype), ratio * length
        )
        other = js.Contact(solid, (contact.heights * length).astype(dtype), law)
        state = js.equilibrate(other, js.MeanGap(jnp.asarray(0.1 * length, dtype)))
        mode = js.assess_stability(other, state).cone.mode
        return jnp.sum(jnp.sin(jnp.arange(256.0)).reshape(16, 16) * mode)

    one = jnp.ones((), jnp.float32)
    found = jax.jvp(number, (0.1 * one,), (one,))[1]
    above, below = (number(x, 1.0, 1.0, jnp.float64) for x in (0.1 + 1e-5, 0.1 - 1e-5))
    np.testing.assert_allclose(found, (above - below) / 2e-5, rtol=1e-2)


def is_undefined(output, x):
    """Whether the derivative of a number is NaN."""
    return jnp.isnan(jax.grad(output)(x)).all()


def test_there_is_no_barrier_to_differentiate_where_nothing_is_held(contact):
    def height(x):
        other = with_parameters(contact, *x[:3])
        equilibrium = js.equilibrate(other, js.MeanGap(x[3]))
        stability = js.assess_stability(other, equilibrium)
        assert stability.verdict == js.VERDICTS.stable
        return stability.barrier.height

    assert is_undefined(height, jnp.array([0.06, 0.1, 1.0, 0.6]))


@pytest.mark.nightly
def test_a_least_reaction_that_points_share_has_no_derivative(contact):
    # Two summits alike.
    heights = jnp.zeros((16, 16)).at[4, 4].set(0.1).at[12, 12].set(0.1)

    def complementarity(x, raised=0.0):
        other = js.Contact(
            with_parameters(contact, *x[:3]).solid,
            heights.at[4, 4].add(raised),
            js.potentials.Exponential(x[0], x[1]),
        )
        equilibrium = js.equilibrate(other, js.MeanGap(x[3]), TIGHT)
        assert equilibrium.in_contact.sum() == 2
        return js.assess_stability(other, equilibrium).complementarity

    x = jnp.array([0.02, 0.1, 1.0, 0.05])
    assert is_undefined(complementarity, x)
    # One of two different summits presses less.
    assert jnp.isfinite(jax.grad(lambda x: complementarity(x, raised=1e-3))(x)).all()


@pytest.mark.nightly
def test_a_multiple_eigenvalue_has_no_derivative(contact):
    def lowest(modulus):
        other = with_parameters(contact, jnp.array(1e-3), jnp.array(1.0), modulus)
        flat = js.Contact(other.solid, jnp.zeros((16, 16)), other.potential)
        equilibrium = js.equilibrate(flat, js.MeanGap(jnp.array(1.0)))
        return js.assess_stability(flat, equilibrium).lower_bound.eigenvalue

    assert is_undefined(lowest, jnp.array(1.0))
    # The eigenvalue itself is there.
    assert jnp.isfinite(lowest(jnp.array(1.0)))


def test_modes_of_a_block_refuse_to_be_differentiated(contact):
    equilibrium = js.equilibrate(contact, js.MeanGap(0.1))

    def eigenvalue(energy):
        other = with_parameters(contact, energy, 0.1, 1.0)
        return js.lowest_modes(other, equilibrium, 2, throw=False).eigenvalue[1]

    # The loads of the jumps of a path can be.
    with pytest.raises(NotImplementedError, match=r"^lowest_modes and continuation cannot be"):
        jax.jvp(eigenvalue, (0.02,), (1.0,))


@pytest.mark.nightly
def test_without_any_pressure_its_scale_and_derivatives_are_zero():
    contact = rough_contact(8, lambda gap: 0 * gap)
    nothing = jnp.zeros((8, 8))
    value, slope = jax.value_and_grad(lambda p: pressure_scale(contact, nothing + 1, p))(nothing)
    assert value == 0
    np.testing.assert_array_equal(slope, 0)
    size = pressure_scale(contact, nothing + 1, nothing.at[:2].set(3.0))
    np.testing.assert_allclose(size, 1.5)
