"""Following a load: batches, interrupts, the entries of a path, failures, refusals and print."""

import re
import signal
import sys
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import with_room

import jaxstab as js
from jaxstab.core.interrupts import interrupts_held
from jaxstab.loading import recorded_path
from jaxstab.states.point import PathPoint
from jaxstab.states.record import RecordList


@pytest.mark.nightly
def test_entries_of_a_batch_are_those_alone(hertz):
    turns = jnp.array([1.6, 1.2])

    def follow(load):
        return js.follow(hertz, js.MeanDisplacement(load), max_states=64, max_jumps=4, throw=False)

    together = jax.jit(jax.vmap(follow))(jnp.stack([turns, turns + 0.05]))
    for i, shift in enumerate((0.0, 0.05)):
        alone = follow(turns + shift)
        number = len(alone.load.value)
        assert (together.load.value[i][:number] == alone.load.value).all()
        assert jnp.isnan(together.load.value[i][number:]).all()
        assert together.jumps.load.value[i][0] == alone.jumps.load.value[0]
        assert len(together[i]) == number
        assert len(together[i].jumps) == len(alone.jumps)


@pytest.mark.nightly
def test_a_path_leaves_its_empty_entries_out(loop, hertz, tmp_path):
    path = with_room(loop)
    assert len(path) == len(loop) + 5
    assert (path.jumps.kind == "fold").sum() > (loop.jumps.kind == "fold").sum()
    assert path.recorded == loop
    assert loop.recorded == loop
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), path)
    assert batch.recorded == batch
    assert batch[1] == loop
    assert len(batch[:1]) == 1
    assert str(path) == str(loop)
    drawn = js.plots.path(path).get_legend_handles_labels()[1]
    assert drawn == js.plots.path(loop).get_legend_handles_labels()[1]
    assert "pulled off" not in drawn
    assert js.load(js.save(tmp_path / "path.nc", hertz, path))[1] == loop
    assert len(js.observe(hertz, path, js.patches)) == len(loop)
    # In a trace the number of states is not known.
    assert jax.eval_shape(lambda path: path.recorded, path).load.value.shape == (len(path),)


@pytest.fixture
def interrupted(interruptible, monkeypatch):
    """Interrupt a path at its seventh step."""
    module = sys.modules["jaxstab.loading.load_stepping"]
    apply_step = module.apply_step
    calls = []

    def interrupted(*arguments):
        calls.append(None)
        if len(calls) == 7:
            signal.raise_signal(signal.SIGINT)
        return apply_step(*arguments)

    monkeypatch.setattr(module, "apply_step", interrupted)


@pytest.mark.usefixtures("interrupted")
def test_a_path_shared_with_other_processes_returns_no_part(hertz, loop, monkeypatch):
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    with pytest.raises(KeyboardInterrupt):
        js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6])), smallest_jump=1e-5)


@pytest.mark.usefixtures("interrupted")
def test_an_interrupted_path_returns_what_is_done(hertz, loop):
    with pytest.warns(js.exceptions.PathInterrupted, match=r"interrupted at \d+ %"):
        turns = js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6]))
        path = js.follow(hertz, turns, smallest_jump=1e-5, fields=True)
    assert path.result == "interrupted"
    # Six steps, of which some only try.
    assert 2 <= len(path.load.value) <= 7
    np.testing.assert_array_equal(path.load.value, loop.load.value[: len(path.load.value)])
    # Its last state is a start of the rest of the way.
    last = path[-1]
    np.testing.assert_allclose(jnp.mean(last.equilibrium.gap), last.equilibrium.mean_gap)
    turns = js.MeanDisplacement(jnp.array([last.load.value, 1.2, 1.6]))
    rest = js.follow(hertz, turns, smallest_jump=1e-5, initial=last, fields=True)
    np.testing.assert_allclose(rest.jumps.load.value[0], loop.jumps.load.value[0], atol=4e-6)


