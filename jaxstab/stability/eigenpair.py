"""A smallest eigenvalue on a cone: the solver's result, and its residual."""

from dataclasses import replace
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxstab.contact.hessian import SymmetricOperator
from jaxstab.core import model
from jaxstab.core.accuracy import rounding_of_numbers
from jaxstab.core.display import Outcome
from jaxstab.core.grid import total
from jaxstab.core.history import History
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.core.units import NUMBER, STIFFNESS
from jaxstab.stability.cones import AdmissibleCone, Subspace

Admissible = Subspace | AdmissibleCone


class Minimum(eqx.Module):
    """The result of a solver: a vector near a minimiser of the Rayleigh quotient, and its cost.

    Attributes:
        vector: the vector, which need not be admissible to the last digit; for a solver on a
            linear space, a block of vectors.
        num_steps: steps taken.
        num_applications: applications of A and of the preconditioner.
        result: how the solver ended.
        history: its indicators as it went.

    Example:
        >>> [field for field in js.solvers.Minimum.__dataclass_fields__]
        ['vector', 'num_steps', 'num_applications', 'result', 'history']
    """

    vector: Field
    num_steps: Int[Array, ""]
    num_applications: Int[Array, ""]
    result: RESULTS
    history: History


class Eigenpair(Outcome):
    """A smallest eigenvalue of A = K + D among admissible unit vectors, and its mode.

    Attributes:
        eigenvalue: lambda = x.Ax / x.x, without the factor 1/2 of Rey & Bleyer's eq. 26
            [pressure/length]; +inf where no perturbation is admissible.
        mode: x, of unit Euclidean norm; zero where no perturbation is admissible.
        residual: the projected residual |x - P(x - (A x - lambda x) / b)| b / s, with b a bound
            on |A| and s its size on the lower modes, which is b where f'' is nowhere positive.
        error: s times the residual, and rounding: how far lambda is from an eigenvalue of A on
            the face of the cone on which x lies [pressure/length].
        proved: whether it is proved to be the smallest, to within its error. That can be so on a
            linear space, and on a cone that holds the lowest mode of the space around it.
        bound: a proved lower bound of the smallest eigenvalue [pressure/length]; -inf if none is
            proved.
        num_steps: steps that the solver took, from all its starts.
        num_applications: applications of A and of the preconditioner, at a pair of Fourier
            transforms each.
        result: a member of `RESULTS`: how the solver ended.
        history: the indicators of the solver as it went, "residual" and others.

    Example:
        >>> pair = js.assess_stability(contact, state).critical
        >>> f"{pair.eigenvalue:.3f}", bool(pair.proved)
        ('1.282', True)
    """

    eigenvalue: Annotated[Scalar, STIFFNESS]
    mode: Annotated[Field, NUMBER]
    residual: Annotated[Scalar, NUMBER]
    error: Annotated[Scalar, STIFFNESS]
    proved: Flag
    bound: Annotated[Scalar, STIFFNESS]
    num_steps: Int[Array, ""]
    num_applications: Int[Array, ""]
    result: RESULTS
    history: History

    @property
    def sign(self) -> Int[Array, ""]:
        """1 or -1 where the eigenvalue is converged and larger than its error, otherwise 0."""
        is_sure = (self.result == RESULTS.successful) & (jnp.abs(self.eigenvalue) > self.error)
        return jnp.where(is_sure, jnp.where(self.eigenvalue > 0, 1, -1), 0)

    def with_proof(
        self, is_proved: Bool[ArrayLike, ""], bound: Float[ArrayLike, ""] = -jnp.inf
    ) -> "Eigenpair":
        """Return the pair with its proved bound.

        Arguments:
            is_proved: whether it is the smallest, if the solver found it.
            bound: a lower bound, from elsewhere.
        """
        proved = (self.result == RESULTS.successful) & is_proved
        least = jnp.where(self.eigenvalue == jnp.inf, jnp.inf, self.eigenvalue - self.error)
        return replace(
            self, proved=proved, bound=jnp.maximum(jnp.where(proved, least, -jnp.inf), bound)
        )


def eigenpair_of(
    operator: SymmetricOperator, cone: Admissible, found: Minimum, vector: Field
) -> Eigenpair:
    """Return the eigenpair of a vector that a solver found, brought onto the cone."""
    eigenvalue, mode, residual = admissible_pair(operator, cone, vector)
    # Rounding of A x and of its projection add to the error.
    rounding = 2 * rounding_of_numbers(residual.dtype) * operator.bound
    # A solver of a user's own may return anything.
    is_lost = jnp.isnan(eigenvalue) & (found.result == RESULTS.successful)
    return Eigenpair(
        eigenvalue=eigenvalue,
        mode=mode,
        residual=residual,
        error=operator.scale * residual + rounding,
        proved=jnp.array(False),
        bound=jnp.full_like(eigenvalue, -jnp.inf),
        num_steps=found.num_steps,
        num_applications=found.num_applications + 1,
        result=RESULTS.where(is_lost, RESULTS.nonfinite, found.result),
        history=found.history,
    )


def lower(pair: Eigenpair, eigenvalue: Scalar, mode: Field) -> Eigenpair:
    """Return a pair that is not above an eigenvalue on a smaller cone, given that and its mode.

    If it is lower by more than the pair's own error, the solver missed the smallest. The pair gets
    the other mode, and counts as stagnated.
    """
    is_missed = eigenvalue < pair.eigenvalue - pair.error
    failed = is_missed & (pair.result == RESULTS.successful)
    return replace(
        pair,
        eigenvalue=jnp.where(eigenvalue < pair.eigenvalue, eigenvalue, pair.eigenvalue),
        mode=jnp.where(is_missed, mode, pair.mode),
        residual=jnp.where(is_missed, jnp.inf, pair.residual),
        error=jnp.where(is_missed, jnp.inf, pair.error),
        proved=pair.proved & ~is_missed,
        bound=jnp.where(is_missed, -jnp.inf, pair.bound),
        result=RESULTS.where(failed, RESULTS.stagnated, pair.result),
    )


def admissible_pair(
    operator: SymmetricOperator, cone: Admissible, vector: Field
) -> tuple[Scalar, Field, Scalar]:
    """Return eigenvalue, mode and projected residual of the cone's unit vector nearest to this.

    The eigenvalue is +inf, mode and residual are zero, where that vector is zero.
    """
    mode = unit_vector(cone, vector)
    product = operator(mode)
    quotient = model.rayleigh_quotient(mode, product)
    moved = cone.project(descend(operator, mode, product, quotient))
    residual = projected_residual(operator, mode, moved)
    return jnp.where(jnp.any(mode != 0), quotient, jnp.inf), mode, residual


def descend(operator: SymmetricOperator, mode: Field, product: Field, eigenvalue: Scalar) -> Field:
    """Return x - (A x - lambda x) / b, from x and A x.

    Projected onto a cone, it has no larger Rayleigh quotient than x: with s the change,
    s.(A - lambda) x <= -b |s|^2 while s.(A - lambda) s <= 2 b |s|^2.
    """
    return mode - (product - eigenvalue * mode) / operator.bound


def projected_residual(operator: SymmetricOperator, mode: Field, moved: Field) -> Scalar:
    """Return |x - P(x - (A x - lambda x) / b)| b / s from x and the vector that it is moved to."""
    return jnp.sqrt(total((mode - moved) ** 2)) * (operator.bound / operator.scale)


def unit_vector(cone: Admissible, vector: Field) -> Field:
    """Return the cone's unit vector nearest to this one, or zero where there is none."""
    return jnp.where(cone.is_trivial, 0, model.onto_sphere(cone.project(vector)))
