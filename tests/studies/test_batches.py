"""Studies in batches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js


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


def test_integers_that_jax_would_wrap_around_run_alone(tmp_path):
    def case(seed):
        return {"same": seed + 0}

    seeds = [1, 2**33 + 1]
    with (
        jax.enable_x64(False),
        pytest.warns(UserWarning, match=r"OverflowError: seed is 8589934593, which .* into int32"),
    ):
        alone = js.study(case, {"seed": seeds}, tmp_path / "single", batch=2)
    assert alone["same"].values.tolist() == seeds
    together = js.study(case, {"seed": seeds}, tmp_path / "double", batch=2)
    assert together["same"].values.tolist() == seeds


def test_a_batch_that_does_not_fit_into_memory_is_refused_and_not_run_one_by_one(tmp_path):
    def case(x):
        # More than a process can address.
        return {"sum": jnp.sort(jnp.full(1 << 44, x)).sum()}

    with pytest.raises(ValueError, match=r"A batch of 2 cases lacks memory.*smaller `batch`"):
        js.study(case, {"x": [1.0, 2.0]}, tmp_path / "study", batch=2)
    assert not list((tmp_path / "study").glob("*.nc"))
