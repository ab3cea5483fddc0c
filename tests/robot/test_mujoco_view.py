"""The view of a run: what is drawn, without a window; and that a window is asked for where there is a display."""

from __future__ import annotations

import threading
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.robot import MuJoCoPlant, load_robot
from flexhinf.robot.kinematics import skeleton
from flexhinf.robot.mujoco import MuJoCoView, check_display

mujoco = pytest.importorskip("mujoco")


class Window:
    """What `launch_passive` returns, without a window."""

    def __init__(self, model: Any, data: Any, **options: Any) -> None:
        self.cam, self.user_scn = mujoco.MjvCamera(), mujoco.MjvScene(model, maxgeom=20)
        self.data, self.texts, self.open, self.synced = data, (), True, threading.Event()

    def set_texts(self, texts: Any) -> None:
        self.texts = texts

    def lock(self) -> Any:
        return nullcontext()

    def sync(self) -> None:
        self.drawing = threading.current_thread()
        self.synced.set()

    def is_running(self) -> bool:
        return self.open

    def close(self) -> None:
        self.open = False


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> list[Window]:
    viewer = pytest.importorskip("mujoco.viewer")
    made: list[Window] = []
    monkeypatch.setattr(viewer, "launch_passive", lambda *a, **o: made.append(Window(*a, **o)) or made[-1])
    monkeypatch.setenv("DISPLAY", ":0")
    return made


def test_links_and_motors_are_drawn(windows: list[Window]) -> None:
    robot = load_robot("planar-two-link")
    plant = MuJoCoPlant(robot)
    plant.reset(robot.operating_point([0.3, 0.4])[0])
    with MuJoCoView(robot, plant) as view:
        window = windows[0]
        assert window.synced.wait(300.0)
        assert view.show()
        scene = window.user_scn
        assert scene.ngeom == 4  # two links, two motors
        lines = skeleton(robot, [0.3, 0.4])
        middles = [line.mean(axis=0) for line in lines]
        np.testing.assert_allclose([geom.pos for geom in scene.geoms[:2]], middles, atol=1e-6)
        assert not np.allclose(scene.geoms[3].pos, middles[1], atol=1e-3)
        assert " 10 times" in window.texts[3]
        assert window.data is not plant.data
        window.open = False
        window.drawing.join(300.0)
        assert not view.show()
    assert threading.active_count() < 10


def test_no_display_and_no_window(monkeypatch: pytest.MonkeyPatch) -> None:
    viewer = pytest.importorskip("mujoco.viewer")
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InvalidInput, match="DISPLAY"):
        check_display()

    def refuse(*arguments: Any, **options: Any) -> None:
        raise RuntimeError("no OpenGL")

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(viewer, "launch_passive", refuse)
    robot = load_robot("planar-two-link")
    with (
        refused_with(InvalidInput, "viewer", "RuntimeError: no OpenGL"),
        MuJoCoView(robot, MuJoCoPlant(robot)),
    ):
        pass
