"""``make bench-robots``: which public URDF files load, at once and after ``flexhinf init``, and whether they are right.

``python -m benchmarks.robots --source "owner/name@commit=FOLDER"`` looks at every URDF below the folder; the package
example-robot-data is looked at where it is installed. What is found goes to benchmarks/robots.json, where rows of other
sources stay, and ``--table`` prints the table of docs/hardware.md from there. Of each file its SHA-256 is kept, and no
text.

A file counts as loaded after ``flexhinf init`` if the robot file that it writes loads, and every joint with a motor
moves in it: with an effort or a transmission, and neither coupled to another joint nor without mass behind it. Mass
matrices are compared with Pinocchio's, where it is installed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot import load_robot
from flexhinf.robot.dynamics import KINDS, Tree, bodies_of, mass_matrix, matrix_of, six_of
from flexhinf.robot.init_file import description_of, robot_file_text
from flexhinf.robot.parameters import INERTIA
from flexhinf.robot.parts import file_warnings
from flexhinf.robot.rigid_arm import RigidArm, nearest_inertia
from flexhinf.robot.urdf import WORLD, read_urdf
from flexhinf.validation import optional_package, read_xml

#: Where the rows are kept, the package of robots, and its folder of them.
KEPT = Path(__file__).with_suffix(".json")
PACKAGE, ROBOTS = "example-robot-data", "cmeel.prefix/share/example-robot-data/robots"

#: Poses at which mass matrices are compared, and their seed.
POSES, SEED = 3, 0


def main(arguments: list[str] | None = None) -> int:
    """Look at all files of all sources, or print the table of what was found."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots", description=__doc__)
    parser.add_argument("--source", action="append", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="FILE")
    parser.add_argument("--table", action="store_true", help="print the table of the rows that are kept")
    given = parser.parse_args(arguments)
    if given.table:
        print(table(json.loads(given.kept.read_text(encoding="utf-8"))))
        return 0
    sources = {name: Path(folder) for name, _, folder in (one.rpartition("=") for one in given.source)}
    with suppress(PackageNotFoundError):
        package = distribution(PACKAGE)
        sources[f"{PACKAGE} {package.version}"] = Path(str(package.locate_file(ROBOTS)))
    if not sources:
        print(f"No robots: install {PACKAGE}, or state --source NAME=FOLDER")
        return 1
    kept = json.loads(given.kept.read_text(encoding="utf-8")) if given.kept.exists() else []
    rows = [row for row in kept if row["source"] not in sources]
    for name, folder in sources.items():
        for file in sorted(folder.rglob("*.urdf")):
            rows.append({"source": name, "file": file.relative_to(folder).as_posix(), **looked_at(file)})
            print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
    given.kept.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n", encoding="utf-8")
    print(table(rows))
    return 0


def looked_at(file: Path) -> dict[str, Any]:
    """What becomes of a file: whether it has masses behind joints, loads, and what stands in the way."""
    row: dict[str, Any] = {"sha256": hashlib.sha256(file.read_bytes()).hexdigest()[:16]}
    try:
        root = read_xml(file)
    except InvalidInput as error:
        return {**row, "robot": False, "at_once": False, "after_init": False, "refused": error.what[:200]}
    row["robot"] = _is_robot(root)
    with file_warnings():
        try:
            read_urdf(root)
            row["at_once"] = True
        except InvalidInput:
            row["at_once"] = False
        try:
            found = description_of(file)
            arm = found.arm()
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "arm.toml"
                path.write_text(robot_file_text(found, arm, path), encoding="utf-8")
                load_robot(path)
        except InvalidInput as error:
            return {**row, "after_init": False, "refused": error.what[:200]}
    still = sorted(driven_joints(root) - {joint.name for joint in arm.joints})
    row |= {"joints": len(arm.joints), "after_init": not still}
    row |= {"still": still} if still else {}
    row |= {"changes": [change[:200] for change in found.changes]} if found.changes else {}
    error = difference(root, arm)
    return row if error is None else {**row, "mass_matrix": float(f"{error:.1e}")}


def _is_robot(root: Element) -> bool:
    """Whether some joint can move, and some link has a mass: others are drawings, tools or scenery."""
    masses = [mass.get("value") or "0" for link in root.findall("link") for mass in link.iter("mass")]
    heavy = any(_number(mass) > 0.0 for mass in masses)
    return heavy and any(joint.get("type") in KINDS for joint in root.findall("joint"))


def _number(text: str | None) -> float:
    try:
        return float(text or "0")
    except ValueError:
        return 0.0


