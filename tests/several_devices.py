"""A contact on all devices that there are: a script, of which a test starts processes.

It writes what it finds to a file of NumPy's. Arguments: the file, and for one of two processes its
number and the address of the first.
"""

import sys
from importlib import import_module

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec

import jaxstab as js
from jaxstab.contact.hessian import Hessian
from jaxstab.stability.cones import Subspace

N = 32


def contact_on(grid, surface_energy=0.02):
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.1)
    law = js.potentials.Exponential(surface_energy, 0.1)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law)


def load_and_solver():
    return js.MeanGap(0.1), js.solvers.PreconditionedConjugateGradient(1e-13)


def numbers(equilibrium, stability):
    eigenvalues = [pair.eigenvalue for pair in stability.pairs.values()]
    return np.stack([equilibrium.mean_pressure, equilibrium.energy, *eigenvalues])


def state(grid):
    """Return fields, and numbers with their derivatives by the surface energy."""

    def solved(surface_energy):
        contact = contact_on(grid, surface_energy)
        equilibrium = js.equilibrate(contact, *load_and_solver(), initial=np.ones((N, N)))
        solver = js.solvers.ProjectedLOBPCG(3e-12)
        return equilibrium, js.assess_stability(contact, equilibrium, solver, throw=False)

    found, changes = jax.jvp(solved, (0.02,), (1.0,))
    equilibrium, stability = found
    names = "displacement", "gap", "pressure", "reaction"
    return {
        "fields": np.stack([getattr(equilibrium, name) for name in names]),
        "numbers": numbers(*found),
        "derivatives": numbers(*changes),
        "verdict": stability.verdict.name,
        "shown": repr(equilibrium),
        "whole": whole(found),
    }


def swept(grid):
    sweep = js.sweep(contact_on(grid), js.MeanGap(np.array([0.1, 0.15])), stability=False)
    return {"swept": sweep.equilibrium.gap, "whole_in_sweep": whole((sweep, sweep[1]))}


def whole(tree):
    """Return which fields are not divided among the devices."""
    return [
        jax.tree_util.keystr(path)
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
        if 512 not in leaf.shape
        and leaf.size >= N * N // 2
        and leaf.addressable_shards[0].data.size * jax.device_count() != leaf.size
    ]


def window(grid):
    solid = js.FreeHalfSpace(grid, 1.0)
    displacement = solid.displacement(grid.device_put(np.eye(N)))
    return {"window": displacement, "whole_on_window": whole((displacement, solid.padded))}


def yielding(grid):
    """Return fields and numbers of a surface that yields, and of the path that has flattened it."""
    elastic = contact_on(grid)
    contact = js.Contact(elastic.solid, elastic.heights, elastic.potential, hardness=0.5)
    solver = load_and_solver()[1]
    equilibrium = js.equilibrate(contact, js.MeanPressure(0.15), solver)
    stability = js.assess_stability(contact, equilibrium)
    path = js.follow(contact, js.MeanPressure(np.array([0.15, 0.1])), initial=equilibrium)
    names = "displacement", "gap", "pressure", "indentation"
    return {
        "yielding_fields": np.stack([getattr(equilibrium, name) for name in names]),
        "yielding_numbers": numbers(equilibrium, stability),
        "yielding_verdict": stability.verdict.name,
        "yielded_area": equilibrium.yielded_area,
        "heights_left": path.contact.heights,
        "whole_where_yielding": whole((contact, equilibrium, stability, path.contact)),
    }


def gap_of_placed(grid, sharding):
    """Return the gap of heights that are on a mesh with explicit axes, as given by its user."""
    contact = contact_on(grid)
    placed = jax.device_put(np.asarray(contact.heights), sharding)
    contact = js.Contact(contact.solid, placed, contact.potential)
    return js.equilibrate(contact, *load_and_solver(), initial=np.ones((N, N))).gap


def programs(grid):
    """Return the texts of the programs of an equilibrium and of an eigenvalue."""
    contact = contact_on(grid)
    heights = contact.heights
    find = import_module("jaxstab.equilibrium.equilibrate").find
    on_space = import_module("jaxstab.stability.lowest_pair").on_space
    search = jax.jit(on_space)
    hessian, space = Hessian(contact.solid, heights), Subspace(heights > 0)
    lowered = [
        jax.jit(find).lower(contact, *load_and_solver(), heights),
        search.lower(js.solvers.Davidson(1e-7), hessian, space, jnp.stack(4 * [heights])),
    ]
    return {"programs": [program.compile().as_text() for program in lowered]}


def refusal(build):
    try:
        build()
    except ValueError as error:
        return str(error)
    return ""


def between_processes(grid):
    """Return an array that every process holds."""
    contact = contact_on(grid)
    equilibrium = js.equilibrate(contact, *load_and_solver())
    missing = np.ones((N, N))
    missing[-1, 2] = np.nan
    return {
        "numbers": [equilibrium.mean_pressure, equilibrium.energy],
        "shown": repr(equilibrium),
        "refused": refusal(lambda: js.Contact(contact.solid, missing, contact.potential)),
    }


def main(path, *process):
    jax.config.update("jax_enable_x64", True)
    if process:
        jax.distributed.initialize(process[1], 2, int(process[0]))
    count = jax.device_count()
    mesh = jax.make_mesh((count,), ("x",))
    sharding = NamedSharding(mesh, PartitionSpec("x"))
    grid = js.Grid(N, sharding=sharding if count > 1 else None)
    if process:
        found = between_processes(grid)
    else:
        found = state(grid) | swept(grid) | window(grid) | yielding(grid) | programs(grid)
        found["explicit"] = gap_of_placed(grid, sharding)
        found["refused"] = refusal(lambda: js.Grid(count + 1, sharding=sharding))
    np.savez(path, **found)


if __name__ == "__main__":
    main(*sys.argv[1:])
