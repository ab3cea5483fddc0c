"""The folder of a design's campaign, and the comparison of two campaigns.

The folder also has gains: the largest ratios ∫|z|²/∫|d|², from rest at the goal, that a search over disturbances of
finite energy attains, for the nominal robot and for the worst one within the tolerances. They are compared with γ² for
z and d of the synthesis, and with the proved γ² for z and d of the proof and its robots. An attained ratio is a lower
bound, so it never exceeds a proved one. The law has the true state fed back, and inputs are held for a period. For the
nominal robot the search is repeated with the estimator, which no proof covers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import tomlkit

from flexhinf.analysis import Attained, worst_disturbance
from flexhinf.analysis.worst_disturbance import DisturbanceRuns, MovedLaw, worst_gain
from flexhinf.campaign import (
    Campaign,
    CampaignJudgement,
    Journal,
    PairedCampaigns,
)
from flexhinf.campaign.journal import check_own_folder
from flexhinf.campaign.manifest import UNREADABLE, CampaignFacts, differing, listed
from flexhinf.campaign.worst_case import Damaged
from flexhinf.certify.certificate import linear_part
from flexhinf.designs import certification, design_file
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.deployed_run import DesignCampaign, DesignedLaw, PoseCampaign
from flexhinf.designs.design_campaign import campaign_of
from flexhinf.designs.design_file import fields_text
from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.designs.request import read_request
from flexhinf.designs.stored import requested_loop
from flexhinf.designs.synthesis.by_step import STATES
from flexhinf.designs.synthesis.steps import synthesise
from flexhinf.designs.verdict import DesignVerdict
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.files import locked, write_file
from flexhinf.plant import GeneralisedPlant, Penalty
from flexhinf.robot.elastic import inactive_parameters
from flexhinf.validation import NotReadable, checked_path

#: Folders of the two campaigns, inside the folder of their comparison.
FOLDERS = ("a", "b")

#: Fields of a specification that define robot, sensors and motors; all others define the law. Start, goal and limits
#: are compared as numbers.
SHARED = (
    "measured",
    "measurement_noise",
    "quantisation",
    "period",
    "latency",
    "unknown_delay",
    "extras",
    "move",
    "workspace",
)


@dataclass(eq=False)
class DesignPair:
    """Two designs with the same options, robots, sensors, motors and step; otherwise InvalidInput names the difference.

    `judged`, `paired`: results after both have run on the same samples: each against the requirements, and in pairs.
    """

    a: DesignCampaign[Any]
    b: DesignCampaign[Any]
    folder: Path  # Folder of the comparison; the campaigns are in its `FOLDERS`
    names: tuple[str, str]  # Names of the designs
    command: Sequence[str] = ()
    judged: tuple[CampaignJudgement, CampaignJudgement] = field(init=False)
    paired: PairedCampaigns = field(init=False)

    def __post_init__(self) -> None:
        self.folder = checked_path("The comparison's folder", self.folder).expanduser().absolute()
        a, b = _circumstances(self.a), _circumstances(self.b)
        rows = [f"{name}: {in_a} ↔ {in_b}" for name, in_a, in_b in differing(a, b, [*a, *b], "default")]
        keys = [LoopPlants(side.robot, side.specification).true_plant.code_key for side in (self.a, self.b)]
        if not rows and keys[0] != keys[1]:
            rows = ["the equations of the robots, which have the same parameters"]
        refuse_if(
            rows,
            "The designs are not for the same robot, sensors, motors and step; their runs cannot be compared "
            "sample by sample.",
            listed(rows),
            "designs that differ in preset, weights, degrees, γ or estimator only",
        )

    @property
    def independent(self) -> bool:
        """Whether the samples are independent: intervals and tests hold for them only."""
        return self.judged[0].independent

    @property
    def differences(self) -> list[tuple[str, str, str]]:
        """Fields of the specifications that differ, and their values in a and in b."""
        a, b = fields_text(self.a.specification), fields_text(self.b.specification)
        return differing(a, b, [*a, *b], "default")


def _circumstances(side: DesignCampaign[Any]) -> dict[str, str]:
    limits = side.metrics.limits
    return {
        **{name: text for name, text in side.stated.items() if not name.startswith("design ")},
        **{name: text for name, text in fields_text(side.specification).items() if name in SHARED},
        "true state fed back": str(side.specification.estimator == "none"),
        "limits of the inputs": str(limits.peak.tolist()),
        "saturation": str(limits.saturation.tolist()),
        "limits of the speeds": str(limits.speed.tolist()),
    }


#: Folder of the design file and the law inside a campaign's.
SETUP = "setup"

#: Lock file, held while a controller is designed and written.
SETUP_LOCK = ".campaign-setup-lock"

#: Longest wait for another driver that designs the controller, s.
PATIENCE = 3600.0


def open_campaign(
    request: DesignCampaign[Any],
    folder: str | Path,
    command: Sequence[str] = (),
    progress: Callable[[str], None] = print,
    designed: DesignedLaw[Any] | None = None,
) -> tuple[Campaign, Journal]:
    """Open the campaign of a folder: design its controller and store it there, or resume with the stored one.

    `designed`: for a new folder, what it runs, as from `designed_controller`.

    InvalidInput before any work if the folder holds something else or a campaign with other settings; FlexhinfError as
    `flexhinf.designs.design`.
    """
    journal, place = Journal.read(folder, (SETUP,)), Path(folder).expanduser().absolute()
    if journal is None:
        (place / SETUP).mkdir(parents=True, exist_ok=True)
        with locked(place / SETUP_LOCK, PATIENCE):
            journal = Journal.read(folder, (SETUP,))  # another driver of a job array may have been quicker
            if journal is None:
                return _begun(request, place, command, designed or designed_controller(request, progress))
    campaign = reopened(request, journal)
    journal.refuse_campaign(campaign)
    return campaign, journal


def _begun(
    request: DesignCampaign[Any], place: Path, command: Sequence[str], designed: DesignedLaw[Any]
) -> tuple[Campaign, Journal]:
    o, design, setup = request.options, request.request, place / SETUP
    designed = replace(designed, length=designed.length if o.duration is None else o.duration)
    request.campaign(designed)  # refuses what does not fit before anything is written
    document = design_file.request_document(
        design.specification, design.source, design.elastic, setup, design.payload, design.robot.links.slides
    )
    text, file = tomlkit.dumps(document), setup / design_file.DESIGN_FILE
    write_file(file, "design file", lambda name: Path(name).write_text(text, encoding="utf-8"))
    request.store(designed.law, setup)
    campaign = request.campaign(replace(designed, law=request.stored(setup)))
    about: CampaignFacts = {
        "title": f"Campaign of the robot “{design.robot.name}”",
        "requirements": list(request.requirements),
        "nominal": {v.name: request.robot.nominal.get(v.name, 0.0) for v in request.variables},
        "options": {**vars(o), "tolerances": [list(tolerance) for tolerance in o.tolerances]},
        "design": designed.verdict.numbers,
    }
    return campaign, Journal.opened(place, campaign, command, about)


def verdict_of(journal: Journal) -> DesignVerdict | None:
    """The verdict on the design of a campaign; None for a campaign of something else."""
    return DesignVerdict.read(journal.about.get("design")) if "options" in journal.about else None


def designed_controller(
    request: DesignCampaign[Any], progress: Callable[[str], None] = print
) -> DesignedLaw[Any]:
    """What a campaign runs: of the unchanged report that its design names, or designed now and not judged."""
    loop, verdict = requested_loop(request.request, progress)
    return replace(request.law_of(loop), verdict=verdict)


def reopened(request: DesignCampaign[Any], journal: Journal) -> Campaign:
    """The campaign of a folder, with its stored controller; InvalidInput if it was begun with other settings."""
    journal.refuse_other(request.stated, partly=True)
    law = request.stored(journal.folder / SETUP)
    return request.campaign(DesignedLaw(law, float(journal.settings["duration"])))


def stored_campaign(folder: str | Path) -> tuple[Campaign, Journal]:
    """The stored campaign of a folder, for replays; its settings are read from the folder.

    InvalidInput if it holds no campaign of a design, or the robot's file was changed since.
    """
    journal = Journal.existing(folder)
    if "options" not in journal.about:
        raise InvalidInput(
            "The folder holds no campaign of a design.",
            f"expected a folder that `flexhinf campaign` wrote, got {folder}",
            "its --out; a campaign from Python replays with Campaign(...).replay(sample)",
        )
    return reopened(stored_request(journal), journal), journal


def stored_request(journal: Journal) -> DesignCampaign[Any]:
    """The design and the campaign of a folder."""
    known = CampaignOptions.__dataclass_fields__
    try:
        stated = cast("dict[str, Any]", journal.about.get("options", {}))
        stored = {name: value for name, value in stated.items() if name in known}
        stored["tolerances"] = tuple((str(name), str(spread)) for name, spread in stored["tolerances"])
        options = CampaignOptions(**stored)
    except InvalidInput:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInput(
            "The options of the campaign cannot be read.",
            f"{journal.folder}: {error}",
            "a copy of its manifest",
        ) from error
    return campaign_of(read_request(journal.folder / SETUP / design_file.DESIGN_FILE), options)


def open_pair(pair: DesignPair, progress: Callable[[str], None] = print) -> list[tuple[Campaign, Journal]]:
    """Open the campaigns of both designs in the folders `FOLDERS`, new ones or stored ones, with runs of equal length.

    Raises as `open_campaign`, before any work for either.
    """
    check_own_folder(pair.folder, "comparison of campaigns", (*FOLDERS, "index.html"))
    pair.folder.mkdir(parents=True, exist_ok=True)
    places = [(side, pair.folder / name) for side, name in zip((pair.a, pair.b), FOLDERS)]
    with locked(pair.folder / SETUP_LOCK, PATIENCE):
        journals = [Journal.read(place, (SETUP,)) for _, place in places]
        for (side, _), journal in zip(places, journals):
            if journal is not None:  # refuse it before the other one is designed
                journal.refuse_other(side.stated, partly=True)
        designed = [
            None if journal else designed_controller(side, progress)
            for (side, _), journal in zip(places, journals)
        ]
        begun = [float(journal.settings["duration"]) for journal in journals if journal]
        duration = begun[0] if begun else float(np.max([result.length for result in designed if result]))
        return [
            open_campaign(side, place, pair.command, progress, result and replace(result, length=duration))
            for (side, place), result in zip(places, designed)
        ]


#: File of the gains in the campaign's folder, and its largest size, bytes.
FILE, _MOST_FILE = Path("worst-case") / "disturbance.json", 100_000_000

#: Where no region was sampled: level of V of small disturbances, relative to V where the step starts.
SMALL = 1e-4

#: Number of random plants at which the search begins, besides the nominal one.
RANDOM = 3

#: Number of ascents of the search with the estimator, whose runs have the loop's own period.
ESTIMATOR_TURNS = 6


@dataclass(frozen=True)
class GainRow:
    """One disturbance and the gain that it attained."""

    robot: str  # {"nominal", "worst"}
    loop: str  # {"true state", "estimator"}
    pair: str  # {"synthesis", "proof"}: the source of z and d
    # gain, gamma: attained √(∫|z|²/∫|d|²), and the level that it is compared with
    gain: float
    gamma: float
    claim: str  # Claim about γ for this robot and loop: "designed", "proved" or "not claimed"
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


def searches_gain(request: DesignCampaign[Any]) -> bool:
    """Whether a disturbance is searched for; with many states one ascent would take minutes."""
    states = STATES * len(request.request.robot.joint_names)
    return isinstance(request, PoseCampaign) and states <= certification.MOST_SEARCHED


class _Claim(NamedTuple):
    pair: str
    problem: GeneralisedPlant  # the problem whose gain is searched
    level: float  # level of V that the state must not leave
    gamma: float
    # claims about γ for the nominal and the worst robot
    nominal: str
    worst: str


class GainSearch:
    """Search for the gains of a design, for runs of `duration` (s). The design is solved again, as no file stores z and
    V."""

    def __init__(
        self,
        request: DesignCampaign[Any],
        duration: float,
        progress: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.request, self.s, self.progress = request, request.specification, progress
        designed, known = request.request.robot, request.robot.nominal
        self.synthesis = synthesise(designed, self.s, progress)
        self.estimator = self.synthesis.setup(designed, self.s).estimator(self.synthesis.goal)
        # length of the disturbances, s
        self.horizon = min(certification.LONGEST_DISTURBANCE, certification.STEPS * duration)
        # the robot's uncertain parameters, both ends (d,) of their intervals, and the nominal robot in the unit box
        # that the model has: disturbances are searched for on it, as the claim is of it
        off = inactive_parameters((), designed.joint_names)
        variables = [v for v in request.variables if v.name in known and v.name not in off]
        self.names = tuple(v.name for v in variables)
        self.low, self.high = np.array([(v.low, v.high) for v in variables], dtype=float).reshape(-1, 2).T
        width = np.where(self.high > self.low, self.high - self.low, 1.0)
        self.nominal = np.clip((np.array([known[name] for name in self.names]) - self.low) / width, 0.0, 1.0)

    def numbers(self, point: np.ndarray) -> dict[str, float]:
        """Parameters of the robot at a point (d,) of the unit box."""
        return dict(zip(self.names, ((1.0 - point) * self.low + point * self.high).tolist(), strict=True))

    def problem_of(self, problem: GeneralisedPlant, numbers: Mapping[str, float]) -> GeneralisedPlant:
        """A problem with another robot, about that robot's equilibrium at the goal; FlexhinfError where it has none."""
        robot, plant = self.request.robot, problem.plant
        values = robot.varied(numbers)
        equilibrium = robot.operating_point(self.synthesis.goal, (), values)
        plant = plant.with_parameters(**plant.parameters.known(values))
        return replace(problem, plant=plant, pose=None, equilibrium=equilibrium)

    def results(self) -> GainResults:
        """Results of all searches: for γ of the synthesis, for the loop with its estimator, for γ of the proof."""
        # the level of the sampled region, or a small one if none was sampled
        law, chosen, level = self.synthesis.solution, self.synthesis.chosen, self.synthesis.chosen.level
        if not (chosen.looked and 0.0 < level < math.inf):
            n, away = len(law.plant_states), np.zeros(len(law.state_names))
            start = self.request.request.robot.operating_point(self.synthesis.start)[0]
            away[:n] = start - law.operating_point[:n]
            level = SMALL * law.value(away)
        problem = self.synthesis.problem
        rows = self._rows(
            _Claim("synthesis", problem, float(level), law.gamma, "designed", "not claimed"), self.estimator
        )
        self.progress("proof")
        claim, unproved = self.proved
        return GainResults((*rows, *(() if claim is None else self._rows(claim))), unproved)

    @cached_property
    def proved(self) -> tuple[_Claim | None, str]:
        """z, d, γ and level (in the law's V) of the proof; or None and the reason: no proof, or z is not linear in
        x."""
        robot, options = self.request.request.robot, self.request.options
        proof = certification.prove_design(
            robot, self.s, self.synthesis, math.nan, certification.Attenuation(None, ())
        )
        certificate, law, solution = proof.certificate, self.synthesis.proved, self.synthesis.solution
        boxed = certificate is not None and any(p.low < p.high for p in certificate.parameters)
        if certificate is not None and law is not None and boxed:
            problem, level = law.problem, certificate.level / law.scale
        elif (
            certificate is not None
            and all(sum(powers) == 1 for row in certificate.penalty for powers, _ in row)
            and isinstance(solution.problem, GeneralisedPlant)
        ):
            matrix = linear_part(certificate.penalty, len(solution.state_names))
            problem = replace(solution.problem, penalty=Penalty(matrix, np.array(certificate.r2)))
            level = certificate.level
        else:
            return None, proof.reason or "z of the proof is not linear in the state"
        worst = "proved" if boxed and not options.tolerances and options.payload is None else ""
        return _Claim("proof", problem, level, certificate.gamma, "proved", worst), proof.reason

    def _rows(self, claim: _Claim, estimator: Any = None) -> list[GainRow]:
        """Gains of the nominal and of the worst robot with the true state, and of the nominal one with an estimator."""
        s, problem, law, rows = self.s, claim.problem, self.synthesis.solution, list[GainRow]()

        def add(robot: str, loop: str, what: str, attained: Attained, numbers: Mapping[str, float]) -> None:
            rows.append(
                GainRow(
                    robot,
                    loop,
                    claim.pair,
                    attained.gain,
                    claim.gamma,
                    what,
                    attained.energy,
                    numbers,
                    tuple(problem.disturbance_names),
                    tuple(attained.times.tolist()),
                    tuple(map(tuple, attained.disturbance.tolist())),
                )
            )

        self.progress(f"worst disturbance of the nominal robot, z and d of the {claim.pair}")
        nominal = self.numbers(self.nominal)
        first = worst_disturbance(
            problem, law, None, s.period, level=claim.level, horizon=self.horizon, seed=s.seed
        )
        add("nominal", "true state", claim.nominal, first, nominal)
        if claim.worst and self.names:
            self.progress(f"worst disturbance of the worst robot, z and d of the {claim.pair}")
            worst = worst_gain(
                lambda point: self.problem_of(problem, self.numbers(point)),
                law,
                self.nominal,
                first,
                level=claim.level,
                period=s.period,
                horizon=self.horizon,
                starts=np.random.Generator(np.random.Philox(key=[s.seed, 0])).random(
                    (RANDOM, len(self.names))
                ),
            )
            add("worst", "true state", claim.worst, worst.attained, self.numbers(worst.point))
        if estimator is not None:  # a disturbance of the same energy
            self.progress("worst disturbance of the loop with the estimator")
            attained = worst_disturbance(
                problem,
                law,
                estimator,
                s.period,
                energy=first.energy,
                horizon=self.horizon,
                turns=ESTIMATOR_TURNS,
                starts=1,
                seed=s.seed,
                latency=s.known_latency,
            )
            add("nominal", "estimator", "not claimed", attained, nominal)
        return rows

    def again(self, row: GainRow) -> float:
        """Simulate the disturbance of a row again, and return its gain."""
        claim, law = self.proved[0] if row.pair == "proof" else None, self.synthesis.solution
        problem = self.synthesis.problem if claim is None else claim.problem
        if row.robot == "worst":
            problem = self.problem_of(problem, row.numbers)
            law = MovedLaw(law, problem)
        estimator = self.estimator if row.loop == "estimator" else None
        latency = 0 if estimator is None else self.s.known_latency
        runs = DisturbanceRuns(problem, law, estimator, self.s.period, self.horizon, latency)
        return runs.attained(np.array(row.disturbance)).gain


