"""A progress bar appears on a terminal and only for long work."""

from __future__ import annotations

import sys

import pytest

from flexhinf.hinf import progress


@pytest.mark.parametrize(
    ("terminal", "long", "shown"), [(True, True, True), (False, True, False), (True, False, False)]
)
def test_bar_only_on_a_terminal_and_for_long_work(monkeypatch, capsys, terminal, long, shown):
    monkeypatch.setattr(progress, "_LONG", 0.0 if long else 1e30)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress.degree_progress(3, 4) as advance:
        advance(3)
        advance(4)
    assert ("degree 4 of 4" in capsys.readouterr().err) == shown
