"""A branch of equilibria, stable or not, and where its load turns."""

from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Array, Int

from jaxstab.core import display
from jaxstab.core.display import Outcome, column, several
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field
from jaxstab.core.units import NUMBER
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load
from jaxstab.states.columns import load_column, state_columns
from jaxstab.states.kinds import ENDS, KINDS
from jaxstab.states.sequence import StateSequence


class Turn(Outcome):
    """Where the load turns back along a branch, or another branch crosses it.

    Attributes:
        load: the load there.
        kind: a member of `KINDS`: a fold, a release, a touch, or a bifurcation, where the load
            does not turn back.
        equilibrium: the state.
        mode: the unit vector along which the branch goes on there, at a bifurcation the other one.
        state: the number of the state after it, among the states of the branch.

    Example:
        >>> branch = js.continuation(contact, js.MeanGap([0.05, 0.3]), initial=state)
        >>> f"{branch.turns[0].equilibrium.mean_pressure:.4f}"
        '-0.1640'
    """

    load: Load
    kind: KINDS
    equilibrium: Equilibrium
    mode: Annotated[Field, NUMBER]
    state: Int[Array, ""]


class Branch(StateSequence):
    """Equilibria along a branch, stable or not, where its load turns, and where others cross.

    `branch[3]` is a state, `len(branch)` their number. In a batch, as after `jax.vmap`, `batch[3]`
    is the fourth branch, without empty entries.

    Attributes:
        load: the loads of the states, in the order of the branch.
        equilibrium: the states. A branch is reversible: nothing is lost, and the work is the change
            of energy.
        index: the Morse index of each: the number of negative eigenvalues of A among perturbations
            of its free points that the load allows. Zero means a minimum, 19 that number or more,
            -1 that it was not found.
        turns: where the load turns back, and where another branch crosses at a bifurcation, in
            order.
        end: a member of `ENDS`: why the branch ends there.
        result: how the search ended.

    Example:
        >>> branch = js.continuation(contact, js.MeanGap([0.05, 0.3]), initial=state)
        >>> sorted({int(index) for index in branch.index})
        [0, 1]
    """

    index: Int[Array, " states"]
    turns: Turn
    end: ENDS
    result: RESULTS
    _of_states: ClassVar[tuple[str, ...]] = (*StateSequence._of_states, "index")
    _of_events: ClassVar[str] = "turns"

    @display.readable
    def __repr__(self) -> str:
        branch = self.recorded
        index = np.asarray(branch.index)
        parts = [f"{branch._extent}", f"{np.sum(index > 0)} of them unstable"]
        if np.any(index < 0):
            parts.append(f"{np.sum(index < 0)} of unknown index")
        parts.append(several(len(branch.turns), "turn"))
        end = str(ENDS[branch.end]).split(": ", 1)[1]
        lines = [f"Branch: {', '.join(parts)}; ends {end}; {branch.result.name}"]
        if len(branch.turns):
            lines.append(display.table(_turns(branch.turns)))
        return "\n".join(lines)


def _turns(turns: Turn) -> dict[str, list[str]]:
    state = turns.equilibrium
    return {
        **load_column(turns.load, state.units, ".8g"),
        "kind": column(turns.kind.name, str),
        **state_columns(state),
    }
