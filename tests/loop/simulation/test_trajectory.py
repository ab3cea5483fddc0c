import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop, Step
from flexhinf.plant import Plant
from flexhinf.robot import paper_arm

# Kernels that run once each: 2 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

KINDS = "state", "estimate", "output", "input", "reference", "disturbance"


@pytest.fixture(scope="module")
def run(made):
    loop = Loop(paper_arm().plant(inductance=True), Controller(made.law, made.ukf()))
    return loop.run(Step(1.2, at=0.5), {"link_torque": 1.0}, 1e-3, 6.0, seed=3)


def test_the_dataset_is_labelled(run):
    data = run.data
    assert set(data.data_vars) == {*KINDS, *run.columns}
    assert data.state.dims == ("time", "state_name")
    assert data.time.attrs["units"] == "s"
    np.testing.assert_allclose(data.time, np.arange(6001) * 1e-3)
    assert data.state_name.values.tolist() == list(paper_arm().plant(inductance=True).states)
    assert data.state_unit.values.tolist() == ["rad", "rad/s", "rad", "rad/s", "A"]
    assert data.input.attrs["units"] == "V"
    assert data.disturbance_name.values.tolist() == ["link_torque", "motor_torque"]
    assert data.disturbance_unit.values.tolist() == ["N·m", "N·m"]
    assert data.attrs["seed"] == "3"
    assert re.fullmatch(r"step .*1\.2 .*0\.5 s", data.attrs["reference"])
    by_name = data.state.sel(state_name="link_position").values
    np.testing.assert_array_equal(by_name, run.signal("state", "link_position"))


def test_each_signal_is_a_variable(run):
    data = run.data
    for name, kind, own, unit in (
        ("link_position", "state", "link_position", "rad"), ("coil_current", "state", "coil_current", "A"),
        ("link_position_estimated", "estimate", "link_position", "rad"),
        ("link_position_measured", "output", "link_position", "rad"),
        ("link_position_commanded", "reference", "link_position", "rad"),
        ("motor_voltage", "input", "motor_voltage", "V"), ("link_torque", "disturbance", "link_torque", "N·m"),
    ):  # fmt: skip
        np.testing.assert_array_equal(data[name].values, run.signal(kind, own))
        assert (data[name].dims, data[name].attrs["units"]) == (("time",), unit)
        assert run.columns[name] == (kind, run.names[kind].index(own))
    assert data.link_position.sel(time=1.0).item() == run.signal("state", "link_position")[1000]


def test_a_flat_table(run, monkeypatch):
    table = run.to_dataframe()
    assert list(table.columns) == list(run.columns)
    assert table.index.name == "time"
    np.testing.assert_array_equal(table.index, run.time)
    np.testing.assert_array_equal(table.link_position_estimated, run.signal("estimate", "link_position"))
    assert table.attrs["units"]["motor_voltage"] == "V"
    monkeypatch.setitem(sys.modules, "pandas", None)
    with refused_with(InvalidInput, "pandas", "pip install"):
        run.to_dataframe()


def test_names_that_are_taken_get_their_kind(made):
    """States that are called like a kind of signal, like the time, or like another's estimate."""
    names = "state", "time", "state_state"
    plant = Plant(lambda x, u, d, p: -x + u[0], lambda x, u, p: x, names, ("u",), outputs=names)
    law = made.LinearLaw(names, ("u",), -np.ones((1, 3)))
    run = Loop(plant, Controller(law, None, 1e-2)).run(duration=0.1, initial_state=[1.0, 2.0, 3.0])
    assert list(run.columns)[:4] == ["state_state", "time_state", "state_state_state", "u"]
    assert run.data.state.dims == ("time", "state_name")
    np.testing.assert_array_equal(run.data.time_state, run.signal("state", "time"))


def test_what_is_recorded(run):
    assert np.all(run.signal("reference", "link_position") == np.where(run.time >= 0.5, 1.2, 0.0))
    assert np.all(run.signal("disturbance", "link_torque") == 1.0)
    error = run.signals["output"][:, 0] - run.signal("state", "link_position")
    assert error.std() == pytest.approx(1e-3, rel=0.05)


