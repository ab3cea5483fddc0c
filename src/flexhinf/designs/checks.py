"""Checks of the running loop beyond its step: impulses, a long run at rest, poses along a move, payloads.

Impulse: an impulse changes the link velocities by M⁻¹ at the goal, so a run begins at the goal with these velocities,
unknown to law and estimator. There is no measurement noise, which would hide the end of the decay.

Limit cycle: linear metrics do not show the effect of dry friction at rest, see docs/real_loop.md. The remedy is a dead
zone of the integrals as wide as the cycle.

Along a move: in error coordinates the law's gain is the same at every pose, but the robot's inertia and the estimator's
stationary gain change with it. At each pose the loop is linearised at rest; velocities along the move, and the switch
from one law to another, are not covered.

Payload: the true robot has masses at the ends of their ranges; law and estimator have the nominal ones. The robot makes
the step from equilibrium with the payload. In a second run, at rest at the goal, the weight beyond the model's acts on
all links at once, as constant torques. Integral action compensates the unmodelled weight.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from flexhinf.analysis import EquilibriumLoop, Margins, margins
from flexhinf.analysis.modes import JointScales
from flexhinf.designs import judge
from flexhinf.designs.loop_setup import DEVIATIONS, LoopSetup
from flexhinf.designs.motions import Plan
from flexhinf.designs.plans import has_integrals
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.responses import (
    LONGEST,
    JointLimits,
    LoadResponse,
    Response,
    Scenario,
    default_load,
    motion_metrics,
    rests,
    settled_run,
)
from flexhinf.designs.specification import RINGS, Specification
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.loop import Schedule
from flexhinf.loop.simulation import metrics
from flexhinf.loop.simulation.ring_down import FITS, Oscillation, RingDown, ring_down
from flexhinf.plant import Law, Parameters
from flexhinf.robot import Robot, Weighing, arm, weigh_payload
from flexhinf.robot.elastic import DRY

# An impulse on each joint of the resting loop ------------------------------------------------------------

#: An impulse is this fraction of the default load times 1/ω of the joint's vibration. The spring then carries about 3 %
#: of the motor's largest torque in the step, where the loop is nearly linear.
FRACTION = 0.3

#: Largest fraction of the input that is left beside the holding input; an impulse that uses more is reduced to the
#: second.
ROOM, KEPT = 0.9, 0.7

#: Length of a run, in periods of the lowest vibration with locked motors; at most that of the step.
PERIODS = 10.0

#: Largest number of past inputs in the fit, for loops with a delay.
MOST_LAGS = 20

#: The remaining velocity is measured after this number of periods of the least damped oscillation.
AFTER = 3.0


@dataclass(frozen=True, eq=False)
class ImpulseRuns:
    """Impulse responses from rest at the goal: one run for each joint, its impulse at time 0."""

    responses: tuple[Response, ...]  # For each joint, the run with the impulse on its link
    impulses: np.ndarray  # (n,), N·m·s or N·s
    # Oscillations of each run, in velocities and input of its own joint; None if a run diverged
    ring_down: RingDown | None

    @property
    def damping(self) -> float:
        """Smallest damping ratio of all runs; −∞ where one diverged."""
        return -np.inf if self.ring_down is None else self.ring_down.damping

    @property
    def worst(self) -> int:
        """The joint whose impulse gives the smallest damping ratio, or makes the run diverge."""
        if self.ring_down is not None:
            return self.ring_down.worst
        return next(k for k, response in enumerate(self.responses) if response.diverged_at is not None)

    def requirement(self, s: Specification, damping: float) -> Requirement:
        """The requirement on the damping after an impulse: that of the running loop, for the same oscillations."""
        row, below, fit = REQUIREMENTS["ring_down"], s.damped_below_limit, self.ring_down
        ratios = [] if fit is None else [fit.damping_of(k, below) for k in range(len(self.responses))]
        worst = int(np.argmin(ratios)) if ratios else self.worst
        return row.judge(
            s, damping, ratios[worst] if ratios else -np.inf,
            "nonlinear loop at rest at the goal, impulse on one joint after the other, nominal robot, no noise",
            joint=judge.of_several(self.responses[0].joints, worst),
            criterion=row.criterion.format(below=below),
        )  # fmt: skip

    @property
    def exponential(self) -> bool:
        """Whether the runs consist of decaying oscillations, as in a linear loop."""
        return self.ring_down is not None and self.ring_down.error <= FITS

    def least_damped(self, joint: int) -> Oscillation | None:
        """Least damped oscillation of the run with the impulse on a joint; None where nothing oscillates."""
        return next(iter(self.ring_down.oscillations[joint]), None) if self.ring_down else None

    def peak_deviation(self, joint: int) -> float | None:
        """Largest distance of the link with the impulse from the goal, rad or m; None where a run diverged."""
        run = self.responses[joint]
        return (
            None
            if self.ring_down is None
            else float(metrics.peak_of(run.positions[:, joint] - run.goal[joint]))
        )

    def velocity(self, joint: int) -> np.ndarray:
        """Velocity (N,) of the link with the impulse, over its peak."""
        own = self.responses[joint].velocities[:, joint]
        return own / metrics.peak_of(own)

    def left(self, joint: int) -> float | None:
        """Largest velocity of the link, over its peak, after `AFTER` periods of its least damped oscillation;
        None where nothing oscillates, or the run is shorter."""
        oscillation, time = self.least_damped(joint), self.responses[joint].run.time
        if oscillation is None or time[-1] * oscillation.frequency < AFTER:
            return None
        return float(metrics.peak_of(self.velocity(joint)[time >= AFTER / oscillation.frequency]))


def impulse_runs(
    setup: LoopSetup, peak: np.ndarray, most: float, sub_steps: int | None = None
) -> ImpulseRuns:
    """One run for each joint. The peak inputs (n,) of the step decide the impulse; it is reduced where a motor would
    come near its limit.

    `most`: longest run, s. `sub_steps`: Runge–Kutta steps per period of the true plant.
    """
    period, quiet = setup.specification.period, setup.without_noise
    scales = JointScales.of(setup.model, setup.goal_equilibrium)
    impulses = FRACTION * default_load(scales.per_input, peak) / scales.vibration
    duration = round(min(most, PERIODS * 2.0 * np.pi / scales.antiresonance) / period) * period
    _, state, holding_input = setup.at_impulse
    runs = tuple(quiet.impulse_responses(impulses, duration, sub_steps))
    room = np.maximum(setup.limits.effort - np.abs(holding_input), 1e-12)
    with np.errstate(invalid="ignore"):  # of a run that diverges
        used = np.array([float((metrics.peak_of(run.inputs - holding_input) / room).max()) for run in runs])
    if np.isfinite(used).all() and (used > ROOM).any():
        impulses = impulses * np.where(used > ROOM, KEPT / used, 1.0)
        runs = tuple(quiet.impulse_responses(impulses, duration, sub_steps))
    if any(run.diverged_at is not None for run in runs):
        return ImpulseRuns(runs, impulses, None)
    # The fit uses the whole state of the loop as deviations from rest: state, estimate and past inputs, the newest
    # last.
    late = setup.specification.known_latency + setup.specification.unknown_samples
    stored, lags = list[np.ndarray](), range(min(late, MOST_LAGS), 0, -1)
    for signals in (response.run.signals for response in runs):
        inputs = signals["input"] - holding_input
        before = [np.vstack([np.zeros((lag, inputs.shape[1])), inputs[:-lag]]) for lag in lags]
        believed = signals.get("estimate", signals["state"][:, :0])
        estimate = believed - state[: believed.shape[1]]
        stored.append(np.hstack([signals["state"] - state, estimate, *before, inputs]))
    n, count, states = len(runs), stored[0].shape[1], runs[0].run.names["state"]
    motors = [name.replace("link_", "motor_") for name in states[n : 2 * n]]
    watched = [
        [n + joint, count - n + joint, *([states.index(name)] if name in states else [])]
        for joint, name in enumerate(motors)
    ]
    return ImpulseRuns(runs, impulses, ring_down(stored, watched, runs[0].run.settings["period"]))


# What a run is too short to tell --------------------------------------------------------------------------

#: Requirements that are judged in the last moments of a run, at rest.
STANDSTILL = {REQUIREMENTS[name].what for name in ("remaining", "ripple")}


def judged_when_settled(
    judge: Callable[[Response], list[Requirement]], run: Response, where: str,
    again: Callable[[float], Response], begun: float = 0.0,
) -> list[Requirement]:  # fmt: skip
    """Requirements of a run to rest. Of a run that misses some of them before its transient is over, or that does not
    settle, those of a longer one, so that its length decides nothing.

    `judge`: requirements of a run. `where`: what the run is. `again`, `begun`: as of `settled_run`.
    """
    lines = judge(run)
    early = [line for line in lines if line.missed and line.what in STANDSTILL and line.where == where]
    longer = settled_run(run, again, begun) if early or not np.isfinite(run.settling.value) else run
    if longer is run:
        return lines
    detail = f"run of {longer.run.time[-1]:.3g} s"
    return [
        replace(line, detail=detail) if line.where == where and line.what in STANDSTILL else line
        for line in judge(longer)
    ]


def as_far_as_judged(
    lines: Sequence[Requirement], run: Response, begun: float, enough: float, timed: bool = False
) -> list[Requirement]:
    """Requirements of a run that cannot be made again, without a judgement of those that it is too short for.

    A run that ends before its command and some rest, or unsettled before `enough` s, judges only what it exceeds. One
    that ends before its transient is over judges no error and no ripple at rest as missed; where the arm is given a
    time to rest (`timed`), a run of `enough` s does.
    """
    if run.diverged_at is not None:
        return list(lines)
    length, settled = float(run.run.time[-1]) * (1.0 + metrics.ROUNDING), np.isfinite(run.settling.value)
    short = length < begun + metrics.WINDOW or (not settled and length < enough)
    early = short or (length < enough if timed else bool(settled) and not rests(run, begun))
    open_ended = [
        (line.missed and early and line.what in STANDSTILL) or (line.met and short) for line in lines
    ]
    return [replace(line, judged=not left) for line, left in zip(lines, open_ended, strict=True)]


# A long run at rest with dry friction or backlash --------------------------------------------------------

#: Length of the run, s, and its largest number of samples. A joint sticks until the integral has grown by twice the
#: friction, which may take tens of seconds.
LENGTH, MOST_SAMPLES = 120.0, 240_000

#: Most samples times sub-steps times disturbances.
MOST_NUMBERS = 30_000_000

#: Largest dead zone as a fraction of the joint's step (of the largest step for a joint that makes none): half of the
#: settling band. The second number says how often the zone is widened.
WIDEST, WIDENED = 0.01, 2


@dataclass(frozen=True, eq=False)
class LimitCycleCheck:
    """A long run of the step without measurement noise, of a robot with backlash, or dry friction that sticks."""

    response: Response
    extras: tuple[str, ...]  # of the true plant
    limit: float  # Largest amplitude that is no limit cycle, rad or m
    # Whether friction sticks; smoothed friction, as of rigid joints, creeps and may hide a cycle
    sharp: bool = True
    dead_zone: np.ndarray | None = None  # (n,) or None. Dead zone of the integrals in this run, rad or m
    # without, tried: the run without the dead zone, if a zone ended the cycle; the run with the widest zone, if none
    # did
    without: LimitCycleCheck | None = None
    tried: LimitCycleCheck | None = None

    @property
    def cause(self) -> str:
        """What of the true plant may keep it swinging."""
        dry = ["dry friction"] if set(self.extras) & set(DRY) else []
        return " and ".join([*dry, *(["backlash"] if "backlash" in self.extras else [])])

    @property
    def where(self) -> str:
        """What the run is."""
        return f"long run at rest, nominal robot with {self.cause}, no noise"

    @cached_property
    def cycles(self) -> tuple[metrics.LimitCycle, ...]:
        """Motion of each link position in the last half of the run; none where the run diverged."""
        diverged, time = self.response.diverged_at is not None, self.response.run.time
        return () if diverged else tuple(metrics.limit_cycle(time, q) for q in self.response.positions.T)

    @property
    def errors(self) -> np.ndarray:
        """Largest distance (n,) of each link from the goal in the last tenth of the run, rad or m."""
        rows = self.response.metrics
        return np.array([row["steady_state_error"] for row in rows] or [np.inf] * len(self.response.goal))

    @property
    def remaining(self) -> tuple[np.ndarray, str]:
        """Remaining error (n,) of each link, rad or m, and what this run is."""
        return remaining_errors(self.response, self.response.goal), self.where

    @property
    def amplitudes(self) -> np.ndarray:
        """Amplitudes (n,) of `cycles`, rad or m; infinite where the run diverged."""
        return np.array([cycle.amplitude for cycle in self.cycles] or [np.inf] * len(self.response.goal))

    @property
    def worst(self) -> int:
        """The joint with the largest amplitude."""
        return int(np.argmax(self.amplitudes))

    @property
    def oscillating(self) -> tuple[int, ...]:
        """Joints whose amplitude exceeds the limit; all if the run diverged."""
        return tuple(np.flatnonzero(self.amplitudes > self.limit).tolist())

    def requirement(self, units: Sequence[str]) -> Requirement:
        """The requirement that `cause` makes no limit cycle; `units` are those of the link positions."""
        worst = self.worst
        return REQUIREMENTS["limit_cycle"].judge(
            None, self.limit, self.amplitudes[worst], self.where,
            unit=units[worst], joint=judge.of_several(self.response.joints, worst),
        )  # fmt: skip


def end_limit_cycle(setup: LoopSetup) -> tuple[LoopSetup, LimitCycleCheck | None]:
    """The loop, with a dead zone of its integrals if that ends a limit cycle, and the check of its run at rest.

    The zone of a joint is its cycle's amplitude, then twice that, and at most `WIDEST` of the step.
    """
    first = check_limit_cycle(setup)
    stated = setup.specification.integral_dead_zone is not None
    if first is None or stated or not (first.oscillating and first.cycles and has_integrals(setup.law)):
        return setup, first
    step = np.abs(setup.goal - setup.start)
    most = WIDEST * np.where(step > 0.0, step, step.max())
    run, zone = first, np.zeros(len(step))
    for _ in range(WIDENED):
        wanted = np.where(run.amplitudes > run.limit, np.maximum(run.amplitudes, 2.0 * zone), zone)
        zone = np.array([float(f"{size:.1e}") for size in np.minimum(wanted, most)])
        changed = replace(setup, chosen_zone=zone)
        run = check_limit_cycle(changed)
        if run is None or not run.cycles:
            break
        if not run.oscillating:
            return changed, replace(run, without=first)
    return setup, replace(first, tried=run)


def remaining_errors(response: Response, references: np.ndarray) -> np.ndarray:
    """Remaining error (n,) of each link from references, (n,) or (N, n), rad or m; infinite where the run diverged."""
    if response.diverged_at is not None:
        return np.full(len(response.goal), np.inf)
    return metrics.remaining_error(response.run.time, response.positions, references)


def errors_after_move(setup: LoopSetup, plan: Plan, dwell: float | None) -> tuple[np.ndarray, str] | None:
    """Remaining error (n,) of each link after a move without noise, rad or m, and what this run is; None for a robot
    without dry friction and backlash."""
    if not setup.may_swing:
        return None
    move = setup.without_noise.move(plan, dwell)
    return remaining_errors(move.response, move.planned), "the stated move, nominal robot, no noise"


def check_limit_cycle(setup: LoopSetup) -> LimitCycleCheck | None:
    """Run the check; None for a robot without dry friction and backlash, or with none above zero."""
    if not setup.may_swing:
        return None
    s, plant, parts = setup.specification, setup.true_plant, setup.loop(setup.bumpless_controller).sub_steps
    samples = min(MOST_SAMPLES, MOST_NUMBERS // (parts * len(plant.disturbances)))
    # no noise: it acts as a dither that may hide sticking
    response = setup.without_noise.step(min(LENGTH, samples * s.period))
    zone, limit = setup.dead_zone if has_integrals(setup.law) else None, setup.position_resolution(DEVIATIONS)
    return LimitCycleCheck(response, setup.extras, limit, plant.arrest is not None, zone)


# The running loop at poses along a stated move -----------------------------------------------------------

#: Number of poses at which the loop is linearised, by the number of states of the linear loop.
POSES = ((30, 13), (60, 7), (10_000, 5))

#: Largest number of laws of an automatic schedule, the goal's included.
MOST_LAWS = 4

#: Number of instants at which the path length of a move is summed.
INSTANTS = 400


@dataclass(frozen=True)
class MarginLimits:
    """Limits at every pose: largest peak sensitivity, smallest gain margin, and smallest damping ratio of oscillations
    below a frequency, rad/s."""

    peak_sensitivity: float
    gain_margin: float
    damping: float
    damped_below: float

    def value(self, name: str, at_pose: Margins) -> float:
        """The number that a limit is for."""
        return at_pose.damping_about(self.damped_below)[0] if name == "damping" else getattr(at_pose, name)

    def shares(self, at_pose: Margins) -> dict[str, float]:
        """Share of each limit that is used: above 1 it is exceeded."""
        if not at_pose.stable:
            return dict.fromkeys(("peak_sensitivity", "gain_margin", "damping"), np.inf)
        return {
            "peak_sensitivity": at_pose.peak_sensitivity / self.peak_sensitivity,
            "gain_margin": self.gain_margin / at_pose.gain_margin,
            "damping": self.damping / max(self.value("damping", at_pose), 1e-300),
        }


@dataclass(frozen=True, eq=False)
class AlongMove:
    """Margins at poses along a move."""

    times: np.ndarray  # (P,). When the move passes the poses, s
    poses: np.ndarray  # (P, n). Link positions, rad or m
    laws: tuple[int, ...]  # Number of the law that acts at each pose; 0 is the goal's law
    margins: tuple[Margins, ...]  # Of the running loop, linearised at each pose
    limits: MarginLimits  # Of the margins
    count: int = 1  # How many laws there are
    added: int = 0  # Number of laws that were added because the margins did not hold

    @cached_property
    def shares(self) -> list[dict[str, float]]:
        """Share of each limit that is used at each pose."""
        return [self.limits.shares(at_pose) for at_pose in self.margins]

    @property
    def share(self) -> float:
        """The largest share of a limit that is used at any pose."""
        return max(max(shares.values()) for shares in self.shares)

    @property
    def worst_pose(self) -> int:
        """Index of the pose with the largest share of a limit."""
        return int(np.argmax([max(shares.values()) for shares in self.shares]))


def margins_along(setup: LoopSetup, plan: Plan, limits: MarginLimits) -> AlongMove:
    """Margins of the running loop at poses at equal distances along a move."""
    size, times = setup.equilibrium_loop().states, np.linspace(0.0, plan.duration, INSTANTS)
    count = next(count for most, count in POSES if size <= most)
    q = np.reshape(plan(times), (INSTANTS, -1))
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    way += 1e-9 * max(float(way[-1]), 1e-9) * np.arange(INSTANTS)
    equal = cast("np.ndarray", np.linspace(0.0, way[-1], count))
    times = np.interp(equal, way, times)  # equal parts of the path, ends included
    poses, s = np.reshape(plan(times), (len(times), -1)), setup.specification
    laws, places = (setup.law,), (0,) * len(poses)
    if isinstance(setup.law, Schedule):
        laws, places = setup.law.laws, tuple(setup.law.acting(pose) for pose in poses)
    at_poses = tuple(
        margins(
            EquilibriumLoop(
                laws[k], setup.estimator(pose), setup.smooth_plant, s.period,
                equilibrium=setup.robot.operating_point(pose), moving=True,
                delay=s.unknown_samples, latency=s.known_latency, positions=setup.model.states[: len(pose)],
            )
        )
        for pose, k in zip(poses, places)
    )  # fmt: skip
    return AlongMove(times, poses, places, at_poses, limits, len(laws))


def scheduled(
    setup: LoopSetup, plan: Plan, limits: MarginLimits, another: Callable[[np.ndarray], Law] | None
) -> tuple[Law, AlongMove]:
    """The law, or a schedule with laws at the worst poses of a move, until the margins hold or it has `MOST_LAWS`.

    `another` designs a law at a pose (n,); None adds none. A law that does not help is not added.
    """
    law, along = setup.law, margins_along(setup, plan, limits)
    laws = [law]
    while another is not None and along.share > 1.0 and len(laws) < MOST_LAWS:
        try:
            laws.append(another(along.poses[along.worst_pose]))
            schedule = Schedule(laws)
        except FlexhinfError:  # no law there, or one at this pose already
            break
        better = margins_along(replace(setup, law=schedule), plan, limits)
        if not better.share < along.share:
            break
        law, along = schedule, replace(better, added=len(laws) - 1)
    return law, along


def along_requirements(s: Specification, along: AlongMove) -> list[Requirement]:
    """Peak sensitivity, gain margin and, where it is required, damping at the worst pose along a move."""
    laws = f", {along.count} laws" if along.count > 1 else ""
    where = f"running loop at {len(along.times)} poses along the move{laws}"
    limits = {
        "peak_sensitivity": s.limit("peak_sensitivity"),
        "gain_margin": s.limit("gain_margin"),
        "damping": along.limits.damping * (1.0 + TOLERANCE),
    }
    # for each margin, the pose at which it is nearest to its limit, or furthest beyond it
    worst = {name: int(np.argmax([shares[name] for shares in along.shares])) for name in limits}
    return [
        REQUIREMENTS[name].judge(
            s, limit, along.limits.value(name, along.margins[worst[name]]), where, at=float(along.times[worst[name]]),
            criterion="worst pose; linearised about the robot at rest there",
        )
        for name, limit in limits.items()
    ]  # fmt: skip


# Payloads at the ends of their ranges --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PayloadEvaluation:
    """Evaluation of a loop whose true robot has other payload masses than the model."""

    robot: Robot  # The model's
    masses: Mapping[str, float]  # Of each payload, kg, by the robot's parameters
    step: Response  # From start to goal, with the payload
    # Step of the weight beyond the model's; None where the model has at least this payload
    load_step: LoadResponse | None
    margins: Margins  # Of the running loop about the goal, with the payload

    @property
    def mass(self) -> float:
        """Sum of all payloads, kg."""
        return float(sum(self.masses.values()))

    @cached_property
    def weighed(self) -> Weighing | None:
        """Masses estimated from the motor torques at the end of the step; None where they cannot be observed at this
        pose."""
        if self.step.diverged_at is not None:
            return None
        try:
            return weigh_payload(self.robot, self.step.goal, metrics.tail_of(self.step.inputs).mean(axis=0))
        except InvalidInput:
            return None


def evaluate_payloads(setup: LoopSetup, runs: Scenario) -> tuple[PayloadEvaluation, ...]:
    """Evaluations with payloads at the ends of their ranges, the lower end only if the model has a larger payload;
    empty without a range."""
    return tuple(evaluate_payload(setup, runs, masses) for masses in arm.payload_ends(setup.robot.uncertain))


def evaluate_payload(setup: LoopSetup, runs: Scenario, masses: Mapping[str, float]) -> PayloadEvaluation:
    """The step and the load step with these masses (kg, by the robot's parameters) in the true robot."""
    robot, load_step = setup.robot, None
    true = setup.true.robot.plant_parameters({**setup.true.robot.nominal, **masses})

    def step_of(length: float) -> Response:
        return setup.step(length, values=true, sub_steps=runs.sub_steps)

    step = settled_run(step_of(runs.step_duration), step_of, setup.command_time)
    if any(mass > robot.nominal[name] for name, mass in masses.items()):
        nominal, loaded = (
            np.asarray(robot.links.gravity_torque(setup.goal, Parameters(p)), dtype=float)
            for p in (robot.plant_parameters(), true)
        )
        load_step = _recovered_load_step(setup, -(loaded - nominal), runs)
    loop_margins = margins(setup.equilibrium_loop(values=true))
    return PayloadEvaluation(robot, masses, step, load_step, loop_margins)


def _recovered_load_step(setup: LoopSetup, load: np.ndarray, runs: Scenario) -> LoadResponse:
    """The load step with torques (n,), in a run that is long enough for the links to come back where they do."""
    length, found = runs.load_duration, setup.load_response(load, runs.load_duration, runs.sub_steps)
    while found.metrics and not np.isfinite(found.recovery.value) and length < LONGEST:
        length = min(2.0 * length, LONGEST)
        found = setup.load_response(load, length, runs.sub_steps)
    return found


def payload_requirements(
    s: Specification, limits: JointLimits, load: PayloadEvaluation, damping: float | None, resolution: float
) -> list[Requirement]:
    """Requirements with a payload: of the step, on the deflection after the load step, and on damping.

    `damping`: required with the model's payload; with others the loop must not ring.
    `resolution`: of a link position, rad or m.
    """
    name = f"with {load.mass:.3g} kg of payload"
    where = f"the step {name}"
    rows = motion_metrics(limits, load.step)
    lines = [
        *judge.step_requirements(s, limits, load.step, where),
        *judge.motion_requirements(s, limits, [rows], resolution, where),
    ]
    least, below = min(RINGS, damping or 0.0), s.damped_below_limit
    (slow, fast), place = load.margins.damping_about(below), f"running loop at the goal {name}"
    lines.append(judge.damping_requirement(None, least, slow, below, place))
    growing = judge.fast_damping_requirement(fast, below, place)
    lines += [line for line in growing if line.missed]
    if load.load_step is None:
        return lines
    where, remaining = f"gripping {load.mass:.3g} kg at the goal", load.load_step.remaining
    k = limits.joints.index(remaining.joint) if remaining.joint else 0
    return [
        *lines,
        REQUIREMENTS["load_step"].judge(
            None, metrics.SETTLING_BAND * float(load.load_step.reference_step[k]), remaining.value, where,
            unit=limits.position_units[k], joint=judge.of_several(limits.joints, remaining.joint),
        ),
        *judge.limit_requirements(limits, [load.load_step.response], where, always=False),
    ]  # fmt: skip
