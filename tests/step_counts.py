"""What a step of a solver asks of a device, counted in its program: no clock is needed.

The step is the body of the outermost loop that has a Fourier transform in it, and no known number
of turns.
"""

from contextlib import contextmanager
from functools import partial
from unittest import mock

import jax

import jaxstab as js
from jaxstab.core import control_flow
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.posing import pose
from jaxstab.equilibrium.start import start_of
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.solvers.davidson import Davidson


@contextmanager
def as_on_an_accelerator():
    """Trace the branches of an accelerator, and no others, so that they run on a CPU too."""
    jax.clear_caches()
    try:
        with (
            mock.patch.object(control_flow, "has_accelerator", lambda: True),
            mock.patch.object(
                jax.lax, "platform_dependent", lambda *args, default, **_: default(*args)
            ),
        ):
            yield
    finally:
        # Or the next test gets this one's programs.
        jax.clear_caches()


def solver_runs(n):
    """Return by name a function that runs each solver, and the number of loops around its own."""
    grid = js.Grid(n)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=n // 4, rms_height=0.05)
    law = js.potentials.Exponential(2e-3, 0.05)
    problem = pose(js.Contact(js.HalfSpace(grid, 1.0), heights, law), js.MeanGap(0.05))
    contact = problem.contact
    load = problem.load
    start = start_of(contact, load, None)
    state = js.equilibrate(contact, load)
    hessian = contact.hessian(state.gap, contact.control(load))
    cone = AdmissibleCone(state.in_contact)
    starts = jax.random.uniform(jax.random.key(0), (12, n, n), minval=-1)
    of_states = (
        js.solvers.PreconditionedConjugateGradient(),
        js.solvers.PolonskyKeerRey(),
        js.solvers.SaddleNewton(),
    )
    runs = {
        type(solver).__name__: (lambda solver=solver: find(contact, load, solver, start), 0)
        for solver in of_states
    }
    runs["Davidson"] = lambda: Davidson().solve(hessian, cone.hull, starts[:4]), 0
    for solver, depth in ((js.solvers.ProjectedLOBPCG(), 1), (js.ProximalIteration(), 0)):
        run = partial(solver.solve, hessian, cone, starts)
        runs[type(solver).__name__] = (run, depth)
    return runs


def measured_step(measure, function, platform="cpu", depth=0):
    """Measure a step of a solver in the program that is handed to the compiler.

    Arguments:
        measure: a function of the solver's loop, and of the operations of StableHLO in it, inner
            loops and branches included; none of them may be kept, as the program is not.
        function: runs the solver.
        platform: the platform it is lowered for, which need not be there.
        depth: how many loops stand around the loop of the solver.
    """
    module = jax.jit(function).trace().lower(lowering_platforms=(platform,)).compiler_ir()
    functions = {str(f.attributes["sym_name"]).strip('"'): f for f in module.body.operations}
    loop = functions["main"]
    for _ in range(depth + 1):
        loop = next(op for op in _within(functions, loop) if _is_solver(functions, op))
    return measure(loop, list(_within(functions, loop)))


def waits(op):
    """Whether the host reads an operation's predicate: a loop's, unless it knows the turns."""
    if name_of(op) != "while":
        return name_of(op) in ("case", "if") and not _is_constant(op.operands[0])
    # A loop whose turns are counted ends by a comparison with a constant.
    (last,) = list(op.regions[0].blocks[0].operations)[-1].operands
    is_comparison = getattr(last.owner, "name", "") == "stablehlo.compare"
    return not (is_comparison and any(map(_is_constant, last.owner.operands)))


def name_of(op):
    return op.operation.name.removeprefix("stablehlo.")


def _operations(functions, op):
    """Yield the operations of a function, and in place of calls those of what is called."""
    for region in op.regions:
        for block in region:
            for inner in block.operations:
                if inner.operation.name == "func.call":
                    callee = str(inner.attributes["callee"]).strip('@"')
                    yield from _operations(functions, functions[callee])
                else:
                    yield inner


def _within(functions, op):
    for inner in _operations(functions, op):
        yield inner
        yield from _within(functions, inner)


def _is_solver(functions, op):
    has_turns = name_of(op) == "while" and waits(op)
    return has_turns and any(name_of(inner) == "fft" for inner in _within(functions, op))


def _is_constant(value):
    """Whether the compiler knows a value: also that by which JAX's own functions look for CUDA."""
    owner = value.owner
    name = getattr(owner, "name", "")
    is_branch = name == "stablehlo.case" and _is_constant(owner.operands[0])
    return name == "stablehlo.constant" or is_branch
