"""Margins of the linear sampled loop with its estimator: distance from instability, and the cost of noise.

The loop is broken at the plant's input::

           w ──►(+)──► delay ─► plant ──► y ──►(+)◄── v
                 ▲                              │
                 └────── u ◄─ law ◄─ estimator ◄┴─ commanded positions

S = (1 + L)⁻¹ from w to u + w is the sensitivity, its largest singular value over all frequencies the inverse of the
distance of the loop from instability; T = 1 − S is the complementary sensitivity [skogestad2005]. v to u is the effect
of sensor noise on the inputs. All margins are those of the running loop: sampled, with its estimator and its own delay.

With the other inputs closed, S_ii = 1/(1 + L_i) and T_ii = L_i/(1 + L_i), so the loop at input i is on the edge of
stability with its gain times k = −1/L_i = −S_ii/T_ii wherever that is real and positive. One sweep of the running loop
therefore shows the peak of S and the gain margins of all inputs.

Delay margin: broken at the plant's input, a loop delayed by (j + φ) periods T is z⁻ʲ L_φ(z), with L_φ exact
(`LinearLoop.sampled_plant`). It is on the edge where an eigenvalue λ of −z⁻ʲ L_φ is one at z = e^{jωT}. For some φ the
frequencies with |λ(L_φ)| = 1 are found, their phase gives j as a real number, and Newton's method brings ω and the
delay together. The smallest delay is checked by the multipliers of the closed loop before it, up to 200 samples; should
any have left the unit circle there, it is bisected down to where they do.

Another gain of the filter, for a search over hundreds of gains (`FilteredLoop`): a Kalman filter corrects x̂(k|k) =
x̂(k|k−1) + L (y − ŷ), and the rest of the controller's step is linear in x̂(k|k). So the matrices of its step are
affine in L,

    M(L) = M(0) + M_x L (−H, 1),

where M_x is the effect of the corrected estimate and (−H, 1) is the innovation by belief and measurement. Both are read
off one linearisation, and a gain then costs a Riccati equation and a few matrix products: 10 to 40 ms with its margins
for six and seven joints, a twentieth of a new linearisation. The margins are those of `margins`, on a coarser sweep.
The equilibrium is that of the filter as it is; a true plant that differs from the model (`spring_hardening`) rests
elsewhere with another gain, which is left out here.
"""

# Not checked strictly: rows of arrays that are unpacked have no type.
# pyright: reportUnknownArgumentType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.linear_loop import DiscreteSystem, LinearLoop
from flexhinf.analysis.search import ACCURACY, crossings, highest_peak, refined_crossings, sign_changes
from flexhinf.loop.simulation.program import LONGEST_LINEAR
from flexhinf.plant.parameters import ParameterValues

#: Fractions of a period at which crossings of the delayed loop are looked for.
FRACTIONS = (0.0, 0.25, 0.5, 0.75)

#: Newton steps, their finite differences (relative), and the size of |λ − 1| at the end.
ITERATIONS, DIFFERENCE, CLOSE = 30, 1e-6, 1e-9

#: The closed loop is checked at this fraction of the extra delay found, and bisected so many times if it fails.
BEFORE, HALVINGS = 0.999, 30


