"""The paper's arm about 180°: what is proved for its linear and its cubic law, by whom, how far and at what cost.

The same claims for all: gain of (75, 27, 90, 27, 330)'s law at 1.5 γ*, checked for the paper's penalty at 1.6 γ*; and
the linear laws of docs/certificate_study.md, for all tolerances of Tables 1 and 2.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from flint import fmpq_mpoly

import flexhinf as fh
from benchmarks.certificates.identities import Solver
from benchmarks.certificates.model import (
    Model,
    evaluated,
    even,
    model_of,
    quotient_bounds,
    with_value,
)
from benchmarks.certificates.slopes import global_gain
from benchmarks.certificates.sums import FreeStorage, proved_inside
from flexhinf.certify import Certificate, prove
from flexhinf.certify.box import common_value, parameter_ranges, tolerance_statement
from flexhinf.certify.problem_to_claim import statement_of, terms_of
from flexhinf.certify.proof import certify_tolerances
from flexhinf.designs.problem.presets import choose
from flexhinf.designs.specification import Specification
from flexhinf.hinf.sampled import equilibrium_state, step_amplitude, step_roles

__all__ = ["COMMON", "claim_at", "given_storage", "ours", "solution_of"]

WEIGHTS, PENALTY = (75.0, 27.0, 90.0, 27.0, 330.0), (60.0, 0.0, 0.0, 0.0, 300.0)
SHARES = (0.999, 0.99, 0.97, 0.95, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5)  # of the sampled level, tried in turn

#: Degree of the polynomials about S, by degree of V.
QUOTIENT = {2: 6, 4: 4}

_FINE, _NEAR = 0.005, 0.02  # of a path of starts: steps in rad, and of the integrator in rad s

#: Which V ours has: that of the law's own design, or the one that (17) finds for a γ that is larger by a factor.
OWN, COMMON, ROOM_OF_GAIN = "V of the law", "V of (17)", 1.02

#: Radius of the ball in which V is free over that of the level set.
ROOM = 1.15


@cache
def solution_of(degree: int, goal: int = 180) -> tuple[fh.HJISolution, float]:
    """V and law of the degree, and γ."""
    problem = fh.paper_arm().problem(fh.Penalty(WEIGHTS, effort=10.0), pose=(np.radians(goal),))
    star = fh.smallest_gamma(problem)
    return fh.solve_hji(problem, gamma=1.5 * star, degree=degree), 1.6 * star


@cache
def sampled_level(degree: int, goal: int = 180) -> float:
    """What nobody can exceed with this V."""
    solution, gamma = solution_of(degree, goal)
    found = solution.sampled_region(gamma=gamma, penalty=PENALTY)
    assert found is not None
    return found.level


def claim_at(degree: int, share: float, goal: int = 180) -> Certificate:
    """The claim at a share of the sampled level."""
    solution, gamma = solution_of(degree, goal)
    return even(statement_of(solution, gamma, PENALTY, level=share * sampled_level(degree, goal)))


def reach_of(model: Model, room: float) -> float:
    """A radius |z| within which V passes one along rays, times some room; 1 for a V of degree two."""
    if model.value.total_degree() == 2:
        return 1.0001
    rays = np.random.default_rng(0).standard_normal((2000, len(model.z)))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    parts: dict[int, fmpq_mpoly] = {}
    for key, number in terms_of(model.value).items():
        term = model.value.context().from_dict({key: number})
        parts[sum(key)] = parts.get(sum(key), model.number(0)) + term
    along = {degree: evaluated(model, part)(rays) for degree, part in parts.items()}
    grid = np.linspace(0.0, 2.0, 201)[1:]
    values = np.stack([sum(part * r**degree for degree, part in along.items()) for r in grid])
    inside = (values <= 1.0).cumprod(axis=0).sum(axis=0)
    return float(room * grid[inside.max() - 1])


# Rivals -----------------------------------------------------------------------------------------------------
def linear_inequalities(solver: Solver, goal: int = 180) -> dict[str, Any]:
    """The linear law for every start."""
    before, claim = solver.seconds, claim_at(2, 1.0, goal)
    found = global_gain(solver, claim)
    return {"method": "matrix inequalities, V free", "law": "linear", "goal": goal, "degree": 2, "gamma": found.gamma,
            "claimed": claim.gamma, "step": None, "exact": found.exact, "seconds": solver.seconds - before,
            "megabytes": solver.megabytes}  # fmt: skip


def given_storage(
    solver: Solver, degree: int, order: int = 1, shares: tuple[float, ...] = SHARES
) -> dict[str, Any]:
    """V as it is: the largest share of the sampled level that sums of squares prove, going down.

    `order` is half the degree of the multiplier of the level; the seconds are those of the last share.
    """
    solution, gamma = solution_of(degree)
    before, found, reason = solver.seconds, 0.0, ""
    last = before
    for share in shares:
        last = solver.seconds
        model = model_of(claim_at(degree, share))
        reach = reach_of(model, 1.05)
        quotients, _ = quotient_bounds(model, reach, QUOTIENT[degree])
        reason = proved_inside(solver, model, quotients, reach, order)
        if not reason:
            found = share
            break
    step = step_amplitude(solution, found * sampled_level(degree)) if found else 0.0
    return {"method": "sums of squares, V given", "law": LAWS[degree], "goal": 180, "degree": degree, "order": order,
            "gamma": gamma, "share": found, "step": step,
            "exact": reason, "seconds": solver.seconds - last, "all_seconds": solver.seconds - before,
            "megabytes": solver.megabytes}  # fmt: skip


LAWS = {2: "linear", 4: "cubic", 6: "quintic"}


def free_storage(solver: Solver, degree: int, share: float, turns: int) -> tuple[dict[str, Any], Certificate]:
    """V free, the law that of the degree, from its own V at a share of the sampled level; and the claim with its V.

    After each turn coordinates, ball and bounds of S are those of the new V at its level. Of the V that are proved, the
    one with the largest step is kept. The path of starts is followed from 0 in doubles.
    """
    solution, gamma = solution_of(degree)
    before, claim = solver.seconds, claim_at(degree, share)
    step = step_amplitude(solution, claim.level)
    largest, best, reason = step, claim, "no V that is proved and better"
    for _ in range(turns):
        model = model_of(claim)
        reach = reach_of(model, ROOM)
        quotients, _ = quotient_bounds(model, reach, QUOTIENT[degree])
        step, x = _path(solution, model, model.value, 1.0, reach)
        start = np.linalg.solve(model.transform, x)
        storage = FreeStorage(solver, model, quotients, reach, degree, 1, start)
        if storage.improve(1):
            break
        step, _ = _path(solution, model, storage.value, storage.level, reach)
        claim = with_value(claim, model, storage.value, storage.level)
        if step > largest:
            largest, best, reason = step, claim, ""
    row = {"method": "sums of squares, V free", "law": LAWS[degree], "goal": 180, "degree": degree, "gamma": gamma,
           "step": largest, "exact": reason, "seconds": solver.seconds - before,
           "megabytes": solver.megabytes}  # fmt: skip
    return row, best


def _path(
    solution: fh.HJISolution, model: Model, value: fmpq_mpoly, level: float, reach: float
) -> tuple[float, np.ndarray]:
    """The largest rest-to-rest step inside, followed from 0, the integrator where V is smallest nearby; its start."""
    function, inverse = _value(model, value), np.linalg.inv(model.transform)
    step, start, integral = 0.0, np.zeros(len(model.z)), 0.0
    while True:
        x, integral = rest(solution, step + _FINE, function, integral)
        if function(x) > level or np.linalg.norm(inverse @ x) > reach:
            return step, start
        step, start = step + _FINE, x


def confirmed(claim: Certificate, step: float) -> dict[str, Any]:
    """Somebody else's V, proved by branch and bound."""
    start = time.process_time()
    proof, outcome = prove(claim)
    seconds = time.process_time() - start
    reason = outcome.reason
    if outcome.proved:
        found = proof.check(threads=1)
        reason = "" if found.proved else found.reason
    check = time.process_time() - start - seconds
    return {"method": "V of the sums of squares, proved by ours", "law": LAWS[claim.degree], "goal": 180,
            "degree": claim.degree, "gamma": claim.gamma, "step": step, "exact": reason, "seconds": seconds,
            "check": check, "megabytes": memory()}  # fmt: skip


