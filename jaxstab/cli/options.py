"""The options of all commands, read and checked before anything heavy is imported."""

import argparse
import re
from importlib.metadata import version
from pathlib import Path

import jaxstab
from jaxstab.cli.parsing import (
    Parser,
    existing_file,
    from_config,
    given_options,
    nearest,
    number,
    option_of,
    typed_text,
    whole_number,
)

# Commands and their descriptions; the default is `run`.
COMMANDS = {
    "run": "Load and unload a rough contact with an adhesive elastic half space, and locate every "
    "jump; or assess the stability of its equilibria as it is unloaded (Rey & Bleyer, section "
    "4.2.3). The figure and the data go into a new folder.",
    "study": "Run or continue the study that a Python file describes: the file defines the "
    "function `case` and its `axes`, as jaxstab.study takes them. Finished cases are never run "
    "again.",
    "info": "Describe a file: a surface, with its statistics, or a result.",
    "report": "Describe how a scanned surface sticks, on a page of HTML that needs no other file: "
    "the surface, the loop of approach and retraction, the pull-off and its uncertainty, patches, "
    "verdicts, assumptions and sources. All numbers are in SI units.",
    "plot": "Draw a result: a loop, a branch, a pass, a stability curve, or a state's fields.",
    "cite": "Print the sources to cite: the software, and the papers behind its functions.",
}
# Laws by the names of their classes in lower case.
LAWS = ("exponential", "gaussian", "rational", "dugdale", "lennard-jones")
LOADS = {
    "gap": "MeanGap",
    "displacement": "MeanDisplacement",
    "pressure": "MeanPressure",
    "spring": "Spring",
}
# Parameters of a surface that is generated; statements that a surface file may lack.
SPECTRUM = ("hurst", "k_low", "k_rolloff", "k_high", "rms_height")
OF_A_FILE = ("lengths", "unit", "channel")
_DEFAULT = " (default %(default)s)"

# The code in the library's advice, beside names of arguments, and its equivalent as options.
_OPTIONS = {
    "js.surfaces.read(path, lengths=(3.0, 1.4))": "--lengths 3 1.4",
    "Topography.detrended()": "--detrend 1",
    # Any treatment fills missing points.
    "Topography.filled()": "--detrend 1",
    "js.surfaces.Topography(grid, heights).filled()": "--detrend 1",
    'Topography.periodic("mirror")': "--periodic mirror",
    'Topography.periodic("window")': "--periodic window",
    "float64": "--precision float64",
    "jaxstab.follow": "--study loop",
}


def in_options(message: str) -> str:
    """Return a message with the code between its backticks as options of the command line.

    Code without an equivalent stays: an argument becomes an option of its name, if there is one.
    """
    known = " ".join(parser.format_usage() for parser in _parsers()[1].values())

    def option(code: str) -> str:
        name, _, value = code.partition("=")
        if code not in _OPTIONS and f"[{option_of(name)}" in known:
            value = value.strip('"').removeprefix("True")
            return f"{option_of(name)} {value}".strip()
        return _OPTIONS.get(code, f"`{code}`")

    parts = message.split("`")
    parts[1::2] = map(option, parts[1::2])
    return "".join(parts)


def read(arguments: list[str]) -> tuple[str, argparse.Namespace]:
    """Return the command that arguments name, and its options, checked."""
    parser, parsers = _parsers()
    first, *rest = arguments or ["run"]
    if first in ("-h", "--help", "--version"):
        parser.parse_args([first])
    if first not in COMMANDS and not first.startswith("-"):
        parser.error(
            f"there is no command {first}{nearest(first, COMMANDS)}. "
            f"Commands: {', '.join(COMMANDS)}."
        )
    name = first
    if first not in COMMANDS:
        name = "run"
        rest = arguments
    options = parsers[name].parse_args(rest)
    if name == "run":
        if options.config is not None:
            # The command line overrides the file.
            rest = [*from_config(parsers[name], options.config), *rest]
            options = parsers[name].parse_args(rest)
        _require_consistent(parsers[name], options, given_options(rest))
    return name, options


