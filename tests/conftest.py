"""The settings and the shared fixtures of all tests."""

import gc
import os
import pickle
import shutil
import signal
from importlib.metadata import version
from pathlib import Path
from zlib import crc32

# Read where NumPy is imported: workers and subprocesses inherit it, and each has a core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "XLA_FLAGS" not in os.environ:
    # Most of the time goes into compiling, and most of that into making small programs faster. Each
    # worker has one core, and programs in one piece map less memory.
    os.environ["XLA_FLAGS"] = (
        "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1 "
        "--xla_disable_hlo_passes=while-loop-invariant-code-motion"
    )
    if version("jaxlib").startswith("0.10."):
        # Later ones have no other emitters, and end where a flag is not known.
        os.environ["XLA_FLAGS"] += " --xla_cpu_use_fusion_emitters=false"
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # Workers and subprocesses inherit it, and compile nothing large that another one has, or a run
    # before. Where it has grown to a gigabyte, a run begins without it.
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"), "jaxstab-tests")
    if cache.exists() and sum(file.stat().st_size for file in cache.iterdir()) > 1e9:
        shutil.rmtree(cache, ignore_errors=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(cache)
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.2"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    # JAX 0.10 reports each program from a cache as made for another machine.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax
import matplotlib
import pytest
from hypothesis import settings

import jaxstab as js

jax.config.update("jax_enable_x64", True)
# A trace makes many objects that live on, and looking for garbage among them takes a tenth: it is
# looked for once after each module, and only among what that has left.
gc.disable()
matplotlib.use("Agg")
# The same examples each time, and no limit on the time of one, which may be compiled for.
settings.register_profile("few", max_examples=20, derandomize=True, deadline=None, database=None)
settings.load_profile("few")


def pytest_addoption(parser):
    help = "of the tests marked nightly only this eighth, 0 to 7; with -m '' beside the daily ones"
    parser.addoption("--nightly-eighth", type=int, choices=range(8), help=help)


def pytest_collection_modifyitems(config, items):
    """Leave out the nightly tests of the other eighths, which their names tell apart."""
    eighth = config.getoption("--nightly-eighth")
    if eighth is None:
        return
    others = [
        item
        for item in items
        if item.get_closest_marker("nightly") and crc32(item.nodeid.encode()) % 8 != eighth
    ]
    config.hook.pytest_deselected(items=others)
    left_out = set(others)
    items[:] = [item for item in items if item not in left_out]


@pytest.fixture(scope="module", autouse=True)
def few_programs_at_a_time():
    """Compiled programs hold memory maps, of which a process may have 65 530."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > 45_000:
        gc.unfreeze()
        jax.clear_caches()
    gc.collect()
    gc.freeze()


@pytest.fixture
def interruptible():
    """Have Ctrl-C arrive here and in subprocesses, also where the tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def hertz():
    """The adhesive paraboloid of Rey & Bleyer's section 4.1."""
    grid = js.Grid(32)
    heights = js.surfaces.paraboloid(grid, radius=2.0)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(10.0, 1.0))


@pytest.fixture(scope="session")
def unloading():
    """A small version of the rough contact of Rey & Bleyer's section 4.2.3."""
    # Once the precision is set.
    from problems import rough_contact

    return rough_contact(32, js.potentials.Exponential(1e-2, 1.0), youngs_modulus=1e-3)


@pytest.fixture(scope="session")
def shared(tmp_path_factory):
    """Return what a function returns, computed by the first worker that asks for it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    def shared(compute, *arguments):
        file = folder / f"{compute.__name__}.pickle"
        if not file.exists():
            part = folder / f"{compute.__name__}-{os.getpid()}"
            part.write_bytes(pickle.dumps(compute(*arguments)))
            part.replace(file)
        return pickle.loads(file.read_bytes())

    return shared


def follow_loop(hertz):
    turns = js.MeanDisplacement(jax.numpy.array([1.6, 1.2, 1.6]))
    return js.follow(hertz, turns, smallest_jump=1e-5, fields=True)


@pytest.fixture(scope="session")
def loop(shared, hertz):
    """The adhesive paraboloid's path into contact and out again, with a jump on each leg."""
    return shared(follow_loop, hertz)


def follow_rough_path():
    grid = js.Grid(32)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.05)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.06, 0.06))
    turns = js.MeanDisplacement(jax.numpy.array([0.25, 0.02, 0.25]))
    return contact, js.follow(contact, turns, fields=True)


@pytest.fixture(scope="session")
def rough_path(shared):
    """A sticky rough contact, pressed to a small mean gap and lifted again, with its jumps."""
    return shared(follow_rough_path)


def follow_branch(hertz):
    loads = js.MeanDisplacement([1.6, 1.0])
    return js.continuation(hertz, loads, fields=True, max_states=22)


@pytest.fixture(scope="session")
def branch(shared, hertz):
    """The first states of the adhesive paraboloid's curve of equilibria, around its fold."""
    return shared(follow_branch, hertz)


def find_transition(hertz):
    load = js.MeanDisplacement(1.35)
    closed = js.equilibrate(hertz, js.MeanDisplacement(0.8))
    return js.transition(hertz, load, js.equilibrate(hertz, load), closed.gap, num_images=6)


@pytest.fixture(scope="session")
def transition(shared, hertz):
    """The pass of the adhesive paraboloid between contact and none."""
    return shared(find_transition, hertz)


def find_detachment():
    grid = js.Grid((12,), (1.0,))
    heights = js.surfaces.self_affine(grid, jax.random.key(2), k_high=4, rms_height=0.05)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.03, 0.2))
    load = js.MeanPressure(-0.09068)
    start = js.equilibrate(contact, load, initial=jax.numpy.full((12,), 1e-3))
    return contact, js.transition(contact, load, start, None)


@pytest.fixture(scope="session")
def detaching(shared):
    """The pass of a rough line of 12 points to nothing, at nine tenths of its pull-off."""
    return shared(find_detachment)
