"""Not a robot, and proved: the gain of a law for a stirred-tank reactor, with Arrhenius' exponential as it is.

The tank of ``stirred_tank.py`` (Seborg, Edgar, Mellichamp & Doyle, "Process Dynamics and Control"), time in minutes.
Arrhenius' law exp(−E/(R T)) divides by the temperature, and a certificate takes functions of linear forms only. So the
second state is 1 − T₀/T instead of T: then the rate is exp(25 · state) relative to that at T₀ = 350 K (E/R = 8750 K),
and all the rest is polynomial. Nothing is expanded.
"""

from __future__ import annotations

import numpy as np

import flexhinf as fh

OPERATING = 350.0  # T₀, K: an unstable equilibrium
ACTIVATION = 25.0  # E/(R T₀)
PARAMETERS = {
    "dilution": 1.0,  # feed rate over volume, 1/min; the rate of reaction at T₀ is as large
    "heat": 5.0e4 / 239.0 / OPERATING,  # heat of reaction over heat capacity and T₀, l/mol
    "cooling": 5.0e4 / (100.0 * 239.0),  # heat transfer over heat capacity, 1/min
}


def flow(x, u, d, p):
    """Rates of concentration − 0.5 mol/l and of 1 − T₀/T; u, d: coolant and feed temperatures over T₀."""
    concentration, hotter = x
    reaction = (0.5 + concentration) * np.exp(ACTIVATION * hotter) - 0.5
    warming = p.heat * reaction + p.dilution * d[0] + p.cooling * u[0]
    return np.array(
        [
            -p.dilution * concentration - reaction,
            (1.0 - hotter) * ((1.0 - hotter) * warming - (p.dilution + p.cooling) * hotter),
        ]
    )


def reactor() -> fh.Plant:
    """The tank in deviations from its unstable equilibrium."""
    return fh.Plant(
        flow,
        lambda x, u, p: x[1:],
        states=("concentration", "temperature"),
        inputs=("coolant",),
        disturbances=("feed",),
        outputs=("temperature",),
        parameters=PARAMETERS,
        units={"concentration": "mol/l"},
    )


def main() -> dict[str, float]:
    """Design, prove, and let the checker prove it again; returns the figures of the certificate."""
    problem = reactor().with_objective(fh.Penalty({"concentration": 0.05, "temperature": 1.0}, effort=0.1))
    gamma_star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * gamma_star, degree=4)
    certificate = solution.certify(gamma=2.0 * gamma_star)
    found = certificate.check()

    hotter = np.linspace(0.0, 0.2, 2001)
    inside = solution.value(np.column_stack([np.zeros_like(hotter), hotter])) <= certificate.level
    largest = OPERATING / (1.0 - hotter[int(np.argmin(inside)) - 1]) - OPERATING
    print(
        f"gamma = {certificate.gamma:.3f}, level of V {certificate.level:.3g}: proved again: {found.proved}"
    )
    print(f"a start up to {largest:.1f} K too hot, at the right concentration, lies in the proved region")
    return {"proved": float(found.proved), "gamma": certificate.gamma, "hotter_K": float(largest)}


if __name__ == "__main__":
    main()
