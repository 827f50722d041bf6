"""Verdicts against brute force: every face of the cone, dense algebra, and pushes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import (
    dense_hessian,
    periodic_stiffness,
    smallest_on_cone,
    smallest_on_critical_cone,
    smallest_on_zero_mean,
)
from problems import Parabola, Waves, state_of

import jaxstab as js

SHAPE = 5, 6


def random_problems(number):
    """Return random gaps, with 4 to 8 points in contact, clustered or scattered.

    And the strengths of laws whose curvature takes any value between plus and minus that.
    """
    random = np.random.default_rng(0)
    gaps = random.uniform(0.01, 6.0, (number, *SHAPE))
    columns, rows = np.meshgrid(*map(np.arange, SHAPE), indexing="ij")
    for i, gap in enumerate(gaps):
        nearby = (columns - 2) ** 2 + (rows - 3) ** 2 + random.random(SHAPE)
        order = nearby if i % 2 else random.random(SHAPE)
        gap.ravel()[np.argsort(order.ravel())[: random.integers(4, 9)]] = 0
    return jnp.asarray(gaps), jnp.asarray(random.uniform(-6, 6, number))


@pytest.fixture(scope="module", params=[60, pytest.param(500, marks=pytest.mark.nightly)])
def faces(request):
    grid = js.Grid(SHAPE, (1.0, 1.2))
    solid = js.HalfSpace(grid, 1.0)

    def state(gap, strength):
        return state_of(js.Contact(solid, jnp.zeros(SHAPE), Waves(strength)), gap)

    gaps, strengths = random_problems(request.param)
    states = jax.jit(jax.vmap(state))(gaps, strengths)
    assess = jax.jit(jax.vmap(lambda state: js.assess_stability(*state, throw=False)))
    curvatures = strengths[:, None] * np.cos(np.asarray(gaps).reshape(len(gaps), -1))
    stiffness = periodic_stiffness(SHAPE, (1.0, 1.2), 1.0)
    matrices = [stiffness + np.diag(curvature) for curvature in curvatures]
    touching = [np.asarray(gap == 0).ravel() for gap in gaps]
    problems = list(zip(matrices, touching, strict=True))
    exact = [smallest_on_cone(*problem) for problem in problems]
    critical = [smallest_on_zero_mean(matrix[np.ix_(~held, ~held)]) for matrix, held in problems]
    return assess(states), np.array(exact), np.array(critical)


def test_the_cone_eigenvalue_is_the_smallest_of_all_faces(faces):
    stability, exact, _ = faces
    excess = np.asarray(stability.cone.eigenvalue) - exact
    assert excess.min() > -1e-8
    assert (excess < 1e-8).mean() >= 0.99
    # Otherwise the problems would be too easy: the linear bound is the answer.
    assert (stability.lower_bound.eigenvalue < exact - 1e-3).mean() > 0.5


def test_no_verdict_contradicts_the_faces(faces):
    stability, exact, critical = faces
    expected = np.where(exact > 0, "stable", np.where(critical > 0, "held_by_contact", "unstable"))
    counts = dict(zip(*np.unique(expected, return_counts=True), strict=True))
    assert len(counts) == 3 and min(counts.values()) > 0.04 * len(exact)
    np.testing.assert_array_equal(stability.verdict.name, expected)


def test_the_critical_eigenvalue_is_exact_and_the_three_are_in_order(faces):
    stability, _, critical = faces
    np.testing.assert_allclose(stability.critical.eigenvalue, critical, atol=1e-8)
    values = [np.asarray(pair.eigenvalue) for pair in stability.pairs.values()]
    assert (values[0] <= values[1]).all()
    assert (values[1] <= values[2]).all()


def test_hertz_in_contact_is_held_by_it(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    stability = js.assess_stability(hertz, equilibrium)
    assert stability.verdict == js.VERDICTS.held_by_contact
    exact = smallest_on_critical_cone(hertz, equilibrium)
    assert 0 < exact == pytest.approx(float(stability.critical.eigenvalue), abs=1e-8)
    # The paper's number.
    assert stability.cone.eigenvalue == pytest.approx(-4.5537, abs=5e-5)
    # The quadratic barrier is computed by hand.
    cost = float(jnp.sum(equilibrium.reaction * stability.cone.mode))
    eigenvalue = float(stability.cone.eigenvalue)
    assert stability.barrier.amplitude == pytest.approx(cost / abs(eigenvalue))
    assert stability.barrier.height == pytest.approx(cost**2 / (2 * abs(eigenvalue)) / 32**2)


@pytest.fixture(scope="module")
def far_side(hertz):
    """The other equilibrium beyond the fold, by reflection of the stable one in the fold."""
    load = js.MeanDisplacement(1.302)
    fold = js.equilibrate(hertz, js.MeanDisplacement(1.2976))
    stable = js.equilibrate(hertz, load)
    start = hertz.gap(2 * fold.displacement - stable.displacement)
    return stable, js.equilibrate(hertz, load, js.solvers.SaddleNewton(), initial=start)


def test_beyond_the_fold_newton_finds_an_unstable_equilibrium(hertz, far_side):
    stable, saddle = far_side
    assert saddle.gap.min() < stable.gap.min() - 0.1
    assert saddle.energy > stable.energy
    stability = js.assess_stability(hertz, saddle)
    assert stability.verdict == js.VERDICTS.unstable
    exact = smallest_on_critical_cone(hertz, saddle)
    assert stability.critical.eigenvalue == pytest.approx(exact, abs=1e-8)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_push_takes_the_unstable_state_to_a_lower_energy(hertz, far_side, sign):
    stable, saddle = far_side
    mode = js.assess_stability(hertz, saddle).critical.mode
    outwards = sign * jnp.sign(mode[16, 16]) * mode
    released = js.relax_along(hertz, saddle, outwards)
    assert released.energy < saddle.energy - 1e-5
    assert float(released.contact_area) == pytest.approx(0.0947 if sign < 0 else 0.0, abs=1e-3)
    if sign > 0:
        np.testing.assert_allclose(released.gap, stable.gap, atol=1e-6)


@pytest.mark.parametrize("displacement", [1.2, 1.302])
def test_a_push_leaves_held_and_stable_states_where_they_were(hertz, displacement):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(displacement))
    stability = js.assess_stability(hertz, equilibrium)
    for pair in stability.pairs.values():
        for sign in (1, -1):
            released = js.relax_along(hertz, equilibrium, sign * pair.mode)
            np.testing.assert_allclose(released.gap, equilibrium.gap, atol=1e-6)


def test_a_push_is_as_long_as_it_is_told(hertz, far_side):
    """Half way down the barrier of a held state it returns, and far beyond the fold it does not."""
    stable, _ = far_side
    mode = js.assess_stability(hertz, stable).critical.mode
    inwards = -jnp.sign(mode[16, 16]) * mode / jnp.abs(mode[16, 16])
    assert js.relax_along(hertz, stable, inwards, amplitude=0.1).contact_area == 0
    assert js.relax_along(hertz, stable, inwards, amplitude=0.5).contact_area > 0


def test_release_refuses_what_is_no_mode(hertz, far_side):
    stable, _ = far_side
    with pytest.raises(ValueError, match=r"mode has shape \(3,\)"):
        js.relax_along(hertz, stable, jnp.ones(3))
    with pytest.raises(ValueError, match=r"The mode is nan at \(0, 0\)"):
        js.relax_along(hertz, stable, jnp.full((32, 32), jnp.nan))
    with pytest.raises(ValueError, match="amplitude is nan"):
        js.relax_along(hertz, stable, jnp.ones((32, 32)), amplitude=jnp.nan)
    with pytest.raises(ValueError, match=r"amplitude has shape \(32,\): give one number"):
        js.relax_along(hertz, stable, jnp.ones((32, 32)), amplitude=jnp.ones(32))
    failed = js.equilibrate(hertz, js.MeanGap(-1.0), throw=False)
    with pytest.raises(ValueError, match=r"state was not found \(infeasible_load\)"):
        js.relax_along(hertz, failed, jnp.ones((32, 32)))
    with pytest.raises(ValueError, match="largest component of the mode is 0"):
        js.relax_along(hertz, stable, jnp.zeros((32, 32)))


def test_a_saddle_of_a_symmetric_start_is_called_unstable():
    """On the paper's grid the four-fold state at 1.2 is a saddle: a push breaks the symmetry."""
    x = jnp.linspace(0, 1, 32)
    heights = -((x[:, None] - 0.5) ** 2 + (x - 0.5) ** 2) / 4
    contact = js.Contact(
        js.HalfSpace(js.Grid(32), 1.0), heights, js.potentials.Exponential(10.0, 1.0)
    )
    equilibrium = js.equilibrate(contact, js.MeanDisplacement(1.2))
    stability = js.assess_stability(contact, equilibrium)
    assert stability.cone.eigenvalue == pytest.approx(-4.5512, abs=5e-4)
    assert stability.verdict == js.VERDICTS.unstable
    released = js.relax_along(contact, equilibrium, stability.critical.mode, amplitude=1e-2)
    assert released.energy < equilibrium.energy - 1e-9
    assert js.assess_stability(contact, released).verdict == js.VERDICTS.held_by_contact


