"""Dimensions: every field of a result declares its own."""

from dataclasses import fields, is_dataclass
from types import NoneType
from typing import Annotated, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Bool, Float, Int

import jaxstab as js
from jaxstab.core.stack import Stackable
from jaxstab.core.types import Mask, Scalar
from jaxstab.core.units import LENGTH, PRESSURE, Dimensioned, declared_dimensions, dimensions


class Result(Dimensioned):
    pressure: Annotated[Scalar, PRESSURE]
    profile: Annotated[Float[Array, " *states_and_grid"], LENGTH] | None = None
    mask: Mask | None = None
    count: Int[Array, ""] | None = None
    inner: Dimensioned | None = None


def classes(kind=Dimensioned):
    return {kind}.union(*map(classes, kind.__subclasses__()))


def parts(kind):
    return [part for one in get_args(kind) for part in parts(one)] or [kind]


def needs_none(kind):
    # Results have dimensions of their own, and a contact is as it was given; flags, counts and
    # members of enumerations have none.
    apart = Dimensioned | Stackable | NoneType | js.Contact
    is_apart = isinstance(kind, type) and issubclass(kind, apart)
    # So has what is neither converted nor cropped, as the memory of an evolution.
    is_declared = is_dataclass(kind) and set(declared_dimensions(kind)) == {
        x.name for x in fields(kind)
    }
    return is_apart or is_declared or getattr(kind, "dtype", None) in (Int, Bool)


def test_every_field_of_a_result_has_a_dimension():
    # Its modules are imported on first use.
    assert all(hasattr(js, name) for name in js.__all__)
    own = {kind for kind in classes() if kind.__module__.startswith("jaxstab.")}
    assert {"Path", "Stability", "CriticalLoad", "Spring"} <= {kind.__name__ for kind in own}
    for kind in own:
        for field in fields(kind):
            is_exempt = field.metadata.get("static") or all(map(needs_none, parts(field.type)))
            assert is_exempt or field.name in dimensions(kind), (kind, field.name)
    known = {kind.__name__: dimensions(kind) for kind in own}
    assert known["Path"]["work"] == "energy" and known["Eigenpair"]["error"] == "pressure/length"
    assert known["Spring"] == {"value": "length", "stiffness": "pressure/length"}
    assert js.MeanPressure(1.0).unit == "pressure"


def test_pressures_change_their_unit_and_fields_are_cropped_also_within():
    solid = js.FreeHalfSpace(js.Grid((2,), (1.0,)), 1.0).padded
    inner = Result(jnp.array([3.0, 5.0]), jnp.arange(8.0).reshape(2, 4))
    outer = Result(jnp.array(6.0), None, jnp.arange(4) > 0, jnp.array(7), inner)
    found = jax.jit(lambda x: x.in_units_of(jnp.array(2.0)).on_surface(solid))(outer)
    assert (found.pressure, found.count) == (3, 7)
    np.testing.assert_array_equal(found.mask, [False, True])
    np.testing.assert_array_equal(found.inner.pressure, [1.5, 2.5])
    np.testing.assert_array_equal(found.inner.profile, [[0, 1], [4, 5]])
    assert jax.grad(lambda x: Result(x).in_units_of(jnp.array(2.0)).pressure)(1.0) == 0.5


@pytest.mark.parametrize(
    "name", ["stress", "MPa", "length²", "length**2", "length^-1", "length^0.5", "force * length"]
)
def test_an_unknown_dimension_is_refused(name):
    with pytest.raises(ValueError, match="has the factor"):
        js.Dimension(name)
