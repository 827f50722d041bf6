"""Problems that several tests share."""

import atexit
import gc
import os
import shutil
import signal
import tempfile
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from unittest import mock

# Read where NumPy is imported: workers and subprocesses inherit it, and each has a core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "XLA_FLAGS" not in os.environ:
    # Most of the time goes into compiling, and most of that into making small programs faster.
    os.environ["XLA_FLAGS"] = (
        "--xla_backend_optimization_level=0 "
        "--xla_disable_hlo_passes=while-loop-invariant-code-motion"
    )
    if version("jaxlib").startswith("0.10."):
        # Later ones have no other emitters, and end where a flag is not known.
        os.environ["XLA_FLAGS"] += " --xla_cpu_use_fusion_emitters=false"
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # Workers and subprocesses inherit it, and compile nothing that another one has.
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="jaxstab-programs-")
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    # JAX 0.10 reports each program from a cache as made for another machine.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest

import jaxstab as js
from jaxstab import potentials
from jaxstab.core import batching
from jaxstab.core.compile import num_pieces
from jaxstab.core.history import History

jax.config.update("jax_enable_x64", True)
# A trace makes many objects that live on, and looking for garbage among them takes a twentieth.
gc.set_threshold(100_000, 20, 20)
matplotlib.use("Agg")

# For what is compared with finite differences.
TIGHT = js.PreconditionedConjugateGradient(tolerance=1e-12)


@pytest.fixture(scope="module", autouse=True)
def few_programs_at_a_time():
    """Compiled programs hold memory maps, of which a process may have 65 530."""
    yield
    if num_pieces() > 20_000:
        jax.clear_caches()


@pytest.fixture
def interruptible():
    """Have Ctrl-C arrive here and in subprocesses, also where the tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@contextmanager
def beside_an_accelerator():
    """Trace programs as where JAX finds one."""
    jax.clear_caches()
    try:
        with mock.patch.object(batching, "has_accelerator", lambda: True):
            yield
    finally:
        # Or the next test gets this one's programs.
        jax.clear_caches()


@contextmanager
def compilations():
    """Yield a growing list of the programs compiled, or taken from a cache on disk, by name."""
    compiled = []

    def listen(event, _, fun_name="", **__):
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(fun_name)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield compiled
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.fixture(scope="session")
def hertz():
    """The adhesive paraboloid of Rey & Bleyer's section 4.1."""
    grid = js.Grid(32)
    heights = js.surfaces.paraboloid(grid, radius=2.0)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(10.0, 1.0))


@pytest.fixture(scope="session")
def unloading():
    """A small version of the rough contact of Rey & Bleyer's section 4.2.3."""
    return rough_contact(32, js.potentials.Exponential(1e-2, 1.0), youngs_modulus=1e-3)


def rough_contact(n, potential, youngs_modulus=1.0, seed=0, rms_height=0.1):
    grid = js.Grid(n)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(seed), k_high=min(32, n // 4), rms_height=rms_height
    )
    return js.Contact(js.HalfSpace(grid, youngs_modulus), heights, potential)


def bisected(contact, load, start, step, holds=lambda state: True, resolution=1e-9):
    """Return the last load at which a warm-started equilibrium holds, by ever smaller steps."""
    state, value = js.equilibrate(contact, load(start)), start
    while abs(step) > resolution:
        new = js.equilibrate(contact, load(value + step), initial=state, throw=False)
        if new.result == "successful" and holds(new):
            state, value = new, value + step
        else:
            step /= 2
    return value


def with_parameters(contact, energy, length, modulus):
    solid = js.HalfSpace(contact.grid, modulus)
    return js.Contact(solid, contact.heights, js.potentials.Exponential(energy, length))


