"""A robot in MuJoCo: an independent physics engine as the true plant of `flexhinf.Loop`, and its viewer beside a run.

MuJoCo has no elastic joint. Each rotor is a body of its own that turns about an axis of the world, with `armature`
making up its inertia, and a fixed tendon θ − T q with the joint's stiffness is the spring; backlash is the tendon's own
dead band. The curve of a gear is three tendons side by side, with dead bands that end at its corners. Dry friction is
MuJoCo's own, a constraint that its solver meets at each step (`frictionloss`): the rotor sticks but for a creep that is
far below the one of our smoothed friction.

MuJoCo's model of the robot has no shapes. What the viewer shows is drawn into its own scene: capsules from joint to
joint, for the links as they are and for the motors with the wind-up of their springs drawn larger.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Mapping, Sequence
from importlib import import_module
from types import TracebackType
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant import BlackBox, Parameters
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot.drive_limits import largest_drive_torques
from flexhinf.robot.dynamics import matrix_of
from flexhinf.robot.elastic import EXTRAS, checked_extras
from flexhinf.robot.gears import curve_parts
from flexhinf.robot.kinematics import skeleton
from flexhinf.robot.robot import Robot
from flexhinf.robot.signals import MECHANICAL, Sensors, signal_names, units_of
from flexhinf.validation import checked_array, checked_positive, extra_package

#: Wind-ups of the springs are drawn so many times larger.
LARGER = 10.0

#: Lines of links and of motors: wind-up of the springs, radius as a part of the robot's size, and colour, of Okabe and
#: Ito's: blue and orange.
LINES = ((0.0, 0.022, (0.0, 0.45, 0.70, 1.0)), (LARGER, 0.012, (0.84, 0.37, 0.0, 1.0)))

#: From the middle of the arm to the camera, in sizes of the robot.
DISTANCE = 2.5

#: Between two pictures, s; and the longest time that the drawing thread keeps the interpreter for itself, s.
FRAME, SWITCH = 1.0 / 30.0, 1e-4


def check_display() -> None:
    """Refuse, before any work, a view where there is no display."""
    refuse_if(
        sys.platform.startswith("linux")
        and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")),
        "There is no display to show the robot on.",
        "expected DISPLAY or WAYLAND_DISPLAY to name one, got neither",
        "--record arm.gif, which needs none; or run it where there is a screen",
    )


class MuJoCoView:
    """A window that shows a robot in MuJoCo while it runs; use it as a context, which refuses where none can be opened.

    A thread of its own draws, on data of its own: a run that calls `show` does not wait for the window, but shares the
    processor and the interpreter with it.
    """

    def __init__(self, robot: Robot, plant: MuJoCoPlant) -> None:
        self._robot, self._plant = robot, plant
        self._viewer: Any = None
        self._state, self._ended = plant.state(), threading.Event()
        self._thread = threading.Thread(target=self._draw_until_ended, daemon=True)
        self._interval = sys.getswitchinterval()

    def __enter__(self) -> MuJoCoView:
        check_display()
        try:
            self._mujoco: Any = import_module("mujoco")
            window, model = import_module("mujoco.viewer"), self._plant.model
            self._viewer = window.launch_passive(
                model, self._mujoco.MjData(model), show_left_ui=False, show_right_ui=False
            )
        except Exception as error:  # whatever the window system raises, of many kinds
            raise InvalidInput(
                "MuJoCo's viewer cannot be opened.",
                f"expected a window with OpenGL, got {type(error).__name__}: {str(error)[:200]}",
                "--record arm.gif; on macOS mjpython in the place of python",
            ) from error
        points = np.concatenate(self._lines(0.0))
        self._size = max(float(np.ptp(points, axis=0).max()), 1e-3)
        camera = self._viewer.cam
        camera.lookat[:] = points.mean(axis=0)
        camera.distance, camera.elevation, camera.azimuth = DISTANCE * self._size, -15.0, 90.0
        self._viewer.set_texts(
            (
                self._mujoco.mjtFontScale.mjFONTSCALE_150,
                self._mujoco.mjtGridPos.mjGRID_TOPLEFT,
                "blue\norange",
                f"links\nmotors, the wind-up of their springs drawn {LARGER:g} times larger",
            )
        )
        sys.setswitchinterval(SWITCH)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()
        sys.setswitchinterval(self._interval)
        self._viewer.close()

    def show(self) -> bool:
        """Show the robot as it stands now; False once the window was closed."""
        self._state = self._plant.state()
        return not self._ended.is_set()

    def _draw_until_ended(self) -> None:
        viewer, mujoco = self._viewer, self._mujoco
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        while not self._ended.wait(FRAME):
            if not viewer.is_running():
                self._ended.set()
                return
            with viewer.lock():
                scene = viewer.user_scn
                scene.ngeom = 0
                for larger, radius, colour in LINES:
                    rgba = np.array(colour, dtype=np.float32)
                    ends = [(line[0], end) for line in self._lines(larger) for end in line[1:]]
                    for begin, end in ends[: scene.maxgeom - scene.ngeom]:
                        geom = scene.geoms[scene.ngeom]
                        scene.ngeom += 1
                        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
                        mujoco.mjv_connector(geom, kind, radius * self._size, begin, end)
            viewer.sync()

    def _lines(self, larger: float) -> tuple[np.ndarray, ...]:
        n = len(self._robot.joint_names)
        links = self._state[:n]
        return skeleton(self._robot, links + larger * (self._robot.layout.relaxed(self._state) - links))


#: The part of a rotor's inertia that MuJoCo's body has; the rest is its armature.
ROTOR_SHARE = 1e-3

#: What a real joint adds and MuJoCo's tendons and joints express; dry friction by a model of its own.
EXPRESSED = ("joint_damping", "stiffness_curve", "backlash", "coulomb_friction", "drive_torque_limit")

#: What MuJoCo has no element for.
MISSING = {
    "inductance": "its motors have no coil",
    "spring_hardening": "its tendons are linear outside their dead band",
    "kinematic_error": "its tendons are linear in the angles",
    "torque_ripple": "its motors have the same torque at every angle",
    "load_friction": "its friction loss is the same at every load",
    "stribeck_friction": "its friction loss is the same at every speed",
}

#: Time constant (s), damping ratio and impedance of MuJoCo's friction constraint. Under a torque τ below F_c it creeps
#: with τ (1 − d) / (d J b), b = 2 / (d · time constant): 5e-6 rad/s for 1 N·m and 1 kg·m².
STICKING = 'solreffriction="0.01 1" solimpfriction="0.999 0.999 0.001"'

#: Smallest share of its load that moves a motor in MuJoCo: one that rejects its load is heavier by its inverse.
REJECTED = 1e-6

#: Light and sky of MuJoCo's viewer; without them it is black.
LOOK = (
    '<visual><headlight ambient="0.5 0.5 0.5" diffuse="0.6 0.6 0.6"/></visual><asset><texture type="skybox" '
    'builtin="gradient" rgb1="0.98 0.98 0.99" rgb2="0.86 0.89 0.92" width="16" height="96"/></asset>'
)


class MuJoCoPlant(BlackBox):
    """A black box for `flexhinf.Loop`: Spong's model integrated by MuJoCo's own RK4; names as for `Robot.plant`.

    Voltage-driven motors are without their coil: the torque k_t V / R is applied, and the back-EMF k_t k_b / R is part
    of the rotor's damping. Drives with an inner loop are MuJoCo's own actuators of position and velocity. One that
    rejects a part of its load is a motor and a loop that are heavier by the inverse of its share.

    Parameters
    ----------
    measured : sequence of str or None
        As for `Robot.plant`; None gives the whole state, for a controller without an estimator.
    step : float
        Longest step of integration, s.
    extras : sequence of str
        Out of joint_damping, stiffness_curve, backlash, coulomb_friction and drive_torque_limit; others are refused,
        and the last of drives that reject a part of their load.
    parameters : mapping, optional
        Of the plant, for example `Robot.draw`; nominal by default.
    """

    def __init__(
        self,
        robot: Robot,
        measured: str | Sequence[str] | None = ("link_position",),
        step: float = 1e-3,
        extras: str | Sequence[str] = (),
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        packed = robot.plant_parameters() if parameters is None else dict(parameters)
        on = checked_extras(extras, False, packed, robot.name)
        self._mujoco: Any = check_expressed(on)
        refuse_if(
            inexpressible(on, packed),
            "MuJoCo does not express 'drive_torque_limit' of a drive that rejects its load.",
            f"expected load_share = 1, got {np.ravel(packed.get('load_share', 1.0)).tolist()}",
            "the same without MuJoCo: robot.plant(extras=...) as the true plant; or without this extra",
        )
        self._step = checked_positive("The step of integration", step, "seconds", "1e-3")
        self._p = p = Parameters(packed)
        joints = robot.joint_names
        self._n, self._robot = len(joints), robot
        model = robot.plant(tuple(SENSORS) if measured is None else measured)
        self.states, self.inputs = tuple(model.states), tuple(model.inputs)
        self.disturbances, self.units = tuple(model.disturbances), units_of(joints, robot.links.slides)
        self._sensors = None if measured is None else Sensors(tuple(model.outputs), joints, on, robot.layout)
        self.outputs = self.states if self._sensors is None else self._sensors.names
        self._gain = np.broadcast_to(robot.drive_kind.torque_per_input(p), self._n)
        self.model = self._mujoco.MjModel.from_xml_string(mujoco_xml(robot, packed, on))
        self.data = self._mujoco.MjData(self.model)
        self.reset(None)

    # Black box ------------------------------------------------------------------------------------
    def reset(self, initial_state: Any = None) -> None:
        """Start again at a state in the order of `states`; at rest in the robot's home by default."""
        x = self._robot.operating_point()[0] if initial_state is None else initial_state
        what = "The initial state does not fit MuJoCo's plant."
        expected = f"{len(self.states)} finite numbers for {list(self.states)}"
        x = checked_array(what, x, (len(self.states),), expected, "one number per state")
        q, dq, theta, dtheta = self._robot.layout.split(x)
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = np.concatenate([q, theta]), np.concatenate([dq, dtheta])
        self._mujoco.mj_forward(self.model, self.data)

    def step(self, u: Any, disturbance: Any, period: float) -> None:
        """Advance by one period (s) with the input (n,) and the disturbance (2 n,) held."""
        n, layout = self._n, self._robot.layout
        count = max(1, int(np.ceil(period / self._step - 1e-9)))
        torque = np.zeros(2 * n) if np.size(disturbance) == 0 else np.array(disturbance, dtype=float)
        if self._robot.drive_kind.inner:
            self.data.ctrl[:] = u
            torque[n:] /= np.maximum(self._p.load_share, REJECTED)
        else:
            torque[n:] += self._gain * np.asarray(u, dtype=float)
        self.model.opt.timestep = period / count
        links, motors = torque[:n], torque[n:]
        links[list(layout.rigid)] += motors[list(layout.rigid)]
        self.data.qfrc_applied[:] = np.concatenate([links, motors[layout.elastic]])
        self._mujoco.mj_step(self.model, self.data, count)

    def state(self) -> np.ndarray:
        """x, in the order of `states`."""
        n, q, dq = self._n, self.data.qpos, self.data.qvel
        return np.concatenate([q[:n], dq[:n], q[n:], dq[n:]])

    def output(self) -> np.ndarray:
        """The measured signals."""
        x = self.state()
        return x if self._sensors is None else np.asarray(self._sensors(x, None, self._p), dtype=float)


