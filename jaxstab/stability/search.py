"""The three smallest eigenvalues of an equilibrium: on all perturbations and on both cones.

Each cone is searched from the lowest modes of the linear space around it, its hull: where the
lowest is admissible, it is the answer.
"""

from dataclasses import replace
from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.hessian import Block, Hessian
from jaxstab.results import RESULTS
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpairs import (
    Admissible,
    Eigenpair,
    Minimiser,
    lowered,
    measured,
    unit_vector,
)
from jaxstab.stability.lobpcg import LOBPCG
from jaxstab.stability.modes import BLOCK_SIZE
from jaxstab.stability.projected import ProjectedLOBPCG
from jaxstab.stability.proximal import ProximalIteration

Tree = TypeVar("Tree")
# A block of modes, and whether the lowest is found.
_Known = tuple[Block, Bool[Array, ""]]
ConeSolver = ProximalIteration | ProjectedLOBPCG


class Search(eqx.Module):
    """A search for smallest eigenvalues at one equilibrium.

    Attributes:
        hessian: A.
        in_contact: where the surfaces touch.
        presses: where the contact reaction is more than an error.
        is_equilibrium: whether there is anything to look for; otherwise all is NaN.
        random: vectors to start from.
        tolerance: the residual to reach.
        fixes_mean: whether perturbations have zero mean.
        verdict_only: whether to stop at a number that proves the verdict.
    """

    hessian: Hessian
    in_contact: Bool[Array, " *grid"]
    presses: Bool[Array, " *grid"]
    is_equilibrium: Bool[Array, ""]
    random: Block
    tolerance: Float[Array, ""]
    fixes_mean: bool = eqx.field(static=True)
    verdict_only: bool = eqx.field(static=True)

    def run(self, solver: ConeSolver) -> tuple[Eigenpair, Eigenpair, Eigenpair]:
        """Return the eigenpairs lower_bound, cone and critical, the solver being the cone's."""
        nowhere = jnp.zeros_like(self.in_contact)
        cone = AdmissibleCone(self.in_contact, nowhere, self.fixes_mean)
        weak, pressed = self.in_contact & ~self.presses, self.in_contact & self.presses
        critical_cone = AdmissibleCone(weak, pressed, self.fixes_mean)
        (lower_bound, critical_bound), around = self._on_spaces(cone.hull, critical_cone.hull)
        is_proved = self.verdict_only & lower_bound.is_positive
        if isinstance(solver, ProximalIteration):
            is_proved, critical = self._on_cone(is_proved, (critical_cone, around[1]))
            # Algorithm 1 as it is, from one random vector.
            found = solver.solve(self.hessian, cone, self._starts(self.random, is_proved))
            smallest = self._pair(cone, found, is_proved)
        else:
            cones = _stack((critical_cone, around[1]), (cone, around[0]))
            # A method that holds arrays cannot be hashed, as a scan would have it.
            _, pairs = jax.lax.scan(lambda *step: self._on_cone(*step), is_proved, cones)
            critical, smallest = _unstack(pairs)
        critical = _after(critical_bound, critical)
        smallest = lowered(smallest, critical.eigenvalue, critical.mode, self.hessian, cone)
        is_lacking = jnp.isnan(smallest.eigenvalue)
        eigenvalue = jnp.where(is_lacking, critical.eigenvalue, smallest.eigenvalue)
        mode = jnp.where(is_lacking, critical.mode, smallest.mode)
        lower_bound = lowered(lower_bound, eigenvalue, mode, self.hessian, cone.hull)
        return lower_bound, smallest, critical

    def _on_spaces(self, *spaces: Subspace) -> tuple[list[Eigenpair], list[_Known]]:
        """Return the lowest pair on each of two spaces, and what is known of their modes."""

        def step(carry: tuple[Block, Array], space: Subspace) -> tuple[tuple, tuple]:
            modes, is_proved = carry
            # Where nothing is held both spaces are the same, and so are their modes.
            starts = jnp.where(jnp.all(space.is_moving), modes, noise)
            hessian = self.hessian.restricted(space.is_moving)
            found = LOBPCG(self.tolerance).solve(hessian, space, self._starts(starts, is_proved))
            pair = self._pair(space, found.at(found.vector[0]), is_proved)
            return (found.vector, self.verdict_only & pair.is_positive), (pair, found.vector)

        noise = self.random[:BLOCK_SIZE]
        # A scan, since one program for both takes half the time to compile.
        _, (pairs, modes) = jax.lax.scan(step, (noise, jnp.array(False)), _stack(*spaces))
        return _unstack(pairs), _unstack((modes, pairs.result == RESULTS.successful))

    def _on_cone(
        self, is_proved: Bool[Array, ""], on: tuple[AdmissibleCone, _Known]
    ) -> tuple[Bool[Array, ""], Eigenpair]:
        """Return whether the verdict is proved, and the pair on a cone."""
        cone, known = on
        hessian = self.hessian.restricted(cone.is_moving)
        starts = self._starts(self._cone_starts(cone, *known), is_proved)
        found = ProjectedLOBPCG(self.tolerance).solve(hessian, cone, starts)
        pair = self._pair(cone, found, is_proved)
        return is_proved | (self.verdict_only & pair.is_negative), pair

    def _cone_starts(self, cone: AdmissibleCone, modes: Block, are_found: Bool[Array, ""]) -> Block:
        """Return what a search on a cone starts from, given modes of its hull.

        The two lowest modes with both signs, and noise; or the lowest alone, where that is found
        and in the cone, and so the answer.
        """
        starts = jnp.concatenate([modes[:2], -modes[:2], self.random])
        distances = [jnp.linalg.norm(x - unit_vector(cone, x)) for x in (modes[0], -modes[0])]
        lowest = jnp.where(distances[0] <= distances[1], modes[0], -modes[0])
        is_answer = are_found & (jnp.minimum(*distances) <= self.tolerance)
        return jnp.where(is_answer, jnp.full_like(starts, jnp.nan).at[0].set(lowest), starts)

    def _starts(self, vectors: Block, is_proved: Bool[Array, ""]) -> Block:
        # From NaN, solvers end at once.
        return jnp.where(self.is_equilibrium & ~is_proved, vectors, jnp.nan)

    def _pair(self, on: Admissible, found: Minimiser, is_proved: Bool[Array, ""]) -> Eigenpair:
        pair = measured(self.hessian.restricted(on.is_moving), on, found)
        result = RESULTS.where(is_proved, RESULTS.not_computed, pair.result)
        result = RESULTS.where(self.is_equilibrium, result, RESULTS.no_equilibrium)
        is_known = self.is_equilibrium & ~is_proved
        return replace(
            pair, eigenvalue=jnp.where(is_known, pair.eigenvalue, jnp.nan), result=result
        )


def _stack(*trees: Tree) -> Tree:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _unstack(pair: Tree) -> list[Tree]:
    return [jax.tree.map(lambda leaf, i=i: leaf[i], pair) for i in range(2)]


def _after(first: Eigenpair, then: Eigenpair) -> Eigenpair:
    """Return the second of two pairs, at the cost of both."""
    was_answer = then.num_steps == 0
    return replace(
        then,
        num_steps=first.num_steps + then.num_steps,
        num_applications=first.num_applications + then.num_applications,
        history=jax.tree.map(partial(jnp.where, was_answer), first.history, then.history),
    )
