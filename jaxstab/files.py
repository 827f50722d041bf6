"""Results on disk."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.contact import Contact
from jaxstab.paths import Path as Followed
from jaxstab.stability import Stability
from jaxstab.sweeps import Sweep


def save_sweep(path: str | Path, contact: Contact, sweep: Sweep) -> Path:
    """Write a sweep as NumPy's `.npz`: one array for each quantity, loads along the first axis.

    Arguments:
        path: the file; it must not exist yet.
        contact: the contact problem, whose grid and heights are written too.
        sweep: its results, with stability or without.

    Returns:
        The path of the file.

    Raises:
        ValueError: if the name does not end in .npz.
        FileExistsError: if the file exists.
    """
    equilibrium = sweep.equilibrium
    arrays: dict[str, Any] = {
        "load_kind": type(sweep.load).__name__,
        "lengths": contact.grid.lengths,
        "heights": contact.heights,
        "load": sweep.load.value,
        "gap": equilibrium.gap,
        "pressure": equilibrium.pressure,
        "reaction": equilibrium.reaction,
        "mean_pressure": equilibrium.mean_pressure,
        "contact_area": equilibrium.contact_area,
        "energy": equilibrium.energy,
        "equilibrium_residual": equilibrium.residual,
        "equilibrium_steps": equilibrium.num_steps,
        "equilibrium_result": equilibrium.result.name,
    }
    if sweep.stability is not None:
        arrays |= _of_stability(sweep.stability)
    return _write(path, arrays)


def save_path(path: str | Path, contact: Contact, followed: Followed) -> Path:
    """Write a path as NumPy's `.npz`: an array for each number of its states, and of its jumps.

    Arguments:
        path: the file; it must not exist yet.
        contact: the contact problem, whose grid and heights are written too.
        followed: its path.

    Returns:
        The path of the file.

    Raises:
        ValueError: if the name does not end in .npz.
        FileExistsError: if the file exists.
    """
    jumps, states = followed.jumps, followed.equilibrium
    numbers = {field.name: getattr(states, field.name) for field in fields(states)}
    arrays: dict[str, Any] = {
        "load_kind": type(followed.load).__name__,
        "lengths": contact.grid.lengths,
        "heights": contact.heights,
        "load": followed.load.value,
        **{name: numbers[name] for name in numbers if numbers[name] is not None},
        "jump_load": jumps.load.value,
        "jump_kind": jumps.kind.name,
        "jump_state": jumps.state,
        "jump_dissipation": jumps.dissipation,
        "jump_mode": jumps.mode,
        "jump_gap_before": jumps.before.gap,
        "jump_gap_after": jumps.after.gap,
        "result": followed.result.name,
    }
    return _write(path, arrays)


def _write(path: str | Path, arrays: dict[str, Any]) -> Path:
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"{path} does not end in .npz.")
    with path.open("xb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
    return path


def _of_stability(stability: Stability) -> dict[str, Any]:
    arrays: dict[str, Any] = {
        "complementarity": stability.complementarity,
        "barrier_height": stability.barrier.height,
        "barrier_amplitude": stability.barrier.amplitude,
        "verdict": stability.verdict.name,
    }
    for name, pair in stability.pairs.items():
        arrays |= {
            f"{name}_eigenvalue": pair.eigenvalue,
            f"{name}_error": pair.error,
            f"{name}_mode": pair.mode,
            f"{name}_residual": pair.residual,
            f"{name}_steps": pair.num_steps,
            f"{name}_result": pair.result.name,
        }
    return arrays
