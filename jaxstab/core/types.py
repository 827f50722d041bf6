"""Arrays by their shapes, as annotations name them."""

from collections.abc import Callable

from jaxtyping import Array, Bool, Float

Scalar = Float[Array, ""]
Flag = Bool[Array, ""]
Field = Float[Array, " *grid"]
Mask = Bool[Array, " *grid"]
FieldMap = Callable[[Field], Field]
