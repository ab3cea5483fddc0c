"""An elastic joint follows a moving reference: feedforward by inverse dynamics, the law on the error alone.

The reference is Fig. 7's, π + sin(πt/10), and a jerk-limited move between two poses. Only the link position is
measured, with noise, and the true arm has the motor's coil. Prints the largest error, in degrees.
"""

from __future__ import annotations

import numpy as np

import flexhinf as fh

PERIOD = 1e-3


def main() -> dict[str, float]:
    """Follow both references; returns the largest error of each after two seconds, in degrees."""
    robot = fh.paper_arm()
    weights = {
        "link_position": 70.0, "link_velocity": 18.0, "motor_position": 60.0, "motor_velocity": 18.0,
        "link_position_integral": 320.0,
    }  # fmt: skip
    references = {
        "sine": fh.Sine(1.0, frequency=0.05, offset=np.pi),
        "move": fh.JerkLimited(
            np.pi, np.pi / 2, velocity=1.5, acceleration=4.0, jerk=20.0, at=2.0, smoothing=0.5
        ),
    }
    problem = robot.problem(fh.Penalty(weights, effort=10.0), pose=[np.pi])
    law = fh.solve_hji(problem, gamma=1.5 * fh.smallest_gamma(problem), degree=4)
    errors = {}
    for name, signal in references.items():
        reference = fh.Moving(
            signal, robot.inverse_dynamics
        )  # the state and the voltage of the wanted motion
        begin = reference.state(0.0)
        ukf = fh.UnscentedKalmanFilter(robot.plant(), PERIOD, 1e-6, 1e-6, mean=begin, covariance=1e-6)
        controller = fh.Controller(law, ukf, PERIOD, moving=True)
        loop = fh.Loop(robot.plant(inductance=True), controller)
        run = loop.run(reference, noise=1e-4, duration=12.0, initial_state=begin)
        error = run.signal("state", "link_position") - signal(run.time)
        errors[name] = float(np.degrees(np.abs(error[run.time > 2.0]).max()))
        print(f"{name}: largest error {errors[name]:.3f}° after two seconds")
    return errors


if __name__ == "__main__":
    main()
