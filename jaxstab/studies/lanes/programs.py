"""The compiled programs of cases in lanes.

A case is a procedure, which stops where it waits for loops. To continue from a stop it is traced
anew, and is sent the same values again up to there.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core.procedure import Procedure, Rounds, unfolded


class Stop(eqx.Module):
    """Where a procedure waits for its loops, or its end.

    Attributes:
        kept: the values kept since the last stop.
        rounds: the loops; None at the end.
        outputs: the outputs of the procedure at its end.
    """

    kept: list[Any]
    rounds: Rounds | None = None
    outputs: Any = None

    @property
    def answers(self) -> list[Any]:
        """The values sent to the procedure up to here, since the last stop."""
        assert self.rounds is not None
        return [*self.kept, self.rounds.found]

    @property
    def has_steps(self) -> tuple[Any, Any]:
        """Which lanes have steps to take, and whether any takes part in the round."""
        if self.rounds is None:
            return jnp.zeros(1, bool), jnp.array(False)
        has_steps = jax.vmap(self.rounds.has_steps)(self.rounds.loops, self.rounds.is_on)
        return has_steps, jnp.any(self.rounds.is_on)


def next_stop(procedure: Procedure[Any], stops: Sequence[Stop]) -> Stop:
    """Return where a procedure waits next, taken anew through the stops that it had."""
    answers = [answer for stop in stops for answer in stop.answers]
    kept, found = [], None
    while True:
        try:
            request = procedure.send(found)
        except StopIteration as end:
            return Stop(kept, outputs=end.value)
        if answers:
            found = answers.pop(0)
        elif isinstance(request, Rounds):
            return Stop(kept, request)
        else:
            found = request.value
            kept.append(found)


class Programs:
    """The compiled programs of cases.

    Arguments:
        procedure: returns the procedure of a case, given its inputs.
    """

    def __init__(self, procedure: Callable[[Any], Procedure[Any]]):
        self._procedure = procedure
        self.taken, self.put = jax.jit(_taken), jax.jit(_put, donate_argnums=0)
        self.go_on, self.turn = jax.jit(self._go_on), jax.jit(_turned)
        self.advance = jax.jit(_advanced, donate_argnums=0)

    def _go_on(self, inputs: Any, stops: Sequence[Stop], where: Array) -> tuple[Stop, Any]:
        """Return the next stops of cases, and which of their lanes have steps."""

        def one(inputs: Any, stops: Sequence[Stop]) -> tuple[Stop, Any]:
            stop = next_stop(unfolded(self._procedure(inputs)), stops)
            return stop, stop.has_steps

        return jax.vmap(one)(*_taken((inputs, stops), where))


def _turned(stop: Stop, where: Array) -> tuple[Stop, Any]:
    """Return stops in their next round, and which of their lanes have steps."""

    def one(stop: Stop) -> tuple[Stop, Any]:
        assert stop.rounds is not None
        stop = replace(stop, rounds=stop.rounds.turned())
        return stop, stop.has_steps

    return jax.vmap(one)(_taken(stop, where))


def _advanced(stop: Stop, where: tuple[Array, Array]) -> tuple[Stop, Array, Array]:
    """Return stops with some lanes advanced, whether these have steps left, and those taken."""
    assert stop.rounds is not None
    rounds, before = replace(stop.rounds, loops=None, is_on=None), stop.rounds.loops

    def one(rounds: Rounds, loop: Any, is_on: Array) -> tuple[Any, Array]:
        loop = rounds.advanced(loop, is_on)
        return loop, rounds.has_steps(loop, is_on)

    lanes = _taken((before, stop.rounds.is_on), where)
    loops, has_steps = jax.vmap(one)(_taken(rounds, where[0]), *lanes)
    stop = replace(stop, rounds=replace(stop.rounds, loops=_put(before, loops, where)))
    return stop, has_steps, loops.num_steps - lanes[0].num_steps


def _taken(arrays: Any, where: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[where], arrays)


def _put(arrays: Any, values: Any, where: Any) -> Any:
    return jax.tree.map(lambda leaf, new: leaf.at[where].set(new), arrays, values)