def _parsers() -> tuple[Parser, dict[str, Parser]]:
    description = "Equilibrium and stability of adhesive rough contacts. The default is run."
    parser = Parser(prog="jaxstab", description=description)
    parser.add_argument("--version", action="version", version=f"%(prog)s {version('jaxstab')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    adders = (_add_run, _add_study, _add_info, _add_report, _add_plot, _add_cite)
    parsers = {}
    for (name, description), add in zip(COMMANDS.items(), adders, strict=True):
        help = re.split("[:;]", description)[0]
        parsers[name] = commands.add_parser(name, help=help, description=description)
        add(parsers[name])
    return parser, parsers


def _add_run(parser: Parser) -> None:
    help = "a TOML file of these options"
    parser.add_argument("--config", type=existing_file, metavar="FILE", help=help)
    help = f"kind of run{_DEFAULT}"
    parser.add_argument("--study", choices=["loop", "unloading"], default="loop", help=help)
    add = parser.add_argument_group("generated surface (cut-offs in waves per side)").add_argument
    add("--size", type=whole_number(2), default=256, help=f"points along a side{_DEFAULT}")
    help = f"seed of the surface{_DEFAULT}"
    add("--seed", type=whole_number(0, 2**32 - 1), default=0, help=help)
    add("--hurst", type=number, default=0.8, help=f"Hurst exponent{_DEFAULT}")
    add("--k-low", type=number, default=2.0, help=f"lower cut-off{_DEFAULT}")
    add("--k-rolloff", type=number, help="roll-off (default: the lower cut-off)")
    add("--k-high", type=number, default=32.0, help=f"upper cut-off{_DEFAULT}")
    add("--rms-height", type=number, default=0.1, help=f"rms height{_DEFAULT}")
    _add_file(parser, "measured surface", "--surface")
    _add_treatment(parser, 1, "1", "as they are, with a warning")
    # Defaults of the paper's example, which suit the generated surface.
    add = parser.add_argument_group("solid and adhesion (all needed with --surface)").add_argument
    add("--youngs-modulus", type=number, default=1e-3, help=f"E{_DEFAULT}")
    add("--poisson-ratio", type=number, default=0.0, help=f"nu{_DEFAULT}")
    help = "unit of pressures, as MPa, to be shown (default: Pa where lengths are in m)"
    add("--pressure-unit", help=help)
    add("--potential", choices=[*LAWS, "none"], default=LAWS[0], help=f"law{_DEFAULT}")
    help = f"work of adhesion w, twice gamma of equal surfaces{_DEFAULT}"
    add("--surface-energy", type=number, default=1e-2, help=help)
    add("--range", type=number, default=1.0, help=f"rho{_DEFAULT}")
    help = "edge width of Dugdale's law, over rho (default 0.1)"
    add("--smoothing", type=number, help=help)
    add = parser.add_argument_group("loads").add_argument
    add("--load", choices=[*LOADS], default="gap", help=f"kind of load{_DEFAULT}")
    add("--stiffness", type=number, help="stiffness of the spring")
    help = "first load (default of a gap: 1e-4 rms heights, above the minimum of a law with a core)"
    add("--first", type=number, help=help)
    add("--last", type=number, help="last load (default of a gap: 20 rms heights more)")
    add = parser.add_argument_group("loop, from the last load to the first and back").add_argument
    help = (
        "locate jumps that lose at least this share of the problem's energy (default 2e-7, or "
        "0.3 %% of the earlier losses if that is more)"
    )
    add("--smallest-jump", type=number, help=help)
    add = parser.add_argument_group("unloading, from the first load to the last").add_argument
    add("--number", type=whole_number(1), default=21, help=f"number of loads{_DEFAULT}")
    orders = ["continuation", "independent"]
    help = f"start of the solver at each load{_DEFAULT}"
    add("--order", choices=orders, default=orders[0], help=help)
    add = parser.add_argument_group("run").add_argument
    help = f"precision of all numbers{_DEFAULT}"
    add("--precision", choices=["float64", "float32"], default="float64", help=help)
    help = f"folder of the numbered runs{_DEFAULT}"
    add("--output", type=Path, default=Path("results"), help=help)


def _add_file(parser: Parser, title: str, *names: str) -> None:
    """Add the options of a measured surface."""
    add = parser.add_argument_group(title).add_argument
    for name in names:
        help = "a scan: text, xyz, npy, NetCDF, x3p, gwy, ..."
        add(name, type=existing_file, metavar="FILE", help=help)
    help = "lengths of its sides, or one length of all, if the file has none"
    add("--lengths", type=number, nargs="+", metavar="L", help=help)
    help = "unit of lengths and heights, if the file has none"
    add("--unit", type=typed_text, help=help)
    add("--channel", type=typed_text, help="channel to read (default: the first with heights)")


def _add_treatment(parser: Parser, detrend: int | None, trend: str, periodic: str) -> None:
    """Add the options of the treatment of a measured surface, with their defaults in words."""
    add = parser.add_argument_group("treatment of a measured surface").add_argument
    help = f"order of the trend that is removed (default: {trend})"
    add("--detrend", type=whole_number(0, 2), default=detrend, help=help)
    help = f"how to make its edges meet (default: {periodic})"
    add("--periodic", choices=["window", "mirror", "as_is"], help=help)


def _add_import(parser: Parser) -> None:
    help = "import a module that defines classes of the result; loading a file imports none"
    parser.add_argument("--import", action="append", default=[], metavar="MODULE", help=help)


def _add_study(parser: Parser) -> None:
    help = "defines `case` and `axes`"
    parser.add_argument("file", type=existing_file, metavar="STUDY.py", help=help)
    help = "the folder of the results; made if it does not exist"
    parser.add_argument("--path", type=Path, metavar="FOLDER", required=True, help=help)
    help = f"number of cases that run at once, by jax.vmap{_DEFAULT}"
    parser.add_argument("--batch", type=whole_number(1), default=1, help=help)
    engine = parser.add_mutually_exclusive_group()
    help = "run cases in N processes of this machine"
    engine.add_argument("--workers", type=whole_number(1), metavar="N", help=help)
    help = "run cases on the workers of a Dask scheduler, as in tcp://HOST:8786"
    engine.add_argument("--scheduler", metavar="ADDRESS", help=help)
    help = "run failed cases again"
    parser.add_argument("--retry", action="store_true", help=help)
    help = "a word that you change with functions and values to which the case refers"
    parser.add_argument("--version", metavar="WORD", help=help)
    help = "go on if the case, the version or packages have changed, and record it"
    parser.add_argument("--accept-changes", action="store_true", help=help)


def _add_info(parser: Parser) -> None:
    help = "a surface or a result"
    parser.add_argument("file", type=existing_file, metavar="FILE", help=help)
    _add_file(parser, "a surface")
    _add_import(parser)


def _add_report(parser: Parser) -> None:
    _add_file(parser, "a scan", "file")
    _add_treatment(parser, None, "1, or 0 if its edges meet", "mirror, or as_is if they meet")
    help = (
        "points along the longest side of the periodic cell, which a mirrored scan makes twice as "
        "long (default: as many as it has, at most 128)"
    )
    parser.add_argument("--size", type=whole_number(8), help=help)
    add = parser.add_argument_group("solid and adhesion, in SI units").add_argument
    add("--modulus", type=number, required=True, metavar="E", help="Young's modulus [Pa]")
    help = f"Poisson's ratio{_DEFAULT}, as of rubber"
    add("--poisson-ratio", type=number, default=0.5, metavar="NU", help=help)
    help = "work of adhesion w, twice gamma of equal surfaces [J/m^2]"
    add("--work", type=number, required=True, metavar="W", help=help)
    help = (
        "range of an exponential attraction [m]; to one that the grid does not resolve the "
        "pull-off is extrapolated (default: the shortest that the grid resolves)"
    )
    add("--range", type=number, metavar="RHO", help=help)
    help = "largest pressure that the softer surface bears, beyond which it yields [Pa]"
    add("--hardness", type=number, metavar="H", help=help)
    help = f"the page{_DEFAULT}"
    default = Path("report.html")
    parser.add_argument("--output", type=Path, default=default, metavar="FILE", help=help)


def _add_plot(parser: Parser) -> None:
    parser.add_argument("file", type=existing_file, metavar="RESULT.nc", help="a result")
    help = "the figure, .png, .pdf or .svg (default: beside the result)"
    parser.add_argument("--output", type=Path, metavar="FILE", help=help)
    help = "draw one state of a sweep, from 0 on"
    parser.add_argument("--state", type=whole_number(0), help=help)
    help = f"width in print, a column or a page{_DEFAULT}"
    parser.add_argument("--width", choices=["single", "double"], default="double", help=help)
    _add_import(parser)


def _add_cite(parser: Parser) -> None:
    help = "a function or module, as equilibrate or references.jkr (default: the method itself)"
    parser.add_argument("names", nargs="*", type=_public_name, metavar="NAME", help=help)
    parser.add_argument("--bibtex", action="store_true", help="as BibTeX")


def _public_name(text: str) -> str:
    """Return a name that begins with one of the library."""
    text = text.removeprefix("jaxstab.")
    first = text.split(".")[0]
    if first not in jaxstab.__all__:
        close = nearest(first, jaxstab.__all__) or "; give one as equilibrate or potentials.Dugdale"
        raise argparse.ArgumentTypeError(f"there is no {first} in jaxstab{close}.")
    return text


def _require_consistent(parser: Parser, options: argparse.Namespace, found: set[str]) -> None:
    """Exit if options do not belong together, or one is missing."""
    is_measured = options.surface is not None
    has_law = options.potential != "none"
    is_spring = options.load == "spring"
    law = ("surface_energy", "range")
    of_another = "describes a generated surface: leave it out with --surface"
    of_surface = "is needed with --surface, in the units of the surface"
    for names, can_be_given, reason in (
        (("size", "seed", *SPECTRUM), not is_measured, of_another),
        ((*OF_A_FILE, "detrend", "periodic"), is_measured, "belongs to --surface"),
        (law, has_law, "belongs to a law, not to --potential none"),
        (["smoothing"], options.potential == "dugdale", "belongs to --potential dugdale"),
        (["stiffness"], is_spring, "belongs to --load spring, which needs it"),
        (["smallest_jump"], options.study == "loop", "belongs to --study loop"),
        (("number", "order"), options.study == "unloading", "belongs to --study unloading"),
    ):
        for name in names:
            if option_of(name) in found and not can_be_given:
                parser.error(f"argument {option_of(name)} {reason}.")
    needs_loads = options.load not in ("gap", "displacement")
    for names, is_needed, reason in (
        (["youngs_modulus"], is_measured, of_surface),
        (law, is_measured and has_law, of_surface),
        (["stiffness"], is_spring, "belongs to --load spring, which needs it"),
        (("first", "last"), needs_loads, f"is needed with --load {options.load}"),
    ):
        for name in names:
            if is_needed and option_of(name) not in found:
                parser.error(f"argument {option_of(name)} {reason}.")
