"""What of jaxstab is public, and where each thing is written; needs no Sphinx."""

import ast
import re
import sys
from functools import cache
from importlib import import_module
from inspect import isclass
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any

PACKAGE = "jaxstab"
# Public modules of classes that are written elsewhere.
_ROOMS = "results", "solvers", "exceptions", "solids"


def resolve(name: str) -> Any:
    """Return the object of a dotted name, be it a module or what one holds."""
    package, _, rest = name.partition(".")
    try:
        return attrgetter(rest)(import_module(package)) if rest else import_module(package)
    except AttributeError:
        home, _, last = name.rpartition(".")
        return getattr(import_module(home), last, None) or import_module(name)


def home_of(item: Any) -> str:
    """Return the name of the module in which something is written."""
    return item.__name__ if isinstance(item, ModuleType) else getattr(item, "__module__", "") or ""


def is_inside(module: str, room: str) -> bool:
    """Whether a module is a room or lies in it."""
    return module == room or module.startswith(f"{room}.")


def members(module: ModuleType) -> list[str]:
    """Return the public names of a module, without its own."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    own = {name: item for name, item in vars(module).items() if not name.startswith("_")}
    return [
        name
        for name, item in own.items()
        if callable(item) and is_inside(home_of(item), module.__name__)
    ]


@cache
def everything() -> dict[str, Any]:
    """Return all that is public, but for modules, by its dotted name, the shortest if several."""
    found: dict[str, Any] = {}

    def collect(name: str, module: ModuleType) -> None:
        items = {f"{name}.{x}": getattr(module, x) for x in members(module)}
        modules = {x: item for x, item in items.items() if isinstance(item, ModuleType)}
        for x, item in items.items():
            if x not in modules and not any(item is known for known in found.values()):
                found[x] = item
        for x, inner in modules.items():
            collect(x, inner)

    collect(PACKAGE, import_module(PACKAGE))
    return found


def name_of(item: Any) -> str | None:
    """Return the name under which something is public, if it is."""
    return next((name for name, known in everything().items() if known is item), None)


def full_name(name: str) -> str | None:
    """Return the dotted name of what is public in the package or in a room of classes."""
    names = [f"{PACKAGE}.{name}", *(f"{PACKAGE}.{room}.{name}" for room in _ROOMS)]
    return next((x for x in names if x in everything()), None)


def names_of(entry: str) -> list[str]:
    """Return the names that an entry of a page stands for.

    A module stands for what is public in it or from it, of the latter functions first; anything
    else for itself.
    """
    module = resolve(entry)
    if not isinstance(module, ModuleType):
        return [entry]
    found = {name: x for name, x in everything().items() if is_inside(home_of(x), module.__name__)}
    inside = [name for name in found if name.rpartition(".")[0] == entry]
    from_it = [name for name in found if name not in inside]
    return sorted(from_it, key=lambda name: isclass(found[name])) + inside


def entries_of(page: str) -> list[str]:
    """Return the entries of all `public` directives in the text of a page."""
    blocks = re.findall(r"^:::\{public\}\n(.*?)^:::", page, re.DOTALL | re.MULTILINE)
    return "".join(blocks).split()


@cache
def _tree(module: str) -> ast.Module:
    path = sys.modules[module].__file__
    assert path is not None
    return ast.parse(Path(path).read_text(encoding="utf-8"))


def definition(item: Any) -> ast.FunctionDef | ast.ClassDef:
    """Return where a function or a class is written."""
    node: Any = _tree(item.__module__)
    for name in item.__qualname__.split("."):
        named = (ast.FunctionDef, ast.ClassDef)
        # The last, since an overload may come before.
        node = [x for x in node.body if isinstance(x, named) and x.name == name][-1]
    return node
