"""The page of a workspace: verdict first, what was looked at, margins as numbers, and the worst move of each joint."""

from __future__ import annotations

import dataclasses
import re
from html import unescape
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console
from tests import workspaces
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf import report
from flexhinf.certify.checker.pairs import CheckedPairs
from flexhinf.designs import Specification, design_workspace
from flexhinf.designs.advice import Advice, Change, Trial
from flexhinf.designs.fields import resolved
from flexhinf.designs.judge import UNHELD, holding_requirement
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.responses import motion_metrics
from flexhinf.designs.result import judged_by
from flexhinf.designs.verdict import UNKNOWN
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.designs.workspace.masses import StatedErrors
from flexhinf.designs.workspace.proof import WorkspaceProof
from flexhinf.designs.workspace.resting_loops import CHOSEN_SEED, OFFSET_TIME
from flexhinf.designs.workspace.robustness import (
    LATEST,
    Cause,
    Robustness,
    quantity_of,
    remaining_cause,
    remaining_errors,
    robustness,
)
from flexhinf.designs.workspace.samples import GOALS_SEED, POSES_SEED, SAMPLED_SEED
from flexhinf.modal import ProvedRange, pair_gains
from flexhinf.modal.pair_errors import Errors, Sector
from flexhinf.modal.unstable import UnstableError
from flexhinf.pages import workspace as page, workspace_summary as summary
from flexhinf.pages.files import EarlyParts, design_files
from flexhinf.pages.page import files_section
from flexhinf.pages.workspace_parts import WorkspaceParts
from flexhinf.pages.workspace_proof import (
    masses_text,
    stability_text,
    workspace_proof_ending,
    workspace_proof_page,
)
from flexhinf.robot.workspace import workspace_of

#: The loops of a design that is made once: 2 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(scope="module")
def design(unoptimised):
    """Of the paper's arm, with few poses and moves and one bandwidth."""
    with pytest.MonkeyPatch.context() as patch:
        workspaces.few(
            patch, POSES=6, GOALS=2, CHOSEN_POSES=2, MODAL_POSES=20, BANDWIDTHS=(10.0,), MARGIN=1.02
        )  # fmt: skip
        s = Specification(measured=("link_position", "motor_position"))
        return design_workspace(fh.paper_arm(), resolved(fh.paper_arm(), s))


@pytest.fixture(scope="module")
def tolerated(design):
    return design.robustness


def robustness_of(it: WorkspaceEvidence) -> Robustness:
    return robustness(it.setup, it.poses, it.loops, it.undamped[0])


@pytest.fixture(autouse=True)
def margins_once(design, tolerated, monkeypatch):
    """Pages and screens of this loop take the margins that are computed once."""
    known = property(lambda of: tolerated if of.setup is design.setup else robustness_of(of))
    monkeypatch.setattr(WorkspaceEvidence, "robustness", known)


@pytest.fixture(scope="module")
def pages():
    return {}


@pytest.fixture
def made(design, tolerated, pages, margins_once, monkeypatch):
    """The page of a design, made once; with these margins, whatever its loop."""
    monkeypatch.setattr(WorkspaceEvidence, "robustness", property(lambda of: tolerated))

    def of(changed=design):
        if id(changed) not in pages:
            words = ["flexhinf", "design", "paper"]
            pages[id(changed)] = changed, page.workspace_page(changed, words, files=["design.json"])
        return pages[id(changed)][1]

    return of


def text_of(html):
    return re.sub(r"\s+", " ", unescape(re.sub(r"<svg.*?</svg>|<[^>]+>", " ", html, flags=re.DOTALL)))


@pytest.mark.costs("makes and draws a design for a workspace, which the others share")
def test_the_page_has_its_sections_and_figures(made, design):
    html = made().html()
    assert [section.id for section in made().sections] == [
        "specification", "poses", "moves", "tolerance", "law", "files",
    ]  # fmt: skip
    drawn = re.findall(r'<figure id="figure-([a-z-]+)"', html)
    assert [name for name in drawn if name != "result-arm"] == ["result", "poses", "move"]
    text = text_of(html)
    assert unnamed(text, "6 random poses", "2 moves", "link position", "motor position") == []
    assert not re.search(r"\bnan\b|\binf\b|\bNone\b|\{small\}", text)
    assert not re.search(r"\bmm\b", text)  # its joint turns


