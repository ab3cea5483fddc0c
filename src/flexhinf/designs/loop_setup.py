"""The loop that a law runs in: estimator, controller, true plant, and the runs of every evaluation."""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from flexhinf import analysis
from flexhinf.analysis import EquilibriumLoop
from flexhinf.designs.estimators import ESTIMATORS, EstimatorTask, is_kalman
from flexhinf.designs.motions import Plan
from flexhinf.designs.noise_levels import EstimatorNoise, noise_variances, sensor_steps
from flexhinf.designs.plans import (
    ON_THE_WAY,
    has_integrals,
    move_reference,
    stated_backlash,
    stated_dry_friction,
    stated_move,
    step_command,
    true_robot,
)
from flexhinf.designs.responses import (
    LOAD_START,
    JointLimits,
    LoadResponse,
    Move,
    Response,
    integral_dead_zone,
    joint_limits,
    with_values,
)
from flexhinf.designs.specification import AUTO, Specification, SpecificationError
from flexhinf.designs.stated_units import per_signal
from flexhinf.errors import FlexhinfError
from flexhinf.estimation import (
    stationary,
    stationary_covariance,
)
from flexhinf.loop import Controller, EnsembleResult, Loop, Moving, Schedule, Step, Supervision
from flexhinf.plant import Law, Plant, sub_steps
from flexhinf.robot import MuJoCoPlant, Robot, elastic
from flexhinf.robot.mujoco import EXPRESSED, inexpressible
from flexhinf.robot.signals import signal_names
from flexhinf.robot.springs import without_damping

#: Initial variance where no process noise is assumed: standard deviations of 1 mrad (mm) and 1 mrad/s (mm/s).
INITIAL_VARIANCE = 1e-6

#: A motion up to this number of standard deviations of a measured position, or one sensor step, is not seen.
DEVIATIONS = 3.0

#: How far commands may lie beyond start, goal and poses of the laws: a share of the largest travel of a joint, and at
#: least so much, rad or m.
WORKSPACE_MARGIN = (0.1, 0.05)

#: Standard deviations by which noise hardly swings to and fro, peak to peak, within the runs of a robot.
SWING_NOISE = 14.0

#: Extras whose linearisation at standstill holds beyond the smallest motions. Dry friction and backlash are left out of
#: the linear loop: their slope holds only below the smoothing velocity, as damping that a moving robot lacks.
SMOOTH_EXTRAS = ("inductance", "joint_damping", "spring_hardening", "stiffness_curve")

#: Largest sub-step times the fastest mode, and smallest number of sub-steps per period, where joints stick. RK4 errs by
#: 3e-6 per radian of phase; the time at which a joint reverses or sticks is known to one sub-step.
RK4_STEP, MIN_PARTS = 0.2, 4


if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Instance = TypeVar("Instance", bound="DataclassInstance")


def with_derived(known: Instance, **changes: Any) -> Instance:
    """A copy with changed fields that keeps the computed properties; they must be valid for the copy too."""
    same = replace(known, **changes)
    vars(same).update({name: value for name, value in vars(known).items() if name not in vars(same)})
    return same


