"""Studies: the outputs of each case are found where its coordinates say."""

import itertools
from collections import Counter
from importlib import import_module

import dask.array
import jax
import numpy as np
import pytest
import xarray
from logged_study import runs

import jaxstab as js


def read(path):
    """Return what xarray reads without jaxstab."""
    with xarray.open_mfdataset(str(path / "*.nc"), combine="by_coords") as dataset:
        return dataset.load()


def test_cases_are_those_of_a_plain_loop_with_verdicts_as_words(tmp_path):
    grid = js.Grid(16)

    def case(seed, energy):
        heights = js.surfaces.self_affine(grid, jax.random.key(seed), k_high=4, rms_height=0.1)
        law = js.potentials.Exponential(energy, 0.2)
        contact = js.Contact(js.HalfSpace(grid, 0.05), heights, law)
        state = js.equilibrate(contact, js.MeanGap(0.15), throw=False)
        stability = js.assess_stability(contact, state, throw=False)
        fields = {"gap": state.gap, "touches": state.in_contact, "steps": state.num_steps}
        return {"ended": state.result, "verdict": stability.verdict, **fields}

    energies = [0.005, 0.02]
    study = js.study(case, {"seed": range(2), "energy": energies}, tmp_path / "study")
    xarray.testing.assert_equal(study, read(tmp_path / "study"))
    assert (study["result"] == "successful").all() and (study["seconds"] > 0).all()
    for seed, energy in itertools.product(range(2), energies):
        one, expected = study.sel(seed=seed, energy=energy), case(seed, energy)
        assert one["ended"] == expected["ended"].name == "successful"
        assert one["verdict"] == expected["verdict"].name
        for name in ("gap", "touches", "steps"):
            np.testing.assert_array_equal(one[name], expected[name])
            assert one[name].dtype == expected[name].dtype
    assert set(study["verdict"].values.ravel()) == {"stable", "held_by_contact"}


def test_values_are_added_to_axes_and_left_out_and_come_in_the_order_asked_for(tmp_path):
    def case(seed, energy):
        with open(log, "a") as file:
            file.write(f"{seed} {energy}\n")
        return {"product": seed * energy}

    log, path = str(tmp_path / "log"), tmp_path / "study"
    js.study(case, {"seed": [1, 2], "energy": [0.5, 0.25]}, path)
    study = js.study(case, {"energy": [0.25, 0.75], "seed": [3, 1]}, path)
    expected = ["1 0.5", "1 0.25", "2 0.5", "2 0.25", "3 0.25", "3 0.75", "1 0.75"]
    assert runs(tmp_path) == Counter(expected)
    assert list(study["seed"]) == [3, 1] and list(study["energy"]) == [0.25, 0.75]
    np.testing.assert_array_equal(study["product"], [[0.75, 2.25], [0.25, 0.75]])
    # All numbers that Python tells apart are cases of their own, equal ones are not.
    close = {"seed": [1], "energy": [0.5, np.nextafter(0.5, 1), 0.0]}
    js.study(case, close, path)
    js.study(case, {"seed": np.array([1], np.int8), "energy": np.array([-0.0], "f4")}, path)
    assert sum(runs(tmp_path).values()) == 9


def test_listed_combinations_and_words_are_axes(tmp_path):
    def listed(law, seed):
        return {"draw": jax.random.normal(jax.random.key(seed)), "length": len(law)}

    rows = [{"law": law, "seed": seed} for seed, law in enumerate(["ä", "bb", "ä"])]
    js.study(listed, rows[:2], tmp_path / "listed")
    study = js.study(listed, rows[::-1], tmp_path / "listed")
    assert study["draw"].dims == ("case",) and list(study["law"]) == ["ä", "bb", "ä"]
    draws = [jax.random.normal(jax.random.key(seed)) for seed in range(3)]
    np.testing.assert_array_equal(study["draw"], draws[::-1])
    stored = read(tmp_path / "listed").sel(case=study["case"])
    assert {"law", "seed", "case"} == set(stored.coords)
    xarray.testing.assert_equal(study, stored)
    product = js.study(listed, {"law": ["bb", "ä"], "seed": range(3)}, tmp_path / "product")
    np.testing.assert_array_equal(product["draw"], [draws] * 2)
    np.testing.assert_array_equal(product["length"], [[2] * 3, [1] * 3])
    xarray.testing.assert_equal(product, read(tmp_path / "product").sel(product.coords))