def _value(model: Model, polynomial: fmpq_mpoly) -> Callable[[np.ndarray], float]:
    """A polynomial in z as a function of x."""
    inverse, value = np.linalg.inv(model.transform), evaluated(model, polynomial)
    return lambda x: float(value(np.atleast_2d(x) @ inverse.T)[0])


def rest(
    solution: fh.HJISolution, amplitude: float, value: Callable[[np.ndarray], float], guess: float
) -> tuple[np.ndarray, float]:
    """The start of a step, with the integrator where V is smallest near a guess; and the integrator."""
    from scipy.optimize import minimize_scalar

    shares, free = step_roles(solution.state_names, None, None)
    x = equilibrium_state(solution, -amplitude * shares, free)
    (place,) = np.flatnonzero(free)

    def moved(integral: float) -> np.ndarray:
        return np.where(np.arange(len(x)) == place, integral, x)

    bounds = (guess - _NEAR, guess + _NEAR)
    best: Any = minimize_scalar(lambda integral: value(moved(integral)), bounds=bounds, method="bounded")
    return moved(float(best.x)), float(best.x)


# Every robot within its tolerances ----------------------------------------------------------------------------
@cache
def tolerant(goal: int) -> tuple[Any, Any, Any, float]:
    """Law, problem, ranges and γ of docs/certificate_study.md: weights of the preset for all tolerances."""
    arm, pose = fh.paper_arm(), np.radians([goal])
    damping, gamma = {180: (0.4, 380.0), 90: (None, 242.0)}[goal]
    specification = Specification(pose=tuple(pose), start=(0.0,), preset="robust", damping=damping)
    chosen = choose(arm, pose, np.zeros(1), specification)
    solution = fh.solve_hji(chosen.problem, gamma=chosen.gamma, degree=2)
    return solution, chosen.nominal, parameter_ranges(arm, chosen.nominal.plant), gamma


