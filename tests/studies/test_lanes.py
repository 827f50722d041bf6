"""Cases in lanes: each gives what it gives alone, and none waits for the slowest."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import jaxstab as js
from jaxstab.studies.cases import Case
from jaxstab.studies.identity import identity_of
from jaxstab.studies.lanes.scheduler import Lanes, Programs
from jaxstab.studies.lanes.stage import Stage
from jaxstab.studies.store import Store

# Steps of Collatz's sequence from a number to one, from the literature (OEIS A006577).
NUM_STEPS = {1: 0, 2: 1, 3: 7, 6: 8, 7: 16, 9: 19, 16: 4, 27: 111, 54: 112, 97: 118}


class Collatz(Stage):
    """Two sequences side by side, from the number and from its double."""

    def begin(self, record):
        start = jnp.asarray(record[0]["number"])
        return {"number": jnp.stack([start, 2 * start]), "count": jnp.zeros(2, int)}

    def advance(self, record, state, max_steps):
        end = state["count"] + max_steps

        def step(state):
            number = state["number"]
            number = jnp.where(number % 2 == 0, number // 2, 3 * number + 1)
            return state | {"number": number, "count": state["count"] + 1}

        def goes_on(state):
            return (state["number"] > 1) & (state["count"] < end)

        return jax.lax.while_loop(goes_on, step, state)

    def is_over(self, record, state):
        return state["number"] <= 1

    def num_steps(self, state):
        return state["count"]


class Again(Collatz):
    """The sequence from the number of steps that the first lane took, if that was odd, twice."""

    has_rounds = True

    def begin(self, record):
        count = record[1]["count"][:1]
        start = jnp.where(count % 2 == 1, count, 1)
        return {"number": start, "count": jnp.zeros(1, int), "round": jnp.ones(1, int)}

    def turn(self, record, states):
        start = jnp.where(states["round"] < 2, self.begin(record)["number"], 1)
        return states | {"number": start, "round": states["round"] + 1}


def finish(record):
    return {"count": record[1]["count"], "again": record[2]["count"][0]}


class CollatzCase(Case):
    def __call__(self, **values):
        record = (values,)
        for stage in (Collatz(), Again()):
            advance = jax.vmap(stage.advance, (None, 0, None))
            states = stage.turn(record, advance(record, stage.begin(record), 1000))
            record = (*record, advance(record, states, 1000))
        return self.summary(finish(record))

    def programs(self):
        return Programs([Collatz(), Again()], lambda record: self.summary(finish(record)))


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

    lanes = Lanes(Programs([Collatz(), Again()], finish), width, take)
    found = list(lanes.run())
    assert sorted(number for number, _, _ in found) == sorted(list(NUM_STEPS) * 3)
    again = {7: 16, 19: 20, 111: 69}
    for number, outputs, seconds in found:
        count = NUM_STEPS[number]
        assert outputs["count"].tolist() == [count, count + 1]
        assert outputs["again"] == 2 * again.get(count, 0)
        assert seconds > 0
    useful = sum(2 * outputs["count"][0] + 1 + outputs["again"] for _, outputs, _ in found)
    assert lanes.tally.useful == useful
    # In a single lane nothing waits.
    assert lanes.tally.paid == useful if width == 1 else useful < lanes.tally.paid < useful / 0.8


def numbers_in(dataset):
    return dataset.drop_vars("seconds").drop_attrs().load()


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
