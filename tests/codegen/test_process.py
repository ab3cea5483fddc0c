"""What compiling leaves in a process, and what a fork in the middle of it leaves to the child."""

import os
import subprocess
import sys
from pathlib import Path

import casadi
import pytest
from tests.costs import resident

from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program, machine
from flexhinf.codegen.emit.module import emit_module
from flexhinf.codegen.program import ENTRY

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc, forks")

X = casadi.SX.sym("x")

FORKS = """
import os, sys, threading
sys.path.insert(0, sys.argv[1])
from test_process import program
from flexhinf.codegen import compile_program
from flexhinf.codegen.shared import share

begun, latest = threading.Semaphore(0), 0

def build(k):
    global latest
    latest = k
    begun.release()
    return compile_program(program(150, 10.0 + k))

def work():
    for k in range(1000):
        share(("forked", k), lambda: build(k))

threading.Thread(target=work, daemon=True).start()
for k in range(4):
    begun.acquire()  # the other thread is about to compile, or compiles
    child = os.fork()
    if not child:
        for number in (latest - 1, latest):  # what the other thread has built, or was building
            share(("forked", number), lambda: compile_program(program(2, 500.0 + number)))
        compile_program(program(2, 1000.0 + k))
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
os._exit(0)
"""


def program(length: int, constant: float) -> Program:
    """Some steps of sin and exp, other ones for each constant."""
    value = X
    for k in range(length):
        value = casadi.sin(value * (constant + k)) + casadi.exp(-value * value)
    step = Call(casadi.Function("f", [X], [value]), (Slice("x"),), (Slice("x"),))
    return Program("process", (Buffer("x", 1, "state"),), (step,))


def growth(work, count: int) -> float:
    """KB that each call of work leaves, after some to begin with."""
    for _ in range(count // 2):
        work()
    before = resident()
    for _ in range(count):
        work()
    return (resident() - before) / count


@pytest.mark.ci("compiles in a process that forks four times")
def test_a_fork_while_another_thread_compiles_leaves_a_child_that_compiles():
    environment = {**os.environ, "FLEXHINF_CACHE": os.devnull}  # nothing is kept: all is compiled
    command = [sys.executable, "-c", FORKS, str(Path(__file__).parent)]
    subprocess.run(command, check=True, timeout=300, env=environment)


@pytest.mark.ci("loads a kernel 300 times")
def test_what_is_loaded_and_forgotten_is_given_back():
    module = emit_module(program(5, 1.0), 1, machine.host().fused)
    image = machine.assemble(str(module), 3)
    assert (
        growth(lambda: machine.Code(image, ENTRY, module.library), 200) < 3.0
    )  # KB; was 11 in one linker for all


@pytest.mark.ci("compiles a kernel 18 times")
def test_what_is_compiled_and_forgotten_leaves_little(monkeypatch):
    monkeypatch.setenv("FLEXHINF_CACHE", os.devnull)
    assert growth(lambda: compile_program(program(20, 3.0)), 12) < 60.0  # KB; was 850
