"""
Two hundred robots within their tolerances: a campaign's band
=============================================================

No arm is its data sheet. The file of the paper's arm states tolerances; a campaign draws robots from them, runs the
same controller on each, and keeps the metrics of all runs.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# A linear H∞ law about the goal of 45°, with an unscented filter that knows the nominal arm.
arm, goal = fh.paper_arm(), np.pi / 4
problem = arm.problem([70.0, 18.0, 60.0, 18.0, 320.0], pose=goal)
law = fh.linear_law(problem, gamma=1.5 * fh.smallest_gamma(problem))
ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-6)
loop = fh.Loop(arm.plant(), fh.Controller(law, ukf, 1e-3, start="bumpless"))
data = fh.run_campaign(loop, arm.draw, 200, reference=fh.Step(goal), noise=1e-3, duration=4.0, seed=3)

# %%
# The traces of the robots as bands of quantiles, and the overshoot of each robot over the mass of its link.
traces = np.degrees(data["trace.link_position"].values)
figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 3.6), layout="constrained")
time = data["time"].values
for low, high, shade in ((0.0, 1.0, 0.15), (0.05, 0.95, 0.3)):
    band = np.quantile(traces, (low, high), axis=0)
    left.fill_between(
        time, *band, color="C0", alpha=shade, linewidth=0, label=f"{100 * (high - low):.0f} % of robots"
    )
left.plot(time, np.median(traces, axis=0), "C0", label="median")
left.axhline(np.degrees(goal), color="0.4", linestyle=":", label="command")
left.set(xlabel="time (s)", ylabel="link position (°)")
left.legend(loc="lower right")
right.plot(data["mass"], data["overshoot_percent"], ".", markersize=4)
right.set(xlabel="mass of the link (kg)", ylabel="overshoot (%)")
for axes in (left, right):
    axes.grid(alpha=0.3)
overshoot, settling = data["overshoot_percent"].values, data["settling_time_s"].values
print(f"overshoot: median {np.median(overshoot):.1f} %, worst {overshoot.max():.1f} %")
print(f"settling time: median {np.median(settling):.2f} s, worst {settling.max():.2f} s")
