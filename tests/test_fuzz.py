"""Every fuzzer: nothing silently wrong, no error but ours. `make ci` tries a tenth of what `make nightly` tries."""

from __future__ import annotations

import os
import time
from importlib import import_module
from pathlib import Path

import pytest
from fuzz import FUZZERS
from fuzz.tally import LONGEST_MESSAGE, Tally

PROMISES = Path(__file__).resolve().parents[1] / "docs" / "promises.md"
"""The page with the table of attempts that ended with neither a right answer nor an error of ours."""

LIMIT_S = 300
"""Processor seconds for one fuzzer."""

pytestmark = pytest.mark.skipif(os.name != "posix", reason="forks, signals and pipes")


@pytest.mark.ci("tries a thousand hostile inputs")
@pytest.mark.usefixtures("unoptimised")  # a tenth less of their time; `make nightly` runs the code that ships
@pytest.mark.parametrize("name", list(FUZZERS))
def test_a_tenth_of_the_attempts_is_right_or_typed(name: str) -> None:
    fuzzer = import_module(f"fuzz.{name}")
    tally = fuzzer.run(fuzzer.ATTEMPTS // 10, seed=0)
    assert tally.tried >= fuzzer.ATTEMPTS // 10
    assert not tally.wrong, "\n".join(tally.wrong[:20])


@pytest.mark.nightly("all attempts of the table of promises; a tenth of them are tried in `make ci`")
@pytest.mark.parametrize("name", list(FUZZERS))
def test_every_attempt_is_right_or_typed(name: str) -> None:
    fuzzer = import_module(f"fuzz.{name}")
    start = time.process_time()
    tally = fuzzer.run(fuzzer.ATTEMPTS, seed=0)
    assert tally.tried >= fuzzer.ATTEMPTS
    assert not tally.wrong, "\n".join(tally.wrong[:20])
    assert f"| {tally.what} | {tally.tried} | 0 |" in PROMISES.read_text(encoding="utf-8")
    assert time.process_time() - start < LIMIT_S


def test_a_tally_tells_right_typed_and_neither() -> None:
    from flexhinf.errors import InvalidInput

    tally = Tally("trial")
    tally.answered()
    tally.answered("a silent NaN", "seed 3")
    tally.raised(InvalidInput("no"), "seed 4")
    long = InvalidInput("no")
    long.args = ("n" * (LONGEST_MESSAGE + 1),)
    tally.raised(long, "seed 5")
    tally.raised(ZeroDivisionError("division"), "seed 6")
    assert (tally.tried, tally.right, tally.typed) == (5, 1, 1)
    assert [line.split(":")[0] for line in tally.wrong] == ["seed 3", "seed 5", "seed 6"]
