"""Law with its estimator and controller at any pose of a workspace: what watches it, and its moves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, cast

import numpy as np

from flexhinf.baselines.posed_laws import PosedLaw
from flexhinf.copies import shared_out
from flexhinf.designs.loop_setup import SWING_NOISE
from flexhinf.designs.motions import Motion, Plan
from flexhinf.designs.noise_levels import RADIAN
from flexhinf.designs.plans import (
    BEYOND,
    SPEED,
    STILL,
    UNLIMITED,
    holding_shares,
    move_reference,
    quintic_move,
    settled,
)
from flexhinf.designs.responses import Move, Response, run_length, settled_run, with_values
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.resting_loops import (
    CHOSEN_POSES,
    CHOSEN_SEED,
    OFFSET,
    OFFSET_TIME,
    RestingLoops,
)
from flexhinf.errors import NumericalFailure
from flexhinf.loop import Controller, Governor, Loop, Supervision
from flexhinf.loop.controller.governor import HEARD
from flexhinf.numerals import worst_text
from flexhinf.robot.elastic import stated_curves
from flexhinf.robot.parameters import PlantValues, random_signs

#: Share of a joint's range by which a command may lie beyond it: rounding, also that of C in single precision.
ROUNDING = 1e-6

#: A goal is left out if holding the heaviest robot of the tolerances, there or on the way, needs more than this share
#: of a limit; instants of the way.
HOLD, ON_THE_WAY = 0.7, 21

#: A joint may be beside its command by what it moves at its speed limit in this time, s, and at least so far, rad; a
#: joint that hunts swings by so much, rad, or `SWING_NOISE` standard deviations of its noise, peak to peak.
FOLLOWING_TIME, FOLLOWING, POSITION_SWING = 0.1, 0.1, 2e-3

#: A joint that is farther from its command than it moves in this time, s, at its speed limit, but from these distances,
#: rad, is brought back, at most with this share of its speed limit, which it reaches in the last time, s.
FAR_TIME, FAR, BACK, BACK_TIME = 0.02, (0.02, 0.08), 0.8, 0.3

#: A joint is blocked where what resists it is so many times as large as tolerances explain, and so many standard
#: deviations of its noise.
EXCESS, HEARD_NOISE = 1.5, 7.0

#: Plans kept for sampled robots, which make the same moves; moves that wait for no code.
PLANS, FEW_MOVES = 32, 4

#: Ends (2, n) of a move, parameters of the true robot (None: the nominal ones), and the seed of its noise.
MoveArguments = tuple[np.ndarray, PlantValues | None, int]


@dataclass(frozen=True, eq=False)
class WorkspaceSetup(RestingLoops):
    """A law with its estimator and controller, at any pose of the workspace.

    Poses are link positions (n,), rad or m. The loop runs with the period, latency, sensors, noise and limits of the
    specification.
    """

    @property
    def task(self) -> Task:
        """Poses, and the only motion."""
        return Task(self.workspace, self.motion)

    @property
    def supervision(self) -> Supervision:
        """What a deployed controller watches: commands outside the box of the workspace (of a path with room for what a
        spline swings beyond its points), limit cycles by `input_swing` or by `position_swing`, saturation, and
        following errors. It brakes along the path where a command leaves the box, an input is at its limit for long, a
        joint is far from its command, or something blocks it."""
        watched = ["workspace", *(["saturation"] if self.limits.saturated is not None else []), "following"]
        watched += [] if self.resistance is None else ["blocked"]
        return Supervision(
            self.box,
            swing=self.input_swing,
            reactions=dict.fromkeys(watched, "brake"),
            position_swing=self.position_swing,
            following=self.following,
        )

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n,) each, rad or m, between which commands lie."""
        if self.motion is not None:
            return self.motion.box
        space = self.workspace
        share = ROUNDING if space.path is None else BEYOND
        margin = np.maximum(share * (space.upper - space.lower), ROUNDING)
        return space.lower - margin, space.upper + margin

    @cached_property
    def input_swing(self) -> np.ndarray:
        """Smallest swing of an input (n,) that counts, peak to peak: a fifth of `authority`, or above its noise."""
        noise = self.noise_spread(self.linear(np.asarray(self.workspace.home)))[0]
        return np.maximum(0.2 * self.authority, SWING_NOISE * np.where(np.isfinite(noise), noise, 0.0))

    @property
    def following(self) -> np.ndarray:
        """Distance of a joint from its command (n,) from which on it does not follow, rad or m."""
        return np.maximum(FOLLOWING_TIME * self._speed, FOLLOWING * self._radian)

    @property
    def governor(self) -> Governor:
        """How a deployed controller brings joints back that were held, or whose command jumps, and lets go of what
        blocks them."""
        speed = BACK * self._speed
        distance = np.clip(FAR_TIME * self._speed, *np.multiply.outer(FAR, self._radian))
        ends = (self.workspace.lower, self.workspace.upper) if self.motion is None else self.motion.box
        rows = distance, speed, speed / BACK_TIME, *ends
        own: dict[str, Any] = {"resistance": None if self.resistance is None else self.resistance.tolist()}
        own["curves"] = stated_curves(self.robot.plant_parameters(), self.robot.layout)
        return Governor(*(row.tolist() for row in rows), coupling=self.robot.coupling or None, **own)

    @cached_property
    def resistance(self) -> np.ndarray | None:
        """Acceleration of each link (n,), rad/s² or m/s², that the estimator's model does not explain, from which on
        something blocks a joint; None where the true state is fed back.

        It is `EXCESS` times the largest that robots at corners of the tolerances show at some poses, where their
        encoders are off by `OFFSET` and dry friction holds rigid joints, with half the speed of the governor and all of
        its acceleration; and `HEARD_NOISE` standard deviations of the sensors' noise."""
        if self.filter is None:
            return None
        model, n, speed = self.model, len(self.joints), 0.5 * BACK * self._speed
        poses, known = self.workspace.sample(CHOSEN_POSES, CHOSEN_SEED), model.parameters.vector()
        signs = np.repeat(random_signs(2 * n, CHOSEN_POSES, CHOSEN_SEED), 2, axis=0)
        motion = np.repeat(poses, 2, axis=0), signs[:, :n] * speed, signs[:, n:] * (2.0 * speed / BACK_TIME)
        dry = self.overcoming(self.filter)["dry_friction"]
        rubs = signs[:, :n] * (0.0 if dry is None else np.array(dry.level))
        off = [OFFSET * name.startswith("motor_position") for name in model.states]
        off = np.tile([-1.0, 1.0], len(poses))[:, None] * off
        most, still = np.zeros(n), np.zeros((len(model.disturbances), len(off)))
        for values in self.robot.random_corners(CHOSEN_POSES, CHOSEN_SEED) or [{}]:
            x, u = self.robot.inverse_dynamics(*motion, parameters=values)
            rates = np.array(cast("object", model.traced_flow((x + off).T, (u + rubs).T, still, known)))
            most = np.maximum(most, np.abs(rates[n : 2 * n].T - motion[2]).max(axis=0))
        period, home = self.specification.period, self.robot.operating_point()
        heard = self._filter_gain(*home)[n : 2 * n] * self.read_noise
        return EXCESS * most + HEARD_NOISE * np.sqrt((heard**2).sum(axis=1) / (2.0 * HEARD * period))

    @property
    def _speed(self) -> np.ndarray:
        return np.where(np.isfinite(self.limits.speed), self.limits.speed, UNLIMITED / SPEED)

    @property
    def position_swing(self) -> np.ndarray:
        """Smallest swing of a joint (n,) that counts, peak to peak, rad or m: above the noise of its sensor."""
        noise, coarse = np.sqrt(self.position_noise), self.position_resolution(0.0)
        return np.maximum(POSITION_SWING * self._radian, np.maximum(SWING_NOISE * noise, 3.0 * coarse))

    @property
    def _radian(self) -> np.ndarray:  # what is a radian of others, of a joint that slides in m
        return np.where(self.robot.links.slides, RADIAN, 1.0)

    @cached_property
    def has_controller(self) -> bool:
        """Whether one controller serves the task: its code has the gains of each pose, or there is one motion."""
        poses = self.workspace.sample(CHOSEN_POSES, CHOSEN_SEED)
        return self.motion is not None or self.law.serves(poses)

    def controller(self, at: np.ndarray, law: PosedLaw | None = None, **options: Any) -> Controller:
        """A controller that begins at rest at a pose (n,), with the input that holds the model there, and holds it
        until there is a command; with another law, and further options of `flexhinf.Controller`."""
        s, held = self.specification, self.robot.operating_point(at)
        own: dict[str, Any] = {
            "offset_time": None if s.estimator == "none" else OFFSET_TIME,
            "integral_dead_zone": self.dead_zone,
            "governor": self.governor,
            **self.overcoming(estimator := self.estimator(at)),
        }
        return Controller(
            replace(law or self.law, equilibrium=held),
            estimator,
            s.period,
            self.limits.saturated,
            moving=True,
            start="zero",
            latency=s.known_latency,
            input_rate=self.limits.input_rate,
            **(own | options),
        )

    # At rest ------------------------------------------------------------------------------------------

    def needs(self, poses: np.ndarray, values: Mapping[str, Any] | None = None) -> np.ndarray:
        """The largest share (N,) of a motor's limit that holds a robot with the parameters `values` at poses (N, n). A
        range of positions that a drive takes may be used whole, and counts as `HOLD` of it. The torque that a drive
        has within its own loop counts too."""
        usable = self.limits.effort / (HOLD if self.robot.drive_kind.takes_positions else 1.0)
        commands = np.abs(self.robot.inverse_dynamics(poses, parameters=values)[1]) / usable
        return np.maximum(np.max(commands, axis=1), holding_shares(self.robot, poses, values))

    # Moves --------------------------------------------------------------------------------------------
    def goals(self, count: int, seed: int | Sequence[int]) -> tuple[np.ndarray, int]:
        """Goals (count, n), one after another, and how many poses were left out between them: those to which the motors
        do not carry the heaviest robot of the tolerances with `HOLD` of their limits, straight on."""
        kept: list[np.ndarray] = []
        for tried, pose in enumerate(self.workspace.sample(50 * count, seed)):
            way = cast("np.ndarray", np.linspace(kept[-1] if kept else pose, pose, ON_THE_WAY))
            if np.all(self.needs(way, self.robot.heaviest) <= HOLD):
                kept.append(pose)
                if len(kept) == count:
                    return np.array(kept), tried + 1 - count
        raise NumericalFailure(
            "The motors hold hardly any pose of the workspace.",
            f"{len(kept)} of {50 * count} random poses are reached with at most {100.0 * HOLD:g} % of the limits, "
            "with the largest masses and payload",
            "a smaller workspace, a lighter payload, or larger limits",
        )

    def move_ends(self, count: int, seed: int | Sequence[int]) -> tuple[np.ndarray, int]:
        """Starts and goals (count, 2, n) of moves, one after another between random goals, and how many poses were left
        out between them; the one motion where there is one."""
        if self.motion is not None:
            return np.tile(self.motion.ends, (count, 1, 1)), 0
        goals, left_out = self.goals(count + 1, seed)
        return np.stack([goals[:-1], goals[1:]], axis=1), left_out

    @property
    def where(self) -> str:
        """The pose at which loops are judged, in words; "" where there are several."""
        return "" if self.motion is None else "the pose"

    def motions(self, count: int) -> str:
        """In which motions a robot, or some, are judged, in words."""
        return worst_text(count, "step" if self.motion is not None and self.motion.jumps else "move")

    def poses(self, count: int, seed: int) -> np.ndarray:
        """Poses (count, n) at which loops are judged; (1, n) of one pose."""
        return self.workspace.sample(1 if self.motion is not None else count, seed)

    @cached_property
    def step_length(self) -> float:
        """Length of the run of a jump to the one pose, s: as stated, or until the governor has brought the joints there
        and the slowest mode of the loop is over; `move` prolongs it where the links do not rest by then."""
        assert self.motion is not None
        if self.motion.length is not None:
            return self.motion.length
        slowest = float(np.abs(self.linear(self.motion.goal).closed_loop.multipliers).max())
        rate = -math.log(max(slowest, 1e-300)) / self.specification.period
        return self._arrival(self.motion) + run_length(rate)

    def _arrival(self, motion: Motion) -> float:
        """When the governor has brought the joints to the goal of a jump, s: with half of its speed, which it reaches
        and leaves within `BACK_TIME`."""
        return float(np.max(np.abs(motion.goal - motion.start) / (0.5 * BACK * self._speed))) + BACK_TIME

    def _motion(self, ends: np.ndarray) -> Motion:
        """The motion between ends (2, n): the one of the task, or a quintic."""
        if self.motion is not None and np.array_equal(ends, self.motion.ends):
            return self.motion
        start, goal = ends
        return Motion(start, goal, quintic_move(self.robot, self.limits, start, goal))

    @cached_property
    def _command(self) -> Callable[[bytes, bytes], tuple[Motion, Any]]:
        """The motion between two poses and its reference; sampled robots make the moves of the nominal one."""

        @lru_cache(PLANS)
        def command(*ends: bytes) -> tuple[Motion, Any]:
            motion = self._motion(np.array([*map(np.frombuffer, ends)]))
            if not motion.jumps:
                return motion, move_reference(self.robot, motion.plan, ())
            held = np.concatenate(self.robot.operating_point(motion.goal))
            return motion, dict(zip(self.moving.commanded, held.tolist(), strict=True))

        return command

    def move(
        self, ends: np.ndarray, values: Mapping[str, Any] | None = None, seed: int = 0, dwell: float = STILL
    ) -> Move:
        """A move with feedforward between the rows of `ends` (2, n), and a dwell, s; the true robot has the parameters
        `values`, and the dry friction that the robot states. The loop has held it at the start for long."""
        plan, arguments = self.move_arguments(ends, values, dwell)
        loop, (motion, _) = self.loop(self.moving_along(ends), values), self._command(*map(bytes, ends))
        number = self.specification.seed + seed

        def run(duration: float) -> Response:
            own: dict[str, Any] = {**arguments, "duration": duration}
            trajectory = loop.run(**own, noise=self.noise, seed=number)
            return Response(trajectory, ends[1], ends[0], self.joints)

        response = run(arguments["duration"])
        if motion.jumps and motion.length is None:
            response = settled_run(response, run, self._arrival(motion))
        return Move(plan, response, self.limits)

    def moves(
        self, runs: Sequence[MoveArguments], begun: Callable[[], None] = lambda: None
    ) -> tuple[Move, ...]:
        """A `move` with its metrics for each of these arguments, on all processors; `begun` as of `shared_out`."""

        def judged(run: MoveArguments) -> tuple[Move, Any]:
            ends, values, _ = run
            move = self.move(*run)
            _ = move.motion, move.swing if self.may_swing else None
            motion, reference = self._command(*map(bytes, ends))
            return move, reference.last if values is None and not motion.jumps else None

        found = shared_out(judged, runs, begun, "moving" not in vars(self) and len(runs) > FEW_MOVES)
        for (ends, *_), (_, last) in zip(runs, found):
            if last is not None:  # sampled robots make these moves too
                self._command(*map(bytes, ends))[1].resume(last)
        return tuple(move for move, _ in found)

    @cached_property
    def moving(self) -> Controller:
        """The controller of all moves, each of which begins with a memory of its own."""
        return self.controller(np.array(self.workspace.home))

    def moving_along(self, ends: np.ndarray) -> Controller:
        """The controller of a move between the rows of `ends` (2, n): that of all moves, or with gains of its own."""
        law = self.law.along(*ends)
        return self.moving if law is self.law else self.controller(np.array(self.workspace.home), law=law)

    def move_arguments(
        self,
        ends: np.ndarray,
        values: Mapping[str, Any] | None = None,
        dwell: float = STILL,
        offset: Any = 0.0,
    ) -> tuple[Plan, dict[str, Any]]:
        """The plan of a `move`, and what `Loop.run` is to begin with and to follow; the measurements
        are off by an `offset` (p,)."""
        (motion, reference), start = self._command(*map(bytes, ends)), ends[0]
        state, held, memory = settled(
            self.true.robot,
            self.robot.operating_point(start),
            self.limits,
            self.moving,
            self.linear(start, values),
            start,
            self.extras,
            values,
            offset,
        )
        period = self.specification.period
        duration = max(self.step_length, dwell) if motion.jumps else motion.plan.duration + dwell
        return motion.plan, {
            "reference": reference,
            "duration": period * round(duration / period),
            "initial_state": state,
            "initial_input": held,
            "initial_memory": memory,
        }

    def power_on(self, ends: np.ndarray, values: Mapping[str, Any], seed: int = 0) -> Response:
        """The first second at the start of a move, of a controller that does not know the robot's parameters."""
        s, at = self.specification, ends[0]
        run = self.loop(self.controller(at), values).run(
            noise=self.noise,
            duration=s.period * round(STILL / s.period),
            seed=s.seed + seed,
            initial_state=self.true.robot.operating_point(at, self.extras, values)[0],
        )
        return Response(run, at, at, self.joints)

    def unknown_load(self, ends: np.ndarray, values: Mapping[str, Any]) -> float:
        """Largest difference of an input that holds the start of a move from the model's, as a share of its limit."""
        held = [self.robot.operating_point(ends[0], (), own)[1] for own in (values, None)]
        return float((np.abs(held[0] - held[1]) / self.authority).max())

    def loop(self, controller: Controller, values: Mapping[str, Any] | None = None) -> Loop:
        """A controller and the true robot with its dry friction and the parameters `values`."""
        plant, late = with_values(self.true_plant, values), self.specification.unknown_delay
        return Loop(plant, controller, self.sub_steps, quantisation=self.quantisation, delay=late)
