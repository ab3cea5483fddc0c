"""The step on robots sampled within their tolerances, with the controller as it was designed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.result import Design
from flexhinf.pages.drawing import (
    DASHED,
    Units,
    changes_text,
    figure_block,
    panels,
    reference_line,
    units_of,
)
from flexhinf.report import (
    INK,
    SERIES,
    Column,
    Figure,
    Paragraph,
    Table,
    label,
    legend,
    new_figure,
    number,
    quantile_band,
    settling_band,
)

#: Panels of link positions: of the joints whose robots differ most, relative to the largest step.
PANELS = 3

#: Fewer robots than this get no histograms.
FEW = 15

#: Half height of the panel about the goal, relative to the step.
CLOSE = 0.12


def blocks(design: Design) -> list[Any]:
    """Bands, histograms, table; none where no robot was sampled."""
    e = design.evaluation
    samples = e.step_samples
    if samples is None or not len(samples):
        return []
    units = units_of(e)
    figures = [*_bands(e, samples, units), *_histograms(e, samples, units)]
    return [Paragraph(_text(e, samples)), *figures, spread_table(e)]


def remarks(design: Design) -> Iterator[str]:
    """Runs that diverge."""
    samples = design.evaluation.step_samples
    if samples is not None and samples.diverged:
        yield (
            f"{samples.diverged} of {len(samples)} robots within their tolerances diverge with this controller. "
            "--preset robust includes the tolerances in the synthesis."
        )


def _text(e: LawEvaluation, samples: MonteCarlo) -> str:
    worst = {"Largest overshoot": samples.worst, "Slowest settling": samples.slowest}
    if samples.worst == samples.slowest:
        worst = {"Largest overshoot and slowest settling": samples.worst}
    robot, extras = e.setup.robot, e.setup.specification.extras
    which = (
        f" {what}: robot {k + 1} ({changes_text(samples.values[k], robot, extras)})."
        for what, k in worst.items()
    )
    return (
        f"{len(robot.uncertain)} parameters of the robot are sampled uniformly within their tolerances, {len(samples)} "
        "times. Controller and estimator stay as designed for the nominal robot; every robot has its own measurement "
        f"noise. A sample says nothing about the robots between.{''.join(which)}"
    )


def _bands(e: LawEvaluation, samples: MonteCarlo, units: Units) -> list[Figure]:
    """Link positions of all robots that reached the end; none if there is none."""
    ended = np.flatnonzero(np.isfinite(samples.positions).all(axis=(1, 2)))
    if not len(ended):
        return []
    away, names = units.scale * (samples.positions[ended] - e.setup.goal), e.setup.joints
    steps = units.scale * np.abs(e.setup.goal - e.setup.start)
    spread = np.ptp(away, axis=0)  # of all robots, at each time and joint
    shown = sorted(np.argsort(-spread.max(axis=0))[:PANELS].tolist())
    late = spread[away.shape[1] // 2 :].max(axis=0)
    close = int(np.argmax(np.where(steps > 0.0, late / np.where(steps > 0.0, steps, 1.0), -1.0)))
    worst = {samples.worst: "largest overshoot"}
    worst[samples.slowest] = f"{worst.get(samples.slowest, '')}, slowest settling".removeprefix(", ")
    styles = ({"color": INK, "dashes": (5.0, 1.5)}, {"color": SERIES[1], "dashes": (2.0, 1.2)})
    figure, axes = new_figure(len(shown) + 1)
    for axis, joint in zip(axes, [*shown, close]):
        quantile_band(axis, samples.time, away[:, :, joint])
        for (robot, name), style in zip(worst.items(), styles):
            for line in away[ended == robot, :, joint]:
                axis.plot(samples.time, line, label=name, linewidth=1.1, **style)
        reference_line(axis)
        label(axis, f"{names[joint]} − goal" if len(names) > 1 else "link − goal", units.angle)
    settling_band(axes[-1], 0.0, float(steps[close]))
    axes[-1].set_ylim(-CLOSE * steps[close] or -1e-3, CLOSE * steps[close] or 1e-3)
    legend(axes[0])
    some = f", the {len(shown)} joints that differ most" if len(shown) < len(names) else ""
    closer = f"{names[close]}, close to its goal" if len(names) > 1 else "the same, close to the goal"
    missing = len(samples) - len(ended)
    gone = f" {missing} that diverged are left out." if missing else ""
    caption = (
        f"Link positions as distance from the goal{some}, of {len(ended)} sampled robots.{gone} Bottom: {closer}, "
        "with the band of ±2 % of the step."
    )
    return [figure_block("draws", figure, caption, "Sampled robots")]


def _metrics(e: LawEvaluation, samples: MonteCarlo) -> list[tuple[str, str, np.ndarray, float, str]]:
    """Name, unit, values of the robots, value of the nominal one, and joint of the worst."""
    step, peak = e.step, int(np.argmax(samples.peak))
    return [
        ("overshoot", "%", samples.overshoot, step.overshoot.value, samples.overshoot_joints[samples.worst]),
        (
            "settling time",
            "s",
            samples.settling,
            step.settling.value,
            samples.settling_joints[samples.slowest],
        ),
        ("peak input", units_of(e).effort, samples.peak, step.peak_input, samples.peak_joints[peak]),
    ]


def _histograms(e: LawEvaluation, samples: MonteCarlo, units: Units) -> list[Figure]:
    """How overshoot, settling time and peak input spread; none for few robots, or where no run settles."""
    s, peaks = e.setup.specification, e.setup.limits.peak
    metrics = _metrics(e, samples)
    if len(samples) < FEW or not any(np.isfinite(values).any() for _, _, values, _, _ in metrics[:2]):
        return []
    same = np.isfinite(peaks[0]) and len(set(peaks.tolist())) == 1
    limits, grains = (s.overshoot, None, float(peaks[0]) if same else None), (0.0, s.period, 0.0)
    figure, (axes,) = panels(1, 3, 2.5)
    for axis, (name, unit, every, nominal, _), limit, grain in zip(axes, metrics, limits, grains):
        values = every[np.isfinite(every)]
        axis.set_xlabel(f"{name} ({unit})")
        label(axis, "robots", "")
        if not len(values):
            continue
        axis.hist(values, bins=histogram_bins(values, grain).tolist(), color=SERIES[0], alpha=0.55)
        axis.grid(axis="x", visible=False)
        if np.isfinite(nominal):
            axis.axvline(nominal, color=SERIES[1], linewidth=1.6)
        if limit is not None and float(values.max()) > 0.5 * limit:
            axis.axvline(limit, color=INK, linewidth=1.0, dashes=DASHED)
    caption = (
        "How many robots have which overshoot, settling time and peak input (the worst joint of each). The orange "
        "line is the nominal robot, the dashed one a limit that is near or exceeded."
    )
    return [figure_block("spread", figure, caption, "Spread of the sampled robots")]


def histogram_bins(values: np.ndarray, grain: float) -> np.ndarray:
    """Edges of bins over values; where these are multiples of a grain, such as the period, so is the bins' width.

    Bins that are not would hold now more, now fewer of the possible values, and look like a comb.
    """
    count = min(20, max(5, len(values) // 5))
    if not grain:
        return np.histogram_bin_edges(values, count)
    first, last = (round(float(end) / grain) for end in (values.min(), values.max()))
    wide = max(1, -(-(last - first + 1) // count))
    return grain * (np.arange(first, last + wide + 1, wide) - 0.5)


def spread_table(e: LawEvaluation) -> Table:
    """Nominal robot, median, 95th percentile and worst of the samples, with the joint of the worst."""
    samples, several = e.step_samples, len(e.setup.joints) > 1
    assert samples is not None
    rows = []
    for name, unit, values, nominal, joint in _metrics(e, samples):
        quantiles = (float(np.quantile(values, q, method="higher")) for q in (0.5, 0.95, 1.0))
        cells = ("never" if np.isinf(value) else number(value, 3) for value in (nominal, *quantiles))
        rows.append((name, unit, *cells, *([joint or "–"] if several else [])))
    settled = f"{len(samples) - samples.unsettled} of {len(samples)} settle, {samples.diverged} diverge"
    columns = (
        "", "unit", Column("nominal robot", brief="nominal", right=True), Column("median", right=True),
        Column("95 % are below", brief="95 % below", right=True),
        Column("worst", right=True), *(["worst joint"] if several else []),
    )  # fmt: skip
    title = f"The step on {len(samples)} robots sampled within their tolerances: {settled}"
    caption = f"Worst joint of each robot: {settled}" if several else settled
    return Table(columns, rows, caption, "table-draws", title=title)
