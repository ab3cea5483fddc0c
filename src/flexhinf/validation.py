"""What comes from outside - numbers, names, texts and files - is checked before work is done with it."""

from __future__ import annotations

import difflib
import errno
import io
import math
import os
import re
import shlex
import stat
import unicodedata
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from io import BufferedReader
from itertools import accumulate
from pathlib import Path
from types import ModuleType, UnionType
from typing import TYPE_CHECKING, Any, TypeGuard, TypeVar, cast

from flexhinf.errors import InvalidInput, readable, refuse_if

Value = TypeVar("Value")


class _LatePackage:
    def __init__(self, package: str) -> None:
        self._package = package

    def __getattr__(self, name: str) -> object:
        package = self._package
        value = getattr(import_module(package), name)
        setattr(self, name, value)
        return value


def late_package(package: str) -> _LatePackage:
    """A package that is imported when something of it is first used: help and refusals of options need none."""
    return _LatePackage(package)


if TYPE_CHECKING:
    import hashlib
    import tomllib
    from xml.etree import ElementTree

    import numpy as np
else:
    hashlib, tomllib, np = map(late_package, ("hashlib", "tomllib", "numpy"))
    ElementTree = late_package("xml.etree.ElementTree")

#: Longest name of a joint, a robot or a signal, and longest description or source, in characters.
LONGEST_NAME, LONGEST_TEXT = 100, 10_000

#: Largest text file, bytes: a robot of 30 joints takes 30 kB; a megabyte is read and refused within a second.
LARGEST_TOML, LARGEST_XML = 1_000_000, 10_000_000

#: Deepest nesting of tables and lists, and most parts of a dotted key: a robot file has four. Of elements of XML: the
#: bodies of an MJCF file stand in each other, and a spine or a tail has dozens.
DEEPEST, DEEPEST_XML = 30, 100

#: Most elements of an XML document.
MOST_ELEMENTS = 100_000

#: Largest magnitude of a physical number in SI units, and the inverse of the smallest positive one: products of
#: several such numbers, and their quotients, are still finite.
HUGE = 1e30

#: The tokens of TOML that matter for its depth. A string that is not closed reaches to the end of its line or file, so
#: that no text is looked at twice.
_TOKEN = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:""")?'
    r"|'''(?:[^']|'(?!''))*+(?:''')?"
    r'|"(?:\\.|[^"\\\n])*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*|[\[\]{}.,=\n]",
    re.DOTALL,
)


# Numbers --------------------------------------------------------------------------------------------
def real_array(value: object, strict: bool = False) -> np.ndarray:
    """A new float64 array of real numbers; NaN where something else stands, so that one test of finiteness finds it.

    Missing entries (masked ones, None) become NaN. Text, bytes, complex numbers, dates, integers beyond 1.8e308, rows
    of different lengths and other objects give a single NaN of shape (), or a ValueError if `strict`.

    Examples
    --------
    >>> real_array([1, 2.5]), real_array("1.0"), real_array([0.5, np.ma.masked])
    (array([1. , 2.5]), array(nan), array([0.5, nan]))
    """
    if is_array(value) and type(value) is np.ndarray and value.dtype == np.float64:
        return value.copy()
    try:
        if isinstance(value, (list, tuple)):
            value = _unmasked(cast("Sequence[object]", value))
        if _is_masked(value):
            value = _filled(value)
        array = np.asarray(value)
        if array.dtype.kind in "fiub" or all(entry is None or is_real(entry) for entry in array.flat):
            return np.array(array, dtype=float)
    except Exception:
        pass  # whatever a foreign object does when it is asked for numbers; lists that hold themselves
    if strict:
        raise ValueError("no real numbers")
    return np.array(np.nan)


def checked_array(
    what: str, value: object, shape: tuple[int, ...], expected: str, advice: str, most: float = math.inf
) -> np.ndarray:
    """Finite numbers of this shape, of a magnitude of at most `most`; the texts are for the message.

    Raises InvalidInput: for anything else.
    """
    array = real_array(value)
    array = array[None] if shape == (1,) and array.ndim == 0 else array
    if array.shape != shape or not np.isfinite(array).all() or np.any(np.abs(array) > most):
        raise InvalidInput(what, f"expected {expected}, got {value_text(value)}", advice)
    return array


def checked_positive(what: str, value: object, unit: str, advice: str) -> float:
    """A finite number above zero, as a float.

    Raises InvalidInput: for anything else; `what` begins the message: "The sampling period".
    """
    number = real_number(value)
    if not 0.0 < number < math.inf:
        raise InvalidInput(
            f"{what} is not positive.", f"expected {unit} > 0, got {value_text(value)}", advice
        )
    return number


def checked_kind(
    what: str, value: object, kind: type | UnionType | tuple[type, ...], expected: str, advice: str
) -> None:
    """Refuse a value of another class; `what` is the message's first sentence."""
    if not isinstance(value, kind):
        raise InvalidInput(what, f"expected {expected}, got {value_text(value)}", advice)


