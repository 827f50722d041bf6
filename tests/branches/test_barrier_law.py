"""How high barriers are near jumps, and how far their law holds, by dense curves of equilibria."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness
from dense_curve import DenseCurve, exponential

import jaxstab as js
from jaxstab.branches import BarrierLaw
from jaxstab.branches.barrier_law import barrier_law


def line(n, law, height, *others, phase=0):
    grid = js.Grid((n,), (1.0,))
    x = 2 * np.pi * np.arange(n) / n
    waves = [part * np.cos(k * x + k - 2 + phase) for k, part in enumerate(others, start=2)]
    return on_half_space(grid, -height * (1 + np.cos(x + 0.2) + sum(waves)), law)


def rough(law):
    grid = js.Grid(8)
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=3, rms_height=0.05)
    return on_half_space(grid, heights, law)


def on_half_space(grid, heights, law):
    return js.Contact(js.HalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0), heights, law)


def exponential_law(energy, length):
    return (lambda g: -energy * np.exp(-g / length), *exponential(energy, length))


def lennard_jones(energy, length):
    def powers(gap, *terms):
        return energy / 2 * sum(factor * (length / gap) ** n for factor, n in terms)

    return (
        lambda g: powers(g, (1, 9), (-3, 3)),
        lambda g: powers(g, (-9, 10), (9, 4)) / length,
        lambda g: powers(g, (90, 11), (-36, 5)) / length**2,
    )


class Barriers:
    """The barriers before a jump: state and saddle lie on one curve, before and behind its turn.

    Attributes:
        events: their kinds, and their distances from the turn.
    """

    def __init__(self, contact, jump, law, farthest, step=1e-3):
        shape, density, *derivatives = contact.grid.shape, *law
        self.stiffness = periodic_stiffness(shape, (1.0,) * len(shape), 1.0)
        self.heights, self.density = np.asarray(contact.heights).ravel(), density
        self.is_pressure = isinstance(jump.load, js.MeanPressure)
        load = (0, 1, 0) if self.is_pressure else (1, 0, 0)
        self.side = -float(np.sign(jump.after.load.value - jump.load.value))
        away, self.curve = (
            DenseCurve(self.stiffness, self.heights, *derivatives, load) for _ in range(2)
        )
        gap, pressure = np.asarray(jump.before.gap), float(jump.before.mean_pressure)
        last = float(jump.load.value) + self.side * farthest
        assert away.follow(gap, pressure, last, step, max_steps=300) == "load"
        *gap, pressure = away.states[-1]
        # The curve comes back to where it has begun.
        back = self.curve.value(away.states[-1]) - self.side * 1e-9 * farthest
        self.curve.follow(np.array(gap), pressure, back, step, max_steps=300)
        (self.kind, self.limit), *_ = self.curve.events
        self.events = [(kind, self.side * (at - self.limit)) for kind, at in self.curve.events]

    def energy(self, x):
        gap, pressure = x[:-1], x[-1] * self.is_pressure
        u = gap + self.heights
        return np.mean(u * (self.stiffness @ u) / 2 + self.density(gap) + pressure * gap)

    def state(self, value, first, second):
        """Return the state of a load between two others, with the contact points of one of them."""
        size = self.heights.size
        row = np.append(np.full(size, self.curve.load[0] / size), self.curve.load[1])
        for free in (second[:-1] > 0, first[:-1] > 0):
            start = np.append(second[:-1] * free, second[-1])
            found = self.curve.corrected(start, free, row, value)
            if found is not None and not np.any(self.curve.violated(found, free)):
                return found
        raise AssertionError("no state")

    def __call__(self, distance):
        value, states = self.limit + self.side * distance, self.curve.states
        is_over = [self.side * (self.curve.value(x) - value) > 0 for x in states]
        before, behind = np.flatnonzero(np.diff(is_over))[:2]
        held, saddle = (
            self.energy(self.state(value, *states[i : i + 2])) for i in (before, behind)
        )
        return saddle - held


def errors(contact, jump, law, *parts, step=1e-3):
    """Return the relative error of the law at parts of its range."""
    found, reach, true = jump.barrier_law, float(jump.barrier_law.range), []
    for part in parts:
        barriers = Barriers(contact, jump, law, 1.02 * part * reach, step)
        assert barriers.kind == jump.kind.name
        np.testing.assert_allclose(jump.load.value, barriers.limit, rtol=1e-5)
        true.append(barriers(part * reach))
    return np.asarray(found.barrier(reach * np.array(parts))) / true - 1


@pytest.fixture(scope="module")
def sticky_loop():
    contact = line(16, js.potentials.Exponential(0.05, 0.05), 0.05, 0.3)
    return contact, js.follow(contact, js.MeanGap(jnp.array([0.25, 0.02, 0.25])))


@pytest.mark.parametrize("number", [1, 4, 13, 17, 20])
def test_at_the_end_of_its_range_the_law_errs_by_about_a_fifth(sticky_loop, number):
    contact, path = sticky_loop
    jump, law = path.jumps[number], exponential_law(0.05, 0.05)
    assert jump.kind == ("fold" if number < 10 else "release")
    near, half, far = errors(contact, jump, law, 0.04, 0.5, 1)
    # The next term, which is 0.15 at the end, is exact.
    np.testing.assert_allclose(near, -0.15 * 0.04, rtol=0.06)
    assert 0.05 < -half < 0.1 < -far < 0.25


def test_the_range_ends_where_another_point_touches(sticky_loop):
    contact, path = sticky_loop
    jump, law = path.jumps[0], exponential_law(0.05, 0.05)
    reach = float(jump.barrier_law.range)
    (_, _), (kind, distance), *_ = Barriers(contact, jump, law, 1.2 * reach).events
    assert kind == "touch"
    np.testing.assert_allclose(distance, reach, rtol=2e-2)
    assert (np.abs(errors(contact, jump, law, 0.3, 0.95)) < 0.1).all()


def pulled_off(contact, tension):
    """Return the last jump under a growing tension."""
    return js.follow(contact, js.MeanPressure(jnp.array([0.0, -tension]))).jumps[-1]


@pytest.mark.nightly
def test_a_lennard_jones_line_is_pulled_off_at_a_fold():
    contact = line(16, js.potentials.LennardJones(0.02, 0.2), 0.1, 0.4)
    jump = pulled_off(contact, 0.2)
    assert jump.kind == "fold"
    near, half, far = errors(contact, jump, lennard_jones(0.02, 0.2), 0.04, 0.5, 1)
    np.testing.assert_allclose(near, -0.15 * 0.04, rtol=0.06)
    assert 0.05 < -half < 0.1 < -far < 0.25


@pytest.mark.nightly
def test_a_rough_surface_is_pulled_off_at_a_release():
    contact = rough(js.potentials.Exponential(0.1, 0.1))
    jump = pulled_off(contact, 1.2)
    assert jump.kind == "release"
    near, half, far = errors(contact, jump, exponential_law(0.1, 0.1), 0.04, 0.5, 1, step=1e-4)
    np.testing.assert_allclose(near, -0.15 * 0.04, rtol=0.06)
    assert 0.05 < -half < 0.1 < -far < 0.25


@pytest.mark.nightly
def test_a_gap_that_closes_elsewhere_ends_the_range_when_it_matters():
    contact = line(32, js.potentials.Exponential(0.008, 0.08), 0.06, 0.4, 0.2, phase=1)
    jump = pulled_off(contact, 0.2)
    assert jump.kind == "release"
    # One closes at a twelfth of the range.
    half, far = errors(contact, jump, exponential_law(0.008, 0.08), 0.5, 1, step=1e-4)
    assert 0.05 < half < 0.12 < far < 0.25


@pytest.mark.parametrize("unit", ["length", "pressure"])
def test_in_another_unit_of_pressure_law_and_range_are_the_same(unit):
    law = BarrierLaw(jnp.array(1.5), jnp.array(3.0), jnp.array(0.2), unit)
    changed = law.in_units_of(jnp.array(8.0))
    per_unit = 8 if unit == "pressure" else 1
    np.testing.assert_allclose(changed.range * per_unit, law.range)
    np.testing.assert_allclose(changed.barrier(changed.range) * 8, law.barrier(law.range))
    assert f"range={float(changed.range):.6g}" in repr(changed)


def test_in_another_unit_of_length_the_law_is_the_same(sticky_loop):
    contact, path = sticky_loop
    fold = js.critical_load(contact, js.MeanGap(jnp.array([0.25, 0.02])))
    assert fold.kind == "fold"
    state = fold.equilibrium
    nowhere = jnp.zeros(16, bool)

    def law_in(unit):
        solid = js.HalfSpace(js.Grid((16,), (unit,)), youngs_modulus=1.0, poisson_ratio=0.0)
        law = js.potentials.Exponential(0.05 * unit, 0.05 * unit)
        scaled = js.Contact(solid, contact.heights * unit, law)
        load = js.MeanGap(state.load.value * unit)
        mode = fold.critical.mode
        return barrier_law(scaled, load, state.gap * unit, fold.kind, mode, nowhere)

    one, other = jax.jit(law_in)(1.0), jax.jit(law_in)(1e6)
    np.testing.assert_allclose(one.range, path.jumps[0].barrier_law.range, rtol=1e-4)
    np.testing.assert_allclose(other.range, one.range * 1e6, rtol=1e-6)
    # On a line areas are lengths, and energies go with their square.
    barrier = one.barrier(one.range)
    np.testing.assert_allclose(other.barrier(other.range), barrier * 1e12, rtol=1e-6)
