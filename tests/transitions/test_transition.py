"""Passes between two equilibria at one load."""

import heapq
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import dense_hessian, on_zero_mean
from problems import with_parameters

import jaxstab as js
from jaxstab.references import maugis

LINE = js.Grid((3,), (1.0,))
PROFILE = np.array([0.0, -0.07, -0.2])
STRENGTH, RANGE, MEAN_GAP = 0.08, 0.05, 0.1


def energies(gaps):
    """Return the energy of gaps on the line, from the symbol of K alone."""
    q = 2 * np.pi * np.abs(np.fft.fftfreq(3, 1 / 3))
    spectrum = np.fft.fft(gaps + PROFILE, axis=-1)
    elastic = np.sum(q / 2 * np.abs(spectrum) ** 2, axis=-1) / 3 / 2
    return (elastic - STRENGTH * np.sum(np.exp(-gaps / RANGE), axis=-1)) / 3


def flooded(start, end, number=401):
    """Return the least height from which water covers a way between two gaps of this mean."""
    total = 3 * MEAN_GAP
    ticks = np.linspace(0, total, number)
    first, second = np.meshgrid(ticks, ticks, indexing="ij")
    third = total - first - second
    height = energies(np.stack([first, second, third], axis=-1))
    height[third < -1e-12] = np.inf
    place = [tuple(np.rint(gap[:2] / ticks[1]).astype(int)) for gap in (start, end)]
    best, queue = np.full(height.shape, np.inf), [(height[place[0]], place[0])]
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    while queue:
        level, (i, j) = heapq.heappop(queue)
        if (i, j) == place[1]:
            return level
        if best[i, j] <= level:
            continue
        best[i, j] = level
        for k, m in ((i + di, j + dj) for di, dj in steps):
            if 0 <= k < number and 0 <= m < number and best[k, m] == np.inf:
                heapq.heappush(queue, (max(level, height[k, m]), (k, m)))
    return np.inf


@pytest.mark.nightly
def test_the_pass_is_the_lowest_that_flooding_finds():
    solid = js.HalfSpace(LINE, youngs_modulus=1.0, poisson_ratio=0.0)
    contact = js.Contact(solid, PROFILE, js.potentials.Exponential(STRENGTH, RANGE))
    load = js.MeanGap(MEAN_GAP)
    states = []
    for corner in np.vstack([np.eye(3), 1 - np.eye(3)]):
        state = js.equilibrate(contact, load, initial=0.01 * MEAN_GAP + 3 * MEAN_GAP * corner)
        if all(np.max(np.abs(state.gap - other.gap)) > 1e-3 for other in states):
            states.append(state)
    assert len(states) >= 2
    for one, other in itertools.pairwise(states):
        found = js.transition(contact, load, one, other)
        np.testing.assert_allclose(energies(np.asarray(one.gap)), one.energy, rtol=1e-12)
        level = flooded(np.asarray(one.gap), np.asarray(other.gap))
        np.testing.assert_allclose(found.barrier.there, level - one.energy, rtol=1e-3)


@pytest.fixture
def detachment(hertz, transition):
    return hertz, transition


def test_the_saddle_has_one_way_down_to_either_end(detachment):
    contact, found = detachment
    saddle = found.saddle
    assert saddle.residual < 1e-9
    free = np.asarray(saddle.gap).ravel() > 0
    hessian = dense_hessian(contact, saddle.gap)[np.ix_(free, free)]
    values = on_zero_mean(hessian)
    assert np.sum(values < 0) == 1
    mode = np.asarray(found.mode).ravel()[free]
    np.testing.assert_allclose(mode @ hessian @ mode, values[0], rtol=1e-2)
    for side, end in zip(found.minima, (found.start, found.end), strict=True):
        np.testing.assert_allclose(side.gap, end.gap, atol=1e-6)
    assert found.start.contact_area == 0 < found.end.contact_area
    heights = saddle.energy - np.array([found.start.energy, found.end.energy])
    np.testing.assert_allclose(found.barrier, heights, rtol=1e-9)


@pytest.mark.nightly
def test_its_barriers_have_the_derivatives_of_differences(detachment):
    contact, at = detachment

    def barriers(energy, value):
        load, other = js.MeanDisplacement(value), with_parameters(contact, energy, 1.0, 1.0)
        found = js.transition(other, load, at.start, at.end, num_images=6)
        return jnp.stack(found.barrier)

    rates = jax.jacrev(barriers, (0, 1))(10.0, 1.35)
    for rate, step in zip(rates, np.eye(2), strict=True):
        ends = [barriers(10.0 + s * 1e-4 * step[0], 1.35 + s * 1e-4 * step[1]) for s in (1, -1)]
        np.testing.assert_allclose(rate, (ends[0] - ends[1]) / 2e-4, rtol=1e-6)


