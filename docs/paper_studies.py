"""Our own studies of Elsa & Akbari (2014), beside the claims that ``flexhinf paper`` judges; see paper_studies.md.

    python docs/paper_studies.py        computes every study and prints its tables (a few minutes)

What repairs the claims that fail, what H∞ buys against a nonlinear LQR of the same weights, how another design of the
same weights stands the tolerances, and what bounds on states in the filter do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.analysis import (
    ALL_STATES,
    VELOCITIES,
    DisturbanceSearch,
    EquilibriumLoop,
    GrowthRates,
    ProcessNoise,
    growth_rates,
)
from flexhinf.baselines import GravityCompensatedLQR
from flexhinf.errors import FlexhinfError
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.loop import Sine, Step, Trajectory
from flexhinf.paper import PaperSettings
from flexhinf.paper.loop_setup import (
    CHANNELS,
    EFFORT,
    FREQUENCY,
    GOALS,
    INITIAL_VARIANCE,
    LOAD_FROM,
    SINE,
    STEP_DURATION,
    TORQUE,
    TRACKING_DURATION,
    PaperSetup,
    load_numbers,
    name_goal,
    tracking_numbers,
)
from flexhinf.paper.responses import HORIZON, STATED_DISTURBANCES, TRACKING_LIMIT, RunGain, run_gain
from flexhinf.paper.tolerances import SWEPT, ToleranceStudy, growth_with, unstable_of
from flexhinf.plant import GeneralisedPlant, Law

#: Weights by state that s multiplies. A motion at 3.3 rad/s, about the bandwidth of the loop, counts alike as position
#: and as velocity under them; the paper's penalty (11) leaves x2, x3 and x4 free, and with them the joint's vibration.
DAMPING_WEIGHTS = {"link_velocity": 9.0, "motor_position": 30.0, "motor_velocity": 9.0}
#: Where the search for s begins and ends, and the step to which it is rounded up.
SMALLEST_SCALE, LARGEST_SCALE, STEP_OF_SCALE = 0.05, 12.8, 0.05
#: How many of the worst R^v at each goal are bisected on, with how many plants, and how often the check of all may add.
WORST_NOISES, WORST_PLANTS, ROUNDS = 3, 16, 4

#: R2 over the paper's, and γ/γ*, in the order of growing effort.
EFFORTS, RATIOS = (1.4, 1.0, 0.5, 0.25, 0.12, 0.06, 0.025), (5.0, 3.0, 2.0, 1.5, 1.25, 1.1)
#: Deviations under load that are compared; the cost is the largest voltage of the 180° step.
CASES, COST = tuple(f"{c} {kind}" for c in CHANNELS for kind in ("step", "sine")), "peak_180"

#: Bad starts of the estimate: x̂(0|−1), rad and rad/s, with the standard deviations of a P0 that admits them.
STARTS = {"off by 17°": (0.3, -0.5, -0.1, -0.5), "off by 86°, moving": (0.0, 5.0, 1.5, 5.0)}
SPREAD = (1.0, 20.0, 3.0, 20.0)


# Curves of laws ------------------------------------------------------------------------------------------
# Two families of laws are compared at equal cost, never at equal weights: a smaller γ and a smaller R2 both buy a
# stiffer loop with more input, so a single pair of laws says nothing about which family is better.

#: Figures of one law by name, SI units; infinite where its run diverged.
Measure = Callable[[HJISolution], Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class TradeOffPoint:
    """One law of a sweep.

    Attributes
    ----------
    value : float
        Of the parameter that is swept: R2 over the problem's own, or γ over γ*.
    figures : mapping of str to float
        What the caller measured, SI units.
    """

    value: float
    law: Law
    figures: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class TradeOffCurve:
    """The laws of one sweep, in its order.

    Attributes
    ----------
    parameter : str
        What is swept.
    """

    name: str
    parameter: str
    points: tuple[TradeOffPoint, ...]

    def at_cost(self, cost: str, benefit: str, value: float) -> float | None:
        """`benefit` where the curve has this `cost`, interpolated in logarithms; None outside the curve.

        Parameters
        ----------
        cost, benefit : str
            Names of two positive figures.
        value : float
            Of the cost.
        """
        pairs = sorted((p.figures[cost], p.figures[benefit]) for p in self.points)
        pairs = [(c, b) for c, b in pairs if math.isfinite(c) and math.isfinite(b) and c > 0.0 and b > 0.0]
        if not pairs or not pairs[0][0] <= value <= pairs[-1][0]:
            return None
        costs, benefits = np.log(np.array(pairs)).T
        return float(np.exp(np.interp(math.log(value), costs, benefits)))


def scaled_effort(problem: GeneralisedPlant, factor: float) -> GeneralisedPlant:
    """The problem with R2 times a factor."""
    effort = factor * np.asarray(problem.penalty.effort, dtype=float)
    return replace(problem, penalty=replace(problem.penalty, effort=effort))


def sweep_effort(
    problem: GeneralisedPlant,
    factors: Sequence[float],
    degree: int,
    measure: Measure,
    ratio: float = math.inf,
) -> TradeOffCurve:
    """Laws of one problem over R2: nonlinear LQR for γ = ∞, nonlinear H∞ for a finite γ/γ*.

    Parameters
    ----------
    factors : sequence of float
        R2 over the problem's own.
    degree : int
        Of V.
    measure : callable
        law → figures by name.
    ratio : float
        γ/γ*, of each problem's own γ*.

    Raises
    ------
    InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        As `flexhinf.hinf.solve_hji`.
    """
    points = []
    for factor in factors:
        scaled = scaled_effort(problem, factor)
        gamma = math.inf if math.isinf(ratio) else ratio * smallest_gamma(scaled)
        law = solve_hji(scaled, gamma, degree)
        points.append(TradeOffPoint(float(factor), law, dict(measure(law))))
    name = "nonlinear LQR" if math.isinf(ratio) else f"nonlinear H∞, γ = {ratio:g} γ*"
    return TradeOffCurve(name, "R2 over the problem's own", tuple(points))


def sweep_gamma(
    problem: GeneralisedPlant, ratios: Sequence[float], degree: int, measure: Measure
) -> TradeOffCurve:
    """Nonlinear H∞ laws of one problem over γ/γ*; ∞ is the nonlinear LQR of the same weights.

    Raises
    ------
    InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        As `flexhinf.hinf.solve_hji`.
    """
    star, points = smallest_gamma(problem), []
    for ratio in ratios:
        law = solve_hji(problem, math.inf if math.isinf(ratio) else ratio * star, degree)
        points.append(TradeOffPoint(float(ratio), law, dict(measure(law))))
    return TradeOffCurve("nonlinear H∞", "γ over γ*", tuple(points))


# Repairs -------------------------------------------------------------------------------------------------
def smallest_change(holds: Callable[[float], bool], start: float, limit: float) -> float | None:
    """Smallest value above `start` for which `holds`, to one per cent; None if there is none up to `limit`.

    The value is doubled until the claim holds, then bisected between the last two.
    """
    low, high = start, 2.0 * start
    while not holds(high):
        low, high = high, 2.0 * high
        if low >= limit:
            return None
    while high - low > 0.01 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def damped_law(setup: PaperSetup, scale: float) -> HJISolution:
    """NL-H∞ for the paper's weights and s (9, 30, 9) on x2, x3, x4, at the same ratio of its own γ*."""
    names, penalty = setup.problem.state_names, setup.arm.penalty
    assert penalty is not None  # the paper's arm has its own
    own = dict(zip(names, penalty.weights(names), strict=True))
    return setup.law({name: float(own[name] + scale * DAMPING_WEIGHTS.get(name, 0.0)) for name in names})