def test_failures_come_first(made, design):
    line = design.requirements[0]
    missed = dataclasses.replace(line, found=2.0)
    bad = dataclasses.replace(design, requirements=(missed, *design.requirements[1:]))
    assert [entry.kind for entry in made(bad).status] == ["not met", "not proved"]
    assert summary.workspace_verdict(bad).startswith("Not met")
    assert unnamed(summary.workspace_verdict(bad), line.what, "2") == []
    assert not summary.workspace_verdict(design).startswith("Not met") or not design.met


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
    assert "ripple" not in text_of(page._move_table(design).html())
    limited = dataclasses.replace(design.specification, saturation=60.0)
    limited = dataclasses.replace(design, setup=dataclasses.replace(design.setup, specification=limited))
    for of, told in ((design, False), (limited, True)):
        assert (unnamed(text_of(page._goals(of, tolerated).html()), "70 %") == []) == told
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
    assert unnamed(text_of(report.Settings(made().settings).html()), *seeds) == []


def test_files_stand_in_the_order_of_their_numbers():
    text = files_section([f"runs/move-{k}.nc" for k in (10, 1, 2)]).html()
    assert "runs/move-1.nc</code> to <code>move-10.nc" in text


@pytest.mark.ci("draws a report once more")
def test_what_was_drawn_and_saved_before_makes_the_same_report(design):
    whole = judged_by(design)
    files = design_files(whole, ())
    with EarlyParts() as early:
        early.begin(design)
        assert design_files(whole, (), early=early) == files
    assert [*design_files(whole, (), early=early).items()] == [
        *files.items()
    ]  # once more, with what was tried
    assert len(early.runs()) == len(design.moves)


def test_what_is_proved_and_what_is_computed_are_told_apart(made, design, tolerated):
    (section,) = [part for part in made().sections if part.id == "tolerance"]
    text = text_of(section.html())
    assert (
        unnamed(text, "proved", "computed", *masses_text(tolerated.tolerance.errors.masses).split()[:1]) == []
    )
    assert tolerated.proved.high == design.setup.law.gains.ends[1]
    part = tolerated._replace(proved=ProvedRange(70.0, 81.0, 3))
    assert unnamed(stability_text(design.setup, part.proved), "9 rad/s", "stable") == []


def test_a_proof_names_its_hypotheses_and_what_is_left_out(design, tolerated):
    """Errors that hold the file's and that do not, stability alone of a part of the vibrations, and nothing."""
    low, high, setup = 70.0, design.setup.law.gains.ends[1], design.setup
    stable, some = (
        ProvedRange(low, high, 3),
        CheckedPairs(low, high, 0.2, 0.25, 0.15, 0.12, 0.0, 0.0, 0.0, False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9),
    )
    far = UnstableError(-0.4, (100.0,), 0.0, 1.0)
    needed, more, stiffer = (
        StatedErrors(Errors(Sector(*masses), Sector(*springs)), 200, ("friction",))
        for masses, springs in (((0.1, 0.1), (0.1, 0.1)), ((0.5, 0.1), (0.1, 0.1)), ((0.1, 0.1), (0.1, 0.3)))
    )
    for stated, checked, shown, kind, told in (
        (
            needed,
            some,
            stable,
            "proved",
            ("Proved", "200 sampled", "0.8 to 1.25", "40 %", "0.85 to 1.12"),
        ),
        (
            more,
            some,
            stable,
            "not proved",
            ("20 %", "50 %", "Not proved", "dry friction", "friction"),
        ),
        (
            stiffer,
            some,
            stable,
            "not proved",
            ("12 %", "30 %", "Not proved", "stiffer"),
        ),
        (needed, None, ProvedRange(low, 81.0, 3), "not proved", ("9 rad/s", "Not proved")),
        (needed, None, ProvedRange(low, low, 0), "not proved", ("nothing",)),
    ):
        proof = WorkspaceProof(setup, stated, tolerated.tolerance, None, checked, far, shown)
        made = workspace_proof_page(proof, ["flexhinf", "certify"], UNKNOWN)
        assert made.status[0].kind == kind
        for text in (text_of(made.html()), " ".join(workspace_proof_ending(proof, UNKNOWN).text.split())):
            assert unnamed(text, *told) == []
            assert ("K/J" in text) == (proof.checked is not None and bool(proof.unlike_motors))


