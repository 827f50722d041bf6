"""Where a function is written: its part of the syntax tree of a file or a cell."""

import ast
import dis
import inspect
from collections.abc import Iterator
from types import CodeType, FunctionType
from typing import Any

Node = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
_GLOBAL = {"LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"}


def definition(function: FunctionType) -> tuple[Node, str]:
    """Return the node that defines a function, and the lines of source that it is on.

    Raises:
        ValueError: where the source is not found, or is no longer that of the function, or where
            lambdas share a line and Python does not keep which is which.
    """
    code, name = function.__code__, function.__qualname__
    try:
        lines, _ = inspect.findsource(code)
        tree = ast.parse("".join(lines))
    except (OSError, TypeError, SyntaxError):
        raise ValueError(
            f"The source of `{name}` is not found, by which a store knows its study again: write "
            "it in a file or in a cell of a notebook."
        ) from None
    nodes = [node for node in ast.walk(tree) if isinstance(node, Node) and _is_of(node, code)]
    if not nodes or not _is_current(code, tree):
        raise ValueError(
            f"`{name}` is no longer what stands in {code.co_filename}: import it anew, or restart "
            "Python."
        )
    node = _compiled_to(code, nodes)
    if node is None:
        raise ValueError(
            f"Several lambdas stand on line {code.co_firstlineno} of {code.co_filename}: write "
            "each on a line of its own."
        )
    first = _first_line(node)
    last = node.end_lineno or first
    return node, inspect.cleandoc("\n" + "".join(lines[first - 1 : last]))


def plain(node: ast.AST) -> str:
    """Return what a node says, without comments, layout and docstrings."""
    node = ast.parse(ast.unparse(node))
    for inner in ast.walk(node):
        if isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and (
            ast.get_docstring(inner, clean=False) is not None
        ):
            inner.body = inner.body[1:] or [ast.Pass()]
    return ast.unparse(node)


def global_names(function: FunctionType, node: Node) -> list[str]:
    """Return the names that a function and its decorators take from outside, sorted."""
    names = {
        instruction.argval
        for code in _codes(function.__code__)
        for instruction in dis.get_instructions(code)
        if instruction.opname in _GLOBAL
    }
    marks = getattr(node, "decorator_list", [])
    names |= {x.id for mark in marks for x in ast.walk(mark) if isinstance(x, ast.Name)}
    return sorted(names)


def _is_of(node: Node, code: CodeType) -> bool:
    is_named = getattr(node, "name", "<lambda>") == code.co_name
    return is_named and _first_line(node) == code.co_firstlineno


def _compiled_to(code: CodeType, nodes: list[Node]) -> Node | None:
    """Return which of the nodes that begin on a line a code is of, None where none can be told."""
    if len(nodes) == 1:
        return nodes[0]
    # Of lambdas within each other, both hold what the inner one does.
    places = [place for place in code.co_positions() if None not in place and place[3] != place[2]]
    around = [node for node in nodes if all(_holds(node.body, place) for place in places)]
    return max(around, key=lambda node: node.col_offset) if places and around else None


def _holds(body: Any, place: tuple[int | None, ...]) -> bool:
    first, last, start, end = place
    is_after = (body.lineno, body.col_offset) <= (first, start)
    return is_after and (last, end) <= (body.end_lineno, body.end_col_offset)


def _first_line(node: Node) -> int:
    marks = [] if isinstance(node, ast.Lambda) else node.decorator_list
    return min([node.lineno, *(mark.lineno for mark in marks)])


def _is_current(code: CodeType, tree: ast.Module) -> bool:
    """Whether a file, which may have been edited since it was imported, still says this."""
    # Pytest rewrites what asserts.
    if any("@pytest_ar" in inner.co_names for inner in _codes(code)):
        return True
    now = compile(tree, code.co_filename, "exec", dont_inherit=True)
    return any(_are_same(code, other) for other in _codes(now))


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _are_same(one: CodeType, other: CodeType) -> bool:
    def constants(code: CodeType) -> list[str]:
        return [repr(x) for x in code.co_consts if not isinstance(x, CodeType)]

    pairs = zip(_codes(one), _codes(other), strict=False)
    return len(list(_codes(one))) == len(list(_codes(other))) and all(
        x.co_code == y.co_code and x.co_names == y.co_names and constants(x) == constants(y)
        for x, y in pairs
    )