@pytest.fixture(scope="module")
def quadratic():
    """A contact whose Hessian is K - pi E: on the unit square the longest waves cost nothing."""
    grid = js.Grid(8)

    def law(stiffness):
        return js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros((8, 8)), Parabola(stiffness))

    return law


@pytest.mark.parametrize(
    ("shift", "verdict"), [(0.0, "undecided"), (1e-3, "unstable"), (-1e-3, "stable")]
)
def test_an_eigenvalue_of_exactly_zero_decides_nothing(quadratic, shift, verdict):
    contact = quadratic(jnp.pi + shift)
    stability = js.assess_stability(*state_of(contact, jnp.ones((8, 8))))
    assert stability.cone.eigenvalue == pytest.approx(-shift, abs=1e-12)
    assert stability.verdict == getattr(js.VERDICTS, verdict)


def test_contact_holds_nothing_where_the_critical_eigenvalue_is_zero(quadratic):
    touches = np.zeros((8, 8), bool)
    touches[2:5, 2:5] = True
    gap = jnp.where(touches, 0.0, 1.0)
    free = ~touches.ravel()
    stiffness = dense_hessian(quadratic(0.0), gap)[np.ix_(free, free)]
    contact = quadratic(smallest_on_zero_mean(stiffness))
    state = state_of(contact, gap)
    stability = js.assess_stability(*state)
    assert stability.cone.eigenvalue < -0.01
    assert stability.critical.eigenvalue == pytest.approx(0, abs=1e-12)
    assert stability.verdict == "undecided"
    # A zero proves no verdict: no search stops at it.
    quick = js.assess_stability(*state, verdict_only=True)
    assert quick.cone.eigenvalue == pytest.approx(float(stability.cone.eigenvalue))


