"""Figures of the runs of a design's campaign, of a run's signals or of runs in lanes, with the same numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexhinf.campaign import Metrics
from flexhinf.design.joint_limits import JointLimits
from flexhinf.design.monte_carlo import move_reductions, position_columns, step_reductions
from flexhinf.design.responses import Plan, Response, plan_ends
from flexhinf.loop import EnsembleResult, Reduction, Trajectory
from flexhinf.loop.simulation.metrics import steady_state_error
from flexhinf.robot.signals import signal_names


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
