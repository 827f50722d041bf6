"""Studies in batches, and from the command line."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from logged_study import SCRIPT, runs

import jaxstab as js
from jaxstab.__main__ import main


def test_a_batch_is_what_its_cases_are_alone(tmp_path):
    def case(seed, energy):
        draw = jax.random.normal(jax.random.key(seed), (4,))
        word = js.VERDICTS.where(draw.sum() > 0, "stable", "unstable")
        return {"field": energy * draw, "verdict": word}

    axes = {"seed": range(5), "energy": [1.0, 2.0]}
    alone = js.study(case, axes, tmp_path / "alone")
    # Of which 4 do not divide the 10 cases.
    together = js.study(case, axes, tmp_path / "together", batch=4)
    assert set(alone["verdict"].values.ravel()) == {"stable", "unstable"}
    np.testing.assert_array_equal(alone["verdict"], together["verdict"])
    np.testing.assert_allclose(alone["field"], together["field"], rtol=1e-14)
    assert len(set(together["seconds"].values.ravel())) == 3


def test_all_batches_are_one_program(tmp_path):
    traces = []

    def case(x):
        traces.append(x)
        return {"square": x**2}

    study = js.study(case, {"x": np.arange(7.0)}, tmp_path / "study", batch=3)
    np.testing.assert_array_equal(study["square"], np.arange(7.0) ** 2)
    assert len(traces) == 1


def test_one_that_fails_in_a_batch_leaves_the_others_and_it_is_said_once(tmp_path):
    def case(x):
        return {"root": eqx.error_if(jnp.sqrt(x), x < 0, "x is negative")}

    with pytest.warns(UserWarning, match=r"A batch raised an error.*one by one: ") as said:
        study = js.study(case, {"x": [4.0, -1.0, 9.0, -4.0]}, tmp_path / "study", batch=2)
    assert len(said) == 1 and said[0].filename == __file__
    assert list(study["result"]) == ["successful", "failed"] * 2
    assert "x is negative" in str(study["error"].values[1])
    np.testing.assert_array_equal(study["root"], [2, np.nan, 3, np.nan])


def test_a_function_that_cannot_be_traced_runs_alone_with_a_warning(tmp_path):
    def case(x):
        return {"a": float(x)}

    with pytest.warns(UserWarning, match="one by one: ConcretizationTypeError"):
        study = js.study(case, {"x": [1.0, 2.0]}, tmp_path / "study", batch=2)
    np.testing.assert_array_equal(study["a"], [1, 2])
    with pytest.warns(UserWarning, match="one by one: TypeError"):
        words = js.study(case, {"x": ["1", "2"]}, tmp_path / "words", batch=2)
    np.testing.assert_array_equal(words["a"], [1, 2])


def test_a_batch_that_does_not_fit_into_memory_is_refused_and_not_run_one_by_one(tmp_path):
    def case(x):
        # More than a process can address.
        return {"sum": jnp.sort(jnp.full(1 << 44, x)).sum()}

    with pytest.raises(ValueError, match=r"A batch of 2 cases needs more memory.*smaller `batch`"):
        js.study(case, {"x": [1.0, 2.0]}, tmp_path / "study", batch=2)
    assert not list((tmp_path / "study").glob("*.nc"))


def test_the_command_line_begins_goes_on_and_sums_up(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("script.py").write_text(SCRIPT)
    for _ in range(2):
        main(["study", "script.py", "--path", "study"])
        said = capsys.readouterr()
        assert "30 cases: 25 successful, 5 failed" in said.out
        first = "The first that failed, seed=3, energy=0.0: ValueError: no contact at 0.0"
        assert first in said.out
        assert str(tmp_path / "study") in said.out and "30/30" in said.err
    assert sum(runs(tmp_path).values()) == 30
    text = "import jax.numpy as jnp\naxes = {'x': [1.0, 2.0]}\n"
    Path("batch.py").write_text(text + "def case(x):\n    return {'root': jnp.sqrt(x)}\n")
    main(["study", "batch.py", "--path", "batch", "--batch", "2", "--version", "3"])
    assert len(list(Path("batch").glob("*.nc"))) == 2
    assert '"version": "3"' in Path("batch/study.json").read_text()


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("axes = {'seed': [1]}", 2, "study.py defines no `case`"),
        ("def case(seed): return {'a': 1}", 2, "study.py defines no `axes`"),
        ("axes = 1 / 0", 2, "study.py, line 1: ZeroDivisionError: division by zero"),
        ("axes = (", 2, "study.py: SyntaxError"),
        ("axes = {'y': [1]}\ndef case(x): return {'a': 1}", 2, "The axes give the case y"),
        ("axes = {'x': [1, 2]}\ndef case(x): return {'a': 1 / 0}", 1, "every case failed"),
        (
            "import signal\naxes = {'x': [1, 2]}\n"
            "def case(x): signal.raise_signal(signal.SIGINT); return {'a': 1}",
            130,
            "interrupted, 1 of 2 cases are done",
        ),
        (None, 2, "there is no file study.py"),
    ],
)
@pytest.mark.usefixtures("interruptible")
def test_the_command_line_says_in_a_line_what_is_wrong(
    text, code, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path("study.py").write_text(text)
    with pytest.raises(SystemExit) as ended:
        main(["study", "study.py", "--path", "study"])
    assert ended.value.code == code
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("jaxstab") and message in last
