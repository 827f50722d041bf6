"""First calls compile the programs of searches, and no single operation of `jax.numpy` beside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from programs import compilations, on_the_cpu

import jaxstab as js

NAMES = {*dir(jnp), *dir(jnp.ndarray), "select_n", "dynamic_slice", "broadcast_in_dim", "add_any"}
# Sizes of a grid that nothing before has asked for.
OWN = {"area", "cell_area", "spacing"}
# Numbers of points of their own, for which nothing has been compiled before.
LINE, SQUARE, OTHER = js.Grid((26,), (1.0,)), js.Grid(18), js.Grid(14)
WAVE = np.cos(2 * np.pi * np.arange(18) / 18)
WAVE_OF_LINE = np.cos(2 * np.pi * np.arange(26) / 26)
LAW = js.potentials.Exponential(0.02, 0.1)
TIMES = np.array([0.0, 1.0])
# The most programs of a call, what is computed before it, and the call.
QUICK = {
    "self_affine": (3, "nothing", lambda key: js.surfaces.self_affine(OTHER, key, k_high=4, **RMS)),
    "power_spectrum": (1, "nothing", lambda _: js.surfaces.power_spectrum(SQUARE, ROUGH)),
    "patches": (2, "rough", lambda known: js.patches(*known)),
    "conductance": (1, "rough", lambda known: js.conductance(*known, (1.0, 1.0))),
    "leakage": (1, "rough", lambda known: js.leakage(*known, 1.0)),
}
SLOW = {
    "equilibrate": (9, "line", lambda known: js.equilibrate(known[0], LOAD[0])),
    "assess_stability": (15, "line", lambda known: js.assess_stability(*known)),
    "lowest_modes": (10, "line", lambda known: js.lowest_modes(*known, count=2)),
    "sweep": (19, "line", lambda known: js.sweep(known[0], LOAD)),
    "continuation": (23, "line", lambda known: js.continuation(known[0], LOAD)),
    "follow": (15, "line", lambda known: js.follow(known[0], LOAD)),
    "pull_off": (38, "line", lambda known: js.pull_off(known[0])),
    "relax_along": (11, "line", lambda known: js.relax_along(*known, WAVE_OF_LINE, amplitude=1e-4)),
    "easiest_exit": (24, "line", lambda known: js.easiest_exit(*known, throw=False)),
    "observe": (8, "path", lambda known: js.observe(*known, js.patches)),
    "evolve": (11, "viscous", lambda known: js.evolve(known[0], LOAD, TIMES)),
    "growth_rate": (7, "viscous", lambda known: js.growth_rate(known[1])),
}
RMS = {"rms_height": 0.1}
ROUGH = np.outer(WAVE, WAVE) / 10
LOAD = js.MeanGap(np.array([0.3, 0.1]))


def known_before(name):
    """Return the contact, and its state, path or evolution, that a call takes."""
    if name == "nothing":
        return jax.random.key(0)
    if name == "rough":
        contact = js.Contact(js.HalfSpace(SQUARE, 1.0), ROUGH, LAW)
        return contact, js.equilibrate(contact, js.MeanGap(0.05))
    solid = js.HalfSpace(LINE, 1.0)
    if name == "viscous":
        solid = js.Viscoelastic(solid, np.array([1.0]), np.array([1.0]))
    contact = js.Contact(solid, WAVE_OF_LINE / 10, LAW)
    if name == "line":
        return contact, js.equilibrate(contact, LOAD[1])
    if name == "path":
        return contact, js.follow(contact, LOAD, fields=True)
    return contact, js.evolve(contact, LOAD, TIMES, fields=True)[1]


@on_the_cpu
@pytest.mark.filterwarnings("ignore:fewer than 5 points")
@pytest.mark.parametrize(
    ("most", "before", "call"),
    [
        *(pytest.param(*rest, id=name) for name, rest in QUICK.items()),
        *(pytest.param(*rest, id=name, marks=pytest.mark.nightly) for name, rest in SLOW.items()),
    ],
)
def test_a_first_call_compiles_few_programs_and_no_single_operation(most, before, call):
    known = known_before(before)
    # Not even what came before it is compiled.
    jax.clear_caches()
    with compilations() as compiled:
        call(known)
    names = [name.removeprefix("jit(").removesuffix(")").lstrip("_") for name in compiled]
    assert {*names} & NAMES <= OWN
    assert 0 < len(names) <= most, names
