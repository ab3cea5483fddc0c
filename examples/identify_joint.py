"""
Stiffness and friction from a log
=================================

The spring of a joint is rarely on the data sheet. ``flexhinf.identify`` finds the numbers of a robot under which a log
is most likely, says how sure they are, and whether the model explains the log at all.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# A log of a real arm comes from ``flexhinf.read_log``. Here the real joint is softer than its data sheet and has more
# friction; the log is a loop that follows a swept sine, with both encoders and their noise.
sheet, sensors, period = fh.load_robot("quanser-rotflex"), ("link_position", "motor_position"), 2e-3
truth = {"stiffness": 0.7 * sheet.nominal["stiffness"], "friction": 2.0 * sheet.nominal["friction"]}
weights = {"link_position": 20.0, "link_position_integral": 40.0, "joint_torque_rate": 1.0}
problem = sheet.problem(weights, measured=sensors)
law = fh.linear_law(problem, gamma=1.5 * fh.smallest_gamma(problem))
ekf = fh.ExtendedKalmanFilter(sheet.plant(sensors), period, 1e-5, 1e-6, np.zeros(4), 1e-6)
loop = fh.Loop(sheet.with_values(truth).plant(sensors), fh.Controller(law, ekf, period))
log = loop.run(lambda t: 0.8 * np.sin(2.0 * np.pi * (0.5 * t + 0.3 * t**2)), noise=5e-4, duration=5.0, seed=2)

# %%
# The search begins at the data sheet. Both numbers are found within their 95 % intervals.
found = fh.identify(sheet, log, ("stiffness", "friction"), measured=sensors)
for name in truth:
    share = 100.0 * (found.values[name] / truth[name] - 1.0)
    print(
        f"{name}: {found.values[name]:.5g} ± {1.96 * found.standard_errors[name]:.2g}, {share:+.2f} % off the truth"
    )
print(f"the model explains the log: {found.consistent}")

# %%
# The link as it was measured, and two simulations with the same voltage: of the data sheet, and with the numbers found.
worst, models = {}, {"data sheet": sheet, "found": sheet.with_values(dict(found.values))}
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
above.plot(
    log.time, np.degrees(log.data.link_position_measured), "k", linewidth=3.0, alpha=0.3, label="measured"
)
for colour, (name, robot) in zip(("C1", "C0"), models.items()):
    blind = fh.ExtendedKalmanFilter(robot.plant(sensors), period, 1e-12, 1e6, np.zeros(4), 1e-12)
    simulated = fh.filter_log(blind, log)["prediction"][:, 0]
    error = np.degrees(simulated.values - log.data.link_position_measured.values[-len(simulated) :])
    above.plot(simulated.time, np.degrees(simulated), colour, label=f"simulated: {name}")
    below.plot(simulated.time, error, colour)
    worst[name] = float(np.abs(error).max())
above.set(ylabel="link position (°)")
below.set(ylabel="error (°)", xlabel="time (s)")
above.legend(ncols=3)
for axes in (above, below):
    axes.grid(alpha=0.3)
