import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from jaxstab.core import compile as compiling
from jaxstab.core.compile import program

SOLVE = """
import sys
import jax
before = dict(jax.config.values)
import jaxstab as js
assert not {"matplotlib", "optax"} & set(sys.modules), "imported too early"
grid = js.Grid(8)
law = js.potentials.Exponential(0.05, 0.1)
contact = js.Contact(js.HalfSpace(grid, 1.0), js.surfaces.sinusoid(grid, 0.05), law)
js.equilibrate(contact, js.MeanGap(0.1))
assert {name: jax.config.values[name] for name in before} == before
"""


def test_a_solve_sets_nothing_and_writes_no_file(tmp_path, monkeypatch):
    for name in ("HOME", "XDG_CACHE_HOME", "TMPDIR"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    subprocess.run([sys.executable, "-c", SOLVE], check=True, timeout=300)
    # CUDA keeps a folder of its own.
    assert [path for path in tmp_path.iterdir() if path.name != ".nv"] == []


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere mappings are not counted")
def test_an_error_tells_the_cure_before_memory_mappings_run_out(monkeypatch):
    double = program(lambda value: 2 * value)
    np.testing.assert_array_equal(double(jnp.ones(2)), 2)
    # As if nearly all were taken.
    monkeypatch.setattr(compiling, "MOST_MAPPINGS", 0)
    with pytest.raises(MemoryError, match=r"memory mappings.* jax\.clear_caches\(\)"):
        double(jnp.ones(3))
    # A compiled program needs no more of them.
    np.testing.assert_array_equal(double(jnp.ones(2)), 2)
