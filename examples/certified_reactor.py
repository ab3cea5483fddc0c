"""
Not a robot, and proved: a law for a stirred-tank reactor
=========================================================

The tank of the other example, with Arrhenius' exponential as it is. The certificate says on which level set of V the
gain from the feed's temperature to the penalty is at most γ: proved, not sampled.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

OPERATING = 350.0  # T₀, K: an unstable equilibrium
ACTIVATION = 25.0  # E/(R T₀)
PARAMETERS = {
    "dilution": 1.0,  # feed rate over volume, 1/min; the rate of reaction at T₀ is as large
    "heat": 5.0e4 / 239.0 / OPERATING,  # heat of reaction over heat capacity and T₀, l/mol
    "cooling": 5.0e4 / (100.0 * 239.0),  # heat transfer over heat capacity, 1/min
}


# %%
# Arrhenius' law exp(−E/(R T)) divides by the temperature, and a certificate takes functions of linear forms only. So
# the second state is 1 − T₀/T: then the rate is exp(25 · state) relative to that at T₀; all the rest is polynomial.
def flow(x, u, d, p):
    """Rates of concentration − 0.5 mol/l and of 1 − T₀/T; u, d: coolant and feed temperatures over T₀."""
    concentration, hotter = x
    reaction = (0.5 + concentration) * np.exp(ACTIVATION * hotter) - 0.5
    warming = p.heat * reaction + p.dilution * d[0] + p.cooling * u[0]
    rate = (1.0 - hotter) * ((1.0 - hotter) * warming - (p.dilution + p.cooling) * hotter)
    return np.array([-p.dilution * concentration - reaction, rate])


plant = fh.Plant(
    flow, lambda x, u, p: x[1:], states=("concentration", "temperature"), inputs=("coolant",),
    disturbances=("feed",), outputs=("temperature",), parameters=PARAMETERS,
)  # fmt: skip

# %%
# Design at 1.5 γ*, prove at 2 γ*, and let the checker, which shares no code with the prover, prove it again.
problem = plant.with_objective(fh.Penalty({"concentration": 0.05, "temperature": 1.0}, effort=0.1))
gamma_star = fh.smallest_gamma(problem)
solution = fh.solve_hji(problem, gamma=1.5 * gamma_star, degree=4)
certificate = solution.certify(gamma=2.0 * gamma_star)
found = certificate.check()
print(f"gamma = {certificate.gamma:.3f}, level of V {certificate.level:.3g}: proved again: {found.proved}")

# %%
# The region in mol/l and K. Starts at the right concentration may be hotter by what the dotted line shows.
concentration, hotter = np.meshgrid(np.linspace(-0.6, 0.6, 241), np.linspace(-0.12, 0.12, 241))
value = solution.value(np.column_stack([concentration.ravel(), hotter.ravel()])).reshape(hotter.shape)
kelvin = OPERATING / (1.0 - hotter) - OPERATING
middle = (value[:, 120] <= certificate.level) & (hotter[:, 120] > 0.0)
largest = float(kelvin[middle, 120].max())
figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
axes.contourf(concentration, kelvin, value, [0.0, certificate.level], colors=["C0"], alpha=0.25)
axes.contour(concentration, kelvin, value, [certificate.level], colors="C0")
axes.plot([], [], "C0", label="proved region")
axes.plot([0.0, 0.0], [0.0, largest], "k:", label=f"up to {largest:.1f} K too hot")
axes.set(xlabel="concentration − 0.5 mol/l (mol/l)", ylabel="temperature − 350 K (K)")
axes.legend()
axes.grid(alpha=0.3)
