"""One controller for the whole workspace sends an arm to several poses in a row, on the robot that MuJoCo simulates.

The moves are quintics with a rest at each pose; the feedforward is the inverse dynamics. The encoder of the elbow's
link is 0.5 mrad off, which the estimator takes in slowly. Then a pose outside of the workspace is commanded, and the
controller says so. Prints the largest error at the end of each rest, in mrad.
"""

from __future__ import annotations

import numpy as np

import flexhinf as fh
from flexhinf.robot import MuJoCoPlant

POSES = np.array([[0.4, 0.6], [1.5, -0.8], [-1.2, 1.4], [0.0, -2.0], [2.2, 0.5]])
MOVE, REST, OFFSET = 2.5, 1.5, 5e-4


class Encoders(MuJoCoPlant):
    """The robot in MuJoCo, with an encoder that is off."""

    def output(self) -> np.ndarray:
        """What is measured (4,): link positions, then motor positions."""
        return super().output() + np.array([0.0, OFFSET, 0.0, 0.0])


def main(controller: fh.Controller | None = None) -> list[float]:
    """Go through all poses; returns the largest error at each, in mrad."""
    robot = fh.load_robot("planar-two-link")
    if controller is None:
        wanted = fh.Specification(measured=("link_position", "motor_position"), saturation=24.0)
        controller = fh.design(robot, wanted).controller()
    starts = (MOVE + REST) * np.arange(len(POSES))
    times = np.column_stack([starts, starts + REST]).ravel()
    way = fh.Waypoints(times, np.repeat(POSES, 2, axis=0), "quintic")

    state, _ = robot.operating_point(POSES[0])
    plant = Encoders(robot, measured=("link_position", "motor_position"))
    run = fh.Loop(plant, controller).run(
        fh.Moving(way, robot.inverse_dynamics), noise=1e-5, duration=float(times[-1]), initial_state=state,
    )  # fmt: skip
    links = np.column_stack([run.signal("state", f"link_position_{joint}") for joint in robot.joint_names])
    errors = []
    for pose, end in zip(POSES, times[1::2]):
        resting = (run.time > end - 0.3) & (run.time <= end)
        errors.append(1e3 * float(np.abs(links[resting] - pose).max()))
        print(f"at {pose.tolist()} rad: {errors[-1]:.2f} mrad")

    controller.reset(pose=POSES[-1])
    state, input = robot.operating_point(POSES[-1])
    controller.step(run.data["output"][-1], np.concatenate([state + 1.0, input]))
    print(f"beyond the workspace: {controller.status!r}")
    return errors


if __name__ == "__main__":
    main()
