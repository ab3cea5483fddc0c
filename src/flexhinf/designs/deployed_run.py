"""Runs of a design's controller as it is deployed: one on MuJoCo's robot, or a campaign on sampled robots.

The robots may have a payload, or other parameters than those of the design. The run on MuJoCo's robot is in real time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from flexhinf.campaign import Campaign, LinearPlant, Sample, Tolerances, Variable
from flexhinf.campaign.samples import Columns, SampleColumns
from flexhinf.designs import (
    checks,
    design_file,
    judge,
    loop_setup,
    monte_carlo,
    motions,
    plans,
    responses,
)
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.fields import law_of
from flexhinf.designs.pose_loop import LoopAtPose
from flexhinf.designs.request import DesignRequest
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.specification import Specification
from flexhinf.designs.verdict import UNKNOWN, DesignVerdict
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export.realtime import RealTimeRun
from flexhinf.loop import Controller, Loop, Status, Step, load_controller
from flexhinf.loop.simulation.inputs import RunOptions, sample_count
from flexhinf.loop.simulation.metrics import WINDOW
from flexhinf.options import declared, quantity
from flexhinf.plant import ParameterTable
from flexhinf.robot import MuJoCoPlant, Parameter, Robot, elastic, load_robot, signals
from flexhinf.robot.parameters import per_joint
from flexhinf.validation import nearest, value_text

#: Default length of a run: of a step in s, of a move of one pose's controller as a multiple of its duration. One for a
#: workspace rests for `plans.STILL` after it, and is judged as resting.
STEP_TIME, MOVE_TIMES = 5.0, 1.5

WHERE = "this run, on MuJoCo's robot"

#: What a campaign runs: a controller, or the setup of a workspace.
LawOfRuns = TypeVar("LawOfRuns")


@dataclass(frozen=True, eq=False)
class DeployedRun:
    """A prepared run: loop, robot and options."""

    robot: Robot  # The driven one
    # Sensors, noise and limits, of the designed robot with this run's specification
    plants: loop_setup.LoopPlants
    box: MuJoCoPlant  # The driven robot in MuJoCo
    loop: Loop
    # start, goal: (n,). Link positions, rad or m
    start: np.ndarray
    goal: np.ndarray
    plan: motions.Plan | None  # The move; None for a step
    arguments: dict[str, Any]  # Of `flexhinf.run_realtime`
    rests: bool  # Whether a controller for a workspace moves: judged as the moves of its design are
    design: DesignVerdict  # On the design whose controller runs
    begun: float  # When the command ends, or the load begins, whichever is later, s
    enough: float  # Length of a run in which a robot that comes to rest does so, s

    def response(self, run: RealTimeRun) -> responses.Response:
        """The run with its metrics for each joint."""
        return responses.Response(run.trajectory, self.goal, self.start, self.robot.joint_names)

    def requirements(self, run: RealTimeRun) -> list[Requirement]:
        """The requirements of the specification, as far as the run is long enough to judge them, and the requirements
        that no input swings at rest and that no deadline was missed."""
        s, limits, response = self.plants.specification, self.plants.limits, self.response(run)
        resolution = 0.0 if self.rests else self.plants.position_resolution(loop_setup.DEVIATIONS)
        if self.plan is None:
            rows = responses.motion_metrics(limits, response)
            lines = [
                *judge.step_requirements(s, limits, response, WHERE),
                *judge.motion_requirements(s, limits, [rows], resolution, WHERE),
            ]
        elif s.move is None:  # from pose to pose of a workspace
            rows = responses.Move.along(self.plan, response, limits).motion
            lines = judge.motion_requirements(s, limits, [rows], resolution, WHERE, rests=self.rests)
            lines += judge.limit_requirements(limits, [response], WHERE)
        else:
            move = responses.Move.along(self.plan, response, limits)
            lines = judge.move_requirements(s, limits, move, resolution, rests=self.rests)
        if self.rests:
            lines += judge.saturation_requirement(limits, [response], WHERE)
        if (watch := self.loop.controller.supervision) is not None:
            # The status outlasts the last swing; what swings while a robot still moves to its goal is no limit cycle.
            over = responses.transient_end(response, self.begun) + watch.longest_swing
            swings = (run.status & Status.LIMIT_CYCLE > 0) & (
                run.trajectory.time > (over if np.isfinite(over) else 0.0)
            )
            time = self.loop.controller.period * float(np.sum(swings))
            lines.append(REQUIREMENTS["swinging"].judge(None, 0.0, time, WHERE))
        lines = [replace(line, where=WHERE) for line in lines]
        lines = checks.as_far_as_judged(lines, response, self.begun, self.enough, timed=self.rests)
        if run.timing.real_time:
            missed = 100.0 * float(np.mean(run.timing.missed))
            lines.insert(0, REQUIREMENTS["deadlines"].judge(None, 0.0, missed, WHERE))
        return lines


def prepare_run(
    controller: Controller,
    designed: tuple[Robot, Specification],
    robot: Robot,
    specification: Specification,
    noise: bool = True,
    load: float | None = None,
    load_at: float | None = None,
    verdict: DesignVerdict = UNKNOWN,
    length: float = 0.0,
) -> DeployedRun:
    """A run of the deployed controller from start to goal, or along a stated move in error coordinates.

    A controller for a workspace goes from start to goal along `plans.quintic_move`, then rests.

    `designed`: robot and specification of the controller. `robot` is the driven robot, with `specification`.
    `noise`: whether measurements have the stated noise.
    `load`: torque on every link, N·m or N, from the time `load_at`, s, on; by default from the middle of the run.
    `verdict`: on the design. `length`: of its own step, s; the run is by default at least as long.
    """
    (model, original), s = designed, specification
    plan, start, goal = plans.run_ends(model, s)
    plants = loop_setup.LoopPlants(model, s)
    rests = law_of(original).any_pose and original.pose is None
    robot, true = plans.true_robot(robot, s)  # as it is judged
    box = loop_setup.LoopPlants(robot, s).mujoco_plant(goal)
    begun, aim = responses.start_and_goal(model, original, plans.stated_move(model, original))
    if rests and plan is None:
        plan = plans.quintic_move(model, plants.limits, start, goal)
    if plan is None:
        command = plans.step_command(model, s, start, goal, controller.law)
        reference: Any = None
        names = signals.signal_names("link_position", model.joint_names)
        if command is None and controller.mode.moving:
            reference = dict(zip(controller.commanded, np.concatenate(model.operating_point(goal)).tolist()))
        elif command is None and set(names) <= set(controller.commanded):
            reference = dict(zip(names, goal.tolist(), strict=True))
        elif command is None and not np.allclose(goal, aim, rtol=0.0, atol=1e-12):
            raise InvalidInput(
                "This controller takes no command: its law has no integrals and holds the pose of its design.",
                f"expected the goal {aim.tolist()}, got {goal.tolist()}",
                "the goal of the design; or a design whose penalty weighs link_position_integral",
            )
        if command is not None:
            controller, reference = plants.driven(controller, command)
        begun = 0.0 if command is None else command.duration
        duration = max(STEP_TIME + begun, length)
    else:
        controller, reference = plants.driven(controller, plan)
        begun = plan.duration
        still = plans.STILL if rests else max((MOVE_TIMES - 1.0) * begun, WINDOW)
        duration = s.period * round((begun + still) / s.period)
    enough, duration = duration, duration if s.duration is None else s.duration
    x, _ = robot.operating_point(start, true.extras)
    at = 0.5 * duration if load_at is None else load_at
    refuse_if(
        load is not None and not 0.0 <= at < duration,
        "The load begins outside of the run.",
        f"expected 0 to {duration:g} s, got {at:g} s",
        "--load-at 1s, or a longer --duration",
    )
    begun = begun if load is None else max(begun, at)
    torques = signals.signal_names("link_torque", robot.joint_names)
    arguments = {
        "reference": reference,
        "duration": duration,
        "initial_state": x[: len(box.states)],
        "noise": plants.noise if noise else None,
        "seed": s.seed,
        "disturbance": None if load is None else {name: Step(load, at=at) for name in torques},
    }
    # the controller gets the holding input, as in firmware
    if controller.mode.moving or not np.allclose(begun, start, rtol=0.0, atol=1e-12):
        state, holding_input = model.operating_point(start)
        arguments |= {"initial_input": holding_input} if not controller.first_input.is_zero else {}
        arguments |= {"initial_estimate": state} if controller.estimator is not None else {}
    loop = Loop(box, controller, quantisation=plants.quantisation, delay=s.unknown_delay)
    return DeployedRun(robot, plants, box, loop, start, goal, plan, arguments, rests, verdict, begun, enough)


def perturbed(robot: Robot, changes: Sequence[str]) -> Robot:
    """The robot with other parameters: ``stiffness=-20%``, ``stiffness_elbow=95``, ``friction=+50%``.

    A name without a joint changes the parameter of all joints.
    """
    values = dict(robot.nominal)
    for text in changes:
        name, _, number = text.partition("=")
        joints, name = robot.joint_names, name.strip()
        full = (per_joint(name, joint, len(joints)) for joint in joints)
        names = list(dict.fromkeys(parameter for parameter in (name, *full) if parameter in robot.nominal))
        refuse_if(
            not names,
            f"The robot {robot.name!r} has no such parameter to change.",
            f"expected NAME=VALUE with a name out of {list(robot.nominal)}, got {value_text(text, 60)}",
            f"{nearest(name, robot.nominal, 'stiffness').strip(chr(39))}=-20%",
        )
        share = number.strip().endswith("%")
        value = np.nan
        with suppress(ValueError):
            value = float(number.strip().rstrip("%"))
        refuse_if(
            not np.isfinite(value),
            "A change of the robot cannot be read.",
            f"expected NAME=NUMBER or NAME=±PERCENT%, got {value_text(text, 60)}",
            "stiffness=-20%",
        )
        for parameter in names:
            values[parameter] = robot.nominal[parameter] * (1.0 + 0.01 * value) if share else value
    return robot.with_values(values)


# A campaign: the same run on sampled robots ----------------------------------------------------------------
#: Names of numbers of a sample, before those of a joint or a measurement; the last has none.
ERROR, TORQUE, OFFSET, DELAY = "initial_error", "link_torque", "encoder_offset", "unknown_delay_samples"


@dataclass(frozen=True, eq=False)
class RobotSamples:
    """Makes true robots from the numbers of samples, each in equilibrium where its run begins.

    The estimator starts at `start` (n,), rad or m. Raises an error where no input holds a robot there; the sample then
    fails.
    """

    robot: Robot
    start: np.ndarray
    extras: tuple[str, ...]

    def __call__(self, numbers: Mapping[str, float]) -> Sample:
        """The sample with these numbers."""
        return self.columns({name: np.array([value]) for name, value in numbers.items()})[0]

    def columns(self, numbers: Columns) -> SampleColumns:
        """Samples with these numbers (N,), by name."""
        robot, joints, count = self.robot, self.robot.joint_names, len(next(iter(numbers.values())))
        values = robot.varied(numbers)
        errors = [numbers.get(name, np.zeros(count)) for name in signals.signal_names(ERROR, joints)]
        x = robot.starting_states(self.start + np.column_stack(errors), self.extras, values)
        loads = {name: numbers[name] for name in signals.signal_names(TORQUE, joints) if name in numbers}
        return SampleColumns(numbers, self._plant.known(values), x, loads)

    @cached_property
    def _plant(self) -> ParameterTable:
        return self.robot.plant(extras=self.extras).parameters


def varied(robot: Robot, o: CampaignOptions, extras: Sequence[str]) -> tuple[Robot, tuple[Variable, ...]]:
    """The robot with the tolerances of a campaign, and what varies from sample to sample."""
    inactive = elastic.inactive_parameters(extras, robot.joint_names, robot.nominal)
    for name, spread in o.tolerances:
        refuse_if(
            name in inactive,
            f"The parameter {name!r} does not act in this design's true plant.",
            f"expected one of its extras {list(extras)} or of every plant, got {name!r}",
            "the design with --extras for it",
        )
        robot = robot.with_parameters(_spread(robot[name], spread))
    acting = [p for p in robot.uncertain if p.name not in inactive]
    variables = [Variable(p.name, *p.interval, o.distribution, p.unit) for p in acting]
    for size, name, signal in (
        (o.initial_error, ERROR, "link_position"),
        (o.disturbance, TORQUE, TORQUE),
    ):
        names = signals.signal_names(name, robot.joint_names) if size else ()
        variables += [
            Variable(full_name, -size, size, o.distribution, signals.UNITS[signal][sliding])
            for full_name, sliding in zip(names, robot.links.slides)
        ]
    return robot, tuple(variables)


class RunNumbers(Protocol):
    """Metrics of the runs of a campaign."""

    @property
    def limits(self) -> responses.JointLimits:
        """Limits of the joints."""
        ...

    @property
    def units(self) -> dict[str, str]:
        """Units by metric."""
        ...


@dataclass(frozen=True, eq=False)
class DesignedLaw(Generic[LawOfRuns]):
    """What a campaign runs: the law of a design, the length of its runs, s (0 of moves, each of which has its own), and
    the verdict on the design, which is not known where the law was made for the campaign alone."""

    law: LawOfRuns
    length: float
    verdict: DesignVerdict = UNKNOWN


@dataclass(frozen=True, eq=False)
class DesignCampaign(ABC, Generic[LawOfRuns]):
    """A design and the options of its campaign. An unchanged report of the design supplies the law."""

    request: DesignRequest
    options: CampaignOptions
    robot: Robot  # the true robot with the tolerances of the campaign
    variables: tuple[Variable, ...]  # what varies from sample to sample
    metrics: RunNumbers  # those of each run, with the limits of the design

    @property
    def specification(self) -> Specification:
        """The specification of the design."""
        return self.request.specification

    @property
    @abstractmethod
    def runs(self) -> Mapping[str, str]:
        """Settings that say which runs are made, as text by name."""

    @property
    @abstractmethod
    def requirements(self) -> tuple[str, ...]:
        """Requirements on each run from the design's specification, besides reaching its end."""

    @abstractmethod
    def law_of(self, loop: Any) -> DesignedLaw[LawOfRuns]:
        """The law that runs, of the loop of the design (a `DesignedLoop` of its kind)."""

    @abstractmethod
    def store(self, law: LawOfRuns, folder: Path) -> None:
        """Write the law into the folder of a campaign."""

    @abstractmethod
    def stored(self, folder: Path) -> LawOfRuns:
        """The law in the folder of a campaign."""

    @abstractmethod
    def campaign(self, designed: DesignedLaw[LawOfRuns]) -> Campaign:
        """The campaign with a law, and runs of its length."""

    @property
    def stated(self) -> dict[str, str]:
        """Settings of design and campaign as text by name, known before anything is designed."""
        o, s, model = self.options, self.specification, self.request.robot
        changed = [p for p in self.robot.parameters if p not in model.parameters]
        parameters = [*(("robot", p) for p in model.parameters), *(("true robot", p) for p in changed)]
        return {
            "samples": str(o.samples),
            "seed": str(o.seed),
            **({} if o.batch is None else {"batch": str(o.batch)}),
            "method": o.method,
            **{f"variable {v.name}": v.text() for v in self.variables},
            **self.runs,
            **{f"design {name}": text for name, text in design_file.fields_text(s).items()},
            **{f"{which} {p.name}": f"{p.value!r} {p.unit} {p.spread}".strip() for which, p in parameters},
        }


