"""The real-time runner: the simulation's own numbers, an honest clock, a stop that loses nothing."""

from __future__ import annotations

import gc
import math
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export import realtime
from flexhinf.export.realtime import MissedSpan, Timing, percentiles
from flexhinf.loop import BlackBox, Loop

# Controllers and a library that make some samples: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


class Box(BlackBox):
    """A mass without friction: as good as no plant at all. `lasts` is called at each sample."""

    states = ("link_position", "link_velocity", "motor_position", "motor_velocity")
    units = {"link_position": "rad"}  # noqa: RUF012

    def __init__(self, lasts: Callable[[int], None] = lambda k: None) -> None:
        self.lasts, self.seen = lasts, []

    def reset(self, initial_state: Any) -> None:
        self.x, self.k, self.seen = np.zeros(4), 0, []

    def step(self, u: Any, disturbance: Any, period: float) -> None:
        self.x[1] += period * (float(u[0]) - self.x[1])
        self.x[0] += period * self.x[1]

    def output(self) -> np.ndarray:
        self.seen.append(time.monotonic_ns())
        self.lasts(self.k)
        self.k += 1
        return self.x[:1]

    def state(self) -> np.ndarray:
        return self.x


@pytest.fixture(scope="module")
def controller() -> fh.Controller:
    """Of a linear law and an extended filter, which are traced and compiled fast."""
    return arm_controller(kind=fh.ExtendedKalmanFilter)