def check_expressed(extras: Sequence[str]) -> Any:
    """The package; refuses extras that MuJoCo's plant does not have, and a missing installation, before any work."""
    for name in extras:
        refuse_if(
            name not in EXPRESSED,
            f"MuJoCo does not express {name!r}: {MISSING.get(name, 'it is unknown')}.",
            f"expected extras out of {list(EXPRESSED)}, got {list(extras)}",
            "the same without MuJoCo: robot.plant(extras=...) as the true plant; or without this extra",
        )
    return extra_package("mujoco", "mujoco", "MuJoCo is not installed.")


def inexpressible(extras: Sequence[str], packed: Mapping[str, Any]) -> tuple[str, ...]:
    """Extras out of `EXPRESSED` that MuJoCo does not express of a robot with these parameters of its plant: its
    actuators know no load."""
    rejects = bool(np.any(np.asarray(packed.get("load_share", 1.0)) < 1.0))
    return tuple(name for name in extras if name == "drive_torque_limit" and rejects)


# The model ----------------------------------------------------------------------------------------
def mujoco_xml(robot: Robot, parameters: Mapping[str, Any], extras: Sequence[str] = ()) -> str:
    """The robot as MJCF: links, rotors, springs; joints in the order links, then motors.

    The parameters are those of its plant; extras out of `EXPRESSED`.
    """
    p, layout, n = Parameters(dict(parameters)), robot.layout, len(robot.joint_names)
    rigid = robot.links.rigid(p)
    links, motors = (signal_names(name, robot.joint_names) for name in MECHANICAL[::2])
    friction = p.friction + robot.drive_kind.back_emf(p)
    damping, gap, loss = (
        getattr(p, EXTRAS[name]) if name in extras else 0.0
        for name in ("joint_damping", "backlash", "coulomb_friction")
    )
    inertia, drives = p.motor_inertia, ""
    if robot.drive_kind.inner:
        heavier = 1.0 / np.maximum(p.load_share, REJECTED)
        inertia, gains = (
            heavier * inertia,
            (heavier * robot.drive_kind.torque_per_input(p), heavier * p.drive_damping),
        )
        largest = largest_drive_torques(p, n) if "drive_torque_limit" in extras else np.inf
        own_loops = _actuators(
            robot, links, motors, *(np.broadcast_to(gain, n) for gain in (*gains, largest))
        )
        drives = f"<actuator>{own_loops}</actuator>"
    rotor = [np.broadcast_to(value, n).tolist() for value in (inertia, friction, loss)]
    curved = curve_parts(p) if "stiffness_curve" in extras else [(p.stiffness, 0.0)]
    twist = [
        [np.broadcast_to(value, len(layout.elastic)).tolist() for value in (slope, lost, 0.5 * gap + width)]
        for lost, (slope, width) in zip((damping, 0.0, 0.0), curved)
    ]
    own = [
        f'armature="{_n(j * (1.0 - (0.0 if i in layout.rigid else ROTOR_SHARE)))}" damping="{_n(b)}" '
        f'frictionloss="{_n(dry)}" {STICKING}'
        for i, j, b, dry in zip(range(n), *rotor)
    ]
    down = np.asarray(robot.links.down)
    across = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])  # no gravity on rotors that slide
    axis, rotors = _row(across / np.linalg.norm(across)), list[str]()
    for i in layout.elastic:
        slides, share = rigid[0].joints[i].slides, rotor[0][i] * ROTOR_SHARE
        mass, moment = (share, 1.0) if slides else (1.0, share)
        rotors.append(
            f'<body><joint name={quoteattr(motors[i])} type="{"slide" if slides else "hinge"}" axis="{axis}" {own[i]}/>'
            f'<inertial pos="0 0 0" mass="{_n(mass)}" diaginertia="{_row([moment] * 3)}"/></body>'
        )
    ends = [
        "".join(
            f'<joint joint={quoteattr(links[j])} coef="{_n(-factor)}"/>'
            for j, factor in enumerate(row)
            if factor
        )
        for row in layout.matrix.tolist()
    ]
    springs = [
        f'<fixed stiffness="{_n(k)}" damping="{_n(c)}" springlength="{_n(-half)} {_n(half)}">'
        f'<joint joint={quoteattr(motors[i])} coef="1"/>{ends[i]}</fixed>'
        for parts in twist
        for i, (k, c, half) in zip(layout.elastic, zip(*parts))
        if k or c
    ]
    turning = [own[i] if i in layout.rigid else "" for i in range(n)]
    return (
        f'<mujoco><compiler angle="radian"/><option integrator="RK4" gravity="{_row(robot.links.fall(p))}">'
        f'<flag contact="disable"/></option>{LOOK}<worldbody>{_bodies(rigid, -1, links, turning)}'
        f"{''.join(rotors)}</worldbody>"
        f"<tendon>{''.join(springs)}</tendon>{drives}</mujoco>"
    )


