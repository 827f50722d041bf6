"""Random small problems of stability, many of them adverse, with their exact eigenvalues."""

from collections.abc import Iterator
from functools import cache
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from faces import smallest_on_cone

import jaxstab as js
from jaxstab.loads import Load

SHAPES = ((3, 3), (5, 6), (16,), (8, 8))
LOADS = (js.MeanGap, js.MeanPressure)
FAMILIES = {
    "random": 0.4,
    "eigenvalue of zero": 0.12,
    "multiple eigenvalues": 0.12,
    "hardly free": 0.12,
    "stiff points": 0.08,
    "extreme units": 0.06,
    "detached": 0.05,
    "broken": 0.05,
}
MOST_ONE_SIDED = 9
# Of the norm of A: what rounding may do to exact eigenvalues.
ROUNDING = 1e-14


class Problem(NamedTuple):
    """A state, by the diagonal of its Hessian, D; `fault` is how a broken one is broken."""

    seed: int
    family: str
    shape: tuple[int, ...]
    load: type[Load]
    youngs_modulus: float
    curvature: np.ndarray
    in_contact: np.ndarray
    reaction: np.ndarray
    fault: int

    @property
    def fixes_mean(self) -> bool:
        return self.load is js.MeanGap

    @property
    def presses(self) -> np.ndarray:
        return self.in_contact & (self.reaction > 0)


def random_problem(seed: int) -> Problem:
    """Return a problem with few points in contact that can lift, so that a cone has few faces.

    Its Hessian's diagonal is random over decades, its contact scattered or clustered, its reactions
    positive, some of them zero. The adverse ones have eigenvalues that are zero to rounding,
    multiple eigenvalues, cones with hardly any vector in them, points a trillion times stiffer than
    others, extreme units, or states that are broken.
    """
    random = np.random.default_rng(seed)
    family = str(random.choice(list(FAMILIES), p=list(FAMILIES.values())))
    load = LOADS[random.integers(len(LOADS))]
    shape = SHAPES[0 if family == "hardly free" else random.integers(len(SHAPES))]
    in_contact = random_contact(random, family, shape)
    weak = in_contact & (random.random(shape) < random.choice([0, 0, 0.3, 1]))
    reaction = np.where(in_contact & ~weak, random.uniform(0.01, 1, shape), 0)
    curvature = random_curvature(random, family, in_contact)
    reaction = reaction * np.abs(curvature).max()
    modulus = 10.0 ** random.choice([-12, 12]) if family == "extreme units" else 1.0
    fault = int(random.integers(1, 5)) if family == "broken" else 0
    fields = (modulus * curvature, in_contact, modulus * reaction)
    problem = Problem(seed, family, shape, load, modulus, *fields, fault)
    if family == "eigenvalue of zero":
        value = exact_eigenvalues(problem, dense(problem, curvature))[random.integers(3)]
        shift = value if np.isfinite(value) else 0.0
        problem = problem._replace(curvature=curvature - shift)
    return problem


def random_contact(random: np.random.Generator, family: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return a contact set: scattered, clustered, symmetric, nearly full, or none."""
    size = int(np.prod(shape))
    chosen = np.zeros(size, bool)
    if family == "detached":
        return chosen.reshape(shape)
    if family == "hardly free":
        num_contact = size - int(random.integers(3))
    else:
        num_contact = int(random.integers(0, min(MOST_ONE_SIDED, size - 1) + 1))
    if family == "multiple eigenvalues" and random.random() < 0.7:
        return lattice(shape)
    order = random.permutation(size) if random.random() < 0.5 else outwards(shape)
    chosen[order[:num_contact]] = True
    return chosen.reshape(shape)


def lattice(shape: tuple[int, ...]) -> np.ndarray:
    """Return a set with the symmetries of the grid, empty where it would have too many points."""
    chosen = np.zeros(shape, bool)
    chosen[tuple(slice(None, None, max(n // 2, 3)) for n in shape)] = True
    return chosen if chosen.sum() <= MOST_ONE_SIDED else np.zeros(shape, bool)


def outwards(shape: tuple[int, ...]) -> np.ndarray:
    """Return the numbers of the points by their distance from the first."""
    distances = [np.minimum(i, n - i) for i, n in zip(np.indices(shape), shape, strict=True)]
    return np.argsort(sum(d**2 for d in distances).ravel(), kind="stable")


def random_curvature(
    random: np.random.Generator, family: str, in_contact: np.ndarray
) -> np.ndarray:
    """Return D, the same at all points in contact, since their gap is the same."""
    shape = in_contact.shape
    scale = 10 ** random.uniform(-3, 3)
    curvature = scale * random.normal(size=shape) + scale * random.normal() * random.integers(2)
    if family == "multiple eigenvalues":
        curvature = np.full(shape, scale * random.normal())
    if family == "stiff points":
        stiffer = 10 ** random.uniform(0, 12, shape)
        curvature = np.where(random.random(shape) < 0.2, abs(curvature) * stiffer, curvature)
    touching = curvature.ravel()[0] if random.random() < 0.5 else scale * random.normal()
    return np.where(in_contact, touching, curvature)


def groups(problems: list[Problem]) -> Iterator[list[Problem]]:
    """Yield the problems of each shape and kind of load, which are assessed together."""
    for kind in product(SHAPES, LOADS):
        group = [problem for problem in problems if (problem.shape, problem.load) == kind]
        if group:
            yield group


def dense(problem: Problem, curvature: np.ndarray) -> np.ndarray:
    """Return the Hessian of a problem with a D, which may be its own but for rounding."""
    return problem.youngs_modulus * elastic_matrix(problem.shape) + np.diag(curvature.ravel())


@cache
def elastic_matrix(shape: tuple[int, ...]) -> np.ndarray:
    solid = js.HalfSpace(js.Grid(shape), 1.0)
    size = solid.grid.size
    columns = jax.vmap(solid.pressure)(jnp.eye(size).reshape(size, *shape))
    matrix = np.asarray(columns).reshape(size, size)
    return (matrix + matrix.T) / 2


def exact_eigenvalues(problem: Problem, matrix: np.ndarray) -> list[float]:
    """Return the smallest eigenvalues on the space, the cone and the critical cone."""
    contact, presses = problem.in_contact.ravel(), problem.presses.ravel()
    nowhere = np.zeros_like(contact)
    sets = ((nowhere, nowhere), (contact, nowhere), (contact & ~presses, presses))
    return [smallest_on_cone(matrix, *masks, problem.fixes_mean) for masks in sets]


def exact_verdict(exact: list[float], scale: float) -> str:
    """Return the verdict that exact eigenvalues prove, "undecided" where rounding decides."""
    _, cone, critical = exact
    if cone > ROUNDING * scale:
        return "stable"
    if critical < -ROUNDING * scale:
        return "unstable"
    if cone < -ROUNDING * scale and critical > ROUNDING * scale:
        return "held_by_contact"
    return "undecided"
