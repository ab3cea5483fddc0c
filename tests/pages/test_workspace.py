"""The page of a workspace: verdict first, what was looked at, margins as numbers, and the worst move of each joint."""

from __future__ import annotations

import dataclasses
import re
from html import unescape
from io import StringIO

import numpy as np
import pytest
from rich.console import Console
from tests import workspaces
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.design import Specification, design_workspace
from flexhinf.design.requirements import REQUIREMENTS
from flexhinf.design.responses import motion_metrics
from flexhinf.design.robustness import LATEST, robustness
from flexhinf.design.workspace.design import GOALS_SEED, POSES_SEED, SAMPLED_SEED
from flexhinf.design.workspace.setup import CHOSEN_SEED, OFFSET_TIME
from flexhinf.modal import ProvedRange, pair_gains
from flexhinf.pages import workspace as page
from flexhinf.pages.page import files_section
from flexhinf.robot.workspace import workspace_of


@pytest.fixture(scope="module")
def design():
    """Of the paper's arm, with few poses and moves and one bandwidth."""
    with pytest.MonkeyPatch.context() as patch:
        workspaces.few(patch, POSES=6, GOALS=2, CHOSEN_POSES=2, MODAL_POSES=20, BANDWIDTHS=(10.0,))
        s = Specification(measured=("link_position", "motor_position"))
        return design_workspace(fh.paper_arm(), s)


@pytest.fixture(scope="module")
def tolerated(design):
    return robustness(design)


@pytest.fixture
def made(design, tolerated, monkeypatch):
    """The page, with the margins computed once."""
    monkeypatch.setattr(page, "robustness", lambda of: tolerated)

    def of(changed=design):
        return page.workspace_page(changed, ["flexhinf", "design", "paper"], files=["design.json"])

    return of


def text_of(html):
    return re.sub(r"\s+", " ", unescape(re.sub(r"<svg.*?</svg>|<[^>]+>", " ", html, flags=re.DOTALL)))


def test_the_page_has_its_sections_and_figures(made, design):
    html = made().html()
    assert [section.id for section in made().sections] == [
        "specification", "poses", "moves", "tolerance", "law", "files",
    ]  # fmt: skip
    assert re.findall(r'id="(figure-[a-z]+)"', html) == ["figure-poses", "figure-move"]
    text = text_of(html)
    assert unnamed(text, "6 random poses", "2 moves", "link position", "motor position") == []
    assert not re.search(r"\bnan\b|\binf\b|\bNone\b|\{small\}", text)
    assert not re.search(r"\bmm\b", text)  # its joint turns


def test_failures_come_first(made, design):
    line = design.requirements[0]
    missed = line.judge(None, line.limit, 2, line.where)
    bad = dataclasses.replace(design, requirements=(missed, *design.requirements[1:]))
    assert [entry.kind for entry in made(bad).status] == ["not met", "not proved"]
    assert page.workspace_verdict(bad).startswith("Not met")
    assert unnamed(page.workspace_verdict(bad), line.what, "2") == []
    assert not page.workspace_verdict(design).startswith("Not met") or not design.met


@pytest.mark.oracle
def test_margins_are_where_the_loop_becomes_unstable(design, tolerated):
    """Every pose is stable below, one is unstable above, by the multipliers of the loops themselves."""
    setup, period = design.setup, design.specification.period

    def radius(late=0.0, by=1.0):
        found = []
        for pose in design.poses:
            loop = setup.linear(pose)
            loop = dataclasses.replace(loop, b=by * loop.b, d=by * loop.d)
            found.append(np.abs(loop.system(loop.delay + late * period).multipliers).max())
        return max(found)

    if tolerated.delay < 0.99 * LATEST:
        assert radius(0.98 * tolerated.delay) < 1.0 < radius(1.02 * tolerated.delay)
    assert radius(by=0.98 * tolerated.louder) < 1.0 < radius(by=1.02 * tolerated.louder)
    assert radius(by=1.02 * tolerated.softer) < 1.0
    needed = [np.abs(design.robot.operating_point(pose)[1]) for pose in design.poses]
    assert tolerated.heavy == np.sum(np.any(needed > 0.7 * setup.limits.effort, axis=1))


def test_every_joint_has_its_worst_move(made, design):
    (section,) = [part for part in made().sections if part.id == "moves"]
    text = text_of(section.html())
    moves = [*design.moves, *design.sampled]
    found = [motion_metrics(design.setup.limits, move.response, move.plan)[0] for move in moves]
    errors = [1e3 * row["remaining_error"] for row in found]
    assert unnamed(text, float(f"{max(errors):.3g}"), f"(move {np.argmax(errors) % 2 + 1}") == []


def test_limits_are_told_of_a_robot_that_has_some(design, tolerated):
    """The paper's arm states none: no share of them and no ripple in moves, but what is assumed."""
    limited = dataclasses.replace(design.specification, saturation=60.0)
    limited = dataclasses.replace(design, setup=dataclasses.replace(design.setup, specification=limited))
    for of, told in ((design, False), (limited, True)):
        assert (unnamed(text_of(page._goal_table(of, tolerated).html()), "70 %") == []) == told
        assert (unnamed(text_of(page._move_table(of).html()), "ripple") == []) == told
        assert (unnamed(text_of(page._law_table(of).html()), "assumed") == []) != told