def test_nothing_can_be_changed(run):
    with pytest.raises(ValueError, match="read-only"):
        run.signals["state"][0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        run.time[0] = 1.0


@pytest.mark.oracle
def test_metrics_of_the_run(run):
    metrics = run.metrics()
    q, r = run.signal("state", "link_position"), run.signal("reference", "link_position")
    after = run.time >= 0.5
    assert metrics["overshoot_percent"] == pytest.approx(100 * (q[after].max() - 1.2) / 1.2, rel=1e-12)
    outside = run.time[after][np.abs(q[after] - 1.2) > 0.024][-1]
    assert metrics["settling_time_s"] == pytest.approx(outside - 0.5, abs=1e-9)
    assert metrics["steady_state_error"] == np.abs(q - r)[-601:].max()
    assert metrics["peak_input"] == np.abs(run.signals["input"]).max()
    assert metrics["tracking_rmse"] == pytest.approx(np.sqrt(np.mean((q - r) ** 2)), rel=1e-14)
    differences = run.signals["estimate"] - run.signals["state"][:, :4]
    np.testing.assert_allclose(
        metrics["estimation_rmse"], np.sqrt(np.mean(differences**2, axis=0)), rtol=1e-14
    )
    assert run.metrics("link_position") == metrics


def test_unknown_names_are_refused(run):
    with refused_with(InvalidInput, "'motor_position'", "['link_position']"):
        run.metrics("motor_position")
    with pytest.raises(InvalidInput, match="state 'speed'"):
        run.signal("state", "speed")
    with pytest.raises(InvalidInput, match="velocity 'link_position'"):
        run.signal("velocity", "link_position")
    with pytest.raises(InvalidInput):
        run.tracked("speed")


def test_the_plot(run, tmp_path):
    from matplotlib.figure import Figure

    figure = run.plot()
    assert isinstance(figure, Figure)
    above, below = figure.axes
    named = [line.get_label() for line in above.lines]
    assert len(named) == 3
    assert [unnamed(name, word) for name, word in zip(named, ("link position", "estimated", "command"))] == [
        []
    ] * 3
    assert named[0].endswith("(°)")
    np.testing.assert_allclose(above.lines[0].get_ydata(), np.degrees(run.signal("state", "link_position")))
    (named,) = [line.get_label() for line in below.lines]
    assert unnamed(named, "motor voltage", "V") == []
    figure.savefig(tmp_path / "run.png")
    assert (tmp_path / "run.png").read_bytes()[:4] == b"\x89PNG"


def test_the_plot_of_a_run_that_tracks_nothing(made):
    plant, _ = made.two_inputs()
    law = made.LinearLaw(plant.states, plant.inputs, -np.ones((2, 4)))
    run = Loop(plant, Controller(law, None, 1e-2)).run(duration=0.1, initial_state={"a": 1.0})
    above, below = run.plot().axes
    assert len(above.lines) == 8
    assert len(below.lines) == 2


# Files and notebooks --------------------------------------------------------------------------------
def test_a_table_of_all_signals(run, tmp_path):
    path = tmp_path / "run.csv"
    run.save(path)
    header, *_ = path.read_text(encoding="utf-8").splitlines()
    columns = header.split(",")
    assert columns[:2] == ["time [s]", "state.link_position [rad]"]
    assert "disturbance.link_torque [N·m]" in columns
    values = np.loadtxt(path, delimiter=",", skiprows=1, encoding="utf-8")
    assert values.shape == (len(run.time), len(columns))
    np.testing.assert_array_equal(values[:, 0], run.time)
    np.testing.assert_array_equal(
        values[:, columns.index("input.motor_voltage [V]")], run.signals["input"][:, 0]
    )
    assert [file.name for file in tmp_path.iterdir()] == ["run.csv"]


def test_netcdf_is_what_xarray_reads(run, tmp_path):
    import xarray as xr

    run.save(tmp_path / "run.nc")
    with xr.open_dataset(tmp_path / "run.nc") as data:
        np.testing.assert_array_equal(data.state.values, run.signals["state"])
        assert data.state_name.values.tolist() == list(run.names["state"])
        assert data.disturbance_unit.values.tolist() == ["N·m", "N·m"]
        assert data.attrs["status"] == "completed"
        xr.testing.assert_identical(data.load(), run.data[list(KINDS)])


@pytest.mark.ci("starts a process")
def test_a_run_is_saved_without_importing_xarray(tmp_path):
    """Importing it takes longer than many a run, and `flexhinf design` saves some."""
    code = (
        "import math, sys, flexhinf as fh; arm = fh.paper_arm(); law = fh.solve_hji(arm.problem(), math.inf, 2);"
        "fh.Loop(arm.plant(), fh.Controller(law, None)).run(duration=0.1).save('run.nc');"
        "print([name for name in ('xarray', 'pandas', 'dask') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert (done.stdout.strip(), done.returncode) == ("[]", 0), done.stderr


def test_names_of_any_script_are_saved(made, tmp_path):
    import csv

    import xarray as xr

    name = '肘,"$x$'
    plant = Plant(lambda x, u, d, p: u, lambda x, u, p: x, (name,), ("u",), outputs=(name,))
    law = made.LinearLaw((name, f"{name}_integral"), ("u",), [[-2.0, -1.0]])
    run = Loop(plant, Controller(law, None, 1e-2)).run({name: 1.0}, duration=0.1)
    run.save(tmp_path / "run.nc")
    run.save(tmp_path / "run.csv")
    with xr.open_dataset(tmp_path / "run.nc") as data:
        assert data["state_name"].values.tolist() == [name]
    head = next(csv.reader((tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()))
    assert f"state.{name}" in head
    assert run.plot()._repr_svg_()


def test_a_run_without_disturbances_is_saved_too(made, tmp_path):
    import xarray as xr

    plant = Plant(lambda x, u, d, p: u, lambda x, u, p: x, ("x",), ("u",), outputs=("x",))
    law = made.LinearLaw(("x", "x_integral"), ("u",), [[-2.0, -1.0]])
    run = Loop(plant, Controller(law, None, 1e-2)).run(1.0, duration=0.1)
    run.save(tmp_path / "run.nc")
    run.save(tmp_path / "run.csv")
    with xr.open_dataset(tmp_path / "run.nc") as data:
        assert data["input_unit"].values.tolist() == [""]
        assert "disturbance" not in data


def test_another_format_and_a_missing_folder_are_refused(run, tmp_path):
    with refused_with(InvalidInput, ".csv", ".nc"):
        run.save(tmp_path / "run.mat")
    for name in ("run.csv", "run.nc"):
        with pytest.raises(InvalidInput, match=rf"written[\s\S]*{re.escape(name)}"):
            run.save(tmp_path / "missing" / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.ci("draws figures, and traces a loop")
def test_what_a_notebook_shows(run, made):
    figure = run.plot()
    assert figure._repr_svg_().startswith("<?xml")
    assert figure._repr_html_().startswith("<svg")
    assert [axes.get_ylabel() for axes in figure.axes] == ["states (°)", "inputs (V)"]
    html = run._repr_html_()
    assert "<table" in html
    assert "<svg" in html
    assert "settling time" in html
    assert len(repr(run)) < 400
    assert "status: completed" in repr(run)
    controller = Controller(made.law, made.ukf(), saturation=14.0)
    loop = Loop(paper_arm().plant(), controller, delay=2e-3)
    for shown in (controller, loop, controller.estimator, controller.law):
        assert len(repr(shown)) < 600
        assert "<table" in shown._repr_html_()
    assert "saturation: -14 to 14 V" in repr(controller)
    assert "3 samples" in repr(loop)  # with that of the latency


def test_a_diverged_run_is_shown_with_its_message(made):
    law = made.LinearLaw(made.law.state_names, made.law.input_names, -40.0 * made.law.gain)
    run = Loop(paper_arm().plant(), Controller(law, None)).run(1.0, duration=60.0)
    assert "diverged" in repr(run)
    assert f"{run.diverged_at:g} s" in run._repr_html_()


def test_errors_whose_squares_are_not_finite_have_a_mean(run):
    """Old code said inf, with a warning of NumPy's."""
    for distance in (1e300, 0.0):
        estimate = run.signals["state"][:, :4] + distance
        found = replace(run, signals={**run.signals, "estimate": estimate}).metrics()
        assert found["estimation_rmse"] == pytest.approx([distance] * 4)
