"""All files of an exported controller, and where they are written."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export import controller_c, follow
from flexhinf.export.c_library import mathematics
from flexhinf.export.controller_c import NOTHING, ControllerCode, code_of
from flexhinf.export.file_list import File, rendered
from flexhinf.export.follow import follow_values
from flexhinf.export.follow_vector import follow_test_values
from flexhinf.export.names import PARTS
from flexhinf.export.provocation import provoked
from flexhinf.export.recording import record
from flexhinf.export.refusals import check_limits
from flexhinf.export.rehearsal import contract_values, reaches_far
from flexhinf.export.rendering import of_file
from flexhinf.export.ros2 import package_name, ros2_values
from flexhinf.export.safety import safety_values, stops
from flexhinf.export.self_test import EVERY, VECTOR, Tested, tested
from flexhinf.export.stack import stack_text
from flexhinf.files import write_folder
from flexhinf.loop import Controller
from flexhinf.loop.controller.protection import LOOK
from flexhinf.plant.joints import joint_places
from flexhinf.validation import checked_path

if TYPE_CHECKING:
    from flexhinf.robot import Robot


@dataclass(frozen=True)
class Export(Tested):
    """A controller with what its files are made of. `design`: Files of the design, which go with it."""

    design: Mapping[str, str]

    @cached_property
    def home(self) -> tuple[str, np.ndarray]:
        """What a command of the templates begins with, in words and as numbers."""
        return _home(self.code)

    @cached_property
    def follow(self) -> Mapping[str, object]:
        """What the files that follow trajectories need; nothing for a law of one pose."""
        return follow_values(self.code)

    @cached_property
    def ros2(self) -> Mapping[str, object]:
        """What the package for ROS 2 needs."""
        return ros2_values(self.code, self.home[1])


def _drives(export: Export) -> Mapping[str, object]:
    """What main.c and the templates know of drives."""
    text, home = export.home
    return {"home": {"text": text, "numbers": home}, "look": f"{LOOK:g}", **_begin_here(export.code)}


def _ros2(export: Export) -> Mapping[str, object]:
    return export.ros2


def _follows(export: Export) -> bool:
    return bool(export.follow)


#: Where the package for ROS 2 and the library for Arduino have the sources too.
COPIES = ("ros2/src", "arduino/src")

#: All files of an exported controller.
FILES: tuple[File[Export], ...] = (
    *(file.within(lambda export: export.code, COPIES) for file in controller_c.SOURCES),
    *(file.within(lambda export: export.follow, COPIES) for file in follow.FILES),
    VECTOR,
    File("@{name}_contract.c", "contract.c", lambda export: _contract(export)),
    File("@{name}_follow_test.c", "follow_test.c", lambda export: follow_test_values(export.code), _follows),
    File("README.md", "README.md", lambda export: _readme(export)),
    File("main.c", "main.c", _drives),
    File("Makefile", "Makefile"),
    File("mutants.py", "mutants.jinja"),
    File("safety.md", "safety.md", lambda export: _safety(export)),
    File("CMakeLists.txt", "CMakeLists.txt"),
    File("library.json", "library.json"),
    File("arduino/library.properties", "library.properties"),
    File("misra.txt", "misra.txt"),
    File("cortex_m4/board.c", "cortex_m4/board.c"),
    File("cortex_m4/board.ld", "cortex_m4/board.ld"),
    File("cortex_m4/periodic.c", "cortex_m4/periodic.c", _drives),
    File("cortex_m4/recorded.c", "cortex_m4/recorded.c"),
    File("templates/@{name}.ino", "sketch.ino", _drives),
    File("templates/@{name}_freertos.c", "freertos.c", _drives),
    File("ros2/package.xml", "ros2/package.xml", _ros2),
    File("ros2/@{package}.xml", "ros2/plugin.xml", _ros2),
    File("ros2/CMakeLists.txt", "ros2/CMakeLists.txt", _ros2),
    File("ros2/config/@{package}.yaml", "ros2/controller.yaml", _ros2),
    File("ros2/config/moveit_controllers.yaml", "ros2/moveit_controllers.yaml", _ros2, _follows),
    File("ros2/launch/@{package}.launch.py", "ros2/launch.jinja", _ros2),
    File("ros2/launch/@{package}_mujoco.launch.py", "ros2/mujoco.jinja", _ros2, _follows),
    File("ros2/urdf/@{package}.urdf.xacro", "ros2/robot.xml", _ros2),
    File("ros2/urdf/@{package}.ros2_control.xacro", "ros2/ros2_control.xml", _ros2),
    File("ros2/include/@{package}/controller.hpp", "ros2/controller.hpp", _ros2),
    File("ros2/src/controller.cpp", "ros2/controller.cpp", _ros2),
    File("ros2/include/@{package}/trajectories.hpp", "ros2/trajectories.hpp", _ros2, _follows),
    File("ros2/src/trajectories.cpp", "ros2/trajectories.cpp", _ros2, _follows),
)

#: Templates of the files that need a recording, or a session that is played.
RECORDED = ("test.c", "contract.c", "follow_test.c", "README.md", "safety.md")


def export_c(
    controller: Controller,
    folder: str | os.PathLike[str],
    name: str = "controller",
    real: str = "double",
    force: bool = False,
    robot: Robot | None = None,
    origin: Mapping[str, str] = NOTHING,
    limits: bool = True,
) -> Path:
    """Write a controller as dependency-free C99: header, source, test vector, and further files for firmware.

    Parameters
    ----------
    controller : Controller
        Its memory of past samples is not exported.
    folder : path
        Made if it is not there.
    name : str
        A C identifier: of the two files, and the beginning of every name in them.
    real : {"double", "float"}
        The type of all numbers. In float, code is smaller and faster on a microcontroller, and the estimate has some
        three to five digits.
    force : bool
        Write into a folder that is not empty: files of the same names are replaced, others stay.
    robot : Robot, optional
        Whose name, parameters with units, and gear ratios stand in the header.
    origin : mapping of str to str, optional
        Lines for header and README that say which design this is: ``{"drawing": "A-1234, revision C"}``.
    limits : bool
        Whether every input must have limits; False exports a controller that may ask for any value.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    InvalidInput
        If the name is none for C, the type is unknown, the folder is not empty, an input has no limits, or numbers or
        law do not fit the type.
    Unsupported
        If law or estimator need an operation that has no form in C.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> import tempfile
    >>> controller = fh.Controller(fh.linear_law(fh.paper_arm().problem(), gamma=np.inf), None, 1e-3, 48.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = fh.export_c(controller, f"{folder}/c")
    ...     (written / "controller.h").is_file()
    True
    """
    target, files = checked_folder(folder, force), controller_files(controller, name, real, robot, origin)
    if limits:
        check_limits(controller)
    write_files(target, files)
    return target


def checked_folder(folder: str | os.PathLike[str], force: bool) -> Path:
    """The absolute path of a folder that may be written.

    Raises InvalidInput: if it is a file, or is not empty and `force` is not set.
    """
    path = checked_path("The folder", folder).absolute()
    found, full = f"expected a new or empty folder, got {path}", path.is_dir() and any(path.iterdir())
    refuse_if(path.exists() and not path.is_dir(), "The output is no folder.", found, "another name")
    refuse_if(
        full and not force,
        "The output folder is not empty.",
        found,
        "another folder, or force=True (--force): files of the same names are then replaced",
    )
    return path


def write_files(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write all files or none; the folders are made, and other files there stay.

    Raises InvalidInput: if the place cannot be written; then all is as it was.
    """
    contents = {n: text.encode("utf-8") if isinstance(text, str) else text for n, text in files.items()}
    try:
        write_folder(folder, contents)
    except OSError as error:
        raise InvalidInput(
            "The output folder cannot be written; nothing was changed.",
            f"{folder}: {error.strerror or error}",
            "another folder, with room",
        ) from error


def controller_files(
    controller: Controller,
    name: str = "controller",
    real: str = "double",
    robot: Robot | None = None,
    origin: Mapping[str, str] = NOTHING,
    design: Mapping[str, str] = NOTHING,
) -> dict[str, str]:
    """The files of `export_c`: relative path to text; raises as it does. `design`: Files of the design, which go with
    it."""
    code = code_of(controller, name, real, robot, origin)
    vector = tested(code, provoked(code, record(code.controller, exact=code.real.kind)))
    texts = files_of(Export(code, vector.runs, vector.allowed, design))
    return texts | {f"design/{path}": text for path, text in design.items()}


def files_of(export: Export, files: Sequence[File[Export]] = FILES) -> dict[str, str]:
    """Relative path to text of these files; those of `RECORDED` need the recordings of the export."""
    code = export.code
    shared = {
        **code.values,
        "digest": code.digest,
        "package": package_name(code),
        "follows": _follows(export),
    }
    return rendered(files, export, code.name, code.real, **shared)


def _home(code: ControllerCode) -> tuple[str, np.ndarray]:
    """What a command of the templates begins with, in words and as numbers: that of the robot where it starts."""
    c, place = code.controller, code.belief
    if c.mode.moving and code.standstill is None:
        return "A motion", c.operating_reference
    state = np.asarray(c.law.operating_point)[: len(c.states)]
    state = state if place is None else c.estimated_states.own(place)
    if code.rests and code.standstill is not None:
        return "Link positions", state[: code.standstill.size1_in(0)]
    positions = state[[c.law.plant_states.index(name) for name in c.law.tracked]]
    return "Positions", positions if len(positions) else np.zeros(1)


def _begin_here(code: ControllerCode) -> Mapping[str, object]:
    """How drives begin: which measurements are the links' positions (None where the model or a sensor is missing), and
    where the tracked positions lie in the state of rest."""
    c, measured = code.controller, list(code.signals["Y"])
    if code.standstill is None or c.estimator is None:
        return {"links": None}
    states = c.estimator.plant.states
    links = [states[int(place)] for place in joint_places(c.estimator.plant)[0].tolist()]
    if not set(links) <= set(measured):
        return {"links": None}
    tracked = [] if code.rests else [states.index(name) for name in c.tracked]
    return {"links": [measured.index(name) for name in links], "tracked": tracked}


#: Why a test vector may saturate: before measured positions are moved, and then.
AT_LIMIT = {
    "": "commands swing faster than a robot should",
    "moved": "measured positions are moved away and back",
}


def _contract(export: Export) -> Mapping[str, object]:
    return contract_values(export.code, export.runs[-1], export.allowed.pose)


def _safety(export: Export) -> Mapping[str, object]:
    return {**safety_values(export.code, export.runs[-1]), "digest": export.code.digest}


def _readme(export: Export) -> Mapping[str, object]:
    """What the README states beside."""
    code, c, run = export.code, export.code.controller, export.runs[-1]
    arrays = {
        "Y": ("input.y", None),
        "R": ("input.r", None),
        "U": ("output.u", code.safe_input),
        "X": ("output.estimate", code.belief),
    }
    signals = [
        (
            Markup(f"`{array}`"),
            str(k),
            name,
            code.unit_text(name),
            "" if starts is None else f"{starts[k]:.6g}",
        )
        for kind, (array, starts) in arrays.items()
        for k, name in enumerate(code.signals[kind])
    ]
    at_limit = (run.u <= c.limits.lower) | (run.u >= c.limits.upper)
    counts = {name: int(at_limit[part].any(axis=1).sum()) for name, part in run.parts.items()}
    none = Markup(
        f"none: set `{code.upper('P_LOWER')}` and `{code.upper('P_UPPER')}` to what the drives take"
    )
    facts = {
        **code.facts,
        "digest": code.digest,
        "saturation": c.summary().get("saturation", none),
        "type": code.real.name,
        "inputs differ from the simulation's by": export.allowed.text,
        "memory of one controller": Markup(
            f"{code.state_bytes} bytes, given by the caller (`{code.name}_state`)"
        ),
        "stack of a step": stack_text(code.files, code.name, code.real.name),
        "constants": f"{code.constants} numbers",
        "arithmetic operations of one step": Markup(
            f"about {code.operations}; `make cortex-m4-contract` counts the most instructions"
        ),
        Markup("from `<math.h>`"): ", ".join(mathematics(code.source)),
    }
    return {
        "stops": of_file(stops(export.code)),
        "facts": list(facts.items()),
        "signals": signals,
        "codes": of_file(
            (f"`{code.upper(key)}`", row.value, row.meaning, row.reaction.format(name=code.name))
            for key, row in code.codes.items()
            if key != "BAD_MEASUREMENT" or not code.predicts
        ),
        "parameters": of_file(
            (f"`{code.upper(f'P_{part.upper()}')}`", place.stop - place.start, PARTS[part])
            for part, place in c.data.places.items()
            if place.stop > place.start
        ),
        "every": EVERY,
        "far": reaches_far(code),
        "at_limit": [(count, AT_LIMIT[name]) for name, count in counts.items() if count and name in AT_LIMIT],
        "samples": run.begun,
        "provoked": 0 if run.provocation is None else sum(run.provocation.repeats),
        "has_design": bool(export.design),
        "exact": export.allowed.exact,
    }
