"""Crystals, stacks and graded solids against what they must agree with, and their times.

Isotropic constants and equal layers; random anisotropic stacks against finite elements in depth;
indentation moduli against a closed form, published curves and spheres on a grid; the kernel of
ContactMechanics for cubic crystals; layers from thin to thick; the pull-off of a sphere from a
graded solid; derivatives against differences; times beside those of an isotropic half space. The
numbers are the largest relative errors. Names of rows choose some of them.
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


def fibre(along, across, shear, nu_across, nu_along):
    """Return the constants of a fibre along z, isotropic across it."""
    compliance = np.zeros((6, 6))
    compliance[range(6), range(6)] = [1 / across] * 2 + [1 / along] + [1 / shear] * 2 + [0]
    compliance[5, 5] = 2 * (1 + nu_across) / across
    compliance[[0, 1], [1, 0]] = -nu_across / across
    compliance[[0, 2, 1, 2], [2, 0, 2, 1]] = -nu_along / along
    return np.linalg.inv(compliance)


def moduli(number=50):
    random = np.random.default_rng(0)
    found = []
    for _ in range(number):
        along, across, shear = 10 ** random.uniform(-1, 1, 3)
        constants = fibre(along, across, shear, *random.uniform((0, 0), (0.4, 0.3)))
        if np.linalg.eigvalsh(constants)[0] <= 0:
            continue
        c11, c13, c33, c44 = constants[[0, 0, 2, 3], [0, 2, 2, 3]]
        mean = np.sqrt(c11 * c33)
        exact = 2 * np.sqrt((mean**2 - c13**2) / c11 / (1 / c44 + 2 / (mean + c13)))
        found.append(error(Anisotropic(GRID, constants).indentation.modulus, exact))
    yield (
        f"{len(found)} random fibres along the normal: M",
        "the closed form of Delafargue and Ulm (2004)",
        "1e-10",
        f"{max(found):.0e}",
    )
    # Jäger et al., Composites A 42, 677 (2011), fig. 4, whose four curves cross at these constants.
    wall = fibre(55.0, 10.0, 3.0, 0.25, 0.25)
    published = {"along": (None, 23.50), "across": (((0, 0, 1), (0, 1, 0), (-1, 0, 0)), 10.09)}
    for name, (axes, value) in published.items():
        modulus = float(Anisotropic(GRID, wall, axes).indentation.modulus)
        yield (
            f"wall of a wood cell, {name} its fibres: M = {modulus:.2f} GPa",
            f"{value:.2f} GPa of Jäger et al. (2011) by the method of Vlassak and Nix",
            "1 %",
            f"{100 * (modulus / value - 1):+.2f} %",
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
                f"a sphere on {points}², and the circle of Vlassak and Nix, integrated",
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
        one, cubic = np.asarray(1, dtype), np.asarray([3.0, 1.2, 1.5], dtype)
        thick, thin, number = [], [], 0
        for slips in (False, True):
            for material in ((one, 0.3 * one), (one, one / 2), Crystal(cubic)):
                for base in ("rigid", (3 * one, 0.2 * one), Crystal(2 * cubic)):
                    solid = Layered(GRID, [Film(material, one, slips=slips)], base)
                    found = stiffnesses(solid, q)
                    assert found.dtype == dtype and (found > 0).all() and np.isfinite(found).all()
                    top = Layered(GRID, [Film(material, one)], material)
                    thick.append(error(found[-20:], stiffnesses(top, q)[-20:]))
                    if base == "rigid":
                        below = foundation(material, slips, q)
                    else:
                        below = stiffnesses(Layered(GRID, [Film(base, one)], base), q)
                    thin.append(error(found[:2], below[:2]))
                    number += 1
        yield (
            f"{number} stacks, bonded and slipping, q h from 1e-6 to 1e6, {np.dtype(dtype)}",
            "the upper material alone where thick; the base alone, or a foundation, where thin",
            "no NaN",
            f"no NaN; {max(thick):.0e}; {max(thin):.0e}",
        )


def stiffnesses(solid, q):
    """Return K of waves along x."""
    return STIFFNESS(solid, q if solid.is_isotropic else jnp.stack([q, 0 * q]))


def foundation(material, slips, q):
    """Return K of a thin layer, of thickness one, on a rigid base."""
    if isinstance(material, Crystal):
        c11, c12 = np.asarray(material.stiffness)[0, :2]
    else:
        modulus, nu = (float(x) for x in material)
        shear = modulus / (2 * (1 + nu))
        if nu == 0.5:
            # It gives way in plane strain, or is squeezed out as a viscous film.
            return 4 * shear + 0 * q if slips else 3 * shear / q**2
        c11 = 2 * shear * (1 - nu) / (1 - 2 * nu)
        c12 = c11 - 2 * shear
    return c11 - slips * c12**2 / c11 + 0 * q


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

    def tension(held):
        both = coefficients(held), coefficients(held + 1)
        (stiffer, offset, energy), (k, offset_of_force, _) = both[1] - both[0], sum(both) / 2
        root = np.sqrt(offset**2 - stiffer * (energy - 2 * work * area))
        return offset_of_force - k * (offset - root) / stiffer

    step = number // 50
    near = max(range(number // 5, 9 * number // 10, step), key=tension)
    return max(map(tension, range(near - step, near + step)))


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


def times(points=256, rounds=5):
    """Compare solids of one K, on which all searches take the same steps."""
    grid = js.Grid(points)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=points // 8, rms_height=0.01)
    law = js.potentials.Exponential(2e-5, 2e-3)
    one = 1.0, 0.3
    crystal = Crystal(isotropic(*one))
    on_crystal = Layered(grid, [Film(one, 0.01)], crystal)
    solids = {
        "`HalfSpace`": js.HalfSpace(grid, *one),
        "`Anisotropic`": Anisotropic(grid, crystal.stiffness),
        "`Graded`": Graded(grid, *one, 0.1, 0.0),
        "`Layered`, isotropic": Layered(grid, [Film(one, 0.01), Film(one, 0.02)], one),
        "`Layered` on a crystal": on_crystal,
        "`Layered` on a crystal, its `prepared`": on_crystal.prepared,
    }
    seconds = {name: [] for name in solids}
    for i in range(rounds + 1):
        for name, solid in solids.items():
            contact = js.Contact(solid, heights, law)
            start = time.process_time()
            jax.block_until_ready(contact.solid.prepared)
            known = time.process_time()
            state = jax.block_until_ready(js.equilibrate(contact, js.MeanGap(0.01)))
            solved = time.process_time()
            jax.block_until_ready(js.assess_stability(contact, state))
            # The first round compiles.
            if i:
                seconds[name].append((known - start, solved - known, time.process_time() - solved))
    least = np.array(seconds["`HalfSpace`"])
    for name, spent in seconds.items():
        ratios = np.median(np.array(spent) / least, axis=0)
        first, solved, judged = np.median(spent, axis=0)
        yield (
            f"{name}, {points}²",
            "`HalfSpace`: processor seconds of an equilibrium, of a verdict",
            "1.05",
            f"{ratios[1]:.2f} of {solved:.2f} s, {ratios[2]:.2f} of {judged:.2f} s; "
            f"K alone {first:.3f} s",
        )


ROWS = {
    row.__name__: row
    for row in (alike, stacks, moduli, spheres, peer, ranges, graded, derivatives, times)
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