def test_a_point_without_reaction_may_lift_off(quadratic):
    """Where a contact point does not press, the critical cone lets it move outwards."""
    contact = quadratic(2.0)
    touches = np.zeros((8, 8), bool)
    touches[2:5, 2:5] = touches[6, 1] = True
    gap = jnp.where(touches, 0.0, 1.0)
    pressing = js.assess_stability(*state_of(contact, gap))
    weak = np.where(touches, 1.0, 0.0)
    weak[6, 1] = weak[3, 3] = 0
    hanging = js.assess_stability(*state_of(contact, gap, reaction=jnp.asarray(weak)))
    assert pressing.complementarity > 0.1
    assert hanging.complementarity == 0
    held = touches.ravel() & (weak.ravel() > 0)
    matrix = dense_hessian(contact, gap)[np.ix_(~held, ~held)]
    exact = smallest_on_cone(matrix, touches.ravel()[~held])
    assert hanging.critical.eigenvalue == pytest.approx(exact, abs=1e-8)
    assert hanging.critical.eigenvalue < pressing.critical.eigenvalue - 1e-3


@pytest.mark.parametrize("num_free", [0, 1])
def test_contact_everywhere_but_at_one_point_has_no_critical_perturbation(quadratic, num_free):
    contact = quadratic(100.0)
    gap = jnp.zeros(64).at[:num_free].set(1.0).reshape(8, 8)
    stability = js.assess_stability(*state_of(contact, gap))
    assert stability.critical.eigenvalue == np.inf
    assert stability.lower_bound.eigenvalue < 0
    if num_free:
        assert stability.cone.eigenvalue < 0
        assert stability.verdict == js.VERDICTS.held_by_contact
    else:
        assert stability.cone.eigenvalue == np.inf
        assert stability.verdict == js.VERDICTS.stable


def test_verdict_only_stops_at_a_proof_and_says_so(hertz, far_side):
    stable, saddle = far_side
    held = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    expected = {"stable": "S..", "unstable": "SS.", "held_by_contact": "SSS"}
    for state in (stable, saddle, held):
        full = js.assess_stability(hertz, state)
        quick = js.assess_stability(hertz, state, verdict_only=True)
        assert quick.verdict == full.verdict
        verdict = quick.verdict.name
        order = quick.lower_bound, quick.critical, quick.cone
        for pair, code in zip(order, expected[verdict], strict=True):
            name = "successful" if code == "S" else "not_computed"
            assert pair.result == getattr(js.RESULTS, name)
            assert np.isnan(pair.eigenvalue) == (code == ".")


