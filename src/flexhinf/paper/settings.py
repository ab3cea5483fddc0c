"""What the paper leaves open or misprints, and what was taken instead; the report states all of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from flexhinf.errors import InvalidInput
from flexhinf.report import Table

ESTIMATORS = ("ukf", "ekf", "none")
PERIODS = "1e-4 to 0.05 s (the joint vibrates at 14 rad/s)"


@dataclass(frozen=True)
class PaperSettings:
    """Options of ``flexhinf paper``.

    Parameters
    ----------
    gamma_ratio : float
        γ/γ*; more than 1.
    degree : int
        Degree of V, at least 2; the law has one less. 4 is the paper's cubic law.
    period : float
        Sampling period of estimator and controller, s.
    seed : int
        Of measurement noise and of the sampled plants.
    estimator : {"ukf", "ekf", "none"}
        "none" feeds back the true state.
    process_noise : float
        Variance q of R^v = q I, added to each state at each sample.
    measurement_noise : float
        Variance R^n of the measured link position, rad². The simulated noise has the same variance.

    Raises
    ------
    InvalidInput
        For a value outside its range.
    """

    gamma_ratio: float = 2.0
    degree: int = 4
    period: float = 1e-3
    seed: int = 0
    estimator: str = "ukf"
    process_noise: float = 1e-6
    measurement_noise: float = 1e-6

    def __post_init__(self) -> None:
        _require(
            "γ/γ*",
            self.gamma_ratio,
            0.0 < self.gamma_ratio <= 1e6,
            "a number above 1, up to 1e6",
            "--gamma-ratio 2",
        )
        whole = isinstance(self.degree, int) and not isinstance(self.degree, bool)
        _require(
            "degree of V",
            self.degree,
            whole and 2 <= self.degree <= 12,
            "an integer from 2 to 12",
            "--degree 4",
        )
        _require("sampling period", self.period, 1e-4 <= self.period <= 0.05, PERIODS, "--period 1e-3")
        known = isinstance(self.seed, int) and not isinstance(self.seed, bool)
        _require("seed", self.seed, known and 0 <= self.seed < 2**53, "an integer from 0", "--seed 0")
        _require(
            "estimator",
            self.estimator,
            self.estimator in ESTIMATORS,
            ", ".join(ESTIMATORS),
            "--estimator ukf",
        )
        _require(
            "process noise",
            self.process_noise,
            self.process_noise >= 0.0,
            "a variance >= 0",
            "--process-noise 1e-6",
        )
        _require(
            "measurement noise", self.measurement_noise, self.measurement_noise > 0.0,
            "a variance > 0, rad²", "--measurement-noise 1e-6",
        )  # fmt: skip


def _require(what: str, value: Any, holds: bool, expected: str, advice: str) -> None:
    finite = not isinstance(value, float) or math.isfinite(value)
    if not (holds and finite):
        raise InvalidInput(f"The {what} cannot be used.", f"expected {expected}, got {value!r}", advice)


MISPRINTS = (
    ("Algorithm 1, step 5", "second block X̂ + γ√P again", "X̂ − γ√P"),
    (
        "Algorithm 1 and Eq. (10)",
        "γ is the sigma-point spread",
        "called spread here; γ is the attenuation level",
    ),
    ("Sec. 5, ẋ4", "+B x4 and −K(x1 − x3)", "−B x4 and +K(x1 − x3), as in Eq. (2) and Sec. 6"),
    ("Eq. (7)", "[pᵀg1 − pᵀg2], [d − u], assumption (6)", "[pᵀg1, pᵀg2], [dᵀ, uᵀ], assumption (4)"),
    ("Sec. 5, h", "Q x5 only", "with 60 x1, as in Eq. (11)"),
    ("Sec. 4", "1e-4 < α < 1", "α = 1 (Table 3) is allowed"),
    ("Sec. 6, g1 and g2", "six rows", "g1 = (0, 0, 0, 0, −1)ᵀ and g2 = (0, 0, 0, 0.9, 0)ᵀ"),
    ("Eq. (8)", "g2 R2⁻¹ g2", "g2 R2⁻¹ g2ᵀ"),
    ("Eq. (10) with Table 3", "five sigma points", "2n + 1 = 9 for n = 4; λ = 0, W0ᵐ = 0, W0ᶜ = 2, Wᵢ = 1/8"),
    ("Sec. 2", "gravity inside C, and G", "gravity once"),
    ("Sec. 3", "asymptotically stable at u = 0", "with u = k(x): x5 is an integrator"),
    (
        "Figs. 7, 9, 10, 12",
        "captions lost in the scan",
        "tracking; tolerances measured, estimated; sinusoidal disturbance",
    ),
)

OPEN = (
    ("γ", "a multiple of the smallest feasible γ* (option --gamma-ratio)"),
    ("sampling", "estimator and law at one period, the input held between samples (option --period)"),
    ("F of Eq. (9)", "the nominal plant over one period by the classical Runge–Kutta method"),
    ("Rᵛ, Rⁿ, P0, X̂0", "q I and R^n (options), 1e-4 I, and rest; the tolerance claim is swept over q"),
    ("x5", "the integral of the measured error, trapezoidal, the command held"),
    ("true plant", "nominal without coil in Figs. 3–8, 11, 12; perturbed with coil in Figs. 9 and 10"),
    ("disturbances", "a torque at the link or at the motor; size and frequency are in the captions"),
    ("saturation", "none, as in the paper"),
    ("“bounded” UKF", "undefined; judged as: the estimation error stays bounded. bounds= on states is ours"),
    ("60 x1", "penalises the angle from hanging, not the error, as printed"),
)


def misprint_table() -> Table:
    """Misprints of the text."""
    return Table(
        ("where", "printed", "taken"), MISPRINTS, "Misprints of the paper.", "table-misprints", stacks=True
    )


def open_table() -> Table:
    """What is not given."""
    return Table(("not given", "chosen"), OPEN, "What the paper does not give.", "table-open", stacks=True)