def test_second_derivatives_of_barriers_are_nan_and_those_of_no_pass_too(detachment):
    contact, at = detachment

    def there(energy, value=1.35):
        load, other = js.MeanDisplacement(value), with_parameters(contact, energy, 1.0, 1.0)
        options = {"num_images": 6, "throw": False}
        return js.transition(other, load, at.start.gap, at.end.gap, **options).there

    assert np.isnan(jax.grad(jax.grad(there))(10.0))
    assert np.isnan(jax.jvp(lambda value: there(10.0, value), (1.6,), (1.0,))[1])


@pytest.mark.nightly
def test_loads_can_be_vmapped_and_single_precision_agrees(detachment):
    contact, at = detachment
    values = jnp.array([1.34, 1.35])

    def barrier(value):
        load = js.MeanDisplacement(value)
        return js.transition(contact, load, at.start, at.end, throw=False).barrier.there

    together = jax.jit(jax.vmap(barrier))(values)
    np.testing.assert_allclose(together[1], at.barrier.there, rtol=1e-8)
    single = js.Contact(contact.solid, contact.heights.astype(jnp.float32), contact.potential)
    starts = at.start.gap.astype(jnp.float32), at.end.gap.astype(jnp.float32)
    found = js.transition(single, js.MeanDisplacement(1.35), *starts)
    assert found.barrier.there.dtype == jnp.float32
    np.testing.assert_allclose(found.barrier.there, at.barrier.there, rtol=2e-2)


def test_the_rate_is_that_of_arrhenius(detachment):
    _, found = detachment
    barrier = float(found.barrier.there)
    np.testing.assert_allclose(found.rate(barrier / 2, 3.0), 3 * np.exp(-2), rtol=1e-12)
    with pytest.raises(ValueError, match="thermal energy"):
        found.rate(-1.0, 1.0)


def test_two_states_that_are_one_and_bad_input_are_refused(detachment):
    contact, found = detachment
    load = js.MeanDisplacement(1.35)
    with pytest.raises(js.exceptions.SolverError, match="both states relax to the same one"):
        js.transition(contact, load, found.start, found.start, num_images=6)
    with pytest.raises(ValueError, match="takes one load"):
        js.transition(contact, js.MeanDisplacement(jnp.ones(2)), found.start, found.end)
    with pytest.raises(ValueError, match="num_images"):
        js.transition(contact, load, found.start, found.end, num_images=2)


@pytest.mark.nightly
def test_the_easiest_exit_is_the_one_that_a_nearby_jump_takes_or_lower(detachment):
    contact, at = detachment
    found = js.easiest_exit(contact, at.start)
    np.testing.assert_allclose(found.barrier.there, at.barrier.there, rtol=1e-6)
    assert found.end.contact_area > 0
    # In contact some points can let go before all of them do.
    assert 0 < js.easiest_exit(contact, at.end).barrier.there < 1.001 * at.barrier.back


def sphere_on_a_half_space(parameter, window, smoothing, number=128):
    """Return a contact in units of JKR, of displacement 0.01, and the arguments of its theory."""
    radius = 100.0
    work = 4 / (3 * np.pi * radius**2)
    strength = parameter / 2 * (np.pi * work * (4 / 3) ** 2 / radius) ** (1 / 3)
    grid = js.Grid(number, window)
    solid = js.FreeHalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0)
    law = js.potentials.Dugdale(work, work / strength, smoothing)
    contact = js.Contact(solid, js.surfaces.paraboloid(grid, radius), law)
    return contact, (radius, 1.0, work, strength)


def maugis_curve(sphere):
    """Return displacement, force and the energy along Maugis' curve from where it leaves zero."""
    touch = maugis.first_touch(*sphere)
    parts = [
        maugis.without_contact(np.linspace(1e-4, 1, 4000) * touch.outer_radius, *sphere),
        maugis.curve(np.linspace(1e-4, 1.3, 8000), *sphere),
    ]
    displacement = np.concatenate([part.displacement for part in parts])
    force = np.concatenate([part.force for part in parts])
    steps = (force[1:] + force[:-1]) / 2 * np.diff(displacement)
    return displacement, force, np.append(0, np.cumsum(steps))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("parameter", "window", "smoothing", "displacement"),
    [(1.0, 6.0, 0.035, -0.94), (2.0, 4.0, 0.1, -0.8), (2.0, 4.0, 0.1, -0.88)],
)
def test_a_spheres_barriers_are_integrals_of_maugis_curve(
    parameter, window, smoothing, displacement
):
    contact, sphere = sphere_on_a_half_space(parameter, window, smoothing)
    load, closed = js.FarDisplacement(-0.01 * displacement), js.FarDisplacement(0.0)
    apart = js.equilibrate(contact, js.FarDisplacement(0.014))
    ends = [
        js.equilibrate(contact, load, initial=state)
        for state in (apart, js.equilibrate(contact, closed))
    ]
    found = js.transition(contact, load, *ends)
    displacements, forces, energies = maugis_curve(sphere)
    # Unstable first, then stable; apart the energy is zero.
    (saddle, held), (force, _) = (
        [np.interp(0, *sides) for sides in passed(displacements - 0.01 * displacement, of)]
        for of in (energies, forces)
    )
    np.testing.assert_allclose(found.barrier.there, saddle, rtol=3e-2)
    np.testing.assert_allclose(found.barrier.back, saddle - held, rtol=3e-2)
    np.testing.assert_allclose(found.saddle.force, force, rtol=2e-2)


