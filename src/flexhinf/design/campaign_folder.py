"""Campaign of a design: its step or move on sampled robots, the campaign's folder, and the comparison of two."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from flexhinf.campaign import (
    Campaign,
    CampaignJudgement,
    Journal,
    PairedCampaigns,
    Sample,
    Tolerances,
    Variable,
)
from flexhinf.campaign.journal import check_own_folder, differing, listed
from flexhinf.design.checks import end_limit_cycle
from flexhinf.design.design_file import (
    DESIGN_FILE,
    DesignRequest,
    load_design,
    plain,
    read_request,
    request_document,
)
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import DESIGN
from flexhinf.design.loop_setup import LoopPlants
from flexhinf.design.options import CampaignOptions
from flexhinf.design.pipeline import step_duration
from flexhinf.design.plans import has_integrals, move_reference, stated_move, step_command
from flexhinf.design.requirements import RunMetrics, final_limits, tracking_limits
from flexhinf.design.responses import LOAD_START, Plan, joint_limits, plan_ends, start_and_goal
from flexhinf.design.result import forwarded
from flexhinf.design.specification import FIELDS, Specification
from flexhinf.design.synthesis.steps import synthesise
from flexhinf.errors import InvalidInput
from flexhinf.files import locked, write_file
from flexhinf.loop import Controller, Loop, Step, load_controller
from flexhinf.loop.simulation.inputs import sample_count
from flexhinf.report import unchanged
from flexhinf.robot import Parameter, Robot, load_robot
from flexhinf.robot.elastic import inactive_parameters
from flexhinf.robot.signals import UNITS, signal_names
from flexhinf.validation import checked_path, read_toml, value_text

_PERCENT = re.compile(r"\s*([\d.eE+-]+)\s*%\s*\Z")
_RANGE = re.compile(r"\s*([-+\d.eE]+?)\s*\.\.\s*([-+\d.eE]+)\s*\Z")


def robot_sample(
    robot: Robot, start: np.ndarray, extras: tuple[str, ...], numbers: Mapping[str, float]
) -> Sample:
    """True robot with the parameters of a sample and `extras`, in equilibrium at the sample's start.

    The estimator starts at `start` (n,), rad or m. Raises an error for a robot that no input holds there: the sample
    fails.
    """
    values = robot.plant_parameters(robot.nominal | {k: v for k, v in numbers.items() if k in robot.nominal})
    errors = [numbers.get(name, 0.0) for name in signal_names(ERROR, robot.joint_names)]
    x, _ = robot.operating_point(start + errors, extras, values)
    loads = {name: numbers[name] for name in signal_names(TORQUE, robot.joint_names) if name in numbers}
    parameters = robot.plant(extras=extras).parameters.known(values)
    return Sample(parameters, {"initial_state": x}, numbers, loads=loads)


ERROR, TORQUE = "initial_error", "link_torque"


@dataclass(frozen=True, eq=False)
class DesignCampaign:
    """A design and the options of its campaign; the controller is that of the report `file` if that is unchanged."""

    request: DesignRequest
    options: CampaignOptions
    file: Path | None = None

    specification = forwarded("request.specification", Specification, "The specification of the design.")

    @cached_property
    def robot(self) -> Robot:
        """The true robot with the tolerances of the campaign; InvalidInput for a parameter that does not act."""
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
        """The move that the design is judged along, as `stated_move`; None for a step."""
        return stated_move(self.request.robot, self.specification)

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Link positions (n,) where a run begins, and where it should end, rad or m."""
        if self.plan is not None:
            return plan_ends(self.plan)
        return start_and_goal(self.request.robot, self.specification, None)

    @cached_property
    def variables(self) -> tuple[Variable, ...]:
        """Quantities that vary from sample to sample; InvalidInput if none does."""
        o, robot = self.options, self.robot
        off = inactive_parameters(self.specification.extras, robot.joint_names)
        acting = [p for p in robot.uncertain if p.name not in off]
        variables = [Variable(p.name, *p.interval, o.distribution, p.unit) for p in acting]
        for size, name, signal in (
            (o.initial_error, ERROR, "link_position"), (o.disturbance, TORQUE, TORQUE),
        ):  # fmt: skip
            names = signal_names(name, robot.joint_names) if size else ()
            variables += [
                Variable(full_name, -size, size, o.distribution, UNITS[signal][sliding])
                for full_name, sliding in zip(names, robot.links.slides)
            ]
        if not variables:
            raise InvalidInput(
                f"Nothing differs from sample to sample: the robot {robot.name!r} states no tolerance.",
                "expected a tolerance, a range of the payload, an initial error or a disturbance",
                "--tolerance stiffness=10%, --payload 0..2kg, --initial-error 0.01, --disturbance 0.5",
            )
        return tuple(variables)

    @property
    def stated(self) -> dict[str, str]:
        """Settings of design and campaign as text by name, before anything is designed; InvalidInput for a misfit."""
        o, s, (start, goal) = self.options, self.specification, self.ends
        length = {} if o.duration is None else {"duration": str(float(o.duration))}
        if o.duration is not None:
            sample_count(o.duration, s.period)
        fields = {f"design {name}": text for name, text in fields_text(s).items()}
        robots = {"robot": self.request.robot, "true robot": self.robot}
        parameters = {
            f"{which} {p.name}": f"{p.value!r} {p.unit} {p.spread}".strip()
            for which, robot in robots.items()
            for p in robot.parameters
            if which == "robot" or p not in self.request.robot.parameters
        }
        return {
            "samples": str(o.samples), "seed": str(o.seed), "batch": str(o.batch), "method": o.method,
            **{f"variable {v.name}": v.text() for v in self.variables},
            "start": str(start.tolist()), "goal": str(goal.tolist()), **fields, **parameters, **length,
        }  # fmt: skip

    def campaign(self, controller: Controller, duration: float) -> Campaign:
        """The campaign with a controller and runs of this length, s."""
        s, robot, o = self.specification, self.robot, self.options
        plants, plant = LoopPlants(robot, s), robot.plant(s.measured, extras=s.extras)
        loop = Loop(plant, controller, None, quantisation=plants.quantisation, delay=s.delay)
        reference: Any = None  # where the law holds its goal
        if self.plan is not None:
            reference = move_reference(self.request.robot, self.plan, plants.dry_friction)
        elif has_integrals(controller.law):
            reference = step_command(self.request.robot, s, *self.ends)
        # a disturbance is of one N·m or N; what a sample draws is the factor
        torques = dict.fromkeys(signal_names(TORQUE, robot.joint_names), Step(1.0, at=LOAD_START * duration))
        arguments = {
            "reference": reference, "noise": plants.noise, "disturbance": torques if o.disturbance else None,
        }  # fmt: skip
        options: dict[str, Any] = {"duration": duration}
        options |= {name: value for name, value in arguments.items() if value is not None}
        draw = Tolerances(self.variables, o.method, partial(robot_sample, robot, self.ends[0], s.extras))
        return Campaign(
            loop, draw, o.samples, o.seed, options,
            self.metrics.metrics(plant.states, controller.states, controller.commanded),
            signal_names("link_position", robot.joint_names), o.batch, self.stated,
        )  # fmt: skip

    @cached_property
    def metrics(self) -> RunMetrics:
        """Metrics of each run, with the limits of the design."""
        s, limits = self.specification, joint_limits(self.request.robot, self.specification)
        if self.plan is None:
            return RunMetrics(limits, self.ends)
        instants = np.arange(0.0, self.plan.duration + 0.5 * s.period, s.period)
        travel = np.ptp(np.reshape(self.plan(instants), (len(instants), -1)), axis=0)
        return RunMetrics(limits, None, (tracking_limits(s, limits, travel), final_limits(limits, travel)))

    @property
    def requirements(self) -> tuple[str, ...]:
        """Requirements on each run from the design's specification, besides reaching its end."""
        limits, move = self.metrics.limits, ("tracking_error_use<=1", "final_error_use<=1")
        step = ("settling_time_s<=1e9", f"overshoot_percent<={self.specification.overshoot:g}")
        peak = ("input_limit_use<=1",) if limits.limits_peak else ()
        speed = ("speed_limit_use<=1",) if limits.limits_speed else ()
        return (*(step if self.plan is None else move), *peak, *speed)


