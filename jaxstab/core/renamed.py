"""Names of version 0.2 that have changed, to be removed in 0.4."""

import warnings
from typing import Any


class Renamed(property):
    """A property that forwards to an attribute of another name, with a `DeprecationWarning`."""

    def __init__(self, name: str) -> None:
        super().__init__(self._forward, doc=f"The same as `{name}`, with a `DeprecationWarning`.")
        self.name = name

    def __set_name__(self, owner: type, name: str) -> None:
        self.old = name

    def _forward(self, instance: object) -> Any:
        kind = type(instance).__name__
        message = f"{kind}.{self.old} is now {kind}.{self.name}."
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return getattr(instance, self.name)
