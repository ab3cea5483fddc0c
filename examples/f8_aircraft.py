"""
F-8 aircraft: back from a high angle of attack
==============================================

The longitudinal motion of the F-8 Crusader, after Garrard and Jordan, Automatica 13 (1977) 497–505, is a textbook test
of nonlinear control. The wing stalls, so a large angle of attack pitches the aircraft up further. The cubic law brings
it back from further away than the linear law.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import flexhinf as fh

# %%
# States: angle of attack, pitch angle (rad), pitch rate (rad/s). Input: deflection of the tail, rad. Terms in its
# square and cube are left out of the design; the simulation has them.
f = {
    (1, 0, 0): (-0.877, 0.0, -4.208), (0, 0, 1): (1.0, 1.0, -0.396), (1, 0, 1): (-0.088, 0.0, 0.0),
    (2, 0, 0): (0.47, 0.0, -0.47), (0, 2, 0): (-0.019, 0.0, 0.0), (2, 0, 1): (-1.0, 0.0, 0.0),
    (3, 0, 0): (3.846, 0.0, -3.564),
}  # fmt: skip
g2 = {(0, 0, 0): [[-0.215], [0.0], [-20.967]], (2, 0, 0): [[0.28], [0.0], [6.265]]}
h = {(1, 0, 0): (0.5, 0.0, 0.0), (0, 1, 0): (0.0, 0.5, 0.0), (0, 0, 1): (0.0, 0.0, 0.5)}
plant = fh.PolynomialPlant(f, g1=[[0.0], [0.0], [1.0]], g2=g2, h=h, r2=1.0)
gamma = 3.0 * fh.smallest_gamma(plant)
laws = {"linear": fh.solve_hji(plant, gamma, 2), "cubic": fh.solve_hji(plant, gamma, 4)}


def rates(t, x, law):
    """The whole model: polynomial terms as above, and those in u² and u³."""
    (u,) = law.law(x)
    monomials = {power: np.prod(x ** np.array(power)) for power in f}
    rate = sum(monomials[power] * np.array(f[power]) for power in f)
    rate += (np.array(g2[0, 0, 0]) + x[0] ** 2 * np.array(g2[2, 0, 0]))[:, 0] * u
    return rate + np.array([0.47 * x[0] * u**2 + 0.63 * u**3, 0.0, 46.0 * x[0] * u**2 + 61.4 * u**3])


def stalled(t, x, law):
    """Zero where the angle of attack reaches 1 rad: beyond, the model means nothing."""
    return abs(x[0]) - 1.0


stalled.terminal = True

# %%
starts, recovered = (22.0, 26.0, 30.0), {}
figure, panels = plt.subplots(2, 1, figsize=(7.0, 4.8), sharex=True, layout="constrained")
for colour, (name, law) in zip(("C1", "C0"), laws.items(), strict=True):
    for style, start in zip((":", "--", "-"), starts, strict=True):
        x0 = [np.radians(start), 0.0, 0.0]
        run = solve_ivp(rates, (0.0, 10.0), x0, args=(law,), events=stalled, max_step=0.05)
        recovered[name, start] = bool(run.t[-1] == 10.0 and abs(run.y[0, -1]) < 0.01)
        panels[0].plot(run.t, np.degrees(run.y[0]), colour, linestyle=style, label=f"{name}, from {start:g}°")
        panels[1].plot(run.t, np.degrees(law.law(run.y.T)), colour, linestyle=style)
panels[0].set(ylabel="angle of attack (°)", ylim=(-10, 60))
panels[1].set(ylabel="tail (°)", xlabel="time (s)")
panels[0].legend(ncols=2)
for axes in panels:
    axes.grid(alpha=0.3)
for (name, start), back in recovered.items():
    print(f"{name} law from {start:g}°: {'recovers' if back else 'is lost'}")
