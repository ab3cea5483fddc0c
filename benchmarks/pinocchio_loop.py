"""The peer: an elastic arm's controller with filterpy's UKF and Pinocchio's dynamics, as Python users write it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from flexhinf.codegen import DIRECT
from flexhinf.plant import eight_stages, rk4_stages

__all__ = ["PinocchioController", "pinocchio_model"]


def pinocchio_model(robot: Any) -> Any:
    """The robot's links as a Pinocchio model."""
    p = robot.plant().parameters
    tree, mass, centre, inertia = robot.links.rigid(p.named(p.vector()))
    model, places = pin.Model(), []
    for i, (joint, parent) in enumerate(zip(tree.joints, tree.parents)):
        place = pin.SE3(np.array(joint.placement.rotation), np.array(joint.placement.translation))
        kind = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        places.append(model.addJoint(places[parent] if parent >= 0 else 0, kind, place, joint.name))
        xx, xy, xz, yy, yz, zz = inertia[i]
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = pin.Inertia(float(mass[i]), np.array(centre[i]), about)
        model.appendBodyToJoint(places[-1], body, pin.SE3.Identity())
    model.gravity.linear = np.array(robot.links.fall(p.named(p.vector())), dtype=float)
    return model


class PinocchioController:
    """Correct, integrate the error, evaluate the law, predict; torque-driven joints, link positions measured.

    Parameters
    ----------
    robot : flexhinf.Robot
    solution : flexhinf.HJISolution
    period : float
        s.
    steps : tuple of int
        Stages of a Runge–Kutta step, and steps of the model between two samples: those of our estimator.
    q, r, p0 : float
        Variances of process noise, measurement noise and first belief.
    """

    def __init__(
        self, robot: Any, solution: Any, period: float, steps: tuple[int, int], q: float, r: float, p0: float
    ) -> None:
        self.model = pinocchio_model(robot)
        self.memory = self.model.createData()
        self.p = robot.plant().parameters.named(robot.plant().parameters.vector())
        self.solution, self.period, self.steps = solution, period, steps
        self.point, self.rest = solution.operating_point, solution.operating_input
        self.n = len(self.rest)
        size = 4 * self.n
        points = MerweScaledSigmaPoints(size, alpha=1.0, beta=2.0, kappa=0.0)
        self.ukf = UnscentedKalmanFilter(
            size, self.n, period, hx=lambda x: x[: self.n], fx=self.advance, points=points
        )
        self.ukf.Q, self.ukf.R = q * np.eye(size), r * np.eye(self.n)
        self.ukf.x, self.ukf.P = self.point[:size].copy(), p0 * np.eye(size)
        self.ukf.sigmas_f = points.sigma_points(self.ukf.x, self.ukf.P)
        self.integral, self.previous, self.last = np.zeros(self.n), np.zeros(self.n), None

    def flow(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Spong's model (Eq. 2)."""
        q, dq, theta, dtheta = np.split(x, 4)
        spring = self.p.stiffness * (theta - q)
        link = pin.aba(self.model, self.memory, q, dq, spring)
        motor = (u - self.p.friction * dtheta - spring) / self.p.motor_inertia
        return np.concatenate([dq, link, dtheta, motor])

    def advance(self, x: np.ndarray, dt: float, u: Any = None) -> np.ndarray:
        """Runge–Kutta steps over one period."""
        stages, count = self.steps
        method = {4: rk4_stages, 8: eight_stages}[stages]
        for _ in range(count):
            x = method(DIRECT, self.flow, x, dt / count, u)
        return x

    def step(self, y: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Input for a measurement and a command."""
        self.ukf.update(y)
        if self.last is not None:
            self.integral = self.integral + self.period * (0.5 * (self.previous + y) - self.last)
        self.previous, self.last = y, reference
        deviation = np.concatenate([self.ukf.x, self.integral]) - self.point
        u = self.rest + self.solution.law(deviation)
        self.ukf.predict(u=u)
        return u
