"""What a controller publishes on ``~/state``: groups of named numbers, the same of the plugin and of the node."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from flexhinf.codegen.naming import distinct
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.trajectory_server import TrajectoryServer
from flexhinf.loop import Status
from flexhinf.stops import Stop

#: Numbers of the published health before the bits of the status and the reasons of a stop.
HEALTH = (
    "code", "status", "path_rate", "late_samples", "missed_writes", "stopped", "refused_commands", "contested",
    "stop",
)  # fmt: skip

#: Groups along a trajectory, with the attributes of `ArmMotion` that they are made of.
FOLLOWED = ("desired", "actual", "error")


def identifiers(signals: Sequence[str]) -> list[str]:
    """Names of signals for parameters and published numbers, each once."""
    return distinct([re.sub(r"[^A-Za-z0-9_]+", "_", name) for name in signals])


def health_names(code: ControllerCode) -> list[tuple[str, str, int]]:
    """Name, kind and place of each number of the health: of `HEALTH`, bits of the status, reasons of a stop, and
    counts."""
    rows = [(name, name, 0) for name in HEALTH]
    rows += [(str(bit.name).lower(), "status_bit", int(bit)) for bit in Status]
    rows += [(f"stop.{str(stop.name).lower()}", "stop_bit", int(stop)) for stop in Stop]
    measured = list(enumerate(identifiers(code.signals["Y"])))
    rows += [(f"unseen.{name}", "unseen", k) for k, name in measured]
    rows += [("doubtful", "doubtful", 0)] if code.doubt is not None else []
    rows += [(f"rejected.{name}", "rejected", k) for k, name in measured if code.rejected is not None]
    return rows


def state_groups(code: ControllerCode) -> dict[str, list[str]]:
    """Names of the published numbers by group, in the order of the message."""
    joints: Sequence[str] = () if code.robot is None else code.robot.joint_names
    followed = [f"{kind}_{joint}" for kind in ("position", "velocity") for joint in joints]
    health = [name for name, _, _ in health_names(code)]
    signals = {
        group: identifiers(code.signals[kind])
        for group, kind in (("input", "U"), ("measured", "Y"), ("estimate", "X"))
    }
    return {"health": health, **signals, **dict.fromkeys(FOLLOWED, followed)}


def state_values(server: TrajectoryServer) -> list[np.ndarray]:
    """The numbers of the last sample, in the order of `state_groups`; NaN for what is not known."""
    code, motion, stepped = server.code, server.motion, server.stepped
    of_health: dict[str, Sequence[float] | np.ndarray] = {
        "code": [code.codes[server.step_code].value],
        "status": [int(stepped.status)],
        "path_rate": [stepped.path_rate],
        "late_samples": [server.late_samples],
        "missed_writes": [0],  # an object that cannot write ends the loop
        "stopped": [int(bool(server.stopped))],
        "refused_commands": [0],  # rows are taken by the plugin alone
        "contested": [int(server.contested)],
        "stop": [int(stepped.stop)],
        "unseen": server.unseen,
        "doubtful": [stepped.doubtful_samples],
        "rejected": stepped.rejected,
    }
    bits = {"status_bit": int(stepped.status), "stop_bit": int(stepped.stop)}
    health = [
        float(bool(bits[kind] & place)) if kind in bits else of_health[kind][place]
        for _, kind, place in health_names(code)
    ]
    signals = [server.input, server.measurement, np.asarray(stepped.estimate, dtype=float)]
    return [np.array(health, dtype=float), *signals, *map(np.concatenate, motion.pairs)]
