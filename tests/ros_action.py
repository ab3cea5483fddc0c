"""Types of control_msgs and std_srvs, generated where the package index has ROS 2 without them.

The definitions are those of the published interfaces; rosidl's generators make the Python module and its libraries.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import sysconfig
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

#: Of each package.
DEFINITIONS = {
    "control_msgs": {
        "action/FollowJointTrajectory.action": """
        trajectory_msgs/JointTrajectory trajectory
        JointTolerance[] path_tolerance
        JointTolerance[] goal_tolerance
        builtin_interfaces/Duration goal_time_tolerance
        ---
        int32 error_code
        string error_string
        ---
        std_msgs/Header header
        string[] joint_names
        trajectory_msgs/JointTrajectoryPoint desired
        trajectory_msgs/JointTrajectoryPoint actual
        trajectory_msgs/JointTrajectoryPoint error
        """,
        "msg/JointTolerance.msg": """
        string name
        float64 position
        float64 velocity
        float64 acceleration
        """,
        "msg/InterfaceValue.msg": """
        string[] interface_names
        float64[] values
        """,
        "msg/DynamicJointState.msg": """
        std_msgs/Header header
        string[] joint_names
        InterfaceValue[] interface_values
        """,
        "msg/JointTrajectoryControllerState.msg": """
        std_msgs/Header header
        string[] joint_names
        trajectory_msgs/JointTrajectoryPoint reference
        trajectory_msgs/JointTrajectoryPoint feedback
        trajectory_msgs/JointTrajectoryPoint error
        trajectory_msgs/JointTrajectoryPoint output
        string[] multi_dof_joint_names
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output
        float64 speed_scaling_factor
        """,
    },
    "std_srvs": {
        "srv/Trigger.srv": """
        ---
        bool success
        string message
        """,
    },
}

#: The command of rosidl, which refuses wheels that state their entry points twice.
ROSIDL = """
import sys, rosidl_cli.entry_points as points
every = points.get_entry_points
points.get_entry_points = lambda group, *, specs=None, strict=False: every(group, specs=specs)
from rosidl_cli.cli import main
sys.exit(main())
"""

#: Packages of ROS 2 whose messages the action has, and what the generated code calls.
MESSAGES = (
    "trajectory_msgs", "geometry_msgs", "std_msgs", "builtin_interfaces", "action_msgs", "unique_identifier_msgs",
    "service_msgs",
)  # fmt: skip
RUNTIME = (
    "rosidl_runtime_c", "rcutils", "fastcdr", "rmw", "rosidl_typesupport_c", "rosidl_typesupport_cpp",
    "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c",
)  # fmt: skip

#: Libraries: their sources, and the generated folder of each.
LIBRARIES = {
    "rosidl_generator_c": ("c", "*/detail/*.c"),
    "rosidl_typesupport_fastrtps_c": ("fastrtps_c", "*/detail/*.cpp"),
    "rosidl_typesupport_introspection_c": ("introspection_c", "*/detail/*.c"),
    "rosidl_typesupport_c": ("c", "*/*.cpp"),
}


def action_type(folder: Path) -> Any:
    """The type of the action: that of control_msgs, or one generated in `folder`; skips where it cannot be."""
    return _type(folder, "control_msgs", "action", "FollowJointTrajectory")


def trigger_type(folder: Path) -> Any:
    """The type of a service, `std_srvs/Trigger`; likewise."""
    return _type(folder, "std_srvs", "srv", "Trigger")


def _type(folder: Path, package: str, kind: str, name: str) -> Any:
    try:
        return getattr(import_module(f"{package}.{kind}"), name)
    except ModuleNotFoundError as error:
        if error.name not in (package, f"{package}.{kind}"):
            raise
    for module in ("rosidl_cli", "catkin_pkg"):
        pytest.importorskip(module, reason=f"not in the locks: {module}, which generates types of ROS 2")
    _generate(folder, package)
    return getattr(import_module(f"{package}.{kind}"), name)


def _generate(folder: Path, name_of: str) -> None:
    package, made = folder / name_of, folder / "made"
    for name, text in DEFINITIONS[name_of].items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text("\n".join(line.strip() for line in text.strip().splitlines()) + "\n")
    prefix = next(
        path
        for path in Path(import_module("rosidl_cli").__file__ or "").parents
        if (path / "share" / "trajectory_msgs").is_dir()
    )
    settings = {**os.environ, "AMENT_PREFIX_PATH": str(prefix)}
    for options in (("-t", "c", "-t", "py"), ("-ts", "c", "-ts", "fastrtps_c", "-ts", "introspection_c")):
        words = [
            sys.executable,
            "-c",
            ROSIDL,
            "generate",
            "-o",
            str(made),
            *options,
            "-I",
            str(prefix / "share"),
        ]
        done = subprocess.run(
            [*words, name_of, *DEFINITIONS[name_of]],
            cwd=package,
            env=settings,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    _compile(folder, name_of, made, prefix)


def _compile(folder: Path, name_of: str, made: Path, prefix: Path) -> None:
    includes = folder / "include"
    includes.mkdir()
    headers = [made / name for name in ("c", "fastrtps_c", "introspection_c")]
    (includes / name_of).mkdir()
    for place in headers:
        for file in place.rglob("*.h"):
            target = includes / name_of / file.relative_to(place)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(file.read_text())
    found = [includes, prefix / "include", sysconfig.get_paths()["include"], np.get_include()]
    found += [path for path in (prefix / "include").iterdir() if path.is_dir()]
    common = [
        "-O0",
        "-shared",
        "-fPIC",
        *(f"-I{path}" for path in found),
        f"-L{prefix / 'lib'}",
        f"-L{folder}",
    ]
    libraries = prefix / "lib"
    common.append(f"-Wl,--disable-new-dtags,-rpath,{libraries}")  # also for what they need in turn
    kinds = (*LIBRARIES, "rosidl_generator_py")
    names = [f"{package}__{kind}" for package in MESSAGES for kind in kinds]
    linked = [f"-l{name}" for name in (*names, *RUNTIME) if (libraries / f"lib{name}.so").is_file()]
    before: list[str] = []
    for name, (place, pattern) in LIBRARIES.items():
        library = folder / f"lib{name_of}__{name}.so"
        sources = sorted((made / place).glob(pattern))
        compiler = "g++" if pattern.endswith("cpp") else "gcc"
        _run([compiler, *common, *sources, *before, *linked, f"-Wl,-soname,{library.name}", "-o", library])
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
        before.append(f"-l{name_of}__{name}")
    package = folder / "python" / name_of
    for file in [*(made / "py").rglob("*.py")]:
        target = package / file.relative_to(made / "py")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(file.read_text())
    (package / "__init__.py").touch()
    sources = [*(made / "py").glob("*/*_s.c"), made / "py" / f"_{name_of}_s.ep.rosidl_typesupport_c.c"]
    extension = f"{name_of}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    _run(["gcc", *common, *sources, *before, *linked, "-o", package / extension])
    sys.path.insert(0, str(package.parent))


def _run(words: list[Any]) -> None:
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]