@pytest.mark.nightly
@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_at_any_line_leaves_whole_records(tmp_path):
    """At each line that records a jump, states, gaps, jumps and losses agree with each other."""
    grid = js.Grid((16,), (1.0,))
    x = grid.coordinates[0]
    heights = 0.1 * jnp.cos(2 * jnp.pi * x) + 0.02 * jnp.cos(6 * jnp.pi * x + 1)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.1, 0.1))
    turns = js.MeanGap(jnp.array([0.4, 0.01, 0.4]))
    whole = js.follow(contact, turns, fields=True)
    first = int(whole.jumps.state[0])
    code, lines = RecordList.append.__code__, []
    # That of a measurement of coverage, if there is one.
    tracer = sys.gettrace()

    def interrupted_at(number):
        """Return a tracer that interrupts at a line, counted from the one at a jump."""
        left = [number]

        def trace(frame, event, _):
            if frame.f_code is code and event == "line":
                is_jump = bool(frame.f_locals["record"].is_event)
                if is_jump and left[0] >= 0:
                    lines.append(frame.f_lineno)
                    if left[0] == 0:
                        signal.raise_signal(signal.SIGINT)
                    left[0] -= 1
            return trace

        return trace

    for number in range(100):
        seen = set(lines)
        sys.settrace(interrupted_at(number))
        try:
            with pytest.warns(js.exceptions.PathInterrupted):
                path = js.follow(contact, turns, fields=True)
        finally:
            sys.settrace(tracer)
        states, jumps = len(path.load.value), len(path.jumps.state)
        assert path.result == "interrupted"
        assert path.equilibrium.gap.shape[0] == states
        assert jumps in (0, 1) and states == first + 1 + jumps
        np.testing.assert_allclose(path.dissipation, np.sum(path.jumps.dissipation))
        js.save(tmp_path / f"{number}.nc", contact, path)
        if set(lines) == seen:
            break
    assert number > 5
    assert jumps == 1


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_after_the_last_step_loses_nothing(hertz, loop, monkeypatch):
    module = sys.modules["jaxstab.loading.follow"]
    path_of = module.path_of

    def interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        return path_of(*arguments)

    monkeypatch.setattr(module, "path_of", interrupted)
    with pytest.warns(js.exceptions.PathInterrupted, match="after its last step; it is complete"):
        turns = js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6]))
        path = js.follow(hertz, turns, smallest_jump=1e-5, fields=True)
    assert path.result == "successful"
    np.testing.assert_array_equal(path.jumps.load.value, loop.jumps.load.value)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("interruptible")
def test_a_second_interrupt_acts():
    with pytest.raises(KeyboardInterrupt), interrupts_held():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)


def test_states_of_a_path_are_entries_of_a_sequence(hertz, loop):
    assert len(loop) == len(loop.load.value)
    assert loop[3].load.value == loop.load.value[3]
    assert loop[-2].equilibrium.mean_pressure == loop.equilibrium.mean_pressure[-2]
    assert len(loop[2:5]) == 3 and len([*loop]) == len(loop)
    with pytest.raises(IndexError):
        loop[len(loop)]
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, 2 * leaf]), loop)
    assert len(batch) == 2 and len(batch[-1]) == len(loop)
    np.testing.assert_array_equal(batch[1][3].equilibrium.gap, 2 * loop[3].equilibrium.gap)
    with pytest.raises(IndexError):
        batch[2]
    bare = eqx.tree_at(lambda path: path.equilibrium.gap, loop, None)
    assert bare[np.int64(-1)].equilibrium.gap is loop.last_gap
    with pytest.raises(ValueError, match=r"without its gap: start from path\[-1\]"):
        js.equilibrate(hertz, loop[3].load, initial=bare[3])
    with pytest.raises(ValueError, match=r"is a stack .* path\[-1\]"):
        js.equilibrate(hertz, loop[3].load, initial=loop[2:5])
    held = js.equilibrate(hertz, loop[-1].load, initial=loop[-1])
    np.testing.assert_allclose(held.gap, loop.last_gap, atol=1e-8)
    pressure = loop[-1].equilibrium.mean_pressure
    np.testing.assert_allclose(held.mean_pressure, pressure, rtol=1e-6)


