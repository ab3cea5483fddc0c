"""Logs with a late signal, a signal of the other sign, and coarse encoders: what fits, and what is named."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.identification.test_likelihood import sought
from tests.logs import arm_log, linear_log, oscillator
from tests.refusals import refused_with, unnamed
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.findings import above_note
from flexhinf.identification.alternatives import Alternative, Shifts
from flexhinf.identification.doctor.beside_model import alternative_advice
from flexhinf.pages.identify import IdentifiedRobot, identified_verdict

SENSORS, NAMES = ("motor_position", "link_position"), ("stiffness", "friction", "motor_inertia")
COUNT = 2.0 * np.pi / 2048.0
NO_FINDINGS: Any = SimpleNamespace(findings=(), log=SimpleNamespace(columns={}))


def late(column, samples):
    """Values of a sensor (N,) so many samples later."""
    return np.append(np.repeat(column[:1], samples), column[: len(column) - samples])


@pytest.fixture(scope="module")
def arm():
    return fh.load_robot("paper")


def found(arm, log, **options):
    guess = arm.with_values({"stiffness": 80.0, "friction": 0.2, "motor_inertia": 1.2})
    return fh.identify(guess, log, NAMES, measured=SENSORS, **options)


@pytest.mark.parametrize(
    ("signal", "samples"),
    ci_and_night("identifies an arm with every signal at other times", [(1, 2)], [(0, 1), (0, 3)]),
)
def test_a_late_sensor_is_named_and_its_delay_may_be_stated(arm, signal, samples):
    """Friction and disturbances explain it so well that innovations are white: that is no fit."""
    times, u, y = arm_log(arm, count=1200, measured=SENSORS)
    y[:, signal] = late(y[:, signal], samples)
    wrong = found(arm, (times, u, y))
    assert not wrong.consistent
    assert wrong.absorbing
    assert wrong.alternative is not None
    assert (wrong.alternative.signal, wrong.alternative.samples) == (SENSORS[signal], samples)
    right = found(arm, (times, u, y), sensors=fh.Sensor(SENSORS[signal], delay=1e-3 * samples))
    assert right.consistent
    low, high = right.intervals["friction"]
    assert low - (high - low) < 0.1 < high + (high - low)


@pytest.mark.ci("identifies short logs of an arm")
def test_a_short_log_does_not_tell_a_late_sensor_and_its_intervals_say_so(arm):
    """A spring of 100 N·m/rad is 98.3 ± 0.4 then, with white innovations; in twice as long a log it is named."""
    times, u, y = arm_log(arm, seed=1, count=250, measured=SENSORS)
    y[:, 1] = late(y[:, 1], 1)
    short = found(arm, (times, u, y))
    assert short.consistent
    assert ("link_position", "late", 1.0) in [
        (each.signal, each.kind, each.samples) for each in short.undecided
    ]
    assert short.values["stiffness"] < 99.0
    low, high = short.intervals["stiffness"]
    assert low < 100.0 < high
    result: Any = SimpleNamespace(found=short, filtered=NO_FINDINGS, stated=arm, motion=None, second=None)
    said = " ".join(identified_verdict(result))
    assert unnamed(said, "too short", "link_position comes later", "stiffness", "intervals") == []
    stiff = arm.with_values({"stiffness": 300.0, "friction": 1.5, "motor_inertia": 0.3})
    times, u, y = arm_log(stiff, seed=1, count=250, measured=SENSORS)
    right = fh.identify(stiff, (times, u, y), NAMES, measured=SENSORS)
    assert right.consistent
    assert not right.undecided
    y[:, 1] = late(y[:, 1], 1)
    assert not fh.identify(stiff, (times, u, y), NAMES, measured=SENSORS).consistent


@pytest.mark.ci("compiles the likelihood of an arm")
def test_a_late_sensor_is_named_though_the_file_is_wrong(arm):
    """As `flexhinf check` and `flexhinf estimate` look for it; a wrong file alone is no fault of a log."""
    times, u, y = arm_log(arm, count=600, measured=SENSORS)
    guess = arm.with_values({"stiffness": 70.0, "friction": 0.2})
    names = {"input": ("motor_voltage",), "output": SENSORS}
    assert above_note(fh.examine(fh.Log(times, u, y, names=names), guess)) == []
    y[:, 1] = late(y[:, 1], 2)
    (other,) = above_note(fh.examine(fh.Log(times, u, y, names=names), guess))
    assert (other.kind, other.signal) == ("late", "link_position")
    assert other.advice == "To try: `--sensor-delay link_position=2`."


@pytest.mark.parametrize(
    ("signal", "samples", "late", "said"),
    [
        ("motor_voltage", 1, {}, ["`--latency 1`"]), ("motor_voltage", 1, {"motor_voltage": 1}, ["`--latency 2`"]),
        ("motor_voltage", -1, {"motor_voltage": 1}, ["`--latency 0`"]), ("motor_voltage", -1, {}, [" up ", "1 row "]),
        ("motor_voltage", -2, {"motor_voltage": 1}, ["`--latency 0`", " up ", "motor_voltage"]),
        ("link_position", 1, {"link_position": 1}, ["`--sensor-delay link_position=2`"]),
        ("link_position", -2, {}, [" down ", "2 rows "]),
    ],
)  # fmt: skip
def test_what_is_advised_for_other_times_can_be_done(arm, signal, samples, late, said):
    """An option counts what was stated already, and is none below 0, where the file says it."""
    other = Alternative(signal, "late", float(samples), 10.0, {})
    advice = alternative_advice(other, arm.plant(SENSORS), late)
    assert all(part in advice for part in said)
    assert not re.search(r"=?-\d|larger|smaller", advice)


@pytest.mark.parametrize("samples", ci_and_night("identifies logs of an arm", [1, -1], [3]))
def test_an_input_that_acts_later_or_earlier_is_named(arm, samples):
    times, u, y = arm_log(arm, count=2000, measured=SENSORS)
    wrong = found(arm, (times, np.roll(u, -samples), y))
    assert not wrong.consistent
    assert wrong.alternative is not None
    assert (wrong.alternative.signal, wrong.alternative.samples) == ("motor_voltage", samples)


@pytest.mark.ci("identifies logs of an arm")
@pytest.mark.parametrize("signal", ["motor_voltage", "link_position"])
def test_the_other_sign_is_named(arm, signal):
    times, u, y = arm_log(arm, count=1200, measured=SENSORS)
    signs = np.array([-1.0 if name == signal else 1.0 for name in SENSORS])
    wrong = found(arm, (times, -u if signal == "motor_voltage" else u, signs * y))
    assert not wrong.consistent
    assert isinstance(wrong.alternative, Alternative)
    assert (wrong.alternative.signal, wrong.alternative.kind) == (signal, "sign")


def test_an_input_that_is_not_held_is_named():
    """The oscillator's input goes in a straight line from row to row: half a period earlier than if it were held."""
    count, fine = 1200, 10
    times, u, _ = linear_log(0, count=count, noise=0.0, level=0.0)
    between = np.interp(np.arange(count * fine) / fine, np.arange(count), u[:, 0])
    x, rows, step = np.zeros(2), [], 0.01 / fine
    for k, force in enumerate(between):
        if k % fine == 0:
            rows.append(x[0])
        x = x + step * np.array(
            [x[1] + step / 2 * (1.5 * force - 40.0 * x[0]), 1.5 * force - 40.0 * x[0] - 0.8 * x[1]]
        )
    y = np.array(rows)[:, None] + 1e-5 * np.random.default_rng(0).normal(size=(count, 1))
    wrong = fh.identify(oscillator(), (times, u, y), ("damping",))
    assert not wrong.consistent
    assert wrong.alternative is not None
    assert (wrong.alternative.signal, wrong.alternative.kind) == ("force", "moving")


