"""Results as Python values: enumerations, stacks of states, and their printed form."""

import copy
import operator
import pickle
import pydoc
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.core.results import throw_failure

NUM_LOADS = 4


@pytest.fixture(scope="module")
def contact():
    grid = js.Grid((8, 6), (2.0, 3.0))
    heights = js.surfaces.sinusoid(grid, 0.25)
    return js.Contact(js.HalfSpace(grid, 12.5), heights, js.potentials.Exponential(0.0625, 0.5))


@pytest.fixture(scope="module")
def sweep(contact):
    """A sweep whose numbers are all 0 in its first state, 1 in its second, and so on."""
    loads = js.MeanGap(jnp.ones(NUM_LOADS))
    shapes = jax.eval_shape(lambda load: js.sweep(contact, load), loads)

    def counted(leaf):
        numbers = np.arange(NUM_LOADS).reshape(-1, *[1] * (leaf.ndim - 1))
        return jnp.asarray(np.broadcast_to(numbers, leaf.shape).astype(leaf.dtype))

    return jax.tree.map(counted, shapes)


@pytest.fixture(scope="module")
def verdicts():
    def judged(number):
        signed = js.VERDICTS.where(number < 0, js.VERDICTS.unstable, js.VERDICTS.undecided)
        return js.VERDICTS.where(number > 0, js.VERDICTS.stable, signed)

    return jax.jit(jax.vmap(judged))(jnp.array([1.0, -1.0, 0.0, 2.0]))


def test_a_verdict_compares_with_members_and_with_names():
    verdict = js.VERDICTS.stable
    for same in ("stable", np.str_("stable"), js.VERDICTS.stable):
        assert operator.eq(verdict, same) and operator.eq(same, verdict)
        assert not operator.ne(verdict, same)
    for other in ("unstable", js.VERDICTS.unstable):
        assert operator.ne(verdict, other) and operator.ne(other, verdict)
        assert not operator.eq(verdict, other)


def test_arrays_of_verdicts_compare_entry_by_entry_also_under_jit(verdicts):
    for other in ("stable", js.VERDICTS.stable):
        compare = partial(lambda other, items: (items == other, items != other), other)
        for equal, unequal in (compare(verdicts), jax.jit(compare)(verdicts)):
            assert equal.tolist() == [True, False, False, True]
            assert unequal.tolist() == [False, True, True, False]
    assert (verdicts == verdicts).all()


def test_a_name_that_no_verdict_has_is_refused(verdicts):
    for verdict in (verdicts, js.VERDICTS.stable):
        for compare in (operator.eq, operator.ne):
            with pytest.raises(ValueError, match=r"'stabel'.*stable, held_by_contact, unstable"):
                compare(verdict, "stabel")
    with pytest.raises(TypeError, match="neither a member of VERDICTS nor a name"):
        operator.eq(verdicts, js.RESULTS.successful)


def test_verdicts_are_never_none_and_are_padded_as_words(verdicts):
    assert not operator.eq(js.VERDICTS.stable, None) and operator.ne(js.VERDICTS.stable, None)
    assert operator.eq(verdicts, None).tolist() == [False] * 4
    assert f"{js.VERDICTS.stable:>10}|{js.VERDICTS.unstable}" == "    stable|unstable"


def test_verdicts_give_their_names_and_texts(verdicts):
    names = ["stable", "unstable", "undecided", "stable"]
    assert type(js.VERDICTS.stable.name) is str
    assert verdicts.name.tolist() == names
    assert js.VERDICTS[js.VERDICTS.stable].startswith("stable: every small admissible")
    assert [text.split(":")[0] for text in js.VERDICTS[verdicts]] == names
    assert str(verdicts) == "[stable unstable undecided stable]"
    assert str(js.VERDICTS.stable) == repr(js.VERDICTS.stable) == "stable"


def test_an_enumeration_is_the_collection_of_its_members(verdicts):
    names = ["stable", "held_by_contact", "unstable", "undecided"]
    assert js.VERDICTS.names.tolist() == names
    assert [member.name for member in js.VERDICTS] == names and len(js.VERDICTS) == 4
    assert js.VERDICTS.unstable in js.VERDICTS and "unstable" in js.VERDICTS
    for other in (js.RESULTS.successful, "successful", "stabel", 0, None):
        assert other not in js.VERDICTS
    for members in (js.RESULTS, js.results.KINDS):
        assert [member.name for member in members] == list(members.names)
        assert all(members[member].startswith(f"{member}: ") for member in members)
    text = pydoc.plain(pydoc.render_doc(js.VERDICTS))
    assert "held_by_contact: a strict local minimum" in text


def test_members_are_keys_that_equal_their_names():
    colours = {"stable": "blue", js.VERDICTS.unstable: "red"}
    assert colours[js.VERDICTS.stable] == "blue" and colours["unstable"] == "red"


