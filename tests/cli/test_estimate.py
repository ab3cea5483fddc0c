"""``flexhinf estimate``: a log's page, its files, what is refused before any work, and what the page says."""

from __future__ import annotations

import csv
import html
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.logs import write_log
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli import main


@pytest.fixture(scope="module")
def run() -> Any:
    """A second of the paper's arm, its motor and its link measured, the input a sample late."""
    noise, sensors = {"q": [0, 0, 1e-7, 1e-7], "r": [1e-8, 1e-6]}, ("motor_position", "link_position")
    controller = arm_controller(measured=sensors, **noise, p0=1e-6, limit=None)
    return fh.Loop(controller.estimator.plant, controller).run(
        fh.Sine(0.3, 1.0), duration=1.5, noise=[1e-4, 1e-3], seed=1
    )


WORDS = ["run.csv", "--robot", "paper", "--measured", "motor_position,link_position", "--latency", "1"]


@pytest.mark.ci("filters a log, and draws its page")
@pytest.mark.parametrize("kind", ["unscented", "extended"])
def test_a_run_of_ours_fits_its_filter(
    run: Any, folder: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    """Noises from the log are those of the simulation; estimates are nearer to the truth than what is measured."""
    run.save(folder / "run.csv")
    assert main(["estimate", *WORDS, "--filter", kind]) == 0
    told = capsys.readouterr().out
    assert unnamed(told, "motor position", "link position", "NIS", "white") == []
    report = folder / "flexhinf-estimate"
    assert {path.name for path in report.iterdir()} == {
        "index.html", "estimate.csv", "estimate.json", "flexhinf-report.json",
    }  # fmt: skip
    numbers = json.loads((report / "estimate.json").read_text(encoding="utf-8"))
    assert numbers["fits"]
    assert numbers["filter"]["kind"].startswith(kind)
    assert numbers["filter"]["sources"]["measurement noise"] == "the log"
    np.testing.assert_allclose(np.diag(numbers["filter"]["measurement_noise"]), [1e-8, 1e-6], rtol=0.2)
    assert numbers["nis"]["judgement"] == "as expected"
    assert numbers["log"]["samples"] == 1500
    assert all(output["whiteness"]["white"] for output in numbers["outputs"].values())
    with (report / "estimate.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == 1500
    estimate = np.array([float(row["estimate.link_position [rad]"]) for row in table])
    truth = run.signals["state"][1:, 0]
    assert np.sqrt(np.mean((estimate - truth)[300:] ** 2)) < 0.2 * 1e-3
    page = (report / "index.html").read_text(encoding="utf-8")
    assert [anchor for anchor in ("innovations", "nis", "measured", "estimates", "nees", "errors", "correlation")
            if f'id="figure-{anchor}"' not in page] == []  # fmt: skip
    assert "://" not in page.replace("http://www.w3.org", "")
    again = ["flexhinf", "estimate", *WORDS, *(["--filter", kind] if kind == "extended" else [])]
    assert all(word in page for word in again)


@pytest.mark.ci("filters a log, and draws its page")
def test_a_latency_that_is_left_out_shows(run: Any, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run.save(folder / "run.csv")
    assert main(["estimate", *WORDS[:-2]]) == 0
    numbers = json.loads((folder / "flexhinf-estimate" / "estimate.json").read_text(encoding="utf-8"))
    assert not numbers["fits"]
    assert numbers["nees"]["judgement"] == "larger"
    told = " ".join(capsys.readouterr().out.split())
    assert unnamed(told, "motor_voltage", "1 sample later", "--latency 1") == []


@pytest.mark.ci("filters a log twice, and draws its page")
def test_columns_and_noises_at_the_command_line(
    run: Any, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Other names, degrees, milliseconds, a slow link encoder, noises that are stated: the numbers of Python."""
    y, u = run.signals["output"], run.signals["input"]
    rows = [
        f"{1e3 * t:.17g},{math.degrees(a):.17g},{'' if k % 5 else repr(float(b))},{float(v)!r}"
        for k, (t, (a, b), (v,)) in enumerate(zip(run.time, y, u))
    ]
    (folder / "log.csv").write_text("stamp [ms],pos,link,volts\n" + "\n".join(rows) + "\n")
    words = [
        "estimate", "log.csv", "--robot", "paper", "--measured", "motor_position", "--latency", "1", "--column",
        "motor_position=pos [deg]", "--column", "motor_voltage=volts", "--measurement-noise", "4e-8", "--torque-noise",
        "1e-9", "--form", "covariance", "--filter", "extended", "--out", "here",
    ]  # fmt: skip
    assert main(words) == 0
    numbers = json.loads((folder / "here" / "estimate.json").read_text(encoding="utf-8"))
    assert numbers["filter"]["form"] == "covariance"
    assert numbers["filter"]["measurement_noise"] == [[4e-8]]
    np.testing.assert_allclose(np.diag(numbers["filter"]["process_noise"]), [0, 1e-9, 0, 1e-9])
    plant = fh.paper_arm().plant("motor_position")
    columns = {"motor_position": "pos [deg]", "motor_voltage": "volts"}
    log = fh.read_log(folder / "log.csv", plant, columns, latency=1)
    np.testing.assert_allclose(log.outputs[:, 0], y[1:, 0], rtol=1e-14)
    np.testing.assert_array_equal(log.inputs, u[:-1])
    period, first = numbers["filter"]["period_s"], [y[1, 0], 0.0, y[1, 0], 0.0]
    filter = fh.ExtendedKalmanFilter(plant, period, np.diag([0, 1e-9, 0, 1e-9]), 4e-8, first, 1.0)
    expected = fh.filter_log(filter, log)
    last = numbers["last_estimate"]
    for k, state in enumerate(plant.states):
        assert last[state]["value"] == pytest.approx(float(expected.estimate[-1, k]), rel=1e-6, abs=1e-9)
        assert last[state]["standard_deviation"] == pytest.approx(
            float(expected.standard_deviation[-1, k]), rel=1e-6
        )
    assert numbers["log_likelihood"] == pytest.approx(expected.attrs["log_likelihood"], rel=1e-9)


@pytest.mark.ci("filters a log twice, and draws its page")
def test_outliers_are_left_out_and_states_kept_in_bounds(
    run: Any, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The estimates of Python's filter with the same gate and bounds; the outliers are in no innovation."""
    y = np.array(run.signals["output"])
    y[[300, 700, 1100], 1] += [0.4, -0.5, 0.3]
    names = ("motor_voltage", "motor_position", "link_position")
    write_log(folder / "run.csv", names, run.time, run.signals["input"], y)
    words = ["--filter", "extended", "--gate", "0.99999", "--bounds", "link_velocity=-80 deg/s..1"]
    assert main(["estimate", *WORDS, *words]) == 0
    told = capsys.readouterr().out
    assert unnamed(told, "link position", 3, 1500) == []
    numbers = json.loads((folder / "flexhinf-estimate" / "estimate.json").read_text(encoding="utf-8"))
    assert numbers["fits"]
    assert numbers["filter"]["gate"] == 0.99999
    assert numbers["outputs"]["link_position"]["rejected"] == 3
    assert numbers["outputs"]["link_position"]["samples"] == 1497
    ends = numbers["filter"]["bounds"]["link_velocity"]
    np.testing.assert_allclose(ends, [math.radians(-80.0), 1.0])
    plant = fh.paper_arm().plant(("motor_position", "link_position"))
    log = fh.read_log(folder / "run.csv", plant, latency=1)
    used = numbers["filter"]
    filter = fh.ExtendedKalmanFilter(
        plant, used["period_s"], used["process_noise"], used["measurement_noise"],
        [log.outputs[0, 1], 0.0, log.outputs[0, 0], 0.0], 1.0, form="square_root", gate=0.99999,
        bounds={"link_velocity": ends},
    )  # fmt: skip
    expected = fh.filter_log(filter, log)
    assert numbers["last_estimate"]["link_position"]["value"] == pytest.approx(
        float(expected.estimate[-1, 0]), rel=1e-6
    )
    places = np.flatnonzero(expected["rejected"].values[:, 1])
    assert places.tolist() == [299, 699, 1099]
    assert np.isnan(expected.innovation.values[places, 1]).all()
    assert np.isfinite(expected.innovation.values[places, 0]).all()
    assert float(expected.estimate.max("time")[1]) <= 1.0


@pytest.mark.ci("smooths a log, and draws its page")
def test_parquet(run: Any, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parquet: Any = pytest.importorskip("pyarrow.parquet")
    run.save(folder / "run.csv")
    assert main(["estimate", *WORDS, "--table", "parquet", "--smooth"]) == 0
    table = parquet.read_table(folder / "flexhinf-estimate" / "estimate.parquet")
    assert "standard_deviation.motor_velocity [rad/s]" in table.column_names
    truth = run.signals["state"][1:, 1]
    errors = [
        float(np.std((table[f"{kind}.link_velocity [rad/s]"].to_numpy() - truth)[300:1200]))
        for kind in ("smoothed", "estimate")
    ]
    assert errors[0] < errors[1]
    assert len(table) == 1500


@pytest.mark.ci("a loop, a filter over its log, and a page of eight figures")
def test_a_design_states_sensors_noises_and_latency(
    run: Any, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run.save(folder / "run.csv")
    (folder / "design.toml").write_text(
        '[design]\nrobot = "paper"\nmeasured = ["motor_position"]\nmeasurement_noise = 1e-8\ntorque_noise = 1e-9\n'
    )
    assert main(["estimate", "run.csv", "--robot", "design.toml"]) == 0
    numbers = json.loads((folder / "flexhinf-estimate" / "estimate.json").read_text(encoding="utf-8"))
    assert set(numbers["filter"]["sources"].values()) == {"the design"}
    assert numbers["log"]["samples"] == 1500
    assert numbers["filter"]["period_s"] == 1e-3
    np.testing.assert_allclose(np.diag(numbers["filter"]["process_noise"]), [0, 1e-9, 0, 1e-9])
    assert list(numbers["outputs"]) == ["motor_position"]


@pytest.mark.ci("three commands over one log, each with a page")
@pytest.mark.usefixtures("unoptimised")
def test_pages_of_a_log_show_angles_as_those_of_its_design_do(run: Any, folder: Path) -> None:
    """A goal in degrees: no page has an angle or its rate in rad, and the tables of numbers stay as they are."""
    run.save(folder / "run.csv")
    (folder / "design.toml").write_text('[design]\nrobot = "paper"\npose = "90deg"\n', encoding="utf-8")
    shared = [
        "run.csv",
        "--robot",
        "design.toml",
        "--measured",
        "motor_position,link_position",
        "--latency",
        "1",
    ]
    bounds = ["--bounds", "link_velocity=-2000deg/s..2000deg/s"]
    for command, *more in (
        ["estimate", *bounds],
        ["identify", "--parameters", "stiffness", "--no-simulate"],
        ["check", "--no-model"],
    ):
        assert main([command, *shared, *more, "--out", command]) == 0
        page = (folder / command / "index.html").read_text(encoding="utf-8")
        shown = html.unescape(re.sub(r"<(script|style)\b.*?</\1>|<[^>]*>", " ", page, flags=re.DOTALL))
        assert "°" in shown
        # N·m/rad are of the robot's file; options are as they were stated
        assert re.findall(r".{0,40}(?<![/\w])[mµ]?rad\b.{0,9}", shown) == [], command
    with (folder / "estimate" / "estimate.csv").open(encoding="utf-8", newline="") as file:
        assert "estimate.link_position [rad]" in next(csv.reader(file))


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["run.csv"], ("--robot", "flexhinf robots")),
        (["arm.toml", "run.csv"], ("estimate run.csv --robot arm.toml",)),
        (["none.csv", "--robot", "paper"], ("none.csv",)),
        (["run.csv", "--robot", "papre"], ("papre", "paper")),
        (["run.csv", "--robot", "paper", "--column", "motor_position"], ("--column", "motor_position")),
        (["run.csv", "--robot", "paper", "--column", "a=b", "--column", "a=c"], ("--column", "'a'", "twice")),
        (["run.csv", "--robot", "paper", "--column", "link_position=lnk"], ("'lnk'", "output.link_position")),
        (["run.csv", "--robot", "paper", "--measured", "joint_torque,link_position"],
         ("joint_torque", '--column "joint_torque=', "--measured")),
        (["run.csv", "--robot", "paper", "--time", "tiem"], ("tiem", "'time'")),
        (["run.csv", "--robot", "paper", "--latency", "-1"], ("latency", "-1")),
        (["run.csv", "--robot", "paper", "--latency", "9999"], ("latency", "9999")),
        (["run.csv", "--robot", "paper", "--measurement-noise", "1,2,3"], ("noise", "3")),
        (["run.csv", "--robot", "paper", "--filter", "particle"], ("particle", "unscented")),
        (["run.csv", "--robot", "paper", "--out", "run.csv"], ("run.csv",)),
        (["gaps.csv", "--robot", "paper"], ("gaps.csv", "motor_voltage", "--hold-inputs")),
        (["run.csv", "--robot", "paper", "--gate", "1"], ("--gate", "1")),
        (["run.csv", "--robot", "paper", "--gate", "nan"], ("--gate", "nan")),
        (["run.csv", "--robot", "paper", "--bounds", "link_position"], ("--bounds", "link_position", "low..high")),
        (["run.csv", "--robot", "paper", "--bounds", "link_position=1..-1"], ("--bounds", "link_position=1..-1")),
        (["run.csv", "--robot", "paper", "--bounds", "link_position=nan..1"], ("--bounds", "link_position=nan..1")),
        (["run.csv", "--robot", "paper", "--bounds", "lnk=-1..1"], ("--bounds", "lnk", "link_position")),
        (["run.csv", "--robot", "paper", "--bounds", "link_position=0..1", "--bounds", "link_position=0..2"],
         ("--bounds", "link_position", "twice")),
        (["run.csv", "--robot", "paper", "--bounds", "link_position=1..2"], ("link_position", "mean", "1 to 2")),
    ],
)  # fmt: skip
def test_what_is_refused(
    run: Any, folder: Path, refused: Callable[..., str], words: list[str], what: tuple[str, ...]
) -> None:
    run.save(folder / "run.csv")
    rows = "".join(f"{0.001 * k},{'' if k % 2 else 1},0.1\n" for k in range(20))
    (folder / "gaps.csv").write_text("time,motor_voltage,link_position\n" + rows)
    refused(["estimate", *words], what, folder)


@pytest.mark.ci("five estimates, most of them interrupted")
def test_ctrl_c_leaves_nothing(
    run: Any, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """While it reads, filters and draws: nothing is written, and an earlier report stays as it was."""
    run.save(folder / "run.csv")

    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    for where in ("flexhinf.read_log", "flexhinf.filter_log", "flexhinf.pages.report_files"):
        with monkeypatch.context() as patch:
            patch.setattr(where, interrupted)
            assert main(["estimate", *WORDS]) == 130
        assert {path.name for path in folder.iterdir()} == {"run.csv"}
    assert main(["estimate", *WORDS]) == 0
    before = (folder / "flexhinf-estimate" / "index.html").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr("flexhinf.pages.report_files", interrupted)
        assert main(["estimate", *WORDS, "--filter", "extended"]) == 130
    assert (folder / "flexhinf-estimate" / "index.html").read_bytes() == before


@pytest.mark.ci("a page of eight states")
def test_several_joints_have_figures_of_four_panels(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two links: eight states in two figures, and the inputs and outputs by the joints' names."""
    robot = fh.load_robot("planar-two-link")
    plant, pose = robot.plant("motor_position"), [0.2, -0.3]
    x, u = robot.operating_point(pose)
    y = x[4:6] + 1e-4 * np.random.default_rng(4).normal(size=(60, 2))
    write_log(
        folder / "log.csv", (*plant.inputs, *plant.outputs), 1e-3 * np.arange(60), np.tile(u, (60, 1)), y
    )
    words = ["estimate", "log.csv", "--robot", "planar-two-link", "--measured", "motor_position", "--smooth"]
    assert main([*words, "--filter", "extended"]) == 0
    page = (folder / "flexhinf-estimate" / "index.html").read_text(encoding="utf-8")
    assert 'id="figure-estimates"' in page
    assert 'id="figure-estimates-2"' in page
    assert 'id="figure-estimates-3"' not in page
    numbers = json.loads((folder / "flexhinf-estimate" / "estimate.json").read_text(encoding="utf-8"))
    assert list(numbers["outputs"]) == ["motor_position_shoulder", "motor_position_elbow"]
    for k, state in enumerate(plant.states):
        found = numbers["last_estimate"][state]
        assert abs(found["value"] - x[k]) < 5.0 * found["standard_deviation"]
