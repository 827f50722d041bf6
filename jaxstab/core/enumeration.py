"""Enumerations whose members compiled code can choose: each is an integer array in a pytree.

Members of `equinox.Enumeration` have no public names, do not compare with names, are no arrays, and
compile an operation where two known ones are compared.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int

from jaxstab.core.checks import concrete
from jaxstab.core.display import UNREADABLE, text
from jaxstab.core.stack import Stackable


def member(meaning: str) -> Any:
    """Return a member of an enumeration, in the body of whose class this is called."""
    return meaning


class _Members(type):
    """The class of an enumeration, which is the collection of its members."""

    names: np.ndarray
    texts: np.ndarray
    promote: Any

    def __len__(cls) -> int:
        return len(cls.names)

    def __iter__(cls) -> Iterator[Any]:
        return (getattr(cls, name) for name in cls.names)

    def __contains__(cls, item: object) -> bool:
        if isinstance(item, str):
            return item in cls.names
        return type(item) is cls

    def __getitem__(cls, item: Any) -> str | np.ndarray:
        """Return the name and the meaning of a member, or an array of them."""
        return _pick(cls.texts, cls.promote(item).code)


@dataclass(frozen=True, eq=False, repr=False)
class Enumeration(Stackable, metaclass=_Members):
    """A member of an enumeration, or an array of members; under JAX transformations too.

    Attributes:
        code: the number of each member, in the order of the enumeration.
        names: the names of all members.
        texts: their names and meanings.
    """

    code: Int[Array | np.ndarray, "..."]
    names: ClassVar[np.ndarray] = np.array([], str)
    texts: ClassVar[np.ndarray] = np.array([], str)

    def __init_subclass__(cls) -> None:
        words = {name: text for name, text in vars(cls).items() if not name.startswith("_")}
        cls.names = np.array(list(words))
        cls.texts = np.array([f"{name}: {text}" for name, text in words.items()])
        for code, name in enumerate(words):
            setattr(cls, name, cls(np.array(code, np.int32)))
        cls.__doc__ = "\n\n".join([cls.__doc__ or "", *cls.texts])
        jax.tree_util.register_dataclass(cls, data_fields=["code"], meta_fields=[])

    @classmethod
    def promote(cls, item: object) -> Self:
        """Return the member of a name, or a member itself.

        Raises:
            ValueError: for a name that no member has.
            TypeError: for anything else.
        """
        if type(item) is cls:
            return item
        if not isinstance(item, str):
            raise TypeError(f"{item!r} is neither a member of {cls.__name__} nor a name of one.")
        if item not in cls.names:
            raise ValueError(f"{item!r} is not one of {cls.__name__}: {', '.join(cls.names)}.")
        return getattr(cls, item)

    @property
    def name(self) -> Any:
        """The name, a `str`; of an array of members, a NumPy array of names."""
        return _pick(type(self).names, self.code)

    @classmethod
    def where(cls, condition: Bool[ArrayLike, "..."], one: Self, other: Self) -> Self:
        """Return one member where the condition holds, and the other elsewhere."""
        with jax.ensure_compile_time_eval():
            return cls(jnp.where(condition, cls.promote(one).code, cls.promote(other).code))

    def __eq__(self, other: object) -> Bool[Array, "..."]:  # pyright: ignore[reportIncompatibleMethodOverride]
        code = np.int32(-1)
        if other is not None:
            code = type(self).promote(other).code
        # Within a trace, too, known values stay known.
        with jax.ensure_compile_time_eval():
            return concrete(self.code) == concrete(code)

    def __ne__(self, other: object) -> Bool[Array, "..."]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return ~(self == other)

    def __hash__(self) -> int:
        # A member equals its name, so their hashes must agree.
        return hash(self.name)

    def __format__(self, spec: str) -> str:
        return format(str(self), spec)

    def __repr__(self) -> str:
        try:
            return np.array2string(np.asarray(self.name), formatter={"all": str}, threshold=12)
        except UNREADABLE:
            return f"{type(self).__name__}({text(self.code)})"


def _pick(words: np.ndarray, code: Array | np.ndarray) -> str | np.ndarray:
    picked = words[np.asarray(code)]
    if picked.ndim == 0:
        return str(picked)
    return picked
