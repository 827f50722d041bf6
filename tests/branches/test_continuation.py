"""Branches of equilibria, stable or not, around their folds and corners."""

import importlib
import itertools
import signal
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from brute_force import on_zero_mean, periodic_stiffness
from problems import with_room
from programs import compilations

import jaxstab as js
from jaxstab.branches import morse_index
from jaxstab.branches.branch_steps import closes_loop
from jaxstab.branches.curve import BorderedVector, Curve, Place
from jaxstab.references import maugis


@pytest.mark.nightly
def test_it_goes_on_around_a_fold_and_counts_the_ways_down(branch):
    fold = branch.turns[0]
    # Where the contact-free branch ends, by the dense algebra of another test.
    np.testing.assert_allclose(fold.load.value, 1.2974855, atol=1e-7)
    assert fold.kind == "fold"
    assert branch.end == "states"
    stiffness = periodic_stiffness((32, 32), (1.0, 1.0), 1.0)
    for gap, index in zip(branch.equilibrium.gap[::5], branch.index[::5], strict=True):
        free = np.asarray(gap).ravel() > 0
        hessian = stiffness + np.diag(-10.0 * np.exp(-np.asarray(gap).ravel()))
        assert index == np.sum(on_zero_mean(hessian[np.ix_(free, free)]) < 0)
    assert set(np.asarray(branch.index)) == {0, 1}
    gap = np.asarray(fold.equilibrium.gap).ravel()
    hessian = stiffness + np.diag(-10.0 * np.exp(-gap))
    mode = np.asarray(fold.mode).ravel()
    np.testing.assert_allclose(np.linalg.norm(mode), 1)
    # The branch goes on along the mode that has lost its stiffness, at one load.
    np.testing.assert_allclose(np.sum(mode), 0, atol=1e-6)
    moved = (hessian @ mode)[gap > 0]
    np.testing.assert_allclose(moved - np.mean(moved), 0, atol=1e-6)


@pytest.mark.nightly
def test_it_goes_on_from_an_unstable_state_of_a_branch(hertz, branch):
    middle = int(np.argmax(branch.index))
    ends = jnp.stack([branch[middle].load.value, branch[middle + 2].load.value])
    rest = js.continuation(hertz, js.MeanDisplacement(ends), initial=branch[middle], fields=True)
    assert rest.index[0] == 1 and rest.end == "load"
    np.testing.assert_allclose(rest[0].equilibrium.gap, branch[middle].equilibrium.gap, atol=1e-7)
    np.testing.assert_allclose(
        rest[-1].equilibrium.gap, branch[middle + 2].equilibrium.gap, atol=1e-6
    )


@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_branch_keeps_the_turn_of_its_last_state(hertz, branch, monkeypatch):
    module = importlib.import_module("jaxstab.branches.continuation")
    count, number = itertools.count(1), int(branch.turns.state[0])

    def interrupted(_):
        if next(count) == number:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(module, "advance_to", interrupted)
    with pytest.warns(js.exceptions.PathInterrupted, match=f"after {number + 1} states"):
        found = js.continuation(hertz, js.MeanDisplacement(jnp.array([1.6, 1.0])), max_states=24)
    assert found.result == "interrupted" and len(found) == number + 1
    np.testing.assert_array_equal(found.turns.load.value, branch.turns.load.value[:1])


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_before_the_last_state_is_kept_leaves_no_end_of_it(hertz, monkeypatch):
    module = importlib.import_module("jaxstab.states.record")
    load = js.MeanDisplacement(jnp.array([1.6, 1.55]))
    whole = js.continuation(hertz, load, max_states=24)
    assert whole.end == "load"
    steps, after = itertools.count(1), module.interrupts_after

    def interrupted():
        if next(steps) == len(whole):
            signal.raise_signal(signal.SIGINT)
        return after()

    monkeypatch.setattr(module, "interrupts_after", interrupted)
    with pytest.warns(js.exceptions.PathInterrupted, match=f"after {len(whole) - 1} states"):
        found = js.continuation(hertz, load, max_states=24)
    assert found.result == "interrupted" and found.end == "states"
    np.testing.assert_array_equal(found.load.value, whole.load.value[:-1])


