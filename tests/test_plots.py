import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxstab as js
from jaxstab import plots


@pytest.fixture(scope="module")
def state(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    return hertz, equilibrium, js.assess_stability(hertz, equilibrium).cone


@pytest.fixture(scope="module")
def line():
    grid = js.Grid((64,), (2.0,))
    contact = js.Contact(
        js.HalfSpace(grid, 1.0), js.surfaces.sinusoid(grid, 0.1), js.potentials.NoAdhesion()
    )
    equilibrium = js.equilibrate(contact, js.MeanGap(0.05))
    return contact, equilibrium, js.assess_stability(contact, equilibrium).cone


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


DRAW = {
    "surface": lambda contact, equilibrium, pair, axes: plots.surface(contact, axes=axes),
    "gap": lambda contact, equilibrium, pair, axes: plots.gap(contact, equilibrium, axes=axes),
    "pressure": lambda contact, equilibrium, pair, axes: plots.pressure(
        contact, equilibrium, axes=axes
    ),
    "contact_map": lambda contact, equilibrium, pair, axes: plots.contact_map(
        contact, equilibrium, axes=axes
    ),
    "mode": lambda contact, equilibrium, pair, axes: plots.mode(contact, pair, axes=axes),
    "convergence": lambda contact, equilibrium, pair, axes: plots.convergence(pair, axes=axes),
}


@pytest.mark.parametrize("name", DRAW)
@pytest.mark.parametrize("kind", ["state", "line"])
def test_each_plot_draws_into_the_axes_given_and_labels_them(name, kind, request):
    axes = plt.subplots()[1]
    returned = DRAW[name](*request.getfixturevalue(kind), axes)
    assert returned is axes
    assert axes.get_xlabel()
    assert axes.images or axes.lines or axes.collections
    assert DRAW[name](*request.getfixturevalue(kind), None) is not axes


def test_maps_put_the_first_index_along_x(state):
    contact, _, _ = state
    grid = js.Grid((4, 6), (2.0, 3.0))
    heights = jnp.zeros((4, 6)).at[3, 1].set(1.0)
    tall = js.Contact(js.HalfSpace(grid, 1.0), heights, contact.potential)
    image = plots.surface(tall).images[0]
    assert image.get_array().shape == (6, 4)
    assert image.get_array()[1, 3] == 1
    assert image.get_extent() == [-0.25, 1.75, -0.25, 2.75]


def test_a_cut_shows_the_mode_and_the_contact(state):
    contact, equilibrium, pair = state
    axes = plots.mode_cut(contact, pair, equilibrium)
    drawn = axes.lines[0].get_ydata()
    np.testing.assert_array_equal(drawn, pair.mode[:, 16])
    assert axes.get_legend() is not None


def test_a_line_has_no_cut(line):
    with pytest.raises(ValueError, match="no rows"):
        plots.mode_cut(line[0], line[2])


def test_laws_and_forces_are_those_asked_for():
    gaps = jnp.linspace(0, 2, 50)
    laws = [js.potentials.Exponential(1.0, 0.5), js.potentials.Rational(1.0, 0.5)]
    axes = plots.potential(laws, gaps)
    np.testing.assert_allclose(axes.lines[0].get_ydata(), -np.exp(-np.asarray(gaps) / 0.5))
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["Exponential", "Rational"]
    axes = plots.force(lambda gap: gap**2, gaps, labels=["mine"])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 2 * np.asarray(gaps))


def test_stability_curves_fill_the_markers_of_stable_states(hertz):
    sweep = js.sweep(hertz, js.MeanDisplacement(jnp.array([1.2, 1.31, 1.4])))
    axes = plots.stability_curve(sweep, "contact_area")
    stable, held = axes.collections
    assert len(stable.get_offsets()) == 2
    assert len(held.get_offsets()) == 1
    assert held.get_label() == "held by contact"
    colours = {tuple(marks.get_facecolor()[0]) for marks in (stable, held)}
    assert len(colours) == 2
    assert plots.stability_curve(sweep).get_ylabel().startswith("mean pressure")
    with pytest.raises(ValueError, match="choose one of"):
        plots.stability_curve(sweep, "gap")


@pytest.fixture(scope="module")
def loop(hertz):
    return js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6])), smallest_jump=1e-5)


def test_a_path_is_drawn_with_its_jumps_and_the_energy_of_its_loop(loop):
    axes = plots.path(loop)
    left, right = axes.figure.axes
    assert left is axes
    assert axes.get_title() == f"lost around the loop: {float(loop.dissipation):.4g} [energy]"
    assert axes.get_xlabel() == "mean gap $g_0$ [length]"
    assert right.get_ylabel() == "contact area [1]"
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


def test_a_pull_off_is_drawn_as_the_end_that_it_is(hertz):
    path = js.follow(hertz, js.MeanPressure(jnp.array([0.0, -10.0])))
    axes = plots.path(path, x="load", y="contact_area", axes=plt.subplots()[1])
    assert not axes.texts and not axes.patches
    (cross,) = (line for line in axes.lines if line.get_marker() == "x")
    np.testing.assert_allclose(cross.get_xdata(), path.jumps.load.value[-1])


def test_what_cannot_be_drawn_of_a_path_is_told(loop):
    with pytest.raises(ValueError, match=r"y is 'gap': choose one of mean_gap, .*, load\."):
        plots.path(loop, y="gap")
