"""The doctor of logs: its word for each ill log, and nothing for healthy ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.logs import arm_log, healthy_log, recorded
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.findings import above_note
from flexhinf.identification.doctor import CHECKS

# One likelihood for each plant, compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

MEASURED = ("motor_position", "link_position")
NAMES = {"input": ("motor_voltage",), "output": MEASURED}
ARM = fh.load_robot("paper")
COUNT = 2.0 * np.pi / 4096.0


@pytest.fixture(scope="module")
def clean() -> fh.Log:
    """The paper's arm, 2 s at 1 kHz, noise of 0.1 mrad."""
    times, u, y = arm_log(ARM, seed=1, count=2000, measured=MEASURED)
    return fh.Log(times, u, y, names=NAMES)


def with_outputs(log: fh.Log, motor: Any = None, link: Any = None) -> fh.Log:
    columns = [log.outputs[:, k] if column is None else column for k, column in enumerate((motor, link))]
    return replace(log, outputs=np.column_stack(columns))


def rows(log: fh.Log, kept: Any) -> fh.Log:
    return replace(log, times=log.times[kept], inputs=log.inputs[kept], outputs=log.outputs[kept])


def dead(log: fh.Log) -> fh.Log:
    return with_outputs(log, link=np.full(len(log), 0.1))


def gap(log: fh.Log) -> fh.Log:
    return rows(log, np.r_[0:700, 1500:2000])


def turns(log: fh.Log) -> fh.Log:
    return with_outputs(log, motor=log.outputs[:, 0] % (2.0 * np.pi))


def counter(log: fh.Log) -> fh.Log:
    """A counter of 12 bits that rises with the motor and is full at 1024 of them."""
    counts = np.rint(log.outputs[:, 0] / COUNT * 20.0)
    return with_outputs(log, motor=COUNT * (counts % 4096.0))


def lost(log: fh.Log) -> fh.Log:
    return with_outputs(log, link=np.where(np.arange(len(log)) % 371 == 40, -9999.0, log.outputs[:, 1]))


def zeros(log: fh.Log) -> fh.Log:
    """A drive that writes 0 where it has no value, far from where the link is."""
    link = 1.5 + log.outputs[:, 1]
    return with_outputs(log, link=np.where(np.arange(len(log)) % 371 < 2, 0.0, link))


def outliers(log: fh.Log) -> fh.Log:
    far = np.random.default_rng(3).uniform(1.0, 3.0, size=len(log))
    return with_outputs(log, link=log.outputs[:, 1] + far * (np.arange(len(log)) % 371 == 40))


def frozen(log: fh.Log) -> fh.Log:
    motor = np.rint(log.outputs[:, 0] / 1e-4) * 1e-4
    held = motor.copy()
    for first in (1000, 1200, 1750):
        held[first : first + 40] = motor[first]
    return with_outputs(log, motor=held)


