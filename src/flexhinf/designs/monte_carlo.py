"""Metrics of a step or a move on many robots at once: reductions, which are computed during each run; the controller is
the designed one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexhinf.campaign import Metrics
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.responses import LONGEST, JointLimits
from flexhinf.loop import EnsembleResult, Instant, Reduction
from flexhinf.loop.simulation.metrics import CommandFacts, step_reduction, updated_late_error, updated_peak
from flexhinf.robot.signals import signal_names
from flexhinf.scalars import where

#: Largest number of instants of a run that are kept.
KEPT = 400

#: A sampled robot that has not settled at the end of the step gets a run of so many times its length.
LONGER = 4.0

#: What a drive may limit of its command.
CHANGES = ("rate", "acceleration")

#: Metrics of the step of one joint that moves.
STEP_UNITS = {"overshoot_percent": "%", "settling_time_s": "s", "rise_time_s": "s"}


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Metrics of N runs, one row per robot."""

    values: tuple[Mapping[str, Any], ...]  # Parameters of each robot
    overshoot: np.ndarray  # (N,). Largest of all joints, per cent; infinite where the run diverged
    settling: np.ndarray  # (N,). Slowest of all joints, s; infinite where one does not settle in the run
    peak: np.ndarray  # (N,). Largest input of all motors; infinite where the run diverged
    # Joints of these worst values; "" where the run diverged, or no joint moves
    joints: Mapping[str, tuple[str, ...]]
    # inputs, speeds: (N, n). Largest input of each motor and speed of each link; infinite where the run diverged
    inputs: np.ndarray
    speeds: np.ndarray
    time: np.ndarray  # (T,). Instants that are kept, s
    positions: np.ndarray  # (N, T, n). Link positions; NaN from where a run diverged

    def __len__(self) -> int:
        return len(self.values)

    @property
    def diverged(self) -> int:
        """Number of runs that diverged."""
        return int(np.isinf(self.overshoot).sum())

    @property
    def unsettled(self) -> int:
        """Number of runs that did not settle, those that diverged included."""
        return int(np.isinf(self.settling).sum())

    @property
    def worst(self) -> int:
        """The robot with the largest overshoot; among equal ones, the one that settles last."""
        return max(range(len(self)), key=lambda k: (self.overshoot[k], self.settling[k]))

    @property
    def slowest(self) -> int:
        """The robot that settles last; among those that never settle, the one with the largest overshoot."""
        return max(range(len(self)), key=lambda k: (self.settling[k], self.overshoot[k]))


def judged_runs(
    setup: LoopSetup, robots: Sequence[Mapping[str, Any]], duration: float, sub_steps: int
) -> MonteCarlo:
    """As `sampled_runs`; robots that have not settled after `duration`, s, are judged by runs of `LONGER` times it."""
    first = sampled_runs(setup, robots, duration, sub_steps)
    late = np.flatnonzero(np.isinf(first.settling) & np.isfinite(first.overshoot)).tolist()
    longer = min(LONGER * duration, LONGEST)
    if not late or longer <= duration:
        return first
    again = sampled_runs(setup, [robots[k] for k in late], longer, sub_steps, late)
    arrays, joints = dict[str, np.ndarray](), dict(first.joints)
    for name in ("overshoot", "settling", "peak", "inputs", "speeds"):
        arrays[name] = getattr(first, name).copy()
        arrays[name][late] = getattr(again, name)
    for name, worst in again.joints.items():
        named = dict(zip(late, worst, strict=True))
        joints[name] = tuple(named.get(k, joint) for k, joint in enumerate(first.joints[name]))
    return replace(first, joints=joints, **arrays)


