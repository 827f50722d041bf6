import re

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text

import jaxstab as js
from jaxstab import plots
from jaxstab.core.stack import stacked


@pytest.fixture(scope="module")
def state(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    return hertz, equilibrium, js.assess_stability(hertz, equilibrium).cone


def line_contact():
    grid = js.Grid((64,), (2.0,))
    heights = js.surfaces.sinusoid(grid, 0.1)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion())


@pytest.fixture(scope="module")
def line():
    contact = line_contact()
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


def measured(contact, unit):
    """Return a contact with a unit, with the numbers of another, and so its states."""
    return js.Contact(contact.solid, contact.heights, contact.potential, unit=unit)


@pytest.mark.parametrize("name", DRAW)
@pytest.mark.parametrize("kind", ["state", "line"])
def test_each_plot_draws_into_the_axes_given_and_labels_them(name, kind, request):
    axes = plt.subplots()[1]
    returned = DRAW[name](*request.getfixturevalue(kind), axes)
    assert returned is axes
    assert axes.get_xlabel()
    assert axes.images or axes.lines or axes.collections
    assert DRAW[name](*request.getfixturevalue(kind), None) is not axes


@pytest.mark.parametrize("kind", ["state", "line"])
def test_lengths_have_the_contacts_unit_and_pressures_none(kind, request):
    contact, equilibrium, pair = request.getfixturevalue(kind)
    for drawn, unit in ((contact, "length"), (measured(contact, "µm"), "µm")):
        axes = plots.gap(drawn, equilibrium)
        (bar,) = axes.child_axes or [axes]
        assert axes.get_xlabel() == f"x [{unit}]"
        assert bar.get_ylabel() == f"gap g [{unit}]"
        axes = plots.pressure(drawn, equilibrium)
        (bar,) = axes.child_axes or [axes]
        assert bar.get_ylabel() == "elastic pressure p [pressure]"
        assert plots.mode(drawn, pair).get_title().endswith(f"[pressure/{unit}]")
    elsewhere = plots.gap(contact, equilibrium, unit="nm")
    assert elsewhere.get_xlabel() == "x [nm]"


@pytest.fixture(scope="module")
def pdms():
    """A PDMS-like contact in metres, pascals and joules per square metre, over a load."""
    grid = js.Grid(16, (50e-6, 50e-6))
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=4, rms_height=0.5e-6)
    law = js.potentials.Exponential(0.04, 0.5e-6)
    contact = js.Contact(js.HalfSpace(grid, 2e6, 0.5), heights, law, unit="m")
    return contact, js.sweep(contact, js.MeanGap(jnp.array([0.5e-6, 1e-6])))


def ticks(axis):
    """Return what is written at the ticks of an axis, beside where they are."""
    places = axis.get_majorticklocs()
    texts = axis.get_major_formatter().format_ticks(places)
    return places, [float(text.replace("\u2212", "-")) for text in texts]


def test_in_metres_lengths_are_micrometres_and_pressures_kilopascals(pdms):
    contact, sweep = pdms
    state = sweep[0]
    axes = plots.pressure(contact, state)
    (bar,) = axes.child_axes
    assert axes.get_xlabel() == "x [µm]" and axes.get_ylabel() == "y [µm]"
    assert bar.get_ylabel() == "elastic pressure p [kPa]"
    # What is drawn stays in metres and pascals, to draw into.
    np.testing.assert_array_equal(axes.images[0].get_array(), state.equilibrium.pressure.T)
    for axis, unit in ((axes.xaxis, 1e-6), (bar.yaxis, 1e3)):
        places, texts = ticks(axis)
        np.testing.assert_allclose(texts, places / unit, rtol=1e-6, atol=1e-9)
    title = plots.mode(contact, state.stability.cone).get_title()
    number, unit = title.removeprefix("$\\lambda$ = ").split(" ")
    prefix = {"G": 1e9, "T": 1e12}[unit[0]]
    assert unit[1:] == "Pa/m"
    np.testing.assert_allclose(float(number) * prefix, state.stability.cone.eigenvalue, rtol=1e-3)


