"""Programs of the gallery: each runs anywhere, writes nothing, draws labelled figures, and says what is true."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import flexhinf as fh


def overshoot(g: Any, name: str) -> float:
    """Per cent, of a run of step_response."""
    return g.metrics[name]["overshoot_percent"]


#: The globals of each program, and what its text says of them.
TRUE: dict[str, Callable[[Any], bool]] = {
    "hji_scalar": lambda g: all(30.0 * g.errors[2 * k] < g.errors[k] for k in (4, 8))
    and 30.0 * g.errors[4] < g.errors[2],
    "van_der_pol": lambda g: g.more > 0.05 and g.near < 1e-3 and np.all(np.diff(g.predicted) > 0),
    "v_surface": lambda g: 0.85 < g.share < 1.0 and -g.difference.min() > 5.0 * g.difference.max(),
    "residual_order": lambda g: all(slope == pytest.approx(k + 2, abs=0.1) for k, slope in g.slopes.items()),
    "f8_aircraft": lambda g: [g.recovered["linear", a] for a in g.starts] == [True, False, False]
    and [g.recovered["cubic", a] for a in g.starts] == [True, True, False],
    "nees": lambda g: g.means["believes the right noise"] == pytest.approx(2.0, abs=0.2)
    and g.means["believes a tenth of it"] > 50.0,
    "campaign_band": lambda g: g.traces.shape[0] == len(g.overshoot) == 200
    and 3.0 < g.overshoot.max() < 10.0
    and g.settling.max() < 4.0
    and np.corrcoef(g.data["mass"], g.overshoot)[0, 1] < -0.5,
    "certificate_region": lambda g: g.checked.proved and 0.95 < g.share <= 1.0,
    "pd_against_hinf": lambda g: len({round(float(m.bandwidth[0])) // 2 for m in g.found.values()}) <= 2
    and g.peak["PD on the motor"] == pytest.approx(1.7, abs=0.05)
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
    "motions": lambda g: g.peak["jerk-limited"] == pytest.approx(1.5)
    and g.peak["quintic"] == pytest.approx(1.875, rel=1e-3),
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
    "several_poses": lambda g: max(g.errors) < 0.6 and fh.Status.OUTSIDE_WORKSPACE in g.controller.status,
    "specified_design": lambda g: g.found.met
    and g.found.evaluation.corners.unstable == 0
    and g.found.synthesis.robust.better  # than the preset damped, estimator in the loop
    and g.found.synthesis.robust.chosen.scale > 1.1 * g.found.synthesis.robust.damped.scale > 1.1,
    "ukf_against_ekf": lambda g: g.rms["encoder of the link", "unscented"]
    == pytest.approx(g.rms["encoder of the link", "extended"], rel=1e-4)
    and g.rms["IMU on the link", "unscented"] < 0.8 * g.rms["IMU on the link", "extended"],
    "two_link_swing": lambda g: 5.0 * g.swing["law for the workspace"] < g.swing["stiff PD + gravity"],
}  # fmt: skip


@pytest.fixture(autouse=True)
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """An empty folder, and no figures before or after."""
    mpl.use("Agg")
    monkeypatch.chdir(tmp_path)
    import matplotlib.pyplot as plt

    plt.close("all")
    yield
    plt.close("all")


#: Programs that take more than three seconds on a busy machine.
LONG = {
    "campaign_band", "certificate_region", "certified_reactor", "f8_aircraft", "identify_joint", "nees",
    "several_poses", "specified_design", "step_response", "ukf_against_ekf",
}  # fmt: skip


@pytest.mark.quick_cases(6)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.ci) if name in LONG else name for name in sorted(TRUE)]
)
def test_a_program_draws_and_says_what_is_true(
    repository: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import matplotlib.pyplot as plt

    found = runpy.run_path(str(repository / "examples" / f"{name}.py"), run_name="__main__")
    assert TRUE[name](type("Globals", (), found))
    figures = {plt.figure(k) for k in plt.get_fignums()} | {
        v for v in found.values() if isinstance(v, Figure)
    }
    assert figures
    for figure in figures:
        width, height = figure.get_size_inches()
        assert width <= 7.0
        assert height <= 5.0
        bare = [axes for axes in figure.axes if not (axes.get_xlabel() or axes.get_ylabel())]
        assert all(axes.get_shared_x_axes().get_siblings(axes) != [axes] for axes in bare)
        assert len(bare) <= len(figure.axes) // 3
    assert len(capsys.readouterr().out.splitlines()) <= 12
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", sorted(TRUE))
def test_a_program_is_a_page(repository: Path, name: str) -> None:
    """A title, blocks with a sentence each, and little code."""
    text = (repository / "examples" / f"{name}.py").read_text(encoding="utf-8")
    title, underline = text.splitlines()[1:3]
    assert underline == "=" * len(title)
    assert text.count("\n# %%\n") >= 2
    code = [
        line for line in text.split('"""', 2)[2].splitlines() if line.strip() and not line.startswith("#")
    ]
    assert len(code) <= 60
    for block in re.split(r"^# %%\n", text, flags=re.MULTILINE)[1:]:
        assert block.strip()
