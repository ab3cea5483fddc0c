"""Noise levels of the estimator, searched for on the running loop.

With the true state fed back the law has wide margins; the estimator takes most of them away, and how much depends on
R^v alone (R^n is the sensors'). Noise on the motor's velocity, where the input acts, gives the margins back as it grows
(loop transfer recovery, [doyle1981]), at the price of noise at the motors; noise on the link's velocity makes the
estimator follow a load on the link.

The default levels (`EstimatorNoise.stated`) are kept where the running loop keeps every limit with them. Otherwise the
search looks at levels q on the motors' velocities and f·q on the links', from the default level up, and takes the first
q, and the f, with the least noise at the motors for which every limit is kept: peak sensitivity, gain margin, damping
where one is required, no unstable corner of the tolerances, and a load compliance of at most `COMPLIANCE` times that of
the law fed the true state. A limit that no levels keep is left out, so that no noise is paid for it in vain: the
default levels stay where they keep the others. Where the others cannot be kept together, those that miss them least.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.analysis import (
    EquilibriumLoop,
    FrequencyResponse,
    LinearLoop,
    corner_plants,
    frequency_response,
)
from flexhinf.analysis.margins import LARGEST_FACTOR
from flexhinf.design.estimators import EstimatorNoise
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.specification import TOLERANCE
from flexhinf.errors import FlexhinfError

__all__ = ["COMPLIANCE", "LIMITS", "NoiseCandidate", "NoiseSearch", "is_free", "search_noise"]

#: Levels on the motors' velocities that are tried, as multiples of R^n per s²: with R^n = 1e-8, 1e-7 to 1e-3. A slower
#: estimator than the default one takes dry friction for a slow motion.
LEVELS = tuple(10.0**k for k in range(1, 6))

#: Fractions of it on the links' velocities.
FRACTIONS = (1.0, 0.1, 0.03, 0.01, 0.0)

#: With more states each candidate takes seconds, and fewer are tried.
MANY_STATES, FEW_LEVELS, FEW_FRACTIONS = 15, (1e2, 1e4), (0.1, 0.01)

#: The first level that keeps the limits is refined by so many halvings of its exponent.
HALVINGS = 2

#: A gain margin and the inverse of a peak that stand for an unstable loop.
UNSTABLE = 1e-9

#: Largest peak of |load torque → link position|, over that of the law fed the true state; both up to so many times the
#: law's bandwidth, below the vibrations.
COMPLIANCE, COMPLIANT_BAND = 1.3, 5.0

#: What may limit the choice, beside unstable corners.
LIMITS = ("peak sensitivity", "gain margin", "damping", "compliance")

#: What a decade of noise at the motors counts, beside the limits that are missed, where no levels keep all of them.
NOISE_WEIGHT = 0.1


@dataclass(frozen=True)
class NoiseCandidate:
    """Levels that were tried, and the running loop with them.

    Attributes
    ----------
    levels : EstimatorNoise
    peak_sensitivity, gain_margin, damping : float
        Infinite, 0 and −1 for an unstable loop.
    compliance : float
        Peak of |load torque → link position| over that of the law fed the true state.
    input_noise : float
        RMS of the noisiest input, V or N·m.
    missed : mapping of str to float
        ln(figure/limit) of each of `LIMITS` that is missed by more than a requirement allows.
    unstable : int or None
        Corners of the tolerances; None without tolerances, and where a margin or the damping is missed: not looked at.
    """

    levels: EstimatorNoise
    peak_sensitivity: float
    gain_margin: float
    damping: float
    compliance: float
    input_noise: float
    missed: Mapping[str, float]
    unstable: int | None

    @property
    def feasible(self) -> bool:
        """Whether every limit is kept, with no unstable corner."""
        return not self.missed and not self.unstable


@dataclass(frozen=True)
class NoiseSearch:
    """The outcome, and the way to it.

    Attributes
    ----------
    chosen : NoiseCandidate
    candidates : tuple of NoiseCandidate
        In the order of the search.
    unreachable : tuple of str
        Those of `LIMITS` that no candidate keeps; they do not count in the choice.
    """

    chosen: NoiseCandidate
    candidates: tuple[NoiseCandidate, ...]
    unreachable: tuple[str, ...]


def is_free(setup: LoopSetup) -> bool:
    """Whether the noise levels are free to choose: no option states them, and a Kalman filter uses them."""
    s = setup.specification
    return s.estimator in ("ukf", "ekf") and s.process_noise is None and s.torque_noise is None


def search_noise(
    setup: LoopSetup, damping: float | None = None, progress: Callable[[str], None] = lambda text: None
) -> NoiseSearch | None:
    """The levels with the least noise at the motors that keep every limit, or those that miss the limits least.

    Parameters
    ----------
    setup : LoopSetup
        Its law about the goal; the linear part is all that matters.
    damping : float, optional
        Required of every oscillation of the running loop.
    progress : callable

    Returns
    -------
    NoiseSearch or None
        None where the levels are not free, or the loop has no equilibrium at the goal.
    """
    if not is_free(setup):
        return None
    search = _Search(setup, damping)
    try:
        search.run()
        found = search.choose()
    except FlexhinfError:
        return None
    progress(f"noise levels of the estimator: {len(found.candidates)} tried")
    return found


class _Search:
    """Candidates of one loop."""

    def __init__(self, setup: LoopSetup, damping: float | None) -> None:
        self.setup, self.damping = setup, damping
        self.loop: EquilibriumLoop = setup.equilibrium_loop()
        self.many = len(setup.linear_law.state_names) > MANY_STATES
        self.tried: list[NoiseCandidate] = []
        self.equilibria: np.ndarray | None = None
        fed_back = frequency_response(setup.equilibrium_loop(estimated=False))
        self.top = COMPLIANT_BAND * _bandwidth(fed_back)
        self.stiff = _compliance(fed_back, self.top)

    def run(self) -> None:
        """Levels from small to large until one keeps the limits, and then between it and the one before."""
        stated = EstimatorNoise.stated(self.setup.specification)
        if self.candidate(stated.motor_velocities, 1.0).feasible:
            return
        scale = self.setup.specification.measurement_noise
        levels = FEW_LEVELS if self.many else LEVELS
        fractions = FEW_FRACTIONS if self.many else FRACTIONS
        before = None
        for level in levels:
            here = [self.candidate(scale * level, fraction) for fraction in fractions]
            feasible = [c for c in here if c.feasible]
            if feasible:
                if before is not None and not self.many:
                    self.refine(before, scale * level, min(feasible, key=lambda c: c.input_noise))
                return
            before = scale * level

    def refine(self, low: float, high: float, best: NoiseCandidate) -> None:
        """Smaller levels of the same fraction."""
        fraction = best.levels.link_velocities / best.levels.motor_velocities
        for _ in range(HALVINGS):
            middle = float(np.sqrt(low * high))
            feasible = self.candidate(middle, fraction).feasible
            low, high = (low, middle) if feasible else (middle, high)

    def candidate(self, level: float, fraction: float) -> NoiseCandidate:
        """The running loop with these levels; the corners are looked at where it keeps its margins and damping."""
        s = self.setup.specification
        levels = EstimatorNoise(0.0, fraction * level, level, "searched on the running loop")
        process = levels.covariance(self.setup.model.states)
        found = _figures(self.loop.linear(process_noise=process), self.setup.noise, self.top)
        compliance = found.compliance / self.stiff
        ratios = (
            found.peak_sensitivity / s.peak_sensitivity_limit,
            s.gain_margin_limit / max(found.gain_margin, UNSTABLE),
            (self.damping or 0.0) / max(found.damping, UNSTABLE),
            compliance / COMPLIANCE,
        )
        missed = {
            limit: float(np.log(ratio))
            for limit, ratio in zip(LIMITS, ratios, strict=True)
            if ratio > 1.0 + 0.9 * TOLERANCE
        }
        candidate = NoiseCandidate(
            levels, found.peak_sensitivity, found.gain_margin, found.damping, compliance, found.input_noise,
            missed, self.unstable(process) if set(missed) <= {"compliance"} else None,
        )  # fmt: skip
        self.tried.append(candidate)
        return candidate

    def choose(self) -> NoiseSearch:
        """The best candidate; among limits that some candidate keeps."""
        unreachable = tuple(limit for limit in LIMITS if all(limit in c.missed for c in self.tried))
        left_out = {"compliance", *unreachable}
        tried = [self.looked_at(c) if set(c.missed) <= left_out else c for c in self.tried]
        chosen = min(tried, key=lambda c: self.score(c, unreachable))
        default = tried[0]
        if set(default.missed) <= set(unreachable) and not default.unstable:
            chosen = default
        return NoiseSearch(chosen, tuple(tried), unreachable)

    def looked_at(self, candidate: NoiseCandidate) -> NoiseCandidate:
        """The candidate with its unstable corners, also where it misses a limit."""
        if candidate.unstable is not None:
            return candidate
        process = candidate.levels.covariance(self.setup.model.states)
        return replace(candidate, unstable=self.unstable(process))

    def score(self, candidate: NoiseCandidate, unreachable: Sequence[str]) -> tuple[bool, float]:
        """What is minimised: the noise where everything that counts is kept, otherwise mainly what is missed."""
        missed = sum(excess for limit, excess in candidate.missed.items() if limit not in unreachable)
        if not missed and not candidate.unstable:
            return False, candidate.input_noise
        corners = len(self.corners) if self.setup.robot.uncertain else 1
        unstable = 1.0 if candidate.unstable is None else candidate.unstable / corners
        return True, missed + unstable + NOISE_WEIGHT * float(np.log10(max(candidate.input_noise, 1e-12)))

    def unstable(self, process: np.ndarray) -> int | None:
        """Unstable corners with this R^v (n, n); None without tolerances."""
        if not self.setup.robot.uncertain:
            return None
        modes = self.loop.modes(self.corners, process, self.equilibria)
        self.equilibria = modes.equilibrium
        return int((modes.rate >= 0.0).sum())

    @cached_property
    def corners(self) -> np.ndarray:
        """Parameter vectors (N, q) of the corners of the tolerances: those of `tolerance_corners`."""
        robot, table = self.setup.robot, self.loop.plant.parameters
        found, _ = corner_plants(self.loop, robot.corner, robot.uncertain)
        return self.loop.vectors([table.known(values) for values in found.values[:-1]])


@dataclass(frozen=True)
class _Figures:
    """Of one linear loop, on a grid of frequencies with points round every pole: near those of `margins`."""

    peak_sensitivity: float
    gain_margin: float
    damping: float
    compliance: float
    input_noise: float


def _bandwidth(response: FrequencyResponse) -> float:
    """Of the fastest joint, rad/s: where |command → position| is 3 dB below its value at the lowest frequency."""
    followed = np.abs(np.diagonal(response.command, axis1=1, axis2=2))
    below = followed < followed[0] / np.sqrt(2.0)
    first = np.where(below.any(axis=0), below.argmax(axis=0), len(below) - 1)
    return float(response.frequencies[first.max()])


def _figures(linear: LinearLoop, noise: np.ndarray | None, top: float) -> _Figures:
    if not linear.running.stable:
        return _Figures(1.0 / UNSTABLE, UNSTABLE, -1.0, 1.0 / UNSTABLE, np.inf)
    response = frequency_response(linear)
    rms = linear.part("v", "u").rms() * (0.0 if noise is None else noise)
    return _Figures(
        response.peaks[0],
        _gain_margin(response.input_loops),
        linear.running.damping[0],
        _compliance(response, top),
        float(np.linalg.norm(rms, axis=1).max()),
    )


def _gain_margin(loops: np.ndarray) -> float:
    """Smallest factor by which the gain of one input may rise or fall, infinite beyond `LARGEST_FACTOR`: where L_i
    (F, m) crosses the negative axis."""
    found = np.inf
    for loop in loops.T:
        before, after = loop[:-1], loop[1:]
        crosses = np.flatnonzero((before.imag * after.imag <= 0.0) & (before.real + after.real < 0.0))
        for k in crosses:
            weight = (
                before[k].imag / (before[k].imag - after[k].imag) if before[k].imag != after[k].imag else 0.0
            )
            at = abs(before[k].real + weight * (after[k].real - before[k].real))
            found = min(found, max(at, 1.0 / at) if at > 0.0 else np.inf)
    return float(found) if found <= LARGEST_FACTOR else np.inf


def _compliance(response: FrequencyResponse, top: float) -> float:
    """Peak of |load torque → link position| up to a frequency, rad/N·m or m/N."""
    torques = [k for k, name in enumerate(response.disturbances) if name.startswith("link_torque")]
    band = response.disturbance[response.frequencies <= top][:, :, torques]
    return float(np.linalg.norm(band, 2, axis=(1, 2)).max())
