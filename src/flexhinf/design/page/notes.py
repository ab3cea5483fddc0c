"""What the reader must not miss, each with the section it belongs to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flexhinf.analysis import Margins
from flexhinf.design.page.units import units_of
from flexhinf.design.page.words import HARDLY_DAMPED, peak_input, vibrations
from flexhinf.design.result import Design
from flexhinf.report import Note, number

__all__ = ["Remark", "noise_volts", "notes", "remarks", "section_notes"]

_OPTION = re.compile(r"--[a-z]+(-[a-z]+)*")

#: An estimation error at a vibration with less damping than this is hardly corrected.
HARDLY_SEEN = 0.01

#: A loop that stands less extra delay than so many periods, or whose S peaks above this, is near its edge.
LEAST_PERIODS, LARGEST_SENSITIVITY = 3.0, 2.0

#: Noise of the sensors that costs the motors more than this share of the step's peak input.
NOISE_SHARE = 0.05

#: What a robot may state and a true plant leaves out unless asked: how the parameter's name begins, and the extra.
STATED = {"inductance": "inductance", "damping": "joint_damping", "coulomb_friction": "coulomb_friction"}

#: A peak input in the first samples that is so much larger than all after them is the estimator's.
STARTING, MUCH = 20, 1.5


@dataclass(frozen=True)
class Remark:
    """A note.

    Attributes
    ----------
    section : str
        Anchor of the section it is shown in.
    about : str
        In a word or two, for the top of the page.
    text : str
    """

    section: str
    about: str
    text: str


def notes(design: Design) -> list[str]:
    """What the reader must not miss."""
    return [remark.text for remark in remarks(design)]


def remarks(design: Design) -> list[Remark]:
    """The same with their places, in the order of the page."""
    return [
        *_runs(design),
        *_modes(design),
        *_margins(design),
        *_corners(design),
        *_guarantee(design),
        *_regions(design),
        *_rigid(design),
    ]


def section_notes(design: Design, section: str) -> list[Note]:
    """Of one section, as blocks; options are set as code."""
    return [
        Note(_OPTION.sub(r"`\g<0>`", remark.text[:1].upper() + remark.text[1:]))
        for remark in remarks(design)
        if remark.section == section
    ]


def _left_out(design: Design) -> list[str]:
    """Extras that the robot's numbers would allow, and that are off."""
    names = [parameter.name for parameter in design.robot.parameters if parameter.value]
    return [
        extra
        for begins, extra in STATED.items()
        if extra not in design.specification.extras and any(name.startswith(begins) for name in names)
    ]


def _runs(design: Design) -> Iterator[Remark]:
    left = _left_out(design)
    if left:
        yield Remark(
            "step", "what the true plant leaves out",
            f"The robot states numbers of {' and '.join(left).replace('_', ' ')} that the true plant of this report "
            f"leaves out: --extras {','.join(left)} takes them in.",
        )  # fmt: skip
    if design.response.diverged is not None:
        yield Remark(
            "step", "the step diverges",
            f"The step diverges at {design.response.diverged:.3g} s: start nearer to the goal, or change the penalty.",
        )  # fmt: skip
    started = _started(design)
    if started:
        yield Remark("step", "a peak input at the estimator's start", started)
    draws = design.draws
    if draws is not None and draws.diverged:
        yield Remark(
            "draws", "robots that diverge",
            f"{draws.diverged} of {len(draws)} robots within their tolerances diverge: the design does not serve them. "
            "--preset robust makes the tolerances part of the game.",
        )  # fmt: skip
    if design.disturbed.response.diverged is not None:
        yield Remark(
            "load",
            "the load run diverges",
            "With torques on the links the loop diverges; try a smaller --load.",
        )
    else:
        slow = [
            name
            for name, m in zip(design.robot.joint_names, design.disturbed.metrics)
            if m["recovery_time_s"] is None
        ]
        if slow:
            yield Remark(
                "load", "loads not recovered from",
                f"{', '.join(slow)}: not recovered from the torque on the links by the end of the run.",
            )  # fmt: skip
    if design.move.response.diverged is not None:
        yield Remark(
            "move",
            "the move diverges",
            "Following the move, the loop diverges: a slower one, or a smaller way.",
        )


