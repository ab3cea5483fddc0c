"""Logs of a run, read again by the libraries that other programs read them with."""

from __future__ import annotations

import csv
import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export.realtime import RealTimeRun, percentiles
from flexhinf.export.run_log import check_log, log_columns, write_log
from flexhinf.loop import Loop
from flexhinf.robot import MuJoCoPlant

pytest.importorskip("mujoco")

# A loop of 50 samples: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(scope="module")
def run(controller: fh.Controller) -> RealTimeRun:
    loop = Loop(MuJoCoPlant(fh.paper_arm()), controller)
    return fh.run_realtime(loop, fh.Step(0.2), {"link_torque": 0.1}, 1e-3, 0.05)


def expected(run: RealTimeRun, kind: str, name: str) -> np.ndarray:
    return next(column.values for column in log_columns(run) if (column.kind, column.name) == (kind, name))


@pytest.mark.costs("the run that all tests here share")
def test_everything_is_logged(run: RealTimeRun) -> None:
    found = {(column.kind, column.name, column.unit) for column in log_columns(run)}
    for name in ("link_position", "motor_position"):
        assert ("state", name, "rad") in found
        assert ("estimate", name, "rad") in found
    for name in ("link_velocity", "motor_velocity"):
        assert ("state", name, "rad/s") in found
    assert {("measured", "link_position", "rad"), ("reference", "link_position", "rad")} <= found
    assert {("input", "motor_voltage", "V"), ("disturbance", "link_torque", "N·m")} <= found
    assert {"missed_deadline", "overrun", "at_limit", "code", "status", "stop"} == {
        n for k, n, _ in found if k == "flags"
    }
    assert ("timing", "lateness", "s") in found
    np.testing.assert_array_equal(
        expected(run, "flags", "at_limit"), np.abs(run.trajectory.signals["input"][:, 0]) >= 48.0 * (1 - 1e-9)
    )
    free = replace(run, input_range=(np.array([-np.inf]), np.array([np.inf])))
    assert not expected(free, "flags", "at_limit").any()
    tight = replace(run, input_range=(np.array([-np.inf]), run.trajectory.signals["input"].max(axis=0)))
    assert expected(tight, "flags", "at_limit").sum() >= 1


@pytest.mark.oracle
def test_csv_is_read_again(run: RealTimeRun, tmp_path: Path) -> None:
    """By Python's csv; PlotJuggler takes the first row as names, splits them at commas, and has a tree of slashes."""
    path = write_log(run, tmp_path / "run.csv")
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    assert head[0] == "time[s]"
    assert "state/link_velocity[rad_per_s]" in head
    assert not any(mark in name for name in head for mark in ', "\n')
    assert all(name.count("/") == 1 for name in head[1:])
    assert len(set(head)) == len(head)
    table = {name: np.array(column, dtype=float) for name, column in zip(head, zip(*rows, strict=True))}
    np.testing.assert_array_equal(table["time[s]"], run.trajectory.time)
    np.testing.assert_array_equal(table["state/link_position[rad]"], expected(run, "state", "link_position"))
    assert np.all(np.diff(table["time[s]"]) > 0.0)
    # jitter by another route: ranks of the logged column, the order by Python's own sort
    late = sorted(float(row[head.index("timing/lateness[s]")]) for row in rows)
    found = percentiles(run.timing.woken)
    assert found["p50"] == late[25]
    assert found["p99"] == late[50]
    assert found["max"] == late[-1]
    assert int(table["flags/missed_deadline"].sum()) == int(run.timing.missed.sum())


@pytest.mark.oracle
def test_parquet_is_read_again(run: RealTimeRun, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(write_log(run, tmp_path / "run.parquet"))
    assert table.num_rows == 51
    assert {str(kind) for kind in table.schema.types} == {"double"}
    values = table.column("input/motor_voltage[V]").to_numpy()
    np.testing.assert_array_equal(values, expected(run, "input", "motor_voltage"))
    assert table.schema.metadata[b"stepped"] == b"Controller.step"


@pytest.mark.oracle
def test_mcap_is_read_again(run: RealTimeRun, tmp_path: Path) -> None:
    """One topic a kind, JSON with a JSON schema of an object: what Foxglove asks for."""
    reader = pytest.importorskip("mcap.reader")
    with write_log(run, tmp_path / "run.mcap").open("rb") as file:
        found = list(reader.make_reader(file).iter_messages())
        file.seek(0)
        metadata = {record.name: record.metadata for record in reader.make_reader(file).iter_metadata()}
    assert {schema.encoding for schema, _, _ in found} == {"jsonschema"}
    assert {channel.message_encoding for _, channel, _ in found} == {"json"}
    topics = {channel.topic: json.loads(schema.data) for schema, channel, _ in found}
    assert set(topics) >= {"/state", "/estimate", "/measured", "/input", "/reference", "/flags", "/timing"}
    assert topics["/state"]["type"] == "object"
    assert topics["/state"]["properties"]["link_velocity"] == {"type": "number", "description": "rad/s"}
    states = [
        (message.log_time, json.loads(message.data))
        for _, channel, message in found
        if channel.topic == "/state"
    ]
    assert [time - run.began for time, _ in states] == [round(1e9 * time) for time in run.trajectory.time]
    values = [state["link_position"] for _, state in states]
    np.testing.assert_array_equal(values, expected(run, "state", "link_position"))
    assert metadata["flexhinf run"]["status"] == "completed"


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("run.txt", "format"),
        ("run", "format"),
        ("missing/run.csv", os.strerror(errno.ENOENT)),
        ("folder.csv", "folder"),
        ("", "path"),
    ],
)
def test_a_log_that_cannot_be_written_is_refused_before_the_run(name: str, what: str, tmp_path: Path) -> None:
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InvalidInput) as caught:
        check_log(str(tmp_path / name) if name else "")
    assert what in str(caught.value) or not name
    assert caught.value.advice
    assert [path.name for path in tmp_path.iterdir()] == ["folder.csv"]


def test_a_package_that_is_missing_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for ending, package in ((".parquet", "pyarrow"), (".mcap", "mcap")):
        with refused_with(InvalidInput, "flexhinf[log]") as caught:
            check_log(tmp_path / f"run{ending}")
        assert repr(package) in caught.value.found
    assert check_log(tmp_path / "run.csv").name == "run.csv"
