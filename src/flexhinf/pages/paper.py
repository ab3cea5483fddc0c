"""The report of `flexhinf paper`: verdict per claim, what fails first, evidence under each claim, figures, settings."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from flexhinf.analysis import FORMS
from flexhinf.loop import Trajectory
from flexhinf.loop.simulation.metrics import RunMetrics
from flexhinf.options import option_name
from flexhinf.paper.claims import NOT_JUDGED
from flexhinf.paper.loop_setup import (
    FREQUENCY,
    GOALS,
    INITIAL_VARIANCE,
    LOAD_FROM,
    LONG,
    SAMPLED_PLANTS,
    TORQUE,
    PaperSetup,
    ToleranceRun,
    name_goal,
)
from flexhinf.paper.reproduction import Reproduction
from flexhinf.paper.responses import ENERGIES, LAWS, RunGain
from flexhinf.paper.settings import PaperSettings
from flexhinf.paper.tolerances import SWEPT, ToleranceStudy, unstable_of
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    Claims,
    Column,
    Fact,
    Figure,
    JudgedClaim,
    Listing,
    Page,
    PageBlock,
    Paragraph,
    Section,
    Table,
    by_verdict,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    panels,
    quantile_band,
    reference_line,
    settling_band,
    summary,
    time_response,
    to_json,
)

MISPRINTS = (
    ("Algorithm 1, step 5", "second block X̂ + γ√P again", "X̂ − γ√P"),
    ("Algorithm 1 and Eq. (10)", "γ is the spread", "called spread here; γ is the attenuation level"),
    ("Sec. 5, ẋ4", "+B x4 and −K(x1 − x3)", "−B x4 and +K(x1 − x3), as in Eq. (2) and Sec. 6"),
    ("Eq. (7)", "[pᵀg1 − pᵀg2], [d − u], assumption (6)", "[pᵀg1, pᵀg2], [dᵀ, uᵀ], assumption (4)"),
    ("Sec. 5, h", "Q x5 only", "with 60 x1, as in Eq. (11)"),
    ("Sec. 4", "1e-4 < α < 1", "α = 1 (Table 3) is allowed"),
    ("Sec. 6, g1 and g2", "six rows", "g1 = (0, 0, 0, 0, −1)ᵀ and g2 = (0, 0, 0, 0.9, 0)ᵀ"),
    ("Eq. (8)", "g2 R2⁻¹ g2", "g2 R2⁻¹ g2ᵀ"),
    ("Eq. (10) with Table 3", "five sigma points", "2n + 1 = 9 for n = 4; λ = 0, W0ᵐ = 0, W0ᶜ = 2, Wᵢ = 1/8"),
    ("Sec. 2", "gravity inside C, and G", "gravity once"),
    ("Eq. (2) against Sec. 5", "u, a torque", "the motor's voltage V; its torque is k_m (V − k_b ẋ4)/R"),
    ("Eqs. (3) and (5)", "the disturbance is ω, then d", "one signal, d"),
    ("Eqs. (3), (7) and (8)", "h1, then h", "one penalty, h"),
    ("Eq. (6)", "pᵀ(f(x)) + g1 d + g2 u)", "pᵀ(f + g1 d + g2 u)"),
    ("Sec. 5, states of the UKF", "x1, x3, x3, x4", "x1, x2, x3, x4"),
    ("Sec. 6, f", "fifth row x1", "x1; −x_d comes in through g1"),
    ("Sec. 6, ẋ4 and Table 2", "b, and B", "one friction constant, 0.1"),
    ("Figs. 3–12 and Secs. 5–6", "degrees, and radians", "radians; figures show degrees"),
    ("Sec. 1", "four sections", "Secs. 1–6; the conclusion, a second Sec. 6, is called Sec. 7 here"),
    ("Sec. 3", "asymptotically stable at u = 0", "with u = k(x): x5 is an integrator"),
    ("Figs. 7, 9, 10, 12", "captions lost", "tracking; tolerances, measured and estimated; sine disturbance"),
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


#: Pose about which the paper's problem is solved.
HANGING = "at the hanging rest (0°)"

#: Colours of the laws, and of the places of a torque.
COLOURS = {
    "nonlinear": SERIES[0], "linear": SERIES[1], "link_torque": SERIES[0], "motor_torque": SERIES[1],
}  # fmt: skip

#: The first part of a run on a sampled plant, s, shown in full; the rest is shown enlarged.
FIRST_PART = 6.0


# Drawings ----------------------------------------------------------------------------------------------
def positions(run: Trajectory) -> tuple[np.ndarray, np.ndarray | None]:
    """Link position as measured and as estimated, degrees; None for the estimate if the true state is fed back."""
    measured, estimate = (np.degrees(run.signal(kind, "link_position")) for kind in ("output", "estimate"))
    return measured, None if (run.names["output"] == run.names["estimate"]) else estimate


def draw_laws(runs: Mapping[str, Trajectory], voltage: bool = False, step: float | None = None) -> str:
    """Draw motor voltages of several laws, or link positions (degrees) with the command and a step's settling band."""
    quantity = ("motor voltage", "V") if voltage else ("link position", "°")
    figure, (axes,) = new_figure(1, height=None if voltage else 3.6, labels=[quantity])
    if not voltage:
        first = next(iter(runs.values()))
        command = np.degrees(first.signal("reference", "link_position"))
        reference_line(axes, first.time, command)
        if step is not None:
            settling_band(axes, float(command[-1]), step)
    for law, run in runs.items():
        signals = (run.signal("input", "motor_voltage"), None) if voltage else positions(run)
        time_response(axes, run.time, *signals, name=LAWS[law], colour=COLOURS[law])
    legend(axes)
    return figure_to_svg(figure)


