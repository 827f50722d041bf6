import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxstab as js
from jaxstab import plots

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


def test_the_contact_is_outlined_on_modes(hertz, state, line):
    contact, equilibrium, pair = state
    (outline,) = plots.mode(contact, pair, equilibrium).collections
    # Between the outermost points in contact and their neighbours, on all four sides.
    outline = np.concatenate([path.vertices for path in outline.get_paths()])
    x, y = (np.asarray(side)[equilibrium.in_contact] for side in contact.grid.coordinates)
    half = float(contact.grid.spacing[0]) / 2
    ends = [[x.min() - half, y.min() - half], [x.max() + half, y.max() + half]]
    np.testing.assert_allclose([outline.min(0), outline.max(0)], ends)
    assert not plots.mode(contact, pair).collections
    contact, equilibrium, pair = line
    assert len(plots.mode(contact, pair, equilibrium).collections) == 1


def test_a_stability_is_not_taken_for_one_of_its_modes(state, line_contact):
    contact, equilibrium, pair = state
    stability = js.assess_stability(contact, equilibrium)
    for draw in (lambda x: plots.mode(contact, x), plots.convergence):
        with pytest.raises(TypeError, match=r"Stability is not an eigenpair.*stability\.cone"):
            draw(stability)
    with pytest.raises(ValueError, match=r"shape \(32, 32\), the grid \(64,\)"):
        plots.mode(line_contact, pair)


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


def test_rows_and_bins_are_whole_numbers_of_a_range(state):
    contact, equilibrium, pair = state
    for row, message in ((32, "row is 32: the grid has 32 rows"), (1.5, "row is 1.5: give an")):
        with pytest.raises((ValueError, TypeError), match=message):
            plots.mode_cut(contact, pair, row=row)
    with pytest.raises(TypeError, match=r"bins is 2.5: give an integer"):
        plots.distribution(contact, equilibrium, bins=2.5)


def test_a_line_has_no_cut(line):
    with pytest.raises(ValueError, match="no rows"):
        plots.mode_cut(line[0], line[2])


def test_each_contact_point_of_a_line_is_drawn_in_its_whole_width(line):
    """Patches of one, two and three points of 64, on a cell of length 2."""
    contact, equilibrium, pair = line
    touches = np.isin(np.arange(64), [0, 20, 21, 40, 41, 42])
    state = eqx.tree_at(lambda x: x.in_contact, equilibrium, jnp.array(touches))
    for axes in (
        plots.contact_map(contact, state),
        plots.patches(contact, state),
        plots.mode(contact, pair, state),
    ):
        shapes = [path.vertices for part in axes.collections for path in part.get_paths()]
        ends = sorted((corners[:, 0].min(), corners[:, 0].max()) for corners in shapes)
        expected = np.array([(-0.5, 0.5), (19.5, 21.5), (39.5, 42.5)]) * 2 / 64
        np.testing.assert_allclose(ends, expected)
        left, right = axes.get_xlim()
        assert left <= -1 / 64 and right >= 2 - 1 / 64
    assert plots.contact_map(contact, state).get_xlim() == (-1 / 64, 2 - 1 / 64)


def test_figures_refuse_a_state_that_was_not_found(line_contact):
    failed = js.equilibrate(line_contact, js.MeanGap(-1.0), throw=False)
    for draw in (plots.gap, plots.pressure, plots.contact_map, plots.distribution, plots.summary):
        stability = [js.assess_stability(line_contact, failed, throw=False)]
        more = stability if draw is plots.summary else []
        with pytest.raises(ValueError, match=r"was not found \(infeasible_load\)"):
            draw(line_contact, failed, *more)


def test_one_step_of_a_solver_is_seen_and_no_legend_is_empty(line):
    contact, equilibrium, pair = line
    (curve,) = plots.convergence(pair).lines
    assert curve.get_marker() == "."
    closed = eqx.tree_at(
        lambda x: (x.in_contact, x.gap), equilibrium, (jnp.ones(64, bool), jnp.zeros(64))
    )
    with warnings.catch_warnings(action="error"):
        assert plots.distribution(contact, closed, "gap").get_legend() is None


def test_heights_on_a_large_datum_keep_their_digits_and_the_label_names_it():
    with jax.enable_x64(False):
        grid = js.Grid((32,), 1e-6)
        heights = 5e-3 + 1e-9 * np.cos(2 * np.pi * np.arange(32) / 32)
        surface = js.surfaces.Topography(grid, heights, "m")
        contact = js.Contact(js.HalfSpace(grid, 1e9), surface, js.potentials.NoAdhesion())
        axes = plots.surface(contact)
    drawn = axes.lines[0].get_ydata()
    np.testing.assert_allclose(drawn - drawn.mean(), heights - heights.mean(), atol=1e-15)
    assert axes.get_ylabel() == "height h above 5 mm [nm]"
