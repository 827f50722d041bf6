"""Progress bars, as they are written to a terminal."""

import inspect
import io
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact

import jaxstab as js
from jaxstab.core import progress
from jaxstab.core.progress import advance, progress_bar


def test_a_bar_says_compiling_until_its_first_step(capsys):
    with progress_bar(3, "load") as bar:
        waiting = capsys.readouterr().err
        bar.update(0)
        begun = capsys.readouterr().err
        bar.update(3)
    assert waiting.split("\r")[-1].startswith("compiling:   0%") and "0/3" in waiting
    assert begun.split("\r")[-1].startswith("  0%")
    after = capsys.readouterr().err
    assert "compiling" not in after and "3/3" in after


def test_compiled_code_ends_the_wait_as_well(capsys):
    def double(x):
        advance(x)
        return 2 * x

    with progress_bar(2, "step", done=1):
        jax.block_until_ready(jax.jit(double)(jnp.ones(2)))
    said = capsys.readouterr().err
    assert said.split("\r")[1].startswith("compiling:  50%")
    assert "compiling" not in said.split("\r")[-1] and "2/2" in said


@pytest.mark.parametrize("updates", [0, 2])
def test_a_bar_that_is_not_shown_says_nothing(capsys, updates):
    with progress_bar(3, "load", shown=False) as bar:
        bar.update(updates)
    assert capsys.readouterr().err == ""


CONTACT = rough_contact(16, js.potentials.Exponential(0.02, 0.08), rms_height=0.05)
STATE = js.equilibrate(CONTACT, js.MeanGap(0.1))
WAITS = {
    "pull_off": lambda **options: js.pull_off(CONTACT, **options),
    "assess_stability": lambda **options: js.assess_stability(CONTACT, STATE, **options),
    "critical_load": lambda **options: js.critical_load(
        CONTACT, js.MeanPressure(jnp.array([0.0, -0.2])), **options
    ),
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", WAITS)
def test_what_takes_long_shows_that_it_goes_on_and_finds_the_same(name, capsys):
    silent = WAITS[name](throw=False)
    assert capsys.readouterr().err == ""
    shown = WAITS[name](throw=False, progress=True)
    said = capsys.readouterr().err
    assert "compiling:   0%" in said and said.split("\r")[-1].startswith("100%")
    for one, other in zip(jax.tree.leaves(silent), jax.tree.leaves(shown), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", WAITS)
def test_inside_of_transformations_no_bar_is_shown_and_a_warning_says_so(name, capsys):
    with pytest.warns(UserWarning, match="no progress is shown") as told:
        jax.eval_shape(lambda: WAITS[name](throw=False, progress=True).result)
    assert [warning.filename for warning in told] == [__file__]
    assert capsys.readouterr().err == ""


def test_a_path_inside_of_transformations_says_that_it_shows_no_progress(capsys):
    turns = js.MeanGap(jnp.array([0.1, 0.09]))
    with pytest.warns(UserWarning, match="no progress is shown"):
        jax.eval_shape(lambda: js.follow(CONTACT, turns, progress=True, throw=False).result)
    assert capsys.readouterr().err == ""


@pytest.fixture
def watched(monkeypatch):
    """Standard error as a terminal, where work of 0.05 s takes long."""
    monkeypatch.setattr(progress, "is_watched", lambda: True)
    monkeypatch.setattr(progress, "_DELAY", 0.05)


@pytest.mark.usefixtures("watched")
def test_by_default_a_bar_appears_after_a_while_before_any_step_and_goes(capsys):
    with progress_bar(3, "load", shown=None) as bar:
        assert capsys.readouterr().err == ""
        time.sleep(0.5)
        assert capsys.readouterr().err.strip().startswith("compiling:   0%")
        with progress_bar(1, "solve", shown=None) as inner:
            inner.update()
            time.sleep(0.5)
        assert capsys.readouterr().err == ""
        bar.update(3)
    assert capsys.readouterr().err.split("\r")[-1].strip() == ""


@pytest.mark.usefixtures("watched")
def test_short_work_shows_no_bar(capsys):
    with progress_bar(3, "load", shown=None) as bar:
        bar.update(3)
    assert capsys.readouterr().err == ""


def test_in_a_pipe_no_bar_appears_by_itself(monkeypatch, capsys):
    monkeypatch.setattr(progress, "_DELAY", 0.05)
    with progress_bar(3, "load", shown=None) as bar:
        time.sleep(0.3)
        bar.update(3)
    assert capsys.readouterr().err == ""


def test_a_variable_silences_bars_in_a_terminal(monkeypatch):
    terminal = type("Terminal", (io.StringIO,), {"isatty": lambda self: True})()
    monkeypatch.setattr(progress.sys, "stderr", terminal)
    assert progress.is_watched()
    monkeypatch.setenv("TQDM_DISABLE", "1")
    assert not progress.is_watched()


@pytest.mark.usefixtures("watched")
def test_a_first_solve_says_that_it_compiles(capsys):
    contact = rough_contact(12, js.potentials.Exponential(0.02, 0.08), rms_height=0.05)
    js.equilibrate(contact, js.MeanGap(0.1))
    assert "compiling:   0%" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name",
    [
        "follow",
        "pull_off",
        "critical_load",
        "assess_stability",
        "sweep",
        "calibrate",
        "continuation",
    ],
)
def test_functions_that_take_long_show_a_bar_by_default(name):
    assert inspect.signature(getattr(js, name)).parameters["progress"].default is None
