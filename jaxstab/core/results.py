"""How a solve can end, and how a failure is raised."""

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
from jaxtyping import Array, Bool, PyTree

from jaxstab.core.checks import is_traced
from jaxstab.core.enumeration import Enumeration, member

Tree = TypeVar("Tree")


class RESULTS(Enumeration):
    """How a solve ended: a name, and a sentence on the cause and the cure.

    Example:
        >>> bool(state.result == js.RESULTS.successful), bool(state.result == "successful")
        (True, True)
        >>> js.RESULTS["successful"]
        'successful: the tolerance was reached'
    """

    successful = member("the tolerance was reached")
    max_steps_reached = member(
        "the solver reached its step limit before its tolerance. Raise the solver's "
        "`max_steps`, loosen its `tolerance`, or start nearer to the solution"
    )
    stagnated = member(
        "the residual stopped falling before it reached the tolerance. Either the tolerance is "
        "finer than the precision allows: loosen it, or use `float64`. Or the solver alternates "
        "between states: start elsewhere, for instance from a neighbouring load. Or the slope of "
        "the law jumps, where a point can rest in no balance: give a smooth law"
    )
    nonfinite = member(
        "a NaN or an infinity appeared. Check that the potential and its two "
        "derivatives are finite for every gap >= 0, and that no input is NaN. A potential that is "
        "infinite at zero gap needs PreconditionedConjugateGradient"
    )
    invalid_contact = member(
        "the heights are not finite, or the value or the slope of the law jumps (make the contact "
        "outside of jax.jit to see where), or a stiffness of the solid is not positive, or it is "
        "outside the range of the precision. Use a modulus > 0, a Poisson's ratio in (-1, 0.5], or "
        "other units"
    )
    infeasible_load = member(
        "this contact cannot carry the load. A mean gap must be positive and finite, and a mean "
        "pressure finite, and below the mean hardness of a surface with one. A load on the far "
        "side needs a solid of finite thickness that is not incompressible. Prescribe a mean "
        "displacement above the mean height"
    )
    sunk = member(
        "the solid is pressed below the surface's lowest point and bulges around its edges. Press "
        "less, or take a larger window"
    )
    pulled_off = member(
        "no equilibrium was found, since nothing holds the surfaces together at this load: they "
        "separate. Pull less or press, start from a state in contact, or prescribe the mean gap"
    )
    no_equilibrium = member(
        "there was no converged equilibrium to assess. See the `result` of the equilibrium"
    )
    other_contact = member(
        "the state is not an equilibrium of this contact: its pressures are out of balance. Use "
        "the contact and the load that it came from"
    )
    no_fold = member(
        "between the two loads the critical eigenvalue does not vanish and no contact point is "
        "released in a jump. Follow a path between them by `jaxstab.follow`, and narrow the bracket"
    )
    no_jump = member(
        "the surfaces separate without a jump, since the machine is stiff. Take the largest "
        "tension of a path by `jaxstab.follow`, or a softer machine"
    )
    no_attraction = member(
        "the law attracts nowhere, so that nothing holds the surfaces together under tension. Give "
        "a law with a positive slope at some gap"
    )
    unbalanced_work = member(
        "on steps without a jump the surfaces gained energy that no load supplied: more than the "
        "error of the sum over the steps. Either the law is not smooth, so that its value or its "
        "slope jumps: give a smooth one, for instance jaxstab.potentials.CutOff of the law. Or "
        "jumps are artefacts of a coarse grid: refine it"
    )
    lost_branch = member(
        "the branch could not be followed on by steps of the least length. If it is in float32, "
        "compute in float64. Otherwise lower the `min_step` of a continuation, or resolve the law "
        "better, by more points or a longer range"
    )
    store_full = member(
        "the store is full before the end. Raise `max_steps`, `max_states` or `max_jumps`, follow "
        "a shorter load path, or locate fewer jumps (`smallest_jump`). In time raise `rtol`: below "
        "1e-5, and 1e-3 in float32, rounding of equilibria makes steps ever shorter"
    )
    interrupted = member("it was interrupted; the states before are kept")
    same_state = member(
        "both states relax to the same one at this load. Give two separate states, as the two "
        "sides of a jump at a load just before it"
    )
    no_pass = member(
        "no equilibrium with one negative eigenvalue was found near the highest state of the "
        "string. Give more images (`num_images`), or states that are closer to each other: there "
        "may be minima between them"
    )
    no_detachment = member(
        "on the branch around the pull-off no state at this load has one negative eigenvalue and "
        "joins the start with detached surfaces. Follow the branch by jaxstab.continuation towards "
        "lower pressures to see where it leads: at a symmetric surface the pass may break the "
        "symmetry, which the branch does not"
    )
    not_computed = member(
        "another number already proves the verdict. Assess without `verdict_only`"
    )
    too_many_modes = member(
        "there are fewer admissible directions than requested modes. Lower `count`"
    )
    no_fit = member(
        "the curve does not describe the measurements: a parameter is at its bound or is not "
        "determined, or the misfit is hardly less than a zero or a constant curve has. Look at "
        "signs, units and outliers, plot the fitted curve beside the measurements, or fit fewer "
        "parameters"
    )
    misfit = member(
        "the model does not describe the measurements: the misfit is many times the noise. The "
        "parameters are those of the best fit. Look at the fitted curve: another shape of the tip, "
        "a layered or viscous sample, hysteresis or a tilted contact are usual causes"
    )
    undetermined = member(
        "the measurements do not determine all parameters: others describe them as well. The "
        "errors say which. Fit fewer parameters, or measure for longer, with less noise or at more "
        "points"
    )
    long_steps = member(
        "the steps violate 1 / tau - sigma >= beta / 2, beta the bound on |A|, from which the "
        "iteration is known to converge. Lower `tau` or `sigma`, or leave them out"
    )
    unordered_times = member("the times do not increase: give them in increasing order, each once")


class SolverError(RuntimeError):
    """A solver did not reach its tolerance; the message gives the cause and the cure.

    Attributes:
        found: the result, as with `throw=False`.

    Example:
        >>> try:
        ...     found = js.equilibrate(contact, js.MeanPressure(-1.0))
        ... except js.exceptions.SolverError:
        ...     print("no equilibrium")
        no equilibrium
    """

    def __init__(self, message: str, found: PyTree = None):
        super().__init__(message)
        self.found = found


def throw_failure(
    result: RESULTS, tree: Tree, describe: Callable[[], str], throw: bool = True
) -> Tree:
    """Return `tree`, or raise if `result` is not successful and failures are thrown.

    Of several results the last one counts. An interrupted search has not failed.
    Outside of JAX transformations the error is a `SolverError` that begins with `describe()` and
    holds the tree. Inside, it is a runtime error of Equinox, raised if any entry of a batch failed.
    """
    if not throw:
        return tree
    if result.stack_shape:
        result = result[-1]
    failed: Bool[Array, ...] = (result != RESULTS.successful) & (result != RESULTS.interrupted)
    if is_traced(failed):
        return eqx.branched_error_if(tree, failed, result.code, RESULTS.texts.tolist())
    if failed:
        raise SolverError(f"{describe()}: {RESULTS[result]}.", tree)
    return tree