@pytest.mark.parametrize("noise", ci_and_night("identifies logs of an arm", [1e-3], [1e-6, 1e-2]))
def test_a_right_model_fits_the_log_of_a_coarse_encoder(arm, noise):
    """2048 counts a turn; noise far below a count, near it, and above it."""
    times, u, y = arm_log(arm, seed=3, count=1500, noise=noise, measured=SENSORS)
    right = found(arm, (times, u, COUNT * np.rint(y / COUNT)))
    assert right.consistent
    assert right.alternative is None
    assert min(right.noise[name] for name in SENSORS) >= 0.999 * COUNT / np.sqrt(12.0)
    for name, (low, high) in right.intervals.items():
        assert low - 0.01 * abs(low) <= arm.nominal[name] <= high + 0.01 * abs(high)


def test_noise_is_never_below_that_of_a_step():
    """A disturbance of any size would explain each count, and the noise would end at nothing."""
    times, u, y = linear_log(5, noise=0.0, level=0.0)
    step = 0.05
    right = fh.identify(oscillator(), (times, u, step * np.rint(y / step)), ("stiffness", "damping"))
    assert right.noise["position"] >= 0.999 * step / np.sqrt(12.0)
    assert right.consistent


@pytest.mark.ci("two fits")
def test_large_disturbances_fit_where_they_are_stated(arm):
    """Forces of a fifth of the input are no part of the model, unless somebody says so."""
    log = linear_log(3, count=1200, noise=1e-4, level=0.3)
    free = fh.identify(oscillator(), log, ("stiffness", "damping", "gain"))
    assert not free.consistent
    level, assumed = free.disturbances["load"]
    assert level > 10.0 * assumed
    result: Any = IdentifiedRobot(arm, free, NO_FINDINGS, None)
    said = " ".join(identified_verdict(result))
    share = re.search(r"`--disturbance (\S+)`", said)
    assert share is not None
    assert unnamed(said, f"{level:.3g}", f"{assumed:.3g}", "at most", f"{level / assumed:.3g} %") == []
    advised = fh.identify(
        oscillator(), log, ("stiffness", "damping", "gain"), disturbance=0.01 * float(share[1])
    )
    assert advised.consistent
    with refused_with(InvalidInput, "twice"):
        fh.identify(oscillator(), log, "gain", disturbance=0.1, process_noise=1.0)
    stated = fh.identify(
        oscillator(), log, ("stiffness", "damping", "gain"), process_noise=np.diag([0.0, 0.3**2 * 0.01])
    )
    assert stated.consistent