@pytest.mark.ci("computes what another design tolerates")
def test_what_offsets_of_encoders_do_is_said(design, tolerated):
    """As they are taken in, at once, and what remains; nothing where the true state is fed back."""
    home = np.array(design.setup.workspace.home)
    (text,) = (block.html() for block in page._offsets(design, tolerated))
    numbers = [design.setup.encoder_offsets(home, time)[0, 0] for time in (OFFSET_TIME, None)]
    assert unnamed(text, "0.5 mrad", "motors", "0.5 s", *(float(f"{1e3 * x:.2g}") for x in numbers)) == []
    assert numbers[0] < numbers[1]
    of = dataclasses.replace(design.specification, estimator="none")
    changed = dataclasses.replace(design, setup=dataclasses.replace(design.setup, specification=of))
    assert page._offsets(changed, robustness_of(changed)) == []


def test_a_move_that_diverges_or_has_no_number_is_one(design, tolerated):
    move = design.moves[0]
    run = dataclasses.replace(move.response.run, diverged_at=0.2)
    gone = dataclasses.replace(move, response=dataclasses.replace(move.response, run=run))
    rows = summary.worst_motion([gone, move])
    assert np.isinf(rows[0]["remaining_error"])
    assert np.isfinite(rows[1]["remaining_error"])
    assert summary._largest([None, 2.0, 1.0]) == 2.0
    assert np.isnan(summary._largest([None, None]))


def screen_of(design):
    screen = Console(width=80, file=StringIO())
    tables, text = summary.workspace_ending(design)
    screen.print(*tables, text, sep="\n")
    return screen.file.getvalue()


def with_missed(design, count):
    """Limits of the joints beside the design's lines; the first `count` of all, and their twins, are missed."""
    where = "the worst of 20 moves, robots at corners of their tolerances"
    limited = [
        REQUIREMENTS[name].judge(None, 1.0, 0.1, where, unit="N·m", joint="panda_joint1", at=0.847)
        for name in ("path", "peak", "speed", "range", "limit_cycle")
    ]
    kinds = list(dict.fromkeys(line.what for line in (*design.requirements, *limited)))[:count]
    lines = (
        dataclasses.replace(line, found=2.0 * line.limit + 1.0 if line.at_most else 0.0)
        if line.what in kinds else line
        for line in (*design.requirements, *limited, *limited)
    )  # fmt: skip
    return dataclasses.replace(design, requirements=tuple(lines)), kinds


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("count", [0, 1, 3, 12])
def test_the_terminal_shows_every_kind_that_is_missed(design, count):
    """Within a screen of 25 lines of 80 columns with the path of the page, or a line or two for each kind."""
    of, kinds = with_missed(design, count)
    text = screen_of(of)
    assert len(text.splitlines()) < (25 if count < 4 else 40)
    assert max(map(len, text.splitlines())) <= 80
    assert unnamed(text, "joint ranges", "remaining error") == []
    assert (unnamed(text, "NOT MET") == []) == (count > 0)
    table = re.sub(r"\s+", " ", text.split("Not met")[0])
    assert table.count("NOT MET") >= len(kinds)
    assert unnamed(table, *(kind.split()[0] for kind in kinds)) == []
    cut = len(of.missed) - table.count("NOT MET")
    assert (unnamed(table, "the page") == []) == (cut > 0)


