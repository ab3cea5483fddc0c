"""Work that is shared out among copies of the process has the results and errors of one process."""

from __future__ import annotations

import os
import select
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import flexhinf.copies
from flexhinf.copies import beside, cached_by_all, cpu_seconds, shared_out
from flexhinf.processors import limited_threads

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/fd").exists(), reason="processes are copied on Linux alone"
)

OWN = os.getpid()


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def no_child_is_left() -> bool:
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return True
    return False


def answered(k: int) -> tuple[int, np.ndarray]:
    return os.getpid(), np.random.default_rng(k).normal(size=100_000)


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_results_stand_in_order_with_the_same_bits(workers: int):
    expected, before = [answered(k)[1] for k in range(9)], open_files()
    with limited_threads(workers):
        found = shared_out(answered, range(9))
    for (_, numbers), other in zip(found, expected):
        np.testing.assert_array_equal(numbers, other)
    assert found[0][0] == OWN
    assert open_files() == before
    assert no_child_is_left()


def test_the_error_is_that_of_the_first_item_that_fails():
    def failing(k: int) -> int:
        if k in (5, 6, 20):
            raise ValueError(k)
        return k

    for workers in (1, 2):
        with limited_threads(workers), pytest.raises(ValueError, match="5"):
            shared_out(failing, range(30))
    assert no_child_is_left()


def test_what_a_copy_does_not_send_is_computed_here():
    def deadly(k: int) -> int:
        if os.getpid() != OWN:
            os.kill(os.getpid(), signal.SIGKILL)
        return k * k

    def unpicklable(k: int) -> Callable[[], int]:
        return lambda: k

    with limited_threads(3):
        assert shared_out(deadly, range(20), compiles=False) == [k * k for k in range(20)]
        assert [each() for each in shared_out(unpicklable, range(20))] == [*range(20)]


def test_an_interruption_ends_the_copies():
    begun, before = [0], open_files()

    def begin() -> None:
        begun[0] += 1
        if begun[0] == 3:
            raise KeyboardInterrupt

    with limited_threads(2), pytest.raises(KeyboardInterrupt):
        shared_out(answered, range(100), begin)
    assert open_files() == before
    assert no_child_is_left()


def test_the_time_of_copies_counts():
    """This process waits in its first item until a copy has done one."""
    inlet, outlet = os.pipe()

    def busy(k: int) -> int:
        if os.getpid() == OWN:
            return len(os.read(inlet, 1))
        end = time.process_time() + 0.02
        while time.process_time() < end:
            pass
        os.write(outlet, b"." * 3)
        return 1

    before, own = cpu_seconds(), time.process_time()
    with limited_threads(2):
        assert shared_out(busy, range(3), compiles=False) == [1, 1, 1]
    os.close(inlet)
    os.close(outlet)
    assert cpu_seconds() - before - (time.process_time() - own) >= 0.02


def test_what_a_copy_caches_is_known_here_and_to_the_next_copy():
    made: list[int] = []

    @cached_by_all(4)
    def squared(k: int) -> np.ndarray:
        made.append(k)
        return np.array(k * k)

    def worked(k: int) -> tuple[int, list[int]]:
        made.clear()
        squared(7)
        return os.getpid(), [*made]

    with limited_threads(2):
        for expected in ([7], []):
            with beside(lambda: worked(0)) as copied:
                process, computed = copied()
            assert process != OWN
            assert computed == expected
    assert worked(0) == (OWN, [])
    for k in range(4):
        squared(k)
    assert worked(0) == (OWN, [7])  # the oldest has given way


def test_a_copy_works_beside_this_process_which_has_its_processor_afterwards():
    go, done = os.pipe(), os.pipe()

    def late() -> tuple[int, np.ndarray]:
        os.read(go[0], 1)
        return answered(3)

    before = open_files()
    with limited_threads(2), beside(late) as result:

        def worked(k: int) -> int:
            if os.getpid() != OWN:
                os.write(done[1], b".")
            elif k == 5:
                os.write(go[1], b".")
                result()
            elif k == 6:  # until another process has done an item
                assert select.select([done[0]], [], [], 60.0)[0]
            return os.getpid()

        by = shared_out(worked, range(60), compiles=False)
        (process, numbers), again = result(), result()
    assert {*by[:5]} == {OWN}
    assert len({*by}) == 2
    assert process not in by
    np.testing.assert_array_equal(numbers, answered(3)[1])
    assert again[0] == process
    os.write(go[1], b".")
    with limited_threads(1), beside(late) as result:
        assert result()[0] == OWN
    assert open_files() == before
    assert no_child_is_left()
    for end in (*go, *done):
        os.close(end)


def test_what_is_beside_begins_when_a_processor_is_free():
    go, before = os.pipe(), open_files()

    def late() -> int:
        os.read(go[0], 1)
        return os.getpid()

    def let_go() -> int:
        os.write(go[1], b".")
        return os.getpid()

    def ended() -> None:
        let_go()
        while not flexhinf.copies._free():
            time.sleep(1e-3)

    with limited_threads(2):
        with beside(late), beside(os.getpid) as second:
            assert second() == OWN  # who asks before there is one computes it
        with beside(late) as first, beside(let_go) as second:
            assert first() != OWN  # this process does what waits, while it waits itself
            assert second() == OWN
        with beside(late) as first, beside(os.getpid) as second:
            shared_out(lambda k: ended() if k == 2 else k, range(5), compiles=False)
            assert second() not in (OWN, first())
        with beside(late) as first, beside(os.getpid) as second:
            ended()
            assert first() not in (OWN, second())  # the result of the first begins the second
    assert open_files() == before
    assert no_child_is_left()
    for end in go:
        os.close(end)


def test_a_copy_beside_ends_with_its_context_and_its_error_is_raised_here():
    def failing() -> int:
        raise ValueError(os.getpid())

    began, before = time.monotonic(), open_files()
    with limited_threads(2):
        with beside(signal.pause):
            pass
        with beside(failing) as result, pytest.raises(ValueError, match=str(OWN)):
            result()
    assert time.monotonic() - began < 30.0
    assert open_files() == before
    assert no_child_is_left()


def test_where_no_process_can_be_made_everything_is_computed_here(monkeypatch: pytest.MonkeyPatch):
    asked: list[int] = []

    def refused() -> int:
        asked.append(1)
        raise BlockingIOError

    monkeypatch.setattr(flexhinf.copies, "_copied", refused)
    before = open_files()
    with limited_threads(2), beside(os.getpid) as result:
        assert shared_out(lambda k: (k, os.getpid()), range(3)) == [(k, OWN) for k in range(3)]
        assert result() == OWN
    assert len(asked) == 2  # once for each, and not again before each item
    assert open_files() == before
