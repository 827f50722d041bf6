"""The barrier to detachment along a growing tension, from few passes.

The slope of a barrier over the load is known with it, as a transition can be differentiated: the
energies of saddle and state follow the load at a fixed gap. Between two passes the 2/3 power of the
barrier, or before a release the 1/2 power, which are smooth up to the end of the branch, is a cubic
with the values and slopes of both.

The barrier is the largest climb on the way. It goes on through a jump of the state: shortly before,
the climb from the state behind the jump, which is met on the way, is larger already.
"""

from bisect import bisect_right
from typing import NamedTuple

import jax
import numpy as np

from jaxstab.branches.differentiable_limit import CriticalLoad
from jaxstab.contact import Contact
from jaxstab.core.checks import array
from jaxstab.core.types import Flag, Scalar
from jaxstab.loading.path import Path
from jaxstab.loads import MeanPressure
from jaxstab.states.kinds import KINDS
from jaxstab.transitions.pass_to_detached import largest_climb

# Passes are computed at no more than so many loads.
_MAX_PASSES = 40
# A jump within this part of the pull-off is the detachment. Paths go on beyond it by as much.
SAME_LOAD = 1e-3
# A new pass divides an interval. It tells by how much the cubic over the whole interval missed it,
# in value and in slope times the length of the part. The error of the cubic over that part is
# taken as a quarter of this; an error of fourth order falls to a sixteenth, which is less.
_OF_MISSED = 0.25
# An interval is divided at this part of it at least.
_LEAST_PART = 0.1
_POINTS = 64


class InterpolatedBarriers(NamedTuple):
    """Barriers over tensions, between the passes interpolated.

    Attributes:
        tensions: -p0, rising to that of the pull-off.
        barriers: B at each; zero at the pull-off.
        errors: of the barriers between each tension and the one before.
        passes: how many of the barriers are those of a computed pass.
        is_direct: whether each pass leads from the state straight to detached surfaces.
    """

    tensions: np.ndarray
    barriers: np.ndarray
    errors: np.ndarray
    passes: int
    is_direct: bool


class _Node(NamedTuple):
    """The barrier at a tension, and its slope, NaN where it is not known."""

    tension: float
    barrier: float
    slope: float