def _started(design: Design) -> str:
    """That the peak input is the estimator's first samples, if it is."""
    sizes = np.abs(design.response.run.signals["input"]).max(axis=1)
    at = int(np.argmax(sizes))
    if not _estimated(design) or not 0 < at < STARTING or len(sizes) <= STARTING:
        return ""
    later = float(sizes[STARTING:].max())
    if sizes[at] < MUCH * later:
        return ""
    unit, period = units_of(design).effort, design.specification.period
    return (
        f"The peak input of {number(float(sizes[at]), 3)} {unit} falls {number(1e3 * at * period, 2)} ms after the "
        "start, where the filter has not yet found its gain and noise passes the law: from "
        f"{number(1e3 * STARTING * period, 3)} ms on it is {number(later, 3)} {unit}. "
        "Let the estimator run before the law takes over."
    )


def _modes(design: Design) -> Iterator[Remark]:
    after = vibrations(design.closed_modes)
    if after and min(after) < HARDLY_DAMPED:
        yield Remark(
            "modes", "a vibration that rings",
            f"A vibration keeps a damping ratio of {min(after):.2g}: these weights hardly act on it. "
            "--damping 0.3 looks for weights that do, with the preset damped.",
        )  # fmt: skip
    unseen = [mode for mode in design.estimator_modes if mode.vibration and mode.damping < HARDLY_SEEN]
    wanted = design.game.wanted
    least = 0.0 if wanted is None else wanted.damping
    ringing = [mode for mode in design.estimator_modes if mode.vibration and mode.damping < least]
    if ringing and not unseen:
        worst = min(ringing, key=lambda mode: mode.damping)
        yield Remark(
            "modes", "an estimation error that rings",
            f"The damping asked for is that of the law. The estimator's error at {worst.frequency:.3g} Hz "
            f"({worst.joint}) is damped by {worst.damping:.2g} only: after a disturbance that the model does not know "
            "the loop rings with it. A larger --torque-noise, or another sensor (--measured).",
        )  # fmt: skip
    if unseen:
        worst = min(unseen, key=lambda mode: mode.damping)
        yield Remark(
            "modes", "a vibration the estimator hardly sees",
            f"The estimator hardly sees {len(unseen)} vibration{'s' if len(unseen) > 1 else ''}: its error at "
            f"{worst.frequency:.3g} Hz ({worst.joint}) is damped by {worst.damping:.1g} only, and noise keeps it "
            "ringing, in the robot too. Measure link positions or joint torques, or raise --process-noise.",
        )  # fmt: skip


def _margins(design: Design) -> Iterator[Remark]:
    found, period = design.margins, design.specification.period
    if not found.stable:
        yield Remark(
            "margins", "the sampled loop is unstable",
            "Linearised at the goal, the sampled loop with its estimator is unstable: the nonlinear runs show how far "
            "it goes. A shorter --period, a faster estimator (--torque-noise) or a slower law (--bandwidth).",
        )  # fmt: skip
        return
    if found.delay_margin_s < LEAST_PERIODS * period:
        yield Remark(
            "margins", "a small delay margin",
            f"The loop stands {number(1e3 * found.delay_margin_s, 2)} ms of extra delay, "
            f"{number(found.delay_margin_s / period, 2)} periods: one computing step late and a slow bus may use that "
            f"up, and it would oscillate at {number(found.delay_frequency / (2.0 * np.pi), 3)} Hz. A shorter --period, "
            "or less --damping or --bandwidth.",
        )  # fmt: skip
    if found.peak_sensitivity > LARGEST_SENSITIVITY:
        yield Remark("margins", "a high peak sensitivity", _sensitive(design, found, design.state_margins))
    volts, peak = noise_volts(design), peak_input(design.response)
    if volts is not None and volts.max() > NOISE_SHARE * peak:
        yield Remark(
            "margins", "noise at the motors",
            f"The sensors' noise costs {number(float(volts.max()), 2)} {units_of(design).effort} rms at rest, "
            f"{number(100.0 * float(volts.max()) / peak, 2)} % of the step's peak input: "
            "a slower estimator (smaller --torque-noise), better sensors, or less bandwidth.",
        )  # fmt: skip


