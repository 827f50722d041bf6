"""The stability of viscoelastic contacts in time, against closed forms, dense matrices and runs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

RATIOS, TIMES = (2.0, 1.0), (0.1, 1.0)
# A tolerance that no step misses: a step for each of the given times.
ANY = 1e9


WIDE = (1e-7, 1e6)


@pytest.mark.parametrize(
    ("rate", "times"), [(0.03, TIMES), (2.0, TIMES), (40.0, TIMES), (1e-5, WIDE), (1e6, WIDE)]
)
def test_a_flat_film_grows_at_the_rate_of_its_longest_wave(rate, times):
    # K(s) = |f''| for the wave of the whole cell, the softest.
    grid = js.Grid(8)
    stiffening = 1 + sum(r * rate * t / (1 + rate * t) for r, t in zip(RATIOS, times, strict=True))
    softening = stiffening * 2 * np.pi / 2
    law = js.potentials.Exponential(softening * 0.02**2 * np.e, 0.02)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), RATIOS, times)
    contact = js.Contact(solid, jnp.zeros(grid.shape), law)
    held = js.MeanGap(jnp.full(2, 0.02))
    state = js.evolve(contact, held, jnp.array([0.0, 1e-9]))[-1]
    assert js.growth_rate(state) == pytest.approx(rate, rel=1e-8)


@pytest.mark.parametrize("gap", [0.03, 0.04])
def test_a_rough_contact_departs_along_its_mode_at_the_growth_rate(gap):
    grid = js.Grid((64,))
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=8, rms_height=0.02)
    law = js.potentials.Exponential(0.004, 0.02)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), RATIOS, TIMES)
    contact = js.Contact(solid, heights, law)
    relaxed = js.Contact(solid.relaxed, heights, law)
    # Stable while the gap is held, unstable under the same load held dead.
    rest = js.equilibrate(relaxed, js.MeanGap(gap))
    held = js.MeanPressure(jnp.full(61, rest.mean_pressure))
    start = js.evolve(contact, held[:2], jnp.array([0.0, 1e-9]), initial=rest, fields=True)[0]
    rate = float(js.growth_rate(start))
    assert rate > 0
    parts = np.array(RATIOS), np.array(TIMES)
    turns = rate * parts[1] / (1 + rate * parts[1])
    q = 2 * np.pi * np.abs(np.fft.fftfreq(64, 1 / 64))
    K = np.fft.ifft(np.diag(q / 2) @ np.fft.fft(np.eye(64), axis=0), axis=0).real
    curvature = -10 * np.exp(-np.array(start.gap) / 0.02)
    is_free = np.array(start.gap > 0)
    A = (K * (1 + parts[0] @ turns) + np.diag(curvature))[np.ix_(is_free, is_free)]
    mode = np.zeros(64)
    mode[is_free] = 1e-6 * 0.02 * np.linalg.eigh(A)[1][:, 0]

    def departure(sign):
        rest, move = start.internal, sign * mode
        moved = js.Internal(rest.gap + move, rest.strains + np.append(1, turns)[:, None] * move)
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
    grid = js.Grid(8)
    law = js.potentials.Exponential(part * np.pi * 0.02**2 * np.e, 0.02)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), ratios, TIMES)
    contact = js.Contact(solid, jnp.zeros(grid.shape), law)
    found = js.evolve(contact, js.MeanGap(jnp.full(2, 0.02)), jnp.array([0.0, 1e-9]))
    assert js.growth_rate(found[-1]) == expected


def test_verdicts_of_a_state_in_time_are_those_of_the_glassy_solid():
    # Relaxed it is unstable, glassy it is stable: K(0) = 1, K(infinity) = 4, |f''| = 2 in between.
    grid = js.Grid(8)
    law = js.potentials.Exponential(2 * np.pi * 0.02**2 * np.e, 0.02)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), RATIOS, TIMES)
    contact = js.Contact(solid, jnp.zeros(grid.shape), law)
    found = js.evolve(contact, js.MeanGap(jnp.full(2, 0.02)), jnp.array([0.0, 1e-9]))
    stability = js.assess_stability(found[-1])
    assert stability.verdict == "stable"
    assert stability.cone.eigenvalue == pytest.approx((4 - 2) * np.pi, rel=1e-6)