def test_a_branch_leaves_its_empty_entries_out(branch):
    in_room = with_room(branch)
    assert (in_room.index == 0).sum() == (branch.index == 0).sum() + 5
    assert in_room.recorded == branch
    assert jax.tree.map(lambda x: x[None], in_room)[0] == branch
    assert str(in_room) == str(branch)
    lines, expected = (js.plots.branch(x).lines for x in (in_room, branch))
    assert len(lines) == len(expected)
    plt.close("all")


def test_an_index_that_is_not_found_is_not_a_number_of_ways(hertz, branch, monkeypatch):
    assert "unknown" not in repr(branch)
    load, gap = branch[0].load, branch.equilibrium.gap[0]
    short = partial(morse_index.CurveDavidson, max_steps=2)
    monkeypatch.setattr(morse_index, "CurveDavidson", short)
    found, _ = morse_index.index_of(hertz, load, gap, morse_index.no_modes(gap))
    assert found == -1
    assert "1 of unknown index, " in repr(replace(branch, index=branch.index.at[2].set(found)))


@pytest.mark.nightly
def test_ways_down_that_the_modes_of_the_state_before_lack_are_counted():
    grid = js.Grid(4)
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=2, rms_height=0.1)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.2, 0.05))
    branch = js.continuation(contact, js.MeanGap(jnp.array([0.6, 0.02])), fields=True)
    stiffness = periodic_stiffness((4, 4), (1.0, 1.0), 1.0)
    for gap, index in zip(np.asarray(branch.equilibrium.gap), branch.index, strict=True):
        free = gap.ravel() > 0
        hessian = stiffness + np.diag(-0.2 / 0.05**2 * np.exp(-gap.ravel() / 0.05))
        assert index == np.sum(on_zero_mean(hessian[np.ix_(free, free)]) < 0)
    assert max(branch.index) >= 3


@pytest.mark.nightly
def test_a_spheres_unstable_branch_is_that_of_maugis():
    # In units of JKR: contact radius 1, displacement 0.01.
    radius, unit = 100.0, 0.01
    work = 4 / (3 * np.pi * radius**2)
    strength = 0.5 * (np.pi * work * (4 / 3) ** 2 / radius) ** (1 / 3)
    grid = js.Grid((128, 128), (6.0, 6.0))
    solid = js.FreeHalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0)
    law = js.potentials.Dugdale(work, work / strength, 0.07)
    contact = js.Contact(solid, js.surfaces.paraboloid(grid, radius), law)
    branch = js.continuation(contact, js.FarDisplacement(jnp.array([1.3, 0.2]) * unit))
    sphere = radius, 1.0, work, strength
    fold = maugis.pull_off(*sphere, stiffness=np.inf)
    np.testing.assert_allclose(branch.turns[1].load.value, -fold.displacement, rtol=5e-3)
    touch = maugis.first_touch(*sphere)
    curves = [
        maugis.without_contact(np.linspace(1e-3, 1, 500) * touch.outer_radius, *sphere),
        maugis.curve(np.linspace(1e-3, fold.contact_radius, 500), *sphere),
    ]
    displacement, force = (
        np.concatenate([getattr(c, name) for c in curves]) for name in ("displacement", "force")
    )
    index, loads = np.asarray(branch.index), -np.asarray(branch.load.value)
    unstable = np.flatnonzero(index == 1)
    assert np.all(np.diff(unstable) == 1) and set(index) == {0, 1}
    for wanted in np.array([-0.88, -0.9, -0.92, -0.94, -0.96]) * unit:
        nearest = unstable[np.argmin(np.abs(loads[unstable] - wanted))]
        exact = force[np.argmin(np.abs(displacement - loads[nearest]))]
        np.testing.assert_allclose(branch.equilibrium.force[nearest], exact, rtol=2e-2)


