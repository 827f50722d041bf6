"""Growth rates, verdicts and lifetimes of viscoelastic contacts: closed forms, matrices, runs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness
from problems import bisected
from viscoelastic_lines import ANY, RATIOS, TIMES, relaxed_of, viscoelastic

import jaxstab as js

WIDE = (1e-7, 1e6)


def flat_film(softening, ratios=RATIOS, times=TIMES):
    """Return a film at a gap where its law softens by so much, answered to as a glass."""
    energy = softening * 0.02**2 * np.e
    contact = viscoelastic(ratios, times, energy=energy, heights=jnp.zeros(32))
    return js.evolve(contact, js.MeanGap(jnp.full(2, 0.02)), jnp.array([0.0, 1e-9]), fields=True)[
        -1
    ]


@pytest.mark.parametrize(
    ("rate", "times"), [(0.03, TIMES), (2.0, TIMES), (40.0, TIMES), (1e-5, WIDE), (1e6, WIDE)]
)
def test_a_flat_film_grows_at_the_rate_of_its_longest_wave(rate, times):
    # K(s) = |f''| for the wave of the whole cell, the softest.
    stiffening = 1 + sum(r * rate * t / (1 + rate * t) for r, t in zip(RATIOS, times, strict=True))
    softening = stiffening * 2 * np.pi / 2
    assert js.growth_rate(flat_film(softening, times=times)) == pytest.approx(rate, rel=1e-8)


@pytest.mark.nightly
@pytest.mark.parametrize("gap", [0.03, 0.04])
def test_a_rough_contact_departs_along_its_mode_at_the_growth_rate(gap):
    grid = js.Grid((32,))
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=8, rms_height=0.02)
    contact = viscoelastic(energy=0.004, heights=heights)
    relaxed = relaxed_of(contact)
    # Stable while the gap is held, unstable under the same load held dead.
    rest = js.equilibrate(relaxed, js.MeanGap(gap))
    held = js.MeanPressure(jnp.full(61, rest.mean_pressure))
    start = js.evolve(contact, held[:2], jnp.array([0.0, 1e-9]), initial=rest, fields=True)[0]
    rate = float(js.growth_rate(start))
    assert rate > 0
    parts = np.array(RATIOS), np.array(TIMES)
    turns = rate * parts[1] / (1 + rate * parts[1])
    K = periodic_stiffness((32,), (1.0,), 1.0)
    curvature = -10 * np.exp(-np.array(start.gap) / 0.02)
    is_free = np.array(start.gap > 0)
    A = (K * (1 + parts[0] @ turns) + np.diag(curvature))[np.ix_(is_free, is_free)]
    mode = np.zeros(32)
    mode[is_free] = 1e-6 * 0.02 * np.linalg.eigh(A)[1][:, 0]

    def departure(sign):
        rest, move = start.memory, sign * mode
        moved = js.results.Memory(
            rest.gap + move, rest.strains + np.append(1, turns)[:, None] * move
        )
        times = jnp.linspace(0, 3 / rate, 61)
        initial = replace(start, last=moved)
        found = js.evolve(contact, held, times, initial=initial, rtol=ANY, fields=True)
        return np.array(found.fields.gap) @ mode

    growth = departure(1) - departure(-1)
    assert np.log(growth[-1] / growth[20]) / 2 == pytest.approx(1, rel=0.01)


@pytest.mark.parametrize(
    ("ratios", "part", "expected"),
    [(RATIOS, 0.9, 0.0), (RATIOS, 4.1, np.inf), ((0.0, 0.0), 0.9, 0.0), ((0.0, 0.0), 1.1, np.inf)],
)
def test_nothing_grows_on_a_relaxed_minimum_and_a_glassy_instability_is_immediate(
    ratios, part, expected
):
    assert js.growth_rate(flat_film(part * np.pi, ratios)) == expected


def test_verdicts_of_a_state_in_time_are_those_of_the_glassy_solid():
    # Relaxed it is unstable, glassy it is stable: K(0) = 1, K(infinity) = 4, |f''| = 2 in between.
    stability = js.assess_stability(flat_film(2 * np.pi))
    assert stability.verdict == "stable"
    assert stability.cone.eigenvalue == pytest.approx((4 - 2) * np.pi, rel=1e-6)


def test_lifetime_ends_between_the_relaxed_and_the_glassy_pull_off():
    contact = viscoelastic(energy=0.001)
    strength = bisected(relaxed_of(contact), js.MeanPressure, 0.0, -0.01)
    assert strength < 0
    assert js.lifetime(contact, js.MeanPressure(0.99 * strength)) == np.inf
    times = [js.lifetime(contact, js.MeanPressure(part * strength)) for part in (1.001, 1.01, 1.1)]
    assert times[0] > 2 * times[1] > 4 * times[2] > 0
    assert js.lifetime(contact, js.MeanPressure(100 * strength)) == 0


@pytest.mark.parametrize("part", [2, 9])
def test_a_lifetime_in_coarse_steps_is_the_one_in_fine_steps(part):
    contact = viscoelastic(energy=0.003)
    relaxed = relaxed_of(contact)
    rest = js.equilibrate(relaxed, js.MeanDisplacement(0.01))
    held = js.Spring(float(np.linspace(0.128, 0.1335, 40)[part]), 0.5)
    # In shorter steps the contact outlasts the interval in which longer ones lost it.
    times = [js.lifetime(contact, held, initial=rest, rtol=rtol) for rtol in (0.03, 1e-3)]
    assert times[0] == pytest.approx(times[1], rel=0.1)
