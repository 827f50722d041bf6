from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxstab as js
from jaxstab import plots
from jaxstab.core.history import History
from jaxstab.core.stack import stack_of


def test_laws_and_forces_are_those_asked_for():
    gaps = jnp.linspace(0, 2, 50)
    laws = [js.potentials.Exponential(1.0, 0.5), js.potentials.Rational(1.0, 0.5)]
    axes = plots.potential(laws, gaps)
    np.testing.assert_allclose(axes.lines[0].get_ydata(), -np.exp(-np.asarray(gaps) / 0.5))
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["Exponential", "Rational"]
    axes = plots.force(lambda gap: gap**2, gaps, labels=["mine"])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 2 * np.asarray(gaps))

    def mine(gap):
        return gap**2

    assert plots.potential(mine, gaps).lines[0].get_label() == "mine"
    contact = js.Contact(js.HalfSpace(js.Grid(4), 1.0), np.zeros((4, 4)), laws[0])
    with pytest.raises(TypeError, match=r"law is a Contact: .*`contact.potential`"):
        plots.force(contact, gaps)


def test_labels_and_gaps_are_lists_and_axes_are_axes():
    law = js.potentials.Exponential(1.0, 1.0)
    axes = plots.potential(law, [0, 1, 2])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), -np.exp([0.0, -1, -2]))
    grid = js.Grid(8)
    spectrum = js.surfaces.power_spectrum(grid, js.surfaces.sinusoid(grid, 0.1))
    for draw in (
        lambda labels: plots.potential([law, law], [0.0, 1.0], labels=labels),
        lambda labels: plots.spectrum([spectrum, spectrum], labels=labels),
    ):
        for labels in (["one"], "ab"):
            with pytest.raises(ValueError, match="give a list of 2, one for each curve"):
                draw(labels)
    with pytest.raises(TypeError, match="Figure is not axes: give"):
        plots.spectrum(spectrum, axes=plt.figure())


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
    # A state that pulled off has fields, but is no equilibrium.
    codes = jnp.full(3, js.RESULTS.successful.code).at[1].set(js.RESULTS.pulled_off.code)
    gone = eqx.tree_at(lambda x: x.equilibrium.result.code, sweep, codes)
    drawn = sum(len(marks.get_offsets()) for marks in plots.stability_curve(gone).collections)
    assert drawn == 2


def test_verdicts_differ_without_colour(sweep):
    codes = jnp.arange(len(js.VERDICTS.names))
    every = eqx.tree_at(lambda x: x.stability.verdict.code, sweep[[0, 1, 2, 0]], codes)
    # As far as found, and proved.
    every = eqx.tree_at(lambda x: x.stability.proved, every, codes > 0)
    extra = eqx.tree_at(lambda x: x.stability.proved, every[[0, 0]], jnp.array([True, False]))
    labels = [marks.get_label() for marks in plots.stability_curve(extra).collections]
    assert labels == ["stable", "stable, locally"]
    every = stack_of([*every, extra[0]], every[0])
    looks = {
        (marks.get_paths()[0].vertices.tobytes(), marks.get_facecolor()[0].mean() > 0.99)
        for marks in plots.stability_curve(every).collections
    }
    assert len(looks) == len(js.VERDICTS.names) + 1


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
    # For a single wave, two of the waves in its ring have A^2 / 4 times the area.
    num_waves = js.surfaces.power_spectrum(grid, heights).num_waves[jnp.array([2, 7])]
    np.testing.assert_allclose(densities * num_waves, 0.5 * np.array([0.01, 0.04]) / 2)
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.get_ylabel() == "power spectral density [length⁴]"
    assert axes.get_legend().get_texts()[0].get_text() == "two waves"


def test_what_is_no_spectrum_is_refused():
    grid = js.Grid(8)
    flat = js.surfaces.power_spectrum(grid, jnp.zeros((8, 8)))
    with pytest.raises(ValueError, match="a flat surface has none"):
        plots.spectrum(flat)
    with pytest.raises(ValueError, match="stack of 2 spectra"):
        plots.spectrum(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), flat))
    with pytest.raises(TypeError, match="ArrayImpl is not a spectrum"):
        plots.spectrum([flat.density])


def test_indicators_of_a_solver_of_ones_own_are_named_as_they_are(line):
    *_, pair = line
    steps = jnp.array([[0, 1.0, 1.0], [1, 0.1, 0.3], [2, 0.01, 0.2]])
    axes = plots.convergence(replace(pair, history=History(steps, ("eta", "shift"))))
    assert [curve.get_label() for curve in axes.lines] == [r"$\eta$", "shift"]