@dataclass(frozen=True, eq=False)
class LoopPlants:
    """Plants, sensors, noise, limits and estimators of a loop: all of it except the control law."""

    robot: Robot
    specification: Specification  # `of_loop`: sensors, estimator, period, latency, limits, extras and noise

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.robot.joint_names

    @cached_property
    def model(self) -> Plant:
        """The nominal robot with its sensors: the estimator's model, without dry friction."""
        return self.robot.plant(self.specification.measured)

    @cached_property
    def true(self) -> LoopPlants:
        """The robot by which everything is judged, and the specification of its plants: those of all plants below."""
        return LoopPlants(*true_robot(self.robot, self.specification))

    @property
    def extras(self) -> tuple[str, ...]:
        """What the true robot has and the model has not: the stated extras, and what `true_robot` adds."""
        return self.true.specification.extras

    @cached_property
    def dry_friction(self) -> tuple[str, ...]:
        """Dry friction of the true robot: a controller adds it along a command, the estimator has it on request."""
        stated = elastic.stated_friction(self.robot.plant_parameters())
        return tuple(name for name in self.extras if name in stated)

    @property
    def knows_friction(self) -> bool:
        """Whether the model of the deployed estimator has dry friction; the observer's gain is computed without."""
        return self.specification.friction_model and is_kalman(self.specification)

    @property
    def may_swing(self) -> bool:
        """Whether the true robot has what makes a loop with integrals swing at rest: dry friction, or backlash."""
        return bool(self.dry_friction) or "backlash" in self.extras

    @cached_property
    def backlash(self) -> np.ndarray:
        """Width of each joint's gap (n,), rad or m; 0 where the robot states none."""
        width, own = np.zeros(len(self.joints)), self.robot.plant_parameters().get("backlash", 0.0)
        width[self.robot.layout.elastic] = own
        return width

    @property
    def dead_zone(self) -> np.ndarray | None:
        """Errors (n,) that are not integrated, rad or m: as stated, or half the backlash; None without any."""
        return integral_dead_zone(self.joints, self.specification.integral_dead_zone, 0.5 * self.backlash)

    @cached_property
    def estimator_model(self) -> Plant:
        """The model of the deployed estimator: on request with smoothed dry friction. Its slope at standstill would
        count as damping, so linear metrics use `model`."""
        known = self.dry_friction if self.knows_friction else ()
        return self.robot.plant(self.specification.measured, extras=known)

    def overcoming(self, estimator: Any) -> dict[str, Any]:
        """Options of a controller that follows a moving reference: the dry friction of the file, which it adds unless
        its estimator's model has it, and the backlash, where both sides of the springs are measured."""
        seen = () if estimator is None else tuple(estimator.plant.outputs)
        known = None if self.knows_friction else stated_dry_friction(self.robot)
        return {"dry_friction": known, "backlash": stated_backlash(self.robot, seen)}

    def reference(self, plan: Plan) -> Moving:
        """A planned move with its feedforward, for a controller with the options of `overcoming`."""
        return move_reference(self.robot, plan, self.dry_friction if self.knows_friction else ())

    def driven(self, controller: Controller, plan: Plan) -> tuple[Controller, Any]:
        """A deployed controller and its reference for a plan: in error coordinates with the feedforward, without it
        along the positions if the law integrates their errors."""
        c = controller
        if not c.mode.moving and not self.specification.feedforward and has_integrals(c.law):
            return c, plan
        if not c.mode.moving:
            c = Controller(
                c.law, c.estimator, c.period, (c.limits.lower, c.limits.upper), moving=True, latency=c.mode.latency,
                integral_dead_zone=c.integral_dead_zone, before_first=c.first_input.option, offset_time=c.offset_time,
                supervision=c.supervision and replace(c.supervision, reactions={}), **self.overcoming(c.estimator),
            )  # fmt: skip
        return c, self.reference(plan)

    @cached_property
    def true_plant(self) -> Plant:
        """The nominal robot with the extras; its dry friction sticks."""
        s = self.true.specification
        return self.true.robot.plant(s.measured, extras=s.extras, sticking=True)

    @cached_property
    def sub_steps(self) -> int | None:
        """Runge–Kutta steps per period of a robot with dry friction; None: by the loop, without any."""
        if not self.dry_friction:
            return None
        fastest = self.true_plant.fastest_mode(*self.true.robot.operating_point(extras=self.extras))
        return max(MIN_PARTS, sub_steps(self.specification.period, fastest, RK4_STEP))

    def mujoco_plant(self, at: np.ndarray) -> MuJoCoPlant:
        """The true plant in MuJoCo, with what it expresses of the robot's file; its time step is at most 0.1 rad of the
        fastest mode's phase at a pose (n,).

        Raises `InvalidInput` if MuJoCo is not installed, or does not express a stated extra.
        """
        s, robot = self.true.specification, self.true.robot
        known = (*self.specification.extras, *EXPRESSED)
        missing = inexpressible(s.extras, robot.plant_parameters())
        extras = [name for name in s.extras if name in known and name not in missing]
        fastest = self.true_plant.fastest_mode(*robot.operating_point(at, s.extras))
        step = s.period / sub_steps(s.period, fastest, 0.1)
        measured = None if s.estimator == "none" else s.measured
        return MuJoCoPlant(robot, measured=measured, step=step, extras=extras)

    @cached_property
    def smooth_plant(self) -> Plant:
        """The true plant of the linear loop: without the extras that are not smooth at standstill."""
        smooth = [name for name in self.extras if name in SMOOTH_EXTRAS]
        return self.true.robot.plant(self.specification.measured, extras=smooth)

    def smooth_plant_of(self, values: Mapping[str, Any] | None, damped: bool) -> Plant:
        """`smooth_plant` with the parameters `values`, its springs damped or with nothing that damps them."""
        plant = with_values(self.smooth_plant, values)
        return plant if damped else without_damping(plant)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Extras of the true plant that the linear loop does not have."""
        return tuple(name for name in self.extras if name not in SMOOTH_EXTRAS)

    @cached_property
    def limits(self) -> JointLimits:
        """Limits of inputs, speeds and positions: the specification's, or the robot's own."""
        return joint_limits(self.robot, self.specification)

    @cached_property
    def quantisation(self) -> np.ndarray | None:
        """Quantisation steps (p,) of measured signals, or one number, as for a state fed back; None without any."""
        s = self.specification
        steps = sensor_steps(self.robot, s.measured, s.quantisation, s.estimator)
        return steps if steps.any() else None

    @cached_property
    def noise(self) -> np.ndarray | None:
        """Standard deviations (p,) of the measurement noise; None where the true state is fed back."""
        s = self.specification
        return None if s.estimator == "none" else np.sqrt(self.noise_variances)

    @cached_property
    def noise_variances(self) -> np.ndarray:
        """Diagonal (p,) of R^n: as stated for each measured signal, or of one number as `noise_variances` says.

        Raises `SpecificationError` for another count of numbers.
        """
        s, noise = self.specification, self.specification.measurement_noise
        if type(noise) is float:  # one with a unit holds for each signal
            return noise_variances(self.model, noise)
        each, signals = per_signal(self.robot, s.measured, noise)
        each = each * len(signals) if isinstance(noise, float) and len(each) == 1 else each
        if len(each) != len(signals):
            raise SpecificationError(
                "measurement_noise", "The noise does not fit what is measured.",
                f"expected one number, or one for each of {list(s.measured)} or of {list(signals)}, got {len(each)}",
                example=",".join(f"{value:g}" for value in np.resize(each, len(signals))),
            )  # fmt: skip
        return np.array(each)

    @cached_property
    def position_noise(self) -> np.ndarray:
        """Variance (n,) of a position of each joint, rad² or m², of the sensor with the least noise."""
        level = float(np.min(self.noise_variances / noise_variances(self.model, 1.0)))
        return noise_variances(self.robot.plant(), level)

    def position_resolution(self, deviations: float = 1.0) -> float:
        """Smallest measurable change of position, rad or m: so many deviations of the noise, or one sensor step."""
        names = self.model.outputs
        steps = np.broadcast_to(0.0 if self.quantisation is None else self.quantisation, len(names)).tolist()
        positions = [step for name, step in zip(names, steps) if "position" in name]
        return max(deviations * float(np.sqrt(self.position_noise.max())), *positions, 0.0)

    def estimator_at(
        self, at: np.ndarray, goal: np.ndarray, noise: EstimatorNoise, deployed: bool = False
    ) -> Any:
        """The estimator, with its initial mean the equilibrium at a pose (n,). None for "none".

        With `deployed` its model is `estimator_model`, otherwise `model`.
        Raises `NotDetectable`, with the state, if at the goal the sensors do not observe a mode that does not decay.
        """
        s, model = self.specification, self.model
        if s.estimator == "none":
            return None
        from scipy.linalg import expm

        equilibrium = self.robot.operating_point(goal)
        a, _, _, c = model.linearise(*equilibrium)
        process, measurement = noise.covariance(model.states), self.noise_variances
        kind = "ukf" if s.estimator == AUTO else s.estimator  # of a law about a pose
        stationary.check_detectable(a, c, model.states)
        model = self.estimator_model if deployed else model
        # Stationary covariance at the goal, so that the gain is constant from the start. Without process noise it would
        # be zero.
        covariance = INITIAL_VARIANCE * np.eye(len(a))
        if process.any():
            sampled = cast("np.ndarray", expm(a * s.period))
            covariance = stationary_covariance((sampled, c), process, np.diag(measurement))
        mean = self.robot.operating_point(at)[0]
        task = EstimatorTask(model, s.period, process, measurement, mean, covariance, equilibrium[0])
        return ESTIMATORS[kind].make(task)


@dataclass(frozen=True, eq=False)
class LoopSetup(LoopPlants):
    """One law with its estimator and controller, in closed loop with one true plant.

    `dataclasses.replace` changes law, sensors or noise levels; all derived properties are then computed anew.
    """

    law: Law  # or a schedule of laws, that at the goal first
    goal: np.ndarray  # (n,), link positions, rad or m
    start: np.ndarray  # (n,), likewise
    estimator_noise: EstimatorNoise | None = None  # R^v; by default what the specification states
    chosen_zone: np.ndarray | None = None  # (n,), where more than the stated is needed, see `design.checks`
    quiet: bool = False  # no measurement noise in runs of the nominal robot; runs of sampled robots have it
    unlimited: bool = False  # no limits of the inputs, which would hide the peak that a law demands

    # Parts of the loop --------------------------------------------------------------------------------
    @property
    def linear_law(self) -> Law:
        """The law whose linearisation at the goal is used."""
        return self.law.laws[0] if isinstance(self.law, Schedule) else self.law

    @property
    def process_noise(self) -> EstimatorNoise:
        """Levels of R^v of the estimator."""
        return self.estimator_noise or EstimatorNoise.stated(self.specification)

    @cached_property
    def without_noise(self) -> LoopSetup:
        """The loop without measurement noise, `quiet`; it shares the derived properties, which depend on no noise."""
        return with_derived(self, quiet=True)

    @cached_property
    def goal_equilibrium(self) -> tuple[np.ndarray, np.ndarray]:
        """State and input with which the model is held at the goal."""
        return self.robot.operating_point(self.goal)

    def estimator(self, at: np.ndarray, deployed: bool = False) -> Any:
        """The estimator, see `LoopPlants.estimator_at`. Linear metrics use it without `deployed`."""
        return self.estimator_at(at, self.goal, self.process_noise, deployed)

    @cached_property
    def stated_move(self) -> Plan | None:
        """The move of the specification; None for a step."""
        return stated_move(self.robot, self.specification)

    @property
    def supervision(self) -> Supervision:
        """What a deployed controller watches: the box of start, goal, laws' poses and a stated move, with a
        `WORKSPACE_MARGIN`, and limit cycles by ± 10 % of a limit, or by more where noise makes such swings."""
        names, laws = self.law.plant_states, self.law.laws if isinstance(self.law, Schedule) else (self.law,)
        places = [names.index(name) for name in self.law.tracked]
        ends = [self.robot.operating_point(at)[0] for at in (self.start, self.goal)]
        if move := self.stated_move:
            times = cast("np.ndarray", np.linspace(0.0, move.duration, ON_THE_WAY))
            ends += list(np.asarray(move(times), dtype=float).reshape(ON_THE_WAY, -1))
        poses = np.array([np.asarray(end)[places] for end in (*ends, *(law.operating_point for law in laws))])
        share, smallest = WORKSPACE_MARGIN
        margin = max(share * float(np.ptp(poses, axis=0).max(initial=0.0)), smallest)
        box = (poses.min(axis=0) - margin, poses.max(axis=0) + margin) if places else None
        return Supervision(box, swing=self._noisy_swing)

    @cached_property
    def _noisy_swing(self) -> np.ndarray | None:
        """Smallest swing of an input (m,) that counts where noise makes larger ones than the default; else None."""
        if self.noise is None or self.limits.saturated is None:
            return None
        try:
            margins = analysis.margins(self.equilibrium_loop())
        except FlexhinfError:  # the runs say so
            return None
        swing, noise = 0.2 * self.limits.saturated, margins.input_noise(self.noise)
        noisy = np.isfinite(swing) & np.isfinite(noise) & (SWING_NOISE * noise > swing)
        return np.where(noisy, SWING_NOISE * noise, swing) if noisy.any() else None

    def controller(
        self, at: np.ndarray, moving: bool = False, start: str | None = None, supervised: bool = False,
        **stated: Any,
    ) -> Controller:  # fmt: skip
        """A controller for a run that begins at a pose (n,); `moving`: in error coordinates about a moving reference.

        `start` is "zero" for integrals at zero, the default of a moving reference, or "bumpless": the first input
        is the one that holds the model at `at`. `supervised`: with the `supervision` of the design. Options of
        `flexhinf.Controller` that are `stated` win.
        """
        start, estimator = start or ("zero" if moving else "bumpless"), self.estimator(at, deployed=True)
        options: dict[str, Any] = {
            "moving": moving,
            "start": start,
            "integral_dead_zone": self.dead_zone if has_integrals(self.law) else None,
            "before_first": self.robot.operating_point(at)[1],
            "latency": self.specification.known_latency,
            "supervision": self.supervision if supervised else None,
            **(self.overcoming(estimator) if moving else {}),
        }
        limits, rate = (None, None) if self.unlimited else (self.limits.saturated, self.limits.input_rate)
        options = {"input_rate": rate, **options, **stated}
        return Controller(self.law, estimator, self.specification.period, limits, **options)

    @property
    def dead_zone(self) -> np.ndarray | None:
        """Errors (n,) that are not integrated, rad or m; None without a dead zone."""
        zone = super().dead_zone
        if self.chosen_zone is None or self.specification.integral_dead_zone is not None:
            return zone
        return self.chosen_zone if zone is None else np.maximum(self.chosen_zone, zone)

    def loop(
        self,
        controller: Controller,
        plant: Any = None,
        sub_steps: int | None = None,
        values: Mapping[str, Any] | None = None,
    ) -> Loop:
        """A loop with the true plant and these parameters, or with another plant; with delay and quantisation."""
        if plant is None or values is not None:
            plant, sub_steps = with_values(self.true_plant, values), sub_steps or self.sub_steps
        return Loop(
            plant, controller, sub_steps, quantisation=self.quantisation, delay=self.specification.unknown_delay,
        )  # fmt: skip

    def equilibrium(
        self, at: np.ndarray, values: Mapping[str, Any] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """State and input with which the true robot is held at a pose (n,), with these parameters."""
        return self.true.robot.operating_point(at, self.extras, values)

    def equilibrium_loop(
        self, estimated: bool = True, values: Mapping[str, Any] | None = None, damped: bool = True
    ) -> EquilibriumLoop:
        """The sampled loop about the goal for linearisation: its plant is `smooth_plant`, with `damped` springs or with
        none that is, its command that of the law.

        The command enters through the integrals of the law; a law without integrals follows x_d(q) and u_d(q). The loop
        has the estimator or feeds back the true state; the estimator does not know changed plant parameters (`values`).
        """
        s, law, plant = self.specification, self.linear_law, self.smooth_plant_of(values, damped)
        return EquilibriumLoop(
            law, self.estimator(self.goal) if estimated else None, plant, s.period,
            equilibrium=self.goal_equilibrium, moving=not has_integrals(law), delay=s.unknown_samples,
            latency=s.known_latency if estimated else 0, positions=self.model.states[: len(self.goal)],
        )  # fmt: skip

    def departure(self, law: Law) -> np.ndarray:
        """Deviation (N,) from the goal's equilibrium at which a law takes over at the start, integrals included."""
        estimator, s = self.estimator(self.start), self.specification
        controller = Controller(
            law, estimator, s.period, self.limits.saturated, start="bumpless", latency=s.known_latency,
            input_rate=self.limits.input_rate,
        )  # fmt: skip
        x, u = self.equilibrium(self.start)
        x, known = x[: len(controller.states)], self.model.parameters.vector()
        controller.reset(None if estimator is None else x, input=u)
        measured = x if estimator is None else np.asarray(self.model.traced_output(x, u, known), dtype=float)
        controller.step(np.asarray(measured, dtype=float).ravel())
        return np.concatenate([x, controller.integrals]) - law.operating_point

    # Controllers of the runs, made once so that their kernels are shared --------------------------------
    @cached_property
    def bumpless_controller(self) -> Controller:
        """The controller as deployed: its first input is the one that holds the robot at the start."""
        return self.controller(self.start)

    @cached_property
    def tracking_controller(self) -> Controller:
        """The controller for a move: in error coordinates, its integrals at zero."""
        return self.controller(self.start, moving=True)

    @cached_property
    def command(self) -> Plan | None:
        """The command of the step from start to goal; None where it jumps, or the law does not take one."""
        return step_command(self.robot, self.specification, self.start, self.goal, self.law)

    @property
    def command_time(self) -> float:
        """Duration of the command of the step, s; 0 for a jump."""
        return 0.0 if self.command is None else self.command.duration

    # Runs -----------------------------------------------------------------------------------------------
    def run(
        self, controller: Controller, at: np.ndarray, duration: float, values: Mapping[str, Any] | None = None,
        seed: int = 0, plant: Any = None, sub_steps: int | None = None, **options: Any,
    ) -> Response:  # fmt: skip
        """A run of `duration` s from equilibrium at a pose (n,); the controller starts with the input that holds the
        model there.

        The true plant has the parameters `values`, or is another `plant` (of MuJoCo). `seed` is added to the
        specification's seed; `sub_steps` are Runge–Kutta steps per period; further options as for `Loop.run`.
        """
        x, _ = self.equilibrium(at, values)
        run = self.loop(controller, plant, sub_steps, values).run(
            noise=None if self.quiet else self.noise, duration=duration, initial_state=x,
            seed=seed + self.specification.seed, **options,
        )  # fmt: skip
        return Response(run, self.goal, x[: len(self.goal)], self.joints)

    def ensemble(
        self, robots: Sequence[Mapping[str, Any]], sub_steps: int, controller: Controller, at: np.ndarray,
        duration: float, numbers: Sequence[int] | None = None, **options: Any,
    ) -> EnsembleResult:  # fmt: skip
        """The same run for each robot, by its parameters, each with its own noise; options of `Loop.ensemble`.

        `numbers`: of the robots, by which they have their noise; counted by default. All runs have the `sub_steps` of
        the nominal plant, so that they share one kernel.
        """
        loop, seed = self.loop(controller, None, sub_steps), 1 + self.specification.seed
        return loop.ensemble(noise=self.noise, duration=duration, **options).run(
            [self.true_plant.parameters.known(values) for values in robots],
            [seed + k for k in (range(len(robots)) if numbers is None else numbers)],
            np.array([self.equilibrium(at, values)[0] for values in robots]),
        )

    def step(self, duration: float, values: Mapping[str, Any] | None = None, **options: Any) -> Response:
        """The step from start to goal along `command`, as deployed: the input starts without a jump; see `run`."""
        return self.run(**self.step_arguments(duration), values=values, **options)

    @property
    def feeds_forward(self) -> bool:
        """Whether the command of the step comes with its feedforward."""
        return self.command is not None and self.specification.feedforward

    @property
    def moves(self) -> bool:
        """Whether the deployed controller follows a moving reference, as it is judged: a stated move or a shaped step
        with feedforward."""
        return self.feeds_forward or (self.specification.move is not None and self._forward)

    @property
    def _forward(self) -> bool:
        return self.specification.feedforward or not has_integrals(self.law)

    def step_arguments(self, duration: float) -> dict[str, Any]:
        """Arguments of `run` and `ensemble` for the step of a duration, s: as of `along`."""
        if self.command is not None and self.feeds_forward:
            return {**self.along(self.command), "duration": duration}
        controller, reference = self.bumpless_controller, self.command
        return {"controller": controller, "at": self.start, "duration": duration, "reference": reference}

    def load_response(self, load: np.ndarray, duration: float, sub_steps: int | None = None) -> LoadResponse:
        """Run from equilibrium at the goal, with constant torques (n,) on all links from `LOAD_START` of it on."""
        period, names = self.specification.period, signal_names("link_torque", self.joints)
        at = round(LOAD_START * duration / period) * period
        torques = {name: Step(float(torque), at=at) for name, torque in zip(names, load)}
        controller = self.controller(self.goal, moving=True)
        response = self.run(controller, self.goal, duration, sub_steps=sub_steps, disturbance=torques)
        step = np.abs(self.goal - self.start)
        return LoadResponse(response, load, at, np.where(step > 0.0, step, step.max()))

    @cached_property
    def at_impulse(self) -> tuple[Plant, np.ndarray, np.ndarray]:
        """The plant of impulses, with its equilibrium at the goal: it has dry friction and backlash only where `extras`
        name them. A motor that sticks leaves its link swinging whatever the law."""
        s, robot = self.specification, self.true.robot
        extras = [name for name in self.extras if name in (*SMOOTH_EXTRAS, *s.extras)]
        return robot.plant(s.measured, extras=extras), *robot.operating_point(self.goal, extras)

    def impulse_responses(
        self, impulses: np.ndarray, duration: float, sub_steps: int | None = None
    ) -> Iterator[Response]:
        """Runs from equilibrium at the goal, each with an impulse, N·m·s or N·s, of `impulses` (n,) on one link: the
        velocities jump, unknown to law and estimator. There is no measurement noise where `quiet`."""
        plant, x, u = self.at_impulse
        enter = plant.linearise(x, u)[2][:, : len(self.goal)]
        sub_steps = None if self.dry_friction else sub_steps  # these are of another plant
        loop = self.loop(self.controller(self.goal, moving=True), plant, sub_steps)
        runs = loop.ensemble(noise=None if self.quiet else self.noise, duration=duration)
        starts, own = x + (enter * impulses).T, [dict[str, Any]()] * len(self.goal)
        for run in runs.trajectories(own, self.specification.seed, starts):
            yield Response(run, self.goal, self.goal, self.joints)

    def move(self, plan: Plan, dwell: float | None = None, **options: Any) -> Move:
        """A planned move, then `dwell` seconds at its end (default: half its duration); options as for `run`."""
        return Move.along(plan, self.run(**self.along(plan, dwell), **options), self.limits)

    def along(self, plan: Plan, dwell: float | None = None) -> dict[str, Any]:
        """Arguments of `run` and `ensemble` for a planned move: controller, pose at which it takes over, duration and
        reference: states and inputs of inverse dynamics, or without feedforward the positions, if the law integrates
        their errors."""
        period, begin = self.specification.period, np.reshape(plan(0.0), -1)
        near = np.allclose(begin, self.start, rtol=0.0, atol=1e-12)
        duration = plan.duration + (0.5 * plan.duration if dwell is None else dwell)
        forward = self._forward
        known = self.tracking_controller if forward else self.bumpless_controller
        return {
            "controller": known if near else self.controller(begin, moving=forward),
            "at": self.start if near else begin,
            "duration": round(duration / period) * period,
            "reference": self.reference(plan) if forward else plan,
        }
