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
from typing import Any

import numpy as np

from flexhinf.analysis import Attained, worst_disturbance
from flexhinf.analysis.worst_disturbance import DisturbanceRuns
from flexhinf.analysis.worst_gain import MovedLaw, worst_gain
from flexhinf.campaign import Journal
from flexhinf.campaign.journal import disk_refusals, write_whole
from flexhinf.campaign.manifest import UNREADABLE, read_sealed, sealed
from flexhinf.certify import Certificate
from flexhinf.certify.sampled_gain import linear_part
from flexhinf.design.attenuation import LONGEST, MOST_STATES, STEPS, Attenuation
from flexhinf.design.campaign_setup import DesignCampaign
from flexhinf.design.certification import DesignProof, prove_design
from flexhinf.design.synthesis import Synthesis, synthesise
from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution
from flexhinf.plant import Estimator, GeneralisedPlant, Penalty

#: File of what was found, in the campaign's folder.
FILE = Path("worst-case") / "disturbance.json"

_MOST_FILE = 100_000_000

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
    """One disturbance and what it attained.

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
    """Everything that was searched of one design.

    Attributes
    ----------
    rows : tuple of GainRow
        None where nothing was searched.
    unproved : str
        Why no γ is proved of the law; empty where one is.
    """

    rows: tuple[GainRow, ...] = ()
    unproved: str = ""


def searches_gain(asked: DesignCampaign) -> bool:
    """Whether a disturbance is searched for: not with so many states that one ascent takes minutes."""
    return STATES * len(asked.request.robot.joint_names) <= MOST_STATES


@dataclass(frozen=True, eq=False)
class GainSearch:
    """The searches of one design.

    Attributes
    ----------
    horizon : float
        Of the disturbances, s.
    """

    asked: DesignCampaign
    made: Synthesis
    horizon: float

    @staticmethod
    def of(asked: DesignCampaign, duration: float, progress: Callable[[str], None]) -> GainSearch:
        """The design is solved again: z and V are not in a controller's file.

        Raises
        ------
        FlexhinfError
            As `flexhinf.design.synthesise`.
        """
        made = synthesise(asked.request.robot, asked.specification, progress)
        return GainSearch(asked, made, min(LONGEST, STEPS * duration))

    # Robots ---------------------------------------------------------------------------------------------
    @cached_property
    def box(self) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Names of the robot's numbers that differ and both ends (d,) of their intervals."""
        variables = [v for v in self.asked.variables if v.name in self.asked.robot.nominal]
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
        values = np.array([self.asked.robot.nominal[name] for name in names])
        return np.clip((values - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)

    def problem_of(self, problem: GeneralisedPlant, numbers: Mapping[str, float]) -> GeneralisedPlant:
        """A problem with another robot, about that robot's equilibrium at the goal.

        Raises
        ------
        FlexhinfError
            If no input holds it there.
        """
        robot = self.asked.robot
        values = robot.plant_parameters(robot.nominal | dict(numbers))
        x, u = robot.operating_point(self.made.goal, (), values)
        known = problem.plant.parameters.known(values)
        return replace(problem, plant=problem.plant.with_parameters(**known), pose=None, equilibrium=(x, u))

    # Pairs of z and d -----------------------------------------------------------------------------------
    @property
    def law(self) -> HJISolution:
        """At the goal."""
        return self.made.solution

    @property
    def estimator(self) -> Estimator | None:
        """The design's, about the goal."""
        return self.made.setup(self.asked.request.robot, self.asked.specification).estimator(self.made.goal)

    @cached_property
    def proof(self) -> DesignProof:
        """What is proved of the law."""
        robot, s = self.asked.request.robot, self.asked.specification
        return prove_design(robot, s, self.made, math.nan, Attenuation(None, ()))

    @property
    def certificate(self) -> Certificate | None:
        """None where nothing is proved."""
        return self.proof.certificate

    @property
    def boxed(self) -> bool:
        """Whether the proof is about all robots within the robot's own tolerances."""
        return self.certificate is not None and any(p.low < p.high for p in self.certificate.parameters)

    @cached_property
    def level(self) -> float:
        """Of the law's V, inside which a disturbance keeps the state; small where no region was sampled."""
        chosen = self.made.chosen
        if chosen.looked and 0.0 < chosen.level < math.inf:
            return float(chosen.level)
        robot, n = self.asked.request.robot, len(self.law.plant_states)
        away = np.zeros(len(self.law.state_names))
        away[:n] = robot.operating_point(self.made.start)[0] - self.law.operating_point[:n]
        return SMALL * float(self.law.value(away))

    def proved_problem(self, certificate: Certificate) -> tuple[GeneralisedPlant, float] | None:
        """z and d of the proof, and its level in the law's V; None where z is no matrix times x."""
        if self.made.proved is not None and self.boxed:
            return self.made.proved.problem, certificate.level / self.made.proved.scale
        problem = self.law.problem
        linear = all(sum(powers) == 1 for row in certificate.penalty for powers, _ in row)
        if not linear or not isinstance(problem, GeneralisedPlant):
            return None
        matrix = linear_part(certificate.penalty, len(self.law.state_names))
        return replace(problem, penalty=Penalty(matrix, np.array(certificate.r2))), certificate.level

    # Searches -------------------------------------------------------------------------------------------
    def found(self, progress: Callable[[str], None]) -> GainResults:
        """Every search, in turn."""
        gamma, made = self.law.gamma, self.made
        found = self._rows_of(
            made.problem, self.level, "synthesis", gamma, ("designed", "not claimed"), progress
        )
        estimator = self._with_estimator(found[0], progress)
        found += [] if estimator is None else [estimator]
        progress("proof")
        certificate = self.certificate
        proved = None if certificate is None else self.proved_problem(certificate)
        if certificate is not None and proved is not None:
            covered = self.boxed and not self.asked.options.tolerances and self.asked.options.payload is None
            claims = ("proved", "proved" if covered else "")
            found += self._rows_of(*proved, "proof", certificate.gamma, claims, progress)
        bent = "" if proved is not None else "z of the proof is not linear in the state"
        return GainResults(tuple(found), self.proof.reason or bent)

    def _rows_of(
        self,
        problem: GeneralisedPlant,
        level: float,
        pair: str,
        gamma: float,
        claims: tuple[str, str],
        progress: Callable[[str], None],
    ) -> list[GainRow]:
        """The nominal robot, and the worst one where something is said of it."""
        s = self.asked.specification
        progress(f"worst disturbance of the nominal robot, z and d of the {pair}")
        first = worst_disturbance(
            problem, self.law, None, s.period, level=level, horizon=self.horizon, seed=s.seed
        )
        begun = self.numbers(self.nominal)
        rows = [self._row("nominal", "true state", pair, first, gamma, claims[0], begun, problem)]
        if claims[1] and self.box[0]:
            progress(f"worst disturbance of the worst robot, z and d of the {pair}")
            generator = np.random.Generator(np.random.Philox(key=[s.seed, 0]))
            worst = worst_gain(
                lambda point: self.problem_of(problem, self.numbers(point)), self.law, self.nominal, first,
                level=level, period=s.period, horizon=self.horizon,
                starts=generator.random((RANDOM, len(self.box[0]))),
            )  # fmt: skip
            numbers = self.numbers(worst.point)
            rows.append(
                self._row("worst", "true state", pair, worst.attained, gamma, claims[1], numbers, problem)
            )
        return rows

    def _with_estimator(self, first: GainRow, progress: Callable[[str], None]) -> GainRow | None:
        """The nominal robot with the design's estimator, a disturbance of the same energy."""
        s, problem = self.asked.specification, self.made.problem
        estimator = self.estimator
        if estimator is None:
            return None
        progress("worst disturbance of the loop with the estimator")
        attained = worst_disturbance(
            problem, self.law, estimator, s.period, energy=first.energy, horizon=self.horizon,
            turns=ESTIMATOR_TURNS, starts=1, seed=s.seed,
        )  # fmt: skip
        return self._row(
            "nominal", "estimator", "synthesis", attained, first.gamma, "not claimed", first.numbers, problem
        )

    @staticmethod
    def _row(
        robot: str,
        loop: str,
        pair: str,
        attained: Attained,
        gamma: float,
        claim: str,
        numbers: Mapping[str, float],
        problem: GeneralisedPlant,
    ) -> GainRow:
        return GainRow(
            robot, loop, pair, attained.gain, gamma, claim, attained.energy, dict(numbers),
            tuple(problem.disturbance_names), tuple(attained.times.tolist()),
            tuple(map(tuple, attained.disturbance.tolist())),
        )  # fmt: skip

    def again(self, row: GainRow) -> float:
        """The gain of a row's disturbance, run alone."""
        s, problem = self.asked.specification, self.made.problem
        certificate = self.certificate if row.pair == "proof" else None
        if certificate is not None and (proved := self.proved_problem(certificate)) is not None:
            problem = proved[0]
        law, estimator = self.law, None
        if row.loop == "estimator":
            estimator = self.estimator
        if row.robot == "worst":
            problem = self.problem_of(problem, row.numbers)
            law = MovedLaw(self.law, problem)
        runs = DisturbanceRuns(problem, law, estimator, s.period, self.horizon)
        return runs.attained(np.array(row.disturbance)).gain


# Kept in the campaign's folder ------------------------------------------------------------------------------
def search_gain(
    asked: DesignCampaign, journal: Journal, progress: Callable[[str], None] = lambda text: None
) -> GainResults:
    """The rows of `GainSearch`, kept in the campaign's folder: taken from there where they were found already.

    The file is written whole when all searches are done, so an interrupted one leaves nothing behind.

    Raises
    ------
    InvalidInput
        If the robot has too many joints, or another driver is at work.
    FlexhinfError
        As the synthesis; or if the disk is full.
    """
    if not searches_gain(asked):
        raise InvalidInput(
            "The worst disturbance is not searched for robots of so many joints.",
            f"expected at most {MOST_STATES // STATES}, got {len(asked.request.robot.joint_names)}",
            "--metric with a metric of the runs, as overshoot_percent",
        )
    there = stored_gains(journal)
    if there.rows:
        return there
    found = GainSearch.of(asked, float(journal.settings["duration"]), progress).found(progress)
    content = {"campaign": journal.manifest["digest"], **asdict(found)}
    with journal.driven(), disk_refusals(journal.folder):
        (journal.folder / FILE).parent.mkdir(exist_ok=True)
        write_whole(journal.folder / FILE, sealed(content))
    return found


def stored_gains(journal: Journal) -> GainResults:
    """What a campaign's folder has; no rows where nothing was searched, or the file is damaged."""
    try:
        content = read_sealed(journal.folder / FILE, _MOST_FILE)
        if content["campaign"] != journal.manifest["digest"]:
            return GainResults()
        return GainResults(tuple(_row(one) for one in content["rows"]), str(content["unproved"]))
    except UNREADABLE:
        return GainResults()


def _row(one: Mapping[str, Any]) -> GainRow:
    """A row of the file; one of `UNREADABLE` where it is none."""
    return GainRow(**dict(one) | {
        "gain": float(one["gain"]), "gamma": float(one["gamma"]), "energy": float(one["energy"]),
        "numbers": {str(name): float(value) for name, value in one["numbers"].items()},
        "names": tuple(map(str, one["names"])), "times": tuple(map(float, one["times"])),
        "disturbance": tuple(tuple(map(float, row)) for row in one["disturbance"]),
    })  # fmt: skip
