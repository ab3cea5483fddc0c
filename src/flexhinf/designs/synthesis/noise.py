"""Noise levels of the estimator, searched for on the running loop.

The running loop has the poles of the law and of the estimation error, and the least damped of them decides how it
rings. How much of the law's margins and damping remains depends on R^v alone: R^n is given by the sensors. For a joint
of inertias M and J, whose vibration has the frequency ω_v and is seen by a position with variance R, noise of variance
q per sample on a velocity gives the error's vibration the damping

    ζ = sin(½ atan(ρ/ω_v²)),   ρ = a √(q/R) / T,

a = J/(M + J) for the link's position, M/(M + J) for the motor's, 1 for the torque between them. So levels are counted
in units of the q with which ρ = ω_v², joint by joint: one level for all joints that damps the lightest link's vibration
would make the heaviest joint's estimator needlessly fast, and one that suits the heavy joint leaves the light one
ringing. Assumed noise at the inputs restores margins too (loop transfer recovery, [doyle1981]); the estimator must then
be faster than the bandwidth at every joint. So the search tries two families first: the same speed relative to each
joint's vibration, and the same speed at all joints. Each family is tried with several ratios of the links' to the
motors' levels. From the best of them the levels of single joints are moved one after the other.

What is searched for is the least noise at the motors (the geometric mean, since motors differ in size) for which every
limit is kept, see docs/real_loop.md. The default levels are used if they keep all limits. If no levels keep all limits,
the search takes the levels with the smallest total excess. A limit may be out of reach, because the law fails it with
the true state or all levels of the families do. It is then relaxed to nearly the best value of the families, and a
damping far out of reach to `RINGS`, so that no noise is spent in vain.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.analysis import (
    EquilibriumLoop,
    FilteredLoop,
    Judgement,
    Margins,
    corner_plants,
    margins,
    minimise,
    modes,
)
from flexhinf.analysis.optimiser import PENALTY
from flexhinf.copies import shared_out
from flexhinf.designs.estimators import is_kalman
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.noise_levels import EstimatorNoise
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.specification import RINGS
from flexhinf.errors import FlexhinfError, NumericalFailure
from flexhinf.plant.instruments import sensor_of
from flexhinf.robot.arm import payload_ends

#: Limits of the choice, besides unstable corners.
LIMITS = ("peak sensitivity", "gain margin", "delay margin", "damping", "compliance", "noise")

#: Relative weight of the noise limit: a loop that rings or has no margin is worse than a noisy one. With limited motor
#: effort the noise limit weighs more than all others: noise uses effort that the step needs.
NOISE_COUNTS, LIMITED_COUNTS = 0.25, 4.0


@dataclass(frozen=True, eq=False)
class NoiseCandidate:
    """Noise levels that were tried, and metrics of the running loop with them."""

    levels: EstimatorNoise
    peak_sensitivity: float
    gain_margin: float
    damping: float
    compliance: float  # peak of |load torque → link position| over that of the law fed the true state
    noises: np.ndarray  # (m,), RMS of each input, V or N·m
    missed: Mapping[str, float]  # ln(metric/limit) of each of `LIMITS` that is missed beyond the tolerance
    avoidable: Mapping[str, float]  # the same beyond what the law or every candidate of the families misses
    unstable: int | None = None  # corners of the tolerances; None where there are none, or none were computed
    noise_counts: float = NOISE_COUNTS  # weight of the limit of the noise beside the others

    @property
    def input_noise(self) -> float:
        """RMS of the noisiest input, V or N·m."""
        return float(self.noises.max())

    @property
    def feasible(self) -> bool:
        """Whether every limit that can be kept is kept, with no unstable corner."""
        return not self.avoidable and not self.unstable

    def judgement(self, of_laws: bool = False) -> Judgement:
        """Mean decades of noise, and the weighted excesses over the limits: of candidates of different laws (`of_laws`)
        every excess, otherwise only the avoidable part."""
        counted = (self.missed if of_laws else self.avoidable).items()
        limits = {what: beyond * (self.noise_counts if what == "noise" else 1.0) for what, beyond in counted}
        return Judgement(float(np.log10(np.maximum(self.noises, 1e-300)).mean()), limits, self)


@dataclass(frozen=True, eq=False)
class NoiseSearch:
    """The chosen noise levels, and the trade-off around them."""

    chosen: NoiseCandidate
    default: NoiseCandidate | None  # the default levels; None where the loop is unstable with them
    trade_off: tuple[NoiseCandidate, ...]  # not bettered in noise, damping and compliance; the quietest first
    count: int  # candidates with a stable loop
    unreachable: tuple[str, ...]  # limits that the law misses with the true state too, or with all levels


#: Speeds of the estimator in the first family: ρ/ω_v² of every joint. In the second: √ρ over the slowest vibration, at
#: least so much of the joint's own.
SPEEDS = (0.1, 0.3, 1.0, 3.0, 10.0, 100.0)
RATES, FLOORS = (1.0, 2.0, 4.0, 8.0), (0.2, 0.5)

#: Ratios of the unmeasured side's levels (link or motor) to the measured side's, tried in both families.
FRACTIONS = (1.0, 0.1, 0.01)

#: The ratios for up to so many joints, whose candidates cost a few milliseconds.
FEW, MORE_FRACTIONS = 2, (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4)

#: Smallest level on a motor's velocity, as a multiple of R^n per s². A slower estimator takes dry friction for a slow
#: motion.
SLOWEST = 10.0

#: Range of ρ/ω_v² of a single level.
MIN_LEVEL, MAX_LEVEL = 1e-4, 1e4

#: Candidates of the search per level.
TRIED = 12

#: Factors on all chosen levels, evaluated for the trade-off.
SCALED = tuple(10.0 ** (k / 4.0) for k in range(-8, 7))

#: Largest peak of |load torque → link position|, as a multiple of the peak with the true state fed back; and the upper
#: end of the frequencies, as a multiple of the law's bandwidth, below the vibrations.
COMPLIANCE, COMPLIANT_BAND = 1.3, 5.0

#: Share of the required ripple that noise may take: the deviation over a run's last 0.3 s scatters by a tenth.
SCATTER = 0.9

#: Largest RMS noise of a motor input, as a fraction of the motor's available input (`authority`).
MOST_NOISE = 0.1

#: A limit out of reach is relaxed to the best excess of the families plus the first number (in ln); a damping whose
#: excess is larger than the second number is relaxed to `RINGS`.
SHORT_OF_BEST, FAR = 0.05, 0.2

#: An excess (in ln) of the families below this number may be removed by single levels.
NEAR = 0.1

#: Number of candidates whose corners are evaluated when no levels make all corners stable.
LOOKED = 24

#: Smallest gain margin and damping that are divided by, and smallest delay margin, samples.
NOTHING, NO_DELAY = 1e-9, 0.05


def search_noise(
    setup: LoopSetup,
    damping: float | None = None,
    progress: Callable[[str], None] = lambda text: None,
    levels: EstimatorNoise | None = None,
) -> NoiseSearch | None:
    """The levels with the least noise at the motors that keep every limit, or those that miss the limits least.

    Only the linear part of the law at the goal matters. `damping` is required of every oscillation of the running loop.
    `levels` from another search are used instead of the result; the trade-off is still that of this search. Returns
    None if the levels are stated, no Kalman filter uses them, the loop has no equilibrium at the goal, or no levels
    make it stable.
    """
    s = setup.specification
    if not is_kalman(s) or s.process_noise is not None or s.torque_noise is not None:
        return None
    try:
        search = _LevelSearch(setup, damping)
        result, own = search.run(), None if levels is None else search.candidate(levels)
    except FlexhinfError:
        return None
    if result is not None:
        progress(f"noise levels of the estimator: {result.count} tried")
    return result if result is None or own is None else replace(result, chosen=search.with_corners(own))


def _order(candidate: NoiseCandidate) -> tuple[float, float]:
    return candidate.judgement().order


class _LevelSearch:
    """Candidates of one loop; levels are x = log10(ρ/ω_v²), links before motors, (2 joints,)."""

    def __init__(self, setup: LoopSetup, damping: float | None) -> None:
        self.setup, self.damping, s, robot = setup, damping or 0.0, setup.specification, setup.true.robot
        self.loop: EquilibriumLoop = setup.equilibrium_loop()
        law = margins(setup.equilibrium_loop(estimated=False))
        followed = law.bandwidth[np.isfinite(law.bandwidth)]
        if not law.stable or not len(followed):
            raise NumericalFailure(
                "The loop that is fed back the true state follows no command.",
                f"expected a stable loop with a bandwidth, got {law.bandwidth.tolist()} rad/s",
                "another period, or other weights",
            )
        bandwidth = float(followed.max())
        self.top, self.filtered = COMPLIANT_BAND * bandwidth, FilteredLoop(self.loop, bandwidth)
        self.loaded = [
            FilteredLoop(
                setup.equilibrium_loop(values=robot.plant_parameters({**robot.nominal, **masses})), bandwidth
            )
            for masses in (payload_ends(robot.uncertain) if damping else ())
        ]
        self.stiff = law.compliance(self.top)
        self.scales = scales = modes.JointScales.of(setup.model, setup.goal_equilibrium)
        self.delay_margin = s.period * s.limit("delay_margin")  # s
        self.unavoidable = self.excess(law.peak_sensitivity, law.gain_margin, np.inf, law.damping)
        # q (n,) with which ρ = ω_v² for a position that sees the whole vibration, (rad/s)² or (m/s)² per sample.
        self.unit = setup.position_noise * (s.period * scales.vibration**2) ** 2
        # Available input of each motor (m,), V or N·m: its effort limit, and at most the largest input that any motor
        # needs to hold the robot and to make the step within the law's bandwidth.
        holding_input = np.max(
            [np.abs(robot.operating_point(at)[1]) for at in (setup.start, setup.goal)], axis=0
        )
        moved = scales.input_per_position(bandwidth) * np.abs(setup.goal - setup.start)
        self.authority = np.minimum(float((holding_input + moved).max()), setup.limits.effort)
        ripple = SCATTER * 0.01 * (s.limit("ripple")) * setup.limits.effort
        self.loudest = np.minimum(MOST_NOISE * self.authority, ripple)  # RMS noise of each input (m,)
        self.tried: list[NoiseCandidate] = []
        self.equilibria: np.ndarray | None = None

    def run(self) -> NoiseSearch | None:
        default = self.noted(self.candidate(EstimatorNoise.stated(self.setup.specification)))
        begun = self.all_at([*self.families()])
        if not begun:
            return None
        # A limit that every candidate so far, or the law itself, fails is relaxed; see the head of this file.
        for limit in LIMITS:
            least = max(self.unavoidable.get(limit, 0.0), min(c.missed.get(limit, 0.0) for c in self.tried))
            if least > NEAR:
                enough = (
                    float(np.log(self.damping / RINGS)) if limit == "damping" and least > FAR else -np.inf
                )
                self.unavoidable[limit] = max(least + SHORT_OF_BEST, enough)
        default = default and self.counted(default)
        chosen = self.with_corners(default) if default and not default.avoidable else None
        if chosen is None or not chosen.feasible:
            first = min(map(self.counted, begun), key=_order)
            start = {str(k): 10.0**x for k, x in enumerate(self.place(first.levels).tolist())}
            bounds = dict.fromkeys(start, (MIN_LEVEL, MAX_LEVEL))
            search = minimise(self.judge, start, bounds, TRIED * len(start))
            chosen = self.stable([candidate.judgement.result for candidate in search.path])
        if chosen.unstable:
            # No levels make every corner stable: the best of some candidates. The fraction of unstable corners counts
            # as an excess, in ln.
            ordered = sorted(map(self.counted, self.tried), key=_order)
            looked = ordered[:: max(1, len(ordered) // LOOKED)]
            checked = [chosen, *shared_out(self.with_corners, looked, compiles=False)]
            count = max(1, len(self.corners))
            chosen = min(checked, key=lambda c: c.judgement().merit + PENALTY * (c.unstable or 0) / count)
        self.all_at([self.place(chosen.levels) + np.log10(factor) for factor in SCALED])
        # Metrics of the choice by a dense frequency sweep, as the evaluation of the design computes them.
        exact = Margins(self.filtered.margins(chosen.levels.covariance(self.setup.model.states)).linear)
        chosen = replace(
            chosen,
            peak_sensitivity=exact.peak_sensitivity,
            gain_margin=exact.gain_margin,
            compliance=exact.compliance(self.top) / self.stiff,
        )
        # The Pareto front of noise, damping and compliance, by rising noise.
        metrics = np.array([[each.input_noise, -each.damping, each.compliance] for each in self.tried])
        front = [
            candidate
            for k, (candidate, own) in enumerate(zip(self.tried, metrics))
            if not (np.all(metrics <= own, axis=1) & np.any(metrics < own, axis=1)).any()
            and not any(np.array_equal(own, before) for before in metrics[:k])
        ]
        trade_off = tuple(sorted(front, key=lambda candidate: candidate.input_noise))
        return NoiseSearch(chosen, default, trade_off, len(self.tried), tuple(self.unavoidable))

    def counted(self, candidate: NoiseCandidate) -> NoiseCandidate:
        left = {name: excess - self.unavoidable.get(name, 0.0) for name, excess in candidate.missed.items()}
        least = np.log1p(0.5 * TOLERANCE)
        return replace(candidate, avoidable={name: excess for name, excess in left.items() if excess > least})

    def families(self) -> Iterator[np.ndarray]:
        slowest, vibration = self.scales.vibration.min(), self.scales.vibration
        every = [np.full(len(vibration), speed) for speed in SPEEDS]
        every += [np.maximum((rate * slowest / vibration) ** 2, floor) for rate in RATES for floor in FLOORS]
        link, motor = self.scales.split_inertia
        kinds = [kind for kind in map(sensor_of, self.setup.model.outputs) if kind is not None]
        force = any(kind.force for kind in kinds)
        seen = motor if force or any(kind.side == "link" for kind in kinds) else link
        share = np.ones(len(link)) if force else seen / (link + motor)
        # The unmeasured side disturbs the measured one less than a torque on the latter would.
        less = np.minimum(1.0, seen / (link + motor - seen))
        for speed in every:
            for fraction in MORE_FRACTIONS if len(link) <= FEW else FRACTIONS:
                here, there = np.log10(speed / share), np.log10(speed / share * less * np.sqrt(fraction))
                yield np.concatenate([here, there] if seen is link else [there, here])

    def all_at(self, places: Sequence[np.ndarray]) -> list[NoiseCandidate]:
        """The candidates of these x (2 joints,) on all processors, without those of unstable loops."""
        return list(filter(None, map(self.noted, shared_out(self.judged, places))))

    def at(self, x: np.ndarray) -> NoiseCandidate | None:
        """The candidate of x (2 joints,), which is noted as tried; None for an unstable loop."""
        return self.noted(self.judged(x))

    def noted(self, candidate: NoiseCandidate | None) -> NoiseCandidate | None:
        """The same candidate, which is one of the tried if there is one."""
        self.tried += filter(None, [candidate])
        return candidate

    def judged(self, x: np.ndarray) -> NoiseCandidate | None:
        """The candidate of x (2 joints,); None for an unstable loop."""
        n, x = len(self.unit), np.clip(x, np.log10(MIN_LEVEL), np.log10(MAX_LEVEL))
        levels = np.tile(self.unit, 2) * 100.0**x
        levels[n:] = np.maximum(levels[n:], SLOWEST * self.setup.position_noise)
        link, motor = (float(s[0]) if n == 1 else tuple(s.tolist()) for s in (levels[:n], levels[n:]))
        return self.candidate(EstimatorNoise(0.0, link, motor, "searched on the running loop"))

    def candidate(self, levels: EstimatorNoise) -> NoiseCandidate | None:
        process = levels.covariance(self.setup.model.states)
        try:
            loop = self.filtered.margins(process)
        except FlexhinfError:
            return None
        if not loop.stable:
            return None
        assert self.setup.noise is not None
        compliance, noises = loop.compliance(self.top) / self.stiff, loop.input_noise(self.setup.noise)
        # With the payloads at the ends of their ranges the loop must not ring.
        loaded = [each.margins(process) for each in self.loaded]
        ringing = min((each.damping if each.stable else 0.0 for each in loaded), default=np.inf)
        missed = self.excess(
            loop.peak_sensitivity,
            loop.gain_margin,
            loop.delay_margin_within(self.delay_margin),
            min(loop.damping, ringing * max(1.0, self.damping / RINGS)),
            compliance / COMPLIANCE,
            float((noises / self.loudest).max()),
        )
        return self.counted(
            NoiseCandidate(
                levels,
                loop.peak_sensitivity,
                loop.gain_margin,
                loop.damping,
                compliance,
                noises,
                missed,
                missed,
                noise_counts=LIMITED_COUNTS if np.isfinite(self.setup.limits.effort).any() else NOISE_COUNTS,
            )
        )

    def excess(
        self, sensitivity: float, gain_margin: float, delay: float, damping: float, *others: float
    ) -> dict[str, float]:
        """ln(metric/limit) of each limit that fails; `others` are the ratios metric/limit of compliance and noise."""
        s = self.setup.specification
        ratios = (
            sensitivity / s.limit("peak_sensitivity"),
            s.limit("gain_margin") / max(gain_margin, NOTHING),
            self.delay_margin / max(delay, NO_DELAY * s.period),
            (1.0 + 0.5 * TOLERANCE) * self.damping / max(damping, NOTHING),  # aimed at without allowance
            *others,
        )
        return {limit: float(np.log(r)) for limit, r in zip(LIMITS, ratios) if r > 1.0 + 0.5 * TOLERANCE}

    def place(self, levels: EstimatorNoise) -> np.ndarray:
        """x (2 joints,) of noise levels, within its range."""
        velocities = levels.link_velocities, levels.motor_velocities
        both = np.concatenate([np.broadcast_to(each, len(self.unit)) for each in velocities])
        x = 0.5 * np.log10(np.maximum(both, 1e-300) / np.tile(self.unit, 2))
        return np.clip(x, np.log10(MIN_LEVEL), np.log10(MAX_LEVEL))

    def judge(self, values: Mapping[str, float]) -> Judgement:
        candidate = self.at(np.log10(list(values.values())))
        return Judgement(np.inf) if candidate is None else candidate.judgement()

    def stable(self, path: list[NoiseCandidate]) -> NoiseCandidate:
        """The last candidate of a path without unstable corners, by bisection; that with the fewest if none is."""
        checked = list[NoiseCandidate]()

        def unstable(candidate: NoiseCandidate) -> bool:
            checked.append(self.with_corners(candidate))
            return bool(checked[-1].unstable)

        if unstable(path[-1]):
            bisect_left(path, True, key=unstable)
        return min(checked, key=lambda candidate: (candidate.unstable or 0, *_order(candidate)))

    def with_corners(self, candidate: NoiseCandidate) -> NoiseCandidate:
        if not self.setup.robot.uncertain:
            return candidate
        growth = self.loop.modes(
            self.corners, candidate.levels.covariance(self.setup.model.states), self.equilibria
        )
        if self.equilibria is None:  # others begin there, in whatever order they are looked at
            self.equilibria = growth.equilibrium
        return replace(candidate, unstable=int((growth.rate >= 0.0).sum()))

    @cached_property
    def corners(self) -> np.ndarray:
        robot, table = self.setup.true.robot, self.loop.plant.parameters
        population, _ = corner_plants(self.loop.states, robot.corner, robot.uncertain)
        return table.vectors([table.known(values) for values in population.values[:-1]])
