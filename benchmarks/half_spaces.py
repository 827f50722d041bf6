"""Crystals, stacks and graded solids against what they must agree with, and their times.

Isotropic constants and equal layers; random anisotropic stacks against finite elements in depth;
spheres on crystals against the ellipse of Willis; the kernel of ContactMechanics for cubic
crystals, if that package is there; ranges of thickness; the pull-off of a sphere from a graded
solid; derivatives against differences; times beside those of an isotropic half space. The numbers
are the largest relative errors. Names of rows choose some of them.
"""

import argparse
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js
from jaxstab.references import materials
from jaxstab.solids import Anisotropic, Axisymmetric, Crystal, Film, Graded, Layered

sys.path.append(str(Path(__file__).parent.parent / "tests" / "solids"))
from depth_columns import (
    barnett_lothe_stiffness,
    column_stiffness,
    isotropic,
    random_axes,
    random_stiffness,
    tensor_of,
)

jax.config.update("jax_enable_x64", True)
HEAD = "| solid | against | goal | found |\n|---|---|---|---|"
GRID = js.Grid(8)
STIFFNESS = jax.jit(lambda solid, waves: solid.stiffness_at(waves))
PLANES = {
    "(100)": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "(110)": ((0, 0, 1), (1, -1, 0), (1, 1, 0)),
    "(111)": ((1, -1, 0), (1, 1, -2), (1, 1, 1)),
}


def error(found, exact):
    """Return the largest error relative to the exact numbers."""
    return float(np.max(abs(np.asarray(found) / np.asarray(exact) - 1)))


def alike():
    q = jnp.geomspace(1e-6, 1e6, 200)
    vectors = jnp.stack([0.6 * q, 0.8 * q])
    axes = random_axes(np.random.default_rng(0))
    crystal = Anisotropic(GRID, isotropic(2.0, 0.3), axes)
    half_space = STIFFNESS(js.HalfSpace(GRID, 2.0, 0.3), q)
    yield (
        "isotropic constants in `Anisotropic`",
        "`HalfSpace`",
        "1e-12",
        (f"{error(STIFFNESS(crystal, vectors), half_space):.0e}"),
    )
    found = []
    for nu in (0.0, 0.3, 0.5):
        films = [Film((2.0, nu), h) for h in (0.2, 0.5, 0.3)]
        for base, exact in (
            ((2.0, nu), js.HalfSpace(GRID, 2.0, nu)),
            ("rigid", js.Layer(GRID, 2.0, nu, 1.0)),
            ((0.1, 0.2), js.CoatedHalfSpace(GRID, (2.0, nu), 1.0, (0.1, 0.2))),
        ):
            found.append(error(STIFFNESS(Layered(GRID, films, base), q), STIFFNESS(exact, q)))
    yield (
        "equal layers in `Layered`",
        "`HalfSpace`, `Layer`, `CoatedHalfSpace`",
        "1e-12",
        (f"{max(found):.0e}"),
    )


def stacks(number=50):
    found = []
    for seed in range(number):
        random = np.random.default_rng(seed)
        pairs = [(random_stiffness(random), random_axes(random)) for _ in range(3)]
        thicknesses = 10 ** random.uniform(-1.5, 0.5, 2)
        slips = random.random(2) < 0.4
        films = [
            Film(Crystal(*pair), h, slips=bool(slip))
            for pair, h, slip in zip(pairs[1:], thicknesses, slips, strict=True)
        ]
        elements = [
            (tensor_of(*pair), h, slip)
            for pair, h, slip in zip(pairs[1:], thicknesses, slips, strict=True)
        ]
        base, below = "rigid", None
        if seed % 2:
            base, below = Crystal(*pairs[0]), tensor_of(*pairs[0])
        vectors = random.normal(size=(2, 3))
        exact = [column_stiffness(elements, below, vector) for vector in vectors.T]
        found.append(error(STIFFNESS(Layered(GRID, films, base), jnp.asarray(vectors)), exact))
    yield (
        f"{number} random stacks of two crystals",
        "finite elements in depth",
        "1e-6",
        (f"{max(found):.0e}"),
    )
    found = []
    for seed in range(number):
        random = np.random.default_rng(seed)
        pair = random_stiffness(random), random_axes(random)
        vectors = random.normal(size=(2, 3))
        exact = [barnett_lothe_stiffness(tensor_of(*pair), vector) for vector in vectors.T]
        found.append(error(STIFFNESS(Anisotropic(GRID, *pair), jnp.asarray(vectors)), exact))
    yield (
        f"{number} random crystals",
        "the integral of Barnett and Lothe",
        "1e-10",
        (f"{max(found):.0e}"),
    )