def delay_margin(loop: LinearLoop) -> tuple[float, float]:
    """(extra delay in s, frequency in rad/s where the loop then oscillates).

    Zero if the loop is unstable as it is, its own delay included; infinite (and NaN) if no delay makes it unstable.
    """
    own = loop.delay
    if not loop.closed_loop.stable:
        return 0.0, np.nan
    candidates: list[tuple[float, float]] = []
    for fraction in FRACTIONS:
        opened = loop.opened(fraction * loop.period)

        def sizes(frequency: np.ndarray, opened: DiscreteSystem = opened) -> np.ndarray:
            return np.sort(np.abs(np.linalg.eigvals(opened.response(frequency))), axis=1) - 1.0

        for _, frequency in crossings(sizes, opened.frequencies()):
            values = np.linalg.eigvals(opened.response(frequency)[0])
            value = values[np.argmin(np.abs(np.abs(values) - 1.0))]
            turn = 2.0 * np.pi / frequency
            delay = np.angle(value) % (2.0 * np.pi) / frequency + fraction * loop.period
            # The smallest delay near this crossing that is not below the loop's own.
            delay += turn * max(0.0, np.ceil((own - delay) / turn))
            refined = _refined(loop, frequency, float(delay))
            if refined is not None and refined[0] >= own:
                candidates.append(refined)
    if not candidates:
        return np.inf, np.nan
    delay, frequency = min(candidates)
    before = min(own + BEFORE * (delay - own), LONGEST_LINEAR * loop.period)
    if loop.system(before).stable:
        return delay - own, frequency
    low, high = own, before
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if loop.system(middle).stable else (low, middle)
    multipliers = loop.system(low).multipliers
    return low - own, float(abs(np.angle(multipliers[np.abs(multipliers).argmax()])) / loop.period)


def _nearest(loop: LinearLoop, frequency: float, delay: float) -> complex:
    samples = delay / loop.period
    j = np.floor(samples)
    response = loop.opened((samples - j) * loop.period).response(frequency)[0]
    values = np.linalg.eigvals(response * np.exp(-1j * frequency * loop.period * j))
    return complex(np.log(values[np.argmin(np.abs(values - 1.0))]))


def _refined(loop: LinearLoop, frequency: float, delay: float) -> tuple[float, float] | None:
    # (delay, ω) with λ = 1, or None if Newton's method leaves the positive numbers
    for _ in range(ITERATIONS):
        value = _nearest(loop, frequency, delay)
        if abs(value) <= CLOSE:
            return delay, frequency
        steps = DIFFERENCE * frequency, DIFFERENCE / frequency
        by_frequency = (_nearest(loop, frequency + steps[0], delay) - value) / steps[0]
        by_delay = (_nearest(loop, frequency, delay + steps[1]) - value) / steps[1]
        slope = np.array([[by_frequency.real, by_delay.real], [by_frequency.imag, by_delay.imag]])
        if abs(np.linalg.det(slope)) == 0.0:
            return None
        move = np.linalg.solve(slope, [-value.real, -value.imag])
        move *= min(1.0, 0.2 * frequency / max(abs(move[0]), 1e-300))
        frequency, delay = frequency + move[0], delay + move[1]
        if not 0.0 < frequency <= np.pi / loop.period or not delay >= 0.0:
            return None
    return None


#: A factor of the gain beyond which a loop counts as stable with any: the open loop is then rounding there.
LARGEST_FACTOR = 1e6

#: Factors at which an input's loop is unstable, read off between two points of the sweep, are refined up to so many
#: times the smallest one.
REFINED_UP_TO = 1.2

#: Relative accuracy of what is refined on a grid that is given.
ROUGH = 1e-5

#: Accuracy of `Margins.delay_margin_within`, relative to the largest delay that matters.
COARSE = 0.005

#: |Im k|/|k| below which a factor is real, in multiples of the accuracy; more is a jump of k between two frequencies.
REAL = 100.0


