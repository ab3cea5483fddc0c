"""Program → kernel: machine code of this processor, run on arrays that are checked once before it touches memory.

Object code is kept on disk, by the hash of what it was made from; only a file that is exactly right is used. The folder
is the environment variable ``FLEXHINF_CACHE``, else ``flexhinf`` in the user's cache folder; a user without a home has
none. A file is named by its key in hexadecimal digits and holds a magic line, the key, the SHA-256 of the object code,
and the object code. It is used only if it is a regular file of the user, all three agree, and the code can be loaded;
it is written under another name and then renamed, so that no reader sees half of it. A file that is not used is
reported through `logging`, and replaced. Whatever else lies in the folder is not ours and stays.

``FLEXHINF_OPTIMISATION`` limits the optimisation of machine code, and of C that is compiled here, see
`highest_optimisation`.
"""

# Arguments are checked whose types nobody else checks.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

import ctypes
import hashlib
import json
import logging
import os
import re
import stat
import sys
import threading
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar, overload

import numpy as np

from flexhinf.codegen.groups import form_of
from flexhinf.codegen.memory import aligned, misfit
from flexhinf.codegen.program import ENTRY, Call, Map, Program, Repeat, Step, Sweep, Unsupported, When
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.files import part_file
from flexhinf.validation import open_regular, read_bytes

if TYPE_CHECKING:
    from flexhinf.codegen.machine import Code, Host


def check_lanes(program: Program, lanes: int) -> None:
    """Refuse a number of lanes that is no positive integer."""
    if isinstance(lanes, bool) or not isinstance(lanes, int) or lanes < 1:
        raise misfit(f"Program '{program.name}' cannot run on these lanes.", "an integer ≥ 1", repr(lanes))


_FLOAT = np.dtype(float)


def check_arrays(program: Program, arrays: Mapping[str, np.ndarray], lanes: int) -> dict[str, np.ndarray]:
    """The arrays of the program's buffers, in its order.

    `arrays`: One C-contiguous float64 array per buffer that is not "work". With one lane any shape of `size` elements
    is taken (a trajectory may be given as (steps, n)); with W lanes the last axis of a buffer that is not shared is
    the lane, so its shape is (size, W) or (…, W). Returns the same array objects. Raises InvalidInput: missing or
    unknown name; wrong type, dtype, layout or number of elements; a read-only array to be written; a written array
    that shares memory with another one.
    """
    expected = {buffer.name: buffer for buffer in program.buffers if buffer.role != "work"}
    if set(arrays) != set(expected):
        raise misfit(
            f"The arrays do not match the buffers of '{program.name}'.",
            f"one for each of {sorted(expected)}",
            sorted(arrays),
        )
    for name, buffer in expected.items():
        array, width = arrays[name], 1 if buffer.shared else lanes
        if not (
            isinstance(array, np.ndarray)
            and ((flags := array.flags).c_contiguous and flags.aligned)
            and (array.dtype is _FLOAT or (array.dtype == np.float64 and array.dtype.isnative))
            and (flags.writeable or buffer.role == "in")
            and array.size % width == 0
            and buffer.size in (None, array.size // width)
            and (width == 1 or (array.ndim >= 2 and array.shape[-1] == width))
        ):
            found = type(array).__name__
            if isinstance(array, np.ndarray):
                layout = "contiguous" if array.flags.c_contiguous else "not contiguous"
                access = "writeable" if array.flags.writeable else "read-only"
                found = (
                    f"{array.dtype} of shape {array.shape}, {layout}, {access}, for the role {buffer.role!r}"
                )
            elements = "any number of" if buffer.size is None else str(buffer.size)
            wanted = f" with a last axis of {lanes} lanes" if width > 1 else ""
            raise InvalidInput(
                f"The array for buffer '{name}' of '{program.name}' cannot be used.",
                f"expected a C-contiguous float64 array of {elements} elements{wanted}, got {found}",
                "numpy.ascontiguousarray(…, dtype=float)",
            )
    reach = {
        True: (0, ""),
        False: (0, ""),
    }  # of the arrays so far that are written, and of those that are read
    for start, name in sorted((_address(arrays[name]), name) for name in expected if arrays[name].size):
        written = expected[name].role != "in"
        end, other = max(reach.values()) if written else reach[True]
        if start < end:
            found = f"'{other}' and '{name}'"
            raise misfit(f"Two buffers of '{program.name}' lie in the same memory.", "arrays apart", found)
        reach[written] = max(reach[written], (start + arrays[name].nbytes, name))
    return {name: arrays[name] for name in expected}


def _address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def check_counts(program: Program, counts: Mapping[str, int]) -> dict[str, int]:
    """The counts of the program, in its order.

    Raises InvalidInput: missing or unknown name, or a value that is not an integer ≥ 0.
    """
    whole = all(isinstance(count, int | np.integer) and count >= 0 for count in counts.values())
    if set(counts) != set(program.counts) or not whole:
        expected = f"an integer ≥ 0 for each of {sorted(program.counts)}"
        raise misfit(f"The counts do not match those of '{program.name}'.", expected, dict(counts))
    return {name: int(counts[name]) for name in program.counts}


def check_reach(program: Program, lengths: Mapping[str, int], counts: Mapping[str, int]) -> None:
    """Every slice stays inside its buffer for these counts.

    `lengths`: Elements per lane of every buffer, work included. `counts`: As returned by `check_counts`. Raises
    InvalidInput: A slice would leave its buffer; the message says by how much.
    """
    for piece, loops in program.pieces:
        turns = [counts[count] if isinstance(count, str) else count for count in loops]
        if 0 in turns:
            continue
        moves = [stride * (turn - 1) for stride, turn in zip(piece.strides, turns, strict=False)]
        start = piece.offset + (counts[piece.shift] if piece.shift else 0)
        first = start + sum(move for move in moves if move < 0)
        end = start + piece.size + sum(move for move in moves if move > 0)
        if first < 0 or end > lengths[piece.buffer]:
            raise misfit(
                f"A slice leaves buffer '{piece.buffer}' of '{program.name}'.",
                f"elements 0 to {lengths[piece.buffer]} (per lane)",
                f"{first} to {end}: {piece} with counts {dict(counts)}",
            )


@dataclass(frozen=True, eq=False)
class RunStatus:
    """How a run ended.

    `code`: 0, or the code of the first `Guard` that failed; an array (lanes,) when the kernel has several.
    `step`: index of the outermost loop at that moment (0 outside of loops); -1 where the code is 0.
    """

    code: int | np.ndarray
    step: int | np.ndarray

    @property
    def fine(self) -> bool:
        """Whether no guard failed, in any lane."""
        return not np.any(self.code)


#: The entry called without and with the interpreter's lock.
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)
_SHORT_ENTRY = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)


