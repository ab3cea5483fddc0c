"""H∞ laws of a design's problem: the polynomial law of any degree, linear H∞, and both with γ = ∞."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.design.laws.kinds import (
    DEGREE,
    DESIGN,
    H_INFINITY,
    INFINITE_GAMMA,
    NL_HINF,
    QUADRATIC,
    ROBUST,
    ROUNDING,
    LawKind,
    register,
)

if TYPE_CHECKING:
    from flexhinf.plant import GeneralisedPlant, Law


def _hji(problem: GeneralisedPlant, degree: float, gamma_ratio: float = INFINITE_GAMMA) -> Law:
    import math

    from flexhinf.hinf import smallest_gamma, solve_hji

    infinite = gamma_ratio >= INFINITE_GAMMA * (1.0 - ROUNDING)
    return solve_hji(problem, math.inf if infinite else gamma_ratio * smallest_gamma(problem), round(degree))


register(
    LawKind(
        DESIGN,
        "nonlinear H∞ as flexhinf design makes it, not tuned for the criterion",
        ROBUST,
        "flexhinf design",
        "whole model",
        _hji,
        (),
        degree=0,
        place=0,
    )
)
register(
    LawKind(
        NL_HINF,
        "nonlinear H∞: the design's problem",
        ROBUST,
        "van der Schaft 1992",
        "whole model",
        _hji,
        (*H_INFINITY, DEGREE),
        degree=0,
        place=1,
    )
)
register(
    LawKind(
        "hinf",
        "linear H∞: degree 2 of the same problem",
        ROBUST,
        "van der Schaft 1992",
        "linear at the goal",
        _hji,
        H_INFINITY,
        degree=2,
        place=2,
    )
)
register(
    LawKind(
        "nlqr",
        "nonlinear LQR: γ = ∞",
        ROBUST,
        "Al'brekht 1961",
        "whole model",
        _hji,
        (*QUADRATIC, DEGREE),
        degree=0,
        place=3,
    )
)