@pytest.mark.nightly
def test_in_single_precision_it_goes_on_where_rounding_outweighs_the_attraction():
    grid = js.Grid(16)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.05)
    law = js.potentials.Exponential(0.01, 0.1)
    double = js.Contact(js.HalfSpace(grid, 1.0), heights, law)
    single = js.Contact(double.solid, heights.astype(jnp.float32), law)
    loads = js.MeanGap([0.35, 0.05])
    found, exact = (js.continuation(contact, loads) for contact in (single, double))
    assert found.load.value.dtype == jnp.float32
    assert found.end == exact.end == "load" and len(found.load.value) == len(exact.load.value)
    pressures = [branch.equilibrium.mean_pressure for branch in (found, exact)]
    order = np.argsort(exact.load.value)
    expected = np.interp(found.load.value, exact.load.value[order], pressures[1][order])
    np.testing.assert_allclose(pressures[0], expected, rtol=2e-3, atol=1e-6)


@pytest.mark.nightly
@pytest.mark.parametrize("load", [js.MeanPressure, js.Spring])
def test_under_any_load_and_in_single_precision_it_is_the_same_curve(hertz, load):
    contact = js.Contact(hertz.solid, hertz.heights.astype(jnp.float32), hertz.potential)
    start = js.equilibrate(contact, js.MeanDisplacement(1.6))
    pressure = float(start.mean_pressure)
    if load is js.Spring:
        stiff = 20.0
        ends = [1.6 - pressure / stiff, 1.2 - 1.5 * pressure / stiff]
        loads = js.Spring(jnp.array(ends, jnp.float32), stiff)
    else:
        loads = js.MeanPressure(jnp.array([pressure, 1.5 * pressure], jnp.float32))
    branch = js.continuation(contact, loads, initial=start, max_states=12)
    assert branch.equilibrium.mean_pressure.dtype == jnp.float32
    exact = js.continuation(hertz, js.MeanDisplacement(jnp.array([1.6, 1.2])), max_states=40)
    gap, pressures = exact.equilibrium.mean_gap, exact.equilibrium.mean_pressure
    last = int(np.argmin(gap))
    found = branch.equilibrium.mean_gap
    is_before = np.asarray(found) > float(gap[last]) * 1.01
    assert np.sum(is_before) > 5
    expected = np.interp(found[is_before], gap[:last][::-1], pressures[:last][::-1])
    np.testing.assert_allclose(branch.equilibrium.mean_pressure[is_before], expected, rtol=5e-3)


@pytest.mark.nightly
def test_under_jit_it_is_the_same(hertz):
    loads = js.MeanDisplacement(jnp.array([1.6, 1.0]))
    alone = js.continuation(hertz, loads, max_states=24)
    within = jax.jit(lambda c: js.continuation(c, loads, max_states=24, throw=False))(hertz)
    np.testing.assert_allclose(within.load.value, alone.load.value, rtol=1e-8)
    np.testing.assert_array_equal(within.index, alone.index)
    np.testing.assert_allclose(within.turns.load.value[0], alone.turns.load.value[0], rtol=1e-9)


@pytest.mark.nightly
def test_a_batch_of_branches_is_the_same_and_compiled_once():
    grid = js.Grid((16,), (1.0,))
    contact = js.Contact(
        js.HalfSpace(grid, 1.0),
        js.surfaces.sinusoid(grid, 0.05),
        js.potentials.Exponential(0.01, 0.05),
    )

    def pressures(values):
        branch = js.continuation(contact, js.MeanGap(values), max_states=6, throw=False)
        return branch.equilibrium.mean_pressure

    values = jnp.array([[0.3, 0.05], [0.25, 0.05]])
    others = values + 0.01
    batch = jax.vmap(pressures)(values)
    np.testing.assert_allclose(batch[1], pressures(values[1]), rtol=1e-9)
    with compilations() as compiled:
        jax.vmap(pressures)(others)
    assert compiled == []