def slow(log: fh.Log) -> fh.Log:
    return with_outputs(log, link=log.outputs[np.arange(len(log)) // 5 * 5, 1])


def arrival(log: fh.Log) -> fh.Log:
    """Messages that arrive 0 to 5 ms later than they were sent, in their order."""
    late = log.times + 5e-3 * np.random.default_rng(0).random(len(log))
    return replace(log, times=np.maximum.accumulate(late) + 1e-9 * np.arange(len(log)))


def sparse(log: fh.Log) -> fh.Log:
    return rows(log, np.arange(0, 2000, 400))


#: An ill log; the kind and the signal of the first finding; and what it says.
ILL: dict[Any, tuple[str, str, str, tuple[str, ...]]] = {
    dead: ("dead", "fault", "link_position", ("never changes", "0.1 rad", "motor position moves")),
    gap: ("gap", "doubt", "time", ("0.801 s", "held", "rows 1 to 700")),
    turns: ("turns", "fault", "motor_position", ("6.28 rad", "a turn", "`--unwrap motor_position`")),
    counter: ("turns", "fault", "motor_position", ("`--unwrap motor_position`",)),
    lost: ("lost", "fault", "link_position", ("-9999", "6 rows", "`--missing -9999`")),
    zeros: ("lost", "fault", "link_position", ("is 0 in", "`--missing 0`")),
    outliers: ("outliers", "doubt", "link_position", ("6 values", "`--gate 0.999`")),
    frozen: ("frozen", "doubt", "motor_position", ("40 rows", "3 places")),
    slow: ("slow", "doubt", "link_position", ("every 5th row", "`--repeated link_position`")),
    arrival: ("arrival", "doubt", "time", ("arrived", "header.stamp")),
    sparse: ("apart", "doubt", "time", ("400 ms", "period")),
}  # fmt: skip


@pytest.mark.parametrize("ill", ILL, ids=lambda ill: ill.__name__)
def test_an_ill_log_is_named_with_what_to_do(clean: fh.Log, ill: Any) -> None:
    """The one finding above a note; the clean log has none."""
    kind, severity, signal, words = ILL[ill]
    assert above_note(fh.examine(clean, ARM, model=False)) == []
    found = above_note(fh.examine(ill(clean), ARM, model=False))
    assert [(one.kind, one.severity, one.signal) for one in found] == [(kind, severity, signal)]
    assert unnamed(found[0].text, *words) == []


@pytest.mark.parametrize(("apart", "lost"), [(2.0, 20), (3.1, 40), (1.6, 0), (2.4, 0)])
def test_rows_are_missing_where_steps_are_whole_ones(clean: fh.Log, apart: float, lost: int) -> None:
    """Twenty steps of 1999 are so many periods: rows were dropped, or a row came late."""
    steps = np.full(len(clean) - 1, 1e-3)
    steps[50::90][:20] *= apart
    found = fh.examine(replace(clean, times=np.append(0.0, np.cumsum(steps))), ARM, model=False)
    assert sum(one.count for one in found if one.kind == "dropped") == lost


@pytest.mark.ci("compares the log with shifted ones")
@pytest.mark.parametrize(
    ("change", "kind", "signal", "advice"),
    [
        (lambda log: replace(log, inputs=-log.inputs), "sign", "motor_voltage",
         '--column "motor_voltage=motor_voltage [-1]"'),
        (lambda log: with_outputs(log, motor=np.append(log.outputs[:1, 0], log.outputs[:-1, 0])), "late",
         "motor_position", "--sensor-delay motor_position=1"),
        (lambda log: replace(log, inputs=np.append(log.inputs[2:], log.inputs[-2:], axis=0)), "late",
         "motor_voltage", "--latency 2"),
    ],
)  # fmt: skip
def test_signs_and_delays_are_told_by_the_model(
    clean: fh.Log, change: Any, kind: str, signal: str, advice: str
) -> None:
    """The paper's arm as its file says; the late encoder of another bus, an input that acts later."""
    (found,) = above_note(fh.examine(change(clean[:800]), ARM))
    assert (found.kind, found.signal) == (kind, signal)
    assert advice in found.advice


@pytest.mark.parametrize("signal", ["deflection", "joint_torque"])
def test_a_spring_that_pulls_against_its_link_has_the_other_sign(signal: str) -> None:
    """A link's angle beside its motor is minus the deflection; the stiffness does not matter."""
    arm, measured = fh.load_robot("quanser-rotflex"), ("motor_position", signal)
    clock = 2e-3 * np.arange(4000)
    volts = 2.0 * np.sin(4.0 * clock) + np.sin(29.0 * clock)
    times, u, y = recorded(arm.plant(measured), volts, 2e-3)
    log = fh.Log(times, u, y, names=NAMES | {"output": measured})
    robot = arm.with_values({"stiffness": 2.0 * arm.nominal["stiffness"]})
    assert above_note(fh.examine(log, robot, model=False)) == []
    (found,) = above_note(fh.examine(replace(log, outputs=y * [1.0, -1.0]), robot, model=False))
    assert (found.kind, found.signal) == ("sign", signal)
    assert f'`--column "{signal}={signal} [-1]"`' in found.advice


@pytest.mark.ci("identifies a log with dry friction")
def test_friction_that_the_file_lacks_is_no_fault_of_the_log() -> None:
    robot = ARM.with_parameters(fh.Parameter("coulomb_friction", 1.6, unit="N·m"))
    times = 2e-3 * np.arange(1500)
    volts = 8.0 * (np.sin(3.0 * times) + 0.6 * np.sin(11.0 * times) + 0.4 * np.sin(23.0 * times))
    t, u, y = recorded(robot.plant(MEASURED, extras="coulomb_friction"), volts, 2e-3)
    found = fh.examine(fh.Log(t, u, y, names=NAMES), ARM)
    assert [one.severity for one in found if one.kind == "model"] == ["note"]
    assert above_note(found) == []
    assert unnamed(next(one.text for one in found if one.kind == "model"), "dry friction", "N·m") == []


def above_note_of_healthy_logs(seeds: Any, model: bool) -> list[tuple[int, str]]:
    several = []
    for seed in seeds:
        robot, log, _ = healthy_log(seed)
        several += [(seed, one.what) for one in above_note(fh.examine(log, robot, model))]
    return several


@pytest.mark.costs("simulates 18 logs of three robots")
def test_healthy_logs_are_healthy() -> None:
    assert above_note_of_healthy_logs(range(18), model=False) == []


@pytest.mark.nightly("simulates 200 logs, and compares them with shifted ones")
def test_two_hundred_healthy_logs_have_two_findings_at_most() -> None:
    assert len(above_note_of_healthy_logs(range(200), model=True)) <= 2


def test_what_is_no_log_of_anything_is_examined_without_an_error() -> None:
    """Constant, missing, three rows, huge; and twice the same without a robot."""
    rng = np.random.default_rng(0)
    for values in (
        np.zeros((3, 2)), np.full((50, 2), 0.1), rng.normal(size=(50, 2)), 1e12 * rng.normal(size=(50, 2)),
        np.where(rng.random((50, 2)) < 0.9, np.nan, 1.0), np.full((50, 2), (-1.0) ** np.arange(50)[:, None]),
    ):  # fmt: skip
        log = fh.Log(0.01 * np.arange(len(values)), np.zeros(len(values)), values, names=NAMES)
        assert {one.severity for one in fh.examine(log, ARM)} <= {"fault", "doubt", "note"}
        fh.examine(replace(log, names={}))
    assert len({check.__name__ for check in CHECKS}) == len(CHECKS)


def test_findings_are_sorted_and_say_where(clean: fh.Log) -> None:
    found = fh.examine(gap(turns(clean)), ARM)
    assert [one.severity for one in found] == sorted(
        (one.severity for one in found), key=("fault", "doubt", "note").index
    )
    assert found[0].place.startswith("motor_position, rows ")
    assert unnamed(repr(found[0]), "fault", "--unwrap") == []
    with pytest.raises(InvalidInput):
        fh.examine(clean.outputs)  # type: ignore[arg-type]
