"""
A plant of one's own: a cart with a pendulum
============================================

Nothing in flexhinf is about robots alone. A plant is two functions of NumPy code. Equilibrium, expansion, derivatives
and machine code follow from them. Position and angle are measured; an unscented filter finds the rates.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh


# %%
# A cart of 1 kg with a pendulum of 0.2 kg and 0.5 m; the angle is zero upright. A wind pushes the pendulum.
def flow(x, u, d, p):
    """Rates of position, angle, and of their rates; u: force on the cart, N; d: push at the pendulum's end, N."""
    _, angle, speed, turn = x
    sine, cosine = np.sin(angle), np.cos(angle)
    whole, pull = p.cart + p.bob, p.bob * p.length * turn * turn * sine
    mass = np.array([[whole, p.bob * p.length * cosine], [p.bob * p.length * cosine, p.bob * p.length**2]])
    force = np.array([u[0] + pull + d[0], p.bob * p.gravity * p.length * sine + p.length * cosine * d[0]])
    determinant = mass[0, 0] * mass[1, 1] - mass[0, 1] * mass[1, 0]
    first = (mass[1, 1] * force[0] - mass[0, 1] * force[1]) / determinant
    second = (mass[0, 0] * force[1] - mass[1, 0] * force[0]) / determinant
    return np.array([speed, turn, first, second])


plant = fh.Plant(
    flow,
    lambda x, u, p: x[:2],
    states=("position", "angle", "speed", "turn"), inputs=("force",), disturbances=("wind",),
    outputs=("position", "angle"),
    parameters={"cart": 1.0, "bob": 0.2, "length": 0.5, "gravity": 9.81},
    units={"position": "m", "angle": "rad", "speed": "m/s", "turn": "rad/s", "force": "N", "wind": "N"},
)  # fmt: skip

# %%
# A cubic law at twice the smallest γ, and a gust of 0.5 N for half a second.
weights = {"position": 4.0, "angle": 2.0, "position_integral": 2.0}
problem = plant.with_objective(
    fh.Penalty(weights, effort=0.3), command="disturbance", integrate=("position",)
)
law = fh.solve_hji(problem, gamma=2.0 * fh.smallest_gamma(problem), degree=4)
ukf = fh.UnscentedKalmanFilter(plant, 5e-3, np.diag([0, 0, 1e-4, 1e-4]), 1e-6, np.zeros(4), 1e-4)
loop = fh.Loop(plant, fh.Controller(law, ukf, 5e-3))
gust = fh.Samples([0.0, 1.0, 1.005, 1.5, 1.505, 10.0], [0.0, 0.0, 0.5, 0.5, 0.0, 0.0])
run = loop.run(fh.Step(0.5, at=4.0), {"wind": gust}, noise=1e-3, duration=10.0, seed=1)

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
above.plot(run.time, run.data.position, label="cart")
above.plot(run.time, run.data.position_commanded, "k:", label="command")
below.plot(run.time, np.degrees(run.data.angle), "C1", label="pendulum")
below.plot(run.time, np.degrees(run.data.angle_estimated), "k", linewidth=0.8, label="pendulum, estimated")
above.set(ylabel="position (m)")
below.set(ylabel="angle (°)", xlabel="time (s)")
for axes in (above, below):
    axes.legend()
    axes.grid(alpha=0.3)
final = float(run.data.position[-1])
print(f"largest angle {np.degrees(np.abs(run.data.angle.values).max()):.1f}°; the cart ends at {final:.3f} m")
