"""A controller as a shared library: compiled once, loaded in milliseconds without LLVM and without CasADi.

The instructions that a library needs are compared with those of this processor before any of its code is run.
"""

# Not checked strictly: llvmlite has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import platform
import re
import shutil
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from flexhinf import __version__
from flexhinf.arrays import Numbers
from flexhinf.errors import ControllerInUse, InvalidInput, refuse_if
from flexhinf.export.programs import accepts, required_compiler, run
from flexhinf.files import check_replaceable, write_file
from flexhinf.starts import Start
from flexhinf.stops import Stop
from flexhinf.validation import (
    checked_path,
    one_of,
    optional_package,
    read_bytes,
    real_array,
    value_text,
)

if TYPE_CHECKING:
    from flexhinf.export.controller_c import ControllerCode
    from flexhinf.loop import Controller
    from flexhinf.loop.controller.memory import RunCounts


def compile_controller(
    controller: Controller, path: str | os.PathLike[str], processor: str = "portable"
) -> Path:
    """Compile a controller into one shared library for this platform, see `flexhinf.load_compiled`.

    Parameters
    ----------
    path : path
        Of the file; an earlier library is replaced, another file is not. It is machine code: load only what you trust.
    processor : {"portable", "any", "native"}
        On which it runs: PCs since about 2015, also older ones (half as fast), or those that have all that this one
        has. The file states the instructions it needs, and is refused where they are missing. For older ones its bits
        are those of ``controller.fresh(fused=False)``, see `CompiledController`.

    Raises
    ------
    InvalidInput
        As `export_c`; for another choice of processors; or there is no C compiler (``CC``, cc, gcc, clang), or it
        fails.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> import tempfile
    >>> controller = fh.Controller(fh.linear_law(fh.paper_arm().problem(), gamma=np.inf), None, 1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fh.compile_controller(controller, f"{folder}/arm.so").name
    'arm.so'
    """
    from markupsafe import Markup

    from flexhinf.export.controller_c import SOURCES, code_of
    from flexhinf.export.file_list import File, rendered
    from flexhinf.loop.controller.memory import RunCounts

    target, flags = checked_path("The library", path), compiler_flags(processor)
    check_replaceable(target, "library", lambda content: MARK in content)
    code = code_of(controller, "controller", "double")
    c = code.controller
    about = {
        "what": "flexhinf controller",
        "version": __version__,
        "period": c.period,
        "measured": c.measured,
        "commanded": c.commanded,
        "inputs": c.law.input_names,
        "states": c.estimated,
        "units": code.units,
        "reference": c.operating_reference.tolist(),
        "codes": {str(row.value): name for name, row in code.codes.items()},
        "starts_anywhere": code.starts_anywhere,
        "digest": code.digest,
        "status": [
            c.memory.places[name].start if name in c.memory.places else None for name in ("status", "stop")
        ],
        "bits": [int(bit) for bit in code.flags],
        "rejected": code.rejected,
        "stop_record": RunCounts.places(c.memory.places),
    }
    entry: File[ControllerCode] = File(
        "entry.c",
        "library.c",
        lambda code: {
            "mark": Markup(MARK.strip().decode() + r"\n"),
            "instructions": list(INSTRUCTIONS.items()),
            "description": about,
        },
    )
    shared = {**code.values, "digest": code.digest}
    sources = rendered([*SOURCES, entry], code, code.name, code.real, **shared)
    known = flags if accepts(required_compiler(), flags) else ()
    image = shared_library(sources, ("-O3", *known))
    write_file(target, "library", lambda part: Path(part).write_bytes(image))
    return target


def shared_library(
    sources: dict[str, str], flags: tuple[str, ...] = ("-O2",), visibility: str = "hidden"
) -> bytes:
    """Shared library of C files, built by this machine's C compiler; raises as `build`.

    `visibility`: Of what no file says that others may call it: "hidden" or "default".
    """
    with TemporaryDirectory() as work:
        own = ("-shared", "-fPIC", f"-fvisibility={visibility}")
        return build(sources, Path(work), (*flags, *own)).read_bytes()