def test_a_case_may_return_a_labelled_data_set(tmp_path):
    def case(seed):
        if seed == 1:
            raise ValueError("no contact")
        return xarray.Dataset(
            {
                "height": (("x", "y"), seed + np.arange(6.0).reshape(3, 2), {"units": "µm"}),
                "name": ("x", ["a", "b", "ccc"]),
                "load": 0.5,
            },
            coords={"x": ("x", [0.1, 0.2, 0.3 + (seed == 3)], {"units": "m"}), "time": 3.0},
        )

    study = js.study(case, {"seed": [0, 1, 2, 3]}, tmp_path / "study")
    for dataset in (study, read(tmp_path / "study")):
        assert dataset["height"].dims == ("seed", "x", "y")
        assert dataset["height"].attrs == {"units": "µm"} and dataset["x"].attrs == {"units": "m"}
        np.testing.assert_array_equal(dataset["x"], [0.1, 0.2, 0.3])
        height = dataset["height"].sel(seed=2, x=0.2)
        np.testing.assert_array_equal(height, case(2)["height"].sel(x=0.2))
        assert np.isnan(dataset["height"].sel(seed=1)).all()
        assert dataset["name"].values[2].tolist() == ["a", "b", "ccc"]
        assert dataset["time"][0] == 3.0
        assert dataset["result"].values.tolist() == ["successful", "failed", "successful", "failed"]
    assert "x is numbers (x 3) [0.1, 0.2, 1.3], in other cases" in str(study["error"][3].values)


def test_a_case_whose_arrays_cannot_be_read_has_failed_alone(tmp_path):
    def heights(seed):
        if seed == 0:
            raise OSError(5, "The file is gone")
        return np.array([seed, 2.0 * seed])

    def case(seed):
        lazy = dask.array.from_delayed(dask.delayed(heights)(seed), (2,), float)
        return xarray.Dataset({"height": ("x", lazy)})

    study = js.study(case, {"seed": [0, 1, 2]}, tmp_path / "study")
    assert study["result"].values.tolist() == ["failed", "successful", "successful"]
    assert study["error"].values[0] == "OSError: [Errno 5] The file is gone"
    np.testing.assert_array_equal(study["height"][1:], [[1, 2], [2, 4]])


def labelled(values, places, unit):
    coordinates = {"x": ("x", places, {"units": "m"})}
    return xarray.DataArray(values, coordinates, dims="x", attrs={"units": unit})


def test_labelled_arrays_of_a_case_keep_their_units_and_places(tmp_path):
    def case(seed):
        force = xarray.DataArray(2.0 * seed, attrs={"units": "nN"})
        height = labelled(seed + np.arange(3.0), [0.1, 0.2, 0.4], "µm")
        return {"height": height, "force": force, "plain": np.arange(2), "number": seed}

    study = js.study(case, {"seed": [0, 3]}, tmp_path / "study")
    for dataset in (study, read(tmp_path / "study")):
        assert dataset["height"].dims == ("seed", "x") and dataset["plain"].shape[-1] == 2
        assert dataset["height"].attrs == {"units": "µm"} and dataset["x"].attrs == {"units": "m"}
        assert dataset["force"].attrs == {"units": "nN"} and dataset["number"].attrs == {}
        assert float(dataset["height"].sel(seed=3, x=0.4)) == 5.0
        assert dataset["force"].values.tolist() == [0.0, 6.0]

    def at_other_places(seed):
        return {"a": labelled([1.0, 2.0], [0, 1], "m"), "b": labelled([1.0, 2.0], [0, 2], "m")}

    def with_a_plain_place(seed):
        return {"a": labelled([1.0, 2.0], [0, 1], "m"), "x": np.array([5.0, 6.0])}

    with pytest.raises(ValueError, match="cannot align"):
        js.study(at_other_places, {"seed": [0]}, tmp_path / "other")
    with pytest.raises(ValueError, match="'x' as an output and as a coordinate"):
        js.study(with_a_plain_place, {"seed": [0]}, tmp_path / "plain")


class Quantity:
    """A number with a unit, as of other packages."""

    magnitude, units = 3.0, "nm"

    def __array__(self, dtype=None, copy=None):
        return np.array(self.magnitude, dtype)


def test_units_of_axes_and_outputs_are_not_dropped(tmp_path):
    def case(gap):
        return {"force": gap}

    for i, axis in enumerate(([Quantity()], labelled([1.0, 2.0], [0, 1], "nm"))):
        for axes in ({"gap": axis}, [{"gap": x} for x in axis]):
            with pytest.raises(TypeError, match=r"gap is a .* in nm, and numbers have the units"):
                js.study(case, axes, tmp_path / f"axes {i}")
    with pytest.raises(TypeError, match="force is a Quantity in nm"):
        js.study(lambda gap: {"force": Quantity()}, {"gap": [1.0]}, tmp_path / "output", version=1)


