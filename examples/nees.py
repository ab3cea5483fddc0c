"""
Does a filter believe too much? NEES over many runs
===================================================

The normalised squared error of an estimate (NEES) has the mean n, the number of states, if the filter's covariance is
right. One unscented filter below knows the noise of its sensor; the other one believes in a tenth of it.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import chi2

import flexhinf as fh

# %%
# A pendulum that random torques drive, as a map from one sample to the next; its angle is measured with noise.
period, noise, runs, samples = 0.02, 0.05, 50, 300
plant = fh.Plant(
    lambda x, u, d, p: np.array([x[0] + period * x[1], x[1] - period * (p.stiffness * np.sin(x[0]) + 0.3 * x[1])]),
    lambda x, u, p: x[:1],
    states=("angle", "rate"), inputs=(), outputs=("angle",), parameters={"stiffness": 9.81}, sampled=True,
)  # fmt: skip
start, process = np.diag([0.2, 1.0]) ** 2, np.diag([1e-4, 0.1]) ** 2
rng, truth = np.random.default_rng(1), np.zeros((runs, samples, 2))
x = rng.multivariate_normal(np.zeros(2), start, runs)
for k in range(samples):
    truth[:, k] = x
    step = [x[:, 1], -9.81 * np.sin(x[:, 0]) - 0.3 * x[:, 1]]
    x = x + period * np.transpose(step) + rng.multivariate_normal(np.zeros(2), process, runs)
measured = truth[:, :, :1] + noise * rng.normal(size=(runs, samples, 1))

# %%
# ``filter_log`` gives the NEES of each sample where the log has the true state. In the band are 95 % of the means over
# fifty runs of a filter that is right.
time, means = period * np.arange(samples), {}
figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
for name, believed in (("believes the right noise", noise), ("believes a tenth of it", noise / 10.0)):
    ukf = fh.UnscentedKalmanFilter(plant, period, process, believed**2, np.zeros(2), start)
    logs = [fh.Log(time, None, y, x) for y, x in zip(measured, truth)]
    nees = np.mean([fh.filter_log(ukf, log)["nees"].values for log in logs], axis=0)
    means[name] = float(nees.mean())
    axes.semilogy(time, nees, label=f"{name}: {means[name]:.2f} on average")
axes.axhspan(*chi2.ppf([0.025, 0.975], 2 * runs) / runs, color="0.8", label="95 % of consistent filters")
axes.set(xlabel="time (s)", ylabel="mean NEES of 50 runs")
axes.legend()
axes.grid(alpha=0.3)
