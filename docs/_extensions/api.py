"""Directives that document what is public, and a role that refers to it.

    public       documents what its lines name: public modules, rooms of the package, single things
    module-text  shows what a module says of itself
    js           refers to something public by its name within the package

Signatures are taken from the source text, so that shapes read as they are written there.
"""

import ast
import inspect
import re
import sys
from collections.abc import Iterator
from copy import deepcopy
from types import ModuleType
from typing import Any

from docutils import nodes
from public_names import (
    PACKAGE,
    definition,
    everything,
    full_name,
    is_inside,
    name_of,
    names_of,
    resolve,
)
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.domains.python import PyObject
from sphinx.util.docutils import SphinxDirective, SphinxRole

# A union, not a class, which the page of equilibria explains.
_STATE = f"{PACKAGE}.equilibrium.equilibrium.State"
_SECTIONS = {"Arguments": "param", "Attributes": "ivar", "Members": "ivar", "Raises": "raises"}


class Public(SphinxDirective):
    """Documents all that its lines stand for."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the nodes of the descriptions."""
        names = [name for entry in self.content if entry for name in names_of(entry)]
        return self.parse_text_to_nodes("\n\n".join(map(described, names)))


class ModuleText(SphinxDirective):
    """Shows the docstring of a module."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return its nodes."""
        (name,) = self.arguments
        return self.parse_text_to_nodes(to_markdown(inspect.getdoc(resolve(name)) or "", name))


class Reference(SphinxRole):
    """Refers to something public."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the reference."""
        reference = addnodes.pending_xref(
            self.rawtext,
            nodes.literal(self.text, f"js.{self.text}", classes=["xref", "py"]),
            reftarget=f"{PACKAGE}.{self.text}",
            refdomain="py",
            reftype="obj",
            refexplicit=True,
            refwarn=True,
        )
        reference["refdoc"] = self.env.docname
        return [reference], []


def described(name: str) -> str:
    """Return the description of something public, as directives of the Python domain."""
    item = resolve(name)
    node = definition(item)
    if isinstance(node, ast.FunctionDef):
        signature = _signature(node, _Linked(item.__module__))
        return _directive("function", name + signature, inspect.getdoc(item), name)
    kind = "exception" if issubclass(item, Exception) else "class"
    methods = "\n\n".join(_methods(node, name, _Linked(item.__module__)))
    return _directive(kind, name + _construction(item), _class_text(item), name, inner=methods)


def _methods(node: ast.ClassDef, name: str, linked: "_Linked") -> Iterator[str]:
    for method in node.body:
        if not isinstance(method, ast.FunctionDef) or method.name.startswith("_"):
            continue
        marks = {ast.unparse(mark) for mark in method.decorator_list}
        options = [
            f":{option}:"
            for option, mark in {
                "abstractmethod": "abstractmethod",
                "classmethod": "classmethod",
                "staticmethod": "staticmethod",
            }.items()
            if mark in marks
        ]
        skipped = 0 if "staticmethod" in marks else 1
        kind, signature = "method", _signature(method, linked, skipped)
        if "property" in marks:
            kind, signature = "property", ""
            if method.returns:
                options.append(f":type: {linked.text(method.returns)}")
        text = ast.get_docstring(method)
        yield _directive(kind, f"{name}.{method.name}{signature}", text, name, options)


def _directive(
    kind: str,
    signature: str,
    text: str | None,
    context: str,
    options: list[str] | None = None,
    inner: str = "",
) -> str:
    fence = "::::" if inner else ":::"
    head = "\n".join([f"{fence}{{py:{kind}}} {signature}", *(options or [])])
    return "\n\n".join([head, to_markdown(text or "", context), inner, fence])


def _signature(node: ast.FunctionDef, linked: "_Linked", skipped: int = 0) -> str:
    """Return the arguments of a function, without the first ones, and what it returns."""
    arguments = deepcopy(node.args)
    arguments.args = arguments.args[skipped:]
    for argument in (*arguments.args, *arguments.kwonlyargs):
        if argument.annotation:
            argument.annotation = linked.visit(argument.annotation)
    returns = f" -> {linked.text(node.returns)}" if node.returns else ""
    return f"({ast.unparse(arguments)}){returns}"


