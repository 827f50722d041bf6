"""What jaxstab says of small problems, each posed as a state of a contact."""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from small_problems import Problem

import jaxstab as js
from jaxstab.loads import Load


class Cosine(eqx.Module):
    """f(g) = -s cos(g + phase): where the gap is chosen, f'' is any number in [-s, s]."""

    strength: jax.Array
    phase: jax.Array

    def __call__(self, gap):
        return -self.strength * jnp.cos(gap + self.phase)


class Case(NamedTuple):
    """A problem as arrays for `assess`."""

    youngs_modulus: np.ndarray
    strength: np.ndarray
    phase: np.ndarray
    gap: np.ndarray
    in_contact: np.ndarray
    reaction: np.ndarray
    fault: np.ndarray


def assess_all(
    problems: list[Problem], solver: js.solvers.ConeSolver | None = None
) -> list[tuple[js.results.Stability, np.ndarray]]:
    """Return what `assess` says of problems of one shape and one kind of load, one by one."""
    cases = jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(case_of, problems))
    anchor = template(problems[0].shape, problems[0].load)
    out = jax.device_get(assess(anchor, cases, solver))
    return [jax.tree.map(lambda leaf, i=i: leaf[i], out) for i in range(len(problems))]


@eqx.filter_jit
def assess(
    anchor: js.results.Equilibrium, cases: Case, solver: js.solvers.ConeSolver | None
) -> tuple[js.results.Stability, jax.Array]:
    """Return the stability of every case, and its D as the library has it."""

    def one(case: Case) -> tuple[js.results.Stability, jax.Array]:
        contact, equilibrium = state_of(anchor, case)
        stability = js.assess_stability(contact, equilibrium, solver, throw=False)
        return stability, contact.curvature(case.gap)

    return jax.vmap(one)(cases)


@cache
def template(shape: tuple[int, ...], load: type[Load]) -> js.results.Equilibrium:
    contact = js.Contact(js.HalfSpace(js.Grid(shape), 1.0), jnp.zeros(shape), lambda gap: 0 * gap)
    return replace(js.equilibrate(contact, js.MeanGap(1.0)), load=load(1.0))


def case_of(problem: Problem) -> Case:
    """Return a law and a gap with the problem's D."""
    strength = 2 * np.abs(problem.curvature).max()
    angles = np.arccos(problem.curvature / strength)
    touching = angles[problem.in_contact][:1]
    phase = touching[0] if touching.size else 0.0
    gap = np.where(angles > phase, angles - phase, angles - phase + 2 * np.pi)
    return Case(
        np.array(problem.youngs_modulus),
        np.array(strength),
        np.array(phase),
        np.where(problem.in_contact, 0, gap),
        problem.in_contact,
        problem.reaction,
        np.array(problem.fault),
    )


def state_of(
    anchor: js.results.Equilibrium, case: Case
) -> tuple[js.Contact, js.results.Equilibrium]:
    """Return a contact, and a state of it: the heights are such that pressures balance."""
    solid = js.HalfSpace(js.Grid(case.gap.shape), case.youngs_modulus)
    attraction = case.strength * jnp.sin(case.gap + case.phase)
    pressure = case.reaction - attraction
    heights = solid.displacement(pressure) - case.gap
    contact = js.Contact(solid, heights, Cosine(case.strength, case.phase))
    is_pressed = isinstance(anchor.load, js.MeanPressure)
    wrong = jnp.where(jnp.arange(4) == case.fault - 1, jnp.nan, 0)
    return contact, replace(
        anchor,
        load=anchor.load.at(jnp.mean(pressure if is_pressed else case.gap)),
        gap=case.gap.at[(0,) * case.gap.ndim].add(wrong[0]),
        in_contact=case.in_contact,
        reaction=case.reaction + wrong[1],
        pressure=pressure + wrong[2],
        result=js.RESULTS.where(case.fault == 4, js.RESULTS.stagnated, js.RESULTS.successful),
    )
