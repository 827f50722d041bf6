"""The stability of a state: three eigenvalues, and their verdict."""

from typing import Annotated

import equinox as eqx
from jaxtyping import Array, Int

from jaxstab.core.display import Outcome
from jaxstab.core.enumeration import Enumeration, member
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.core.units import NO_UNITS, NUMBER, STIFFNESS, Units
from jaxstab.stability.barrier import Barrier
from jaxstab.stability.eigenpair import Eigenpair


class VERDICTS(Enumeration):
    """The verdict on the stability of an equilibrium.

    Example:
        >>> verdict = js.assess_stability(contact, state).verdict
        >>> print(verdict, bool(verdict == "held_by_contact"))
        held_by_contact True
    """

    stable = member("every small admissible perturbation raises the energy to second order")
    held_by_contact = member(
        "a strict local minimum, since lifting off costs energy at first order; "
        "beyond a finite barrier lifting off lowers it"
    )
    unstable = member("an arbitrarily small admissible perturbation lowers the energy")
    undecided = member("an eigenvalue is zero to within its error, or a solver did not converge")


class AngularMode(Outcome):
    """The lowest mode x(r) cos(m theta) of an order m of an axisymmetric contact.

    Attributes:
        order: m.
        eigenvalue: the smallest one, with x = 0 in contact; +inf without a free ring
            [pressure/length].
        error: of the eigenvalue, by rounding [pressure/length].
        mode: x(r), of unit Euclidean norm.
    """

    order: Int[Array, ""]
    eigenvalue: Annotated[Scalar, STIFFNESS]
    error: Annotated[Scalar, STIFFNESS]
    mode: Annotated[Field, NUMBER]


class Stability(Outcome):
    """The stability of an equilibrium.

    Always lower_bound <= cone <= critical.

    Attributes:
        lower_bound: the smallest eigenvalue among all perturbations that the load allows: of
            zero mean under a prescribed mean gap, all under a prescribed pressure.
        cone: the smallest on V0+, whose perturbations do not penetrate the surface (Rey & Bleyer,
            eq. 26). Positive means stable; negative proves nothing where contact presses, since
            lifting off then costs energy at first order.
        critical: the smallest on the critical cone, where points in contact stay if they press,
            and may lift off if they do not. Negative means unstable. In a `CriticalLoad` the points
            that are released count as free.
        complementarity: the least reaction at a point in contact, over the rms of elastic pressure
            and attraction; +inf without contact. Near zero, a point is about to lift off.
        barrier: the energy that holds a state by contact, along the cone's mode to second order;
            NaN elsewhere.
        verdict: a member of `VERDICTS`.
        proved: whether the verdict is proved: no eigenvalue on which it rests can have been
            missed.
        result: how the solvers ended: the first failure, or successful.
        angular: on rings, the lowest mode of each order m = 1, 2, ... that was asked for; the three
            eigenvalues are of order zero. None where no order was.
        units: the units of length and of pressure, None where unknown.

    Example:
        >>> stability = js.assess_stability(contact, state)
        >>> bool(stability.lower_bound.eigenvalue <= stability.cone.eigenvalue)
        True
    """

    lower_bound: Eigenpair
    cone: Eigenpair
    critical: Eigenpair
    complementarity: Annotated[Scalar, NUMBER]
    barrier: Barrier
    verdict: VERDICTS
    proved: Flag
    result: RESULTS
    angular: AngularMode | None = None
    units: Units = eqx.field(static=True, default=NO_UNITS, repr=False)

    @property
    def is_local(self) -> Flag:
        """Whether the verdict is stable but not proved: a lower minimum may have been missed."""
        return (self.verdict == VERDICTS.stable) & ~self.proved

    @property
    def pairs(self) -> dict[str, Eigenpair]:
        """The three eigenpairs by name, from the lowest to the highest."""
        return {"lower_bound": self.lower_bound, "cone": self.cone, "critical": self.critical}


def verdict_on(
    lower_bound: Eigenpair, cone: Eigenpair, critical: Eigenpair, is_critical_positive: Flag
) -> VERDICTS:
    """Return the verdict on three eigenpairs, given whether contact is sure to hold."""
    is_held = (cone.sign < 0) & is_critical_positive
    verdict = VERDICTS.where(is_held, VERDICTS.held_by_contact, VERDICTS.undecided)
    verdict = VERDICTS.where(critical.sign < 0, VERDICTS.unstable, verdict)
    is_stable = (cone.sign > 0) | (lower_bound.sign > 0)
    return VERDICTS.where(is_stable, VERDICTS.stable, verdict)


def proof_of(verdict: VERDICTS, cone: Eigenpair, critical: Eigenpair) -> Flag:
    """Return whether a verdict is proved, given the pairs on both cones.

    A negative eigenvalue proves itself, by its mode; a positive one must not be below zero.
    """
    is_held = (verdict == VERDICTS.held_by_contact) & (critical.bound > 0)
    is_stable = (verdict == VERDICTS.stable) & (cone.bound > 0)
    return is_stable | is_held | (verdict == VERDICTS.unstable)


def first_failure(*pairs: Eigenpair) -> RESULTS:
    """Return how the first of several pairs failed, or successful."""
    result = RESULTS.successful
    for pair in reversed(pairs):
        failed = (pair.result != RESULTS.successful) & (pair.result != RESULTS.not_computed)
        result = RESULTS.where(failed, pair.result, result)
    return result


def describe(stability: Stability) -> str:
    """Say which eigenvalue was not found."""
    for name, pair in stability.pairs.items():
        if pair.result == RESULTS.other_contact or pair.result == RESULTS.no_equilibrium:
            return "There is nothing to assess"
        if pair.result != RESULTS.successful and pair.result != RESULTS.not_computed:
            return (
                f"The {name} eigenvalue was not found after {int(pair.num_steps)} steps; at "
                f"{float(pair.eigenvalue):.6g} the projected residual is {float(pair.residual):.3g}"
            )
    return "All eigenvalues were found"