def test_bad_loads_are_refused(hertz):
    with pytest.raises(ValueError, match="takes two loads"):
        js.continuation(hertz, js.MeanDisplacement(1.6))
    with pytest.raises(ValueError, match="two loads that differ"):
        js.continuation(hertz, js.MeanDisplacement(jnp.array([1.6, 1.6])))
    with pytest.raises(ValueError, match="max_states"):
        js.continuation(hertz, js.MeanDisplacement(jnp.array([1.6, 1.0])), max_states=1)
    with pytest.raises(ValueError, match=r"max_step has shape \(2,\): give one number"):
        js.continuation(hertz, js.MeanDisplacement(jnp.array([1.6, 1.0])), max_step=jnp.ones(2))
    with pytest.raises(ValueError, match=r"min_step is 0.2: give at most `max_step`"):
        js.continuation(
            hertz, js.MeanDisplacement(jnp.array([1.6, 1.0])), max_step=0.1, min_step=0.2
        )


def test_a_branch_without_a_first_state_has_no_end(hertz):
    with pytest.raises(
        js.exceptions.SolverError, match=r"ended at .*\(-2\) after 1 state: infeasible_load"
    ):
        js.continuation(hertz, js.MeanDisplacement(jnp.array([-2.0, -1.0])), max_states=24)


def test_a_branch_is_a_loop_once_a_step_passes_its_start():
    law = js.potentials.Exponential(1.0, 1.0)
    contact = js.Contact(js.HalfSpace(js.Grid((2,)), 1.0), jnp.zeros(2), law)
    curve = Curve.of(contact, js.MeanGap(1.0))

    def is_loop(*points):
        *_, before, last = (BorderedVector(jnp.array(point), jnp.zeros(())) for point in points)
        tangent = BorderedVector(jnp.array([1.0, 0.0]), jnp.zeros(()))
        start = Place(
            BorderedVector(jnp.array(points[0]), jnp.zeros(())), jnp.ones(2, bool), tangent
        )
        step = SimpleNamespace(here=SimpleNamespace(at=before))
        return bool(
            closes_loop(curve, SimpleNamespace(start=start, step=step, count=len(points)), last)
        )

    # Steps along a circle of radius 0.1 around (1, 1.1), from its lowest point on.
    angles = np.radians(50) * np.arange(10)
    circle = np.stack([1 + 0.1 * np.sin(angles), 1.1 - 0.1 * np.cos(angles)], axis=1)
    closes = [is_loop(*circle[:number]) for number in range(2, 11)]
    assert closes == [False] * 7 + [True, False]
    # A step back to near the start, which has not gone around.
    assert not is_loop([1.0, 1.0], [1.1, 1.0], [1.2, 1.0], [1.3, 1.0], [1.05, 1.0])


def two_summits(number, higher, law):
    """Return a contact of two equal waves on a line, the first summit a little higher."""
    heights = 0.1 * np.cos(4 * np.pi * np.arange(number) / number)
    heights[0] += higher
    return js.Contact(js.HalfSpace(js.Grid((number,)), 1.0), heights, law)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
@pytest.mark.parametrize("higher", [0.0, 1e-12])
def test_it_records_a_bifurcation_where_a_symmetric_mode_loses_its_stiffness(higher):
    law = js.potentials.LennardJones(0.12, 0.1)
    contact = two_summits(12, higher, law)
    loads = js.MeanDisplacement(jnp.array([0.5, 0.325]))
    branch = js.continuation(contact, loads)
    assert branch.end == "load" and branch.equilibrium.gap is None
    assert branch.turns.kind.name.tolist() == ["bifurcation"]
    turn = jax.tree.map(lambda leaf: leaf[0], branch.turns)
    assert (np.asarray(branch.index) == (np.arange(len(branch)) >= turn.state)).all()
    gap, mode = turn.equilibrium.gap, turn.mode
    curvature = jax.vmap(jax.grad(jax.grad(law)))(gap)
    hessian = periodic_stiffness((12,), (1.0,), 1.0) + np.diag(curvature)
    assert abs(on_zero_mean(hessian)[0]) < 1e-6
    # Its mode moves one summit against the other: it is odd under a shift by their distance.
    np.testing.assert_allclose(hessian @ mode - np.mean(hessian @ mode), 0, atol=1e-5)
    np.testing.assert_allclose(np.roll(mode, 6), -mode, atol=1e-5)
    if higher == 0:
        limit = js.critical_load(contact, loads)
        assert limit.kind == "bifurcation"
        np.testing.assert_allclose(limit.load.value, turn.load.value, atol=1e-8)
    assert "bifurcation" in repr(branch)


