"""
One controller, several poses in a row, on the robot that MuJoCo simulates
==========================================================================

The moves are quintics with a rest at each pose. The encoder of the elbow's link is 0.5 mrad off, which the estimator
takes in slowly. At the end a pose outside of the workspace is commanded, and the controller says so.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# The law for the workspace with its filter; ``flexhinf.design`` would choose its bandwidth and judge it.
robot, period, sensors = fh.load_robot("planar-two-link"), 1e-3, ("link_position", "motor_position")
poses = np.array([[0.4, 0.6], [1.5, -0.8], [-1.2, 1.4], [0.0, -2.0], [2.2, 0.5]])
state, _ = robot.operating_point(poses[0])
noise = np.diag([0.0, 0.0, 1e-6, 1e-6, 0.0, 0.0, 1e-4, 1e-4])
ekf = fh.ExtendedKalmanFilter(
    robot.plant(sensors), period, noise, 1e-8, state, noise + 1e-12 * np.eye(8), form="covariance"
)
law = fh.ModalLaw.tuned(robot.problem(pose=poses[0], measured=sensors))
watch = fh.Supervision((np.array([-2.5, -2.5]), np.array([2.5, 2.5])))
controller = fh.Controller(
    law, fh.ModalFilter(ekf, state), period, saturation=24.0, moving=True, start="zero", offset_time=0.5,
    supervision=watch,
)  # fmt: skip

# %%
# 2.5 s for each move, 1.5 s of rest. Without MuJoCo the true arm is flexhinf's own, and the encoder is right.
starts = 4.0 * np.arange(len(poses))
times = np.column_stack([starts, starts + 1.5]).ravel()
way = fh.Waypoints(times, np.repeat(poses, 2, axis=0), "quintic")
try:
    from flexhinf.robot import MuJoCoPlant

    class Encoders(MuJoCoPlant):
        """The robot in MuJoCo, with an encoder that is off."""

        def output(self):
            """Link positions, then motor positions."""
            return super().output() + np.array([0.0, 5e-4, 0.0, 0.0])

    plant = Encoders(robot, measured=sensors)
except fh.InvalidInput as missing:
    print(missing)
    plant = robot.plant(sensors)
reference = fh.Moving(way, robot.inverse_dynamics)
run = fh.Loop(plant, controller).run(reference, noise=1e-5, duration=float(times[-1]), initial_state=state)

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
links = run.signals["state"][:, :2]
for k, joint in enumerate(robot.joint_names):
    above.plot(run.time, np.degrees(links[:, k]), label=joint)
    below.plot(run.time, 1e3 * (links[:, k] - way(run.time)[:, k]))
above.set(ylabel="link position (°)")
below.set(ylabel="error (mrad)", xlabel="time (s)")
above.legend()
for axes in (above, below):
    axes.grid(alpha=0.3)
resting = [(run.time > end - 0.3) & (run.time <= end) for end in times[1::2]]
errors = [1e3 * float(np.abs(links[at] - pose).max()) for at, pose in zip(resting, poses)]
print("largest error at each pose: " + ", ".join(f"{error:.2f}" for error in errors) + " mrad")

# %%
beyond = np.concatenate(robot.operating_point((2.55, 0.0)))
controller.reset(pose=poses[-1])
controller.step(run.signals["output"][-1], beyond)
print(f"beyond the workspace: {controller.status!r}")