def test_what_energies_lose_between_jumps_is_the_work_that_is_missing(loop):
    # States of the force 3 v^2 - v, whose work is v^3 - v^2 / 2.
    values = jnp.array([0.0, 0.1, 0.3, 0.4, 0.7, 1.0])
    changes = jnp.array([0.0, 0.0, 0.0, 0.25, 0.25, 0.25])
    points = PathPoint(*10 * [jnp.zeros(6)])
    force, potential = 3 * values**2 - values, values**3 - values**2 / 2 + changes
    points = replace(points, value=values, force=force, potential=potential)
    # In the first and the last step there is one parabola, which is compared with a trapezoid.
    lost = recorded_path.unlocated_loss(points, jnp.ones(5, bool))
    np.testing.assert_allclose(lost, [-0.25, (0.1**3 + 0.3**3) / 2], rtol=1e-12)
    # Where there is a jump it does not count.
    lost = recorded_path.unlocated_loss(points, jnp.arange(5) != 2)
    np.testing.assert_allclose(lost, [0, (0.1**3 + 0.2**3 + 2 * 0.3**3) / 2], atol=1e-14)
    # Two states a rounding apart, whose forces differ by theirs, count as one.
    near = [0, 1, 2, 3, 3, 4, 5]
    twice = jax.tree.map(lambda leaf: leaf[jnp.array(near)], points)
    twice = replace(
        twice,
        value=twice.value.at[4].set(jnp.nextafter(twice.value[3], 1.0)),
        force=twice.force.at[4].add(1e-12),
    )
    lost = recorded_path.unlocated_loss(twice, jnp.array([True, True, False, True, True, True]))
    np.testing.assert_allclose(lost[0], 0, atol=1e-11)
    assert lost[1] <= (0.1**3 + 0.2**3 + 4 * 0.3**3) / 2
    failed = eqx.tree_at(lambda path: path.unlocated, loop, jnp.array(-1.0))
    assert "lost between jumps, which cannot be" in repr(failed)


@pytest.mark.nightly
def test_no_step_is_as_short_as_rounding():
    """Also where steps that add up to a part of the load path end a rounding before it."""
    grid = js.Grid((16,), (1.0,))
    heights = 0.1 * jnp.cos(2 * jnp.pi * grid.coordinates[0])
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.05, 0.1))
    for lowest in (0.4, 0.42):
        path = js.follow(contact, js.MeanGap(jnp.array([0.6, lowest, 0.6])))
        steps = np.abs(np.diff(path.load.value))
        assert steps.min() > 1e-9
    # The loss under a spring is that of both, and says so.
    assert re.search(r"lost in \d+ jumps?  ", repr(path))
    pulled = js.follow(contact, js.Spring(jnp.array([0.2, 0.5]), 1.0))
    assert re.search(r"lost in \d+ jumps?, by contact and spring together  ", repr(pulled))


@pytest.mark.nightly
def test_a_batch_entry_without_a_state_has_no_loss(hertz):
    def losses(height, modulus):
        heights = hertz.heights.at[0, 0].add(height)
        contact = js.Contact(js.HalfSpace(hertz.grid, modulus), heights, hertz.potential)
        load = js.MeanDisplacement(jnp.array([2.0, 1.9]))
        path = js.follow(contact, load, max_states=40, max_jumps=1, throw=False)
        return path.dissipation, path.unlocated

    heights, moduli = jnp.array([0.0, jnp.nan, 0.0]), jnp.array([1.0, 1.0, -1.0])
    for loss in jax.vmap(losses)(heights, moduli):
        np.testing.assert_array_equal(np.isnan(loss), [False, True, True])


class Reaching(eqx.Module):
    """A law with a core, which is zero beyond its reach."""

    reach: jax.Array

    def __call__(self, gap):
        core = 0.05 / gap
        return jnp.where(gap < self.reach, 0.002 * (0.5 * core**9 - 1.5 * core**3), 0.0)


@pytest.mark.nightly
def test_a_gain_of_energy_that_no_load_supplies_ends_as_failed():
    grid = js.Grid(8)
    heights = js.surfaces.self_affine(grid, jax.random.key(3), k_high=2, rms_height=0.05)
    smooth = js.Contact(js.HalfSpace(grid, 1.0), heights, Reaching(jnp.array(jnp.inf)))
    turns = js.MeanGap([0.25, 0.2, 0.25])
    assert js.follow(smooth, turns).result == "successful"
    # Without its check: a value that jumps by 2e-4.
    jumping = eqx.tree_at(lambda contact: contact.potential.reach, smooth, jnp.array(0.12, float))
    with pytest.raises(js.exceptions.SolverError, match=r"unbalanced_work.*CutOff") as told:
        js.follow(jumping, turns)
    path = told.value.found
    assert path.unlocated < -path.unlocated_error
    assert "lost between jumps, which cannot be" in repr(path)


