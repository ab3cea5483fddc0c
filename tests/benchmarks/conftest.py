"""Benchmarks do not ship, so none of their tests is a quick one."""

from __future__ import annotations

from pathlib import Path

import pytest

TIERS = ("ci", "nightly")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents and not any(map(item.get_closest_marker, TIERS)):
            item.add_marker(pytest.mark.ci("of a benchmark, which does not ship"))
