"""Pictures by which robots and designs show themselves, in a notebook and on the page of a check."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
import re
from base64 import b64encode
from contextlib import suppress
from functools import singledispatch
from html import escape, unescape

import numpy as np

from flexhinf.design.pose_evidence import PoseEvidence
from flexhinf.design.result import Design
from flexhinf.design.stored import StoredReport
from flexhinf.design.workspace.evidence import WorkspaceEvidence
from flexhinf.errors import InvalidInput
from flexhinf.numerals import number
from flexhinf.pages.design.overview import lead
from flexhinf.pages.design.step import arm_plane
from flexhinf.pages.drawing import figure_block
from flexhinf.pages.workspace import workspace_lead
from flexhinf.report import INK, MUTED, SERIES, Figure, house_style, label, legend, panels
from flexhinf.report.figure import standalone
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import skeleton

#: By how much an arrow moves a joint that turns, rad, and one that slides, of the robot's size.
TURN, SLIDE = math.radians(15.0), 0.12


@house_style()
def robot_picture(robot: Robot) -> Figure | None:
    """The links at the robot's home, and for each joint an arrow to where its positive direction moves the end of its
    link; None for links without a length."""
    home = np.asarray(robot.home, dtype=float)
    lines = skeleton(robot, home)
    size = float(np.ptp(np.concatenate(lines), axis=0).max())
    steps = np.diag(np.where(robot.links.slides, SLIDE * size, TURN))
    moved = [skeleton(robot, home + step) for step in steps]
    seen = arm_plane(robot, [lines, *moved])
    if seen is None:
        return None
    view, names, (low, high) = seen
    panel = np.array((5.0, min(max(5.0 * (high - low)[1] / (high - low)[0], 1.8), 3.6)))
    # As much to the inch in both directions, the whole panel used.
    half = 0.5 * max((high - low) / panel) * panel
    (left, bottom), (right, top) = 0.5 * (low + high) - half, 0.5 * (low + high) + half
    figure, ((axes,),) = panels(1, 1, 1.2 + float(panel[1]))
    for line in lines:
        axes.plot(*(line @ view).T, color=SERIES[0], linewidth=3.2)
    joints = np.array([line[0] for line in lines]) @ view
    axes.plot(*joints.T, "o", color=INK, markersize=4.5)
    numbers: list[np.ndarray] = []
    numbered = len(robot.joint_names) > len(SERIES) - 1  # more joints than colours
    for k, (joint, own) in enumerate(zip(robot.joint_names, lines)):
        ends = ((own[-1] @ view, moved[k][k][-1] @ view), (lines[-1][-1] @ view, moved[k][-1][-1] @ view))
        seen_ends = (pair for pair in ends if float(np.linalg.norm(pair[1] - pair[0])) > 1e-3 * size)
        if (pair := next(seen_ends, None)) is None:
            continue
        begin, end = pair
        colour = SERIES[1 + k % (len(SERIES) - 1)]
        arrow = {"arrowstyle": "-|>", "linewidth": 2.0, "shrinkA": 0, "shrinkB": 0, "color": colour}
        axes.annotate("", end, begin, arrowprops=arrow)
        if numbered:
            near = sum(float(np.linalg.norm(end - other)) < 0.03 * size for other in numbers)
            numbers.append(end)
            axes.annotate(
                str(k + 1), end, (10.0 + 12.0 * near, 7.0), textcoords="offset points", color=colour
            )
        axes.plot([], [], label=f"{k + 1} {joint}" if numbered else joint, linewidth=2.0, color=colour)
    axes.axhline(float(joints[0, 1]), color=MUTED, linewidth=0.6, zorder=0)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_xlabel(f"{names[0]} (m)")
    label(axes, names[1], "m")
    legend(axes)
    place = ", ".join(
        f"{number(float(q), 3)} m" if slides else f"{number(math.degrees(q), 3)}°"
        for q, slides in zip(home, robot.links.slides)
    )
    return figure_block(
        "robot",
        figure,
        f"{robot.name} at home ({place}). An arrow leads where a joint moves the end of its link, or else of the "
        f"arm, when its position grows, by {math.degrees(TURN):.0f}° where it turns; a joint without one moves it out "
        "of the picture. A last link is drawn to twice the distance of its centre of mass.",
        "The arm",
    )


@singledispatch
def pictures_of(result: object) -> list[Figure]:
    """The pictures of a result; none where it has none."""
    return []


@pictures_of.register
def _(result: Robot) -> list[Figure]:
    picture = robot_picture(result)
    return [] if picture is None else [picture]


@pictures_of.register
def _(result: Design) -> list[Figure]:
    evidence = result.evidence
    if isinstance(evidence, PoseEvidence):
        return lead(evidence)
    if isinstance(evidence, WorkspaceEvidence):
        return workspace_lead(evidence)
    return stored_lead(evidence) if isinstance(evidence, StoredReport) else []


#: The drawings that the page of a design begins with, each with its label and its caption.
_LEAD = re.compile(
    r'<figure id="figure-(result(?:-arm)?)"[^>]*><div class="drawing">(<svg.*?</svg>)</div>'
    r"<figcaption[^>]*>(?:<strong>(.*?)\.</strong>)?(.*?)</figcaption>",
    re.DOTALL,
)


def stored_lead(report: StoredReport) -> list[Figure]:
    """What the page in the folder of a design begins with; nothing where it was changed or has gone."""
    with suppress(InvalidInput):
        page = report.files.get("index.html", "")
        text = page if isinstance(page, str) else page.decode()
        return [
            Figure(name, standalone(svg), _plain(said), _plain(called))
            for name, svg, called, said in _LEAD.findall(text)
        ]
    return []


def _plain(html: str) -> str:
    return unescape(re.sub(r"<[^>]*>", "", html)).strip()


def notebook_pictures(result: object) -> str:
    """The pictures of a result as HTML, on white: a notebook may have other colours."""
    figures = (
        '<figure style="margin: 0.5em 0; max-width: 36em">'
        f'<img style="width: 100%; background: white" alt="{escape(figure.label)}" '
        f'src="data:image/svg+xml;base64,{b64encode(figure.svg.encode()).decode()}">'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
        for figure in pictures_of(result)
    )
    return "".join(figures)