def tolerant_inequalities(solver: Solver, goal: int) -> dict[str, Any]:
    """All robots of the box and every start, one V."""
    solution, problem, ranges, gamma = tolerant(goal)
    before = solver.seconds
    claim = replace(tolerance_statement(solution, problem, ranges, gamma), level=1e4)
    found = global_gain(solver, claim)
    return {"method": "matrix inequalities, V free", "law": "linear, all tolerances", "goal": goal, "degree": 2,
            "gamma": found.gamma, "claimed": gamma, "step": None, "exact": found.exact,
            "seconds": solver.seconds - before, "megabytes": solver.megabytes}  # fmt: skip


# Ours ---------------------------------------------------------------------------------------------------------
def ours(law: str, degree: int, goal: int, value: str = OWN) -> dict[str, Any]:
    """The largest proved level with its checked certificate, in this process; V is the law's own, or that of (17)."""
    row: dict[str, Any] = {
        "method": "ours" if value == OWN else f"ours, {value}", "law": law, "goal": goal, "degree": degree,
    }  # fmt: skip
    if "tolerances" in law:
        solution, problem, ranges, gamma = tolerant(goal)
        step, start, p = float(np.radians(goal)), time.process_time(), None
        if value == COMMON:
            found = common_value(tolerance_statement(solution, problem, ranges, 1.0))
            assert found is not None, "no quadratic V has a gain"
            gamma, p = ROOM_OF_GAIN * found.smallest, found.p(ROOM_OF_GAIN)
        proof = certify_tolerances(
            solution, problem, ranges, gamma, step=step, scale=1.0 if value == COMMON else 4.0, p=p
        )
    else:
        solution, gamma = solution_of(degree, goal)
        start = time.process_time()
        proof = solution.certify(gamma=gamma, penalty=PENALTY, level=0.999 * sampled_level(degree, goal))
        row["share"] = 0.999
    seconds = time.process_time() - start
    checked = proof.check(threads=1)
    check = time.process_time() - start - seconds
    return row | {"gamma": proof.gamma, "step": proof.step_amplitude, "exact": "" if checked.proved else checked.reason,
                  "seconds": seconds, "check": check, "megabytes": memory()}  # fmt: skip


def memory() -> float:
    """The largest so far of this process, MB."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024.0
    raise SystemExit("no VmHWM in /proc/self/status")


def ours_alone(law: str, degree: int, goal: int, value: str = OWN) -> dict[str, Any]:
    """The same in a process of its own, for its memory."""
    command = [sys.executable, "-m", "benchmarks.certificates", "--ours", law, str(degree), str(goal), value]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])
