"""The linear loop as a function of its filter's gain, for a search that asks for hundreds of gains.

A Kalman filter corrects x̂(k|k) = x̂(k|k−1) + L (y − ŷ), and what the controller does next is linear in x̂(k|k). So the
matrices of its step are affine in L,

    M(L) = M(0) + M_x L (−H, 1),

where M_x says what the corrected estimate moves and (−H, 1) is the innovation by belief and measurement. Both are read
off one linearisation, and a gain then costs a Riccati equation and a few matrix products: 10 to 40 ms with its margins
for six and seven joints, a twentieth of a new linearisation. The margins are those of `margins`, on a coarser sweep.
The equilibrium is that of the filter as it is; a true plant that differs from the model (`spring_hardening`) rests
elsewhere with another gain, which is left out here.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.linear_loop import LinearLoop
from flexhinf.analysis.margins import Margins

#: Frequencies looked at, from this fraction of the law's bandwidth to half the sampling frequency, beside those of the
#: poles.
POINTS, BELOW = 80, 0.05


class FilteredLoop:
    """A loop whose Kalman filter has any gain.

    Parameters
    ----------
    loop : EquilibriumLoop
        With a Kalman filter.
    bandwidth : float
        Of the law, rad/s: the sweep begins at a fraction of it.
    """

    def __init__(self, loop: EquilibriumLoop, bandwidth: float) -> None:
        self.loop = loop
        self.own = loop.linear()
        self.grid = np.geomspace(BELOW * bandwidth, np.pi / loop.period, POINTS)

    @cached_property
    def _affine(self) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray], np.ndarray]:
        """(M(0), M_x) of memory and law, and the innovation (p, s + p) by the controller's memory and y."""
        own, (_, h), places = self.own, self.loop.model, self.loop.step.places
        gain = self.loop.gain(self.loop.filter.process_noise)
        innovation = np.zeros((len(h), own.memory.shape[1]))
        innovation[:, places["belief"]] = -h
        innovation[:, places["u"]] = -own.d
        innovation[:, len(own.memory) :] = np.eye(len(h))
        kept = np.linalg.inv(np.eye(h.shape[1]) - gain @ h)

        def split(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            moved = matrix[:, places["belief"]] @ kept
            return matrix - moved @ gain @ innovation, moved

        return split(own.memory), split(own.law), innovation

    def linear(self, gain: np.ndarray) -> LinearLoop:
        """The running loop with this gain (n, p)."""
        *parts, innovation = self._affine
        memory, law = (still + moved @ gain @ innovation for still, moved in parts)
        return replace(self.own, memory=memory, law=law)

    def margins(self, process_noise: np.ndarray) -> Margins:
        """With the stationary gain of this R^v (n, n), on a sweep with a point at every pole of the running loop.

        Raises
        ------
        NumericalFailure
            If there is no such gain in these numbers.
        """
        linear = self.linear(self.loop.gain(process_noise))
        poles = linear.running.poles
        near = np.abs(poles[np.imag(poles) >= 0.0])
        inside = near[(near > self.grid[0]) & (near < self.grid[-1])]
        return Margins(linear, np.union1d(self.grid, inside))