class Kernel:
    """A program ready to run on one or more lanes: its machine code, unless a subclass binds otherwise.

    `lanes`: W; with W > 1 every buffer that is not shared has the lane as its last (fastest) axis.

    With one lane a run stops at the guard that fails. With several, the lane that failed is marked and its
    numbers mean nothing from there on, while the others go on undisturbed; the run stops when all have
    failed.
    """

    def __init__(self, program: Program, lanes: int, code: Code | None = None) -> None:
        self.program, self.lanes, self.code = program, lanes, code
        self._fitting: tuple[int, ...] | None = (
            None  # elements of the buffers, and counts, that were checked last
        )
        if code is not None:
            self._entry, self._short_entry = _ENTRY(code.address), _SHORT_ENTRY(code.address)

    def run(self, arrays: Mapping[str, np.ndarray], counts: Mapping[str, int] | None = None) -> RunStatus:
        """Check the arrays, run once, and return how it ended.

        `arrays`: One C-contiguous float64 array per buffer that is not "work"; "out" and "state" are written in place.
        `counts`: Turns of every loop of the program. Raises InvalidInput: arrays or counts that do not fit the
        program.
        """
        bound = self.bind(arrays, counts)
        bound()
        return bound.status

    def bind(
        self, arrays: Mapping[str, np.ndarray], counts: Mapping[str, int] | None = None, short: bool = False
    ) -> BoundKernel:
        """Check the arrays once; return a callable without arguments that runs on them and returns the code.

        `arrays`, `counts`: As for `run`. `short`: A call takes microseconds: other Python threads wait for it, where
        otherwise they go on meanwhile. Giving up the interpreter's lock costs 50 ns, and up to its switching interval
        (5 ms) to get it back. Raises InvalidInput: arrays or counts that do not fit the program.
        """
        checked = check_arrays(self.program, arrays, self.lanes)
        turns = check_counts(self.program, counts or {})
        lengths = {
            buffer.name: buffer.size or 0
            if buffer.role == "work"
            else checked[buffer.name].size // (1 if buffer.shared else self.lanes)
            for buffer in self.program.buffers
        }
        sizes = (*lengths.values(), *turns.values())
        if sizes != self._fitting:  # those of the last time fit
            check_reach(self.program, lengths, turns)
            self._fitting = sizes
        return self._bind(checked, turns, short)

    def _bind(self, arrays: dict[str, np.ndarray], counts: dict[str, int], short: bool) -> BoundKernel:
        work = [buffer for buffer in self.program.buffers if buffer.role == "work"]
        arrays = arrays | {buffer.name: aligned((buffer.size or 0) * self.lanes) for buffer in work}
        slots = [
            *(_address(arrays[buffer.name]) for buffer in self.program.buffers),
            *(counts[name] for name in self.program.counts),
        ]
        context = np.array([*slots, *[0] * self.lanes, *[-1] * self.lanes], dtype=np.int64)
        bound = BoundKernel(self._short_entry if short else self._entry, ctypes.c_void_p(_address(context)))
        bound.keep = (self, arrays, context)
        bound.outcome = context[len(slots) :]
        return bound


