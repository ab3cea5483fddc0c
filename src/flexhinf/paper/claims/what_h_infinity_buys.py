"""What H∞ itself buys against a nonlinear LQR, at equal effort: our question, not the paper's.

A smaller γ and a smaller R2 both make a loop stiffer and both take more volts, so a pair of laws of the same weights
says nothing. Three families are swept: H∞ over γ, nonlinear LQR (γ = ∞) over R2, and H∞ over R2 at the γ/γ* of the
settings, and compared where they take the same peak voltage. LQR with gravity compensation over R2 stands beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from flexhinf.analysis.trade_off import TradeOffCurve, TradeOffPoint, scaled_effort, sweep_effort, sweep_gamma
from flexhinf.baselines import GravityCompensatedLQR
from flexhinf.hinf import HJISolution
from flexhinf.loop import Sine, Step, Trajectory
from flexhinf.paper.claims.judgement import Judged
from flexhinf.paper.disturbance_gain import GainRuns, stated_disturbances
from flexhinf.paper.experiments import (
    CHANNELS,
    FREQUENCY,
    LOAD_FROM,
    STEP_DURATION,
    TORQUE,
    Experiments,
    load_numbers,
)
from flexhinf.paper.loop_setup import EFFORT, GOALS, in_two_threads, name_goal
from flexhinf.plant import Law
from flexhinf.report import (
    SERIES,
    Claim,
    Column,
    Figure,
    Table,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
)

#: R2 over the paper's, and γ/γ*, in the order of growing effort.
EFFORTS = (1.4, 1.0, 0.5, 0.25, 0.12, 0.06, 0.025)
RATIOS = (5.0, 3.0, 2.0, 1.5, 1.25, 1.1)

#: Deviations nearer to each other than this are called equal.
EQUAL = 0.01

#: The deviations under load that are compared: key, name, unit; angles in rad.
CASES = {
    "link_torque step": "torque step at the link, peak deviation",
    "motor_torque step": "torque step at the motor, peak deviation",
    "link_torque sine": f"{FREQUENCY:g} Hz at the link, RMS deviation",
    "motor_torque sine": f"{FREQUENCY:g} Hz at the motor, RMS deviation",
}

#: The cost: the largest voltage of the 180° step, the larger of the paper's two commands.
COST = "peak_180"

TEXT = "H∞ itself, not just nonlinearity, pays: NL-H∞ deviates less under disturbance torques than a nonlinear LQR."
CRITERION = (
    f"At equal peak voltage of the 180° step, in all four cases (a torque of {TORQUE:g} N·m as a step, and at "
    f"{FREQUENCY:g} Hz, at the link and at the motor), NL-H∞ over γ deviates less by more than 1 % than the "
    "nonlinear LQR (γ = ∞, same degree, same state weights) over R2, interpolated between the laws of its sweep."
)


# Compute -------------------------------------------------------------------------------------------------
def measure_law(experiments: Experiments, law: Law) -> dict[str, float]:
    """Peak volts and overshoot (%) of both steps, deviations (rad) of the four cases; infinite where a run diverged."""
    setup, start = experiments.setup, LOAD_FROM
    jobs: list[tuple[str, Callable[[], Trajectory]]] = [
        (f"{round(math.degrees(g))}", lambda g=g: setup.run(law, Step(g), STEP_DURATION)) for g in GOALS
    ]
    for c in CHANNELS:
        for kind, signal in (("step", Step(TORQUE, at=start)), ("sine", Sine(TORQUE, FREQUENCY, at=start))):
            jobs.append((f"{c} {kind}", lambda c=c, s=signal: experiments.load_response(law, s, c)))
    runs = dict(zip([name for name, _ in jobs], in_two_threads(lambda job: job[1](), jobs), strict=True))
    found: dict[str, float] = {}
    for goal in ("90", "180"):
        m = runs[goal].metrics()
        found[f"peak_{goal}"], found[f"overshoot_{goal}"] = (
            _known(m[key]) for key in ("peak_input", "overshoot_percent")
        )
    for case in CASES:
        run = runs[case]
        found[case] = _known(load_numbers(run)["peak_deviation_rad"]) if "step" in case else _rms_late(run)
    return found


def measure_gain(experiments: Experiments, law: Law) -> dict[str, float]:
    """Gains from the paper's d to the paper's z (R2 = 10, whatever R2 the law was made for), true state fed back.

    ``norm``: H∞ norm of the linear loop in the hanging equilibrium; ``gain``: the largest √(∫|z|²/∫|d|²) of the stated
    disturbances that keep the link within ±180°.
    """
    runs = GainRuns(experiments.setup, law)
    attained = in_two_threads(lambda named: runs.attained(named[1]), stated_disturbances())
    return {
        "norm": float(runs.search.small()[0]),
        "gain": max((a.gain for a in attained if a.inside), default=math.inf),
    }


def _known(value: float | None) -> float:
    return math.inf if value is None else float(value)


def _rms_late(run: Trajectory) -> float:
    """RMS deviation over the last four seconds, rad."""
    if run.diverged_at is not None:
        return math.inf
    late = run.time >= run.time[-1] - 4.0
    error = run.tracked("link_position")[late] - run.signals["reference"][late, 0]
    return float(np.sqrt(np.mean(error**2)))


def trade_off_curves(experiments: Experiments) -> dict[str, TradeOffCurve]:
    """H∞ over γ, nonlinear LQR over R2, H∞ over R2, and the simplest rival over R2."""
    setup = experiments.setup
    degree, ratio = setup.settings.degree, setup.settings.gamma_ratio

    known: dict[bytes, dict[str, float]] = {}  # two of the curves share a law

    def measure(law: Law) -> Mapping[str, float]:
        key = law.law_data.tobytes()
        if key not in known:
            known[key] = {**measure_law(experiments, law), **measure_gain(experiments, law)}
        return known[key]

    most = EFFORTS[:5]  # the others take more volts than the smallest γ does
    simple = []
    for factor in most:
        law = GravityCompensatedLQR.design(scaled_effort(setup.problem, factor))
        simple.append(TradeOffPoint(factor, law, measure(law)))
    return {
        "NL-H∞ over γ": sweep_gamma(setup.problem, RATIOS, degree, measure),
        "nonlinear LQR over R2": sweep_effort(setup.problem, EFFORTS, degree, measure),
        f"NL-H∞ of γ = {ratio:g} γ* over R2": sweep_effort(setup.problem, most, degree, measure, ratio),
        "LQR + gravity compensation over R2": TradeOffCurve(
            "LQR", "R2 over the problem's own", tuple(simple)
        ),
    }


def ratios_at_equal_peak(ours: TradeOffCurve, rival: TradeOffCurve, cost: str = COST) -> np.ndarray:
    """Deviation of each law of a curve over that of the rival at the same peak voltage, (laws, cases).

    Laws outside the rival's range of voltages are left out.
    """
    found = []
    for point in ours.points:
        others = [rival.at_cost(cost, case, point.figures[cost]) for case in CASES]
        if all(other is not None for other in others):
            pairs = zip(CASES, others, strict=True)
            found.append([point.figures[case] / other for case, other in pairs if other is not None])
    return np.array(found).reshape(-1, len(CASES))


# Judge -----------------------------------------------------------------------------------------------------
def judge_h_infinity(experiments: Experiments) -> Judged:
    """what-h-infinity-buys."""
    curves = trade_off_curves(experiments)
    over_gamma, lqr, over_effort, simple = curves.values()
    ratios = ratios_at_equal_peak(over_gamma, lqr)
    if not len(ratios):
        verdict = "not judged"
    elif np.all(ratios < 1.0 - EQUAL):
        verdict = "holds"
    else:
        verdict = "ties" if np.all(np.abs(ratios - 1.0) <= EQUAL) else "fails"
    claim = Claim(
        "what-h-infinity-buys",
        TEXT,
        verdict,
        _evidence(ratios, over_gamma, lqr, over_effort, simple),
        "" if verdict != "fails" else _repair(ratios),
        ("figure-trade-off", "table-trade-off", "table-laws"),
        CRITERION,
    )
    numbers = {
        "deviation_over_lqr_at_equal_peak": {
            case: [float(v) for v in ratios[:, k]] for k, case in enumerate(CASES)
        },
        "curves": {
            name: [
                {"value": _finite(p.value), **{k: _finite(v) for k, v in p.figures.items()}} for p in c.points
            ]
            for name, c in curves.items()
        },
    }
    blocks = (_figure(curves), _table(curves), _laws_table(experiments, curves))
    return Judged(claim, blocks, numbers, ours=True)


def _repair(ratios: np.ndarray) -> str:
    if np.any(np.all(ratios < 1.0 - EQUAL, axis=1)):
        return "some γ of the sweep, not all of them; see the table."
    return "no γ of the sweep: at its voltage the nonlinear LQR with another R2 deviates as little or less."


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _per_cent(ratios: np.ndarray) -> str:
    """``3.0 % less to 9.1 % more``, ``0.5 to 10.4 % more``."""
    low, high = (100.0 * (float(edge) - 1.0) for edge in (ratios.min(), ratios.max()))
    if low < 0.0 < high:
        return f"{-low:.1f} % less to {high:.1f} % more"
    small, large = sorted((abs(low), abs(high)))
    return f"{small:.1f} to {large:.1f} % {'less' if high <= 0.0 else 'more'}"


def _evidence(
    ratios: np.ndarray,
    over_gamma: TradeOffCurve,
    lqr: TradeOffCurve,
    over_effort: TradeOffCurve,
    simple: TradeOffCurve,
) -> str:
    if not len(ratios):
        return "The sweeps share no range of peak voltages: 0 laws could be compared."
    text = (
        f"At equal peak voltage of the 180° step the {len(ratios)} laws over γ deviate {_per_cent(ratios)} than the "
        "nonlinear LQR, over the four cases."
    )
    at_90 = ratios_at_equal_peak(over_gamma, lqr, "peak_90")
    if len(at_90):
        text += f" At equal peak voltage of the 90° step it is {_per_cent(at_90)}."
    same_gamma, others = (ratios_at_equal_peak(curve, lqr) for curve in (over_effort, simple))
    if len(same_gamma):
        text += f" NL-H∞ over R2 deviates {_per_cent(same_gamma)}."
    if len(others):
        text += (
            f" The simplest rival, LQR with gravity compensation over R2, deviates {_per_cent(others)} than the "
            "nonlinear LQR."
        )
    pairs = [(p.figures["norm"], lqr.at_cost(COST, "norm", p.figures[COST])) for p in over_gamma.points]
    gains = [ours / other for ours, other in pairs if other is not None and math.isfinite(ours)]
    if gains:
        text += (
            f" In the criterion that H∞ is made for, the norm from the paper's d to the paper's z, it "
            f"has {_per_cent(np.array(gains))} at equal voltage."
        )
    return text + " The step responses are no evidence for H∞: the nonlinear LQR has them too."


# Present ---------------------------------------------------------------------------------------------------
def _law_and_ratio(law: Law) -> tuple[str, str | None]:
    """Name, and γ over γ* of the law's own problem."""
    if not isinstance(law, HJISolution):
        return "LQR + gravity", None
    if math.isinf(law.gamma):
        return "NL-LQR", "∞"
    return "NL-H∞", f"{law.gamma / law.gamma_star:g}"


