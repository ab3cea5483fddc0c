"""Options of MJCF files: gravity, masses, ranges and the mass matrix as MuJoCo has them, or a refusal."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from flexhinf.plant import Parameters
from flexhinf.robot import Robot, load_robot
from flexhinf.robot.dynamics import bodies_of, mass_matrix
from fuzz.random_text import RandomText
from fuzz.tally import Tally

ATTEMPTS = 1500

MJCF = """<mujoco model="arm"><compiler {compiler}/><option {option}>{flag}</option>
<default><joint {joint}/><geom {geom}/></default>
<worldbody><body name="upper" pos="0.1 0 0.3" {place}>
<joint name="shoulder" axis="0 1 0" range="-20 30"/>
<inertial pos="0.1 0.02 0.3" mass="2.5" diaginertia="0.03 0.04 0.02"/>
<body name="fore" pos="0 0 0.5"><joint name="elbow" type="slide" axis="0.6 0 0.8" range="-0.1 0.3" {own}/>
<geom type="capsule" size="0.05 0.2" {shape}/></body></body></worldbody>
<actuator><motor name="a" joint="shoulder" {motor}/></actuator></mujoco>
"""
OPTIONS: dict[str, tuple[str, ...]] = {
    "compiler": ('angle="radian"', 'angle="degree"', 'eulerseq="zyx"', 'eulerseq="XYz"', 'eulerseq="xyq"',
                 'autolimits="false"', 'inertiafromgeom="true"', 'inertiafromgeom="perhaps"', 'coordinate="global"',
                 'settotalmass="3"', 'balanceinertia="true"', 'boundmass="N"'),
    "option": ('gravity="0 0 N"', 'gravity="N 0 -9.81"', 'gravity="0 0"', 'density="N"', 'viscosity="0"',
               'integrator="RK4"', 'timestep="N"', 'wind="1 0 0"'),
    "flag": ('<flag gravity="disable"/>', '<flag gravity="enable"/>', '<flag contact="disable"/>', "<flag/>"),
    "joint": ('damping="N"', 'armature="N"', 'frictionloss="N"', 'stiffness="N"', 'limited="true"', 'ref="N"'),
    "own": ('damping="N"', 'armature="N"', 'limited="false"', 'ref="N"', 'springdamper="1 1"', 'pos="N 0 0"',
            'actuatorfrcrange="-N N"', 'type="ball"'),
    "place": ('euler="N 0 N"', 'quat="1 N 0 0"', 'axisangle="0 0 1 N"', 'gravcomp="N"', 'xyaxes="1 0 0 0 1 0"'),
    "geom": ('density="N"', 'mass="N"', 'contype="0"'),
    "shape": ('density="N"', 'mass="N"', 'pos="0 0 N"', 'type="box"', 'fromto="0 0 0 0 0 N"', 'shellinertia="true"'),
    "motor": ('gear="N"', 'ctrlrange="-N N"', 'forcerange="-N N"', 'ctrllimited="true"', 'ctrlrange="1 -1"'),
}  # fmt: skip
ELASTIC = "".join(
    f'[[joint]]\nname = "{name}"\n[joint.spring]\nstiffness = 5000.0\n[joint.motor]\nmotor_inertia = 0.4\n'
    for name in ("shoulder", "elbow")
)


def run(attempts: int, seed: int) -> Tally:
    """Up to two options of each element at a time."""
    tally, random = (
        Tally("options of MJCF files, against MuJoCo"),
        RandomText(np.random.default_rng([seed, 10]), 0.15),
    )
    mujoco.set_mju_user_warning(lambda text: None)  # printed, and written into a file of the working folder
    with tempfile.TemporaryDirectory() as folder:
        path, elastic = Path(folder) / "arm.xml", Path(folder) / "elastic.toml"
        elastic.write_text(ELASTIC, encoding="utf-8")
        for attempt in range(attempts):
            text = _text(random)
            path.write_text(text, encoding="utf-8")
            how = f"seed {seed}, attempt {attempt}"
            try:
                with warnings.catch_warnings(), np.errstate(all="ignore"):
                    warnings.simplefilter("ignore")
                    tally.answered(_unlike_mujoco(load_robot(path, elastic=elastic), text), how)
            except Exception as error:
                tally.raised(error, how)
    mujoco.set_mju_user_warning(None)
    return tally


def _text(random: RandomText) -> str:
    parts = {}
    for place, choices in OPTIONS.items():
        picked = [random.one(choices) for _ in range(random.one((0, 0, 0, 0, 0, 0, 1, 1, 2)))]
        unique = {text.split("=")[0]: text for text in picked}.values()
        parts[place] = " ".join(text.replace("N", random.number().replace('"', "")) for text in unique)
    return MJCF.format(**parts)


def _unlike_mujoco(robot: Robot, text: str) -> str:
    """What MuJoCo has otherwise; nothing where it reads no such file."""
    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError:
        return ""
    p = Parameters(robot.plant_parameters())
    fall = np.array(robot.links.fall(p))
    gravity = (
        np.zeros(3) if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY else model.opt.gravity
    )
    if not np.allclose(fall, gravity, rtol=1e-9, atol=1e-12):
        return f"a free fall of {fall} instead of {gravity}"
    for k, limits in enumerate(robot.links.limits):
        stated = tuple(model.jnt_range[k].tolist()) if model.jnt_limited[k] else None
        if (limits is None) != (stated is None) or (limits and not np.allclose(limits, stated, rtol=1e-9)):
            return f"limits {limits} instead of {stated}"
    for quantity, stated in (("friction", model.dof_damping), ("coulomb_friction", model.dof_frictionloss)):
        found = [robot.nominal.get(f"{quantity}_{name}", 0.0) for name in robot.joint_names]
        if not np.allclose(found, stated, rtol=1e-12, atol=0.0):
            return f"{quantity} of {found} instead of {stated}"
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, 0.1]
    for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_crb):
        step(model, data)
    inertia = _inertia(model, data) - np.diag(model.dof_armature)
    tree, masses, centres, about = robot.links.rigid(p)
    own = np.array(mass_matrix(tree, bodies_of(tree, masses, centres, about), data.qpos), dtype=float)
    if not np.allclose(own, inertia, rtol=1e-8, atol=1e-9 * np.abs(inertia).max()):
        return f"a mass matrix {own.tolist()} instead of {inertia.tolist()}"
    return ""


def _inertia(model: Any, data: Any) -> np.ndarray:
    full = np.zeros((model.nv, model.nv))
    try:
        mujoco.mj_fullM(model, data, full)
    except TypeError:  # before MuJoCo 3.9
        mujoco.mj_fullM(model, full, data.qM)
    return full
