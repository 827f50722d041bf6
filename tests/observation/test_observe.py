"""Observables beside the states of paths and sweeps, one by one, in files and in print."""

from functools import partial
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from problems import rough_contact

import jaxstab as js
from jaxstab.__main__ import main


class CubedPressure(js.results.Observable):
    """An observable as a user adds it: the sum of |p|^3 over the contact."""

    total: Annotated[Float[Array, ""], js.Dimension("pressure^3 length^2")]
    cubes: Annotated[Float[Array, " *grid"], js.Dimension("pressure^3")] | None


def cubed_pressure(contact, equilibrium):
    cubes = jnp.where(equilibrium.in_contact, jnp.abs(equilibrium.pressure) ** 3, 0)
    return CubedPressure(jnp.sum(cubes) * contact.grid.cell_area, cubes, units=contact.units)


class Bare(js.results.Observable):
    total: Annotated[Array, js.Dimension("pressure")]


@pytest.fixture(scope="module")
def contact():
    return rough_contact(32, js.potentials.Exponential(1e-3, 0.05), rms_height=0.05)


@pytest.fixture(scope="module")
def path(contact):
    turns = js.MeanGap(jnp.array([0.1, 0.01, 0.1]))
    # With fewer states than by default, of which each is observed by itself.
    return js.follow(contact, turns, smallest_jump=1e-2, fields=True)


@pytest.fixture(scope="module")
def sweep(contact):
    return js.sweep(contact, js.MeanGap(jnp.array([0.2, 0.05, 0.01])), stability=False)


def test_a_sweeps_columns_are_those_of_each_state(contact, sweep):
    conducted = partial(js.conductance, resistivities=(1.0, 2.0))
    found = js.observe(contact, sweep, js.patches, conducted, js.leakage)
    assert len(found) == 3
    for i, state in enumerate(sweep):
        patches = js.patches(contact, state)
        for name in ("number", "area", "true_area", "largest", "perimeter", "percolates"):
            np.testing.assert_array_equal(
                getattr(found.patches, name)[i], getattr(patches, name), name
            )
        one = js.conductance(contact, state, (1.0, 2.0))
        np.testing.assert_allclose(found.conductance.conductance[i], one.conductance, rtol=1e-9)
        tensor = js.leakage(contact, state).permeability
        np.testing.assert_allclose(found.leakage.permeability[i], tensor, rtol=1e-9)
    np.testing.assert_allclose(
        found.patches.area, sweep.equilibrium.contact_area * contact.area, rtol=1e-12
    )


def test_a_path_is_observed_along_its_states(contact, path):
    found = js.observe(contact, path, js.patches, js.conductance)
    with pytest.raises(AttributeError, match="holds patches, conductance"):
        _ = found.leakage
    assert len(found) == len(path.equilibrium)
    np.testing.assert_allclose(
        found.patches.area, path.equilibrium.contact_area * contact.area, rtol=1e-12
    )
    # More contact conducts more: the sets of contact points are nested while pressing.
    pressing = int(np.argmin(path.load.value))
    assert (np.diff(found.conductance.conductance[: pressing + 1]) >= -1e-9).all()
    lines = repr(found).splitlines()
    assert lines[0].split() == [
        "MeanGap",
        "contact",
        "area",
        "patches",
        "true",
        "area",
        "conductance",
    ]
    assert len(lines) == min(len(found), 61) + 2
    one = found[pressing]
    assert one.patches.area == found.patches.area[pressing]


def test_a_state_of_a_path_is_had_again_from_its_gap(contact, path):
    i = 1
    with pytest.raises(TypeError, match=r"States is not a state.*initial=path"):
        js.leakage(contact, path.equilibrium[i])
    again = js.equilibrate(contact, path.load[i], initial=path.equilibrium.gap[i])
    np.testing.assert_allclose(again.gap, path.equilibrium.gap[i], atol=1e-9)
    np.testing.assert_allclose(again.mean_gap, path.equilibrium.mean_gap[i], rtol=1e-12)
    assert (js.leakage(contact, again).permeability > 0).any()


@pytest.mark.nightly
def test_on_a_window_points_of_the_window_count(contact):
    window = js.Contact(js.FreeHalfSpace(js.Grid(32), 1.0), contact.heights, contact.potential)
    load = js.FarDisplacement(jnp.array([0.1, -0.05]))
    path = js.follow(window, load, fields=True)
    found = js.observe(window, path, js.patches, js.conductance, cubed_pressure)
    np.testing.assert_allclose(
        found.patches.area, path.equilibrium.contact_area * window.area, rtol=1e-12
    )
    last = js.equilibrate(window, path[-1].load, initial=path[-1])
    expected = cubed_pressure(window, last).total
    np.testing.assert_allclose(found.cubed_pressure.total[-1], expected, rtol=1e-6)


def test_states_not_found_are_nan_and_leave_the_others(contact, sweep):
    gap = sweep.equilibrium.gap.at[1].set(jnp.nan)
    states = sweep.equilibrium
    object.__setattr__(lost := states[:], "gap", gap)
    found = js.observe(contact, lost, js.patches, js.leakage)
    assert np.isnan(found.patches.area[1])
    assert found.patches.number[1] == 0
    assert np.isnan(found.leakage.permeability[1]).all()
    assert np.isfinite(found.patches.area[jnp.array([0, 2])]).all()


