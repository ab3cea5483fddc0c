"""
Two links that stop at once, and two that swing
===============================================

Both controllers move the elastic two-link arm along the same quintic, with the same feedforward and limits. A stiff PD
then holds its motors while the links swing on their springs. The law for the workspace feeds back what its filter knows
of the links, and they stop.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh
from flexhinf.baselines import MotorPD

# %%
# One law serves every pose. Its filter sees the encoders of both sides, and expects random torques on links and motors.
robot, period = fh.load_robot("planar-two-link"), 1e-3
start, goal, sensors = np.array([0.2, 0.4]), np.array([1.0, 1.4]), ("link_position", "motor_position")
problem, rest = robot.problem(pose=start, measured=sensors), robot.operating_point(start)
noise = np.diag([0.0, 0.0, 1e-4, 1e-4, 0.0, 0.0, 1e-2, 1e-2])
ekf = fh.ExtendedKalmanFilter(
    robot.plant(sensors), period, noise, 1e-8, rest[0], noise + 1e-12 * np.eye(8), form="covariance"
)
laws = {
    "law for the workspace": (fh.ModalLaw.tuned(problem), fh.ModalFilter(ekf, rest[0])),
    "stiff PD + gravity": (MotorPD.tuned(problem, bandwidth=80.0), ekf),
}

# %%
# The motors reach their limit of 24 V on the way. After 0.6 s the command stands still.
path = fh.Moving([fh.Quintic(a, b, 0.4, at=0.2) for a, b in zip(start, goal)], robot.inverse_dynamics)
figure, panels = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
swing = {}
for name, (law, estimator) in laws.items():
    controller = fh.Controller(law, estimator, period, saturation=24.0, moving=True, start="zero")
    run = fh.Loop(robot.plant(sensors), controller).run(path, noise=1e-4, duration=1.6, initial_state=rest[0])
    errors = np.degrees(run.signals["state"][:, :2] - run.signals["reference"][:, :2])
    swing[name] = float(np.abs(errors[run.time > 1.1]).max())
    for axes, joint, error in zip(panels, robot.joint_names, errors.T):
        axes.plot(run.time, error, label=name)
        axes.set(ylabel=f"error of the {joint} (°)")
for axes in panels:
    axes.axvspan(0.2, 0.6, color="0.93", label="the arm is moved")
    axes.grid(alpha=0.3)
panels[0].legend()
panels[1].set(xlabel="time (s)")
for name, value in swing.items():
    print(f"{name}: at most {value:.2f}° off, from half a second after the move on")