def tracking_weight(setup: PaperSetup) -> tuple[float | None, float]:
    """The smallest weight of x5 with which π + sin(πt/10) is tracked, and the largest error with it, rad."""

    def error(weight: float) -> float:
        law = setup.law({"link_position": 60.0, "link_position_integral": weight})
        found = tracking_numbers(setup.run(law, SINE, TRACKING_DURATION))["largest_error_rad"]
        return math.inf if found is None else found

    weight = smallest_change(lambda w: error(w) <= TRACKING_LIMIT, 300.0, 32.0 * 300.0)
    return weight, math.inf if weight is None else error(weight)


@dataclass(frozen=True)
class Repair:
    """A scale s of the penalty with which no plant within the tolerances is unstable, and its law."""

    name: str
    scale: float
    law: HJISolution


def find_repairs(setup: PaperSetup, study: ToleranceStudy) -> list[Repair]:
    """For R^v = q I, and for q on the velocities too."""
    found: list[Repair] = []
    for name, forms in (
        ("R^v = q I", (ALL_STATES,)),
        ("R^v = q I and q on the velocities", (ALL_STATES, VELOCITIES)),
    ):
        begin = found[-1].scale - STEP_OF_SCALE if found else SMALLEST_SCALE
        repair = smallest_repair(setup, study, name, forms, max(begin, SMALLEST_SCALE))
        found += [] if repair is None else [repair]
    return found


