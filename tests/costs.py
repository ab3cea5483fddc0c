"""What a run of tests cost, for each room: printed, and kept in build/cpu.json with the tests that lacked a tool.

A test's cost is the CPU time of its process and of the processes that it waits for, its fixtures included. Nothing is
judged by it, since machines differ.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

#: CPU seconds above which a test states why it costs them, by one of its marks `costs`, `ci` and `nightly`.
STATED = 1.0

#: How a skip begins whose reason is that a tool is not installed.
MISSING = ("missing: ", "could not import ")
#: Under which such skips are counted in the last line.
FOR_WANT = "for want of a tool"


def spent() -> float:
    """CPU time of this process and of those that it has waited for, s."""
    kids = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + kids.ru_utime + kids.ru_stime


def resident() -> float:
    """Memory of this process, KB, after what is garbage has gone."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e3


def room_of(nodeid: str) -> str:
    """The room that a test belongs to; "house" for tests of the repository."""
    parts = nodeid.partition("::")[0].split("/")
    if parts[0] == "src":
        return parts[2] if len(parts) > 3 else "house"
    return parts[1] if len(parts) > 2 else "house"


def why_of(item: pytest.Item) -> str:
    """Why a test costs what it does, as its marks say; an example of a docstring has none."""
    if isinstance(item, pytest.DoctestItem):
        return "an example as users run it"
    marks = (item.get_closest_marker(name) for name in ("costs", "nightly", "ci"))
    return next((mark.args[0] for mark in marks if mark is not None and mark.args), "")


def missing_tool(report: pytest.TestReport | pytest.CollectReport) -> str:
    """The reason of a skip for want of a tool; empty for any other outcome."""
    if not (report.skipped and isinstance(report.longrepr, tuple)):
        return ""
    reason = str(report.longrepr[2]).removeprefix("Skipped: ")
    return reason if reason.startswith(MISSING) else ""


class Costs:
    """Measures in each worker, adds up where the tests were started."""

    def __init__(self, config: pytest.Config) -> None:
        self.config, self.worker = config, hasattr(config, "workerinput")
        self.rooms: dict[str, float] = defaultdict(float)
        self.tests: dict[str, tuple[float, str]] = {}
        self.missing: dict[str, str] = {}
        self.before = 0.0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self) -> None:
        self.before = spent()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
        report = yield
        if call.when == "teardown":
            report.user_properties.append(("cost", [round(spent() - self.before, 4), why_of(item)]))
        return report

    def pytest_collection_finish(self) -> None:
        """Imports and collection, of every worker."""
        cost = round(time.process_time(), 2)
        if self.worker:
            self.config.workeroutput["collected"] = cost  # type: ignore[attr-defined]
        else:
            self.rooms["(collection)"] += cost

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self.rooms["(collection)"] += getattr(node, "workeroutput", {}).get("collected", 0.0)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file may be skipped as a whole; each worker tells of it."""
        if not self.worker and (reason := missing_tool(report)):
            self.missing.setdefault(report.nodeid, reason)

    def pytest_report_teststatus(self, report: pytest.TestReport) -> tuple[str, str, str] | None:
        """Skips for want of a tool are a number of their own in the last line."""
        return (FOR_WANT, "m", "MISSING") if missing_tool(report) else None

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if self.worker:
            return
        if reason := missing_tool(report):
            self.missing[report.nodeid] = reason
        for name, value in report.user_properties:
            if name == "cost":
                cost, why = value
                self.rooms[room_of(report.nodeid)] += cost
                self.tests[report.nodeid] = (cost, why)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """In CI, which installs the tools, none may be missing."""
        if self.missing and os.environ.get("CI") and not self.worker and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        if self.worker or not self.tests:
            return
        total = sum(self.rooms.values())
        terminalreporter.section(f"CPU seconds: {total:.0f}", sep="-")
        rooms = sorted(self.rooms.items(), key=lambda room: -room[1])
        terminalreporter.write_line("  ".join(f"{name} {cost:.0f}" for name, cost in rooms))
        long = {name: value for name, value in self.tests.items() if value[0] > STATED}
        silent = sorted(name for name, (_, why) in long.items() if not why)
        for name in silent:
            terminalreporter.write_line(f"{long[name][0]:.1f} s, and does not say why: {name}")
        for name, reason in self.missing.items():
            terminalreporter.write_line(f"MISSING {name}: {reason}")
        if self.config.args_source != self.config.ArgsSource.TESTPATHS:  # some tests are no run
            return
        files: dict[str, float] = defaultdict(float)
        for name, (cost, _) in self.tests.items():
            files[name.partition("::")[0]] += cost
        place = Path(self.config.rootpath) / "build" / "cpu.json"
        place.parent.mkdir(exist_ok=True)
        kept = json.loads(place.read_text(encoding="utf-8")) if place.exists() else {}
        kept[self.config.option.markexpr or "all"] = {
            "total": round(total, 1),
            "date": time.strftime("%Y-%m-%d"),
            "outcomes": {
                kind: len(found)
                for kind, found in terminalreporter.stats.items()
                if kind in ("passed", "failed", "error", "skipped", FOR_WANT)
            },
            "python": sys.version.split()[0],
            "rooms": {name: round(cost, 1) for name, cost in rooms},
            "files": {file: round(cost, 1) for file, cost in sorted(files.items(), key=lambda f: -f[1])},
            "tests": {
                name: [cost, why] for name, (cost, why) in sorted(long.items(), key=lambda t: -t[1][0])
            },
        }
        place.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
