"""The peers of the exported C: CasADi's own C of the same step, and a linear predictive controller by ADMM.

Each is a folder as `flexhinf export c` makes it, with other files ``arm.h``, ``arm.c`` and ``arm_test.c``: compilers,
flags, boards and counters of `benchmarks.firmware` are the same. The samples are those of the closed loop with the
program's own controller, none of them missing.

*CasADi*: Algorithm 1 and the law as one function of numbers alone (SX), all parameters constants, by CasADi's
``CodeGenerator``; what its users get who write the step with it. It has what a step needs to give the same inputs, and
nothing of what surrounds it here (missing measurements, checks of numbers, memories to go back to). In ``float``,
constants and functions are those of ``float``, which the generator leaves to its user.

*ADMM*: the mathematics of TinyMPC [nguyen2024tinympc], in a loop of our own: a Riccati recursion that is at its limit
gives the gains, and each iteration is a sweep backwards for the linear terms, one forwards for states and inputs, a
clipping, and an update of the multipliers. A steady Kalman filter of the same noise gives the state.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import expm, solve_discrete_are

import flexhinf as fh
from flexhinf.codegen import DIRECT
from flexhinf.plant import rk4_step
from flexhinf.scalars import trace

#: Samples of a run, standard deviation of the noise in rad, and the limit of every input, V.
SAMPLES, NOISE, LIMIT = 1000, 1e-5, 48.0

#: Of the predictive controller: samples ahead, iterations, and largest position error in rad beside the limit.
HORIZON, ITERATIONS, ERROR = 20, 5, 0.1

HEADER = """
typedef @REAL@ arm_real;
typedef struct { arm_real memory[@MEMORY@]; } arm_state;
typedef struct { int nothing; } arm_param;
typedef struct { arm_real y[@P@], r[@K@]; int measured; } arm_input;
typedef struct { arm_real u[@M@]; } arm_output;
static const arm_param arm_defaults = {0};
int arm_init(arm_state *state);
int arm_step(arm_state *state, const arm_param *param, const arm_input *input, arm_output *output);
"""

TEST = """
#include <stdio.h>
#include "arm.h"
enum { SAMPLES = @SAMPLES@, P = @P@, K = @K@, M = @M@ };
static const arm_real given_y[SAMPLES][P] = {@Y@}, given_r[K] = {@R@};
static const arm_real expected_u[SAMPLES][M] = {@U@}, size_of_u[M] = {@SIZES@};
static arm_state state;
int main(void)
{
    arm_input input = {0};
    arm_output output = {0};
    arm_real worst = 0;
    if (arm_init(&state) != 0) return 1;
    for (int i = 0; i < K; ++i) input.r[i] = given_r[i];
    input.measured = 1;
    for (int k = 0; k < SAMPLES; ++k) {
        for (int i = 0; i < P; ++i) input.y[i] = given_y[k][i];
        (void)arm_step(&state, &arm_defaults, &input, &output);
        for (int i = 0; i < M; ++i) {
            const arm_real away = output.u[i] - expected_u[k][i];
            const arm_real error = (away < 0 ? -away : away) / size_of_u[i];
            if (!(error <= worst) && worst == worst) worst = error; /* what is no number stays */
        }
    }
    printf("arm: %d samples, largest relative error %.3g\\n", (int)SAMPLES, (double)worst);
    return 0;
}
"""

INIT = """
static const arm_real begin[@MEMORY@] = {@BEGIN@};
int arm_init(arm_state *state)
{
    for (int i = 0; i < @MEMORY@; ++i) state->memory[i] = begin[i];
    return 0;
}
"""

CASADI = """
#define CASADI_SYMBOL_EXPORT static
#include "arm.h"
@GENERATED@
@INIT@
int arm_step(arm_state *state, const arm_param *param, const arm_input *input, arm_output *output)
{
    const arm_real *arg[step_SZ_ARG] = {state->memory, input->y, input->r};
    arm_real *res[step_SZ_RES] = {output->u, state->memory};
    (void)param;
    return step(arg, res, 0, 0, 0);
}
"""

ADMM = """
#include "arm.h"
enum { N = @N@, M = @M@, P = @P@, HORIZON = @HORIZON@, ITERATIONS = @ITERATIONS@ };
static const arm_real @NUMBERS@;
typedef struct { arm_real x[N], u[M], z[HORIZON][M], y[HORIZON][M]; } kept;
@INIT@
int arm_step(arm_state *state, const arm_param *param, const arm_input *input, arm_output *output)
{
    kept *s = (kept *)state;
    arm_real x[N], next[N], p[N], u[M], r[M], d[HORIZON][M];
    (void)param;
    for (int j = 0; j < P; ++j) { /* steady Kalman filter */
        u[0] = input->y[j] - level[j];
        for (int i = 0; i < N; ++i) u[0] -= C[j][i] * s->x[i];
        next[j] = u[0];
    }
    for (int i = 0; i < N; ++i) {
        x[i] = s->x[i];
        for (int j = 0; j < P; ++j) x[i] += L[i][j] * next[j];
    }
    for (int i = 0; i < N; ++i) { /* the state at which the input acts */
        next[i] = 0;
        for (int j = 0; j < N; ++j) next[i] += A[i][j] * x[j];
        for (int j = 0; j < M; ++j) next[i] += B[i][j] * s->u[j];
    }
    for (int i = 0; i < N; ++i) s->x[i] = next[i];
    for (int iteration = 0; iteration < ITERATIONS; ++iteration) {
        for (int i = 0; i < N; ++i) p[i] = 0;
        for (int k = HORIZON - 1; k >= 0; --k) { /* linear terms, backwards */
            for (int i = 0; i < M; ++i) {
                r[i] = penalty * (s->y[k][i] - s->z[k][i]);
                u[i] = r[i];
                for (int j = 0; j < N; ++j) u[i] += B[j][i] * p[j];
            }
            for (int i = 0; i < M; ++i) {
                d[k][i] = 0;
                for (int j = 0; j < M; ++j) d[k][i] += inverse[i][j] * u[j];
            }
            for (int i = 0; i < N; ++i) {
                next[i] = 0;
                for (int j = 0; j < N; ++j) next[i] += closed[j][i] * p[j];
                for (int j = 0; j < M; ++j) next[i] -= gain[j][i] * r[j];
            }
            for (int i = 0; i < N; ++i) p[i] = next[i];
        }
        for (int i = 0; i < N; ++i) x[i] = s->x[i];
        for (int k = 0; k < HORIZON; ++k) { /* states and inputs forwards, limits, multipliers */
            for (int i = 0; i < M; ++i) {
                u[i] = -d[k][i];
                for (int j = 0; j < N; ++j) u[i] -= gain[i][j] * x[j];
            }
            for (int i = 0; i < N; ++i) {
                next[i] = 0;
                for (int j = 0; j < N; ++j) next[i] += A[i][j] * x[j];
                for (int j = 0; j < M; ++j) next[i] += B[i][j] * u[j];
            }
            for (int i = 0; i < N; ++i) x[i] = next[i];
            for (int i = 0; i < M; ++i) {
                const arm_real wanted = u[i] + s->y[k][i];
                s->z[k][i] = wanted < lower[i] ? lower[i] : wanted > upper[i] ? upper[i] : wanted;
                s->y[k][i] = wanted - s->z[k][i];
            }
        }
    }
    for (int i = 0; i < M; ++i) {
        s->u[i] = s->z[0][i];
        output->u[i] = s->z[0][i] + hold[i];
    }
    return 0;
}
"""


def texts(values: Any, real: str) -> str:
    """Constants in C of the type, in braces row by row."""
    if np.ndim(values):
        return ", ".join(f"{{{texts(row, real)}}}" if np.ndim(row) else texts(row, real) for row in values)
    return repr(float(values)) + "f" * (real == "float")


def filled(template: str, **marks: Any) -> str:
    """A template with its marks."""
    for mark, value in marks.items():
        template = template.replace(f"@{mark}@", str(value))
    return template


def limited(controller: fh.Controller) -> fh.Controller:
    """The controller with the limit of every input."""
    return controller.fresh(saturation=LIMIT)


def seen(plant: fh.Plant, x: Any, u: Any) -> np.ndarray:
    """What is measured, without noise, (p,)."""
    return np.ravel(np.asarray(plant.traced_output(x, u, plant.parameters.vector()), dtype=float))


def recorded(controller: fh.Controller, one: Any) -> tuple[np.ndarray, np.ndarray]:
    """Measurements (SAMPLES, p) and inputs (SAMPLES, m) of a closed loop of `one` from the start of a design's step to
    its goal; `controller` is that of the design."""
    plant, noise = controller.estimator.plant, np.random.default_rng(0)  # type: ignore[union-attr]
    x = np.array(controller.estimator.initial[0], dtype=float)  # type: ignore[union-attr]
    acts = np.asarray(controller.input_before(), dtype=float)
    still, measurements, inputs = np.zeros(len(plant.disturbances)), [], []
    for _ in range(SAMPLES):
        y = seen(plant, x, acts) + NOISE * noise.standard_normal(len(plant.outputs))
        u = np.array(one.step(y, controller.operating_reference))
        measurements.append(y)
        inputs.append(u)
        x = np.asarray(
            rk4_step(lambda x, u: plant.derivative(x, u, still), x, (acts, acts, acts), controller.period)
        )
        acts = u  # a sample of latency
    return np.array(measurements), np.array(inputs)


class Peer:
    """A program in the place of the exported one: `begin` is its memory at first, `y` and `u` are its samples."""

    begin: np.ndarray
    y: np.ndarray
    u: np.ndarray

    def __init__(self, controller: fh.Controller) -> None:
        self.controller = controller
        assert controller.mode.latency == 1
        assert controller.estimator is not None
        self.e: Any = controller.estimator
        self.n, self.m, self.p = self.e.plant.n, len(controller.law.input_names), len(controller.measured)

    def source(self, real: str) -> str:
        """``arm.c`` without ``arm_init``, for which it has a mark."""
        raise NotImplementedError

    def write(self, folder: Path, real: str) -> None:
        """Replace the files of an exported folder."""
        marks = {"REAL": real, "MEMORY": len(self.begin), "BEGIN": texts(self.begin, real),
                 "P": self.p, "K": len(self.controller.commanded), "M": self.m}  # fmt: skip
        (folder / "arm.h").write_text(filled(HEADER, **marks), encoding="utf-8")
        (folder / "arm.c").write_text(filled(self.source(real), INIT=INIT, **marks), encoding="utf-8")
        write_test(folder, real, self.y, self.controller.operating_reference, self.u)


def write_test(folder: Path, real: str, y: np.ndarray, r: np.ndarray, u: np.ndarray) -> None:
    """A test that gives the samples, none of them missing, and says the largest error."""
    text = filled(
        TEST, SAMPLES=len(y), P=y.shape[1], K=len(r), M=u.shape[1], Y=texts(y, real), R=texts(r, real),
        U=texts(u, real), SIZES=texts(np.abs(u).max(axis=0), real),
    )  # fmt: skip
    (folder / "arm_test.c").write_text(text, encoding="utf-8")


class Exported(Peer):
    """The exported C itself, with the same samples."""

    def write(self, folder: Path, real: str) -> None:
        """Replace the test alone."""
        y, u = recorded(self.controller, self.controller.fresh())
        write_test(folder, real, y, self.controller.operating_reference, u)


class CasadiStep(Peer):
    """Algorithm 1 and the law as a function of CasADi. It begins after the first sample, at which the bumpless start
    chooses the integrals."""

    def __init__(self, controller: fh.Controller) -> None:
        super().__init__(controller)
        one = controller.fresh()
        y, u = recorded(controller, one)
        self.y, self.u = y[1:], u[1:]
        one.reset()
        one.step(y[0], controller.operating_reference)
        first = controller.memory.named(one._history.memory)
        self.begin = np.concatenate(
            [first.belief[0], np.ravel(first.belief[1]), first.integral, first.position, first.u]
        )

    @cached_property
    def function(self) -> ca.Function:
        """(memory, y, r) → (u, memory)."""
        c, e, n, m, p = self.controller, self.e, self.n, self.m, self.p
        numbers, point = e.plant.parameters.vector(), np.asarray(c.law.operating_point, dtype=float)
        k = len(point) - n
        memory, y, r = ca.SX.sym("memory", n + n * n + 2 * k + m), ca.SX.sym("y", p), ca.SX.sym("r", k)
        x, flat, integral, before, u = ca.vertsplit(memory, np.cumsum([0, n, n * n, k, k, m]).tolist())
        covariance = ca.reshape(flat, n, n)
        move = trace(lambda x, u: e.moved(DIRECT, x, u, numbers), n, m, name="move")
        see = trace(lambda x, u: e.output(x, u, numbers), n, m, name="see")
        law = trace(lambda x: c.law.evaluate_law(x, c.law.law_data), len(point), name="law")
        # correct: the output is linear in the state
        slope = ca.DM(see.jacobian()(np.zeros(n), np.zeros(m), np.zeros(p))[0])
        spread = covariance @ slope.T
        gain = ca.mrdivide(spread, slope @ spread + e.measurement_noise)
        x, covariance = x + gain @ (y - see(x, u)), covariance - gain @ spread.T
        # predict to where the input acts
        root = e.sigma.spread * ca.chol(covariance).T
        points = ca.horzcat(*(move(at, u) for at in ca.horzsplit(ca.horzcat(x, x + root, x - root))))
        x = points @ e.sigma.mean_weights
        apart = points - ca.repmat(x, 1, 2 * n + 1)
        covariance = apart @ ca.diag(e.sigma.covariance_weights) @ apart.T + e.process_noise
        # law, limits, integrals
        measured = ca.vertcat(*(y[c.measured.index(name)] for name in c.tracked))
        growth = c.period * (0.5 * (before + measured) - r)
        wanted = c.law.operating_input + law(ca.vertcat(x, integral + growth) - point)
        after = ca.fmin(ca.fmax(wanted, c.limits.lower), c.limits.upper)
        push = growth * (c.data.named(c.data_vector).integral_gain.T @ (wanted - after))
        kept = ca.if_else(push > 0, integral, integral + growth)
        memory_after = ca.vertcat(x, ca.vec(covariance), kept, measured, after)
        return ca.Function("step", [memory, y, r], [after, memory_after])

    def source(self, real: str) -> str:
        """What CasADi generates, called with the memory."""
        generator = ca.CodeGenerator("step", {"casadi_real": real, "casadi_int": "int", "with_header": False})
        generator.add(self.function)
        text = generator.dump()
        if real == "float":  # without: constants and functions of double
            text = re.sub(r"(?<![\w.])(\d+\.\d*(?:e[-+]\d+)?)(?![\w.])", r"\1f", text)
            single = (f"#define {name} {name}f" for name in ("sin", "cos", "sqrt", "fabs", "fmin", "fmax"))
            text = text.replace("#include <math.h>", "\n".join(["#include <math.h>", *single]))
        sizes = f"enum {{ step_SZ_ARG = {self.function.sz_arg()}, step_SZ_RES = {self.function.sz_res()} }};"
        return CASADI.replace("@GENERATED@", f"{text}\n{sizes}")


class Predictive(Peer):
    """A linear predictive controller about the goal with limits of the inputs, in NumPy too."""

    def __init__(self, controller: fh.Controller) -> None:
        super().__init__(controller)
        e, n, m, point = self.e, self.n, self.m, np.asarray(controller.law.operating_point, dtype=float)
        self.at, self.hold = point[:n], np.asarray(controller.law.operating_input, dtype=float)
        a, b, _ = e.plant.change_slopes(self.at, self.hold)
        whole = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * controller.period)
        self.a, self.b = whole[:n, :n], whole[:n, n:]
        self.c = np.asarray(trace(lambda x, u: e.output(x, u, e.plant.parameters.vector()), n, m).jacobian()(
            np.zeros(n), np.zeros(m), np.zeros(self.p))[0])  # fmt: skip
        self.level = seen(e.plant, self.at, self.hold)
        noise = np.asarray(e.measurement_noise)
        p = solve_discrete_are(self.a.T, self.c.T, np.asarray(e.process_noise), noise)
        self.filter_gain = p @ self.c.T @ np.linalg.inv(self.c @ p @ self.c.T + noise)
        weights, self.penalty = self.c.T @ self.c / ERROR**2, 1.0 / LIMIT**2
        both = 2.0 * self.penalty * np.eye(m)  # the cost of the input and ADMM's penalty
        p = solve_discrete_are(self.a, self.b, weights, both)
        self.inverse = np.linalg.inv(both + self.b.T @ p @ self.b)
        self.gain = self.inverse @ self.b.T @ p @ self.a
        self.lower, self.upper = controller.limits.lower - self.hold, controller.limits.upper - self.hold
        self.x = np.asarray(e.initial[0], dtype=float) - self.at
        self.last = np.asarray(controller.input_before(), dtype=float) - self.hold
        self.z, self.multipliers = np.zeros((HORIZON, m)), np.zeros((HORIZON, m))
        self.begin = np.concatenate([self.x, self.last, np.zeros(2 * HORIZON * m)])
        self.y, self.u = recorded(controller, self)

    def step(self, y: np.ndarray, r: np.ndarray) -> np.ndarray:
        """The input; the goal is that of the design."""
        x = self.x + self.filter_gain @ (y - self.level - self.c @ self.x)
        self.x = self.a @ x + self.b @ self.last
        closed = self.a - self.b @ self.gain
        for _ in range(ITERATIONS):
            p, feedforward = np.zeros(self.n), []
            for z, multiplier in zip(self.z[::-1], self.multipliers[::-1], strict=True):
                r = self.penalty * (multiplier - z)
                feedforward.append(self.inverse @ (self.b.T @ p + r))
                p = closed.T @ p - self.gain.T @ r
            x = self.x
            for k, d in enumerate(feedforward[::-1]):
                u = -self.gain @ x - d
                x, wanted = self.a @ x + self.b @ u, u + self.multipliers[k]
                self.z[k] = np.clip(wanted, self.lower, self.upper)
                self.multipliers[k] = wanted - self.z[k]
        self.last = self.z[0].copy()
        return self.last + self.hold

    def source(self, real: str) -> str:
        """The loops and their numbers."""
        tables = {
            "A": self.a, "B": self.b, "C": self.c, "L": self.filter_gain, "gain": self.gain, "inverse": self.inverse,
            "closed": self.a - self.b @ self.gain,
        }  # fmt: skip
        rows = {"level": self.level, "hold": self.hold, "lower": self.lower, "upper": self.upper}
        named = [
            *(f"{name}[{len(t)}][{len(t[0])}] = {{{texts(t, real)}}}" for name, t in tables.items()),
            *(f"{name}[{len(t)}] = {{{texts(t, real)}}}" for name, t in rows.items()),
            f"penalty = {texts(self.penalty, real)}",
        ]
        return filled(ADMM, N=self.n, HORIZON=HORIZON, ITERATIONS=ITERATIONS, NUMBERS=",\n    ".join(named))


PROGRAMS: dict[str, type[Peer]] = {"exported": Exported, "CasADi": CasadiStep, "ADMM": Predictive}

#: What is compared: name, and place in a row.
COMPARED = {
    "code and constants": "code", "state": "state", "stack": "stack", "instructions a step": "instructions",
    "cycles at most": "cycles", "error of `float`": "error",
}  # fmt: skip


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Where the exported C loses, then a row for every design, type and machine; in each cell the best comes first."""
    groups: dict[tuple[Any, ...], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        if row["program"]:
            groups.setdefault((row["links"], row["real"], row["machine"]), {})[row["program"]] = row
    lines = [f"| links | type, machine | {' | '.join(COMPARED)} |", "|---|---" + "|---" * len(COMPARED) + "|"]
    for (links, real, machine), programs in groups.items():
        cells = [_cell(programs, what, real) for what in COMPARED.values()]
        lines.append("| " + " | ".join([str(links), f"{real}, {machine}", *cells]) + " |")
    verdicts = [_verdict(groups.values(), peer) for peer in PROGRAMS if peer != "exported"]
    return "\n".join([*verdicts, "", *lines])


def _values(programs: Mapping[str, Mapping[str, Any]], what: str, real: str) -> dict[str, float]:
    """Numbers by program; none of an error in `double`, which is that of rounding."""
    shown = {name: row[what] for name, row in programs.items() if what in row}
    return {} if what == "error" and real == "double" else shown


def _cell(programs: Mapping[str, Mapping[str, Any]], what: str, real: str) -> str:
    forms: dict[str, Any] = {
        "error": "{:.0e}".format,
        "instructions": "{:,.0f}".format,
        "cycles": "{:,}".format,
    }
    values = sorted(_values(programs, what, real).items(), key=lambda pair: (np.isnan(pair[1]), pair[1]))
    return ", ".join(f"{name} {forms.get(what, kilobytes)(value)}" for name, value in values)


def _verdict(groups: Iterable[Mapping[str, Mapping[str, Any]]], peer: str) -> str:
    """In what the exported C is worse than a peer, and by what factor the peer needs more."""
    ratios: dict[str, list[float]] = {}
    for programs in groups:
        for name, what in COMPARED.items():
            values = _values(programs, what, programs[peer]["real"])
            if peer in values and what != "error":
                ratios.setdefault(name, []).append(values[peer] / values["exported"])
    always = [name for name, found in ratios.items() if max(found) < 1.0]
    partly = [name for name, found in ratios.items() if min(found) < 1.0 <= max(found)]
    texts = [
        f"{', '.join(names)} in {where}"
        for names, where in ((always, "every row"), (partly, "some rows"))
        if names
    ]
    shares = ", ".join(f"{name} {min(found):.2g} to {max(found):.2g}" for name, found in ratios.items())
    lost = "; ".join(texts) or "nothing"
    return (
        f"- Against {peer} the exported C loses: {lost}. {peer} needs, relative to the exported C: {shares}."
    )


def kilobytes(size: float) -> str:
    """A size for a reader."""
    return f"{size:.0f} B" if size < 1000 else f"{size / 1000:.1f} kB"
