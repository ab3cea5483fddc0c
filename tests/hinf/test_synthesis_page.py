"""The programs on docs/synthesis.md run, and what is said of their results is so."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest


def test_examples_of_the_page_run(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (repository / "docs" / "synthesis.md").read_text(encoding="utf-8")
    names: dict = {}
    programs = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(programs) == 2
    for program in programs:
        exec(program, names)
    shown = capsys.readouterr().out
    assert shown.startswith("[-0.2209")
    assert names["gamma"] == pytest.approx(2.0, rel=1e-8)
    columns = re.compile(r"(\d\.\de-\d\d|[\d.]+ (ms|kB|s)\b) *")  # residuals, times and sizes vary
    report = columns.sub("", names["hji"].report()).split("\n\n")[1].split("\n")
    on_page = columns.sub("", page)
    for line in report:
        assert line.rstrip() in on_page
    assert np.isfinite(names["v4"]).all()