def cortex_m4_bytes(code: ControllerCode) -> int | None:
    """Bytes of code and constants on a Cortex-M4F, C library included; None without arm-none-eabi-gcc.

    The same number as by `make cortex-m4` in an exported folder. Raises InvalidInput: that compiler fails.
    """
    compiler, size = shutil.which("arm-none-eabi-gcc"), shutil.which("arm-none-eabi-size")
    if compiler is None or size is None:
        return None
    core = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffunction-sections")
    used = (f"-Wl,--entry={code.name}_step", f"-Wl,--undefined={code.name}_init", "-Wl,--gc-sections")
    what = "The code cannot be counted for a Cortex-M4F."
    advice = "newlib beside the compiler (apt install libnewlib-arm-none-eabi); or no --flash"
    with TemporaryDirectory() as work:
        _write(code.files, Path(work))
        flags = ("-std=c99", "-O2", *core, f"{code.name}.c", "-nostartfiles", *used, "-lm", "-o", "alone")
        run([compiler, *flags], Path(work), what, advice)
        table = run([size, "alone"], Path(work), what, advice)
    text, data = table.splitlines()[1].split()[:2]
    return int(text) + int(data)


def build(sources: dict[str, str], folder: Path, flags: tuple[str, ...]) -> Path:
    """Compile and link files of C in an existing folder; returns the path of the result.

    A level of optimisation among the flags is at most `flexhinf.codegen.compiler.highest_optimisation`. Raises
    InvalidInput: if there is no compiler (``CC``, cc, gcc, clang), or it fails.
    """
    compiler = required_compiler()
    _write(sources, folder)
    files = [file for file in sources if file.endswith(".c")]
    command = [*compiler, "-std=c99", *map(limited, flags), *files, "-lm", "-o", "built"]
    run(command, folder, "The C compiler does not compile the controller.", "another compiler in CC")
    return folder / "built"


def limited(flag: str) -> str:
    """A flag of a C compiler, its level of optimisation not above `highest_optimisation`."""
    from flexhinf.codegen.compiler import highest_optimisation  # not needed to load a library

    return f"-O{min(int(flag[2:]), highest_optimisation())}" if re.fullmatch(r"-O\d", flag) else flag


def _write(sources: dict[str, str], folder: Path) -> None:
    for file, text in sources.items():
        (folder / file).write_text(text, encoding="utf-8")


#: Libraries of this process by the digest of their bytes: none is ever unloaded.
_LOADED: dict[str, ctypes.CDLL] = {}


def loaded(image: bytes, beside: Path) -> ctypes.CDLL:
    """The library with these bytes, once per process, whatever lies at the path that they were read from.

    The dynamic loader identifies libraries by path and would return the one that it loaded from there before: it loads
    a private copy named by content, which is removed at once. Where nothing in the directory for temporary files may be
    run, the copy is made in the folder `beside`.

    Raises OSError: if it cannot be loaded.
    """
    name = hashlib.sha256(image).hexdigest()
    for folder in (None, beside):
        if name in _LOADED:
            break
        try:
            with TemporaryDirectory(prefix=".flexhinf-", dir=folder, ignore_cleanup_errors=True) as private:
                copy = Path(private) / f"{name}.so"
                copy.write_bytes(image)
                _LOADED[name] = ctypes.CDLL(str(copy))
        except OSError:
            if folder is beside:
                raise
    return _LOADED[name]


class _Copied(TypedDict):
    """What a copy or a pickle of a controller has: the library's file and digest, the memory, and the last code."""

    path: str
    digest: str
    memory: list[np.ndarray]
    code: str


