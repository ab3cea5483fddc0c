"""Metrics of a step or a move of all joints on many robots at once, and a design's own sampled robots.

The metrics are reductions, computed while each run goes on; the controller stays as it was designed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexhinf.campaign import Metrics
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.responses import JointLimits
from flexhinf.loop import EnsembleResult, Instant, Reduction
from flexhinf.loop.simulation.metrics import Command, step_reduction
from flexhinf.robot.signals import signal_names
from flexhinf.scalars import maximum, where

#: At most so many instants of each run are kept.
KEPT = 400

#: Metrics of the step of one joint that moves.
STEP_UNITS = {"overshoot_percent": "%", "settling_time_s": "s", "rise_time_s": "s"}


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Figures of N runs, one row per robot."""

    values: tuple[Mapping[str, Any], ...]  # Parameters of each robot
    overshoot: np.ndarray  # (N,). Largest of all joints, per cent; infinite where the run diverged
    settling: np.ndarray  # (N,). Slowest of all joints, s; infinite where one does not settle in the run
    peak: np.ndarray  # (N,). Largest input of all motors; infinite where the run diverged
    # overshoot_joints, settling_joints, peak_joints: The joints of these worst values; "" where the run diverged, or
    # no joint moves
    overshoot_joints: tuple[str, ...]
    settling_joints: tuple[str, ...]
    peak_joints: tuple[str, ...]
    # inputs, speeds: (N, n). Largest input of each motor and speed of each link; infinite where the run diverged
    inputs: np.ndarray
    speeds: np.ndarray
    time: np.ndarray  # (T,). Instants that are kept, s
    positions: np.ndarray  # (N, T, n). Link positions; NaN from where a run diverged

    def __len__(self) -> int:
        return len(self.values)

    @property
    def diverged(self) -> int:
        """How many runs diverged."""
        return int(np.isinf(self.overshoot).sum())

    @property
    def unsettled(self) -> int:
        """How many runs did not settle, those that diverged among them."""
        return int(np.isinf(self.settling).sum())

    @property
    def worst(self) -> int:
        """The robot with the largest overshoot; of equal ones, that which settles last."""
        return max(range(len(self)), key=lambda k: (self.overshoot[k], self.settling[k]))

    @property
    def slowest(self) -> int:
        """The robot that settles last; of those that never do, the one with the largest overshoot."""
        return max(range(len(self)), key=lambda k: (self.settling[k], self.overshoot[k]))