def _pair(name: str, *texts: str) -> tuple[Any, Any]:
    """Properties of both numbers of a pair that is computed once; type checkers do not see what they read."""

    def part(k: int) -> property:
        return property(lambda margins: attrgetter(name)(margins)[k], doc=texts[k])

    return part(0), part(1)


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins of one loop; those of an unstable loop are zero (delay, disk), infinite (peaks, noise) or NaN.

    Each is computed when it is first read: a search over many loops that reads few of them pays for those. On a given
    `grid` (F,), rad/s, the loop is swept, and the peaks of S and of the compliance and the gain margins that are seen
    there are refined between its points, to `ROUGH`. By default the sweep is dense, with points at every pole of the
    running loop and of the loop opened at each input, refined to the last digits, and the peak of S is an H∞ norm.
    """

    linear: LinearLoop = field(repr=False)
    grid: np.ndarray | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        peaks = f"peak_sensitivity={self.peak_sensitivity:.4g}, gain_margin={self.gain_margin:.4g}"
        return f"Margins(stable={self.stable}, {peaks}, damping={self.damping:.3g})"

    @cached_property
    def stable(self) -> bool:
        """Whether the closed loop is stable."""
        return self.linear.closed_loop.stable

    @property
    def _accuracy(self) -> float:
        return ACCURACY if self.grid is None else ROUGH

    # Sensitivity and gain margins -------------------------------------------------------------------------
    @cached_property
    def _frequencies(self) -> np.ndarray:
        if self.grid is not None:
            return self.grid
        opened = [self.linear.opened(i=i).near_poles() for i in range(self.linear.b.shape[1])]
        return np.unique(np.concatenate([self.linear.closed_loop.frequencies(), *opened]))

    @cached_property
    def _sweep(self) -> np.ndarray:
        return self.linear.closed_loop.response(self._frequencies, self._inputs)

    @cached_property
    def _inputs(self) -> np.ndarray:
        linear, m = self.linear, self.linear.b.shape[1]
        torques = enumerate(linear.disturbances, m + len(linear.c) + len(linear.positions))
        return np.array([*range(m), *(k for k, name in torques if name.startswith("link_torque"))])

    def _peak(self, outputs: slice, inputs: slice, top: float = np.inf) -> tuple[float, float]:
        kept, chosen, closed = self._frequencies <= top, self._inputs[inputs], self.linear.closed_loop

        def sizes(response: np.ndarray) -> np.ndarray:
            return np.linalg.norm(response[:, outputs], 2, axis=(1, 2))

        swept = sizes(self._sweep[kept][:, :, inputs])
        return highest_peak(
            lambda w: sizes(closed.response(w, chosen)), self._frequencies[kept], swept, self._accuracy
        )

    @cached_property
    def _sensitivity(self) -> tuple[float, float]:
        if not self.stable:
            return np.inf, np.nan
        every = slice(0, self.linear.b.shape[1])
        return self.linear.part("w", "u+w").norm() if self.grid is None else self._peak(every, every)

    peak_sensitivity, sensitivity_frequency = _pair(
        "_sensitivity",
        "max over ω of σ_max(S(e^{jωT})).",
        "Frequency where it is reached, rad/s.",
    )

    @cached_property
    def gain_margins(self) -> np.ndarray:
        """The loop is stable with the gain of one input times all factors between these (m, 2), the others as they
        are. Beyond a millionth and a million they are 0 and infinite."""
        m = self.linear.b.shape[1]
        if not self.stable:
            return np.full((m, 2), np.nan)
        system = self.linear.closed_loop.block(slice(0, 2 * m), slice(0, m))
        return _gain_margins(
            lambda w: _critical_factors(system.response(w)),
            self._frequencies,
            _critical_factors(self._sweep[:, : 2 * m, :m]),
            np.pi / system.period,
            self._accuracy,
        )

    @property
    def gain_margin(self) -> float:
        """Smallest factor, above one, by which one input's gain may not rise or fall; 1 for an unstable loop."""
        return float(self._factors.min()) if self.stable else 1.0

    @property
    def weakest_input(self) -> int:
        """The input whose gain margin is the smallest."""
        return int(np.argmin(self._factors))

    @property
    def _factors(self) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return np.minimum(self.gain_margins[:, 1], 1.0 / self.gain_margins[:, 0])

    @cached_property
    def _complementary(self) -> tuple[float, float]:
        return self.linear.part("w", "u").norm() if self.stable else (np.inf, np.nan)

    peak_complementary, complementary_frequency = _pair(
        "_complementary",
        "max over ω of σ_max(T), T = 1 − S.",
        "Frequency where it is reached, rad/s.",
    )

    # Disk and delay margin --------------------------------------------------------------------------------
    @cached_property
    def _disk(self) -> tuple[float, float]:
        """(α, ω) with 1/α = max over ω of μ(½ (S − T)), ½ (S − T) = S − ½ [seiler2020].

        With one input μ is the absolute value. With several, each with its own factor, μ is bounded from above by the
        largest singular value after a diagonal scaling at each frequency, that of Perron's vectors [skogestad2005].
        """
        if not self.stable:
            return 0.0, np.nan
        s, m = self.linear.part("w", "u+w"), self.linear.b.shape[1]
        middle = s.changed(d=s.d - 0.5 * np.eye(m))

        def norms(w: np.ndarray) -> np.ndarray:
            return _scaled_norms(middle.response(w))

        peak, at = middle.norm() if m == 1 else highest_peak(norms, middle.frequencies())
        return 1.0 / peak, at

    disk_margin, disk_frequency = _pair(
        "_disk",
        "α, symmetric: the loop is stable with every input multiplied by its own complex factor "
        "(1 + δ/2)/(1 − δ/2), all |δ| < α at once [seiler2020]. The largest such α with one "
        "input; with several, a lower bound of it.",
        "Frequency where it is reached, rad/s.",
    )

    @property
    def disk_gain_margins(self) -> tuple[float, float]:
        """All inputs' gains may change at once, each by its own real factor between these: (2 ∓ α)/(2 ± α)."""
        a = self.disk_margin
        return (0.0, np.inf) if a >= 2.0 else ((2.0 - a) / (2.0 + a), (2.0 + a) / (2.0 - a))

    @property
    def disk_phase_margin(self) -> float:
        """All inputs' phases may change at once, each by up to 2 atan(α/2), rad."""
        return 2.0 * float(np.arctan(0.5 * self.disk_margin))

    @cached_property
    def _delay(self) -> tuple[float, float]:
        return delay_margin(self.linear)

    delay_margin_s, delay_frequency = _pair(
        "_delay",
        "Largest extra delay of all inputs together, beyond the loop's own, s, between samples "
        "too; infinite if no delay makes the loop unstable.",
        "Frequency at which the loop then oscillates, rad/s.",
    )

    def delay_margin_within(self, most: float) -> float:
        """The delay margin, s, or `most` where it is larger: for searches, by the poles of the loop with that delay.

        Where it is unstable, the edge is bisected to `COARSE`; a shorter delay that alone is unstable is not seen.
        """

        def stable(extra: float) -> bool:
            return self.linear.system(self.linear.delay + extra).stable

        low, high = 0.0, most
        if not self.stable or stable(most):
            return most if self.stable else 0.0
        while high - low > COARSE * most:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if stable(middle) else (low, middle)
        return low

    # Noise ------------------------------------------------------------------------------------------------
    @cached_property
    def noise_to_input(self) -> np.ndarray:
        """RMS of each input (m,) per RMS of white noise on one measurement (p,), (m, p); independent noises add in
        squares."""
        noise = self.linear.part("v", "u")
        return noise.rms() if self.stable else np.full(noise.d.shape, np.inf)

    def input_noise(self, deviations: np.ndarray) -> np.ndarray:
        """RMS of each input (m,) for measurement noises of these standard deviations (p,)."""
        noise = self.linear.part("v", "u")
        return noise.spread(deviations) if self.stable else np.full(len(noise.d), np.inf)

    @cached_property
    def peak_noise_to_input(self) -> float:
        """H∞ norm from measurement noise to the inputs."""
        return self.linear.part("v", "u").norm()[0]

    # What the loop does -----------------------------------------------------------------------------------
    positions = property(
        attrgetter("linear.names"), doc="Names of the commanded positions, in the order of `bandwidth` (q)."
    )

    @cached_property
    def bandwidth(self) -> np.ndarray:
        """Frequency (q,) at which a commanded position is followed 3 dB less than at ω = 0, rad/s; NaN where the
        command does not act, infinite if beyond half the sampling frequency."""
        if not self.stable or not self.positions:
            return np.full(len(self.positions), np.nan)
        system = self.linear.part("r", "q")
        grid = system.frequencies()

        def followed(w: np.ndarray) -> np.ndarray:
            return np.abs(np.diagonal(system.response(w), axis1=1, axis2=2))

        level = followed(np.zeros(1))[0] / np.sqrt(2.0)
        swept = followed(grid) - level
        rows, joints = sign_changes(swept)
        joints, first = np.unique(joints, return_index=True)  # rows are ascending
        bandwidth = np.where(level > 0.0, np.inf, np.nan)
        at = np.array(refined_crossings(lambda w: followed(w) - level, grid, swept, rows[first], joints))
        acts = level[joints] > 0.0
        bandwidth[joints[acts]] = at[acts]
        return bandwidth

    @property
    def slowest_bandwidth(self) -> float:
        """Bandwidth of the slowest position, rad/s; NaN if a command does not act, or the loop is unstable."""
        return float(self.bandwidth.min()) if len(self.bandwidth) else np.nan

    def compliance(self, top: float) -> float:
        """Peak of σ_max of |load torque → link position| up to a frequency (rad/s), rad/N·m or m/N."""
        m = self.linear.b.shape[1]
        return self._peak(slice(2 * m, None), slice(m, None), top)[0] if self.stable else np.inf

    damping, damping_frequency = _pair(
        "linear.closed_loop.damping",
        "Smallest damping ratio of all oscillations of the running loop (plant, estimator, delay), see "
        "`DiscreteSystem.damping`; negative for an unstable loop.",
        "|s| of that oscillation, rad/s.",
    )

    def damping_about(self, limit: float) -> tuple[float, float]:
        """Smallest damping ratio of slow oscillations and of fast ones, see `DiscreteSystem.damping_about`."""
        return self.linear.closed_loop.damping_about(limit)


