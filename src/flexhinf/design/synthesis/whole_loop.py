"""The preset `robust`: weights and noise levels for the tolerances, searched on the whole loop with its estimator.

The channels of the tolerances see the law alone: with the true state fed back they bound its gain, and with the
estimator in the loop they may make it worse. So the final decision uses the closed loop with its estimator. From the
weights of the preset `damped` with its noise levels, and from those whose channels cover all tolerances, factors are
searched (the scalings of a μ-synthesis, with the fraction of the tolerances that the channels stand for) on

    ω and ζ of all joints, the noise levels of links and of motors, the fraction of the tolerances in the channels

for the largest factor of all tolerances up to which no corner of them is unstable, under these conditions: the worst
overshoot of the corners is at most that with `damped`, and clearly less where a candidate has that too; peak
sensitivity, gain margin, damping, bandwidth, and the joints' limits in the step are kept, or missed by no more than
with `damped`; and each motor has at most `NOISE` times its noise. `damped` itself is the first candidate, so by this
criterion the outcome cannot be worse.

A candidate is computed at few corners: those that are nearest to instability or overshoot most. One that would be the
best is computed at all, and those that it fails on join them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexhinf.analysis import EquilibriumLoop, Margins, ToleranceBox, margins
from flexhinf.design.loop_setup import EstimatorNoise, LoopPlants
from flexhinf.design.problem.presets import DesignProblem, required_damping
from flexhinf.design.problem.weights import Candidate, SearchResult, behaviour_of
from flexhinf.design.requirements import sampled_runs
from flexhinf.design.responses import run_length
from flexhinf.design.synthesis.by_step import Task
from flexhinf.errors import FlexhinfError

#: Most noise of a motor, over that with the preset damped.
NOISE = 3.0

#: Largest factor of the tolerances that is looked for, and to what it is found.
MOST, WIDTH = 16.0, 0.01

#: Candidates, and corners that step in each, for up to so many states: a step of many joints takes its time.
CANDIDATES = ((10, 45, 12), (15, 60, 12), (10_000, 25, 4))

#: Corners nearest to instability that are looked at from the beginning; corners that join at once.
NEAREST, JOIN = 12, 4

#: Corners at which the outcome steps, at most: as many of the preset damped, for the comparison.
STEPPED = 200

#: First moves of ln ω, ln ζ, ln of both noise levels, and of the fraction of the tolerances in the channels.
MOVES = (-0.1, 0.4, 1.0, 1.0, 0.3)

#: Worst overshoot that is preferred, over that of `damped`: corners that are not stepped differ by a few per cent; and
#: how many of the best candidates step at all corners.
LESS, CONFIRMED = 0.95, 5

#: What a condition that is missed by e to this power costs, in powers of e of the factor; allowance for rounding; and
#: the cost of a candidate without a stable loop.
MISSED, ALLOWED, NOTHING = 20.0, 2e-3, 10.0

#: The fraction of the tolerances in the channels is at least this: less does nothing.
LEAST_FRACTION = 0.01

#: The length of a step is that for this fraction of the bandwidth as its slowest rate.
SLOWEST = 0.5


@dataclass(frozen=True, eq=False)
class LoopCandidate:
    """A problem with the noise levels of its estimator, and its loop as the search judges it."""

    x: np.ndarray  # (5,), ln of ω, ζ, link and motor levels over those of damped; fraction
    solved: DesignProblem
    levels: EstimatorNoise | None
    scale: float  # factor of all tolerances at which the first corner is unstable, at most `MOST`
    corner: int  # that corner, of the corners of `tolerance_corners`; −1 for none
    overshoot: float  # largest of all joints and of the corners that stepped, per cent
    margins: Margins
    noises: np.ndarray  # (m,), RMS of each input, V or N·m; zeros with the true state fed back
    used: float  # largest share of a limit of input or speed that a step used; 0 without limits


@dataclass(frozen=True, eq=False)
class WholeLoopSearch:
    """Result of the search, and the preset `damped` that it began with.

    `frequency`, `damping`, `links` and `motors` are factors of ω, of ζ and of the noise levels, over those of `damped`.
    """

    damped: LoopCandidate
    chosen: LoopCandidate  # that of `damped` where nothing is better
    frequency: float
    damping: float
    links: float
    motors: float
    fraction: float  # of what the channels can cover
    count: int  # candidates
    corner: str  # the corner at which the loop becomes unstable first, by its changes

    @property
    def better(self) -> bool:
        """Whether any candidate was better than `damped`."""
        return self.chosen is not self.damped


def search_whole_loop(
    task: Task, damped: DesignProblem, robust: DesignProblem, levels: EstimatorNoise | None, degree: int
) -> tuple[DesignProblem, EstimatorNoise | None, WholeLoopSearch]:
    """The problem of the preset robust, its noise levels, and how they were found.

    `damped` is of the preset damped, with these `levels` (None where they are not free); the channels of `robust`
    stand for the tolerances with the true state fed back; the law that steps at the corners has V of the `degree`.
    """
    search = _Search(task, damped, robust, levels, degree)
    best = search.run()
    task.progress(f"weights and noise levels for the tolerances: {search.count} loops tried")
    factors = dict(zip(("frequency", "damping", "links", "motors"), np.exp(best.x[:4]).tolist()))
    outcome = WholeLoopSearch(
        search.own, best, **factors, fraction=search.settings(best.x)[2], count=search.count,
        corner="" if best.corner < 0 else search.box.population.describe(best.corner),
    )  # fmt: skip
    if best is search.own:
        return replace(damped, preset="robust"), levels, outcome
    channels, (frequency, damping, fraction) = search.channels, search.settings(best.x)
    design = channels.design(best.solved, frequency, damping, fraction)
    chosen = Candidate(frequency, damping, design, behaviour_of(channels.family, design.gain))
    assert damped.search
    result = SearchResult(chosen, (*damped.search.candidates, chosen))
    source = (
        f"searched on the running loop: its corners are stable up to {best.scale:.3g} times the tolerances, "
        f"{search.own.scale:.3g} with the preset damped"
    )
    return channels.checked(best.solved, fraction, search.target, result, source), best.levels, outcome


class _Search:
    def __init__(
        self,
        task: Task,
        damped: DesignProblem,
        robust: DesignProblem,
        levels: EstimatorNoise | None,
        degree: int,
    ) -> None:
        assert damped.search is not None
        assert damped.target is not None
        assert robust.channels is not None
        assert robust.search is not None
        self.task, self.noise = task, LoopPlants(task.robot, task.s).noise
        self.target, self.first = damped.target, damped.search.chosen
        self.channels, self.robust = robust.channels, robust.search.chosen
        self.levels, self.degree, self.count = levels, degree, 0
        states = len(damped.problem.state_names)
        self.most, stepping = next((count, few) for most, count, few in CANDIDATES if states <= most)
        self.duration = run_length(SLOWEST * float(np.min(self.target.bandwidth)))
        # What `damped` comes to, and the corners at which candidates are computed.
        loop = self.loop(damped, levels)
        self.box = ToleranceBox.of(loop, task.robot.corner, task.robot.uncertain)
        every = np.arange(len(self.box))
        scale, corner = self.edge(loop)
        nearest = self.box.unstable(loop, 1.1 * scale)[:NEAREST] if corner >= 0 else every[:0]
        places = every if len(every) <= STEPPED else np.linspace(0, len(every) - 1, STEPPED).astype(int)
        self.compared = np.unique(np.concatenate([places, nearest]))
        overshoots, used = self.stepped(damped, levels, self.compared)
        worst = self.compared[np.argsort(-overshoots, kind="stable")]
        self.stepping_at = worst[:stepping]
        self.active = np.unique(np.concatenate([nearest, worst[:JOIN]]))
        loop_margins = margins(loop)
        self.own = LoopCandidate(
            np.zeros(5),
            damped,
            levels,
            scale,
            corner,
            float(overshoots.max()),
            loop_margins,
            self.noises(loop_margins),
            used,
        )
        self.kept = [(0.0, self.own)]

    def run(self) -> LoopCandidate:
        """The best candidate that overshoots clearly less than `damped` at all corners at which that stepped; else the
        best that does not overshoot more; else `damped`."""
        from scipy.optimize import minimize

        # The weights whose channels cover the tolerances are the second start.
        frequency = np.log(self.robust.target_frequency / self.first.target_frequency).mean()
        ratio = np.maximum(self.robust.damping_weights, 1e-3) / np.maximum(self.first.damping_weights, 1e-3)
        starts = [
            np.array([0.0, 0.0, 0.0, 0.0, LEAST_FRACTION]),
            np.array([frequency, float(np.clip(np.log(ratio).mean(), -1.0, 1.0)), 0.0, 0.0, 1.0]),
        ]
        free = np.array([True, True, *(2 * [self.levels is not None]), True])
        x = starts[int(np.argmin([self.cost(each) for each in starts]))].copy()
        moves = np.array(MOVES) * (1.0, 1.0, 1.0, 1.0, -1.0 if x[4] > 0.5 else 1.0)

        def moved(part: np.ndarray) -> float:
            whole = x.copy()
            whole[free] = part
            return self.cost(whole)

        simplex = np.vstack([x[free], x[free] + np.diag(moves[free])])
        minimize(
            moved, x[free], method="Nelder-Mead",
            options={"maxfev": self.most, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3},
        )  # fmt: skip
        second = None
        best = self.kept[-CONFIRMED:] if len(self.kept) > CONFIRMED else self.kept[1:]
        for _, candidate in reversed(best):
            overshoots, used = self.stepped(candidate.solved, candidate.levels, self.compared)
            candidate = replace(candidate, overshoot=float(overshoots.max()), used=used)
            if self.missed_in_steps(candidate) > ALLOWED:
                continue
            if candidate.overshoot <= LESS * self.own.overshoot:
                return candidate
            second = second or candidate
        return second or self.own

    def cost(self, x: np.ndarray) -> float:
        """ln of the factor of `damped` over the candidate's, and a penalty on missed conditions."""
        self.count += 1
        try:
            problem = self.channels.problem(*self.settings(x), 1e-4)
            levels = self.levels
            if levels is not None:
                links, motors = np.exp(x[2:4]).tolist()
                levels = levels.scaled(links, motors / links, "searched on the running loop")
            loop = self.loop(problem, levels)
            scale, corner = self.edge(loop, self.active)
            if scale <= 0.0:
                return NOTHING
            gained, best = -np.log(scale / self.own.scale), self.kept[-1][0]
            if gained > best + 0.2:  # conditions can only add to it
                return gained
            loop_margins = margins(loop)
            missed = self.missed(loop_margins)
            if MISSED * missed + gained < best + 0.1:
                overshoots, used = self.stepped(problem, levels, self.stepping_at)
                judged = LoopCandidate(
                    x.copy(), problem, levels, scale, corner, float(overshoots.max()), loop_margins,
                    self.noises(loop_margins), used,
                )  # fmt: skip
                missed += self.missed_in_steps(judged)
                if MISSED * missed + gained < best and missed <= ALLOWED:
                    # By the factor of all corners; those that were missing are computed from now on.
                    beyond = self.box.unstable(loop, (1.0 - WIDTH) * scale)
                    if len(beyond):
                        self.active = np.union1d(self.active, beyond[:JOIN])
                        scale, corner = self.edge(loop, beyond)
                        judged = replace(judged, scale=scale, corner=corner)
                    gained = -np.log(judged.scale / self.own.scale)
                    if gained < best:
                        self.kept.append((gained, judged))
        except FlexhinfError:
            return NOTHING
        return float(gained + MISSED * missed)

    def settings(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """ω and ζ (n,), and the fraction of what the channels can cover, of x (5,)."""
        frequency, damping = (
            self.first.target_frequency * np.exp(x[0]),
            self.first.damping_weights * np.exp(x[1]),
        )
        return frequency, damping, float(np.clip(x[4], LEAST_FRACTION, 1.0))

    def loop(self, solved: DesignProblem, levels: EstimatorNoise | None) -> EquilibriumLoop:
        setup = self.task.solved(solved.problem, solved.gamma, 2, levels)
        return setup.equilibrium_loop(estimated=self.task.s.estimator != "none")

    def edge(self, loop: EquilibriumLoop, which: np.ndarray | None = None) -> tuple[float, int]:
        """Factor of the tolerances at which one of some corners (all by default) is unstable, and which."""
        scale, corner = self.box.edge(loop, which, most=MOST, width=WIDTH)
        return min(scale, MOST), corner

    def stepped(
        self, solved: DesignProblem, levels: EstimatorNoise | None, which: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Overshoot (N,) of the step at corners, and the largest share of a limit that a step used."""
        setup = self.task.solved(solved.problem, solved.gamma, self.degree, levels)
        duration, limits = self.duration + setup.command_time, setup.limits
        nominal = setup.step(duration)
        if nominal.diverged_at is not None:
            return np.full(len(which), np.inf), np.inf
        parts = nominal.run.settings["sub_steps"]
        runs = sampled_runs(setup, [self.box.population.values[k] for k in which], duration, parts)
        shares = [runs.inputs / limits.peak, runs.speeds / limits.speed]
        used = np.max([np.where(np.isfinite(share), share, 0.0).max() for share in shares])
        return runs.overshoot, float(used)

    def noises(self, loop_margins: Margins) -> np.ndarray:
        if self.noise is None:
            return np.zeros(len(loop_margins.noise_to_input))
        return np.linalg.norm(loop_margins.noise_to_input * self.noise, axis=1)

    def missed(self, loop_margins: Margins) -> float:
        """Sum of ln(metric/limit) of the linear conditions that are missed, and missed by more than with `damped`."""
        own, s = self.own.margins, self.task.s
        damping = required_damping(s, self.target)
        noises = self.noises(loop_margins) / (NOISE * np.maximum(self.own.noises, 1e-300))
        bandwidth = np.minimum(self.target.bandwidth, np.nan_to_num(own.bandwidth))
        ratios = [
            loop_margins.peak_sensitivity / max(s.peak_sensitivity_limit, own.peak_sensitivity),
            min(s.gain_margin_limit, own.gain_margin) / loop_margins.gain_margin,
            min(damping, own.damping) / max(loop_margins.damping, 1e-9),
            float(np.max(bandwidth / np.maximum(np.nan_to_num(loop_margins.bandwidth), 1e-9))),
            float(noises.max()) if self.own.noises.any() else 0.0,
        ]
        return float(sum(np.log(ratio) for ratio in ratios if ratio > 1.0))

    def missed_in_steps(self, judged: LoopCandidate) -> float:
        """Excess of the overshoot over that with `damped`, at most 1, and ln of that over the joints' limits."""
        over = max(0.0, judged.overshoot - self.own.overshoot) / max(self.own.overshoot, 0.5)
        return min(over, 1.0) + max(0.0, float(np.log(max(judged.used, 1e-9) / max(1.0, self.own.used))))