def fields_text(s: Specification) -> dict[str, str]:
    """The fields of a specification that are not at their defaults, as text."""
    values = {name: (plain(name, getattr(s, name)), plain(name, f.default)) for name, f in FIELDS.items()}
    return {name: str(value) for name, (value, default) in values.items() if value != default}


def _spread(parameter: Parameter, text: str) -> Parameter:
    percent, ends = _PERCENT.match(text), _RANGE.match(text)
    with suppress(ValueError):
        if percent:
            return replace(parameter, tolerance=float(percent[1]), range=None)
        if ends:
            return replace(parameter, tolerance=0.0, range=(float(ends[1]), float(ends[2])))
    raise InvalidInput(
        f"The tolerance of {parameter.name!r} cannot be read.",
        f"expected per cent of its value, or an interval in {parameter.unit or 'its unit'}, got {value_text(text)}",
        f"--tolerance {parameter.name}=10%, or --tolerance {parameter.name}={0.9 * parameter.value:g}.."
        f"{1.1 * parameter.value:g}",
    )


#: Folders of the two campaigns in that of their comparison.
FOLDERS = ("a", "b")

#: Fields of a specification that say on what robot, with which sensors and motors the law runs; all others say which
#: law that is. Start, goal and limits are compared as numbers.
SHARED = ("measured", "measurement_noise", "quantisation", "period", "delay", "extras", "move")

