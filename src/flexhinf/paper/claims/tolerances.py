"""The loop withstands the tolerances of Tables 1 and 2.

Computed on the true plant with its coil, in equilibrium at 90° and at 180°: all 2048 corners of the tolerances, each
tolerance alone at both ends, and the plants of Figs. 9 and 10. The paper gives no R^v, so the verdict is for the R^v of
the settings, and four forms of it are swept over and shown beside it. Runs of 30 s of the nonlinear loop without noise
must agree with the growth rates of the linear one.

Where the loop does not withstand the tolerances: the smallest change of the penalty with which it does.

x2, x3 and x4 get the weights s (9, 30, 9), see `judgement`. The smallest s is found by bisection on growth rates: no
plant of the population (all corners among them) may be unstable at either goal for any R^v of the forms asked for.
Runs confirm it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import (
    ALL_STATES,
    LINK_VELOCITIES,
    MOTOR_VELOCITIES,
    VELOCITIES,
    GrowthRates,
    ProcessNoise,
)
from flexhinf.errors import FlexhinfError
from flexhinf.hinf import HJISolution
from flexhinf.loop import Step, Trajectory
from flexhinf.paper.claims.judgement import (
    LARGEST_SCALE,
    SMALLEST_SCALE,
    Judged,
    damped_law,
    scaled_weights,
    smallest_change,
)
from flexhinf.paper.experiments import STEP_DURATION, TORQUE
from flexhinf.paper.loop_setup import GOALS, LONG, PaperSetup, affordable, name_goal
from flexhinf.paper.tolerance_study import (
    NO_ESTIMATOR,
    OTHER_MEASUREMENT,
    OTHER_NOISE,
    OTHER_RATIO,
    SWEPT,
    ToleranceStudy,
    growth_with,
    other_design,
    swept_noises,
    unstable_of,
)
from flexhinf.report import (
    MUTED,
    SERIES,
    Claim,
    Column,
    Figure,
    Paragraph,
    Table,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    number,
    settling_band,
)

TEXT = "The loop withstands the parameter tolerances of Tables 1 and 2."
CRITERION = (
    "With the R^v of the settings, coil in the plant, the loop in equilibrium at 90° and at 180° is stable with "
    "every plant tried: all 2048 corners of the tolerances, each tolerance alone, and the 100 sampled plants of "
    "Figure 9. The paper gives no R^v; other forms of it are shown and not judged."
)

#: Plants run at each goal: the worst by growth rate, every tolerance alone, and every tenth of those sampled.
WORST, EVERY = 8, 10

#: Below this RMS velocity, rad/s, a run has decayed to rounding and its rate says nothing.
ROUNDING = 1e-9

#: Rates nearer to zero than this, 1/s, cannot be distinguished by a run of 30 s.
UNDECIDED = 2e-3

#: Early and late part of a run, as fractions of it.
EARLY, LATE = (0.4, 0.6), (0.8, 1.0)


def judge(setup: PaperSetup) -> Judged:
    """withstands-tolerances."""
    study = ToleranceStudy.of(setup, setup.nonlinear)
    agreement = _agreement(setup, study)
    figures = ["table-tolerances"]
    blocks: list[Any] = [_table(study)]
    if study.estimated:
        blocks.append(_share_figure(study))
        figures.append("figure-tolerances")
    repairs, repair = [], ""
    if not study.holds or any(rates.unstable for goal in GOALS for rates in study.swept[goal]):
        repairs = find_repairs(setup, study)
        repair = _repair_text(setup, study, repairs)
        blocks += [cost_table(setup, repairs), _worst_figure(setup, study, repairs)]
        figures += ["table-repair", "figure-worst-plant"]
    if study.holds and repair:  # with the settings' R^v, but not over the sweep
        blocks.append(Paragraph(f"No plant is unstable over the sweep of R^v with {repair}"))
        repair = ""
    claim = Claim(
        "withstands-tolerances",
        TEXT,
        "holds" if study.holds else "fails",
        f"{_evidence(study)} {agreement.text}",
        repair,
        tuple(figures),
        CRITERION,
    )
    return Judged(claim, tuple(blocks), _numbers(study, agreement, repairs))


def _numbers(study: ToleranceStudy, agreement: Agreement, repairs: Sequence[Repair]) -> dict[str, Any]:
    chosen = study.chosen
    numbers: dict[str, Any] = {
        "plants": len(study.setup.population),
        "corners": study.count("corner"),
        "unstable": {name_goal(g): chosen[g].unstable for g in GOALS},
        "unstable_corners": {name_goal(g): unstable_of(chosen[g], "corner") for g in GOALS},
        "fastest_growth_per_s": {name_goal(g): _finite(chosen[g].fastest) for g in GOALS},
        "swept_unstable_corners": {
            name_goal(g): [
                [r.noise.form, r.noise.q, unstable_of(r, "corner")] for r in study.swept[g] if r.noise
            ]
            for g in GOALS
        },
        "runs": agreement.runs,
        "runs_that_agree": agreement.agree,
    }
    if repairs:
        numbers["repair_scale"] = {r.name: r.scale for r in repairs}
    return numbers


# Sentences and table -----------------------------------------------------------------------------------
def _finite(rate: float) -> float | None:
    return float(rate) if math.isfinite(rate) else None


def _evidence(study: ToleranceStudy) -> str:
    parts = []
    for goal in GOALS:
        rates = study.chosen[goal]
        pace = (
            "some plant has no equilibrium"
            if math.isinf(rates.fastest)
            else f"slowest mode {number(rates.fastest, decimals=3)}/s"
        )
        parts.append(
            f"at {name_goal(goal)} {unstable_of(rates, 'corner')} of {study.count('corner')} corners and "
            f"{unstable_of(rates, 'draw')} of {study.count('draw')} sampled plants ({pace})"
        )
    which = (
        f"R^v = {number(study.setup.settings.process_noise)} I"
        if study.estimated
        else "the true state fed back"
    )
    text = f"Unstable with {which}: {'; '.join(parts)}."
    growth = max(rates.fastest for rates in study.chosen.values())
    if 0.0 <= growth < math.inf:
        factors = [math.exp(min(growth * seconds, 50.0)) for seconds in (STEP_DURATION, LONG)]
        text += (
            f" The fastest growth makes a factor of {factors[0]:.2g} in {STEP_DURATION:g} s and of {factors[1]:.2g} in "
            f"{LONG:g} s."
        )
    return text


def _table(study: ToleranceStudy) -> Table:
    rows: list[tuple[Any, ...]] = []
    for goal in GOALS:
        name, forms = name_goal(goal), dict.fromkeys(r.noise.form for r in study.swept[goal] if r.noise)
        rows.append((name, "true state fed back", *_cells(study, [study.true_state[goal]])))
        if study.estimated:
            q = study.setup.settings.process_noise
            rows.append((name, f"R^v = {number(q)} I (settings)", *_cells(study, [study.chosen[goal]])))
        rows += [(name, f"q on {form}", *_cells(study, study.of_form(form, goal))) for form in forms]
    other = other_design(study.setup)
    noises = f"q = {number(OTHER_NOISE)} on velocities, R^n = {number(OTHER_MEASUREMENT)}"
    which = f"law about 90°, γ = {OTHER_RATIO:g} γ* of its own problem, {noises}"
    rows.append((name_goal(math.pi / 2), which, *_cells(study, [other])))
    columns = (
        "goal",
        "R^v",
        Column("corners unstable, fewest over q"),
        Column("corners unstable, most over q"),
        Column("sampled plants unstable, most over q"),
        Column("fastest growth", "1/s", 3),
        "one tolerance alone suffices",
    )
    caption = (
        f"Plants with which the loop is unstable, of {study.count('corner')} corners and {study.count('draw')} sampled "
        f"ones, with the paper's penalty and the coil; each form of R^v with q from {number(SWEPT[0])} to "
        f"{number(SWEPT[-1])}. A negative growth is the decay of the slowest loop; – where some plant has no "
        "equilibrium. The last row is another design of the paper's weights, by this program and not by the paper."
    )
    return Table(columns, rows, caption, "table-tolerances")


def _cells(study: ToleranceStudy, found: Sequence[GrowthRates]) -> tuple[Any, ...]:
    corners = [unstable_of(rates, "corner") for rates in found]
    alone = study.sufficient_alone(found)
    text = "; ".join(alone[:3]) + (f" and {len(alone) - 3} more" if len(alone) > 3 else "")
    return (
        min(corners),
        max(corners),
        max(unstable_of(rates, "draw") for rates in found),
        _finite(max(rates.fastest for rates in found)),
        text or "none",
    )


# Runs ------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Agreement:
    """What runs of the nonlinear loop say of the growth rates.

    Attributes
    ----------
    error : float
        Largest |rate of a run − rate of the linear loop| where both are known, 1/s.
    """

    runs: int
    agree: int
    error: float

    @property
    def text(self) -> str:
        """For a sentence."""
        text = (
            f"{self.agree} of {self.runs} runs of {LONG:g} s agree with the growth rates of the linear loop"
        )
        return text + (f" (within {number(self.error, 2)}/s)." if math.isfinite(self.error) else ".")


def growth_rate(velocity: np.ndarray) -> tuple[float, float]:
    """(rate in 1/s, late RMS in rad/s) of the link's velocity (N,) in a run of `LONG`; both infinite if it diverged."""
    if np.isnan(velocity).any():
        return np.inf, np.inf
    fractions = np.linspace(0.0, 1.0, len(velocity))
    sizes = [
        max(float(np.sqrt(np.mean(velocity[(fractions >= first) & (fractions <= last)] ** 2))), 1e-300)
        for first, last in (EARLY, LATE)
    ]
    return float(np.log(sizes[1] / sizes[0]) / (LONG * (LATE[0] - EARLY[0]))), sizes[1]


