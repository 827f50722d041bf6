"""Studies: what each case returns is found where its axes say."""

from collections import Counter

import jax
import numpy as np
import xarray
from logged_study import runs

import jaxstab as js


def test_cases_are_those_of_a_plain_loop_with_verdicts_as_words(tmp_path):
    grid = js.Grid(16)

    def case(seed, energy):
        heights = js.surfaces.self_affine(grid, jax.random.key(seed), k_high=4, rms_height=0.1)
        law = js.potentials.Exponential(energy, 0.2)
        contact = js.Contact(js.HalfSpace(grid, 0.05), heights, law)
        state = js.equilibrate(contact, js.MeanGap(0.15), throw=False)
        stability = js.assess_stability(contact, state, throw=False)
        return {
            "ended": state.result,
            "verdict": stability.verdict,
            "gap": state.gap,
            "touches": state.in_contact,
            "steps": state.num_steps,
        }

    energies = [0.005, 0.02]
    js.study(case, {"seed": range(2), "energy": energies}, tmp_path / "study.zarr")
    stored = xarray.open_zarr(tmp_path / "study.zarr")
    assert (stored["result"] == "successful").all() and (stored["seconds"] > 0).all()
    for seed in range(2):
        for energy in energies:
            one, expected = stored.sel(seed=seed, energy=energy), case(seed, energy)
            assert one["ended"] == expected["ended"].name == "successful"
            assert one["verdict"] == expected["verdict"].name
            for name in ("gap", "touches", "steps"):
                np.testing.assert_array_equal(one[name], expected[name])
                assert one[name].dtype == expected[name].dtype
    assert set(stored["verdict"].values.ravel()) == {"stable", "held_by_contact"}
    assert "equilibrate" in stored.attrs["source"] and "jaxlib" in stored.attrs["versions"]


def test_values_are_added_to_axes_and_left_out_and_come_in_the_order_asked_for(tmp_path):
    def case(seed, energy):
        with open(log, "a") as file:
            file.write(f"{seed} {energy}\n")
        return {"product": seed * energy}

    log, path = str(tmp_path / "log"), tmp_path / "study.zarr"
    js.study(case, {"seed": [1, 2], "energy": [0.5, 0.25]}, path)
    dataset = js.study(case, {"seed": [3, 1], "energy": [0.25, 0.75]}, path)
    expected = ["1 0.5", "1 0.25", "2 0.5", "2 0.25", "3 0.25", "3 0.75", "1 0.75"]
    assert runs(tmp_path) == Counter(expected)
    assert list(dataset["seed"]) == [3, 1] and list(dataset["energy"]) == [0.25, 0.75]
    np.testing.assert_array_equal(dataset["product"], [[0.75, 2.25], [0.25, 0.75]])
    stored = xarray.open_zarr(path)
    assert list(stored["seed"]) == [1, 2, 3] and list(stored["energy"]) == [0.5, 0.25, 0.75]
    assert int((stored["result"] == "missing").sum()) == 2
    assert np.isnan(stored["product"].sel(seed=2, energy=0.75))


def test_masked_floats_are_missing_numbers(tmp_path):
    def case(seed):
        field = np.ma.array([1.0, 2.0, 3.0], mask=[False, seed == 1, False])
        whole = np.ma.array([4, 5], mask=[False, False])
        return {"field": field, "rows": [field, field], "mean": field[1:2].mean(), "whole": whole}

    dataset = js.study(case, {"seed": [0, 1]}, tmp_path / "study.zarr")
    np.testing.assert_array_equal(dataset["field"], [[1, 2, 3], [1, np.nan, 3]])
    np.testing.assert_array_equal(dataset["rows"][1], [[1, np.nan, 3]] * 2)
    np.testing.assert_array_equal(dataset["mean"], [2, np.nan])
    np.testing.assert_array_equal(dataset["whole"], [[4, 5]] * 2)


def test_listed_combinations_and_random_keys_and_words_are_axes(tmp_path):
    def listed(law, key):
        return {"draw": jax.random.normal(key), "length": len(law)}

    keys = jax.random.split(jax.random.key(7), 3)
    rows = [{"law": law, "key": key} for law, key in zip(["a", "bb", "a"], keys, strict=True)]
    js.study(listed, rows[:2], tmp_path / "listed.zarr")
    dataset = js.study(listed, rows[::-1], tmp_path / "listed.zarr")
    assert dataset["draw"].dims == ("case",) and list(dataset["law"]) == ["a", "bb", "a"]
    np.testing.assert_array_equal(dataset["draw"], jax.vmap(jax.random.normal)(keys)[::-1])
    assert {"law", "key"} <= set(xarray.open_zarr(tmp_path / "listed.zarr").coords)
    product = js.study(listed, {"law": ["bb", "a"], "key": keys}, tmp_path / "product.zarr")
    np.testing.assert_array_equal(product["draw"], [dataset["draw"][::-1]] * 2)
    np.testing.assert_array_equal(product["length"], [[2] * 3, [1] * 3])
    assert len(set(product["key"].values.tolist())) == 3


def test_a_case_that_raises_or_returns_something_else_is_recorded_and_the_rest_goes_on(tmp_path):
    def case(kind):
        if kind == "raises":
            raise RuntimeError("it broke")
        field = np.arange(3 if kind == "longer" else 2)
        more = {"more": 1} if kind == "more" else {}
        return {"field": field + (0.5 if kind == "fraction" else 0), "flag": True, **more}

    kinds = ["raises", "plain", "longer", "more", "fraction"]
    dataset = js.study(case, {"kind": kinds}, tmp_path / "study.zarr")
    assert list(dataset["result"]) == ["failed", "successful", "failed", "failed", "failed"]
    errors = dict(zip(kinds, dataset["error"].values.tolist(), strict=True))
    assert errors["raises"] == "RuntimeError: it broke" and errors["plain"] == ""
    assert "field is int64 of shape (3,) in this case, int64 of shape (2,)" in errors["longer"]
    assert "returned field, flag, more, cases before it field, flag" in errors["more"]
    assert "float64" in errors["fraction"]
    np.testing.assert_array_equal(dataset["field"][1], [0, 1])
    assert (dataset["field"][0] == np.iinfo(np.int64).min).all()


def test_words_can_be_masked_joined_and_loaded_however_a_store_is_read(tmp_path):
    def case(seed, law):
        if seed == 1:
            raise ValueError("no contact")
        return {"verdict": "stable", "words": ["a", law]}

    path, axes = tmp_path / "study.zarr", {"seed": [0, 1, 2], "law": ["x", "yy"]}
    study = js.study(case, axes, path)
    for dataset in (study, xarray.open_zarr(path), xarray.open_zarr(path, chunks=None)):
        assert dataset["error"].values[:, 0].tolist() == ["", "ValueError: no contact", ""]
        done = dataset.where(dataset["result"] == "successful")
        assert done["verdict"].fillna("-").values[:, 0].tolist() == ["stable", "-", "stable"]
        assert dataset.load()["words"].sel(seed=2, law="yy").values.tolist() == ["a", "yy"]
        assert dataset.reindex(seed=[2, 5])["verdict"].values[0].tolist() == ["stable", "stable"]
        dropped = dataset.where(dataset["result"] == "successful", drop=True)
        assert dropped.sizes["seed"] == 2
        assert len(xarray.concat([dataset, dropped], "seed")["seed"]) == 5
        assert (dataset["verdict"].sel(seed=1) == "missing").all()