def draw_loads(runs: Mapping[str, Trajectory]) -> str:
    """Draw link position, its error enlarged from the disturbance on, and torque; a colour per place of the torque."""
    figure, (position, error, torque) = new_figure(
        3, height=6.6, labels=(("link position", "°"), ("link − command", "°"), ("disturbance torque", "N·m"))
    )
    longest = max(runs.values(), key=lambda run: len(run.time))
    command = np.degrees(longest.signal("reference", "link_position"))
    reference_line(position, longest.time, command)
    goal, largest, load = float(command[-1]), 0.0, longest.signals["disturbance"].sum(axis=1)
    settling_band(error, 0.0, goal)
    for channel, run in runs.items():
        colour = COLOURS[channel]
        name, (link, estimate) = f"torque at the {channel.removesuffix('_torque')}", positions(run)
        time_response(position, run.time, link, estimate, name=name, colour=colour)
        late = run.time >= LOAD_FROM - 1.0
        off = None if estimate is None else estimate[late] - goal
        time_response(error, run.time[late], link[late] - goal, off, colour=colour)
        largest = max(largest, float(np.abs(link[late] - goal).max(initial=0.0)))
    torque.plot(longest.time, load, color=SERIES[3])  # alike at both places
    reach = 1.1 * min(max(largest, 1.0), 180.0)
    error.set_ylim(-reach, reach)
    legend(position)
    return figure_to_svg(figure)


# Many plants -------------------------------------------------------------------------------------------
def worst_runs(runs: Sequence[ToleranceRun]) -> dict[str, int]:
    """Indices of the runs that overshoot most and settle last, or end farthest; one that diverged is the worst."""

    def worst(read: Callable[[RunMetrics], Sequence[float | None]]) -> int:
        ranks = [[math.inf if value is None else value for value in read(run.metrics)] for run in runs]
        return max(range(len(runs)), key=ranks.__getitem__)

    return {
        "largest overshoot": worst(lambda m: [m["overshoot_percent"]]),
        "settles last": worst(lambda m: [m["settling_time_s"], m["steady_state_error"]]),
    }