def test_every_curve_reads_in_si_units(pdms):
    contact, sweep = pdms
    axes = plots.stability_curve(sweep, unit="m")
    assert axes.get_xlabel() == "mean gap $g_0$ [µm]"
    assert axes.get_ylabel() == "mean pressure $p_0$ [kPa]"
    assert plots.stability_curve(sweep, "energy", unit="m").get_ylabel() == "energy [pJ]"
    gaps = jnp.linspace(0, 9e-7, 9)
    axes = plots.potential(contact.potential, gaps, unit="m")
    assert axes.get_xlabel() == "gap g [nm]"
    assert axes.get_ylabel() == "energy per area f(g) [mJ/m²]"
    assert plots.force(contact.potential, gaps, unit="m").get_ylabel() == "attraction f'(g) [kPa]"
    assert plots.force(contact.potential, gaps).get_ylabel() == "attraction f'(g) [pressure]"
    rings = js.surfaces.power_spectrum(contact.grid, contact.heights)
    assert plots.spectrum(rings, unit="m").get_ylabel() == "power spectral density [m$^4$]"


def test_a_second_curve_takes_the_unit_that_suits_both():
    law, axes = js.potentials.Exponential(0.04, 1e-7), plt.subplots()[1]
    for most, label in ((5e-7, "gap g [nm]"), (5e-5, "gap g [µm]"), (50.0, "gap g [m]")):
        plots.force(law, jnp.linspace(0, most, 9), unit="m", axes=axes)
        assert axes.get_xlabel() == label
        places, texts = ticks(axes.xaxis)
        unit = {"[nm]": 1e-9, "[µm]": 1e-6, "[m]": 1}[label.split()[-1]]
        np.testing.assert_allclose(texts, places / unit, rtol=1e-6, atol=1e-9)


def test_a_summary_in_metres_tells_numbers_with_prefixes(pdms):
    contact, sweep = pdms
    state = sweep[0]
    shown = words(plots.summary(contact, state))
    assert {"500 nm", f"{float(state.equilibrium.mean_pressure) / 1e3:.3g} kPa"} <= shown
    assert shown & {"[GPa/m]", "[TPa/m]"}


def test_a_line_has_energies_per_length(line):
    contact, _, _ = line
    sweep = js.sweep(contact, js.MeanGap(jnp.array([0.05, 0.1])), stability=True)
    assert plots.stability_curve(sweep, "energy").get_ylabel() == "energy [energy/length]"
    assert plots.stability_curve(sweep, "energy", unit="m").get_ylabel().endswith("J/m]")


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


def test_the_axis_of_a_mode_is_not_called_as_a_side_is(line, state):
    contact, _, pair = line
    assert plots.mode(contact, pair).get_ylabel() == "mode of unit norm [1]"
    contact, _, pair = state
    assert plots.mode_cut(contact, pair).get_ylabel() == "mode of unit norm [1]"


def test_a_stability_is_not_taken_for_one_of_its_modes(state):
    contact, equilibrium, pair = state
    stability = js.assess_stability(contact, equilibrium)
    for draw in (lambda x: plots.mode(contact, x), plots.convergence):
        with pytest.raises(TypeError, match=r"Stability is not an eigenpair.*stability\.cone"):
            draw(stability)
    with pytest.raises(ValueError, match=r"shape \(32, 32\), the contact's grid \(64,\)"):
        plots.mode(line_contact(), pair)


def test_a_closed_gap_is_shown_as_zero(state):
    contact, equilibrium, _ = state
    closed = eqx.tree_at(lambda x: x.gap, equilibrium, jnp.zeros((32, 32)))
    assert plots.gap(contact, closed).images[0].get_clim()[0] == 0


def test_colours_reach_from_the_lowest_point_to_a_summit_at_zero(state):
    contact, _, _ = state
    image = plots.surface(contact).images[0]
    assert image.get_clim() == (contact.heights.min(), 0)


def test_a_path_of_one_state_is_no_curve(hertz):
    path = js.follow(hertz, js.MeanGap(jnp.array([-0.1, 0.2])), throw=False)
    with pytest.raises(ValueError, match=r"The path has 1 states .*, a curve two or more"):
        plots.path(path)


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


@pytest.fixture(scope="module")
def sweep(hertz):
    return js.sweep(hertz, js.MeanDisplacement(jnp.array([1.2, 1.31, 1.4])))


def test_stability_curves_fill_the_markers_of_stable_states(sweep):
    axes = plots.stability_curve(sweep, "contact_area")
    stable, held = axes.collections
    assert len(stable.get_offsets()) == 2
    assert len(held.get_offsets()) == 1
    assert held.get_label() == "held by contact"
    assert tuple(held.get_facecolor()[0]) == (1, 1, 1, 1)
    np.testing.assert_array_equal(stable.get_facecolor(), stable.get_edgecolor())
    assert plots.stability_curve(sweep).get_ylabel().startswith("mean pressure")
    with pytest.raises(ValueError, match="choose one of"):
        plots.stability_curve(sweep, "gap")