@pytest.mark.nightly
def test_the_rounding_of_a_window_in_single_precision_is_no_gain():
    grid = js.Grid(64, (30.0, 30.0))
    heights = js.surfaces.paraboloid(grid, radius=20.0).astype("float32")
    law = js.potentials.Exponential(0.05, 0.7)
    contact = js.Contact(js.FreeHalfSpace(grid, 1.0), heights, law)
    path = js.follow(contact, js.FarDisplacement([3.0, -1.0, 3.0]))
    assert path.result == "successful" and len(path.jumps.state) == 0
    # The rounding of the work is larger than that of the potential alone.
    assert abs(path.unlocated) < 1e-3 * abs(path.equilibrium.energy).max()


@pytest.mark.nightly
def test_a_load_that_rounding_reaches_a_step_too_early_is_passed():
    grid = js.Grid((16,))
    heights = js.surfaces.sinusoid(grid, 0.05)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.01, 0.2))
    # As far from each other as the longest step.
    turns = js.MeanGap(jnp.linspace(0.44, 0.54, 33))
    path = jax.jit(lambda load: js.follow(contact, load, max_states=256, throw=False))(turns)
    assert path.result == "successful"
    assert jnp.isin(turns.value, path.load.value).all()


def test_what_cannot_be_followed_is_told(hertz):
    with pytest.raises(ValueError, match="takes the turning points of a load, two or more"):
        js.follow(hertz, js.MeanDisplacement(1.3))
    with pytest.raises(
        js.exceptions.SolverError, match=r"MeanDispl\S+\(\S+\) after \d+ states"
    ) as told:
        js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, 1.4, -1.0])), fields=True)
    assert len(told.value.found.load.value) > 8
    with pytest.raises(ValueError, match=r"The load is nan at \(\d,\): give finite numbers"):
        js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, jnp.nan])))
    with pytest.raises(ValueError, match="must belong to one machine"):
        js.follow(hertz, js.Spring(jnp.array([1.6, 1.2]), jnp.array([1.0, 2.0])))
    with pytest.raises(ValueError, match="must belong to one machine"):
        js.critical_load(hertz, js.Spring(jnp.array([1.6, 1.2]), jnp.array([1.0, 2.0])))
    with pytest.raises(ValueError, match=r"The load is \[1.6 1.3 1.3\]: a turning point repeats"):
        js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, 1.3, 1.3])))
    with pytest.raises(ValueError, match="max_states is 1: a path has two states"):
        js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, 1.2])), max_states=1)
    with pytest.raises(ValueError, match=r"disturbance is -1\.0"):
        js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, 1.2])), disturbance=-1.0)
    with pytest.raises(ValueError, match=r"The disturbance has shape \(2,\): give one number"):
        js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, 1.2])), disturbance=jnp.ones(2))
    with pytest.raises(ValueError, match=r"smallest_jump has shape \(2,\): give one number"):
        js.follow(hertz, js.MeanDisplacement(jnp.array([1.6, 1.2])), smallest_jump=jnp.ones(2))


@pytest.mark.nightly
def test_under_jit_a_path_has_room_for_so_many_states_and_elsewhere_for_any_number(hertz):
    turns = js.MeanDisplacement(jnp.array([1.6, 1.2]))
    short = jax.jit(lambda load: js.follow(hertz, load, max_states=8, throw=False))
    assert short(turns).result == "store_full" and short(turns).load.value.shape == (8,)
    assert len(js.follow(hertz, turns, max_states=8, max_jumps=1).load.value) > 8
    endless = js.MeanDisplacement(jnp.array([1.6, jnp.nan]))
    assert short(endless).result == "infeasible_load"


def test_a_path_prints_what_it_is_and_its_jumps(loop):
    first, work, _, header, _, *rows = repr(loop).splitlines()
    assert first.startswith("Path: MeanDisplacement 1.6 to 1.6 in ") and "successful" in first
    assert float(work.split()[-1]) == pytest.approx(float(loop.work), rel=1e-5)
    assert header.split()[:3] == ["MeanDisplacement", "kind", "dissipation"]
    assert [row.split()[1] for row in rows] == list(loop.jumps.kind.name)
    assert float(rows[0].split()[0]) == pytest.approx(float(loop.jumps.load.value[0]), rel=1e-7)
    assert repr(loop.jumps[0]).startswith("Jump")
    traced = []
    jax.eval_shape(lambda path: traced.append(repr(path)), loop)
    assert traced[0].startswith("Path")
