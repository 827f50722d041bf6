"""Cases in lanes: each gives what it gives alone, and none waits for the slowest."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import jaxstab as js
from jaxstab.core.loop import IterativeSolver
from jaxstab.core.procedure import Part, Rounds, run
from jaxstab.studies.cases import Case
from jaxstab.studies.identity import identity_of
from jaxstab.studies.lanes.programs import Programs
from jaxstab.studies.lanes.scheduler import Lanes
from jaxstab.studies.store import Store

# Steps of Collatz's sequence from a number to one, from the literature (OEIS A006577).
NUM_STEPS = {1: 0, 2: 1, 3: 7, 6: 8, 7: 16, 9: 19, 16: 4, 27: 111, 54: 112, 97: 118}


class Collatz(IterativeSolver):
    """A sequence from a number to one."""

    tolerance: float = 0.5
    max_steps: int = eqx.field(converter=jnp.asarray, default=1000)

    def step(self, problem, state):
        return jnp.where(state % 2 == 0, state // 2, 3 * state + 1)

    def measure(self, problem, state):
        return {"residual": jnp.where(state > 1, 1.0, 0.0)}


class Both(Rounds):
    """Two sequences side by side, from the number and from its double."""

    number: jax.Array

    @property
    def search(self):
        return Collatz(), None

    @property
    def found(self):
        return self.loops.num_steps

    def begun(self):
        loops = jax.vmap(partial(Collatz().begin, None))(jnp.stack([self.number, 2 * self.number]))
        return replace(self, loops=loops, is_on=jnp.ones(2, bool))


class Again(Rounds):
    """The sequence from a number, a number of times."""

    number: jax.Array
    left: jax.Array
    count: jax.Array

    @property
    def search(self):
        return Collatz(), None

    @property
    def found(self):
        return self.count

    def begun(self):
        loop = Collatz().begin(None, self.number)
        return replace(
            self, loops=jax.tree.map(lambda leaf: leaf[None], loop), is_on=self.left[None] > 0
        )

    def turned(self):
        count = self.count + self.loops.num_steps[0]
        return replace(self, count=count, left=self.left - 1).begun()


def again(number):
    return (yield Again(number, jnp.array(2), jnp.array(0)))


def collatz(values):
    """From the number of steps that the first lane took, if that was odd, twice more."""
    count = yield Both(jnp.asarray(values["number"]))
    is_odd = count[0] % 2 == 1
    more = yield Part(again, (jnp.where(is_odd, count[0], 1),), is_odd, jnp.array(0))
    return {"count": count, "again": more}


class CollatzCase(Case):
    def __call__(self, **values):
        return self.summary(run(collatz(values)))

    def procedure(self, values):
        return self.summary((yield from collatz(values)))


def build(number):
    return number


def refusing(outputs):
    count = outputs["count"]
    return outputs | {"count": eqx.error_if(count, count[0] == 118, "too long")}


@pytest.mark.parametrize("width", [1, 5])
def test_lanes_count_what_they_pay_and_what_is_of_use(width):
    left = list(NUM_STEPS) * 3

    def take(number, waits):
        taken = [left.pop() for _ in range(min(number, len(left)))]
        return taken, {"number": np.array(taken)}

    lanes = Lanes(Programs(collatz), width, take)
    found = list(lanes.run())
    assert sorted(number for number, _, _ in found) == sorted(list(NUM_STEPS) * 3)
    steps_again = {7: 16, 19: 20, 111: 69}
    for number, outputs, seconds in found:
        count = NUM_STEPS[number]
        assert outputs["count"].tolist() == [count, count + 1]
        assert outputs["again"] == 2 * steps_again.get(count, 0)
        assert seconds > 0
    useful = sum(2 * outputs["count"][0] + 1 + outputs["again"] for _, outputs, _ in found)
    assert lanes.useful == useful
    # In a single lane nothing waits.
    assert lanes.paid == useful if width == 1 else useful < lanes.paid < useful / 0.8


def numbers_in(dataset):
    return dataset.drop_vars("seconds").drop_attrs().load()


@pytest.mark.nightly
def test_a_study_in_lanes_is_that_of_single_cases_also_where_one_raises(tmp_path):
    case = CollatzCase(build, refusing)
    axes = {"number": list(NUM_STEPS)}
    alone, lanes = (
        js.study(case, axes, tmp_path / f"{batch}.zarr", batch=batch) for batch in (1, 4)
    )
    assert alone.result.sel(number=97) == "failed" and int((alone.result == "failed").sum()) == 1
    assert "too long" in str(lanes.error.sel(number=97).values)
    xarray.testing.assert_identical(
        numbers_in(lanes.drop_vars("error")), numbers_in(alone.drop_vars("error"))
    )


def test_a_study_in_lanes_goes_on_after_an_end_at_any_write(tmp_path, monkeypatch):
    case, axes = CollatzCase(build, dict), {"number": list(NUM_STEPS)}
    whole = numbers_in(js.study(case, axes, tmp_path / "whole.zarr", batch=4))
    written, keep = [], Store.keep

    def dying(self, found):
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(found.place)
        return keep(self, found)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(Store, "keep", dying)
        js.study(case, axes, tmp_path / "cut.zarr", batch=4)
    assert len(written) == 3
    done = js.study(case, axes, tmp_path / "cut.zarr", batch=4)
    xarray.testing.assert_identical(numbers_in(done), whole)


GRID = js.Grid(16)


def rough(seed, energy, gap):
    heights = js.surfaces.self_affine(GRID, jax.random.key(seed), k_high=4, rms_height=0.05)
    law = js.potentials.Exponential(energy, 0.05)
    return js.Contact(js.HalfSpace(GRID, 1.0), heights, law), js.MeanGap(gap)


def fields(contact, equilibrium):
    return {
        "field": equilibrium.gap,
        "steps": equilibrium.num_steps,
        "ended": equilibrium.result,
        "resolution": contact.resolution,
    }


def test_equilibria_in_lanes_are_those_found_alone(tmp_path):
    case = js.cases.equilibrium(rough, fields)
    # The last load is one that no gap meets.
    axes = {"seed": [0, 1], "energy": [0.05], "gap": [0.2, 0.03, -1.0]}
    lanes = js.study(case, axes, tmp_path / "lanes.zarr", batch=4)
    assert (lanes.ended.sel(gap=-1.0) == "infeasible_load").all()
    for seed, gap in [(0, 0.2), (0, 0.03), (1, 0.2), (1, 0.03)]:
        alone = case(seed=seed, energy=0.05, gap=gap)
        found = lanes.sel(seed=seed, energy=0.05, gap=gap)
        assert found.ended == "successful"
        # Both stop at a residual of 1e-9.
        np.testing.assert_allclose(found.field, alone["field"], atol=1e-8)
        np.testing.assert_allclose(found.resolution, alone["resolution"])


def test_a_ready_made_case_is_known_by_all_that_it_is_made_of():
    def other(contact, equilibrium):
        return {"steps": equilibrium.num_steps}

    case = js.cases.equilibrium(rough, fields)
    assert identity_of(case) == identity_of(js.cases.equilibrium(rough, fields))
    assert "GRID" in identity_of(case) and "fields" in identity_of(case)
    assert identity_of(case) != identity_of(js.cases.equilibrium(rough, other))
    assert identity_of(case) != identity_of(js.cases.equilibrium(rough))
    assert identity_of(case) != identity_of(CollatzCase(rough, fields))


def test_the_arguments_of_a_ready_made_case_are_those_of_what_builds_it(tmp_path):
    with pytest.raises(TypeError, match=r"\(seed, energy, gap\), the axes give seed"):
        js.study(js.cases.equilibrium(rough), {"seed": [0]}, tmp_path / "study.zarr")