def test_members_are_copied_and_stored(verdicts):
    for item in (verdicts, js.VERDICTS.unstable):
        for twin in (copy.deepcopy(item), pickle.loads(pickle.dumps(item))):
            assert isinstance(twin, js.VERDICTS)
            assert (twin == item).all()


def test_arrays_of_verdicts_are_sequences(verdicts):
    assert len(verdicts) == 4
    assert verdicts[1] == "unstable" and verdicts[-1] == "stable"
    assert [verdict.name for verdict in verdicts[1:3]] == ["unstable", "undecided"]
    assert verdicts[np.asarray(verdicts == "stable")].name.tolist() == ["stable", "stable"]


def numbers_of(state):
    """Return every number that a state holds, as a set."""
    return {float(number) for leaf in jax.tree.leaves(state) for number in np.ravel(leaf)}


@pytest.mark.nightly
def test_an_index_chooses_a_state(sweep, contact):
    for index, number in ((3, 3), (0, 0), (-1, 3), (np.int64(2), 2), (jnp.array(1), 1)):
        state = sweep[index]
        assert numbers_of(state) == {bool(number), number}
        assert state.equilibrium.gap.shape == contact.grid.shape
        assert state.load.value.shape == ()
    assert jax.tree.structure(sweep[3]) == jax.tree.structure(sweep)


def test_slices_masks_and_lists_choose_several_states(sweep):
    mask = np.array([True, False, False, True])
    chosen = {(1, 2): slice(1, 3), (0, 3): mask, (2, 0): [2, 0], (3,): jnp.array([3])}
    for numbers, index in chosen.items():
        np.testing.assert_array_equal(sweep[index].load.value, numbers)
        np.testing.assert_array_equal(sweep[index].equilibrium.gap[:, 0, 0], numbers)
    for nothing in ([], slice(0), np.zeros(NUM_LOADS, bool)):
        assert len(sweep[nothing]) == 0 and len(repr(sweep[nothing]).splitlines()) == 2


def test_a_sweep_is_a_sequence_of_its_states(sweep):
    assert len(sweep) == NUM_LOADS
    assert [float(state.load.value) for state in sweep] == [0, 1, 2, 3]
    assert len(sweep.stability.critical) == len(sweep.equilibrium) == NUM_LOADS
    for index in (NUM_LOADS, -NUM_LOADS - 1, [0, NUM_LOADS], np.ones(3, bool)):
        with pytest.raises(IndexError):
            sweep[index]


def test_a_single_state_has_nothing_to_choose(sweep):
    for choose in (lambda: sweep[3][0], lambda: len(sweep[3]), lambda: list(sweep[3])):
        with pytest.raises(TypeError, match="single Sweep"):
            choose()
    with pytest.raises(TypeError, match="single VERDICTS"):
        js.VERDICTS.stable[0]


def test_states_are_chosen_under_jit_and_vmap(sweep):
    def gap(sweep, index):
        return sweep[index].equilibrium.gap[0, 0], sweep[1:3].load.value

    found, between = jax.jit(gap)(sweep, 2)
    assert found == 2 and between.tolist() == [1, 2]
    pairs = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), sweep)
    assert jax.vmap(lambda sweep: sweep[3].load.value)(pairs).tolist() == [3, 3]
    assert pairs[1, 2].load.value == 2 and len(pairs[0]) == NUM_LOADS


def test_what_takes_one_state_says_how_to_choose_it(sweep, contact):
    state, cone = sweep[3], sweep.stability.cone
    refusals = [
        lambda: js.plots.gap(contact, sweep.equilibrium),
        lambda: js.plots.pressure(contact, sweep),
        lambda: js.plots.contact_map(contact, sweep.equilibrium),
        lambda: js.plots.mode(contact, cone),
        lambda: js.plots.mode_cut(contact, cone),
        lambda: js.plots.mode_cut(contact, cone[3], sweep.equilibrium),
        lambda: js.plots.convergence(cone),
        lambda: js.assess_stability(contact, sweep.equilibrium),
        lambda: js.relax_along(contact, sweep, state.stability.cone.mode),
        lambda: js.lowest_modes(contact, sweep.equilibrium, 1),
    ]
    for refused in refusals:
        with pytest.raises(ValueError, match=r"shape \(4,\): choose one: sweep\[3\]"):
            refused()
    for single in (state, state.equilibrium):
        with pytest.raises(ValueError, match="no sweep over one axis"):
            js.plots.stability_curve(single)
    with pytest.raises(TypeError, match="Contact is not a state"):
        js.plots.gap(contact, contact)


def test_a_state_of_another_precision_is_refused(sweep, contact):
    single = js.Contact(contact.solid, contact.heights.astype("float32"), contact.potential)
    state = js.equilibrate(single, js.MeanGap(0.5), initial=sweep[3])
    for refused in (
        lambda: js.assess_stability(contact, state),
        lambda: js.lowest_modes(contact, state, 1),
        lambda: js.relax_along(single, sweep[3], sweep[3].stability.cone.mode),
    ):
        with pytest.raises(ValueError, match=r"float(32|64).*in float(64|32): .* or start from it"):
            refused()