_CACHE_LOGGER = logging.getLogger("flexhinf.codegen")

_MAGIC = b"flexhinf object code 1\n"
_DIGEST = 32
_MOST_FILES = 2_000  # some 150 MB; the oldest go first
_LARGEST = 1 << 28  # bytes; the object code of seven links has some hundred thousand
_NAME = re.compile(r"[0-9a-f]{64}\.o")


def highest_optimisation() -> int:
    """The highest level of optimisation, 0 to 3, of machine code and of C that is compiled here.

    It is the environment variable ``FLEXHINF_OPTIMISATION``, without which it is 3. No number that is computed depends
    on it. At 0 a program is compiled in about half the time and runs some five times slower: for code that runs once.
    Raises InvalidInput: for another value.
    """
    stated = os.environ.get("FLEXHINF_OPTIMISATION", "3")
    refuse_if(
        stated not in ("0", "1", "2", "3"),
        "FLEXHINF_OPTIMISATION is no level of optimisation.",
        f"expected 0, 1, 2 or 3, got {stated[:40]!r}",
        "unset FLEXHINF_OPTIMISATION, for the fastest code",
    )
    return int(stated)


Loaded = TypeVar("Loaded")


@overload
def cached(parts: tuple[str, ...], make: Callable[[], bytes]) -> bytes: ...


@overload
def cached(parts: tuple[str, ...], make: Callable[[], bytes], load: Callable[[bytes], Loaded]) -> Loaded: ...


def cached(
    parts: tuple[str, ...], make: Callable[[], bytes], load: Callable[[bytes], object] = bytes
) -> object:
    """Load object code from the cache, or make and keep it.

    `parts`: Everything that the code depends on. `make`: Makes the code; called when no usable file is there. `load`:
    Loads it; where it raises for a file's code, the file is replaced. By default the code is returned.

    Never raises for the cache's own sake: a folder that cannot be written only costs time.
    """
    key, directory = _key(parts), folder()
    path = None if directory is None else directory / f"{key.hex()}.o"
    if path is not None:
        try:
            if (image := _read(path, key)) is not None:
                return load(image)
        except Exception as reason:  # whatever is wrong with the file, what is made anew is right, or tells
            _CACHE_LOGGER.warning(
                "the compiled code %s is not used (%s); it is compiled anew.",
                path,
                " ".join(str(reason).split())[:100],
            )
    image = make()
    code = load(image)
    if path is not None:
        _write(path, key, image)
    return code


def folder() -> Path | None:
    """Where object code is kept (the folder may not exist); None where there is no place for it."""
    if chosen := os.environ.get("FLEXHINF_CACHE"):
        return Path(os.path.expanduser(chosen))
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/AppData/Local")
    elif sys.platform == "darwin":
        base = os.path.expanduser("~/Library/Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME", "")
        base = base if os.path.isabs(base) else os.path.expanduser("~/.cache")
    return Path(base) / "flexhinf" if os.path.isabs(base) else None  # of an unknown user "~" is left as it is


