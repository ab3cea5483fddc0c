"""
What γ does: from the quadratic regulator to the smallest γ
===========================================================

γ bounds the gain from disturbances to the penalty. A large γ is the quadratic regulator; near the smallest one, γ*, the
law gives way less and pays with a larger input.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# The paper's arm, hit by a torque on its link. The true state is fed back.
arm = fh.paper_arm()
problem = arm.plant().with_objective(
    fh.Penalty([70.0, 18.0, 60.0, 18.0, 320.0], effort=10.0),
    command=None, integrate=("link_position",), disturbances=("link_torque",),
)  # fmt: skip
star = fh.smallest_gamma(problem)

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
peaks = {}
for ratio in (1.02, 1.2, 2.0, np.inf):
    law = fh.linear_law(problem, gamma=ratio * star)
    loop = fh.Loop(arm.plant(), fh.Controller(law, None, 1e-3))
    run = loop.run(0.0, {"link_torque": fh.Step(2.0, at=0.2)}, duration=3.0)
    name = "γ = ∞ (LQR)" if np.isinf(ratio) else f"γ = {ratio:g} γ*"
    peaks[ratio] = (
        float(np.degrees(np.abs(run.data.link_position.values).max())),
        run.metrics()["peak_input"],
    )
    above.plot(run.time, np.degrees(run.data.link_position), label=name)
    below.plot(run.time, run.data.motor_voltage)
above.set(ylabel="link position (°)")
below.set(ylabel="motor voltage (V)", xlabel="time (s)")
above.legend()
for axes in (above, below):
    axes.grid(alpha=0.3)
for ratio, (angle, volts) in peaks.items():
    print(f"{ratio:4g} γ*: at most {angle:.2f}° away, {volts:.1f} V")