def sampled_runs(
    setup: LoopSetup,
    robots: Sequence[Mapping[str, Any]],
    duration: float,
    sub_steps: int,
) -> MonteCarlo:
    """The step of each robot (its parameters) as the controller is deployed, with noise of its own.

    `duration` in s; `sub_steps` of the true plants are the nominal one's, so that all runs share one kernel.
    """
    n, samples = len(setup.goal), round(duration / setup.specification.period)
    instants = np.arange(0, samples, max(1, -(-samples // KEPT)))  # evenly apart
    runs = setup.steps(
        robots, duration, sub_steps, reductions=step_reductions(setup.start, setup.goal),
        kept=setup.true_plant.states[:n], instants=instants,
    )  # fmt: skip
    numbers = {name: np.where(np.isnan(values), np.inf, values) for name, values in runs.common.items()}
    moving = np.flatnonzero(setup.start != setup.goal).tolist()

    def worst(rows: Any, joints: Sequence[int]) -> tuple[np.ndarray, tuple[str, ...]]:
        """The largest of joints' values (n, N) for each run, and its joint; as `worst_of` for a `Response`."""
        if not joints:
            return np.where(runs.completed, 0.0, np.inf), ("",) * len(robots)
        names = [setup.joints[joints[k]] for k in np.argmax(rows, axis=0)]
        return np.max(rows, axis=0), tuple(np.where(runs.completed, names, "").tolist())

    overshoot = worst([numbers[f"{k} overshoot_percent"] for k in moving], moving)
    settling = worst([numbers[f"{k} settling_time_s"] for k in moving], moving)
    peak = worst(numbers["effort"].T, range(n))
    return MonteCarlo(
        tuple(robots), overshoot[0], settling[0], peak[0], overshoot[1], settling[1], peak[1], numbers["effort"],
        numbers["speed"], setup.specification.period * instants, runs.kept,
    )  # fmt: skip


def move_errors(
    setup: LoopSetup,
    robots: Sequence[Mapping[str, Any]],
    plan: Any,
    sub_steps: int,
    rest: float | None = None,
) -> np.ndarray:
    """Largest error (N,) of any joint along the planned move, rad or m; infinite where a run diverged."""
    reductions = move_reductions(position_columns(setup.tracking_controller.commanded, setup.joints))
    runs = setup.moves(robots, plan, sub_steps, rest, reductions=reductions)
    errors = runs.common["tracking_error"].max(axis=1)
    return np.where(np.isnan(errors), np.inf, errors)


def position_columns(commanded: Sequence[str], joints: Sequence[str]) -> tuple[int, ...]:
    """Columns of a command in which the joints' link positions are."""
    return tuple(tuple(commanded).index(name) for name in signal_names("link_position", joints))


def step_reductions(
    start: np.ndarray, goal: np.ndarray, pairs: Sequence[tuple[int, int]] = ()
) -> list[Reduction]:
    """What is said of the step of all joints while it runs.

    Of each joint k that moves ``"k overshoot_percent"``, ``"k settling_time_s"`` and ``"k rise_time_s"``, (N,); of
    all joints ``late_error`` (in the last tenth of the run), ``effort`` and ``speed``, the largest ones, (N, n);
    and ``estimate``, the largest error of the estimates, (N,).

    `start`, `goal`: (n,), Link positions, rad or m.
    `pairs`: columns of an estimated position, and of the true one.
    """
    moving = np.flatnonzero(start != goal).tolist()
    steps = (step_reduction(k, float(start[k]), float(goal[k])) for k in moving)
    return [*steps, _sizes_of(goal.tolist(), None, pairs)]


def move_reductions(columns: Sequence[int], pairs: Sequence[tuple[int, int]] = ()) -> list[Reduction]:
    """``tracking_error``, the largest distances from a move (n,), and of `step_reductions` those of all joints.

    ``late_error`` is the distance from where the move then is. `columns`: link positions in the command (n,).
    """
    return [_sizes_of([0.0] * len(columns), tuple(columns), pairs)]


def _sizes_of(
    first: Sequence[float], columns: Sequence[int] | None, pairs: Sequence[tuple[int, int]]
) -> Reduction:
    """Sizes of a step to the goal `first` (n,), or of the move in these columns of the command."""
    n = len(first)
    key = ("sizes of a step", n, pairs) if columns is None else ("sizes of a move", columns, pairs)
    start = (*first, *[0.0] * (3 * n + 1))
    return Reduction(start, partial(_sizes, n, columns, pairs), partial(_named_sizes, n, columns), key)


def _sizes(
    n: int, columns: Sequence[int] | None, pairs: Sequence[tuple[int, int]], kept: Any, now: Instant
) -> Any:
    """The goal, or largest distances from the move; largest late errors, inputs and speeds (n each); an estimate's."""
    first, late, effort, speed = (kept[k * n : (k + 1) * n] for k in range(4))
    estimate = kept[-1]
    if columns is None:
        errors = [abs(now.state[k] - first[k]) for k in range(n)]
    else:
        errors = [abs(now.state[k] - now.reference[column]) for k, column in enumerate(columns)]
        first = [maximum(old, new) for old, new in zip(first, errors)]
    late = [where(now.step >= now.tail, maximum(old, new), old) for old, new in zip(late, errors)]
    effort = [maximum(old, abs(new)) for old, new in zip(effort, now.input)]
    speed = [maximum(old, abs(now.state[n + k])) for k, old in enumerate(speed)]
    for one, other in pairs:
        estimate = maximum(estimate, abs(now.estimate[one] - now.state[other]))
    return np.array([*first, *late, *effort, *speed, estimate])


def _named_sizes(
    n: int, columns: Sequence[int] | None, kept: np.ndarray, command: Command
) -> dict[str, np.ndarray]:
    first, late, effort, speed = (kept[k * n : (k + 1) * n].T for k in range(4))
    named = {} if columns is None else {"tracking_error": first}
    return {**named, "late_error": late, "effort": effort, "speed": speed, "estimate": kept[-1]}


@dataclass(frozen=True, eq=False)
class RunMetrics:
    """Metrics of a run of all joints, each the worst of them, and where there are several those of each joint."""

    limits: JointLimits
    ends: tuple[np.ndarray, np.ndarray] | None = (
        None  # Start and goal (n,) of a step, rad or m; None for a move
    )
    required: tuple[np.ndarray, np.ndarray] | None = None  # Of a move: tracking error, distance after it (n,)

    @cached_property
    def joint_metrics(self) -> dict[str, tuple[Sequence[str], Sequence[int]]]:
        """Metrics that joints have: units for each joint, and the joints that have it; the first is the primary one.

        Of a step of the joints that move, and where every joint ends; of a move largest distances from it and from its
        end, also as fractions of those required; then peaks.
        """
        limits, every, n = self.limits, range(len(self.limits.joints)), len(self.limits.joints)
        found: dict[str, tuple[Sequence[str], Sequence[int]]] = {}
        if self.ends is not None:
            moving = np.flatnonzero(self.ends[0] != self.ends[1]).tolist()
            found = {name: ([unit] * n, moving) for name, unit in STEP_UNITS.items()}
            found["steady_state_error"] = limits.position_units, every
        else:
            for name in ("tracking_error", "final_error"):
                found |= {name: (limits.position_units, every), f"{name}_use": ([""] * n, every)}
        return found | {"peak_input": (limits.effort_units, every), "peak_speed": (limits.speed_units, every)}

    @property
    def units(self) -> dict[str, str]:
        """By name, empty where those of the joints differ; a fraction of a limit only where there is one."""
        each = {name: units for name, (units, _) in self.joint_metrics.items()}
        each["estimation_error"] = self.limits.position_units
        common = {name: units[0] if len(set(units)) == 1 else "" for name, units in each.items()}
        uses = {"input_limit_use": self.limits.limits_peak, "speed_limit_use": self.limits.limits_speed}
        common |= {name: "" for name, limited in uses.items() if limited}
        return common | {name: each[kind][k] for name, (kind, k) in self._parts.items()}

    @cached_property
    def _parts(self) -> dict[str, tuple[str, int]]:
        """Metrics of single joints, where there are several: which metric, and of which joint."""
        names = self.limits.joints
        several = self.joint_metrics.items() if len(names) > 1 else ()
        return {f"{kind}_{names[k]}": (kind, k) for kind, (_, joints) in several for k in joints}

    def metrics(self, states: Sequence[str], estimated: Sequence[str], commanded: Sequence[str]) -> Metrics:
        """For a campaign whose true plant, estimate and command have these names."""
        names = [name for name in signal_names("link_position", self.limits.joints) if name in estimated]
        pairs = tuple((tuple(estimated).index(name), tuple(states).index(name)) for name in names)
        columns = position_columns(commanded, self.limits.joints) if self.ends is None else ()
        reductions = step_reductions(*self.ends, pairs) if self.ends else move_reductions(columns, pairs)
        return Metrics(self.units, None, partial(self._reduced, bool(pairs)), reductions, tuple(self._parts))

    def _reduced(self, estimated: bool, runs: EnsembleResult) -> dict[str, np.ndarray]:
        common, nothing = runs.common, np.full(len(runs.codes), np.nan)
        late, effort, speed = common["late_error"], common["effort"], common["speed"]
        every = {"peak_input": effort, "peak_speed": speed}  # (N, n); any number for a joint that has none
        if self.required is None:
            every["steady_state_error"] = late
            for kind in STEP_UNITS:
                each = [common.get(f"{k} {kind}", late[:, k]) for k in range(late.shape[1])]
                every[kind] = np.stack(each, axis=1)
        else:
            errors = {"tracking_error": common["tracking_error"], "final_error": late}
            every |= errors
            for (kind, error), most in zip(errors.items(), self.required):
                every[f"{kind}_use"] = error / most
        worst = {
            kind: every[kind][:, list(joints)].max(axis=1) if len(joints) else nothing
            for kind, (_, joints) in self.joint_metrics.items()
        }
        worst["estimation_error"] = common["estimate"] if estimated else nothing
        worst["input_limit_use"] = (effort / self.limits.peak).max(axis=1)
        worst["speed_limit_use"] = (speed / self.limits.speed).max(axis=1)
        return worst | {name: every[kind][:, k] for name, (kind, k) in self._parts.items()}