@pytest.mark.ci("margins at every pose")
def test_requirements_on_gain_and_delay_say_what_is_tolerated(design, tolerated):
    """Of factors up and down the one that is nearer to 1."""
    lines = summary.requirements_with_margins(design)
    (gain,), (delay,) = ([line.detail for line in lines if key in line.what] for key in ("gain", "delay"))
    assert unnamed(gain, float(f"{min(tolerated.louder, 1.0 / tolerated.softer):.3g}")) == []
    assert unnamed(delay, float(f"{min(tolerated.delay, LATEST):.3g}")) == []
    assert {line.detail for line in lines} == {gain, delay, ""}
    assert [line.found for line in lines] == [line.found for line in design.requirements]
    assert unnamed(text_of(page.requirement_table(lines).html()), gain, delay) == []
    unstable = design.loops[0]._replace(growth=1.01), *design.loops[1:]
    lines = summary.requirements_with_margins(dataclasses.replace(design, loops=unstable))
    assert lines == list(design.requirements)


def missing(design, what="poses unstable with a gain of 2 or 0.5"):
    lines = (
        dataclasses.replace(l, found=l.limit + 1.0) if l.what == what else l for l in design.requirements
    )
    return dataclasses.replace(design, requirements=tuple(lines))


@pytest.mark.ci("margins at every pose")
def test_what_was_tried_is_told_and_no_option_that_was_not(design, tolerated):
    """Without trials only numbers of the robot are named; with them the change that meets all, or how far each came."""
    assert summary.workspace_advice(design, None) == ""
    bad = missing(design)
    assert "--" not in summary.workspace_advice(bad, None)
    assert unnamed(summary.scope_text(design), "0.1 mrad", "assumed") == []
    full = REQUIREMENTS["at_limit"].judge(None, 0.2, 0.5, "a move")
    weak = dataclasses.replace(design, requirements=(*design.requirements, full))
    assert unnamed(summary.workspace_advice(weak, None), "effort_limit") == []
    assert unnamed(summary.workspace_advice(bad, None), "effort_limit") != []
    slow, fast = Change("slower moves", {"peak_speed": "0.5"}), Change("shorter", {"period": "0.5ms"})
    near, far = (dataclasses.replace(full, found=found) for found in (0.3, 0.9))
    trials = tuple(Trial(change, (line,), whole=True) for change, line in ((fast, far), (slow, near)))
    text = summary.workspace_advice(weak, Advice(trials, (Change("limit", {"ripple": "6"}),), 20.0))
    assert unnamed(text, "--peak-speed 0.5 misses least", "0.3 s", "0.9 s", "--set ripple=6", "20 s") == []
    given_up = (trials[0], dataclasses.replace(trials[1], whole=False))  # the moves may go further astray
    text = summary.workspace_advice(weak, Advice(given_up, (), 20.0))
    assert unnamed(text, "--period 0.5ms misses least", "0.3 s", "≤ 0.2 s", "given up") == []
    text = summary.workspace_advice(weak, Advice(given_up[1:] * 2, (), 20.0))
    assert unnamed(text, "misses least") != []
    kept = dataclasses.replace(full, found=0.1)
    found = Advice(
        (trials[0], Trial(slow, (kept,), whole=True)), (), 20.0, ("flexhinf", "design", "my arm.toml")
    )
    assert (
        unnamed(summary.workspace_advice(weak, found), "--peak-speed 0.5", "0.1 s", "required ≤ 0.2 s") == []
    )
    status = next(
        each for each in page.workspace_page(weak, (), advice=found).status if each.kind == "not met"
    )
    assert unnamed(status.text, "flexhinf design 'my arm.toml'") == []
    stated = dataclasses.replace(design.specification, measurement_noise=1e-10)
    finer = dataclasses.replace(design, setup=dataclasses.replace(design.setup, specification=stated))
    assert unnamed(summary.scope_text(finer), "0.01 mrad", "stated") == []


