"""A traced function in three, of which the second is called only where a flag is set.

One trace computes both sides of every choice. Where a long one counts in few samples only, such as the steps of a
takeover, that is most of it in vain. What leads to results through choices by one flag alone becomes a function of its
own, which runs where the flag is not zero. No bit of a result changes: products stay with the sums that they are fused
into, and quotients with those that share a reciprocal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise

import casadi

from flexhinf.codegen.memory import Buffer, Part, Slice
from flexhinf.codegen.program import Call, Stages, Step, When
from flexhinf.scalars.trace import built, walk

#: Operations for which a flag is asked; fewer cost less than what two more calls pass on.
WORTH = 100

#: Operations that become one with the only one that reads them: products with sums, and the sides of a choice.
TOGETHER = (casadi.OP_MUL, casadi.OP_SQ, casadi.OP_IF_ELSE_ZERO)

#: What the parts are called, and what each passes on.
PARTS = ("before", "rarely", "after")

#: Operations that are no operations.
LEAVES = (casadi.OP_CONST, casadi.OP_INPUT)


def rare_apart(call: Call, buffer: str, often: str = "") -> tuple[tuple[Step, ...], Buffer] | None:
    """The steps in the place of a call, and the buffer of this name that they need; None without such a flag.

    `often`: A buffer whose flags are nearly always set, such as that of the measurement.
    """
    return _Division.of(call).steps(buffer, often)


@dataclass(frozen=True)
class _Operation:
    code: int
    arguments: tuple[int, ...]
    constant: float = 0.0


@dataclass(frozen=True)
class _Division:
    """Operations of a call that results need, in order; `outputs` are (result, element, operation)."""

    call: Call
    operations: dict[int, _Operation]
    outputs: list[tuple[int, int, int]]
    stages: list[list[int]]

    @classmethod
    def of(cls, call: Call) -> _Division:
        count = len(call.stages.about) if call.stages else 0
        every: list[_Operation] = []

        def add(code: int, arguments: Iterable[int], constant: float = 0.0) -> int:
            every.append(_Operation(code, tuple(arguments), constant))
            return len(every) - 1

        outputs = list(
            walk(
                call.stages.function if call.stages else call.function,
                lambda *place: add(casadi.OP_INPUT, place),
                lambda constant: add(casadi.OP_CONST, (), constant),
                add,
            )
        )
        needed = {k for result, _, k in outputs if result >= count}
        for k in reversed(range(len(every))):
            if k in needed and every[k].code != casadi.OP_INPUT:
                needed.update(every[k].arguments)
        stages = [[k for result, _, k in outputs if result == n and k in needed] for n in range(count)]
        own = [(result - count, element, k) for result, element, k in outputs if result >= count]
        return cls(call, {k: every[k] for k in sorted(needed)}, own, stages)

    def operands(self, k: int) -> tuple[int, ...]:
        """What an operation reads; of a flag that is reversed, which every part does by itself, the flag."""
        operation = self.operations[k]
        if operation.code in LEAVES:
            return ()
        return tuple(known for argument in operation.arguments for known in self.values(argument))

    def values(self, k: int) -> tuple[int, ...]:
        """The value of an operation, or what every part makes it of."""
        return self.operands(k) if self._is_anywhere(k) else (k,)

    def _is_anywhere(self, k: int) -> bool:
        return self.operations[k].code == casadi.OP_NOT

    def flags(self) -> dict[int, frozenset[int]]:
        """Flags of which an operation needs every one: without one of them, no way leads from it to a result."""
        found = dict.fromkeys((k for _, _, k in self.outputs), frozenset[int]())
        for k in reversed(self.operations):
            operation = self.operations[k]
            for place, argument in enumerate(operation.arguments if operation.code not in LEAVES else ()):
                chosen = operation.code == casadi.OP_IF_ELSE_ZERO and place == 1
                flags = found[k] | {operation.arguments[0]} if chosen else found[k]
                found[argument] = found.get(argument, flags) & flags
        return {
            k: flags
            for k, flags in found.items()
            if self.operations[k].code not in LEAVES and not self._is_anywhere(k)
        }

    def depends(self, buffer: str) -> set[int]:
        """Operations that depend on a buffer."""
        found = set[int]()
        for k, operation in self.operations.items():
            read = (
                operation.code == casadi.OP_INPUT
                and self.call.inputs[operation.arguments[0]].buffer == buffer
            )
            if read or found.intersection(self.operands(k)):
                found.add(k)
        return found

    def parts(self, often: str) -> tuple[int, dict[int, int]] | None:
        """The flag, and the part of each operation: before, where the flag is set, and after."""
        flags, usual = self.flags(), self.depends(often)
        counts = Counter(
            flag for own in flags.values() for flag in own if flag in flags and flag not in usual
        )
        if not counts:
            return None
        ((flag, count),) = counts.most_common(1)
        if count < WORTH:
            return None
        rare = {k for k, own in flags.items() if flag in own}
        others = (k for k in self.operations if k not in rare and not self._is_anywhere(k))
        users = [k for k in others if rare.intersection(self.operands(k))]
        after = min(users, default=0)
        part = {
            k: 2 if k >= after else 1 if k in rare else 0
            for k, operation in self.operations.items()
            if operation.code not in LEAVES and not self._is_anywhere(k)
        }
        uses = Counter(argument for k in part for argument in self.operands(k))
        uses.update(k for _, _, k in self.outputs)
        for k in reversed(part):
            for one in self.operands(k):
                if one in part and uses[one] == 1 and self.operations[one].code in TOGETHER:
                    part[one] = part[k]
        shared: dict[int, set[int]] = {}
        for k in part:
            if self.operations[k].code == casadi.OP_DIV:
                shared.setdefault(self.operands(k)[1], set()).add(part[k])
        divided = any(len(places) > 1 for places in shared.values())
        return None if divided or part[flag] or sum(p == 1 for p in part.values()) < WORTH else (flag, part)

    def steps(self, buffer: str, often: str) -> tuple[tuple[Step, ...], Buffer] | None:
        """The calls, with what one of them passes to the next in a buffer."""
        found = self.parts(often)
        if found is None:
            return None
        flag, part = found
        # the last part that reads a number; all results are written by the last part
        reads = [(argument, part[k]) for k in part for argument in self.operands(k)]
        reads += [(value, 2) for _, _, k in self.outputs for value in self.values(k)]
        last = dict.fromkeys(part, 0)
        for k, which in reads:
            if k in part:
                last[k] = max(last[k], which)
        crossing = [[k for k in part if part[k] == which < last[k] and k != flag] for which in (0, 1)]
        crossing[0].insert(0, flag)
        ends = [0, *accumulate(map(len, crossing))]
        places = [Slice(buffer, first, end - first) for first, end in pairwise(ends)]
        calls = [self._call(part, which, crossing, places) for which in (0, 1, 2)]
        rare = calls[1].stages
        about = next(iter(rare.about), "") if rare else ""
        parts = Part(PARTS[0], ends[0]), Part(PARTS[1], ends[1], about)
        scratch = Buffer(buffer, ends[-1], "work", cleared=False, parts=parts)
        return (calls[0], When(replace(places[0], size=1), (calls[1],)), calls[2]), scratch

    def _call(
        self, part: dict[int, int], which: int, crossing: Sequence[list[int]], places: Sequence[Slice]
    ) -> Call:
        """The call of one part, which reads what those before it leave."""
        function = self.call.function
        arguments = [casadi.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
        passed = [casadi.SX.sym(f"part{k}", len(crossing[k])) for k in range(min(which, 2))]
        values = {k: passed[p][place] for p in range(which) for place, k in enumerate(crossing[p])}
        read = set[int]()
        for k, operation in self.operations.items():
            if operation.code == casadi.OP_CONST:
                values[k] = casadi.SX(operation.constant)
            elif operation.code == casadi.OP_INPUT:
                values[k] = arguments[operation.arguments[0]][operation.arguments[1]]
            elif self._is_anywhere(k):
                (one,) = operation.arguments
                if one in values:
                    values[k] = built(operation.code, [values[one]])
            elif part[k] == which:
                values[k] = built(operation.code, [values[a] for a in operation.arguments])
                read.update(
                    self.operations[a].arguments[0]
                    for a in self.operands(k) if self.operations[a].code == casadi.OP_INPUT
                )  # fmt: skip
        if which < 2:
            results, written = [casadi.vertcat(*(values[k] for k in crossing[which]))], (places[which],)
        else:
            results = [casadi.SX.zeros(function.size1_out(k)) for k in range(function.n_out())]
            for result, element, k in self.outputs:
                results[result][element] = values[k]
                if self.operations[k].code == casadi.OP_INPUT:
                    read.add(self.operations[k].arguments[0])
            written = self.call.outputs
        kept = sorted(read)
        inputs = [*(arguments[k] for k in kept), *passed]
        pieces = (*(self.call.inputs[k] for k in kept), *places[:which])
        results = [casadi.densify(result) for result in results]
        own = [[k for k in stage if part.get(k) == which] for stage in self.stages]
        ends = [casadi.densify(casadi.vertcat(*(values[k] for k in stage))) for stage in own if stage]
        of = self.call.stages
        names, about = (
            tuple(t for t, stage in zip(texts, own) if stage)
            for texts in ((of.names, of.about) if of else ((), ()))
        )
        own_name = f"{function.name()}_{PARTS[which]}"
        stages = Stages(casadi.Function(own_name, inputs, [*ends, *results]), names, about)
        called = casadi.Function(own_name, inputs, results)
        known = self.call.names[: function.n_in()] if self.call.names else ()
        names_of = (*(known[k] for k in kept), *PARTS[:which]) if known else ()
        results_of = self.call.names[function.n_in() :] if which == 2 else (PARTS[which],)
        return Call(
            called, pieces, written, self.call.about, (*names_of, *results_of) if names_of else (), stages
        )
