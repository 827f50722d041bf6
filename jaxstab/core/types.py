"""Arrays by their shapes, as annotations name them."""

from collections.abc import Callable

import jaxtyping
from jaxtyping import Array, Bool, Float
from typing_extensions import TypeAliasType

# A named alias, which signatures show in place of the union that it stands for.
ArrayLike = TypeAliasType("ArrayLike", jaxtyping.ArrayLike)
Scalar = Float[Array, ""]
Flag = Bool[Array, ""]
Field = Float[Array, " *grid"]
Mask = Bool[Array, " *grid"]
FieldMap = Callable[[Field], Field]
