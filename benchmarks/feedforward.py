"""What vibration moves without feedback leave, by how their commands are computed.

    python -m benchmarks.feedforward               makes the rows that are missing, and keeps each when it is whole
    python -m benchmarks.feedforward --table       prints the table of docs/real_loop.md from the rows that are kept

The robot is ``planar-two-link`` with position drives of 20 Hz at 250 Hz. Moves between random poses end after the same
time, commands included, whatever computes them. A robot that is not as stated starts where the first command holds it.
It is simulated by MuJoCo, whose actuators are the drives. What remains is the largest of the links' swings, peak to
peak, over a time after the end of the command; the largest rate of the commands stands beside it.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before NumPy is imported
    os.environ.setdefault(_name, "1")

import argparse  # noqa: E402
import itertools  # noqa: E402
import sys  # noqa: E402
from collections.abc import Callable, Mapping  # noqa: E402
from functools import cached_property  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import NamedTuple  # noqa: E402

import numpy as np  # noqa: E402

import flexhinf as fh  # noqa: E402
from benchmarks.drives import SLOWER, keep, kept_in, servo  # noqa: E402
from flexhinf.robot import MuJoCoPlant, Robot  # noqa: E402
from flexhinf.robot.kinematics import position_ranges  # noqa: E402
from flexhinf.robot.shaper import shaped_by, vibration_frequencies  # noqa: E402

#: The rows that the docs show.
KEPT = Path(__file__).with_suffix(".json")

NAME, BANDWIDTH, PERIOD, SMOOTHING = "planar-two-link", 20.0, 4e-3, 0.02

#: Whole times of moves, s; time after them in which vibration is measured, s; pose whose vibration is the slowest.
TIMES, AFTER, WORST = (0.7, 1.0, 1.4), 1.2, (0.0, 0.0)

#: Share of the joints' ranges in which poses are drawn; shortest and longest way of the joint that goes farthest, rad.
SHARE, WAYS, SEED = 0.8, (0.5, 1.6), 5

#: Factors of stiffness, mass and the drives' bandwidth of robots that are not as stated.
ROBOTS = {
    "as stated": (1.0, 1.0, 1.0),
    "springs 20 % softer": (0.8, 1.0, 1.0),
    "springs 20 % stiffer": (1.2, 1.0, 1.0),
    "masses 10 % larger": (1.0, 1.1, 1.0),
    "drives 30 % slower": (1.0, 1.0, SLOWER),
}


class Move(NamedTuple):
    """From one pose to another within a time, s."""

    start: np.ndarray
    goal: np.ndarray
    time: float

    def polynomial(self, less: float) -> np.ndarray:
        """A path of fifth degree that is shorter than the move by a time, and then rests."""
        s = np.clip(self._times / (self.time - less), 0.0, 1.0)
        return self.start + np.outer(s**3 * (10.0 - 15.0 * s + 6.0 * s**2), self.goal - self.start)

    def jerk_limited(self) -> np.ndarray:
        """The path with the smallest largest jerk: constant in each eighth, as of a step through three averages."""
        count = round(self.time / PERIOD)
        kernel = np.ones(1)
        for length in (count // 2, count // 4, count // 4):
            kernel = np.convolve(kernel, np.full(length, 1.0 / length))
        way = np.cumsum(np.concatenate([kernel, np.zeros(len(self._times))]))[: len(self._times)]
        return self.start + np.outer(way, self.goal - self.start)

    @property
    def _times(self) -> np.ndarray:
        return PERIOD * np.arange(round((self.time + AFTER) / PERIOD))


class Commands:
    """The ways to compute commands of a move, of a robot as it is stated."""

    def __init__(self) -> None:
        self.robot = servo(fh.load_robot(NAME), "position", (BANDWIDTH,))
        self.slowest = vibration_frequencies(self.robot, np.array([WORST]))
        self.shaping = float((1.0 / self.slowest).sum())  # time that shaping adds to a move, s

    @cached_property
    def short(self) -> fh.Feedforward:
        """Feedforward with the usual smoothing."""
        return fh.Feedforward(self.robot, PERIOD, SMOOTHING)

    @cached_property
    def long(self) -> fh.Feedforward:
        """Feedforward that is as late as with shaping: splines of the whole length."""
        length = round((self.shaping / 6.0 + SMOOTHING) / PERIOD) * PERIOD
        return fh.Feedforward(self.robot, PERIOD, length)

    def ways(self) -> dict[str, Callable[[Move], np.ndarray]]:
        """Commands (N, n) of a move, rad, by way."""
        short, long, ends = self.short, self.long, 2.0 * self.short.delay
        return {
            "feedforward": lambda move: short.rows(move.polynomial(ends)).command,
            "feedforward, smoothing as late": lambda move: (
                long.rows(move.polynomial(2.0 * long.delay)).command
            ),
            "shaped, fixed periods, feedforward": lambda move: (
                short.rows(shaped_by(self._fixed(move), move.polynomial(ends + self.shaping), PERIOD)).command
            ),
            "shaped by pose, feedforward": lambda move: (
                short.rows(short.shaped(move.polynomial(ends + self.shaping))).command
            ),
            "ZVD at the slowest pose": lambda move: self._static(
                shaped_by(self._fixed(move)[:, :1], move.polynomial(1.0 / self.slowest[0, 0]), PERIOD)
            ),
            "jerk-limited": lambda move: self._static(move.jerk_limited()),
        }

    def _fixed(self, move: Move) -> np.ndarray:
        return np.repeat(self.slowest, round((move.time + AFTER) / PERIOD), axis=0)

    def _static(self, path: np.ndarray) -> np.ndarray:
        """Commands that hold the arm at each pose: springs' twist and weight, no acceleration."""
        still = np.zeros_like(path)
        return self.robot.inverse_dynamics(path, still, still, still, still)[1]


