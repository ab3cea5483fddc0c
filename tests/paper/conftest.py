"""One reproduction with the default settings, shared by the tests of the paper."""

from __future__ import annotations

import pytest

from flexhinf.paper import PaperSettings, Reproduction, reproduce
from flexhinf.paper.bench import PaperBench
from flexhinf.paper.reproduction import STAGES


@pytest.fixture(scope="session")
def bench() -> PaperBench:
    """The bench with the default settings."""
    return PaperBench(PaperSettings())


@pytest.fixture(scope="session")
def told() -> list[str]:
    """What the reproduction said while it ran."""
    return []


@pytest.fixture(scope="session")
def reproduction(told: list[str]) -> Reproduction:
    """The whole report with the default settings."""
    result = reproduce(PaperSettings(), progress=told.append)
    assert len(told) == STAGES
    return result
