"""Results of a design and of a comparison, and the status of a design: not met, not proved, risky."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import tomlkit

from flexhinf.analysis import modes
from flexhinf.design import certification, checks, design_file, laws, loop_setup, responses, tuning
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.problem import presets
from flexhinf.design.requirements import Requirement
from flexhinf.design.rigid import RigidComparison
from flexhinf.design.specification import RINGS, TOLERANCE, Specification
from flexhinf.design.synthesis import by_step, steps
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller
from flexhinf.notebook import Summarised
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

#: An estimation error that oscillates with a smaller damping ratio than this is a risk.
HARDLY_DAMPED = 0.05

#: A loop that tolerates less extra delay than so many periods is at risk from a late computation and a slow bus.
FEW_PERIODS = 3.0

#: Sensor noise that moves a motor by more than this fraction of the step's peak input, rms, wears it out.
NOISE_FRACTION = 0.05

#: The room whose pages show results. It reads designs, so it is loaded when one is saved.
PAGES = "flexhinf.pages"


T = TypeVar("T")


def forwarded(path: str, kind: type[T], doc: str) -> T:
    """A property that reads an attribute of a part by its path; `kind` is its type."""
    return cast("T", property(attrgetter(path), doc=doc))


@dataclass(frozen=True)
class Status:
    """The first lines of a report."""

    # not_met, not_proved: Requirements that the loop misses; claims that were only sampled, or found by search
    not_met: tuple[str, ...] = ()
    not_proved: tuple[str, ...] = ()
    risky: tuple[str, ...] = ()  # Dangers for the loop that no requirement covers
    # Limits that are met within the tolerance only, and the robots of the judgement, where those are less than all
    # within the tolerances; else empty
    scope: str = ""

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return not self.not_met

    @property
    def line(self) -> str:
        """One line: what is not met, not proved or risky."""
        met = f"Specification met on the running loop{f' ({self.scope})' if self.scope else ''}"
        rows = {"Not met": self.not_met, "Risky": self.risky, "Not proved": self.not_proved}
        parts = [f"{name}: " + "; ".join(texts) for name, texts in rows.items() if texts]
        return ". ".join(parts if self.not_met else [met, *parts]) + "."


def status_of(
    lines: Sequence[Requirement],
    evaluation: LawEvaluation,
    chosen: by_step.DegreeChoice,
    worth: certification.Attenuation,
    inside: bool | None,
    proof: certification.DesignProof,
) -> Status:
    """The status of a design."""
    setup, names = evaluation.setup, [line.what for line in lines]
    degrees = setup.specification.in_degrees and not any(setup.robot.links.slides)
    missed = dict.fromkeys(
        _missed(line.converted(degrees), names.count(line.what) > 1) for line in lines if not line.met
    )
    past = f"{100.0 * TOLERANCE:g} % past its limit at most, which counts as met"
    scope = [
        *dict.fromkeys(f"{line.what}: {past}" for line in lines if line.within_tolerance),
        *(["no tolerance stated: only the nominal robot was judged"] if evaluation.corners is None else []),
    ]
    unproved = certification.step_proof(proof, chosen, inside).missing
    if proof.certificate is None and proof.box is None and not worth.lasts:
        unproved = (*unproved, "the dissipation budget of the step does not last")
    return Status(tuple(missed), unproved, tuple(_risks(lines, evaluation)), "; ".join(scope))


def _missed(line: Requirement, places: bool) -> str:
    sign, unit = "≤" if line.at_most else "≥", line.unit_text
    joint, at = f" in {line.joint}" if line.joint else "", "" if line.at is None else f" at {line.at:.3g} s"
    place = f"; {line.where}" if places else ""
    return f"{line.what} {line.found:.3g}{unit}{joint}{at} (required {sign} {line.limit:.3g}{unit}{place})"


def _in_brackets(joints: Sequence[str], joint: str) -> str:
    return f" ({joint})" if len(joints) > 1 and joint else ""


def _risks(lines: Sequence[Requirement], evaluation: LawEvaluation) -> list[str]:
    setup, margins, risks = evaluation.setup, evaluation.margins, []
    of, period = partial(_in_brackets, setup.joints), setup.specification.period
    slow = [m for m in evaluation.estimator_modes if m.eigenvalue.imag > 0.0 and m.damping < HARDLY_DAMPED]
    if slow:
        worst = min(slow, key=lambda m: m.damping)
        risks.append(
            f"the estimation error oscillates at {worst.frequency:.3g} Hz{of(worst.joint)} with a damping of "
            f"{worst.damping:.2g}"
        )
    elif margins.damping < RINGS and not any(line.what.startswith("damping") for line in lines):
        risks.append(
            f"an oscillation of the running loop{of(evaluation.least_damped_joint)} is damped by "
            f"{margins.damping:.2g} only, and no damping is required"
        )
    if margins.stable and margins.delay_margin_s < FEW_PERIODS * period:
        risks.append(
            f"the loop tolerates {1e3 * margins.delay_margin_s:.2g} ms of extra delay, "
            f"{margins.delay_margin_s / period:.2g} periods"
        )
    loaded = evaluation.load_response.metrics
    if not loaded:
        risks.append("under a constant load on the links the loop diverges")
    if held := [row for row in loaded if row["recovery_time_s"] is None]:
        name = max(held, key=lambda row: row["remaining_error"])["joint"] if len(loaded) > 1 else ""
        link = f"link {name}" if name else "link"
        risks.append(f"under a constant load the {link} does not come back within 2 % of the step")
    noise, peak = evaluation.input_noise, evaluation.step.peak_input
    if margins.stable and noise > NOISE_FRACTION * peak:
        noises = evaluation.input_noises
        joint = "" if noises is None else of(setup.joints[int(np.argmax(noises))])
        risks.append(
            f"sensor noise at a motor{joint} is {100.0 * noise / peak:.2g} % of the step's peak input, rms"
        )
    return risks


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Design(Summarised):
    """A synthesised law for a robot and a specification, its evaluation in the loop, and the judgement of both.

    Attributes
    ----------
    synthesis : Synthesis
        Weights, problem, solutions of several degrees, and the law.
    evaluation : LawEvaluation
        The law in its loop.
    attenuation : Attenuation
        The worst disturbance found, and the dissipation budget of the step.
    inside : bool or None
        Whether the step starts inside the sampled region of the solution; None if no region was sampled.
    proof : DesignProof
        Of the law that is used, and of the step.
    mujoco : Response or None
        The step on MuJoCo's plant, if requested.
    rigid : RigidComparison or None
        The rigid design on the same robot, fed the true state.
    rest : LimitCycleCheck or None
        The long run at rest with dry friction; None for a robot that states none.
    payloads : tuple of PayloadEvaluation
        The runs with payloads at the ends of their ranges; none for a robot without such a range.
    law_modes : tuple of Mode
        Of the law alone: continuous, with the true state fed back.
    """

    robot: Robot
    specification: Specification
    synthesis: steps.Synthesis
    evaluation: LawEvaluation
    attenuation: certification.Attenuation
    inside: bool | None
    proof: certification.DesignProof
    mujoco: responses.Response | None
    rigid: RigidComparison | None
    rest: checks.LimitCycleCheck | None
    payloads: tuple[checks.PayloadEvaluation, ...] = ()
    law_modes: tuple[modes.Mode, ...]
    requirements: tuple[Requirement, ...]
    status: Status

    @property
    def step_proof(self) -> certification.StepProof:
        """Whether the requested step is proved."""
        return certification.step_proof(self.proof, self.chosen, self.inside)

    def summary(self) -> dict[str, str]:
        """Robot, whether the requirements are met, degree and level, and the step in numbers."""
        step, missed = self.evaluation.step, sum(not line.met for line in self.requirements)
        unit = self.setup.model.unit(self.setup.model.inputs[0])
        of = partial(_in_brackets, self.setup.joints)
        settling = f"{step.settling.value:.3g} s" if np.isfinite(step.settling.value) else "not settled"
        return {
            "robot": self.robot.name,
            "requirements": f"{missed} of {len(self.requirements)} not met" if missed else "met",
            "degree of V": str(self.chosen.degree),
            "γ": f"{self.gamma:.4g}",
            "settling": f"{settling}{of(step.settling.joint)}",
            "peak input": f"{step.peak_input:.3g} {unit}{of(step.peak.joint)}",
        }

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return all(line.met for line in self.requirements)

    setup = forwarded("evaluation.setup", loop_setup.LoopSetup, "The loop of all runs.")
    scenario = forwarded("evaluation.scenario", responses.Scenario, "The runs.")
    goal = forwarded("synthesis.goal", np.ndarray, "Link positions (n,), rad or m.")
    start = forwarded("synthesis.start", np.ndarray, "Link positions (n,), rad or m.")
    design_problem = forwarded(
        "synthesis.design_problem",
        presets.DesignProblem,
        "Weights, disturbances and level, with their sources.",
    )
    problem = forwarded("synthesis.problem", GeneralisedPlant, "The nominal problem about the goal.")
    choices = forwarded(
        "synthesis.choices", tuple[by_step.DegreeChoice, ...], "Every degree that was solved."
    )
    chosen = forwarded("synthesis.chosen", by_step.DegreeChoice, "The degree that is used.")
    solution = forwarded("synthesis.chosen.solution", HJISolution, "The solution that is used, at the goal.")
    gamma_star = forwarded(
        "synthesis.design_problem.gamma_star", float,
        "Smallest level of the problem that is solved; of the preset robust, with the channels of the tolerances.",
    )  # fmt: skip
    gamma = forwarded("synthesis.chosen.solution.gamma", float, "Level of the solution.")

    def controller(self, at: np.ndarray | None = None) -> Controller:
        """A new controller as it is deployed: it takes over without a jump of the input.

        `at`: (n,), Pose at which it takes over; the start of the step by default.
        """
        return self.setup.controller(self.start if at is None else np.atleast_1d(at).astype(float))

    def save(self, folder: str | Path) -> Path:
        """Write the report, its numbers, the controller and every run into a folder, which is returned."""
        return import_module(PAGES).write_design(self, folder)


@dataclass(frozen=True, eq=False)
class ComparedLaw:
    """One row of a comparison."""

    kind: laws.LawKind
    # The law, its parameters and its evaluation; None for a law that could not be made, or tuned within the limits
    tuned: tuning.TunedLaw | None = None
    # What the specification requires of margins, step, corners and sampled robots, judged as `design` judges it
    requirements: tuple[Requirement, ...] = ()
    failure: str = ""  # Why there is no evaluation

    name = forwarded("kind.name", str, "Of the law.")

    @property
    def evaluation(self) -> LawEvaluation | None:
        """Evaluation of the law; None for a law that is not compared."""
        return None if self.tuned is None else self.tuned.evaluation

    @property
    def metrics(self) -> Mapping[str, float | None]:
        """Metrics of the law, see `LawEvaluation.metrics`; empty without an evaluation."""
        return {} if self.evaluation is None else self.evaluation.metrics


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Summarised):
    """Several laws, each tuned for the same criterion and evaluated in the same scenario as `flexhinf.design`'s.

    Attributes
    ----------
    synthesis : Synthesis
        Of the design's own law.
    criterion : Criterion
        What every law is tuned for, and the limits that it keeps.
    rows : tuple of ComparedLaw
        The design as it is first, then nonlinear H∞ tuned as the others are.
    """

    robot: Robot
    specification: Specification
    synthesis: steps.Synthesis
    criterion: tuning.Criterion
    rows: tuple[ComparedLaw, ...]
    scenario: responses.Scenario

    def summary(self) -> dict[str, str]:
        """Robot, and the laws by the criterion (less is better)."""
        tuned = sorted((row.tuned for row in self.rows if row.tuned is not None), key=lambda law: law.cost)
        costs = ", ".join(f"{law.name} {law.cost:.3g}" for law in tuned)
        lost = ", ".join(row.name for row in self.rows if row.failure)
        return {"robot": self.robot.name, "laws by the criterion": costs} | (
            {"not compared": lost} if lost else {}
        )

    @property
    def own(self) -> ComparedLaw:
        """The design as it is, whose metrics are the reference of the criterion."""
        return self.rows[0]

    @property
    def tuned_design(self) -> ComparedLaw:
        """Nonlinear H∞ tuned for the criterion; the design as it is where there is no such law."""
        return next((row for row in self.rows[1:2] if row.evaluation is not None), self.own)

    @property
    def compared(self) -> tuple[ComparedLaw, ...]:
        """Rows with an evaluation."""
        return tuple(row for row in self.rows if row.evaluation is not None)

    def row(self, name: str) -> ComparedLaw:
        """The row of a law, by name."""
        return next(row for row in self.rows if row.name == name)

    def save(self, folder: str | Path) -> Path:
        """Write the report and its numbers into a folder, which is returned."""
        return import_module(PAGES).write_comparison(self, folder)

    def units(self) -> dict[str, Any]:
        """Units of inputs, positions, small position errors and torques, for joints that turn, slide or both."""
        slides = tuple(bool(slide) for slide in self.robot.links.slides)
        kinds = {"position": ("rad", "m"), "error": ("mrad", "mm"), "torque": ("N·m", "N")}
        problem = self.synthesis.problem
        return {"input": problem.plant.unit(problem.input_names[0])} | {
            name: " or ".join(unit for unit, there in zip(pair, (not all(slides), any(slides))) if there)
            for name, pair in kinds.items()
        }


def design_text(design: Design, request: design_file.DesignRequest, folder: str | Path = ".") -> str:
    """Text of the design file of a design: the request, and the result.

    `request`: where the robot came from, and its payload.
    `folder`: of the file; its paths are relative to it.

    InvalidInput if the penalty is code.
    """
    slides = design.robot.links.slides
    document = design_file.request_document(
        design.specification, request.source, request.elastic, folder, request.payload, slides
    )
    document.add(tomlkit.nl())
    document.add(tomlkit.comment("What came of it. This part is not read: changing it changes nothing."))
    problem, samples, loop = design.design_problem, design.evaluation.step_samples, design.evaluation.margins
    levels, states = design.setup.process_noise, problem.penalty.states
    weights = None if callable(states) else design_file.plain("penalty", states)
    if isinstance(weights, list):  # by name
        rows = bool(weights) and isinstance(weights[0], list)
        weights = {"rows": weights} if rows else dict(zip(design.problem.state_names, weights))
    table: dict[str, Any] = {
        "verdict": import_module(PAGES).verdict(design), "met": design.met, "preset": problem.preset,
        "goal": design.goal, "start": design.start, "gamma_star": design.gamma_star, "gamma": design.gamma,
        "degrees": [choice.degree for choice in design.choices], "degree": design.chosen.degree,
        "bandwidth": loop.bandwidth, "damping": loop.damping if math.isfinite(loop.damping) else None,
        "draws": 0 if samples is None else len(samples), "rays": design.synthesis.rays,
        "duration": design.scenario.step_duration, "weights_from": problem.source,
        "R2": np.asarray(problem.penalty.effort, dtype=float), "R2_from": problem.effort_source, "weights": weights,
        "robust": None if problem.robustness is None else asdict(problem.robustness),
        "estimator_noise": {
            "all_states": levels.all_states, "link_velocities": np.asarray(levels.link_velocities),
            "motor_velocities": np.asarray(levels.motor_velocities), "from": levels.source,
        },
        "margins": {
            "delay_margin": loop.delay_margin_s, "peak_sensitivity": loop.peak_sensitivity,
            "gain_margin": loop.gain_margin,
        },
        "specification": [
            {
                "what": line.what, "limit": "at most" if line.at_most else "at least", "asked": line.limit,
                "found": line.found, "unit": line.unit, "holds": line.met, "within_tolerance": line.within_tolerance,
                "where": line.where, "by_default": line.stated_by == "default",
            }
            for line in design.requirements
        ],
    }  # fmt: skip
    document.add(
        "result", design_file.toml_table({name: value for name, value in table.items() if value is not None})
    )
    return tomlkit.dumps(document)
