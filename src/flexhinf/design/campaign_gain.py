"""The worst finite-energy disturbance of a design's loop, for its robot and for the worst one within the tolerances.

∫|z|²/∫|d|² from rest at the goal is compared with γ² for z and d of the synthesis, and with the proved γ² for z and d
of the proof and the robots that it covers. The attained ratio is a lower bound of the gain, so it never exceeds a
proved one. The loop is that of the law with the true state fed back, inputs held for a period; the same search with the
estimator is made for the nominal robot, and no proof covers it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.analysis import Attained, worst_disturbance
from flexhinf.analysis.worst_disturbance import DisturbanceRuns, MovedLaw, worst_gain
from flexhinf.campaign import Journal
from flexhinf.campaign.journal import UNREADABLE
from flexhinf.certify.certificate import linear_part
from flexhinf.design import certification
from flexhinf.design.campaign_folder import DesignCampaign
from flexhinf.design.synthesis.steps import synthesise
from flexhinf.errors import InvalidInput
from flexhinf.plant import GeneralisedPlant, Penalty

#: File of the results, in the campaign's folder, and its bytes at most.
FILE, _MOST_FILE = Path("worst-case") / "disturbance.json", 100_000_000

#: States of the problem of one joint.
STATES = 5

#: Where no region was sampled: level of V of small disturbances, relative to V where the step starts.
SMALL = 1e-4

#: Random plants of the box at which the search begins beside the nominal one.
RANDOM = 3

#: Ascents of the search with the estimator: each run has the loop's own period.
ESTIMATOR_TURNS = 6

#: Why γ of a proof is not compared with anything.
BENT = "z of the proof is not linear in the state"


@dataclass(frozen=True)
class GainRow:
    """One disturbance and the gain that it attained."""

    robot: str  # {"nominal", "worst"}
    loop: str  # {"true state", "estimator"}
    pair: str  # {"synthesis", "proof"}. Whose z and d are meant
    # gain, gamma: Attained, and the level that it is compared with; √(∫|z|²/∫|d|²)
    gain: float
    gamma: float
    claim: str  # What γ is: "designed", "proved", or "not claimed" for this robot and loop
    energy: float  # ∫|d|²
    numbers: Mapping[str, float]  # Of the robot
    names: tuple[str, ...]  # Of d
    times: tuple[float, ...]  # s
    disturbance: tuple[tuple[float, ...], ...]  # d, each sample held until the next

    @property
    def kept(self) -> bool:
        """Whether the gain is at most γ."""
        return self.gain <= self.gamma


@dataclass(frozen=True)
class GainResults:
    """Gains of one design: rows (none if nothing was searched), and why no γ is proved (empty if one is)."""

    rows: tuple[GainRow, ...] = ()
    unproved: str = ""
    campaign: str = ""


def searches_gain(request: DesignCampaign) -> bool:
    """Whether a disturbance is searched for: not with so many states that one ascent takes minutes."""
    return STATES * len(request.request.robot.joint_names) <= certification.MOST_SEARCHED


@dataclass(frozen=True, eq=False)
class _Claim:
    """A problem whose gain is searched, the level of V that keeps the state, and γ with its claim for each robot."""

    pair: str
    problem: GeneralisedPlant
    level: float
    gamma: float
    nominal: str
    worst: str


class GainSearch:
    """Search for the gains of a design, for runs of `duration` (s); it is solved again, as no file stores z and V.

    `names`, `low`, `high`, `nominal`: the robot's uncertain parameters, both ends (d,) of their intervals, and the
        nominal robot in the unit box.
    `horizon`: length of the disturbances, s.
    """

    def __init__(
        self, request: DesignCampaign, duration: float, progress: Callable[[str], None] = lambda text: None
    ) -> None:
        self.request, self.s, self.progress = request, request.specification, progress
        designed = request.request.robot
        self.synthesis = synthesise(designed, self.s, progress)
        self.estimator = self.synthesis.setup(designed, self.s).estimator(self.synthesis.goal)
        self.horizon = min(certification.LONGEST_DISTURBANCE, certification.STEPS * duration)
        known = request.robot.nominal
        variables = [v for v in request.variables if v.name in known]
        self.names, values = tuple(v.name for v in variables), np.array([known[v.name] for v in variables])
        low, high = np.array([(v.low, v.high) for v in variables], dtype=float).reshape(-1, 2).T
        self.low, self.high = low, high
        self.nominal = np.clip((values - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)

    def numbers(self, point: np.ndarray) -> dict[str, float]:
        """Parameters of the robot at a point (d,) of the unit box."""
        return dict(zip(self.names, ((1.0 - point) * self.low + point * self.high).tolist(), strict=True))

    def problem_of(self, problem: GeneralisedPlant, numbers: Mapping[str, float]) -> GeneralisedPlant:
        """A problem with another robot, about that robot's equilibrium at the goal; FlexhinfError where it has none."""
        robot, plant = self.request.robot, problem.plant
        values = robot.plant_parameters(robot.nominal | dict(numbers))
        equilibrium = robot.operating_point(self.synthesis.goal, (), values)
        plant = plant.with_parameters(**plant.parameters.known(values))
        return replace(problem, plant=plant, pose=None, equilibrium=equilibrium)

    def _designed(self) -> _Claim:
        """z, d and γ of the synthesis, on the sampled region, or for small disturbances where none was sampled."""
        law, chosen = self.synthesis.solution, self.synthesis.chosen
        level = chosen.level
        if not (chosen.looked and 0.0 < level < math.inf):
            n, away = len(law.plant_states), np.zeros(len(law.state_names))
            start = self.request.request.robot.operating_point(self.synthesis.start)[0]
            away[:n] = start - law.operating_point[:n]
            level = SMALL * law.value(away)
        return _Claim("synthesis", self.synthesis.problem, float(level), law.gamma, "designed", "not claimed")

    @cached_property
    def proved(self) -> tuple[_Claim | None, str]:
        """z, d and γ of the proof, its level in the law's V; or None and why: no proof, or z not linear in x."""
        robot, options = self.request.request.robot, self.request.options
        proof = certification.prove_design(
            robot, self.s, self.synthesis, math.nan, certification.Attenuation(None, ())
        )
        certificate, law, solution = proof.certificate, self.synthesis.proved, self.synthesis.solution
        if certificate is None:
            return None, proof.reason or BENT
        boxed = any(p.low < p.high for p in certificate.parameters)
        worst = "proved" if boxed and not options.tolerances and options.payload is None else ""
        linear = all(sum(powers) == 1 for row in certificate.penalty for powers, _ in row)
        if law is not None and boxed:
            problem, level = law.problem, certificate.level / law.scale
        elif linear and isinstance(solution.problem, GeneralisedPlant):
            matrix = linear_part(certificate.penalty, len(solution.state_names))
            problem = replace(solution.problem, penalty=Penalty(matrix, np.array(certificate.r2)))
            level = certificate.level
        else:
            return None, proof.reason or BENT
        return _Claim("proof", problem, level, certificate.gamma, "proved", worst), proof.reason

    def results(self) -> GainResults:
        """Results of all searches: for γ of the synthesis, for the loop with its estimator, for γ of the proof."""
        designed = self._designed()
        rows = self._rows(designed)
        if self.estimator is not None:  # a disturbance of the same energy
            self.progress("worst disturbance of the loop with the estimator")
            attained = worst_disturbance(
                self.synthesis.problem, self.synthesis.solution, self.estimator, self.s.period, energy=rows[0].energy,
                horizon=self.horizon, turns=ESTIMATOR_TURNS, starts=1, seed=self.s.seed,
            )  # fmt: skip
            rows.append(_row("nominal", "estimator", designed, "not claimed", attained, rows[0].numbers))
        self.progress("proof")
        claim, unproved = self.proved
        return GainResults(tuple(rows + ([] if claim is None else self._rows(claim))), unproved)

    def _rows(self, claim: _Claim) -> list[GainRow]:
        s, problem, law = self.s, claim.problem, self.synthesis.solution
        self.progress(f"worst disturbance of the nominal robot, z and d of the {claim.pair}")
        first = worst_disturbance(
            problem, law, None, s.period, level=claim.level, horizon=self.horizon, seed=s.seed
        )
        rows = [_row("nominal", "true state", claim, claim.nominal, first, self.numbers(self.nominal))]
        if claim.worst and self.names:
            self.progress(f"worst disturbance of the worst robot, z and d of the {claim.pair}")
            generator = np.random.Generator(np.random.Philox(key=[s.seed, 0]))
            worst = worst_gain(
                lambda point: self.problem_of(problem, self.numbers(point)), law, self.nominal, first,
                level=claim.level, period=s.period, horizon=self.horizon,
                starts=generator.random((RANDOM, len(self.names))),
            )  # fmt: skip
            numbers = self.numbers(worst.point)
            rows.append(_row("worst", "true state", claim, claim.worst, worst.attained, numbers))
        return rows

    def again(self, row: GainRow) -> float:
        """Simulate the disturbance of a row again, and return its gain."""
        claim = self.proved[0] if row.pair == "proof" else None
        problem = self.synthesis.problem if claim is None else claim.problem
        law: Any = self.synthesis.solution
        if row.robot == "worst":
            problem = self.problem_of(problem, row.numbers)
            law = MovedLaw(law, problem)
        estimator = self.estimator if row.loop == "estimator" else None
        runs = DisturbanceRuns(problem, law, estimator, self.s.period, self.horizon)
        return runs.attained(np.array(row.disturbance)).gain