@pytest.mark.ci("margins at every pose once more")
def test_poses_that_the_motors_cannot_hold_are_counted(design):
    """More than the limit, by the equation of the heaviest robot at each pose; not only the 70 % of the goals."""
    heaviest = design.robot.corner({"mass": 1})
    held = [np.abs(design.robot.operating_point(pose, (), heaviest)[1]).max() for pose in design.poses]
    limit = float(np.sort(held)[3])
    weak = dataclasses.replace(design.specification, saturation=1.001 * limit)
    weak = dataclasses.replace(design, setup=dataclasses.replace(design.setup, specification=weak))
    assert robustness_of(weak).unheld == 2
    assert unnamed(summary.workspace_verdict(weak), " 2 of", "motors have") == []
    assert summary.workspace_advice(weak, None) == ""
    unheld = tuple(holding_requirement(weak.setup.needs(design.poses)))
    unheld = dataclasses.replace(weak, requirements=unheld)
    assert unnamed(summary.workspace_advice(unheld, None), "effort_limit") == []
    assert unnamed(summary.workspace_verdict(design), "motors have") != []
    assert unnamed(summary.workspace_advice(missing(design), None), "effort_limit") != []


def test_large_motions_at_the_start_are_told(design, tolerated, monkeypatch):
    """At power-on and by offsets, where they exceed 10 mrad."""
    run = design.power_on
    moved = 1e3 * np.abs(run.positions - run.goal).max()
    for most, said in ((2.0 * moved, False), (0.5 * moved, True)):
        monkeypatch.setattr(summary, "FAR", 1e-3 * most)
        assert (unnamed(screen_of(design), "power-on", float(f"{moved:.3g}"), "first second") == []) == said
    off = 1e3 * tolerated.offsets[1].max()
    monkeypatch.setattr(summary, "FAR", 0.5e-3 * off)
    assert unnamed(summary._starts(design), "0.5 mrad", float(f"{off:.3g}")) == []
    monkeypatch.setattr(summary, "FAR", 2e-3 * max(off, moved))
    assert summary._starts(design) == ""


def test_settings_say_who_states_the_workspace(made, design):
    def rows(stated, space):
        s = dataclasses.replace(design.specification, workspace=stated)
        setup = dataclasses.replace(design.setup, specification=s, workspace=space)
        of = dataclasses.replace(design, setup=setup)
        return summary.poses_of(of), [row.note for row in page._sample_rows(of)[:3]]

    space = design.setup.workspace
    _, (stated, *ends) = rows("limits", space)
    assert "default" in stated
    assert all("the robot's file" in text for text in ends)
    path = dataclasses.replace(space, path=np.array([[0.0], [0.1]]))
    where, told = rows({"time": (0.0, 1.0), "arm": (0.0, 0.1)}, path)
    assert all(text == "option --workspace" for text in told)
    assert "waypoints" in where
    ratio = fh.load_robot("scara")
    assert "1" not in {row.unit for row in page.robot_rows(ratio)}


def test_both_required_dampings_are_drawn(design):
    svg = page._pose_figure(design).svg
    assert unnamed(text_of(f"{svg}".replace("svg", "g")), "required", "at corners") == []


def test_the_numbers_of_the_page_are_in_its_file(design, tolerated):
    numbers = WorkspaceParts(design).facts()
    assert numbers["tolerated"]["louder"] == tolerated.louder
    assert numbers["tolerated"]["tolerance"]["lower"] == tolerated.tolerance.errors.masses.lower
    assert numbers["tolerated"]["proved"]["high"] == tolerated.proved.high
    assert np.array(numbers["tolerated"]["offsets"]) == pytest.approx(tolerated.offsets)
    assert len(numbers["goals"]) == 1 + len(design.moves)
    assert numbers["goals"][1] == pytest.approx(design.moves[0].response.goal)
    run = design.power_on
    assert numbers["power_on"] == pytest.approx(np.abs(run.positions - run.goal).max(axis=0))


def test_the_page_says_what_is_watched_at_run_time_and_what_is_not(made, design):
    """The box of joints and the reactions; of a box in space, that the tool is not watched."""
    text = text_of(made().html())
    assert unnamed(text, "run time", "status", "path_rate", "reset", "supervision", "brake", "swings") == []
    assert unnamed(text, "tool") != []
    limited = dataclasses.replace(design.specification, saturation=60.0)
    limited = dataclasses.replace(design, setup=dataclasses.replace(design.setup, specification=limited))
    for of, told in ((design, False), (limited, True)):
        watched = text_of(page._watched(of).html())
        assert (unnamed(watched, "limit", "0.2 s") == []) == told
    space = workspace_of(design.robot, "x=-0.2:0.2")
    changed = dataclasses.replace(design, setup=dataclasses.replace(design.setup, workspace=space))
    assert unnamed(text_of(page._watched(changed).html()), "not watch", "tool", "box in space") == []