def _actuators(
    robot: Robot,
    links: Sequence[str],
    motors: Sequence[str],
    gain: np.ndarray,
    damping: np.ndarray,
    largest: np.ndarray,
) -> str:
    """XML of the drives' own loops, with their largest torques; the motor of a rigid joint is the joint of its link."""
    names = [links[i] if i in robot.layout.rigid else motors[i] for i in range(len(links))]
    limits = [
        f' forcerange="{_row([-most, most])}"' if np.isfinite(most) else "" for most in largest.tolist()
    ]
    return "".join(
        f"<{robot.drive_kind.actuator.format(quoteattr(n), _n(k), _n(d))}{limit}/>"
        for n, k, d, limit in zip(names, gain, damping, limits)
    )


def _bodies(rigid: Any, parent: int, names: Sequence[str], motors: Sequence[str]) -> str:
    """XML of the links behind a parent and, nested, of those behind them; `motors` are attributes of their joints."""
    (tree, masses, centres, inertias), text = rigid, ""
    for i, joint in enumerate(tree.joints):
        if tree.parents[i] == parent:
            place = joint.placement
            moments, axes = np.linalg.eigh(matrix_of(inertias[i]))  # our own decomposition: MuJoCo's rounds
            if np.linalg.det(axes) < 0.0:
                axes[:, 0] *= -1.0
            text += (
                f'<body pos="{_row(place.translation)}" quat="{_row(_quaternion(place.rotation))}">'
                f'<inertial pos="{_row(centres[i])}" quat="{_row(_quaternion(axes))}" mass="{_n(masses[i])}" '
                f'diaginertia="{_row(moments)}"/><joint name={quoteattr(names[i])} '
                f'type="{"slide" if joint.slides else "hinge"}" axis="{_row(joint.axis)}" {motors[i]}/>'
                f"{_bodies(rigid, i, names, motors)}</body>"
            )
    return text


def _n(number: Any) -> str:
    return repr(float(number))


def _row(numbers: Any) -> str:
    return " ".join(_n(number) for number in numbers)


def _quaternion(rotation: Any) -> np.ndarray:
    """(w, x, y, z) of a rotation matrix: the eigenvector that Shepperd's largest component picks."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.asarray(rotation, dtype=float)
    table = np.array([
        [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz],
    ])  # fmt: skip
    row = table[int(np.argmax(np.diag(table)))]
    return row / np.linalg.norm(row)
