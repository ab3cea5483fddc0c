"""Settings of all tests: hypothesis draws the same examples every time and knows no deadline."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from cProfile import Profile
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

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


@cache
def _why_not(compiler: str, flags: tuple[str, ...]) -> str:
    """Why a program cannot be built with these flags and run; empty where it can."""
    found = shutil.which(compiler)
    if found is None:
        return f"no {compiler}"
    with TemporaryDirectory() as work:
        (Path(work) / "probe.c").write_text(
            '#include <math.h>\n#include <stdio.h>\nint main(void) { return printf("%d", 1) != 1; }\n'
        )
        for words in ([found, *flags, "probe.c", "-lm", "-o", "probe"], ["./probe"]):
            done = subprocess.run(words, cwd=work, capture_output=True, text=True, check=False)
            if done.returncode:
                said = (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[-1]
                return f"{compiler} {' '.join(flags)} does not work here: {said[:200]}"
    return ""


@pytest.fixture(scope="session")
def needs_compiler() -> Callable[..., None]:
    """Skips, with the reason, where a compiler is missing, or what it builds with these flags does not run."""

    def needed(compiler: str, *flags: str) -> None:
        if reason := _why_not(compiler, flags):
            pytest.skip(reason)

    return needed


@pytest.fixture
def bounded_work() -> Callable[[int], AbstractContextManager[None]]:
    """A context with at most so many calls of Python and C functions: a bound that no busy machine breaks."""

    @contextmanager
    def bounded(most: int) -> Iterator[None]:
        profile = Profile()
        profile.enable()
        try:
            yield
        finally:
            profile.disable()
            calls = sum(entry.callcount for entry in profile.getstats())
            assert calls <= most, f"{calls} calls"

    return bounded
