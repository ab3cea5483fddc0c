"""Logs of files: every format gives the same numbers, units and digits are right, and what is wrong is named."""

from __future__ import annotations

import datetime
import json
import math
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.identification import log_columns, log_files, log_messages, log_units

PLANT = fh.paper_arm().plant(("motor_position", "link_position"))
N = 40
RNG = np.random.default_rng(3)
TIMES = np.cumsum(RNG.uniform(7e-3, 12e-3, N))
VOLTS, MOTOR, LINK = RNG.normal(0, 9, N), RNG.normal(0, 1, N), RNG.normal(0, 1, N)


def csv_text(columns: dict[str, Any], separator: str = ",") -> str:
    rows = zip(*columns.values(), strict=True)
    cells = (separator.join("" if value != value else f"{value:.17g}" for value in row) for row in rows)
    return "\n".join([separator.join(columns), *cells]) + "\n"


@pytest.fixture
def log_of(tmp_path: Path) -> Callable[..., fh.Log]:
    """The log of a text, for the paper's arm with encoders on the motor and on the link."""

    def read(text: str, name: str = "log.csv", plant: fh.Plant = PLANT, **options: Any) -> fh.Log:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return fh.read_log(tmp_path / name, plant, **options)

    return read


PLAIN = {"time": TIMES, "motor_voltage": VOLTS, "motor_position": MOTOR, "link_position": LINK}


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_plain_columns_are_taken_by_their_names(log_of: Callable[..., fh.Log], separator: str) -> None:
    log = log_of("# a comment\n\n" + csv_text({**PLAIN, "mode": np.zeros(N)}, separator))
    np.testing.assert_allclose(log.times, TIMES - TIMES[0], rtol=0, atol=1e-16)
    np.testing.assert_array_equal(log.inputs[:, 0], VOLTS)
    np.testing.assert_array_equal(log.outputs, np.column_stack([MOTOR, LINK]))
    assert log.truth is None
    assert log.source == "log.csv"
    assert log.names["output"] == ("motor_position", "link_position")
    assert len(log) == N
    assert log.period == pytest.approx(np.median(np.diff(TIMES)), rel=1e-12)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_are_read(log_of: Callable[..., fh.Log], separator: str) -> None:
    """As spreadsheets of many countries write: 0,5 between semicolons; the same numbers to the last bit."""
    text = csv_text(PLAIN, separator)
    assert "." in text
    log, own = log_of(text.replace(".", ",")), log_of(text)
    for name in ("times", "inputs", "outputs"):
        np.testing.assert_array_equal(getattr(log, name), getattr(own, name))


