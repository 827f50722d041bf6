"""Results as data sets and files: they come back unchanged, here and in plain xarray."""

import json
import subprocess
import sys

import equinox as eqx
import h5netcdf
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from problems import state_of
from saved import BUMPY, LENGTHS, SHAPE, assert_same_bits, contact_of, rewrite

import jaxstab as js
from jaxstab.core import checked_netcdf
from jaxstab.files.records import Recorder, restore


def swept(potential, dtype=jnp.float64):
    contact = contact_of(potential, dtype)
    return contact, js.sweep(contact, js.Spring(jnp.linspace(0.0, 0.2, 3), 0.3))


@pytest.fixture(scope="module")
def plain():
    return swept(js.potentials.Exponential(0.01, 0.2))


@pytest.fixture(
    scope="module",
    params=[
        "float64",
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("float32", "own law")),
    ],
)
def case(request, plain):
    if request.param == "float32":
        return swept(js.potentials.Exponential(0.01, 0.2), jnp.float32)
    return plain if request.param == "float64" else swept(BUMPY)


@pytest.mark.nightly
def test_each_result_comes_back_to_the_last_bit(case, tmp_path):
    contact, sweep = case
    results = sweep, sweep[1], sweep.equilibrium, sweep[2].equilibrium, sweep[0].stability
    for i, result in enumerate(results):
        path = js.save(tmp_path / f"{i}.nc", contact, result)
        assert_same_bits((contact, result), js.load(path))
        # Rows of a history that were not needed are NaN.
        assert js.load(path)[1] == result
    assert results[1] != results[0][2] and results[2] != results[3]


@pytest.mark.nightly
def test_a_path_comes_back_to_the_last_bit(rough_path, tmp_path):
    contact, path = rough_path
    assert len(path.jumps) >= 2
    assert_same_bits(rough_path, js.load(js.save(tmp_path / "path.nc", contact, path)))
    scalars = js.to_dataset(contact, path, fields=False)
    np.testing.assert_array_equal(scalars.jump_load, path.jumps.load.value)
    assert scalars.jump_kind.values.tolist() == path.jumps.kind.name.tolist()
    np.testing.assert_array_equal(scalars.work[-1], scalars.total_work)
    assert not {"x", "y"} & set(scalars.dims)


def test_a_data_set_says_what_everything_is(case):
    contact, sweep = case
    dataset = js.to_dataset(contact, sweep)
    assert dataset.gap.dims == ("load", "x", "y") and dataset.cone_mode.dims == ("load", "x", "y")
    np.testing.assert_array_equal(dataset["load"], sweep.load.value)
    np.testing.assert_array_equal(dataset.load_stiffness, sweep.load.stiffness)
    for axis, name in enumerate(("x", "y")):
        places = np.moveaxis(contact.grid.coordinates[axis], axis, 0)[:, 0]
        np.testing.assert_allclose(dataset[name], places, rtol=1e-6)
    assert dataset.gap.attrs == {"long_name": "gap", "units": "length"}
    assert dataset.cone_eigenvalue.attrs["long_name"] == "cone, eigenvalue"
    assert dataset["load"].attrs == {"long_name": "load: Spring", "units": "length"}
    assert dataset.verdict.values.tolist() == sweep.stability.verdict.name.tolist()
    assert json.loads(dataset.versions)["jax"] == jax.__version__
    assert "0.3" in dataset.attrs["solid"]
    energies = [contact.potential(gap) for gap in dataset.law_gap.values.astype(dataset.gap.dtype)]
    np.testing.assert_allclose(dataset.law_energy, energies, rtol=1e-5)
    unlabelled = [
        name
        for name, array in dataset.data_vars.items()
        if "long_name" not in array.attrs
        or (array.dtype.kind == "f" and "units" not in array.attrs and "potential" not in name)
    ]
    assert unlabelled == []


@pytest.mark.nightly
def test_plain_xarray_opens_it_without_this_package(plain, tmp_path):
    contact, sweep = plain
    path = js.save(tmp_path / "sweep.nc", contact, sweep)
    script = (
        "import sys, xarray; data = xarray.open_dataset(sys.argv[1]);"
        "print(float(data.mean_pressure[1]), data.verdict.values[1], 'jax' in sys.modules)"
    )
    command = [sys.executable, "-c", script, str(path)]
    said = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path).stdout
    pressure, verdict, has_jax = said.split()
    assert float(pressure) == float(sweep[1].equilibrium.mean_pressure)
    assert verdict == sweep[1].stability.verdict.name
    assert has_jax == "False"


