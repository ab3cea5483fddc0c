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
# Past this many operations, less optimisation: 95,000 operations take seconds even so.
_LARGE = 20_000


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


def level(operations: int) -> int:
    """Optimisation level for a program of that many operations."""
    return 3 if operations <= _LARGE else 1


def assemble(text: str, optimisation: int) -> bytes:
    """Optimise LLVM text and return an object file for this host.

    Parameters
    ----------
    text : str
    optimisation : int
        0 to 3.

    Returns
    -------
    bytes
    """
    with _LOCK:
        target = _target(optimisation)
        module = llvm.parse_assembly(text)
        module.verify()
        tuning = llvm.create_pipeline_tuning_options(speed_level=optimisation)
        passes = llvm.create_pass_builder(target, tuning)
        passes.getModulePassManager().run(module, passes)
        return target.emit_object(module)


def _target(optimisation: int) -> llvm.TargetMachine:
    machine = host()
    return llvm.Target.from_triple(machine.triple).create_target_machine(
        cpu=machine.cpu, features=machine.features, opt=optimisation, reloc="pic", codemodel="small"
    )


@cache
def _linker() -> llvm.LLJIT:
    return llvm.create_lljit_compiler(_target(0))