def test_columns_units_and_scales(log_of: Callable[..., fh.Log]) -> None:
    """Each unit against a factor written here; a number stands for a unit of the sensor's own."""
    columns = {
        "stamp [ms]": 1e3 * TIMES, "u(mV)": 1e3 * VOLTS, "motor/pos": np.degrees(MOTOR), "counts": LINK / 1.5e-3,
        "state.link_velocity [rpm]": 30.0 / math.pi * MOTOR, "note [deg]": MOTOR,
    }  # fmt: skip
    log = log_of(
        csv_text(columns),
        columns={"motor_voltage": "u", "motor_position": "motor/pos [deg]", "link_position": "counts"},
        units={"counts": 1.5e-3},
    )
    np.testing.assert_allclose(log.times, TIMES - TIMES[0], rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(log.inputs[:, 0], VOLTS, rtol=1e-14)
    np.testing.assert_allclose(log.outputs, np.column_stack([MOTOR, LINK]), rtol=1e-14)
    np.testing.assert_allclose(log.truth[:, 1], MOTOR, rtol=1e-14)
    assert np.isnan(log.truth[:, [0, 2, 3]]).all()
    again = log_of(
        csv_text(columns), time="stamp", units={"motor/pos": "deg"},
        columns={"motor_voltage": "u [mV]", "motor_position": "motor/pos", "link_position": "counts [0.0015]"},
    )  # fmt: skip
    np.testing.assert_array_equal(again.outputs, log.outputs)


def test_an_array_of_a_file_is_no_unit(log_of: Callable[..., fh.Log]) -> None:
    text = csv_text({"t": TIMES, "motor_voltage": VOLTS, "position[0]": MOTOR, "position[1]": LINK})
    log = log_of(text, columns={"motor_position": "position[0]", "link_position": "position[1]"})
    np.testing.assert_array_equal(log.outputs, np.column_stack([MOTOR, LINK]))
    with refused_with(InvalidInput, "position[0]", "position[1]", "motor_position"):
        log_of(text, columns={"motor_position": "position", "link_position": "position[1]"})


@pytest.mark.parametrize(
    ("head", "stamp"),
    [
        ("time", "{s}.{ns:09d}"), ("time [s]", "{s}.{ns:09d}"), ("stamp", "{s}{ns:09d}"), ("t [ns]", "{s}{ns:09d}"),
        ("time", "{date}.{ns:09d}"), ("time", "{date}.{ns:09d}Z"),
    ],
)  # fmt: skip
def test_stamps_since_1970_keep_their_nanoseconds(
    log_of: Callable[..., fh.Log], head: str, stamp: str
) -> None:
    steps = np.array([0, 7_000_001, 19_000_003, 31_000_009, 999_999_999])
    rows = [f"{stamp.format(s=1530821160, ns=ns, date='2018-07-05T20:06:00')},1,2,3" for ns in steps]
    log = log_of(f"{head},motor_voltage,motor_position,link_position\n" + "\n".join(rows))
    np.testing.assert_allclose(log.times, 1e-9 * steps, rtol=1e-15)


def test_times_of_the_day_go_on_after_midnight(log_of: Callable[..., fh.Log], tmp_path: Path) -> None:
    """In text with either decimal mark, and as times and durations of Parquet."""
    clocks = ("23:59:59,5", "23:59:59,998", "0:00:00,006", "00:00:01")
    rows = "".join(f"{clock};0,5;1;2,25\n" for clock in clocks)
    exact = [0.0, 0.498, 0.506, 1.5]
    log = log_of("Time;motor_voltage;motor_position;link_position\n" + rows)
    np.testing.assert_allclose(log.times, exact, rtol=1e-12)
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    times = [datetime.time(23, 59, 59, 500_000), datetime.time(23, 59, 59, 998_000),
             datetime.time(0, 0, 0, 6_000), datetime.time(0, 0, 1)]  # fmt: skip
    durations = np.array(exact) * 1e9
    ones = {name: arrow.array(np.ones(4)) for name in (*PLANT.inputs, *PLANT.outputs)}
    for column in (arrow.array(times), arrow.array(durations.round().astype("timedelta64[ns]"))):
        parquet.write_table(arrow.table({"time": column, **ones}), tmp_path / "log.parquet")
        np.testing.assert_allclose(fh.read_log(tmp_path / "log.parquet", PLANT).times, exact, rtol=1e-12)


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("time,motor_voltage,motor_position,link_position\nms,V,deg,\n", "{ms},1,90,2"),  # a row of units
        ("time,motor_voltage,motor_position,link_position\n[ms],[V],[deg],-\n", "{ms},1,90,2"),
        ("# a rig\n# time [ms],motor_voltage,motor_position [deg],link_position\n", "{ms},1,90,2"),  # by savetxt
        ("# time motor_voltage motor_position[deg] link_position\n", "{s} 1 90 2"),
        ("time   motor_voltage motor_position[deg] link_position\n", " {s}  1   90.0 2 "),  # by spaces
        ("%time,motor_voltage,motor_position[deg],link_position\n", "17000000000{ms:02d}000000,1,90,2,"),
        ("__time,motor_voltage,motor_position[deg],link_position\n", "{s},1,90,2"),
    ],
)  # fmt: skip
def test_headers_as_tools_write_them(log_of: Callable[..., fh.Log], head: str, row: str) -> None:
    """Units below the names, a header that begins with #, spaces, a separator behind the last value, names of times."""
    log = log_of(head + "".join(row.format(ms=ms, s=1e-3 * ms) + "\n" for ms in (10, 30, 45)))
    np.testing.assert_allclose(log.times, [0.0, 0.02, 0.035], rtol=1e-12)
    np.testing.assert_allclose(log.outputs[0], [np.pi / 2, 2.0])


