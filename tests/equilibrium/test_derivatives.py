"""Derivatives of equilibria: against finite differences, and where none exist."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import TIGHT, rough_contact, with_parameters

import jaxstab as js

OUTPUTS = ("gap", "displacement", "pressure", "reaction", "mean_pressure", "energy")
STEP = 3e-5


def parameters_of(seed, shape, load):
    """Return random parameters of every class, and a load that keeps or loses contact."""
    random = np.random.default_rng(seed)
    grid = js.Grid(shape)
    key = jax.random.key(seed)
    heights = js.surfaces.self_affine(grid, key, k_high=min(shape) // 4, rms_height=0.1)
    is_far = random.random() < 0.3
    value = random.uniform(0.6, 0.9) if is_far else random.uniform(0.05, 0.3)
    if load is js.MeanPressure:
        value = random.uniform(-0.01, 0.5)
    return {
        "surface_energy": jnp.array(random.uniform(0.005, 0.02)),
        "length": jnp.array(random.uniform(0.1, 0.2)),
        "youngs_modulus": jnp.array(random.uniform(0.5, 2)),
        "poisson_ratio": jnp.array(random.uniform(0.1, 0.4)),
        "side": jnp.array(random.uniform(0.8, 1.2)),
        "heights": heights + random.uniform(-0.1, 0.1),
        "load": jnp.array(value),
    }


@jax.jit
def contact_of(parameters):
    heights = parameters["heights"]
    solid = js.HalfSpace(
        js.Grid(heights.shape, parameters["side"]),
        parameters["youngs_modulus"],
        parameters["poisson_ratio"],
    )
    law = js.potentials.Exponential(parameters["surface_energy"], parameters["length"])
    return js.Contact(solid, heights, law)


def directions(parameters, seed):
    """Return a direction for each class of parameters, relative to its size."""
    random = np.random.default_rng(seed + 1000)
    everything = {}
    for name, value in parameters.items():
        nothing = jax.tree.map(jnp.zeros_like, parameters)
        noise = 0.1 * random.normal(size=value.shape)
        change = noise if name == "heights" else abs(value) + 0.01
        everything[name] = {**nothing, name: jnp.asarray(change)}
    return everything


@pytest.mark.parametrize(
    "shape",
    [pytest.param((16, 16), id="2-D"), pytest.param((64,), id="1-D", marks=pytest.mark.nightly)],
)
@pytest.mark.parametrize(
    "load",
    [
        js.MeanGap,
        pytest.param(js.MeanDisplacement, marks=pytest.mark.nightly),
        pytest.param(js.MeanPressure, marks=pytest.mark.nightly),
    ],
)
def test_every_output_by_every_parameter_agrees_with_finite_differences(shape, load):
    def solve(parameters, start=None):
        contact, value = contact_of(parameters), parameters["load"]
        start = 0.3 - contact.heights if start is None else start
        if load is js.MeanDisplacement:
            value = value + jnp.mean(contact.heights)
        found = js.equilibrate(contact, load(value), TIGHT, initial=start, throw=False)
        return {name: getattr(found, name) for name in OUTPUTS}, found

    @jax.jit
    def push(parameters, direction, start):
        return jax.jvp(lambda p: solve(p, start)[0], (parameters,), (direction,))[1]

    @jax.jit
    def pull(parameters, weights, start):
        return jax.vjp(lambda p: solve(p, start)[0], parameters)[1](weights)[0]

    num_compared, areas = 0, []
    for seed in range(8):
        parameters = parameters_of(seed, shape, load)
        _, found = solve(parameters)
        assert found.result == js.RESULTS.successful
        start = found.gap
        random = np.random.default_rng(seed)
        weights = {n: jnp.asarray(random.normal(size=found.gap.shape)) for n in OUTPUTS[:4]}
        weights |= {name: jnp.array(random.normal()) for name in OUTPUTS[4:]}
        gradient = pull(parameters, weights, start)
        scale = contact_of(parameters).conforming_pressure
        is_away = True
        for name, direction in directions(parameters, seed).items():
            moved = [
                solve(
                    jax.tree.map(lambda p, d, s=s: p + s * STEP * d, parameters, direction), start
                )
                for s in (1, -1)
            ]
            if any((state.in_contact != found.in_contact).any() for _, state in moved):
                is_away = False
                continue
            forward = push(parameters, direction, start)
            for output in OUTPUTS:
                exact, (above, _), (below, _) = forward[output], *moved
                differences = (above[output] - below[output]) / (2 * STEP)
                # Differences of an output that hardly changes are lost in its rounding.
                value = np.asarray(getattr(found, output))
                floor = scale * np.sqrt(value.size) if "pressure" in output else 0
                size = max(np.linalg.norm(differences), 1e-3 * max(np.linalg.norm(value), floor))
                error = np.linalg.norm(exact - differences)
                assert error <= 1e-5 * size, (seed, name, output)
            terms = [jnp.vdot(weights[n], forward[n]) for n in OUTPUTS]
            through = sum(jnp.vdot(gradient[n], direction[n]) for n in direction)
            size = sum(map(abs, terms)) + 1e-3 * scale
            assert abs(sum(terms) - through) < 1e-10 * size, (seed, name)
        num_compared += is_away
        areas += [found.contact_area] if is_away else []
    assert num_compared >= 6
    # A pressure holds no state without contact; there it reaches from little to much.
    least, most = (0.2, 0.3) if load is js.MeanPressure else (0, 0.05)
    assert min(areas) <= least and max(areas) >= most


X = jnp.array([0.02, 0.1, 1.0, 0.1])
GAP = jnp.array(0.1)
GAPS = jnp.array([0.1, 0.12])


@pytest.fixture(scope="module")
def contact():
    return with_parameters(rough_contact(16, js.potentials.NoAdhesion()), *X[:3])


def solve(contact, x, solver=TIGHT, **options):
    return js.equilibrate(with_parameters(contact, *x[:3]), js.MeanGap(x[3]), solver, **options)


@pytest.mark.nightly
def test_second_derivatives_are_right_too(contact):
    gradient = jax.jit(jax.grad(lambda x: solve(contact, x).mean_pressure))
    turn = jax.jit(lambda direction: jax.jvp(gradient, (X,), (direction,))[1])
    for i, h in enumerate(1e-5 * X):
        direction = jnp.zeros(4).at[i].set(1)
        second = turn(direction)
        differences = (gradient(X + h * direction) - gradient(X - h * direction)) / (2 * h)
        np.testing.assert_allclose(second, differences, rtol=1e-6, atol=1e-6)


@pytest.mark.nightly
def test_a_batch_and_jacobians_equal_single_derivatives(contact):
    def pressure(x):
        return solve(contact, x, throw=False).mean_pressure

    values = jnp.stack([X, 0.9 * X, 1.1 * X])
    batch = jax.jit(jax.vmap(jax.value_and_grad(pressure)))(values)[1]
    jacobian = jax.jacrev(jax.vmap(pressure))(values)
    for i, x in enumerate(values):
        single = jax.grad(pressure)(x)
        np.testing.assert_allclose(batch[i], single, rtol=1e-10)
        np.testing.assert_allclose(jacobian[i, i], single, rtol=1e-10)


@pytest.mark.nightly
def test_a_failed_entry_is_nan_and_leaves_a_masked_sum_alone(contact):
    gaps = jnp.array([0.1, -0.1, jnp.nan, 0.2])

    def solve_at(energy, gap):
        return solve(contact, X.at[0].set(energy).at[3].set(gap), throw=False)

    def pressure(gap, energy=0.02):
        return solve_at(energy, gap).mean_pressure

    rates = jax.jit(jax.vmap(jax.grad(pressure)))(gaps)
    np.testing.assert_array_equal(jnp.isnan(rates), [False, True, True, False])

    def masked(energy):
        found = jax.vmap(lambda gap: solve_at(energy, gap))(gaps)
        return jnp.sum(jnp.where(found.result == js.RESULTS.successful, found.mean_pressure, 0))

    alone = jax.jit(jax.grad(pressure, argnums=1))
    both = alone(0.1, 0.02) + alone(0.2, 0.02)
    np.testing.assert_allclose(jax.jit(jax.grad(masked))(0.02), both, rtol=1e-9)


@pytest.mark.nightly
def test_an_equilibrium_that_was_not_found_has_no_derivative(contact):
    hasty = js.solvers.PreconditionedConjugateGradient(tolerance=1e-13, max_steps=2)

    def pressure(x, throw=False):
        return solve(contact, x, hasty, throw=throw).mean_pressure

    assert jnp.isnan(jax.grad(pressure)(X)).all()
    with pytest.raises(js.exceptions.SolverError, match="max_steps_reached"):
        jax.grad(pressure)(X, throw=True)


@pytest.mark.nightly
def test_where_a_point_is_about_to_touch_or_to_be_released_the_derivative_is_nan(contact):
    def touching(value):
        return solve(contact, X.at[3].set(value)).in_contact

    low, high = 0.1, 0.12
    assert (touching(low) != touching(high)).any()
    while high - low > 1e-15:
        middle = (low + high) / 2
        same = (touching(middle) == touching(low)).all()
        low, high = (middle, high) if same else (low, middle)
    x = X.at[3].set(low)

    def output(x, name="mean_pressure"):
        return jnp.sum(getattr(solve(contact, x), name))

    for name in ("mean_pressure", "gap"):
        assert jnp.isnan(jax.grad(output)(x, name)).all()
    # The energy does have a derivative there.
    rate = jax.grad(output)(x, "energy")[3]
    np.testing.assert_allclose(rate, -output(x), rtol=1e-8)


def states(contact, energy, gaps, **options):
    other = with_parameters(contact, energy, *X[1:3])
    found = js.sweep(other, js.MeanGap(gaps), **options)
    return found.equilibrium.mean_pressure, found.stability.critical.eigenvalue


@pytest.fixture(scope="module")
def single_rates(contact):
    def single(energy, gap):
        other = with_parameters(contact, energy, *X[1:3])
        found = js.equilibrate(other, js.MeanGap(gap), throw=False)
        critical = js.assess_stability(other, found, throw=False).critical
        return found.mean_pressure, critical.eigenvalue

    one = jnp.array(1.0)
    return [jax.jvp(lambda e, g=gap: single(e, g), (X[0],), (one,))[1] for gap in GAPS]


@pytest.mark.nightly
@pytest.mark.parametrize("order", ["independent", "continuation"])
def test_a_sweep_has_the_derivatives_of_its_states(contact, single_rates, order):
    rates = jax.jacrev(lambda energy: states(contact, energy, GAPS, order=order))(X[0])
    for i, alone in enumerate(single_rates):
        for rate, expected in zip(rates, alone, strict=True):
            np.testing.assert_allclose(rate[i], expected, rtol=1e-5)


def test_at_the_fold_of_flat_surfaces_is_no_derivative_and_beside_it_there_is():
    """Flat surfaces on a spring snap together where it is as stiff as the attraction."""
    stiffness, length, gap = 2.0, 0.1, 0.3
    law = js.potentials.Exponential(stiffness * length**2 * np.exp(gap / length), length)
    contact = js.Contact(js.HalfSpace(js.Grid(8), 10.0), jnp.zeros((8, 8)), law)

    def mean_gap(position):
        load = js.Spring(position, stiffness)
        found = js.equilibrate(contact, load, initial=jnp.full((8, 8), 0.6), throw=False)
        return jnp.mean(found.gap)

    value_and_slope = jax.value_and_grad(mean_gap)
    fold = gap + length
    found, slope = value_and_slope(fold)
    assert found == pytest.approx(gap, abs=1e-3)
    assert jnp.isnan(slope)
    found, slope = value_and_slope(fold + 0.05)
    assert slope == pytest.approx(1 / (1 - np.exp((gap - found) / length)), rel=1e-6)


@pytest.mark.nightly
def test_single_precision_has_derivatives(contact):
    single = js.Contact(contact.solid, contact.heights.astype(jnp.float32), contact.potential)

    @jax.jit
    @jax.grad
    def rate(value, contact):
        return js.equilibrate(contact, js.MeanGap(value)).mean_pressure

    found = rate(jnp.float32(0.1), single)
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, rate(GAP, contact), rtol=1e-3)
