"""Checks of input, wherever its value is known: eagerly always, under a JAX trace never.

Known values are checked with NumPy, to avoid compiling. Values sharded over several devices are
checked there.
"""

import datetime
import operator
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, wraps
from pathlib import Path
from types import UnionType
from typing import Any, ParamSpec, SupportsIndex, TypeVar

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding
from jax.typing import DTypeLike
from jaxtyping import Array, Float, PyTree

from jaxstab.core.types import ArrayLike, Scalar

Given = ParamSpec("Given")
Tree = TypeVar("Tree")


def is_traced(value: PyTree) -> bool:
    """Whether any leaf of `value` is a JAX tracer, so that its numbers are not known yet."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))


def is_transformed(inputs: PyTree) -> bool:
    """Whether JAX transforms computations with `inputs`; under `jax.jit` always."""
    return is_traced((inputs, jax.device_put(_nothing())))


@cache
def _nothing() -> Array:
    # Put on the device once: to put it there again is no transfer, but a tracer under `jax.jit`.
    with jax.ensure_compile_time_eval():
        return jax.device_put(np.zeros(()))


def is_readable(value: PyTree) -> bool:
    """Whether the numbers of all arrays are known, and none is sharded over several devices."""
    arrays = [leaf for leaf in jax.tree.leaves(value) if isinstance(leaf, jax.Array)]
    return not is_traced(arrays) and all(leaf.is_fully_replicated for leaf in arrays)


def concrete(value: ArrayLike | np.generic) -> Any:
    """Return `value` as a NumPy array; a traced or sharded one is returned unchanged."""
    if not is_readable(value):
        return value
    return np.asarray(value)


def without_derivatives(value: Any) -> Any:
    """Return `value` without its derivatives, so that it is known while these are computed."""
    if is_traced(value):
        return jax.lax.stop_gradient(value)
    return value


def array(value: ArrayLike | np.generic | list, dtype: DTypeLike | None = None) -> Array:
    """Return a copy of a concrete value as an array of JAX, without compiling anything."""
    return jax.device_put(np.array(value, dtype))


def as_array(value: ArrayLike | np.generic | list, dtype: DTypeLike | None = None) -> Array:
    """Return an array of JAX as it is, and another value as one, without compiling anything."""
    if isinstance(value, jax.Array):
        return value
    return array(value, dtype)


def has_explicit_axes(mesh: Any) -> bool:
    """Whether a mesh has axes over which each operation states the sharding of its result."""
    return AxisType.Explicit in mesh.axis_types


def require_no_explicit_mesh() -> None:
    """Raise `ValueError` where the mesh in use, as by `jax.set_mesh`, has explicit axes."""
    mesh = jax.sharding.get_abstract_mesh()
    if has_explicit_axes(mesh):
        raise ValueError(
            f"The mesh in use has the explicit axes {mesh.axis_names}, on which the operations of "
            "jaxstab would have to state the sharding of each result: call it outside of "
            "`with jax.set_mesh(mesh)`, and give the mesh to the grid, as in jaxstab.Grid(n, "
            'sharding=jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("x"))); or make '
            "the mesh with axis_types=(jax.sharding.AxisType.Auto,)."
        )


def with_automatic_axes(value: Array, name: str) -> Array:
    """Return an array where it is, on axes over which the compiler propagates shardings.

    Raises:
        ValueError: for a traced array on a mesh with explicit axes, and as
            `require_no_explicit_mesh`.
    """
    if not has_explicit_axes(jax.typeof(value).sharding.mesh):
        return value
    if is_traced(value):
        raise ValueError(
            f"{name} is traced, and sharded over the explicit axes of a mesh: outside of jax.jit "
            "jaxstab takes it as it is; for use in jax.jit make the mesh with "
            "axis_types=(jax.sharding.AxisType.Auto,)."
        )
    require_no_explicit_mesh()
    assert isinstance(value.sharding, NamedSharding)
    return jax.device_put(value, with_automatic_mesh(value.sharding))


def with_automatic_mesh(sharding: NamedSharding) -> NamedSharding:
    """Return a sharding of a known mesh over axes that the compiler propagates."""
    mesh = sharding.mesh
    assert isinstance(mesh, Mesh)
    return NamedSharding(Mesh(mesh.devices, mesh.axis_names), sharding.spec)


def parameter(value: object, name: str = "A parameter") -> Float[Array, "..."]:
    """Return `value` as a floating-point array, so that it can be vmapped and differentiated."""
    return as_array(numbers(value, name))


def in_words(value: object) -> str:
    """Return a text, a number or a class as an error shows it, and its class for anything else."""
    match value:
        case str() | int() | float():
            return repr(value)
        case type():
            return value.__name__
        case _:
            return f"a {type(value).__name__}"


def require_no_unit(value: Any, name: str) -> None:
    """Refuse a number that carries a unit, whose conversion only its owner can decide.

    Raises:
        TypeError: for quantities (of pint, astropy and others), arrays of xarray whose attributes
            name a unit, and differences of times; the message says what to write.
    """
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    if kind in ("m", "M") or isinstance(value, datetime.timedelta | datetime.datetime):
        raise TypeError(
            f"{name} is a {type(value).__name__}, a time with a unit of its own: give numbers in "
            "the unit of your times, as in difference / numpy.timedelta64(1, 's')."
        )
    unit = None
    attributes = getattr(value, "attrs", None)
    if isinstance(attributes, Mapping):
        unit = attributes.get("units", attributes.get("unit"))
    cure = "its `.values`, once it is in the units of the contact"
    if unit is None and hasattr(value, "magnitude"):
        unit = getattr(value, "units", None)
        cure = '`quantity.to("...").magnitude`'
    elif unit is None and hasattr(value, "value"):
        unit = getattr(value, "unit", None)
        cure = '`quantity.to_value("...")`'
    if unit is not None and str(unit) not in ("", "1", "dimensionless"):
        raise TypeError(
            f"{name} is a {type(value).__name__} in {unit}, and numbers have the units of the "
            f"contact, which are not known here: give {cure}."
        )


def numbers(value: object, name: str) -> Float[Array | np.ndarray, "..."]:
    """Return `value` as a floating-point array, of NumPy unless it is one of JAX."""
    if np.ma.is_masked(value):
        raise TypeError(
            f"{name} is masked, with {np.ma.count_masked(value)} values missing: fill it first, as "
            "with `numpy.ma.filled(values, number)`."
        )
    if isinstance(value, bool | int | float) and not isinstance(value, np.generic):
        # A number of Python stays weakly typed.
        return jax.device_put(float(value))
    given = in_words(value)
    if not isinstance(value, jax.Array):
        require_no_unit(value, name)
    if isinstance(value, jax.Array):
        value = with_automatic_axes(value, name)
    if is_traced(value):
        value = jnp.asarray(value)
    elif not isinstance(value, jax.Array):
        value = np.asarray(value)
        if value.dtype.kind == "O" and value.ndim:
            kinds = sorted({type(entry).__name__ for entry in value.flat})
            given = f"an array of objects ({', '.join(kinds[:3])})"
        elif value.dtype.kind in "US" and value.ndim:
            given = "an array of text"
        elif value.dtype == np.longdouble:
            raise TypeError(f"{name} is {value.dtype}: give `.astype(float)` of it.")
        # Arrays from files may have a byte order that JAX refuses.
        value = value.astype(value.dtype.newbyteorder("="), copy=False)
    if jnp.issubdtype(value.dtype, jnp.floating):
        if isinstance(value, jax.Array) and value.ndim:
            return cast(value, value.dtype)
        return value
    if not (jnp.issubdtype(value.dtype, jnp.integer) or value.dtype == bool):
        if jnp.issubdtype(value.dtype, jnp.number):
            given = str(value.dtype)
        raise TypeError(f"{name} is {given}: give real numbers.")
    return concrete(value).astype(float)


def scalar_parameter(value: ArrayLike, name: str) -> Scalar:
    """Return a parameter that must be a single number."""
    number = parameter(value, name)
    if number.shape != ():
        raise ValueError(f"{name} has shape {number.shape}: give one number, or use jax.vmap.")
    return number


def cast(tree: Tree, dtype: DTypeLike) -> Tree:
    """Return `tree` with its floating-point leaves in `dtype`.

    The result is never weakly typed, since JAX compiles anew for weakly typed values.
    """

    def cast_leaf(leaf: PyTree) -> PyTree:
        is_array = isinstance(leaf, jax.Array | np.ndarray | np.generic)
        if not (is_array and jnp.issubdtype(leaf.dtype, jnp.floating)):
            return leaf
        if isinstance(leaf, jax.Array) and leaf.dtype == dtype and not leaf.weak_type:
            return leaf
        if not is_readable(leaf):
            return leaf.astype(dtype)
        return array(leaf, dtype)

    return jax.tree.map(cast_leaf, tree)


def integer(name: str, value: SupportsIndex) -> int:
    """Return `value` as an integer."""
    try:
        return operator.index(value)
    except TypeError:
        raise TypeError(f"{name} is {value!r}: give an integer.") from None


def possible(value: Array, holds: ArrayLike) -> Array:
    """Return a value; NaN where it is traced and a condition on it does not hold."""
    if not is_traced(holds):
        return value
    # As a factor it makes derivatives NaN too.
    return value * jnp.where(holds, 1, jnp.nan)


def positive_parameter(value: object, name: str) -> Float[Array, "..."]:
    """Return a parameter that must be positive; NaN where it is traced and is not."""
    number = parameter(value, name)
    require_positive(name, number)
    # NumPy compiles nothing.
    return possible(number, concrete(number) > 0)


def positive_scalar(value: ArrayLike, name: str) -> Scalar:
    """Return a parameter that must be one positive number; NaN where it is traced and is not."""
    return positive_parameter(scalar_parameter(value, name), name)


def nonnegative_parameter(value: object, name: str) -> Float[Array, "..."]:
    """Return a parameter that must not be negative; NaN where it is traced and is."""
    number = parameter(value, name)
    known = concrete(number)
    finite = (known >= 0) & (known < np.inf)
    require(name, known, finite, "it must be finite and not negative.")
    return possible(number, known >= 0)


def where_known(check: Callable[Given, None]) -> Callable[Given, None]:
    """Return a check or a warning that says nothing where JAX traces one of its arguments."""

    @wraps(check)
    def call(*args: Given.args, **kwargs: Given.kwargs) -> None:
        if not is_traced((args, kwargs)):
            check(*args, **kwargs)

    return call


def require_known(inputs: object, name: str) -> None:
    """Raise `TypeError` inside of a JAX transformation."""
    if is_traced(inputs):
        raise TypeError(
            f"{name} works on known numbers, and JAX is tracing these: call it outside of jax.jit, "
            "jax.vmap and jax.grad, for one state after another."
        )


@contextmanager
def file_named_in_errors(path: Path) -> Iterator[None]:
    """Put the name of a file, which must exist, before the errors of its readers."""
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{path}: {error}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def require(name: str, value: Any, holds: Any, cure: str) -> None:
    """Raise `ValueError` naming `value` and the `cure` where `holds`, if known, is false."""
    if is_traced(holds) or np.all(holds):
        return
    value = without_derivatives(value)
    if np.ndim(holds) and np.shape(value) == np.shape(holds):
        index = np.unravel_index(int(holds.argmin()), holds.shape)
        value = f"{value[index]} at {tuple(map(int, index))}"
    raise ValueError(f"{name} is {value}: {cure}")


def require_shape(name: str, shape: tuple[int, ...], grid: tuple[int, ...], cure: str) -> None:
    """Raise `ValueError` for an array of another shape than the grid's."""
    if shape != grid:
        raise ValueError(f"{name} has shape {shape}, the grid {grid}: {cure}")


