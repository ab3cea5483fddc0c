"""A driver of a GPU that runs on this processor: the functions of NVIDIA's that are used, and a card of theirs.

Its memory is this process's. A kernel is the PTX that it is given, as C, which is called for each thread of each block.
The threads of a warp have stacks of their own. One after the other runs until it waits for the others, forwards or
`backwards`: where a wait is missing, a thread reads too early in one of the two.
"""

from __future__ import annotations

import ctypes
import hashlib
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.ptx import in_c

from flexhinf.codegen import cuda
from flexhinf.codegen.threads import KERNEL

SOURCE = r"""
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>
typedef void (*kernel_type)(uint64_t table, uint64_t plants);
typedef kernel_type (*loader_type)(const char *ptx);
typedef uint64_t address;
loader_type loader;
int cards = 1, major = 9, refusal = 0, failing = 0, arrays = 0, launches = 0, backwards = 0, waits = 0;
size_t unused = (size_t)1 << 30;

int cuInit(unsigned flags) { return cards == -1 ? 100 : cards < 0 ? 999 : 0; }
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

enum { WARP = 32, STACK = 1 << 20, MOST = 1 << 16, SURPLUS = 4096 };
unsigned char memory_of_block[MOST + SURPLUS];
static unsigned granted = 48 * 1024;
static ucontext_t scheduler, threads[WARP];
static char *stacks;
static int ended[WARP], here, said[2][WARP], turn[WARP], width;
static struct { kernel_type kernel; uint64_t table, plants; uint32_t block, threads, first; } launched;

int cuFuncSetAttribute(void *kernel, int which, int value) {
    if (which != 8 || value > MOST) { return 1; }
    granted = value > (int)granted ? (unsigned)value : granted;
    return 0;
}
uint32_t block_number(void) { return launched.block; }
uint32_t threads_of_block(void) { return launched.threads; }
uint32_t thread_number(void) { return launched.first + here; }
void wait_for_warp(void) { waits++; swapcontext(&threads[here], &scheduler); }
int any_of_warp(int condition) {
    int mine = turn[here] ^= 1, found = 0;
    said[mine][here] = condition;
    wait_for_warp();
    for (int k = 0; k < width; ++k) { found |= said[mine][k]; }
    return found;
}
static void run_thread(void) {
    launched.kernel(launched.table, launched.plants);
    ended[here] = 1;
}
/* Whether all threads waited as often as each other, and ended together. */
static int run_warp(unsigned count) {
    int left = width = count;
    stacks = stacks ? stacks : malloc((size_t)WARP * STACK);
    for (int k = 0; k < width; ++k) {
        getcontext(&threads[k]);
        threads[k].uc_stack.ss_sp = stacks + (size_t)k * STACK;
        threads[k].uc_stack.ss_size = STACK;
        threads[k].uc_link = &scheduler;
        ended[k] = turn[k] = 0;
        makecontext(&threads[k], run_thread, 0);
    }
    while (left == width) {
        for (int k = 0; k < width; ++k) {
            here = backwards ? width - 1 - k : k;
            swapcontext(&scheduler, &threads[here]);
            left -= ended[here];
        }
    }
    return left == 0;
}
int cuLaunchKernel(void *kernel, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned by, unsigned bz,
                   unsigned shared, void *stream, void **values, void **extra) {
    launches++;
    if (shared > granted) { return 1; }
    for (unsigned block = 0; block < gx; ++block) {
        memset(memory_of_block, 0xff, sizeof memory_of_block);
        launched.kernel = (kernel_type)kernel;
        launched.table = *(uint64_t *)values[0];
        launched.plants = *(uint64_t *)values[1];
        launched.block = block;
        launched.threads = bx;
        for (launched.first = 0; launched.first < bx; launched.first += WARP) {
            unsigned left = bx - launched.first;
            if (!run_warp(left < WARP ? left : WARP)) { return 719; }
        }
        for (unsigned k = 0; k < SURPLUS; ++k) { if (memory_of_block[shared + k] != 0xff) { return 700; } }
    }
    return 0;
}
"""

#: Of no rounding that is not written.
FLAGS = ("-O1", "-ffp-contract=off", "-shared", "-fPIC")


_LOADER = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_char_p)


class StandIn:
    """The library, and what it was asked for."""

    def __init__(self, folder: Path) -> None:
        found = shutil.which("gcc") or shutil.which("cc")
        if found is None:
            pytest.skip("missing: a C compiler")
        self._compiler, self._folder = found, folder
        self.path = self._compiled("driver", SOURCE)
        self.library = ctypes.CDLL(str(self.path), mode=ctypes.RTLD_GLOBAL)  # for the kernels
        self._kernels = dict[str, ctypes.CDLL]()
        self._loader = _LOADER(self._load)
        ctypes.c_void_p.in_dll(self.library, "loader").value = ctypes.cast(
            self._loader, ctypes.c_void_p
        ).value

    def __getitem__(self, name: str) -> int:
        return ctypes.c_int.in_dll(self.library, name).value

    def __setitem__(self, name: str, value: int) -> None:
        ctypes.c_int.in_dll(self.library, name).value = value

    def _compiled(self, name: str, text: str) -> Path:
        source = self._folder / f"{name}.c"
        source.write_text(text, encoding="utf-8")
        command = [self._compiler, *FLAGS, str(source), "-lm", "-o", str(source.with_suffix(".so"))]
        subprocess.run(command, check=True)
        return source.with_suffix(".so")

    def _load(self, ptx: bytes) -> int | None:
        key = hashlib.sha256(ptx).hexdigest()
        if key not in self._kernels:
            self._kernels[key] = ctypes.CDLL(str(self._compiled(key, in_c(ptx.decode()))))
        return ctypes.cast(getattr(self._kernels[key], KERNEL), ctypes.c_void_p).value


_made: list[StandIn] = []


@pytest.fixture(scope="session")
def stand_in(tmp_path_factory: pytest.TempPathFactory) -> StandIn:
    """The library, one in a process: kernels find its functions by name, those of the first one that is loaded.

    Each file that imports this fixture has it anew."""
    if not _made:
        _made.append(StandIn(tmp_path_factory.mktemp("driver")))
    return _made[0]


@pytest.fixture
def on_stand_in(stand_in: StandIn, monkeypatch: pytest.MonkeyPatch) -> Iterator[StandIn]:
    """The card of this process is one of that driver; at the end nothing is left in its memory."""
    card = cuda.Card(cuda.Driver(str(stand_in.path)))
    monkeypatch.setattr(cuda, "card", lambda: card)
    before = {
        name: stand_in[name] for name in ("cards", "major", "refusal", "failing", "arrays", "backwards")
    }
    yield stand_in
    left = stand_in["arrays"]
    for name, value in before.items():
        stand_in[name] = value
    assert left == 0