def with_payload(design: DesignRequest, payload: str | None) -> Robot:
    """The robot of a design, with another payload where one is stated."""
    return design.robot if payload is None else load_robot(design.source, design.elastic, payload=payload)


@dataclass(frozen=True, eq=False)
class PoseCampaign(DesignCampaign[Controller]):
    """The campaign of a design of one pose: its step or its move, by many robots."""

    metrics: monte_carlo.RunMetrics
    plan: motions.Plan | None  # the move that the design is judged along, as `stated_move`; None for a step
    ends: tuple[np.ndarray, np.ndarray]  # link positions (n,) where a run begins and should end, rad or m

    @classmethod
    def of(cls, design: DesignRequest, o: CampaignOptions) -> PoseCampaign:
        """The campaign of a design with these options.

        Raises InvalidInput: for a parameter that does not act, where nothing varies, or for a duration that does not
            fit the period.
        """
        s, robot = design.specification, design.robot
        for name in ("encoder_offset", "extra_delay"):
            refuse_if(
                getattr(o, name),
                f"The option {declared(CampaignOptions)[name].option} is of a design for a workspace.",
                f"expected none for a design of one pose, got {getattr(o, name):g}",
                "a design without --pose, or leave it out",
            )
        plan, start, goal = plans.run_ends(robot, s)
        limits = responses.joint_limits(robot, s)
        metrics = monte_carlo.RunMetrics(limits, (start, goal))
        if plan is not None:
            instants = np.arange(0.0, plan.duration + 0.5 * s.period, s.period)
            travel = np.ptp(np.reshape(plan(instants), (len(instants), -1)), axis=0)
            metrics = monte_carlo.RunMetrics(
                limits, None, judge.move_limits(REQUIREMENTS["tracking"].stated(s), limits, travel)
            )
        if o.duration is not None:
            sample_count(o.duration, s.period)
        robot, true = plans.true_robot(with_payload(design, o.payload), s)
        robot, variables = varied(robot, o, true.extras)
        refuse_if(
            not variables,
            f"Nothing differs from sample to sample: the robot {robot.name!r} states no tolerance.",
            "expected a tolerance, a range of the payload, an initial error or a disturbance",
            "--tolerance stiffness=10%, --payload 0..2kg, --initial-error 0.01, --disturbance 0.5",
        )
        return cls(design, o, robot, variables, metrics, plan, (start, goal))

    @property
    def runs(self) -> dict[str, str]:
        """Where a run begins and should end, and its length where one is stated."""
        (start, goal), duration = self.ends, self.options.duration
        own = {} if duration is None else {"duration": str(float(duration))}
        return {"start": str(start.tolist()), "goal": str(goal.tolist()), **own}

    def law_of(self, loop: LoopAtPose) -> DesignedLaw[Controller]:
        """The controller of the step, or of the stated move and a rest as long as the step."""
        if self.plan is None:
            return DesignedLaw(loop.setup.bumpless_controller, loop.length)
        period = self.specification.period
        length = round((self.plan.duration + loop.length) / period) * period
        return DesignedLaw(loop.setup.along(self.plan)["controller"], length)

    def store(self, law: Controller, folder: Path) -> None:
        """As a file of its own."""
        law.save(folder / design_file.CONTROLLER_FILE)

    def stored(self, folder: Path) -> Controller:
        """From its file."""
        return load_controller(folder / design_file.CONTROLLER_FILE)

    def campaign(self, designed: DesignedLaw[Controller]) -> Campaign:
        """The campaign with a controller and runs of one length."""
        controller, duration = designed.law, designed.length
        s, robot, o, model = self.specification, self.robot, self.options, self.request.robot
        plants = loop_setup.LoopPlants(robot, s)
        plan = self.plan or plans.step_command(model, s, *self.ends, controller.law)
        reference = None
        if plan is not None:
            controller, reference = loop_setup.LoopPlants(model, s).driven(controller, plan)
        plant = plants.true_plant
        loop = Loop(
            plant, controller, plants.sub_steps, quantisation=plants.quantisation, delay=s.unknown_delay
        )
        options: RunOptions = {"duration": duration}
        if plants.noise is not None:
            options["noise"] = plants.noise
        if reference is not None:
            options["reference"] = reference
        if o.disturbance:  # of 1 N·m or 1 N; each sample has its own factor
            torque = Step(1.0, at=responses.LOAD_START * duration)
            options["disturbance"] = dict.fromkeys(signals.signal_names(TORQUE, robot.joint_names), torque)
        draw = Tolerances(
            self.variables, o.method, RobotSamples(plants.true.robot, self.ends[0], plants.extras)
        )
        return Campaign(
            loop,
            draw,
            o.samples,
            o.seed,
            options,
            self.metrics.metrics(plant.states, controller.states, controller.commanded),
            signals.signal_names("link_position", robot.joint_names),
            o.batch,
            self.stated,
            None if plants.knows_friction else LinearPlant(plants.smooth_plant, s.damped_below_limit),
        )

    @property
    def requirements(self) -> tuple[str, ...]:
        """Requirements on each run from the design's specification, besides reaching its end."""
        move = ("tracking_error_use<=1", "final_error_use<=1")
        step = ("settling_time_s<=1e9", f"overshoot_percent<={self.specification.limit('overshoot'):g}")
        return (*(step if self.plan is None else move), *(f"{name}<=1" for name in self.metrics.uses))


def _spread(parameter: Parameter, text: str) -> Parameter:
    low, dots, high = text.partition("..")
    with suppress(ValueError):
        if dots:
            return replace(parameter, tolerance=0.0, range=(quantity(low), quantity(high)))
        if text.strip().endswith("%"):
            return replace(parameter, tolerance=float(quantity(text, ({"%": 1.0},))), range=None)
    raise InvalidInput(
        f"The tolerance of {parameter.name!r} cannot be read.",
        f"expected per cent of its value, or an interval in {parameter.unit or 'its unit'}, got {value_text(text)}",
        f"--tolerance {parameter.name}=10%, or --tolerance {parameter.name}={0.9 * parameter.value:g}.."
        f"{1.1 * parameter.value:g}",
    )