def _growth_rates(
    setup: PaperSetup, law: HJISolution, goal: float, plants: Sequence[int]
) -> list[tuple[float, float]]:
    """`growth_rate` of runs without noise to a goal, with these plants of the population."""
    samples = np.arange(round(LONG / setup.settings.period) + 1)
    ensemble = setup.ensemble(
        law, Step(goal), LONG, inductance=True, noise=False, kept=["state.link_velocity"], instants=samples
    )
    found = ensemble.run([setup.population.values[k] for k in plants])
    return [growth_rate(velocity) for velocity in found.kept[:, :, 0]]


def _agreement(setup: PaperSetup, study: ToleranceStudy) -> Agreement:
    """Runs of 30 s with a stated subset of the plants against the growth rates of the linear loop."""
    jobs = []
    for goal in GOALS:
        rates, kinds = study.chosen[goal].rates, setup.population.kinds
        sampled = np.flatnonzero(kinds == "draw")[::EVERY]
        plants = dict.fromkeys([*np.argsort(-rates)[:WORST], *np.flatnonzero(kinds == "single"), *sampled])
        jobs += [(goal, int(k), float(rates[k])) for k in plants]
    jobs = jobs[:: max(1, len(jobs) // affordable(len(jobs), setup.settings.period))]
    found = [
        rate
        for goal in GOALS
        for rate in _growth_rates(setup, setup.nonlinear, goal, [k for at, k, _ in jobs if at == goal])
    ]
    agree, errors = 0, [0.0]
    for (_, _, expected), (measured, size) in zip(jobs, found, strict=True):
        decayed = size < ROUNDING and expected < 0.0
        undecided = abs(expected) < UNDECIDED and abs(measured - expected) < UNDECIDED
        agree += bool(decayed or undecided or (measured >= 0.0) == (expected >= 0.0))
        if not decayed and math.isfinite(measured) and math.isfinite(expected):
            errors.append(abs(measured - expected))
    return Agreement(len(jobs), agree, max(errors))


def _repair_text(setup: PaperSetup, study: ToleranceStudy, repairs: Sequence[Repair]) -> str:
    if not repairs:
        return "no weights s (9, 30, 9) on x2, x3, x4 with s up to 12.8 do it."
    parts = []
    for found in repairs:
        grown = 0
        for goal in GOALS:
            worst = np.argsort(-study.chosen[goal].rates)[: affordable(WORST, setup.settings.period)]
            runs = _growth_rates(setup, found.law, goal, worst.tolist())
            grown += sum(rate >= 0.0 and size > ROUNDING for rate, size in runs)
        confirmed = (
            "the worst plants' runs decay" if not grown else f"{grown} of the worst plants' runs still grow"
        )
        parts.append(f"s = {found.scale:.2f} for {found.name} ({confirmed})")
    text = "weights s (9, 30, 9) on x2, x3, x4, smallest s by bisection: " + " and ".join(parts) + "."
    lost = left_unstable(setup, repairs[-1].law) if study.estimated else {}
    if any(lost.values()):
        named = " and ".join(f"{count} with q on {form}" for form, count in lost.items() if count)
        text += (
            f" Even with the last one corners of the {study.count('corner')} are unstable at the worst q: {named}. "
            "The estimator's noise belongs to the design."
        )
    return text


# Figures ---------------------------------------------------------------------------------------------
@house_style()
def _share_figure(study: ToleranceStudy) -> Figure:
    """Unstable corners over q, for all forms of R^v."""
    figure, panels = new_figure(len(GOALS), height=5.2)
    forms = dict.fromkeys(r.noise.form for r in study.swept[GOALS[0]] if r.noise)
    for axes, goal in zip(panels, GOALS, strict=True):
        for form, colour, marker in zip(forms, SERIES, "os^D", strict=False):
            found = study.of_form(form, goal)
            counts = [unstable_of(rates, "corner") for rates in found]
            axes.plot(SWEPT, counts, color=colour, marker=marker, markersize=4.5, label=f"Rᵛ = q on {form}")
        q = study.setup.settings.process_noise
        if q > 0.0:
            axes.axvline(
                q,
                color=MUTED,
                linewidth=1.0,
                linestyle=(0, (1.0, 1.6)),
                label="q of the settings (all states)",
            )
        axes.set_xscale("log")
        axes.set_ylim(-0.03 * study.count("corner"), 1.03 * study.count("corner"))
        label(axes, f"unstable corners at {name_goal(goal)}", "")
    panels[-1].set_xlabel("q, variance added at each sample (rad² or rad²/s²)")
    legend(panels[0])
    caption = (
        f"How many of the {study.count('corner')} corners of the tolerances make the loop unstable at 90° (above) "
        "and at 180° (below), over the R^v that the paper does not give; the paper's penalty, coil in the true plant."
    )
    return Figure("figure-tolerances", figure_to_svg(figure), caption)


@house_style()
def _worst_figure(setup: PaperSetup, study: ToleranceStudy, repairs: Sequence[Repair]) -> Figure:
    """The link's error in 30 s with the plant that grows fastest, with the paper's and with repaired penalties."""
    goal = max(GOALS, key=lambda g: study.chosen[g].fastest)
    k = study.chosen[goal].worst
    laws: Mapping[str, HJISolution] = {
        "the paper's penalty": setup.nonlinear,
        **{f"s = {r.scale:.2f}, repaired for {r.name}".replace("R^v", "Rᵛ"): r.law for r in repairs},
    }
    figure, panels = new_figure(len(laws), height=1.0 + 1.5 * len(laws))
    plant = {"true_values": setup.population.values[k], "inductance": True, "noise": False}
    errors = {name: _error(setup.run(law, Step(goal), LONG, **plant), goal) for name, law in laws.items()}
    reach = min(95.0, 1.1 * max(float(np.abs(error).max()) for _, error in errors.values()))
    for axes, (name, (time, error)), colour in zip(panels, errors.items(), SERIES, strict=False):
        axes.plot(time, np.clip(error, -reach, reach), color=colour, linewidth=1.0)
        axes.set_ylim(-reach, reach)
        settling_band(axes, 0.0, np.degrees(goal))
        axes.axvline(STEP_DURATION, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)))
        label(axes, "link − command", "°", name)
    which = "the R^v of the settings" if study.estimated else "the true state fed back"
    caption = (
        f"Error of the link after a step to {name_goal(goal)}, from 1 s on, with the plant that grows fastest "
        f"({setup.population.describe(k)}), {which}, no noise. The dotted line at {STEP_DURATION:g} s is where a "
        "usual step response ends; the band is ±2 % of the step."
    )
    return Figure("figure-worst-plant", figure_to_svg(figure), caption)


