"""The texts of programs, which a process leaves to the next."""

import errno
import hashlib
import os
import subprocess
import sys
from datetime import datetime

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from programs import compilations, on_the_cpu

import jaxstab as js
from jaxstab.core import program_texts
from jaxstab.core.stored_programs import StoredProgram

pytestmark = on_the_cpu

SCRIPT = """
import json, sys, jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import jaxstab as js

def law(gap):
    return -0.05 * jnp.exp(-gap / 0.1)

def fail(*_):
    raise AssertionError("A solver is traced.")

if "no traces" in sys.argv:
    jax.lax.while_loop = fail
grid = js.Grid(8)
contact = js.Contact(js.HalfSpace(grid, 1.0), js.surfaces.sinusoid(grid, 0.05), law)
state = js.equilibrate(contact, js.MeanGap(0.04))
stability = js.assess_stability(contact, state)
numbers = state.mean_pressure, stability.cone.eigenvalue, stability.lower_bound.eigenvalue
print(json.dumps([*(float(x).hex() for x in numbers), str(stability.verdict)]))
"""


def run(folder, *arguments):
    """Return what a process computes."""
    variables = {"JAX_COMPILATION_CACHE_DIR": str(folder), "JAXSTAB_CACHE": "1"}
    command = [sys.executable, "-c", SCRIPT, *arguments]
    return subprocess.run(command, env=os.environ | variables, capture_output=True, text=True)


def test_the_next_process_traces_no_solver_and_computes_the_same(tmp_path, capsys):
    pytest.importorskip("flatbuffers")
    assert "A solver is traced." in run(tmp_path, "no traces").stderr
    for arguments in [], ["no traces"]:
        process = run(tmp_path, *arguments)
        assert process.returncode == 0, process.stderr
    # Here no texts are kept.
    exec(SCRIPT, {})
    assert process.stdout == capsys.readouterr().out


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder for texts, and functions of these tests as if they were jaxstab's own."""
    pytest.importorskip("flatbuffers")
    before = jax.config.values["jax_compilation_cache_dir"]
    monkeypatch.setenv("JAXSTAB_CACHE", "1")
    # Files may have been edited since the tests began.
    monkeypatch.setattr(program_texts, "_STARTED", datetime.now())
    for function in attraction, double:
        monkeypatch.setattr(function, "__module__", "jaxstab.core")
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "jaxstab"
    jax.config.update("jax_compilation_cache_dir", before)


TRACES = []


def attraction(law, gap, factor=1):
    TRACES.append(law)
    return {"attraction": factor * law(gap)}


def program(function=attraction, **options):
    """Return a program as in a process of its own, which has compiled nothing yet."""
    return StoredProgram(function, {}, **{"static_argnames": "factor"} | options)


