"""What the laws of a comparison are measured by: the figures of one law in its loop, and those of the design."""

from __future__ import annotations

import math
from dataclasses import replace

from flexhinf.design.criterion import Criterion, Figures
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure

#: Runs of the criterion, by the figure that is infinite where one diverged.
RUNS = {
    "peak_input": "the step",
    "load_deviation": "the run under the load",
    "move_error": "the planned move",
}


def unstable_corners(evaluation: LawEvaluation) -> int:
    """Unstable corners of the tolerances; 0 for a robot that states none."""
    return 0 if evaluation.corners is None else int(evaluation.corners.unstable)


def figures_of(evaluation: LawEvaluation, criterion: Criterion | None = None) -> Figures:
    """What a law is tuned by.

    Parameters
    ----------
    criterion : Criterion, optional
        A loop that is far beyond its limits is not run, nor run further after the step.

    Raises
    ------
    FlexhinfError
        If the loop cannot be linearised, or is unstable: then nothing is known in its favour.
    """
    found = evaluation.margins
    if not found.stable:
        raise NumericalFailure(
            "The linear loop with its estimator is unstable at the goal.",
            "expected all eigenvalues inside the unit circle",
            "other parameters",
        )
    linear = Figures(
        found.peak_sensitivity,
        found.gain_margin,
        found.damping,
        evaluation.input_noise,
        found.slowest_bandwidth,
    )
    return (
        linear if criterion is not None and criterion.is_far(linear) else _run(linear, evaluation, criterion)
    )


def own_figures(evaluation: LawEvaluation) -> Figures:
    """Those of the design's own law; of an unstable loop, or one without an equilibrium, with no margins at all."""
    try:
        return figures_of(evaluation)
    except FlexhinfError:
        return _run(Figures(math.inf, 1.0, 0.0, math.inf, math.nan), evaluation)


def yardstick(evaluation: LawEvaluation) -> Figures:
    """Figures of the design's own law, by which those of all laws are divided.

    Raises
    ------
    InvalidInput
        If there is nothing to divide by: its linear loop is unstable at the goal, or one of its runs diverges.
    """
    found = own_figures(evaluation)
    lost = [f"{run} diverges" for figure, run in RUNS.items() if math.isinf(getattr(found, figure))]
    if not evaluation.linear_failure and not evaluation.margins.stable:
        lost.insert(0, "its linear loop is unstable at the goal")
    if lost:
        raise InvalidInput(
            "The design's own law is unstable or diverges, so no law can be measured by it.",
            f"expected a stable loop whose runs stay finite, got: {'; '.join(lost)}",
            "`process_noise` and the other options of the estimator as they are by default, a smaller `load`, or a "
            "start nearer to the goal; `flexhinf design` shows the loop alone",
        )
    return found


def _run(linear: Figures, evaluation: LawEvaluation, criterion: Criterion | None = None) -> Figures:
    quiet = evaluation.quiet
    peak = evaluation.setup.limits.equivalent_peak(quiet.demanded_step)
    found = replace(linear, peak_input=peak, settling=quiet.step.settling.value)
    if criterion is not None and criterion.is_far(found):
        return found
    worst = {key: one.value for key, one in quiet.worst.items()}
    remaining = max(worst[key] for key in ("step_remaining", "load_remaining", "move_remaining"))
    return replace(
        found,
        load_deviation=worst["load_deviation"],
        move_error=worst["move_error"],
        remaining_error=remaining,
    )
