"""What exported C says of itself: its design, its parameters by name, and what each number of the law multiplies."""

from __future__ import annotations

import html
import json
import math
import re
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from markdown_it import MarkdownIt
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.export import controller_files
from flexhinf.export.controller_c import code_of
from flexhinf.export.feedforward import export_feedforward
from flexhinf.export.fmu import export_plant_fmu
from flexhinf.export.names import law_terms, named_parameters, parameter_units
from flexhinf.export.rendering import names_in

# Recordings and stacks of exports whose text is read: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(scope="module")
def arm() -> fh.Robot:
    return fh.load_robot("paper")


@pytest.fixture(scope="module")
def cubic(arm: fh.Robot) -> fh.Controller:
    return arm_controller(degree=4, q=[0, 0, 1e-4, 1e-4], r=1e-7)


def law_numbers(source: str) -> list[tuple[float, str]]:
    """Coefficients of the law with what stands behind them."""
    block = source.split("/* law: ")[1].split("/* operating_point: ")[0]
    return [
        (float(number), term) for number, term in re.findall(r"^\s*(\S+), /\* (.*) \*/$", block, re.MULTILINE)
    ]


def test_no_function_of_a_model_takes_a_name_of_the_source() -> None:
    template = (files("flexhinf.export") / "templates/controller.c").read_text(encoding="utf-8")
    text = template.replace("@{name}", "arm")
    names = set(re.findall(r"^(?:[a-z][^=;({]*?\b|\} )(arm_\w+)[(\[]", text, re.MULTILINE))
    assert len(names) > 20
    assert names | {"real", "FMA", "SAFE"} <= names_in("controller.c", "arm")
    assert "arm_exact" in names_in("controller.c", "arm"), "a template that it includes"


@pytest.mark.ci("writes the code of an unscented filter twice")
@pytest.mark.oracle
@pytest.mark.parametrize("pieces", [False, True])
def test_the_terms_in_the_comments_are_the_law(cubic: fh.Controller, pieces: bool) -> None:
    controller = cubic.in_pieces() if pieces else cubic
    rows = law_numbers(code_of(controller, "arm", "double").source)
    assert len(rows) == len(law_terms(controller)) > 20
    law = controller.law
    rng = np.random.default_rng(7)
    for x in rng.uniform(-0.5, 0.5, (5, len(law.state_names))):
        values = dict(zip(law.state_names, x, strict=True))
        total = 0.0
        for coefficient, term in rows:
            name, monomial = term.split(": ")
            if name == "unused":
                assert coefficient == 0.0
                continue
            factors = [factor.partition("^") for factor in monomial.split()]
            total += coefficient * np.prod([values[base] ** int(power or 1) for base, _, power in factors])
        np.testing.assert_allclose(total, law.evaluate_law(x, law.law_data)[0], rtol=1e-12)


@pytest.mark.ci("exports a controller of its own")
def test_parameters_stand_at_their_constants(cubic: fh.Controller, arm: fh.Robot) -> None:
    header = code_of(cubic, "arm", "double", arm).header
    units = {parameter.name: parameter.unit for parameter in arm.parameters}
    for name, place, unit in named_parameters(cubic, units):
        at = int(re.search(rf"ARM_P_{name.upper()} = (\d+),? /\* ", header).group(1))  # type: ignore[union-attr]
        assert cubic.data_vector[at] == arm.nominal[name]
        assert at == cubic.data.places["parameters"].start + place
        assert unit == units[name]
    assert re.search(r"ARM_P_STIFFNESS = \d+, /\* N m/rad \*/", header)


def test_parameters_of_several_joints_have_units_and_say_whose_they_are() -> None:
    """Those of the robot file, of which some are one number of several in the model."""
    robot = fh.load_robot("planar-two-link")
    made = arm_controller(robot, fh.ExtendedKalmanFilter, r=1e-6, p0=1e-8)
    stated = {parameter.name: parameter.unit for parameter in robot.parameters}
    rows = {name: (place, unit) for name, place, unit in named_parameters(made, parameter_units(made, robot))}
    assert all(unit for _, unit in rows.values())
    for name in ("mass", "stiffness", "friction", "torque_constant"):
        for k, joint in enumerate(robot.joint_names):
            place, unit = rows[f"{name}_{k}"]
            assert unit == f"{stated[f'{name}_{joint}']} of {joint}"
            if name in ("mass", "stiffness"):  # the others are of the motor, as seen from the joint
                at = made.data.places["parameters"].start + place
                assert made.data_vector[at] == robot.nominal[f"{name}_{joint}"]
    unit, _, axes = rows["inertia_6"][1].partition(", ")
    assert unit == f"{stated['inertia_xx_elbow']} of elbow"
    assert axes == "xx"


