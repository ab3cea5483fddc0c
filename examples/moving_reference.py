"""
A moving reference: feedforward by inverse dynamics, the law on the error alone
===============================================================================

An elastic joint follows a sine and a jerk-limited move. The feedforward is the state and the voltage of the wanted
motion, exactly; the law acts on what differs from it. Only the link position is measured, with noise.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# A cubic law of the paper's arm about its upright pose, where gravity pulls it away.
robot, period = fh.paper_arm(), 1e-3
problem = robot.problem(fh.Penalty([70.0, 18.0, 60.0, 18.0, 320.0], effort=10.0), pose=[np.pi])
law = fh.solve_hji(problem, gamma=1.5 * fh.smallest_gamma(problem), degree=4)
references = {
    "sine": fh.Sine(1.0, frequency=0.05, offset=np.pi),
    "move": fh.JerkLimited(
        np.pi, np.pi / 2, velocity=1.5, acceleration=4.0, jerk=20.0, at=2.0, smoothing=0.5
    ),
}

# %%
# The true arm has the motor's coil too, which the model leaves out.
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
errors = {}
for name, signal in references.items():
    reference = fh.Moving(signal, robot.inverse_dynamics)  # the state and the voltage of the wanted motion
    begin = reference.state(0.0)
    ukf = fh.UnscentedKalmanFilter(robot.plant(), period, 1e-6, 1e-6, mean=begin, covariance=1e-6)
    loop = fh.Loop(robot.plant(inductance=True), fh.Controller(law, ukf, period, moving=True))
    run = loop.run(reference, noise=1e-4, duration=12.0, initial_state=begin)
    error = np.degrees(run.data.link_position.values - signal(run.time))
    errors[name] = float(np.abs(error[run.time > 2.0]).max())
    above.plot(run.time, np.degrees(run.data.link_position), label=name)
    below.plot(run.time, error)
    print(f"{name}: largest error {errors[name]:.3f}° after two seconds")
above.set(ylabel="link position (°)")
below.set(ylabel="error (°)", xlabel="time (s)")
above.legend()
for axes in (above, below):
    axes.grid(alpha=0.3)
