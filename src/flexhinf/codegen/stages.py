"""A traced function as one function for each of its stages, some of which are called only where a flag is set.

What one stage computes for later ones is kept in memory under the name of the stage's result, so that in C every stage
is a function with named arguments and results, and equal ones are one function.

One trace computes both sides of every choice. Where a long one counts in few samples only, such as the steps of a
takeover, that is most of it in vain. Stages that lead to results through choices by one flag alone run where the flag
is not zero.

No bit of a result changes: products stay with the sums that they are fused into, and quotients share the reciprocals
that they would share in one function.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, groupby

import casadi

from flexhinf.codegen.cut import Filling, pieces
from flexhinf.codegen.dataflow import LEAVES, Operation, read_dataflow
from flexhinf.codegen.memory import Buffer, BufferPart, Slice
from flexhinf.codegen.naming import Names
from flexhinf.codegen.operations import OPERATIONS, SELECT
from flexhinf.codegen.program import Call, Copy, Repeat, Stages, Step, TracedStage, When
from flexhinf.scalars.trace import built

#: Operations for which a flag is asked; fewer cost less than what two more calls pass on.
WORTH = 100

#: Lines of a function to which a new section of the algorithm is not added, and operations of all columns of a matrix
#: that go together.
SECTION, COLUMNS = 6, 400

#: Lines of an operation that stands in the expression of another, about: an expression has only so many.
INSIDE = 1 / 2

#: Results that are neighbours among the arguments, from which on they are copied.
FEW = 4

#: A function: of those before a flag is asked, where it is set, or after (0, 1, 2), the k-th; where a reciprocal ends
#: one, the piece of it.
Group = tuple[int, int, int]


def staged(call: Call, buffer: str, often: str = "") -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
    """The steps in the place of a call, and the buffer of this name if they need it; a short call stays one.

    `often`: A buffer whose flags are nearly always set, such as that of the measurement.
    """
    return _Functions(_Operations.of(call), buffer, often).steps()


def staged_call(
    name: str,
    inputs: Sequence[casadi.SX],
    results: Sequence[Sequence[casadi.SX]],
    stages: Sequence[TracedStage],
    ends: Sequence[Sequence[casadi.SX]],
    pieces: tuple[Sequence[Slice], Sequence[Slice]],
    called: tuple[str, ...],
) -> Call:
    """The call of a function of some inputs in stages, and what these end with. `pieces`: Read and written; `called`:
    the names of both."""

    def function(columns: Sequence[Sequence[casadi.SX]]) -> casadi.Function:
        return casadi.Function(name, inputs, [casadi.densify(casadi.vertcat(*own)) for own in columns])

    whole = Stages(function([*ends, *results]), tuple(stages))
    about = {stage.about for stage in stages}
    sentence = about.pop() if len(about) == 1 else ""
    return Call(function(results), tuple(pieces[0]), tuple(pieces[1]), sentence, called, whole)


@dataclass(frozen=True)
class _Operations:
    """Those of a call that results need, in order; `outputs` are (result, element, operation). `stages`: of the call;
    `stage`: of each. `labels`: Of what a stage gives: the name of the result, the place in it, and that in all that the
    stage gives."""

    call: Call
    operations: list[Operation]
    outputs: list[tuple[int, int, int]]
    stages: tuple[TracedStage, ...]
    stage: list[int]
    labels: dict[int, tuple[str, int, int]]

    @classmethod
    def of(cls, call: Call) -> _Operations:
        stages = call.stages or Stages(call.function, ())
        count, rows = len(stages.rows), stages.rows
        flow = read_dataflow(stages.function, OPERATIONS, False, count)
        operations = list(flow.operations.values())
        stage = [min(bisect_left(flow.ends, k), max(count - 1, 0)) for k in range(len(operations))]
        labels = dict[int, tuple[str, int, int]]()
        for n, element, k in flow.stages:
            if stage[k] == n and element:
                labels.setdefault(k, (*rows[n].result(element - 1), element))
        return cls(call, operations, flow.outputs, rows, stage, labels)

    def is_anywhere(self, k: int) -> bool:
        """Whether it is a flag that is reversed, which every function does by itself."""
        return self.operations[k].code == casadi.OP_NOT

    def is_leaf(self, k: int) -> bool:
        """Whether it is a constant or an element of an argument."""
        return self.operations[k].code in LEAVES

    def inside(self) -> Iterator[int]:
        """Those that some function has alone."""
        return (k for k in range(len(self.operations)) if not self.is_leaf(k) and not self.is_anywhere(k))

    def operands(self, k: int) -> tuple[int, ...]:
        """What an operation reads; of a flag that is reversed, the flag."""
        return self._operands[k]

    @cached_property
    def _operands(self) -> list[tuple[int, ...]]:
        found = list[tuple[int, ...]]()
        for operation in self.operations:  # each reads earlier ones
            values = (
                (v,) if self.operations[v].code != casadi.OP_NOT else found[v] for v in operation.operands
            )
            found.append(tuple(known for value in values for known in value))
        return found

    def values(self, k: int) -> tuple[int, ...]:
        """The value of an operation, or what every function makes it of."""
        return self.operands(k) if self.is_anywhere(k) else (k,)

    # The flag -----------------------------------------------------------------------------------------
    def flags(self) -> dict[int, frozenset[int]]:
        """Flags of which an operation needs every one: without one of them, no way leads from it to a result."""
        found = dict.fromkeys((k for _, _, k in self.outputs), frozenset[int]())
        for k in reversed(range(len(self.operations))):
            operation = self.operations[k]
            for place, argument in enumerate(operation.operands):
                chosen = operation.code == SELECT and place == 1
                flags = found[k] | {operation.arguments[0]} if chosen else found[k]
                found[argument] = found.get(argument, flags) & flags
        return {k: found[k] for k in self.inside()}

    def depends(self, buffer: str) -> set[int]:
        """Operations that depend on a buffer."""
        found = set[int]()
        for k, operation in enumerate(self.operations):
            if operation.code == casadi.OP_INPUT:
                if self.call.inputs[operation.arguments[0]].buffer == buffer:
                    found.add(k)
            elif found.intersection(self.operands(k)):
                found.add(k)
        return found

    def parted(self, often: str) -> tuple[int | None, dict[int, int]]:
        """The flag, if there is one, and of each operation whether it comes before, where the flag is set, or after."""
        whole, flags, usual = dict.fromkeys(self.inside(), 0), self.flags(), self.depends(often)
        counts = Counter(f for own in flags.values() for f in own if f in flags and f not in usual)
        ((flag, count),) = counts.most_common(1) or [(0, 0)]
        if count < WORTH:
            return None, whole
        rare = {k for k, own in flags.items() if flag in own}
        users = [k for k in whole if k not in rare and rare.intersection(self.operands(k))]
        after = min(users, default=0)
        part = {k: 2 if k >= after else 1 if k in rare else 0 for k in whole}
        self.together(part)
        small = sum(p == 1 for p in part.values()) < WORTH
        return (None, whole) if small or part[flag] else (flag, part)

    def fuses(self, one: int, k: int) -> bool:
        """Whether an operation is a product, and becomes one with a sum if only that reads it."""
        product, total = (OPERATIONS[self.operations[each].code] for each in (one, k))
        return bool(product.factors) and total.fused is not None

    def together(self, place: dict[int, int] | dict[int, Group]) -> None:
        """Move operations to where the only ones are that read them, and that they become one with."""
        uses = self._uses(place)
        for one in reversed(place):
            if self._is_inside(one, uses):
                place[one] = place[uses[one][0]]  # type: ignore[assignment]

    def _uses(self, own: Iterable[int]) -> dict[int, list[int]]:
        """What reads each operation; -1 is a result."""
        uses = defaultdict[int, list[int]](list)
        for k in own:
            for argument in self.operands(k):
                uses[argument].append(k)
        for _, _, k in self.outputs:
            uses[k].append(-1)
        return uses

    def _lines(self, k: int, uses: Sequence[int]) -> float:
        """Lines of an operation, about: fewer where it may stand in the expression of the only one that reads it."""
        user = self.operations[uses[0]] if len(uses) == 1 and uses[0] >= 0 else None
        if user is None or OPERATIONS[user.code].named or (user.code == SELECT and user.arguments[0] != k):
            return 1.0
        return 0.0 if self.fuses(k, uses[0]) else INSIDE

    def _is_inside(self, one: int, uses: Mapping[int, Sequence[int]]) -> bool:
        """Whether an operation becomes one with the only one that reads it."""
        return len(uses[one]) == 1 and uses[one] != [-1] and self.fuses(one, uses[one][0])

    # Functions ----------------------------------------------------------------------------------------
    def grouped(self, part: Mapping[int, int]) -> dict[int, Group]:
        """The function of each operation: whole stages, all columns of a matrix if they are not too many, or a piece of
        a long stage."""
        group, uses = dict[int, Group](), self._uses(part)
        last = {k: max(own, key=lambda user: (user < 0, user)) for k, own in uses.items()}
        for which in sorted({*part.values()}):
            filling, before = Filling(SECTION, last), -1
            for stage, values, alone in self._families([k for k in part if part[k] == which]):
                begins = any(each.begins for each in self.stages[before + 1 : stage + 1])
                before = stage
                sizes = {k: self._lines(k, uses[k]) for k in values}
                for k, (piece, lines) in enumerate(pieces(values, sizes, self.operands, last)):
                    number = filling.add(lines, piece, begins and not k, alone and not k)
                    group |= dict.fromkeys(piece, (which, number, 0))
        group = {k: group[k] for k in part}
        self.together(group)
        ends = list[int]()
        while new := set(self._ends(group)).difference(ends):
            ends = sorted([*ends, *new])
            group = {k: (*own[:2], bisect_left(ends, k)) for k, own in group.items()}
            self.together(group)
        return group

    def _ends(self, group: Mapping[int, Group]) -> Iterator[int]:
        """Operations with which a function ends, so that its quotients share no other reciprocals than they shall: of a
        reciprocal and a quotient by the same number CasADi makes quotients, and what another function computed is an
        argument, by which two quotients share one."""
        products, quotients = defaultdict[int, list[int]](list), defaultdict[int, list[int]](list)
        for k in group:
            operation = self.operations[k]
            for argument in {*operation.arguments} if operation.code == casadi.OP_MUL else ():
                products[argument].append(k)
            if operation.code == casadi.OP_DIV:
                quotients[operation.arguments[1]].append(k)
        for k, operation in enumerate(self.operations):
            if operation.code == casadi.OP_INV and k in group:
                here = sum(group[user] == group[k] for user in products[k])
                known = self.operations[operation.arguments[0]].code in (casadi.OP_INPUT, casadi.OP_SQRT)
                if 0 < here < len(products[k]) and not (here > 1 and known):
                    yield k
            first, *others = quotients[k] or [-1]
            if k in group and any(group[k] != group[first] == group[other] for other in others):
                yield first

    def _families(self, members: Iterable[int]) -> Iterator[tuple[int, list[int], bool]]:
        """Operations of a stage, or of those for all columns of a matrix, after the first stage; and whether they are
        of one of too many columns."""
        names = [next((name for name, *_ in stage.results), "") for stage in self.stages]
        own = sorted(members, key=self.stage.__getitem__)
        for _, family in groupby(own, lambda k: names[self.stage[k]] if names else self.stage[k]):
            values = list(family)
            if len(values) <= COLUMNS:
                yield self.stage[values[0]], values, False
            else:
                yield from ((n, list(some), True) for n, some in groupby(values, self.stage.__getitem__))


def _expression(code: int, operands: Sequence[casadi.SX]) -> casadi.SX:
    """An operation; a choice as CasADi has it, in two halves."""
    if code != SELECT:
        return built(code, operands)
    flag, yes, no = operands
    reversed_flag = built(casadi.OP_NOT, [flag])
    return built(casadi.OP_IF_ELSE_ZERO, [flag, yes]) + built(casadi.OP_IF_ELSE_ZERO, [reversed_flag, no])


class _Functions:
    """The calls in the place of one; `traced` is its operations."""

    def __init__(self, traced: _Operations, buffer: str, often: str) -> None:
        self.traced, self.call, self.buffer = traced, traced.call, buffer
        self.flag, part = traced.parted(often)
        self.group = traced.grouped(part)
        self.groups = sorted({*self.group.values()})
        read = {piece.buffer for piece in self.call.inputs}
        #: (result, element, operation) of what each function writes; what is none's is the last one's.
        self.written: dict[Group, list[tuple[int, int, int]]] = {group: [] for group in self.groups}
        self.copies, outputs = _copies(traced)
        for result, element, k in outputs:
            own = self.group.get(k, self.groups[-1])
            direct = own[0] != 1 and self.call.outputs[result].buffer not in read
            self.written[own if direct else self.groups[-1]].append((result, element, k))
        labels, last = traced.labels, self._crossing()
        self._names, self._others = (
            Names(name for name, *_ in labels.values()),
            dict[tuple[str, Group | None], str](),
        )
        order = {k: (self.group[k], traced.stage[k], labels[k][2] if k in labels else k) for k in last}
        #: Values by part of the buffer and place in it; of turns of a loop, one after the other in one place.
        self.parts: dict[str, dict[int, list[int]]] = {}
        self.part_of: dict[int, str] = {}
        for k in sorted(order, key=order.__getitem__):
            name = self._part(k)
            while True:
                part = self.parts.setdefault(name, {})
                place = labels[k][1] if k in labels else len(part)
                if place not in part or last[part[place][-1]] <= self.group[k]:
                    break
                name = self._other(f"{name}_before", None)  # one of a turn before is read later
            part.setdefault(place, []).append(k)
            self.part_of[k] = name
        ends = [0, *accumulate(map(len, self.parts.values()))]
        self.begin = dict(zip(self.parts, ends))
        self.size = ends[-1]
        self.place = {
            k: self.begin[name] + place
            for name, part in self.parts.items()
            for place, values in enumerate(part.values())
            for k in values
        }

    def _crossing(self) -> dict[int, Group]:
        """Values that another function reads, and the last one that does."""
        reads = [(argument, self.group[k]) for k in self.group for argument in self.traced.operands(k)]
        for group, rows in self.written.items():
            reads += [(value, group) for _, _, k in rows for value in self.traced.values(k)]
        found = dict[int, Group]()
        for k, group in reads:
            if k in self.group and group != self.group[k]:
                found[k] = max(group, found.get(k, group))
        if self.flag is not None:
            found[self.flag] = max(found.get(self.flag, (1, 0, 0)), (1, 0, 0))
        return found

    def _part(self, k: int) -> str:
        """The part of the buffer for a value: that of a stage's result, or what else is known of its stage."""
        if k in self.traced.labels:
            return self.traced.labels[k][0]
        stages = self.traced.stages
        name = stages[self.traced.stage[k]].name if stages else self.call.function.name()
        return self._other(f"of_{name}", self.group[k])

    def _other(self, name: str, group: Group | None) -> str:
        """What a part is called that is of no stage's result: another name in each function."""
        if (name, group) not in self._others:
            self._others[name, group] = self._names.allot(name, "")
        return self._others[name, group]

    def steps(self) -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
        """The calls, and the buffer in which one passes numbers to the next."""
        if len(self.groups) < 2:
            return (self.call,), ()
        about = dict[str, str]()
        calls = {group: self._call(group, about) for group in self.groups}
        before, rare, after = ([call for (which, *_), call in calls.items() if which == k] for k in (0, 1, 2))
        steps: tuple[Step, ...] = tuple(before)
        if self.flag is not None:
            steps += (When(Slice(self.buffer, self.place[self.flag], 1), tuple(_repeated(rare))),)
        parts = tuple(BufferPart(name, self.begin[name], about.get(name, "")) for name in self.parts)
        passes = self.size > 0
        scratch = (Buffer(self.buffer, self.size, "work", cleared=False, parts=parts),) if passes else ()
        return (*steps, *after, *self.copies), scratch

    def _read(self, group: Group) -> tuple[list[int], dict[str, Slice]]:
        """Arguments of the call, and parts of the buffer, that a function reads."""
        needed = {a for k, own in self.group.items() if own == group for a in self.traced.operands(k)}
        needed |= {value for _, _, k in self.written[group] for value in self.traced.values(k)}
        leaves = [self.traced.operations[k] for k in needed if self.traced.is_leaf(k)]
        arguments = {leaf.arguments[0] for leaf in leaves if leaf.code == casadi.OP_INPUT}
        names = {self.part_of[k] for k in needed if k in self.place and self.group[k] != group}
        pieces = dict[str, Slice]()
        for name in (name for name in self.parts if name in names):
            values = self.parts[name].values()
            own = any(self.group[k] == group for some in values for k in some)
            there = sum(self.group[some[0]] < group for some in values) if own else len(values)
            pieces[name] = Slice(self.buffer, self.begin[name], there)
        return sorted(arguments), pieces

    def _call(self, group: Group, abouts: dict[str, str]) -> Call:
        """The call of one function; what it does is said of the first part that it writes."""
        function, traced = self.call.function, self.traced
        read, pieces = self._read(group)
        symbols = {k: casadi.SX.sym(f"i{k}", function.size1_in(k)) for k in read}
        passed = {name: casadi.SX.sym(f"p{k}", piece.size) for k, (name, piece) in enumerate(pieces.items())}
        values = dict[int, casadi.SX]()
        for k, operation in enumerate(traced.operations):
            if operation.code == casadi.OP_CONST:
                values[k] = casadi.SX(operation.constant)
            elif operation.code == casadi.OP_INPUT:
                if operation.arguments[0] in symbols:
                    values[k] = symbols[operation.arguments[0]][operation.arguments[1]]
            elif self.group.get(k, group) == group:
                if all(a in values for a in operation.arguments):
                    values[k] = _expression(operation.code, [values[a] for a in operation.arguments])
            elif k in self.place and (name := self.part_of[k]) in passed:
                place = self.place[k] - self.begin[name]
                if place < pieces[name].size:
                    values[k] = passed[name][place]
        written, results, names = list[Slice](), list[list[casadi.SX]](), list[str]()
        for name, part in self.parts.items():
            own = [(self.place[k], k) for some in part.values() for k in some if self.group[k] == group]
            for run in _runs(own):
                written.append(Slice(self.buffer, run[0][0], len(run)))
                results.append([values[k] for _, k in run])
                names.append(name)
        for result, rows in groupby(sorted(self.written[group], key=lambda row: row[:2]), lambda row: row[0]):
            whole = self.call.outputs[result]
            for run in _runs([(element, k) for _, element, k in rows]):
                written.append(replace(whole, offset=whole.offset + run[0][0], size=len(run)))
                results.append([values[k] for _, k in run])
                names.append(self._name(function.n_in() + result))
        whole, stages, ends = self._stages(group, values)
        said = next((stage.about for stage in stages if stage.about), "")
        if said and names and names[0] in self.parts:
            sentence = " ".join(said.partition("\n\n")[0].split())
            abouts.setdefault(names[0], sentence if sentence not in abouts.values() else "")
        inputs, places = [*symbols.values(), *passed.values()], [self.call.inputs[k] for k in read]
        called = (*(self._name(k) for k in read), *pieces, *names)
        return staged_call(
            whole, inputs, results, stages, ends, ([*places, *pieces.values()], written), called
        )

    def _name(self, k: int) -> str:
        """What an argument or a result of the call is called."""
        return self.call.names[k] if self.call.names else f"i{k}"

    def _stages(
        self, group: Group, values: Mapping[int, casadi.SX]
    ) -> tuple[str, list[TracedStage], list[list[casadi.SX]]]:
        """The name of one function, that of its longest stage or of the turn of a loop, its stages, and their ends."""
        traced = self.traced
        members = [k for k, own in self.group.items() if own == group]
        if not traced.stages:
            return f"{self.call.function.name()}_{group[0]}", [], []
        ends = {
            stage: [k for k in members if traced.stage[k] == stage] for stage in range(len(traced.stages))
        }
        ends = {stage: end for stage, end in ends.items() if end}
        own = [traced.stages[stage] for stage in ends]
        longest = max(ends, key=lambda stage: len(ends[stage]))
        known = [traced.labels[k][:2] for k in members if k in traced.labels]
        first = {label: min(at for name, at in known if name == label) for label, _ in known}

        def label(k: int) -> str:
            name, place, _ = traced.labels.get(k, ("", 0, 0))
            return f"{name}_{place - first[name]}" if name else ""

        stages = [
            TracedStage(stage.name, stage.about, labels=tuple(map(label, end)))
            for stage, end in zip(own, ends.values())
        ]
        turn = next((stage.turn for stage in own if stage.turn), traced.stages[longest].name)
        return turn, stages, [[values[k] for k in end] for end in ends.values()]


