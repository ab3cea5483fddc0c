"""MuJoCo's viewer beside a run: links, and motors as they stand behind their springs.

MuJoCo's model of the robot has no shapes. What is shown is drawn into the viewer's own scene: capsules from joint to
joint, for the links as they are and for the motors with the wind-up of their springs drawn larger.
"""

from __future__ import annotations

import os
import sys
import threading
from importlib import import_module
from types import TracebackType
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.mujoco_plant import MuJoCoPlant
from flexhinf.robot.robot import Robot
from flexhinf.robot.skeleton import skeleton

#: Wind-ups of the springs are drawn so many times larger.
LARGER = 10.0

#: Radii of links and motors as parts of the robot's size, and their colours: those of Okabe and Ito's blue and orange.
LINK, MOTOR = 0.022, 0.012
BLUE, ORANGE = (0.0, 0.45, 0.70, 1.0), (0.84, 0.37, 0.0, 1.0)

#: From the middle of the arm to the camera, in sizes of the robot.
DISTANCE = 2.5

#: Between two pictures, s; and the longest time that the drawing thread keeps the interpreter for itself, s.
FRAME, SWITCH = 1.0 / 30.0, 1e-4


def check_display() -> None:
    """Refuse, before any work, a view where there is no display.

    Raises
    ------
    InvalidInput
    """
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise InvalidInput(
            "There is no display to show the robot on.",
            "expected DISPLAY or WAYLAND_DISPLAY to name one, got neither",
            "--record arm.gif, which needs none; or run it where there is a screen",
        )


class MuJoCoView:
    """A window that shows a robot in MuJoCo while it runs; use it as a context.

    A thread of its own draws, on data of its own: a run that calls `show` does not wait for the window, but shares the
    processor and the interpreter with it.

    Parameters
    ----------
    plant : MuJoCoPlant
        The same robot, as it is driven.

    Raises
    ------
    InvalidInput
        If no window can be opened, when the context is entered.
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
        self._viewer.set_texts((
            self._mujoco.mjtFontScale.mjFONTSCALE_150, self._mujoco.mjtGridPos.mjGRID_TOPLEFT,
            "blue\norange", f"links\nmotors, the wind-up of their springs drawn {LARGER:g} times larger",
        ))  # fmt: skip
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
        viewer = self._viewer
        while not self._ended.wait(FRAME):
            if not viewer.is_running():
                self._ended.set()
                return
            with viewer.lock():
                scene = viewer.user_scn
                scene.ngeom = 0
                for larger, radius, colour in ((0.0, LINK, BLUE), (LARGER, MOTOR, ORANGE)):
                    for line in self._lines(larger):
                        for end in line[1:]:
                            self._draw(scene, line[0], end, radius * self._size, colour)
            viewer.sync()

    def _lines(self, larger: float) -> tuple[np.ndarray, ...]:
        """The arm with its links turned by so many times their spring's wind-up."""
        n = len(self._robot.joint_names)
        x = self._robot.layout.whole(self._state)
        return skeleton(self._robot, x[:n] + larger * (x[2 * n : 3 * n] - x[:n]))

    def _draw(self, scene: Any, begin: np.ndarray, end: np.ndarray, radius: float, colour: tuple) -> None:
        if scene.ngeom >= scene.maxgeom:
            return
        mujoco, kind = self._mujoco, self._mujoco.mjtGeom.mjGEOM_CAPSULE
        geom = scene.geoms[scene.ngeom]
        scene.ngeom += 1
        rgba = np.array(colour, dtype=np.float32)
        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
        mujoco.mjv_connector(geom, kind, radius, begin, end)