def moves(robot: Robot, count: int, time: float) -> list[Move]:
    """Random moves between poses of the robot's ranges."""
    rng, drawn = np.random.default_rng(SEED), list[Move]()
    low, high = SHARE * position_ranges(robot)
    while len(drawn) < count:
        start, goal = rng.uniform(low, high, (2, len(low)))
        if WAYS[0] < np.abs(goal - start).max() < WAYS[1]:
            drawn.append(Move(start, goal, time))
    return drawn


def swings(kind: str, commands: list[np.ndarray], drawn: list[Move]) -> list[float]:
    """What remains after moves of a kind of robot, mrad."""
    from scipy.optimize import root

    stiffness, mass, bandwidth = ROBOTS[kind]
    robot = servo(fh.load_robot(NAME), "position", (BANDWIDTH * bandwidth,))
    true = dict(robot.plant_parameters())
    for name, factor in (("stiffness", stiffness), ("mass", mass), ("inertia", mass)):
        true[name] = factor * np.asarray(true[name], dtype=float)
    plant, left = MuJoCoPlant(robot, None, step=1e-3, parameters=true), []
    for rows, move in zip(commands, drawn, strict=True):
        held = root(lambda q, u=rows[0]: robot.operating_point(q, parameters=true)[1] - u, move.start)
        assert held.success, held.message
        plant.reset(robot.operating_point(held.x, parameters=true)[0])
        links = np.empty_like(rows)
        for k, command in enumerate(rows):
            plant.step(command, np.zeros(0), PERIOD)
            links[k] = plant.state()[: rows.shape[1]]
        after = round(move.time / PERIOD) + 1
        left.append(1e3 * float(np.ptp(links[after:], axis=0).max()))
    return left


def made(way: str, time: float, count: int) -> dict[str, object]:
    """The record of a way: swings, median and largest, of each kind of robot, mrad; largest rate of commands."""
    own = Commands()
    drawn = moves(own.robot, count, time)
    rows = [own.ways()[way](move) for move in drawn]
    rate = max(float(np.abs(np.diff(each, axis=0)).max()) for each in rows) / PERIOD
    record: dict[str, object] = {"moves": count, "rate": round(rate, 2)}
    for kind in ROBOTS:
        left = swings(kind, rows, drawn)
        record[kind] = [float(f"{number:.3g}") for number in (np.median(left), max(left))]
    return record


# Program ------------------------------------------------------------------------------------------
def table(kept: Mapping[str, Mapping[str, object]]) -> str:
    """The rows that are kept, as Markdown."""
    head = ["move", "commands", "largest rate, rad/s", *ROBOTS]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name, record in kept.items():
        time, way = name.split(" s: ")
        pairs = [record[kind] for kind in ROBOTS]
        assert all(isinstance(pair, list) for pair in pairs)
        cells = [
            ", ".join(f"{float(f'{number:.2g}'):g}" for number in pair)
            for pair in pairs
            if isinstance(pair, list)
        ]
        lines.append(f"| {' | '.join([f'{time} s', way, str(record['rate']), *cells])} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Make the rows that are missing, or print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.feedforward", description=__doc__)
    parser.add_argument(
        "--times", nargs="+", type=float, default=TIMES, metavar="S", help="whole times of moves"
    )
    parser.add_argument("--moves", type=int, default=12, help="moves of each row (default: 12)")
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="FILE", help="where the rows are kept")
    parser.add_argument("--table", action="store_true", help="print the table of the rows that are kept")
    given = parser.parse_args(arguments)
    own = Commands()
    shortest = max(own.shaping + 2.0 * own.short.delay, 2.0 * own.long.delay)
    if given.moves < 1 or min(given.times) <= shortest:
        parser.error(f"--moves is at least 1, --times are longer than {shortest:.2f}")
    if given.table:
        print(table(kept_in(given.kept)))
        return 0
    try:
        for time, way in itertools.product(given.times, own.ways()):
            name, kept = f"{time:g} s: {way}", kept_in(given.kept)
            if kept.get(name, {}).get("moves") != given.moves:
                kept[name] = made(way, time, given.moves)
                keep(given.kept, kept)
                print(name, kept[name], flush=True)
    except KeyboardInterrupt:
        print("interrupted; the rows that are whole are kept")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
