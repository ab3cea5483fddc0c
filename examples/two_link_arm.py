"""
A two-link arm moves, and only its motors are measured
======================================================

The robot comes from the catalogue, the nonlinear law from the weights in its file. The true plant is MuJoCo's where
MuJoCo is installed, an independent simulation of the same arm; otherwise it is flexhinf's own.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# A law with a V of degree 4 about the goal; the filter sees the encoders of the motors.
robot, period, goal = fh.load_robot("planar-two-link"), 1e-3, np.array([0.6, 0.3])
problem = robot.problem(pose=goal, measured=("motor_position",))
law = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=4)
start, _ = robot.operating_point()  # at the robot's home
model = robot.plant(measured=("motor_position",))
ukf = fh.UnscentedKalmanFilter(model, period, 1e-6, 1e-6, mean=start, covariance=1e-6)
controller = fh.Controller(law, ukf, period, saturation=24.0, start="bumpless")  # no jump of the input

# %%
try:
    from flexhinf.robot import MuJoCoPlant

    true_plant = MuJoCoPlant(robot, measured=("motor_position",))
except fh.InvalidInput as missing:
    print(missing)
    true_plant = model
path = [fh.Quintic(float(a), float(b), 1.0) for a, b in zip(start[:2], goal, strict=True)]
run = fh.Loop(true_plant, controller).run(path, noise=1e-4, duration=3.0, initial_state=start)

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
error = {}
for joint, colour in zip(robot.joint_names, ("C0", "C1")):
    link, wanted = run.data[f"link_position_{joint}"], run.data[f"link_position_{joint}_commanded"]
    error[joint] = np.abs(link.values - wanted.values)
    above.plot(run.time, np.degrees(link), colour, label=joint)
    above.plot(run.time, np.degrees(wanted), "k:")
    below.plot(run.time, run.data[f"motor_voltage_{joint}"], colour)
above.set(ylabel="link position (°)")
below.set(ylabel="motor voltage (V)", xlabel="time (s)")
above.legend()
for axes in (above, below):
    axes.grid(alpha=0.3)
largest = max(each.max() for each in error.values())
final = max(each[-100:].max() for each in error.values())
print(f"largest error {largest:.3f} rad on the way, {final:.4f} rad at the end")
