"""Fields of a specification: each is read by law, estimator and task, or refused by its name with advice that works."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests import workspaces
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.designs import Specification, WorkspaceEvidence, read_request
from flexhinf.designs.design_file import request_document
from flexhinf.designs.fields import OF_POSE, readers, resolved
from flexhinf.designs.laws import LAWS
from flexhinf.designs.specification import FIELDS, SpecificationError

Named = Callable[[str], Any]
Stated = dict[str, Any]

#: What is stated beside each field: law and task.
DESIGNS: dict[str, Stated] = {
    "modal over a workspace": {},
    "modal at a pose": {"law": "modal", "pose": "home"},
    "nl-hinf at a pose": {"pose": "home"},
    "lqg at a pose": {"law": "lqg", "pose": "home"},
    "pd over a workspace": {"law": "pd"},
}

#: Values of fields whose example is their default, which states nothing.
OTHERS: Stated = {
    "gamma_ratio": 2.0, "checked_gamma_ratio": 2.0, "seed": 3, "period": "2ms", "measurement_noise": "0.2mrad",
}  # fmt: skip


#: Few poses and goals, and one bandwidth.
FEW: Stated = {
    "POSES": 2, "GOALS": 1, "CHOSEN_POSES": 2, "MODAL_POSES": 20, "TUNING_POSES": (2, 1), "TUNING_MOVES": 1,
    "BANDWIDTHS": (10.0,),
}  # fmt: skip


def stated_value(name: str) -> Any:
    """The example of a field, or what switches it."""
    field = FIELDS[name]
    return OTHERS.get(name, field.about.example or not field.default)


def followed(advice: str, stated: Stated) -> Iterator[Stated]:
    """What is stated after each of the ways that an advice names: fields left out, and those set to a value."""
    for way in re.split(r"[,;] or ", advice):
        left_out = re.findall(r"leave out `(\w+)`", way)
        values = dict(re.findall(r"(\w+)=('[^']*'|\([^()]*\)|[^\s,;]+)", way))
        assert left_out or values, advice
        kept = {name: value for name, value in stated.items() if name not in left_out}
        yield kept | {name: ast.literal_eval(value) for name, value in values.items()}


def refusal(robot: fh.Robot, stated: Stated) -> SpecificationError | None:
    """What refuses a specification, where something does."""
    try:
        resolved(robot, Specification(**stated))
    except SpecificationError as error:
        return error
    return None


@pytest.fixture
def beside_waypoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example of a move is a file."""
    (tmp_path / "waypoints.csv").write_text("time,a,b\n0,0,0\n1,0.5,0.4\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("beside_waypoints")
@pytest.mark.parametrize("arm", ["planar-two-link", "paper"])
@pytest.mark.parametrize("own", DESIGNS.values(), ids=[*DESIGNS])
def test_a_field_is_read_or_refused_with_advice_that_works(robot_of: Named, arm: str, own: Stated) -> None:
    """And no field but law, pose and workspace changes law and task."""
    robot, unread = robot_of(arm), set[str]()
    plain = resolved(robot, Specification(**own))
    for name in FIELDS:
        stated = {**own, name: stated_value(name)}
        if error := refusal(robot, stated):
            unread.add(name)
            assert error.field == name
            assert unnamed(f"{error.what} {error.found}", name) == []
            for other in followed(error.advice, stated):
                assert refusal(robot, other) is None
            continue
        s = resolved(robot, Specification(**stated))
        assert getattr(s, name) == getattr(Specification(**{name: stated_value(name)}), name)
        assert getattr(s, name) != FIELDS[name].default
        if name not in ("law", "pose", "workspace"):
            assert (s.law, s.pose, s.workspace) == (plain.law, plain.pose, plain.workspace)
    kind, at_pose = LAWS[str(plain.law)], "pose" in own
    assert unread >= {*readers()} - {*kind.fields} - ({*OF_POSE} if at_pose else set())
    assert unread - {*readers()} == ({"workspace"} if at_pose else set())


@pytest.mark.parametrize(
    ("stated", "field"),
    [
        ({"law": "nl-hinf"}, "law"),
        ({"law": "hinf", "pose": "home"}, "law"),
        ({"estimator": "observer"}, "estimator"),
        ({"estimator": "modal", "pose": "home"}, "estimator"),
        ({"estimator": "modal", "measured": ("motor_position", "link_position_elbow")}, "estimator"),
        ({"workspace": "limits", "pose": (0.1, 0.2)}, "workspace"),
        ({"law": "lqg", "preset": "robust"}, "preset"),
        ({"preset": "robust"}, "preset"),
    ],
)
def test_law_estimator_and_task_that_do_not_fit_are_refused(
    robot_of: Named, stated: Stated, field: str
) -> None:
    robot = robot_of("planar-two-link")
    error = refusal(robot, stated)
    assert error is not None
    assert error.field == field
    for other in followed(error.advice, stated):
        assert refusal(robot, other) is None


def test_home_is_the_robot_s_own_pose_wherever_it_is_stated(robot_of: Named, tmp_path: Path) -> None:
    """In Python, in a copy with another seed, in its text, and in a design file."""
    robot, s = robot_of("planar-two-link"), Specification(pose="home", start="home")  # type: ignore[arg-type]
    home = tuple(robot.home)
    again = eval(repr(s), {"Specification": Specification})
    for each in (s, again, replace(replace(s, seed=3), seed=0)):
        made = resolved(robot, each)
        assert (made.pose, made.start) == (home, home)
    text = request_document(s, "planar-two-link").as_string()
    (tmp_path / "design.toml").write_text(text, encoding="utf-8")
    asked = read_request(tmp_path / "design.toml").specification
    assert (asked.pose, asked.start, text.count('"home"')) == (home, home, 2)


def test_without_a_law_and_an_estimator_task_and_sensors_choose(robot_of: Named) -> None:
    robot = robot_of("planar-two-link")
    both, unlike = ("link_position", "motor_position"), ("motor_position", "link_position_shoulder")
    for stated, law, estimator in (
        ({"measured": both}, "modal", "modal"),
        ({"measured": unlike}, "modal", "ekf"),
        ({"measured": both, "pose": "home"}, "nl-hinf", "ukf"),
        ({"measured": both, "pose": "home", "law": "modal"}, "modal", "modal"),
        ({"measured": unlike, "law": "pd"}, "pd", "ekf"),
    ):
        s = resolved(robot, Specification(**stated))
        assert (s.law, s.estimator) == (law, estimator)
        assert resolved(robot, s) == s


# Over a workspace ------------------------------------------------------------------------------------------
@pytest.mark.ci("designs for a workspace of one joint")
@pytest.mark.parametrize(
    ("law", "estimator", "kind"),
    [
        ("modal", "auto", fh.ModalFilter),
        ("modal", "ekf", fh.ExtendedKalmanFilter),
        ("modal", "ukf", fh.UnscentedKalmanFilter),
        ("lqg", "ukf", fh.UnscentedKalmanFilter),
    ],
)
def test_the_stated_estimator_runs_over_a_workspace(
    robot_of: Named, monkeypatch: pytest.MonkeyPatch, law: str, estimator: str, kind: type
) -> None:
    """It is stable at poses that the search did not use; one of a package's own is in tests/test_extensions.py."""
    workspaces.few(monkeypatch, **FEW)
    s = Specification(law=law, estimator=estimator, workspace=((0.0, 0.1),), draws=0)  # type: ignore[arg-type]
    design = fh.design(robot_of("paper"), s)
    evidence = design.evidence
    assert isinstance(evidence, WorkspaceEvidence)
    assert type(evidence.setup.moving.estimator) is kind
    assert design.specification.law == law
    assert max(loop.growth for loop in evidence.loops) < 1.0
    assert not any(move.response.run.diverged_at for move in evidence.moves)