@pytest.mark.parametrize(
    "date",
    [
        "2024-10-27T02:59:59.{ms:03d}+02:00", "2024-10-27 00:59:59,{ms:03d}Z", "27.10.2024 00:59:59,{ms:03d}",
        "27.10.2024 00:59:59.{ms:03d}", "2024-10-26T20:59:59.{ms:03d}000000-0400",
    ],
)  # fmt: skip
def test_dates_as_people_write_them(log_of: Callable[..., fh.Log], date: str) -> None:
    """With an offset from UTC, or the day first; decimal commas beside them are read all the same."""
    rows = "".join(f"{date.format(ms=ms)};0,5;1;2,25\n" for ms in (0, 7, 19, 998))
    log = log_of("time;motor_voltage;motor_position;link_position\n" + rows)
    np.testing.assert_allclose(log.times, [0.0, 7e-3, 19e-3, 0.998], rtol=1e-12)
    np.testing.assert_array_equal(log.outputs[0], [1.0, 2.25])
    earlier = log_of(
        "time;motor_voltage;motor_position;link_position\n" + "2024-10-27T00:59:58.5;1;2;3\n" + rows
    )
    assert earlier.times[1] == pytest.approx(0.5)


def test_a_unit_at_the_end_of_a_name_is_its_unit(log_of: Callable[..., fh.Log]) -> None:
    text = csv_text(
        {"time_ms": 1e3 * TIMES, "u_V": VOLTS, "motor_position_deg": np.degrees(MOTOR), "q_2": LINK}
    )
    columns = {"motor_voltage": "u_V", "motor_position": "motor_position_deg", "link_position": "q_2"}
    log = log_of(text, columns=columns, time="time_ms")
    np.testing.assert_allclose(log.times, TIMES - TIMES[0], atol=1e-14)
    np.testing.assert_allclose(log.outputs, np.column_stack([MOTOR, LINK]), rtol=1e-14)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("deg_elbow", ("deg", "rad")), ("elbow_deg", ("deg", "rad")), ("elbow_A", ("A", "A")), ("A_elbow", ("", "")),
     ("s_elbow", ("", "")), ("m", ("", ""))],
)  # fmt: skip
def test_a_letter_at_the_front_of_a_name_is_no_unit(name: str, unit: tuple[str, str]) -> None:
    assert log_units.named_unit(name) == unit


def test_late_sensors_are_moved_back(log_of: Callable[..., fh.Log]) -> None:
    log = log_of(csv_text(PLAIN), delays={"motor_position": 2})
    np.testing.assert_array_equal(log.outputs[:-2, 0], MOTOR[2:])
    assert np.isnan(log.outputs[-2:, 0]).all()
    np.testing.assert_array_equal(log.outputs[:, 1], LINK)
    for delays, anchors in (({"motor": 1}, ("motor", "motor_position")), ({"motor_position": -1}, (-1,))):
        with refused_with(InvalidInput, *anchors):
            log_of(csv_text(PLAIN), delays=delays)


@pytest.mark.parametrize(("unit", "size"), [("us", 1e-6), ("ms", 1e-3)])
def test_other_stamps_since_1970_are_known_by_their_size(
    log_of: Callable[..., fh.Log], unit: str, size: float
) -> None:
    first = round(1530821160 / size)
    rows = "".join(f"{first + k},1,2,3\n" for k in range(0, 50, 10))
    log = log_of("time,motor_voltage,motor_position,link_position\n" + rows)
    np.testing.assert_allclose(np.diff(log.times), 10 * size, rtol=1e-12)


def test_sensors_slower_than_others_leave_cells_empty(log_of: Callable[..., fh.Log]) -> None:
    link, motor = np.where(np.arange(N) % 5, np.nan, LINK), np.where(np.arange(N) % 2, np.nan, MOTOR)
    log = log_of(csv_text({**PLAIN, "motor_position": motor, "link_position": link}))
    np.testing.assert_array_equal(log.outputs, np.column_stack([motor, link]))
    for word in ("nan", "NaN", "NA", "null", " None ", "-"):
        row = "0,1,{},3\n1,1,2,3\n2,1,2,3\n"
        assert np.isnan(
            log_of("time,motor_voltage,motor_position,link_position\n" + row.format(word)).outputs[0, 0]
        )


