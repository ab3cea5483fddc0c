"""One page in which the arm runs in real time in the browser."""

from __future__ import annotations

from pathlib import Path

from flexhinf.designs.exports.kinds import Exported, ExportKind, register
from flexhinf.designs.live_page import live_arm
from flexhinf.export.web import check_compiler, write_page


def _write(it: Exported, path: Path) -> Path:
    assert it.robot is not None  # of a design
    assert it.specification is not None
    return write_page(live_arm(it.controller, it.robot, it.specification, not_met=it.not_met), path)


register(ExportKind("web", "One page in which the arm runs in the browser.", ".html", _write, check_compiler))
