"""The first jump of a path: closed forms of flat surfaces on a spring, other searches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

LINE = js.Grid((8,), 1.0)
SOLID = js.HalfSpace(LINE, 4.0)
MACHINE = 0.5
FLAT = jnp.zeros(8)


def on_spring(first, last):
    return js.Spring(jnp.array([first, last]), MACHINE)


def gaussian(work):
    return js.Contact(SOLID, FLAT, js.potentials.Gaussian(work, 0.1))


def charged(voltage):
    return js.Contact(SOLID, FLAT, js.potentials.Electrostatic(voltage, 2.0, 0.1))


@pytest.mark.nightly
def test_flat_surfaces_on_a_spring_jump_once_the_law_is_steeper_than_the_spring():
    # f'' of the Gaussian is least at sqrt(3) rho: -2 w exp(-3 / 2) / rho^2.
    exact = MACHINE * 0.1**2 * np.exp(1.5) / 2
    found = js.first_jump(gaussian, (2 * exact, exact / 2), on_spring(0.4, 0.02))
    assert found.error <= 1.5e-3 * exact
    assert abs(found.parameter - exact) <= 1.05 * found.error
    assert found.kind == "fold"
    np.testing.assert_allclose(found.equilibrium.gap, np.sqrt(3) * 0.1, rtol=0.1)
    assert found.result == "successful"
    assert js.assess_stability(gaussian(found.jumping), found).cone.eigenvalue < 1e-6


@pytest.mark.nightly
def test_electrodes_on_a_spring_are_pulled_in_from_the_voltage_of_a_closed_form():
    # The steepest attraction is where they touch: eps V^2 / d^3.
    exact = np.sqrt(MACHINE * 0.1**3 / 2)
    found = js.first_jump(charged, (0.7 * exact, 1.5 * exact), on_spring(0.3, -0.05), rtol=2e-3)
    assert abs(found.parameter - exact) <= found.error
    assert found.equilibrium.gap.max() < 0.01


def test_a_path_that_is_not_known_ends_the_search_with_the_bracket_so_far():
    ends = 5e-3, 0.02

    def broken(work):
        if float(work) in ends:
            return gaussian(work)
        return js.Contact(js.HalfSpace(LINE, 1e-309), FLAT, js.potentials.Gaussian(work, 0.1))

    load = on_spring(0.4, 0.02)
    found = js.first_jump(broken, ends, load, throw=False)
    assert found.result == "invalid_contact"
    assert found.jumping == 0.02
    np.testing.assert_allclose([found.parameter, found.error], [0.0125, 0.0075])
    with pytest.raises(
        js.exceptions.SolverError, match=r"path at the parameter 0\.0125 is not known"
    ):
        js.first_jump(broken, ends, load)


@pytest.mark.nightly
def test_on_a_rough_line_another_search_jumps_on_one_side_only():
    grid = js.Grid((32,), 1.0)
    heights = js.surfaces.self_affine(grid, jax.random.key(3), k_high=4, rms_height=0.05)
    load = js.MeanDisplacement(jnp.array([0.25, 0.02]))

    def contact(work):
        return js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(work, 0.05))

    found = js.first_jump(contact, (0.002, 0.05), load, rtol=0.02)
    calm = 2 * found.parameter - found.jumping
    far = found.jumping + 4 * found.error
    assert not len(js.follow(contact(calm), load).jumps)
    assert len(js.follow(contact(far), load).jumps)


def test_what_is_no_bracket_is_refused():
    load = on_spring(0.4, 0.02)
    with pytest.raises(ValueError, match="neither jumps"):
        js.first_jump(gaussian, (1e-4, 2e-4), load)
    with pytest.raises(ValueError, match=r"bracket is \(1.0, 1.0\)"):
        js.first_jump(gaussian, (1.0, 1.0), load)
    with pytest.raises(ValueError, match="continuation takes two loads"):
        js.first_jump(gaussian, (1e-4, 1.0), load[0])
    with pytest.raises(TypeError, match="no contact"):
        js.first_jump(lambda x: x, (1e-4, 1.0), load)
