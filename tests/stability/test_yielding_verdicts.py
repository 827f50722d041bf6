"""Verdicts on surfaces that yield, held against every face of the cones by dense algebra."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness

import jaxstab as js
from jaxstab.core import model
from jaxstab.stability.cones import AdmissibleCone

SIZE = 7
HARDNESS = 0.4
ENERGY, RANGE = 0.25, 0.6
OPEN, HELD, TOUCHING, YIELDING = range(4)
# Seeds, few of many, whose cone has a negative eigenvalue and whose critical cone has none.
HELD_BY_CONTACT = (20, 96, 264, 636, 1336, 1560, 1614, 1990, 2072, 2236)


def made_state(seed, load_kind):
    """Return a contact, one of its equilibria and the kinds of its points, made to be one."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice(4, SIZE, p=[0.45, 0.15, 0.1, 0.3])
    kinds[:2] = OPEN, YIELDING
    law = js.potentials.Exponential(ENERGY * rng.uniform(0.2, 1.5), RANGE)
    slope = jax.vmap(jax.grad(law))
    gap = np.where(kinds == OPEN, rng.uniform(0.05, 1.0, SIZE), 0.0)
    attraction = np.asarray(slope(jnp.asarray(gap)))
    reaction = np.where(kinds == HELD, rng.uniform(0.2, 0.8, SIZE) * (HARDNESS + attraction), 0.0)
    pressure = np.where(kinds == YIELDING, HARDNESS, reaction - attraction)
    stiffness = periodic_stiffness((SIZE,), (1.0,), 1.0)
    displacement = np.linalg.pinv(stiffness) @ (pressure - pressure.mean())
    grid = js.Grid((SIZE,), (1.0,))
    contact = js.Contact(js.HalfSpace(grid, 1.0), displacement - gap, law, hardness=HARDNESS)
    load = js.MeanPressure(pressure.mean())
    if load_kind is js.MeanGap:
        load = js.MeanGap(gap.mean())
    state = js.equilibrate(contact, load, initial=gap)
    np.testing.assert_allclose(state.signed_gap, gap, atol=1e-9)
    curvature = np.asarray(jax.vmap(jax.grad(jax.grad(law)))(jnp.asarray(gap)))
    matrix = stiffness + np.diag(np.where(kinds == YIELDING, 0, curvature))
    return contact, state, kinds, matrix


def lowest_on_cone(matrix, sign, held, fixes_mean):
    """Return the least quotient over x with sign * x >= 0 where the sign is not 0: of all faces."""
    sided = np.flatnonzero((sign != 0) & ~held)
    free = np.flatnonzero((sign == 0) & ~held)
    lowest = np.inf
    for opens in product([False, True], repeat=sided.size):
        moving = np.sort([*free, *sided[list(opens)]]).astype(int)
        if not moving.size:
            continue
        basis = np.eye(len(matrix))[:, moving]
        if fixes_mean:
            basis = basis @ np.linalg.svd(np.ones((1, moving.size)))[2][1:].T
        if not basis.shape[1]:
            continue
        values, vectors = np.linalg.eigh(basis.T @ matrix @ basis)
        for value, vector in zip(values, (basis @ vectors).T, strict=True):
            if any((sign * s * vector >= -1e-12).all() for s in (1, -1)):
                lowest = min(lowest, value)
    return lowest


def check_verdict(seed, load_kind):
    contact, state, kinds, matrix = made_state(seed, load_kind)
    fixes_mean = load_kind is js.MeanGap
    nowhere = np.zeros(SIZE, bool)
    sign = np.where(kinds == OPEN, 0, np.where(kinds == YIELDING, -1, 1))
    cone = lowest_on_cone(matrix, sign, nowhere, fixes_mean)
    critical = lowest_on_cone(matrix, sign, kinds == HELD, fixes_mean)
    stability = js.assess_stability(contact, state)
    np.testing.assert_allclose(stability.cone.eigenvalue, cone, atol=2e-6)
    np.testing.assert_allclose(stability.critical.eigenvalue, critical, atol=2e-6)
    verdict = "stable" if cone > 0 else "held_by_contact" if critical > 0 else "unstable"
    assert stability.verdict in (verdict, "undecided")
    assert stability.lower_bound.eigenvalue <= stability.cone.eigenvalue + 1e-9
    for pair in (stability.cone, stability.critical):
        assert (np.asarray(pair.mode)[kinds == YIELDING] <= 0).all()
        assert (np.asarray(pair.mode)[(kinds == HELD) | (kinds == TOUCHING)] >= 0).all()
    return stability.verdict.name, bool((kinds == TOUCHING).any())


def check_verdicts(seeds):
    found = [check_verdict(i, (js.MeanPressure, js.MeanGap)[i % 2]) for i in seeds]
    verdicts = [verdict for verdict, _ in found]
    assert {"stable", "unstable"} <= {*verdicts}
    # Only a point that just touches, to within the error, may leave a verdict open.
    assert all(touches for verdict, touches in found if verdict == "undecided")
    assert verdicts.count("undecided") < len(verdicts) / 2
    return verdicts


def test_eigenvalues_and_verdicts_are_those_of_all_faces():
    assert "held_by_contact" in check_verdicts((*range(16), *HELD_BY_CONTACT[:2]))


@pytest.mark.nightly
def test_two_hundred_verdicts_are_right():
    verdicts = check_verdicts((*range(1000, 1190), *HELD_BY_CONTACT))
    assert verdicts.count("held_by_contact") > 5


@pytest.mark.parametrize("seed", range(4))
def test_the_projection_is_the_nearest_field_of_both_signs_and_zero_mean(seed):
    rng = np.random.default_rng(seed)
    field = rng.normal(size=9)
    one_sided, held = rng.random(9) < 0.7, rng.random(9) < 0.1
    sign = np.where(rng.random(9) < 0.5, 1.0, -1.0)
    cone = AdmissibleCone(*map(jnp.asarray, (one_sided, held)), sign=jnp.asarray(sign))
    nearest = np.asarray(cone.project(jnp.asarray(field)))
    moving = ~held
    # The shift of the mean, by bisection.
    low, high = -10.0, 10.0
    for _ in range(100):
        middle = (low + high) / 2
        x = np.where(moving, field - middle, 0)
        x = np.where(one_sided & (sign * x < 0), 0, x)
        low, high = (middle, high) if x.sum() > 0 else (low, middle)
    np.testing.assert_allclose(nearest, x, atol=1e-12)
    np.testing.assert_allclose(nearest.sum(), 0, atol=1e-12)
    both = np.where(one_sided, np.where(sign < 0, -1, 1), 0)
    assert (both * nearest >= 0).all()


def test_a_cone_of_both_signs_may_have_points_to_move_against_each_other():
    yes, signs = jnp.ones(2, bool), jnp.array([1.0, -1.0])
    assert not AdmissibleCone(yes, sign=signs).is_trivial
    assert AdmissibleCone(yes, sign=-jnp.ones(2)).is_trivial
    np.testing.assert_allclose(
        model.onto_cone_of_signs(jnp.array([1.0, 3.0]), yes, yes, signs), 0, atol=1e-15
    )
