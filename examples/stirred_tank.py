"""
Not a robot: a stirred-tank reactor held at an unstable temperature
===================================================================

In a cooled tank a reactant burns faster the hotter it is. The wanted operating point, 350 K, is unstable, and the feed
disturbs it. The model is the textbook one of Seborg, Edgar, Mellichamp and Doyle, "Process Dynamics and Control"; time
is in minutes. The temperature alone is measured.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

PARAMETERS = {
    "dilution": 1.0,  # feed rate over volume, 1/min
    "rate": 7.2e10,  # Arrhenius factor, 1/min
    "activation": 8750.0,  # E/R, K
    "heat": 5.0e4 / 239.0,  # heat of reaction over heat capacity, K·l/mol
    "cooling": 5.0e4 / (100.0 * 239.0),  # heat transfer over heat capacity, 1/min
    "feed_temperature": 350.0,  # K
    "feed_concentration": 1.0,  # mol/l
}


# %%
# The plant is two functions of NumPy code, with the exponential of Arrhenius' law as it is.
def flow(x, u, d, p):
    """Rates of concentration and temperature; u: coolant temperature; d: feed temperature and concentration."""
    concentration, temperature = x
    reaction = p.rate * np.exp(-p.activation / temperature) * concentration
    cooled = p.cooling * (u[0] - temperature)
    warmed = p.dilution * (p.feed_temperature + d[0] - temperature)
    fed = p.dilution * (p.feed_concentration + d[1] - concentration)
    return np.array([fed - reaction, warmed + p.heat * reaction + cooled])


plant = fh.Plant(
    flow,
    lambda x, u, p: x[1:],
    states=("concentration", "temperature"), inputs=("coolant_temperature",), outputs=("temperature",),
    disturbances=("feed_temperature_change", "feed_concentration_change"), parameters=PARAMETERS,
    units={"concentration": "mol/l", "temperature": "K", "coolant_temperature": "K"},
)  # fmt: skip

# %%
# flexhinf finds the equilibrium, expands the plant there exactly, and gives a cubic H∞ law.
penalty = fh.Penalty({"temperature": 1.0, "temperature_integral": 5.0}, effort=0.1)
problem = plant.with_objective(penalty, integrate=("temperature",), pose=(350.0,))
gamma_star = fh.smallest_gamma(problem)
solution = fh.solve_hji(problem, gamma=2 * gamma_star, degree=4)
rest = problem.operating_point[:2]
poles = np.linalg.eigvals(plant.linearise(rest, problem.operating_input)[0])
print(
    f"operating point: {rest[0]:.3f} mol/l, coolant {problem.operating_input[0]:.1f} K; γ* = {gamma_star:.3f}"
)
print(f"open-loop poles: {np.round(poles, 2)} per minute")

# %%
# After a minute the feed gets 10 K warmer.
ukf = fh.UnscentedKalmanFilter(plant, 0.01, [1e-6, 1e-2], 0.01, mean=rest, covariance=[1e-4, 1.0])
loop = fh.Loop(plant, fh.Controller(solution, ukf, 0.01, saturation=(250.0, 350.0)))
run = loop.run(350.0, {"feed_temperature_change": fh.Step(10.0, at=1.0)}, noise=0.1, duration=10.0)
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
above.plot(run.time, run.data.temperature_measured, "0.7", label="measured")
above.plot(run.time, run.data.temperature, label="true")
below.plot(run.time, run.data.coolant_temperature)
above.set(ylabel="temperature (K)")
below.set(ylabel="coolant (K)", xlabel="time (min)")
above.legend()
for axes in (above, below):
    axes.grid(alpha=0.3)
off = np.abs(run.data.temperature.values - 350.0)
print(f"at most {off.max():.2f} K off, {off[-100:].max():.2f} K in the last minute")
