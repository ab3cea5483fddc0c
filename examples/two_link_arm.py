"""A two-link arm with elastic joints moves between two poses; only the motors are measured.

The robot comes from the catalogue, the law from its own file's weights. The true plant is MuJoCo's where MuJoCo is
installed, and ours where it is not. Prints how far the links are from their goal.
"""

from __future__ import annotations

import numpy as np

import flexhinf as fh
from flexhinf.robot import MuJoCoPlant

PERIOD, DURATION = 1e-3, 3.0


def main() -> dict[str, float]:
    """Design, move, and return the largest error on the way (rad) and at the end."""
    robot = fh.load_robot("planar-two-link")
    goal = np.array([0.6, 0.3])
    problem = robot.problem(pose=goal, measured=("motor_position",))
    law = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=4)

    start, _ = robot.operating_point()  # at the robot's home
    model = robot.plant(measured=("motor_position",))
    ukf = fh.UnscentedKalmanFilter(model, PERIOD, 1e-6, 1e-6, mean=start, covariance=1e-6)
    controller = fh.Controller(law, ukf, PERIOD, saturation=24.0)
    path = [fh.Quintic(float(a), float(b), 1.0) for a, b in zip(start[:2], goal, strict=True)]
    run = fh.Loop(true_plant(robot), controller).run(path, noise=1e-4, duration=DURATION, initial_state=start)

    positions = np.column_stack(
        [run.signal("state", f"link_position_{joint}") for joint in robot.joint_names]
    )
    error = np.abs(positions - run.signals["reference"])
    result = {"largest_error_rad": float(error.max()), "final_error_rad": float(error[-100:].max())}
    for name, value in result.items():
        print(f"{name}: {value:.4f}")
    return result


def true_plant(robot: fh.Robot):
    """The arm in MuJoCo, or our own plant where MuJoCo is not installed."""
    try:
        return MuJoCoPlant(robot, measured=("motor_position",))
    except fh.InvalidInput as missing:
        print(missing)
        return robot.plant(measured=("motor_position",))


if __name__ == "__main__":
    main()