def search_gain(
    request: DesignCampaign[Any], journal: Journal, progress: Callable[[str], None] = lambda text: None
) -> GainResults:
    """Results of `GainSearch`; they are stored in the campaign's folder, and read from there if they exist."""
    refuse_if(
        not searches_gain(request),
        "The worst disturbance is not searched for this design.",
        f"expected one of one pose of at most {certification.MOST_SEARCHED // STATES} joints",
        "--metric with a metric of the runs, as overshoot_percent",
    )
    try:
        results = stored_gains(journal)
    except Damaged:  # they are made anew
        results = GainResults()
    if not results.rows:
        results = GainSearch(request, float(journal.settings["duration"]), progress).results()
        results = replace(results, campaign=journal.digest)
        journal.store(FILE, asdict(results))
    return results


def stored_gains(journal: Journal) -> GainResults:
    """The results in a campaign's folder; no rows where nothing was searched. Raises InvalidInput: they are damaged."""
    try:
        results = journal.stored(FILE, GainResults, _MOST_FILE)
    except FileNotFoundError:
        return GainResults()
    except NotReadable:
        raise
    except UNREADABLE as error:
        raise Damaged(
            "The worst disturbances cannot be read.",
            f"{journal.folder / FILE}: {str(error)[:200]}",
            "the campaign's command with --worst-case, which searches again",
        ) from error
    return results if results.campaign == journal.digest else GainResults()