@pytest.mark.ci("writes the code of four designs")
def test_header_and_source_have_one_digest_and_another_design_has_another(
    cubic: fh.Controller, arm: fh.Robot
) -> None:
    def digests(controller: fh.Controller, **origin: str) -> set[str]:
        files = code_of(controller, "arm", "double", arm, origin).files
        return {
            re.search(rf'{mark} "?([0-9a-f]{{64}})', files[name].replace('= "', '"')).group(1)  # type: ignore[union-attr]
            for name, mark in (("arm.h", "ARM_DIGEST"), ("arm.c", r"arm_digest\[\]"))
        }

    first = digests(cubic)
    assert len(first) == 1
    assert first == digests(cubic)
    assert first != digests(fh.Controller(cubic.law, cubic.estimator, 1e-3, 47.0))
    assert first != digests(cubic, drawing="A-1234")


@pytest.mark.ci("an export with its test vector")
def test_the_origin_stands_in_header_source_and_readme_and_ends_no_comment(
    cubic: fh.Controller, arm: fh.Robot
) -> None:
    files = controller_files(cubic, "arm", robot=arm, origin={"drawing": "A-12 */ #error"})
    for name, mark, drawing in (
        ("arm.h", " * {}: {}\n", "A-12 * / #error"),
        ("arm.c", " * {}: {}\n", "A-12 * / #error"),
        ("README.md", "| {} | {} |\n", r"A-12 \*/ #error"),
    ):
        for line in (("robot", arm.name), ("degree of V", "4"), ("drawing", drawing)):
            assert mark.format(*line) in files[name]


#: A name of a robot that closes the comment that it stands in, where marks in it are replaced.
CLOSES = '*@{""}/ #error "run" /{% if c %}{% endif %}@{""}*'

MARKED = """name = {name}
[penalty]
weights = {{ link_position = 1.0, link_position_integral = 2.0 }}
[[joint]]
name = "@{{name}}&@{{signals}}"
[joint.link]
axis_inertia = 0.006
[joint.spring]
stiffness = 1.6
[joint.motor]
motor_inertia = 0.002
friction = 0.01
"""


def exported(folder: Path, sign: str) -> dict[str, str]:
    """Every text of exports of a robot whose names have marks; `sign` stands for @."""
    robot = fh.load_robot(written(folder, sign))
    law = fh.linear_law(robot.problem(), gamma=math.inf)
    state = f"@DIGEST@ @{{digest}} {CLOSES}".replace("@", sign)
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], u[0] + d[0] - p.stiffness * x[0]]), lambda x, u, p: x[:1],
        states=(state, f"{sign}{{name}}"), inputs=(f"{sign}{{units}}",), disturbances=("d",),
        parameters={"stiffness": 2.0}, units={state: f"rad {sign}{{variables}}"},
    )  # fmt: skip
    own = fh.linear_law(plant.with_objective([1.0, 1.0]), gamma=math.inf)
    ekf = fh.ExtendedKalmanFilter(plant, 1e-3, 1e-6, 1e-6, np.zeros(2), 1e-4)
    controller = fh.Controller(own, ekf, 1e-3, 5.0)
    texts = controller_files(controller, "arm", origin={"robot": robot.name})
    one = fh.ExtendedKalmanFilter(robot.plant(), 1e-3, 1e-7, 1e-6, np.zeros(4), 1e-4)
    texts |= {
        f"robot/{file}": text
        for file, text in controller_files(fh.Controller(law, one, 1e-3, 5.0), "arm", robot=robot).items()
    }
    library = fh.load_compiled(fh.compile_controller(controller, folder / "arm.so"))
    texts["library"] = f"{library.states} {library.inputs} {library.units}"
    for fmi in ("2.0", "3.0"):
        with zipfile.ZipFile(fh.export_fmu(controller, folder / "arm.fmu", "arm", fmi)) as archive:
            names = [name for name in archive.namelist() if not name.startswith("binaries")]
            texts |= {f"{fmi}/{name}": archive.read(name).decode() for name in names}
    return texts