def test_the_worst_ripple_is_that_of_poses_too(design, monkeypatch):
    """The table had 7.1 %, NOT MET, of a pose, and the summary 0 %, of the moves."""
    monkeypatch.setattr(summary, "columns_of", lambda of: {"ripple_percent": ("ripple", "%", 1.0)})
    loops = (*design.loops[:-1], design.loops[-1]._replace(ripple=7.1))
    number = summary.key_numbers(dataclasses.replace(design, loops=loops))[-1]
    assert (number.value, number.unit) == ("7.1", "%")


@pytest.mark.parametrize(("missed", "told"), [((), False), (("ripple",), False), ((UNHELD,), True)])
def test_limits_of_motors_are_to_check_where_they_are_too_weak(missed, told):
    lines = [Requirement(what, 0.0, 1.0, "", True, "the move", "") for what in missed]
    made = SimpleNamespace(missed=lines, robot=fh.paper_arm(), remaining_cause=None)
    assert (unnamed(summary._to_check(made), "motors", "effort_limit") == []) == told


@pytest.mark.parametrize(("what", "told"), [("remaining", False), ("damping", True)])
def test_tolerances_are_to_check_where_another_cause_explains_the_remaining_error_alone(what, told):
    """A damping of 0.005 at corners of ± 50 % was blamed on dry friction, which made the remaining error."""
    lines = [REQUIREMENTS[each].judge(None, 1e-3, 2e-3, "at a corner") for each in ("remaining", what)]
    cause = Cause("dry friction", 0, 2e-3, 1e-5, False)
    made = SimpleNamespace(missed=lines, robot=fh.paper_arm(), remaining_cause=cause)
    assert (unnamed(summary._to_check(made), "tolerances", "dry friction") == []) == told


@pytest.mark.ci("judges a changed design, and draws its page")
def test_the_damping_of_springs_is_named_and_what_is_unstable_without(design):
    """An assumption says of which joints; the verdict without damping counts, and is no requirement."""
    robot, loop = fh.load_robot("planar-two-link"), design.undamped[0][0]
    assert unnamed(summary.damping_text(robot), "states") == []
    elbow = dataclasses.replace(robot, parameters=[p for p in robot.parameters if p.name != "damping_elbow"])
    assert unnamed(summary.damping_text(elbow), "0.5 %", "elbow", "shoulder") == []
    loops = (design.undamped[0], (*design.undamped[1][1:], loop._replace(growth=1.01)))
    changed = dataclasses.replace(design, undamped=loops)
    assert unnamed(summary.undamped_text(changed), "1 of 6") == []
    assert (changed.missed, changed.met) == (design.missed, design.met)
    shown = page.workspace_page(design, ()).html()
    assert unnamed(shown, summary.damping_text(design.robot), summary.undamped_text(design)) == []


def test_a_vibration_beyond_half_the_sampling_frequency_is_named(design, tolerated, monkeypatch):
    frequency, joint = tolerated.fastest
    modes = [mode for pose in design.poses for mode in design.robot.modes(pose)]
    assert joint == design.robot.joint_names[0]
    assert frequency >= max(abs(mode.eigenvalue.imag) for mode in modes) / (2.0 * np.pi)
    assert summary.nyquist_text(design) == ""
    hidden = tolerated._replace(fastest=(623.0, "wrist"))
    monkeypatch.setattr(WorkspaceEvidence, "robustness", property(lambda of: hidden))
    assert unnamed(summary.nyquist_text(design), "wrist", "623 Hz", "500 Hz", "--period 0.64ms") == []
    assert summary.nyquist_text(design) in summary.workspace_verdict(design)


