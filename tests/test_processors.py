"""Threads are those that were requested, else the processors that the process may use."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# threadpoolctl has no types.
from threadpoolctl import threadpool_info, threadpool_limits  # pyright: ignore

import flexhinf as fh
from flexhinf import processors
from flexhinf.campaign import search_weights, worst_case
from flexhinf.certify.proof import certify
from flexhinf.designs.advice import advise
from flexhinf.designs.certification import certify_design
from flexhinf.paper import reproduce
from flexhinf.paper.settings import PaperSettings
from flexhinf.processors import available, in_threads, limited_threads, single_blas, thread_count


def test_the_environment_and_a_request_limit_the_threads(monkeypatch: pytest.MonkeyPatch):
    for text, expected in (
        ("3", 3),
        ("5,2", 5),
        (" 4 ", 4),
        ("0", available()),
        ("many", available()),
        ("", available()),
    ):
        monkeypatch.setenv("OMP_NUM_THREADS", text)
        assert thread_count() == expected
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    with limited_threads(7):
        with limited_threads(None):
            assert thread_count() == 7
        with limited_threads(1):
            assert thread_count() == 1
    assert thread_count() == 3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("max 100000", 12),
        ("250000 100000", 3),
        ("50000 100000", 1),
        ("1250000 100000", 12),
        ("-1 100000", 12),
        ("4 0", 12),
        ("strange", 12),
    ],
)
def test_affinity_and_the_share_of_a_group_limit_the_threads(
    text: str, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(12)), raising=False)
    quota, _, period = text.partition(" ")
    versions = [
        ("0::/jobs/one", "", {"cpu.max": text}),
        ("3:cpu,cpuacct:/jobs/one", "cpu", {"cpu.cfs_quota_us": quota, "cpu.cfs_period_us": period}),
    ]
    for version, (line, controller, files) in enumerate(versions):
        for level in ("", "jobs", "jobs/one", "jobs/other"):  # of the group, and of those above it
            root = tmp_path / f"{version}{level.replace('/', '-')}"
            group, own = root / controller / level, root / "own"
            group.mkdir(parents=True)
            for name, content in files.items():
                (group / name).write_text(content + "\n")
            own.write_text(f"1:name=systemd:/elsewhere\n{line}\nstrange\n")
            monkeypatch.setattr(processors, "GROUPS", root)
            monkeypatch.setattr(processors, "OWN_GROUPS", own)
            assert available() == (12 if level == "jobs/other" else expected), (line, level)


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_give_results_in_order_and_begin_few_before_they_are_needed(threads: int):
    begun: list[int] = []

    def squared(k: int) -> int:
        begun.append(k)
        if k == 50:
            raise ValueError(k)
        return k * k

    with limited_threads(threads):
        results = in_threads(squared, range(100), 8)
        assert [next(results) for _ in range(5)] == [0, 1, 4, 9, 16]
        assert len(begun) <= 5 + 2 * threads
        assert [next(results) for _ in range(45)] == [k * k for k in range(5, 50)]
        with pytest.raises(ValueError, match="50"):
            next(results)


def blas_threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}  # pyright: ignore


class RunCounts(Exception):
    """The first thing that a call does, with the threads that BLAS has then."""

    def __init__(self, *_: object) -> None:
        super().__init__(blas_threads())


def tell(*_: object) -> None:
    raise RunCounts


class Probe:
    """A robot, a loop or a solution of which anything is asked."""

    def __getattr__(self, name: str) -> Any:
        raise RunCounts

    def __fspath__(self) -> str:
        raise RunCounts

    def __repr__(self) -> str:
        raise RunCounts


ARM = "planar-two-link"
PROBE: Any = Probe()
LONG_CALLS: dict[str, Callable[[], object]] = {
    "design": lambda: fh.design(fh.load_robot(ARM), progress=tell),
    "compare": lambda: fh.compare(fh.load_robot(ARM), fh.Specification(), progress=tell),
    "certify_design": lambda: certify_design(PROBE, fh.Specification(), tell, tell),
    "identify": lambda: fh.identify(PROBE, PROBE),
    "run_campaign": lambda: fh.run_campaign(PROBE, PROBE, 3),
    "worst_case": lambda: worst_case(PROBE, "peak_speed"),
    "search_weights": lambda: search_weights(PROBE, PROBE, {}, "peak_speed"),
    "certify": lambda: certify(PROBE),
    "Design.certificate": lambda: fh.Design.certificate(PROBE),
    "Design.campaign": lambda: fh.Design.campaign(PROBE, 3),
    "advise": lambda: advise(PROBE, 1.0),
    "reproduce": lambda: reproduce(PaperSettings(), progress=tell),
}


@pytest.mark.parametrize("call", LONG_CALLS)
def test_a_long_call_has_one_thread_of_blas_and_then_the_users_number(
    call: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with threadpool_limits(2, "blas"):
        with pytest.raises((RunCounts, fh.InvalidInput), match=r"\{1\}"):
            LONG_CALLS[call]()
        assert blas_threads() == {2}
    assert "OPENBLAS_NUM_THREADS" not in os.environ


def test_the_users_number_of_blas_stays_and_comes_back_after_calls_in_several_threads(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    begun, end = threading.Event(), threading.Event()

    @single_blas()
    def other() -> None:
        begun.set()
        end.wait()

    with threadpool_limits(2, "blas"):
        thread = threading.Thread(target=other)
        with single_blas(), single_blas():
            thread.start()
            begun.wait()
            assert (blas_threads(), os.environ["OPENBLAS_NUM_THREADS"]) == ({1}, "1")
        end.set()
        thread.join()
        assert blas_threads() == {2}
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
        with single_blas():
            assert blas_threads() == {2}
