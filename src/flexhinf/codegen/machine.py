"""LLVM text to machine code in this process, by llvmlite. Loading this module loads llvmlite."""

from __future__ import annotations

import itertools
import threading
from dataclasses import dataclass
from functools import cache

import llvmlite
import llvmlite.binding as llvm

from flexhinf.codegen import c_library

_LOCK = threading.RLock()  # LLVM's global state
_SERIAL = itertools.count()
_LARGE = 20_000  # operations


@dataclass(frozen=True)
class Effort:
    """Optimisation levels, 0 to 3: of the passes over LLVM's own text, and of the choice of instructions.

    For a large program the second is what takes the time: measured, level 1 gave the same speed as level 3 in
    four fifths of the time, and level 0 ran five times slower.
    """

    passes: int
    instructions: int

    @classmethod
    def for_size(cls, operations: int) -> Effort:
        """All of it, but less for more than 20,000 operations."""
        return cls(3, 3) if operations <= _LARGE else cls(2, 1)


@dataclass(frozen=True)
class Host:
    """The processor that runs this process.

    Attributes
    ----------
    triple, cpu, features : str
        As LLVM names them.
    version : str
        Of llvmlite and of LLVM.
    """

    triple: str
    cpu: str
    features: str
    version: str

    @property
    def fused(self) -> bool:
        """The processor has a fused multiply-add."""
        return not self.triple.startswith(("x86", "i386", "i686")) or "+fma" in self.features.split(",")


class Code:
    """Machine code loaded into this process; released when the object is.

    Parameters
    ----------
    image : bytes
        An object file for this host.
    entry : str
        Name of the function to find.
    library : dict of str to str
        C library functions that it needs.

    Attributes
    ----------
    address : int
        Of the entry.
    """

    def __init__(self, image: bytes, entry: str, library: dict[str, str]) -> None:
        builder = llvm.JITLibraryBuilder().add_object_img(image).add_current_process().export_symbol(entry)
        for name, address in c_library.addresses(library).items():
            builder.import_symbol(name, address)
        with _LOCK:
            self._resources = builder.link(_linker(), f"flexhinf{next(_SERIAL)}")
        self.address: int = self._resources[entry]


@cache
def host() -> Host:
    """The processor that runs this process."""
    with _LOCK:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        version = f"llvmlite {llvmlite.__version__}, LLVM {'.'.join(map(str, llvm.llvm_version_info))}"
        features = llvm.get_host_cpu_features().flatten()
        return Host(llvm.get_process_triple(), llvm.get_host_cpu_name(), features, version)


def assemble(text: str, effort: Effort) -> bytes:
    """Optimise LLVM text and return an object file for this host.

    Parameters
    ----------
    text : str
    effort : Effort

    Returns
    -------
    bytes
    """
    with _LOCK:
        module = llvm.parse_assembly(text)
        module.verify()
        tuning = llvm.create_pipeline_tuning_options(speed_level=effort.passes)
        passes = llvm.create_pass_builder(_target(effort.passes), tuning)
        passes.getModulePassManager().run(module, passes)
        return _target(effort.instructions).emit_object(module)


def _target(level: int) -> llvm.TargetMachine:
    machine = host()
    return llvm.Target.from_triple(machine.triple).create_target_machine(
        cpu=machine.cpu, features=machine.features, opt=level, reloc="pic", codemodel="small"
    )


@cache
def _linker() -> llvm.LLJIT:
    # JITLink keeps the sections of an object together. The older linker takes memory wherever there is some; in a
    # process with large arrays code and constants can end up more than 2 GB apart, and it then aborts the process.
    return llvm.create_lljit_compiler(_target(0), use_jit_link=True)
