"""What the rehearsal of a contract needs: numbers that a caller may change, rest at poses, a motion that is slowed.

All of them are computed here by other routes than those of the C: CasADi's own evaluation, and the formulas in NumPy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import casadi
import numpy as np
from markupsafe import Markup

from flexhinf.errors import NumericalFailure
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.parameter_check import Range, ranges
from flexhinf.export.recording import Recording, history_of
from flexhinf.export.stop_rehearsal import stop_values
from flexhinf.loop.controller.options import holding_function


def reaches_far(code: ControllerCode) -> bool:
    """Whether the rehearsal stands the robot at large angles: a model knows it at rest, and no limit refuses them."""
    return code.standstill is not None and not code.controller.mode.checks_measurements


#: Angles beyond those that are reduced quickly, rad; and farther ones, of every number of words that a reduction in
#: float reads.
FAR = {"double": "4e9", "float": "2e4F"}
FARTHER = {"double": (), "float": (3e9, 7e15, 5e24, 2e33, 3e38)}
LARGEST = {"double": "1e300", "float": "1e30F"}


def far_values(code: ControllerCode) -> dict[str, object] | None:
    """At which angles the rehearsal stands the robot, and with how many; None where it does not."""
    if code.standstill is None or not reaches_far(code):
        return None
    real = code.real.name
    return {"joints": code.standstill.size1_in(0), "angle": FAR[real], "largest": LARGEST[real]}


def contract_values(code: ControllerCode, run: Recording, tight: float) -> dict[str, object]:
    """What the rehearsal of the contract consists of, which begins with the first sample of a recording. `tight`: How
    far rest and starts may be from what is computed elsewhere, relative to 1 and each number."""
    kept = code.controller.memory.places
    stop = kept.get("stop")
    exact = (
        code.real.bytes == 8
    )  # in float rounding decides about a number of the other sign, and not about none
    nones, *flipped = failures(code, run, {math.nan: MOST_NONES} | ({-1.0: MOST_FLIPS} if exact else {}))
    return {
        "far": far_values(code),
        "flips": flipped[0] if exact else [],
        "most_flips": MOST_FLIPS,
        "turned": turned_parameters(code, run) if exact else [],
        "nones": nones,
        "most_nones": MOST_NONES,
        "largest": Markup(LARGEST[code.real.name]),
        "eps": float(np.finfo(code.real.kind).eps),
        "commanded": kept["reference"],
        "brakes": [] if stop is None else [stop.start + 1, stop.start + 2],
        "tight": tight,
        "starts": starts_elsewhere(code),
        "tries": tries(code),
        "rests": rests(code),
        "slower": slower(code) if code.slows else [],
        **stop_values(code),
        "first_y": run.y[0],
        "first_r": run.r[0],
        "first_estimate": np.zeros(code.sizes["estimate"]) if code.belief is None else code.belief,
    }


#: How many numbers of a memory get the other sign, one after the other, and how many are none.
MOST_FLIPS, MOST_NONES = 64, 320


def failures(code: ControllerCode, run: Recording, changes: Mapping[float, int]) -> list[list[int]]:
    """By factor, whether a step fails (1 or 0) after one number of the memory, of so many at most, was multiplied by
    it, three samples from the start."""
    one, y, r = code.controller.fresh(), run.y[0], run.r[0][: code.sizes["r"]]
    command = r if code.controller.commanded else None
    for measured in (y, y, None if code.predicts else y):
        one.step(measured, command)
    history, found = history_of(one), list[list[int]]()
    memory = history.memory.copy()
    for factor, most in changes.items():
        failed = list[int]()
        for place in range(0, memory.size, 1 + memory.size // most):
            history.begin(memory)
            history.waiting = False
            history.memory[place] = factor * memory[place]
            try:
                one.step(y, command)
                failed.append(0)
            except NumericalFailure:
                failed.append(1)
        found.append(failed)
    return found


def turned_parameters(code: ControllerCode, run: Recording) -> list[int]:
    """Whether the first step fails (1 or 0) where one parameter, of so many at most, has the other sign; limits of
    inputs are left as they are."""
    y, r = run.y[0], run.r[0][: code.sizes["r"]]
    numbers, places = code.controller.data_vector, code.controller.data.places
    limits = [np.arange(numbers.size)[places[name]] for name in ("lower", "upper")]
    found = list[int]()
    for place in range(0, numbers.size, 1 + numbers.size // MOST_NONES):
        one, turned = code.controller.fresh(), np.array(numbers)
        turned[place] *= 1.0 if place in np.concatenate(limits) else -1.0
        one.data_vector = turned
        one.reset()
        try:
            one.step(y, r if code.controller.commanded else None)
            found.append(0)
        except NumericalFailure:
            found.append(1)
    return found


def starts_elsewhere(code: ControllerCode) -> list[tuple[np.ndarray, np.ndarray]]:
    """States that differ from the first belief in one element, and the input before the first sample there."""
    if not code.starts_anywhere or code.belief is None:
        return []
    kind = code.real.kind
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for place in (0, len(code.belief) - 1):
        state = code.belief.astype(kind).astype(float)
        state[place] += 2e-3
        state = state.astype(kind).astype(float)
        found.append((state, code.controller.input_before(None, state)))
    return found


#: How many numbers are changed one by one, at most; by how much, relative to each.
MOST_TRIED, CHANGE = 200, 1e-3

#: A number beyond every other one, which nothing but a limit above it refuses.
HUGE = 1e30

#: What `NAME_check` finds, as the header has it.
FINE, BEYOND, NOT_PHYSICAL = 0, 1, 2


def tries(code: ControllerCode) -> list[tuple[int, float, int]]:
    """Place, value and what the check of parameters says, of numbers changed alone: those with a range first."""
    whole = code.whole_numbers
    numbers = np.concatenate([code.defaults, [code.oldest], whole])
    rows = {row.place: row for row in ranges(code.controller, code.defaults, code.robot, code.oldest, whole)}
    fixed = [place for place in range(len(numbers)) if place not in rows]
    chosen = [*_some(sorted(rows), MOST_TRIED // 2), *_some(fixed, MOST_TRIED // 2)]
    kind = code.real.kind
    found: list[tuple[int, float, int]] = []
    for place in chosen:
        if place >= len(numbers) - len(whole):  # an integer
            values = [numbers[place] - 1.0, numbers[place] + 1.0, 0.0, -1.0]
        else:
            step = CHANGE * (abs(numbers[place]) or 1.0) if math.isfinite(numbers[place]) else 0.0
            values = [numbers[place] - step, numbers[place] + step] if step else [-1e6, 1e6]
            values += [*_beyond_ends(rows[place], numbers), HUGE] if place in rows else []
        for value in (float(kind(value)) for value in values):
            found.append(
                (place, value, verdict(rows.get(place), numbers, value, float(kind(numbers[place]))))
            )
    return found


def _beyond_ends(row: Range, numbers: np.ndarray) -> list[float]:
    """Numbers on either side of each end of a range, and of the number that must be above, which are not equal to it in
    float either."""
    above = numbers[row.below] if row.below >= 0 else math.inf
    ends = {float(end) for end in (row.least, row.most, row.low, row.high, above) if math.isfinite(end)}
    sizes = [abs(end) for end in ends if end != 0.0]
    zero = min(sizes, default=1.0)  # of an end at 0
    return sorted({end + side * CHANGE * (abs(end) or zero) for end in ends for side in (-1.0, 1.0)})


def _some(places: Sequence[int], most: int) -> list[int]:
    return list(places[:: max(1, math.ceil(len(places) / most))])


def verdict(row: Range | None, numbers: np.ndarray, value: float, design: float) -> int:
    """What the check says of one number that is changed to a finite value."""
    if row is None:
        return FINE if value == design else BEYOND
    below = row.below >= 0 and value >= numbers[row.below]
    if not row.least <= value <= row.most or below:
        return NOT_PHYSICAL
    return FINE if row.low <= value <= row.high else BEYOND


#: Where joints rest, as shares of a radian, one pose after the other; then all of them are far away.
POSES = (0.3, -0.5, 0.78, 2.34)


def rests(code: ControllerCode) -> list[tuple[np.ndarray, np.ndarray]]:
    """Link positions, and the state with the input at rest there; none where no model tells it."""
    function = code.standstill
    if function is None:
        return []
    kind = code.real.kind
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for share in POSES:
        q = np.array([share * math.cos(k) for k in range(function.size1_in(0))]).astype(kind).astype(float)
        found.append((q, _called(function, q, _model(code))))
    for angle in (float(FAR[code.real.name].rstrip("F")), *FARTHER[code.real.name]):
        far = np.full(function.size1_in(0), angle).astype(kind).astype(float)
        found.append((far, _called(function, far, _model(code))))
    return found


#: Rates of a path, the last of which changes nothing.
RATES = (0.0, 0.25, 0.7, 1.0)


def slower(code: ControllerCode) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Path rates, a command, and that of the slower motion: velocities times the rate ρ, the rest of the state times ρ²
    about rest at its positions, and the input that holds it with ρ² of what the input had beside the holding one."""
    (_, standing), *_ = rests(code)
    found: list[tuple[float, np.ndarray, np.ndarray]] = []
    states, velocities = code.sizes["estimate"], np.array(["velocity" in name for name in code.signals["X"]])
    assert code.standstill is not None
    links = code.standstill.size1_in(0)
    row = standing + 0.05 * np.cos(np.arange(standing.size))
    row[:links] = standing[:links]
    kind = code.real.kind
    row = row.astype(kind).astype(float)
    still = _called(code.standstill, row[:links], _model(code))
    assert code.controller.estimator is not None
    held = holding_function(code.controller.estimator.plant)
    for rate in RATES:
        x = still[:states] + np.where(velocities, rate, rate**2) * (row[:states] - still[:states])
        before, after = (_called(held, at, _model(code)) for at in (row[:states], x))
        u = after + rate**2 * (row[states:] - before)
        found.append((rate, row, row if rate >= 1.0 else np.concatenate([x, u])))
    return found


def _model(code: ControllerCode) -> np.ndarray:
    """Parameters of the estimator's model."""
    assert code.controller.estimator is not None
    return np.asarray(code.controller.estimator.plant.parameters.vector(), dtype=float)


def _called(function: casadi.Function, *arguments: np.ndarray) -> np.ndarray:
    """All results of a CasADi function, flat."""
    return np.concatenate([np.asarray(one.full()).ravel() for one in function.call(list(arguments))])