def _copies(traced: _Operations) -> tuple[list[Copy], list[tuple[int, int, int]]]:
    """Copies of neighbours among arguments that are results, and the other outputs, as (result, element, operation)."""
    copies, others = list[Copy](), list[tuple[int, int, int]]()
    read = {piece.buffer for piece in traced.call.inputs}

    def moves(pair: tuple[int, tuple[int, int, int]]) -> tuple[int, ...] | None:
        turn, (result, element, k) = pair
        operation = traced.operations[k]
        if operation.code != casadi.OP_INPUT:
            return None
        argument, source = operation.arguments
        return (
            None
            if traced.call.outputs[result].buffer in read
            else (result, element - turn, source - element, argument)
        )

    for key, each in groupby(enumerate(sorted(traced.outputs, key=lambda row: row[:2])), moves):
        rows = [row for _, row in each]
        if key is None or len(rows) < FEW:
            others += rows
            continue
        result, first, k = rows[0]
        argument, source = traced.operations[k].arguments
        origin, target = traced.call.inputs[argument], traced.call.outputs[result]
        here, there = origin.offset + source, target.offset + first
        copies.append(
            Copy(replace(origin, offset=here, size=len(rows)), replace(target, offset=there, size=len(rows)))
        )
    return copies, others


def _repeated(calls: Iterable[Call]) -> Iterator[Step]:
    """Calls, those as loops that are several times the same."""

    def key(call: Call) -> tuple[object, ...]:
        return call.function.serialize(), call.inputs, call.outputs

    for _, same in groupby(calls, key):
        call, *others = same
        yield Repeat(1 + len(others), (call,)) if others else call


def _runs(rows: list[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
    """Rows whose first numbers are neighbours."""
    for _, run in groupby(enumerate(rows), lambda pair: pair[1][0] - pair[0]):
        yield [row for _, row in run]
