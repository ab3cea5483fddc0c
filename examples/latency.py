"""
What a late input costs, and what knowing it brings
===================================================

Computation and bus make an input late. A controller that knows its latency predicts over it; one that does not
acts on what is over. The same law, with the same filter, rings in the one and stays calm in the other.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# Quanser's rotary flexible joint, sampled at 500 Hz, steps by 30°. Its motor gets at most 10 V.
robot, period, goal = fh.load_robot("quanser-rotflex"), 2e-3, np.radians(30.0)
sensors = ("link_position", "motor_position")
weights = {"link_position": 200.0, "link_position_integral": 400.0, "joint_torque_rate": 5.0}
problem = robot.problem(weights, measured=sensors)
law = fh.linear_law(problem, gamma=1.5 * fh.smallest_gamma(problem))
ekf = fh.ExtendedKalmanFilter(
    robot.plant(sensors), period, np.diag([0.0, 1e-2, 0.0, 1e-2]), 1e-6, np.zeros(4), 1e-6
)

# %%
figure, panels = plt.subplots(1, 2, figsize=(7.0, 3.6), sharey=True, layout="constrained")
ripple = {}
for axes, known in zip(panels, (False, True)):
    for samples in (0, 3, 5):
        controller = fh.Controller(law, ekf, period, latency=samples if known else 0, saturation=10.0)
        loop = fh.Loop(robot.plant(sensors), controller, delay=0.0 if known else samples * period)
        run = loop.run(goal, duration=1.5)
        ripple[known, samples] = float(np.ptp(run.data.motor_voltage.values[-250:]))
        axes.plot(run.time, np.degrees(run.data.link_position), label=f"{1e3 * samples * period:.0f} ms late")
    axes.axhline(30.0, color="0.4", linestyle=":")
    axes.set(
        xlabel="time (s)", title="the controller knows it" if known else "the controller does not know it"
    )
    axes.title.set_fontsize(9)
    axes.grid(alpha=0.3)
panels[0].set(ylabel="link position (°)", ylim=(-2, 35))
panels[1].legend(loc="lower right")
for (known, samples), value in ripple.items():
    late = f"{1e3 * samples * period:2.0f} ms, {'known' if known else 'unknown'}"
    print(f"{late}: the voltage swings by {value:.2f} V in the last half second")