def _key(parts: tuple[str, ...]) -> bytes:
    encoded = [part.encode() for part in parts]
    return hashlib.sha256(b"".join(len(part).to_bytes(8, "little") + part for part in encoded)).digest()


def _read(path: Path, key: bytes) -> bytes | None:
    """The code in a file; None where there is no file.

    Raises OSError, ValueError: what is wrong with it.
    """
    try:
        with open_regular(path) as file:
            info = os.fstat(file.fileno())
            if not _is_private(info):
                raise ValueError("it is no file of this user alone")
            if info.st_size > _LARGEST:
                raise ValueError("it is too large")
            content = file.read()
    except FileNotFoundError:
        return None
    head = _MAGIC + key
    image = content[len(head) + _DIGEST :]
    if not image or content[: len(head) + _DIGEST] != head + hashlib.sha256(image).digest():
        raise ValueError("it is damaged")
    return image


def _is_private(info: os.stat_result) -> bool:
    """Whether it is a regular file of this user that nobody else may write (where the system knows of users)."""
    private = not hasattr(os, "getuid") or (
        info.st_uid == os.getuid() and not info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    )
    return stat.S_ISREG(info.st_mode) and private


def _write(path: Path, key: bytes, image: bytes) -> None:
    with suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with part_file(path.parent, "flexhinf-") as temporary:
            with open(temporary, "wb") as file:
                file.write(_MAGIC + key + hashlib.sha256(image).digest() + image)
            os.replace(temporary, path)
        names = [name for name in os.listdir(path.parent) if _NAME.fullmatch(name)]
        if len(names) <= _MOST_FILES:
            return
        files = {path.parent / name: os.lstat(path.parent / name) for name in names}
        cached_files = [other for other, info in files.items() if _is_private(info)]
        cached_files.sort(key=lambda other: files[other].st_mtime)
        for other in cached_files[: max(0, len(cached_files) - _MOST_FILES)]:
            if read_bytes(other, len(_MAGIC)) == _MAGIC:
                other.unlink(missing_ok=True)


#: Held while something is compiled or loaded, and while this process is forked: LLVM has global state, which a child
#: that was forked in the middle of it would find locked for ever.
_LOCK = threading.RLock()


def _before_fork() -> None:
    _LOCK.acquire()
    if lock := _lock_of_llvm():
        lock.acquire()


def _after_fork() -> None:
    if lock := _lock_of_llvm():
        lock.release()
    _LOCK.release()


class _Lock(Protocol):
    """What llvmlite's lock can do."""

    def acquire(self) -> bool: ...

    def release(self) -> None: ...


def _lock_of_llvm() -> _Lock | None:
    """llvmlite's own lock, which every call of it takes, the release of old code too; None before it is loaded."""
    module = sys.modules.get("llvmlite.binding.ffi")
    return getattr(getattr(getattr(module, "lib", None), "_lock", None), "_lock", None)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork)


def compile_program(program: Program, lanes: int = 1, fused: bool | None = None) -> Kernel:
    """Compile a program for this processor.

    `lanes`: W ≥ 1 runs at once, in the lanes of vector registers; 8 suits most processors. `fused`: Round a product and
    the sum that uses it once, or twice; None for once where this processor has an instruction for it. Raises
    InvalidInput: lanes that are not a positive integer. Raises Unsupported: an operation without machine code, or a
    machine on which LLVM does not work.

    The bits of a result depend neither on W nor on the optimisation: products are fused into sums by our own
    rule, no operation may be reordered, and sin and cos are the same sequence of operations for any W.
    """
    check_lanes(program, lanes)
    with _compiling(program):
        from flexhinf.codegen import machine

        host, highest = machine.host(), highest_optimisation()
        once = host.fused if fused is None else fused

        def load(code: bytes) -> Kernel:
            library, _, image = code.partition(b"\n")
            return Kernel(program, lanes, machine.Code(image, ENTRY, json.loads(library)))

        def make() -> bytes:
            """The C functions that are needed, on a line, and the object code."""
            from flexhinf.codegen.emit.module import emit_module

            module = emit_module(program, lanes, once, host.choosing)
            head = json.dumps(module.library).encode() + b"\n"
            return head + machine.assemble(str(module), min(machine.level(module.operations), highest))

        way = f"{lanes} {once} {host.choosing} {highest}"
        return cached(_parts(program, way, host), make, load)