def sampled_runs(
    setup: LoopSetup,
    robots: Sequence[Mapping[str, Any]],
    duration: float,
    sub_steps: int,
    indices: Sequence[int] | None = None,
) -> MonteCarlo:
    """The step of each robot (by its parameters) with the deployed controller, each with its own noise.

    `duration`, s. `sub_steps` are those of the nominal plant, so that all runs share one kernel. `indices`: of the
    robots, by which they have their noise; counted by default.
    """
    n, samples = len(setup.goal), round(duration / setup.specification.period)
    instants = np.arange(0, samples, max(1, -(-samples // KEPT)))  # evenly apart
    runs = setup.ensemble(
        robots,
        sub_steps,
        **setup.step_arguments(duration),
        numbers=indices,
        reductions=run_reductions((setup.start, setup.goal)),
        kept=setup.true_plant.states[:n],
        instants=instants,
    )
    numbers = {name: np.where(np.isnan(values), np.inf, values) for name, values in runs.common.items()}
    moving = np.flatnonzero(setup.start != setup.goal).tolist()

    def worst(rows: Any, joints: Sequence[int]) -> tuple[np.ndarray, tuple[str, ...]]:
        """The largest value of all joints, of `values` (n, N), for each run, and its joint; as `worst_of` for a
        `Response`."""
        if not joints:
            return np.where(runs.completed, 0.0, np.inf), ("",) * len(robots)
        names = [setup.joints[joints[int(k)]] for k in np.argmax(rows, axis=0)]
        return np.max(rows, axis=0), tuple(np.where(runs.completed, names, "").tolist())

    found = {
        "overshoot": worst([numbers[f"{k} overshoot_percent"] for k in moving], moving),
        "settling": worst([numbers[f"{k} settling_time_s"] for k in moving], moving),
        "peak": worst(numbers["effort"].T, range(n)),
    }
    return MonteCarlo(
        tuple(robots),
        found["overshoot"][0],
        found["settling"][0],
        found["peak"][0],
        {name: joints for name, (_, joints) in found.items()},
        numbers["effort"],
        numbers["speed"],
        setup.specification.period * instants,
        runs.kept,
    )


def position_columns(commanded: Sequence[str], joints: Sequence[str]) -> tuple[int, ...]:
    """Columns of the joints' link positions in a command."""
    return tuple(tuple(commanded).index(name) for name in signal_names("link_position", joints))


def run_reductions(
    ends: tuple[np.ndarray, np.ndarray] | None,
    columns: tuple[int, ...] = (),
    pairs: Sequence[tuple[int, int]] = (),
) -> list[Reduction]:
    """Reductions of a step of all joints between `ends` (n,), rad or m, or of a move (`ends` is None).

    For each joint k that makes a step: ``"k overshoot_percent"``, ``"k settling_time_s"`` and ``"k rise_time_s"``,
    (N,). For all joints, largest values (N, n): ``tracking_error`` (of a move), ``late_error`` (in the last tenth of
    the run, from the goal or the planned position), ``effort`` and ``speed``. And ``estimate``, the largest estimation
    error, (N,).

    `columns`: link positions in the command of a move (n,).
    `pairs`: columns of an estimated position, and of the true one.
    """
    goal, moved, steps = [0.0] * len(columns), columns, []
    if ends is not None:
        goal, moved, moving = ends[1].tolist(), None, np.flatnonzero(ends[0] != ends[1]).tolist()
        steps = [step_reduction(k, float(ends[0][k]), goal[k]) for k in moving]
    n = len(goal)
    return [
        *steps,
        Reduction(
            (*goal, *[0.0] * (3 * n + 1)),
            partial(_sizes, n, moved, pairs),
            partial(_named_sizes, n, moved),
            ("sizes of a run", n, moved, pairs),
        ),
    ]


def _sizes(
    n: int, columns: Sequence[int] | None, pairs: Sequence[tuple[int, int]], kept: Any, now: Instant
) -> Any:
    # the goal, or largest errors of a move; largest late errors, inputs and speeds (n each); estimation error
    first, late, effort, speed = (kept[k * n : (k + 1) * n] for k in range(4))
    estimate = kept[-1]
    if columns is None:
        errors = [now.state[k] - first[k] for k in range(n)]
    else:
        errors = [now.state[k] - now.reference[column] for k, column in enumerate(columns)]
        first = list(map(updated_peak, first, errors))
    late = [updated_late_error(now, old, error) for old, error in zip(late, errors)]
    effort = [updated_peak(old, new) for old, new in zip(effort, now.input)]
    speed = [updated_peak(old, now.state[n + k]) for k, old in enumerate(speed)]
    for estimated, true in pairs:
        estimate = updated_peak(estimate, now.estimate[estimated] - now.state[true])
    return np.array([*first, *late, *effort, *speed, estimate])


def _named_sizes(
    n: int, columns: Sequence[int] | None, kept: np.ndarray, command: CommandFacts
) -> dict[str, np.ndarray]:
    parts = ("goal" if columns is None else "tracking_error", "late_error", "effort", "speed")
    named = {name: kept[k * n : (k + 1) * n].T for k, name in enumerate(parts) if name != "goal"}
    return {**named, "estimate": kept[-1]}


def changes_reduction(joints: int, period: float) -> Reduction:
    """Largest rates and accelerations (N, n) of the inputs, ``rate`` and ``acceleration``: per s, and per s², as those
    of `flexhinf.robot.command_limits.command_changes`."""
    return Reduction(
        [0.0] * (4 * joints),
        partial(_changes, joints, period),
        partial(_named_changes, joints),
        ("changes of inputs", joints, period),
    )


def _changes(n: int, period: float, kept: Any, now: Instant) -> Any:
    # the last inputs and rates, and the largest rates and accelerations, n each
    before, rate, fastest, strongest = (kept[k * n : (k + 1) * n] for k in range(4))
    rates = [(new - where(now.step >= 1.0, old, new)) / period for old, new in zip(before, now.input)]
    accelerations = [(new - old) / period for old, new in zip(rate, rates)]
    fastest = list(map(updated_peak, fastest, rates))
    return np.array([*now.input, *rates, *fastest, *map(updated_peak, strongest, accelerations)])


def _named_changes(n: int, kept: np.ndarray, command: CommandFacts) -> dict[str, np.ndarray]:
    return {"rate": kept[2 * n : 3 * n].T, "acceleration": kept[3 * n :].T}


@dataclass(frozen=True, eq=False)
class RunMetrics:
    """Metrics of a run: the worst of all joints and, for several joints, the value of each."""

    limits: JointLimits
    # Start and goal (n,) of a step, rad or m; None for a move
    ends: tuple[np.ndarray, np.ndarray] | None = None
    required: tuple[np.ndarray, np.ndarray] | None = None  # (n,) each: tracking and final error of a move

    @cached_property
    def joint_metrics(self) -> dict[str, tuple[Sequence[str], Sequence[int]]]:
        """Metrics of single joints: for each its units by joint, and the joints that have it. The first metric is the
        primary one.

        A step has its metrics for the joints that move, and the steady-state error of every joint. A move has the
        tracking error and the final error, also as fractions of their limits. Both have peak input and peak speed.
        """
        limits, n = self.limits, len(self.limits.joints)
        positions, fractions = (limits.position_units, range(n)), ([""] * n, range(n))
        table: dict[str, tuple[Sequence[str], Sequence[int]]] = {
            "tracking_error": positions,
            "tracking_error_use": fractions,
            "final_error": positions,
            "final_error_use": fractions,
        }
        if self.ends is not None:
            moving = np.flatnonzero(self.ends[0] != self.ends[1]).tolist()
            table = {name: ([unit] * n, moving) for name, unit in STEP_UNITS.items()}
            table["steady_state_error"] = positions
        return table | {
            "peak_input": (limits.effort_units, range(n)),
            "peak_speed": (limits.speed_units, range(n)),
        }

    @property
    def units(self) -> dict[str, str]:
        """Units by metric, empty where those of the joints differ; a limit's use is listed only where the limit
        exists."""
        each = {name: units for name, (units, _) in self.joint_metrics.items()}
        each["estimation_error"] = self.limits.position_units
        common = {name: units[0] if len(set(units)) == 1 else "" for name, units in each.items()}
        common |= dict.fromkeys(self.uses, "")
        return common | {name: each[kind][k] for name, (kind, k) in self._of_joints.items()}

    @property
    def uses(self) -> tuple[str, ...]:
        """Shares of the limits that there are, of which each run has at most 1."""
        limits = self.limits
        limited = {
            "input_limit_use": limits.limits_peak,
            "speed_limit_use": limits.limits_speed,
            "input_rate_use": limits.limits_rate,
            "input_acceleration_use": limits.limits_acceleration,
        }
        return tuple(name for name, there in limited.items() if there)

    @cached_property
    def _of_joints(self) -> dict[str, tuple[str, int]]:
        names = self.limits.joints
        several = self.joint_metrics.items() if len(names) > 1 else ()
        return {f"{kind}_{names[k]}": (kind, k) for kind, (_, joints) in several for k in joints}

    def metrics(self, states: Sequence[str], estimated: Sequence[str], commanded: Sequence[str]) -> Metrics:
        """Metrics for a campaign whose true plant, estimate and command have these names."""
        names = [name for name in signal_names("link_position", self.limits.joints) if name in estimated]
        pairs = tuple((tuple(estimated).index(name), tuple(states).index(name)) for name in names)
        columns = position_columns(commanded, self.limits.joints) if self.ends is None else ()
        reductions = run_reductions(self.ends, columns, pairs)
        if self.limits.limits_rate or self.limits.limits_acceleration:
            reductions.append(changes_reduction(len(self.limits.joints), self.limits.period))
        return Metrics(
            self.units, None, partial(self._reduced, bool(pairs)), reductions, tuple(self._of_joints)
        )

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
            tracking, (most, most_late) = common["tracking_error"], self.required
            every |= {"tracking_error": tracking, "tracking_error_use": tracking / most}
            every |= {"final_error": late, "final_error_use": late / most_late}
        changes = {
            f"input_{kind}_use": common.get(kind, late) / getattr(self.limits, kind) for kind in CHANGES
        }
        uses = {"input_limit_use": effort / self.limits.peak, "speed_limit_use": speed / self.limits.speed}
        return {
            **{
                kind: every[kind][:, list(joints)].max(axis=1) if len(joints) else nothing
                for kind, (_, joints) in self.joint_metrics.items()
            },
            "estimation_error": common["estimate"] if estimated else nothing,
            **{name: use.max(axis=1) for name, use in (uses | changes).items() if name in self.uses},
            **{name: every[kind][:, k] for name, (kind, k) in self._of_joints.items()},
        }
