"""
PD against H∞ at an elastic joint: margins and Bode diagrams
============================================================

A PD on the motor of a flexible joint does not see the vibration behind the spring. The H∞ law feeds back the whole
state, which a filter estimates from both encoders. Both loops below have the same bandwidth. The PD amplifies a command
near the vibration by 1.7; it tolerates four times the delay of the other loop, and a larger gain.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop, frequency_response, margins
from flexhinf.baselines import MotorPD

# %%
# Quanser's rotary flexible joint, sampled at 1 kHz, with a sample of latency.
robot, sensors, period = fh.load_robot("quanser-rotflex"), ("link_position", "motor_position"), 1e-3
plant, (rest, _) = robot.plant(sensors), robot.operating_point()
penalty = fh.Penalty({"link_position": 30.0, "joint_torque_rate": 0.5}, effort=1.0)
torques = ("link_torque", "motor_torque")  # the disturbances; nothing is integrated
problem = robot.problem(penalty, measured=sensors, command=None, disturbances=torques, integrate=())
h_inf = fh.linear_law(problem, gamma=1.5 * fh.smallest_gamma(problem))
ekf = fh.ExtendedKalmanFilter(plant, period, np.diag([0.0, 1e-3, 0.0, 1e-3]), 1e-6, rest, 1e-6)
laws = {"PD on the motor": MotorPD.tuned(problem, bandwidth=20.0), "H∞": h_inf}

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.8), sharex=True, layout="constrained")
found, peak = {}, {}
for name, law in laws.items():
    loop = EquilibriumLoop(law, ekf, plant, period, positions="link_position", moving=True)
    response, found[name] = frequency_response(loop), margins(loop)
    hertz = response.frequencies / (2.0 * np.pi)
    above.semilogx(hertz, 20.0 * np.log10(np.abs(response.command[:, 0, 0])), label=name)
    torque = response.linear.disturbances.index("link_torque")
    below.semilogx(hertz, 20.0 * np.log10(np.abs(response.disturbance[:, 0, torque])), label=name)
    m, peak[name] = found[name], float(np.abs(response.command[:, 0, 0]).max())
    print(f"{name}: bandwidth {m.bandwidth[0]:.0f} rad/s, damping {m.damping:.2f}, amplifies by {peak[name]:.2f}, "
          f"tolerates {1e3 * m.delay_margin_s:.0f} ms and gain × {m.gain_margin:.1f}")  # fmt: skip
above.set(ylabel="command → link (dB)", ylim=(-40, 10), xlim=(0.4, 40))
below.set(ylabel="torque → link (dB rad/N·m)", xlabel="frequency (Hz)", ylim=(-40, 20))
above.legend()
for axes in (above, below):
    axes.grid(alpha=0.3)
