"""∂∫|z|²/∂d along a run, by the adjoint of the sampled loop; and the loop from d to z for small motions.

The state of the sampled loop is that of the plant and the controller's memory (`SampledController`). With
ζ' = F(ζ, d) from sample to sample, λ_k = ∂|z_k|²/∂ζ_k + λ_{k+1} ∂F/∂ζ is followed backwards, and the gradient is
λ_{k+1} ∂F/∂d. All derivatives along the run are computed at once; only the products of the recursion are in turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.analysis.discrete import DiscreteSystem
from flexhinf.analysis.disturbance_runs import DisturbanceRuns
from flexhinf.analysis.rows import one_period
from flexhinf.loop import Trajectory

__all__ = ["gradient", "small_motions"]

#: Samples whose derivatives are held in memory at a time.
CHUNK = 2048


@dataclass(frozen=True)
class _Slopes:
    """Derivatives at N samples.

    Attributes
    ----------
    state, disturbance : (N, K, K) and (N, K, k) arrays
        Of the next state: by the state, and by the torques of the interval that begins (commands are zero).
    command : (N, K, c) array
        By the commands of the interval that ends.
    x_by, u_by : tuples of (N, …, K) and (N, …, c) arrays
        Of the deviation and the input, by the state and by these commands.
    """

    state: np.ndarray
    disturbance: np.ndarray
    command: np.ndarray
    x_by: tuple[np.ndarray, np.ndarray]
    u_by: tuple[np.ndarray, np.ndarray]


def _slopes(
    runs: DisturbanceRuns,
    x: np.ndarray,
    memory: np.ndarray,
    command: np.ndarray,
    d: np.ndarray,
    started: np.ndarray,
) -> _Slopes:
    """At states x (N, n) of the plant and memories (N, s) of the controller."""
    resting, plant = runs.resting, runs.problem.plant
    step, (count, n), c = resting.step, x.shape, runs.commands
    s, p, m, place = step.size, step.p, step.m, step.places["u"]
    vectors = np.broadcast_to(plant.parameters.vector(), (count, plant.parameters.size))
    y, by_y = resting.measure(np.hstack([x, memory[:, place]]), vectors)
    stepped = step.step(memory, y, command, started=started)

    def split(by: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        through = by[:, :, s : s + p] @ by_y
        whole = np.concatenate([through[:, :, :n], by[:, :, :s]], axis=2)
        whole[:, :, n + place.start : n + place.stop] += through[:, :, n:]
        return whole, by[:, :, s + p : s + p + c]

    torques = np.zeros((count, len(plant.disturbances)))
    chosen = [tuple(plant.disturbances).index(name) for name in runs.problem.disturbances or ()]
    torques[:, chosen] = d[:, c:]
    u_by, after = split(stepped.u.by), split(stepped.memory.by)
    sub_steps = runs.loop.sub_steps
    moved = one_period(plant, runs.period, sub_steps, x, stepped.u.value, vectors, torques)[1]
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
    return _Slopes(state, disturbance, np.concatenate([by_input @ u_by[1], after[1]], axis=1), x_by, u_by)


def gradient(runs: DisturbanceRuns, d: np.ndarray) -> tuple[np.ndarray, float] | None:
    """(∂/∂d (N, k), ∫|z|²) for samples d (N, k), both integrals as sums over samples; None if the loop diverged."""
    run, whole = runs.run(d)
    x_moved, u_moved = runs.deviations(run, d)
    cost, by_x, by_u = runs.cost(x_moved, u_moved)
    if not (whole and np.all(np.isfinite(cost)) and np.all(np.isfinite(by_x))):
        return None
    x, memory, command = run.signals["state"], _memories(runs, x_moved, run), _before(runs, d)
    started = np.minimum(np.arange(len(d)), 1.0)
    adjoint, found = np.zeros(x.shape[1] + memory.shape[1]), np.zeros(d.shape)
    for begin in reversed(range(0, len(d), CHUNK)):
        part = slice(begin, min(begin + CHUNK, len(d)))
        slopes = _slopes(runs, x[part], memory[part], command[part], d[part], started[part])
        own, by_command = (
            np.einsum("ki,kij->kj", by_x[part], slopes.x_by[which])
            + np.einsum("ki,kij->kj", by_u[part], slopes.u_by[which])
            for which in (0, 1)
        )
        for k in reversed(range(part.stop - begin)):
            found[begin + k] += adjoint @ slopes.disturbance[k]
            if begin + k:  # the command of the interval before acts now
                found[begin + k - 1, : runs.commands] += by_command[k] + adjoint @ slopes.command[k]
            adjoint = own[k] + adjoint @ slopes.state[k]
    return found * runs.period, float(cost.sum() * runs.period)


def small_motions(runs: DisturbanceRuns) -> DiscreteSystem:
    """From d, held between samples, to z = (h(x), R2^½ u) at the samples, for small motions."""
    resting = runs.resting
    start, n, c = resting.start[None, :], resting.plant.n, runs.commands
    k = runs.channels
    slopes = _slopes(runs, start[:, :n], start[:, n:], resting.command[None, :], np.zeros((1, k)), np.ones(1))
    weights, root = runs.problem.expand(1).h_parts[1], np.linalg.cholesky(runs.problem.r2).T
    size = n + resting.step.size
    a, b = np.zeros((size + c, size + c)), np.zeros((size + c, k))
    a[:size, :size], a[:size, size:] = slopes.state[0], slopes.command[0]
    b[:size], b[size:, :c] = slopes.disturbance[0], np.eye(c)  # a command is remembered for a period
    seen = np.vstack([
        weights @ np.hstack([slopes.x_by[0][0], slopes.x_by[1][0]]),
        root @ np.hstack([slopes.u_by[0][0], slopes.u_by[1][0]]),
    ])  # fmt: skip
    return DiscreteSystem(a, b, seen, np.zeros((len(seen), k)), runs.period)


def _before(runs: DisturbanceRuns, d: np.ndarray) -> np.ndarray:
    """Commands (N, k) of the interval that ends at each sample."""
    controller = runs.loop.controller
    wanted = np.broadcast_to(controller.operating_reference, (len(d), len(controller.tracked))).copy()
    wanted[1:, : runs.commands] += d[:-1, : runs.commands]
    return wanted


def _memories(runs: DisturbanceRuns, x_moved: np.ndarray, run: Trajectory) -> np.ndarray:
    """The controller's memory (N, s) before each sample of a run."""
    law, step, u = runs.law, runs.resting.step, run.signals["input"]
    integral = x_moved[:, step.n :] + law.operating_point[step.n :]
    first = (law.operating_input, law.operating_point[step.n :], np.zeros(step.k))
    last, before, position = (
        np.vstack([start[None, :], rows[:-1]])
        for start, rows in zip(first, (u, integral, runs.tracked(run)), strict=True)
    )
    belief = step.beliefs(run.signals["output"], u, run.signals["estimate"], last)
    return np.hstack([belief, last, before, position])