def index_on(contact, gap, free):
    """Return the number of negative eigenvalues on some points, at a prescribed mean gap."""
    curvature = jax.vmap(jax.grad(jax.grad(contact.potential)))(gap)
    hessian = periodic_stiffness(gap.shape, (1.0,), 1.0) + np.diag(curvature)
    return np.sum(on_zero_mean(hessian[np.ix_(free, free)]) < 0)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_equal_points_that_detach_or_touch_together_leave_no_change_of_the_index_unlocated():
    contact = two_summits(16, 0.0, js.potentials.Exponential(0.05, 0.1))
    there = js.continuation(contact, js.MeanGap(jnp.array([0.13, 0.145])), fields=True)
    back = js.continuation(contact, js.MeanGap(jnp.array([0.145, 0.13])), initial=there[-1])
    for branch in (there, back):
        # Behind the first, where they detach, a symmetric mode gets its stiffness back.
        assert branch.turns.kind.name.tolist() == 2 * ["bifurcation"] and branch.end == "load"
        after = np.asarray(branch.turns.state) - np.flatnonzero(np.diff(branch.index))
        assert set(after) <= {0, 1}
    turn = jax.tree.map(lambda leaf: leaf[0], there.turns)
    np.testing.assert_allclose(back.turns.load.value[1], turn.load.value, rtol=1e-9)
    # Both summits have lost their reactions, and one alone would open by itself.
    gap = np.asarray(turn.equilibrium.gap)
    np.testing.assert_allclose(turn.equilibrium.reaction[jnp.array([0, 8])], 0, atol=1e-10)
    held = gap > 0
    assert set(np.flatnonzero(~held)) == {0, 8}
    assert index_on(contact, gap, held) == 0 and index_on(contact, gap, held | ~held) == 1
    np.testing.assert_allclose(np.roll(turn.mode, 8), -turn.mode, atol=1e-6)
    assert abs(turn.mode[0]) > 0.1
    limit = js.critical_load(contact, js.MeanGap(jnp.array([0.13, 0.145])))
    assert limit.kind == "bifurcation"
    np.testing.assert_allclose(limit.load.value, turn.load.value, rtol=1e-9)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
@pytest.mark.parametrize("higher", [0.0, 1e-9])
def test_of_two_nearly_equal_points_it_releases_the_first_alone(higher):
    law = js.potentials.Exponential(0.05, 0.1)
    contact = two_summits(16, higher, law)
    load = js.MeanGap(jnp.array([0.13, 0.145]))
    branch = js.continuation(contact, load, fields=True, max_states=16, throw=False)
    touching = np.asarray(branch.equilibrium.gap == 0).sum(axis=1)
    if higher == 0:
        # Equal points are released together, and the branch keeps its symmetry.
        assert set(touching) == {2, 0}
        assert branch.turns.kind.name.tolist() == ["bifurcation"]
        return
    assert branch.turns.kind.name[0] == "release"
    # At the event the first has no reaction, but the other still has one.
    event = int(np.argmax(touching == 1)) - 1
    assert touching[event] == 2
    gap = np.asarray(branch.equilibrium.gap[event])
    elastic = periodic_stiffness((16,), (1.0,), 1.0) @ (gap + np.asarray(contact.heights))
    net = elastic + np.asarray(jax.vmap(jax.grad(law))(gap))
    reaction = net - net[4]
    stays = np.asarray(branch.equilibrium.gap[event + 1, [0, 8]] == 0)
    np.testing.assert_allclose(reaction[[0, 8]][~stays], 0, atol=1e-10)
    assert 1e-10 < reaction[[0, 8]][stays][0] < 1e-6
