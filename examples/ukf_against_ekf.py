"""
Unscented or extended Kalman filter? A tie, and a win
=====================================================

The true arm steps by 90° from a start that the filters do not know by 0.3 rad and 0.3 rad/s. With an encoder of the
link their errors are one line: the arm's only nonlinearity is a function of what is measured. With an inertial sensor
at the link's end the unscented filter errs less.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

PERIOD, RUNS, UNKNOWN = 0.01, 100, 0.3  # s; runs; standard deviation of the start, rad and rad/s
arm = fh.paper_arm()
plant, problem = arm.plant(), arm.problem()


# %%
# The inertial sensor measures specific force along and across the link, and the rate of turn.
def imu(x, u, p):
    """What the sensor at the end of the link measures."""
    torque = -p.mass * p.gravity * p.length * np.sin(x[0]) - p.stiffness * (x[0] - x[2])
    across = p.length * torque / p.link_inertia + p.gravity * np.sin(x[0])
    return np.array([across, p.length * x[1] ** 2 + p.gravity * np.cos(x[0]), x[1]])


signals = plant.states, plant.inputs, plant.disturbances, plant.parameters
with_imu = fh.Plant(plant.flow, imu, *signals, outputs=("across", "along", "rate"))
sensors = {"encoder of the link": (plant, [1e-3]), "IMU on the link": (with_imu, [0.1, 0.1, 0.01])}
filters = {"unscented": fh.UnscentedKalmanFilter, "extended": fh.ExtendedKalmanFilter}
law = fh.linear_law(problem, gamma=2 * fh.smallest_gamma(problem))
loop = fh.Loop(plant, fh.Controller(law, None, PERIOD))  # the true state is fed back

# %%
# Both filters see the same noisy samples of a hundred runs.
figure, panels = plt.subplots(2, 1, figsize=(7.0, 4.8), sharex=True, layout="constrained")
rms = {}
for axes, (sensor, (model, noise)) in zip(panels, sensors.items()):
    errors = {name: [] for name in filters}
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        run = loop.run(fh.Step(np.pi / 2), duration=2.0, initial_state=UNKNOWN * rng.normal(size=plant.n))
        states, inputs = run.signals["state"], run.signals["input"]
        seen = [model.evaluate_output(x, u, model.parameters.vector()) for x, u in zip(states, inputs)]
        measured = np.array(seen) + rng.normal(size=(len(seen), len(noise))) * noise
        for name, kind in filters.items():
            kalman = kind(model, PERIOD, 1e-8, np.square(noise), np.zeros(plant.n), UNKNOWN**2)
            estimate = fh.filter_log(kalman, (run.time, inputs, measured))["estimate"]
            errors[name].append(estimate.values[:, 0] - states[:, 0])
    for (name, error), style in zip(errors.items(), ("-", "--")):
        rms[sensor, name] = float(np.sqrt(np.mean(np.square(error))))
        axes.semilogy(run.time, 1e3 * np.sqrt(np.mean(np.square(error), axis=0)), style, label=name)
    axes.set(ylabel="RMS error (mrad)", ylim=(0.1, 1e3 * UNKNOWN))
    axes.set_title(sensor, fontsize=9)
    axes.grid(alpha=0.3)
panels[0].legend()
panels[1].set(xlabel="time (s)")
for (sensor, name), value in rms.items():
    print(f"{sensor}, {name}: {1e3 * value:.4g} mrad")