def test_states_print_numbers_shapes_and_words(sweep):
    equilibrium = replace(sweep[1].equilibrium, mean_pressure=jnp.array(-0.123456789))
    rows = dict(line.split(maxsplit=1) for line in repr(equilibrium).splitlines()[1:])
    assert rows["mean_pressure"] == "-0.123457"
    assert rows["load"] == "MeanGap(value=1)"
    assert rows["gap"] == "f64[8,6]"
    assert rows["in_contact"] == "bool[8,6]"
    assert rows["result"] == "max_steps_reached"
    lines = repr(equilibrium).splitlines()[1:]
    assert len({len(line) - len(rows[line.split()[0]]) for line in lines}) == 1

    stability = repr(sweep[1].stability)
    assert "Eigenpair(eigenvalue=1, " in stability and "Barrier(height=1, " in stability
    assert "verdict          held_by_contact" in stability
    assert "[stable held_by_contact unstable undecided]" in repr(sweep.stability)
    assert repr(sweep[1].stability.cone.history) == "History(residual)"


def test_a_sweep_prints_as_a_table(sweep):
    header, rule, *rows = repr(sweep).splitlines()
    assert header.split("  ")[-1].strip() == "solvers" and set(rule) == {"-"}
    assert len(rows) == NUM_LOADS and {len(row) for row in rows} == {len(header)}
    cells = rows[2].split()
    assert cells[:4] == ["2", "+2.0000e+00", "200.00", "%"]
    assert "unstable" in cells and cells[-1] == "stagnated"
    assert len(repr(sweep[2]).splitlines()) == 3


def test_nothing_that_is_printed_raises_or_reads_what_is_traced(sweep, contact):
    shown = []

    @jax.jit
    def show(*arguments):
        shown.extend(repr(part) for part in arguments)
        return arguments

    parts = [sweep, sweep.equilibrium, sweep.stability, sweep.stability.cone.history, contact]
    show(*parts, sweep.stability.verdict, sweep.load)
    assert "load" in shown[0] and "f64[4]" in shown[0]
    assert "f64[4,8,6]" in shown[1]
    assert shown[3] == "History(residual)"
    assert shown[5] == "VERDICTS(i32[4])"
    assert shown[6] == "MeanGap(value=f64[4])"

    for spoil in (lambda leaf: None, lambda leaf: object(), lambda leaf: leaf * 1.5, np.shape):
        for part in parts:
            assert repr(jax.tree.map(spoil, part))
    deleted = jax.tree.map(jnp.copy, sweep)
    jax.tree.map(lambda leaf: leaf.delete(), deleted)
    assert repr(deleted) and repr(deleted.stability.verdict)


def test_the_last_of_several_results_raises_and_an_interrupted_one_does_not():
    good, bad, cut = js.RESULTS.successful, js.RESULTS.stagnated, js.RESULTS.interrupted

    def thrown(*results):
        codes = js.RESULTS(jnp.stack([result.code for result in results]))
        return throw_failure(codes, len(results), lambda: "It ended")

    assert thrown(bad, good) == thrown(good, cut) == 2
    with pytest.raises(js.exceptions.SolverError, match="It ended: stagnated") as error:
        thrown(good, good, bad)
    assert error.value.found == 3


def test_enumerations_are_sequences_of_their_members():
    for kind in (js.VERDICTS, js.results.KINDS, js.results.ENDS, js.RESULTS):
        members = list(kind)
        assert len(members) == len(kind) == len(set(map(str, members)))
        assert all(member in kind and str(member) in kind for member in members)
        assert "no such name" not in kind and 0 not in kind
    assert js.VERDICTS.stable in js.VERDICTS and js.VERDICTS.stable not in js.results.KINDS


def test_a_single_result_is_true_and_none_of_several_is_not(hertz):
    load = js.MeanDisplacement(1.6)
    assert load and js.VERDICTS.stable and (load or None) is load
    state = js.equilibrate(hertz, load)
    assert state
    several = js.sweep(hertz, js.MeanDisplacement(np.array([1.6, 1.7])), stability=False)
    assert several and several[0] and not several[:0]


def test_a_number_is_shown_while_its_derivative_is_computed():
    shown = []

    def squared(pressure):
        shown.append(str(js.MeanPressure(pressure)))
        return pressure**2

    jax.grad(squared)(-1.5)
    jax.hessian(squared)(-1.5)
    jax.jvp(squared, (-1.5,), (1.0,))
    load = js.MeanPressure(-1.5)
    jax.jit(lambda: shown.append(str(load)))()
    assert shown == 4 * ["MeanPressure(value=-1.5)"]
