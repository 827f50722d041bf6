"""Searches that start from the modes of the same problem on every other point."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.contact.hessian import Hessian
from jaxstab.stability import coarse_start
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.solvers.base import ConeProblem


@pytest.fixture
def small_is_large(monkeypatch):
    """Have grids of 64 x 64 searched from ones of 16 x 16."""
    jax.clear_caches()
    monkeypatch.setattr(coarse_start, "LARGE", 64**2)
    monkeypatch.setattr(coarse_start, "COARSE", 16**2)
    yield
    jax.clear_caches()


def contact_with(k_high):
    grid = js.Grid(64)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=k_high, rms_height=0.1)
    law = js.potentials.Exponential(1e-2, 1.0)
    return js.Contact(js.HalfSpace(grid, 1e-3), heights, law), js.MeanDisplacement(0.5)


def tip():
    window = js.Grid(32)
    heights = js.surfaces.paraboloid(window, radius=0.5)
    law = js.potentials.Exponential(1e-2, 1.0)
    return js.Contact(js.FreeHalfSpace(window, 1.0), heights, law), js.FarDisplacement(0.1)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    "make, most",
    [
        pytest.param(lambda: contact_with(4), 0.5, id="smooth"),
        # On 16 x 16 points there is little left of it, so that all starts are needed.
        pytest.param(lambda: contact_with(32), 1.5, id="rough"),
        pytest.param(tip, 1.0, id="tip"),
    ],
)
def test_they_find_what_all_starts_do(make, most, request):
    contact, load = make()
    equilibrium = js.equilibrate(contact, load)
    expected = js.assess_stability(contact, equilibrium)
    request.getfixturevalue("small_is_large")
    found = js.assess_stability(contact, equilibrium)
    assert found.verdict == expected.verdict
    for pair, other in zip(found.pairs.values(), expected.pairs.values(), strict=True):
        assert abs(pair.eigenvalue - other.eigenvalue) <= pair.error + other.error
    costs = [sum(p.num_applications for p in s.pairs.values()) for s in (found, expected)]
    assert costs[0] < most * costs[1]


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("displacement, is_trusted", [(0.5, True), (0.1, False)])
def test_all_starts_are_looked_at_only_where_the_coarser_mode_is_not_to_be_trusted(
    displacement, is_trusted, small_is_large, monkeypatch
):
    contact, _ = contact_with(4)
    equilibrium = js.equilibrate(contact, js.MeanDisplacement(displacement))
    search, compared = sys.modules["jaxstab.stability.search"], []
    from_all_starts = search.from_all_starts

    def counted(*problem):
        if problem[1].operator.curvature.shape == contact.grid.shape:
            compared.append(problem)
        return from_all_starts(*problem)

    monkeypatch.setattr(search, "from_all_starts", counted)
    found = js.assess_stability(contact, equilibrium)
    assert len(compared) == (not is_trusted)
    if is_trusted:
        return
    traced = jax.jit(js.assess_stability)(contact, equilibrium)
    np.testing.assert_allclose(traced.cone.eigenvalue, found.cone.eigenvalue, rtol=1e-10)


@pytest.mark.nightly
def test_a_coarser_problem_without_a_mode_gives_no_start(small_is_large):
    # Cells of which one point in four is free are in contact.
    grid = js.Grid(64)
    free = jnp.zeros(grid.shape, bool).at[::8, ::8].set(True)
    hessian = Hessian(js.HalfSpace(grid, 1.0), jnp.where(free, -40.0, 0.0))
    problem = ConeProblem.of(hessian, AdmissibleCone(~free))
    key = jax.random.key(0)
    search = sys.modules["jaxstab.stability.search"]
    started = search.start_from_coarse
    starts = []

    def kept(*problem):
        starts.append(started(*problem))
        return starts[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "start_from_coarse", kept)
        hull = search.lowest_on_hull(js.solvers.Davidson(), problem, key)
        lowest = search.from_one_start(
            js.solvers.ProjectedLOBPCG(), js.solvers.Davidson(), problem, hull, key
        )
    np.testing.assert_array_equal(starts[0].vector, 0)
    # Then all starts are looked at.
    expected = search.from_all_starts(js.solvers.ProjectedLOBPCG(), problem, hull, key)
    np.testing.assert_allclose(lowest.pair.eigenvalue, expected.pair.eigenvalue, rtol=1e-9)


@pytest.mark.nightly
def test_a_start_that_is_not_needed_takes_no_step():
    contact, load = contact_with(8)
    equilibrium = js.equilibrate(contact, load)
    hessian = contact.hessian(equilibrium.gap)
    cone = AdmissibleCone(equilibrium.in_contact)
    starts = jax.random.normal(jax.random.key(0), (2, *contact.grid.shape))
    solver = js.solvers.ProjectedLOBPCG()
    solve = jax.jit(lambda *problem: solver.solve(*problem))
    both = solve(hessian, cone, starts, jnp.array([True, False]))
    alone = solve(hessian, cone, starts[:1])
    assert int(both.num_applications) == int(alone.num_applications)
    np.testing.assert_allclose(both.vector, alone.vector, atol=1e-9)


def test_the_coarser_solid_has_the_long_waves_of_the_fine_one():
    grid = js.Grid((12, 8), (3.0, 2.0))
    solid = js.HalfSpace(grid, 2.0).with_uniform_stiffness(0.5)
    coarser = solid.coarser()
    assert coarser.grid.shape == (6, 4)
    np.testing.assert_array_equal(coarser.grid.lengths, grid.lengths)
    x, y = coarser.grid.coordinates
    wave = jnp.cos(2 * jnp.pi * (x / 3 - y / 2)) + 0.3
    fine = jnp.cos(2 * jnp.pi * (grid.coordinates[0] / 3 - grid.coordinates[1] / 2)) + 0.3
    np.testing.assert_allclose(coarser.apply(wave), solid.apply(fine)[::2, ::2], atol=1e-12)
    assert js.HalfSpace(js.Grid((7, 8)), 1.0).with_uniform_stiffness(0).coarser() is None


def test_a_problem_is_made_coarser_until_few_points_are_left(monkeypatch):
    monkeypatch.setattr(coarse_start, "COARSE", 32)
    touches = jnp.zeros((16, 8), bool).at[:4, :4].set(True)
    solid = js.HalfSpace(js.Grid((16, 8)), 1.0)
    hessian = Hessian(solid, jnp.where(touches, -4.0, -1.0))
    coarse = coarse_start.coarser(ConeProblem.of(hessian, AdmissibleCone(touches)))
    assert coarse.operator.solid.grid.shape == (8, 4)
    np.testing.assert_array_equal(coarse.domain.one_sided, touches[::2, ::2])
    np.testing.assert_array_equal(coarse.operator.curvature, hessian.curvature[::2, ::2])
