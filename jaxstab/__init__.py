"""Equilibrium and stability of adhesive rough contacts, on JAX.

It implements V. Rey and J. Bleyer, *Stability analysis of rough surfaces in adhesive normal
contact*, whose equation numbers the documentation quotes.
"""

import ast
import pathlib
from importlib import import_module
from importlib.util import find_spec
from typing import Any


def _homes() -> dict[str, str]:
    """Return the module of each public name, as `__init__.pyi` says."""
    tree = ast.parse(pathlib.Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module or "" for node in imports for alias in node.names}


# Each is imported where it is first used: a few take longer than all that most people need.
_HOMES = _homes()
__all__ = sorted(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    home = _HOMES.get(name)
    if home:
        value = getattr(import_module(f"{__name__}.{home}"), name)
    elif not name.startswith("_") and find_spec(f"{__name__}.{name}"):
        value = import_module(f"{__name__}.{name}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)
    return globals().setdefault(name, value)