def test_an_observable_of_the_user_is_a_column_of_a_path_a_figure_and_a_file(
    contact, path, tmp_path
):
    observed = js.observe(contact, path, cubed_pressure, js.patches)
    column = np.asarray(observed.cubed_pressure.total)
    for i in (1, len(column) // 2):
        state = js.equilibrate(contact, path.load[i], initial=path.equilibrium.gap[i])
        # In contact the elastic pressure is the reaction less the attraction.
        pressure = np.asarray(state.reaction - js.potentials.slope(contact.potential, state.gap))
        expected = np.sum(np.abs(pressure[np.asarray(state.in_contact)]) ** 3) / 32**2
        np.testing.assert_allclose(column[i], expected, rtol=1e-6)
    assert observed.cubed_pressure.cubes is None
    assert "total" in repr(observed).splitlines()[0].split()
    axes = js.plots.observed(observed, x="mean_gap")
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), column)
    np.testing.assert_array_equal(axes.lines[0].get_xdata(), path.equilibrium.mean_gap)
    assert axes.get_ylabel() == "cubed pressure total [pressure³ length²]"
    dataset = js.to_dataset(contact, observed)
    assert dataset["cubed_pressure_total"].dims == ("state",)
    assert dataset["cubed_pressure_total"].attrs["units"] == "pressure^3 length^2"
    np.testing.assert_array_equal(dataset["cubed_pressure_total"], column)
    _, again = js.load(js.save(tmp_path / "it.nc", contact, observed))
    np.testing.assert_array_equal(again.cubed_pressure.total, column)


def test_units_of_the_users_dimension_follow_from_those_of_length_and_pressure(contact):
    micro = js.Contact(
        contact.solid, contact.heights, contact.potential, unit="µm", pressure_unit="MPa"
    )
    state = js.equilibrate(micro, js.MeanGap(0.05))
    found = cubed_pressure(micro, state)
    assert "MPa³ µm²" in repr(found)
    kilo = found.in_units_of(jnp.array(10.0))
    np.testing.assert_allclose(kilo.total, found.total / 1e3, rtol=1e-14)


def test_an_observable_of_python_numbers_is_a_column(contact, sweep):
    def counted(contact, state):
        return CubedPressure(float(state.num_steps), None)

    found = js.observe(contact, sweep, counted).counted.total
    np.testing.assert_array_equal(found, sweep.equilibrium.num_steps)
    assert found.dtype == contact.heights.dtype


def test_the_command_line_shows_columns_and_draws_one(contact, sweep, tmp_path, capsys):
    path = js.save(tmp_path / "it.nc", contact, js.observe(contact, sweep, js.patches))
    main(["info", str(path)])
    assert "true area" in capsys.readouterr().out
    main(["plot", str(path)])
    assert path.with_suffix(".png").stat().st_size > 1000


def test_what_cannot_be_observed_is_said(contact, path, sweep):
    def equilibrium(contact, state):
        return cubed_pressure(contact, state)

    def law(contact, state):
        return cubed_pressure(contact, state)

    bare = eqx.tree_at(lambda path: path.equilibrium.gap, path, None)
    with pytest.raises(ValueError, match=r"kept no gaps.*fields=True"):
        js.observe(contact, bare, js.patches)
    with pytest.raises(TypeError, match="Path is no contact"):
        js.observe(path, contact, js.patches)
    with pytest.raises(TypeError, match="Stability has no states to observe"):
        js.observe(contact, js.assess_stability(contact, sweep[0]), js.patches)
    with pytest.raises(TypeError, match="is 'patches': give functions"):
        js.observe(contact, path, "patches")
    with pytest.raises(TypeError, match="is missing: give functions"):
        js.observe(contact, path)
    with pytest.raises(ValueError, match=r"named patches, leakage, leakage: names must differ"):
        js.observe(contact, sweep, js.patches, js.leakage, partial(js.leakage, viscosity=2.0))
    with pytest.raises(ValueError, match="equilibrium is a name of the result itself: rename"):
        js.observe(contact, sweep, equilibrium)
    with pytest.raises(ValueError, match="law is a name of the result itself: rename"):
        js.observe(contact, sweep, law)
    with pytest.raises(TypeError, match="<lambda> returned a Array"):
        js.observe(contact, sweep, lambda contact, state: state.gap)
    with pytest.raises(TypeError, match=r"total of Bare is declared as no array: .*Float\["):
        js.observe(contact, sweep, lambda contact, state: Bare(state.energy))
    for wrong in (jnp.ones(3), None, js.RESULTS.successful):
        with pytest.raises(ValueError, match=r"total of CubedPressure is .*, not of shape \(\)"):
            js.observe(contact, sweep, lambda contact, state, x=wrong: CubedPressure(x, None))
    with pytest.raises(ValueError, match="several states in one row"):
        js.observe(contact, sweep[0], js.patches)
    with pytest.raises(ValueError, match=r"column is 'area': choose one of patches\.number"):
        js.plots.observed(js.observe(contact, sweep, js.patches), "area")
    one = js.observe(contact, sweep, js.leakage)[0]
    with pytest.raises(ValueError, match="along a path has no fields"):
        js.plots.flow(contact, one.leakage)