def test_a_sweep_goes_on_from_a_loaded_state_as_if_never_interrupted(tmp_path):
    contact = contact_of(js.potentials.Exponential(0.01, 0.2))
    loads = js.Spring(jnp.linspace(0.0, 0.2, 5), 0.3)
    whole = js.sweep(contact, loads, order="continuation", stability=False)
    path = js.save(tmp_path / "half.nc", contact, whole[:3])
    contact, half = js.load(path)
    rest = js.sweep(contact, loads[3:], order="continuation", stability=False, initial=half[-1])
    assert_same_bits(rest.equilibrium.gap, whole[3:].equilibrium.gap)


def test_nothing_is_overwritten_and_no_half_of_a_file_is_left(plain, tmp_path, monkeypatch):
    contact, sweep = plain
    path = js.save(tmp_path / "a.nc", contact, sweep)
    before = path.read_bytes()
    with pytest.raises(FileExistsError, match=r"a.nc exists: delete it, or give another name"):
        js.save(path, contact, sweep[0])
    assert path.read_bytes() == before
    killed = tmp_path / "killed.nc"
    killed.touch()
    with pytest.raises(FileExistsError, match=r"killed.nc is empty, perhaps left by a process"):
        js.save(killed, contact, sweep[0])
    killed.unlink()

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(checked_netcdf, "write_whole", interrupted)
    with pytest.raises(KeyboardInterrupt):
        js.save(tmp_path / "b.nc", contact, sweep)
    assert [file.name for file in tmp_path.iterdir()] == ["a.nc"]


def test_what_cannot_be_written_is_refused(plain, rough_path, tmp_path):
    contact, sweep = plain
    with pytest.raises(ValueError, match=r"run.npz does not end in .nc"):
        js.save(tmp_path / "run.npz", contact, sweep)
    with pytest.raises(TypeError, match="Contact is no path: give the file first"):
        js.save(contact, sweep, tmp_path / "run.nc")
    with pytest.raises(TypeError, match="tuple is no result"):
        js.to_dataset(contact, (sweep[0].equilibrium, sweep[0].stability))
    other = js.Contact(js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), lambda gap: 0 * gap)
    with pytest.raises(ValueError, match=r"shape \(16, 12\), the grid \(8, 8\)"):
        js.to_dataset(other, sweep)
    with pytest.raises(TypeError, match="tracing"):
        jax.jit(lambda state: js.to_dataset(contact, state).gap.values)(sweep[0].equilibrium)
    with pytest.raises(TypeError, match="Sweep is no contact: give that first"):
        js.save(tmp_path / "run.nc", sweep, contact)
    contacts = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), contact)
    with pytest.raises(ValueError, match="several contacts"):
        js.to_dataset(contacts, sweep)
    twice = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), rough_path[1])
    with pytest.raises(ValueError, match="several paths"):
        js.to_dataset(rough_path[0], twice)


