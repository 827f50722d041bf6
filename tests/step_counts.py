"""What a step of a solver asks of a device, counted in its program: no clock is needed.

The step is the body of the outermost loop that has a Fourier transform in it, and no known number
of turns.
"""

import re
from collections import Counter
from contextlib import contextmanager
from functools import partial
from math import prod
from unittest import mock

import jax

import jaxstab as js
from jaxstab.core import control_flow
from jaxstab.equilibrium.equilibrate import find
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.solvers.davidson import Davidson

# In HLO: operations that start no kernel.
_FREE = {"parameter", "constant", "get-tuple-element", "tuple", "bitcast"}
_NESTED = {"while", "conditional", "call"}


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
    contact, _ = js.Contact(js.HalfSpace(grid, 1.0), heights, law).in_own_units()
    load = js.MeanGap(0.05)
    state = js.equilibrate(contact, load)
    hessian = contact.hessian(state.gap, contact.control(load))
    cone = AdmissibleCone(state.in_contact)
    starts = jax.random.uniform(jax.random.key(0), (12, n, n), minval=-1)
    of_states = js.PreconditionedConjugateGradient(), js.PolonskyKeerRey(), js.SaddleNewton()
    runs = {
        type(solver).__name__: (lambda solver=solver: find(contact, load, solver, None), 0)
        for solver in of_states
    }
    runs["Davidson"] = lambda: Davidson().solve(hessian, cone.hull, starts[:4]), 0
    for solver, depth in ((js.ProjectedLOBPCG(), 1), (js.ProximalIteration(), 0)):
        run = partial(solver.solve, hessian, cone, starts)
        runs[type(solver).__name__] = (run, depth)
    return runs


def step_counts(function, *args, platform="cpu", depth=0):
    """Count the operations of a step in the program that is handed to the compiler.

    Arguments:
        function: runs the solver.
        args: its arguments.
        platform: the platform it is lowered for, which need not be there.
        depth: how many loops stand around the loop of the solver.

    Returns:
        How often each operation of StableHLO stands in the step, inner loops and branches
        included. "waits" are those of them whose predicate the host reads, unless it knows the
        number of turns; "sums" leave fewer numbers than they read; "pairs" are pairs of
        transforms. "carry" are the bytes that the loop hands on.
    """
    module = jax.jit(function).trace(*args).lower(lowering_platforms=(platform,)).compiler_ir()
    functions = {str(f.attributes["sym_name"]).strip('"'): f for f in module.body.operations}
    loop = functions["main"]
    for _ in range(depth + 1):
        loop = next(op for op in _within(functions, loop) if _is_solver(functions, op))
    counts = Counter(carry=sum(_bytes(result.type) for result in loop.results))
    for op in _within(functions, loop):
        counts[_name(op)] += 1
        counts["waits"] += _waits(op)
        counts["sums"] += _is_sum(op)
        counts["pairs"] += _name(op) == "fft" and "type RFFT" in str(op.attributes["fft_type"])
    return counts


def num_kernels(function, *args, depth=0):
    """Return how many kernels a step starts beside its transforms, as compiled for this device."""
    text = jax.jit(function).lower(*args).compile().as_text()
    parts = dict(re.findall(r"^(?:ENTRY )?%?([\w.-]+) \(.*?\{\n(.*?)^\}", text, re.M | re.S))

    def codes(part):
        """Yield the operations of a computation and of those it calls, with their operands."""
        for line in parts[part].splitlines():
            code = re.search(r" = .*? ([a-z][\w-]*)\(", line)[1]
            if code not in _FREE:
                yield code, line
            if code in _NESTED:
                called = re.findall(
                    r"(?:body|to_apply|\w+_computations?)=\{?(%[^,}]+(?:, %[^,}]+)*)", line
                )
                for name in ", ".join(called).split(", "):
                    yield from codes(name.lstrip("%"))

    step = re.search(r"^ENTRY %?([\w.-]+)", text, re.M)[1]
    for _ in range(depth + 1):
        bodies = [
            re.search(r"body=%?([\w.-]+)", line)[1]
            for code, line in codes(step)
            if code == "while" and "known_trip_count" not in line
        ]
        step = next(body for body in bodies if any(code == "fft" for code, _ in codes(body)))
    return sum(code not in {*_NESTED, "fft"} for code, _ in codes(step))


def _name(op):
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
    has_turns = _name(op) == "while" and _waits(op)
    return has_turns and any(_name(inner) == "fft" for inner in _within(functions, op))


def _waits(op):
    if _name(op) != "while":
        return _name(op) in ("case", "if") and not _is_constant(op.operands[0])
    # A loop whose turns are counted ends by a comparison with a constant.
    (last,) = list(op.regions[0].blocks[0].operations)[-1].operands
    is_comparison = getattr(last.owner, "name", "") == "stablehlo.compare"
    return not (is_comparison and any(map(_is_constant, last.owner.operands)))


def _is_constant(value):
    """Whether the compiler knows a value: also that by which JAX's own functions look for CUDA."""
    owner = value.owner
    name = getattr(owner, "name", "")
    is_branch = name == "stablehlo.case" and _is_constant(owner.operands[0])
    return name == "stablehlo.constant" or is_branch


def _is_sum(op):
    if _name(op) not in ("reduce", "dot_general"):
        return False
    read, left = ([_size(value.type) for value in side] for side in (op.operands, op.results))
    return max(left) < max(read)


def _size(kind):
    return prod(map(int, re.findall(r"(\d+)x", str(kind))))


def _bytes(kind):
    bits = int(re.search(r"(\d+)>", str(kind))[1])
    return _size(kind) * max(bits // 8, 1)
