"""The sources behind a computation, as text and as BibTeX; `citations.bib` lists them."""

import re
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from inspect import isclass
from operator import attrgetter
from textwrap import fill
from types import ModuleType
from typing import Any, NamedTuple

_SOFTWARE = "jaxstab"
_METHOD = "rey_bleyer_2018"
# Fields of an entry that are not BibTeX's.
_OURS = ("behind", "role")
# Addresses stay whole.
_UNBROKEN: Any = {"break_long_words": False, "break_on_hyphens": False}


class Source(NamedTuple):
    """An entry of the bibliography: its key, its kind, as "article", and its fields by name."""

    key: str
    kind: str
    fields: dict[str, str]

    @property
    def behind(self) -> list[str]:
        """The public names that rest on the source."""
        return re.findall(r"[\w.]+", self.fields.get("behind", ""))

    @property
    def text(self) -> str:
        """The source as one line of plain text."""
        plain = re.compile("[{}]")
        field = {k: plain.sub("", x).replace("--", "-") for k, x in self.fields.items()}
        names = [" ".join(reversed(name.split(", "))) for name in field["author"].split(" and ")]
        line = f"{', '.join(names)}. {field['title']}"
        if "version" in field:
            return f"{line}, version {field['version']}."
        where = field.get("journal") or ", ".join(
            field[name] for name in ("booktitle", "publisher") if name in field
        )
        if "volume" in field:
            where = f"{where} {field['volume']}, {field['pages']}"
        line = f"{line}. {where} ({field['year']})."
        if "doi" in field:
            line += f" doi:{field['doi']}"
        return line

    @property
    def bibtex(self) -> str:
        """The source as an entry of BibTeX."""
        lines = [f"  {name} = {{{x}}}," for name, x in self.fields.items() if name not in _OURS]
        return "\n".join([f"@{self.kind}{{{self.key},", *lines, "}"])


class Citations:
    """The sources to cite, each with the public names that rest on it; `print` shows them."""

    def __init__(self, reasons: dict[str, list[str]]):
        self.reasons = reasons

    @property
    def bibtex(self) -> str:
        """The entries of BibTeX, for a `.bib` file."""
        return "\n\n".join(source.bibtex for source in self.sources) + "\n"

    @property
    def sources(self) -> list[Source]:
        """The sources, in the order of their print."""
        return [_sources()[key] for key in self.reasons]

    def __repr__(self) -> str:
        entries = []
        for source, names in zip(self.sources, self.reasons.values(), strict=True):
            role = source.fields["role"]
            if names:
                role += f" (behind {', '.join(names)})"
            entries.append(_wrap(source.text, ""))
            entries.append(_wrap(role, "    "))
        return "\n".join(entries)


def cite(*objects: object) -> Citations:
    """Return the sources behind functions, classes, modules or results, and jaxstab itself.

    Arguments:
        objects: functions (`js.equilibrate`), classes (`js.potentials.Dugdale`), modules
            (`js.references.jkr`), or their results, whose classes and parts are cited. None for the
            software and the paper whose method it implements.

    Returns:
        The citations: `print` them, or write `.bibtex` to a file.

    Raises:
        ValueError: for something that is not of jaxstab.

    Example:
        >>> "Stability analysis of rough surfaces" in js.cite(js.equilibrate).bibtex
        True
    """
    reasons: dict[str, list[str]] = {_SOFTWARE: []}
    if not objects:
        reasons[_METHOD] = []
    for item in objects:
        parts = list(_parts(item))
        if not parts:
            given = _name(item)
            if isinstance(item, str):
                given = repr(item)
            raise ValueError(
                f"{given} is not of jaxstab: cite takes its functions, classes and modules, as "
                "jaxstab.equilibrate or jaxstab.references.jkr, and their results, one by one."
            )
        for source in _sources().values():
            targets = [attrgetter(name)(sys.modules[_SOFTWARE]) for name in source.behind]
            if any(_concerns(target, part) for target in targets for part in parts):
                reasons.setdefault(source.key, []).append(_name(item))
    return Citations({key: list(dict.fromkeys(names)) for key, names in reasons.items()})


@cache
def _sources() -> dict[str, Source]:
    text = files("jaxstab.citations").joinpath("citations.bib").read_text(encoding="utf-8")
    sources = {}
    for kind, key, body in re.findall(r"^@(\w+)\{(\w+),\n(.*?)^\}", text, re.DOTALL | re.MULTILINE):
        found = dict(re.findall(r"^  (\w+) = \{(.*)\},$", body, re.MULTILINE))
        if key == _SOFTWARE:
            found["version"] = version("jaxstab")
        sources[key] = Source(key, kind, found)
    return sources


def _parts(item: object) -> Iterator[object]:
    """Yield the functions, classes and modules of jaxstab that an object is or is made of."""
    if isinstance(item, ModuleType):
        if _is_inside(item.__name__, "jaxstab"):
            yield item
    elif isclass(item):
        yield from (kind for kind in item.__mro__ if _is_inside(kind.__module__, "jaxstab"))
    elif hasattr(item, "__qualname__"):
        if _is_inside(getattr(item, "__module__", None) or "", "jaxstab"):
            yield item
    else:
        yield from _parts(type(item))
        if is_dataclass(item):
            for field in fields(item):
                part = getattr(item, field.name, None)
                if isinstance(part, dict):
                    part = [*part.values()]
                if not isinstance(part, list | tuple):
                    part = [part]
                for each in part:
                    yield from _parts(each)


def _concerns(target: object, part: object) -> bool:
    """Whether they are the same, or one is a module that holds the other."""
    return part is target or _holds(target, part) or _holds(part, target)


def _holds(module: object, item: object) -> bool:
    if not isinstance(module, ModuleType):
        return False
    home = item.__name__ if isinstance(item, ModuleType) else item.__module__
    return _is_inside(home, module.__name__)


def _is_inside(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def _name(item: object) -> str:
    """Return the name of an object, or of the class of a result."""
    if isinstance(item, ModuleType):
        return item.__name__.removeprefix("jaxstab.")
    return getattr(item, "__qualname__", type(item).__name__)


def _wrap(text: str, margin: str) -> str:
    return fill(text, 88, initial_indent=margin, subsequent_indent=margin + "  ", **_UNBROKEN)
