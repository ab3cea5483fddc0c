"""The tables of docs/augmentation.md, for docs/make.py: what it brings to estimate a load and the like too.

The paper's arm stands at 90° with the law of one design for each set of sensors. The filter of the design is as it
was searched; the others have more states, and the same R^v of the arm's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

GOAL, BANDWIDTH, PERIOD = np.pi / 2, 4.0, 1e-3

#: Load on the link, N·m, and when; offset of the motor's encoder, rad; random corners of the tolerances; seeds.
LOAD, AT, OFFSET, CORNERS, SEED = 1.0, 0.5, 5e-4, 16, 0

SENSORS = {
    "link": ("link_position",), "motor": ("motor_position",), "both": ("link_position", "motor_position"),
}  # fmt: skip

#: Rows: what is estimated beside the arm's states, and what the input balances.
ROWS: dict[str, dict[str, Any]] = {
    "nothing more (the design's filter)": {},
    "stiffness": {"parameters": ("stiffness",)},
    "load": {"disturbances": ("link_torque",)},
    "load, balanced": {"disturbances": ("link_torque",), "compensate": "link_torque"},
    "load that drifts ten times faster, balanced": {
        "disturbances": ("link_torque",), "compensate": "link_torque", "drift": 10.0,
    },
    "stiffness and load, balanced": {
        "parameters": ("stiffness",), "disturbances": ("link_torque",), "compensate": "link_torque",
    },
    "offset of the motor's encoder": {"offsets": ("motor_position",)},
    "offset and load, balanced": {
        "offsets": ("motor_position",), "disturbances": ("link_torque",), "compensate": "link_torque",
    },
}  # fmt: skip

#: Of a new state by its name: standard deviation at first, and of its drift in one period.
KNOWN = {
    "stiffness": (7.0, 1e-2), "link_torque": (1.0, 1e-3), "motor_position_offset": (5e-4, 1e-8),
}  # fmt: skip


def designs() -> dict[str, Any]:
    """One for each set of sensors."""
    import flexhinf as fh

    arm = fh.load_robot("paper")
    options: dict[str, Any] = {"pose": "90deg", "start": 0.0, "bandwidth": BANDWIDTH, "draws": 0, "rays": 0}
    return {
        name: fh.design(arm, fh.Specification(measured=measured, **options))
        for name, measured in SENSORS.items()
    }


def controller(
    design: Any, at: float, compensate: str | None = None, drift: float = 1.0, **more: Sequence[str]
) -> Any:
    """The design's law with a filter that estimates more; begins at a pose, in rad, without a jump. `drift`: times
    that of `KNOWN`."""
    import flexhinf as fh

    own = design.loop.setup.estimator(np.array([at]), deployed=True)
    plant = own.plant.augmented(**more) if more else own.plant
    added = [KNOWN[name] for name in plant.states[own.plant.n :]]
    first = [100.0 if name == "stiffness" else 0.0 for name in plant.states[own.plant.n :]]
    variances, drifts = np.square(added * np.array([1.0, drift])).T if added else np.zeros((2, 0))
    filter = fh.UnscentedKalmanFilter(
        plant, PERIOD, _beside(own.process_noise, drifts), own.measurement_noise,
        np.append(own.initial.mean, first), _beside(own.initial.covariance, variances), form="square_root",
    )  # fmt: skip
    holding = design.robot.operating_point([at])[1]
    return fh.Controller(
        design.evidence.solution,
        filter,
        PERIOD,
        start="bumpless",
        before_first=holding,
        latency=1,
        compensate=compensate,
    )


def _beside(own: np.ndarray, added: np.ndarray) -> np.ndarray:
    whole = np.zeros((len(own) + len(added),) * 2)
    whole[: len(own), : len(own)] = own
    return whole + np.diag(np.append(np.zeros(len(own)), added))


def disturbed(
    design: Any, row: dict[str, Any], offset: float = 0.0, load: float = 0.0
) -> tuple[float, float, float]:
    """At rest at the goal with an offset of the motor's encoder, or a load: largest error of the link, the mean one in
    the last 0.3 s, mrad, and by how much the input moves beyond what the load asks for, V."""
    import flexhinf as fh

    robot, measured = design.robot, design.specification.measured
    true, x = robot.plant(measured), robot.operating_point([GOAL])[0]
    if "motor_position" in measured:
        true, x = true.augmented(offsets=("motor_position",)), np.append(x, offset)
    run = fh.Loop(true, controller(design, GOAL, **row)).run(
        fh.Step(GOAL), {"link_torque": fh.Step(load, at=AT)}, noise=np.full(len(measured), 1e-5), duration=8.0,
        initial_state=x, seed=SEED,
    )  # fmt: skip
    error = 1e3 * np.abs(run.signals["state"][:, 0] - GOAL)
    volts = run.signals["input"][:, 0] - robot.operating_point([GOAL])[1][0]
    needed = (
        min(0.0, -load * 10.0 / 9.0),
        max(0.0, -load * 10.0 / 9.0),
    )  # R/k_t of a volt holds a newton metre
    return (
        float(error.max()),
        float(error[-300:].mean()),
        float(np.max([volts - needed[1], needed[0] - volts])),
    )


def stepped(design: Any, row: dict[str, Any]) -> tuple[float, float, float, int]:
    """The step to the goal at random corners of the tolerances: worst overshoot, %, largest mean error of the last 0.3
    s, mrad, and input, V, of those that settle; and how many do not."""
    import flexhinf as fh

    robot, measured = design.robot, design.specification.measured
    found, lost = [], 0
    for k, values in enumerate(robot.random_corners(CORNERS, SEED)):
        true = robot.plant(measured)
        true = true.with_parameters(**true.parameters.known(values))
        run = fh.Loop(true, controller(design, 0.0, **row)).run(
            fh.Step(GOAL), noise=np.full(len(measured), 1e-5), duration=8.0, initial_state=np.zeros(4), seed=k
        )
        link = run.signals["state"][:, 0]
        if run.status != "completed" or np.abs(link[-300:] - GOAL).max() > 0.02 * GOAL:
            lost += 1
            continue
        left = 1e3 * np.abs(link[-300:] - GOAL).mean()
        found.append((100.0 * (link.max() / GOAL - 1.0), left, np.abs(run.signals["input"]).max()))
    worst = np.max(found, axis=0) if found else np.full(3, np.nan)
    return (*map(float, worst), lost)


def seen(row: dict[str, Any], sensors: str) -> bool:
    """Whether the sensors can have what the row estimates: an offset is one of the motor's encoder."""
    return "offsets" not in row or sensors != "link"


def augmentation() -> str:
    """A row for each set of sensors and of new states."""
    head = (
        "measured", "estimated beside the state", f"load of {LOAD:g} N·m: largest, remaining error, mrad; effort, V",
        f"power-on, {1e3 * OFFSET:g} mrad of the motor's encoder: largest, remaining error, mrad; effort, V",
        f"step at {CORNERS} corners: overshoot, %; remaining error, mrad; peak, V; not settled",
    )  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for sensors, design in designs().items():
        for name, row in ROWS.items():
            if not seen(row, sensors):
                continue
            load = disturbed(design, row, load=LOAD)
            offset = disturbed(design, row, offset=OFFSET) if sensors != "link" else None
            *step, lost = stepped(design, row)
            cells = (
                sensors, name, "{:.1f}, {:.2f}; {:.1f}".format(*load),
                "–" if offset is None else "{:.2f}, {:.2f}; {:.2f}".format(*offset),
                "{:.1f}; {:.2f}; {:.0f}; {}".format(*step, lost),
            )  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
            print(lines[-1], flush=True)
    return "\n".join(lines)