def _error(run: Trajectory, goal: float) -> tuple[np.ndarray, np.ndarray]:
    """(time, error in degrees) from 1 s on; of a run that diverged earlier, all of it."""
    shown = run.time >= min(1.0, 0.5 * run.time[-1])
    return run.time[shown], np.degrees(run.signal("state", "link_position")[shown] - goal)


#: Of the worst R^v at each goal, how many are bisected on, with how many plants. All are checked after.
WORST_NOISES, WORST_PLANTS = 3, 16

#: How often what the check of all brings up is added and the bisection begun again.
ROUNDS = 4

#: s is rounded up to a multiple of this.
STEP_OF_SCALE = 0.05

#: By goal and R^v: the plants to bisect on.
Watched = dict[tuple[float, ProcessNoise | None], np.ndarray]


@dataclass(frozen=True)
class Repair:
    """A penalty with which no plant is unstable.

    Attributes
    ----------
    name : str
        For which R^v.
    scale : float
        s.
    weights : dict
        By state.
    slowest : float
        Largest growth rate over all plants, goals and R^v asked for, 1/s; negative.
    """

    name: str
    scale: float
    weights: dict[str, float]
    law: HJISolution
    slowest: float


def find_repairs(setup: PaperSetup, study: ToleranceStudy) -> list[Repair]:
    """For R^v = q I, and for q on the velocities too; for the true state fed back where nothing estimates."""
    asked = {"R^v = q I": (ALL_STATES,), "R^v = q I and q on the velocities": (ALL_STATES, VELOCITIES)}
    if not study.estimated:
        asked = {NO_ESTIMATOR: ()}
    found: list[Repair] = []
    for name, forms in asked.items():
        begin = found[-1].scale - STEP_OF_SCALE if found else SMALLEST_SCALE
        repair = smallest_repair(setup, study, name, forms, max(begin, SMALLEST_SCALE))
        if repair is not None:
            found.append(repair)
    return found


