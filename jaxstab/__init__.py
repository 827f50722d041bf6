"""Equilibrium and stability of adhesive rough contacts, on JAX.

It implements V. Rey and J. Bleyer, *Stability analysis of rough surfaces in adhesive normal
contact*, whose equation numbers the documentation quotes.
"""

import importlib.metadata
import warnings

import lazy_loader

# Each name is imported where it is first used, from the module that `__init__.pyi` gives.
_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
# Functions of version 0.2 that have another name; to be removed in 0.4.
_RENAMED = {"release": "relax_along"}
__version__ = importlib.metadata.version(__name__)


def __getattr__(name: str) -> object:
    if name in _RENAMED:
        message = f"jaxstab.{name} is now jaxstab.{_RENAMED[name]}."
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return _imported(_RENAMED[name])
    if name in __all__ or not name[0].isupper():
        return _imported(name)
    # Names that the root held in version 0.2; to be removed in 0.4.
    for room in map(_imported, ("results", "solvers", "exceptions", "solids")):
        if name in room.__all__:
            message = f"jaxstab.{name} is now {room.__name__}.{name}."
            warnings.warn(message, DeprecationWarning, stacklevel=2)
            return getattr(room, name)
    return _imported(name)
