"""One self-contained page in which an arm runs in real time: no server, and nothing from the network."""

from __future__ import annotations

import base64
import gzip
import json
import os
from html import escape
from importlib.resources import files
from pathlib import Path

from flexhinf import __version__
from flexhinf.export.filling import at_once
from flexhinf.export.web.compiler import check_compiler, webassembly
from flexhinf.export.web.live_arm import LiveArm
from flexhinf.export.web.rival import BELOW
from flexhinf.files import check_replaceable, write_file
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
    settings = arm.settings()
    marks = {
        "TITLE": escape(f"{settings['robot']}: live arm"),
        "HEADING": escape(f"Pull this robot arm: {settings['robot']}"),
        "LEAD": escape(_lead(settings["joints"])),
        "TRY": "pull a link with the mouse, click beside the arm to move its goal, give it a payload, or show "
        "50 arms with other springs and masses.",
        "VERDICT": "\n".join(f'<p class="warning">{escape(text)}</p>' for text in _warnings(arm)),
        "STYLE": _file("page.css"),
        "SCRIPT": "\n".join(map(_file, SCRIPTS)),
        "ABOUT": _about(arm),
        # no text may end the element that it stands in
        "SETTINGS": json.dumps(settings, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
        "MODULE": base64.b64encode(gzip.compress(module, 9, mtime=0)).decode(),
    }
    return at_once(_file("page.html"), marks)  # what looks like a mark in the name of a joint is none


def _file(name: str) -> str:
    return (files("flexhinf.export.web") / name).read_text(encoding="utf-8").rstrip("\n")


def _warnings(arm: LiveArm) -> list[str]:
    """Which requirements are not met, and whether the PD is a fair comparison."""
    found = []
    if arm.not_met:
        found.append(f"{arm.not_met}.")
    if not arm.rival.fair:
        found.append(
            "The PD beside this design is no fair comparison: none of the gains that were tried keep it stable, with "
            "margins, at all poses of this page. It may swing by itself."
        )
    return found


def _lead(joints: list[str]) -> str:
    spring = "a spring in its joint" if len(joints) == 1 else f"springs in its {len(joints)} joints"
    return (
        f"A robot arm with {spring} moves in your browser in real time, twice: with the controller of this "
        "design, and with a PD on its motors that was tuned for the same arm."
    )


def _about(arm: LiveArm) -> str:
    settings, pd = arm.settings(), arm.rival
    rows = "".join(
        f"<tr><th scope='row'>{escape(key)}</th><td>{escape(text)}</td></tr>"
        for key, text in settings["facts"].items()
    )
    effort, gains = settings["effort"], []
    for name, kp, kd, omega, zeta in zip(
        settings["joints"], pd.proportional, pd.derivative, pd.bandwidth, pd.damping, strict=True
    ):
        unit = settings["unit"][settings["joints"].index(name)]
        gains.append(
            f"<li>{escape(name)}: K<sub>p</sub> = {kp:.4g} {effort}/{unit}, K<sub>d</sub> = {kd:.4g} {effort}·s/{unit} "
            f"(bandwidth {omega:.3g} rad/s, damping ratio {zeta:.3g})</li>"
        )
    margins = (
        "stays stable with one period of latency more, and with all gains halved or doubled"
        if pd.fair
        else "is not stable everywhere, or would not be with one period of latency more or other gains"
    )
    checked = (
        f" In {pd.checked} linear loops, at these poses and at ends of the joints' ranges, with robots at corners of "
        f"the tolerances too, it {margins}. The smallest damping ratio of an oscillation below {BELOW:g} rad/s is "
        f"{pd.least:.2g}."
    )
    commands = (
        "gets the same commands with the same feedforward"
        if settings["shortest"]
        else "follows a smooth motion to the goal with feedforward, as quick as the inputs of the design's step allow"
    )
    where = f"at {pd.poses} poses" if pd.poses > 1 else "at one pose"
    notes = "".join(f"<p>{escape(note)}</p>" for note in arm.notes)
    return (
        f"{notes}<p>The controller is the C code that <code>flexhinf export c</code> writes for a robot, compiled to "
        f"WebAssembly, one step every {1e3 * settings['period']:g} ms. The arm is the design's own model of the robot, "
        "links, springs and motors, integrated by the Runge–Kutta method of order four. The sliders change the arm and "
        "not the controller.</p>"
        f"<table>{rows}</table>"
        "<p>The PD has the encoders of the motors, with the same noise and latency, and their filtered differences as "
        f"speeds. It holds the weight at its command, knows the nominal arm for that, and "
        f"{commands}. Its gains were searched when this page was made: they bring the links to rest fastest "
        f"after a step of each joint, in the linear loop with its latency, {where}.{checked}</p>"
        f"<ul>{''.join(gains)}</ul>"
        f"<p>Made by flexhinf {escape(__version__)}.</p>"
    )