def smallest_repair(
    setup: PaperSetup, study: ToleranceStudy, name: str, forms: Sequence[str], begin: float = SMALLEST_SCALE
) -> Repair | None:
    """The smallest s above `begin` for which no plant is unstable with the settings' R^v or any of these forms;
    None without one.
    """
    noises = (None, *swept_noises(forms))
    known = {(g, r.noise): r for g in GOALS for r in (study.chosen[g], *study.swept[g]) if r.noise in noises}
    watched = _worst(known)
    for _ in range(ROUNDS):
        scale = smallest_change(lambda s: _withstands(setup, study, s, watched), begin, LARGEST_SCALE)
        if scale is None:
            return None
        scale = STEP_OF_SCALE * math.ceil(scale / STEP_OF_SCALE - 1e-9)
        law = damped_law(setup, scale)
        found = growth_with(setup, law, noises, estimated=study.estimated)
        rates = [(goal, each) for goal in GOALS for each in found[goal]]
        slowest = max(each.fastest for _, each in rates)
        if slowest < 0.0:
            return Repair(name, scale, scaled_weights(setup, scale), law, slowest)
        for goal, each in rates:
            if each.unstable:
                plants = each.plants[np.argsort(-each.rates)[:WORST_PLANTS]]
                watched[goal, each.noise] = np.union1d(watched.get((goal, each.noise), plants), plants)
        begin = scale / 1.5
    return None


