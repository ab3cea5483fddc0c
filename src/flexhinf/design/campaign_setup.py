"""The campaign of a design: its step or move on robots within their tolerances, with its controller as it is.

Figures of the runs of a design's campaign, of a run's signals or of runs in lanes, with the same numbers.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.campaign import (
    DISTRIBUTIONS,
    METHODS,
    Campaign,
    Metrics,
    Sample,
    Tolerances,
    Variable,
    check_counts,
    one_of,
)
from flexhinf.design.design_file import DesignRequest, plain
from flexhinf.design.joint_limits import JointLimits, joint_limits
from flexhinf.design.loop_setup import LoopPlants
from flexhinf.design.monte_carlo import move_reductions, position_columns, step_reductions
from flexhinf.design.plans import has_integrals, move_reference, stated_move, step_command
from flexhinf.design.requirements import final_limits, tracking_limits
from flexhinf.design.responses import LOAD_START, Plan, Response, plan_ends, start_and_goal
from flexhinf.design.specification import FIELDS, Specification
from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, EnsembleResult, Loop, Reduction, Step, Trajectory
from flexhinf.loop.simulation.compiled_runs import sample_count
from flexhinf.loop.simulation.metrics import steady_state_error
from flexhinf.robot import Parameter, Robot, load_robot
from flexhinf.robot.elastic import inactive_parameters
from flexhinf.robot.signals import UNITS, signal_names
from flexhinf.validation import value_text


@dataclass(frozen=True)
class JointFigure:
    """A figure that joints have: its unit for each joint, and which of them have it."""

    units: Sequence[str]
    joints: Sequence[int]

    @property
    def unit(self) -> str:
        """Of the worst of all joints; empty where they differ."""
        return self.units[0] if len(set(self.units)) == 1 else ""


@dataclass(frozen=True, eq=False)
class RunMetrics(ABC):
    """Figures of a run of all joints, each the worst of them, and where there are several those of each joint."""

    limits: JointLimits

    # What a step, or a move, has of its own -----------------------------------------------------------
    @property
    @abstractmethod
    def own(self) -> dict[str, JointFigure]:
        """Its figures, the main one first."""

    @abstractmethod
    def of_run(self, run: Trajectory) -> tuple[Response, Sequence[Mapping[str, Any]]]:
        """A run, and for each joint all its figures by name; None where it does not come to one."""

    @abstractmethod
    def of_many(self, common: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Its figures of N runs by name, (N, n); what is said of a joint that has none does not count."""

    @abstractmethod
    def reductions(self, commanded: Sequence[str], pairs: Any) -> list[Reduction]:
        """What is kept of runs in lanes for `of_many`."""

    # What both have -----------------------------------------------------------------------------------
    @property
    def every(self) -> range:
        """All joints."""
        return range(len(self.limits.joints))

    @cached_property
    def figures(self) -> dict[str, JointFigure]:
        """Its own, then peaks."""
        peaks = {"peak_input": self.limits.effort_units, "peak_speed": self.limits.speed_units}
        return {**self.own, **{name: JointFigure(units, self.every) for name, units in peaks.items()}}

    @property
    def units(self) -> dict[str, str]:
        """By name; a fraction of a limit only where there is one."""
        found = {name: figure.unit for name, figure in self.figures.items()}
        found["estimation_error"] = JointFigure(self.limits.position_units, self.every).unit
        found |= {"input_limit_use": ""} if self.limits.limits_peak else {}
        found |= {"speed_limit_use": ""} if self.limits.limits_speed else {}
        return found | {name: self.figures[kind].units[k] for name, (kind, k) in self._parts.items()}

    @cached_property
    def _parts(self) -> dict[str, tuple[str, int]]:
        """Figures of single joints, where there are several: what it is, and of which joint."""
        several = self.figures.items() if len(self.every) > 1 else ()
        names = self.limits.joints
        return {f"{kind}_{names[k]}": (kind, k) for kind, figure in several for k in figure.joints}

    def __call__(self, run: Trajectory) -> dict[str, float]:
        """Of one run."""
        response, rows = self.of_run(run)
        values = {
            kind: {k: np.inf if rows[k][kind] is None else float(rows[k][kind]) for k in figure.joints}
            for kind, figure in self.figures.items()
        }
        found = {kind: max(each.values(), default=np.nan) for kind, each in values.items()}
        found |= {name: values[kind][k] for name, (kind, k) in self._parts.items()}
        found["estimation_error"] = max(
            (
                float(np.abs(run.signal("estimate", name) - run.signal("state", name)).max())
                for name in signal_names("link_position", self.limits.joints)
                if name in run.names["estimate"]
            ),
            default=np.nan,
        )
        found["input_limit_use"] = self.limits.input_use(response).share
        found["speed_limit_use"] = self.limits.speed_use(response).share
        return {name: found[name] for name in self.units}

    # In lanes -----------------------------------------------------------------------------------------
    def metrics(self, states: Sequence[str], estimated: Sequence[str], commanded: Sequence[str]) -> Metrics:
        """For a campaign, of runs in lanes too.

        Parameters
        ----------
        states, estimated, commanded : sequence of str
            Of the true plant, of the estimate and of the command.
        """
        names = [name for name in signal_names("link_position", self.limits.joints) if name in estimated]
        pairs = tuple((tuple(estimated).index(name), tuple(states).index(name)) for name in names)
        reductions = self.reductions(commanded, pairs)
        return Metrics(self.units, self, partial(self._reduced, bool(pairs)), reductions, tuple(self._parts))

    def _reduced(self, estimated: bool, found: EnsembleResult) -> dict[str, np.ndarray]:
        """As of one run, of N runs."""
        effort, speed = found.common["effort"], found.common["speed"]
        nothing = np.full(len(found.codes), np.nan)
        every = {**self.of_many(found.common), "peak_input": effort, "peak_speed": speed}
        values = {
            kind: every[kind][:, list(figure.joints)].max(axis=1) if len(figure.joints) else nothing
            for kind, figure in self.figures.items()
        }
        values["estimation_error"] = found.common["estimate"] if estimated else nothing
        values["input_limit_use"] = (effort / self.limits.peak).max(axis=1)
        values["speed_limit_use"] = (speed / self.limits.speed).max(axis=1)
        return values | {name: every[kind][:, k] for name, (kind, k) in self._parts.items()}


