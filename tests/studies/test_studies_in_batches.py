"""Studies in batches, on several devices, and from the command line."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from logged_study import runs, script_in

import jaxstab as js
from jaxstab.__main__ import main


def test_a_batch_is_what_its_cases_are_alone(tmp_path):
    def case(key, energy):
        draw = jax.random.normal(key, (4,))
        word = js.VERDICTS.where(draw.sum() > 0, "stable", "unstable")
        return {"field": energy * draw, "verdict": word}

    axes = {"key": jax.random.split(jax.random.key(1), 5), "energy": [1.0, 2.0]}
    alone = js.study(case, axes, tmp_path / "alone.zarr").load()
    # Of which 4 do not divide the 10 cases.
    together = js.study(case, axes, tmp_path / "together.zarr", batch=4).load()
    assert set(alone["verdict"].values.ravel()) == {"stable", "unstable"}
    np.testing.assert_array_equal(alone["verdict"], together["verdict"])
    np.testing.assert_allclose(alone["field"], together["field"], rtol=1e-14)
    assert len(set(together["seconds"].values.ravel())) == 3


def test_one_that_fails_in_a_batch_leaves_the_others(tmp_path):
    def case(x):
        return {"root": eqx.error_if(jnp.sqrt(x), x < 0, "x is negative")}

    with pytest.warns(UserWarning, match=r"its 3 cases are run one by one.*x is negative") as said:
        dataset = js.study(case, {"x": [4.0, -1.0, 9.0]}, tmp_path / "study.zarr", batch=3)
    assert len(said) == 1 and said[0].filename == __file__
    assert list(dataset["result"]) == ["successful", "failed", "successful"]
    assert "x is negative" in str(dataset["error"].values[1])
    np.testing.assert_array_equal(dataset["root"], [2, np.nan, 3])


def test_of_batches_that_raise_it_is_said_once(tmp_path):
    def case(x):
        return {"root": eqx.error_if(jnp.sqrt(x), x < 0, "x is negative")}

    axes = {"x": [-4.0, -1.0, 9.0, -2.0]}
    with pytest.warns(UserWarning, match="one by one") as said:
        dataset = js.study(case, axes, tmp_path / "study.zarr", batch=2)
    assert len(said) == 1 and (dataset["result"] == "failed").sum() == 3


def test_a_batch_that_does_not_fit_into_memory_is_refused_and_not_run_one_by_one(tmp_path):
    def case(x):
        # More than a process can address.
        return {"sum": jnp.sort(jnp.full(1 << 44, x)).sum()}

    message = r"A batch of 2 cases needs more memory than there is \(.*: use a smaller batch"
    with pytest.raises(ValueError, match=message):
        js.study(case, {"x": [1.0, 2.0]}, tmp_path / "study.zarr", batch=2)
    stored = xarray.open_zarr(tmp_path / "study.zarr")
    assert list(stored["result"].values) == ["missing"] * 2


def test_cases_alone_go_on_in_the_precision_of_those_in_batches(tmp_path):
    def case(x):
        return {"half": (0.5 * x).astype(jnp.float32) if hasattr(x, "dtype") else 0.5 * x}

    path = tmp_path / "study.zarr"
    js.study(case, {"x": [0.1, 0.2]}, path, batch=2)
    dataset = js.study(case, {"x": [0.1, 0.2, 0.3, 1e300]}, path)
    assert list(dataset["result"][:3]) == 3 * ["successful"]
    np.testing.assert_allclose(dataset["half"][:3], [0.05, 0.1, 0.15], rtol=1e-6)
    # What single precision cannot hold is no number of it.
    assert "half is float64 in this case, float32" in str(dataset["error"][3].values)


def test_a_function_that_cannot_be_traced_is_refused_in_batches(tmp_path):
    def case(x):
        return {"a": float(x)}

    with pytest.raises(ValueError, match=r"cannot be run in batches.*or use batch=1"):
        js.study(case, {"x": [1.0, 2.0]}, tmp_path / "study.zarr", batch=2)
    with pytest.raises(ValueError, match=r"x are words.*use batch=1"):
        js.study(case, {"x": ["1", "2"]}, tmp_path / "words.zarr", batch=2)
    np.testing.assert_array_equal(
        js.study(case, {"x": [1.0, 2.0]}, tmp_path / "study.zarr")["a"], [1, 2]
    )


def test_cases_are_dealt_to_all_devices_and_zarr_is_imported_late(tmp_path):
    (tmp_path / "script.py").write_text(
        textwrap.dedent("""
            import jax, jax.numpy as jnp, sys, time, jaxstab
            assert not {"zarr", "xarray"} & set(sys.modules)
            def case(seed):
                x = jnp.ones(2) * seed
                time.sleep(0.02)
                return {"device": next(iter(x.devices())).id, "x": x}
            study = jaxstab.study(case, {"seed": range(12)}, "study.zarr")
            assert (study.x == study.seed).all() and (study.result == "successful").all()
            print(sorted(set(study.device.values.tolist())))
        """)
    )
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=2"
    environment = {**os.environ, "XLA_FLAGS": flags}
    command = [sys.executable, "script.py"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.stdout == "[0, 1]\n", done.stderr


def test_the_command_line_begins_goes_on_and_sums_up(tmp_path, capsys, monkeypatch):
    script = script_in(tmp_path)
    monkeypatch.chdir(script)
    for _ in range(2):
        main(["study", "script.py", "--path", "study.zarr"])
        said = capsys.readouterr()
        assert "30 cases: 25 successful, 5 failed" in said.out
        first = "The first that failed, energy=0.0, seed=3: ValueError: no contact at 0.0"
        assert first in said.out
        assert str(script / "study.zarr") in said.out and "30/30" in said.err
        assert "failed=5" in said.err
    assert sum(runs(script).values()) == 30
    text = "import jax.numpy as jnp\naxes = {'x': [1.0, 2.0]}\n"
    Path("batch.py").write_text(text + "def case(x):\n    return {'root': jnp.sqrt(x)}\n")
    main(["study", "batch.py", "--path", "batch.zarr", "--batch", "2"])
    np.testing.assert_allclose(xarray.open_zarr("batch.zarr")["root"], np.sqrt([1, 2]))


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("axes = {'seed': [1]}", 2, "study.py defines no `case`"),
        ("def case(seed): return {'a': 1}", 2, "study.py defines no `axes`"),
        ("axes = 1 / 0", 2, "study.py, line 1: ZeroDivisionError: division by zero"),
        ("axes = (", 2, "study.py: SyntaxError"),
        ("axes = {'y': [1]}\ndef case(x): return {'a': 1}", 2, "the axes give y"),
        ("axes = {'x': [1, 2]}\ndef case(x): return {'a': 1 / 0}", 1, "every case failed"),
        (
            "import signal\naxes = {'x': [1, 2]}\n"
            "def case(x): signal.raise_signal(signal.SIGINT); return {'a': 1}",
            130,
            "interrupted, 1 of 2 cases are done",
        ),
        (None, 2, "study.py is not a Python file"),
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
        main(["study", "study.py", "--path", "study.zarr"])
    assert ended.value.code == code
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("jaxstab: ") and message in last
