"""The command line: a rough contact loaded and unloaded, or the unloading study of the paper."""

import argparse
import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from jaxstab.contact import Contact
from jaxstab.elasticity import HalfSpace
from jaxstab.files import save_path, save_sweep
from jaxstab.grid import Grid
from jaxstab.loads import Load, MeanDisplacement, MeanGap
from jaxstab.paths import follow
from jaxstab.plots import path as plot_path
from jaxstab.plots import stability_curve
from jaxstab.potentials import Exponential, Gaussian, NoAdhesion, Potential, Rational
from jaxstab.results import RESULTS, SolverError
from jaxstab.surfaces import self_affine
from jaxstab.sweeps import Sweep, SweepInterrupted, sweep

LAWS = {"exponential": Exponential, "gaussian": Gaussian, "rational": Rational}
LOADS = {"gap": MeanGap, "displacement": MeanDisplacement}


def run() -> None:
    """Run the command line with a cache of compiled programs."""
    _restart_quietly()
    _keep_programs()
    main()


def main(arguments: list[str] | None = None) -> None:
    """Run the study that the arguments describe, print its table and write its files."""
    options = _parser().parse_args(arguments)
    jax.config.update("jax_enable_x64", options.precision == "float64")
    matplotlib.use("Agg")
    try:
        _study(options)
    except (ValueError, OSError, SolverError) as error:
        raise SystemExit(f"jaxstab: {error}") from error
    except KeyboardInterrupt:
        raise SystemExit("jaxstab: interrupted.") from None


def _study(options: argparse.Namespace) -> None:
    contact = _contact(options)
    folder = _new_folder(options.output)
    print(_summary(options, contact))
    study = _follow_loop if options.study == "loop" else _assess_unloading
    complaint = study(options, contact, folder)
    print(f"\nFigure and data are in {folder.resolve()}")
    if complaint:
        raise SystemExit(f"jaxstab: {complaint}")


def _follow_loop(options: argparse.Namespace, contact: Contact, folder: Path) -> str | None:
    """Follow the contact from the last load to the first and back."""
    turns = LOADS[options.load](jnp.array([options.last, options.first, options.last]))
    path = follow(contact, turns, smallest_jump=options.smallest_jump, progress=True, throw=False)
    print(path)
    figure = plot_path(path).get_figure(root=True)
    assert figure is not None
    figure.savefig(folder / "loop.png", dpi=150)
    save_path(folder / "loop.npz", contact, path)
    is_done = path.result == RESULTS.successful
    return None if is_done else f"the path ended before its end: {RESULTS[path.result]}."


def _assess_unloading(options: argparse.Namespace, contact: Contact, folder: Path) -> str | None:
    """Assess the stability of the equilibria from the first load to the last."""
    with warnings.catch_warnings():
        # Said at the end instead.
        warnings.simplefilter("ignore", SweepInterrupted)
        result = sweep(contact, _loads(options), order=options.order, progress=True)
    print(result)
    _draw(result, folder / "unloading.png")
    save_sweep(folder / "unloading.npz", contact, result)
    done = result.load.value.size
    if done < options.number:
        return f"interrupted, {done} of {options.number} loads are done."
    assert result.stability is not None
    if not np.any(result.stability.result == "successful"):
        return "every load failed, as the last column says."
    return None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="jaxstab",
        description="Press a self-affine rough surface on an adhesive elastic half space and draw "
        "it off again, through every jump on the way; or judge the stability of each of many "
        "states as it is unloaded (Rey & Bleyer, section 4.2.3).",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    kinds = ["loop", "unloading"]
    parser.add_argument("--study", choices=kinds, default=kinds[0], help="what to do")
    surface = parser.add_argument_group("surface (cut-offs in waves per side of the unit cell)")
    surface.add_argument("--size", type=int, default=256, help="points along a side")
    surface.add_argument("--seed", type=_whole(0, 2**32 - 1), default=0, help="which surface")
    surface.add_argument("--hurst", type=float, default=0.8, help="Hurst exponent")
    surface.add_argument("--k-low", type=float, default=2, help="lower cut-off")
    surface.add_argument("--k-rolloff", type=float, default=2, help="roll-off")
    surface.add_argument("--k-high", type=float, default=32, help="upper cut-off")
    surface.add_argument("--rms-height", type=float, default=0.1, help="rms height")
    solid = parser.add_argument_group("solid and adhesion")
    solid.add_argument("--youngs-modulus", type=float, default=1e-3, help="E")
    solid.add_argument("--poisson-ratio", type=float, default=0.0, help="nu")
    choices = [*LAWS, "none"]
    solid.add_argument("--potential", choices=choices, default="exponential", help="law")
    solid.add_argument("--surface-energy", type=float, default=1e-2, help="gamma")
    solid.add_argument("--range", type=float, default=1.0, help="rho")
    loads = parser.add_argument_group("loads")
    loads.add_argument("--load", choices=[*LOADS], default="gap", help="the mean of what")
    loads.add_argument("--first", type=float, default=1e-5, help="first load")
    loads.add_argument("--last", type=float, default=2 + 1e-5, help="last load")
    loop = parser.add_argument_group("loop, from the last load to the first and back")
    help = "part of the problem's energy that a jump loses for it to be located"
    loop.add_argument("--smallest-jump", type=float, default=2e-3, help=help)
    unloading = parser.add_argument_group("unloading, from the first load to the last")
    unloading.add_argument("--number", type=_whole(1), default=21, help="number of loads")
    orders = ["continuation", "independent"]
    help = "where each load starts"
    unloading.add_argument("--order", choices=orders, default=orders[0], help=help)
    run = parser.add_argument_group("run")
    run.add_argument("--precision", choices=["float64", "float32"], default="float64", help="type")
    default = Path("results")
    run.add_argument("--output", type=Path, default=default, help="folder; runs are numbered in it")
    return parser


