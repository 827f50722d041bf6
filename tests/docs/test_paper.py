"""The method in plain JAX of docs/paper.md beside the library."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import jaxstab as js

PAGE = (Path(__file__).parents[2] / "docs" / "paper.md").read_text()
METHOD = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL).group(1)


@pytest.fixture(scope="module")
def plain():
    names = {}
    exec(METHOD, names)
    return names


def test_the_method_fits_into_eighty_lines_without_the_library():
    assert METHOD.count("\n") <= 80
    assert "jaxstab" not in METHOD


def test_the_table_names_every_equation():
    table = re.search(r"^## Equations\n.*?^## ", PAGE, re.DOTALL | re.MULTILINE)[0]
    named = []
    for cell in re.findall(r"^\| (\(.*?) \|", table, re.MULTILINE):
        assert re.fullmatch(r"\(\d+\)(, \(\d+\))*", cell), cell
        named += map(int, re.findall(r"\d+", cell))
    assert set(named) == set(range(1, 48)) and len(set(named)) == len(named)


# The first state has contact and is stable, the second has an admissible unstable direction.
@pytest.mark.nightly
@pytest.mark.parametrize(("energy", "sign"), [(0.03, 1), (0.1, -1)])
def test_equilibrium_and_cone_eigenvalue_of_a_rough_surface_are_the_librarys(plain, energy, sign):
    grid = js.Grid(32)
    h = js.surfaces.self_affine(grid, jax.random.key(3), k_low=2, k_high=8, rms_height=0.05)
    law = js.potentials.Exponential(energy, 0.1)
    contact = js.Contact(js.HalfSpace(grid, 1.0), h, law)
    state = js.equilibrate(contact, js.MeanDisplacement(0.1))
    stability = js.assess_stability(contact, state)

    gap = plain["equilibrium"](h, 1.0, law, 0.1)
    eigenvalue, mode = plain["cone_eigenvalue"](h, 1.0, law, gap, jax.random.key(0))

    assert jnp.any(gap == 0) and jnp.sign(eigenvalue) == sign
    assert jnp.max(jnp.abs(gap - state.gap)) < 1e-9
    assert jnp.min(jnp.where(gap == 0, mode, 0)) > -1e-7
    assert eigenvalue == pytest.approx(float(stability.cone.eigenvalue), rel=1e-6)