def test_inputs_hold_where_that_is_stated(log_of: Callable[..., fh.Log]) -> None:
    sparse = VOLTS.copy()
    sparse[[0, 1, 5, 6, 20]] = np.nan
    text = csv_text({**PLAIN, "motor_voltage": sparse})
    with refused_with(InvalidInput, "line 2", "motor_voltage", 5, 40, "hold_inputs"):
        log_of(text)
    log = log_of(text, hold_inputs=True)
    assert len(log) == N - 2
    assert log.times[0] == 0.0
    expected = VOLTS[2:].copy()
    expected[[3, 4, 18]] = VOLTS[[4, 4, 19]]
    np.testing.assert_array_equal(log.inputs[:, 0], expected)
    np.testing.assert_allclose(log.times, TIMES[2:] - TIMES[2], rtol=1e-12)
    with refused_with(InvalidInput, "motor_voltage", 40):
        log_of(csv_text({**PLAIN, "motor_voltage": np.full(N, np.nan)}), hold_inputs=True)


def test_a_run_of_our_own_is_read_without_any_option(tmp_path: Path) -> None:
    """The file of a trajectory, and the log of a run, by their own names and units."""
    arm = fh.paper_arm()
    controller = arm_controller(q=1e-9, r=1e-8, p0=1e-6, limit=None)
    run = fh.Loop(arm.plant(), controller).run(fh.Step(0.2), duration=0.05)
    run.save(tmp_path / "run.csv")
    log = fh.read_log(tmp_path / "run.csv", arm.plant())
    np.testing.assert_array_equal(log.outputs, run.signals["output"])
    np.testing.assert_array_equal(log.inputs, run.signals["input"])
    np.testing.assert_array_equal(log.truth, run.signals["state"])
    np.testing.assert_array_equal(log.times, run.time)


