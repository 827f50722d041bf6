"""Stacks: against finite elements in depth, their shortest forms, their limits, differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth_columns import column_stiffness, isotropic, random_axes, random_stiffness, tensor_of

import jaxstab as js
from jaxstab.solids import Crystal, Film, Isotropic, Layered

GRID = js.Grid(8)
STIFFNESS = jax.jit(lambda solid, waves: solid.stiffness_at(waves))
SOFT, STIFF = (1.0, 0.4), (5.0, 0.25)
CUBIC = (3.0, 1.2, 1.5)


def random_case(seed):
    """Return a random stack, and the same as finite elements take it."""
    random = np.random.default_rng(seed)

    def material(is_crystal):
        if is_crystal:
            constants, axes = random_stiffness(random), random_axes(random)
            return Crystal(constants, axes), tensor_of(constants, axes)
        modulus, nu = random.uniform(0.3, 3), random.uniform(-0.3, 0.45)
        return Isotropic(modulus, nu), tensor_of(isotropic(modulus, nu))

    number = random.integers(1, 4)
    pairs = [material(i == 0 or random.random() < 0.5) for i in range(number)]
    thicknesses = 10 ** random.uniform(-1.5, 0.5, number)
    slips = random.random(number) < 0.4
    layers = [
        Film(one, h, slips=bool(slip))
        for (one, _), h, slip in zip(pairs, thicknesses, slips, strict=True)
    ]
    elements = [
        (tensor, h, slip) for (_, tensor), h, slip in zip(pairs, thicknesses, slips, strict=True)
    ]
    base, below = ("rigid", None)
    if random.random() < 0.5:
        base, below = material(random.random() < 0.7)
    return Layered(GRID, layers, base), elements, below, random.normal(size=(2, 3))


def check_against_elements(seed):
    solid, elements, base, vectors = random_case(seed)
    assert not solid.is_isotropic
    exact = [column_stiffness(elements, base, vector) for vector in vectors.T]
    np.testing.assert_allclose(STIFFNESS(solid, jnp.asarray(vectors)), exact, rtol=1e-7)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))]
)
def test_a_random_stack_is_as_stiff_as_finite_elements_say(seed):
    check_against_elements(seed)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(3, 50))
def test_many_random_stacks_are_as_stiff_as_finite_elements_say(seed):
    check_against_elements(seed)


@pytest.mark.parametrize(
    ("base", "slips"),
    [
        (None, False),
        ((0.5, 0.1), True),
        pytest.param(None, True, marks=pytest.mark.nightly),
        pytest.param((0.5, 0.1), False, marks=pytest.mark.nightly),
    ],
)
def test_isotropic_layers_are_as_stiff_as_finite_elements_say(base, slips):
    materials = [(2.0, 0.45), (0.3, -0.5), (1.0, 0.2)]
    thicknesses = [0.1, 0.4, 0.3]
    layers = [Film(*pair, slips=slips) for pair in zip(materials, thicknesses, strict=True)]
    solid = Layered(GRID, layers, base or "rigid")
    q = np.array([0.1, 1.0, 8.0])
    elements = [
        (tensor_of(isotropic(*material)), h, slips)
        for material, h in zip(materials, thicknesses, strict=True)
    ]
    below = base and tensor_of(isotropic(*base))
    exact = [column_stiffness(elements, below, (one, 0.0)) for one in q]
    np.testing.assert_allclose(STIFFNESS(solid, jnp.asarray(q)), exact, rtol=1e-9)
    # Crystals of the same constants take the other way.
    crystals = [
        Film(Crystal(isotropic(*material)), h, slips=slips)
        for material, h in zip(materials, thicknesses, strict=True)
    ]
    other = Layered(GRID, crystals, base or "rigid")
    vectors = jnp.asarray(q * np.array([[0.6], [0.8]]))
    np.testing.assert_allclose(STIFFNESS(other, vectors), exact, rtol=1e-9)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.4999, 0.5])
def test_layers_that_are_alike_are_one(nu):
    q = jnp.geomspace(1e-6, 1e6, 49)
    parts = [Film((2.0, nu), h) for h in (0.2, 0.5, 0.3)]
    half_space = STIFFNESS(Layered(GRID, parts, (2.0, nu)), q)
    np.testing.assert_allclose(half_space, 2.0 / (1 - nu**2) * q / 2, rtol=1e-12)
    layer = js.Layer(GRID, 2.0, nu, 1.0)
    found = Layered(GRID, parts, "rigid")
    np.testing.assert_allclose(STIFFNESS(found, q), STIFFNESS(layer, q), rtol=1e-12)
    np.testing.assert_allclose(found.uniform_stiffness, layer.uniform_stiffness, rtol=1e-12)
    coated = js.CoatedHalfSpace(GRID, (2.0, nu), 1.0, STIFF)
    found = Layered(GRID, parts, STIFF)
    np.testing.assert_allclose(STIFFNESS(found, q), STIFFNESS(coated, q), rtol=1e-12)


def stacks(dtype):
    """Return stacks with layers that slip and that do not, isotropic, incompressible, crystals."""
    one = np.asarray(1.0, dtype)
    cubic = np.asarray(CUBIC, dtype)
    for slips in (False, True):
        for layer in (Isotropic(one, 0.3 * one), Isotropic(one, one / 2), Crystal(cubic)):
            for base in ("rigid", Isotropic(3 * one, 0.2 * one), Crystal(2 * cubic)):
                films = [Film(layer, one, slips=slips), Film((2 * one, 0.1 * one), one)]
                yield Layered(GRID, films, base)


@pytest.mark.parametrize(
    ("dtype", "chosen"),
    [
        (np.float32, slice(1, None, 8)),
        pytest.param(np.float32, slice(None), marks=pytest.mark.nightly),
        pytest.param(np.float64, slice(None), marks=pytest.mark.nightly),
    ],
)
def test_stacks_have_a_stiffness_from_thin_to_thick(dtype, chosen):
    q = jnp.asarray(np.geomspace(1e-6, 1e6, 49), dtype)
    vectors = jnp.stack([0.6 * q, 0.8 * q])
    for solid in list(stacks(dtype))[chosen]:
        waves = q if solid.is_isotropic else vectors
        found = STIFFNESS(solid, waves)
        assert found.dtype == dtype
        assert np.isfinite(found).all() and (found > 0).all(), solid
        # Short waves feel the uppermost material alone.
        top = solid.layers[0].material
        alone = Layered(GRID, [Film(top, 1.0)], top)
        short = STIFFNESS(alone, waves if alone.is_isotropic == solid.is_isotropic else q)
        eps = np.finfo(dtype).eps
        np.testing.assert_allclose(found[-10:], short[-10:], rtol=100 * eps)
        if solid.base is not None:
            # Long ones feel the base.
            base = solid.base
            if isinstance(base, Crystal):
                deep = STIFFNESS(js.solids.Anisotropic(GRID, base.stiffness), vectors)
            else:
                deep = js.HalfSpace(GRID, *jax.tree.leaves(base)).stiffness_at(q)
            np.testing.assert_allclose(found[:2], deep[:2], rtol=max(100 * eps, 1e-4))


@pytest.mark.parametrize("material", [SOFT, Crystal(isotropic(*SOFT)), Crystal(CUBIC)])
def test_thin_layers_are_foundations(material):
    solid = Layered(GRID, [Film(material, 1e-4)], "rigid")
    q = jnp.array([1e-2, 1.0])
    waves = q if solid.is_isotropic else jnp.stack([q, 0 * q])
    np.testing.assert_allclose(STIFFNESS(solid, waves), solid.uniform_stiffness, rtol=1e-6)
    # One that slips gives way sideways: its modulus is that of plane strain.
    slipping = STIFFNESS(Layered(GRID, [Film(material, 1e-4, slips=True)], "rigid"), waves)
    c11, c12, _ = CUBIC if isinstance(material, Crystal) else isotropic(*SOFT)
    if isinstance(material, Crystal) and float(material.stiffness[0, 0]) != c11:
        c11, c12, _ = isotropic(*SOFT)
    np.testing.assert_allclose(slipping, (c11 - c12**2 / c11) / 1e-4, rtol=1e-6)


def test_an_incompressible_film_that_slips_is_a_plate_on_what_is_below():
    # E h^3 q^4 / (12 (1 - nu^2)) of a plate, and the base without friction.
    modulus, h, q = 1e6, 0.01, jnp.array([0.5, 1.0])
    solid = Layered(GRID, [Film((modulus, 0.5), h, slips=True)], (1.0, 0.3))
    plate = modulus * h**3 / (12 * 0.75) * q**4
    base = 1.0 / (1 - 0.3**2) * q / 2
    np.testing.assert_allclose(STIFFNESS(solid, q), plate + base, rtol=1e-4)


@pytest.mark.nightly
def test_derivatives_by_each_thickness_and_modulus_agree_with_differences():
    q = jnp.array([0.3, 2.0, 9.0])
    vectors = jnp.stack([0.6 * q, 0.8 * q])

    def stiffness(parameters, base):
        h1, h2, modulus, nu, c44 = parameters
        films = [Film((modulus, nu), h1, slips=True), Film((3.0, 0.3), h2)]
        below = base if base == "rigid" else (c44, 0.2)
        first = Layered(GRID, films, below).stiffness_at(q)
        film = Film(Crystal(jnp.stack([modulus, nu, c44])), h1, slips=True)
        return jnp.concatenate([first, Layered(GRID, [film], base).stiffness_at(vectors)])

    point, step = jnp.array([0.3, 0.2, 2.0, 0.35, 1.5]), 1e-5
    for base in ("rigid", "crystal"):
        chosen = base if base == "rigid" else Crystal(CUBIC)
        call = jax.jit(lambda parameters, chosen=chosen: stiffness(parameters, chosen))
        slopes = jax.jit(jax.jacrev(call))(point)
        for i, unit in enumerate(np.eye(5)):
            difference = (call(point + step * unit) - call(point - step * unit)) / (2 * step)
            np.testing.assert_allclose(slopes[:, i], difference, rtol=1e-6, atol=1e-7)


@pytest.mark.nightly
def test_a_contact_takes_a_stack_or_its_stiffness_computed_once():
    grid = js.Grid(8)
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=3, rms_height=0.02)
    films = [Film(Crystal(CUBIC), 0.05, slips=True), Film(SOFT, 0.1)]
    solid = Layered(grid, films, STIFF)
    contact = js.Contact(solid, heights, js.potentials.Exponential(0.002, 0.02))
    state = js.equilibrate(contact, js.MeanGap(0.03))
    once = js.Contact(solid.prepared, heights, contact.potential)
    same = js.equilibrate(once, js.MeanGap(0.03))
    np.testing.assert_allclose(state.gap, same.gap, atol=1e-12)
    np.testing.assert_allclose(
        state.pressure - state.mean_pressure, solid.pressure(state.displacement), atol=1e-9
    )


def test_a_stack_that_relaxes_alike_is_viscoelastic_and_no_other():
    solid = Layered(GRID, [Film(SOFT, 0.1), Film(STIFF, 0.2)], (2.0, 0.3))
    aged = js.Viscoelastic(solid, (1.5,), (1.0,))
    ratio = aged.glassy.multiplier[1:] / solid.waves.multiplier[1:]
    np.testing.assert_allclose(ratio, 2.5)
    rubber = js.Viscoelastic(js.HalfSpace(GRID, 1.0), (1.5,), (1.0,))
    with pytest.raises(TypeError, match=r"Viscoelastic is no material of the film.*relax differ"):
        Film(rubber, 0.1)


def test_what_makes_no_stack_is_refused():
    with pytest.raises(ValueError, match=r"layers are \[\].*HalfSpace"):
        Layered(GRID, [], (1.0, 0.3))
    with pytest.raises(ValueError, match=r"base is None, and a stack on nothing"):
        Layered(GRID, [Film(SOFT, 0.1)], None)
    with pytest.raises(TypeError, match=r"str is no material of the base"):
        Layered(GRID, [Film(SOFT, 0.1)], "glued")
    with pytest.raises(TypeError, match=r"tuple is no layer: give a jaxstab.solids.Film"):
        Layered(GRID, [(SOFT, 0.1)], SOFT)
    with pytest.raises(ValueError, match=r"thickness is -0.1: it must be positive"):
        Film(SOFT, -0.1)
    with pytest.raises(ValueError, match=r"film is .*give its Young's modulus"):
        Film((1.0, 0.2, 0.1), 0.1)
    with pytest.raises(TypeError, match=r"grid"):
        Layered(SOFT, [Film(SOFT, 0.1)], SOFT)