@house_style()
def draw_sampled(runs: Sequence[ToleranceRun], kind: str) -> str:
    """Draw all runs on sampled plants, the two worst apart; the first seconds above, the rest enlarged below."""
    whole = [run for run in runs if run.diverged_at is None]
    figure, ((above,), (below,)) = panels(2, 1, 5.6)
    if not whole:
        above.text(0.5, 0.5, "every run diverged", ha="center", transform=above.transAxes)
        return figure_to_svg(figure)
    time = whole[0].time
    values = np.array([getattr(run, kind) for run in whole])
    apart = list(zip(worst_runs(whole).items(), (INK, SERIES[1])))
    for axes, part in ((above, time <= FIRST_PART), (below, time >= FIRST_PART)):
        if axes is above:
            settling_band(axes, 90.0, 90.0)
        quantile_band(axes, time[part], values[:, part])
        for (name, k), colour in apart:
            axes.plot(time[part], values[k, part], color=colour, linewidth=1.1, dashes=(5.0, 1.5), label=name)
        label(axes, "link position", "°")
        axes.set_xlabel("time (s)")
    figure.align_ylabels([above, below])
    legend(above)
    return figure_to_svg(figure)


def _worst_table(runs: Sequence[ToleranceRun]) -> Table:
    return Table.of(
        (
            Column("run", key="run"),
            Column("overshoot", "%", 2, key="overshoot_percent"),
            Column("settling", "s", 2, key="settling_time_s"),
            Column(
                "largest error in the last 3 s", "°", 3, key="steady_state_error", scale=math.degrees(1.0)
            ),
            Column("changes of the plant", key="changes"),
        ),
        [
            {**runs[k].metrics, "run": name, "changes": runs[k].changes.replace("-", "−")}
            for name, k in worst_runs(runs).items()
        ],
        "The worst runs of Figures 9 and 10, of the true link; – where a run diverged or did not settle.",
        "table-worst-runs",
        stacks=True,
    )


#: Title, caption, and drawing as SVG, by the figure's number in the paper.
FIGURES: dict[str, tuple[str, str | Callable[[PaperSetup], str], Callable[[PaperSetup], str]]] = {
    "03": (
        "Step to 180°: link position.",
        "The paper shows NL-H∞ alone; the linear law of the same γ is added. Dotted: command; grey: ±2 % of the step.",
        lambda e: draw_laws(e.runs("03"), step=180.0),
    ),
    "04": (
        "Step to 180°: motor voltage.",
        "The law is held between samples.",
        lambda e: draw_laws(e.runs("03"), voltage=True),
    ),
    "05": (
        "Step to 90°: link position by NL-H∞ and by L-H∞.",
        "The measured and the estimated curve lie on each other. Dotted: command; grey: ±2 % of the step.",
        lambda e: draw_laws(e.runs("05"), step=90.0),
    ),
    "06": (
        "Step to 90°: motor voltage by NL-H∞ and by L-H∞.",
        "At rest at 90° the motor holds the full gravity torque M g L: 10.9 V.",
        lambda e: draw_laws(e.runs("05"), voltage=True),
    ),
    "07": (
        "Tracking π + sin(πt/10): link position.",
        "The law acts on the angle from hanging and on the integral of the error, so the arm follows a moving command "
        "with a delay.",
        lambda e: draw_laws(e.runs("07")),
    ),
    "08": (
        "Tracking π + sin(πt/10): motor voltage.",
        "",
        lambda e: draw_laws(e.runs("07"), voltage=True),
    ),
    "09": (
        "Step to 90° under the tolerances of Tables 1 and 2: link position as measured.",
        lambda e: (
            f"{SAMPLED_PLANTS} plants sampled uniformly, with coil inductance; below, the rest of the 30 s enlarged. "
            f"{sum(run.diverged_at is not None for run in e.sampled_plants)} runs diverged and are not drawn."
        ),
        lambda e: draw_sampled(e.sampled_plants, "output"),
    ),
    "10": (
        "The runs of Figure 9 as estimated.",
        "The estimator's model is the nominal plant without coil; the same where the true state is fed back.",
        lambda e: draw_sampled(e.sampled_plants, "estimate"),
    ),
    "11": (
        "Step to 90° with a step disturbance: link position, and its error from one second before the torque on.",
        f"A torque of {TORQUE:g} N·m from t = {LOAD_FROM:g} s on, at the link or at the motor. "
        "The paper gives neither size nor place.",
        lambda e: draw_loads(e.runs("11")),
    ),
    "12": (
        "Step to 90° with a sinusoidal disturbance: link position, and its error from one second before the torque on.",
        f"A torque of {TORQUE:g} N·m at {FREQUENCY:g} Hz from t = {LOAD_FROM:g} s on, at the link or at the motor.",
        lambda e: draw_loads(e.runs("12")),
    ),
}