def read_only(value: Value) -> Value:
    """The same with arrays that cannot be written, in tuples and mappings too: what copies may share."""
    return cast("Value", _read_only(value))


def _read_only(value: object) -> object:
    if is_array(value):
        view = value.view()
        view.setflags(write=False)
        return view
    if isinstance(value, dict):
        return {key: _read_only(entry) for key, entry in cast("dict[object, object]", value).items()}
    if isinstance(value, tuple):
        whole = cast("tuple[object, ...]", value)
        entries, make = [_read_only(entry) for entry in whole], cast("Callable[..., object]", type(whole))
        return make(*entries) if hasattr(whole, "_fields") else tuple(entries)
    return value


def real_number(value: object) -> float:
    """One real number as a float; NaN for anything else, arrays of one number with axes included."""
    if type(value) is float:
        return value
    array = real_array(value)
    return float(array) if array.ndim == 0 else float("nan")


def is_array(value: object) -> TypeGuard[np.ndarray]:
    """Whether this is an array of NumPy, whatever it holds."""
    return isinstance(value, np.ndarray)


def _is_masked(value: object) -> TypeGuard[np.ma.MaskedArray]:
    return isinstance(value, np.ma.MaskedArray)


def _filled(masked: np.ma.MaskedArray) -> np.ndarray:
    return np.ma.filled(masked.astype(float), np.nan)


def is_real(value: object) -> bool:
    """Whether this is one real number, of Python, NumPy or another library, and neither text, masked nor complex."""
    return isinstance(value, (float, int)) or (
        not isinstance(value, (str, bytes, complex, np.complexfloating, np.datetime64, np.timedelta64))
        and value is not np.ma.masked
        and getattr(value, "shape", ()) == ()
        and hasattr(value, "__float__")
    )


def _unmasked(values: Sequence[object]) -> Sequence[object]:
    """The same rows with NaN where an entry is masked, and rows that are masked arrays filled."""
    if all(type(value) is float for value in values):
        return values
    filled: list[object] = []
    for value in values:
        if value is np.ma.masked:
            value = np.nan
        elif _is_masked(value):
            value = _filled(value)
        elif isinstance(value, (list, tuple)):
            value = _unmasked(cast("Sequence[object]", value))
        filled.append(value)
    return filled


