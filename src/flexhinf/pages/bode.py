"""Bode diagram of a running loop, as a figure that a notebook displays."""

from __future__ import annotations

import numpy as np

from flexhinf.analysis import FrequencyResponse, Margins
from flexhinf.loop.simulation.figure import NotebookFigure
from flexhinf.report import MUTED, SERIES, house_style, label, legend

#: Decibels below the largest value that are drawn.
DEPTH_DB = 120.0


@house_style()
def bode_figure(response: FrequencyResponse) -> NotebookFigure:
    """Magnitude and phase of L_i, opened at one input with the others closed, over the frequency in Hz.

    A dot on the magnitude is where the gain may rise to 1 at the edge of stability: its distance from 0 dB is the gain
    margin upwards.
    """
    figure = NotebookFigure(figsize=(7.0, 4.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    linear = response.linear
    below_end = response.frequencies <= 0.97 * np.pi / linear.period  # at its end the phase jumps
    hertz = response.frequencies[below_end] / (2.0 * np.pi)
    factors = Margins(linear).gain_margins[:, 1]
    for i, name in enumerate(linear.inputs):
        opened, colour = response.input_loops[below_end, i], SERIES[i % len(SERIES)]
        decibel = 20.0 * np.log10(np.maximum(np.abs(opened), 1e-300))
        phase = np.degrees(np.unwrap(np.angle(opened)))
        phase -= 360.0 * np.ceil(phase[0] / 360.0)  # begins in (−360°, 0°]
        above.plot(hertz, decibel, color=colour, label=name.replace("_", " "))
        below.plot(hertz, phase, color=colour)
        if np.isfinite(factors[i]):
            critical = np.argmin(np.abs(opened + 1.0 / factors[i]))
            text = f"gain margin × {factors[i]:.3g}" if len(linear.inputs) == 1 else None
            above.plot(hertz[critical], decibel[critical], "o", color=colour, markersize=5.0, label=text)
    above.axhline(0.0, color=MUTED, linewidth=0.8, linestyle=":")
    below.axhline(-180.0, color=MUTED, linewidth=0.8, linestyle=":")
    above.set_xscale("log")
    low, high = above.get_ylim()
    above.set_ylim(bottom=max(low, high - DEPTH_DB))
    label(above, "open loop", "dB")
    label(below, "phase", "°")
    below.set_xlabel("frequency (Hz)")
    figure.align_ylabels([above, below])
    legend(above)
    return figure