class Clock:
    """A clock that tests own: it goes on by a microsecond where it is read, and otherwise where something lasts."""

    def __init__(self) -> None:
        self.now = 0

    def perf_counter_ns(self) -> int:
        self.now += 1_000
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += round(1e9 * seconds)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of the runner."""
    own = Clock()
    names = SimpleNamespace(perf_counter_ns=own.perf_counter_ns, time_ns=own.perf_counter_ns, sleep=own.sleep)
    monkeypatch.setattr(realtime, "time", names)
    return own


@pytest.fixture(scope="module")
def library(controller: fh.Controller, compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fh.compile_controller(controller, tmp_path_factory.mktemp("real-time") / "arm.so")


@pytest.mark.costs("compiles the first controller of this file")
def test_the_numbers_are_those_of_the_loop(controller: fh.Controller, clock: Clock) -> None:
    """Bit for bit, real time or not: only the time at which a sample is made is another one."""
    given: dict[str, Any] = {"reference": fh.Step(0.2), "duration": 0.05, "noise": 1e-3, "seed": 3}
    expected = Loop(Box(), controller, delay=2e-3).run(**given)
    for real_time in (False, True):
        run = fh.run_realtime(Loop(Box(), controller, delay=2e-3), **given, real_time=real_time)
        assert run.stopped is None
        for kind, values in expected.signals.items():
            np.testing.assert_array_equal(run.trajectory.signals[kind], values)
        assert run.trajectory.settings["real_time"] is real_time
        assert len(run.timing.time) == len(run.codes) == 51


@pytest.mark.ci("two runs of 200 samples")
@pytest.mark.oracle
def test_the_compiled_library_steps_instead(controller: fh.Controller, library: Path) -> None:
    compiled = fh.load_compiled(library)
    given: dict[str, Any] = {"reference": fh.Step(0.2), "duration": 0.2, "real_time": False}
    runs = [fh.run_realtime(Loop(Box(), controller), **given, library=one) for one in (None, compiled)]
    inputs = [run.trajectory.signals["input"] for run in runs]
    np.testing.assert_allclose(inputs[1], inputs[0], rtol=0, atol=1e-9 * np.abs(inputs[0]).max())
    assert runs[1].code_names[0] == "OK"
    assert "PREDICTED" in runs[1].code_names.values()
    assert runs[1].trajectory.settings["stepped"] == "compiled library arm.so"
    compiled.step(0.3)  # the runner has stepped a copy: this one is where it was
    np.testing.assert_array_equal(compiled.estimate, _first_estimate(library))


def _first_estimate(library: Path) -> np.ndarray:
    fresh = fh.load_compiled(library)
    fresh.step(0.3)
    return fresh.estimate


@pytest.mark.ci("a run in real time with a slow sample")
def test_a_sample_that_takes_too_long_is_a_missed_deadline(controller: fh.Controller, clock: Clock) -> None:
    """Ten milliseconds in sample 20: it and those behind it are late, each by one period less."""
    box = Box(lambda k: clock.sleep(0.010) if k == 20 else None)
    timing = fh.run_realtime(Loop(box, controller), duration=0.06).timing
    assert timing.ready[20] == pytest.approx(0.010, abs=1e-4)
    assert timing.woken[:21] == pytest.approx(0.0, abs=1e-4)
    late = [0.010 - 0.001 * k for k in range(1, 10)]
    assert timing.woken[21:30] == pytest.approx(late, abs=2e-4)
    assert timing.woken[32:] == pytest.approx(0.0, abs=1e-4)
    (span,) = timing.missed_spans()
    assert span.begin == pytest.approx(0.020)
    assert span.worst == pytest.approx(0.009, abs=1e-4)
    assert timing.elapsed == pytest.approx(0.060, abs=2e-3)


@pytest.mark.ci("a run in real time")
def test_no_garbage_is_collected_and_everything_is_as_before(controller: fh.Controller) -> None:
    found: list[Any] = []

    def watch() -> bool:
        found.append(gc.isenabled())
        return True

    before = signal.getsignal(signal.SIGINT)
    fh.run_realtime(Loop(Box(), controller), duration=0.02, real_time=False, watch=watch, watch_every=1e-3)
    assert found == [False] * 21
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.ci("a run in real time until it is interrupted")
def test_control_c_keeps_what_was_recorded(controller: fh.Controller, clock: Clock) -> None:
    calls: list[int] = []

    def watch() -> bool:
        calls.append(0)
        if len(calls) == 5:
            os.kill(os.getpid(), signal.SIGINT)
        return True

    run = fh.run_realtime(Loop(Box(), controller), duration=10.0, watch=watch, watch_every=1e-3)
    assert run.stopped == signal.SIGINT
    assert len(run.trajectory.time) == len(run.codes) == len(run.timing.over) in (5, 6)
    assert np.isfinite(run.trajectory.signals["input"]).all()
    ended = fh.run_realtime(Loop(Box(), controller), duration=10.0, watch=lambda: False, real_time=False)
    assert ended.stopped == 0
    assert len(ended.trajectory.time) == 1


@pytest.mark.ci("a run in real time")
def test_in_another_thread_signals_are_left_alone(controller: fh.Controller) -> None:
    runs: list[Any] = []
    thread = threading.Thread(
        target=lambda: runs.append(
            fh.run_realtime(Loop(Box(), controller), duration=0.01, priority=50, core=0)
        )
    )
    thread.start()
    thread.join()
    assert len(runs[0].trajectory.time) == 11
    assert len(runs[0].scheduling) >= 2


@pytest.mark.ci("a run in real time that diverges")
def test_a_run_that_diverges_ends_there(controller: fh.Controller) -> None:
    class Bad(Box):
        def output(self) -> np.ndarray:
            return np.array([np.inf]) if self.k > 8 else super().output()

    run = fh.run_realtime(Loop(Bad(), controller), duration=0.05, real_time=False)
    assert run.stopped is None
    assert "finite" in run.trajectory.message
    assert len(run.timing.time) == len(run.trajectory.time) == 10


@pytest.mark.ci("runs a library that is stopped")
def test_the_run_ends_where_the_drives_lose_their_power(controller: fh.Controller, library: Path) -> None:
    """After 20 samples the sensor is silent; ten more may be missing, and then the input is off."""

    class Silent(Box):
        def output(self) -> np.ndarray:
            y = super().output()
            return y if self.k <= 20 else np.full(1, np.nan)

    runs = [
        fh.run_realtime(Loop(Silent(), controller), 0.1, duration=0.1, real_time=False, library=one)
        for one in (None, fh.load_compiled(library))
    ]
    for run in runs:
        assert fh.Stop.SENSOR_LOST in run.stop  # the C says too that its step cannot go on
        assert (len(run.trajectory.time), run.stopped, run.trajectory.message) == (31, None, "")
        assert run.powered.tolist() == [True] * 30 + [False]
        assert run.trajectory.signals["input"][-1] == 0.0 != run.trajectory.signals["input"][-2]
        assert unnamed(run.stop_text, "0.03 s", "sensor", "SENSOR_LOST", "no power", "cables") == []
    fine = fh.run_realtime(Loop(Box(), controller), 0.1, duration=0.1, real_time=False)
    assert (fine.stop, fine.stop_text, len(fine.trajectory.time)) == (fh.Stop(0), "", 101)


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"priority": 100}, "priority"),
        ({"core": 100_000}, "core"),
        ({"duration": 1e9}, "too long"),
        ({"reference": fh.Step(100.0)}, "turn"),
    ],
)
def test_what_does_not_fit_is_refused_before_any_sample(
    given: dict[str, Any], what: str, controller: fh.Controller
) -> None:
    box = Box()
    with pytest.raises(InvalidInput, match=what):
        fh.run_realtime(Loop(box, controller), **given)
    assert box.seen == []


def test_a_plant_or_a_library_of_another_kind(controller: fh.Controller, library: Path) -> None:
    with pytest.raises(InvalidInput, match="integrates"):
        fh.run_realtime(Loop(fh.paper_arm().plant(), controller))
    other = arm_controller(kind=fh.ExtendedKalmanFilter, period=2e-3)
    with pytest.raises(InvalidInput, match="period"):
        fh.run_realtime(Loop(Box(), other), library=fh.load_compiled(library))


@pytest.mark.ci("compiles a library of another law")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("what", ["law", "noise", "limits", "start", "spring"])
def test_a_library_of_another_design_of_the_same_robot(
    what: str, controller: fh.Controller, library: Path
) -> None:
    """Signals and period are the same: its inputs are not."""
    arm = fh.paper_arm()
    plant = (
        arm.plant()
        if what != "spring"
        else arm.with_values({"stiffness": 1.01 * arm.nominal["stiffness"]}).plant()
    )
    law = fh.linear_law(arm.problem(pose=0.1), gamma=math.inf) if what == "law" else controller.law
    start = [0.1 * (what == "start")] * 4
    ekf = fh.ExtendedKalmanFilter(plant, 1e-3, 1e-7, 1e-4 * (1 + (what == "noise")), start, 1e-4)
    other = fh.Controller(law, ekf, 1e-3, 24.0 if what == "limits" else 48.0)
    compiled = fh.load_compiled(library)
    with refused_with(InvalidInput, "controller", compiled.path.name, compiled.digest[:12]):
        fh.run_realtime(Loop(Box(), other), library=compiled)
    same = fh.Controller(controller.law, controller.estimator, 1e-3, 48.0)
    run = fh.run_realtime(Loop(Box(), same), library=compiled, duration=0.003, real_time=False)
    assert len(run.trajectory.time) == 4


# Timing ---------------------------------------------------------------------------------------------
@pytest.mark.oracle
def test_percentiles_are_values_that_occurred() -> None:
    """Against the definition: the smallest value that at least so many of them are not above."""
    values = np.random.default_rng(0).exponential(size=12_345)
    found = percentiles(values)
    for name, share in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("p99.99", 0.9999)):
        assert found[name] in values
        assert np.mean(values <= found[name]) >= share
        assert np.mean(values < found[name]) < share
    assert found["max"] == values.max()
    assert percentiles(np.array([2.0, 1.0])) == {"p50": 1.0, **dict.fromkeys(list(found)[1:], 2.0)}


def test_where_the_missed_deadlines_lay() -> None:
    ready = np.array([0.5, 1.5, 2.5, 0.5, 0.5, 1.1]) * 1e-3
    time = 1e-3 * np.arange(6)
    timing = Timing(1e-3, True, time, ready, ready, ready, ready, 7e-3)
    assert timing.missed.tolist() == [False, True, True, False, False, True]
    spans = timing.missed_spans()
    assert [span[:2] for span in spans] == [(1e-3, 2), (5e-3, 1)]
    assert spans[0] == MissedSpan(1e-3, 2, pytest.approx(1.5e-3))
    assert timing.slowness == pytest.approx(7.0 / 6.0)


@pytest.mark.ci("half a second on the wall clock")
@pytest.mark.oracle
def test_half_a_second_on_the_wall_clock(controller: fh.Controller) -> None:
    """The lateness that is recorded is what the plant sees of it, however busy the machine is.

    The plant is read between the moments when its sample woke and was over: one start of the run fits them all.
    """
    box, start = Box(), time.monotonic_ns()
    run = fh.run_realtime(Loop(box, controller), duration=0.5)
    assert time.monotonic_ns() - start >= 500_000_000
    timing, seen = run.timing, 1e-9 * (np.array(box.seen) - start)
    assert len(seen) == len(timing.time) == 501
    assert timing.woken.min() >= 0.0
    assert timing.elapsed >= 0.5 - timing.woken[0]
    earliest = (seen - timing.time - timing.over).max()
    assert earliest <= (seen - timing.time - timing.woken).min() + 1e-8
    assert earliest >= -1e-8