@pytest.mark.ci("runs a loop with MuJoCo for each format; the test above reads a file of a run")
@pytest.mark.parametrize("ending", ["csv", "parquet", "mcap"])
def test_the_log_of_a_real_time_run_is_read_in_every_format(ending: str, tmp_path: Path) -> None:
    for package in {"parquet": ("pyarrow",), "mcap": ("mcap", "zstandard")}.get(ending, ()):
        pytest.importorskip(package)
    arm = fh.paper_arm()
    from flexhinf.export import write_log

    pytest.importorskip("mujoco")
    from flexhinf.robot import MuJoCoPlant

    loop = fh.Loop(MuJoCoPlant(arm), arm_controller(q=1e-9, r=1e-8, p0=1e-6, limit=None))
    run = fh.run_realtime(loop, fh.Step(0.2), {}, 1e-3, 0.02, real_time=False)
    path = write_log(run, tmp_path / f"run.{ending}")
    log, signals = fh.read_log(path, arm.plant()), run.trajectory.signals
    np.testing.assert_array_equal(log.outputs, signals["output"])
    np.testing.assert_array_equal(log.inputs, signals["input"])
    np.testing.assert_array_equal(log.truth, signals["state"])
    np.testing.assert_allclose(log.times, run.trajectory.time, atol=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("stamps", ["float", "int", "date"])
def test_parquet_by_pandas(stamps: str, tmp_path: Path) -> None:
    """Written by pandas: numbers, missing ones, integers of nanoseconds, dates, text in columns that nobody reads."""
    pytest.importorskip("pyarrow")
    pandas: Any = pytest.importorskip("pandas")
    nano = np.round(1e9 * TIMES).astype(np.int64) + 1530821160 * 10**9
    column = {"float": TIMES, "int": nano, "date": pandas.to_datetime(nano)}[stamps]
    table = pandas.DataFrame(
        {
            "time": column, "motor_voltage": VOLTS, "motor_position [deg]": np.degrees(MOTOR),
            "link_position": pandas.array(np.where(np.arange(N) % 3, None, 2), dtype="Int64"), "mode": ["a"] * N,
        }
    )  # fmt: skip
    table.to_parquet(tmp_path / "log.parquet")
    log = fh.read_log(tmp_path / "log.parquet", PLANT)
    exact = TIMES - TIMES[0] if stamps == "float" else 1e-9 * (nano - nano[0])
    np.testing.assert_allclose(log.times, exact, rtol=1e-14)
    np.testing.assert_allclose(log.outputs[:, 0], MOTOR, rtol=1e-14)
    np.testing.assert_array_equal(log.outputs[:, 1], np.where(np.arange(N) % 3, np.nan, 2.0))
    for bad in ("mode",):
        with refused_with(InvalidInput, "mode", "no numbers", "to_numeric"):
            fh.read_log(tmp_path / "log.parquet", PLANT, columns={"link_position": bad})
    with refused_with(InvalidInput, "mode", "to_datetime"):
        fh.read_log(tmp_path / "log.parquet", PLANT, time="mode")
    (tmp_path / "log.parquet").write_bytes((tmp_path / "log.parquet").read_bytes()[:-20])
    with refused_with(InvalidInput, "log.parquet", "Parquet"):
        fh.read_log(tmp_path / "log.parquet", PLANT)


@pytest.mark.parametrize("more", [(), ("state.link_position",), ("spare", "mode")])
def test_advice_names_no_column_that_is_taken(log_of: Callable[..., fh.Log], more: tuple[str, ...]) -> None:
    """An input's column is sought among those that nothing else uses: never the encoder of a link."""
    columns = {name: values for name, values in PLAIN.items() if name != "motor_voltage"}
    with pytest.raises(InvalidInput) as raised:
        log_of(csv_text({**columns, "mv_e": VOLTS, **dict.fromkeys(more, LINK)}))
    advice = raised.value.advice
    assert "mv_e" in advice
    assert "position" not in advice
    with pytest.raises(InvalidInput) as raised:
        log_of(csv_text(columns))
    assert "position" not in raised.value.advice
    only_motor = fh.load_robot("paper").plant("motor_position")
    with pytest.raises(InvalidInput) as raised:
        log_of(csv_text({**columns, "mv_e": VOLTS}), plant=only_motor)
    assert "mv_e" in raised.value.advice
    assert "position" not in raised.value.advice


HEAD = "time,motor_voltage,motor_position,link_position\n"
ROWS = "".join(f"{0.01 * k},1,2,3\n" for k in range(10))


@pytest.mark.parametrize(
    ("text", "options", "anchors"),
    [
        ("", {}, ["log.csv", "empty"]),
        (HEAD, {}, ["log.csv", "too few", 3, 0]),
        (HEAD + "0,1,2,3\n0.1,1,2,3\n", {}, ["too few", 2]),
        (HEAD + ROWS + "0.05,1,2,3\n", {}, ["line 12", "backwards", 0.05, 0.09]),
        (HEAD + ROWS + "0.09,1,2,3\n", {}, ["line 12", "repeat", 0.09]),
        (HEAD + ROWS + "11,1,2,3\n", {}, ["line 12", "gap", 1000, 0.01, "first 10 rows"]),
        (HEAD + ROWS + ",1,2,3\n", {}, ["line 12", "time"]),
        (HEAD + ROWS + "inf,1,2,3\n", {}, ["line 12", "time", "inf"]),
        (HEAD + ROWS + "0.2,1,fast,3\n", {}, ["line 12", "motor_position", "fast"]),
        (HEAD + ROWS + "0.2,1,inf,3\n", {}, ["line 12", "motor_position", "inf"]),
        (HEAD + ROWS + "0.2,1,1_0,3\n", {}, ["line 12", "motor_position", "1_0"]),
        (HEAD + ROWS + "0.2,1,\u0663,3\n", {}, ["line 12", "motor_position"]),
        (HEAD + ROWS + "\u0663,1,2,3\n", {}, ["line 12", "time"]),
        (HEAD + ROWS + "0.2,1,3\n", {}, ["line 12", 4, 3]),
        (HEAD + ROWS + '0.2,1,"2,3\n', {}, ["line 12"]),
        (HEAD.replace(",", ";") + ROWS.replace(",", ";") + "0.2;1;2,5;3\n", {}, ["line 12", "2,5", "2.5"]),
        (HEAD.replace(",", ";") + ROWS.replace(",", ";") + "0,2;1;2;3\n", {}, ["line 12", "0,2", "0.2"]),
        (HEAD.replace(",", ";") + ROWS.replace(",", ";").replace(".", ",") + "1,2,3;1;2;3\n", {}, ["line 12"]),
        (HEAD + ROWS + "0.2,,2,3\n", {}, ["line 12", "motor_voltage", "every sample", "hold_inputs"]),
        (HEAD.replace("motor_voltage", "volts") + ROWS, {}, ["input", "motor_voltage", "volts", "every sample"]),
        (HEAD.replace("link_", "lnk_") + ROWS, {}, ["output", "link_position", "lnk_position", "measured"]),
        (HEAD.replace("motor_position", "a").replace("link_position", "b") + ROWS, {}, ["output", "motor_position"]),
        (HEAD.replace("time", "tme") + ROWS, {}, ["tme", "timestamp"]),
        (HEAD + ROWS, {"time": "tiem"}, ["tiem", "time", "motor_voltage"]),
        (HEAD + ROWS, {"columns": {"motor_position": "motr_position"}}, ["motr_position", "'motor_position'"]),
        (HEAD + ROWS, {"columns": {"motor_positon": "motor_position"}}, ["motor_positon", "'motor_position'"]),
        (HEAD + ROWS, {"columns": {"motor_position": 3}}, ["motor_position", 3]),
        (HEAD + ROWS, {"columns": {"motor_position": "link_position"}}, ["link_position", "'motor_position'"]),
        (HEAD + ROWS, {"columns": {"motor_position": "time"}}, ["time", "two signals"]),
        (HEAD + ROWS, {"columns": dict.fromkeys(PLANT.outputs, "link_position")}, ["link_position", "two signals"]),
        (HEAD + ROWS, {"columns": {"motor_position": "motor_position [mm]"}}, ["motor_position", "mm", "rad"]),
        (HEAD + ROWS, {"columns": {"motor_position": "motor_position [dgs]"}}, ["dgs", "rad"]),
        (HEAD + ROWS, {"columns": {"motor_position": "motor_position [DEGRE]"}}, ["DEGRE", "rad"]),
        (HEAD + ROWS, {"columns": {"motor_position": "motor_position [0.0]"}}, ["0.0", "rad"]),
        (HEAD.replace("link_position", "link_position [V]") + ROWS, {}, ["link_position", "V", "rad"]),
        (HEAD.replace("time", "time [m]") + ROWS, {}, ["time", "m", "s"]),
        (HEAD + ROWS, {"units": {"pos": "deg"}}, ["pos", "motor_position"]),
        (HEAD + ROWS, {"units": {"motor_position": None}}, ["motor_position", "None"]),
        (HEAD + ROWS, {"units": "deg"}, ["deg"]),
        (HEAD + ROWS, {"columns": ["motor_position"]}, ["motor_position"]),
        (HEAD.replace("\n", ",measured/link_position\n") + ROWS.replace("\n", ",4\n"), {}, ["two columns"]),
        (HEAD.replace("\n", ",link_position\n") + ROWS.replace("\n", ",4\n"), {}, ["two columns", "link_position"]),
        (HEAD + ROWS.replace(",3\n", ",\n"), {}, ["link_position", "no value", 10]),
        (HEAD + ROWS + "0.2,1,1e31,3\n", {}, [1e30]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(
    log_of: Callable[..., fh.Log], text: str, options: dict[str, Any], anchors: list[Any]
) -> None:
    with refused_with(InvalidInput, *anchors):
        log_of(text, **options)


def test_files_that_are_none(log_of: Callable[..., fh.Log], tmp_path: Path) -> None:
    with refused_with(InvalidInput, "none.csv"):
        fh.read_log(tmp_path / "none.csv", PLANT)
    with refused_with(InvalidInput, tmp_path.name, ".csv", ".parquet", ".mcap"):
        fh.read_log(tmp_path, PLANT)
    (tmp_path / "folder.csv").mkdir()
    with refused_with(InvalidInput, "folder.csv"):
        fh.read_log(tmp_path / "folder.csv", PLANT)
    with refused_with(InvalidInput, "log.xls", ".csv"):
        log_of("", "log.xls")
    with refused_with(InvalidInput, "UTF-8"):
        (tmp_path / "log.csv").write_bytes(b"\xff\xfe\x00")
        fh.read_log(tmp_path / "log.csv", PLANT)
    bad: Any = None
    with refused_with(InvalidInput, "Plant"):
        fh.read_log(tmp_path / "log.csv", bad)
    with refused_with(InvalidInput, "None"):
        fh.read_log(bad, PLANT)


def test_a_package_that_is_missing_is_named(
    log_of: Callable[..., fh.Log], monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    for ending, package in (("parquet", "pyarrow.parquet"), ("mcap", "mcap.reader")):
        monkeypatch.setitem(sys.modules, package, None)
        with refused_with(InvalidInput, package.split(".")[0], "pip install 'flexhinf[log]'"):
            log_of("x", f"log.{ending}")


def test_a_plant_without_units_takes_si_units(log_of: Callable[..., fh.Log]) -> None:
    plant = fh.Plant(lambda x, u, d, p: u, lambda x, u, p: x, ("x",), ("u",), outputs=("x",))
    text = csv_text({"time": TIMES, "u": VOLTS, "x [deg]": LINK})
    with refused_with(InvalidInput, "deg", "x"):
        log_of(text, plant=plant)
    log = log_of(text, plant=plant, columns={"x": "x [2.5]"})
    np.testing.assert_array_equal(log.outputs[:, 0], 2.5 * LINK)


# Logs made of arrays ----------------------------------------------------------------------------------
def test_a_log_of_arrays_is_checked_frozen_and_cut() -> None:
    log = fh.Log(TIMES, VOLTS, np.column_stack([MOTOR, LINK]), truth=np.zeros((N, 4)))
    assert log.inputs.shape == (N, 1)
    assert not log.times.flags.writeable
    part = log[10:20]
    np.testing.assert_array_equal(part.times, TIMES[10:20])
    assert part.truth.shape == (10, 4)
    again = pickle.loads(pickle.dumps(log))
    np.testing.assert_array_equal(again.outputs, log.outputs)
    for anchors, change in (
        (("inputs", 39), {"inputs": VOLTS[1:]}),
        (("outputs", 3), {"outputs": np.zeros((N, 2, 3))}),
        (("truth", 2), {"truth": np.zeros((2, 4))}),
        (("inputs", "every sample"), {"inputs": np.where(np.arange(N) == 3, np.nan, VOLTS)}),
        (("outputs", 1e30), {"outputs": np.where(np.arange(N) == 3, np.inf, VOLTS)}),
        (("times", "nan"), {"times": np.where(np.arange(N) == 3, np.nan, TIMES)}),
        (("sample 4", "repeat"), {"times": np.where(np.arange(N) == 3, TIMES[2], TIMES)}),
        (("samples", 3), {"times": TIMES[:2]}),
        (("times", "text"), {"times": "text"}),
        (("outputs", "a"), {"names": {"output": ("a",)}}),
    ):
        with refused_with(InvalidInput, *anchors):
            fh.Log(**{"times": TIMES, "inputs": VOLTS, "outputs": np.column_stack([MOTOR, LINK]), **change})
    wrong: Any = 3
    with refused_with(InvalidInput, "slice", "log[:1000]"):
        log[wrong]


@pytest.mark.nightly("a real log, which is no part of the repository")
def test_a_real_actuator() -> None:
    """7.3 to 11.9 ms between samples, stamps since 1970 with all the digits of a double, columns by other names."""
    folder = os.environ.get("FLEXHINF_DATA", "")
    path = Path(folder) / "series_elastic_actuator_100hz.csv"
    if not folder or not path.is_file():
        pytest.skip("FLEXHINF_DATA names no folder with series_elastic_actuator_100hz.csv")
    plant = fh.paper_arm().plant(("motor_position", "joint_torque"))
    log = fh.read_log(
        path, plant, {"motor_voltage": "voltage", "motor_position": "motor_position [0.01]", "joint_torque": "effort"},
        "receive_time",
    )  # fmt: skip
    table = np.genfromtxt(path, delimiter=",", names=True)
    np.testing.assert_allclose(log.times, table["receive_time"] - table["receive_time"][0], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(
        log.outputs, np.column_stack([0.01 * table["motor_position"], table["effort"]])
    )
    assert 7.2e-3 < np.diff(log.times).min() < np.diff(log.times).max() < 12e-3
    assert log.truth is None


STAMPS = np.datetime64("2026-01-01") + np.arange(20) * np.timedelta64(100, "ms")


@pytest.mark.parametrize(
    ("times", "named"),
    [
        (STAMPS, ("datetime64", "(t - t[0]) / np.timedelta64(1, 's')")),
        (list(STAMPS.astype(object)), ("(t - t[0]) / np.timedelta64(1, 's')",)),
        (STAMPS - STAMPS[0], ("timedelta64", "times / np.timedelta64(1, 's')")),
        ([str(0.1 * k) for k in range(20)], ("dtype=float",)),
        (None, ("None", "times in s")),
        (0.1 * np.arange(20) + 0j, ("complex128", "columns")),
    ],
)
def test_times_that_are_no_numbers_say_what_to_try(times, named):
    ones = np.ones((20, 1))
    with refused_with(InvalidInput, "times", *named):
        fh.Log(times, ones, ones)


def test_the_advice_for_stamps_works_and_complex_outputs_are_named():
    ones, seconds = np.ones((20, 1)), (STAMPS - STAMPS[0]) / np.timedelta64(1, "s")
    assert fh.Log(seconds, ones, ones).period == pytest.approx(0.1)
    for outputs, named in ((ones * 1j, "complex128"), (None, "None"), ([["a"]] * 20, "a")):
        with refused_with(InvalidInput, "outputs", named):
            fh.Log(seconds, ones, outputs)


def test_what_unpacks_to_too_much_is_refused_by_its_footer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of megabytes may be one of gigabytes when it is unpacked: nothing is, before it is counted."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(log_columns, "MOST_ROWS", 1000)
    monkeypatch.setattr(parquet.ParquetFile, "read", None)  # it is not read
    names = ("time", *PLANT.inputs, *PLANT.outputs)
    columns = {name: arrow.array(np.zeros(1001)) for name in names}
    path = tmp_path / "log.parquet"
    parquet.write_table(arrow.table(columns), path)
    with refused_with(InvalidInput, "log.parquet", 1000, 1001):
        fh.read_log(path, PLANT)
    few = {name: column[:10] for name, column in columns.items()}
    parquet.write_table(arrow.table({**few, names[1]: arrow.array([[0.0] * 5] * 10)}), path)
    with refused_with(InvalidInput, names[1], "list"):
        fh.read_log(path, PLANT)
    long = arrow.array(["x" * 1_000_000] * 10)  # the file has it once, and the footer counts it once
    for texts in (long, long.dictionary_encode(), long.cast("binary")):
        parquet.write_table(arrow.table({**few, names[1]: texts}), path)
        with refused_with(InvalidInput, "log.parquet", names[1], str(texts.type)):
            fh.read_log(path, PLANT)
    monkeypatch.setattr(log_files, "LARGEST_CELL", 0)
    parquet.write_table(arrow.table(few), path)
    with refused_with(InvalidInput, "log.parquet", "large"):
        fh.read_log(path, PLANT)


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4"])
def test_messages_are_counted_and_chunks_have_a_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: str
) -> None:
    writing: Any = pytest.importorskip("mcap.writer")

    def write(messages: int, size: int) -> Path:
        with (tmp_path / "log.mcap").open("wb") as file:
            writer = writing.Writer(file, compression=writing.CompressionType[compression], chunk_size=10**9)
            writer.start(profile="", library="")
            channel = writer.register_channel(
                "/arm", "json", writer.register_schema("any", "jsonschema", b"{}")
            )
            for k in range(messages):
                content = json.dumps({"motor_voltage": 1.0, "q": [k, 2.0], "text": "x" * size})
                writer.add_message(channel, k * 10**7, content.encode(), k * 10**7)
            writer.finish()
        return tmp_path / "log.mcap"

    columns = {"motor_voltage": "arm/motor_voltage", "motor_position": "arm/q/0", "link_position": "arm/q/1"}
    assert len(fh.read_log(write(20, 10), PLANT, columns).times) == 20
    monkeypatch.setattr(log_messages, "LARGEST_CHUNK", 5000)
    with refused_with(InvalidInput, "log.mcap", 5000):
        fh.read_log(write(20, 1000), PLANT, columns)
    for limit, most in (("LARGEST_CHUNK", 10**6), ("LARGEST_UNPACKED", 5000)):
        monkeypatch.setattr(log_messages, limit, most)
    with refused_with(InvalidInput, "log.mcap", "messages", 5000):
        fh.read_log(write(20, 1000), PLANT, columns)
    monkeypatch.setattr(log_messages, "LARGEST_UNPACKED", 10**6)
    for limit, most in (("MOST_COLUMNS", 2), ("MOST_NUMBERS", 50)):
        with monkeypatch.context() as patch, refused_with(InvalidInput, "log.mcap", limit[5:].lower(), most):
            patch.setattr(log_messages, limit, most)
            fh.read_log(write(20, 10), PLANT, columns)
    monkeypatch.setattr(log_messages, "LARGEST_MESSAGE", 500)
    with refused_with(InvalidInput, "log.mcap"):  # a topic of pictures has no columns
        fh.read_log(write(20, 1000), PLANT, columns)
    monkeypatch.setattr(log_columns, "MOST_ROWS", 10)
    with refused_with(InvalidInput, "log.mcap", 10, 20):
        fh.read_log(write(20, 10), PLANT, columns)
