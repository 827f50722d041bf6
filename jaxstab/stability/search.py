"""The three smallest eigenvalues of an equilibrium: on all perturbations and on both cones.

Each cone is searched from the lowest modes of the linear space around it, its hull. Known results
are not searched for again. Without contact all three eigenvalues are one; where all contact
presses, the critical cone is a linear space.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxstab.contact.hessian import Block, Hessian
from jaxstab.core.checks import is_traced
from jaxstab.core.compile import program
from jaxstab.core.conditional import if_needed
from jaxstab.core.procedure import Part, Procedure
from jaxstab.core.progress import Report, unseen
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Flag, Mask, Scalar
from jaxstab.stability.certificate import certified_bound
from jaxstab.stability.coarse_start import (
    is_foreseen,
    is_large,
    minimum_by_coarser,
    space_starts,
)
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Eigenpair, admissible_pair, lowered
from jaxstab.stability.lowest_modes import BLOCK_SIZE
from jaxstab.stability.lowest_pair import (
    Lowest,
    after,
    again,
    cone_starts,
    costing,
    on_cone,
    on_space,
)
from jaxstab.stability.solvers.base import ConeSolver, Eigenproblem
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG
from jaxstab.stability.solvers.davidson import Davidson


class Search(eqx.Module):
    """A search for smallest eigenvalues at one equilibrium.

    Attributes:
        hessian: A.
        cone: V0+.
        critical_cone: the critical cone.
        random: vectors to start from.
        nearly_touching: points that may be in contact, to within the error of the state.
        touches: whether the surfaces touch anywhere.
        is_weak: whether they do so anywhere without pressing beyond an error.
        is_doubtful: whether it is in doubt of any point that it touches or presses.
        verdict_only: whether to stop at a number that proves the verdict.
    """

    hessian: Hessian
    cone: AdmissibleCone
    critical_cone: AdmissibleCone
    random: Block
    nearly_touching: Mask
    touches: Flag
    is_weak: Flag
    is_doubtful: Flag
    verdict_only: bool = eqx.field(static=True)

    def eigenpairs(self, solver: ConeSolver, report: Report = unseen) -> Procedure["Found"]:
        """Return the procedure that finds the eigenpairs, the solver being the cone's."""
        spaces = Davidson(solver.tolerance_in(self.random.dtype))
        is_default = isinstance(solver, ProjectedLOBPCG)
        fast = solver if is_default else ProjectedLOBPCG(spaces.tolerance)
        touches = _flag(self.touches)

        around = yield Part(_on_hull, (spaces, self.hessian, self.cone, self.random))
        report(around)
        is_proved = self.verdict_only & (_flag(around.sign) > 0)
        is_open = touches & ~is_proved
        problem = spaces, self.hessian, self.critical_cone, self.random
        hull = yield Part(_on_hull, problem, is_open, again(around))
        problem = fast, self.hessian, self.critical_cone, hull, self.random
        is_needed = is_open & _flag(self.is_weak)
        critical = yield from _on_cone(*problem, is_needed, again(hull))
        critical = if_needed(is_needed, lambda: after(hull, critical), hull)
        report(critical)
        is_decided = is_proved | (self.verdict_only & (_flag(critical.sign) < 0))
        # A solver that the caller chose is one to look at.
        is_needed = touches & ~is_decided if is_default else True
        problem = solver, self.hessian, self.cone, around, self.random
        cone = yield from _on_cone(*problem, is_needed, again(around))
        lacks_proof = (_flag(cone.sign) > 0) & (_flag(around.sign) <= 0)
        lacks_proof &= ~_flag(cone.pair.proved) & ~_flag(self.is_doubtful)
        is_needed = touches & ~is_decided & lacks_proof
        problem = spaces, self.hessian, self.cone, cone, around
        cone = yield Part(_certified, problem, is_needed, cone)
        report(cone)
        return self._concluded(around, cone, critical, hull, is_proved, is_decided)

    def _concluded(
        self,
        around: "Lowest",
        cone: "Lowest",
        critical: "Lowest",
        hull: "Lowest",
        is_proved: Bool[Array | np.ndarray, ""],
        is_decided: Bool[Array | np.ndarray, ""],
    ) -> "Found":
        """Return the results, with errors that cover the points in doubt."""
        critical = if_needed(
            _flag(self.is_doubtful), lambda: _critical_in_doubt(self, critical, hull), critical
        )
        cone = if_needed(_flag(self.is_doubtful), lambda: _cone_in_doubt(self, cone), cone)
        return Found(around.pair, cone.pair, critical.pair, hull.pair, is_proved, is_decided)


class Found(eqx.Module):
    """The results of a search.

    Attributes:
        lower_bound: the smallest eigenpair of all perturbations.
        cone: that on V0+.
        critical: that on the critical cone.
        hull: that on the linear space around the critical cone.
        is_proved: whether the verdict was proved before `critical` was known.
        is_decided: whether it was before `cone` was known.
    """

    lower_bound: Eigenpair
    cone: Eigenpair
    critical: Eigenpair
    hull: Eigenpair
    is_proved: Bool[Array | np.ndarray, ""]
    is_decided: Bool[Array | np.ndarray, ""]

    def ordered(self) -> "Found":
        """Return pairs of which none is above one on a smaller cone; NaN if not computed."""
        critical = _unless(self.is_proved, self.critical)
        cone = lowered(_unless(self.is_decided, self.cone), critical)
        lower_bound = lowered(lowered(self.lower_bound, cone), critical)
        return replace(self, lower_bound=lower_bound, cone=cone, critical=critical)


