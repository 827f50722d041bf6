"""The three smallest eigenvalues of an equilibrium: on all perturbations and on both cones.

Each cone is searched from the lowest modes of the linear space around it, its hull. Without contact
all three eigenvalues coincide. Where every contact point presses, the critical cone is a linear
space.
"""

from jaxtyping import PRNGKeyArray

from jaxstab.core.checks import concrete
from jaxstab.core.control_flow import cond
from jaxstab.core.progress import advance_if_known
from jaxstab.core.types import ArrayLike, Flag
from jaxstab.stability.certificate import certify
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
from jaxstab.stability.eigenproblems import Eigenproblems, SmallestPairs, covering_doubt
from jaxstab.stability.lowest_pair import (
    Lowest,
    lowest_of,
    mode_on_cone,
    modes_around,
    random_starts,
)
from jaxstab.stability.solvers.base import ConeProblem, ConeSolver, SpaceSolver
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG


def smallest_eigenpairs(
    problems: Eigenproblems,
    solver: ConeSolver,
    spaces: SpaceSolver,
    key: PRNGKeyArray,
    verdict_only: Flag,
) -> SmallestPairs:
    """Return the smallest eigenpairs, of V0+ by one solver and of linear spaces by another.

    The key is the random key of vectors to start from. With `verdict_only` the searches stop at a
    number that proves the verdict.
    """
    touches = concrete(problems.touches)
    is_doubtful = concrete(problems.is_doubtful)
    stops_early = concrete(verdict_only)
    is_default = isinstance(solver, ProjectedLOBPCG)
    fast = solver
    if not is_default:
        fast = ProjectedLOBPCG(solver.tolerance_in(problems.cone.operator.curvature.dtype))

    # All perturbations that the load allows: the linear space around the cone.
    lower_bound = lowest_on_hull(spaces, problems.cone, key)
    advance_if_known(lower_bound)
    is_proved = stops_early & (concrete(lower_bound.sign) > 0)

    # The critical cone: a linear space, unless some point touches without pressing.
    is_undecided = touches & ~is_proved
    problem = problems.critical_cone
    hull = cond(
        is_undecided,
        lambda: lowest_on_hull(spaces, problem, key),
        lambda: lower_bound.without_cost(),
    )
    is_weak = is_undecided & concrete(problems.is_weak)
    critical = _lowest_on_cone(fast, spaces, problem, hull, key, is_weak)
    advance_if_known(critical)
    is_decided = is_proved | (stops_early & (concrete(critical.sign) < 0))

    # The cone V0+; a solver that the caller has chosen always runs.
    is_undecided = touches & ~is_decided
    problem = problems.cone
    is_needed = True
    if is_default:
        is_needed = is_undecided
    lowest = _lowest_on_cone(solver, spaces, problem, lower_bound, key, is_needed)

    # A proof, if the eigenvalue on the cone is positive and none is known.
    lacks_proof = (concrete(lowest.sign) > 0) & (concrete(lower_bound.sign) <= 0)
    lacks_proof &= ~concrete(lowest.pair.proved) & ~is_doubtful
    is_needed = is_undecided & lacks_proof
    proved = cond(is_needed, lambda: certify(spaces, problem, lowest, lower_bound), lambda: lowest)
    advance_if_known(proved)

    found = SmallestPairs(lower_bound.pair, proved.pair, critical.pair, hull.pair)
    covered = cond(is_doubtful, lambda: covering_doubt(problems, found), lambda: found)
    left = cond(is_decided, lambda: covered.without("cone"), lambda: covered)
    return cond(is_proved, lambda: left.without("critical"), lambda: left)


def lowest_on_hull(spaces: SpaceSolver, problem: ConeProblem, key: PRNGKeyArray) -> Lowest:
    """Return the lowest pair on the linear space around a cone.

    On a large grid the search begins with the modes of the coarser problem.
    """
    hessian = problem.operator
    if not has_coarser(hessian):
        found, modes = modes_around(spaces, problem, random_starts(key, hessian))
        return lowest_of(problem, found, modes)
    rough = roughly(spaces, hessian.curvature)
    coarse_problem = coarser(problem)
    random = random_starts(key, coarse_problem.operator)
    coarse, modes = modes_around(rough, coarse_problem, random)
    starts, cost = starts_on_space(coarse, modes, key, hessian.curvature)
    found, modes = modes_around(spaces, problem, starts)
    return lowest_of(problem, found, modes, before=cost)


def _lowest_on_cone(
    solver: ConeSolver,
    spaces: SpaceSolver,
    problem: ConeProblem,
    hull: Lowest,
    key: PRNGKeyArray,
    is_needed: ArrayLike,
) -> Lowest:
    """Return the lowest pair on a cone, or where it is not needed the pair on its hull."""

    def search() -> Lowest:
        if not (has_coarser(problem.operator) and isinstance(solver, ProjectedLOBPCG)):
            return from_all_starts(solver, problem, hull, key)
        return from_one_start(solver, spaces, problem, hull, key)

    return cond(is_needed, search, lambda: hull.without_cost())


def from_one_start(
    solver: ProjectedLOBPCG,
    spaces: SpaceSolver,
    problem: ConeProblem,
    hull: Lowest,
    key: PRNGKeyArray,
) -> Lowest:
    """Return the lowest pair on a cone of a large grid, outside of a trace.

    It is sought from the lowest mode around the cone, if that is the answer, or from the mode of
    the coarser problem; and from all starts only where the pair does not agree with that problem.
    """
    start = start_from_hull(solver, problem.domain, hull)
    if not start.is_known:
        fine = problem.operator.curvature
        coarse_problem = coarser(problem)
        random = random_starts(key, coarse_problem.operator)
        coarse_hull, modes = modes_around(roughly(spaces, fine), coarse_problem, random)
        rough = roughly(solver, fine)
        coarse, _ = mode_on_cone(rough, coarse_problem, coarse_hull.result, modes, random)
        start = start_from_coarse(coarse_problem, coarse_hull, coarse, fine)
    found, is_proved_lowest = mode_from(solver, problem, start)
    first = lowest_of(problem, found, hull.modes, is_proved_lowest, start.cost)
    if is_trusted(start, first):
        return first
    return from_all_starts(solver, problem, hull, key, first)


def from_all_starts(
    solver: ConeSolver,
    problem: ConeProblem,
    hull: Lowest,
    key: PRNGKeyArray,
    before: Lowest | None = None,
) -> Lowest:
    """Return the lowest pair on a cone, also from an earlier result if there is one."""
    random = random_starts(key, problem.operator)
    mode = None
    cost = None
    if before is not None:
        mode = before.pair.mode
        cost = before.cost
    result = hull.pair.result
    found, is_proved_lowest = mode_on_cone(solver, problem, result, hull.modes, random, mode)
    return lowest_of(problem, found, hull.modes, is_proved_lowest, cost)