def require_kind(value: object, kind: type | UnionType, sentence: str) -> None:
    """Raise `TypeError` for a value of another class, with the class to give."""
    if not isinstance(value, kind):
        raise TypeError(f"{type(value).__name__} is {sentence}")


def require_one_of(name: str, value: object, choices: Collection[object]) -> None:
    """Raise `ValueError` for a value that is not one of the choices, words or integers."""
    if not isinstance(value, str | int | np.integer) or value not in choices:
        raise ValueError(f"{name} is {value!r}: choose one of {', '.join(map(str, choices))}.")


def key_or_default(key: Array | None) -> Array:
    """Return a random key, that of the number 0 for None.

    Raises:
        TypeError, ValueError: as `require_key`.
    """
    if key is None:
        return jax.random.key(0)
    require_key(key)
    return key


def require_key(key: Any) -> None:
    """Raise `TypeError` for anything but a random key of JAX, `ValueError` for several."""
    dtype = getattr(key, "dtype", np.dtype(object))
    is_typed = jnp.issubdtype(dtype, jax.dtypes.prng_key)
    if not (is_typed or dtype == np.uint32):
        raise TypeError(f"The key is {key!r}: give a random key, as jax.random.key(0).")
    shape = np.shape(key)
    if not is_typed:
        # A raw key has an axis of its own.
        shape = shape[:-1]
    if shape:
        raise ValueError(
            f"The key is an array of keys of shape {shape}, as of jax.random.split: give one of "
            "them, or use jax.vmap."
        )


def require_positive(name: str, value: Float[Array, "..."]) -> None:
    """Raise `ValueError` where `value`, if known, is not positive and finite."""
    value = concrete(value)
    require(name, value, (value > 0) & (value < np.inf), "it must be positive and finite.")


def are_finite(value: Float[Array | np.ndarray, "..."]) -> Array | np.ndarray:
    """Return the mask of finite entries of a known value."""
    # A comparison also works on sharded arrays.
    return abs(concrete(value)) < np.inf


@where_known
def require_finite(
    name: str, value: Float[Array | np.ndarray, "..."], cure: str = "give finite numbers."
) -> None:
    """Raise `ValueError` where `value`, if known, is NaN or infinite."""
    require(name, value, are_finite(value), cure)
