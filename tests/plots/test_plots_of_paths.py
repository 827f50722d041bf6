import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxstab as js
from jaxstab import plots


def test_a_path_is_drawn_with_its_jumps_and_the_energy_of_its_loop(loop):
    axes = plots.path(loop)
    left, right = axes.figure.axes
    assert left is axes
    assert axes.get_title() == f"lost in 2 jumps: {float(loop.dissipation):.4g}"
    assert axes.get_xlabel() == "mean gap $g_0$ [length]"
    assert right.get_ylabel() == "contact area"
    assert len(axes.texts) == len(loop.jumps)
    first = int(loop.jumps.state[0])
    drawn = axes.lines[0].get_xdata()
    # A branch ends at its last state.
    np.testing.assert_allclose(drawn, loop.equilibrium.mean_gap[: first + 1])
    np.testing.assert_allclose(
        axes.texts[0].xyann,
        [loop.equilibrium.mean_gap[first], loop.equilibrium.mean_pressure[first]],
    )
    (patch,) = axes.patches
    x, y = patch.get_xy().T
    area = abs(np.trapezoid(y, x))
    np.testing.assert_allclose(area, loop.dissipation, rtol=2e-2)
    over = plots.path(loop, x="load", y="energy", axes=right)
    assert over.get_xlabel() == "mean displacement $u_0$ [length]"


def test_adhesion_is_seen_beside_a_compression_that_is_far_larger(loop):
    pressures = loop.equilibrium.mean_pressure
    pressed = eqx.tree_at(lambda x: x.equilibrium.mean_pressure, loop, pressures.at[40].set(1000.0))
    tension = -float(pressures.min())
    axes = plots.path(pressed, axes=plt.subplots()[1])
    np.testing.assert_allclose(axes.get_ylim(), [-1.2 * tension, tension])


def test_a_pull_off_is_drawn_as_the_end_that_it_is(hertz):
    path = js.follow(hertz, js.MeanPressure(jnp.array([0.0, -5.0, -10.0])))
    axes = plots.path(path, x="load", y="contact_area", axes=plt.subplots()[1])
    assert not axes.texts and not axes.patches
    (cross,) = (line for line in axes.lines if line.get_marker() == "x")
    np.testing.assert_allclose(cross.get_xdata(), path.jumps.load.value[-1])


def test_what_cannot_be_drawn_of_a_path_is_told(hertz, loop):
    load = js.MeanDisplacement(jnp.array([-2.0, 1.2, 1.6]))
    one = js.follow(hertz, load, throw=False, fields=True)
    with pytest.raises(ValueError, match=r"The path has 1 states .*, a curve two or more"):
        plots.path(one)
    with pytest.raises(ValueError, match=r"y is 'gap': choose one of mean_gap, .*, load\."):
        plots.path(loop, y="gap")
    with pytest.raises(TypeError, match="Equilibrium is not a path"):
        plots.path(loop.jumps.before)
