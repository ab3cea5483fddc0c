"""The robots that are judged: their files, the payload that no law knows, and limits where a file states none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import flexhinf as fh
from benchmarks.hardware.robots import ROBOTS as HARDWARE, files_of
from benchmarks.workspace.arm import Arm, damped

__all__ = ["ROBOTS", "Entry", "true_arms"]

#: Robots of the condition "sampled", each with every uncertain number at one end of its tolerance; and their seed.
SAMPLES, SEED = 8, 11


@dataclass(frozen=True)
class Entry:
    """A robot of the benchmark: a name of the catalogue or of `benchmarks.hardware`, its payload, assumed limits."""

    source: str
    payload: str
    efforts: tuple[float, ...] | None = None
    speeds: tuple[float, ...] | None = None

    def robot(self, payload: bool = False) -> Any:
        """The robot, with the payload or without; FileNotFoundError where its URDF is not installed."""
        load = self.payload if payload else None
        if self.source in HARDWARE:
            file, elastic = files_of(self.source)
            robot = fh.load_robot(file, elastic, payload=load)
        else:
            robot = fh.load_robot(self.source, payload=load)
        limits = {"effort_limits": self.efforts, "speed_limits": self.speeds}
        return replace(robot, **{name: value for name, value in limits.items() if value is not None})


#: By name. Limits stand here where the file states none: of the paper's arm and of planar-two-link volts (their motors
#: have no other limit), of the seven links those of a light arm.
ROBOTS = {
    "paper": Entry("paper", "0.2kg", (48.0,), (2.0,)),
    "planar-two-link": Entry("planar-two-link", "1kg", (24.0, 24.0), (4.0, 4.0)),
    "scara": Entry("scara", "1kg@wrist:0.03,0,-0.06"),
    "spatial": Entry("spatial", "1kg"),
    "seven-link": Entry(
        "seven-link", "1kg", (176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0), (1.7, 1.7, 1.7, 2.2, 2.4, 3.1, 3.1)
    ),
    "ur5": Entry("ur5", "1kg@wrist_3_joint"),
    "panda": Entry("panda", "1kg@panda_joint7"),
}  # fmt: skip


def true_arms(entry: Entry, kind: str) -> list[Arm]:
    """The true robots of a condition: "nominal", with the "payload", or "sampled"; no spring of theirs is undamped."""
    if kind == "sampled":
        robot = entry.robot()
        return [damped(Arm.of(robot, values)) for values in robot.random_corners(SAMPLES, SEED)]
    return [damped(Arm.of(entry.robot(payload=kind == "payload")))]
