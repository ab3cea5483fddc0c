"""The worst finite-energy disturbance of a design's loop, for its robot and for the worst one within the tolerances.

∫|z|²/∫|d|² from rest at the goal, z and d as the synthesis has them, against γ²; and z and d of the proof, against the
proved γ, for the robots that the proof is about. What is attained is a lower bound of the gain, so it never exceeds a
proved one. The loop is that of the law with the true state fed back, inputs held for a period; the same search with the
estimator is made for the nominal robot, and no proof covers it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from flexhinf.analysis import Attained, worst_disturbance
from flexhinf.analysis.search import MovedLaw, worst_gain
from flexhinf.analysis.worst_disturbance import DisturbanceRuns
from flexhinf.campaign import Journal
from flexhinf.campaign.manifest import UNREADABLE
from flexhinf.certify import Certificate
from flexhinf.certify.evaluation import linear_part
from flexhinf.design.attenuation import LONGEST, MOST_STATES, STEPS, Attenuation
from flexhinf.design.campaign_setup import DesignCampaign
from flexhinf.design.certification import DesignProof, prove_design
from flexhinf.design.synthesis.steps import Synthesis, synthesise
from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution
from flexhinf.plant import Estimator, GeneralisedPlant, Penalty

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


@dataclass(frozen=True)
class GainRow:
    """One disturbance and the gain that it attained.

    Attributes
    ----------
    robot : {"nominal", "worst"}
    loop : {"true state", "estimator"}
    pair : {"synthesis", "proof"}
        Whose z and d are meant.
    gain, gamma : float
        Attained, and the level that it is compared with; √(∫|z|²/∫|d|²).
    claim : str
        What γ is: "designed", "proved", or "not claimed" for this robot and loop.
    energy : float
        ∫|d|².
    numbers : mapping of str to float
        Of the robot.
    names : tuple of str
        Of d.
    times : tuple of float
        s.
    disturbance : tuple of tuples of float
        d, each sample held until the next.
    """

    robot: str
    loop: str
    pair: str
    gain: float
    gamma: float
    claim: str
    energy: float
    numbers: Mapping[str, float]
    names: tuple[str, ...]
    times: tuple[float, ...]
    disturbance: tuple[tuple[float, ...], ...]

    @property
    def kept(self) -> bool:
        """Whether the gain is at most γ."""
        return self.gain <= self.gamma


@dataclass(frozen=True)
class GainResults:
    """All gains of one design: no rows where nothing was searched; why no γ is proved, empty where one is."""

    rows: tuple[GainRow, ...] = ()
    unproved: str = ""
    campaign: str = ""


def searches_gain(request: DesignCampaign) -> bool:
    """Whether a disturbance is searched for: not with so many states that one ascent takes minutes."""
    return STATES * len(request.request.robot.joint_names) <= MOST_STATES


@dataclass(frozen=True, eq=False)
class _Claim:
    """A problem whose gain is searched, the level of V that keeps the state, and γ with its claim for each robot."""

    pair: str
    problem: GeneralisedPlant
    level: float
    gamma: float
    nominal: str
    worst: str


@dataclass(frozen=True, eq=False)
class GainSearch:
    """The searches of one design; `horizon` is the length of the disturbances, s."""

    request: DesignCampaign
    synthesis: Synthesis
    horizon: float
    progress: Callable[[str], None] = lambda text: None

    @staticmethod
    def of(request: DesignCampaign, duration: float, progress: Callable[[str], None]) -> GainSearch:
        """The design is solved again: z and V are not in a controller's file; raises as `synthesise`."""
        synthesis = synthesise(request.request.robot, request.specification, progress)
        return GainSearch(request, synthesis, min(LONGEST, STEPS * duration), progress)

    # Robots ---------------------------------------------------------------------------------------------
    @cached_property
    def box(self) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Names of the robot's numbers that differ and both ends (d,) of their intervals."""
        variables = [v for v in self.request.variables if v.name in self.request.robot.nominal]
        low, high = np.array([(v.low, v.high) for v in variables], dtype=float).reshape(-1, 2).T
        return tuple(v.name for v in variables), low, high

    def numbers(self, point: np.ndarray) -> dict[str, float]:
        """Of a point (d,) of the unit box."""
        names, low, high = self.box
        return dict(zip(names, ((1.0 - point) * low + point * high).tolist(), strict=True))

    @cached_property
    def nominal(self) -> np.ndarray:
        """The nominal robot in the unit box (d,)."""
        names, low, high = self.box
        values = np.array([self.request.robot.nominal[name] for name in names])
        return np.clip((values - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)

    def problem_of(self, problem: GeneralisedPlant, numbers: Mapping[str, float]) -> GeneralisedPlant:
        """A problem with another robot, about that robot's equilibrium at the goal; FlexhinfError where it has none."""
        robot = self.request.robot
        values = robot.plant_parameters(robot.nominal | dict(numbers))
        equilibrium = robot.operating_point(self.synthesis.goal, (), values)
        plant = problem.plant.with_parameters(**problem.plant.parameters.known(values))
        return replace(problem, plant=plant, pose=None, equilibrium=equilibrium)

    # Claims ---------------------------------------------------------------------------------------------
    @property
    def law(self) -> HJISolution:
        """At the goal."""
        return self.synthesis.solution

    @property
    def estimator(self) -> Estimator | None:
        """The design's, about the goal."""
        setup = self.synthesis.setup(self.request.request.robot, self.request.specification)
        return setup.estimator(self.synthesis.goal)

    @cached_property
    def proof(self) -> DesignProof:
        """What is proved of the law."""
        robot, s = self.request.request.robot, self.request.specification
        return prove_design(robot, s, self.synthesis, math.nan, Attenuation(None, ()))

    @cached_property
    def designed(self) -> _Claim:
        """z, d and γ of the synthesis, on the sampled region, or for small disturbances where none was sampled."""
        chosen, level = self.synthesis.chosen, self.synthesis.chosen.level
        if not (chosen.looked and 0.0 < level < math.inf):
            robot, n = self.request.request.robot, len(self.law.plant_states)
            away = np.zeros(len(self.law.state_names))
            away[:n] = robot.operating_point(self.synthesis.start)[0] - self.law.operating_point[:n]
            level = SMALL * self.law.value(away)
        gamma = self.law.gamma
        return _Claim("synthesis", self.synthesis.problem, float(level), gamma, "designed", "not claimed")

    @cached_property
    def proved(self) -> _Claim | None:
        """z, d and γ of the proof, its level in the law's V; None without a proof, or where z is no matrix times x."""
        certificate, law = self.proof.certificate, self.synthesis.proved
        if certificate is None:
            return None
        boxed = any(p.low < p.high for p in certificate.parameters)
        options = self.request.options
        worst = "proved" if boxed and not options.tolerances and options.payload is None else ""
        if law is not None and boxed:
            problem, level = law.problem, certificate.level / law.scale
        elif (own := self._with_penalty(certificate)) is not None:
            problem, level = own, certificate.level
        else:
            return None
        return _Claim("proof", problem, level, certificate.gamma, "proved", worst)

    def _with_penalty(self, certificate: Certificate) -> GeneralisedPlant | None:
        """The law's problem with the penalty of a certificate, where that is linear in the state."""
        problem = self.law.problem
        linear = all(sum(powers) == 1 for row in certificate.penalty for powers, _ in row)
        if not linear or not isinstance(problem, GeneralisedPlant):
            return None
        matrix = linear_part(certificate.penalty, len(self.law.state_names))
        return replace(problem, penalty=Penalty(matrix, np.array(certificate.r2)))

    # Searches -------------------------------------------------------------------------------------------
    def results(self) -> GainResults:
        """Every search, in turn: the synthesis' claim, the loop with its estimator, the proof's claim."""
        rows = self._rows(self.designed)
        if self.estimator is not None:
            rows.append(self._estimator_row(rows[0]))
        self.progress("proof")
        if self.proved is not None:
            rows += self._rows(self.proved)
        bent = "" if self.proved is not None else "z of the proof is not linear in the state"
        return GainResults(tuple(rows), self.proof.reason or bent)

    def _rows(self, claim: _Claim) -> list[GainRow]:
        """The nominal robot, and the worst one where γ is said of it."""
        s, problem = self.request.specification, claim.problem
        self.progress(f"worst disturbance of the nominal robot, z and d of the {claim.pair}")
        first = worst_disturbance(
            problem, self.law, None, s.period, level=claim.level, horizon=self.horizon, seed=s.seed
        )
        rows = [_row("nominal", "true state", claim, claim.nominal, first, self.numbers(self.nominal))]
        if claim.worst and self.box[0]:
            self.progress(f"worst disturbance of the worst robot, z and d of the {claim.pair}")
            generator = np.random.Generator(np.random.Philox(key=[s.seed, 0]))
            worst = worst_gain(
                lambda point: self.problem_of(problem, self.numbers(point)), self.law, self.nominal, first,
                level=claim.level, period=s.period, horizon=self.horizon,
                starts=generator.random((RANDOM, len(self.box[0]))),
            )  # fmt: skip
            rows.append(
                _row("worst", "true state", claim, claim.worst, worst.attained, self.numbers(worst.point))
            )
        return rows

    def _estimator_row(self, first: GainRow) -> GainRow:
        """The nominal robot with the design's estimator, a disturbance of the same energy."""
        s = self.request.specification
        self.progress("worst disturbance of the loop with the estimator")
        attained = worst_disturbance(
            self.synthesis.problem, self.law, self.estimator, s.period, energy=first.energy, horizon=self.horizon,
            turns=ESTIMATOR_TURNS, starts=1, seed=s.seed,
        )  # fmt: skip
        return _row("nominal", "estimator", self.designed, "not claimed", attained, first.numbers)

    def again(self, row: GainRow) -> float:
        """The gain of a row's disturbance, run alone."""
        claim = self.proved if row.pair == "proof" else None
        problem = self.synthesis.problem if claim is None else claim.problem
        law = self.law
        if row.robot == "worst":
            problem = self.problem_of(problem, row.numbers)
            law = MovedLaw(self.law, problem)
        estimator = self.estimator if row.loop == "estimator" else None
        runs = DisturbanceRuns(problem, law, estimator, self.request.specification.period, self.horizon)
        return runs.attained(np.array(row.disturbance)).gain


def _row(
    robot: str, loop: str, claim: _Claim, what: str, attained: Attained, numbers: Mapping[str, float]
) -> GainRow:
    return GainRow(
        robot, loop, claim.pair, attained.gain, claim.gamma, what, attained.energy, dict(numbers),
        tuple(claim.problem.disturbance_names), tuple(attained.times.tolist()),
        tuple(map(tuple, attained.disturbance.tolist())),
    )  # fmt: skip


# Kept in the campaign's folder ------------------------------------------------------------------------------
def search_gain(
    request: DesignCampaign, journal: Journal, progress: Callable[[str], None] = lambda text: None
) -> GainResults:
    """The rows of `GainSearch`, kept in the campaign's folder: taken from there where they were found already.

    Raises
    ------
    InvalidInput
        If the robot has too many joints, or another driver is at work.
    FlexhinfError
        As the synthesis; or if the disk is full.
    """
    if not searches_gain(request):
        raise InvalidInput(
            "The worst disturbance is not searched for robots of so many joints.",
            f"expected at most {MOST_STATES // STATES}, got {len(request.request.robot.joint_names)}",
            "--metric with a metric of the runs, as overshoot_percent",
        )
    stored = stored_gains(journal)
    if stored.rows:
        return stored
    results = GainSearch.of(request, float(journal.settings["duration"]), progress).results()
    results = replace(results, campaign=journal.manifest["digest"])
    journal.store(FILE, asdict(results))
    return results


def stored_gains(journal: Journal) -> GainResults:
    """The results in a campaign's folder; no rows where nothing was searched, or the file is damaged."""
    try:
        results = journal.stored(FILE, GainResults, _MOST_FILE)
    except UNREADABLE:
        return GainResults()
    return results if results.campaign == journal.manifest["digest"] else GainResults()