def smallest_repair(
    setup: PaperSetup, study: ToleranceStudy, name: str, forms: Sequence[str], begin: float
) -> Repair | None:
    """The smallest s above `begin` for which no plant is unstable with the settings' R^v or any of these forms."""
    noises = (None, *(ProcessNoise(form, q) for form in forms for q in SWEPT))
    known = {(g, r.noise): r for g in GOALS for r in (study.chosen[g], *study.swept[g]) if r.noise in noises}
    watched: dict[tuple[float, ProcessNoise | None], np.ndarray] = {}  # plants to bisect on
    for goal in GOALS:
        keys = sorted((key for key in known if key[0] == goal), key=lambda key: -known[key].fastest)
        watched |= {key: _worst_plants(known[key]) for key in keys[:WORST_NOISES]}

    def withstands(scale: float) -> bool:
        try:
            law = damped_law(setup, scale)
        except FlexhinfError:
            return False
        for goal in GOALS:
            some = {noise: plants for (at, noise), plants in watched.items() if at == goal}
            plants = np.unique(np.concatenate(list(some.values())))
            if any(rates.unstable for rates in growth_with(setup, law, tuple(some), plants, (goal,))[goal]):
                return False
        return True

    for _ in range(ROUNDS):
        scale = smallest_change(withstands, begin, LARGEST_SCALE)
        if scale is None:
            return None
        scale = STEP_OF_SCALE * math.ceil(scale / STEP_OF_SCALE - 1e-9)
        law = damped_law(setup, scale)
        unstable = [
            (goal, each)
            for goal, rates in growth_with(setup, law, noises).items()
            for each in rates
            if each.unstable
        ]
        if not unstable:
            return Repair(name, scale, law)
        for goal, each in unstable:
            plants = _worst_plants(each)
            watched[goal, each.noise] = np.union1d(watched.get((goal, each.noise), plants), plants)
        begin = scale / 1.5
    return None


def _worst_plants(rates: GrowthRates) -> np.ndarray:
    return rates.plants[np.argsort(-rates.rates)[:WORST_PLANTS]]


def other_design(setup: PaperSetup) -> GrowthRates:
    """A loop that `flexhinf design` made of the paper's weights: law about 90°, γ = 1.5 γ*, q = 1e-7 on velocities."""
    problem: Any = setup.arm.problem(pose=math.pi / 2)
    law = solve_hji(problem, gamma=1.5 * smallest_gamma(problem), degree=4)
    noise = np.diag(ProcessNoise(VELOCITIES, 1e-7).covariance(setup.model.states))
    filter = ExtendedKalmanFilter(
        setup.model,
        1e-3,
        noise,
        1e-8,
        law.operating_point[: setup.model.n],
        INITIAL_VARIANCE,
        form="covariance",
    )
    coil = setup.arm.plant(inductance=True)
    loop = EquilibriumLoop(law, filter, coil, 1e-3, math.pi / 2, moving=True, latency=0)
    return growth_rates(loop, setup.population)[0]


