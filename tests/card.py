"""A driver of a GPU that runs on this processor: the functions of NVIDIA's that are used, and a card of theirs.

Its memory is this process's. A kernel is loaded by the hash of its PTX: the same text of one lane, compiled for this
processor, is called for each thread, those of the last block without a plant left out.
"""

from __future__ import annotations

import ctypes
import hashlib
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flexhinf.codegen import Program, compiler, cuda, gpu, machine
from flexhinf.codegen.threads import KERNEL, PLANT, emit_threads

SOURCE = r"""
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
typedef void (*plant_type)(void *table, int64_t plant, int64_t plants);
typedef plant_type (*loader_type)(const char *ptx);
typedef uint64_t address;
loader_type loader;
int cards = 1, major = 9, refusal = 0, failing = 0, arrays = 0, launches = 0;
size_t unused = (size_t)1 << 30;

int cuInit(unsigned flags) { return cards < 0 ? 100 : 0; }
int cuDeviceGetCount(int *count) { *count = cards; return 0; }
int cuDeviceGet(int *device, int ordinal) { *device = ordinal; return 0; }
int cuDeviceGetAttribute(int *value, int which, int device) { *value = which == 75 ? major : 0; return 0; }
int cuDeviceGetName(char *name, int size, int device) { strncpy(name, "this processor", size); return 0; }
int cuDevicePrimaryCtxRetain(void **context, int device) { *context = &cards; return 0; }
int cuCtxSetCurrent(void *context) { return context == &cards ? 0 : 201; }
int cuDriverGetVersion(int *version) { *version = 12040; return 0; }
int cuCtxSynchronize(void) { return failing; }
int cuMemGetInfo_v2(size_t *left, size_t *total) { *left = *total = unused; return 0; }
int cuGetErrorString(int code, const char **text) { *text = code == 2 ? "out of memory" : "of the stand-in"; return 0; }
int cuMemAlloc_v2(address *place, size_t size) {
    if (size > unused) { return 2; }
    arrays++;
    *place = (address)malloc(size);
    memset((void *)*place, 0xff, size);
    return 0;
}
int cuMemFree_v2(address place) { arrays--; free((void *)place); return 0; }
int cuMemcpyHtoD_v2(address to, const void *from, size_t size) { memcpy((void *)to, from, size); return 0; }
int cuMemcpyDtoH_v2(void *to, address from, size_t size) { memcpy(to, (void *)from, size); return 0; }
int cuModuleLoadDataEx(void **module, const char *ptx, unsigned n, int *options, void **values) {
    if (refusal) {
        for (unsigned k = 0; k < n; ++k) { if (options[k] == 5) { strcpy(values[k], "ptxas: line 7"); } }
        return refusal;
    }
    *module = (void *)loader(ptx);
    return *module == 0 ? 218 : 0;
}
int cuModuleGetFunction(void **kernel, void *module, const char *name) { *kernel = module; return 0; }
int cuLaunchKernel(void *kernel, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned by, unsigned bz,
                   unsigned shared, void *stream, void **values, void **extra) {
    void *table = *(void **)values[0];
    int64_t plants = *(int64_t *)values[1];
    launches++;
    for (int64_t k = 0; k < (int64_t)gx * bx; ++k) {
        if (k < plants) { ((plant_type)kernel)(table, k, plants); }
    }
    return 0;
}
"""

_LOADER = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_char_p)


class StandIn:
    """The library, and what it was asked for."""

    def __init__(self, folder: Path) -> None:
        found = shutil.which("gcc") or shutil.which("cc")
        if found is None:
            pytest.skip("missing: a C compiler")
        source = folder / "driver.c"
        source.write_text(SOURCE, encoding="utf-8")
        self.path = source.with_suffix(".so")
        subprocess.run([found, "-O1", "-shared", "-fPIC", str(source), "-o", str(self.path)], check=True)
        self.library = ctypes.CDLL(str(self.path))
        self._made = dict[str, Callable[[], machine.Code]]()
        self._codes = dict[str, machine.Code]()
        self._loader = _LOADER(self._load)
        ctypes.c_void_p.in_dll(self.library, "loader").value = ctypes.cast(
            self._loader, ctypes.c_void_p
        ).value

    def __getitem__(self, name: str) -> int:
        return ctypes.c_int.in_dll(self.library, name).value

    def __setitem__(self, name: str, value: int) -> None:
        ctypes.c_int.in_dll(self.library, name).value = value

    def compile_ptx(self, program: Program, returned: tuple[str, ...], fused: bool | None = None) -> str:
        """As the one of the compiler; knows afterwards which program the PTX is of."""
        ptx = compiler.compile_ptx(program, returned, fused)
        once = machine.host().fused if fused is None else fused

        def made() -> machine.Code:
            module = emit_threads(program, returned, once, kernel=False)
            return machine.Code(machine.assemble(str(module), 1), PLANT, module.library)

        assert f".entry {KERNEL}" in ptx
        self._made[_digest(ptx.encode())] = made
        return ptx

    def _load(self, ptx: bytes) -> int | None:
        key = _digest(ptx)
        if key not in self._codes and key in self._made:
            self._codes[key] = self._made[key]()
        return self._codes[key].address if key in self._codes else None


def _digest(ptx: bytes) -> str:
    return hashlib.sha256(ptx).hexdigest()


@pytest.fixture(scope="session")
def stand_in(tmp_path_factory: pytest.TempPathFactory) -> StandIn:
    """The library, compiled once."""
    return StandIn(tmp_path_factory.mktemp("driver"))


@pytest.fixture
def on_stand_in(stand_in: StandIn, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Kernels of a GPU run by it; at the end nothing is left in its memory."""
    card = cuda.Card(cuda.Driver(str(stand_in.path)))
    monkeypatch.setattr(cuda, "card", lambda: card)
    monkeypatch.setattr(gpu, "compile_ptx", stand_in.compile_ptx)
    before = {name: stand_in[name] for name in ("cards", "major", "refusal", "failing", "arrays")}
    yield stand_in
    left = stand_in["arrays"]
    for name, value in before.items():
        stand_in[name] = value
    assert left == 0