def _row(
    robot: str, loop: str, claim: _Claim, what: str, attained: Attained, numbers: Mapping[str, float]
) -> GainRow:
    return GainRow(
        robot, loop, claim.pair, attained.gain, claim.gamma, what, attained.energy, dict(numbers),
        tuple(claim.problem.disturbance_names), tuple(attained.times.tolist()),
        tuple(map(tuple, attained.disturbance.tolist())),
    )  # fmt: skip


def search_gain(
    request: DesignCampaign, journal: Journal, progress: Callable[[str], None] = lambda text: None
) -> GainResults:
    """Results of `GainSearch`, stored in the campaign's folder; read from there if they are stored already."""
    if not searches_gain(request):
        raise InvalidInput(
            "The worst disturbance is not searched for robots of so many joints.",
            f"expected at most {certification.MOST_SEARCHED // STATES}, got {len(request.request.robot.joint_names)}",
            "--metric with a metric of the runs, as overshoot_percent",
        )
    results = stored_gains(journal)
    if not results.rows:
        results = GainSearch(request, float(journal.settings["duration"]), progress).results()
        results = replace(results, campaign=journal.digest)
        journal.store(FILE, asdict(results))
    return results


def stored_gains(journal: Journal) -> GainResults:
    """The results in a campaign's folder; no rows where nothing was searched, or the file is damaged."""
    with suppress(*UNREADABLE):
        results = journal.stored(FILE, GainResults, _MOST_FILE)
        if results.campaign == journal.digest:
            return results
    return GainResults()