def is_integer(value: object) -> TypeGuard[int]:
    """Whether this is an integer of Python or NumPy, and no bool."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def within_proportion(value: float, positive: bool = False) -> bool:
    """Whether a physical number in SI units is at most `HUGE`, and, where it must be positive, not below 1/`HUGE`."""
    return abs(value) <= HUGE and not (positive and 0.0 < value < 1.0 / HUGE)


def value_text(value: object, most: int = 200) -> str:
    """A value as Python writes it, cut to `most` characters; whatever its ``__repr__`` does, this returns."""
    try:
        return readable(repr(value), most)
    # An integer of more than 4300 digits, lists nested too deeply, foreign objects.
    except Exception as error:
        return f"a {type(value).__name__} that cannot be printed ({readable(str(error), 80)})"


def extra_package(package: str, extra: str, what: str) -> ModuleType:
    """An optional package; without it an error that names the extra of flexhinf that brings it.

    Raises InvalidInput: `what` is its first sentence.
    """
    return required_package(package, what, install_advice(extra))


def install_advice(extra: str) -> str:
    """How an extra of flexhinf is installed, from a package index or a clone."""
    return f"pip install 'flexhinf[{extra}]', or in a clone of the repository pip install '.[{extra}]'"


def required_package(package: str, what: str, advice: str) -> ModuleType:
    """As `optional_package`. Raises InvalidInput: it is not installed; `what` and `advice` are its first and last
    part."""
    if (module := optional_package(package)) is None:
        raise InvalidInput(what, f"expected the package {package!r}, which is not installed", advice)
    return module


def optional_package(package: str) -> ModuleType | None:
    """A package; None where it is not installed.

    Raises InvalidInput: it is installed and cannot be imported, in its own words.
    """
    try:
        return import_module(package)
    except ImportError as error:
        root, parents = package.partition(".")[0], [*accumulate(package.split("."), "{}.{}".format)]
        if isinstance(error, ModuleNotFoundError) and error.name in parents:
            return None
        raise InvalidInput(
            f"The package {root!r} is installed and does not work here.",
            f"expected that {package!r} can be imported, got {type(error).__name__}: {error}",
            f"what it says that it lacks; or pip install --force-reinstall {root}",
        ) from error


# Names ----------------------------------------------------------------------------------------------
def checked_name(
    what: str, name: object, spaces: bool = False, without: str = "", longest: int = LONGEST_NAME
) -> str:
    """A name that can stand in a table, a figure, a file and a terminal.

    `what`: For the message: "a joint", "a state". `spaces`: Whether single spaces may stand between its words.
    `without`: Characters that it may not have, because they separate names elsewhere. `longest`: Most characters.
    Raises InvalidInput: for what is no text, empty or too long, begins with a mark for the letter before it, or has
    spaces, control characters or characters that change the direction of writing.
    """
    text = name if isinstance(name, str) else ""
    names = text.split(" ") if spaces else [text]
    plain = all(word and word.isprintable() and not set(word) & set(without + " ") for word in names)
    if not plain or unicodedata.combining(text[0]) or len(text) > longest:
        allowed = "single spaces" if spaces else " ".join(["no spaces", *(f"{mark!r}" for mark in without)])
        long = f" ({len(text)} characters)" if len(text) > longest else ""
        raise InvalidInput(
            f"{what[0].upper()}{what[1:]} has no usable name.",
            f"expected 1 to {longest} printable characters with {allowed}, got {value_text(name, 60)}{long}",
            "letters, digits, hyphens and underscores: 'shoulder'",
        )
    return text


def nearest(name: object, known: Iterable[str], otherwise: str = "one of these") -> str:
    """The known name that is most like a wrong one, or ends with it, as an advice."""
    text, names = str(name)[:200], list(known)
    ending = [other for other in names if text and other.endswith(text)]
    close = difflib.get_close_matches(text, names, n=1) or ending
    return repr(close[0]) if close else otherwise


def unknown_name(
    what: str, name: object, known: Iterable[str], otherwise: str = "one of these"
) -> InvalidInput:
    """The error for a name that is none of the known ones."""
    known = list(known)
    return InvalidInput(
        what, f"expected one of {known}, got {value_text(name, 60)}", nearest(name, known, otherwise)
    )


def one_of(what: str, name: object, known: Collection[str], otherwise: str = "one of these") -> None:
    """Refuse a name that is none of the known ones; `what` is the message's first sentence."""
    if name not in known:
        raise unknown_name(what, name, known, otherwise)


def checked_names(what: str, names: object) -> tuple[str, ...]:
    """One name or several, as a tuple; `what` begins the message: "The sensors".

    Raises InvalidInput: for what is neither text nor a sequence of texts.
    """
    sequence = (names,) if isinstance(names, str) else names
    scalar = is_array(sequence) and sequence.ndim == 0
    iterable = isinstance(sequence, Iterable) and not scalar
    several = tuple(cast("Iterable[object]", sequence)) if iterable else None
    if several is not None and all(isinstance(name, str) for name in several):
        return cast("tuple[str, ...]", several)
    found = f"expected a name or a sequence of distinct names, got {value_text(names)}"
    raise InvalidInput(f"{what} are not named.", found, "('one', 'another')")


def checked_text(what: str, text: object) -> str:
    """A description, a unit or a source: printable characters, tabs and line breaks, `LONGEST_TEXT` at most.

    Raises InvalidInput: for anything else.
    """
    if not isinstance(text, str) or len(text) > LONGEST_TEXT or not re.sub("[\n\t]", "", text).isprintable():
        raise InvalidInput(
            f"{what[0].upper()}{what[1:]} cannot be printed.",
            f"expected at most {LONGEST_TEXT} characters, none of them a control character, got "
            f"{value_text(text, 60)}",
            "plain text",
        )
    return text


def distinct(what: str, names: Sequence[str]) -> None:
    """Refuse a name that stands twice."""
    if len(set(names)) < len(names):
        counted = Counter(names)
        twice = next(name for name, count in counted.items() if count > 1)
        raise InvalidInput(
            f"{what} {value_text(twice, 60)} {'is' if len(names) == 2 else 'stands'} there {counted[twice]} times.",
            f"expected distinct names, got {len(names)} of which {len(counted)} are distinct",
            "another name for each",
        )