# Figures of the evidence -----------------------------------------------------------------------------
@house_style()
def _gain_figure(setup: PaperSetup, worst: Sequence[RunGain]) -> Figure:
    figure, (axes,) = new_figure(
        height=3.0, labels=[("attained gain", "")], across="energy of the disturbance, ∫|d|² (rad² s)"
    )
    known = [run for run in worst if math.isfinite(run.gain)]
    axes.plot([run.energy for run in known], [run.gain for run in known], color=SERIES[0], linewidth=1.2)
    for inside, fill in ((True, SERIES[0]), (False, "none")):
        points = np.array([[run.energy, run.gain] for run in known if run.inside == inside]).reshape(-1, 2)
        name = f"worst found, |x1| {'≤' if inside else 'beyond'} 180°"
        axes.plot(*points.T, "o", color=SERIES[0], markerfacecolor=fill, markersize=5, label=name)
    axes.axhline(setup.gamma, color=SERIES[1], linewidth=1.4, label="γ of the design")
    axes.axhline(setup.gamma_star, color=MUTED, linewidth=1.2, linestyle=(0, (4.0, 2.2)), label="γ*")
    axes.set_xlim(0.7 * ENERGIES[0], 1.4 * ENERGIES[-1])  # first: one known energy alone has no range
    axes.set(xscale="log", ylim=(0.0, None))
    legend(axes)
    return Figure(
        "figure-gain",
        figure_to_svg(figure),
        "The largest √(∫|z|²/∫|d|²) found by ascent on the disturbance, a lower bound of the loop's gain, against "
        "the γ of the design and γ* of the paper's problem.",
    )


@house_style()
def _unstable_figure(setup: PaperSetup, study: ToleranceStudy) -> Figure | None:
    if not study.estimated:
        return None
    corners, q = study.count("corner"), setup.settings.process_noise
    figure, goals = new_figure(
        len(GOALS),
        height=5.2,
        labels=[(f"unstable corners at {name_goal(goal)}", "") for goal in GOALS],
        across="q, variance added at each sample (rad² or rad²/s²)",
    )
    for axes, goal in zip(goals, GOALS, strict=True):
        for form, colour, marker in zip(FORMS, SERIES, "os^D", strict=False):
            counts = [unstable_of(rates, "corner") for rates in study.of_form(form, goal)]
            axes.plot(SWEPT, counts, color=colour, marker=marker, markersize=4.5, label=f"Rᵛ = q on {form}")
        if q > 0.0:
            name = "q of the settings (all states)"
            axes.axvline(q, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)), label=name)
        axes.set_xscale("log")
        axes.set_ylim(-0.03 * corners, 1.03 * corners)
    legend(goals[0])
    return Figure(
        "figure-tolerances",
        figure_to_svg(figure),
        f"How many of the {corners} corners of the tolerances make the loop unstable at 90° (above) "
        "and at 180° (below), over the R^v that the paper does not give; the paper's penalty, coil in the true plant.",
    )


#: Figures of the evidence, by the claims that have one.
EVIDENCE: dict[str, Callable[[PaperSetup, Any], Figure | None]] = {
    "gain-attained": _gain_figure, "withstands-tolerances": _unstable_figure,
}  # fmt: skip


class PaperDrawings:
    """The figures of the paper as SVG, by their numbers there, and those of the evidence, by the claims.

    Each is drawn once, as soon as its numbers are known.
    """

    def __init__(self) -> None:
        self.figures: dict[str, str] = {}
        self.evidence: dict[str, Figure | None] = {}

    def draw(self, setup: PaperSetup, claim: JudgedClaim | None = None) -> None:
        """Draw the figures of the paper, or that of a claim, if they are not there yet."""
        if claim is None:
            self.figures = self.figures or {number: draw(setup) for number, (_, _, draw) in FIGURES.items()}
        elif claim.id in EVIDENCE and claim.id not in self.evidence:
            self.evidence[claim.id] = EVIDENCE[claim.id](setup, claim.data)


