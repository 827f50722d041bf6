"""Progress bars, as they are written to a terminal."""

import io
import time

import jax
import jax.numpy as jnp
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


@pytest.mark.parametrize("name", ["assess_stability", "pull_off", "follow"])
def test_inside_of_transformations_no_bar_is_shown_and_a_warning_says_so(name, capsys):
    contact = rough_contact(16, js.potentials.Exponential(0.02, 0.08), rms_height=0.05)
    turns = js.MeanGap(jnp.array([0.1, 0.09]))
    call = {
        "assess_stability": lambda: js.assess_stability(
            contact, js.equilibrate(contact, turns[0], throw=False), throw=False, progress=True
        ),
        "pull_off": lambda: js.pull_off(contact, throw=False, progress=True),
        "follow": lambda: js.follow(contact, turns, throw=False, progress=True),
    }[name]
    with pytest.warns(UserWarning, match="no progress is shown") as told:
        jax.eval_shape(lambda: call().result)
    assert [warning.filename for warning in told] == [__file__]
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