def spheres(points=256):
    grid = js.Grid(points)
    heights = js.surfaces.paraboloid(grid, 2.0)
    x, y = (np.asarray(x) - 0.5 for x in grid.coordinates)
    for name in ("copper", "silicon"):
        for plane, axes in PLANES.items():
            solid = Anisotropic(grid, getattr(materials, name), axes)
            contact = js.Contact(solid, heights, js.potentials.NoAdhesion())
            state = js.equilibrate(contact, js.MeanPressure(0.0004 * solid.contact_modulus))
            weights = np.asarray(state.reaction) / np.sum(state.reaction)
            xx, yy, xy = (np.sum(weights * a * b) for a, b in ((x, x), (y, y), (x, y)))
            narrow, wide = np.linalg.eigvalsh([[xx, xy], [xy, yy]])
            # Of p0 sqrt(1 - rho^2) the moments are a fifth of the squared semi-axes.
            radius = np.sqrt(5) * (wide * narrow) ** 0.25
            modulus = 3 / 4 * float(state.force) * 2.0 / radius**3
            found = solid.indentation
            circle = 2 / np.mean(1 / barnett_lothe_circle(materials_tensor(name, axes)))
            yield (
                f"{name} {plane}: M = {float(found.modulus):.1f} GPa, ellipse "
                f"{float(found.aspect_ratio):.3f}",
                f"a sphere on {points}², and the circle of Vlassak and Nix",
                "1 %",
                f"sphere {100 * (modulus / found.modulus - 1):+.2f} %, ellipse "
                f"{100 * ((wide / narrow) ** 0.5 / found.aspect_ratio - 1):+.2f} %, circle "
                f"{100 * (circle / found.modulus - 1):+.2f} %",
            )


def materials_tensor(name, axes):
    return tensor_of(getattr(materials, name), axes)


def barnett_lothe_circle(tensor, points=60):
    """Return K / |q| at directions over half a turn."""
    angles = np.pi * np.arange(points) / points
    return np.array([barnett_lothe_stiffness(tensor, (np.cos(t), np.sin(t))) for t in angles])


def peer():
    try:
        from ContactMechanics.GreensFunctions import AnisotropicGreensFunction
    except ImportError:
        yield "copper", "ContactMechanics' cubic kernel", "1e-10", "not installed"
        return
    constants = 168.4, 121.4, 75.4
    vectors = np.random.default_rng(0).normal(size=(2, 30))
    exact = 1 / AnisotropicGreensFunction(*constants).greens_function(*vectors)[:, 2, 2].real
    found = STIFFNESS(Anisotropic(GRID, constants), jnp.asarray(vectors))
    yield "copper (100)", "ContactMechanics' cubic kernel", "1e-10", f"{error(found, exact):.0e}"
    exact = AnisotropicGreensFunction(*constants, thickness=0.4).greens_function(*vectors)
    film = Film(Crystal(constants), 0.4)
    found = STIFFNESS(Layered(GRID, [film], "rigid"), jnp.asarray(vectors))
    yield (
        "copper (100) on a rigid base",
        "ContactMechanics' cubic kernel",
        "1e-10",
        (f"{error(found, 1 / exact[:, 2, 2].real):.0e}"),
    )


def ranges():
    for dtype in (np.float32, np.float64):
        q = jnp.asarray(np.geomspace(1e-6, 1e6, 100), dtype)
        vectors = jnp.stack([0.6 * q, 0.8 * q])
        one, cubic = np.asarray(1, dtype), np.asarray([3.0, 1.2, 1.5], dtype)
        thick, number = [], 0
        for slips in (False, True):
            for material in ((one, 0.3 * one), (one, one / 2), Crystal(cubic)):
                for base in ("rigid", (3 * one, 0.2 * one), Crystal(2 * cubic)):
                    solid = Layered(GRID, [Film(material, one, slips=slips)], base)
                    waves = q if solid.is_isotropic else vectors
                    found = np.asarray(STIFFNESS(solid, waves))
                    assert found.dtype == dtype and (found > 0).all() and np.isfinite(found).all()
                    top = Layered(GRID, [Film(material, one)], material)
                    exact = STIFFNESS(top, q if top.is_isotropic else vectors)
                    thick.append(error(found[-20:], exact[-20:]))
                    number += 1
        yield (
            f"{number} stacks, bonded and slipping, q h from 1e-6 to 1e6, {np.dtype(dtype)}",
            "the upper material alone where thick",
            "no NaN",
            f"no NaN; {max(thick):.0e}",
        )


def graded():
    for exponent, work in ((-0.2, 0.1), (0.0, 0.1), (0.3, 0.1), (0.6, 0.05)):
        found = [
            100 * (graded_pull_off(exponent, work, number) / (exponent + 3) * 2 / np.pi / work - 1)
            for number in (100, 200, 400)
        ]
        yield (
            f"sphere on `Graded`, k = {exponent}",
            "pull-off (k + 3) pi w R / 2",
            "1 %",
            ", ".join(f"{one:+.3f} %" for one in found) + " (100, 200, 400 rings)",
        )


