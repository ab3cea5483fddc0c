"""A program walked step by step with CasADi's own evaluator: what compiled programs are compared with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flexhinf.codegen.compiler import Kernel, RunStatus, check_lanes
from flexhinf.codegen.memory import COLUMN, Columns, Slice, whole
from flexhinf.codegen.noise import normal_numbers
from flexhinf.codegen.program import (
    Call,
    Cholesky,
    Copy,
    Guard,
    Householder,
    Map,
    Normal,
    OuterSum,
    Polynomial,
    Program,
    Residual,
    Step,
    Sweep,
    When,
)
from flexhinf.polynomial.algebra import monomials


def interpret(program: Program, lanes: int = 1) -> Kernel:
    """A kernel that evaluates the program without compiling it.

    Parameters
    ----------
    lanes : int
        Lanes are run one after the other.

    Returns
    -------
    Kernel
        Some microseconds per call of a traced function.
    """
    check_lanes(program, lanes)
    return InterpretedKernel(program, lanes)


class InterpretedKernel(Kernel):
    """See `interpret`."""

    def _bind(self, arrays: dict[str, np.ndarray], counts: dict[str, int], short: bool) -> BoundWalk:
        return BoundWalk(self, arrays, counts)


class _Stop(Exception):
    """A guard failed; carries the code and the index of the outermost loop."""


Walk = Callable[[tuple[int, ...]], None]


class BoundWalk:
    """An interpreted program with its arrays; every lane is copied in, run, and copied back."""

    def __init__(
        self, kernel: InterpretedKernel, arrays: dict[str, np.ndarray], counts: dict[str, int]
    ) -> None:
        self._lanes = kernel.lanes
        self._counts = counts
        self._shared = {buffer.name: buffer.shared for buffer in kernel.program.buffers}
        self._arrays = arrays
        self._columns = {
            buffer.name: np.zeros(buffer.size or 0)
            if buffer.role == "work"
            else np.empty(self._column(buffer.name, 0).size)
            for buffer in kernel.program.buffers
        }
        work = [buffer for buffer in kernel.program.buffers if buffer.role == "work"]
        self._work = {
            buffer.name: 0.0 if buffer.cleared else np.nan for buffer in work
        }  # NaN tells on a reader
        self._written = [buffer.name for buffer in kernel.program.buffers if buffer.role in ("out", "state")]
        self._walks = [self._walk(step) for step in kernel.program.body]
        self._codes = np.zeros(kernel.lanes, dtype=np.int64)
        self._steps = np.full(kernel.lanes, -1, dtype=np.int64)

    def __call__(self) -> int:
        """Run every lane; the largest code, 0 when all is well."""
        for lane in range(self._lanes):
            self._codes[lane], self._steps[lane] = self._run_lane(lane)
        return int(self._codes.max())

    @property
    def status(self) -> RunStatus:
        """Status of the last call."""
        if self._lanes == 1:
            return RunStatus(int(self._codes[0]), int(self._steps[0]))
        return RunStatus(self._codes.copy(), self._steps.copy())

    def _run_lane(self, lane: int) -> tuple[int, int]:
        for name in self._arrays:
            self._columns[name][:] = self._column(name, lane)
        for name, start in self._work.items():
            self._columns[name][:] = start
        outcome = (0, -1)
        try:
            for walk in self._walks:
                walk(())
        except _Stop as stop:
            outcome = stop.args
        for name in self._written:
            self._column(name, lane)[:] = self._columns[name]
        return outcome

    def _column(self, name: str, lane: int) -> np.ndarray:
        array = self._arrays[name]
        if self._shared[name] or self._lanes == 1:
            return array.reshape(-1)
        return array.reshape(-1, self._lanes)[:, lane]

    def _walk(self, step: Step) -> Walk:
        if isinstance(step, Call | Map):
            return self._call(step)
        if isinstance(step, Sweep):
            return self._sweep(step)
        if isinstance(step, OuterSum):
            return self._outer_sum(step)
        if isinstance(step, Polynomial):
            return self._polynomial(step)
        if isinstance(step, Cholesky):
            return self._cholesky(step)
        if isinstance(step, Householder):
            return self._householder(step)
        if isinstance(step, Residual):
            return self._residual(step)
        if isinstance(step, Copy):
            source, target = self._view(step.source), self._view(step.target)

            def copy(turns: tuple[int, ...]) -> None:
                target(turns)[:] = source(turns).copy()

            return copy
        if isinstance(step, Normal):
            return self._normal(step)
        if isinstance(step, Guard):
            watched, code = self._view(step.source), step.code

            def guard(turns: tuple[int, ...]) -> None:
                if not np.isfinite(watched(turns)).all():
                    raise _Stop(code, turns[0] if turns else 0)

            return guard
        if isinstance(step, When):
            flag, body = self._view(step.flag), [self._walk(part) for part in step.body]

            def when(turns: tuple[int, ...]) -> None:
                if flag(turns)[0] != 0.0:
                    for walk in body:
                        walk(turns)

            return when
        inner = [self._walk(step) for step in step.body]
        count = self._counts[step.count] if isinstance(step.count, str) else step.count

        def repeat(turns: tuple[int, ...]) -> None:
            for turn in range(count):
                deeper = (*turns, turn)
                for walk in inner:
                    walk(deeper)

        return repeat

    def _call(self, step: Call | Map) -> Walk:
        arguments = [np.empty(piece.size) for piece in step.inputs]
        results = [np.empty(piece.size) for piece in step.outputs]
        evaluator: Any
        evaluator, trigger = step.function.buffer()
        for k, argument in enumerate(arguments):
            evaluator.set_arg(k, argument.data)
        for k, result in enumerate(results):
            evaluator.set_res(k, result.data)
        sources = [self._column_of(piece) for piece in step.inputs]
        targets = [self._column_of(piece) for piece in step.outputs]
        columns = step.count if isinstance(step, Map) else 1

        def call(
            turns: tuple[int, ...], _alive: Any = evaluator
        ) -> None:  # trigger does not own the evaluator
            for column in range(columns):
                for argument, source in zip(arguments, sources, strict=True):
                    argument[:] = source(turns, column)
                trigger()
                for target, result in zip(targets, results, strict=True):
                    target(turns, column)[:] = result

        return call

    def _sweep(self, step: Sweep) -> Walk:
        self._columns[COLUMN] = memory = np.full(step.size, np.nan)
        before, after = (
            [(self._column_of(columns), self._view(place)) for columns, place in pairs]
            for pairs in (step.inputs, step.outputs)
        )
        body = [self._walk(part) for part in step.body]

        def sweep(turns: tuple[int, ...]) -> None:
            for column in range(step.count):
                memory[:] = np.nan
                for matrix, place in before:
                    place(())[:] = matrix(turns, column)
                for walk in body:
                    walk(turns)
                for matrix, place in after:
                    matrix(turns, column)[:] = place(())

        return sweep

    def _outer_sum(self, step: OuterSum) -> Walk:
        left, right, target = (self._view(piece) for piece in (step.left, step.right, step.target))
        weights, plus = (piece and self._view(piece) for piece in (step.weights, step.plus))

        def outer_sum(turns: tuple[int, ...]) -> None:
            rows, others = (view(turns).reshape(step.count, -1) for view in (left, right))
            if weights is not None:
                rows = rows * weights(turns)[:, None]
            total = rows.T @ others
            if step.symmetric:
                total = np.tril(total) + np.tril(total, -1).T
            target(turns)[:] = total.ravel() if plus is None else total.ravel() + plus(turns)

        return outer_sum

    def _polynomial(self, step: Polynomial) -> Walk:
        point, table, target = (self._view(piece) for piece in (step.point, step.table, step.target))

        def polynomial(turns: tuple[int, ...]) -> None:
            x = point(turns)[None, :]
            powers = np.concatenate([part[0] for part in monomials(x, step.degrees).values()])
            rows = table(turns).reshape(step.rows, step.columns)[:, : step.target.size]
            target(turns)[:] = powers @ rows

        return polynomial

    def _cholesky(self, step: Cholesky) -> Walk:
        from flexhinf.scalars import cholesky

        source, target = self._view(step.source), self._view(step.target)

        def factor(turns: tuple[int, ...]) -> None:
            target(turns)[:] = cholesky(source(turns).reshape(step.order, step.order)).T.ravel()

        return factor

    def _householder(self, step: Householder) -> Walk:
        from flexhinf.scalars import householder

        source, target = self._view(step.source), self._view(step.target)

        def reflect(turns: tuple[int, ...]) -> None:
            target(turns)[:] = householder(source(turns).reshape(step.shape), step.count).ravel()

        return reflect

    def _residual(self, step: Residual) -> Walk:
        from flexhinf.scalars import residual

        rows, slope, target = (self._view(piece) for piece in (step.rows, step.slope, step.target))

        def subtract(turns: tuple[int, ...]) -> None:
            table, matrix = rows(turns).reshape(step.count, -1), slope(turns).reshape(step.shape)
            target(turns)[:] = residual(table, matrix).ravel()

        return subtract

    def _normal(self, step: Normal) -> Walk:
        step_number, key, target = (self._view(piece) for piece in (step.step, step.key, step.target))
        channels = np.arange(step.target.size)

        def normal(turns: tuple[int, ...]) -> None:
            sample, low, high = map(int, key(turns))
            seed = low + (high << 32)
            target(turns)[:] = normal_numbers(seed, int(step_number(turns)[0]), channels, sample)

        return normal

    def _column_of(self, piece: Slice | Columns) -> Callable[[tuple[int, ...], int], np.ndarray]:
        view = self._view(whole(piece))
        if isinstance(piece, Columns):
            shape = (piece.size, piece.count)
            return lambda turns, column: view(turns).reshape(shape, order=piece.order)[:, column]
        return lambda turns, column: view(turns)

    def _view(self, piece: Slice) -> Callable[[tuple[int, ...]], np.ndarray]:
        column = self._columns[piece.buffer]
        first = piece.offset + (self._counts[piece.shift] if piece.shift else 0)

        def view(turns: tuple[int, ...]) -> np.ndarray:
            moved = (stride * turn for stride, turn in zip(piece.strides, turns, strict=False))
            start = first + sum(moved)
            return column[start : start + piece.size]

        return view
