"""A contact as a function of its parameters, and the curve of its mean pressures over loads."""

from collections.abc import Callable
from dataclasses import dataclass, field, is_dataclass
from itertools import pairwise
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from jaxstab.contact import Contact
from jaxstab.core.checks import as_array
from jaxstab.core.compile import program
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Scalar
from jaxstab.core.units import NUMBER, declared_dimensions
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import solve
from jaxstab.equilibrium.posing import as_given, pose
from jaxstab.equilibrium.start import start_of
from jaxstab.loads import Load

Values = Float[Array | np.ndarray, " parameters"]
Order = Literal["continuation", "independent"]
Where = Callable[[Contact], PyTree]
# The zeros of loads and measurements, the last of the parameters.
ZEROS = ("offset", "baseline", "tilt")


@dataclass(frozen=True)
class Pick:
    """A function that picks parameters of a contact, equal to another that picks the same ones.

    So a function that is defined again, as by another run of a cell, is not compiled again.
    """

    where: Where = field(compare=False)
    places: tuple[int, ...]
    structure: jax.tree_util.PyTreeDef
    names: tuple[str, ...]
    dimensions: tuple[str, ...]

    @classmethod
    def of(cls, where: Where, contact: Contact) -> "Pick":
        """Return the parameters that a function picks from a contact."""
        paths, structure = jax.tree.flatten_with_path(contact)
        opaque = [object() for _ in paths]
        try:
            picked, tree = jax.tree.flatten(where(jax.tree.unflatten(structure, opaque)))
            places = tuple(map(opaque.index, picked))
        except (TypeError, ValueError):
            raise TypeError(
                "`where` is no function that picks parameters of the contact, or it computes with "
                "them: it may only pick them."
            ) from None
        if len({*places}) < len(places):
            raise ValueError("`where` picks a parameter twice: pick each once.")
        names = []
        dimensions = []
        for path, leaf in [paths[place] for place in places]:
            found = _names(path, leaf)
            names += found
            dimensions += [_dimension(contact, path)] * len(found)
        return cls(where, places, tree, tuple(names), tuple(dimensions))

    def __call__(self, contact: Contact) -> PyTree:
        """Return these parameters of a contact."""
        return self.where(contact)


def _names(path: jax.tree_util.KeyPath, leaf: Array) -> list[str]:
    """Return a name for each number of a leaf that can be fitted."""
    if not eqx.is_inexact_array(leaf):
        return []
    name = jax.tree_util.keystr(path, simple=True, separator=".")
    if leaf.ndim == 0:
        return [name]
    return [f"{name}[{i}]" for i in range(leaf.size)]


def _dimension(tree: PyTree, path: jax.tree_util.KeyPath) -> str:
    """Return the dimension that the field of a leaf declares, or that of a number."""
    parts = ()
    for key in path:
        match key:
            case jax.tree_util.GetAttrKey(name=name):
                parts = ()
                if is_dataclass(tree):
                    parts = declared_dimensions(type(tree)).get(name, ())
                tree = getattr(tree, name)
            case jax.tree_util.SequenceKey(idx=i):
                parts = parts[i:]
                tree = tree[i]
            case _:
                return NUMBER
    return (*parts, NUMBER)[0]


def values_of(tree: PyTree) -> np.ndarray:
    """Return the numbers of the floating-point leaves of a pytree."""
    return np.concatenate([np.zeros(0), *map(np.ravel, jax.tree.leaves(_numbers(tree)))])


def with_values(tree: PyTree, values: Values) -> PyTree:
    """Return a pytree with other numbers in its floating-point leaves."""
    leaves, structure = jax.tree.flatten(_numbers(tree))
    ends = np.cumsum([0, *(leaf.size for leaf in leaves)]).tolist()
    parts = [
        as_array(values[first:last].reshape(leaf.shape))
        for (first, last), leaf in zip(pairwise(ends), leaves, strict=True)
    ]
    return eqx.combine(jax.tree.unflatten(structure, parts), tree)


def _numbers(tree: PyTree) -> PyTree:
    return eqx.filter(tree, eqx.is_inexact_array)


class Model(eqx.Module):
    """The curve of a contact as a function of a vector of parameters.

    The last numbers of the vector are the zeros: the offset of the loads, the baseline of the
    measurements and its tilt over the load. These are forces over the area, or pressures with an
    area of one.
    """

    contact: Contact
    loads: Load
    area: Scalar
    where: Pick = eqx.field(static=True)
    order: Order = eqx.field(static=True)

    def contact_at(self, values: Values) -> Contact:
        """Return the contact with other parameters."""
        picked = with_values(self.where(self.contact), values[: -len(ZEROS)])
        return eqx.tree_at(self.where, self.contact, picked)

    @program
    def curve(self, values: Values) -> tuple[Array, Array]:
        """Return the mean pressures at the loads and their Jacobian, NaN without an equilibrium."""
        at_load = jax.value_and_grad(self._pressure, has_aux=True)

        def follow(start: Array, load: Load) -> tuple[Array, tuple[Array, Array]]:
            (pressure, gap), row = at_load(values, load, start)
            return jnp.where(jnp.isnan(pressure), start, gap), (pressure, row)

        if self.order == "independent":
            (pressures, _), rows = jax.vmap(lambda load: at_load(values, load, None))(self.loads)
            return pressures, rows
        first = jax.tree.map(lambda leaf: leaf[0], self.loads)
        start = self.contact.control(first).starting_gap(self.contact.heights)
        return jax.lax.scan(follow, start, self.loads)[1]

    def _pressure(self, values: Values, load: Load, start: Array | None) -> tuple[Array, Array]:
        """Return the mean pressure at one load, and the gap, the start of the next load."""
        offset, baseline, tilt = values[-len(ZEROS) :]
        zero = (baseline + tilt * load.value) / self.area
        problem = pose(self.contact_at(values), load.at(load.value - offset))
        gap = start_of(problem.contact, problem.load, start)
        found = as_given(
            solve(problem.contact, problem.load, PreconditionedConjugateGradient(), gap), problem
        )
        is_found = found.result == RESULTS.successful
        return jnp.where(is_found, found.mean_pressure, jnp.nan) + zero, found.gap
