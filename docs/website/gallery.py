"""The gallery: examples in groups, as sphinx-gallery wants them, and a scraper of their figures, which checks them."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Iterable
from functools import wraps
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from website import truths
from website.contents import EXAMPLES

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples"


def group_of(stem: str) -> str:
    """The group of an example."""
    return next((name for name, (_, _, stems) in EXAMPLES.items() if stem in stems), "more")


def label_of(stem: str) -> str:
    """The label that sphinx-gallery gives to the page of an example."""
    return f"sphx_glr_gallery_{group_of(stem)}_{stem}.py"


def _copy(text: str, path: Path) -> None:
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def titled(text: str, stem: str) -> str:
    """The program with a title in its docstring: that of its file's name where it has none."""
    first, _, rest = text.partition("\n")
    if re.match(r'"""\n?[^\n]*\n[=-]{3,}\n', text) or not first.startswith('"""'):
        return text
    title = stem.replace("_", " ").capitalize()
    return f'"""\n{title}\n{"=" * len(title)}\n\n{first.removeprefix(chr(34) * 3)}\n{rest}'


def left_behind(folder: Path, stems: Iterable[str]) -> list[Path]:
    """What a folder of staged examples has beside these."""
    staged = {"GALLERY_HEADER.rst", *(f"{stem}.py" for stem in stems)}
    return [file for file in folder.iterdir() if file.name not in staged]


def stage(folder: Path) -> Path:
    """Copy the examples into a folder with one subfolder a group; what is as before is not touched.

    Returns
    -------
    Path
        The folder.
    """
    wanted: dict[str, list[Path]] = {}
    for file in sorted(FOLDER.glob("*.py")):
        wanted.setdefault(group_of(file.stem), []).append(file)
    for old in folder.glob("*/"):
        if old.name not in wanted:
            shutil.rmtree(old)
    for name, files in wanted.items():
        part = folder / name
        part.mkdir(parents=True, exist_ok=True)
        for old in left_behind(part, [file.stem for file in files]):
            old.unlink() if old.is_file() else shutil.rmtree(old)
        title, sentence, _ = EXAMPLES[name]
        _copy(f"{title}\n{'-' * len(title)}\n\n{sentence}\n", part / "GALLERY_HEADER.rst")
        for file in files:
            _copy(titled(file.read_text(encoding="utf-8"), file.stem), part / file.name)
    title = "Gallery"
    sentence = (
        "Programs with their figures, run when this site is built; also as programs and notebooks to download. "
        "Arms that move in the browser are on the page :doc:`/live`."
    )
    _copy(f"{title}\n{'=' * len(title)}\n\n{sentence}\n", folder / "GALLERY_HEADER.rst")
    return folder


def by_group(folder: str) -> int:
    """Sort key of the groups: position of the folder of one."""
    return list(EXAMPLES).index(Path(folder).name)


def by_position(file: str) -> tuple[int, str]:
    """Sort key of the examples of a group."""
    stem = Path(file).stem
    stems = EXAMPLES[group_of(stem)][2]
    return (stems.index(stem) if stem in stems else len(stems), file)


#: Figures that an example has saved by itself, in a function for instance, and what it has printed.
_SAVED: list[Figure] = []
_PRINTED: list[str] = []


def note_figures_and_output() -> None:
    """From now on a figure that is saved, and what an example prints, is noted for `scrape_figures`."""
    from sphinx_gallery.gen_rst import _LoggingTee

    save, write = Figure.savefig, _LoggingTee.write

    @wraps(save)
    def noted(self: Figure, *arguments: Any, **options: Any) -> Any:
        _SAVED.append(self)
        return save(self, *arguments, **options)

    @wraps(write)
    def heard(self: _LoggingTee, data: str) -> None:
        _PRINTED.append(data)
        write(self, data)

    Figure.savefig, _LoggingTee.write = noted, heard


