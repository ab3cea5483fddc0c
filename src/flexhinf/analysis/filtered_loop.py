"""The linear loop as a function of its filter's gain, for a search that asks for hundreds of gains.

A Kalman filter corrects x̂(k|k) = x̂(k|k−1) + L (y − ŷ), and what the controller does next is linear in x̂(k|k). So the
matrices of its step are affine in L,

    M(L) = M(0) + M_x L (−H, 1),

where M_x says what the corrected estimate moves and (−H, 1) is the innovation by belief and measurement. Both are read
off one linearisation, and a gain then costs a Riccati equation and a few matrix products: 10 to 40 ms with all figures
for six and seven joints, a twentieth of a new linearisation. The equilibrium is that of the filter as it is; a true
plant that differs from the model (`spring_hardening`) rests elsewhere with another gain, which is left out here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.frequency_response import FrequencyResponse
from flexhinf.analysis.linear_loop import LinearLoop
from flexhinf.analysis.margins import LARGEST_FACTOR

__all__ = ["FilteredLoop", "LoopFigures", "bandwidth_of", "compliance_of", "gain_margins_of"]

#: Frequencies looked at, from this fraction of the law's bandwidth to half the sampling frequency, beside those of the
#: poles.
POINTS, BELOW = 120, 0.05


@dataclass(frozen=True, eq=False)
class LoopFigures:
    """Figures of a stable running loop, on a grid of frequencies with points at every pole: near those of `margins`.

    Attributes
    ----------
    peak_sensitivity : float
        Largest σ_max(S) at the plant's inputs.
    gain_margins : (m,)
        Smallest factor, up or down, of the gain of each input; infinite beyond `LARGEST_FACTOR`.
    damping, damping_frequency : float
        Smallest damping ratio of all oscillations, and its |s|, rad/s.
    compliance : float
        Peak of |load torque → link position|, rad/N·m or m/N.
    input_noise : (m,)
        RMS of each input that the measurement noise causes, V or N·m.
    """

    peak_sensitivity: float
    gain_margins: np.ndarray
    damping: float
    damping_frequency: float
    compliance: float
    input_noise: np.ndarray

    @property
    def gain_margin(self) -> float:
        """The smallest of the gain margins."""
        return float(self.gain_margins.min())


class FilteredLoop:
    """A loop whose Kalman filter has any gain.

    Parameters
    ----------
    loop : EquilibriumLoop
        With a Kalman filter.
    noise : (p,) array
        Standard deviations of the measurement noise.
    bandwidth, top : float
        Of the law, rad/s; and up to where the compliance is taken.
    """

    def __init__(self, loop: EquilibriumLoop, noise: np.ndarray, bandwidth: float, top: float) -> None:
        self.loop, self.noise, self.top = loop, noise, top
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

    def figures(self, process_noise: np.ndarray) -> LoopFigures | None:
        """With the stationary gain of this R^v (n, n); None for an unstable loop.

        Raises
        ------
        NumericalFailure
            If there is no such gain in these numbers.
        """
        linear = self.linear(self.loop.gain(process_noise))
        running, m, p = linear.running, linear.b.shape[1], len(linear.c)
        if not running.stable:
            return None
        near = np.abs(running.poles[np.imag(running.poles) >= 0.0])
        grid = np.union1d(self.grid, near[(near > self.grid[0]) & (near < self.grid[-1])])
        links = [k for k, name in enumerate(linear.disturbances) if name.startswith("link_torque")]
        torques = m + p + len(linear.positions) + np.array(links, dtype=int)
        answer = running.response(grid, np.concatenate([np.arange(m), torques]))
        sensitivity, compliant = answer[:, :m, :m], answer[grid <= self.top, 2 * m :, m:]
        diagonal = np.diagonal(sensitivity, axis1=1, axis2=2)
        return LoopFigures(
            float(np.linalg.norm(sensitivity, 2, axis=(1, 2)).max()),
            gain_margins_of(1.0 / diagonal - 1.0),  # S_ii = 1/(1 + L_i), the other inputs closed
            *running.damping,
            float(np.linalg.norm(compliant, 2, axis=(1, 2)).max()),
            linear.part("v", "u").spread(self.noise),
        )


def bandwidth_of(response: FrequencyResponse) -> float:
    """Of the fastest joint, rad/s: where |command → position| is 3 dB below its value at the lowest frequency."""
    followed = np.abs(np.diagonal(response.command, axis1=1, axis2=2))
    below = followed < followed[0] / np.sqrt(2.0)
    first = np.where(below.any(axis=0), below.argmax(axis=0), len(below) - 1)
    return float(response.frequencies[first.max()])


def compliance_of(response: FrequencyResponse, top: float) -> float:
    """Peak of |load torque → link position| up to a frequency, rad/N·m or m/N."""
    torques = [k for k, name in enumerate(response.disturbances) if name.startswith("link_torque")]
    band = response.disturbance[response.frequencies <= top][:, :, torques]
    return float(np.linalg.norm(band, 2, axis=(1, 2)).max())


def gain_margins_of(loops: np.ndarray) -> np.ndarray:
    """Smallest factor (m,) by which the gain of each input may rise or fall, infinite beyond `LARGEST_FACTOR`: where
    L_i (F, m) crosses the negative axis."""
    return np.array([_gain_margin(loop) for loop in loops.T])


def _gain_margin(loop: np.ndarray) -> float:
    real, imaginary = np.real(loop), np.imag(loop)
    left, right = imaginary[:-1], imaginary[1:]
    k = np.flatnonzero((left * right <= 0.0) & (real[:-1] + real[1:] < 0.0) & (left != right))
    at = np.abs(real[k] + left[k] / (left[k] - right[k]) * (real[k + 1] - real[k]))
    at = at[at > 0.0]
    found = float(np.maximum(at, 1.0 / at).min(initial=np.inf))
    return found if found <= LARGEST_FACTOR else np.inf