def graded_pull_off(exponent, work, number):
    """Return the largest tension of a sphere of radius 1 in the limit of short range.

    With n rings in contact and a displacement d the energy is (k d^2 - 2 l d + m) / 2; at the edge
    it grows with n by the work of adhesion of a ring.
    """
    rings = js.Rings(number, 1.0)
    solid = Axisymmetric(rings, Graded(GRID, 1.0, 0.3, 1.0, exponent))
    compliance = np.linalg.inv(np.asarray(solid.stiffness_of_order(0)))
    area = np.pi / number
    profile = np.asarray(rings.squared_distances) / 2

    def coefficients(held):
        stiffness = area * np.linalg.inv(compliance[:held, :held])
        one, shape = np.ones(held), profile[:held]
        return np.array([one @ stiffness @ one, one @ stiffness @ shape, shape @ stiffness @ shape])

    forces = []
    for held in range(number // 5, 9 * number // 10, number // 50):
        both = coefficients(held), coefficients(held + 1)
        (stiffer, offset, energy), (k, offset_of_force, _) = both[1] - both[0], sum(both) / 2
        root = np.sqrt(offset**2 - stiffer * (energy - 2 * work * area))
        forces.append(k * (offset - root) / stiffer - offset_of_force)
    return -min(forces)


def derivatives():
    q = jnp.array([0.3, 2.0, 9.0])
    vectors = jnp.stack([0.6 * q, 0.8 * q])
    base = Crystal(materials.silicon / 50)

    def stiffness(p):
        films = [Film((p[2], p[3]), p[0], slips=True), Film(Crystal(p[4:7]), p[1])]
        stack = Layered(GRID, films, base).stiffness_at(vectors)
        crystal = Anisotropic(GRID, p[4:7], PLANES["(110)"])
        graded = Graded(GRID, p[2], p[3], p[0], p[1]).stiffness_at(q)
        whole = stack, crystal.stiffness_at(vectors), graded, crystal.contact_modulus[None]
        return jnp.concatenate(whole)

    point = jnp.array([0.3, 0.2, 2.0, 0.35, 3.0, 1.2, 1.5])
    call = jax.jit(stiffness)
    slopes = np.asarray(jax.jit(jax.jacfwd(stiffness))(point))
    step = 1e-4
    # Of fourth order in the step.
    differences = np.stack(
        [
            (8 * (call(point + e) - call(point - e)) - call(point + 2 * e) + call(point - 2 * e))
            / (12 * step)
            for e in step * np.eye(point.size)
        ],
        axis=1,
    )
    scale = np.abs(slopes).max(axis=1, keepdims=True)
    found = np.max(abs(slopes - differences) / scale)
    yield "a stack, a crystal, `Graded`: by all parameters", "differences", "1e-6", f"{found:.0e}"


def times(points=256, repeats=5):
    grid = js.Grid(points)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=points // 8, rms_height=0.01)
    law = js.potentials.Exponential(2e-5, 2e-3)
    films = [Film((2.0, 0.3), 0.01), Film((0.5, 0.45), 0.02, slips=True)]
    on_crystal = Layered(grid, [Film((2.0, 0.3), 0.01)], Crystal(materials.silicon / 165))
    solids = {
        "`HalfSpace`": js.HalfSpace(grid, 1.0),
        "`Anisotropic`": Anisotropic(grid, materials.silicon / 165),
        "`Graded`": Graded(grid, 1.0, 0.3, 0.1, 0.3),
        "`Layered` of isotropic layers": Layered(grid, films, (1.0, 0.3)),
        "`Layered` on a crystal": on_crystal,
        "`Layered` on a crystal, its `prepared`": on_crystal.prepared,
    }
    before = None
    for name, solid in solids.items():
        contact = js.Contact(solid, heights, law)
        # A step costs the same on every solid, but their numbers differ: K alone is the difference.
        durations = []
        for _ in range(repeats + 1):
            start = time.process_time()
            jax.block_until_ready(contact.solid.prepared)
            durations.append(time.process_time() - start)
        own = min(durations[1:])
        if before is None:
            state = js.equilibrate(contact, js.MeanGap(0.01))
            js.assess_stability(contact, state)
            start = time.process_time()
            js.equilibrate(contact, js.MeanGap(0.01))
            middle = time.process_time()
            js.assess_stability(contact, state)
            before = own, middle - start, time.process_time() - middle
        first, solved, judged = before
        yield (
            f"{name}, {points}²",
            "`HalfSpace`: seconds of a processor, equilibrium and verdict",
            "1.05",
            f"{1 + (own - first) / solved:.3f}, {1 + (own - first) / judged:.3f}, K in {own:.3f} s",
        )


ROWS = {
    row.__name__: row for row in (alike, stacks, spheres, peer, ranges, graded, derivatives, times)
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", help=f"some of {', '.join(ROWS)}; by default all")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    arguments = parser.parse_args()
    lines = [HEAD]
    print(HEAD)
    for chosen in arguments.rows or ROWS:
        for cells in ROWS[chosen]():
            lines.append(f"| {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    if arguments.out:
        arguments.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
