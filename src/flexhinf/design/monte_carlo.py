"""The same run on many robots sampled within their tolerances, with the controller as it was designed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.responses import worst_of

__all__ = ["MonteCarlo", "move_errors", "sampled_runs"]

#: At most so many instants of each run are kept.
KEPT = 400


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Figures of N runs, one row per robot.

    Attributes
    ----------
    values : tuple of mapping
        Parameters of each robot.
    overshoot : (N,)
        Largest of all joints, per cent; infinite where the run diverged.
    settling : (N,)
        Slowest of all joints, s; infinite where one does not settle in the run.
    peak : (N,)
        Largest input of all motors; infinite where the run diverged.
    overshoot_joints, settling_joints, peak_joints : tuple of str
        The joints of these worst values; "" where the run diverged, or no joint moves.
    inputs, speeds : (N, n)
        Largest input of each motor and speed of each link; infinite where the run diverged.
    time : (T,)
        Instants that are kept, s.
    positions : (N, T, n)
        Link positions; NaN from where a run diverged.
    """

    values: tuple[Mapping[str, Any], ...]
    overshoot: np.ndarray
    settling: np.ndarray
    peak: np.ndarray
    overshoot_joints: tuple[str, ...]
    settling_joints: tuple[str, ...]
    peak_joints: tuple[str, ...]
    inputs: np.ndarray
    speeds: np.ndarray
    time: np.ndarray
    positions: np.ndarray

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

    @property
    def joint_of_worst_overshoot(self) -> str:
        """Empty for a robot of one joint."""
        if self.positions.shape[2] < 2:
            return ""
        return self.overshoot_joints[int(np.argmax(self.overshoot))]


def sampled_runs(
    setup: LoopSetup,
    robots: Sequence[Mapping[str, Any]],
    duration: float,
    sub_steps: int,
    jump: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> MonteCarlo:
    """The step, or the jump, of each robot, with noise of its own.

    Parameters
    ----------
    setup : LoopSetup
    robots : sequence of mapping
        Parameters.
    duration : float
        s.
    sub_steps : int
        Of the true plants: the nominal one's, so that all runs share one kernel.
    jump : bool
        The whole command at once with integrals at zero; otherwise the step as deployed.
    progress : callable
    """
    count, period = len(robots), setup.specification.period
    time = _kept(duration, period)
    positions = np.full((count, len(time), len(setup.goal)), np.nan)
    inputs, speeds = (np.full((count, len(setup.goal)), np.inf) for _ in range(2))
    overshoots, settlings, peaks = [], [], []
    for k, response in enumerate(setup.steps(robots, duration, sub_steps, jump)):
        overshoots.append(response.overshoot)
        settlings.append(response.settling)
        peaks.append(response.peak)
        if response.diverged_at is None:
            inputs[k], speeds[k] = (np.abs(x).max(axis=0) for x in (response.inputs, response.velocities))
        passed = int(np.searchsorted(time, response.run.time[-1] + 0.5 * period))
        at = np.searchsorted(response.run.time, time[:passed] - 0.5 * period)
        positions[k, :passed] = response.positions[at]
        if (k + 1) % max(1, count // 10) == 0:
            progress(f"robots within the tolerances: {k + 1} of {count}")
    return MonteCarlo(
        tuple(robots),
        np.array([worst.value for worst in overshoots]),
        np.array([worst.value for worst in settlings]),
        np.array([worst.value for worst in peaks]),
        tuple(worst.joint for worst in overshoots),
        tuple(worst.joint for worst in settlings),
        tuple(worst.joint for worst in peaks),
        inputs,
        speeds,
        time,
        positions,
    )


def move_errors(
    setup: LoopSetup,
    robots: Sequence[Mapping[str, Any]],
    plan: Any,
    sub_steps: int,
    rest: float | None = None,
) -> np.ndarray:
    """Largest error (N,) of any joint along the planned move, rad or m; infinite where a run diverged."""
    moves = setup.moves(robots, plan, sub_steps, rest)
    return np.array([worst_of(move.metrics, "largest_error").value for move in moves])


def _kept(duration: float, period: float) -> np.ndarray:
    """Instants of samples (T,), evenly apart."""
    samples = round(duration / period)
    return period * np.arange(0, samples, max(1, -(-samples // KEPT)))
