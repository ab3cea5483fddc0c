"""Report of a run of a deployed controller: deadlines and requirements; its film as GIF or MP4."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from flexhinf.design.deployed_run import DeployedRun
from flexhinf.design.responses import Move, worst_of
from flexhinf.errors import InvalidInput
from flexhinf.export.realtime import PERCENTILES, RealTimeRun, Timing, percentiles
from flexhinf.export.run_log import check_place
from flexhinf.files import write_file
from flexhinf.pages.arm_picture import ArmFilm, frames
from flexhinf.pages.design.requirements import requirement_table
from flexhinf.pages.drawing import Units, count_text, rounded, settling_text
from flexhinf.report import Column, Table, number
from flexhinf.validation import checked_path

#: By ending: frames per second and pixels of an inch, of a picture of 12.8 by 7.2 inches.
FORMATS = {".mp4": (30, 100), ".gif": (20, 75)}

#: Places of missed deadlines that are listed, the latest first.
LISTED = 5

#: A run that takes this many times its own time did not keep up, beyond single late samples.
SLOW = 1.01

#: Rows of the table of times: what, and the array of `Timing`.
ROWS = {
    "lateness of the beginning": "woken", "step of the controller": "computed", "input is there": "ready",
    "simulated robot is done": "over",
}  # fmt: skip


def run_met(prepared: DeployedRun, run: RealTimeRun) -> bool:
    """Whether a run met every requirement and came to its end."""
    return not run.trajectory.message and all(line.met for line in prepared.requirements(run))


def run_tables(prepared: DeployedRun, run: RealTimeRun) -> list[Any]:
    """Tables of the requirements, of the metrics of each joint, and of the times of the samples."""
    timing, tables = run.timing, list[Table]()
    if not run.trajectory.message and len(run.trajectory.time):
        units = Units.of(prepared.plants.model, prepared.robot.joint_names, prepared.specification.in_degrees)
        if run.stopped is None:
            title = f"{prepared.robot.name}: what is required of this run (* our default)"
            tables.append(requirement_table(prepared.requirements(run), units.degrees, title))
        tables.append(_joints(prepared, run, units))
    if tables or len(timing.time):
        rows = [
            (name, *(1e6 * value for value in percentiles(getattr(timing, field)).values()))
            for name, field in (
                ROWS if timing.real_time else {"step of the controller": "computed", "whole sample": "over"}
            ).items()
        ]
        columns = ("", *(Column(name, decimals=1) for name in PERCENTILES))
        tables.append(Table(columns, rows, f"Times in µs; the period has {number(1e6 * timing.period)} µs"))
    return [table.terminal() for table in tables]


def _joints(prepared: DeployedRun, run: RealTimeRun, units: Units) -> Table:
    (small, factor), response = units.small, prepared.response(run)
    rows, title = response.metrics, "Joints"
    columns = (
        Column("settled after", key="settled", right=True), Column("overshoot", "%", digits=3, key="overshoot_percent"),
        Column("end error", small, digits=3, key="steady_state_error", scale=factor),
    )  # fmt: skip
    if prepared.plan is not None:
        rows, title = Move.along(prepared.plan, response).metrics, f"Joints: distance from the move, {small}"
        errors = {"largest": "largest_error", "rms": "rms_error", "at the end": "final_error"}
        columns = tuple(Column(name, digits=3, key=key, scale=factor) for name, key in errors.items())
    rows = [
        {**row, "settled": settling_text(row["settling_time_s"]) if "settling_time_s" in row else None}
        for row in rows
    ]
    return Table.of(
        (Column("joint", key="joint"), *columns, Column("peak", units.effort, digits=3, key="peak_input")),
        rows,
        title,
    )


# Sentences ------------------------------------------------------------------------------------------
def run_verdict(prepared: DeployedRun, run: RealTimeRun) -> str:
    """Verdict on a run: deadlines first, then what the robot did."""
    text = _real_time(run.timing)
    if run.trajectory.message:
        return f"{text} {run.trajectory.message}"
    if run.stopped is not None:
        return f"{text} Stopped at {number(run.trajectory.time[-1] if len(run.trajectory.time) else 0.0)} s."
    response, several = prepared.response(run), len(prepared.robot.joint_names) > 1
    units = Units.of(prepared.plants.model, prepared.robot.joint_names, prepared.specification.in_degrees)

    def named(text: str, joint: str) -> str:
        return f"{text} ({joint})" if several and joint else text

    effort = named(f"{number(response.peak.value, 3)} {units.effort}", response.peak.joint)
    if prepared.plan is not None:
        worst = worst_of(Move.along(prepared.plan, response).metrics, "largest_error")
        error = f"{number(units.scale * worst.value, 3)}{'' if units.degrees else ' '}{units.angle}"
        return f"{text} The move was followed within {named(error, worst.joint)} and needed at most {effort}."
    settling, overshoot = response.settling, response.overshoot
    settled = f"did not settle ({settling.joint})"
    if np.isfinite(settling.value):
        settled = f"settled in {named(settling_text(settling.value), settling.joint)}"
    over = named(f"{number(overshoot.value, 2)} %", overshoot.joint)
    return f"{text} The step {settled}, overshot by {over} and needed at most {effort}."


def _real_time(timing: Timing) -> str:
    count, rate = len(timing.time), number(1.0 / timing.period)
    if not count:
        return "The run was stopped before its first sample."
    length = number(timing.period * (count - 1))
    elapsed, missed = number(timing.elapsed, 3), int(timing.missed.sum())
    if not timing.real_time:
        return f"Not in real time: {count} samples of a loop at {rate} Hz, {length} s, in {elapsed} s."
    if timing.slowness > SLOW:
        step, robot = (
            number(1e3 * float(np.median(part)), 2) for part in (timing.computed, timing.over - timing.ready)
        )
        return (
            f"Real time was not kept: {length} s took {elapsed} s. Of a period of {number(1e3 * timing.period)} ms the "
            f"controller's step takes {step} ms and the simulated robot {robot} ms (medians)."
        )
    if not missed:
        return f"Every deadline was met: {count} samples at {rate} Hz in {number(timing.elapsed)} s."
    return (
        f"{missed} of {count} deadlines were missed ({number(100.0 * missed / count, 2)} %), the latest input by "
        f"{number(1e3 * timing.missed_spans()[0].worst, 2)} ms: {length} s of a loop at {rate} Hz took "
        f"{number(timing.elapsed)} s."
    )


def run_notes(run: RealTimeRun) -> list[str]:
    """Notes on missed deadlines, on values that the controller refused, and on what the operating system permitted."""
    notes, spans = list(run.scheduling), run.timing.missed_spans() if run.timing.real_time else []
    if spans and run.timing.slowness <= SLOW:
        places = [
            f"at {number(rounded(span.begin, 4) or 0.0)} s ({count_text(span.samples, 'sample')}, up to "
            f"{number(1e3 * span.worst, 2)} ms)"
            for span in spans[:LISTED]
        ]
        more = f", and {len(spans) - LISTED} more places" if len(spans) > LISTED else ""
        notes.append(f"Missed deadlines: {', '.join(places)}{more}.")
    if spans and not run.scheduling:
        notes.append(
            "A real-time priority and a core of its own keep other programs off: --priority 80 --core 1."
        )
    return notes + [
        f"The controller's step ended with {run.code_names[int(code)]} in {int(np.sum(run.codes == code))} samples."
        for code in np.unique(run.codes)
        if code
    ]


# Film ------------------------------------------------------------------------------------------------
def check_film(path: str | os.PathLike[str]) -> Path:
    """Refuse with `InvalidInput`, before any work, a film that could not be written at its end: another ending, an
    encoder that is missing, a place that cannot be written."""
    path = checked_path("The film", path)
    gif = f"--record {path.stem or 'arm'}.gif"
    if path.suffix not in FORMATS:
        got = f"expected a name that ends with {' or '.join(FORMATS)}, got {str(path)!r}"
        raise InvalidInput("The format of the film is not known.", got, gif)
    if path.suffix == ".mp4" and _encoder() is None:
        got = f"expected the program ffmpeg or the package 'imageio-ffmpeg', found neither, for {path.name}"
        raise InvalidInput("A film in MP4 needs an encoder.", got, f"pip install 'flexhinf[video]', or {gif}")
    return check_place(path, "film")


def write_film(prepared: DeployedRun, run: RealTimeRun, path: str | os.PathLike[str]) -> Path:
    """Write the film of a run, whole or not at all; its ending says the format.

    Raises
    ------
    InvalidInput
        As `check_film`; for a robot whose links have no length; if the encoder fails.
    """
    path = check_film(path)
    rate, resolution = FORMATS[path.suffix]
    film = ArmFilm.of(prepared, run)

    def write(name: str) -> None:
        pictures = frames(film, rate, resolution)
        if path.suffix == ".mp4":
            return _write_mp4(name, pictures, rate)
        from PIL import Image

        plain = Image.Dither.NONE  # with the colours of the first frame, so that nothing flickers
        first = Image.fromarray(next(pictures)).quantize(128, dither=plain)
        others = (Image.fromarray(frame).quantize(palette=first, dither=plain) for frame in pictures)
        options: dict[str, Any] = {"duration": round(1000 / rate), "loop": 0, "optimize": False}
        return first.save(name, "GIF", save_all=True, append_images=others, **options)

    write_file(path, "film", write)
    return path


def _write_mp4(name: str, pictures: Iterator[np.ndarray], rate: int) -> None:
    first = next(pictures)
    height, width, _ = first.shape
    command = [
        str(_encoder()), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", str(rate), "-i", "-", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart",
        "-f", "mp4", name,
    ]  # fmt: skip
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
    if path := shutil.which("ffmpeg"):
        return path
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return None
