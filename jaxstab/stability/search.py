"""The three smallest eigenvalues of an equilibrium: on all perturbations and on both cones.

Each cone is searched from the lowest modes of the linear space around it, its hull. Without contact
all three eigenvalues are one. Where every contact point presses, the critical cone is a linear
space.
"""

from jaxtyping import PRNGKeyArray

from jaxstab.contact.hessian import Hessian
from jaxstab.core.checks import concrete
from jaxstab.core.control_flow import cond
from jaxstab.core.progress import advance_if_known
from jaxstab.core.types import ArrayLike, Flag
from jaxstab.stability.certificate import certified
from jaxstab.stability.coarse_start import (
    coarser,
    has_coarser,
    is_trusted,
    mode_from,
    roughly,
    start_from_coarse,
    start_from_hull,
    starts_on_space,
)
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenproblems import Eigenproblems, Found, covering_doubt
from jaxstab.stability.lowest_pair import (
    Lowest,
    lowest_of,
    mode_on_cone,
    modes_around,
    random_starts,
)
from jaxstab.stability.solvers.base import ConeSolver, SpaceSolver
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG


def smallest_eigenpairs(
    problems: Eigenproblems,
    solver: ConeSolver,
    spaces: SpaceSolver,
    key: PRNGKeyArray,
    verdict_only: Flag,
) -> Found:
    """Return the smallest eigenpairs, of V0+ by one solver and of linear spaces by another.

    The key is the random key of vectors to start from. With `verdict_only` the searches stop at a
    number that proves the verdict.
    """
    hessian = problems.hessian
    touches = concrete(problems.touches)
    is_doubtful = concrete(problems.is_doubtful)
    stops_early = concrete(verdict_only)
    is_default = isinstance(solver, ProjectedLOBPCG)
    fast = solver
    if not is_default:
        fast = ProjectedLOBPCG(solver.tolerance_in(hessian.curvature.dtype))

    # All perturbations that the load allows: the linear space around the cone.
    around = _lowest_on_hull(spaces, hessian, problems.cone, key)
    advance_if_known(around)
    is_proved = stops_early & (concrete(around.sign) > 0)

    # The critical cone: a linear space, unless some point touches without pressing.
    is_open = touches & ~is_proved
    cone = problems.critical_cone
    hull = cond(
        is_open, lambda: _lowest_on_hull(spaces, hessian, cone, key), lambda: around.known_before()
    )
    is_weak = is_open & concrete(problems.is_weak)
    critical = _lowest_on_cone(fast, spaces, hessian, cone, hull, key, is_weak)
    advance_if_known(critical)
    is_decided = is_proved | (stops_early & (concrete(critical.sign) < 0))

    # The cone V0+; a solver that the caller has chosen always runs.
    is_open = touches & ~is_decided
    cone = problems.cone
    is_needed = True
    if is_default:
        is_needed = is_open
    lowest = _lowest_on_cone(solver, spaces, hessian, cone, around, key, is_needed)

    # A proof, if the eigenvalue on the cone is positive and none is known.
    lacks_proof = (concrete(lowest.sign) > 0) & (concrete(around.sign) <= 0)
    lacks_proof &= ~concrete(lowest.pair.proved) & ~is_doubtful
    is_needed = is_open & lacks_proof
    proved = cond(
        is_needed, lambda: certified(spaces, hessian, cone, lowest, around), lambda: lowest
    )
    advance_if_known(proved)

    found = Found(around.pair, proved.pair, critical.pair, hull.pair, is_proved, is_decided)
    return cond(is_doubtful, lambda: covering_doubt(problems, found), lambda: found)


def _lowest_on_hull(
    spaces: SpaceSolver, hessian: Hessian, cone: AdmissibleCone, key: PRNGKeyArray
) -> Lowest:
    """Return the lowest pair on the linear space around a cone.

    On a large grid the search begins with the modes of the coarser problem.
    """
    if not has_coarser(hessian):
        found, modes = modes_around(spaces, hessian, cone, random_starts(key, hessian))
        return lowest_of(hessian, cone, found, modes)
    rough = roughly(spaces, hessian.curvature)
    problem = coarser(hessian, cone)
    coarse, modes = modes_around(rough, *problem, random_starts(key, problem[0]))
    starts, cost = starts_on_space(coarse, modes, key, hessian.curvature)
    found, modes = modes_around(spaces, hessian, cone, starts)
    return lowest_of(hessian, cone, found, modes, before=cost)


def _lowest_on_cone(
    solver: ConeSolver,
    spaces: SpaceSolver,
    hessian: Hessian,
    cone: AdmissibleCone,
    hull: Lowest,
    key: PRNGKeyArray,
    is_needed: ArrayLike,
) -> Lowest:
    """Return the lowest pair on a cone, or where it is not needed the pair on its hull."""

    def search() -> Lowest:
        if not (has_coarser(hessian) and isinstance(solver, ProjectedLOBPCG)):
            return _from_all_starts(solver, hessian, cone, hull, key)
        return _from_one_start(solver, spaces, hessian, cone, hull, key)

    return cond(is_needed, search, lambda: hull.known_before())


def _from_one_start(
    solver: ProjectedLOBPCG,
    spaces: SpaceSolver,
    hessian: Hessian,
    cone: AdmissibleCone,
    hull: Lowest,
    key: PRNGKeyArray,
) -> Lowest:
    """Return the lowest pair on a cone of a large grid, outside of a trace.

    It is sought from the lowest mode around the cone, if that is the answer, or from the mode of
    the coarser problem; and from all starts only where the pair does not agree with that problem.
    """
    start = start_from_hull(solver, cone, hull)
    if not start.is_known:
        problem = coarser(hessian, cone)
        random = random_starts(key, problem[0])
        around, modes = modes_around(roughly(spaces, hessian.curvature), *problem, random)
        rough = roughly(solver, hessian.curvature)
        coarse, _ = mode_on_cone(rough, *problem, around.result, modes, random)
        start = start_from_coarse(*problem, around, coarse, hessian.curvature)
    found, is_answer = mode_from(solver, hessian, cone, start)
    first = lowest_of(hessian, cone, found, hull.modes, is_answer, start.cost)
    if is_trusted(start, first):
        return first
    return _from_all_starts(solver, hessian, cone, hull, key, first)


def _from_all_starts(
    solver: ConeSolver,
    hessian: Hessian,
    cone: AdmissibleCone,
    hull: Lowest,
    key: PRNGKeyArray,
    before: Lowest | None = None,
) -> Lowest:
    """Return the lowest pair on a cone, also from an earlier result if there is one."""
    random = random_starts(key, hessian)
    mode = None
    cost = None
    if before is not None:
        mode = before.pair.mode
        cost = before.cost
    around = hull.pair.result
    found, is_answer = mode_on_cone(solver, hessian, cone, around, hull.modes, random, mode)
    return lowest_of(hessian, cone, found, hull.modes, is_answer, cost)
