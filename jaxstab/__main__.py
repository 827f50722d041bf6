"""The command line."""

import codecs
import io
import os
import sys
import unicodedata
import warnings
from importlib import import_module

from jaxstab.cli.options import in_options, read
from jaxstab.cli.parsing import BAD_INPUT, CLOSED_PIPE, FAILED, INTERRUPTED, Ended

# JAX before 0.12 reports every program from its cache as made for another machine. It reads this
# when it is imported.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

# Spellings in ASCII of characters that have no decomposition into letters of ASCII.
_SPELLINGS = str.maketrans({"\u03bc": "u", "±": "+-", "\u00d7": "x", "\u2013": "-", "\u2212": "-"})


def start() -> None:
    """Run the command line with a compilation cache; a reader that has gone ends it."""
    open_streams()
    try:
        try:
            main(with_cache=True)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # Python flushes once more when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(CLOSED_PIPE) from None


def open_streams() -> None:
    """Make standard output and error print anything: a message must not fail as it is printed.

    Characters that the terminal's encoding lacks are spelled in others. A stream that is closed is
    replaced by the null device, which also takes its number before another file does.
    """
    codecs.register_error("spelled", _ascii_spelling)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="spelled")


def _ascii_spelling(error: UnicodeError) -> tuple[str, int]:
    """Return a spelling in ASCII of characters that cannot be encoded, and where they end."""
    assert isinstance(error, UnicodeEncodeError)
    characters = error.object[error.start : error.end]
    spellings = (unicodedata.normalize("NFKD", x).translate(_SPELLINGS) for x in characters)
    plain = (text.encode("ascii", "ignore").decode() or "?" for text in spellings)
    return "".join(plain), error.end


def main(arguments: list[str] | None = None, *, with_cache: bool = False) -> None:
    """Run the command that the arguments name, `run` if they name none."""
    if arguments is None:
        arguments = sys.argv[1:]
    # Nothing heavy is imported before, so that a mistake is answered at once.
    name, options = read(arguments)
    if with_cache:
        import_module("jaxstab.cli.compilation_cache").use_compilation_cache()
    import_module("matplotlib").use("Agg")
    command = import_module(f"jaxstab.cli.{name}")
    results = import_module("jaxstab.core.results")
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            command.run(options)
    except Ended as ended:
        _end(str(ended), ended.code)
    except results.SolverError as error:
        _end(str(error), FAILED)
    except BrokenPipeError:
        raise
    except (ValueError, TypeError, OSError, ImportError) as error:
        _end(str(error), BAD_INPUT)
    except KeyboardInterrupt:
        _end("interrupted.", INTERRUPTED)


def _end(message: str, code: int) -> None:
    print(f"jaxstab: {in_options(message)}", file=sys.stderr)
    raise SystemExit(code)


def _warn(message: Warning | str, *_: object) -> None:
    print(f"jaxstab: {in_options(str(message))}", file=sys.stderr)


if __name__ == "__main__":
    start()