def repair_costs(setup: PaperSetup, repairs: Sequence[Repair]) -> Iterable[Sequence[Any]]:
    """Metrics of the nominal arm, with the paper's penalty and with each repair."""
    goals = [name_goal(goal) for goal in GOALS]
    yield (
        "penalty",
        "s",
        "γ*",
        *(f"{g} {what}" for g in goals for what in ("overshoot %", "settling s", "peak V")),
    )
    for name, scale, law in (
        ("the paper's", 0.0, setup.nonlinear),
        *((r.name, r.scale, r.law) for r in repairs),
    ):
        metrics = [setup.run(law, Step(goal), STEP_DURATION).metrics() for goal in GOALS]
        keys = ("overshoot_percent", "settling_time_s", "peak_input")
        yield (name, scale, law.gamma_star, *(m[key] for m in metrics for key in keys))


# What H∞ buys --------------------------------------------------------------------------------------------
def in_two_threads(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """Map in two threads, after the first item alone, which compiles what the others share."""
    with ThreadPoolExecutor(2) as pool:
        return [*map(function, items[:1]), *pool.map(function, items[1:])]


def measure_law(setup: PaperSetup, law: Law) -> dict[str, float]:
    """Peak volts and overshoot (%) of both steps, deviations (rad) of the four cases; infinite where a run diverged."""
    jobs: dict[str, Callable[[], Trajectory]] = {}
    for goal in GOALS:
        jobs[f"{round(math.degrees(goal))}"] = lambda g=goal: setup.run(law, Step(g), STEP_DURATION)
    signals = {"step": Step(TORQUE, at=LOAD_FROM), "sine": Sine(TORQUE, FREQUENCY, at=LOAD_FROM)}
    for case in CASES:
        channel, kind = case.split()
        jobs[case] = lambda c=channel, s=signals[kind]: setup.load_response(law, s, c)
    runs = dict(zip(jobs, in_two_threads(lambda job: job(), list(jobs.values())), strict=True))
    found: dict[str, float] = {}
    for goal in ("90", "180"):
        m = runs[goal].metrics()
        found[f"peak_{goal}"], found[f"overshoot_{goal}"] = (
            _known(m["peak_input"]),
            _known(m["overshoot_percent"]),
        )
    for case in CASES:
        run = runs[case]
        found[case] = _known(load_numbers(run)["peak_deviation_rad"]) if "step" in case else _late_rms(run)
    return found


def measure_gain(setup: PaperSetup, law: Law) -> dict[str, float]:
    """Gains from the paper's d to the paper's z (R2 = 10, whatever R2 the law was made for), true state fed back.

    ``norm``: H∞ norm of the linear loop in the hanging equilibrium; ``gain``: the largest √(∫|z|²/∫|d|²) of the stated
    disturbances that keep the link within ±180°.
    """
    search = DisturbanceSearch(setup.problem, law, None, setup.settings.period, HORIZON)

    def attain(disturbance: Callable[[np.ndarray], np.ndarray]) -> RunGain:
        return run_gain(search.runs.attained(disturbance(search.runs.times)[:, None]))

    attained = in_two_threads(attain, list(STATED_DISTURBANCES.values()))
    return {
        "norm": float(search.small()[0]),
        "gain": max((a.gain for a in attained if a.inside), default=math.inf),
    }


def _known(value: float | None) -> float:
    return math.inf if value is None else float(value)


def _late_rms(run: Trajectory) -> float:
    """RMS deviation over the last four seconds, rad."""
    if run.diverged_at is not None:
        return math.inf
    late = run.time >= run.time[-1] - 4.0
    error = run.tracked("link_position")[late] - run.signals["reference"][late, 0]
    return float(np.sqrt(np.mean(error**2)))


def trade_off_curves(setup: PaperSetup) -> dict[str, TradeOffCurve]:
    """H∞ over γ, nonlinear LQR over R2, H∞ over R2, and the simplest rival over R2."""
    degree, ratio = setup.settings.degree, setup.settings.gamma_ratio
    most = EFFORTS[:5]  # the others take more volts than the smallest γ does

    def measure(law: Law) -> Mapping[str, float]:
        return {**measure_law(setup, law), **measure_gain(setup, law)}

    simple = [GravityCompensatedLQR.design(scaled_effort(setup.problem, factor)) for factor in most]
    points = tuple(TradeOffPoint(factor, law, measure(law)) for factor, law in zip(most, simple, strict=True))
    return {
        "NL-H∞ over γ": sweep_gamma(setup.problem, RATIOS, degree, measure),
        "nonlinear LQR over R2": sweep_effort(setup.problem, EFFORTS, degree, measure),
        f"NL-H∞ of γ = {ratio:g} γ* over R2": sweep_effort(setup.problem, most, degree, measure, ratio),
        "LQR + gravity compensation over R2": TradeOffCurve("LQR", "R2 over the problem's own", points),
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


def trade_off_rows(curves: Mapping[str, TradeOffCurve]) -> Iterable[Sequence[Any]]:
    """Every law of the sweeps; deviations in degrees."""
    steps = ("peak_90", "peak_180", "overshoot_90", "overshoot_180")
    yield ("sweep", "γ/γ* or R2", *steps, *(f"{case} °" for case in CASES), "norm", "gain")
    for name, curve in curves.items():
        for p in curve.points:
            angles = [math.degrees(p.figures[case]) for case in CASES]
            value = p.value * (EFFORT if curve.parameter.startswith("R2") else 1.0)
            yield (
                name,
                value,
                *(p.figures[key] for key in steps),
                *angles,
                p.figures["norm"],
                p.figures["gain"],
            )


# Bounds on states ----------------------------------------------------------------------------------------
def bounds_rows(setup: PaperSetup) -> Iterable[Sequence[Any]]:
    """The 180° step from a bad estimate, without and with bounds on the sigma points of the unmeasured states."""
    true = setup.run(setup.nonlinear, Step(math.pi), STEP_DURATION, estimator=None)
    names = [name for name in setup.model.states if name not in setup.model.outputs]
    reach = {name: max(1.5 * float(np.abs(true.signal("state", name)).max()), 2.0) for name in names}
    limits = np.array([reach.get(name, np.inf) for name in setup.model.states])
    yield (
        "estimate starts",
        "bounds",
        *(f"largest error of {name}" for name in names),
        "peak V",
        "overshoot %",
    )
    for start, mean in STARTS.items():
        for bounds in (None, {name: (-r, r) for name, r in reach.items()}):
            mean, p0 = np.clip(mean, -limits, limits), np.array(SPREAD) ** 2
            ukf = setup.estimator("ukf", mean=mean, covariance=p0, bounds=bounds)
            run = setup.run(setup.nonlinear, Step(math.pi), STEP_DURATION, estimator=ukf)
            m, error = run.metrics(), np.abs(run.signals["estimate"] - run.signals["state"]).max(axis=0)
            whole = run.diverged_at is None
            errors = [float(error[setup.model.index(name)]) if whole else "diverged" for name in names]
            yield (start, "yes" if bounds else "no", *errors, m["peak_input"], m["overshoot_percent"])


# Page ----------------------------------------------------------------------------------------------------
def table(rows: Iterable[Sequence[Any]]) -> str:
    """A table of Markdown; the first row is its head."""
    cells = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    lines = ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join([lines[0], "|---" * len(cells[0]) + "|", *lines[1:]])


def main() -> None:
    """Compute every study at the default settings and print its numbers."""
    setup = PaperSetup(PaperSettings())
    weight, error = tracking_weight(setup)
    print(f"tracks-sine: weight of x5 {weight}, largest error {math.degrees(error):.2f}°\n", flush=True)
    study = ToleranceStudy(setup, setup.nonlinear)
    print(table(repair_costs(setup, find_repairs(setup, study))), "\n", flush=True)
    print(f"another design: {unstable_of(other_design(setup), 'corner')} corners unstable\n", flush=True)
    print(table(bounds_rows(setup)), "\n", flush=True)
    curves = trade_off_curves(setup)
    print(table(trade_off_rows(curves)), "\n")
    over_gamma, lqr, *others = curves.values()
    for curve in (over_gamma, *others):
        ratios = ratios_at_equal_peak(curve, lqr)
        print(f"{curve.name}, deviation over the nonlinear LQR's: {ratios.min():.4f} to {ratios.max():.4f}")


if __name__ == "__main__":
    main()
