"""Dimensions: every field of a result says what it is measured in."""

from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float, Int

import jaxstab as js
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Mask, Scalar
from jaxstab.core.units import LENGTH, PRESSURE, STIFFNESS, Dimensioned, dimensions
from jaxstab.files.labels import QUANTITIES
from jaxstab.solids.free_half_space import Padded


class Inner(Dimensioned):
    stiffness: Annotated[Scalar, STIFFNESS]
    profile: Annotated[Float[Array, " *states_and_grid"], LENGTH] | None


class Outer(Dimensioned):
    pressure: Annotated[Scalar, PRESSURE]
    mask: Mask
    count: Int[Array, ""]
    result: RESULTS
    inner: Inner


def classes(kind=Dimensioned):
    yield kind
    for sub in kind.__subclasses__():
        yield from classes(sub)


def test_every_field_of_a_result_has_the_dimension_that_files_say():
    own = [kind for kind in classes() if kind.__module__.startswith("jaxstab.")]
    assert {"Path", "Stability", "CriticalLoad", "Spring"} <= {kind.__name__ for kind in own}
    for kind in own:
        said = dimensions(kind)
        assert said.get("value", "") in ("", getattr(kind, "unit", ""))
        assert all(QUANTITIES.get(name, ("", said[name]))[1] == said[name] for name in said)


def test_a_field_without_a_dimension_is_an_error():
    class Forgetful(Dimensioned):
        pressure: Scalar

    loaded = Forgetful(jnp.array(8.0))
    # That of a user's own stays.
    assert loaded.in_units_of(jnp.array(2.0)).pressure == 8
    Forgetful.__module__ = "jaxstab.somewhere"
    dimensions.cache_clear()
    with pytest.raises(TypeError, match=r"Forgetful.pressure has no dimension: declare it"):
        loaded.in_units_of(jnp.array(2.0))


def test_pressures_change_their_unit_and_fields_are_cropped_also_within():
    solid = js.FreeHalfSpace(js.Grid((2,), (1.0,)), 1.0).whole
    assert isinstance(solid, Padded) and solid.window == (2,)
    inner = Inner(jnp.array([3.0, 5.0]), jnp.arange(8.0).reshape(2, 4))
    outer = Outer(jnp.array(6.0), jnp.arange(4) > 0, jnp.array(7), RESULTS.successful, inner)
    found = jax.jit(lambda x: x.in_units_of(jnp.array(2.0)).on_surface(solid))(outer)
    assert (found.pressure, found.count) == (3, 7) and found.result == RESULTS.successful
    np.testing.assert_array_equal(found.mask, [False, True])
    np.testing.assert_array_equal(found.inner.stiffness, [1.5, 2.5])
    np.testing.assert_array_equal(found.inner.profile, [[0, 1], [4, 5]])
    slope = jax.grad(lambda x: Inner(x, None).in_units_of(jnp.array(2.0)).stiffness)(jnp.array(1.0))
    assert slope == 0.5
