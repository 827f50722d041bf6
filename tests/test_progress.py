"""Progress bars, as they are written to a terminal."""

import jax
import jax.numpy as jnp
import pytest

from jaxstab.progress import advance, progress_bar


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