def test_verdicts_differ_without_colour(sweep):
    codes = jnp.arange(len(js.VERDICTS))
    every = eqx.tree_at(lambda x: x.stability.verdict.code, sweep[[0, 1, 2, 0]], codes)
    # As far as found, and proved.
    every = eqx.tree_at(lambda x: x.stability.proved, every, codes > 0)
    extra = eqx.tree_at(lambda x: x.stability.proved, every[[0, 0]], jnp.array([True, False]))
    labels = [marks.get_label() for marks in plots.stability_curve(extra).collections]
    assert labels == ["stable", "stable, locally"]
    every = stacked([*every, extra[0]], every[0])
    looks = {
        (marks.get_paths()[0].vertices.tobytes(), marks.get_facecolor()[0].mean() > 0.99)
        for marks in plots.stability_curve(every).collections
    }
    assert len(looks) == len(js.VERDICTS) + 1


def test_curves_have_the_colours_of_okabe_and_ito():
    gaps = jnp.linspace(0, 1, 5)
    laws = [js.potentials.Exponential(depth, 0.5) for depth in (1.0, 2.0, 3.0)]
    axes = plots.potential(laws, gaps)
    drawn = [np.multiply(plt.matplotlib.colors.to_rgb(x.get_color()), 255) for x in axes.lines[:3]]
    np.testing.assert_allclose(drawn, [(0, 114, 178), (213, 94, 0), (0, 158, 115)])


def test_a_load_of_ones_own_is_named_as_it_says_or_by_its_class(sweep):
    class Magnet(js.MeanDisplacement):
        quantity, unit = "", ""

    class Coil(js.MeanDisplacement):
        quantity, unit = "current", "A"

    for load, label in ((Magnet, "Magnet"), (Coil, "current [A]")):
        pulled = eqx.tree_at(lambda x: x.load, sweep, load(sweep.load.value))
        assert plots.stability_curve(pulled).get_xlabel() == label


def test_a_spectrum_shows_the_rings_that_hold_waves():
    grid = js.Grid(32, (1.0, 0.5))
    heights = js.surfaces.sinusoid(grid, 0.1, (3, 0)) + js.surfaces.sinusoid(grid, 0.2, (0, 4))
    axes = plots.spectrum(js.surfaces.power_spectrum(grid, heights), labels=["two waves"])
    wavenumbers, densities = axes.lines[0].get_data()
    np.testing.assert_allclose(wavenumbers, 2 * np.pi * np.array([3, 8]))
    # Of a wave, two of the waves in its ring have A^2 / 4 times the area.
    num_waves = js.surfaces.power_spectrum(grid, heights).num_waves[jnp.array([2, 7])]
    np.testing.assert_allclose(densities * num_waves, 0.5 * np.array([0.01, 0.04]) / 2)
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.get_ylabel() == "power spectral density [length$^4$]"
    assert axes.get_legend().get_texts()[0].get_text() == "two waves"


def test_the_spectrum_of_a_line_has_the_unit_of_a_line():
    contact = line_contact()
    spectrum = js.surfaces.power_spectrum(contact.grid, contact.heights)
    axes = plots.spectrum([spectrum, spectrum])
    assert axes.get_ylabel() == "power spectral density [length$^3$]"
    assert len(axes.lines) == 2


def test_what_is_no_spectrum_is_refused():
    grid = js.Grid(8)
    flat = js.surfaces.power_spectrum(grid, jnp.zeros((8, 8)))
    with pytest.raises(ValueError, match="a flat surface has none"):
        plots.spectrum(flat)
    with pytest.raises(ValueError, match="stack of 2 spectra"):
        plots.spectrum(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), flat))
    with pytest.raises(TypeError, match="ArrayImpl is not a spectrum"):
        plots.spectrum([flat.density])


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


