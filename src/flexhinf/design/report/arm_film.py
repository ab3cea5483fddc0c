"""What a film of a run shows: the arm with links and motors apart, positions, the springs' wind-up, the inputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.design.deployed_run import DeployedRun
from flexhinf.design.report.sections.arm_figure import viewing_plane
from flexhinf.errors import InvalidInput
from flexhinf.export.realtime import RealTimeRun
from flexhinf.robot import Robot
from flexhinf.robot.signals import signal_names
from flexhinf.robot.skeleton import skeleton

#: Wind-ups are drawn larger by one of these factors, so that none is drawn as more than this angle, rad, or as more
#: than this part of the robot's size where a joint slides.
FACTORS, WIDEST, FARTHEST = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000), 0.3, 0.15

#: Length of a motor's hand, as a part of its link.
HAND = 0.62


def magnification(windup: np.ndarray, slides: np.ndarray, size: float) -> int:
    """By how much wind-ups are drawn larger: the largest of `FACTORS` with which all of them stay small enough.

    Parameters
    ----------
    windup : (N, n)
        Motor minus link, rad or m.
    slides : (n,) of bool
    size : float
        Of the robot, m.
    """
    largest = np.abs(windup).max(axis=0) / np.where(slides, FARTHEST * size, WIDEST)
    return max(factor for factor in FACTORS if factor == 1 or factor * largest.max() <= 1.0)


@dataclass(frozen=True, eq=False)
class ArmFilm:
    """A run as it is drawn.

    Parameters
    ----------
    time : (N,)
        s.
    links, motors, command : (N, n)
        Positions, rad or m; the motors' seen from the link side.
    inputs : (N, n)
    limits : (n,)
        Of the inputs, infinite where there are none.
    unit : str
        Of the inputs.
    """

    robot: Robot
    time: np.ndarray
    links: np.ndarray
    motors: np.ndarray
    command: np.ndarray
    inputs: np.ndarray
    limits: np.ndarray
    unit: str
    title: str

    @staticmethod
    def of(prepared: DeployedRun, run: RealTimeRun) -> ArmFilm:
        """Of a run that has one sample at least.

        Raises
        ------
        InvalidInput
            For a run without samples, or a robot whose links have no length.
        """
        n, trajectory = len(prepared.joints), run.trajectory
        state, inputs = trajectory.signals["state"], trajectory.signals["input"]
        bad = np.flatnonzero(~np.isfinite(np.hstack([state, inputs])).all(axis=1))
        kept = slice(0, int(bad[0]) if len(bad) else len(state))  # until the loop diverged
        if not kept.stop:
            raise InvalidInput(
                "There is nothing to film.", "expected a run of one sample at least", "a longer run"
            )
        names = signal_names("link_position", prepared.joints)
        goal = np.broadcast_to(prepared.goal, (len(state), n))
        commanded = trajectory.names.get("reference", ())
        columns = [
            trajectory.signal("reference", name) if name in commanded else goal[:, k]
            for k, name in enumerate(names)
        ]
        motors = prepared.robot.layout.whole(state.T)[2 * n : 3 * n].T
        film = ArmFilm(
            prepared.robot, trajectory.time[kept], state[kept, :n], motors[kept], np.stack(columns, axis=1)[kept],
            inputs[kept], np.maximum(*np.abs(run.input_range)), " or ".join(dict.fromkeys(trajectory.units["input"])),
            f"{prepared.robot.name}: {'step' if prepared.plan is None else 'move'}",
        )  # fmt: skip
        if film.size < 1e-9:
            raise InvalidInput(
                "The arm cannot be drawn: its links have no length.",
                f"expected a robot with joints or centres of mass apart, got {prepared.robot.name!r}",
                "the run without --record",
            )
        return film

    # What is drawn --------------------------------------------------------------------------------
    @cached_property
    def slides(self) -> np.ndarray:
        """Whether each joint slides (n,)."""
        return np.array(self.robot.links.slides, dtype=bool)

    @cached_property
    def windup(self) -> np.ndarray:
        """Motor minus link (N, n)."""
        return self.motors - self.links

    @cached_property
    def extent(self) -> np.ndarray:
        """Points of the arm (K, 3) at some poses of the run and at its commands."""
        rows = np.linspace(0, len(self.time) - 1, min(len(self.time), 40)).astype(int)
        poses = [*self.links[rows], *self.command[rows[[0, -1]]]]
        return np.concatenate([line for pose in poses for line in skeleton(self.robot, pose)])

    @cached_property
    def size(self) -> float:
        """Of the space that the arm takes, m."""
        return float(np.ptp(self.extent, axis=0).max())

    @cached_property
    def factor(self) -> int:
        """By how much wind-ups are drawn larger."""
        return magnification(self.windup, self.slides, self.size)

    @cached_property
    def view(self) -> tuple[np.ndarray, tuple[str, str]]:
        """Two directions (3, 2) to project on, and what they are called."""
        right, up, names = viewing_plane(
            np.asarray(self.robot.links.down, dtype=float), self.extent, self.size
        )
        return np.column_stack([right, up]), names

    def arm(self, pose: np.ndarray) -> list[np.ndarray]:
        """The links at a pose (n,), as lines on the picture."""
        return [line @ self.view[0] for line in skeleton(self.robot, pose)]

    def hands(self, k: int) -> list[np.ndarray]:
        """For each joint three points at sample k: on its link, the joint, and on its motor's hand."""
        found, own = [], self.arm(self.links[k])
        for j, turned in enumerate(self.factor * self.windup[k]):
            pose = self.links[k].copy()
            pose[j] += turned
            motor = self.arm(pose)[j]
            ends = [line[0] + HAND * (line[1] - line[0]) for line in (own[j], motor)]
            found.append(np.array([ends[0], motor[0], ends[1]]))
        return found

    def shown(self, values: np.ndarray) -> np.ndarray:
        """Positions (…, n) in degrees and mm."""
        return values * np.where(self.slides, 1e3, np.degrees(1.0))

    @property
    def position_unit(self) -> str:
        """Of what is shown."""
        return " or ".join(
            unit for unit, there in (("°", not self.slides.all()), ("mm", self.slides.any())) if there
        )