def _degrees(value: float) -> float | None:
    return math.degrees(value) if math.isfinite(value) else None


def _table(curves: Mapping[str, TradeOffCurve]) -> Table:
    rows = [
        (
            *_law_and_ratio(p.law),
            EFFORT * (p.value if curve.parameter.startswith("R2") else 1.0),
            *(_finite(p.figures[k]) for k in ("peak_90", "peak_180", "overshoot_90", "overshoot_180")),
            *(_degrees(p.figures[case]) for case in CASES),
            _finite(p.figures["norm"]),
            _finite(p.figures["gain"]),
        )
        for curve in curves.values()
        for p in curve.points
    ]
    columns = (
        "law",
        "γ/γ*",
        Column("R2"),
        *(Column(f"{name_goal(g)} peak", "V", 1) for g in GOALS),
        *(Column(f"{name_goal(g)} overshoot", "%", 2) for g in GOALS),
        *(Column(name, "°", 2) for name in CASES.values()),
        Column("H∞ norm d → z", "", 1),
        Column("largest √(∫|z|²/∫|d|²)", "", 1),
    )
    caption = (
        "The four sweeps (NL-LQR: nonlinear LQR): same state weights, degree, estimator, noise and seed. γ* is that "
        "of each law's own problem. The gains are from the paper's d to the paper's z with R2 = 10 for all laws: "
        "norm of the linear loop at rest, and largest over the stated pulses and sines."
    )
    return Table(columns, rows, caption, "table-trade-off")


