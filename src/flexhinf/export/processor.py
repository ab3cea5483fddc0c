"""Which instructions a compiled library needs, and which this processor has: asked before any of it is run."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from flexhinf.errors import InvalidInput
from flexhinf.validation import value_text

#: What the manifest of a library begins with; a line of instruction sets, one of JSON and a zero byte follow.
MARK = b"flexhinf library 2: instructions, then what it is\n"

#: Instruction sets beyond the oldest processor of a platform that compilers use on their own for such code: the macro
#: that says so, and LLVM's name without points.
INSTRUCTIONS = {
    "__SSE3__": "sse3", "__SSSE3__": "ssse3", "__SSE4_1__": "sse41", "__SSE4_2__": "sse42", "__POPCNT__": "popcnt",
    "__AVX__": "avx", "__AVX2__": "avx2", "__FMA__": "fma", "__FMA4__": "fma4", "__XOP__": "xop", "__TBM__": "tbm",
    "__BMI__": "bmi", "__BMI2__": "bmi2", "__LZCNT__": "lzcnt", "__MOVBE__": "movbe", "__F16C__": "f16c",
    "__GFNI__": "gfni", "__AVX512F__": "avx512f", "__AVX512CD__": "avx512cd", "__AVX512DQ__": "avx512dq",
    "__AVX512BW__": "avx512bw", "__AVX512VL__": "avx512vl", "__AVX512IFMA__": "avx512ifma",
    "__AVX512VBMI__": "avx512vbmi", "__AVX512VBMI2__": "avx512vbmi2", "__AVX512VNNI__": "avx512vnni",
    "__AVX512BITALG__": "avx512bitalg", "__AVX512VPOPCNTDQ__": "avx512vpopcntdq", "__AVX512BF16__": "avx512bf16",
    "__AVX512FP16__": "avx512fp16", "__APX_F__": "apxf", "__ARM_FEATURE_SVE": "sve", "__ARM_FEATURE_SVE2": "sve2",
}  # fmt: skip

#: Linux's names for some of them.
OF_LINUX = {"pni": "sse3", "bmi1": "bmi", "abm": "lzcnt", "apx": "apxf"}

#: PCs since about 2015: with a fused multiply-add, which every other operation of a step is.
PORTABLE = {"avx2", "fma"}

X86 = ("x86_64", "AMD64")


@cache
def instructions() -> frozenset[str]:
    """Instruction sets of this processor that the system permits, by LLVM's names without points."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:  # no Linux: LLVM knows, where it is installed
        return _of_llvm()
    line = next((line for line in text.splitlines() if line.startswith(("flags", "Features"))), "")
    words = line.partition(":")[2].split()
    return frozenset(OF_LINUX.get(word, word.replace("_", "")) for word in words)


def _of_llvm() -> frozenset[str]:
    try:
        from llvmlite.binding import get_host_cpu_features

        features = get_host_cpu_features()
    except (ImportError, OSError, RuntimeError):
        return frozenset()
    return frozenset(name.replace(".", "").replace("-", "") for name, there in features.items() if there)


def named_instructions() -> str:
    """C text: strings, each the name of a set that the compiler may use, with a space before it."""
    return "\n".join(f'#ifdef {macro}\n    " {name}"\n#endif' for macro, name in INSTRUCTIONS.items())


def compiler_flags(processor: str) -> tuple[str, ...]:
    """What tells gcc and clang for which processors to compile.

    `processor`: {"portable", "any", "native"}, PCs since about 2015 (AVX2 and fused multiply-adds; on a machine
    without them, as "any"), the oldest ones of the platform, or those with all that this one has. Other platforms than
    PCs have the first two in common. Raises InvalidInput: for another word.
    """
    if processor not in ("portable", "any", "native"):
        raise InvalidInput(
            "There is no such choice of processors.",
            f"expected portable, any or native, got {value_text(processor)}",
            "portable: PCs since about 2015; any: older ones too, slowly; native: those that are like this one",
        )
    if platform.machine() not in X86:
        return ("-mcpu=native",) if processor == "native" else ()
    if processor == "native":
        return ("-march=native",)
    fused = processor == "portable" and instructions() >= PORTABLE
    return ("-march=x86-64", *(f"-m{name}" for name in sorted(PORTABLE) if fused))


def check_instructions(needed: Iterable[str], name: str) -> None:
    """Refuse machine code that this processor would end with SIGILL."""
    needed = set(needed)
    if needed and (missing := sorted(needed - instructions())):
        raise InvalidInput(
            "The library is for another processor.",
            f"expected one that has {', '.join(missing)}, for which {name} was compiled; this one has not",
            "flexhinf compile DESIGN --processor portable, or on this machine",
        )
