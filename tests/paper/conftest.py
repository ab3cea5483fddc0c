"""One reproduction with the default settings, shared by the tests of the paper."""

from __future__ import annotations

import pytest

from flexhinf.pages import paper_files
from flexhinf.paper import PaperSettings, Reproduction, reproduce
from flexhinf.paper.loop_setup import PaperSetup
from flexhinf.paper.reproduction import STAGES


@pytest.fixture(scope="session")
def setup() -> PaperSetup:
    """The setup with the default settings."""
    return PaperSetup(PaperSettings())


@pytest.fixture(scope="session")
def said() -> list[str]:
    """What the reproduction said while it ran."""
    return []


@pytest.fixture(scope="session")
def reproduction(said: list[str]) -> Reproduction:
    """The whole report with the default settings."""
    result = reproduce(PaperSettings(), progress=said.append)
    assert len(said) == STAGES
    return result


@pytest.fixture(scope="session")
def files(reproduction: Reproduction) -> dict[str, str]:
    """The files of its report."""
    return paper_files(reproduction)