def test_a_few_stiff_points_do_not_hide_a_soft_one():
    """Against the stiffest point every residual is small, against the others not."""
    grid = js.Grid(16)
    curvature = jnp.full((16, 16), 10.0).at[3, 4].set(-1.0)

    def law(gap):
        # Its curvature, g - 5, is set by the gap.
        return gap**3 / 6 - 5 * gap**2 / 2

    for stiff in (1e4, 1e7, 1e9):
        diagonal = curvature.at[9, 9].set(stiff)
        contact = js.Contact(js.HalfSpace(grid, 1e-3), jnp.zeros((16, 16)), law)
        contact, state = state_of(contact, diagonal + 5)
        stability = js.assess_stability(contact, state, throw=False)
        exact = smallest_on_critical_cone(contact, state)
        assert exact == pytest.approx(-0.9375, abs=1e-3)
        if stability.result == js.RESULTS.successful:
            assert stability.lower_bound.eigenvalue == pytest.approx(exact, abs=1e-6)
            # Rounding of pressures as large as these moves the gap, and so the number.
            is_sure = stability.critical.error < -exact
            assert stability.verdict == ("unstable" if is_sure else "undecided")
            assert is_sure or stiff > 1e4
        else:
            assert stability.verdict == js.VERDICTS.undecided
        assert stability.result == js.RESULTS.successful or stiff > 1e8


def test_what_is_nan_is_undecided(hertz, far_side):
    stable, _ = far_side
    for name in ("reaction", "pressure"):
        spoiled = eqx.tree_at(
            lambda state, name=name: getattr(state, name),
            stable,
            replace_fn=lambda field: field.at[16, 16].set(jnp.nan),
        )
        stability = js.assess_stability(hertz, spoiled, throw=False)
        assert stability.verdict == js.VERDICTS.undecided
        assert stability.result == js.RESULTS.no_equilibrium
    broken = js.Contact(
        hertz.solid, hertz.heights, lambda gap: jnp.where(gap > 1, jnp.nan, -1) * gap**2
    )
    with pytest.raises(js.exceptions.SolverError, match=r"lower_bound eigenvalue.*nonfinite"):
        js.assess_stability(broken, stable)
    stability = js.assess_stability(broken, stable, throw=False)
    assert stability.verdict == js.VERDICTS.undecided
    assert stability.result == js.RESULTS.nonfinite


def test_the_same_key_gives_the_same_answer_and_another_one_the_same_verdict(unloading):
    equilibrium = js.equilibrate(unloading, js.MeanGap(0.5))
    first, again, other = (
        js.assess_stability(unloading, equilibrium, key=jax.random.key(k)) for k in (0, 0, 1)
    )
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert other.verdict == first.verdict
    for a, b in zip(first.pairs.values(), other.pairs.values(), strict=True):
        assert a.eigenvalue == pytest.approx(float(b.eigenvalue), abs=1e-8)


def test_a_state_of_another_contact_is_refused(hertz):
    """The same grid and load, but a stronger law: neither judged, nor released, nor searched."""
    state = js.equilibrate(hertz, js.MeanDisplacement(1.31))
    law = js.potentials.Exponential(10.01, 1.0)
    other = js.Contact(hertz.solid, hertz.heights, law)
    message = "other_contact: the state is not an equilibrium of this contact"
    for use in (
        lambda: js.assess_stability(other, state),
        lambda: js.relax_along(other, state, jnp.ones((32, 32))),
        lambda: js.lowest_modes(other, state, 1),
    ):
        with pytest.raises(js.exceptions.SolverError, match=message):
            use()
    stability = js.assess_stability(other, state, throw=False)
    assert stability.result == "other_contact"
    assert stability.verdict == "undecided"
    assert np.isnan(stability.cone.eigenvalue)
    shifted = eqx.tree_at(lambda state: state.load, state, js.MeanDisplacement(1.32))
    assert js.assess_stability(hertz, shifted, throw=False).result == "other_contact"


@pytest.mark.parametrize(
    "seed",
    [28, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (37, 76, 130, 180, 207))],
)
def test_on_few_points_near_full_contact_the_smallest_is_not_missed(seed):
    random = np.random.default_rng(seed)
    heights = 0.1 * random.normal(size=14)
    energy = 10 ** random.uniform(-2, 0)
    length, gap = (np.exp(random.uniform(*np.log(ends))) for ends in ((0.05, 1), (0.025, 0.3)))
    law = js.potentials.Exponential(energy, length)
    contact = js.Contact(js.HalfSpace(js.Grid((14,), (1.0,)), 1.0), heights, law)
    state = js.equilibrate(contact, js.MeanGap(gap))
    exact = smallest_on_cone(dense_hessian(contact, state.gap), np.asarray(state.in_contact))
    cone = js.assess_stability(contact, state).cone
    assert abs(cone.eigenvalue - exact) < cone.error + 1e-8
