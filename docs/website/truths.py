"""What the programs of the gallery say is true: each is checked when it runs, and what is false fails the build."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from math import isclose
from types import SimpleNamespace
from typing import Any

import numpy as np

#: Lines that a program prints at most, and width and height of a figure, inches.
LINES, LARGEST = 12, (7.0, 5.0)

#: Figures that are larger: the one that docs/regions.md has too.
LARGER = {"region_of_validity": (7.2, 5.0)}


class Untrue(Exception):
    """A program of the gallery says what is false, or is not what a page of the gallery is."""


def overshoot(g: Any, name: str) -> float:
    """Per cent, of a run of step_response."""
    return g.metrics[name]["overshoot_percent"]


def near(found: float, expected: float, distance: float) -> bool:
    """Whether a number is another one, within a distance."""
    return abs(found - expected) <= distance


#: The globals of each program, and what its text says of them.
TRUE: dict[str, Callable[[Any], Any]] = {
    "hji_scalar": lambda g: all(30.0 * g.errors[2 * k] < g.errors[k] for k in (4, 8))
    and 30.0 * g.errors[4] < g.errors[2],
    "van_der_pol": lambda g: g.more > 0.05 and g.near < 1e-3 and np.all(np.diff(g.predicted) > 0),
    "v_surface": lambda g: 0.85 < g.share < 1.0 and -g.difference.min() > 5.0 * g.difference.max(),
    "residual_order": lambda g: all(near(slope, k + 2, 0.1) for k, slope in g.slopes.items()),
    "f8_aircraft": lambda g: [g.recovered["linear", a] for a in g.starts] == [True, False, False]
    and [g.recovered["cubic", a] for a in g.starts] == [True, True, False],
    "nees": lambda g: near(g.means["believes the right noise"], 2.0, 0.2)
    and g.means["believes a tenth of it"] > 50.0,
    "campaign_band": lambda g: g.traces.shape[0] == len(g.overshoot) == 200
    and 3.0 < g.overshoot.max() < 10.0
    and g.settling.max() < 4.0
    and np.corrcoef(g.data["mass"], g.overshoot)[0, 1] < -0.5,
    "certificate_region": lambda g: g.checked.proved and 0.95 < g.share <= 1.0,
    "pd_against_hinf": lambda g: len({round(float(m.bandwidth[0])) // 2 for m in g.found.values()}) <= 2
    and near(g.peak["PD on the motor"], 1.7, 0.05)
    and g.peak["H∞"] < 1.01
    and g.found["PD on the motor"].delay_margin_s > 4.0 * g.found["H∞"].delay_margin_s
    and g.found["PD on the motor"].gain_margin > g.found["H∞"].gain_margin
    and g.found["PD on the motor"].damping < 0.6 * g.found["H∞"].damping,
    "vibration_modes": lambda g: all(values.max() > 1.5 * values.min() for values in g.frequencies.values()),
    "payload_step": lambda g: [np.degrees(m["steady_state_error"]) < 0.2 for m in g.metrics.values()]
    == [True] * 3,
    "latency": lambda g: g.ripple[False, 5] > 10.0 > 0.1 > max(v for k, v in g.ripple.items() if k != (False, 5)),
    "sensor_choice": lambda g: g.middle["motor"] > 10.0 * g.middle["link"] >= 10.0 * g.middle["motor and link"],
    "identify_joint": lambda g: g.found.consistent
    and all(
        abs(g.found.values[k] - g.truth[k]) < 1.96 * g.found.standard_errors[k] for k in g.truth
    )
    and 10.0 * g.worst["found"] < g.worst["data sheet"],
    "own_plant": lambda g: abs(g.final - 0.5) < 0.05
    and np.abs(g.run.data.angle - g.run.data.angle_estimated).values.max() < np.radians(1.0),
    "motions": lambda g: isclose(g.peak["jerk-limited"], 1.5, rel_tol=1e-6)
    and isclose(g.peak["quintic"], 1.875, rel_tol=1e-3),
    "gamma_tradeoff": lambda g: [p[0] for p in g.peaks.values()] == sorted(p[0] for p in g.peaks.values())
    and [p[1] for p in g.peaks.values()] == sorted((p[1] for p in g.peaks.values()), reverse=True),
    "paper_figures": lambda g: g.metrics["step to 180°", "nonlinear"]["overshoot_percent"] < 2.0
    < 20.0 < g.metrics["step to 180°", "linear"]["overshoot_percent"],
    "stirred_tank": lambda g: g.off[-100:].max() < 0.5 < g.off.max() < 10.0 and g.poles.max() > 1.0,
    "certified_reactor": lambda g: g.found.proved and g.largest > 10.0,
    "two_link_arm": lambda g: g.final < 0.002 < g.largest < 0.4,
    "moving_reference": lambda g: g.errors["sine"] < 0.2 and g.errors["move"] < 2.0,
    "step_response": lambda g: overshoot(g, "linear about the goal") < 2.0 < overshoot(g, "cubic about the goal")
    and overshoot(g, "cubic about the hanging rest") < 2.0 < overshoot(g, "linear about the hanging rest"),
    "several_poses": lambda g: max(g.errors) < 0.6 and g.fh.Status.OUTSIDE_WORKSPACE in g.controller.status,
    "specified_design": lambda g: g.found.met
    and g.found.evidence.evaluation.corners.unstable == 0
    and g.found.evidence.synthesis.robust.better  # than the preset damped, estimator in the loop
    and g.found.evidence.synthesis.robust.chosen.scale > 1.1 * g.found.evidence.synthesis.robust.damped.scale > 1.1,
    "ukf_against_ekf": lambda g: isclose(
        g.rms["encoder of the link", "unscented"], g.rms["encoder of the link", "extended"], rel_tol=1e-4
    )
    and g.rms["IMU on the link", "unscented"] < 0.8 * g.rms["IMU on the link", "extended"],
    "two_link_swing": lambda g: 5.0 * g.swing["law for the workspace"] < g.swing["stiff PD + gravity"],
    "region_of_validity": lambda g: all(
        linear < 0.5 < 1.4 < cubic < quintic
        for linear, cubic, quintic in (case.steps.values() for case in g.found)
    )
    and g.found[1].steps[6] > g.found[0].steps[6],
}  # fmt: skip


def bare_axes(figure: Any) -> list[Any]:
    """Axes without a label of their own."""
    return [axes for axes in figure.axes if not (axes.get_xlabel() or axes.get_ylabel())]


def check(
    name: str,
    example_globals: Mapping[str, Any],
    figures: Sequence[Any],
    printed: str = "",
    files: Collection[str] = (),
) -> None:
    """Look at a program that has run.

    Raises
    ------
    Untrue
        If what its text says of its globals is false, it draws nothing, a figure is too large or its axes have no
        labels, it prints too much, or it has written files.
    """
    wrong = [] if TRUE[name](SimpleNamespace(**example_globals)) else ["what it says of its results is false"]
    wrong += [] if figures else ["it draws nothing"]
    largest = LARGER.get(name, LARGEST)
    for figure in figures:
        size = tuple(figure.get_size_inches())
        if size[0] > largest[0] or size[1] > largest[1]:
            wrong.append(f"a figure of {size[0]:g} x {size[1]:g} inches; at most {largest[0]} x {largest[1]}")
        bare = bare_axes(figure)
        alone = [axes for axes in bare if axes.get_shared_x_axes().get_siblings(axes) == [axes]]
        if alone or len(bare) > len(figure.axes) // 3:
            wrong.append(f"{len(bare)} of {len(figure.axes)} axes of a figure have no label")
    lines = len(printed.splitlines())
    wrong += [f"it prints {lines} lines; at most {LINES}"] if lines > LINES else []
    wrong += [f"it leaves files behind: {', '.join(sorted(files))}"] if files else []
    if wrong:
        raise Untrue(f"{name}: {'; '.join(wrong)}")
