"""The outputs of a case, as arrays that a store can hold."""

import math
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxstab.core.checks import is_traced
from jaxstab.core.enumeration import Enumeration

# What each case has beside what it returns.
MARKS = ("result", "seconds", "error")
MISSING = "missing"


@dataclass(frozen=True)
class Form:
    """The kind and the shape of an output, which are those of all cases.

    Attributes:
        dtype: the kind of numbers; that of `str` for words.
        shape: of one case.
    """

    dtype: np.dtype
    shape: tuple[int, ...]

    def __str__(self) -> str:
        kind = "words" if self.dtype.kind == "U" else str(self.dtype)
        return f"{kind} of shape {self.shape}" if self.shape else kind

    @property
    def least_bytes(self) -> int:
        """The size of a chunk; of words, which may be longer, that of empty ones."""
        number = math.prod(self.shape)
        return 4 + 4 * number if self.dtype.kind == "U" else number * self.dtype.itemsize

    @property
    def missing(self) -> Any:
        """The value of missing entries: NaN, the least integer, False, or a word."""
        kind = self.dtype.kind
        if kind in "iu":
            limits = np.iinfo(self.dtype)
            return limits.min if kind == "i" else limits.max
        return {"b": False, "U": MISSING}.get(kind, np.nan)


def arrays_of(outputs: Any, taken: Collection[str]) -> dict[str, np.ndarray]:
    """Return the outputs of a case as arrays, members of enumerations as words.

    Arguments:
        outputs: the outputs of the case.
        taken: the names of the axes.

    Raises:
        TypeError: if it is not a dict, or holds something else than arrays.
        ValueError: for names that are taken, or are none.
    """
    if not isinstance(outputs, Mapping) or not outputs:
        raise TypeError(
            f"The case returned {type(outputs).__name__}: return a dict of arrays, as in "
            '{"area": equilibrium.contact_area}.'
        )
    for name in outputs:
        if not (isinstance(name, str) and name.isidentifier()):
            raise ValueError(f"The case returned {name!r}: name outputs by letters and digits.")
        if name in MARKS or name in taken:
            raise ValueError(
                f"The case returned `{name}`, which the study holds by itself: rename it."
            )
    return {name: _array(name, value) for name, value in outputs.items()}


def form_of(array: np.ndarray) -> Form:
    """Return the form of an output."""
    return Form(np.dtype(str) if array.dtype.kind == "U" else array.dtype, array.shape)


def require_forms(arrays: Mapping[str, np.ndarray] | Exception, forms: Mapping[str, Form]) -> None:
    """Raise `ValueError` where a case returned other outputs than those before it."""
    if isinstance(arrays, Exception):
        raise arrays
    if set(arrays) != set(forms):
        raise ValueError(
            f"The case returned {', '.join(sorted(arrays))}, cases before it "
            f"{', '.join(sorted(forms))}: return the same in all."
        )
    for name, array in arrays.items():
        form, expected = form_of(array), forms[name]
        if form.shape != expected.shape or not _fits(array, expected.dtype):
            raise ValueError(
                f"{name} is {form} in this case, {expected} in those before: return the same kind "
                "and shape in all, padded with NaN for instance."
            )


def _fits(array: np.ndarray, dtype: np.dtype) -> bool:
    """Whether an array can be kept as a kind: a Python number in the precision of a batch too."""
    if np.can_cast(array.dtype, dtype, "safe"):
        return True
    if not np.can_cast(array.dtype, dtype, "same_kind"):
        return False
    with np.errstate(over="ignore"):
        cast = array.astype(dtype)
    if array.dtype.kind in "fc":
        return np.array_equal(np.isfinite(cast), np.isfinite(array))
    return np.array_equal(cast.astype(array.dtype), array)


def encoded(array: np.ndarray, form: Form) -> bytes:
    """Return an array as the bytes of a chunk of Zarr that is not compressed."""
    if form.dtype.kind != "U":
        return array.astype(form.dtype.newbyteorder("<")).tobytes()
    words = [word.encode() for word in array.ravel().tolist()]
    return struct.pack("<I", len(words)) + b"".join(
        struct.pack("<I", len(word)) + word for word in words
    )


def decoded_word(chunk: bytes) -> str:
    """Return the word of a chunk that holds one."""
    return chunk[8:].decode(errors="replace")


def error_text(error: BaseException) -> str:
    """Return the kind of an error and its message."""
    return f"{type(error).__name__}: {error}"


def _array(name: str, value: Any) -> np.ndarray:
    if isinstance(value, Enumeration):
        return np.asarray(value.name)
    if is_traced(value):
        raise TypeError(f"{name} is traced: call js.study outside of JAX transformations.")
    is_list = isinstance(value, list | tuple) and not any(map(_is_tree, value))
    is_array = is_list or np.isscalar(value) or hasattr(value, "dtype")
    array = _without_mask(name, value) if is_array else None
    if array is None or array.dtype.kind not in "biufcU":
        kind = type(value).__name__ if array is None else array.dtype
        raise TypeError(
            f"{name} is {kind}, which is no array: return the numbers of it that you need."
        )
    return array


def _without_mask(name: str, value: Any) -> np.ndarray:
    """Return an array with NaN at masked entries."""
    array = np.ma.asarray(value)
    if not np.ma.is_masked(array):
        return array.data
    if array.dtype.kind not in "fc":
        raise TypeError(
            f"{name} is a masked array of {array.dtype}, which has no NaN for a masked value: "
            "return floats, or fill it."
        )
    return array.filled(np.nan)


def _is_tree(value: Any) -> bool:
    return not (np.isscalar(value) or isinstance(value, jax.Array | np.ndarray))
