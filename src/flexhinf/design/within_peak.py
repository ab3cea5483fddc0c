"""A bandwidth whose step keeps the limit of the input, judged in the nonlinear loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.degrees import tried_degrees
from flexhinf.design.draws import drawn_steps
from flexhinf.design.met import CLOSE
from flexhinf.design.presets.choose import BANDWIDTH_SHARE, Chosen, choose
from flexhinf.design.presets.weights import JointScales
from flexhinf.design.response import run_length
from flexhinf.design.specification import Specification
from flexhinf.design.withstand import choose_withstanding
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.hinf import solve_hji

__all__ = ["choose_within_peak"]

#: Shares of the bandwidth that are tried first go down by this factor, to this one; then they are halved to this width.
COARSE, LEAST, WIDTH = 0.7, 0.05, 0.04

#: Robots within their tolerances whose peak counts, beside the nominal one's.
DRAWN = 12


def choose_within_peak(
    robot: Any,
    goal: np.ndarray,
    start: np.ndarray,
    s: Specification,
    tell: Callable[[str], None],
) -> Chosen:
    """The game of a specification; with a limit of the input, one whose step keeps it.

    A bandwidth that is a default of ours is lowered until the limit is kept; one that was asked for is not.

    Raises
    ------
    InvalidInput
        If the limit is not kept: the best bandwidth found within it.
    """
    game = choose_withstanding(choose, robot, goal, start, s)
    if s.peak_effort is None or game.found is None or game.wanted is None:
        return game
    tell("the peak input of the step")
    peak = _peak(robot, goal, start, s, game)
    if peak <= (1.0 + CLOSE) * s.peak_effort:
        return game
    scales = JointScales.of(robot.plant(), robot.operating_point(goal))
    whole = np.asarray(BANDWIDTH_SHARE * scales.held if s.bandwidth is None else s.bandwidth, dtype=float)
    best, share = _slower(robot, goal, start, s, whole)
    if best is not None and s.bandwidth is None:
        return best
    raise _beyond(s, game.wanted.bandwidth, peak, best, share)


def _slower(
    robot: Any, goal: np.ndarray, start: np.ndarray, s: Specification, whole: np.ndarray
) -> tuple[Chosen | None, float]:
    """The largest share of the bandwidth that keeps the limit, and its game."""

    def kept(share: float) -> Chosen | None:
        asked = replace(s, bandwidth=(share * whole).tolist())
        try:
            game = choose_withstanding(choose, robot, goal, start, asked)
            return game if _peak(robot, goal, start, asked, game) <= s.peak_effort else None  # type: ignore[operator]
        except FlexhinfError:
            return None

    high = low = 1.0
    best = None
    while best is None and low > LEAST:
        high, low = low, COARSE * low
        best = kept(low)
    while best is not None and high - low > WIDTH * high:
        middle = float(np.sqrt(low * high))
        better = kept(middle)
        low, high = (middle, high) if better is not None else (low, middle)
        best = best if better is None else better
    return best, low


def _peak(robot: Any, goal: np.ndarray, start: np.ndarray, s: Specification, game: Chosen) -> float:
    """Largest input of the step, of the nominal robot and of a few within its tolerances; infinite if one diverges.

    What holds each of them at the goal counts too: a slow step may end before it is there.
    """
    degree = max(tried_degrees(len(game.problem.state_names), s))
    law = solve_hji(game.problem, game.gamma, degree)
    bench = Bench(robot, replace(s, saturation=None), game.nominal.plant, law, goal, start)
    assert game.wanted is not None
    length = run_length(0.4 * float(np.min(game.wanted.bandwidth))) if s.duration is None else s.duration
    response = bench.step(length)
    if response.diverged is not None:
        return np.inf
    peak = max(float(np.abs(u).max()) for u in (response.run.signals["input"], bench.rest(goal)[1]))
    if not robot.uncertain or s.draws == 0:
        return peak
    drawn = drawn_steps(bench, DRAWN, length, response.run.settings["sub_steps"])
    held = max(float(np.abs(bench.rest(goal, values)[1]).max()) for values in drawn.values)
    return np.inf if drawn.diverged else max(peak, held, float(drawn.peak.max()))


def _beyond(
    s: Specification, bandwidth: np.ndarray, peak: float, best: Chosen | None, share: float
) -> InvalidInput:
    most = f"{float(np.max(bandwidth)):.3g}"
    found = "no slower loop down to a twentieth of it keeps the limit either"
    advice = "a larger `peak_effort`, or a shorter step (`start`)"
    if best is not None:
        slower = share * float(np.min(bandwidth))
        found = f"the best found within the limit is a bandwidth of {slower:.3g} rad/s"
        advice = f"bandwidth={slower:.3g}, or {advice}"
    needs = "diverges" if np.isinf(peak) else f"takes {peak:.4g}"
    return InvalidInput(
        "The specification cannot be met: the peak of the input binds.",
        f"expected at most {s.peak_effort:g}; with a bandwidth of {most} rad/s the step of the nonlinear loop {needs}, "
        f"within the tolerances; {found}",
        advice,
    )