# Page ------------------------------------------------------------------------------------------------
def paper_files(reproduction: Reproduction, drawings: PaperDrawings | None = None) -> dict[str, str]:
    """Files of the report: index.html, metrics.json, and every figure of the paper, figure_03.svg … figure_12.svg.

    `drawings`: what is drawn already.
    """
    drawings = drawings or PaperDrawings()
    for claim in (None, *reproduction.claims, *reproduction.questions):
        drawings.draw(reproduction.setup, claim)
    return {
        "index.html": _page(reproduction, drawings).html(),
        "metrics.json": to_json(reproduction.metrics),
        **{f"figure_{number}.svg": drawing for number, drawing in drawings.figures.items()},
    }


def _page(reproduction: Reproduction, drawings: PaperDrawings) -> Page:
    setup, claims = reproduction.setup, reproduction.claims
    counters = {"table": count(1), "figure": count(13)}  # in the order of the page; the paper has 12 figures
    figures: list[Figure | Table] = []
    for number, (title, caption, _) in FIGURES.items():
        text = caption if isinstance(caption, str) else caption(setup)
        figures.append(
            Figure(f"figure-{number}", drawings.figures[number], f"{title} {text}", f"Figure {int(number)}")
        )
        if number == "09":
            figures.append(_numbered(_worst_table(setup.sampled_plants), counters))

    def evidence(claims: Sequence[JudgedClaim]) -> list[JudgedClaim]:  # those that fail first
        numbered: list[JudgedClaim] = []
        for claim in by_verdict(claims):
            blocks = filter(None, (*claim.blocks, drawings.evidence.get(claim.id)))
            numbered.append(replace(claim, blocks=[_numbered(block, counters) for block in blocks]))
        return numbered

    paper, own = evidence(claims), evidence(reproduction.questions)
    gain, kind = ", ".join(f"{k:.4g}" for k in setup.linear.law_data), setup.settings.estimator
    return Page(
        "Nonlinear H∞ control of a flexible joint, reproduced",
        "Elsa & Akbari (2014): the single-link arm of Sec. 6, its Figures 3–12 and its claims, computed again from its "
        "equations and tables. No printed curve was compared with a computed one, so a claim is judged by what it "
        f"says. The law acts on {'the true state' if kind == 'none' else f'the estimate of the {kind.upper()}'}.",
        summary(claims),
        (
            Section(
                "Verdict per claim",
                (
                    Paragraph(
                        "Each claim has a criterion, fixed before the result, a verdict computed from it, and the "
                        "numbers behind it under “Evidence”; another option may turn a verdict. Nothing here is "
                        "proved: stable or unstable is by the growth rates of the linear loop, the rest by runs and "
                        "searches."
                    ),
                    Claims(claims),
                    Table(
                        ("the paper says", "why it is not judged"),
                        NOT_JUDGED,
                        "What no claim here judges.",
                        "table-not-judged",
                        stacks=True,
                    ),
                ),
                "claims",
                True,
            ),
            Section("Figures 3–12", tuple(figures), "figures", True),
            Section("Evidence, claim by claim", paper, "evidence"),
            Section(
                "Our own question",
                (
                    Paragraph(
                        "The paper does not ask this. It is not counted among its claims. What repairs the claims that "
                        "fail, and what H∞ buys against a nonlinear LQR, is computed at the default settings in "
                        "“Studies beside the paper's claims” of the documentation."
                    ),
                    *own,
                ),
                "ours",
            ),
            Section(
                "What was taken instead",
                (
                    Table(
                        ("where", "printed", "taken"),
                        MISPRINTS,
                        "Misprints of the paper.",
                        "table-misprints",
                        stacks=True,
                    ),
                    Table(
                        ("not given", "chosen"),
                        OPEN,
                        "What the paper does not give.",
                        "table-open",
                        stacks=True,
                    ),
                ),
                "instead",
            ),
            Section(
                "The law",
                (
                    Paragraph(
                        f"V of degree {setup.settings.degree} solves Eq. (8) at γ = {setup.gamma:.4f}; its linear part "
                        f"is u = ({gain}) · (x1, x2, x3, x4, x5)."
                    ),
                    Listing(setup.nonlinear.report()),
                ),
                "law",
            ),
        ),
        reproduction.command,
        setup.settings.seed,
        _settings(setup),
        _facts(setup),
    )