# Files ----------------------------------------------------------------------------------------------
def checked_path(what: str, path: object) -> Path:
    """A path as a `Path`; `what` begins the message: "The controller's file".

    Raises InvalidInput: for what is no text and no path object (None, numbers, bytes) or is empty.
    """
    text = os.fspath(cast("os.PathLike[str]", path)) if isinstance(path, os.PathLike) else path
    if isinstance(text, str) and text:
        return Path(text)
    raise InvalidInput(
        f"{what} has no usable path.",
        f"expected text or a pathlib.Path, got {value_text(cast('object', path), 60)}",
        "for example 'folder/name'",
    )


def read_text(path: Path, largest: int, kind: str, what: str = "file") -> str:
    """The text of a file of at most `largest` bytes in UTF-8; `kind` and `what` are for the message.

    Raises InvalidInput: for a file that is larger, no text, or cannot be read.
    """
    try:
        content = read_bytes(path, largest + 1)
    except (OSError, ValueError) as error:
        raise InvalidInput(
            f"There is no {what} {value_text(str(path), 120)} that can be read.",
            f"expected {kind}, got: {getattr(error, 'strerror', None) or error}",
            way_to_read(path, error) or "the path of a file that you may read",
        ) from error
    refuse_if(
        len(content) > largest,
        f"{path.name}: this file is too large for {kind}.",
        f"expected at most {largest / 1e6:g} MB, got more",
        "a file without meshes and tables of data",
    )
    try:
        return content.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InvalidInput(
            f"{path.name}: this is no text in UTF-8.",
            f"expected {kind} in UTF-8, got byte {error.object[error.start]:#04x} at position {error.start}",
            "the same text, saved in UTF-8",
        ) from None


def read_toml(path: Path, what: str = "robot file") -> dict[str, Any]:
    """The tables of a TOML file.

    Raises InvalidInput: for what `read_text` refuses, nesting or keys of more than `DEEPEST` parts, and what is no
    TOML.
    """
    text = read_text(path, LARGEST_TOML, "TOML", what)
    _check_depth(path.name, *_toml_depth(text))
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also of integers with more than 4300 digits
        raise InvalidInput(
            f"{path.name}: this is no TOML.", f"expected key = value, got: {error}", "correct that line"
        ) from None


def _toml_depth(text: str) -> tuple[int, int]:
    depth = deepest = dots = most = 0
    for token in _TOKEN.finditer(text):
        mark = token[0]
        if mark == ".":
            dots += 1
            most = max(most, dots)
        elif mark[0] in "[]{},=\n":
            dots = 0
            depth += (mark in ("[", "{")) - (mark in ("]", "}"))
            deepest = max(deepest, depth)
    return deepest, most


def _check_depth(file: str, nesting: int, parts: int = 0) -> None:
    deep = nesting > DEEPEST
    refuse_if(
        deep or parts > DEEPEST,
        f"{file}: this file {'is nested too deeply' if deep else 'has a key of too many parts'}.",
        f"expected at most {DEEPEST}, got {nesting if deep else parts + 1}",
        "tables inside tables as the examples have them",
    )


def read_xml(path: Path) -> ElementTree.Element:
    """The root element of an XML file without a document type, `DEEPEST_XML` elements deep at most.

    Raises InvalidInput: for what `read_text` refuses, entities, nesting, too many elements, and what is no XML.
    """
    text = read_text(path, LARGEST_XML, "XML", "URDF or MJCF file")
    refuse_if(
        "<!DOCTYPE" in text or "<!ENTITY" in text,
        f"{path.name}: this file has a document type.",
        "expected plain elements, got <!DOCTYPE or <!ENTITY",
        "leave it out: nothing of it is read",
    )
    parser: ElementTree.XMLPullParser[ElementTree.Element] = ElementTree.XMLPullParser(("start", "end"))
    root: ElementTree.Element | None = None
    depth, count = 0, 0
    try:
        for start in range(0, len(text), 65536):
            parser.feed(text[start : start + 65536])
            events = cast("Iterator[tuple[str, ElementTree.Element]]", parser.read_events())
            for event, element in events:
                root = element if root is None else root
                depth += 1 if event == "start" else -1
                count += event == "start"
                refuse_if(
                    depth > DEEPEST_XML,
                    f"{path.name}: this file is nested too deeply.",
                    f"expected elements at most {DEEPEST_XML} deep, got more",
                    "one robot, of at most so many bodies one behind the other",
                )
            refuse_if(
                count > MOST_ELEMENTS,
                f"{path.name}: this file has too many elements.",
                f"expected at most {MOST_ELEMENTS}, got more",
                "one robot, without meshes written out as text",
            )
        parser.close()
    except ElementTree.ParseError as error:
        raise InvalidInput(
            f"{path.name}: this is no XML.", f"expected elements, got: {error}", "a URDF file, as text"
        ) from None
    assert root is not None  # the parser refuses a file without one
    return root


