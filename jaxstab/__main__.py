"""The command line."""

import os
import sys
import warnings

# JAX before 0.12 reports every program from its cache as made for another machine. It reads this
# when it is imported.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import matplotlib

import jaxstab
from jaxstab.cli import cite, info, plot, run, study
from jaxstab.cli.compilation_cache import use_compilation_cache
from jaxstab.cli.parsing import BAD_INPUT, FAILED, INTERRUPTED, Ended, Parser
from jaxstab.core.results import SolverError

COMMANDS = {"run": run, "study": study, "info": info, "plot": plot, "cite": cite}


def start() -> None:
    """Run the command line with a compilation cache."""
    use_compilation_cache()
    main()


def main(arguments: list[str] | None = None) -> None:
    """Run the command that the arguments name, `run` if they name none."""
    arguments = sys.argv[1:] if arguments is None else arguments
    known = (*COMMANDS, "-h", "--help", "--version")
    name, *rest = arguments if arguments and arguments[0] in known else ["run", *arguments]
    parser, parsers = _parsers()
    if name not in COMMANDS:
        parser.parse_args([name])
    options = parsers[name].parse_args(rest)
    if name == "run":
        options = run.read(parsers[name], rest, options)
    matplotlib.use("Agg")
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            COMMANDS[name].run(options)
    except Ended as ended:
        _end(str(ended), ended.code)
    except SolverError as error:
        _end(str(error), FAILED)
    except (ValueError, TypeError, OSError, ImportError) as error:
        _end(str(error), BAD_INPUT)
    except KeyboardInterrupt:
        _end("interrupted.", INTERRUPTED)


def _parsers() -> tuple[Parser, dict[str, Parser]]:
    description = "Equilibrium and stability of adhesive rough contacts. Without a command: run."
    parser = Parser(prog="jaxstab", description=description)
    version = f"%(prog)s {jaxstab.__version__}"
    parser.add_argument("--version", action="version", version=version)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    parsers = {}
    for name, module in COMMANDS.items():
        help = module.DESCRIPTION.partition(":")[0].partition(";")[0].replace("\n", " ")
        parsers[name] = commands.add_parser(name, help=help, description=module.DESCRIPTION)
        module.add_options(parsers[name])
    return parser, parsers


def _end(message: str, code: int) -> None:
    print(f"jaxstab: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(code)


def _warn(message: Warning | str, *_: object) -> None:
    print(f"jaxstab: {' '.join(str(message).split())}", file=sys.stderr)


if __name__ == "__main__":
    start()
