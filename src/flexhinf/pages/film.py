"""The film of a run, as GIF or MP4: the arm with links and motors apart, positions, the springs' wind-up, the inputs.

What stands still is drawn once; a frame draws what moves on top of it.
"""

# Not checked strictly: parts of Matplotlib have no types, imageio_ffmpeg has none.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np

from flexhinf.designs.deployed_run import DeployedRun
from flexhinf.errors import refuse_if
from flexhinf.export.realtime import RealTimeRun
from flexhinf.export.run_log import check_place
from flexhinf.files import write_file
from flexhinf.loop.simulation.metrics import peak_of
from flexhinf.numerals import number
from flexhinf.pages.design.step import viewing_plane
from flexhinf.pages.drawing import DOTTED, framed, line_style
from flexhinf.report import GRID, INK, MUTED, SERIES, LineStyle, house_style
from flexhinf.robot.kinematics import magnification, skeleton
from flexhinf.robot.signals import signal_names
from flexhinf.validation import checked_path, install_advice, optional_package

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle
    from matplotlib.text import Text


#: By ending: frames per second and pixels of an inch, of a picture of 12.8 by 7.2 inches.
FORMATS = {".mp4": (30, 100), ".gif": (20, 75)}


def check_film(path: str | os.PathLike[str]) -> Path:
    """Refuse with `InvalidInput`, before any work, a film that could not be written at its end: another ending, an
    encoder that is missing, a place that cannot be written."""
    path = checked_path("The film", path)
    gif = f"--record {path.stem or 'arm'}.gif"
    refuse_if(
        path.suffix not in FORMATS,
        "The format of the film is not known.",
        f"expected a name that ends with {' or '.join(FORMATS)}, got {str(path)!r}",
        gif,
    )
    refuse_if(
        path.suffix == ".mp4" and _encoder() is None,
        "A film in MP4 needs an encoder.",
        f"expected the program ffmpeg or the package 'imageio-ffmpeg', found neither, for {path.name}",
        f"{install_advice('video')}; or {gif}",
    )
    return check_place(path, "film")


def write_film(prepared: DeployedRun, run: RealTimeRun, path: str | os.PathLike[str]) -> Path:
    """Write the film of a run, whole or not at all; its ending says the format.

    Raises InvalidInput: as `check_film`; for a robot whose links have no length; if the encoder fails.
    """
    path = check_film(path)
    rate, resolution = FORMATS[path.suffix]
    film = ArmFilm(prepared, run)

    def write(name: str) -> None:
        pictures = frames(film, rate, resolution)
        if path.suffix == ".mp4":
            return _write_mp4(name, pictures, rate)
        from PIL import Image

        plain = Image.Dither.NONE  # with the colours of the first frame, so that nothing flickers
        first = Image.fromarray(next(pictures)).quantize(128, dither=plain)
        others = (Image.fromarray(frame).quantize(palette=first, dither=plain) for frame in pictures)
        return first.save(
            name,
            "GIF",
            save_all=True,
            append_images=others,
            duration=round(1000 / rate),
            loop=0,
            optimize=False,
        )

    write_file(path, "film", write)
    return path