def read_bytes(path: Path, most: int) -> bytes:
    """The first `most` bytes of a regular file, all for −1, in no more memory than they take; nobody is kept waiting
    by a FIFO or a device.

    Raises OSError, ValueError: there is no such file, it cannot be read, or it is not a regular one.
    """
    with open_regular(path) as file:
        step = max(os.fstat(file.fileno()).st_size, 1 << 16)  # what the kernel makes up says that it is empty
        parts, left = list[bytes](), most
        while left and (part := file.read(min(step, left) if left > 0 else step)):
            parts.append(part)
            left -= len(part) if left > 0 else 0
    return parts[0] if len(parts) == 1 else b"".join(parts)


class NotReadable(InvalidInput):
    """The system does not let us read a file just now: of its content nothing is known."""


@contextmanager
def access_to(path: Path, whole: Path | None = None) -> Generator[None]:
    """Refuse what the system does not let us read just now.

    An error that tells what is there passes: no such file, or a folder in its place. `whole`: the folder whose files
    one command makes readable, by default the file alone. Raises NotReadable.
    """
    try:
        yield
    except OSError as error:
        if not (advice := way_to_read(path, error, whole)):
            raise
        raise NotReadable(
            "A file cannot be read just now.",
            f"{path}: {error.strerror or error}; nothing was changed",
            advice,
        ) from error


def is_file(path: Path) -> bool:
    """Whether there is a file of this name; False for a name that no file can have. Raises NotReadable: a folder on the
    way to it may not be looked into."""
    try:
        with access_to(path):
            return path.is_file()
    except NotReadable:
        raise
    except (OSError, ValueError):
        return False


def way_to_read(path: Path, error: Exception, whole: Path | None = None) -> str:
    """How a file becomes readable that the system does not give, and who can do it; empty where that is no remedy."""
    number = isinstance(error, OSError) and error.errno
    if not number or number in (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP):
        return ""
    if number not in (errno.EACCES, errno.EPERM):
        return (
            f"ls -l {shlex.quote(str(path))}, and the same command when that answers: its disk or file server does "
            "not give it"
        )
    closed = next(
        (place for place in reversed(path.absolute().parents) if not os.access(place, os.X_OK)), path
    )
    inside = whole is not None and closed.is_relative_to(whole)
    name = shlex.quote(str(whole if inside else closed))
    mine = owner_of(closed) == "you"
    return (
        f"chmod {'-R ' if inside else ''}{'u' if mine else 'a'}+{'rX' if inside or closed == path else 'x'} {name}, "
        f"which {owner_of(closed)} can do, and the same command"
    )


def owner_of(path: Path) -> str:
    """Who owns a file or folder, as a message says it."""
    try:
        return "you" if path.stat().st_uid == os.geteuid() else path.owner()
    # not to be seen, without a name, no POSIX
    except (OSError, KeyError, NotImplementedError, AttributeError):
        return "its owner"


def file_digest(path: Path) -> str:
    """SHA-256 of a regular file, in hexadecimal, in little memory; raises as `read_bytes`."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def open_regular(path: Path) -> Generator[BufferedReader]:
    """An open file; OSError for a folder, a pipe or a device, which is not waited for."""
    no_waiting = getattr(os, "O_NONBLOCK", 0)
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | no_waiting)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError("not a file, but a folder, a pipe or a device")
        yield file


def array_of(content: bytes) -> np.ndarray:
    """An array from its file in an archive; what its head promises beyond the file's own bytes takes no memory."""
    file = io.BytesIO(content)
    header = (
        np.lib.format.read_array_header_1_0
        if np.lib.format.read_magic(file) == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, by_columns, kind = header(file)
    if kind.hasobject or min(shape, default=0) < 0:
        raise ValueError("no array of numbers or texts")
    order = "F" if by_columns else "C"
    return np.ndarray(shape, kind, content, file.tell(), order=order).copy(order)