def test_fields_are_read_on_access_where_the_study_is_large(tmp_path, monkeypatch):
    def case(seed, energy):
        if seed == 1:
            raise ValueError("no contact")
        return {"field": np.full((30, 20), seed + energy), "small": seed, "words": ["a"] * 300}

    axes, path = {"seed": [0, 1, 2], "energy": [0.5, 0.25]}, tmp_path / "study"
    expected = js.study(case, axes, path)
    monkeypatch.setattr(import_module("jaxstab.studies.study"), "LARGE", 20_000)
    study = js.study(case, axes, path)
    assert study["field"].chunks and not study["small"].chunks
    xarray.testing.assert_identical(study.load(), expected)
    study = js.study(case, axes, path)
    for file in path.glob("*.nc"):
        content = bytearray(file.read_bytes())
        place = content.find(np.full(4, 2.5).tobytes())
        if place > 0:
            content[place] ^= 1
            file.write_bytes(content)
            break
    assert float(study["field"].sel(seed=2, energy=0.25).mean()) == 2.25
    with pytest.raises(OSError, match=f"{file.name} is damaged"):
        study["field"].sel(seed=2, energy=0.5).load()
    xarray.testing.assert_equal(js.study(case, axes, path)["field"].load(), expected["field"])


def test_a_case_that_raises_or_returns_something_else_is_recorded_and_the_rest_goes_on(tmp_path):
    def case(kind):
        if kind == "raises":
            raise RuntimeError("it broke")
        if kind == "object":
            return {"field": object()}
        field = np.arange(3 if kind == "longer" else 2)
        more = {"more": 1} if kind == "more" else {}
        field = field + 0.5 if kind == "fraction" else field
        return {"field": field.astype(str) if kind == "words" else field, "flag": True, **more}

    kinds = ["raises", "plain", "longer", "more", "words", "object"]
    study = js.study(case, {"kind": kinds}, tmp_path / "study")
    assert list(study["result"]) == ["failed", "successful", *["failed"] * 4]
    errors = dict(zip(kinds, study["error"].values.tolist(), strict=True))
    assert errors["raises"] == "RuntimeError: it broke" and errors["plain"] == ""
    expected = "numbers (kind 1, field_0 3), in other cases numbers (kind 1, field_0 2)"
    assert expected in errors["longer"]
    assert "more is numbers (kind 1), in other cases missing" in errors["more"]
    assert "field is words" in errors["words"] and "field is object" in errors["object"]
    np.testing.assert_array_equal(study["field"][1], [0, 1])
    assert (study["field"][0] == np.iinfo(np.int64).min).all() and not study["flag"][0]
    assert study["flag"].dtype == bool
    # Integers and fractions are numbers both, and missing ones are then NaN, in the files too.
    study = js.study(case, {"kind": [*sorted(kinds), "fraction"]}, tmp_path / "study")
    for dataset in (study, read(tmp_path / "study")):
        field = dataset["field"].sel(kind=["fraction", "plain", "raises"])
        np.testing.assert_array_equal(field, [[0.5, 1.5], [0, 1], [np.nan, np.nan]])


def test_words_that_hdf5_does_not_hold_are_escaped(tmp_path):
    """Half characters stand for bytes in names of files, which messages of errors quote."""

    def case(seed):
        if seed == 1:
            raise FileNotFoundError("scan\udcff.txt")
        return {"word": "a\0b", "name": ["\udcff", "ä"]}

    study = js.study(case, {"seed": [0, 1]}, tmp_path / "study")
    assert study["error"].values.tolist() == ["", r"FileNotFoundError: scan\udcff.txt"]
    assert study["word"].values[0] == r"a\0b"
    assert study["name"].values[0].tolist() == [
        r"\udcff",
        "ä",
    ]


def test_failed_cases_count_as_done_until_they_are_to_run_again(tmp_path):
    def case(seed):
        with open(log, "a") as file:
            file.write(f"{seed}\n")
        if (tmp_path / "broken").exists() and seed == 1:
            raise ValueError("no contact")
        return {"words": ["a", str(seed)]}

    log, path, axes = str(tmp_path / "log"), tmp_path / "study", {"seed": [0, 1, 2]}
    (tmp_path / "broken").touch()
    js.study(case, axes, path)
    (tmp_path / "broken").unlink()
    study = js.study(case, axes, path)
    assert study["error"].values.tolist() == ["", "ValueError: no contact", ""]
    assert (study["words"][1] == "missing").all()
    done = study.where(study["result"] == "successful")
    assert done["words"].fillna("-").values[:, 0].tolist() == ["a", "-", "a"]
    study = js.study(case, axes, path, retry=True)
    assert (study["result"] == "successful").all() and (study["words"][:, 0] == "a").all()
    assert runs(tmp_path) == {"0": 1, "1": 2, "2": 1}


