"""Feedforward without feedback: commands for drives along a streamed path, by the inverse dynamics of the elastic arm.

A drive that takes positions, of a robot without sensors at its links, can still be given a motion that leaves no
vibration. The path q(t_k) of the links is streamed, one sample per period h. It is smoothed by B-splines of degree 5,
whose knots are a time T = N h apart [unser1999],

    q_d(t) = Σ_i φ(t − t_i) q(t_i),      φ = h β₅(t/T)/T,

so that four derivatives are continuous, whatever is streamed: jumps too. They are exact sums of the last 6 N samples,
and the inverse dynamics [deluca2016] give from them, in a bounded number of operations,

- the command c of a drive with an inner loop, which the robot file describes, or the torque, current or voltage;
- or, for a drive that has inputs for them, the motor's position θ_d with its velocity and torque as offsets (0x60B1
  and 0x60B2 of CiA 402), all on the link side.

q_d is later than q by 3 T. A path of constant velocity is kept exactly. As the inverse dynamics follow the pose, so
does what the command cancels. Where stiffness or load is uncertain, a part of it is left: the path is first shaped
then, by a filter whose periods follow the pose too, see `flexhinf.robot.shaper`.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Matrix
from flexhinf.errors import InvalidInput
from flexhinf.notebook import StatedRepr
from flexhinf.robot.command_limits import check_commands, check_sizes
from flexhinf.robot.drives import TORQUE
from flexhinf.robot.elastic import InverseFlow
from flexhinf.robot.robot import Robot
from flexhinf.robot.shaper import shaped_path
from flexhinf.validation import checked_array, checked_positive

#: Degree of the spline; knots of one of its pieces; derivatives, the position included; longest window, samples.
DEGREE, KNOTS, ORDERS, LONGEST = 5, 6, 5, 2000

#: Weights that are no more than rounding, of the largest of their row.
ROUNDING = 1e-13


class FeedforwardRows(NamedTuple):
    """Commands along a path of N samples, (N, n) each; rad, rad/s and N·m, or m, m/s and N, on the link side."""

    command: np.ndarray  # input of the robot's drive
    motor_position: np.ndarray  # θ_d
    motor_velocity: np.ndarray  # velocity offset, 0x60B1
    motor_torque: np.ndarray  # torque offset, 0x60B2
    link_position: np.ndarray  # q_d, which the links follow


@dataclass(frozen=True, eq=False, repr=False)
class Feedforward(StatedRepr):
    """Commands for a robot's drives along a streamed path.

    Parameters
    ----------
    robot : Robot
        Its links, springs, motors and drives.
    period : float
        Time between two samples of the path, s.
    smoothing : float
        T, s: a multiple of the period. The path is later by 3 T, and jumps take 6 T. By default the vibration's period
        does not matter, as the inverse dynamics leave none; where stiffness is uncertain, stream what `shaped` gives.

    Raises InvalidInput: for a smoothing that is no multiple of the period, or longer than 333 of them.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> feedforward = fh.Feedforward(fh.load_robot("planar-two-link"), period=4e-3, smoothing=0.02)
    >>> rows = feedforward.rows(np.linspace([0.0, 0.0], [0.5, 1.0], 250))
    >>> rows.command.shape, rows.motor_position.shape
    ((250, 2), (250, 2))
    """

    robot: Robot
    period: float
    smoothing: float = 0.02

    def __post_init__(self) -> None:
        checked_positive("The period", self.period, "seconds", "period=4e-3")
        checked_positive("The smoothing", self.smoothing, "seconds", "smoothing=0.02")
        count = round(self.smoothing / self.period)
        if not 1 <= KNOTS * count <= LONGEST or abs(count * self.period / self.smoothing - 1.0) > 1e-6:
            nearest = min(max(count, 1), LONGEST // KNOTS)
            raise InvalidInput(
                "The smoothing of the path does not fit its samples.",
                f"expected a multiple of the period {self.period:g} s, up to {LONGEST // KNOTS} of them, "
                f"got {self.smoothing:g} s",
                f"smoothing={nearest * self.period:.6g}",
            )

    @cached_property
    def weights(self) -> Matrix:
        """φ and its derivatives (5, 6 N) at the ages of samples, the newest first; 1, 1/s, … 1/s⁴."""
        from scipy.interpolate import BSpline

        count = round(self.smoothing / self.period)
        spline = BSpline.basis_element(np.arange(KNOTS + 1.0), extrapolate=False)
        ages = np.arange(KNOTS * count) / count
        rows = [spline.derivative(order)(ages) if order else spline(ages) for order in range(ORDERS)]
        weights = np.nan_to_num(np.array(rows)) / count
        sizes = np.abs(weights).max(axis=1, keepdims=True)
        weights[np.abs(weights) < ROUNDING * sizes] = 0.0  # where a derivative changes its sign
        return weights / self.smoothing ** np.arange(ORDERS)[:, None]

    @property
    def delay(self) -> float:
        """By how much q_d is later than the path, s."""
        return 0.5 * KNOTS * self.smoothing

    def shaped(self, path: ArrayLike) -> np.ndarray:
        """A path (N, n), rad or m, shaped by a filter of zero vibration and derivative whose periods follow the pose.

        To be streamed in its place, in Python or C, where stiffness or load is uncertain, to drives that hold the
        motors: by positions, velocities, or the motor's position; a torque alone does not. It is later by half a period
        of each vibration, see `shaping_delay`. A row needs the path of two periods of each before it, no more.
        Raises InvalidInput: where the springs do not hold the links against gravity.

        Examples
        --------
        >>> import flexhinf as fh
        >>> feedforward = fh.Feedforward(fh.load_robot("planar-two-link"), period=4e-3)
        >>> step = [[0.0, 0.0]] + [[0.5, 0.2]] * 249
        >>> float(feedforward.shaping_delay(step)[-1].round(3))
        0.22
        >>> feedforward.shaped(step)[[1, 80, -1], 0].round(3).tolist()
        [0.031, 0.375, 0.5]
        """
        return shaped_path(self.robot, self._checked(path), self.period)[0]

    def shaping_delay(self, path: ArrayLike) -> np.ndarray:
        """By how much `shaped` is later than the path at each of its rows (N,), s."""
        return shaped_path(self.robot, self._checked(path), self.period)[1]

    def _checked(self, path: ArrayLike) -> np.ndarray:
        """A path as finite rows (N, n)."""
        n, what = len(self.robot.joint_names), "The path does not fit the robot."
        q = np.atleast_1d(np.asarray(path, dtype=float))
        q = q[:, None] if q.ndim == 1 and n == 1 else q
        return checked_array(
            what, q, (len(q), n), f"(N, {n}) finite numbers", "one row of link positions per sample"
        )

    def smoothed(self, path: ArrayLike) -> np.ndarray:
        """q_d and four derivatives (5, N, n) along a path (N, n), which rested at its first row before."""
        q = self._checked(path)
        size = self.weights.shape[1]
        held = np.vstack([np.repeat(q[:1], size - 1, axis=0), q]) - q[0]
        windows = np.lib.stride_tricks.sliding_window_view(held, size, axis=0)[..., ::-1]
        found = np.einsum("ok,snk->osn", self.weights, windows)
        found[0] += q[0]
        return found

    def rows(self, path: ArrayLike) -> FeedforwardRows:
        """Commands along a path (N, n) of link positions, rad or m, one row per period.

        Raises InvalidInput: where a command is larger, changes faster or is accelerated more than the robot's drives
        take, or the torque of a motor is larger than its drive's.
        """
        motion = self.smoothed(path)
        state, command = self.robot.inverse_dynamics(*motion)
        check_commands(
            self.robot,
            command,
            self.period,
            f"; or a longer smoothing than {self.smoothing:g} s where it jumps",
        )
        torques = self.torques(motion)
        check_sizes(self.robot, command, torques, self.period)
        layout = self.robot.layout
        _, _, theta, speed = (part.T for part in layout.split(state.T))
        motors, speeds = (
            layout.motors(at.T, own.T).T for at, own in ((motion[0], theta), (motion[1], speed))
        )
        return FeedforwardRows(command, motors, speeds, torques, motion[0])

    def torques(self, motion: np.ndarray) -> np.ndarray:
        """Torques (N, n) of the motors, on the link side, along a motion (5, N, n)."""
        from flexhinf.plant.model import ParameterTable
        from flexhinf.robot.elastic import traced_inverse

        table = ParameterTable(dict(self.robot.plant_parameters()))
        inverse = traced_inverse(
            self.inverse, tuple((name, value.shape) for name, value in table.values.items())
        )
        return np.array(inverse(*(part.T for part in motion), table.vector())[1], dtype=float).T

    @property
    def inverse(self) -> InverseFlow:
        """The inverse dynamics with the motors' torques for inputs."""
        return InverseFlow(self.robot.links, TORQUE.name, layout=self.robot.layout)
