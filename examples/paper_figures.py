"""
The paper's arm: steps to 90° and 180°, and a sine
==================================================

Three experiments of Elsa and Akbari, Nonlinear H∞ control for uncertain flexible joint robots with unscented Kalman
filter (2014): the arm hangs at rest, only its link position is measured, and the law has a V of degree 4. All twelve
figures and the claims of the paper are judged by ``flexhinf paper``.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# The arm of Tables 1 and 2, the penalty of Eq. (11), and γ twice the smallest.
arm = fh.paper_arm()
problem = arm.problem()
gamma = 2.0 * fh.smallest_gamma(problem)
laws = {"nonlinear": fh.solve_hji(problem, gamma, 4), "linear": fh.solve_hji(problem, gamma, 2)}
references = {
    "step to 90°": fh.Step(np.pi / 2), "step to 180°": fh.Step(np.pi),
    "sine about 180°": fh.Sine(1.0, frequency=0.05, offset=np.pi),
}  # fmt: skip

# %%
figure, panels = plt.subplots(2, 3, figsize=(7.0, 4.4), sharex="col", sharey="row", layout="constrained")
metrics = {}
for (title, reference), (above, below) in zip(references.items(), panels.T):
    for name, law in laws.items():
        ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-4)
        loop = fh.Loop(arm.plant(), fh.Controller(law, ukf, 1e-3, latency=0))
        run = loop.run(reference, noise=1e-3, duration=20.0 if "sine" in title else 6.0)
        metrics[title, name] = run.metrics()
        above.plot(run.time, np.degrees(run.data.link_position), label=name)
        below.plot(run.time, run.data.motor_voltage, linewidth=0.8)
    above.plot(run.time, np.degrees(run.data.link_position_commanded), "k:", label="command")
    above.set_title(title, fontsize=9)
    below.set(xlabel="time (s)")
panels[0, 0].set(ylabel="link position (°)")
panels[1, 0].set(ylabel="motor voltage (V)")
panels[0, 0].legend(fontsize=8)
for axes in panels.ravel():
    axes.grid(alpha=0.3)
for name in laws:
    print(f"{name}: overshoot {metrics['step to 180°', name]['overshoot_percent']:.0f} % in the step to 180°")
