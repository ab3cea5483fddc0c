"""A lower bound of the loop's gain, found by search: the finite-energy disturbance that makes ∫|z|²/∫|d|² largest.

Power iteration: d is replaced by the gradient of ∫|z|², scaled to the same energy [tierno1997]. For a linear loop that
is the power iteration of its H∞ norm squared, and the search begins with the worst disturbance for small motions, a
sinusoid at the frequency of that norm under a window. The gain attained is a lower bound.

The search may run at a longer period than the loop, and takes an estimator at its stationary gain; its result is then
run with the loop itself.

The gradient ∂∫|z|²/∂d comes from the adjoint of the sampled loop. The state of the sampled loop is that of the plant
and the controller's memory (`SampledController`). With ζ' = F(ζ, d) from sample to sample, λ_k = ∂|z_k|²/∂ζ_k +
λ_{k+1} ∂F/∂ζ is followed backwards, and the gradient is λ_{k+1} ∂F/∂d. All derivatives along the run are computed at
once; only the products of the recursion are in turn.

`worst_gain` is a lower bound of the gain of one law over all plants of a box. Each plant runs about its own
equilibrium at the goal, from rest there: the deviations of state, input and integrals count from it, as in
`flexhinf.certify.proof`. Where the equilibrium moves by δ, integrals included, the law in these deviations is
k(x + δ) − k(δ). Plant and disturbance are improved in turn: the plant for a given disturbance by `climb`, which needs
no derivatives of the loop by its parameters, then the disturbance for that plant by power iteration, as
`worst_disturbance`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.linear_loop import DiscreteSystem
from flexhinf.analysis.sampled_controller import DerivativeRows, LawRows, equilibrium_integrals, one_period
from flexhinf.analysis.search import climb
from flexhinf.arrays import Elements
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure, refuse_if
from flexhinf.hinf import HJISolution
from flexhinf.loop import Controller, Loop, Samples, Trajectory
from flexhinf.loop.controller.options import checked_latency
from flexhinf.plant import Estimator, GeneralisedPlant, Law
from flexhinf.scalars import trace

#: Horizons count from where this share of ∫|d|² has passed: before, both integrals are rounding.
BEGUN = 1e-6


class ZeroOrderHold(Samples):
    """Samples, each held until the next."""

    def __call__(self, t: ArrayLike) -> np.ndarray:
        """The last sample at or before the time."""
        place = np.searchsorted(self.times, np.asarray(t) * (1.0 + 1e-12), side="right") - 1
        return self.values[np.maximum(place, 0)]


@dataclass(frozen=True, eq=False)
class Attained:
    """One disturbance and the gain it attained from rest at the operating point: a lower bound of the loop's gain."""

    gain: float  # √(∫|z|²/∫|d|²), the largest over all horizons; infinite if the run diverged
    energy: float  # ∫|d|²
    solution: HJISolution | None = field(repr=False)  # whose V is meant
    deviation: np.ndarray = field(repr=False)  # (N, n + k), x − x* on the way, with the integrals
    times: np.ndarray = field(repr=False)  # (N,), s
    disturbance: np.ndarray = field(repr=False)  # (N, k), each sample held until the next
    trajectory: Trajectory = field(repr=False)  # as far as it went

    @cached_property
    def largest_value(self) -> float:
        """The largest V on the way; NaN without V, infinite if the run diverged."""
        if np.isinf(self.gain) or self.solution is None:
            return np.inf if np.isinf(self.gain) else np.nan
        return float(np.max(self.solution.value_and_gradient(self.deviation)[0]))


