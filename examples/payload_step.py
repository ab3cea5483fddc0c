"""
A payload that the controller does not know
===========================================

An arm that carries more than its model believes sags, and the integral of the link's error takes the sag back. The law
and the filter stay those of the empty arm.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# The paper's arm lifts its link to 60°. Half as much mass again is added at the same centre of gravity.
arm, goal = fh.paper_arm(), np.radians(60.0)
problem = arm.problem([70.0, 18.0, 60.0, 18.0, 320.0], pose=goal)
law = fh.linear_law(problem, gamma=1.5 * fh.smallest_gamma(problem))
ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-6)
controller = fh.Controller(law, ukf, 1e-3, start="bumpless")

# %%
# ``with_values`` has another number in the robot; the inertia of the link grows with its mass.
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
metrics = {}
for share in (1.0, 1.25, 1.5):
    values = {name: share * arm.nominal[name] for name in ("mass", "link_inertia")}
    loop = fh.Loop(arm.with_values(values).plant(), controller)
    run = loop.run(fh.Quintic(0.0, goal, 1.0), noise=1e-4, duration=8.0)
    metrics[share] = run.metrics()
    above.plot(run.time, np.degrees(run.data.link_position), label=f"{100 * (share - 1):.0f} % more mass")
    below.plot(run.time, run.data.motor_voltage)
above.plot(run.time, np.degrees(run.data.link_position_commanded), "k:", label="command")
above.set(ylabel="link position (°)")
below.set(ylabel="motor voltage (V)", xlabel="time (s)")
above.legend()
for axes in (above, below):
    axes.grid(alpha=0.3)
for share, found in metrics.items():
    error = np.degrees(found["steady_state_error"])
    print(
        f"{100 * (share - 1):3.0f} % more: overshoot {found['overshoot_percent']:4.1f} %, remains {error:.2f}°"
    )
