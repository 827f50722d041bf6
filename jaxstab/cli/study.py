"""`jaxstab study`: run or continue the study that a file describes."""

import argparse
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

import jaxstab
from jaxstab.cli.parsing import FAILED, INTERRUPTED, Ended
from jaxstab.core.optional_packages import require_packages
from jaxstab.core.progress import is_watched
from jaxstab.studies import StudyInterrupted

if TYPE_CHECKING:
    import xarray

# The name of the imported file, which no other module has.
_MODULE = "__study__"


def run(options: argparse.Namespace) -> None:
    """Run the study and say how its cases ended."""
    module = _import_module(options.file)
    with (
        _executor(options, module) as executor,
        # Said at the end instead.
        warnings.catch_warnings(action="ignore", category=StudyInterrupted),
    ):
        try:
            dataset = jaxstab.study(
                module.case,
                module.axes,
                options.path,
                executor=executor,
                batch=options.batch,
                version=options.version,
                retry=options.retry,
                accept_changes=options.accept_changes,
                progress=is_watched(),
            )
        except RuntimeError as error:
            raise Ended(str(error), FAILED) from error
    results = dataset["result"].values.ravel().tolist()
    print(_summary(dataset, results))
    print(f"\nThe results are in {options.path.resolve()}")
    if "missing" in results:
        done = len(results) - results.count("missing")
        raise Ended(f"interrupted, {done} of {len(results)} cases are done.", INTERRUPTED)
    if "successful" not in results:
        raise Ended("every case failed, as the error above says.", FAILED)


@contextmanager
def _executor(options: argparse.Namespace, module: ModuleType) -> Iterator[object]:
    """Yield the executor of the cases, for `jaxstab.study`."""
    if options.workers is None and options.scheduler is None:
        yield None
        return
    require_packages("Studies in many processes", "studies", "cloudpickle", "distributed")
    import cloudpickle
    from distributed import Client

    # No other process can import it by its name.
    cloudpickle.register_pickle_by_value(module)
    if options.scheduler is None:
        yield options.workers
        return
    try:
        client = Client(options.scheduler, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(f"No Dask scheduler answers at {options.scheduler}: {error}") from error
    with client:
        yield client


def _import_module(path: Path) -> ModuleType:
    """Return the module that a file is."""
    spec = spec_from_file_location(_MODULE, path.resolve())
    if not path.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"{path} is not a Python file.")
    module = module_from_spec(spec)
    # It can import modules beside it, as a script can.
    sys.path.insert(0, str(path.resolve().parent))
    sys.modules[_MODULE] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == spec.origin]
        place = str(path)
        if lines:
            place += f", line {lines[-1]}"
        raise ValueError(f"{place}: {type(error).__name__}: {error}") from error
    for name in ("case", "axes"):
        if not hasattr(module, name):
            raise ValueError(f"{path} defines no `{name}`: a study needs `case` and `axes`.")
    return module


def _summary(dataset: "xarray.Dataset", results: list[str]) -> str:
    counts = {word: results.count(word) for word in ("successful", "failed", "missing")}
    lines = [f"{len(results)} cases: {', '.join(f'{n} {word}' for word, n in counts.items() if n)}"]
    lines.append(f"{float(dataset['seconds'].sum()):.3g} s of computation")
    if counts["failed"]:
        shape = dataset["result"].shape
        place = np.unravel_index(results.index("failed"), shape)
        first = dataset[dict(zip(dataset["result"].dims, place, strict=True))]
        where = ", ".join(f"{n}={x.item()}" for n, x in first.coords.items() if not x.ndim)
        lines.append(f"The first that failed, {where}: {first['error'].item()}")
        lines.append("To run failed cases again: --retry")
    return "\n".join(lines)
