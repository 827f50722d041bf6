"""Viscoelastic contacts in time against published solutions, a theorem and another package."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from viscoelastic_lines import ANY, RATIOS, TIMES

import jaxstab as js
from jaxstab.references import persson_brener


def rough(size, seed):
    grid, key = js.Grid(size), jax.random.key(seed)
    heights = js.surfaces.self_affine(grid, key, k_low=2, k_high=8, rms_height=0.02)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), RATIOS, TIMES)
    return js.Contact(solid, heights, js.potentials.NoAdhesion())


@pytest.mark.nightly
@pytest.mark.parametrize(
    "depth", [lambda t: 0.05 * t, lambda t: 0.1 * np.minimum(2 * t, 1)], ids=["ramp", "hold"]
)
def test_a_sphere_is_pressed_by_the_force_of_lee_and_radok(depth):
    times = np.linspace(0, 2, 17)
    grid = js.Grid(48)
    solid = js.Viscoelastic(js.FreeHalfSpace(grid, 1.0), RATIOS, TIMES)
    sphere = js.surfaces.paraboloid(grid, 1.0)
    contact = js.Contact(solid, sphere, js.potentials.NoAdhesion())
    load = js.FarDisplacement(jnp.max(contact.heights) - depth(jnp.array(times)))
    found = js.evolve(contact, load, jnp.array(times), rtol=ANY)
    # F = 4 / (3 R) int E*(t - s) d(a^3), a^2 = R d, of the history linear between the times.
    s = np.linspace(0, 2, 32_001)
    cubes = np.diff(np.interp(s, times, depth(times)) ** 1.5)
    ago = 2 - (s[1:] + s[:-1]) / 2
    relaxing = 1 + sum(r * np.exp(-ago / t) for r, t in zip(RATIOS, TIMES, strict=True))
    assert found.force[-1] == pytest.approx(4 / 3 * relaxing @ cubes, rel=2e-3)


@pytest.mark.nightly
@pytest.mark.parametrize("start", [0.01, 0.06], ids=["loaded", "partly unloaded"])
def test_without_adhesion_the_area_under_a_constant_load_never_falls(start):
    times = jnp.concatenate([jnp.zeros(1), jnp.geomspace(1e-3, 30, 20)])
    for seed in range(3):
        contact = rough(32, seed)
        relaxed = js.Contact(contact.solid.relaxed, contact.heights, contact.potential)
        initial = js.equilibrate(relaxed, js.MeanPressure(start))
        held = js.MeanPressure(jnp.full(times.size, 0.03))
        areas = np.array(js.evolve(contact, held, times, initial=initial).contact_area[1:])
        assert np.all(np.diff(areas) >= 0)
        rest = js.equilibrate(relaxed, held[0])
        assert areas[-1] == rest.contact_area
        # After a partial unloading nothing is remembered.
        assert (areas[0] < areas[-1]) == (start < 0.03)


def test_pressures_are_those_of_tamaas_in_small_steps():
    tamaas = pytest.importorskip("tamaas")
    tamaas.set_log_level(tamaas.LogLevel.error)
    contact, number = rough(32, 0), 200
    times = np.linspace(0, 2, number + 1)
    pressures = 0.01 + 0.02 * np.sin(np.pi * times / 3)
    pressures[0] = 1e-6
    load = js.MeanPressure(jnp.array(pressures))
    found = js.evolve(contact, load, jnp.array(times), rtol=ANY)
    model = tamaas.Model(tamaas.model_type.basic_2d, [1.0, 1.0], [32, 32])
    # Its memory is that of the moduli in a unit in which the relaxed shear modulus is one.
    model.E, model.nu = 2.0, 0.0
    heights = np.array(contact.heights)
    solver = tamaas.MaxwellViscoelastic(model, heights, 1e-10, 2 / number, [*RATIOS], [*TIMES])
    for pressure in pressures[1:]:
        solver.solve(2 * float(pressure))
    theirs = np.asarray(model.traction).reshape(32, 32) / 2
    ours = np.array(found.instant[1].pressure)
    assert np.mean(theirs > 0) == found.contact_area[-1]
    assert np.sqrt(np.mean((ours - theirs) ** 2) / np.mean(theirs**2)) < 1e-3


@pytest.mark.nightly
def test_a_crack_takes_the_work_of_persson_and_brener():
    # Along a bonded layer, of a base pulled slowly away, the energy per area is E u^2 / (2 h).
    size, tip, work, ratio = 1024, 2 / 1024, 1e-4, 4.0
    depth, grid = 60 * tip, js.Grid((size,))
    solid = js.Viscoelastic(js.Layer(grid, 1.0, 0.0, depth), ratio, 1.0)
    law = js.potentials.Exponential(work, np.sqrt(np.pi * tip * work))
    contact = js.Contact(solid, jnp.zeros(size), law)
    pulled, opened = np.sqrt(2 * depth * work), 3 * depth
    is_open = jnp.abs(grid.coordinates[0] - 0.5) > (1 - opened) / 2
    relaxed = js.Contact(solid.relaxed, contact.heights, law)
    initial = jnp.where(is_open, pulled, 0.0)
    start = js.equilibrate(relaxed, js.MeanGap(opened * pulled), initial=initial)
    # The radius of the tip of a slow crack: to first order in the speed v a crack dissipates
    # v r t int u' K u' dx, with u its elastic shape.
    q = 2j * np.pi * np.fft.rfftfreq(size, 1 / size)
    slope = np.fft.irfft(q * np.fft.rfft(np.array(start.gap)), size)
    radius = 2 * np.pi * work / np.mean(slope * np.array(solid.relaxed.apply(slope)))
    way = np.linspace(0, (1 - opened) / 2 - depth, 201)
    planned = 0.01 * radius * 20 ** (way / way[-1])
    times = 10 + np.append(0, np.cumsum(np.diff(way) / np.sqrt(planned[1:] * planned[:-1])))
    driving = persson_brener.work(planned, [ratio], [1.0], radius)
    far = float(jnp.mean(start.gap) - start.mean_pressure * depth)
    values = jnp.append(far, jnp.sqrt(2 * depth * work * driving))
    found = js.evolve(
        contact,
        js.FarDisplacement(values),
        jnp.append(0.0, times),
        initial=start,
        fields=True,
        max_steps=4000,
    )
    half = np.array(found.fields.gap)[1:, : size // 2]
    place = np.argmax(half < law.length, axis=1)
    before, after = (half[np.arange(place.size), place - i] for i in (1, 0))
    edges = (place - 1 + (before - law.length) / (before - after)) / size
    chosen = np.arange(60, 190, 20)
    speeds = (edges[chosen + 10] - edges[chosen - 10]) / (times[chosen + 10] - times[chosen - 10])
    expected = persson_brener.work(speeds, [ratio], [1.0], radius)
    assert speeds[-1] > 4 * speeds[0] and driving[chosen[-1]] > 1.5
    assert driving[chosen] == pytest.approx(expected, rel=0.1)