def _worst(known: dict[tuple[float, ProcessNoise | None], GrowthRates]) -> Watched:
    """The worst plants with the worst R^v at each goal."""
    watched: Watched = {}
    for goal in GOALS:
        keys = sorted((key for key in known if key[0] == goal), key=lambda key: -known[key].fastest)
        for key in keys[:WORST_NOISES]:
            watched[key] = np.argsort(-known[key].rates)[:WORST_PLANTS]
    return watched


def _withstands(setup: PaperSetup, study: ToleranceStudy, scale: float, watched: Watched) -> bool:
    try:
        law = damped_law(setup, scale)
    except FlexhinfError:
        return False
    for goal in GOALS:
        noises = [noise for at, noise in watched if at == goal]
        plants = np.unique(np.concatenate([p for (at, _), p in watched.items() if at == goal]))
        found = growth_with(setup, law, noises, plants, (goal,), study.estimated)[goal]
        if any(each.unstable for each in found):
            return False
    return True


def left_unstable(setup: PaperSetup, law: HJISolution) -> dict[str, int]:
    """Corners that a repair leaves unstable, at the worst q and goal, with the two forms of R^v it is not made for."""
    others = (LINK_VELOCITIES, MOTOR_VELOCITIES)
    corners = np.flatnonzero(setup.population.kinds == "corner")
    found = growth_with(setup, law, swept_noises(others), corners)
    rates = [each for goal in GOALS for each in found[goal]]
    return {
        form: max(unstable_of(r, "corner") for r in rates if r.noise is not None and r.noise.form == form)
        for form in others
    }


