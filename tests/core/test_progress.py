"""Progress bars, as they are written to a terminal."""

import io
import time

import jax
import jax.numpy as jnp
import pytest
from problems import rough_contact

import jaxstab as js
from jaxstab.core import progress
from jaxstab.core.progress import progress_bar


@pytest.mark.parametrize("updates", [0, 2])
def test_a_bar_that_is_not_shown_says_nothing(capsys, updates):
    with progress_bar("sweep", 3, "load", shown=False) as bar:
        bar.update(updates)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "name",
    [
        "assess_stability",
        pytest.param("pull_off", marks=pytest.mark.nightly),
        pytest.param("follow", marks=pytest.mark.nightly),
    ],
)
def test_inside_of_transformations_no_bar_is_shown(name, capsys):
    contact = rough_contact(16, js.potentials.Exponential(0.02, 0.08), rms_height=0.05)
    turns = js.MeanGap(jnp.array([0.1, 0.09]))
    call = {
        "assess_stability": lambda: js.assess_stability(
            contact, js.equilibrate(contact, turns[0], throw=False), throw=False, progress=True
        ),
        "pull_off": lambda: js.pull_off(contact, throw=False, progress=True),
        "follow": lambda: js.follow(contact, turns, throw=False, progress=True),
    }[name]
    jax.eval_shape(lambda: call().result)
    assert capsys.readouterr().err == ""


@pytest.fixture
def watched(monkeypatch):
    """Standard error as a terminal, where work of 0.05 s takes long."""
    monkeypatch.setattr(progress, "is_watched", lambda: True)
    monkeypatch.setattr(progress, "DELAY", 0.05)


@pytest.mark.usefixtures("watched")
def test_by_default_a_bar_appears_after_a_while_and_goes(capsys):
    with progress_bar("sweep", 3, "load", shown=None) as bar:
        assert capsys.readouterr().err == ""
        time.sleep(0.5)
        bar.update(2)
        assert "2/3" in capsys.readouterr().err
        with progress_bar("path", 1, "solve", shown=None) as inner:
            time.sleep(0.5)
            inner.update()
        assert capsys.readouterr().err == ""
    assert capsys.readouterr().err.split("\r")[-1].strip() == ""


@pytest.mark.usefixtures("watched")
def test_short_work_shows_no_bar(capsys):
    with progress_bar("sweep", 3, "load", shown=None) as bar:
        bar.update(3)
    assert capsys.readouterr().err == ""


def test_in_a_pipe_no_bar_appears_by_itself(monkeypatch, capsys):
    monkeypatch.setattr(progress, "DELAY", 0.05)
    with progress_bar("sweep", 3, "load", shown=None) as bar:
        time.sleep(0.3)
        bar.update(3)
    assert capsys.readouterr().err == ""


def test_a_variable_silences_bars_in_a_terminal(monkeypatch):
    terminal = type("Terminal", (io.StringIO,), {"isatty": lambda self: True})()
    monkeypatch.setattr(progress.sys, "stderr", terminal)
    assert progress.is_watched()
    monkeypatch.setenv("TQDM_DISABLE", "1")
    assert not progress.is_watched()


def test_bars_say_what_they_show(capsys):
    with progress_bar("pull-off", 3, "%", shown=True):
        pass
    with progress_bar("path", 3, "%", shown=True):
        pass
    first, *_, last = capsys.readouterr().err.strip().splitlines()
    assert "pull-off:" in first
    assert "path:" in last