def _write_mp4(name: str, pictures: Iterator[np.ndarray], rate: int) -> None:
    first = next(pictures)
    height, width, _ = first.shape
    command = [
        str(_encoder()),
        "-y",
        "-loglevel",
        "error",
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        f"{width}x{height}",
        "-r",
        str(rate),
        "-i",
        "-",
        "-c:v",
        "libx264",
        "-crf",
        "18",
        "-pix_fmt",
        "yuv420p",
        "-movflags",
        "+faststart",
        "-f",
        "mp4",
        name,
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as encoder:
        pipe, messages = cast(IO[bytes], encoder.stdin), cast(IO[bytes], encoder.stderr)
        with suppress(BrokenPipeError):
            for frame in chain((first,), pictures):
                pipe.write(frame.tobytes())
            pipe.close()
        errors = messages.read().decode(errors="replace")
    if encoder.returncode:
        raise OSError(f"ffmpeg: {errors.strip()[:200]}")


def _encoder() -> str | None:
    """The program ffmpeg, or that of the package imageio-ffmpeg; None where there is neither."""
    if path := shutil.which("ffmpeg"):
        return path
    package: Any = optional_package("imageio_ffmpeg")
    try:
        return None if package is None else package.get_ffmpeg_exe()
    except RuntimeError:  # the package for this system brings none
        return None


class ArmFilm:
    """Data of a run for its film; one without samples, or of links without a length, is refused with `InvalidInput`.

    `time` (N,) in s; positions (N, n) of `links`, `motors` (seen from the link side) and `command` in rad or m, and
    `windup`, motor minus link, which is drawn `factor` times larger; `inputs` (N, n) in `unit`, and their `limits`
    (n,), infinite where there are none. `scale` (n,) turns positions into degrees and mm. `extent`: points of the arm
    (K, 3) at some poses of the run and at its commands; `size` of the space that it takes, m; `plane`: two directions
    (3, 2) to project on, and their `names`.
    """

    def __init__(self, prepared: DeployedRun, run: RealTimeRun) -> None:
        self.robot, n, trajectory = prepared.robot, len(prepared.robot.joint_names), run.trajectory
        state, inputs = trajectory.signals["state"], trajectory.signals["input"]
        bad = np.flatnonzero(~np.isfinite(np.hstack([state, inputs])).all(axis=1))
        kept = slice(0, int(bad[0]) if len(bad) else len(state))  # until the loop diverged
        refuse_if(not kept.stop, "There is nothing to film.", "expected one sample at least", "a longer run")
        commanded = trajectory.names.get("reference", ())
        columns = [
            trajectory.signal("reference", name) if name in commanded else np.full(len(state), goal)
            for name, goal in zip(signal_names("link_position", self.robot.joint_names), prepared.goal)
        ]
        self.title = f"{self.robot.name}: {'step' if prepared.plan is None else 'move'}"
        self.time, self.links, self.inputs = trajectory.time[kept], state[kept, :n], inputs[kept]
        self.command = np.stack(columns, axis=1)[kept]
        self.motors = self.robot.layout.relaxed(state.T).T[kept]
        self.windup, self.limits = self.motors - self.links, np.maximum(*np.abs(run.input_range))
        self.unit = " or ".join(dict.fromkeys(trajectory.units["input"]))
        self.slides = np.array(self.robot.links.slides, dtype=bool)
        kinds = (("°", ~self.slides), ("mm", self.slides))
        self.position_unit = " or ".join(unit for unit, there in kinds if there.any())
        rows = np.linspace(0, kept.stop - 1, min(kept.stop, 40)).astype(int)
        poses = [*self.links[rows], *self.command[rows[[0, -1]]]]
        self.extent = np.concatenate([line for pose in poses for line in skeleton(self.robot, pose)])
        self.size = float(np.ptp(self.extent, axis=0).max())
        refuse_if(
            self.size < 1e-9,
            "The arm cannot be drawn: its links have no length.",
            f"expected a robot with joints or centres of mass apart, got {self.robot.name!r}",
            "the run without --record",
        )
        self.factor = magnification(self.windup, self.slides, self.size)
        self.plane, self.names = viewing_plane(self.robot, self.extent, self.size)
        self.scale = np.where(self.slides, 1e3, np.degrees(1.0))

    def arm(self, pose: np.ndarray) -> list[np.ndarray]:
        """The links at a pose (n,), as lines on the picture."""
        return [line @ self.plane for line in skeleton(self.robot, pose)]

    def hands(self, k: int) -> list[np.ndarray]:
        """For each joint three points at sample k: on its link, the joint, and on its motor's hand."""
        hands, own = list[np.ndarray](), self.arm(self.links[k])
        for j, turned in enumerate(self.factor * self.windup[k]):
            pose = self.links[k].copy()
            pose[j] += turned
            motor = self.arm(pose)[j]
            # a motor's hand is a part of its link
            ends = [line[0] + 0.62 * (line[1] - line[0]) for line in (own[j], motor)]
            hands.append(np.array([ends[0], motor[0], ends[1]]))
        return hands


#: A film lasts so many seconds; a run that is shorter or longer is played more slowly or faster, and the title says so.
SHORTEST, LONGEST = 3.0, 60.0

#: With more joints than these, lines show how far the links are from their command, which would else be flat.
MANY = 3

#: Place of the arm on the picture: left, bottom, width, height, as parts of it; and its width and height, inches.
PLACE, PICTURE = (0.07, 0.085, 0.435, 0.76), (12.8, 7.2)

#: Where the bar of an input is zero, and its length on either side, as parts of the table's width.
ZERO, BAR = 0.75, 0.13

#: What moves in a part of the picture, in the order of drawing, and the function that moves it to a sample.
Moving: TypeAlias = "tuple[Sequence[Artist], Callable[[int], None]]"


def frames(film: ArmFilm, rate: int, resolution: int) -> Iterator[np.ndarray]:
    """Pictures (height, width, 3) of bytes, `rate` of them a second, with `resolution` pixels to an inch of `PICTURE`;
    the last one is the end of the run. What stands still is drawn once."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    length, n = float(film.time[-1]), len(film.slides)
    played = min(max(length, SHORTEST), LONGEST)
    slowness, speed = played / length if length else 1.0, "in real time"
    if abs(slowness - 1.0) >= 1e-6:
        speed = f"{number(max(slowness, 1.0 / slowness), 2)} times {'slower' if slowness > 1.0 else 'faster'}"
    larger = f"{film.factor} times larger" if film.factor > 1 else "as it is"
    rows = (0.055 if n <= MANY else 0.042) * max(n, 2) + 0.05
    low, high = 0.10 + rows, 0.86
    middle = low + 0.42 * (high - low)
    what = f"{'position' if film.slides.any() else 'angle'} of the links"
    positions = what, film.links, film.command * film.scale
    if n > MANY:
        positions = "links minus their command", film.links - film.command, None
    with house_style():
        figure = Figure(figsize=PICTURE, dpi=resolution, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        figure.text(0.035, 0.945, film.title, fontsize=17, weight="bold", va="center")
        figure.text(
            0.035,
            0.905,
            f"wind-up of the springs drawn {larger}; played {speed}",
            fontsize=10.5,
            color=MUTED,
            va="center",
        )
        clock = figure.text(0.965, 0.935, "", ha="right", va="center", family="DejaVu Sans Mono", fontsize=20)
        arm = _draw_arm(figure.add_axes(PLACE), film)
        above = figure.add_axes((0.575, middle + 0.045, 0.39, high - middle - 0.045))
        below = figure.add_axes((0.575, low + 0.035, 0.39, middle - low - 0.04))
        lines = (
            _draw_lines(above, film, *positions),
            _draw_lines(below, film, "wind-up of the springs", film.windup),
        )
        above.set_xticklabels([])
        below.set_xlabel("time (s)", fontsize=9.5)
        parts = (arm, *lines, _draw_table(figure.add_axes((0.575, 0.035, 0.39, rows)), film))
        moving = [clock, *(artist for artists, _ in parts for artist in artists)]
        for artist in moving:
            artist.set_animated(True)
        canvas.draw()
        still = cast("object", canvas.copy_from_bbox(figure.bbox))
        renderer = canvas.get_renderer()
        for k in (
            np.linspace(0, len(film.time) - 1, max(2, round(played * rate))).round().astype(int).tolist()
        ):
            canvas.restore_region(still)
            clock.set_text(f"{film.time[k]:6.2f} s")
            for _, move in parts:
                move(k)
            for artist in moving:
                artist.draw(renderer)
            yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _draw_arm(axes: Axes, film: ArmFilm) -> Moving:
    flat = film.extent @ film.plane
    middle, reach = 0.5 * (flat.max(axis=0) + flat.min(axis=0)), np.ptp(flat, axis=0)
    box = np.array(PLACE[2:]) * PICTURE
    half = 0.5 * max((reach + 0.2 * film.size) / box) * box  # as much to the inch in both directions
    (left, low), (right, high) = middle - half, middle + half
    axes.set(facecolor="#fbfcfd", xlim=(left, right), ylim=(low, high))
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, labelsize=8)
    axes.set_xlabel(f"{film.names[0]} (m)", fontsize=9)
    axes.set_ylabel(f"{film.names[1]} (m)", fontsize=9)
    first, dashes = film.arm(film.links[0]), (0, (3.0, 1.6))
    axes.plot(*first[0][0], "s", color=MUTED, markersize=15, zorder=1, alpha=0.5)

    def line(
        colour: str,
        width: float,
        zorder: int,
        alpha: float | None = None,
        style: str | tuple[float, tuple[float, float]] = "-",
    ) -> Line2D:
        return axes.plot([], [], color=colour, linewidth=width, zorder=zorder, alpha=alpha, linestyle=style)[
            0
        ]

    goal = [line(SERIES[2], 2.2, 2, alpha=0.55, style=dashes) for _ in first]
    (aim,) = axes.plot([], [], "o", color=SERIES[2], markersize=17, mfc="none", mew=2.2, zorder=2)
    trail = line(SERIES[0], 1.4, 2, alpha=0.35)
    fans = [axes.fill([0, 0, 0], [0, 0, 0], color=SERIES[1], alpha=0.25, zorder=3, lw=0)[0] for _ in first]
    links = [line(SERIES[0], width, 4, alpha=0.9) for width in np.linspace(9.0, 5.0, len(first)).tolist()]
    motors = [line(SERIES[1], 2.6, 5) for _ in first]
    (joints,) = axes.plot([], [], "o", color=INK, markersize=7, mfc="white", mew=1.8, zorder=6)
    for name, colour, width, style in (
        ("link", SERIES[0], 5.0, "-"),
        ("motor, behind its spring", SERIES[1], 2.6, "-"),
        ("command", SERIES[2], 2.2, dashes),
    ):
        axes.plot([], [], color=colour, linewidth=width, linestyle=style, label=name)
    axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 0.995), ncols=3, fontsize=9.5, handlelength=1.8)

    def move(k: int) -> None:
        own, wanted = film.arm(film.links[k]), film.arm(film.command[k])
        for artist, points in zip((*links, *goal), (*own, *wanted), strict=True):
            artist.set_data(*points.T)
        for fan, motor, points in zip(fans, motors, film.hands(k), strict=True):
            fan.set_xy(points)
            motor.set_data(*points[1:].T)
        joints.set_data(*np.array([points[0] for points in own]).T)
        aim.set_data(*wanted[-1][-1:].T)
        # The last second.
        past = np.linspace(int(np.searchsorted(film.time, float(film.time[k]) - 1.0)), k, 24).astype(int)
        trail.set_data(*np.array([film.arm(film.links[i])[-1][-1] for i in past]).T)

    return [*goal, aim, trail, *fans, *links, *motors, joints], move


def _draw_lines(
    axes: Axes, film: ArmFilm, quantity: str, positions: np.ndarray, command: np.ndarray | None = None
) -> Moving:
    values, few = positions * film.scale, max(1, len(film.time) // 800)
    artists: list[Line2D] = []
    single = values.shape[1] == 1
    for j, column in enumerate(values.T):
        style = line_style(j)
        if single:
            style["color"] = SERIES[0 if command is not None else 1]
        faint: LineStyle = {**style, "alpha": 0.22}
        bold: LineStyle = {**style, "linewidth": 2.0}
        axes.plot(film.time[::few], column[::few], **faint)
        artists += axes.plot([], [], **bold)
        artists += axes.plot([], [], "o", color=style["color"], markersize=4.5)
        if command is not None:
            dotted: LineStyle = {
                "color": SERIES[2] if single else style["color"],
                "linewidth": 1.2,
                "linestyle": DOTTED,
            }
            axes.plot(film.time[::few], command[::few, j], **dotted)
    axes.set_title(f"{quantity} ({film.position_unit})", fontsize=10.5)
    axes.set_xlim(0.0, max(float(film.time[-1]), 1e-9))
    axes.set_ylim(*framed(values if command is None else np.concatenate([values, command]), 0.1))
    axes.tick_params(labelsize=8.5)

    def move(k: int) -> None:
        for line, dot, column in zip(artists[::2], artists[1::2], values.T, strict=True):
            line.set_data(film.time[: k + 1 : few], column[: k + 1 : few])
            dot.set_data(film.time[k : k + 1], column[k : k + 1])

    return artists, move


def _draw_table(axes: Axes, film: ArmFilm) -> Moving:
    n, peaks = len(film.slides), peak_of(film.inputs)
    full = np.where(np.isfinite(film.limits), film.limits, np.where(peaks > 0.0, peaks, 1.0))
    axes.set_axis_off()
    axes.set(xlim=(0.0, 1.0), ylim=(n - 0.4, -1.0))
    most = "limit" if np.isfinite(film.limits).all() else "peak"
    heads = ("joint", "link", "motor", "wind-up", f"input ({film.unit}), bar up to its {most}")
    places, alignments = (0.0, 0.27, 0.42, 0.57, 0.62), ("left", "right", "right", "right", "left")
    for head, x, side in zip(heads, places, alignments, strict=True):
        axes.text(x, -0.75, head, ha=side, va="center", fontsize=8.5, color=MUTED)
    rows: list[tuple[Rectangle, list[Text]]] = []
    for j, name in enumerate(film.robot.joint_names):
        colour = SERIES[0] if n == 1 else line_style(j)["color"]
        short = name if len(name) <= 14 else f"{name[:13]}…"
        axes.text(0.0, j, short, va="center", fontsize=9.5, weight="bold", color=colour)
        axes.barh(j, 2.0 * BAR, 0.5, ZERO - BAR, color=GRID, zorder=1)
        axes.plot([ZERO, ZERO], [j - 0.32, j + 0.32], color=MUTED, linewidth=1.0, zorder=3)
        bar = axes.barh(j, 0.0, 0.5, ZERO, color=SERIES[3], zorder=2).patches[0]
        texts = [axes.text(x, j, "", ha="right", va="center", fontsize=9.5) for x in (*places[1:4], 1.0)]
        rows.append((bar, texts))

    def move(k: int) -> None:
        columns = [values[k] * film.scale for values in (film.links, film.motors, film.windup)]
        for j, (bar, (*texts, last)) in enumerate(rows):
            unit, u = " mm" if film.slides[j] else "°", float(film.inputs[k, j])
            for text, values, decimals in zip(texts, columns, (2, 2, 3), strict=True):
                text.set_text(f"{number(float(values[j]), decimals=decimals)}{unit}")
            bar.set_width(BAR * float(np.clip(u / full[j], -1.0, 1.0)))
            last.set_text(number(u, decimals=2 if full[j] < 100.0 else 1))

    return [artist for bar, texts in rows for artist in (bar, *texts)], move
