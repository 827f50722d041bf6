"""A branch of equilibria, stable or not: the result of `continuation`."""

from typing import Annotated

import numpy as np
from jaxtyping import Array, Int

from jaxstab.core import display
from jaxstab.core.display import block, column
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import Stackable
from jaxstab.core.types import Field
from jaxstab.core.units import NUMBER, Dimensioned
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load
from jaxstab.paths.kinds import KINDS
from jaxstab.paths.path import StateSequence


class Turn(Stackable, Dimensioned):
    """Where the load turns back along a branch.

    Attributes:
        load: the load there.
        kind: a member of `KINDS`: a fold, a release or a touch.
        equilibrium: the state.
        mode: the unit vector along which the branch goes on there.
        state: the number of the state after it, among the states of the branch.
    """

    load: Load
    kind: KINDS
    equilibrium: Equilibrium
    mode: Annotated[Field, NUMBER]
    state: Int[Array, ""]

    __repr__ = block


class Branch(StateSequence):
    """Equilibria along a branch, stable or not, and where its load turns.

    `branch[3]` is a state, `len(branch)` their number.

    Attributes:
        load: the loads of the states, in the order of the branch.
        equilibrium: the states. A branch is reversible: nothing is lost, and the work is the change
            of energy.
        index: the Morse index of each: the number of negative eigenvalues of A among perturbations
            of its free points that the load allows. Zero means a minimum, 19 that number or more,
            -1 that it was not found.
        turns: where the load turns back, in order.
        end: a member of `KINDS`: why the branch ends there.
        result: how the search ended.
    """

    index: Int[Array, " states"]
    turns: Turn
    end: KINDS
    result: RESULTS

    def __repr__(self) -> str:
        try:
            index = np.asarray(self.index)
            unknown = f"{np.sum(index < 0)} of unknown index, " if np.any(index < 0) else ""
            lines = [
                f"Branch: {self._extent}, {np.sum(index > 0)} of them unstable, {unknown}"
                f"{len(self.turns)} turns; "
                f"ends {str(KINDS[self.end]).split(': ', 1)[1]}; {self.result.name}"
            ]
            table = [display.table(_rows(self.turns))] if len(self.turns) else []
            return "\n".join([*lines, *table])
        except display.UNREADABLE:
            return display.block(self)


def _rows(turns: Turn) -> dict[str, list[str]]:
    state = turns.equilibrium
    return {
        **display.load_column(turns.load, state.units, ".8g"),
        "kind": column(turns.kind.name, str),
        **display.pressure_columns(state),
        "contact area": column(state.contact_area, lambda part: f"{100 * part:.2f} %"),
    }
