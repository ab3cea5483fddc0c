"""Limits of the inputs, speeds and positions of each joint, from the specification or the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from flexhinf.design.responses import Response
from flexhinf.design.specification import FIELDS, Specification, SpecificationError
from flexhinf.robot import Robot
from flexhinf.robot.elastic import DRIVES
from flexhinf.robot.kinematics import position_ranges
from flexhinf.robot.signals import UNITS

#: Who states a limit that no option does.
ROBOT = "the robot's file"


class LimitUse(NamedTuple):
    """Use of a limit by a run, in the joint and at the moment where it is largest."""

    # value, limit: In `unit`; the value is infinite where the run diverged
    value: float
    limit: float
    joint: str
    unit: str
    at: float | None  # s

    @property
    def share(self) -> float:
        """Value over limit."""
        return self.value / self.limit


@dataclass(frozen=True, eq=False)
class JointLimits:
    """One number per joint, infinite where there is no limit."""

    joints: tuple[str, ...]
    peak: np.ndarray  # (n,). Largest absolute input that is required, V, or N·m (N)
    saturation: np.ndarray  # (n,). Limits ± of controller and motors
    speed: np.ndarray  # (n,). Largest absolute velocity of the links, rad/s or m/s
    # lower, upper: (n,). Ranges of the link positions, rad or m
    lower: np.ndarray
    upper: np.ndarray
    effort_units: tuple[str, ...]
    speed_units: tuple[str, ...]
    position_units: tuple[str, ...]
    # peak_source, saturation_source, speed_source: The option that states them, or `ROBOT`
    peak_source: str
    saturation_source: str
    speed_source: str

    @property
    def effort(self) -> np.ndarray:
        """The smaller of requirement and saturation (n,)."""
        return np.minimum(self.peak, self.saturation)

    @property
    def saturated(self) -> np.ndarray | None:
        """The saturation (n,) for a controller; None where no motor has one."""
        return self.saturation if np.isfinite(self.saturation).any() else None

    @property
    def limits_peak(self) -> bool:
        """Whether the peak input of any joint has a limit."""
        return bool(np.isfinite(self.peak).any())

    @property
    def limits_effort(self) -> bool:
        """Whether any input has a limit, required or by saturation."""
        return bool(np.isfinite(self.effort).any())

    @property
    def limits_speed(self) -> bool:
        """Whether the speed of any joint has a limit."""
        return bool(np.isfinite(self.speed).any())

    @property
    def strongest(self) -> float:
        """The largest limit of an input, by the required peak, or by saturation without one; infinite without any."""
        limits = self.peak if self.limits_peak else self.saturation
        return (
            float(np.max(limits[np.isfinite(limits)], initial=-np.inf))
            if np.isfinite(limits).any()
            else np.inf
        )

    def equivalent_peak(self, response: Response) -> float:
        """Largest input of a run in terms of the `strongest` motor: the largest share of a limit times that one's."""
        if not np.isfinite(self.strongest) or response.diverged_at is not None:
            return response.peak_input
        use = self.input_use(response, self.peak if self.limits_peak else self.saturation)
        return use.value if use.limit == self.strongest else use.share * self.strongest

    def input_use(self, response: Response, limits: np.ndarray | None = None) -> LimitUse:
        """Of the peak, or other limits (n,) of the inputs."""
        limits = self.peak if limits is None else limits
        return self._use(response, response.inputs, limits, self.effort_units)

    def speed_use(self, response: Response) -> LimitUse:
        """Of the speed."""
        return self._use(response, response.velocities, self.speed, self.speed_units)

    def beyond_range(self, response: Response) -> LimitUse:
        """Largest distance of a joint outside of its range (lower, upper), rad or m; the limit is 0."""
        if response.diverged_at is not None:
            return LimitUse(np.inf, 0.0, "", self.position_units[0], None)
        q = response.positions
        beyond = np.maximum(np.maximum(self.lower - q, q - self.upper), 0.0)
        return self._largest(response, beyond, beyond, np.zeros(len(self.joints)), self.position_units)

    def _use(
        self, response: Response, signal: np.ndarray, limits: np.ndarray, units: tuple[str, ...]
    ) -> LimitUse:
        if response.diverged_at is not None:
            tightest = int(np.argmin(limits))
            return LimitUse(np.inf, float(limits[tightest]), "", units[tightest], None)
        values = np.abs(signal)
        return self._largest(response, values / limits, values, limits, units)

    def _largest(
        self,
        run: Response,
        shares: np.ndarray,
        values: np.ndarray,
        limits: np.ndarray,
        units: tuple[str, ...],
    ) -> LimitUse:
        """The value (N, n) at the largest share (N, n), with its joint and its time."""
        row, joint = divmod(int(np.argmax(shares)), shares.shape[1])
        value, at = float(values[row, joint]), float(run.run.time[row])
        return LimitUse(value, float(limits[joint]), self.joints[joint], units[joint], at)


def joint_limits(robot: Robot, s: Specification) -> JointLimits:
    """The limits of a specification, and those of the robot where it states none."""
    slides, joints = robot.links.slides, robot.joint_names
    low, high = position_ranges(robot)

    def units(signal: str) -> tuple[str, ...]:
        return tuple(UNITS[signal][sliding] for sliding in slides)

    def stated(name: str, own: Any) -> tuple[np.ndarray, str]:
        value = getattr(s, name)
        if value is None:
            return np.array(own, dtype=float), ROBOT
        return per_joint(joints, name, value), FIELDS[name].option

    peak, peak_source = stated("peak_effort", robot.effort_limits)
    saturation, saturation_source = stated("saturation", robot.effort_limits)
    speed, speed_source = stated("peak_speed", robot.speed_limits)
    return JointLimits(
        joints, peak, saturation, speed, low, high, units(DRIVES[robot.drive]),
        units("link_velocity"), units("link_position"), peak_source, saturation_source, speed_source,
    )  # fmt: skip


def integral_dead_zone(robot: Robot, s: Specification, chosen: np.ndarray | None) -> np.ndarray | None:
    """Errors (n,) that are not integrated, rad or m: as stated, or `chosen`; None without any."""
    zone = chosen if s.integral_dead_zone is None else s.integral_dead_zone
    none = zone is None or not np.any(zone)
    return None if none else per_joint(robot.joint_names, "integral_dead_zone", zone)


def per_joint(joints: Sequence[str], name: str, value: Any) -> np.ndarray:
    """A number of a field for each joint (n,); SpecificationError for another count of numbers."""
    limits = np.asarray(value, dtype=float)
    if limits.shape not in ((), (1,), (len(joints),)):
        raise SpecificationError(
            name,
            f"The {name.replace('_', ' ')} does not fit the joints.",
            f"expected one number, or one for each of {list(joints)}, got {limits.size}",
            example=",".join(f"{limit:g}" for limit in np.resize(limits, len(joints))),
        )
    return np.array(np.broadcast_to(limits, (len(joints),)))