def margins(
    loop: EquilibriumLoop | LinearLoop,
    values: ParameterValues | None = None,
    process_noise: np.ndarray | None = None,
) -> Margins:
    """Margins of a loop at its equilibrium.

    The loop's own delay counts in all margins; the delay margin is the delay that it tolerates in addition. `values`
    and `process_noise` are as for `EquilibriumLoop.linear`: one true plant, the nominal one by default, and R^v instead
    of the filter's; a NumericalFailure says that the loop has no equilibrium with this plant.
    """
    return Margins(loop if isinstance(loop, LinearLoop) else loop.linear(values, process_noise))


def _critical_factors(response: np.ndarray) -> np.ndarray:
    """k = −S_ii/T_ii (F, m), from (u + w, u) by w, (F, 2 m, m); u/w = S − 1 loses no digits of a small T."""
    m = response.shape[2]
    with np.errstate(all="ignore"):
        return np.diagonal(response[:, :m], axis1=1, axis2=2) / np.diagonal(response[:, m:], axis1=1, axis2=2)


def _gain_margins(
    factors: Callable[[np.ndarray], np.ndarray],
    grid: np.ndarray,
    swept: np.ndarray,
    top: float,
    accuracy: float,
) -> np.ndarray:
    """Largest real factor below one and smallest above, (m, 2), of `factors` k (F, m), complex, by frequency.

    `grid` and `swept` are frequencies (F,) and factors of a sweep, `top` is half the sampling frequency, rad/s, where k
    is real as it is at ω = 0, and the accuracy is that of the frequencies where k is real, relative. Of what is read
    off the sweep only factors that may be the closest to one on their side are refined.
    """
    rows, inputs = sign_changes(np.imag(swept))
    left, right = swept[rows, inputs], swept[rows + 1, inputs]
    with np.errstate(all="ignore"):
        part = np.imag(left) / (np.imag(left) - np.imag(right))
        about = np.log(np.real(left) + part * np.real(right - left))
    chosen, distance = np.zeros(len(about), dtype=bool), np.abs(about)
    for i in range(swept.shape[1]):
        for side in (-1.0, 1.0):
            own = (inputs == i) & (side * about > 0.0) & (distance <= np.log(LARGEST_FACTOR))
            chosen |= own & (distance <= distance[own].min(initial=np.inf) + np.log(REFINED_UP_TO))
    rows, inputs = rows[chosen], inputs[chosen]
    at = refined_crossings(lambda w: np.imag(factors(w)), grid, np.imag(swept), rows, inputs, accuracy)
    values = factors(np.array([*at, 0.0, top]))
    limits = np.full((swept.shape[1], 2), [0.0, np.inf])
    for i, own in enumerate(limits):
        k = np.concatenate([values[:-2][inputs == i, i], values[-2:, i]])
        with np.errstate(invalid="ignore"):
            real = np.real(k)[np.abs(np.imag(k)) <= max(1e-6, REAL * accuracy) * np.abs(k)]
        real = real[(real >= 1.0 / LARGEST_FACTOR) & (real <= LARGEST_FACTOR)]
        own[:] = real[real < 1.0].max(initial=0.0), real[real > 1.0].min(initial=np.inf)
    return limits


