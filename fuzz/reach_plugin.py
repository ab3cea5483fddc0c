"""A plugin of pytest for `fuzz.mutants`: each test notes what it reached, see `fuzz.reach`.

``FLEXHINF_WITHIN`` is the number of CPU seconds after which no test begins.
"""

from __future__ import annotations

import atexit
import os
from typing import Any

import pytest

from fuzz.reach import OUT_OF_TIME, at_exit, reached, write


class Reach:
    """The plugin itself."""

    def __init__(self) -> None:
        from tests.costs import spent

        self.spent, self.ended = spent, ""
        self.within = float(os.environ.get("FLEXHINF_WITHIN", "inf"))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        """Measure a test, if there is time left for it."""
        if self.spent() > self.within:
            pytest.exit("no test begins after so many CPU seconds", returncode=OUT_OF_TIME)
        reached.clear()
        self.ended, before = "", self.spent()
        outcome = yield
        if os.environ.get("FLEXHINF_REACH"):
            write(item.nodeid, self.spent() - before, self.ended)
        return outcome

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
        """Keep how a test ended."""
        report = yield
        if report.outcome != "passed" or (call.when == "call" and not self.ended):
            self.ended = report.outcome
        return report

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Quick tests first, each kind in the order that was asked for."""
        items.sort(key=lambda item: any(item.get_closest_marker(tier) for tier in ("slow", "ci")))


def pytest_configure(config: pytest.Config) -> None:
    """Tests note for themselves what they reach."""
    atexit.unregister(at_exit)
    config.pluginmanager.register(Reach(), "flexhinf-reach")