def _numbered(block: PageBlock, counters: Mapping[str, Iterator[int]]) -> Figure | Table:
    if isinstance(block, Table):
        k = next(counters["table"])
        return replace(block, id=f"table-{k}", caption=f"Table {k}. {block.caption}")
    assert isinstance(block, Figure)
    k = next(counters["figure"])
    return replace(block, id=f"figure-{k}", label=f"Figure {k}")


def _facts(setup: PaperSetup) -> list[Fact]:
    ratio = f"{setup.settings.gamma_ratio:g} γ*; the paper gives none"
    numbers = [
        Fact(
            "γ* of the paper's problem",
            f"{setup.gamma_star:.4f}",
            note=f"the smallest feasible one, {HANGING}",
        ),
        Fact("γ of the paper's law here", f"{setup.gamma:.4f}", note=ratio),
    ]
    for goal, runs in (("180°", setup.runs("03")), ("90°", setup.runs("05"))):
        own, linear = (runs[name].metrics()["overshoot_percent"] for name in ("nonlinear", "linear"))
        overshoot = ("diverged", "") if own is None else (round(own, 2), "%")
        note = "L-H∞ diverged" if linear is None else f"L-H∞: {linear:.1f} %"
        numbers.append(Fact(f"overshoot, {goal} step", *overshoot, note))
    return numbers


def _settings(setup: PaperSetup) -> dict[str, list[Fact]]:
    s, steps = setup.settings, [setup.loop(setup.nonlinear, coil, None).sub_steps for coil in (False, True)]
    units = {"period": "s", "process_noise": "q of Rᵛ = q I", "measurement_noise": "rad²"}
    rows = {
        "Options": [
            (
                name.replace("_", " "),
                value,
                units.get(name, ""),
                f"{'default' if value == getattr(PaperSettings, name) else 'option'} {option_name(name)}",
            )
            for name, value in vars(s).items()
        ],
        "Arm": [
            (p.name.replace("_", " "), f"{p.value:g} ± {p.tolerance:g} %", p.unit, p.source)
            for p in setup.arm.parameters
        ],
        "Synthesis": [
            ("penalty", "(60 x1, 0, 0, 0, 300 x5), R2 = 10", "", "Eq. (11)"),
            (f"γ* of the paper's problem, {HANGING}", setup.gamma_star, "", "bisection, relative 1e-8"),
            ("γ", setup.gamma, "", "ours"),
            ("expansion", "about the hanging rest", "", "Sec. 6"),
        ],
        "Estimator": [
            ("α, β, κ", "1, 2, 0", "", "Table 3"),
            ("initial estimate", "rest", "", "ours"),
            ("P0", f"{INITIAL_VARIANCE:g} I", "", "ours"),
            ("simulated noise", f"{math.sqrt(s.measurement_noise):.3g}", "rad (standard deviation)", "as Rⁿ"),
        ],
        "Simulation": [
            ("sub-steps per period", steps[0], "", "Runge–Kutta, plant without coil"),
            ("sub-steps per period", steps[1], "", "Runge–Kutta, plant with coil"),
            ("plants sampled", SAMPLED_PLANTS, "", "ours"),
            ("length of runs under tolerances", LONG, "s", "ours"),
            ("disturbance torque", TORQUE, "N·m", "ours"),
            ("disturbance from", LOAD_FROM, "s", "ours"),
            ("disturbance frequency", FREQUENCY, "Hz", "ours"),
        ],
    }
    return {name: [Fact(*row) for row in group] for name, group in rows.items()}
