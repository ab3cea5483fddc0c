"""The campaign of a controller for a workspace: each sample is a robot of the tolerances with a move of its own."""

# Not checked strictly: a cached property of `MoveMetrics` serves as a property.
# pyright: reportIncompatibleVariableOverride=false

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from flexhinf.arrays import Number, Vector
from flexhinf.campaign import Campaign, Metrics, Sample, Tolerances, Variable
from flexhinf.campaign.draws import METHODS
from flexhinf.campaign.samples import Columns
from flexhinf.designs import judge
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.deployed_run import (
    DELAY,
    ERROR,
    OFFSET,
    TORQUE,
    DesignCampaign,
    DesignedLaw,
    varied,
    with_payload,
)
from flexhinf.designs.judge import missed_by
from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.designs.motions import Motion, Plan
from flexhinf.designs.plans import true_robot
from flexhinf.designs.request import DesignRequest
from flexhinf.designs.requirements import POSITION, REQUIREMENTS, Requirement, on_motions
from flexhinf.designs.responses import LOAD_START, JointLimits, Move, Response, joint_limits
from flexhinf.designs.specification import Specification
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.evidence import LoopOverWorkspace
from flexhinf.designs.workspace.law_file import law_numbers, read_setup
from flexhinf.designs.workspace.samples import GOALS, GOALS_SEED
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import FlexhinfError, NumericalFailure, refuse_if
from flexhinf.files import write_file
from flexhinf.loop import Step, Trajectory
from flexhinf.loop.simulation.inputs import RunOptions, SampleOptions
from flexhinf.report import to_json
from flexhinf.robot.signals import UNITS, signal_names
from flexhinf.validation import one_of

#: The law's file in the folder of a campaign.
LAW = "law.json"

#: Blocks of goals that are kept; names of the ends of a move in a row, before those of the joints.
BLOCKS, ENDS = 8, ("start", "goal")

#: Metrics by the rows of `REQUIREMENTS` that they measure, and whether single joints have them too.
METRICS = {
    "overshoot": ("overshoot_percent", False),
    "tracking": ("tracking_error", True),
    "remaining": ("remaining_error", True),
    "path": ("path_distance", True),
    "undershoot": ("wrong_way_percent", False),
    "ripple": ("ripple_percent", False),
    "at_limit": ("time_at_limit_s", False),
}


@dataclass(frozen=True, eq=False)
class FollowedPlan:
    """A plan by its samples in a run."""

    time: np.ndarray  # (N,), s
    positions: np.ndarray  # (N, n), rad or m

    @cached_property
    def duration(self) -> float:
        """When it comes to rest, s."""
        moving = np.flatnonzero(np.any(self.positions != self.positions[-1], axis=1))
        return float(self.time[moving[-1] + 1]) if len(moving) else 0.0

    def __call__(self, t: Number) -> np.ndarray:
        """Link positions (…, n) at times t, straight between samples."""
        columns: list[Vector] = [np.interp(t, self.time, column) for column in self.positions.T]
        return np.stack(columns, axis=-1)