def test_the_law_can_be_made_again_from_the_page(made, design):
    """Bandwidth, γ, share and integral, and the random torques of its estimator."""
    (section,) = [part for part in made().sections if part.id == "law"]
    gains, (links, motors) = design.setup.law.gains, design.setup.random
    w = gains.weights
    numbers = (w.bandwidth, w.gamma, w.share, w.integral, w.damping, 100.0 * links, 100.0 * motors)
    assert unnamed(text_of(section.html()), *numbers) == []
    again = pair_gains(gains.ends, gains.motor, gains.damping, gains.period, w)
    np.testing.assert_array_equal(again.coefficients, gains.coefficients)
    seeds = POSES_SEED, GOALS_SEED, SAMPLED_SEED, CHOSEN_SEED
    assert unnamed(text_of(made().settings.html()), *seeds) == []


def test_files_stand_in_the_order_of_their_numbers():
    text = files_section([f"runs/move-{k}.nc" for k in (10, 1, 2)]).html()
    assert text.index("move-2") < text.index("move-10")


def test_what_is_proved_and_what_is_computed_are_told_apart(made, design, tolerated):
    (section,) = [part for part in made().sections if part.id == "tolerance"]
    text = text_of(section.html())
    assert unnamed(text, "proved", "computed", float(f"{100 * tolerated.tolerance.error:.3g}")) == []
    assert tolerated.proved.high == design.setup.law.gains.ends[1]
    part = tolerated._replace(proved=ProvedRange(70.0, 81.0, 0.0, 3))
    assert unnamed(page._not_proved(design, part), "9 rad/s", "random samples") == []


def test_what_offsets_of_encoders_do_is_said(design, tolerated):
    """As they are taken in, at once, and what remains; nothing where the true state is fed back."""
    home = np.array(design.setup.workspace.home)
    (text,) = (block.html() for block in page._offsets(design, tolerated))
    numbers = [design.setup.encoder_offsets(home, time)[0, 0] for time in (OFFSET_TIME, None)]
    assert unnamed(text, "0.5 mrad", "motors", "0.5 s", *(float(f"{1e3 * x:.2g}") for x in numbers)) == []
    assert numbers[0] < numbers[1]
    of = dataclasses.replace(design.specification, estimator="none")
    changed = dataclasses.replace(design, setup=dataclasses.replace(design.setup, specification=of))
    assert page._offsets(changed, robustness(changed)) == []


def test_a_move_that_diverges_or_has_no_number_is_one(design, tolerated):
    move = design.moves[0]
    run = dataclasses.replace(move.response.run, diverged_at=0.2)
    gone = dataclasses.replace(move, response=dataclasses.replace(move.response, run=run))
    rows = page.worst_motion([gone, move])
    assert np.isinf(rows[0]["remaining_error"])
    assert np.isfinite(rows[1]["remaining_error"])
    assert page._largest([None, 2.0, 1.0]) == 2.0
    assert np.isnan(page._largest([None, None]))


def test_the_terminal_shows_what_is_missed_within_a_screen(design):
    """At most 25 lines of 80 columns with the path of the page, whatever is missed; and what to try."""
    where = "the worst of 20 moves, robots at corners of their tolerances"
    limited = [
        REQUIREMENTS[name].judge(None, 1.0, 9.0, where, unit="N·m", joint="panda_joint1", at=0.847)
        for name in ("path", "peak", "speed", "range", "limit_cycle")
    ]
    missed = tuple(
        dataclasses.replace(line, found=2.0 * line.limit + 1.0 if line.at_most else 0.0)
        for line in (*design.requirements, *limited, *limited)
    )
    for of in (design, dataclasses.replace(design, requirements=missed)):
        screen = Console(width=80, file=StringIO())
        screen.print(*page.workspace_tables(of), page.workspace_text(of), sep="\n")
        text = screen.file.getvalue()
        assert len(text.splitlines()) < 25
        assert max(map(len, text.splitlines())) <= 80
        assert unnamed(text, "joint ranges", "remaining error") == []
        assert (unnamed(text, "NOT MET") == []) == (not of.met)
        assert (unnamed(text, "--workspace", "--remaining-error", "--damping") == []) == (not of.met)


def test_the_page_says_what_is_watched_at_run_time_and_what_is_not(made, design):
    """The box of joints and the reactions; of a box in space, that the tool is not watched."""
    text = text_of(made().html())
    assert unnamed(text, "run time", "status", "path_rate", "reset", "supervision", "brake", "swings") == []
    assert unnamed(text, "tool") != []
    limited = dataclasses.replace(design.specification, saturation=60.0)
    limited = dataclasses.replace(design, setup=dataclasses.replace(design.setup, specification=limited))
    for of, told in ((design, False), (limited, True)):
        watched = text_of(page._watched(of).html())
        assert (unnamed(watched, "at a limit", "0.2 s") == []) == told
    space = workspace_of(design.robot, "x=-0.2:0.2")
    changed = dataclasses.replace(design, setup=dataclasses.replace(design.setup, workspace=space))
    assert unnamed(text_of(made(changed).html()), "not watch", "tool", "box in space") == []