class _Linked(ast.NodeTransformer):
    """Makes of public names in annotations what Sphinx shows shortly and links.

    Arguments:
        module: the name of the module that the annotations are of.
    """

    def __init__(self, module: str):
        self.module = module

    def text(self, annotation: ast.expr) -> str:
        """Return an annotation as text."""
        return ast.unparse(self.visit(deepcopy(annotation)))

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Return a name in full, after the `~` that has Sphinx show its end; of a shape, that."""
        meant = vars(sys.modules[self.module]).get(node.id)
        if getattr(meant, "__module__", None) == "jaxtyping" and "[" in meant.__name__:
            shape = re.sub(r"\[[\w.]+,", "[Array,", meant.__name__)
            return ast.parse(shape, mode="eval").body
        top = full_name(node.id)
        full = name_of(meant)
        if full is None and top is not None:
            # What is imported for types only is not there; another `Path` is another thing.
            full = top if meant is None else f"{meant.__module__}.{meant.__qualname__}"
        full = _STATE if full is None and node.id == "State" else full
        return node if full is None else ast.UnaryOp(ast.Invert(), ast.Name(full))

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        """Return a name in quotes without them, and shapes without the space before them."""
        if not isinstance(node.value, str):
            return node
        if full_name(node.value):
            return self.visit_Name(ast.Name(node.value))
        return ast.Constant(node.value.strip())


def _construction(item: type) -> str:
    """Return the arguments that a class is made with, where users make it."""
    kinds = [kind for kind in item.__mro__ if is_inside(kind.__module__, PACKAGE)]
    for kind in kinds:
        for method in definition(kind).body:
            if isinstance(method, ast.FunctionDef) and method.name == "__init__":
                return _signature(method, _Linked(kind.__module__), skipped=1)
    if "Attributes:" in (item.__doc__ or ""):
        return ""
    linked = _Linked(item.__module__)
    fields = [
        f"{field.target.id}: {linked.text(field.annotation)}{_default(field.value)}"
        for field in definition(item).body
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and "ClassVar" not in ast.unparse(field.annotation)
    ]
    return f"({', '.join(fields)})" if fields else ""


def _default(value: ast.expr | None) -> str:
    """Return the default of a field, which may stand in an `eqx.field`."""
    if isinstance(value, ast.Call):
        value = next((x.value for x in value.keywords if x.arg == "default"), None)
    return "" if value is None else f" = {ast.unparse(value)}"


def _class_text(item: Any) -> str:
    """Return the docstring of a class; of an enumeration its members as a section."""
    text = inspect.getdoc(item) or ""
    if not hasattr(item, "texts"):
        return text
    lines = [f"    {line}" for line in item.texts]
    blocks = text.split("\n\n")[: -len(lines)]
    return "\n".join(["\n\n".join(blocks), "", "Members:", *lines])


def to_markdown(text: str, context: str) -> str:
    """Return a docstring of the house's style as MyST Markdown.

    Arguments:
        text: the docstring.
        context: the name of what it is of, near which names in backticks are looked for.
    """
    lines = inspect.cleandoc(text).splitlines()
    blocks = "\n".join(lines).split("\n\n")
    return "\n\n".join(_block(block, context) for block in blocks)


def _block(block: str, context: str) -> str:
    lines = block.splitlines()
    title = lines[0].removesuffix(":")
    if lines[0].startswith("    "):
        return "\n".join(["```text", inspect.cleandoc(block), "```"])
    if title in _SECTIONS and len(lines) > 1:
        return "\n".join(_fields(_SECTIONS[title], lines[1:], context))
    if title == "Example" and len(lines) > 1:
        return "\n".join(["```pycon", inspect.cleandoc("\n".join(["", *lines[1:]])), "```"])
    if title == "Returns" and len(lines) > 1:
        return f":returns: {_inline(' '.join(map(str.strip, lines[1:])), context)}"
    return _inline(" ".join(lines), context)


def _fields(kind: str, lines: list[str], context: str) -> Iterator[str]:
    """Yield a field for each name of a section, where several may share a text."""
    entries = re.split(r"\n(?! {5})", "\n".join(lines))
    for entry in entries:
        names, _, text = " ".join(entry.split()).partition(": ")
        for name in names.split(", "):
            if kind == "raises":
                full = full_name(name)
                name = f"~{full}" if full else name
            yield f":{kind} {name}: {_inline(text, context)}"


def _inline(text: str, context: str) -> str:
    """Return running text with formulae escaped and names in backticks linked."""
    pieces = re.split(r"(`[^`]+`|(?<![\w*])\*\w[^*]*\w\*(?!\w))", text)
    for i, piece in enumerate(pieces):
        if i % 2 == 0:
            pieces[i] = re.sub(r"([\\*_\[\]<>$])", r"\\\1", piece)
        elif piece.startswith("`"):
            pieces[i] = _linked(piece.strip("`"), context)
    return "".join(pieces)


def _linked(code: str, context: str) -> str:
    name = re.sub(r"^(jaxstab|js)\.|\(\)$", "", code)
    if code not in _argument_names(context):
        beside = f"{context.rpartition('.')[0]}.{name}"
        full = full_name(name) or (beside if beside in everything() else None)
        if full:
            return f"{{py:obj}}`{code} <{full}>`"
    return f"`{code}`"


def _argument_names(name: str) -> list[str]:
    """Return the names of the arguments of a function, which may be functions too."""
    item = resolve(name)
    node = None if isinstance(item, ModuleType) else definition(item)
    if not isinstance(node, ast.FunctionDef):
        return []
    return [argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)]


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directives and the role to Sphinx."""
    app.add_directive("public", Public)
    app.add_directive("module-text", ModuleText)
    app.add_role("js", Reference())
    labels = {"parameter": "Arguments", "variable": "Attributes"}
    for field in PyObject.doc_field_types:
        field.label = labels.get(field.name, field.label)
    return {"parallel_read_safe": True}
