"""Logs in MCAP: messages of ROS 2 and in JSON, at their own times or at those of their headers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.identification.test_log import LINK, MOTOR, PLANT, VOLTS, N
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput

JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""


@pytest.mark.oracle
def test_mcap_of_ros_2_by_its_own_writer(tmp_path: Path) -> None:
    """Joint states at one rate and a command in JSON at another: rows at all times, the input as it was held."""
    for package in ("mcap", "zstandard"):
        pytest.importorskip(package)
    writing: Any = pytest.importorskip("mcap_ros2.writer")
    began = 1530821160 * 10**9
    stamps = began + np.arange(30) * 10_000_000
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = writing.Writer(file)
        schema = writer.register_msgdef("sensor_msgs/JointState", JOINT_STATE)
        command = writer.register_msgdef("std_msgs/Float64", "float64 data")
        for k, stamp in enumerate(stamps.tolist()):
            header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": ""}
            message = {"header": header, "name": ["elbow", "wrist"], "position": [MOTOR[k], 90.0 * LINK[k]]}
            writer.write_message(
                "/joint_states", schema, {**message, "velocity": [], "effort": []}, stamp, stamp
            )
            if k % 3 == 1:
                writer.write_message("/command", command, {"data": VOLTS[k]}, stamp + 4_000_000, stamp)
        writer.finish()
    columns = {
        "motor_position": "joint_states/position/elbow", "link_position": "joint_states/position/wrist [deg]",
        "motor_voltage": "command/data",
    }  # fmt: skip
    with refused_with(InvalidInput, "motor_voltage", "hold_inputs"):
        fh.read_log(tmp_path / "bag.mcap", PLANT, columns)
    log = fh.read_log(tmp_path / "bag.mcap", PLANT, columns, hold_inputs=True)
    rows = sorted([(int(s), 0, k) for k, s in enumerate(stamps)] + [
        (int(s) + 4_000_000, 1, k) for k, s in enumerate(stamps) if k % 3 == 1
    ])[2:]  # fmt: skip
    np.testing.assert_allclose(log.times, [1e-9 * (s - rows[0][0]) for s, _, _ in rows], rtol=1e-13)
    volts, current = [], math.nan
    for _, commanded, k in rows:
        current = VOLTS[k] if commanded else current
        volts.append(current)
    np.testing.assert_array_equal(log.inputs[:, 0], volts)
    expected = [[math.nan] * 2 if c else [MOTOR[k], math.radians(90.0 * LINK[k])] for _, c, k in rows]
    np.testing.assert_allclose(log.outputs, expected, rtol=1e-14)
    with refused_with(InvalidInput, "joint_states/position/elbow", "joint_states/position/elbo"):
        fh.read_log(tmp_path / "bag.mcap", PLANT, {**columns, "motor_position": "joint_states/position/elbo"})
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    with refused_with(InvalidInput, "bag.mcap", "MCAP"):
        fh.read_log(tmp_path / "bag.mcap", PLANT, columns)


def test_mcap_in_json_with_two_messages_at_one_time(tmp_path: Path) -> None:
    pytest.importorskip("zstandard")
    writing: Any = pytest.importorskip("mcap.writer")
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = writing.Writer(file)
        writer.start(profile="", library="")
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channel = writer.register_channel("/arm", "json", schema)
        for k in (0, 1, 1, 2):
            message = {"motor_voltage": 1.0, "q": [k, 2.0], "text": "x"}
            writer.add_message(channel, k * 10**7, json.dumps(message).encode(), k * 10**7)
        writer.finish()
    columns = {"motor_voltage": "arm/motor_voltage", "motor_position": "arm/q/0", "link_position": "arm/q/1"}
    with refused_with(InvalidInput, "log.mcap", "same time", 1):
        fh.read_log(tmp_path / "log.mcap", PLANT, columns)


def test_mcap_by_the_stamps_of_its_headers(tmp_path: Path) -> None:
    """Messages come up to half a sample after their stamp; a topic without a header has the times of the log."""
    pytest.importorskip("zstandard")
    writing: Any = pytest.importorskip("mcap.writer")
    began, rng = 1700000000123456789, np.random.default_rng(0)
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = writing.Writer(file)
        writer.start(profile="", library="")
        schema = writer.register_schema("any", "jsonschema", b"{}")
        command, joints = (writer.register_channel(name, "json", schema) for name in ("/cmd", "/joints"))
        for k in range(N):
            stamp = began + k * 10**6
            late = stamp + int(5e5 * rng.random())
            header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}
            message = {"header": header, "name": ["motor", "link"], "position": [MOTOR[k], LINK[k]]}
            writer.add_message(command, stamp, json.dumps({"data": VOLTS[k]}).encode(), stamp)
            writer.add_message(joints, late, json.dumps(message).encode(), late)
        writer.finish()
    columns = {
        "motor_voltage": "cmd/data", "motor_position": "joints/position/motor",
        "link_position": "joints/position/link",
    }  # fmt: skip
    log = fh.read_log(tmp_path / "log.mcap", PLANT, columns, time="joints/header/stamp")
    np.testing.assert_allclose(log.times, 1e-3 * np.arange(N), atol=1e-15)
    np.testing.assert_array_equal(log.inputs[:, 0], VOLTS)
    np.testing.assert_array_equal(log.outputs, np.column_stack([MOTOR, LINK]))