def _on_hull(
    solver: Davidson, hessian: Hessian, cone: AdmissibleCone, random: Block
) -> Procedure[Lowest]:
    """Return the procedure that searches the linear space around a cone."""
    space = cone.hull
    starts, cost = space_starts(solver, hessian, space, random[:BLOCK_SIZE])
    found = yield from on_space(solver, hessian, space, starts)
    return costing(found, cost)


def _on_cone(
    solver: ConeSolver,
    hessian: Hessian,
    cone: AdmissibleCone,
    hull: Lowest,
    random: Block,
    is_needed: Any,
    otherwise: Lowest,
) -> Procedure[Lowest]:
    """Return the procedure that searches a cone, if it is needed.

    On a large grid it begins with the mode of the coarser problem.
    """
    problem = solver, hessian, cone, hull, random
    if not (is_large(hessian) and isinstance(solver, ProjectedLOBPCG)):
        return (yield Part(_from_all_starts, problem, is_needed, otherwise))
    trusted = otherwise, np.True_
    first, is_trusted = yield Part(_from_coarser_mode, problem, is_needed, trusted)
    return (yield Part(_from_all_starts, (*problem, first), ~_flag(is_trusted), first))


def _from_all_starts(
    solver: ConeSolver,
    hessian: Hessian,
    cone: AdmissibleCone,
    hull: Lowest,
    random: Block,
    before: Lowest | None = None,
) -> Procedure[Lowest]:
    """Return the procedure that searches a cone, also from earlier vectors if there are any."""
    starts, is_needed, is_answer = cone_starts(solver, cone, hull, random, before)
    problem = Eigenproblem(hessian.restricted(cone.is_moving), cone)
    found = yield from solver.search(problem, starts, is_needed)
    lowest = on_cone(hessian, cone, hull, found, is_answer)
    return lowest if before is None else after(before, lowest)


def _from_coarser_mode(
    solver: ProjectedLOBPCG, hessian: Hessian, cone: AdmissibleCone, hull: Lowest, random: Block
) -> Procedure[tuple[Lowest, Flag]]:
    """Return the procedure that searches a cone from one mode, and says whether to trust it.

    Apart from the search from all starts, as that takes the memory of them all.
    """
    starts, _, is_answer = cone_starts(solver, cone, hull, random)
    is_known = is_answer | cone.is_trivial
    search = minimum_by_coarser(solver, hessian, cone, starts[0], is_known, random)
    found, foreseen = yield from search
    lowest = on_cone(hessian, cone, hull, found, is_answer)
    return lowest, is_known | is_foreseen(lowest.pair.eigenvalue, foreseen)


def _certified(
    solver: Davidson, hessian: Hessian, cone: AdmissibleCone, found: Lowest, hull: Lowest
) -> Procedure[Lowest]:
    """Return the procedure that adds a bound that is proved to a pair on a cone."""
    search = certified_bound(solver, hessian, cone, found.pair.eigenvalue, hull.modes)
    bound, cost = yield from search
    return costing(replace(found, pair=found.pair.with_proof(False, bound)), cost)


@program
def _critical_in_doubt(search: Search, critical: Lowest, hull: Lowest) -> Lowest:
    """Return a pair of the critical cone whose error covers the points in doubt.

    It lies between the eigenvalue where they all move freely and the quotient of its mode where
    they all stay.
    """
    cone, pair = search.critical_cone, critical.pair
    held = Subspace(~(search.cone.one_sided | search.nearly_touching), cone.fixes_mean)
    above, _, _ = admissible_pair(search.hessian.restricted(held.is_moving), held, pair.mode)
    below = hull.pair.eigenvalue - hull.pair.error
    rise = _rise(above, pair.eigenvalue)
    return _with_error(critical, jnp.maximum(rise, _rise(pair.eigenvalue, below)))


@program
def _cone_in_doubt(search: Search, cone: Lowest) -> Lowest:
    """Return a pair of V0+ whose error covers the points in doubt.

    Those that nearly touch may be one-sided too, which raises the quotient of the mode; and
    those that hardly press may be free, where the mode leaves a residual.
    """
    hessian, pair = search.hessian, cone.pair
    touching, fixes_mean = search.cone.one_sided, search.cone.fixes_mean
    nowhere = jnp.zeros_like(touching)
    closed = AdmissibleCone(touching | search.nearly_touching, nowhere, fixes_mean)
    opened = AdmissibleCone(touching & ~search.critical_cone.one_sided, nowhere, fixes_mean)
    above, _, _ = admissible_pair(hessian, closed, pair.mode)
    _, _, residual = admissible_pair(hessian, opened, pair.mode)
    rise = _rise(above, pair.eigenvalue)
    return _with_error(cone, jnp.maximum(rise, hessian.scale * residual))


def _rise(above: Scalar, below: Scalar) -> Scalar:
    # Two infinite numbers are alike.
    return jnp.where(above == below, 0, above - below)


def _with_error(lowest: Lowest, error: Scalar) -> Lowest:
    pair = lowest.pair
    pair = replace(pair, error=jnp.maximum(pair.error, jnp.where(jnp.isnan(error), jnp.inf, error)))
    return replace(lowest, pair=pair.with_proof(pair.proved), sign=pair.sign)


def _flag(value: Array) -> Array | np.ndarray:
    """Return a value as it is if traced, otherwise in NumPy, where nothing need be compiled."""
    return value if is_traced(value) else np.asarray(value)


def _unless(is_lacking: Bool[Array | np.ndarray, ""], pair: Eigenpair) -> Eigenpair:
    return replace(
        pair,
        eigenvalue=jnp.where(is_lacking, jnp.nan, pair.eigenvalue),
        result=RESULTS.where(is_lacking, RESULTS.not_computed, pair.result),
    )
