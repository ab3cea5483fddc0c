"""The local L2 gain of a published plant: sums of squares with V free, V of Hamilton, Jacobi and Isaacs, and both.

    ẋ1 = −x1 + x1³ + d,   ẋ2 = −x2 + d,   z = x1 − x2,   γ = 0.5:

for which ‖d‖₂ ≤ R is ‖z‖₂ ≤ γ ‖d‖₂ shown? The plant is that of a demonstration in the toolbox nlanal of authors of
[summers2013], who say that they take it from [summers2010]; a comment there has R = 0.75 for V of degree six.
With V̇ ≤ ½γ²|d|² − ½|z|² on {V ≤ c}, R = √(2c)/γ. The linear gain is 0: what is bounded here is nonlinear.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.certificates.identities import Solver
from benchmarks.certificates.model import model_of, quotient_bounds, with_value
from benchmarks.certificates.sums import FreeStorage
from flexhinf.certify import Certificate, prove
from flexhinf.certify.problem_to_claim import statement_of
from flexhinf.errors import FlexhinfError

__all__ = ["GAMMA", "PUBLISHED", "claim_of", "ours", "plant", "rival"]

GAMMA, PUBLISHED = 0.5, 0.75
OUTPUT = np.array([[1.0, -1.0]])  # z = x1 − x2

#: What our V is made with: weights of x1 and x2 beside z (without them V_2 is not definite), share of γ, degree.
WEIGHTS, SHARES, DEGREES = (0.2, 0.25, 0.28, 0.3, 0.32, 0.35), (0.8, 0.9, 0.95), (2, 4, 6, 8)
_BELOW = (0.999, 0.99, 0.97, 0.9)  # shares of a level that are tried in turn


def plant(weight: float) -> fh.PolynomialPlant:
    """The plant, with an input that does nothing, and with weights of both states in z."""
    f = {(1, 0): (-1.0, 0.0), (0, 1): (0.0, -1.0), (3, 0): (1.0, 0.0)}
    h = {(1, 0): (1.0, weight, 0.0), (0, 1): (-1.0, 0.0, weight)}
    return fh.PolynomialPlant(f, np.ones((2, 1)), np.zeros((2, 1)), h, np.eye(1))


def radius(claim: Certificate) -> float:
    """R."""
    return float(np.sqrt(2.0 * claim.level) / claim.gamma)


def claim_of(weight: float, share: float, degree: int) -> tuple[Certificate, float] | None:
    """The claim at the sampled level of V, and R there; None where there is no such V."""
    try:
        solution = fh.solve_hji(plant(weight), gamma=share * GAMMA, degree=degree)
        sampled = solution.sampled_region(gamma=GAMMA, penalty=OUTPUT)
    except FlexhinfError:
        return None
    if sampled is None or not 0 < sampled.level < np.inf:
        return None
    claim = statement_of(solution, GAMMA, OUTPUT, level=sampled.level, about="a published plant")
    return claim, radius(claim)


def ours() -> dict[str, Any]:
    """V of Hamilton, Jacobi and Isaacs: all are sampled, the best is proved and checked."""
    start = time.process_time()
    every = [
        (found, design)
        for design in itertools.product(WEIGHTS, SHARES, DEGREES)
        if (found := claim_of(*design))
    ]
    (claim, _), design = max(every, key=lambda pair: pair[0][1])
    proof = _proved(claim)
    seconds = time.process_time() - start
    return {"method": "ours", "degree": design[2], "radius": radius(proof), "seconds": seconds,
            "exact": _checked(proof), "note": f"{len(every)} designs sampled"}  # fmt: skip


def _proved(claim: Certificate) -> Certificate:
    for share in _BELOW:
        found, outcome = prove(replace(claim, level=share * claim.level))
        if outcome.proved:
            return found
    raise SystemExit(f"no level of the published plant is proved: {outcome.reason}")


def _checked(claim: Certificate) -> str:
    found = claim.check(threads=1)
    return "" if found.proved else found.reason


def rival(solver: Solver, degree: int, turns: int) -> tuple[dict[str, Any], Certificate]:
    """V free, from that of degree two; its row, and the claim with its V at its level."""
    before = solver.seconds
    found = claim_of(0.3, 0.9, 2)
    assert found is not None
    claim = found[0]
    model = model_of(replace(claim, level=0.99 * claim.level))
    claim = replace(claim, level=0.99 * claim.level)
    storage = FreeStorage(solver, model, quotient_bounds(model, 1.0, 2)[0], float("inf"), degree, degree // 2)
    exact = storage.improve(turns)
    best = with_value(claim, model, storage.value, storage.level)
    row = {"method": "sums of squares, V free", "degree": degree, "radius": radius(best), "exact": exact,
           "seconds": solver.seconds - before, "note": f"{turns} turns"}  # fmt: skip
    return row, best


def rows(solver: Solver, turns: int = 24) -> list[dict[str, Any]]:
    """The rival's rows, ours, and the rival's V in our prover."""
    found = []
    for degree in (2, 4, 6):
        row, best = rival(solver, degree, turns)
        found.append(row)
    start = time.process_time()
    proof = _proved(best)
    seconds = time.process_time() - start
    found.append({"method": "V of the sums of squares, proved by ours", "degree": 6, "radius": radius(proof),
                  "seconds": seconds, "exact": _checked(proof), "note": "V was given"})  # fmt: skip
    said = {"method": "sums of squares, V free, as published", "degree": 6, "radius": PUBLISHED, "seconds": None,
            "exact": None, "note": "a comment in nlanal's demonstration"}  # fmt: skip
    return [*found, said, ours()]