#: Differences that a refusal lists.
_LISTED = 6


@dataclass(frozen=True, eq=False)
class DesignPair:
    """Two designs with the same options, robots, sensors, motors and step; InvalidInput says what differs."""

    a: DesignCampaign
    b: DesignCampaign

    def __post_init__(self) -> None:
        sides = self.a, self.b
        a, b = map(_circumstances, sides)
        rows = [f"{name}: {in_a} ↔ {in_b}" for name, in_a, in_b in differing(a, b, [*a, *b], "default")]
        plants = [
            side.robot.plant(side.specification.measured, extras=side.specification.extras) for side in sides
        ]
        if not rows and plants[0].code_key != plants[1].code_key:
            rows = ["the equations of the robots, which have the same parameters"]
        if rows:
            raise InvalidInput(
                "The designs are not for the same robot, sensors, motors and step; their runs cannot be compared "
                "sample by sample.",
                listed(rows, _LISTED),
                "designs that differ in preset, weights, degrees, γ or estimator only",
            )

    @property
    def differences(self) -> list[tuple[str, str, str]]:
        """Fields of the specifications that differ, and their values in a and in b."""
        a, b = fields_text(self.a.specification), fields_text(self.b.specification)
        return differing(a, b, [*a, *b], "default")


@dataclass(frozen=True, eq=False)
class PairResult:
    """Two designs that were run on the same samples: each judged by the same requirements, and both compared."""

    pair: DesignPair
    folder: Path
    names: tuple[str, str]
    judged: tuple[CampaignJudgement, CampaignJudgement]
    paired: PairedCampaigns
    command: tuple[str, ...] = ()


def _circumstances(side: DesignCampaign) -> dict[str, str]:
    """Settings of a campaign as text by name, except those of its control law."""
    limits = side.metrics.limits
    stated = {name: text for name, text in side.stated.items() if not name.startswith("design ")}
    fields = {name: text for name, text in fields_text(side.specification).items() if name in SHARED}
    return {
        **stated, **fields, "true state fed back": str(side.specification.estimator == "none"),
        "limits of the inputs": str(limits.peak.tolist()), "saturation": str(limits.saturation.tolist()),
        "limits of the speeds": str(limits.speed.tolist()),
    }  # fmt: skip


#: Folder of the design file and the controller inside a campaign's, and their names.
SETUP, CONTROLLER = "setup", "controller"

#: Held while a controller is designed and written.
SETUP_LOCK = ".campaign-setup-lock"

#: What the folder of a comparison may hold.
_OWN = (*FOLDERS, "index.html")

#: How long a driver waits for another one that designs the controller, s.
PATIENCE = 3600.0


def open_campaign(
    request: DesignCampaign,
    folder: str | Path,
    command: Sequence[str] = (),
    progress: Callable[[str], None] = print,
    designed: tuple[Controller, float] | None = None,
) -> tuple[Campaign, Journal]:
    """Open the campaign of a folder: design its controller and store it there, or resume with the stored one.

    `designed`: for a new folder, controller and length of its runs (s) as of `designed_controller`.

    InvalidInput before any work if the folder holds something else or a campaign with other settings; FlexhinfError as
    `flexhinf.design.design`.
    """
    _ = request.stated, request.metrics  # refuses what does not fit
    journal, place = Journal.read(folder, (SETUP,)), Path(folder).expanduser().absolute()
    if journal is None:
        (place / SETUP).mkdir(parents=True, exist_ok=True)
        with locked(place / SETUP_LOCK, PATIENCE):
            journal = Journal.read(folder, (SETUP,))  # another driver of a job array may have been quicker
            if journal is None:
                return _begun(request, place, command, *(designed or designed_controller(request, progress)))
    journal.refuse_other(request.stated, partly=True)
    campaign = reopened(request, journal)
    journal.refuse_campaign(campaign)
    return campaign, journal