@pytest.mark.ci("makes the moves of a design again")
def test_the_cause_of_the_remaining_error_is_found_by_a_move_without_it(design, monkeypatch):
    """By the moves of the design made again; the ending names the cause and what lessens it."""
    cause = remaining_cause(design.setup, design.moves, design.sampled)
    moves = (*design.moves, *design.sampled)
    assert cause.error == max(remaining_errors(move).max() for move in moves)
    assert cause.without < cause.error
    remaining = REQUIREMENTS["remaining"].what
    assert summary.cause_text(dataclasses.replace(design, requirements=())) == ""
    bad = missing(design, remaining)
    for kind, tolerance, words in (
        ("stiffness", True, ("tolerance", "stiffness")), ("dry friction", False, ("dry friction",)),
        ("rest", False, ("5 s",)), ("", False, ("No tolerance",)),
    ):  # fmt: skip
        found = cause._replace(kind=kind, tolerance=tolerance, error=2e-3, without=1e-4)
        monkeypatch.setattr(WorkspaceEvidence, "remaining_cause", property(lambda of, found=found: found))
        assert unnamed(summary.cause_text(bad), "2 mrad", *words) == []
        said = {"stiffness": "stiffness: a measured one", "dry friction": "coulomb_friction"}
        assert unnamed(summary.workspace_advice(bad, None), *filter(None, [said.get(kind)])) == []
        swinging = REQUIREMENTS["limit_cycle"].judge(None, 1e-3, 2e-3, "after the worst move")
        swinging = dataclasses.replace(bad, requirements=(*bad.requirements, swinging))
        told = summary.cause_text(swinging) + summary.workspace_advice(swinging, None)
        assert "rest of" not in told  # no rest is long enough for a limit cycle
        assert "longer rest" not in told
    assert quantity_of("motor_inertia_elbow", ("shoulder", "elbow")) == "motor inertia"


@pytest.mark.ci("beside cheaper ones of this page")
def test_the_speed_that_was_tested_and_the_own_vibrations_are_said(design):
    text = summary.speed_text(design)
    fastest = max(
        15.0 / 8.0 * np.abs(m.response.goal - m.response.start).max() / m.plan.duration for m in design.moves
    )
    assert float(text.split()[0]) == pytest.approx(fastest, rel=0.02)
    assert unnamed(summary.scope_text(design), text, "--peak-speed", "speed_limit") == []
    low = np.sqrt(design.setup.law.gains.ends[0])
    assert unnamed(summary.vibration_text(design), f"{low:.0f} rad/s", "10 rad/s") == []


def test_a_quantity_has_one_unit_on_all_pages_of_a_design(design):
    s = dataclasses.replace(design.specification, angle_unit="deg")
    line = REQUIREMENTS["remaining"].judge(None, 1e-3, 4.41e-3, "a", unit="rad")
    setup = dataclasses.replace(design.setup, specification=s)
    other = dataclasses.replace(design, setup=setup, requirements=(line,))
    assert unnamed(summary.missed_text(other), "0.253°", "0.0573°") == []
    assert {summary.columns_of(other)[key][1] for key in ("remaining_error", "path_distance")} == {"°"}


@pytest.mark.ci("beside cheaper ones of this page")
def test_an_unstable_fast_vibration_is_not_called_hardly_damped(design):
    """It is a requirement that is not met, see `pose_requirements`."""
    for damping, hardly in ((-0.00015, False), (0.001, True), (0.3, False)):
        loops = tuple(loop._replace(fast_damping=damping) for loop in (*design.loops, *design.corner_loops))
        n = len(design.loops)
        text = summary.scope_text(dataclasses.replace(design, loops=loops[:n], corner_loops=loops[n:]))
        assert ("hardly" in text) == hardly


@pytest.mark.ci("beside cheaper ones of this page")
def test_the_table_has_the_worst_of_each_kind_in_small_units(design):
    line = REQUIREMENTS["remaining"]
    lines = [line.judge(None, 1e-3, found, where, unit="rad") for found, where in ((2e-3, "a"), (7e-3, "b"))]
    text = screen_of(dataclasses.replace(design, requirements=tuple(lines)))
    table = text.split("Not met")[0]
    assert unnamed(table, "7 mrad", "1 mrad") == []
    assert unnamed(table, "0.001 rad") != []
    assert (
        unnamed(summary.missed_text(dataclasses.replace(design, requirements=tuple(lines))), "7 mrad") == []
    )