class CompiledController:
    """A controller of `flexhinf.export.compile_controller`, with a memory of its own.

    A step never raises for a bad measurement: the output is held instead, see `code` and docs/deployment.md.

    Parameters
    ----------
    path : path
        Of the shared library. Its code is run: load only what you trust.

    Attributes
    ----------
    period : float
        s.
    measured, commanded, inputs, states : tuple of str
        Names of the elements of y, r, u and the estimate.
    digest : str
        Of the C of which it was compiled.
    fused : bool
        Whether its bits are those of ``Controller.fresh(fused=True)``, or of False.
    code : str
        How the last step ended: "OK", "PREDICTED", "BAD_MEASUREMENT", …
    estimate : (n,) array
        Of the last step; zero before the first.

    Raises
    ------
    InvalidInput
        If this is no such library, is one of another machine, or needs instructions that this processor lacks.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> import tempfile
    >>> controller = fh.Controller(fh.linear_law(fh.paper_arm().problem(), gamma=np.inf), None, 1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     compiled = fh.CompiledController(fh.compile_controller(controller, f"{folder}/arm.so"))
    >>> x, goal = np.array([0.1, 0.0, 0.1, 0.0]), [0.0]
    >>> bool(np.all(compiled.step(x, goal) == controller.step(x, goal)))
    True
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = checked_path("The library", path).absolute()
        try:
            image = read_bytes(self.path, -1)
            _, mark, tail = image.partition(MARK)
            needed, _, text = tail.partition(b"\0")[0].decode().partition("\n")
            if not mark:
                raise ValueError("no library of this version")
            about = json.loads(text)
            here = instructions()
            refuse_if(
                needed.split() and here is None,
                "The library may be for another processor.",
                f"expected one that has {needed.strip()}, for which {self.path.name} was compiled; neither the system "
                "nor LLVM tells what this one has",
                "flexhinf compile DESIGN --processor any",
            )
            missing = sorted(set(needed.split()) - (here or set()))
            refuse_if(
                missing,
                "The library is for another processor.",
                f"expected one that has {', '.join(missing)}, for which {self.path.name} was compiled; this one "
                "has not",
                "flexhinf compile DESIGN --processor portable, or on this machine",
            )
            self._library = loaded(image, self.path.parent)
            self._library.flexhinf_state_size.restype = ctypes.c_size_t
            self.fused = bool(self._library.flexhinf_fused())
        except InvalidInput:
            raise
        except (OSError, ValueError, AttributeError) as error:
            raise InvalidInput(
                "The library cannot be loaded.",
                f"expected one of `flexhinf compile` for {platform.machine()}, got {self.path}: {str(error)[:200]}",
                "flexhinf compile DESIGN on this machine",
            ) from error
        self.period = float(about["period"])
        self.measured, self.commanded, self.inputs, self.states = (
            tuple(about[kind]) for kind in ("measured", "commanded", "inputs", "states")
        )
        self.digest = str(about["digest"])
        self._status_places: list[int | None] = about["status"]
        self._bits = np.array(about["bits"], dtype=float)
        self._rejected_place: int | None = about.get("rejected")
        self._count_places = [(int(row), int(place)) for row, place in about["stop_record"]]
        self.units: dict[str, str] = dict(about["units"])
        self.code_numbers = {int(value): name for value, name in about["codes"].items()}
        self._starts_anywhere = bool(about["starts_anywhere"])
        self._operating_reference = np.array(about["reference"], dtype=float)
        self._state = np.zeros(-(-int(self._library.flexhinf_state_size()) // 8))
        self._y, self._r = np.zeros(len(self.measured)), np.zeros(max(1, len(self.commanded)))
        self._u, self.estimate = np.zeros(len(self.inputs)), np.zeros(len(self.states))
        self._busy = False
        self._kept = (self._state, self._r, self._u, self.estimate)  # what copies and pickles hold
        self._fresh, self._acts = np.zeros(len(self.measured), dtype=np.intc), self._u.copy()
        self.stop, self.start_reasons = Stop(0), Start(0)
        state, y, fresh, r, u, estimate = (
            ctypes.c_void_p(array.ctypes.data)
            for array in (self._state, self._y, self._fresh, self._r, self._u, self.estimate)
        )
        step, elapsed = self._library.flexhinf_step, ctypes.c_double()

        def run(seconds: float, measured: int) -> int:
            elapsed.value = seconds  # of one object: a step allocates none
            return step(state, y, fresh, r, elapsed, measured, u, estimate)

        def begin(x: ctypes.c_void_p | None, v: ctypes.c_void_p | None) -> int:
            return self._library.flexhinf_start(state, x, v)

        acts, reasons = ctypes.c_void_p(self._acts.ctypes.data), ctypes.c_int()

        def decide(code: int) -> tuple[bool, int]:
            power = self._library.flexhinf_may_act(state, code, acts, ctypes.byref(reasons))
            return bool(power), reasons.value

        def look() -> tuple[int, int]:
            code = self._library.flexhinf_at_rest(state, y, ctypes.byref(reasons))
            return code, reasons.value

        self._run, self._begin, self._decide, self._look = run, begin, decide, look
        self.reset()

    def step(
        self,
        y: ArrayLike | None,
        reference: Numbers = None,
        elapsed: float = 0.0,
        fresh: ArrayLike | None = None,
    ) -> np.ndarray:
        """Input u (m,) for the measurement y (p,) and the command (k,); None for y where there is no measurement.

        Without a command the last one is kept (that of the operating point at first). `elapsed`: s since the step
        before, 0 if that is not known; where its mean over some 32 steps is off by more than a tenth of the period,
        `code` is "BAD_PERIOD", nothing is computed, and the last input is held. `fresh` (p,): as of `Controller.step`.

        Raises
        ------
        InvalidInput
            If y or the command does not have the right size.
        ControllerInUse
            If another thread is inside a step.
        """
        if self._busy:
            raise ControllerInUse
        self._busy = True
        try:
            if y is not None:
                self._fill(self._y, y, "measurement", self.measured)
            self._fresh[:] = 0 if fresh is None else np.asarray(fresh)
            if reference is not None:
                self._fill(self._r[: len(self.commanded)], reference, "command", self.commanded)
            self.code = self.code_numbers[self._run(elapsed, int(y is not None))]
            return self._u.copy()
        finally:
            self._busy = False

    def may_act(self) -> bool:
        """As `Controller.may_act`; `output` is what acts."""
        self._acts[:] = self._u
        numbers = {name: number for number, name in self.code_numbers.items()}
        power, reasons = self._decide(numbers[self.code])
        self.stop = Stop(reasons)
        return power

    @property
    def output(self) -> np.ndarray:
        """The input (m,) that acts after `may_act`."""
        return self._acts.copy()

    def at_rest(self, y: Numbers) -> bool:
        """As `Controller.at_rest`; `start_reasons` says what it found."""
        self._fill(
            self._y, np.full(len(self.measured), np.nan) if y is None else y, "measurement", self.measured
        )
        code, reasons = self._look()
        self.start_reasons = Start(reasons)
        return self.code_numbers.get(code) == "OK"

    def _fill(self, place: np.ndarray, numbers: Numbers, what: str, names: tuple[str, ...]) -> None:
        try:
            place[:] = real_array(numbers, strict=True).reshape(place.shape)
        except (TypeError, ValueError):
            raise InvalidInput(
                f"The {what} does not fit.",
                f"expected a number for each of {list(names)}, got {value_text(numbers)}",
                "an array of this length, or a plain number for one signal",
            ) from None

    @property
    def status(self) -> int:
        """The bits of `Controller.status`: the memory is the first part of the state."""
        place, doubts = self._status_places[0], [at for row, at in self._count_places if row == 0]
        watched = 0 if place is None else int(self._state[place : place + len(self._bits)] @ self._bits)
        return watched | int(16.0 * self._state[doubts[0] - 1]) if doubts else watched

    @property
    def counts(self) -> RunCounts:
        """As `Controller.counts`."""
        from flexhinf.loop.controller.memory import RunCounts  # loads CasADi, which a step needs not

        counts = {row: float(self._state[place]) for row, place in self._count_places}
        return RunCounts(*(counts.get(row, 0.0) for row in range(3)))

    @property
    def doubtful_samples(self) -> int:
        """As `Controller.doubtful_samples`."""
        return int(self.counts.doubtful)

    @property
    def rejected(self) -> np.ndarray:
        """As `Controller.rejected`, (p,)."""
        place, p = self._rejected_place, len(self.measured)
        return np.zeros(p, dtype=int) if place is None else self._state[place : place + p].astype(int)

    @property
    def path_rate(self) -> float:
        """As `Controller.path_rate`."""
        place = self._status_places[1]
        return 1.0 if place is None else min(max(float(self._state[place + 2]), 0.0), 1.0)

    def reset(self, state: Numbers = None, input: Numbers = None) -> None:
        """Forget; the estimate starts at `state` (n,) and the input before the first sample is `input` (m,), if given.

        Raises
        ------
        InvalidInput
            If they do not fit, or this controller's estimate cannot be set.
        """
        refuse_if(
            state is not None and not self._starts_anywhere,
            "The estimate of this controller cannot be set.",
            "expected state=None",
            "reset()",
        )
        x, u = np.zeros(len(self.states)), np.zeros(len(self.inputs))
        if state is not None:
            self._fill(x, state, "state", self.states)
        if input is not None:
            self._fill(u, input, "input", self.inputs)
        refuse_if(
            self._begin(
                None if state is None else ctypes.c_void_p(x.ctypes.data),
                None if input is None else ctypes.c_void_p(u.ctypes.data),
            ),
            "This process does not compute as the library must.",
            "expected rounding to nearest and numbers below the normal ones, got another setting of the processor, "
            "or a library that was compiled with flags that change results",
            "a process without libraries that are linked with -ffast-math, or flexhinf compile with gcc or clang",
        )
        self._r[: len(self.commanded)] = self._operating_reference
        self.estimate[:] = 0.0
        self.code, self.stop, self.start_reasons = "OK", Stop(0), Start(0)

    # Copies and pickles: the library's path, and what is remembered ---------------------------------------
    def __getstate__(self) -> _Copied:
        return {
            "path": str(self.path),
            "digest": self.digest,
            "memory": [array.copy() for array in self._kept],
            "code": self.code,
        }

    def __setstate__(self, state: _Copied) -> None:
        self.__init__(state["path"])  # type: ignore[misc]
        refuse_if(
            self.digest != state["digest"],
            "The library of this controller was replaced by one of another controller.",
            f"expected {state['digest'][:12]}, got {self.digest[:12]} in {self.path}",
            "load_compiled, to begin anew",
        )
        for place, values in zip(self._kept, state["memory"], strict=True):
            place[:] = values
        self.code = state["code"]

    def __repr__(self) -> str:
        return f"<CompiledController: {Path(self.path).name}, period {self.period:g} s, {len(self.states)} states>"


def load_compiled(path: str | os.PathLike[str]) -> CompiledController:
    """A controller of `flexhinf compile`; see `CompiledController`.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> import tempfile
    >>> controller = fh.Controller(fh.linear_law(fh.paper_arm().problem(), gamma=np.inf), None, 1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     compiled = fh.load_compiled(fh.compile_controller(controller, f"{folder}/arm.so"))
    >>> compiled.measured
    ('link_position', 'link_velocity', 'motor_position', 'motor_velocity')
    """
    return CompiledController(path)


#: What the manifest of a library begins with; a line of instruction sets, one of JSON and a zero byte follow.
MARK = b"flexhinf library 3: instructions, then what it is\n"

#: Instruction sets beyond the oldest processor of a platform that compilers use on their own for such code: the macro
#: that says so, and LLVM's name without points.
INSTRUCTIONS = {
    "__SSE3__": "sse3", "__SSSE3__": "ssse3", "__SSE4_1__": "sse41", "__SSE4_2__": "sse42",
    "__POPCNT__": "popcnt", "__AVX__": "avx", "__AVX2__": "avx2", "__FMA__": "fma", "__FMA4__": "fma4",
    "__XOP__": "xop", "__TBM__": "tbm", "__BMI__": "bmi", "__BMI2__": "bmi2", "__LZCNT__": "lzcnt",
    "__MOVBE__": "movbe", "__F16C__": "f16c", "__GFNI__": "gfni", "__AVX512F__": "avx512f",
    "__AVX512CD__": "avx512cd", "__AVX512DQ__": "avx512dq", "__AVX512BW__": "avx512bw",
    "__AVX512VL__": "avx512vl", "__AVX512IFMA__": "avx512ifma", "__AVX512VBMI__": "avx512vbmi",
    "__AVX512VBMI2__": "avx512vbmi2", "__AVX512VNNI__": "avx512vnni", "__AVX512BITALG__": "avx512bitalg",
    "__AVX512VPOPCNTDQ__": "avx512vpopcntdq", "__AVX512BF16__": "avx512bf16", "__AVX512FP16__": "avx512fp16",
    "__APX_F__": "apxf", "__ARM_FEATURE_SVE": "sve", "__ARM_FEATURE_SVE2": "sve2",
}  # fmt: skip

#: Linux's names for some of them.
OF_LINUX = {"pni": "sse3", "bmi1": "bmi", "abm": "lzcnt", "apx": "apxf"}

#: PCs since about 2015: fused multiply-adds, which every other operation of a step is, of four numbers at once.
PORTABLE = {"avx2", "fma"}

X86 = ("x86_64", "AMD64")


@cache
def instructions() -> frozenset[str] | None:
    """Instruction sets of this processor that the system permits, by LLVM's names without points; None where neither
    the system nor LLVM tells them."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:  # no Linux, or none that shows it: LLVM knows, where it is installed
        return _by_llvm()
    line = next((line for line in text.splitlines() if line.startswith(("flags", "Features"))), "")
    return frozenset(OF_LINUX.get(word, word.replace("_", "")) for word in line.partition(":")[2].split())


def _by_llvm() -> frozenset[str] | None:
    llvm = optional_package("llvmlite.binding")
    try:
        features = {} if llvm is None else llvm.get_host_cpu_features()
    except RuntimeError:  # LLVM does not know them on this system
        features = {}
    if not features:
        return None
    return frozenset(name.replace(".", "").replace("-", "") for name, there in features.items() if there)


def compiler_flags(processor: str) -> tuple[str, ...]:
    """Flags of gcc and clang for the processors to compile for.

    `processor`: {"portable", "any", "native"}, PCs since about 2015 (AVX2 and fused multiply-adds; on a machine
    without them, as "any"), the oldest ones of the platform, or those with all that this one has. Other platforms than
    PCs have the first two in common. Raises InvalidInput: for another word.
    """
    one_of(
        "There is no such choice of processors.",
        processor,
        ("portable", "any", "native"),
        "portable: PCs since about 2015; any: older ones too, half as fast; native: those that are like this one",
    )
    pc = platform.machine() in X86
    if processor == "native":
        return ("-march=native" if pc else "-mcpu=native",)
    fused = processor == "portable" and pc and (instructions() or frozenset()) >= PORTABLE
    return (*(["-march=x86-64"] if pc else []), *(f"-m{name}" for name in sorted(PORTABLE) if fused))
