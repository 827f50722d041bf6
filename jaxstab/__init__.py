"""Equilibrium and stability of adhesive rough contacts, on JAX.

It implements V. Rey and J. Bleyer, *Stability analysis of rough surfaces in adhesive normal
contact*, whose equation numbers the documentation quotes.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from lazy_loader import attach_stub

from jaxstab.core.cache import keep_programs

keep_programs()

# By `__init__.pyi`: each public name is imported where it is first used.
_named, _, __all__ = attach_stub(__name__, __file__)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    if not name.startswith("_") and find_spec(f"{__name__}.{name}"):
        return import_module(f"{__name__}.{name}")
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)
    return _named(name)