def _sensitive(design: Design, found: Margins, state: Margins) -> str:
    text = (
        f"The sensitivity peaks at {number(found.peak_sensitivity, 3)} "
        f"({number(found.sensitivity_frequency / (2.0 * np.pi), 3)} Hz), where up to 2 is usual: the open loop passes "
        f"the point of instability at a distance of {number(1.0 / found.peak_sensitivity, 2)}. "
    )
    if state.peak_sensitivity > LARGEST_SENSITIVITY or design.specification.estimator == "none":
        own = (
            f"With the true state fed back it is {number(state.peak_sensitivity, 3)}: "
            if _estimated(design)
            else ""
        )
        return text + own + "the law itself asks for too much. Less --bandwidth, or less --damping."
    return text + (
        f"The estimator raises it: with the true state fed back it is {number(state.peak_sensitivity, 3)}. A larger "
        "--torque-noise makes the estimator faster (and noise at the motors larger), a lower --bandwidth or "
        "--damping makes the law need less of it."
    )


def _estimated(design: Design) -> bool:
    return design.specification.estimator != "none"


def noise_volts(design: Design) -> np.ndarray | None:
    """RMS of each input (m,) at rest from the noise of all sensors together; None with the true state fed back."""
    noise = design.bench.noise
    if noise is None or not design.margins.stable:
        return None
    return np.sqrt(np.sum((design.margins.noise_to_input * noise) ** 2, axis=1))


def _corners(design: Design) -> Iterator[Remark]:
    found = design.tolerances
    if found is None or not found.unstable_anywhere:
        return
    robust = "" if design.game.preset == "robust" else ", or --preset robust"
    many, faster = len(found.population), f"--torque-noise, another --estimator{robust}"
    if found.with_state.share() > 0.0:
        faster = (
            f"a shorter --period or --delay, less --bandwidth{robust}: the law itself does not withstand them"
        )
    if found.unstable:
        yield Remark(
            "corners", "corners of the tolerances that are unstable",
            f"{found.unstable} of {many} plants at corners of the tolerances are unstable with the estimator as it is, "
            f"{int((found.with_state.rates >= 0.0).sum())} with the true state fed back: {faster}.",
        )  # fmt: skip
        return
    yield Remark(
        "corners", "corners that another Rᵛ makes unstable",
        f"With the estimator as it is no corner is unstable, but at another Rᵛ up to {found.unstable_anywhere} of "
        f"{many} are: the loop owes its tolerances to the noise that is assumed. More --damping{robust}.",
    )  # fmt: skip


def _guarantee(design: Design) -> Iterator[Remark]:
    found = design.guarantee.attained
    if found is not None and found.gain > design.solution.gamma:
        yield Remark(
            "attained", "a disturbance beyond γ",
            f"The disturbance found attains {number(found.gain)}, more than γ = {number(design.solution.gamma)}: the "
            "law does not keep its level there, as the truncated V or the sampling period leaves too much out.",
        )  # fmt: skip
    if not design.guarantee.expenses:
        return
    budget = design.guarantee.expenses[-1].budget
    if np.isfinite(budget.level) and budget.start <= budget.level and not budget.kept:
        yield Remark(
            "budget", "a budget that does not last",
            f"The step begins inside the region, but its parts spend {number(budget.total, 3)} of the "
            f"{number(budget.level - budget.start, 3)} that are left: for this step nothing follows from the region. "
            "A shorter --period, a faster estimator, or a smaller step.",
        )  # fmt: skip


def _regions(design: Design) -> Iterator[Remark]:
    for low, high in design.shrinking:
        yield Remark(
            "region",
            "a degree that shrinks the region",
            f"degree {high} allows a smaller step than degree {low}.",
        )
    if design.inside is False:
        yield Remark(
            "region", "a start outside the sampled region",
            "The step starts, with the integrals that the controller chooses there so that the input does not jump, "
            "outside the region in which nothing was found against the solution of degree "
            f"{design.chosen.degree} (V there is above {design.chosen.level:.4g}); the simulation shows what happens. "
            "The table's steps start at the integrals where V is smallest.",
        )  # fmt: skip
    s = design.specification
    if not design.chosen.looked:
        asked = (
            f"The regions were not looked at: {len(design.problem.state_names)} states take minutes. "
            "Ask for it with --rays 50."
        )
        text = asked if s.rays is None else "The regions were not looked at, as asked."
        yield Remark("region", "regions not looked at", text)
    elif np.isnan(design.chosen.level):
        yield Remark(
            "region", "no region", f"No region is claimed for the law that runs: {design.chosen.limit}."
        )


def _rigid(design: Design) -> Iterator[Remark]:
    if design.specification.compare_rigid and design.rigid is None:
        yield Remark(
            "law", "no rigid design",
            "No rigid design was made: a penalty that is code says nothing about a rigid robot.",
        )  # fmt: skip