def thumbnail(path: Path) -> str:
    """The picture of examples that print numbers alone; it is drawn into a file."""
    figure = Figure(figsize=(4, 2.8), facecolor="0.96")
    look = {"ha": "center", "va": "center", "size": 22, "family": "monospace", "color": "0.45"}
    figure.text(0.5, 0.5, "1.234 rad\n0.56 s\n7.8 N·m", **look)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    return str(path)


def scrape_figures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any], **_: Any) -> str:
    """Save the figures of pyplot, those in global names of the example, and those that it saved; each is shown once.

    After the last block what the example says is checked: an error here is one of the example.

    Returns
    -------
    str
        RST of the figures of one block.
    """
    from matplotlib import pyplot
    from sphinx_gallery.scrapers import figure_rst

    shown: list[Figure] = block_vars.setdefault("_figures_shown", [])
    block_vars["_printed"] = block_vars.get("_printed", "") + "".join(_PRINTED)
    saved, _SAVED[:], _PRINTED[:] = list(_SAVED), [], []
    figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
    figures += [value for value in block_vars["example_globals"].values() if isinstance(value, Figure)]
    figures += saved
    files = []
    for figure in figures:
        if any(figure is other for other in shown):
            continue
        shown.append(figure)
        path = next(block_vars["image_path_iterator"])
        figure.savefig(path, dpi=160, facecolor="white")
        files.append(path)
    pyplot.close("all")
    _SAVED.clear()
    source = Path(block_vars["src_file"])
    if block.lineno == last_block(source):
        staged = [file.stem for file in FOLDER.glob("*.py") if group_of(file.stem) == source.parent.name]
        left = [file.name for file in left_behind(source.parent, staged)]
        truths.check(source.stem, block_vars["example_globals"], shown, block_vars["_printed"], left)
    return figure_rst(files, gallery_conf["src_dir"])


def last_block(source: Path) -> int:
    """The line where the last block of code of a program begins."""
    from sphinx_gallery.py_source_parser import split_code_and_text_blocks

    _, blocks = split_code_and_text_blocks(str(source))
    return max(block.lineno for block in blocks if block.type == "code")


def forget_stale(build: Path) -> None:
    """Programs and notebooks run again where the package, its locks or what is checked has changed."""
    from tests.store import source_digest

    checked = b"".join(Path(file).read_bytes() for file in (__file__, truths.__file__))
    digest = source_digest() + hashlib.sha256(checked).hexdigest()
    stamp = build / "ran-with"
    if stamp.exists() and stamp.read_text(encoding="utf-8") == digest:
        return
    shutil.rmtree(build / "notebooks", ignore_errors=True)
    for ran in (ROOT / "docs" / "gallery").rglob("*.md5"):
        ran.unlink()
    build.mkdir(parents=True, exist_ok=True)
    stamp.write_text(digest, encoding="utf-8")


def settings(folder: Path) -> dict[str, Any]:
    """``sphinx_gallery_conf``."""
    forget_stale(folder.parent)
    picture = thumbnail(folder.parent / "thumbnail.png")
    note_figures_and_output()
    return {
        "default_thumb_file": picture,
        "examples_dirs": [str(stage(folder))],
        "gallery_dirs": ["gallery"],
        "filename_pattern": r".*\.py",
        "subsection_order": "website.gallery.by_group",
        "within_subsection_order": "website.gallery.by_position",
        "image_scrapers": ("website.gallery.scrape_figures",),
        "reset_modules": (),
        "download_all_examples": False,
        "show_memory": False,
        "write_computation_times": False,
        "min_reported_time": 1_000,
        "abort_on_example_error": False,
        "only_warn_on_example_error": False,
        "remove_config_comments": True,
        "capture_repr": ("_repr_html_", "__repr__"),
        "ignore_repr_types": r"matplotlib\.",
        "doc_module": ("flexhinf",),
        "backreferences_dir": "gallery/backreferences",
        "inspect_global_variables": False,
        "show_signature": False,
    }