def test_what_cannot_be_read_is_refused_in_a_sentence(plain, tmp_path):
    contact, sweep = plain
    path = js.save(tmp_path / "run.nc", contact, sweep[0])
    with pytest.raises(FileNotFoundError, match=r"There is no file .*none.nc"):
        js.load(tmp_path / "none.nc")
    (tmp_path / "cut.nc").write_bytes(path.read_bytes()[:5000])
    (tmp_path / "text.nc").write_text("gap 1 2 3")
    for name in ("cut", "text"):
        with pytest.raises(ValueError, match=f"{name}.nc is no readable NetCDF file"):
            js.load(tmp_path / f"{name}.nc")
    xarray.Dataset({"gap": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=r"other.nc was not written by jaxstab.save"):
        js.load(tmp_path / "other.nc")
    scalars = js.save(tmp_path / "scalars.nc", contact, sweep, fields=False)
    with pytest.raises(ValueError, match=r"fields=False, so it cannot become a result"):
        js.load(scalars)
    with jax.enable_x64(False), pytest.raises(ValueError, match="is in double precision"):
        js.load(path)


def test_changed_numbers_and_damaged_structures_are_refused_in_a_sentence(plain, tmp_path):
    contact, sweep = plain
    state = sweep[0].equilibrium
    content = js.save(tmp_path / "run.nc", contact, state).read_bytes()

    def refuses(place, bit=1):
        changed = bytearray(content)
        changed[place] ^= bit
        (tmp_path / "changed.nc").write_bytes(changed)
        try:
            js.load(tmp_path / "changed.nc")
        except ValueError as error:
            assert "changed.nc" in str(error)
            return True
        return False

    for value, place in ((contact.heights, 100), (state.energy, 0)):
        start = content.find(np.asarray(value).tobytes())
        assert start > 0 and refuses(start + place)
    # A number of the structure.
    assert refuses(content.find(b'"value": ') + len(b'"value": '))
    # Here the structure is no valid text.
    assert refuses(content.find(b'"value": ') + 2, bit=0x80)
    assert all(map(refuses, range(0, len(content), len(content) // 20)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"num_steps": {', '"num_loops": {', "another version of the"),
        ("jaxstab:History", "jaxstab:Chronicle", "is not found"),
        ("jaxstab:H", "jaxstab.core.history:H", "is not found"),
        ('"RESULTS"', '"VERDICTS"', "successful in the file is not one"),
    ],
)
def test_a_file_of_another_version_is_refused_in_a_sentence(plain, tmp_path, old, new, message):
    contact, sweep = plain
    path = js.save(tmp_path / "run.nc", contact, sweep[0].equilibrium)
    rewrite(path, old, new)
    with pytest.raises(ValueError, match=message):
        js.load(path)


@pytest.mark.parametrize("number", [1, 99])
def test_a_file_of_another_format_is_refused_with_both_numbers(plain, tmp_path, number):
    contact, sweep = plain
    path = js.save(tmp_path / "run.nc", contact, sweep[0].equilibrium)
    with h5netcdf.File(path, "r+") as file:
        own = int(file.attrs["format"])
        del file.attrs["format"]
        if number != 1:
            file.attrs["format"] = number
    with pytest.raises(ValueError, match=rf"of format {number}, and .* reads format {own}: comp"):
        js.load(path)


def test_a_file_opens_that_is_older_than_a_field_with_a_default(case, tmp_path):
    contact, sweep = case
    path = js.save(tmp_path / "run.nc", contact, sweep[0].equilibrium)
    rewrite(path, ', "sharding": null', "")
    assert_same_bits((contact, sweep[0].equilibrium), js.load(path))


def test_a_file_that_lacks_something_says_what(plain, tmp_path):
    contact, sweep = plain
    path = js.save(tmp_path / "run.nc", contact, sweep[0])
    for name in ("gap", "law_energy"):
        less = tmp_path / f"{name}.nc"
        xarray.load_dataset(path).drop_vars(name).to_netcdf(less, engine="h5netcdf")
        with pytest.raises(ValueError, match=rf"{name}.nc was changed since .* damaged"):
            js.load(less)
    with h5netcdf.File(path, "r+") as file:
        file.attrs["structure"] = "{"
    with pytest.raises(ValueError, match=r"run.nc was changed since .* damaged"):
        js.load(path)


def test_solids_with_a_scaled_stiffness_come_back(tmp_path):
    contact, state = state_of(
        contact_of(js.potentials.Exponential(0.01, 0.2)), jnp.full(SHAPE, 0.2)
    )
    layer = js.Layer(contact.grid, 1.0, 0.3, 0.1)
    rubber = js.Viscoelastic.from_moduli(layer, (0.5,), (1.0,))
    altered = js.solids.Solid.scaled(layer, jnp.array(2.0))
    for i, solid in enumerate((rubber, rubber.glassy, altered)):
        both = js.Contact(solid, contact.heights, contact.potential), state
        assert_same_bits(both, js.load(js.save(tmp_path / f"{i}.nc", *both)))


@pytest.mark.nightly
def test_stacks_crystals_and_graded_solids_come_back(tmp_path):
    contact, state = state_of(
        contact_of(js.potentials.Exponential(0.01, 0.2)), jnp.full(SHAPE, 0.2)
    )
    films = [js.solids.Film((1.0, 0.5), 0.1, slips=True), js.solids.Film((2.0, 0.2), 0.3)]
    rigid = js.solids.Layered(contact.grid, films, "rigid")
    silicon = js.solids.Crystal((165.64, 63.94, 79.51), ((0, 0, 1), (1, -1, 0), (1, 1, 0)))
    coated = js.solids.Layered(contact.grid, films, silicon)
    crystal = js.solids.Anisotropic(contact.grid, silicon.stiffness)
    graded = js.solids.Graded(contact.grid, 1.0, 0.3, 0.1, 0.5)
    for i, solid in enumerate((rigid, coated, crystal, graded)):
        both = js.Contact(solid, contact.heights, contact.potential), state
        assert_same_bits(both, js.load(js.save(tmp_path / f"{i}.nc", *both)))


def test_a_line_has_one_dimension(tmp_path):
    grid = js.Grid((64,), (1.0,))
    law = js.potentials.Exponential(0.01, 0.1)
    contact = js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros(grid.shape), law)
    gap = 0.1 - js.surfaces.sinusoid(grid, 0.1)
    contact, state = state_of(contact, gap, load=js.MeanPressure)
    assert js.to_dataset(contact, state).gap.dims == ("x",)
    assert js.to_dataset(contact, state)["load"].attrs["units"] == "pressure"
    measured = js.surfaces.Topography(grid, np.asarray(contact.heights), "um", is_periodic=True)
    contact_in_um = js.Contact(contact.solid, measured, law)
    dataset = js.to_dataset(contact_in_um, state)
    assert dataset.solid_grid_lengths.units == dataset.x.units == "µm"
    assert_same_bits((contact, state), js.load(js.save(tmp_path / "line.nc", contact, state)))


def test_the_unit_of_a_surface_is_that_of_eigenvalues(plain):
    contact, sweep = plain
    heights = np.asarray(contact.heights)
    measured = js.surfaces.Topography(contact.grid, heights, "um", is_periodic=True)
    dataset = js.to_dataset(js.Contact(contact.solid, measured, contact.potential), sweep)
    assert dataset.solid_grid_lengths.units == dataset.x.units == "µm"
    assert dataset.cone_eigenvalue.units == "pressure/µm"


def test_the_surface_of_a_result_without_a_unit_can_be_read(plain, tmp_path):
    contact, sweep = plain
    path = js.save(tmp_path / "state.nc", contact, sweep[0].equilibrium)
    surface = js.surfaces.read(path)
    np.testing.assert_array_equal(surface.heights, contact.heights)
    np.testing.assert_allclose(surface.lengths, LENGTHS)
    assert surface.unit is None


def test_a_result_of_another_contact_is_refused(plain, tmp_path):
    contact, sweep = plain
    others = [
        eqx.tree_at(lambda contact: contact.heights, contact, contact.heights[::-1]),
        eqx.tree_at(lambda contact: contact.solid.youngs_modulus, contact, 2.0),
    ]
    for other in others:
        with pytest.raises(ValueError, match=r"no equilibrium of this contact.*it came from"):
            js.save(tmp_path / "other.nc", other, sweep)
    assert not (tmp_path / "other.nc").exists()


def test_a_file_that_the_disk_has_no_room_for_is_an_error_and_leaves_nothing(plain, tmp_path):
    resource = pytest.importorskip("resource")
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, most))
    try:
        with pytest.raises(OSError, match="File too large"):
            js.save(tmp_path / "run.nc", *plain)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))
    assert not list(tmp_path.iterdir())


class Stiffnesses(eqx.Module):
    k_0: jax.Array
    k: tuple[jax.Array, ...]


def test_fields_whose_joined_names_agree_are_kept_apart():
    recorder = Recorder(js.Grid((4, 6)))
    given = Stiffnesses(jnp.array(1.0), (jnp.array(2.0), jnp.array(3.0)))
    structure = recorder.structure(given, ("load",))
    arrays = {name: record.values for name, record in recorder.records.items()}
    assert_same_bits(restore(structure, arrays), given)