class BarrierCurve:
    """The barriers to detachment of the states of a path under growing tension.

    Arguments:
        contact: the contact.
        path: its states from the first load to the pull-off, with their gaps.
        limit: the pull-off.
    """

    def __init__(self, contact: Contact, path: Path, limit: CriticalLoad):
        self._contact = contact
        self._path = path
        self._tensions = -np.asarray(path.load.value, float)
        self._end = -float(limit.load.value)
        jumps = -np.asarray(path.jumps.load.value, float)
        self._law = None
        if np.any(jumps >= (1 - SAME_LOAD) * self._end):
            self._law = path.jumps.barrier_law[-1]
        self._power = 2.0
        if limit.kind == KINDS.fold:
            self._power = 3 / 2
        self._nodes = [_Node(self._end, 0.0, np.nan)]
        self._errors: list[float] = []
        self._is_direct = True

    def add_down_to(self, barrier: float, first: float) -> None:
        """Compute passes at lower and lower tensions, up to a barrier, and at the first tension."""
        distance = self._guess(barrier)
        while self._nodes[0].barrier < barrier and self._nodes[0].tension > first:
            tension = max(first, self._end - distance)
            self._add(tension)
            ratio = barrier / max(self._nodes[0].barrier, 0.1 * barrier)
            distance = self._end - tension
            distance *= max(1.1 * ratio ** (1 / self._power), 1.2)
        if self._nodes[0].tension > first:
            self._add(first)

    def refine(self, barrier: float, tolerance: float) -> None:
        """Compute passes until the barriers below a given one are within a tolerance."""
        while len(self._nodes) < _MAX_PASSES:
            errors = list(self._errors)
            for i in range(len(errors)):
                if self._nodes[i + 1].barrier >= barrier:
                    errors[i] = 0.0
            worst = int(np.argmax(errors))
            if errors[worst] <= tolerance:
                return
            place = self._place_between(worst)
            (expected,), (slope,) = self._between(worst, np.array([place]))
            self._add(place)
            new = self._nodes[worst + 1]
            for i in (worst, worst + 1):
                length = self._nodes[i + 1].tension - self._nodes[i].tension
                missed = abs(new.barrier - expected) + abs(new.slope - slope) * length
                self._errors[i] = min(self._errors[i], missed * _OF_MISSED)

    def barriers(self) -> InterpolatedBarriers:
        """Return the barriers at many tensions."""
        tensions = [np.array([self._nodes[0].tension])]
        barriers = [np.array([self._nodes[0].barrier])]
        errors = [np.zeros(1)]
        for i, error in enumerate(self._errors):
            ends = self._nodes[i].tension, self._nodes[i + 1].tension
            places = np.linspace(*ends, _POINTS + 1)[1:]
            tensions.append(places)
            barriers.append(self._between(i, places)[0])
            errors.append(np.full(_POINTS, error))
        return InterpolatedBarriers(
            np.concatenate(tensions),
            np.concatenate(barriers),
            np.concatenate(errors),
            len(self._nodes) - 1,
            self._is_direct,
        )

    def _guess(self, barrier: float) -> float:
        """Return how far from the pull-off the barrier is about as high as a given one."""
        if self._law is not None and np.isfinite(self._law.coefficient):
            distance = (barrier / float(self._law.coefficient)) ** (1 / self._power)
            return min(distance, 0.2 * self._end)
        return 0.1 * self._end

    def _add(self, tension: float) -> None:
        """Compute the pass at a tension below that of the pull-off."""
        place = bisect_right([node.tension for node in self._nodes], tension)
        self._nodes.insert(place, self._node(tension))
        self._errors.insert(place, np.inf)
        for i in range(max(place - 1, 0), place + 1):
            # The barrier between two passes is between theirs.
            self._errors[i] = abs(self._nodes[i].barrier - self._nodes[i + 1].barrier)

    def _node(self, tension: float) -> _Node:
        """Return the barrier at a tension."""
        # The last state of the path at a lower tension.
        number = int(np.flatnonzero(self._tensions <= tension * (1 + 1e-9))[-1])
        gaps = self._path.equilibrium.gap
        assert gaps is not None

        def climb(pressure: Scalar) -> tuple[Scalar, Flag]:
            found, is_direct = largest_climb(self._contact, MeanPressure(pressure), gaps[number])
            return found.there, array(is_direct)

        barrier, slope, is_direct = jax.jvp(
            climb, (array(-tension, gaps.dtype),), (array(1.0, gaps.dtype),), has_aux=True
        )
        self._is_direct &= bool(is_direct)
        if tension == 0:
            # It falls the faster there the farther apart the surfaces are on the pass.
            slope = np.nan
        return _Node(tension, max(float(barrier), 0.0), -float(slope))

    def _between(self, i: int, tensions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the barriers at tensions between two passes, and their slopes."""
        from scipy.interpolate import CubicHermiteSpline

        one, other = self._nodes[i : i + 2]
        chord = (other.barrier - one.barrier) / (other.tension - one.tension)
        if one.tension == 0:
            # The slope is infinite at first.
            return one.barrier + chord * tensions, np.full_like(tensions, chord)
        low, high = (node.barrier ** (1 / self._power) for node in (one, other))
        rise = self._slope(one)
        if other.barrier > 0:
            fall = self._slope(other)
        elif self._law is not None and other.tension - one.tension <= self._law.range:
            fall = -(float(self._law.coefficient) ** (1 / self._power))
        else:
            # With the slope of a parabola.
            fall = 2 * (high - low) / (other.tension - one.tension) - rise
        root = CubicHermiteSpline([one.tension, other.tension], [low, high], [rise, fall])
        roots = np.maximum(root(tensions), 0)
        slopes = self._power * roots ** (self._power - 1) * root(tensions, 1)
        return roots**self._power, slopes

    def _place_between(self, i: int) -> float:
        """Return the tension between two passes at which their tangents meet.

        That is near where another state has the largest climb from there on, and in the middle if
        the barrier bends evenly.
        """
        one, other = self._nodes[i : i + 2]
        length = other.tension - one.tension
        chord = (other.barrier - one.barrier) / length
        bend = one.slope - other.slope
        # Two ends have no slope.
        share = (chord - other.slope) / bend if np.isfinite(bend) and bend != 0 else 0.5
        return one.tension + float(np.clip(share, _LEAST_PART, 1 - _LEAST_PART)) * length

    def _slope(self, node: _Node) -> float:
        """Return the slope of the power of the barrier that is smooth."""
        return node.slope * node.barrier ** (1 / self._power - 1) / self._power
