"""Figures of the step of a design's campaign: of a run's signals, or of runs in lanes, with the same numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from flexhinf.campaign import Metrics
from flexhinf.design.joint_limits import JointLimits
from flexhinf.design.monte_carlo import step_reductions
from flexhinf.design.responses import Response
from flexhinf.loop import EnsembleResult, Trajectory
from flexhinf.robot.signals import signal_names

__all__ = ["StepMetrics"]


@dataclass(frozen=True, eq=False)
class StepMetrics:
    """Figures of the step of all joints, each the worst of them: what `Response` and `JointLimits` say."""

    start: np.ndarray
    goal: np.ndarray
    limits: JointLimits

    @property
    def units(self) -> dict[str, str]:
        """By name; a fraction of a limit only where there is one."""
        position, speed, effort = (
            units[0] if len(set(units)) == 1 else ""
            for units in (self.limits.position_units, self.limits.speed_units, self.limits.effort_units)
        )
        found = {
            "overshoot_percent": "%", "settling_time_s": "s", "rise_time_s": "s", "steady_state_error": position,
            "peak_input": effort, "peak_speed": speed, "estimation_error": position,
        }  # fmt: skip
        found |= {"input_limit_use": ""} if self.limits.limits_peak else {}
        found |= {"speed_limit_use": ""} if self.limits.limits_speed else {}
        return found | {name: unit for name, (_, _, unit) in self._joints.items()}

    @property
    def moving(self) -> list[int]:
        """Joints that the step moves."""
        return [k for k in range(len(self.goal)) if self.start[k] != self.goal[k]]

    @property
    def _joints(self) -> dict[str, tuple[str, int, str]]:
        """Figures of single joints, where there are several: what it is, of which joint, and its unit."""
        every, limits = list(range(len(self.goal))), self.limits
        percent, seconds = ["%"] * len(every), ["s"] * len(every)
        kinds = (
            ("overshoot_percent", self.moving, percent), ("settling_time_s", self.moving, seconds),
            ("rise_time_s", self.moving, seconds), ("steady_state_error", every, limits.position_units),
            ("peak_input", every, limits.effort_units), ("peak_speed", every, limits.speed_units),
        )  # fmt: skip
        return {
            f"{kind}_{limits.joints[k]}": (kind, k, units[k])
            for kind, joints, units in kinds
            for k in (joints if len(every) > 1 else ())
        }

    def __call__(self, run: Trajectory) -> dict[str, float]:
        """Of one run."""
        response = Response(run, self.goal, self.start, self.limits.joints)
        moved = [row for row in response.metrics if "overshoot_percent" in row] or response.metrics
        found = {
            name: max(np.inf if row[name] is None else row[name] for row in rows if name in row)
            for name, rows in (
                *((name, moved) for name in ("overshoot_percent", "settling_time_s", "rise_time_s")),
                *((name, response.metrics) for name in ("steady_state_error", "peak_input", "peak_speed")),
            )
            if any(name in row for row in rows)
        }
        estimates = [
            k for k in signal_names("link_position", self.limits.joints) if k in run.names["estimate"]
        ]
        found["estimation_error"] = max(
            (float(np.abs(run.signal("estimate", k) - run.signal("state", k)).max()) for k in estimates),
            default=np.nan,
        )
        found["input_limit_use"] = self.limits.input_use(response).share
        found["speed_limit_use"] = self.limits.speed_use(response).share
        for name, (kind, k, _) in self._joints.items():
            found[name] = np.inf if (value := response.metrics[k][kind]) is None else value
        return {name: found.get(name, np.nan) for name in self.units}

    # In lanes -----------------------------------------------------------------------------------------
    def metrics(self, states: Sequence[str], estimated: Sequence[str]) -> Metrics:
        """For a campaign, of runs in lanes too.

        Parameters
        ----------
        states, estimated : sequence of str
            Of the true plant and of the estimate.
        """
        names = [name for name in signal_names("link_position", self.limits.joints) if name in estimated]
        pairs = tuple((tuple(estimated).index(name), tuple(states).index(name)) for name in names)
        reductions = step_reductions(self.start, self.goal, pairs)
        return Metrics(self.units, self, partial(self._reduced, bool(pairs)), reductions, tuple(self._joints))

    def _reduced(self, estimated: bool, found: EnsembleResult) -> dict[str, np.ndarray]:
        """As of one run, of N runs."""
        kept, moving = found.common, self.moving
        values = {
            name: np.max([kept[f"{k} {name}"] for k in moving], axis=0) if moving else np.full(len(found.codes), np.nan)
            for name in ("overshoot_percent", "settling_time_s", "rise_time_s")
        }  # fmt: skip
        late, effort, speed = kept["late_error"], kept["effort"], kept["speed"]
        values |= {"steady_state_error": late.max(axis=1), "peak_speed": speed.max(axis=1)}
        values |= {"estimation_error": kept["estimate"] if estimated else np.full(len(found.codes), np.nan)}
        values |= {
            "peak_input": effort.max(axis=1),
            "input_limit_use": (effort / self.limits.peak).max(axis=1),
        }
        values |= {"speed_limit_use": (speed / self.limits.speed).max(axis=1)}
        columns = {"steady_state_error": late, "peak_input": effort, "peak_speed": speed}
        return values | {
            name: columns[kind][:, k] if kind in columns else kept[f"{k} {kind}"]
            for name, (kind, k, _) in self._joints.items()
        }