def law_of(function):
    """Return a law as a contact holds it, without keeping the programs that look at it."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("JAXSTAB_CACHE", "0")
        return js.Contact(js.HalfSpace(js.Grid(4), 1.0), jnp.zeros((4, 4)), function).potential


def is_traced(function, *args, **kwargs):
    """Whether a new process traces a program, that must return what its function returns."""
    gap = jnp.linspace(0.1, 1.0, 5)
    expected = attraction(*args, gap, **kwargs)["attraction"]
    before = len(TRACES)
    found = function(*args, gap, **kwargs)["attraction"]
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    return len(TRACES) > before


def double(tree, by):
    return {name: by * leaf for name, leaf in tree.items()}


def test_what_is_compiled_ahead_is_not_compiled_again():
    tree = {"number": np.float64(1.5), "field": np.ones(3), "known": jnp.ones((2, 2), jnp.float32)}
    with compilations() as compiled:
        doubled = program(double, static_argnames="by")
        shapes = doubled.ahead(tree, by=2)
        # They are those of the arguments.
        assert doubled.ahead(shapes, by=2) == shapes
        found = doubled(tree, by=2)
    assert compiled.count("jit(double)") == 1
    for name, leaf in found.items():
        np.testing.assert_array_equal(leaf, 2 * np.asarray(tree[name]))
        assert (leaf.shape, leaf.dtype) == (shapes[name].shape, shapes[name].dtype)


def texts(folder):
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []


def test_a_text_is_found_by_what_a_law_computes_and_not_by_its_name(folder):
    def exponential(gap):
        return -0.5 * jnp.exp(-gap / 0.1)

    assert is_traced(program(), law_of(exponential))
    assert not is_traced(program(), law_of(lambda gap: -0.5 * jnp.exp(-gap / 0.1)))
    assert is_traced(program(), law_of(lambda gap: -0.6 * jnp.exp(-gap / 0.1)))
    assert is_traced(program(), law_of(lambda gap: -0.5 * jnp.exp(-gap / 0.2)))
    # What a law closes over is an argument of the program.
    short, long = jnp.asarray([0.1]), jnp.asarray([0.3])
    assert is_traced(program(), law_of(lambda gap: -0.5 * jnp.exp(-gap / short[0])))
    assert not is_traced(program(), law_of(lambda gap: -0.5 * jnp.exp(-gap / long[0])))
    assert is_traced(program(), law_of(js.potentials.Exponential(0.5, 0.1)))
    assert not is_traced(program(), law_of(js.potentials.Exponential(0.7, 0.2)))


def test_a_static_argument_belongs_to_the_name(folder):
    law = law_of(js.potentials.Exponential(0.5, 0.1))
    assert is_traced(program(), law, factor=2)
    assert is_traced(program(), law, factor=3)
    assert not is_traced(program(), law, factor=2)


@jax.custom_jvp
def ruled(gap):
    return -jnp.exp(-gap)


ruled.defjvp(lambda primals, tangents: (ruled(*primals), -ruled(*primals) * tangents[0]))


class OwnLaw(eqx.Module):
    energy: jax.Array

    def __call__(self, gap):
        return -self.energy * jnp.exp(-gap)


def test_nothing_is_kept_of_what_only_this_process_knows(folder, monkeypatch):
    for law in law_of(ruled), law_of(OwnLaw(jnp.asarray(0.5))):
        assert is_traced(program(), law)
    assert not texts(folder)
    monkeypatch.setattr(attraction, "__module__", "laws")
    assert is_traced(program(), law_of(js.potentials.Exponential(0.5, 0.1)))
    assert not texts(folder)


def test_a_program_that_calls_python_has_no_text(folder):
    seen = []

    def watched(law, gap):
        jax.debug.callback(lambda _: seen.append(1), gap)
        return attraction(law, gap)

    watched.__qualname__, watched.__module__ = "watched", "jaxstab.core"
    law = law_of(js.potentials.Exponential(0.5, 0.1))
    for count in 1, 2:
        program(watched, static_argnames=())(law, jnp.ones(3))
        jax.effects_barrier()
        assert len(seen) == count
    (path,) = folder.iterdir()
    assert path.stat().st_size == hashlib.sha256().digest_size


def test_another_source_or_setting_has_other_texts(folder, monkeypatch):
    law = law_of(js.potentials.Exponential(0.5, 0.1))
    assert is_traced(program(), law) and not is_traced(program(), law)
    with jax.default_matmul_precision("highest"):
        assert is_traced(program(), law) and not is_traced(program(), law)
    with monkeypatch.context() as patched:
        patched.setattr(np, "__version__", "another")
        program_texts._versions.cache_clear()
        assert is_traced(program(), law) and not is_traced(program(), law)
    program_texts._versions.cache_clear()
    num_texts = len(texts(folder))
    with jax.debug_nans(True):
        program()(law, jnp.ones(7))
    assert len(texts(folder)) == num_texts


def test_a_patched_process_neither_finds_texts_nor_leaves_any_to_others(folder, monkeypatch):
    law = law_of(js.potentials.Exponential(0.5, 0.1))
    assert is_traced(program(), law) and not is_traced(program(), law)
    with monkeypatch.context() as patched:
        patched.setattr(js.potentials.Exponential, "number", 2, raising=False)
        assert is_traced(program(), law)
    num_texts = len(texts(folder))
    assert num_texts == 2
    with monkeypatch.context() as patched:
        patched.setattr(js.potentials.Exponential, "helper", lambda: 2, raising=False)
        assert is_traced(program(), law)
    monkeypatch.setattr(program_texts, "_STARTED", datetime(2000, 1, 1))
    assert is_traced(program(), law)
    assert len(texts(folder)) == num_texts


def test_programs_are_dropped_with_all_that_jax_has_compiled():
    doubled = program(double, static_argnames="by")
    for compilations_expected in 1, 0:
        with compilations() as compiled:
            doubled({"value": jnp.ones(11)}, by=2)
        assert compiled.count("jit(double)") == compilations_expected
    jax.clear_caches()
    with compilations() as compiled:
        doubled({"value": jnp.ones(11)}, by=2)
    assert compiled.count("jit(double)") == 1


def test_numbers_keep_no_weak_type_and_static_arguments_have_their_type(folder):
    for _ in range(2):
        doubled = program(double, static_argnames="by")
        found = doubled({"value": 1.5}, by=2)["value"]
        assert not found.weak_type and found == 3
        integers = {"value": jnp.arange(3)}
        assert doubled(integers, by=2)["value"].dtype == integers["value"].dtype
        assert jnp.issubdtype(doubled(integers, by=2.0)["value"].dtype, jnp.floating)


def test_a_file_that_is_not_what_was_written_is_written_anew(folder):
    law = law_of(js.potentials.Exponential(0.5, 0.1))
    assert is_traced(program(), law)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    for torn in whole[:-1], whole[: len(whole) // 2], b"", whole[:-1] + b"x":
        path.write_bytes(torn)
        assert is_traced(program(), law)
        assert not is_traced(program(), law)


def test_a_folder_that_cannot_be_used_is_no_error(folder, monkeypatch):
    law = law_of(js.potentials.Exponential(0.5, 0.1))

    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(program_texts.Path, "replace", fail)
        assert is_traced(program(), law)
        assert not texts(folder)
    folder.rmdir()
    folder.touch()
    assert is_traced(program(), law)
    assert folder.read_bytes() == b""


def test_the_texts_read_last_are_the_last_to_be_dropped(folder, monkeypatch):
    laws = [law_of(lambda gap, depth=depth: -depth * gap) for depth in (0.1, 0.2, 0.3)]
    assert is_traced(program(), laws[0])
    (path,) = folder.iterdir()
    monkeypatch.setattr(program_texts, "_MAX_SIZE", int(2.5 * path.stat().st_size))
    path.unlink()
    assert is_traced(program(), laws[0])
    assert is_traced(program(), laws[1])
    assert not is_traced(program(), laws[0])
    assert is_traced(program(), laws[2])
    assert len(texts(folder)) == 2
    assert not is_traced(program(), laws[0])
    assert is_traced(program(), laws[1])