def test_a_loop_in_metres_is_lost_in_joules(loop):
    small = eqx.tree_at(lambda x: x.jumps.dissipation, loop, jnp.array([3e-14, 6.2e-15]))
    axes = plots.path(small, unit="m")
    assert axes.get_title() == "lost in 2 jumps: 36.2 fJ"
    loads = small.load.value * 1e-6
    tiny = eqx.tree_at(lambda x: x.load.value, small, loads)
    legend = plots.path(tiny, unit="m", axes=axes).get_legend()
    assert "[µm]" in legend.get_title().get_text()
    assert "to 1.2" in {text.get_text() for text in legend.get_texts()}


def test_states_of_a_sweep_are_not_joined(sweep):
    assert not plots.stability_curve(sweep).lines


def test_a_pull_off_is_drawn_as_the_end_that_it_is(hertz):
    path = js.follow(hertz, js.MeanPressure(jnp.array([0.0, -10.0])))
    axes = plots.path(path, x="load", y="contact_area", axes=plt.subplots()[1])
    assert not axes.texts and not axes.patches
    (cross,) = (line for line in axes.lines if line.get_marker() == "x")
    np.testing.assert_allclose(cross.get_xdata(), path.jumps.load.value[-1])


def test_what_cannot_be_drawn_of_a_path_is_told(loop):
    with pytest.raises(ValueError, match=r"y is 'gap': choose one of mean_gap, .*, load\."):
        plots.path(loop, y="gap")
    with pytest.raises(TypeError, match="Equilibrium is not a path"):
        plots.path(loop.jumps.before)


def words(figure):
    return {text.get_text() for text in figure.findobj(Text)}


def test_a_summary_tells_the_numbers_of_a_state(hertz, sweep):
    state = sweep[0]
    figure = plots.summary(hertz, state)
    shown = words(figure)
    stability = state.stability
    for pair in stability.pairs.values():
        value, error = float(pair.eigenvalue), float(pair.error)
        assert f"{value:.3g} ± {error:.1g}" in shown
    assert {"held by contact", "1.2 [length]", "[pressure/length]"} <= shown
    assert f"{float(state.equilibrium.mean_pressure):.3g} [pressure]" in shown
    assert f"{100 * float(state.equilibrium.contact_area):.1f} %" in shown
    assert f"{float(stability.barrier.height):.3g} [energy]" in shown
    images = [axes.images[0].get_array() for axes in figure.axes if axes.images]
    fields = [hertz.heights, state.equilibrium.gap, state.equilibrium.pressure, stability.cone.mode]
    np.testing.assert_array_equal(images, [np.asarray(field).T for field in fields])
    given = plots.summary(hertz, state.equilibrium, stability, figure=plt.figure())
    assert words(given) == shown
    assert "barrier" not in words(plots.summary(hertz, sweep[1]))


def test_ticks_of_a_saved_summary_that_smaller_letters_make_room_for_are_as_small(
    hertz, sweep, tmp_path
):
    figure = plots.summary(hertz, sweep[1])
    text = plots.save(figure, tmp_path / "figure.svg", width="double").read_text()
    sizes = re.findall(r"font(?:-size)?: ([0-9.]+)px[^>]*>\s*([^<]+?)\s*<", text)
    # Matplotlib has U+2212 for minus.
    ticks = [float(size) for size, word in sizes if re.fullmatch(r"\u2212?\d+\.\d+", word)]
    assert len(ticks) > 20 and set(ticks) == {7}


def test_a_summary_of_a_line_shades_the_contact(line):
    contact, equilibrium, _ = line
    figure = plots.summary(contact, equilibrium, js.assess_stability(contact, equilibrium))
    assert [len(axes.collections) for axes in figure.axes] == [0, 1, 0, 0, 1]


def test_a_failed_state_says_so_in_its_summary(hertz, sweep):
    failed = js.RESULTS.infeasible_load
    state = eqx.tree_at(lambda x: x.equilibrium.result, sweep[0], failed)
    assert {"equilibrium", "infeasible load"} <= words(plots.summary(hertz, state))


def test_what_cannot_be_summed_up_is_told(hertz, sweep):
    with pytest.raises(ValueError, match=r"stack of shape \(3,\)"):
        plots.summary(hertz, sweep)
    with pytest.raises(ValueError, match=r"stack of shape \(3,\)"):
        plots.summary(hertz, sweep[0], sweep.stability)
    with pytest.raises(ValueError, match="stability of this state is missing"):
        plots.summary(hertz, sweep[0].equilibrium)
    with pytest.raises(TypeError, match="Eigenpair is not a stability"):
        plots.summary(hertz, sweep[0], sweep[0].stability.cone)