def state_of(contact, gap, reaction=1.0, load=js.MeanGap):
    """Return a contact with the same Hessian at a gap, and that gap as its equilibrium.

    The heights are such that the elastic pressure balances reaction and attraction.
    """
    touches = gap == 0
    reaction = jnp.where(touches, reaction, 0.0)
    pressure = reaction - potentials.slope(contact.potential, gap)
    displacement = contact.solid.displacement(pressure)
    contact = eqx.tree_at(lambda contact: contact.heights, contact, displacement - gap)
    mean_pressure = jnp.mean(pressure)
    state = js.Equilibrium(
        load=load(mean_pressure if load is js.MeanPressure else jnp.mean(gap)),
        displacement=displacement,
        gap=gap,
        pressure=pressure,
        reaction=reaction,
        in_contact=touches,
        mean_pressure=mean_pressure,
        contact_area=jnp.mean(touches),
        area=contact.grid.area,
        energy=contact.energy(gap),
        residual=jnp.array(1e-9),
        num_steps=jnp.array(0),
        result=js.RESULTS.successful,
        history=History.empty(["residual"]),
    )
    return contact, state


def check_optimality(contact, equilibrium, tolerance):
    """Assert equations 9 and 10 field by field, on the equilibrium that is returned."""
    pressure, reaction, gap = (
        np.asarray(x) for x in (equilibrium.pressure, equilibrium.reaction, equilibrium.gap)
    )
    attraction = np.asarray(jnp.vectorize(jax.grad(contact.potential))(equilibrium.gap))
    scale = np.sqrt(np.mean(pressure**2 + attraction**2))
    error = np.sqrt(np.mean((pressure + attraction - reaction) ** 2))
    assert error <= tolerance * scale
    assert gap.min() >= 0
    assert reaction.min() >= -tolerance * scale * np.sqrt(gap.size)
    assert not (reaction * gap).any()
    assert not reaction[~np.asarray(equilibrium.in_contact)].any()
    np.testing.assert_allclose(pressure.mean(), equilibrium.mean_pressure, rtol=1e-6)
    np.testing.assert_allclose((reaction - attraction).mean(), equilibrium.mean_pressure)
    elastic = np.asarray(contact.solid.pressure(equilibrium.displacement))
    np.testing.assert_allclose(pressure - pressure.mean(), elastic, atol=1e-6 * scale)


def lennard_jones_force(separation, energy, length):
    x = length / separation
    return energy / 2 * 9 * (x**4 - x**10) / length


def dense_hessian(contact, gap):
    n = gap.size
    columns = jax.vmap(contact.hessian(gap))(jnp.eye(n).reshape(n, *gap.shape))
    return np.asarray(columns).reshape(n, n)


@cache
def zero_mean_basis(size):
    """Return orthonormal vectors of zero mean, as rows."""
    return np.linalg.svd(np.ones((1, size)))[2][1:]


def smallest_on_zero_mean(matrix):
    """Return the smallest eigenvalue on the space of zero mean, by dense algebra."""
    basis = zero_mean_basis(len(matrix))
    return np.linalg.eigvalsh(basis @ matrix @ basis.T).min(initial=np.inf)


def smallest_on_critical_cone(contact, equilibrium):
    """Return the smallest eigenvalue where contact points stay and the rest keeps its mean."""
    free = ~np.asarray(equilibrium.in_contact).ravel()
    return smallest_on_zero_mean(dense_hessian(contact, equilibrium.gap)[np.ix_(free, free)])


def smallest_on_cone(matrix, touching):
    """Return the smallest eigenvalue on V0+ by looking at each of its faces.

    From the largest face down: on a part of a face no eigenvalue is smaller than on all of it.
    """
    free, smallest = np.flatnonzero(~touching), np.inf
    faces = {tuple(np.flatnonzero(touching))}
    while faces:
        parts = set()
        for lifting in faces:
            face = np.concatenate([free, np.array(lifting, int)])
            if len(face) < 2:
                continue
            basis = zero_mean_basis(len(face))
            values, vectors = np.linalg.eigh(basis @ matrix[np.ix_(face, face)] @ basis.T)
            for value, vector in zip(values, vectors.T @ basis, strict=True):
                if value >= smallest:
                    break
                lifts = vector[len(free) :]
                if (lifts > -1e-12).all() or (lifts < 1e-12).all():
                    smallest = value
            if values[0] < smallest:
                parts |= {lifting[:i] + lifting[i + 1 :] for i in range(len(lifting))}
        faces = parts
    return smallest
