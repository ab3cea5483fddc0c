"""A law with its estimator and controller at any pose of a workspace: its loop at rest there, and its moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, cast

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.analysis.linear_loop import exponential
from flexhinf.baselines.posed_laws import PosedLaw
from flexhinf.copies import shared_out
from flexhinf.design.loop_setup import SMOOTH_EXTRAS, SWING_NOISE, LoopPlants
from flexhinf.design.noise_levels import RADIAN, EstimatorNoise
from flexhinf.design.plans import (
    BEYOND,
    SPEED,
    STILL,
    UNLIMITED,
    holding_shares,
    move_reference,
    quintic_move,
    settled,
    true_robot,
)
from flexhinf.design.responses import Move, Response, with_values
from flexhinf.design.specification import RINGS, RIPPLE, Specification
from flexhinf.errors import NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter, ModalFilter, stationary_gain
from flexhinf.estimation.modal import has_equal_joints
from flexhinf.estimation.stationary import stationary_covariance
from flexhinf.loop import Controller, Governor, Loop, Moving, Supervision, Waypoints
from flexhinf.loop.controller.governor import HEARD
from flexhinf.modal import ModalLaw, PairGains
from flexhinf.robot import Robot
from flexhinf.robot.elastic import stated_curves
from flexhinf.robot.parameters import PlantValues, random_signs
from flexhinf.robot.workspace import Workspace

#: Poses by which a law is chosen, and their seed; a ripple below which an estimator is preferred, per cent.
CHOSEN_POSES, CHOSEN_SEED, QUIET = 16, 17, 1.2

#: Random torques that the estimator expects each sample unless others are found or stated, on links and on motors, in
#: parts of the motors' limits.
EXPECTED = (0.0025, 0.03)

#: Least damping of slow oscillations; factor of all inputs at once that a loop tolerates, up and down.
DAMPING, GAIN = 0.2, 2.0

#: Offsets of the encoders are taken in with this time constant, s, and those of which is said what they do, rad or m. A
#: difference of 0.5 mrad between link and motor looks like a twisted spring; acting at once it would move a stiff arm
#: by 14 mrad. A response lasts until this share of it is left, at most so long, s.
OFFSET_TIME, OFFSET, LEFT, LASTS = 0.5, 5e-4, 1e-3, 20.0

#: Share of a joint's range by which a command may lie beyond it: rounding, also that of C in single precision.
#: Acceleration that a motor without a stated limit is assumed to have, rad/s² or m/s². Stated limits allow up to twice.
ROUNDING, ACCELERATION = 1e-6, 50.0

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

#: Plans kept for sampled robots, which make the same moves; linear controllers, by poses; moves that wait for no code.
PLANS, STEPS, FEW_MOVES = 32, 1000, 4


#: Ends (2, n) of a move, parameters of the true robot (None: the nominal ones), and the seed of its noise.
MoveArguments = tuple[np.ndarray, PlantValues | None, int]


def pose_limits(s: Specification) -> tuple[float, float]:
    """Least damping of slow oscillations, and largest ripple, per cent."""
    return DAMPING if s.damping is None else s.damping, RIPPLE if s.ripple is None else s.ripple


def corner_damping(s: Specification) -> float:
    """Least damping of slow oscillations of robots at corners of their tolerances; a smaller one rings."""
    return min(RINGS, pose_limits(s)[0])


def gain_limit(s: Specification) -> float:
    """Factor by which all inputs may grow or shrink at once."""
    return GAIN if s.gain_margin is None else s.gain_margin


class CornerLoop(NamedTuple):
    """The loop at rest at one pose, of a robot at a corner of its tolerances; as in `PoseLoop`."""

    growth: float
    damping: float
    fast_damping: float


class PoseLoop(NamedTuple):
    """The loop at rest at one pose. Growth is the largest modulus of the poles in the z plane; below 1 is stable."""

    growth: float
    damping: float  # smallest damping ratio of slow oscillations, see `Specification.damped_below_limit`
    fast_damping: float  # smallest of faster ones
    late: float  # growth with the extra delay that is required
    later: float  # the same with twice that delay
    louder: float  # growth with all inputs times the gain margin that is required
    softer: float  # and divided by it
    ripple: float  # largest deviation of an input by the noise of the sensors, per cent of its limit

    def excess(self, damping: float, ripple: float, period: float) -> np.ndarray:
        """How far it misses, (4,), in order of importance: stability with the extra delay (1/s), damping and ripple
        (relative); the gain margins (1/s); twice the delay (1/s), and a ripple of `QUIET`, which are only preferred. At
        most 0 where it misses nothing."""
        late, gain, wished = np.log([self.late, max(self.louder, self.softer), self.later]) / period
        loud = np.log(np.clip(self.ripple, 1e-9, 1e5) / np.array([ripple, QUIET]))
        needed = max(np.log(self.growth) / period, late, 1.0 - self.damping / damping, loud[0])
        return np.array([needed, gain, wished, loud[1]])


@dataclass(frozen=True, eq=False)
class WorkspaceSetup(LoopPlants):
    """A law with its estimator and controller, at any pose of the workspace.

    Poses are link positions (n,), rad or m. The loop runs with the period, latency, sensors, noise and limits of the
    specification.
    """

    workspace: Workspace
    law: PosedLaw
    random: tuple[float, float] = EXPECTED
    other: Robot | None = None  # the true robot, where it is another one than the model's

    def __getstate__(self) -> dict[str, Any]:
        """State to pickle for other processes: what is computed from it is left out."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def gains(self) -> PairGains:
        """Those of the pairs, of a modal law."""
        assert isinstance(self.law, ModalLaw)
        return self.law.gains

    @cached_property
    def true(self) -> LoopPlants:
        """As of every loop, of the robot that is the true one."""
        return LoopPlants(*true_robot(self.other or self.robot, self.specification))

    @cached_property
    def noise_levels(self) -> EstimatorNoise:
        """R^v: as stated, or random torques on links and motors in parts of the motors' limits."""
        s, joints = self.specification, self.law.joints
        if s.process_noise is not None or s.torque_noise is not None:
            return EstimatorNoise.stated(s)
        limit = self.authority * joints.torque_per_input
        links, motors = self.random
        on_links = links * limit / np.diag(joints.link_inertia)
        on_motors = motors * limit / joints.motor_inertia
        return EstimatorNoise(0.0, tuple((s.period * on_links) ** 2), tuple((s.period * on_motors) ** 2))

    @cached_property
    def authority(self) -> np.ndarray:
        """Limits of the motors (n,); of one without a limit the input that holds the weight and accelerates link and
        motor by `ACCELERATION`, at some random poses. Of a drive that takes positions it is that, beside the pose: its
        limit is a range of positions."""
        joints, p = self.law.joints, self.law.plant.parameters.vector()
        place = float(self.robot.drive == "position")
        needed = [
            np.abs(self.robot.operating_point(pose)[1] - place * pose)
            + ACCELERATION
            / joints.torque_per_input
            * (np.diag(np.linalg.inv(self.law.compliance.matrix(pose, p))) + joints.motor_inertia)
            for pose in self.workspace.sample(CHOSEN_POSES, CHOSEN_SEED)
        ]
        stated = np.isfinite(self.limits.effort) & (not place)
        return np.where(stated, self.limits.effort, np.max(needed, axis=0))

    def estimator(self, at: np.ndarray) -> Any:
        """The estimator, started at rest at a pose (n,), of which its gains do not depend; None where the true state is
        fed back.

        Joints with the same sensors fall into pairs, and gains of the pairs are those of every pose. With rigid joints
        or other sensors at some joints they do not, and an extended filter, whose covariance follows the pose, begins
        with the covariance of rest at home."""
        s = self.specification
        if s.estimator == "none":
            return None
        model, mean = self.model, self.robot.operating_point(at)[0]
        process, measurement = self.noise_levels.covariance(model.states), self.noise_variances
        pairs = not self.robot.rigid and has_equal_joints(model, len(self.joints))
        covariance = process + 1e-12 * np.eye(len(mean)) if pairs else self._covariance_at_home
        kalman = ExtendedKalmanFilter(
            model, s.period, process, measurement, mean, covariance, form="covariance"
        )
        return ModalFilter(kalman, self.law.equilibrium[0]) if pairs else kalman

    @cached_property
    def _covariance_at_home(self) -> np.ndarray:
        """P of a prediction at rest at home, by the noises of the estimator."""
        noises = self.noise_levels.covariance(self.model.states), np.diag(self.noise_variances)
        return stationary_covariance(self._sampled_model(*self.robot.operating_point()), *noises)

    def _sampled_model(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F and H of the model about an equilibrium."""
        inner, driven, _, seen = self.model.linearise(x, u)
        return exponential(inner, driven, self.specification.period)[0], seen

    @property
    def knows_friction(self) -> bool:
        """Never: the controller adds the friction of the file itself."""
        return False

    @property
    def supervision(self) -> Supervision:
        """What a deployed controller watches: commands outside the box of the workspace (of a path with room for what a
        spline swings beyond its points), limit cycles by `input_swing` or by `position_swing`, saturation, and
        following errors. It brakes along the path where a command leaves the box, an input is at its limit for long, a
        joint is far from its command, or something blocks it."""
        space = self.workspace
        share = ROUNDING if space.path is None else BEYOND
        margin = np.maximum(share * (space.upper - space.lower), ROUNDING)
        box = space.lower - margin, space.upper + margin
        watched = ["workspace", *(["saturation"] if self.limits.saturated is not None else []), "following"]
        watched += [] if self.resistance is None else ["blocked"]
        return Supervision(
            box,
            swing=self.input_swing,
            reactions=dict.fromkeys(watched, "brake"),
            position_swing=self.position_swing,
            following=self.following,
        )

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
        speed, space = BACK * self._speed, self.workspace
        distance = np.clip(FAR_TIME * self._speed, *np.multiply.outer(FAR, self._radian))
        rows = distance, speed, speed / BACK_TIME, space.lower, space.upper
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

    def _filter_gain(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """That of the estimator (states, p) at rest at an equilibrium."""
        if isinstance(self.filter, ModalFilter):
            return self.filter.gain(x)
        return stationary_gain(
            self._sampled_model(x, u), self.filter.process_noise, self.filter.measurement_noise
        )

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
    @cached_property
    def filter(self) -> Any:
        """The estimator at home, from which `linear` takes the gains."""
        return self.estimator(np.asarray(self.robot.home))

    def linear(
        self, at: np.ndarray, values: Mapping[str, Any] | None = None, damped: bool = True
    ) -> LinearLoop:
        """The sampled loop linearised at rest at a pose (n,), of a robot with the parameters `values`, whose springs
        may be without damping.

        It is built from the gains of law and filter. `EquilibriumLoop` gives the same from derivatives of the traced
        step, more slowly.
        """
        s, states, n = self.specification, self.model.states, len(self.joints)
        plant = self.smooth_plant_of(values, damped)
        smooth = tuple(name for name in self.extras if name in SMOOTH_EXTRAS)
        a, b, g, c = plant.linearise(*self.true.robot.operating_point(at, smooth, values))
        whole = np.eye(plant.n)[[plant.index(name) for name in states]]
        c = whole if self.filter is None else c
        # Robots at corners of the tolerances have the same controller.
        memory, law = self._kept_step(at.tobytes())
        return LinearLoop(
            s.period,
            a,
            b,
            c,
            np.zeros((len(c), n)),
            memory,
            law,
            np.zeros((len(memory), n)),
            np.zeros((n, n)),
            whole[:n],
            tuple(states[:n]),
            g,
            tuple(plant.disturbances),
            tuple(plant.inputs),
            delay=(s.known_latency + s.unknown_samples) * s.period,
        )

    @cached_property
    def _kept_step(self) -> Callable[[bytes], tuple[np.ndarray, np.ndarray]]:
        return lru_cache(STEPS)(self._step)

    def _step(self, pose: bytes) -> tuple[np.ndarray, np.ndarray]:
        """The controller's step at rest at a pose (n,): its next memory (s, s + p) and the input (n, s + p), by its
        memory and what is measured. The memory is the estimator's prediction, the inputs that have not acted yet, and,
        of a law that uses them, the integrals with the half of the last error that the next step adds."""
        s, model, n, at = self.specification, self.model, len(self.joints), np.frombuffer(pose)
        x, u = self.robot.operating_point(at)
        inner, driven, _, seen = model.linearise(x, u)
        moved, driven = exponential(inner, driven, s.period)
        if self.filter is None:
            seen, measured, gain = np.eye(model.n), model.states, np.eye(model.n)
        else:
            gain, measured = self._filter_gain(x, u), model.outputs
        size = model.n + (s.known_latency + 1) * n
        unit = np.eye(size + len(seen))
        prediction, integral, y = unit[: model.n], unit[size - n : size], unit[size:]
        waiting = [unit[k : k + n] for k in range(model.n, size - n, n)]  # which acts next first
        estimate = prediction + gain @ (y - seen @ prediction)
        links = tuple(model.states[:n])
        seen_links = [measured.index(name) for name in links if name in measured]
        half = 0.5 * s.period * (y[seen_links] if len(seen_links) == n else estimate[:n])
        ahead = estimate
        for late in waiting:
            ahead = moved @ ahead + driven @ late
        law = self.law.slope_at(at)
        waiting.append(law[:, : model.n] @ ahead + law[:, model.n :] @ (integral + half))
        memory = np.vstack([moved @ estimate + driven @ waiting[0], *waiting[1:], integral + 2.0 * half])
        if law[:, model.n :].any():
            return memory, waiting[-1]
        kept = np.delete(np.arange(size + len(seen)), np.s_[size - n : size])
        return memory[: size - n, kept], waiting[-1][:, kept]

    def at_corner(self, at: np.ndarray, values: Mapping[str, Any] | None, damped: bool = True) -> CornerLoop:
        """The loop at rest at a pose (n,), of a robot with the parameters `values`, as for `linear`."""
        loop = self.linear(at, values, damped).closed_loop
        growth, limit = float(np.abs(loop.multipliers).max()), self.specification.damped_below_limit
        return CornerLoop(growth, *loop.damping_about(limit))

    def at_pose(self, at: np.ndarray, tolerance: float = 0.0) -> PoseLoop:
        """The loop at rest at a pose (n,), with margins that are smaller than required by a relative tolerance."""
        s, loop = self.specification, self.linear(at)
        extra = (1.0 - tolerance) * ((s.delay_margin_limit or 0.0) * s.period)
        gain = (1.0 - tolerance) * gain_limit(s)

        def growth(loop: LinearLoop, extra: float = 0.0) -> float:
            return float(np.abs(loop.system(loop.delay + extra).multipliers).max())

        ripple = float((self.noise_spread(loop)[0] / self.authority).max())
        damping, fast = loop.closed_loop.damping_about(s.damped_below_limit)
        louder, softer = (growth(replace(loop, b=k * loop.b, d=k * loop.d)) for k in (gain, 1.0 / gain))
        return PoseLoop(
            growth=float(np.abs(loop.closed_loop.multipliers).max()),
            damping=damping,
            fast_damping=fast,
            late=growth(loop, extra),
            later=growth(loop, 2.0 * extra),
            louder=louder,
            softer=softer,
            ripple=100.0 * ripple,
        )

    def noise_spread(self, loop: LinearLoop) -> np.ndarray:
        """Standard deviations (2, n) of inputs, and of link positions, rad or m, by the sensors' noise and steps."""
        m, p, noise = len(self.joints), len(loop.c), np.zeros(loop.closed_loop.b.shape[1])
        if self.noise is not None:
            noise[m : m + p] = self.read_noise
        return loop.closed_loop.spread(noise)[m:].reshape(2, m)

    @property
    def read_noise(self) -> np.ndarray:
        """Standard deviations (p,) of what is measured, with the steps of the sensors."""
        steps = 0.0 if self.quantisation is None else self.quantisation
        return np.hypot(0.0 if self.noise is None else self.noise, steps / np.sqrt(12.0))

    def encoder_offsets(self, at: np.ndarray, time: float | None = OFFSET_TIME) -> np.ndarray:
        """How far offsets of `OFFSET` of all motors' encoders, or without these the links', move each link that rests
        at a pose (n,): at most on the way, and at the end, (2, n), rad or m, for the worst signs of the offsets.

        By the linear loop, without dry friction; infinite where that is unstable. The controller takes them in with the
        constant `time`, s, or at once (None).
        """
        chain = self.linear(at).part("v", "q")
        measured = self.model.states if self.filter is None else self.model.outputs
        if not chain.stable:
            return np.full((2, len(at)), np.inf)
        off = np.array([name.startswith("motor_position") for name in measured])
        off = off if off.any() else np.array([name.startswith("link_position") for name in measured])
        full, decay = OFFSET * chain.b[:, off], 0.0 if time is None else np.exp(-chain.period / time)
        slowest = max(decay, float(np.abs(chain.multipliers).max()))
        remaining = np.abs(chain.c @ np.linalg.solve(np.eye(len(chain.a)) - chain.a, full)).sum(axis=1)
        state, largest, left = np.zeros_like(full), remaining, 1.0
        for _ in range(round(min(np.log(LEFT) / np.log(slowest), LASTS / chain.period))):
            left *= decay
            state = chain.a @ state + (1.0 - left) * full
            largest = np.maximum(largest, np.abs(chain.c @ state).sum(axis=1))
        return np.array([largest, remaining])

    def needs(self, poses: np.ndarray, values: Mapping[str, Any] | None = None) -> np.ndarray:
        """The largest share (N,) of a motor's limit that holds a robot with the parameters `values` at poses (N, n). A
        range of positions that a drive takes may be used whole, and counts as `HOLD` of it. The torque that a drive
        has within its own loop counts too."""
        usable = self.limits.effort / (HOLD if self.robot.drive == "position" else 1.0)
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

    @cached_property
    def _command(self) -> Callable[[bytes, bytes], tuple[Waypoints, Moving]]:
        """Plan and reference of a move; sampled robots make the moves of the nominal one."""

        @lru_cache(PLANS)
        def command(*ends: bytes) -> tuple[Waypoints, Moving]:
            plan = quintic_move(self.robot, self.limits, *map(np.frombuffer, ends))
            return plan, move_reference(self.robot, plan, ())

        return command

    def move(
        self, ends: np.ndarray, values: Mapping[str, Any] | None = None, seed: int = 0, dwell: float = STILL
    ) -> Move:
        """A move with feedforward between the rows of `ends` (2, n), and a dwell, s; the true robot has the parameters
        `values`, and the dry friction that the robot states. The loop has held it at the start for long."""
        plan, arguments = self.move_arguments(ends, values, dwell)
        loop = self.loop(self.moving_along(ends), values)
        run = loop.run(**arguments, noise=self.noise, seed=self.specification.seed + seed)
        return Move(plan, Response(run, ends[1], ends[0], self.joints), self.limits)

    def moves(
        self, runs: Sequence[MoveArguments], begun: Callable[[], None] = lambda: None
    ) -> tuple[Move, ...]:
        """A `move` with its metrics for each of these arguments, on all processors; `begun` as of `shared_out`."""

        def judged(run: MoveArguments) -> tuple[Move, Any]:
            ends, values, _ = run
            move = self.move(*run)
            _ = move.motion, move.swing if self.may_swing else None
            return move, self._command(*map(bytes, ends))[1].last if values is None else None

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
    ) -> tuple[Waypoints, dict[str, Any]]:
        """The plan of a `move`, and what `Loop.run` is to begin with and to follow; the measurements are off by an
        `offset` (p,)."""
        (plan, reference), start = self._command(*map(bytes, ends)), ends[0]
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
        return plan, {
            "reference": reference,
            "duration": period * round((plan.duration + dwell) / period),
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
