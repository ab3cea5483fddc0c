"""LLVM text to machine code in this process, linked with the C mathematical library. Loading this loads llvmlite."""

# llvmlite has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownArgumentType=false

from __future__ import annotations

import ctypes
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache

import llvmlite
import llvmlite.binding as llvm

from flexhinf.codegen.program import Unsupported

#: What is done to LLVM's own text, in this order. The emitter shares subexpressions and writes straight lines in
#: loops: what is left are the columns in hand, addresses, and small loops. Measured, all of level 3 gives the same
#: speed in up to twice the time, and each run of it leaves 0.2 MB and more in the process, which llvmlite never frees.
_PASSES = (
    "always_inliner",
    "simplify_cfg",
    "sroa",
    "instruction_combine",
    "simplify_cfg",
    "loop_simplify",
    "lcssa",
    "loop_rotate",
    "new_gvn",
    "mem_copy_opt",
    "dead_store_elimination",
    "loop_unroll",
    "instruction_combine",
    "simplify_cfg",
)


def level(operations: int) -> int:
    """How hard LLVM looks for the best instructions, 0 to 3: 3, or 1 above 20,000 operations.

    For a large program this is what takes the time: measured, level 1 gave the same speed as level 3 in four fifths
    of the time, and level 0 ran five times slower.
    """
    return 3 if operations <= 20_000 else 1


@dataclass(frozen=True)
class Host:
    """The processor that runs this process.

    `triple`, `cpu`, `features`: As LLVM names them. `version`: Of llvmlite and of LLVM.
    """

    triple: str
    cpu: str
    features: str
    version: str

    @property
    def fused(self) -> bool:
        """Whether the processor has a fused multiply-add."""
        return not self._x86 or "+fma" in self.features.split(",")

    @property
    def choosing(self) -> bool:
        """Whether to choose between two vectors costs less than to compute with both: not by AVX2, two or three
        instructions of Intel's processors, while AVX-512 has masks."""
        return not self._x86 or "+avx512f" in self.features.split(",")

    @property
    def _x86(self) -> bool:
        return self.triple.startswith(("x86", "i386", "i686"))


#: What PTX is made for: any card since 2018.
PTX = Host("nvptx64-nvidia-cuda", "sm_75", "+ptx63", "")


class Code:
    """Machine code loaded into this process; released when the object is.

    `image`: An object file for this host. `entry`: Name of the function to find. `library`: C library functions that
    it needs: name used in the machine code to name in the C library. `address`: Of the entry. Raises Unsupported: A
    function that this C library does not have.
    """

    def __init__(self, image: bytes, entry: str, library: dict[str, str]) -> None:
        builder = llvm.JITLibraryBuilder().add_object_img(image).add_current_process().export_symbol(entry)
        for emitted, name in library.items():
            builder.import_symbol(emitted, _address(name))
        # A linker of its own: what one linker has once linked leaves 10 KB in it for ever. JITLink keeps the sections
        # of an object together; the older linker takes memory wherever there is some, and where code and constants
        # then are more than 2 GB apart, in a process with large arrays, it aborts the process.
        self._linker = llvm.create_lljit_compiler(_target(0), use_jit_link=True)
        self._resources = builder.link(self._linker, "flexhinf")
        self.address: int = self._resources[entry]


@cache
def host() -> Host:
    """The processor that runs this process."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    version = f"llvmlite {llvmlite.__version__}, LLVM {'.'.join(map(str, llvm.llvm_version_info))}"
    return Host(
        llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten(), version
    )


def assemble(text: str, level: int) -> bytes:
    """Optimise LLVM text and return an object file for this host.

    `level`: See `level`; at 0 the text is translated as it stands.
    """
    target = _target(level)
    with _optimised(text, level, target) as module:
        return target.emit_object(module)


def assemble_ptx(text: str, level: int) -> str:
    """Optimise LLVM text and return PTX, which the driver of a GPU assembles for the card at hand."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(PTX.triple)
    target = machine.create_target_machine(cpu=PTX.cpu, features=PTX.features, opt=max(1, level))
    with _optimised(text, level, target) as module:
        return target.emit_assembly(module)


@contextmanager
def _optimised(text: str, level: int, target: llvm.TargetMachine) -> Generator[llvm.ModuleRef]:
    with llvm.create_context() as context, llvm.parse_assembly(text, context) as module:
        module.triple, module.data_layout = target.triple, str(target.target_data)
        module.verify()
        with (
            llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()) as builder,
            llvm.create_new_module_pass_manager() as passes,
        ):
            for name in _PASSES if level else ():
                getattr(passes, f"add_{name}_pass")()
            passes.run(module, builder)
        yield module


def _target(level: int) -> llvm.TargetMachine:
    machine = host()
    return llvm.Target.from_triple(machine.triple).create_target_machine(
        cpu=machine.cpu, features=machine.features, opt=level, reloc="pic", codemodel="small"
    )


#: Where functions of the C library are looked for beside this process (None), by platform.
_LIBRARIES = {"win32": ("ucrtbase", "msvcrt"), "darwin": (None, "libm.dylib")}


@cache
def _address(name: str) -> int:
    for library in _LIBRARIES.get(sys.platform, (None, "libm.so.6", "libm.so")):
        with suppress(OSError):
            function = getattr(ctypes.CDLL(library), name, None)
            if function is not None and (address := ctypes.cast(function, ctypes.c_void_p).value):
                return address
    raise Unsupported("The C library lacks a function.", f"'{name}' was not found on {sys.platform}")
