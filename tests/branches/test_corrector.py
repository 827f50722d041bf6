"""The corrector ends a vain search, and finds folds in steps as short as a single point needs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.branches.branch_steps import pressure_of
from jaxstab.branches.corrector import CorrectorProblem, Undirected, correct, on_plane, place_of
from jaxstab.branches.curve import BorderedVector, Curve
from jaxstab.core.accuracy import EXACT
from jaxstab.equilibrium.posing import pose

HEIGHTS = np.array([0.0265, 0.0055, -0.0643, 0.0301, 0.0105, -0.0316, 0.0162, 0.007])


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_it_meets_a_tension_that_there_is_and_soon_gives_up_one_that_there_is_not():
    grid = js.Grid((8,), (1.0,))
    contact = js.Contact(js.HalfSpace(grid, 1.0), HEIGHTS, js.potentials.Exponential(0.466, 0.2))
    state = js.equilibrate(contact, js.MeanGap(0.4))
    problem = pose(contact, js.MeanPressure(state.mean_pressure))
    at = BorderedVector(state.gap, pressure_of(problem.contact, problem.load, state.gap))
    curve = Curve.of(problem.contact, problem.load)
    row = curve.load_gradient
    unit = jnp.ones_like(at.pressure)

    def found_at(value):
        problem = CorrectorProblem(curve, on_plane(row, value * unit, unit), at.gap > 0)
        return correct(problem, at, row, tangent, EXACT["float64"])

    nothing = jax.tree.map(jnp.zeros_like, at)
    here = on_plane(row, row.times(at), unit)
    tangent = place_of(curve, Undirected(at, at.gap > 0, here, row, nothing)).tangent
    nearer = found_at(1.05 * row.times(at))
    assert nearer.is_found and 0 < nearer.num_steps <= 8
    net = curve.forces(nearer.place.at, at.gap > 0).net
    assert np.max(np.abs(net)) < 1e-10 * float(curve.contact.profile.max_attraction)
    # No gap balances a tension beyond the largest attraction.
    vain = found_at(-1.2 * curve.contact.profile.max_attraction)
    assert not vain.is_found and 0 < vain.num_steps <= 8


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_jumps_of_single_points_are_told_as_folds():
    # Dugdale's edge is so sharp that its folds fit into 1e-8 of the size of the state.
    modulus, work = 0.75, 1e-4
    unit = js.references.jkr.units(1.0, modulus, work)
    strength = 2 / float(js.references.maugis.transition_parameter(1.0, modulus, work, 1.0))
    window = 8 * unit.contact_radius
    grid = js.Grid(64, [window, window])
    contact = js.Contact(
        js.FreeHalfSpace(grid, modulus),
        js.surfaces.paraboloid(grid, 1.0),
        js.potentials.Dugdale(work, work / strength, 0.05),
    )
    path = js.follow(contact, js.FarDisplacement(np.array([0.0, 0.53]) * unit.displacement))
    assert len(path.jumps) == 13
    assert set(path.jumps.kind.name) == {"fold"}