class DisturbanceRuns:
    """Runs of a law's loop under the disturbances of its problem, held between samples; Eq. (3) as a run.

    The problem's penalty is z, its disturbances are d: commands (as deviations from the operating point's) first.
    Without an estimator the true state is fed back; period and horizon are in s, the latency is as of
    `flexhinf.loop.Controller`. A law and a problem of other states are refused.
    """

    def __init__(
        self,
        problem: GeneralisedPlant,
        law: Law,
        estimator: Estimator | None,
        period: float,
        horizon: float,
        latency: int | None = None,
    ) -> None:
        refuse_if(
            tuple(law.state_names) != tuple(problem.state_names),
            "The law was not made for the problem's states.",
            f"expected {list(problem.state_names)}, got {list(law.state_names)}",
            "the same integrals",
        )
        self.problem, self.law, self.period, self.horizon = problem, law, period, horizon
        self.loop = Loop(problem.plant, Controller(law, estimator, period, latency=latency))
        self.times = np.arange(round(horizon / period) + 1) * period
        self.commands = len(problem.integrate) if problem.command else 0
        self.channels = len(problem.disturbance_names)

    def within(self, d: np.ndarray) -> np.ndarray:
        """Samples (N, k) with commands that the joints' limits allow: what lies beyond is cut off."""
        controller, limits, array = self.loop.controller, self.problem.plant.limits, np.array(d, dtype=float)
        for i, name in enumerate(controller.tracked[: self.commands]):
            if name in limits:
                low, high = np.asarray(limits[name]) - controller.operating_reference[i]
                array[:, i] = np.clip(array[:, i], low, high)
        return array

    def run(self, d: np.ndarray) -> Trajectory:
        """The run with d (N, k) held between samples."""
        controller, channels, law = self.loop.controller, self.problem.disturbances or (), self.law
        wanted = controller.operating_reference + d[:, : self.commands] if self.commands else None
        commands = None if wanted is None else Samples(self.times, wanted)
        torques = {
            name: ZeroOrderHold(self.times, d[:, self.commands + i]) for i, name in enumerate(channels)
        }
        start, u = law.operating_point[: len(controller.states)], law.operating_input
        return self.loop.run(commands, torques or None, None, self.horizon, start, initial_input=u)

    def deviations(self, run: Trajectory, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x − x* with the integrals as the controller has them (N, n + k), and u − u* (N, m)."""
        controller, x, position = self.loop.controller, run.signals["state"], self.tracked(run)
        growth = self.period * (0.5 * (position[1:] + position[:-1]) - self.wanted(d)[: len(position) - 1])
        integral = np.vstack([np.zeros(position.shape[1]), np.cumsum(growth, axis=0)])
        states = [tuple(self.problem.plant.states).index(name) for name in controller.states]
        moved = np.hstack([x[:, states] - self.law.operating_point[: len(states)], integral])
        return moved, run.signals["input"] - self.law.operating_input

    def wanted(self, d: np.ndarray) -> np.ndarray:
        """Commanded positions (N, k) of the interval that begins at each sample."""
        wanted = np.tile(self.loop.controller.operating_reference, (len(d), 1))
        wanted[:, : self.commands] += d[:, : self.commands]
        return wanted

    def tracked(self, run: Trajectory) -> np.ndarray:
        """Tracked positions as the integrals use them, at each sample, (N, k)."""
        controller = self.loop.controller
        measured = controller.measured if controller.estimator is not None else ()
        columns = [
            run.signal("output" if name in measured else "estimate", name) for name in controller.tracked
        ]
        return np.column_stack(columns) if columns else np.zeros((len(run.time), 0))

    @cached_property
    def _penalty(self) -> DerivativeRows:
        problem = self.problem
        p, n = problem.plant.parameters, len(problem.state_names)

        def squared(x: Elements, _: Elements) -> Elements:
            h = np.asarray(problem.penalty_output(x, p.named(p.vector())))
            return np.array([h @ h])

        return DerivativeRows(("penalty", problem), lambda: trace(squared, n, 0, name="penalty"))

    def cost(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """|z|² (N,) at deviations x (N, n) and u (N, m), and its derivatives by both."""
        with np.errstate(over="ignore", invalid="ignore"):
            h, by_x = self._penalty(x)
            priced = u @ self.problem.r2
            return h[:, 0] + (u * priced).sum(axis=1), by_x[:, 0], 2.0 * priced

    def attained(self, d: np.ndarray, solution: HJISolution | None = None) -> Attained:
        """Gain of samples d (N, k), commands cut off at the joints' limits; V is that of the law, or of a solution."""
        d = self.within(d)
        run = self.run(d)
        x, u = self.deviations(run, d)
        z, gain = self.cost(x, u)[0], np.inf
        energy = float((d[:-1] ** 2).sum()) * self.period
        if run.diverged_at is None and np.all(np.isfinite(z)):
            outer = np.cumsum((d[:-1] ** 2).sum(axis=1))
            begun = outer > BEGUN * outer[-1]
            ratio = np.cumsum(0.5 * (z[1:] + z[:-1]))[begun] / outer[begun]
            gain = float(np.sqrt(ratio.max()))
        value = self.law if solution is None else solution
        value = value if isinstance(value, HJISolution) else None
        return Attained(gain, energy, value, x, self.times, d, run)

    @cached_property
    def equilibrium_loop(self) -> EquilibriumLoop:
        """The loop in equilibrium at the operating point, an estimator at its stationary gain; no input waits."""
        estimator = self.loop.controller.estimator
        return EquilibriumLoop(self.law, estimator, self.problem.plant, self.period, latency=0)


#: Samples whose derivatives are held in memory at a time.
CHUNK = 2048


def _slopes(
    runs: DisturbanceRuns,
    x: np.ndarray,
    memory: np.ndarray,
    command: np.ndarray,
    d: np.ndarray,
    started: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Derivatives at N states x (N, n) of the plant and memories (N, s) of the controller.

    Of the next state by the state, (N, K, K), by the torques of the interval that begins, (N, K, k) with zeros for the
    commands, and by the commands of the interval that ends, (N, K, c); and of deviation and input by the state and by
    these commands, (N, …, K) and (N, …, c).
    """
    equilibrium_loop, plant = runs.equilibrium_loop, runs.problem.plant
    step, (count, n), c = equilibrium_loop.step, x.shape, runs.commands
    s, p, m, place = step.size, step.p, step.m, step.places["u"]
    vectors = np.broadcast_to(plant.parameters.vector(), (count, plant.parameters.size))
    y, by_y = equilibrium_loop.measure(np.hstack([x, memory[:, place]]), vectors)
    stepped = step.step(memory, y, command, started=started)

    def split(by: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return equilibrium_loop.by_loop(by, by_y), by[:, :, s + p : s + p + c]

    torques = np.zeros((count, len(plant.disturbances)))
    chosen = [tuple(plant.disturbances).index(name) for name in runs.problem.disturbances or ()]
    torques[:, chosen] = d[:, c:]
    u_by, after = split(stepped.u.by), split(stepped.memory.by)
    moved = one_period(plant, runs.period, runs.loop.sub_steps, x, stepped.u.value, vectors, torques)[1]
    by_input = moved[:, :, n : n + m]
    state = np.concatenate([by_input @ u_by[0], after[0]], axis=1)
    state[:, :n, :n] += moved[:, :, :n]
    disturbance = np.zeros((count, n + s, d.shape[1]))
    disturbance[:, :n, c:] = moved[:, :, n + m :][:, :, chosen]
    deviation = split(stepped.deviation.by)
    true = np.zeros((count, len(step.states), n + s))
    places = [plant.index(name) for name in step.states]
    true[:, np.arange(len(places)), places] = 1.0
    x_by = (
        np.concatenate([true, deviation[0][:, step.n :]], axis=1),
        np.concatenate([np.zeros((count, step.n, c)), deviation[1][:, step.n :]], axis=1),
    )
    return state, disturbance, np.concatenate([by_input @ u_by[1], after[1]], axis=1), x_by, u_by


def gradient(runs: DisturbanceRuns, d: np.ndarray) -> tuple[np.ndarray, float] | None:
    """(∂/∂d (N, k), ∫|z|²) for samples d (N, k), both integrals as sums over samples; None if the loop diverged."""
    run = runs.run(d)
    x_moved, u_moved = runs.deviations(run, d)
    cost, by_x, by_u = runs.cost(x_moved, u_moved)
    if run.diverged_at is not None or not (np.all(np.isfinite(cost)) and np.all(np.isfinite(by_x))):
        return None
    law, step, x, u = runs.law, runs.equilibrium_loop.step, run.signals["state"], run.signals["input"]
    # The controller's memory (N, s) before each sample.
    integral = x_moved[:, step.n :] + law.operating_point[step.n :]
    first = (law.operating_input, law.operating_point[step.n :], np.zeros(step.k))
    last, before, position = (
        np.vstack([start[None, :], rows[:-1]])
        for start, rows in zip(first, (u, integral, runs.tracked(run)), strict=True)
    )
    belief = step.beliefs(run.signals["output"], u, run.signals["estimate"], last)
    memory = np.hstack([belief, last, before, position])
    # Commands of the interval before.
    command = np.vstack([runs.wanted(np.zeros((1, d.shape[1]))), runs.wanted(d)[:-1]])
    started = np.minimum(np.arange(len(d)), 1.0)
    adjoint, by_d = np.zeros(x.shape[1] + memory.shape[1]), np.zeros(d.shape)
    for begin in reversed(range(0, len(d), CHUNK)):
        part = slice(begin, min(begin + CHUNK, len(d)))
        by_state, by_torque, by_command, *moved = _slopes(
            runs, x[part], memory[part], command[part], d[part], started[part]
        )
        own, commands = (
            np.einsum("ki,kij->kj", by_x[part], x_by) + np.einsum("ki,kij->kj", by_u[part], u_by)
            for x_by, u_by in zip(*moved)
        )
        # Backwards; a call of `dot` takes half the time of `@`.
        *adjoints, adjoint = rows = [adjoint, *own[::-1]]
        for later, row, slope in zip(rows, rows[1:], by_state[::-1]):
            row += later.dot(slope)
        adjoints = np.array(adjoints[::-1])
        by_d[part] += np.einsum("ki,kij->kj", adjoints, by_torque)
        commands = commands + np.einsum("ki,kij->kj", adjoints, by_command)
        # The command of the interval before acts now; sample 0 has none before it.
        skipped = int(begin == 0)
        by_d[begin + skipped - 1 : part.stop - 1, : runs.commands] += commands[skipped:]
    return by_d * runs.period, float(cost.sum() * runs.period)


def small_motions(runs: DisturbanceRuns) -> DiscreteSystem:
    """From d, held between samples, to z = (h(x), R2^½ u) at the samples, for small motions."""
    loop, c, k = runs.equilibrium_loop, runs.commands, runs.channels
    start, n = loop.start[None, :], loop.plant.n
    by_state, by_torque, by_command, x_by, u_by = _slopes(
        runs, start[:, :n], start[:, n:], loop.command[None, :], np.zeros((1, k)), np.ones(1)
    )
    weights, root = runs.problem.expand(1).h_parts[1], np.linalg.cholesky(runs.problem.r2).T
    a = np.vstack([np.hstack([by_state[0], by_command[0]]), np.zeros((c, n + loop.step.size + c))])
    b = np.vstack([by_torque[0], np.eye(c, k)])  # a command is remembered for a period
    penalised = weights @ np.hstack([x_by[0][0], x_by[1][0]])
    seen = np.vstack([penalised, root @ np.hstack([u_by[0][0], u_by[1][0]])])
    return DiscreteSystem(a, b, seen, np.zeros((len(seen), k)), runs.period)


#: Period of the search without an estimator, s, unless the loop's is longer.
SEARCH_PERIOD = 1e-2

#: The energy grows by this factor while the state stays in the level set, and shrinks by it while it does not; at
#: most so often.
FACTOR, ROUNDS = 1.5, 12


class DisturbanceSearch:
    """Ascent on ∫|z|²/∫|d|²; arguments as of `DisturbanceRuns`.

    In the search a Kalman filter is taken at its stationary gain, and no input waits; what is found runs in the loop
    itself. The search's period is 10 ms, or the loop's where that is longer; with an estimator always the loop's.
    """

    def __init__(
        self,
        problem: GeneralisedPlant,
        law: Law,
        estimator: Estimator | None = None,
        period: float = 1e-3,
        horizon: float = 20.0,
        search_period: float | None = None,
        latency: int | None = None,
    ) -> None:
        if estimator is not None and search_period not in (None, period):
            raise InvalidInput(
                "An estimator has one period.",
                f"expected search_period={period:g} s or none, got {search_period!r}",
                "search_period only for state feedback",
            )
        steady = estimator
        if estimator is not None:
            search_period = period
            steady = EquilibriumLoop(law, estimator, problem.plant, period).step.estimator
        search_period = max(period, SEARCH_PERIOD) if search_period is None else search_period
        self.search_runs = DisturbanceRuns(problem, law, steady, search_period, horizon, 0)
        late = checked_latency(latency, estimator)
        same = estimator is steady and search_period == period and not late
        self.runs = (
            self.search_runs if same else DisturbanceRuns(problem, law, estimator, period, horizon, late)
        )

    def attained(self, d: np.ndarray, solution: HJISolution | None = None) -> Attained:
        """Of samples (N, k) at the search's period, run by the loop itself, with V of the law or of a solution."""
        return self.runs.attained(self.on(self.runs.times, d), solution)

    def on(self, times: np.ndarray, d: np.ndarray) -> np.ndarray:
        """A disturbance of the search at other times, each sample held."""
        return d[np.minimum((times / self.search_runs.period + 1e-6).astype(int), len(d) - 1)]

    def scaled(self, d: np.ndarray, energy: float) -> np.ndarray:
        """d with ∫|d|² = energy."""
        return d * np.sqrt(energy / (self.search_runs.period * float((d**2).sum())))

    def small(self) -> tuple[float, np.ndarray]:
        """(gain of small motions of the sampled loop, the sinusoid that attains it, under a window)."""
        system = small_motions(self.search_runs)
        gain, frequency = system.norm()
        if not np.isfinite(gain):
            return gain, np.ones((len(self.search_runs.times), self.search_runs.channels))
        direction = np.linalg.svd(system.response(frequency)[0])[2][0].conj()
        t = self.search_runs.times
        window = np.sin(np.pi * (t + self.search_runs.period) / (t[-1] + 2.0 * self.search_runs.period)) ** 2
        return gain, np.real(np.exp(1j * frequency * t)[:, None] * direction) * window[:, None]

    def random(self, seed: int) -> np.ndarray:
        """Decaying noise: a start that prefers no frequency."""
        t = self.search_runs.times
        noise = np.random.default_rng(seed).normal(size=(len(t), self.search_runs.channels))
        return noise * np.exp(-3.0 * t / t[-1])[:, None]

    def ascend(self, start: np.ndarray, energy: float, turns: int) -> np.ndarray | None:
        """The disturbance (N, k) of this energy found from `start`; None if the loop diverges on the way."""
        within = self.search_runs.within  # no command goes beyond the joints' limits
        d, best = within(self.scaled(start, energy)), (-np.inf, start)
        for _ in range(turns):
            climbed = gradient(self.search_runs, d)
            if climbed is None or not np.all(np.isfinite(climbed[0])):
                return None
            slope, value = climbed
            best = max(best, (value, d), key=lambda pair: pair[0])
            if not slope.any():
                break
            d = within(self.scaled(slope, energy))
        return best[1]

    def climbed(
        self, start: np.ndarray, energy: float, turns: int, solution: HJISolution | None = None
    ) -> Attained:
        """Gain of the loop itself under the disturbance of this energy that the search reaches from `start`."""
        d = self.ascend(start, energy, turns)
        return self.attained(self.scaled(start, energy) if d is None else d, solution)


def worst_disturbance(
    problem: GeneralisedPlant,
    law: Law,
    estimator: Estimator | None = None,
    period: float = 1e-3,
    *,
    energy: float | None = None,
    level: float | None = None,
    horizon: float = 20.0,
    turns: int = 12,
    starts: int = 2,
    seed: int = 0,
    search_period: float | None = None,
    latency: int | None = None,
) -> Attained:
    """The worst disturbance found, of a given energy or with the state inside {V ≤ level}: that of the largest gain,
    which is infinite if the loop diverged under a disturbance of this energy.

    `energy` is ∫|d|². A search for a `level` instead begins with the energy 2 level/γ², up to which the dissipation
    inequality itself keeps V below the level, and then takes more or less, as long as the state stays inside. It
    starts `starts` times, each an ascent of so many `turns`: from the worst sinusoid of small motions, then from
    fading noise with the seeds `seed`, `seed` + 1, … Other arguments are those of `DisturbanceSearch`. Neither or both
    of energy and level, and a level for a law without V, are refused.
    """
    sizes = [number for number in (energy, level) if number is not None]
    refuse_if(
        len(sizes) != 1 or not (np.isfinite(sizes[0]) and sizes[0] > 0.0),
        "The disturbance has no size.",
        f"expected energy or level, a positive number, got energy={energy!r} and level={level!r}",
        "level=solution.sampled_region().level",
    )
    refuse_if(
        level is not None and not (isinstance(law, HJISolution) and np.isfinite(law.gamma)),
        "The law has no level sets.",
        f"got level={level!r} and {type(law).__name__}",
        "energy=…",
    )
    search = DisturbanceSearch(problem, law, estimator, period, horizon, search_period, latency)
    first = [search.small()[1], *(search.random(seed + k) for k in range(starts - 1))]
    attained = (
        ascend_inside(search, start, level, turns, law)
        if level is not None and isinstance(law, HJISolution)
        else search.climbed(start, sizes[0], turns)
        for start in first
    )
    return max(attained, key=lambda candidate: candidate.gain)


def ascend_inside(
    search: DisturbanceSearch, start: np.ndarray, level: float, turns: int, solution: HJISolution
) -> Attained:
    """The best of all energies tried with which V of a solution, whose γ gives the first energy, stayed below the
    level; the smallest energy if there is none. The start (N, k) is at the search's period, of any size."""
    energy, best, grows = 2.0 * level / solution.gamma**2, None, None
    tried: list[Attained] = []
    for _ in range(ROUNDS):
        candidate = search.climbed(start, energy, turns, solution)
        tried.append(candidate)
        inside = candidate.largest_value <= level
        if inside and (best is None or candidate.gain > best.gain):
            best = candidate
        grows = inside if grows is None else grows
        if inside != grows:
            break
        energy *= FACTOR if inside else 1.0 / FACTOR
    return tried[-1] if best is None else best


# The worst plant --------------------------------------------------------------------------------
#: Turns of plant and disturbance at most, and the growth of the gain below which they end.
PLANT_ROUNDS, GROWTH = 4, 1e-3

#: Newton steps towards the integrals of an equilibrium at most, and the relative error of its input.
ITERATIONS, BALANCED = 20, 1e-12

#: Turns of each ascent of the disturbance.
TURNS = 6


class MovedLaw(Law):
    """A law in deviations from the equilibrium of another problem's plant at the goal: k(x + δ) − k(δ). A
    NumericalFailure says that no integrals make the law hold that plant there."""

    law_data: Any = None  # the law's, then δ (n,) and k(δ) (m,)

    def __init__(self, law: Law, problem: GeneralisedPlant) -> None:
        self.law, self.state_names, self.input_names = law, tuple(law.state_names), tuple(law.input_names)
        self.operating_point = np.array(problem.operating_point, dtype=float)
        self.operating_input = np.array(problem.operating_input, dtype=float)
        n, rows = len(law.plant_states), LawRows(law)
        integrals = equilibrium_integrals(rows, self.operating_point[:n], self.operating_input)
        start = np.concatenate([self.operating_point[:n], integrals]) - law.operating_point
        moved, wanted = start.copy(), self.operating_input - law.operating_input
        # Newton's method: integrals with which the law gives the input that is wanted.
        for _ in range(ITERATIONS):
            value, slope = rows(moved[None, :])
            gap = wanted - value[0]
            if np.abs(gap).max() <= BALANCED * max(1.0, np.abs(wanted).max()):
                self.law_data = np.concatenate([np.ravel(law.law_data), moved, value[0]])
                return
            moved[n:] += np.linalg.lstsq(slope[0][:, n:], gap, rcond=None)[0]
            if not np.all(np.isfinite(moved)):
                break
        raise NumericalFailure(
            "The law does not hold the plant at the goal.",
            f"no integrals near {np.array2string(start[n:], precision=6)} give the input that balances it",
            "another degree, or a law made for this goal",
        )

    @property
    def law_key(self) -> str:
        """Key of the law's code: δ is data."""
        return f"moved {self.law.law_key}"

    def evaluate_law(self, x: Elements, data: Elements) -> Elements:
        """k(x + δ) − k(δ)."""
        n, m = len(self.state_names), len(self.input_names)
        return self.law.evaluate_law(x + data[-n - m : -m], data[: -n - m]) - data[-m:]


class WorstGain(NamedTuple):
    """The plant with the largest gain, and its worst disturbance."""

    point: np.ndarray  # (d,), the plant in the unit box
    attained: Attained
    runs: int  # of the search over plants


def worst_gain(
    problem_at: Callable[[np.ndarray], GeneralisedPlant],
    law: HJISolution,
    start: np.ndarray,
    first: Attained,
    *,
    level: float,
    period: float,
    horizon: float,
    starts: np.ndarray | None = None,
) -> WorstGain:
    """The plant of a box, and the disturbance of it, with the largest ∫|z|²/∫|d|² that is found, under a law with the
    true state fed back.

    `problem_at` takes a point (d,) of the unit box to the problem of that plant, about its own equilibrium; where it
    raises a `FlexhinfError` there is none, and the plant is left out. The search begins at `start` (d,), the nominal
    plant, and at `starts` (S, d), with the worst disturbance `first` of the nominal plant, whose period and horizon,
    s, are given too. V of the deviation from each plant's own equilibrium stays below `level`.
    """
    point = np.asarray(start, dtype=float)
    others = np.empty((0, len(point))) if starts is None else starts
    best, runs = WorstGain(point, first, 0), 0

    # The search at a point, and its best disturbance (N, k).
    def searched(point: np.ndarray) -> tuple[DisturbanceSearch, np.ndarray]:
        problem = problem_at(point)
        search = DisturbanceSearch(problem, MovedLaw(law, problem), None, period, horizon)
        place = np.searchsorted(best.attained.times, search.search_runs.times + 1e-9, side="right") - 1
        return search, best.attained.disturbance[place]

    def gains(points: np.ndarray) -> np.ndarray:
        values: list[
            float
        ] = []  # under the best disturbance, at the search's period; −inf where there is no plant
        for plant in points:
            try:
                search, d = searched(plant)
                values.append(search.search_runs.attained(d).gain)
            except FlexhinfError:
                values.append(-np.inf)
        return np.array(values)

    for _ in range(PLANT_ROUNDS):
        climbed = climb(gains, np.vstack([best.point, others]))
        others, runs = others[:0], runs + climbed.evaluations
        search, d = searched(climbed.point)
        attained = ascend_inside(search, d, level, TURNS, law)
        before = best.attained.gain
        if attained.gain > before and attained.largest_value <= level:
            best = WorstGain(climbed.point, attained, runs)
        if not best.attained.gain > before * (1.0 + GROWTH):
            break
    return WorstGain(best.point, best.attained, runs)
