"""The loop with its estimator, linearised and sampled: how far from the edge, and what noise costs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.analysis import Margins
from flexhinf.design.page.notes import LARGEST_SENSITIVITY, LEAST_PERIODS, noise_volts, section_notes
from flexhinf.design.page.step_figure import estimation_figure
from flexhinf.design.page.units import units_of
from flexhinf.design.page.words import range_of
from flexhinf.design.result import Design
from flexhinf.report import Column, Paragraph, Section, Table, number

__all__ = ["margin_rows", "margins_section"]


def margins_section(design: Design) -> Section:
    """Margins with the estimator beside those of the true state, in words what they mean, and the noise."""
    words = " ".join(_words(design))
    blocks: list[Any] = [
        *section_notes(design, "margins"),
        *([Paragraph(words)] if words else []),
        _table(design),
    ]
    if noise_volts(design) is not None:
        blocks.append(_noise(design))
    estimate = estimation_figure(design)
    if estimate is not None:
        blocks.append(estimate)
    return Section("The loop with its estimator", tuple(blocks), "margins")


def margin_rows(design: Design) -> list[tuple[str, str, str]]:
    """What, with the estimator, with the true state fed back."""
    loops = (design.margins, design.state_margins)
    period, one = design.specification.period, len(design.margins.gain_margins) == 1
    tracked = ", ".join(name.removeprefix("link_position_") for name in design.margins.positions)
    several = 1 < len(design.margins.positions) <= 3

    def row(what: str, of: Any) -> tuple[str, str, str]:
        first, second = (of(m) if m.stable else "unstable" for m in loops)
        return what, first, second

    return [
        row("extra delay it stands, ms", lambda m: number(1e3 * m.delay_margin_s, 3)),
        row("the same in periods", lambda m: number(m.delay_margin_s / period, 3)),
        row("it then oscillates at, Hz", lambda m: number(m.delay_frequency / (2.0 * np.pi), 3)),
        row("peak sensitivity", lambda m: number(m.peak_sensitivity, 3)),
        row("its frequency, Hz", lambda m: number(m.sensitivity_frequency / (2.0 * np.pi), 3)),
        *([row("gain may fall to, rise to", _gains)] if one else []),
        row(
            f"bandwidth{f' ({tracked})' if several else ''}, rad/s",
            lambda m: _bandwidths(m.bandwidth),
        ),
    ]  # fmt: skip


def _bandwidths(found: np.ndarray) -> str:
    """Of every joint, or their range where there are many."""
    if len(found) > 3 and np.isfinite(found).all():
        return range_of(found)
    return ", ".join(number(float(w), 3) for w in found)


def _gains(m: Margins) -> str:
    low, high = m.gain_margins[0]
    return f"× {number(low if low > 1e-6 else 0.0, 3)}, × {number(high, 3)}"


def _table(design: Design) -> Table:
    alone = design.specification.estimator == "none"
    rows = [row[:2] if alone else row for row in margin_rows(design)]
    heads = (
        ("linearised at the goal, sampled", "true state")
        if alone
        else ("linearised at the goal, sampled", "with the estimator", "true state fed back")
    )
    return Table(heads, rows, "Margins, the loop broken at the inputs", "table-margins")


def _words(design: Design) -> Iterator[str]:
    """What no note says."""
    m, own, period = design.margins, design.state_margins, design.specification.period
    if m.stable and m.delay_margin_s >= LEAST_PERIODS * period:
        yield (
            f"The loop stands {number(1e3 * m.delay_margin_s, 3)} ms of extra delay, "
            f"{number(m.delay_margin_s / period, 3)} periods: enough."
        )
    if m.stable and m.peak_sensitivity <= LARGEST_SENSITIVITY:
        yield f"Its sensitivity peaks at {number(m.peak_sensitivity, 3)}; up to 2 is usual."
        if design.specification.estimator != "none" and own.stable:
            yield f"With the true state fed back that would be {number(own.peak_sensitivity, 3)}."
    volts = noise_volts(design)
    if volts is not None:
        yield (
            f"The noise of all sensors together moves the inputs by {range_of(volts, 2)} {units_of(design).effort} rms "
            "at rest."
        )


def _noise(design: Design) -> Table:
    """Gain from each sensor to the worst input, the sensor's deviation, and their product."""
    noise, gains = design.bench.noise, design.margins.noise_to_input
    assert noise is not None
    plant, units, inputs = design.bench.model, units_of(design), design.robot.joint_names
    rows = []
    for k, (name, sigma) in enumerate(zip(plant.outputs, noise)):
        worst = int(np.argmax(gains[:, k]))
        rows.append(
            (
                name.replace("_", " "),
                f"{number(float(sigma), 3)} {plant.unit(name)}",
                f"{number(float(gains[worst, k]))} {units.effort}/{plant.unit(name)}",
                float(gains[worst, k] * sigma),
                inputs[worst],
            )
        )
    columns = (
        "sensor",
        "its noise (rms)",
        "gain to the input (rms)",
        Column("at the motor, rms", units.effort),
        "motor",
    )
    return Table(columns, rows, "Noise of each sensor at the motor it moves most", "table-noise")