def compile_ptx(program: Program, returned: tuple[str, ...], fused: bool | None = None) -> str:
    """PTX of a program for a GPU, a thread or a warp for each run; see `flexhinf.codegen.threads`.

    `returned`: Names of buffers of which elements are returned. `fused`: As for `compile_program`: None for what this
    processor does. Raises Unsupported: as `compile_program`; and for functions of the C library, which no GPU has.
    """
    with _compiling(program):
        from flexhinf.codegen import machine

        host, highest, form = machine.host(), highest_optimisation(), form_of(program)
        once = host.fused if fused is None else fused

        def make() -> bytes:
            from flexhinf.codegen.threads import emit_threads

            module = emit_threads(program, returned, once, form)
            if module.library:
                called = ", ".join(sorted(module.library.values()))
                what = f"its model calls {called} of the C library"
                raise Unsupported("The loop cannot run on a GPU.", what, 'device="cpu" (--device cpu)')
            level = min(machine.level(module.operations), highest)
            return machine.assemble_ptx(str(module), level).encode()

        way = f"{returned} {once} {host.version} {highest} {form}"
        return cached(_parts(program, way, machine.PTX), make).decode()


@contextmanager
def _compiling(program: Program) -> Generator[None]:
    """Nothing else is compiled or loaded meanwhile; what fails says so."""
    try:
        with _LOCK:
            yield
    except (ImportError, OSError, RuntimeError) as reason:
        raise Unsupported(
            f"Program '{program.name}' cannot be compiled.",
            f"llvmlite does not work here ({reason})",
            "python -m pip install --force-reinstall llvmlite",
        ) from reason


def _parts(program: Program, way: str, target: Host) -> tuple[str, ...]:
    """Everything that machine code depends on."""
    from flexhinf.codegen.operations import written_by_others

    machine = target.triple, target.cpu, target.features, target.version
    return (fingerprint(program), way, *machine, emitter_digest(), written_by_others(), _version())


class BoundKernel(partial[int]):
    """A kernel with its arrays, nothing left to check: calling it runs no Python code, and returns the largest code.

    `keep`: The kernel, the arrays and the context, alive as long as this object. `outcome`: codes and steps of
    the last call, (2·lanes,).
    """

    keep: tuple[object, ...]
    outcome: np.ndarray

    @property
    def status(self) -> RunStatus:
        """Status of the last call."""
        if len(self.outcome) == 2:
            return RunStatus(*self.outcome.tolist())
        codes, steps = self.outcome.reshape(2, -1)
        return RunStatus(codes.copy(), steps.copy())


def fingerprint(program: Program) -> str:
    """Text that identifies a program: buffers, counts, steps, and every traced function in CasADi's serial form.

    Two programs with the same fingerprint are the same to the last constant: a function's serial form holds its
    instructions, not what they were written as.
    """
    functions: dict[int, str] = {}

    def line(step: Step) -> str:
        if isinstance(step, Repeat):
            return f"Repeat({step.count!r}: {'; '.join(map(line, step.body))})"
        if isinstance(step, When):
            return f"When({step.flag!r}: {'; '.join(map(line, step.body))})"
        if isinstance(step, Sweep):
            return f"Sweep({step.inputs!r}, {step.outputs!r}, {step.size}: {'; '.join(map(line, step.body))})"
        if not isinstance(step, Call | Map):
            return repr(step)
        key = step.function.__hash__()
        if key not in functions:
            functions[key] = step.function.serialize()
        kind = "Joins" if isinstance(step, Call) and step.joins else type(step).__name__
        return f"{kind}({list(functions).index(key)}, {step.inputs!r}, {step.outputs!r})"

    lines = [repr(program.buffers), repr(program.counts), *map(line, program.body)]
    return "\n".join([*lines, *(f"{len(text)} {text}" for text in functions.values())])


@cache
def _version() -> str:
    from importlib.metadata import version

    return version("flexhinf")


@cache
def emitter_digest() -> str:
    """SHA-256 of the sources that turn a program into LLVM text; empty where there are none to read."""
    here = Path(__file__).parent
    own = (here / f"{name}.py" for name in ("noise", "operations", "dataflow", "threads", "groups"))
    sources = (*own, *sorted((here / "emit").glob("*.py")))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
