from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxstab as js
from jaxstab import plots
from jaxstab.core.unit_system import Units


@pytest.fixture(scope="module")
def loop(hertz):
    return js.follow(
        hertz, js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6])), smallest_jump=1e-5, fields=True
    )


def test_a_path_is_drawn_with_its_jumps_and_the_energy_of_its_loop(loop):
    axes = plots.path(loop)
    left, right = axes.figure.axes
    assert left is axes
    assert axes.get_title() == f"lost in 2 jumps: {float(loop.dissipation):.4g} [energy]"
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


def test_jumps_too_short_for_a_head_have_none(loop):
    short = eqx.tree_at(
        lambda x: x.equilibrium.mean_pressure,
        loop,
        # The second jump is made a hundredth of the curve's height.
        loop.equilibrium.mean_pressure.at[loop.jumps.state[1] + 1].set(
            loop.equilibrium.mean_pressure[loop.jumps.state[1]] + 0.015
        ),
    )

    def heads(path):
        axes = plots.path(path, axes=plt.subplots()[1])
        return [type(text.arrow_patch.get_arrowstyle()).__name__ for text in axes.texts]

    assert heads(loop) == ["CurveB", "CurveB"]
    assert heads(short) == ["CurveB", "Curve"]


def test_adhesion_is_seen_beside_a_compression_that_is_far_larger(loop):
    def limits(path, **quantities):
        axes = plots.path(path, axes=plt.subplots()[1], **quantities)
        return axes.get_xlim(), axes.get_ylim()

    pressed = eqx.tree_at(
        lambda x: x.equilibrium.mean_pressure,
        loop,
        loop.equilibrium.mean_pressure.at[40].set(1000.0),
    )
    # Nor is rounding a tension.
    rounded = eqx.tree_at(
        lambda x: x.equilibrium.mean_pressure, loop, loop.equilibrium.mean_pressure.at[:].set(1e-9)
    )
    rounded = eqx.tree_at(
        lambda x: x.equilibrium.mean_pressure,
        rounded,
        rounded.equilibrium.mean_pressure.at[3].set(-1e-17),
    )
    assert limits(rounded)[1][1] > 1e-9
    tension = -float(loop.equilibrium.mean_pressure.min())
    np.testing.assert_allclose(limits(pressed)[1], [-1.2 * tension, tension])
    over = limits(pressed, x="mean_pressure", y="mean_gap")[0]
    np.testing.assert_allclose(over, [-1.2 * tension, tension])
    # Without tension there is none to be seen, and a small compression is shown in full.
    pushed = eqx.tree_at(
        lambda x: x.equilibrium.mean_pressure, loop, 10 + loop.equilibrium.mean_pressure
    )
    assert limits(pushed)[1][1] > float(pushed.equilibrium.mean_pressure.max())
    assert limits(loop)[1][1] > float(loop.equilibrium.mean_pressure.max())


def test_the_contact_area_is_drawn_only_where_something_touches(loop):
    apart = eqx.tree_at(
        lambda x: x.equilibrium.contact_area, loop, jnp.zeros_like(loop.equilibrium.contact_area)
    )
    for drawn, y, number in (
        (apart, "mean_pressure", 1),
        (loop, "contact_area", 1),
        (loop, "energy", 2),
    ):
        axes = plots.path(drawn, y=y)
        assert len(axes.figure.axes) == number
        # The legend is beside the last panel, off all that is drawn.
        legend = axes.figure.axes[-1].get_legend()
        axes.figure.draw_without_rendering()
        box, inside = legend.get_window_extent(), axes.figure.axes[-1].get_window_extent()
        assert box.x0 >= inside.x1


def test_the_approach_is_thinner_and_the_legend_names_jumps(loop):
    axes = plots.path(loop, axes=plt.subplots()[1])
    drawn = [line for line in axes.lines if line.get_marker() == "."]
    # The first part of the loop brings the surfaces together, the second takes them apart.
    widths = {line.get_color(): line.get_linewidth() for line in drawn}
    (approach, thin), (retreat, thick) = widths.items()
    assert thin < thick / 2
    order = {line.get_color(): line.get_zorder() for line in drawn}
    assert order[approach] > order[retreat]
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["to 1.2", "to 1.6", "jump"]


def test_a_loop_in_metres_is_lost_in_joules(loop):
    states = replace(loop.equilibrium, units=Units("m", "Pa"))
    small = replace(loop, equilibrium=states)
    small = eqx.tree_at(lambda x: x.jumps.dissipation, small, jnp.array([3e-14, 6.2e-15]))
    axes = plots.path(small)
    assert axes.get_title() == "lost in 2 jumps: 36.2 fJ"
    loads = small.load.value * 1e-6
    tiny = eqx.tree_at(lambda x: x.load.value, small, loads)
    legend = plots.path(tiny, axes=axes).get_legend()
    assert "[µm]" in legend.get_title().get_text()
    assert "to 1.2" in {text.get_text() for text in legend.get_texts()}


def test_a_pull_off_is_drawn_as_the_end_that_it_is(hertz):
    path = js.follow(hertz, js.MeanPressure(jnp.array([0.0, -10.0])))
    axes = plots.path(path, x="load", y="contact_area", axes=plt.subplots()[1])
    assert not axes.texts and not axes.patches
    (cross,) = (line for line in axes.lines if line.get_marker() == "x")
    np.testing.assert_allclose(cross.get_xdata(), path.jumps.load.value[-1])


def test_a_path_of_one_state_is_no_curve(hertz):
    path = js.follow(hertz, js.MeanGap(jnp.array([-0.1, 0.2])), throw=False)
    with pytest.raises(ValueError, match=r"The path has 1 states .*, a curve two or more"):
        plots.path(path)


def test_what_cannot_be_drawn_of_a_path_is_told(loop):
    with pytest.raises(ValueError, match=r"y is 'gap': choose one of mean_gap, .*, load\."):
        plots.path(loop, y="gap")
    with pytest.raises(TypeError, match="Equilibrium is not a path"):
        plots.path(loop.jumps.before)
