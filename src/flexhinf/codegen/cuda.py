"""NVIDIA's driver by its own functions: the first card, its memory, and kernels of PTX. No toolkit is needed.

Which card is the first one is said by CUDA_VISIBLE_DEVICES, which the driver reads.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np

from flexhinf.errors import FlexhinfError

#: The driver's library, by platform.
LIBRARY: Final = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"

#: What to do without a card.
ON_CPU: Final = 'device="cpu" (--device cpu), which gives the same bits'

#: The oldest card that PTX is made for, see `flexhinf.codegen.machine.PTX`: its compute capability.
OLDEST: Final = (7, 5)

#: The driver's numbers of some errors, of attributes of a card and of a kernel, and of options of its assembler.
_FULL, _NO_CARD, _UNREADABLE = 2, 100, (218, 222)
_MAJOR, _MINOR = 75, 76
_SHARED_BYTES = 8
_ERROR_LOG, _ERROR_LOG_SIZE = 5, 6

#: Bytes of the assembler's messages that are kept.
_LOG = 8192

#: Threads of a block.
BLOCK: Final = 128


class CardError(FlexhinfError):
    """There is no GPU that can be used, or its driver refuses: nothing is wrong with what was to be run."""


class NoCard(CardError):
    """There is no GPU, no driver of one, or none that is new enough."""


class Driver:
    """The driver's library; its functions raise CardError. `path`: Of the library, or its name.

    Raises CardError: There is none, or it lacks a function.
    """

    def __init__(self, path: str = LIBRARY) -> None:
        self._path = path
        try:
            self._library = ctypes.CDLL(path)
        except OSError as reason:
            found = f"expected NVIDIA's, got {path}: {reason}"
            if isinstance(reason, FileNotFoundError) or "no such file" in str(reason).lower():
                raise NoCard("There is no driver of a GPU.", found, ON_CPU) from reason
            raise CardError("The driver of the GPU cannot be loaded.", found, ON_CPU) from reason

    def call(self, name: str, *arguments: object) -> None:
        """Call a function by its name."""
        code = self._function(name)(*arguments)
        if code:
            raise self._error(name, code)

    def _function(self, name: str) -> ctypes._NamedFuncPointer:  # pyright: ignore[reportPrivateUsage]
        try:
            return getattr(self._library, name)
        except AttributeError as reason:
            raise CardError(
                "The driver of the GPU is too old.", f"expected a function {name} in {self._path}", ON_CPU
            ) from reason

    def _error(self, name: str, code: int) -> CardError:
        said = ctypes.c_char_p()
        self._function("cuGetErrorString")(code, ctypes.byref(said))
        found = f"{name}: {(said.value or b'an unknown error').decode(errors='replace')} ({code})"
        if code == _FULL:
            return CardError("The memory of the GPU is full.", found, f"a smaller batch, or {ON_CPU}")
        if code == _NO_CARD:
            return NoCard("There is no GPU.", f"expected one of NVIDIA's, got {found}", ON_CPU)
        if code in _UNREADABLE:
            return CardError(
                "The driver of the GPU cannot read the kernel.", found, f"a newer driver, or {ON_CPU}"
            )
        return CardError("The GPU does not run the campaign.", found, ON_CPU)


class Card:
    """The first card of a driver, for one thread at a time: take `lock`, and call `begin` in each thread.

    Raises CardError: There is none, or it is too old.
    """

    def __init__(self, driver: Driver) -> None:
        self.driver, self.lock, self._context = driver, threading.RLock(), ctypes.c_void_p()
        number, self._device = ctypes.c_int(), ctypes.c_int()
        driver.call("cuInit", 0)
        driver.call("cuDeviceGetCount", ctypes.byref(number))
        if number.value == 0:
            raise NoCard("There is no GPU.", "expected one that CUDA_VISIBLE_DEVICES shows", ON_CPU)
        driver.call("cuDeviceGet", ctypes.byref(self._device), 0)
        version = self._attribute(_MAJOR), self._attribute(_MINOR)
        if version < OLDEST:
            raise NoCard(
                "The GPU is too old.",
                f"expected compute capability {OLDEST[0]}.{OLDEST[1]}, got {version[0]}.{version[1]}",
                ON_CPU,
            )

    def _attribute(self, which: int) -> int:
        value = ctypes.c_int()
        self.driver.call("cuDeviceGetAttribute", ctypes.byref(value), which, self._device)
        return value.value

    @property
    def name(self) -> str:
        """What it is called."""
        text = ctypes.create_string_buffer(256)
        self.driver.call("cuDeviceGetName", text, len(text), self._device)
        return text.value.decode(errors="replace")

    @property
    def version(self) -> str:
        """The newest CUDA that the driver knows."""
        number = ctypes.c_int()
        self.driver.call("cuDriverGetVersion", ctypes.byref(number))
        return f"{number.value // 1000}.{number.value % 1000 // 10}"

    def begin(self) -> None:
        """Make it the card of this thread."""
        if not self._context:
            self.driver.call("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), self._device)
        self.driver.call("cuCtxSetCurrent", self._context)

    @property
    def free(self) -> int:
        """Bytes of its memory that are free."""
        free, total = ctypes.c_size_t(), ctypes.c_size_t()
        self.driver.call("cuMemGetInfo_v2", ctypes.byref(free), ctypes.byref(total))
        return free.value

    def kernel(self, ptx: str, name: str) -> ctypes.c_void_p:
        """The kernel of a name in PTX, which the driver assembles for this card, and keeps until the process ends."""
        log, module, kernel = ctypes.create_string_buffer(_LOG), ctypes.c_void_p(), ctypes.c_void_p()
        options = (ctypes.c_int * 2)(_ERROR_LOG, _ERROR_LOG_SIZE)
        values = (ctypes.c_void_p * 2)(ctypes.addressof(log), len(log))
        content = ptx.encode() + b"\0"
        try:
            self.driver.call("cuModuleLoadDataEx", ctypes.byref(module), content, 2, options, values)
        except CardError as error:
            said = " ".join(log.value.decode(errors="replace").split())
            raise CardError(error.what, f"{error.found} {said}".strip(), error.advice) from error
        self.driver.call("cuModuleGetFunction", ctypes.byref(kernel), module, name.encode())
        return kernel

    def launch(
        self, kernel: ctypes.c_void_p, count: int, arguments: Sequence[int], group: int = 1, shared: int = 0
    ) -> None:
        """Run a kernel of 64-bit arguments for so many plants, a few more included, and wait for its end.

        `group`: Threads of a plant; if they are several, a block of threads is one plant's. `shared`: Bytes of memory
        that a block shares.
        """
        block, blocks = (BLOCK, -(-count // BLOCK)) if group == 1 else (group, count)
        if shared:
            self.driver.call("cuFuncSetAttribute", kernel, _SHARED_BYTES, shared)
        values = [ctypes.c_uint64(argument) for argument in arguments]
        pointers = (ctypes.c_void_p * len(values))(*map(ctypes.addressof, values))
        shape = blocks, 1, 1, block, 1, 1
        self.driver.call("cuLaunchKernel", kernel, *shape, shared, None, pointers, None)
        self.driver.call("cuCtxSynchronize")


class CardMemory:
    """Arrays in the memory of a card, released at the end of a block; addresses are integers."""

    def __init__(self, card: Card) -> None:
        self._driver, self._addresses = card.driver, list[int]()

    def __enter__(self) -> CardMemory:
        return self

    def __exit__(self, *failure: object) -> None:
        for address in self._addresses:
            try:
                self._driver.call("cuMemFree_v2", ctypes.c_uint64(address))
            except CardError:
                if failure == (None, None, None):  # else what failed is told
                    raise

    def empty(self, size: int) -> int:
        """Memory of so many bytes."""
        address = ctypes.c_uint64()
        self._driver.call("cuMemAlloc_v2", ctypes.byref(address), ctypes.c_size_t(max(8, size)))
        self._addresses.append(address.value)
        return address.value

    def put(self, array: np.ndarray) -> int:
        """A copy of an array."""
        content = np.ascontiguousarray(array)
        address = self.empty(content.nbytes)
        pointer, size = ctypes.c_void_p(content.ctypes.data), ctypes.c_size_t(content.nbytes)
        self._driver.call("cuMemcpyHtoD_v2", ctypes.c_uint64(address), pointer, size)
        return address

    def get(self, address: int, shape: tuple[int, ...], kind: type[float | np.int64] = float) -> np.ndarray:
        """What is there, as an array."""
        array = np.empty(shape, np.dtype(kind))
        pointer, size = ctypes.c_void_p(array.ctypes.data), ctypes.c_size_t(array.nbytes)
        self._driver.call("cuMemcpyDtoH_v2", pointer, ctypes.c_uint64(address), size)
        return array


def is_there() -> bool:
    """Whether this process has a card. Raises CardError: it has one that fails."""
    try:
        card()
    except NoCard:
        return False
    return True


@cache
def card() -> Card:
    """The first card of this process. Raises CardError: as `Driver` and `Card`."""
    return Card(Driver())