def test_masked_floats_are_missing_numbers(tmp_path):
    def case(seed):
        field = np.ma.array([1.0, 2.0, 3.0], mask=[False, seed == 1, False])
        whole = np.ma.array([4, 5], mask=[False, False])
        none, waves = np.zeros((0, 2)), np.exp(1j * np.arange(3))
        return {"field": field, "mean": field[1:2].mean(), "whole": whole, "none": none, "w": waves}

    study = js.study(case, {"seed": [0, 1]}, tmp_path / "study")
    np.testing.assert_array_equal(study["field"], [[1, 2, 3], [1, np.nan, 3]])
    np.testing.assert_array_equal(study["mean"], [2, np.nan])
    np.testing.assert_array_equal(study["whole"], [[4, 5]] * 2)
    assert study["none"].shape == (2, 0, 2)
    np.testing.assert_array_equal(study["w"][1], np.exp(1j * np.arange(3)))


def test_a_half_is_kept_in_single_precision(tmp_path):
    study = js.study(lambda seed: {"half": np.float16(seed)}, {"seed": [1]}, tmp_path, version=1)
    assert study["half"].dtype == read(tmp_path)["half"].dtype == np.float32


@pytest.mark.parametrize(
    ("outputs", "message"),
    [
        (None, "returned NoneType"),
        ({}, "return a dict"),
        ({"result": 1}, "'result': choose another name"),
        ({"a": [1, 2], "a_0": 1}, "'a_0': choose another name"),
        ({"a/b": 1}, "a name that is taken, or no identifier, 'a/b'"),
        ({"a": None}, "a is NoneType"),
        ({"a": ["b", 1]}, "a is list of object: give numbers or words"),
        ({"a": [1, [2, 3]]}, "a is no array"),
        ({"a": np.ma.array([1, 2], mask=[0, 1])}, "a is no array.* nan to dtype int64"),
        (xarray.Dataset({"a": ("seed", [1])}), "'seed': choose another name"),
    ],
)
def test_outputs_that_no_file_can_hold_are_refused_at_the_first_case(outputs, message, tmp_path):
    def case(seed):
        return outputs

    with pytest.raises((TypeError, ValueError), match=message):
        js.study(case, {"seed": range(3)}, tmp_path / "study")
    assert not list((tmp_path / "study").iterdir())


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({}, "neither a dict"),
        ({"seed": []}, "seed is array([], dtype=float64): give"),
        ({"seed": 3}, "seed is array(3): give"),
        ({"seed": [1.0, float("nan")]}, "seed is array([ 1., nan]): give"),
        ({"seed": [1, 2, 1]}, "the case {'seed': 1} twice"),
        ({"seed": [0.0, -0.0]}, "the case {'seed': -0.0} twice"),
        ([{"seed": 1}, {"seed": True}], "the case {'seed': 1} twice"),
        ({"seed": [None]}, "seed is list of object: give numbers or words, or an array of"),
        ({"seed": [1, "a"]}, "seed is list of object: give numbers or words, or an array of"),
        ({"seed": np.ma.array([1.0, 2.0], mask=[0, 1])}, "seed is array([ 1., nan]): give"),
        ({"seed": jax.random.split(jax.random.key(0))}, "PRNGKey"),
        ({"case": [1]}, "'case' is a name of the study"),
        ({"energy": [1]}, "The axes give the case energy: missing a required argument: 'seed'"),
        ({"seed": [1], "energy": [1]}, "The axes give the case seed, energy: got an unexpected"),
        ([{"seed": 1}, {"energy": 1}], "the same names"),
        ([{"seed": np.arange(2)}], "seed is array([[0, 1]]): give"),
    ],
)
def test_axes_that_make_no_sense_are_refused_before_anything_is_written(axes, message, tmp_path):
    def case(seed):
        return {"a": seed}

    with pytest.raises((TypeError, ValueError)) as refused:
        js.study(case, axes, tmp_path / "study")
    assert message in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_values_of_a_case_with_other_outputs_than_the_first_are_kept(tmp_path):
    path = tmp_path / "study"
    js.study(lambda n: {"a": 1.0 * n}, {"n": [0]}, path, version="trial")
    study = js.study(
        lambda n: {"a": 1.0 * n, "b": 2.0 * n},
        {"n": [0, 3]},
        path,
        version="final",
        accept_changes=True,
    )
    (kept,) = path.glob("*.unusual")
    assert kept.name in study["error"].values[1] and study["result"].values[1] == "failed"
    with xarray.open_dataset(kept, engine="h5netcdf") as dataset:
        assert (dataset["n"], dataset["a"], dataset["b"]) == (3, 3.0, 6.0)


def test_an_attribute_named_dtype_converts_no_numbers(tmp_path):
    def case(seed):
        return xarray.Dataset({"a": ("x", [0.5, 1.7], {"dtype": "int32"})})

    study = js.study(case, {"seed": [0]}, tmp_path / "study")
    np.testing.assert_array_equal(study["a"], [[0.5, 1.7]])
    assert study["a"].attrs == {"dtype": "int32"}