@dataclass(frozen=True, eq=False)
class MoveMetrics:
    """Metrics of a motion, by the requirements of a design on its motions."""

    specification: Specification
    limits: JointLimits
    motion: Motion | None = None  # the only one; None: moves between random goals, each a plan

    @cached_property
    def known(self) -> dict[str, tuple[str, bool]]:
        """`METRICS`, and those of requirements that have a file of their own and a limit."""
        own = (
            kind
            for kind in on_motions()
            if kind.name not in METRICS
            and not (kind.steps or kind.bounded)
            and kind.limit(self.specification)
        )
        return METRICS | {kind.name: (kind.metric, False) for kind in own}

    @cached_property
    def units(self) -> dict[str, str]:
        """Units by metric: the worst of all joints and its share of what is allowed; then those of single joints."""
        limits, known = self.limits, [name for name in self.known if self._applies(name)]
        units = {self.known[name][0]: self._unit(name) for name in known}
        units |= {f"{self.known[name][0]}_use": "" for name in known}
        uses = {
            "input_limit_use": limits.limits_peak,
            "speed_limit_use": limits.limits_speed,
            "range_use": True,
            "input_rate_use": limits.limits_rate,
            "input_acceleration_use": limits.limits_acceleration,
        }
        units |= {name: "" for name, limited in uses.items() if limited}
        return units | {f"{self.known[name][0]}_{joint}": unit for name, joint, unit in self._parts}

    @property
    def _parts(self) -> list[tuple[str, str, str]]:
        pairs = list(zip(self.limits.joints, self.limits.position_units))
        several = [
            name for name, (_, each) in self.known.items() if each and self._applies(name) and len(pairs) > 1
        ]
        return [(name, *pair) for name in several for pair in pairs]

    @property
    def _jumps(self) -> bool:
        return self.motion is not None and self.motion.jumps

    def _applies(self, name: str) -> bool:
        limited = {
            "overshoot": self._jumps,
            "tracking": not self._jumps,
            "path": REQUIREMENTS["path"].stated(self.specification) is not None,
            "ripple": bool(np.isfinite(self.limits.effort).any()),
            "at_limit": self.limits.limits_inputs,
        }
        return limited.get(name, True)

    def _unit(self, name: str) -> str:
        own = {"at_limit": "s"}.get(name, REQUIREMENTS[name].unit)
        units = {*self.limits.position_units}
        return own if own != POSITION else self.limits.position_units[0] if len(units) == 1 else ""

    @property
    def required(self) -> tuple[str, ...]:
        """Requirements on each run."""
        return tuple(
            f"{name}<={1e-9 if name == 'range_use' else 1:g}" for name in self.units if name.endswith("_use")
        )

    @property
    def metrics(self) -> Metrics:
        """For a campaign."""
        return Metrics(
            self.units, self, parts=[f"{self.known[name][0]}_{joint}" for name, joint, _ in self._parts]
        )

    def __call__(self, run: Trajectory) -> dict[str, float]:
        """The numbers of one run."""
        s, limits = self.specification, self.limits
        columns = [
            run.names["reference"].index(name) for name in signal_names("link_position", limits.joints)
        ]
        followed = FollowedPlan(run.time, run.signals["reference"][:, columns])
        plan, ends = cast("Plan", followed), followed.positions[[0, -1]]
        if self.motion is not None and self._jumps:
            plan, ends = self.motion.plan, self.motion.ends
        response = Response(run, ends[1], ends[0], limits.joints)
        rows = Move(plan, response, limits).motion
        lines: dict[str, Requirement] = {
            line.what: line
            for line in (
                *judge.overshoot_requirement(s, limits, [response], ""),
                *judge.motion_requirements(s, limits, [rows], 0.0, "", rests=True),
                *judge.saturation_requirement(limits, [response], ""),
            )
        }
        found = {
            f"{metric}_use": judge.measured(name, limits, [response]).share
            for name, metric in (
                ("peak", "input_limit"),
                ("speed", "speed_limit"),
                ("range", "range"),
                ("input_rate", "input_rate"),
                ("input_acceleration", "input_acceleration"),
            )
        }
        for name, (metric, _) in self.known.items():
            if not self._applies(name):
                continue
            line = lines.get(REQUIREMENTS[name].what)
            found[metric] = 0.0 if line is None else line.found
            found[f"{metric}_use"] = 0.0 if line is None else missed_by(line)
        for name, joint, _ in self._parts:
            metric = self.known[name][0]
            found[f"{metric}_{joint}"] = rows[limits.joints.index(joint)][metric]
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class MovedRobots(Tolerances):
    """Robots of the tolerances, each with a move of its own between random goals.

    The move belongs to the index of a sample, as its noise does. The first moves are those that the design is judged
    by, which follow one another; then each has goals of its own.
    """

    setup: WorkspaceSetup
    seed: int  # of the campaign
    longest_delay: int = 0  # samples

    def __post_init__(self) -> None:
        one_of("There is no such method.", self.method, METHODS)

    def columns(self, numbers: Columns) -> None:
        """None: each sample has a move of its own."""

    def built(self, numbers: Mapping[str, float], index: int = 0) -> Sample:
        """The robot with these numbers, settled at the start of the move of an index."""
        joints, ends, row = self.setup.joints, self.ends(index), dict(numbers)
        if DELAY in row:
            row[DELAY] = float(min(max(int(row[DELAY]), 0), self.longest_delay))
        for which, pose in zip(ENDS, ends.tolist()):
            row |= zip(signal_names(which, joints), pose)
        try:
            refuse_if(
                not np.all(np.isfinite(ends)),
                "The motors hold hardly any pose of the workspace.",
                "no goals were found for this sample",
                "a smaller workspace",
            )
            return self._settled(row, ends)
        except FlexhinfError as error:
            return Sample(numbers=row, failure=" ".join(str(error).split()))

    def _settled(self, row: Mapping[str, float], ends: np.ndarray) -> Sample:
        setup, robot, plant = self.setup, self.setup.true.robot, self.setup.true_plant
        values = robot.varied(row)
        off = {name: row[key] for name in plant.outputs if (key := f"{OFFSET}_{name}") in row}
        offset = np.array([off.get(name, 0.0) for name in plant.outputs]) if off else 0.0
        _, options = setup.move_arguments(ends, values, offset=offset)
        errors = np.array([row.get(name, 0.0) for name in signal_names(ERROR, setup.joints)])
        if errors.any():
            options["initial_state"] = robot.operating_point(ends[0] + errors, setup.extras, values)[0]
        options["initial_state"] = np.append(options["initial_state"], list(off.values()))
        at = LOAD_START * options["duration"]
        if loads := {
            name: Step(row[name], at=at) for name in signal_names(TORQUE, setup.joints) if name in row
        }:
            options["disturbance"] = loads
        delay = int(row.get(DELAY, 0.0))
        return Sample(plant.parameters.known(values), cast("SampleOptions", options), row, delay=delay)

    def ends(self, index: int) -> np.ndarray:
        """Start and goal (2, n) of the move of an index, rad or m; NaN where the search for goals fails."""
        block, place = divmod(index, GOALS)
        return self._move_ends(block)[place if block == 0 else 2 * place]

    @cached_property
    def _move_ends(self) -> Callable[[int], np.ndarray]:
        setup = self.setup

        @lru_cache(BLOCKS)
        def move_ends(block: int) -> np.ndarray:
            own = GOALS_SEED + 100 * setup.specification.seed
            try:
                if block == 0:
                    return setup.move_ends(GOALS, own)[0]
                return setup.move_ends(2 * GOALS - 1, [own, self.seed, block])[0]
            except NumericalFailure:
                return np.full((2 * GOALS, 2, len(setup.joints)), np.nan)

        return move_ends

    def __getstate__(self) -> dict[str, Any]:
        """State to pickle for other processes: the goals are found again."""
        return {name: value for name, value in vars(self).items() if name != "_move_ends"}

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the variables, and of the ends of moves, by name."""
        joints, slides = self.setup.joints, self.setup.robot.links.slides
        units = [UNITS["link_position"][sliding] for sliding in slides]
        ends = {name: unit for which in ENDS for name, unit in zip(signal_names(which, joints), units)}
        return {**super().units, **ends}

    @property
    def settings(self) -> Mapping[str, str]:
        """The method, every variable, and where the moves are from."""
        own = GOALS_SEED + 100 * self.setup.specification.seed
        random = f"between random goals of the workspace, the first {GOALS} by seed {own}"
        return {**super().settings, "moves": self.setup.motions(1) if self.setup.motion else random}


@dataclass(frozen=True, eq=False)
class WorkspaceCampaign(DesignCampaign[WorkspaceSetup]):
    """The campaign of a controller for a workspace: moves between random goals, by many robots."""

    metrics: MoveMetrics
    offsets: tuple[str, ...]  # measurements that are off in each sample by a number of its own

    @classmethod
    def of(cls, design: DesignRequest, o: CampaignOptions) -> WorkspaceCampaign:
        """The campaign of a design with these options; raises InvalidInput for a parameter that does not act, and for a
        duration, as each move has its own."""
        s = design.specification
        refuse_if(
            o.duration is not None,
            f"The runs of a design with the law {s.law} are as long as those of its test.",
            f"expected no duration, got {o.duration} s",
            "leave out --duration; or a design with --law nl-hinf and --pose home, whose runs have one length",
        )
        plants = LoopPlants(*true_robot(with_payload(design, o.payload), s))
        robot, variables = varied(plants.robot, o, plants.specification.extras)
        offsets = (
            tuple(name for name in plants.model.outputs if "position" in name) if o.encoder_offset else ()
        )
        refuse_if(
            offsets and s.estimator == "none",
            "Encoders are not read where the true state is fed back.",
            f"expected no encoder offset, got {o.encoder_offset:g}",
            "a design with an estimator, or leave it out",
        )
        size, late = o.encoder_offset, o.extra_delay
        off = [
            Variable(f"{OFFSET}_{name}", -size, size, o.distribution, plants.model.unit(name))
            for name in offsets
        ]
        off += [Variable(DELAY, 0.0, late + 1.0, o.distribution)] if late else []
        metrics = MoveMetrics(s, joint_limits(design.robot, s), Task.of(design.robot, s).motion)
        return cls(replace(design, specification=s), o, robot, (*variables, *off), metrics, offsets)

    @property
    def runs(self) -> dict[str, str]:
        """Where the moves are from; they do not differ between two designs of one seed."""
        return {"goals": f"by seed {GOALS_SEED + 100 * self.specification.seed}, then by that of the samples"}

    @property
    def requirements(self) -> tuple[str, ...]:
        """Requirements on each run: those of the design on its moves."""
        return self.metrics.required

    def law_of(self, loop: LoopOverWorkspace) -> DesignedLaw[WorkspaceSetup]:
        """The setup; moves have no common length."""
        return DesignedLaw(loop.setup, loop.length)

    def store(self, law: WorkspaceSetup, folder: Path) -> None:
        """As the numbers that make it again."""
        numbers = to_json(law_numbers(law))
        write_file(folder / LAW, "law", lambda name: Path(name).write_text(numbers, encoding="utf-8"))

    def stored(self, folder: Path) -> WorkspaceSetup:
        """From these numbers."""
        return read_setup(self.request.robot, self.specification, folder / LAW)

    def campaign(self, designed: DesignedLaw[WorkspaceSetup]) -> Campaign:
        """The campaign with the law of a setup; each move has a duration of its own."""
        o, setup = self.options, replace(designed.law, other=self.robot)
        loop = setup.loop(setup.moving)
        if self.offsets:
            loop = loop.with_plant(setup.true_plant.augmented(offsets=self.offsets))
        draw = MovedRobots(self.variables, o.method, setup=setup, seed=o.seed, longest_delay=o.extra_delay)
        first = setup.move_arguments(draw.ends(0))[1]
        options: RunOptions = {"duration": first["duration"]}
        if setup.noise is not None:
            options["noise"] = setup.noise
        return Campaign(
            loop, draw, o.samples, o.seed, options, self.metrics.metrics, (), o.batch, self.stated
        )