def _begun(
    request: DesignCampaign, place: Path, command: Sequence[str], controller: Controller, duration: float
) -> tuple[Campaign, Journal]:
    o, design, setup = request.options, request.request, place / SETUP
    duration = duration if o.duration is None else o.duration
    request.campaign(controller, duration)  # refuses what does not fit before anything is written
    document = request_document(
        design.specification, design.source, design.elastic, setup, design.payload, design.robot.links.slides
    )
    text = tomlkit.dumps(document)
    write_file(setup / DESIGN_FILE, "design file", lambda name: Path(name).write_text(text, encoding="utf-8"))
    controller.save(setup / CONTROLLER)
    campaign = request.campaign(load_controller(setup / CONTROLLER), duration)
    nominal = {v.name: request.robot.nominal.get(v.name, 0.0) for v in request.variables}
    about = {
        "title": f"Campaign of the robot “{design.robot.name}”", "requirements": list(request.requirements),
        "nominal": nominal, "options": {**vars(o), "tolerances": [list(tolerance) for tolerance in o.tolerances]},
    }  # fmt: skip
    return campaign, Journal.opened(place, campaign, command, about)


def designed_controller(
    request: DesignCampaign, progress: Callable[[str], None] = print
) -> tuple[Controller, float]:
    """Controller and length of its runs, s: read from an unchanged report, or designed now.

    A report's controller begins at the start of the step, so for a move a controller is designed that begins there.
    """
    path, plan, robot, s = request.file, request.plan, request.request.robot, request.specification
    report = path if plan is None and path is not None and path.name == DESIGN_FILE else None
    if report and unchanged(report.parent, (DESIGN_FILE, CONTROLLER)):
        length = read_toml(report, "design file").get("result", {}).get("duration")
        if isinstance(length, float) and fields_text(load_design(report)[1]) == fields_text(s):
            return load_controller(report.parent / CONTROLLER), length
    synthesis = synthesise(robot, s, progress)
    setup, _ = end_limit_cycle(synthesis.setup(robot, s))
    length = step_duration(LawEvaluation(DESIGN, setup), synthesis)
    if plan is None:
        return setup.bumpless_controller, length
    periods = round((plan.duration + length) / s.period)
    return setup.controller(request.ends[0], moving=True), periods * s.period


def reopened(request: DesignCampaign, journal: Journal) -> Campaign:
    """The campaign of a folder, with its stored controller."""
    duration = float(journal.settings["duration"])
    return request.campaign(load_controller(journal.folder / SETUP / CONTROLLER), duration)


def stored_campaign(folder: str | Path) -> tuple[Campaign, Journal]:
    """The stored campaign of a folder, for replays; its settings are read from the folder.

    InvalidInput if it holds no campaign of a design, or the robot's file was changed since.
    """
    journal = Journal.read(folder)
    if journal is None or "options" not in journal.about:
        raise InvalidInput(
            "The folder holds no campaign of a design.",
            f"expected a folder that `flexhinf campaign` wrote, got {folder}",
            "its --out; a campaign from Python replays with Campaign(...).replay(sample)",
        )
    request = stored_request(journal)
    journal.refuse_other(request.stated, partly=True)
    return reopened(request, journal), journal


def stored_request(journal: Journal) -> DesignCampaign:
    """The design and the campaign of a folder."""
    known = CampaignOptions.__dataclass_fields__
    try:
        stored = {name: value for name, value in journal.about["options"].items() if name in known}
        stored["tolerances"] = tuple((str(name), str(spread)) for name, spread in stored["tolerances"])
        options = CampaignOptions(**stored)
    except InvalidInput:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInput(
            "The options of the campaign cannot be read.",
            f"{journal.folder}: {error}",
            "a copy of its manifest",
        ) from error
    return DesignCampaign(read_request(journal.folder / SETUP / DESIGN_FILE), options)


def open_pair(
    pair: DesignPair,
    folder: str | Path,
    commands: Sequence[Sequence[str]] = ((), ()),
    progress: Callable[[str], None] = print,
) -> list[tuple[Campaign, Journal]]:
    """Open the campaigns of both designs in the folders `FOLDERS`, new ones or stored ones, with runs of equal length.

    Raises as `open_campaign`, before any work for either.
    """
    place = checked_path("The comparison's folder", folder).expanduser().absolute()
    check_own_folder(place, "comparison of campaigns", _OWN)
    place.mkdir(parents=True, exist_ok=True)
    with locked(place / SETUP_LOCK, PATIENCE):
        sides = [(side, Journal.read(place / at, (SETUP,))) for side, at in zip((pair.a, pair.b), FOLDERS)]
        for side, journal in sides:
            if journal is not None:  # refused before the other one is designed
                journal.refuse_other(side.stated, partly=True)
        designed = [None if journal else designed_controller(side, progress) for side, journal in sides]
        begun = [float(journal.settings["duration"]) for _, journal in sides if journal]
        duration = begun[0] if begun else float(np.max([result[1] for result in designed if result]))
        return [
            open_campaign(side, place / name, command, progress, result and (result[0], duration))
            for (side, _), name, command, result in zip(sides, FOLDERS, commands, designed)
        ]
