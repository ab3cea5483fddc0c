"""Not a robot: a stirred-tank reactor held at an unstable temperature.

A cooled tank in which a reactant burns faster the hotter it is: ẋ has an exponential, the wanted operating
point (350 K) is unstable, and the feed's temperature and concentration disturb it. The model is the
textbook one of Seborg, Edgar, Mellichamp & Doyle, "Process Dynamics and Control". Time is in minutes.

The plant is two functions of NumPy code. flexhinf finds the equilibrium, expands the plant there exactly,
and gives a cubic H∞ law; the temperature alone is measured.
"""

from __future__ import annotations

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


def flow(x, u, d, p):
    """Rates of concentration and temperature; u: coolant temperature; d: feed temperature and concentration."""
    concentration, temperature = x
    reaction = p.rate * np.exp(-p.activation / temperature) * concentration
    feed_concentration, feed_temperature = p.feed_concentration + d[1], p.feed_temperature + d[0]
    return np.array(
        [
            p.dilution * (feed_concentration - concentration) - reaction,
            p.dilution * (feed_temperature - temperature)
            + p.heat * reaction
            + p.cooling * (u[0] - temperature),
        ]
    )


def reactor() -> fh.Plant:
    """The tank, its temperature measured."""
    return fh.Plant(
        flow,
        lambda x, u, p: x[1:],
        states=("concentration", "temperature"),
        inputs=("coolant_temperature",),
        disturbances=("feed_temperature_change", "feed_concentration_change"),
        outputs=("temperature",),
        parameters=PARAMETERS,
        units={"concentration": "mol/l", "temperature": "K", "coolant_temperature": "K"},
    )


def main() -> dict[str, float]:
    """Design, then let the feed get 10 K warmer; returns the figures of merit."""
    plant = reactor()
    problem = plant.with_objective(
        fh.Penalty({"temperature": 1.0, "temperature_integral": 5.0}, effort=0.1),
        integrate=("temperature",),
        pose=(350.0,),
    )
    gamma_star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=2 * gamma_star, degree=4)
    poles = np.linalg.eigvals(plant.linearise(problem.operating_point[:2], problem.operating_input)[0])
    print(
        f"operating point: {problem.operating_point[0]:.3f} mol/l, coolant {problem.operating_input[0]:.1f} K"
    )
    print(f"open-loop poles: {np.round(poles, 2)} per minute; γ* = {gamma_star:.3f}")

    period = 0.01
    rest = problem.operating_point[:2]
    ukf = fh.UnscentedKalmanFilter(plant, period, [1e-6, 1e-2], 0.01, mean=rest, covariance=[1e-4, 1.0])
    loop = fh.Loop(plant, fh.Controller(solution, ukf, period, saturation=(250.0, 350.0)))
    warmer = {"feed_temperature_change": fh.Step(10.0, at=1.0)}
    run = loop.run(350.0, warmer, noise=0.1, duration=10.0)
    temperature = run.signal("state", "temperature")
    figures = {
        "largest_deviation_K": float(np.abs(temperature - 350.0).max()),
        "final_deviation_K": float(np.abs(temperature[-100:] - 350.0).max()),
    }
    print(f"feed 10 K warmer at 1 min: at most {figures['largest_deviation_K']:.2f} K off, "
          f"{figures['final_deviation_K']:.2f} K in the last minute")  # fmt: skip
    return figures


if __name__ == "__main__":
    main()