@pytest.mark.parametrize(
    "sensors", [fh.Sensor("position", period=0.04), fh.Sensor("position", delay=0.02, noise=0.01)]
)
def test_what_is_known_of_a_sensor_counts(sensors):
    """Held values count once, late ones at their time, and a noise that is stated is not sought."""
    times, u, y = linear_log(9, count=800, noise=0.01, level=0.0)
    shown = y.copy()
    if sensors.period:
        shown = y[np.arange(800) // 4 * 4]
    else:
        shown[:, 0] = late(y[:, 0], 2)
    right = fh.identify(oscillator(stiffness=50.0), (times, u, shown), ("stiffness",), sensors=sensors)
    assert right.consistent
    assert right.noise["position"] == pytest.approx(0.01, rel=1e-12 if sensors.noise else 0.2)
    low, high = right.intervals["stiffness"]
    assert low - (high - low) < 40.0 < high + (high - low)


@pytest.mark.parametrize("lost", [-1.0, 1.0])
def test_a_shift_with_which_nothing_can_be_computed_is_passed_over(lost, monkeypatch):
    """Of one signal one shift, to either side, has no likelihood: what is expected is said of the other signal."""
    log, shift = linear_log(1, count=200), Shifts.likelihood
    likelihood, unknowns = sought(log)
    evaluated, left_out = Shifts.evaluated, []

    def shifted(self, signal=None, samples=0.0, sign=1.0):
        made = shift(self, signal, samples, sign)
        if (signal, samples) == (0, lost):
            left_out.append(made)
        return made

    monkeypatch.setattr(Shifts, "likelihood", shifted)
    monkeypatch.setattr(
        Shifts, "evaluated", lambda self, of, z: None if of in left_out else evaluated(self, of, z)
    )
    shifts = Shifts(likelihood.filter, unknowns, unknowns.start, *log)
    assert {signal for _, _, signal, _ in shifts.expected()} == {1}
