"""The film of a run in a file: GIF by Pillow, MP4 by ffmpeg."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from flexhinf.design.deployed_run import DeployedRun
from flexhinf.errors import InvalidInput
from flexhinf.export.realtime import RealTimeRun
from flexhinf.export.run_log import check_place
from flexhinf.files import write_file
from flexhinf.pages.arm_picture import ArmFilm, frames
from flexhinf.validation import checked_path

#: By ending: frames per second and pixels of an inch, of a picture of 12.8 by 7.2 inches.
FORMATS = {".mp4": (30, 100), ".gif": (20, 75)}


def check_film(path: str | os.PathLike[str]) -> Path:
    """Refuse, before any work, a film that could not be written at its end.

    Raises
    ------
    InvalidInput
        For another ending, an encoder that is missing, or a place that cannot be written.
    """
    path = checked_path("The film", path)
    if path.suffix not in FORMATS:
        raise InvalidInput(
            "The format of the film is not known.",
            f"expected a name that ends with {' or '.join(FORMATS)}, got {str(path)!r}",
            f"--record {path.stem or 'arm'}.gif",
        )
    if path.suffix == ".mp4" and _encoder() is None:
        raise InvalidInput(
            "A film in MP4 needs an encoder.",
            f"expected the program ffmpeg or the package 'imageio-ffmpeg', found neither, for {path.name}",
            f"pip install 'flexhinf[video]', or --record {path.stem or 'arm'}.gif",
        )
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
    write = _write_gif if path.suffix == ".gif" else _write_mp4
    write_file(path, "film", lambda name: write(name, frames(film, rate, resolution), rate))
    return path


def _encoder() -> str | None:
    """The program ffmpeg of this system, or that of imageio-ffmpeg."""
    if found := shutil.which("ffmpeg"):
        return found
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return None


def _write_gif(name: str, pictures: Iterator[np.ndarray], rate: int) -> None:
    """With the colours of the first frame, so that nothing flickers."""
    from PIL import Image

    first = Image.fromarray(next(pictures)).quantize(128, dither=Image.Dither.NONE)
    others = (Image.fromarray(frame).quantize(palette=first, dither=Image.Dither.NONE) for frame in pictures)
    first.save(
        name, "GIF", save_all=True, append_images=others, duration=round(1000 / rate), loop=0, optimize=False
    )  # fmt: skip


def _write_mp4(name: str, pictures: Iterator[np.ndarray], rate: int) -> None:
    first = next(pictures)
    height, width, _ = first.shape
    words = [
        str(_encoder()), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", str(rate), "-i", "-", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart",
        "-f", "mp4", name,
    ]  # fmt: skip
    with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        assert encoder.stderr is not None
        try:
            encoder.stdin.write(first.tobytes())
            for frame in pictures:
                encoder.stdin.write(frame.tobytes())
            encoder.stdin.close()
        except BrokenPipeError:
            pass
        told = encoder.stderr.read().decode(errors="replace")
    if encoder.returncode:
        raise OSError(f"ffmpeg: {told.strip()[:200]}")