@pytest.mark.nightly
def test_a_spheres_barrier_to_nothing_is_the_area_under_maugis_curve():
    contact, sphere = sphere_on_a_half_space(1.0, 6.0, 0.1, number=48)
    displacements, forces, energies = maugis_curve(sphere)
    strongest = np.argmin(forces)
    force = 0.9 * forces[strongest]

    def potential(part):
        order = np.argsort(forces[part])
        displacement, energy = (
            np.interp(force, forces[part][order], values[part][order])
            for values in (displacements, energies)
        )
        return energy - force * displacement

    # Unstable first, then stable.
    expected = potential(slice(strongest)) - potential(slice(strongest, None))
    load = js.MeanPressure(force / 36)
    loads = js.MeanPressure(jnp.array([0.0, force / 36]))
    path = js.follow(contact, loads, initial=js.equilibrate(contact, js.FarDisplacement(0.0)))
    found = js.transition(contact, load, path[-1], None)
    np.testing.assert_allclose(found.barrier.there, expected, rtol=3e-2)


def passed(values, others):
    """Return for each change of sign both sides of it, the lower first, with the other values."""
    for i in np.flatnonzero(values[1:] * values[:-1] < 0):
        order = np.argsort(values[i : i + 2])
        yield values[i : i + 2][order], others[i : i + 2][order]


def rough_loop():
    grid = js.Grid(64)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=8, rms_height=0.05)
    solid = js.HalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0)
    contact = js.Contact(solid, heights, js.potentials.Exponential(0.06, 0.06))
    return contact, js.follow(contact, js.MeanGap(jnp.array([0.4, 0.01, 0.4])))


def barriers_before(contact, jump, limit, parts):
    """Return the distances of three loads before a limit, and the barriers there."""
    ahead = jnp.sign(jump.after.load.value - jump.load.value)
    distances = np.array(parts) * float(limit)
    loads = [js.MeanGap(limit - ahead * distance) for distance in distances]
    ways = [js.transition(contact, load, jump.before, jump.after) for load in loads]
    return distances, np.array([float(way.barrier.there) for way in ways])


def large_jumps(path, kind):
    return [jump for jump in path.jumps if jump.kind == kind and jump.dissipation > 5e-6][:3]


@pytest.mark.nightly
def test_near_folds_barriers_fall_with_the_power_of_three_halves():
    contact, path = rough_loop()
    for jump in large_jumps(path, "fold"):
        law, parts = jump.barrier_law, [8e-5, 4e-5, 2e-5]
        distances, barriers = barriers_before(contact, jump, jump.load.value, parts)
        # The jump is located to a millionth of the loads: where the branch ends is fitted too.
        power = np.polynomial.Polynomial.fit(distances, barriers ** (2 / 3), 1).convert()
        whole = distances + power.coef[0] / power.coef[1]
        slope = np.diff(np.log(barriers)) / np.diff(np.log(whole))
        np.testing.assert_allclose(slope, law.exponent, atol=0.02)
        np.testing.assert_allclose(barriers, law.barrier(whole), rtol=2e-2)


@pytest.mark.nightly
def test_near_releases_barriers_fall_with_the_power_of_two():
    contact, path = rough_loop()
    for jump in large_jumps(path, "release"):
        value = jump.load.value
        ahead = jnp.sign(jump.after.load.value - value)
        bracket = js.MeanGap(value + jnp.array([-2e-3, 1e-3]) * ahead * value)
        limit = js.critical_load(contact, bracket, initial=jump.before).load.value
        distances, barriers = barriers_before(contact, jump, limit, [4e-6, 2e-6, 1e-6])
        slope = np.diff(np.log(barriers)) / np.diff(np.log(distances))
        np.testing.assert_allclose(slope[-1], jump.barrier_law.exponent, atol=0.02)
        np.testing.assert_allclose(barriers[-1], jump.barrier_law.barrier(distances[-1]), rtol=2e-2)


@pytest.mark.nightly
def test_where_the_load_does_not_drive_the_mode_there_is_no_law(hertz):
    # Ahead the contact loses its symmetry, which all loads have.
    path = js.follow(hertz, js.MeanDisplacement(jnp.array([1.1, 1.0])))
    assert path.jumps[0].kind == "bifurcation"
    law = path.jumps[0].barrier_law
    assert np.isnan([law.exponent, law.coefficient, law.range]).all()


def test_more_modes_than_moves_are_refused_by_their_name():
    grid = js.Grid((3,), (1.0,))
    heights = jnp.array([0.0, 0.1, 0.0])
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.02, 0.3))
    state = js.equilibrate(contact, js.MeanGap(0.2))
    with pytest.raises(ValueError, match="num_modes is 4: the load allows 2 independent moves"):
        js.easiest_exit(contact, state)
