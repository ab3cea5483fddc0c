"""Settings of all tests: hypothesis draws the same examples every time and knows no deadline."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(
        _name, "1"
    )  # small matrices: more threads only cost, and tests already run side by side

settings.register_profile(
    "flexhinf",
    derandomize=True,
    deadline=None,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("thorough", parent=settings.get_profile("flexhinf"), max_examples=1000)
settings.load_profile(os.environ.get("FLEXHINF_HYPOTHESIS", "flexhinf"))


@pytest.fixture(scope="session")
def repository() -> Path:
    """The folder that holds pyproject.toml."""
    return Path(__file__).resolve().parents[1]
