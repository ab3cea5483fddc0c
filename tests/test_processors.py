"""Threads are those that were requested, else the processors that the process may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from flexhinf import processors
from flexhinf.processors import available, in_threads, limited_threads, thread_count


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
