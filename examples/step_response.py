"""
Linear or cubic law? A step of 180°
===================================

Which law is better depends on where it is designed. About the goal the linear law is; about the hanging rest, as in the
paper, the cubic law is. Only the link position is measured.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh


# %%
# From the hanging rest to the top, with a law about a pose from a V of some degree. The true arm has the motor's coil.
def step(pose, degree):
    """The run of a step of 180°."""
    robot = fh.paper_arm()
    problem = robot.problem(pose=pose)
    solution = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=degree)
    ukf = fh.UnscentedKalmanFilter(robot.plant(), 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-4)
    controller = fh.Controller(solution, ukf, period=1e-3, start="bumpless")  # the input does not jump
    rest, held = robot.operating_point(0.0, ("inductance",))
    loop = fh.Loop(robot.plant(inductance=True), controller)
    return loop.run(fh.Step(np.pi), noise=1e-3, duration=8.0, initial_state=rest, initial_input=held)


# %%
figure, panels = plt.subplots(2, 2, figsize=(7.0, 4.6), sharex=True, sharey="row", layout="constrained")
metrics = {}
for (above, below), (about, pose) in zip(panels.T, (("the goal", np.pi), ("the hanging rest", 0.0))):
    for law, degree in (("linear", 2), ("cubic", 4)):
        run, name = step(pose, degree), f"{law} about {about}"
        found = metrics[name] = run.metrics()
        above.plot(run.time, np.degrees(run.data.link_position), label=law)
        below.plot(run.time, run.data.motor_voltage)
        print(
            f"{name}: overshoot {found['overshoot_percent']:.1f} %, settling time {found['settling_time_s']:.2f} s"
        )
    above.axhline(180.0, color="0.4", linestyle=":")
    above.set_title(f"designed about {about}", fontsize=9)
    below.set(xlabel="time (s)")
panels[0, 0].set(ylabel="link position (°)")
panels[1, 0].set(ylabel="motor voltage (V)")
panels[0, 0].legend()
for axes in panels.ravel():
    axes.grid(alpha=0.3)