@house_style()
def _figure(curves: Mapping[str, TradeOffCurve]) -> Figure:
    panels = {
        "link_torque step": ("torque step at link", "°"),
        "motor_torque step": ("torque step at motor", "°"),
        "norm": ("H∞ norm d → z", ""),
    }
    figure, axes = new_figure(len(panels), height=7.0)
    for ax, (key, (name, unit)) in zip(axes, panels.items(), strict=True):
        for (family, curve), colour, marker in zip(curves.items(), SERIES, "os^D", strict=False):
            points = [(p.figures[COST], p.figures[key]) for p in curve.points]
            points = [(c, math.degrees(v) if unit else v) for c, v in points if math.isfinite(c * v)]
            if points:
                ax.plot(*zip(*points, strict=True), color=colour, marker=marker, markersize=4.5, label=family)
        label(ax, name, unit)
    axes[-1].set_xlabel("peak voltage of the 180° step (V)")
    figure.align_ylabels(axes)
    legend(axes[0])
    caption = (
        f"Trade-off: what each law takes at most (peak voltage of the 180° step) against what it holds: the largest "
        f"deviation from 90° under a torque of {TORQUE:g} N·m, and the H∞ norm from the paper's d to the paper's z "
        "of the linear loop at rest. Lower and further left is better."
    )
    return Figure("figure-trade-off", figure_to_svg(figure), caption)