# What it costs -------------------------------------------------------------------------------------------
def cost_table(setup: PaperSetup, repairs: Sequence[Repair]) -> Table:
    """What the repairs cost the nominal arm."""
    rows = [_cost(setup, "the paper's", 0.0, setup.nonlinear)]
    rows += [_cost(setup, f"repaired for {r.name}", r.scale, r.law) for r in repairs]
    columns: list[Column | str] = ["penalty", Column("s", "", 2), Column("γ* of its problem", "", 1)]
    for goal in GOALS:
        columns += [
            Column(f"{name_goal(goal)} overshoot", "%", 2),
            Column(f"{name_goal(goal)} settling", "s", 2),
            Column(f"{name_goal(goal)} peak", "V", 1),
        ]
    columns.append(Column(f"deviation under {TORQUE:g} N·m at the link", "°", 2))
    caption = (
        "What the repair costs the nominal arm: weights s (9, 30, 9) on x2, x3, x4, the others the paper's."
    )
    return Table(columns, rows, caption, "table-repair")


def _cost(setup: PaperSetup, name: str, scale: float, law: HJISolution) -> list[Any]:
    row: list[Any] = [name, scale, law.gamma_star]
    for goal in GOALS:
        m = setup.run(law, Step(goal), STEP_DURATION).metrics()
        row += [m["overshoot_percent"], m["settling_time_s"], m["peak_input"]]
    pushed = setup.run(law, Step(GOALS[0]), 14.0, disturbance={"link_torque": Step(TORQUE, at=8.0)})
    if pushed.diverged_at is not None:
        return [*row, None]
    off = np.abs(pushed.signal("state", "link_position") - GOALS[0])[pushed.time >= 8.0]
    return [*row, float(np.degrees(off.max()))]
