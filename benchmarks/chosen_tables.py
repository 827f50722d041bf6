"""The command line of a script of several tables, of which names choose some."""

import argparse
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path


def make_tables(
    description: str | None,
    tables: Mapping[str, tuple[str, tuple[str, ...], Callable[[], Iterable[tuple]]]],
) -> None:
    """Print the tables that the command line names, or all, and write them where it says.

    Arguments:
        description: of the script, for its help.
        tables: a title, a header and a function that yields the rows, by the name of each table.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("tables", nargs="*", help=f"some of {', '.join(tables)}; all by default")
    parser.add_argument("--out", type=Path, help="a file for the tables as well")
    arguments = parser.parse_args()
    lines = []
    for name in arguments.tables or tables:
        title, header, rows = tables[name]
        lines += [title, "", f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
        print(title, flush=True)
        for row in rows():
            lines.append(f"| {' | '.join(map(str, row))} |")
            print(lines[-1], flush=True)
        lines.append("")
    if arguments.out:
        arguments.out.write_text("\n".join(lines).rstrip("\n") + "\n")