def driven_joints(root: Element) -> set[str]:
    """Joints with an effort or a transmission that follow no other joint, and that none follows, as a gripper's."""
    joints = {str(joint.get("name")): joint for joint in root.findall("joint") if joint.get("type") in KINDS}
    coupled = {name for name, joint in joints.items() if joint.find("mimic") is not None}
    coupled |= {str(mimic.get("joint")) for joint in joints.values() for mimic in joint.findall("mimic")}
    acted = {str(joint.get("name")) for one in root.iter("transmission") for joint in one.iter("joint")}
    strong = {
        name
        for name, joint in joints.items()
        if any(_number(limit.get("effort")) > 0.0 for limit in joint.findall("limit"))
    }
    return (strong | (acted & joints.keys())) - coupled


def difference(root: Element, arm: RigidArm) -> float | None:
    """Largest difference to Pinocchio's mass matrix, relative to its largest element; None where it is not installed,
    or cannot read it."""
    pin: Any = optional_package("pinocchio")
    if pin is None:
        return None
    try:
        model = pin.buildModelFromXML(_with_bodies(root, arm))
    except (ValueError, RuntimeError):
        return None
    names, tree = [joint.name for joint in arm.joints], Tree(tuple(arm.joints))
    place = pin.neutral(model)
    for name, value in arm.locked.items():
        if model.existJointName(name):
            joint = model.joints[model.getJointId(name)]
            if joint.nq <= 2 and value is not None:
                turn = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
                place[joint.idx_q : joint.idx_q + joint.nq] = turn
    held = [model.getJointId(name) for name in list(model.names)[1:] if name not in names]
    try:
        model = pin.buildReducedModel(model, held, place) if held else model
    except ValueError:  # of a link and a joint with one name
        return None
    data, rng, worst = model.createData(), np.random.default_rng(SEED), 0.0
    order = [model.joints[model.getJointId(name)] for name in names]
    bodies = bodies_of(tree, *zip(*((link.mass, link.centre_of_mass, link.inertia) for link in arm.links)))
    for _ in range(POSES):
        q, position = rng.uniform(-1.0, 1.0, len(names)), np.zeros(model.nq)
        for value, joint in zip(q.tolist(), order):
            turn = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
            position[joint.idx_q : joint.idx_q + joint.nq] = turn
        half = np.triu(pin.crba(model, data, position))
        places = [joint.idx_v for joint in order]
        theirs = (half + np.triu(half, 1).T)[np.ix_(places, places)]
        ours = np.array(mass_matrix(tree, bodies, q), dtype=float)
        worst = max(worst, float(np.abs(ours - theirs).max() / np.abs(theirs).max()))
    return worst


def _with_bodies(root: Element, arm: RigidArm) -> str:
    """The text of a URDF in which inertias that no body has are the nearest that one has, or those that are stated."""
    whole = ElementTree.fromstring(ElementTree.tostring(root))
    links = {link.get("name"): link for link in whole.findall("link")}
    if WORLD not in links and any(parent.get("link") == WORLD for parent in whole.iter("parent")):
        whole.insert(0, Element("link", {"name": WORLD}))
    for name, link in links.items():
        inertial = link.find("inertial")
        if inertial is not None and inertial.find("inertia") is None and name in arm.inertias:
            inertial.append(Element("inertia"))
        for six in link.findall("inertial/inertia"):
            numbers = [_number(six.get(f"i{axes}")) for axes in INERTIA]
            stated = arm.inertias.get(str(name))
            moments = (
                six_of(nearest_inertia(matrix_of(numbers)))
                if stated is None or isinstance(stated, str)
                else stated
            )
            if not np.allclose(moments, numbers, rtol=1e-15, atol=0.0):
                six.attrib.update({f"i{axes}": repr(float(x)) for axes, x in zip(INERTIA, moments)})
    return ElementTree.tostring(whole, encoding="unicode")


# Table --------------------------------------------------------------------------------------------
def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many files of each source load, as a table of a page."""
    head = (
        "| source | files | robots | load at once | load after `flexhinf init` | "
        "largest difference to Pinocchio |\n|---|---:|---:|---:|---:|---:|"
    )
    names = dict.fromkeys(row["source"] for row in rows)
    lines = [_line(name, [row for row in rows if row["source"] == name]) for name in names]
    return "\n".join([head, *lines, *_line_of_all(rows, len(names))])


def _line_of_all(rows: Sequence[Mapping[str, Any]], sources: int) -> Iterator[str]:
    if sources > 1:
        different = {row["sha256"]: row for row in rows}
        yield _line("all, each file once", list(different.values()))


def _line(name: str, rows: Sequence[Mapping[str, Any]]) -> str:
    robots = [row for row in rows if row["robot"]]
    counts = [sum(row[key] for row in robots) for key in ("at_once", "after_init")]
    shares = [f"{count} ({100.0 * count / max(len(robots), 1):.0f} %)" for count in counts]
    errors = [row["mass_matrix"] for row in rows if "mass_matrix" in row]
    worst = f"{max(errors):.0e} in {len(errors)}" if errors else "–"
    return f"| {name} | {len(rows)} | {len(robots)} | {' | '.join(shares)} | {worst} |"


if __name__ == "__main__":
    sys.exit(main())