def _scaled_norms(matrices: np.ndarray) -> np.ndarray:
    """The smaller of σ_max(M) and σ_max(D M D⁻¹), D from Perron's vectors of |M|, for each of (F, m, m)."""
    sizes = np.abs(matrices) + 1e-12 * np.abs(matrices).max(axis=(1, 2), keepdims=True)
    right = left = np.ones(sizes.shape[:2])
    for _ in range(50):  # power iteration of positive matrices
        right, left = np.einsum("fij,fj->fi", sizes, right), np.einsum("fij,fi->fj", sizes, left)
        right, left = (v / v.max(axis=1, keepdims=True) for v in (right, left))
    scale = np.sqrt(left / right)
    scaled = scale[:, :, None] * matrices / scale[:, None, :]
    return np.minimum(*(np.linalg.norm(each, 2, axis=(1, 2)) for each in (matrices, scaled)))


#: Frequencies looked at, from this fraction of the law's bandwidth to half the sampling frequency, beside those of the
#: poles.
POINTS, BELOW = 80, 0.05


class FilteredLoop:
    """A loop as a function of its filter's gain; its sweep begins at a fraction of the law's bandwidth, rad/s."""

    def __init__(self, loop: EquilibriumLoop, bandwidth: float) -> None:
        self.loop, self.own = loop, loop.linear()
        self.grid = np.geomspace(BELOW * bandwidth, np.pi / loop.period, POINTS)
        own, (_, h), places = self.own, loop.model, loop.step.places
        gain = loop.gain(loop.filter.process_noise)
        innovation = np.hstack([np.zeros((len(h), len(own.memory))), np.eye(len(h))])
        innovation[:, places["belief"]], innovation[:, loop.step.acted] = -h, -own.d

        def split(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            moved = matrix[:, places["belief"]] @ np.linalg.inv(np.eye(h.shape[1]) - gain @ h)
            return matrix - moved @ gain @ innovation, moved

        #: (M(0), M_x) of memory and law, and the innovation (p, s + p) by the controller's memory and y.
        self._affine = split(own.memory), split(own.law), innovation

    def linear(self, gain: np.ndarray) -> LinearLoop:
        """The running loop with this gain (n, p)."""
        *parts, innovation = self._affine
        memory, law = (still + moved @ gain @ innovation for still, moved in parts)
        return replace(self.own, memory=memory, law=law)

    def margins(self, process_noise: np.ndarray) -> Margins:
        """With the stationary gain of this R^v (n, n), on a sweep with a point at every pole of the running loop; a
        NumericalFailure if there is no such gain in these numbers."""
        linear = self.linear(self.loop.gain(process_noise))
        poles = linear.closed_loop.poles
        near = np.abs(poles[np.imag(poles) >= 0.0])
        return Margins(linear, np.union1d(self.grid, near[(near > self.grid[0]) & (near < self.grid[-1])]))
