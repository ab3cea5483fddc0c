"""One self-contained page in which an arm runs in real time: no server, and nothing from the network."""

from __future__ import annotations

import base64
import gzip
import os
from pathlib import Path

from flexhinf import __version__
from flexhinf.export.rendering import render
from flexhinf.export.web.compiler import check_compiler, webassembly
from flexhinf.export.web.live_arm import LiveArm
from flexhinf.export.web.rival import BELOW
from flexhinf.files import check_replaceable, write_file
from flexhinf.numerals import unbroken
from flexhinf.validation import checked_path

#: What the page's script is made of, in this order.
SCRIPTS = ("simulation.js", "drawing.js", "plots.js", "page.js")


def write_page(arm: LiveArm, path: str | os.PathLike[str]) -> Path:
    """Write the page of an arm, whole or not at all; the file's path.

    Raises InvalidInput: if clang or wasm-ld is missing or fails, or the file cannot be written.
    """
    target = checked_path("The page", path)
    check_replaceable(target, "live page", lambda content: b"flexhinf live page" in content[:1000])
    check_compiler()
    text = page_text(arm, webassembly(arm.sources))
    write_file(target, "page", lambda part: Path(part).write_text(text, encoding="utf-8"))
    return target


def page_text(arm: LiveArm, module: bytes) -> str:
    """The HTML of a page with a compiled module."""
    pd = arm.rival
    gains = [
        {"joint": joint, "unit": unit, "kp": kp, "kd": kd, "bandwidth": omega, "damping": zeta}
        for joint, unit, kp, kd, omega, zeta in zip(
            arm.robot.joint_names,
            arm.units,
            pd.proportional,
            pd.derivative,
            pd.bandwidth,
            pd.damping,
            strict=True,
        )
    ]
    return render(
        "web/page.html",
        settings=arm.settings(),
        pd=pd,
        gains=gains,
        below=BELOW,
        notes=[unbroken(text) for text in arm.notes],
        warnings=[unbroken(text) for text in _warnings(arm)],
        scripts=[f"web/{script}" for script in SCRIPTS],
        version=__version__,
        module=base64.b64encode(gzip.compress(module, 9, mtime=0)).decode(),
    ).rstrip()


def _warnings(arm: LiveArm) -> list[str]:
    """Which requirements are not met, and whether the PD is a fair comparison."""
    found: list[str] = []
    if arm.not_met:
        found.append(f"{arm.not_met}.")
    if not arm.rival.fair:
        found.append(
            "The PD beside this design is no fair comparison: none of the gains that were tried keep it stable, with "
            "margins, at all poses of this page. It may swing by itself."
        )
    return found