@dataclass(frozen=True, eq=False)
class StepMetrics(RunMetrics):
    """Of a step from start to goal (n,), rad or m: what `Response` and `JointLimits` say."""

    start: np.ndarray
    goal: np.ndarray

    @property
    def own(self) -> dict[str, JointFigure]:
        """Of the joints that move, and where every joint ends."""
        moving = np.flatnonzero(self.start != self.goal).tolist()
        kinds = {"overshoot_percent": "%", "settling_time_s": "s", "rise_time_s": "s"}
        found = {name: JointFigure([unit] * len(self.goal), moving) for name, unit in kinds.items()}
        return {**found, "steady_state_error": JointFigure(self.limits.position_units, self.every)}

    def of_run(self, run: Trajectory) -> tuple[Response, Sequence[Mapping[str, Any]]]:
        """As `Response` says."""
        response = Response(run, self.goal, self.start, self.limits.joints)
        return response, response.metrics

    def of_many(self, common: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """As `step_reductions` say."""
        late = common["late_error"]
        found = {
            kind: np.stack([common.get(f"{k} {kind}", late[:, k]) for k in self.every], axis=1)
            for kind in ("overshoot_percent", "settling_time_s", "rise_time_s")
        }
        return {**found, "steady_state_error": late}

    def reductions(self, commanded: Sequence[str], pairs: Any) -> list[Reduction]:
        """Of the step."""
        return step_reductions(self.start, self.goal, pairs)


@dataclass(frozen=True, eq=False)
class MoveMetrics(RunMetrics):
    """Of a move: what `Move` and `JointLimits` say.

    Parameters
    ----------
    tracking, final : (n,)
        Largest distances from the move, and from its end after it, rad or m.
    """

    plan: Plan
    tracking: np.ndarray
    final: np.ndarray

    @property
    def own(self) -> dict[str, JointFigure]:
        """How far from the move, and from its end after it; and both as fractions of what is required."""
        lengths, shares = self.limits.position_units, [""] * len(self.every)
        kinds = {
            "tracking_error": lengths, "tracking_error_use": shares,
            "final_error": lengths, "final_error_use": shares,
        }  # fmt: skip
        return {name: JointFigure(units, self.every) for name, units in kinds.items()}

    def of_run(self, run: Trajectory) -> tuple[Response, Sequence[Mapping[str, Any]]]:
        """As `Move` says, with the command of the run, which is the move at its samples."""
        begin, end = plan_ends(self.plan)
        response = Response(run, end, begin, self.limits.joints)
        rows = []
        for k, name in enumerate(signal_names("link_position", self.limits.joints)):
            position, command = response.positions[:, k], run.signal("reference", name)
            largest, final = float(np.abs(position - command).max()), steady_state_error(position, command)
            shares = {
                "tracking_error_use": largest / self.tracking[k],
                "final_error_use": final / self.final[k],
            }
            rows.append(response.metrics[k] | {"tracking_error": largest, "final_error": final, **shares})
        return response, rows

    def of_many(self, common: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """As `move_reductions` say."""
        error, late = common["tracking_error"], common["late_error"]
        return {
            "tracking_error": error, "tracking_error_use": error / self.tracking,
            "final_error": late, "final_error_use": late / self.final,
        }  # fmt: skip

    def reductions(self, commanded: Sequence[str], pairs: Any) -> list[Reduction]:
        """Of the move."""
        return move_reductions(position_columns(commanded, self.limits.joints), pairs)


_PERCENT = re.compile(r"\s*([\d.eE+-]+)\s*%\s*\Z")
_RANGE = re.compile(r"\s*([-+\d.eE]+?)\s*\.\.\s*([-+\d.eE]+)\s*\Z")


@dataclass(frozen=True)
class CampaignOptions:
    """What a campaign adds to a design.

    Attributes
    ----------
    samples, seed, batch : int
        See `Campaign`.
    distribution, method : str
        See `Variable` and `Tolerances`.
    tolerances : tuple of (str, str)
        Parameters of the robot and what they are instead: ``("stiffness", "15%")`` or ``("mass", "0.9..1.2")``.
    payload : str or None
        What the true robot carries instead, as for `load_robot`; the controller stays the design's.
    initial_error : float
        The robot starts up to so much (rad or m) beside where the estimator believes it, each joint by itself.
    disturbance : float
        A constant torque (N·m or N) of up to so much on each link, from a tenth of the run on.
    duration : float or None
        Of the runs, s; the design's by default.
    """

    samples: int
    seed: int = 0
    batch: int = 256
    distribution: str = "uniform"
    method: str = "random"
    tolerances: tuple[tuple[str, str], ...] = ()
    payload: str | None = None
    initial_error: float = 0.0
    disturbance: float = 0.0
    duration: float | None = None

    def __post_init__(self) -> None:
        check_counts(self.samples, self.seed, self.batch)
        one_of("distribution", self.distribution, DISTRIBUTIONS)
        one_of("method", self.method, METHODS)
        for name in ("initial_error", "disturbance"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InvalidInput(
                    f"The {name.replace('_', ' ')} is not usable.",
                    f"expected a number >= 0, the half width of its interval, got {value_text(value)}",
                    "0.01",
                )


@dataclass(frozen=True, eq=False)
class RobotDraw:
    """From numbers of a sample to its robot, in equilibrium where it starts.

    Parameters
    ----------
    robot : Robot
        The true one.
    start : (n,)
        Where the estimator believes it, rad or m.
    extras : tuple of str
        Of the true plant.
    """

    robot: Robot
    start: np.ndarray
    extras: tuple[str, ...]

    def __call__(self, numbers: Mapping[str, float]) -> Sample:
        """The sample; a robot that no input holds where it starts is refused, which is the sample's failure."""
        known = self.robot.nominal
        values = self.robot.plant_parameters(known | {k: v for k, v in numbers.items() if k in known})
        errors = [numbers.get(name, 0.0) for name in signal_names(ERROR, self.robot.joint_names)]
        x, _ = self.robot.operating_point(self.start + errors, self.extras, values)
        options: dict[str, Any] = {"initial_state": x}
        torques = signal_names(TORQUE, self.robot.joint_names)
        loads = {name: numbers[name] for name in torques if name in numbers}
        plant = self.robot.plant(extras=self.extras)
        return Sample(plant.parameters.known(values), options, numbers, loads=loads)


ERROR, TORQUE = "initial_error", "link_torque"


@dataclass(frozen=True, eq=False)
class DesignCampaign:
    """A design and the campaign that is asked for.

    Parameters
    ----------
    file : Path or None
        The design file it came from. Of a report that nobody changed the controller is taken as it was judged.
    """

    request: DesignRequest
    options: CampaignOptions
    file: Path | None = None

    @property
    def specification(self) -> Specification:
        """Of the design."""
        return self.request.specification

    @cached_property
    def robot(self) -> Robot:
        """The true robot with the tolerances of the campaign.

        Raises
        ------
        InvalidInput
            For a parameter that the robot does not have, or one that does not act.
        """
        robot = self.request.robot
        if self.options.payload is not None:
            robot = load_robot(self.request.source, self.request.elastic, payload=self.options.payload)
        off = inactive_parameters(self.specification.extras, robot.joint_names)
        for name, spread in self.options.tolerances:
            parameter = robot[name]
            if name in off:
                raise InvalidInput(
                    f"The parameter {name!r} does not act in this design's true plant.",
                    f"expected one of its extras {list(self.specification.extras)} or of every plant, got {name!r}",
                    "the design with --extras for it",
                )
            robot = robot.with_parameters(_spread(parameter, spread))
        return robot

    @cached_property
    def plan(self) -> Plan | None:
        """The move that the design is judged along; None for a step.

        Raises
        ------
        InvalidInput
            As `stated_move`.
        """
        return stated_move(self.request.robot, self.specification)

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Where a run begins, and where it should end (n,), rad or m."""
        if self.plan is not None:
            return plan_ends(self.plan)
        return start_and_goal(self.request.robot, self.specification, None)

    @cached_property
    def variables(self) -> tuple[Variable, ...]:
        """What differs from sample to sample.

        Raises
        ------
        InvalidInput
            If nothing does.
        """
        o, robot = self.options, self.robot
        slides = robot.links.slides
        off = inactive_parameters(self.specification.extras, robot.joint_names)
        found = [
            Variable(p.name, *p.interval, o.distribution, p.unit)
            for p in robot.uncertain
            if p.name not in off
        ]
        for size, name, signal in (
            (o.initial_error, ERROR, "link_position"),
            (o.disturbance, TORQUE, TORQUE),
        ):
            units = [UNITS[signal][sliding] for sliding in slides]
            names = signal_names(name, robot.joint_names) if size else ()
            found += [Variable(one, -size, size, o.distribution, unit) for one, unit in zip(names, units)]
        if not found:
            raise InvalidInput(
                f"Nothing differs from sample to sample: the robot {robot.name!r} states no tolerance.",
                "expected a tolerance, a range of the payload, an initial error or a disturbance",
                "--tolerance stiffness=10%, --payload 0..2kg, --initial-error 0.01, --disturbance 0.5",
            )
        return tuple(found)

    @property
    def stated(self) -> dict[str, str]:
        """The design and the campaign as text by name: known before anything is designed.

        Raises
        ------
        InvalidInput
            For what does not fit the robot.
        """
        o, s, (start, goal) = self.options, self.specification, self.ends
        length = {}
        if o.duration is not None:
            sample_count(o.duration, s.period)
            length = {"duration": str(float(o.duration))}
        fields = {f"design {name}": text for name, text in fields_text(s).items()}
        robots = {"robot": self.request.robot, "true robot": self.robot}
        parameters = {
            f"{which} {p.name}": f"{p.value!r} {p.unit} {p.spread}".strip()
            for which, robot in robots.items()
            for p in robot.parameters
            if which == "robot" or p not in self.request.robot.parameters
        }
        drawn = {f"variable {v.name}": v.text() for v in self.variables}
        return {
            "samples": str(o.samples), "seed": str(o.seed), "batch": str(o.batch), "method": o.method, **drawn,
            "start": str(start.tolist()), "goal": str(goal.tolist()), **fields, **parameters, **length,
        }  # fmt: skip

    def campaign(self, controller: Controller, duration: float) -> Campaign:
        """The campaign with a controller and runs of this length, s."""
        s, robot = self.specification, self.robot
        plants = LoopPlants(robot, s)
        plant = robot.plant(s.measured, extras=s.extras)
        loop = Loop(plant, controller, None, quantisation=plants.quantisation, delay=s.delay)
        options: dict[str, Any] = {"duration": duration}
        reference = self._reference(controller, plants.dry_friction)
        options |= {} if reference is None else {"reference": reference}
        options |= {} if plants.noise is None else {"noise": plants.noise}
        if self.options.disturbance:  # of one N·m or N; what a sample draws is the factor
            torques = signal_names(TORQUE, robot.joint_names)
            options["disturbance"] = dict.fromkeys(torques, Step(1.0, at=LOAD_START * duration))
        draw = Tolerances(self.variables, self.options.method, RobotDraw(robot, self.ends[0], s.extras))
        return Campaign(
            loop, draw, self.options.samples, self.options.seed, options,
            self.metrics.metrics(plant.states, controller.states, controller.commanded),
            signal_names("link_position", robot.joint_names), self.options.batch, self.stated,
        )  # fmt: skip

    def _reference(self, controller: Controller, dry_friction: tuple[str, ...]) -> Any:
        """The move with its feedforward, the shaped step, or nothing where the law holds its goal."""
        if self.plan is not None:
            return move_reference(self.request.robot, self.plan, dry_friction)
        if not has_integrals(controller.law):
            return None
        return step_command(self.request.robot, self.specification, *self.ends)

    @cached_property
    def metrics(self) -> RunMetrics:
        """Of each run."""
        s, limits = self.specification, joint_limits(self.request.robot, self.specification)
        if self.plan is None:
            return StepMetrics(limits, *self.ends)
        instants = np.arange(0.0, self.plan.duration + 0.5 * s.period, s.period)
        ways = np.ptp(np.reshape(self.plan(instants), (len(instants), -1)), axis=0)
        return MoveMetrics(limits, self.plan, tracking_limits(s, limits, ways), final_limits(limits, ways))

    @property
    def requirements(self) -> tuple[str, ...]:
        """What a run must keep by the design's specification, besides reaching its end."""
        limits = self.metrics.limits
        found = ["tracking_error_use<=1", "final_error_use<=1"]
        if self.plan is None:
            found = ["settling_time_s<=1e9", f"overshoot_percent<={self.specification.overshoot:g}"]
        found += ["input_limit_use<=1"] if limits.limits_peak else []
        return (*found, *(["speed_limit_use<=1"] if limits.limits_speed else []))

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal values of the variables."""
        return {v.name: self.robot.nominal.get(v.name, 0.0) for v in self.variables}


def fields_text(s: Specification) -> dict[str, str]:
    """The fields of a specification that are not at their defaults, as text."""
    values = {name: (plain(name, getattr(s, name)), plain(name, one.default)) for name, one in FIELDS.items()}
    return {name: str(value) for name, (value, default) in values.items() if value != default}


def _spread(parameter: Parameter, text: str) -> Parameter:
    """A parameter with another tolerance: ``12%``, or ``0.9..1.2`` in its unit."""
    percent, ends = _PERCENT.match(text), _RANGE.match(text)
    try:
        if percent:
            return replace(parameter, tolerance=float(percent[1]), range=None)
        if ends:
            return replace(parameter, tolerance=0.0, range=(float(ends[1]), float(ends[2])))
    except ValueError:
        pass
    raise InvalidInput(
        f"The tolerance of {parameter.name!r} cannot be read.",
        f"expected per cent of its value, or an interval in {parameter.unit or 'its unit'}, got {value_text(text)}",
        f"--tolerance {parameter.name}=10%, or --tolerance {parameter.name}={0.9 * parameter.value:g}.."
        f"{1.1 * parameter.value:g}",
    )