def _whole(least: int, most: int | None = None) -> Callable[[str], int]:
    """Return a converter of text that lets whole numbers of a range pass."""
    limits = f"of at least {least}" if most is None else f"from {least} to {most}"

    def convert(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = None
        if number is None or number < least or (most is not None and number > most):
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number {limits}.")
        return number

    return convert


def _contact(options: argparse.Namespace) -> Contact:
    grid = Grid(options.size)
    heights = self_affine(
        grid,
        jax.random.key(options.seed),
        hurst=options.hurst,
        k_low=options.k_low,
        k_rolloff=options.k_rolloff,
        k_high=options.k_high,
        rms_height=options.rms_height,
    )
    solid = HalfSpace(grid, options.youngs_modulus, options.poisson_ratio)
    return Contact(solid, heights, _potential(options))


def _potential(options: argparse.Namespace) -> Potential:
    if options.potential == "none":
        return NoAdhesion()
    return LAWS[options.potential](options.surface_energy, options.range)


def _loads(options: argparse.Namespace) -> Load:
    return LOADS[options.load](jnp.linspace(options.first, options.last, options.number))


def _new_folder(parent: Path) -> Path:
    """Make and return the first of parent/1, parent/2, ... that does not exist."""
    number = 1
    while True:
        folder = parent / str(number)
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            number += 1
        else:
            return folder


def _summary(options: argparse.Namespace, contact: Contact) -> str:
    law = options.potential
    if law != "none":
        law += f", gamma = {options.surface_energy:g}, rho = {options.range:g}"
    return (
        f"Self-affine surface {options.seed}, {options.size} x {options.size} points, "
        f"rms height {options.rms_height:g}\n"
        f"Half space, E = {options.youngs_modulus:g}, nu = {options.poisson_ratio:g}; "
        f"adhesion: {law}; {contact.heights.dtype}\n"
    )


def _draw(result: Sweep, path: Path) -> None:
    """Draw the two panels of Rey & Bleyer's fig. 12."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    stability_curve(result, "mean_pressure", axes=left)
    stability_curve(result, "contact_area", axes=right)
    figure.savefig(path, dpi=150)


def _restart_quietly() -> None:
    # JAX before 0.12 takes every program in its cache for another machine's, and says so at
    # length. What may be said is settled as JAX is imported: "1" is its own choice.
    is_loud = jax.__version_info__ < (0, 12) and os.environ.get("TF_CPP_MIN_LOG_LEVEL") == "1"
    if is_loud and os.name == "posix":
        os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
        os.execv(sys.executable, sys.orig_argv)


def _keep_programs() -> None:
    """Let JAX keep all that it compiles in the user's cache folder, if none is set already."""
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        folder = _cache_folder() / "jaxstab"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _cache_folder() -> Path:
    """Return the folder of the user's caches."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


if __name__ == "__main__":
    run()
