"""Arrays by their shapes, as annotations name them."""

from collections.abc import Callable

import jaxtyping
from jaxtyping import Array, Bool, Float
from typing_extensions import TypeAliasType

# With a name of its own, which signatures show in place of all that it stands for.
ArrayLike = TypeAliasType("ArrayLike", jaxtyping.ArrayLike)
Scalar = Float[Array, ""]
Flag = Bool[Array, ""]
Field = Float[Array, " *grid"]
Mask = Bool[Array, " *grid"]
FieldMap = Callable[[Field], Field]
