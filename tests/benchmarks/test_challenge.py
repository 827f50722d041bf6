"""The reader of the contact-mechanics challenge, on small surfaces in the forms of its files."""

import json
import sys
from pathlib import Path

import h5py
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
N = 16
X = np.arange(N) / N
# Waves and their amplitudes; no symmetry would hide a swapped axis or a lost phase.
WAVES = [(1, 0, 0.02, 0.01), (0, 2, -0.01, 0.03), (2, -1, 0.004, 0.0), (-3, 5, 0.0, -0.002)]


def heights():
    """Return the sum of h(q) exp(i q.x) and its conjugate, in units of 0.1 mm."""
    x, y = np.meshgrid(X, X, indexing="ij")
    phases = [2 * np.pi * (a * x + b * y) for a, b, *_ in WAVES]
    terms = [
        2 * (re * np.cos(phase) - im * np.sin(phase))
        for (*_, re, im), phase in zip(WAVES, phases, strict=True)
    ]
    return np.sum(terms, axis=0)


def as_matrix(path):
    np.savetxt(path, heights(), header="h(x, y)")


def as_points(path):
    x, y = np.meshgrid(X, X, indexing="ij")
    with path.open("w") as file:
        file.write("# x, y, h\n")
        for block in np.stack([x, y, heights()], axis=-1):
            np.savetxt(file, block, delimiter=", ")
            file.write("\n")


def as_hdf5(path):
    with h5py.File(path, "w") as file:
        file["surface"] = heights()


def as_half_of_the_coefficients(path):
    np.savetxt(path, WAVES, header="qX, qY, Re, Im", delimiter=", ")


def as_all_coefficients(path):
    both = [*WAVES, *((-a, -b, re, -im) for a, b, re, im in WAVES)]
    with h5py.File(path, "w") as file:
        file["fourier"] = np.array(both)


FORMS = [as_matrix, as_points, as_hdf5, as_half_of_the_coefficients, as_all_coefficients]


@pytest.fixture
def challenge(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import challenge

    yield challenge
    sys.modules.pop("challenge")


@pytest.mark.parametrize("write", FORMS)
def test_each_form_is_read(write, challenge, tmp_path):
    write(tmp_path / "surface")
    np.testing.assert_allclose(
        challenge.read_surface(tmp_path / "surface"), 1e-4 * heights(), rtol=1e-9, atol=1e-18
    )


def test_coefficients_are_summed_on_finer_grids(challenge, tmp_path):
    as_half_of_the_coefficients(tmp_path / "surface")
    fine = challenge.read_surface(tmp_path / "surface", 48)
    np.testing.assert_allclose(fine[::3, ::3], 1e-4 * heights(), rtol=1e-9, atol=1e-18)
    with pytest.raises(ValueError, match="10 points do not resolve wave 5: give more than 10"):
        challenge.read_surface(tmp_path / "surface", 10)


def test_other_files_are_refused(challenge, tmp_path):
    np.savetxt(tmp_path / "surface", np.ones((4, 7)))
    with pytest.raises(ValueError, match="4 rows of 7 numbers"):
        challenge.read_surface(tmp_path / "surface")


@pytest.mark.nightly
def test_area_gap_and_distributions_stand_beside_published_numbers(challenge, tmp_path):
    as_hdf5(tmp_path / "surface")
    published = {"area": [[1e5, 0.02], [4e5, 0.05]], "gaps": [[0.0, 1e3], [1.0, 1e3]]}
    (tmp_path / "reference").write_text(json.dumps(published))
    rows = list(challenge.challenge_rows(tmp_path / "surface", tmp_path / "reference"))
    found = {row.setting.partition("²")[2]: row for row in rows}
    solid, load = js.HalfSpace(js.Grid(N, 1e-4), 25e6), js.MeanPressure(250e3)
    laws = js.potentials.NoAdhesion(), js.potentials.Exponential(50e-3, 2.071e-9)
    bare, contact = (js.Contact(solid, jnp.asarray(1e-4 * heights()), law) for law in laws)
    state = js.equilibrate(contact, load, initial=js.equilibrate(bare, load))
    at = ", adhesive, 250 kPa: "
    area = found[at + "contact as counted [%]"]
    np.testing.assert_allclose(area.ours, 100 * state.contact_area)
    np.testing.assert_allclose(area.published, 3.5)
    gap = found[at + "mean gap [µm]"]
    np.testing.assert_allclose(gap.ours, 1e6 * state.gap.mean(), rtol=1e-6)
    assert gap.published == "in the publication"
    densities = [r for r in rows if "adhesive: density at a gap" in r.setting]
    places = [float(r.setting.split(" of ")[1].split()[0]) for r in densities]
    share = sum(r.ours for r in densities) * (places[1] - places[0])
    np.testing.assert_allclose(share, 1 - area.ours / 100, atol=0.02)
    np.testing.assert_allclose([r.published for r in densities], 1e-3)