def _laws_table(experiments: Experiments, curves: Mapping[str, TradeOffCurve]) -> Table:
    """Laws of the same weights and R2, side by side; unequal in effort, so nothing is judged by it."""
    setup = experiments.setup
    lqr = next(p for p in curves["nonlinear LQR over R2"].points if p.value == 1.0)
    measured = {
        "NL-H∞": (setup.nonlinear, measure_law(experiments, setup.nonlinear)),
        "L-H∞": (setup.linear, measure_law(experiments, setup.linear)),
        "nonlinear LQR (γ = ∞)": (lqr.law, lqr.figures),
        "LQR + gravity compensation": (setup.gravity_lqr, measure_law(experiments, setup.gravity_lqr)),
    }
    rows = []
    for name, (law, figures) in measured.items():
        steps = [_finite(figures[f"{key}_{goal}"]) for goal in ("90", "180") for key in ("overshoot", "peak")]
        fed_back = experiments.load_response(law, Step(TORQUE, at=LOAD_FROM), estimator=None)
        peak = load_numbers(fed_back)["peak_deviation_rad"]
        deviations = [_degrees(figures[case]) for case in CASES]
        rows.append((name, *steps, *deviations, None if peak is None else math.degrees(peak)))
    columns: list[Column | str] = ["law"]
    for goal in ("90°", "180°"):
        columns += [Column(f"{goal} overshoot", "%", 2), Column(f"{goal} peak", "V", 1)]
    columns += [Column(name, "°", 2) for name in CASES.values()]
    columns.append(Column("torque step at the link, true state fed back", "°", 2))
    caption = (
        "Four laws of the same weights and R2, with the same estimator, noise and seed; they take different volts, so "
        "nothing is judged by this table. With the true state fed back (last column) the deviation is that of the law "
        "alone: the estimator knows nothing of the torque."
    )
    return Table(columns, rows, caption, "table-laws")