def written(folder: Path, sign: str) -> Path:
    path = folder / "arm.toml"
    path.write_text(MARKED.format(name=json.dumps(CLOSES)).replace("@", sign), encoding="utf-8")
    return path


@pytest.mark.ci("exports two controllers, libraries and FMUs, with marks and without")
def test_what_looks_like_a_mark_in_a_name_stands_there_as_it_is(tmp_path: Path) -> None:
    """What users wrote is a value of a template, never a part of it: a name runs no code."""
    one, other = (exported(tmp_path, sign) for sign in "@#")
    assert one.keys() == other.keys()
    digest = re.compile(r"[0-9a-f]{64}|[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}")
    for file, text in one.items():
        assert digest.sub("", text).replace("@", "#") == digest.sub("", other[file]).replace("@", "#"), file
    assert "@DIGEST@ @{digest}" in one["2.0/modelDescription.xml"]
    assert sum('*@{""}' in text for text in one.values()) > 2


#: Names of a robot and of its joints that end what they stand in: comments, strings, attributes, scripts.
# A tag of its own that a page has where the names were not filtered.
MARKUP = re.compile(r"<(a|b|em|img|script)\b")
ENDING = "*/ ?? \\ \" ' <b> & </script> $(X) `id` | é"
ENDING_JOINTS = ('a"b\\</script>{{', "x*/??/&'$(X)%d")


@pytest.mark.ci("exports a controller, its FMUs and a feedforward, and compiles them")
def test_names_that_end_comments_and_strings_end_none(tmp_path: Path, compiler: str) -> None:
    """Every file of C is read without a warning, and every other one by a reader of its kind."""
    fh.load_robot("planar-two-link").save(tmp_path / "arm.toml")
    text = (tmp_path / "arm.toml").read_text(encoding="utf-8")
    for name, ending in zip(("planar-two-link", "shoulder", "elbow"), (ENDING, *ENDING_JOINTS), strict=True):
        text = text.replace(f'name = "{name}"', f"name = {json.dumps(ending)}")
    (tmp_path / "arm.toml").write_text(text, encoding="utf-8")
    robot = fh.load_robot(tmp_path / "arm.toml")
    assert (robot.name, *robot.joint_names) == (ENDING, *ENDING_JOINTS)
    made = arm_controller(robot, fh.ExtendedKalmanFilter, r=1e-6, p0=1e-8)
    exported = fh.export_c(made, tmp_path / "c", "arm", robot=robot, origin={ENDING: ENDING})
    forward = export_feedforward(fh.Feedforward(robot, 1e-3, 0.02), tmp_path / "forward", "forward")
    for folder in (exported, forward):
        files = sorted(path.name for path in folder.glob("*.c"))
        flags = ["-std=c99", "-Wall", "-Wtrigraphs", "-Werror", "-fsyntax-only"]
        subprocess.run([compiler, *flags, *files], cwd=folder, check=True)
    texts = [path.read_text(encoding="utf-8") for path in exported.rglob("*.xml")]
    for fmi in ("2.0", "3.0"):
        for archive in (
            fh.export_fmu(made, tmp_path / "controller.fmu", "arm", fmi),
            export_plant_fmu(robot.plant(), tmp_path / "plant.fmu", "arm", fmi=fmi),
        ):
            with zipfile.ZipFile(archive) as packed:
                texts.append(packed.read("modelDescription.xml").decode())
    named = {element.get("name") for text in texts for element in ET.fromstring(text).iter()}
    assert {f"measured.link_position_{joint}" for joint in ENDING_JOINTS} <= named
    for page in (exported / "README.md", exported / "safety.md", forward / "README.md"):
        reader = MarkdownIt("commonmark", {"html": True}).enable("table")
        shown = reader.render(page.read_text(encoding="utf-8"))
        assert ENDING in html.unescape(shown), page
        assert not MARKUP.search(shown), page
    yaml = pytest.importorskip("yaml")
    settings = next(exported.rglob("*.yaml")).read_text(encoding="utf-8")
    assert yaml.safe_load(settings)["arm_controller"]["ros__parameters"]["period"] == 1e-3
