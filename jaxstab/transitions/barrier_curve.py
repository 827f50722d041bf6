"""The barrier to detachment along a growing tension, from few passes.

The slope of a barrier over the load is known with it, as a transition can be differentiated: the
energies of saddle and state follow the load at a fixed gap. Between two passes the 2/3 power of the
barrier, or before a release the 1/2 power, which are smooth up to the end of the branch, is a cubic
with the values and slopes of both.
"""

from bisect import bisect_right
from typing import NamedTuple

import jax
import numpy as np

from jaxstab.branches.differentiable_limit import CriticalLoad
from jaxstab.branches.kinds import KINDS
from jaxstab.contact import Contact
from jaxstab.core.checks import array
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Scalar
from jaxstab.equilibrium import Equilibrium, equilibrate
from jaxstab.loading.path import Path
from jaxstab.loads import MeanGap, MeanPressure
from jaxstab.transitions.saddle import are_apart
from jaxstab.transitions.transition import transition

# Passes are computed at no more than so many loads.
_MAX_PASSES = 40
# The state jumps within this part of the load at which it ends.
_BESIDE_JUMP = 1e-3
# Two cubics over half of an interval each have at most this part of the error of one.
_PER_HALVING = 1 / 4
# Surfaces are far apart from this ratio of the attraction to the largest on.
_HARDLY_ANY = 1e-9
_POINTS = 64


class Barriers(NamedTuple):
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
        beside = _BESIDE_JUMP * self._end
        self._jumps = [jump for jump in jumps.tolist() if jump < self._end - beside]
        self._law = path.jumps.barrier_law[-1] if len(path.jumps) > len(self._jumps) else None
        self._power = 3 / 2 if limit.kind == KINDS.fold else 2.0
        self._nodes = [_Node(self._end, 0.0, np.nan)]
        self._errors: list[float] = []
        self._is_direct = True

    def add_down_to(self, barrier: float, first: float) -> None:
        """Compute passes at lower and lower tensions, up to a barrier, and at the first tension."""
        distance = self._guess(barrier)
        while self._nodes[0].barrier < barrier and self._nodes[0].tension > first:
            here = self._nodes[0]
            tension = max(first, self._end - distance)
            between = [jump for jump in self._jumps if tension < jump < here.tension]
            if between:
                # From one side of the last jump to the other.
                beside = _BESIDE_JUMP * self._end
                above = between[-1] + beside
                is_above = here.tension > above
                tension = above if is_above else max(first, between[-1] - beside)
            self._add(tension)
            ratio = barrier / max(self._nodes[0].barrier, 0.1 * barrier)
            distance = self._end - tension
            distance *= max(1.1 * ratio ** (1 / self._power), 1.2)
        if self._nodes[0].tension > first:
            self._add(first)

    def refine(self, barrier: float, tolerance: float) -> None:
        """Compute passes until the barriers below a given one are within a tolerance."""
        while len(self._nodes) < _MAX_PASSES:
            errors = [
                0.0 if self._has_jump(i) or self._nodes[i + 1].barrier >= barrier else error
                for i, error in enumerate(self._errors)
            ]
            worst = int(np.argmax(errors))
            if errors[worst] <= tolerance:
                return
            middle = (self._nodes[worst].tension + self._nodes[worst + 1].tension) / 2
            expected = self._between(worst, np.array([middle]))[0]
            self._add(middle)
            error = abs(self._nodes[worst + 1].barrier - expected) * _PER_HALVING
            for i in (worst, worst + 1):
                self._errors[i] = min(self._errors[i], error)

    def barriers(self) -> Barriers:
        """Return the barriers at many tensions."""
        tensions = [np.array([self._nodes[0].tension])]
        barriers = [np.array([self._nodes[0].barrier])]
        errors = [np.zeros(1)]
        for i, error in enumerate(self._errors):
            ends = self._nodes[i].tension, self._nodes[i + 1].tension
            places = np.linspace(*ends, _POINTS + 1)[1:]
            tensions.append(places)
            barriers.append(self._between(i, places))
            errors.append(np.full(_POINTS, error))
        return Barriers(
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
        if tension == 0:
            start = self._path[0].equilibrium
            return _Node(0.0, float(_apart(self._contact).energy - start.energy), np.nan)
        # The last state of the path at a lower tension.
        number = int(np.flatnonzero(self._tensions <= tension * (1 + 1e-9))[-1])
        gaps = self._path.equilibrium.gap
        assert gaps is not None

        def there(pressure: Scalar) -> tuple[Scalar, tuple[Equilibrium, Equilibrium]]:
            found = transition(self._contact, MeanPressure(pressure), gaps[number], None)
            return found.there, (found.start, found.minima)

        barrier, slope, (start, (near, far)) = jax.jvp(
            there, (array(-tension, gaps.dtype),), (array(1.0, gaps.dtype),), has_aux=True
        )
        leads_back = near.result == RESULTS.successful and not are_apart(near, start)
        self._is_direct &= bool(leads_back) and bool(far.result == RESULTS.pulled_off)
        return _Node(tension, max(float(barrier), 0.0), -float(slope))

    def _has_jump(self, i: int) -> bool:
        """Return whether the state jumps between two passes."""
        one, other = self._nodes[i : i + 2]
        return any(one.tension < jump < other.tension for jump in self._jumps)

    def _between(self, i: int, tensions: np.ndarray) -> np.ndarray:
        """Return the barriers at tensions between two passes."""
        one, other = self._nodes[i : i + 2]
        length = other.tension - one.tension
        share = (tensions - one.tension) / length
        if self._has_jump(i) or one.tension == 0:
            return one.barrier + share * (other.barrier - one.barrier)
        low, high = (node.barrier ** (1 / self._power) for node in (one, other))
        rise = self._slope(one) * length
        if other.barrier > 0:
            fall = self._slope(other) * length
        elif self._law is not None and length <= self._law.range:
            fall = -(float(self._law.coefficient) ** (1 / self._power)) * length
        else:
            # With the slope of a parabola.
            fall = 2 * (high - low) - rise
        bend = (1 - share) * (rise - high + low) - share * (fall - high + low)
        root = low + share * (high - low) + share * (1 - share) * bend
        return np.maximum(root, 0) ** self._power

    def _slope(self, node: _Node) -> float:
        """Return the slope of the power of the barrier that is smooth."""
        return node.slope * node.barrier ** (1 / self._power - 1) / self._power


def _apart(contact: Contact) -> Equilibrium:
    """Return a state of surfaces that hardly attract each other any more."""
    profile = contact.profile
    reach = profile.outermost_gap(_HARDLY_ANY * profile.max_attraction)
    lifted = reach + contact.heights.max() - contact.heights.mean()
    return equilibrate(contact, MeanGap(lifted))
