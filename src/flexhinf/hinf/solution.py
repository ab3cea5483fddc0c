"""The result of a synthesis: the value function, its law, its report, and its file.

The law is what a closed loop runs, u = −R2⁻¹ g2(x)ᵀ V_xᵀ on any element. With a constant g2 that is a polynomial, a
table of monomials; with g2(x) it is the product of the exact g2 and the polynomial V_x, as `sampled_region` checks it.

A file is a compressed NumPy archive with a version, written beside and moved into place.
"""

# Not checked strictly: a file is of any kind until it is read.
# pyright: reportUnknownArgumentType=false, reportUnknownVariableType=false

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.files import read_arrays, write_arrays
from flexhinf.hinf.homological import HOPELESS
from flexhinf.hinf.recursion import DOUBTFUL, DegreeRecord
from flexhinf.hinf.sampled import CheckedPenalty, checked_margin, sample_region
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.notebook import names_text
from flexhinf.numerals import number_text
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.plant.polynomial_plant import PolynomialPlant, Problem
from flexhinf.plant.protocols import Law
from flexhinf.polynomial.algebra import PolynomialLaw, add_part, product
from flexhinf.polynomial.basis import count
from flexhinf.scalars import digest, trace
from flexhinf.validation import checked_path

if TYPE_CHECKING:
    from flexhinf.certify.certificate import Certificate


def _row(degree: object, size: object, method: str, residual: str, error: str, seconds: float | None) -> str:
    time = "–" if seconds is None else f"{seconds:.2f} s" if seconds >= 1 else f"{1e3 * seconds:.2f} ms"
    return f"{degree:>6}  {size:>12}  {method:<19}  {residual:>17}  {error:>11}  {time:>8}"


@dataclass(frozen=True, eq=False, repr=False)
class HJISolution(ValueFunction, Law):
    """V = V_2 + … + V_degree with V_x f + ½ hᵀh + ½ V_x (g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ) V_xᵀ = O(|x|^(degree+1)).

    All states are deviations x from the operating point, shape (n,) or (N, n); results follow.

    In addition to those of `ValueFunction`:

    Attributes
    ----------
    records : tuple of DegreeRecord
        Method, residual and time by degree.
    condition : float
        Condition number of the closed loop's eigenvectors, in scaled coordinates (nan for degree 2).
    memory : int
        Estimate of the memory the solve needed, in bytes.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> problem = fh.paper_arm().problem()
    >>> solution = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=4)
    >>> x = np.array([0.3, 0.0, 0.3, 0.0, 0.0])
    >>> bool(solution.value(x) > 0.0), solution.law(x).shape
    (True, (1,))
    """

    records: tuple[DegreeRecord, ...] = ()
    condition: float = float("nan")
    memory: int = 0

    @property
    def gain(self) -> np.ndarray:
        """The law's linear part, shape (m, n): u = K x + …, K = −R2⁻¹ g2(0)ᵀ P."""
        return -np.linalg.solve(self.expansion.r2, self.expansion.g2_parts[0][:, :, 0].T @ self.P)

    sampled_region = sample_region  # functions whose first argument is a solution
    checked_margin = checked_margin

    def certify(
        self,
        gamma: float | None = None,
        penalty: CheckedPenalty | None = None,
        level: float | None = None,
        *,
        decay: float = 0.0,
        about: str = "",
        observer: float | None = None,
        threads: int | None = None,
        progress: Callable[[int, float], None] | None = None,
    ) -> Certificate:
        """Prove the dissipation inequality on a level set of V, by arithmetic that cannot round the wrong way.

        Parameters
        ----------
        gamma, penalty
            The checked pair, weaker than the designed one; as `sampled_region`.
        level : float, optional
            The level c to prove. Default: the largest that is proved, from just below the one that
            `sampled_region` finds.
        decay : float
            α in V̇ ≤ −αV + ½γ²|d|² − ½|z|²: with α > 0 the region is invariant for all |d| ≤ √(2αc)/γ.
        about : str
            What is certified, for readers of the certificate.
        observer : float, optional
            Bandwidth of an output-injection observer, 1/s: the certificate covers output feedback too, for initial
            errors that take up to a tenth of the level (`flexhinf.certify.proof.with_observer`).
        threads : int, optional
            The certificate does not depend on it. By default all processors.
        progress : callable, optional
            Called with the number of cells done and the estimated share of the whole, many times.

        Returns
        -------
        Certificate
            Of the state feedback, with `observer` also of the output feedback, nominal parameters: see
            docs/certificate.md for what it claims.

        Raises
        ------
        InvalidInput
            A plant of more than five states, or with functions that the method cannot take, by name.
        NumericalFailure
            `flexhinf.certify.NotProved`: the level, or none, could be proved; ``.point`` is where it fails.
        """
        from flexhinf.certify.proof import certify

        return certify(
            self,
            gamma,
            penalty,
            level,
            decay=decay,
            about=about,
            observer=observer,
            threads=threads,
            progress=progress,
        )

    def law_polynomial(self) -> PolynomialLaw:
        """The law as a table of monomials through degree − 1.

        With a constant g2 this is `law` itself; otherwise the product −R2⁻¹ g2(x)ᵀ V_xᵀ is truncated after
        degree − 1, the last degree that V determines.
        """
        n, _, m, _ = self.expansion.size
        parts: dict[int, np.ndarray] = {}
        for i, slope in self.slope_parts.items():
            for p, fields in self.expansion.g2_parts.items():
                if i - 1 + p <= self.degree - 1:
                    columns = [product(slope, fields[:, j], n, i - 1, p) for j in range(m)]
                    add_part(parts, i - 1 + p, -np.linalg.solve(self.expansion.r2, np.array(columns)))
        degrees = tuple(sorted(parts))
        return PolynomialLaw(n, degrees, np.concatenate([parts[k] for k in degrees], axis=1))

    # As a law of a closed loop (`flexhinf.plant.Law`) ----------------------------------------------
    @property
    def _source(self) -> GeneralisedPlant | PolynomialPlant:
        """The evaluator of g2 on any element: the problem itself where possible, else its expansion."""
        problem = self.problem
        return problem if isinstance(problem, GeneralisedPlant | PolynomialPlant) else self.expansion

    @cached_property
    def law_is_polynomial(self) -> bool:
        """Whether `law_polynomial` is the law itself: g2 is constant, and not only its expansion."""
        return self._source.input_matrix_is_constant

    @property
    def law_table(self) -> PolynomialLaw | None:
        """`law_polynomial` where it is the law itself."""
        return self.law_polynomial() if self.law_is_polynomial else None

    @property
    def law_degree(self) -> int:
        """Degree of V."""
        return self.degree

    @cached_property
    def _polynomials(self) -> PolynomialLaw:
        """The law where it is a polynomial; else V_x, one row per state, of which it is −R2⁻¹ g2(x)ᵀ V_xᵀ."""
        if self.law_is_polynomial:
            return self.law_polynomial()
        degrees = tuple(sorted(self.slope_parts))
        table = np.concatenate([self.slope_parts[k] for k in degrees]).T
        return PolynomialLaw(len(self.P), tuple(k - 1 for k in degrees), table)

    @property
    def law_data(self) -> np.ndarray:
        """Coefficients of the law, flat: data of a kernel, so another γ compiles nothing."""
        return self._polynomials.coefficients.ravel()

    @property
    def law_key(self) -> str:
        """Key of the law's code: its monomials, and R2⁻¹ g2ᵀ where it is not constant."""
        return self._key

    @cached_property
    def _key(self) -> str:
        n, degrees, matrix = self._polynomials.n, self._polynomials.degrees, self._source.input_matrix
        if self.law_is_polynomial:
            return f"polynomial {n} {degrees}"

        def priced(x: Elements) -> Elements:
            return self.input_price @ np.asarray(matrix(x)).T

        return f"gradient {n} {degrees} {digest(trace(priced, n, name='priced'))}"

    def evaluate_law(self, x: np.ndarray, data: np.ndarray) -> np.ndarray:
        """The law at one deviation x (n,) on any element, with its coefficients as an argument."""
        table = self._polynomials
        values = table.evaluate(x, np.asarray(data).reshape(table.coefficients.shape))
        if self.law_is_polynomial:
            return values
        return -(self.input_price @ (np.asarray(self._source.input_matrix(x)).T @ values))

    def summary(self) -> dict[str, str]:
        """γ, degree, states, inputs, coefficients and the largest residual of any degree, for ``repr``."""
        residuals = [record.residual for record in self.records if record.residual == record.residual]
        return {
            "gamma": number_text(self.gamma),
            "degree of V": str(self.degree),
            "states": names_text(self.state_names),
            "inputs": names_text(self.input_names),
            "coefficients": str(sum(len(part) for part in self.value_parts.values())),
            **({"largest relative residual": f"{max(residuals):.1e}"} if residuals else {}),
        }

    # Report and file ---------------------------------------------------------------------------
    def report(self) -> str:
        """Report of the synthesis by degree: method, measured residual, conditioning, time, memory."""
        n, md, m, s = self.expansion.size
        sizes = (n, "state"), (md, "disturbance"), (m, "input"), (s, "penalised output")
        counted = ", ".join(f"{number} {name}" + ("" if number == 1 else "s") for number, name in sizes)
        kind, level = "Bellman", "gamma = inf: no disturbance"
        if np.isfinite(self.gamma):
            kind, star = "Isaacs", self.gamma_star
            excess = self.gamma / star - 1 if star else np.inf
            ratio = f"{1 + excess:.4g}" if abs(excess) >= 1e-3 else f"(1 + {excess:.1e})"
            times = f" = {ratio} gamma*" if star else ""
            level = f"gamma = {self.gamma:.10g}{times}, gamma* = {star:.10g}"
        lines = [
            f"Hamilton–Jacobi–{kind} equation, {counted}",
            f"{level}; V to degree {self.degree}, the law to degree {self.degree - 1}",
            "",
            f"{'degree':>6}  {'coefficients':>12}  {'method':<19}  {'relative residual':>17}  {'error about':>11}  "
            f"{'time':>8}",
        ]
        for record in self.records:
            solved = record.method != "zero by parity"
            residual = f"{record.residual:.1e}" if solved else "–"
            error = f"{record.error:.1e}" if solved and not np.isnan(record.error) else "–"
            size, seconds = count(n, record.degree), record.seconds if solved else None
            lines.append(_row(record.degree, size, record.method, residual, error, seconds))
        total = sum(count(n, record.degree) for record in self.records)
        lines += [_row("total", total, "", "", "", sum(record.seconds for record in self.records)), ""]
        if doubtful := [record for record in self.records if record.error > DOUBTFUL]:
            worst, degrees = max(doubtful, key=lambda record: record.error), [str(r.degree) for r in doubtful]
            lines += [
                f"warning: few digits are determined by the data in degree {', '.join(degrees)}: "
                f"in degree {worst.degree}",
                f"         each holds to about {worst.error:.0e} of the largest; "
                "a gamma further above gamma* gives more",
                "",
            ]
        if not np.isnan(self.condition):  # the error of the eigenbasis before refinement is about cond(T)^k ε
            growth = self.condition**self.degree * np.finfo(float).eps
            lines += [
                f"closed loop: cond(T) = {self.condition:.3g} for its eigenvectors in scaled states, "
                f"cond(T)^{self.degree} eps = {growth:.1e}",
                f"             (eigenbasis up to {HOPELESS:g} and where its residual is at rounding, Schur otherwise)",
            ]
        sizes = ((1e9, f"{self.memory / 1e9:.2f} GB"), (1e6, f"{self.memory / 1e6:.1f} MB"))
        size = next(
            (text for minimum, text in sizes if self.memory >= minimum), f"{self.memory / 1e3:.1f} kB"
        )
        return "\n".join([*lines, f"memory: about {size} at the peak, estimated before the solve"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one file, atomically; see `load_solution`.

        Raises
        ------
        InvalidInput
            The place cannot be written.
        """
        plant = self.expansion
        header = {
            "format": _FORMAT,
            "version": _VERSION,
            "digest": "sha256",
            "gamma": repr(self.gamma),
            "degree": self.degree,
            "states": list(plant.state_names),
            "inputs": list(plant.input_names),
            "polynomial": isinstance(self.problem, PolynomialPlant),
            "condition": repr(self.condition),
            "memory": self.memory,
            "records": [asdict(record) for record in self.records],
        }
        exact = self.problem if isinstance(self.problem, PolynomialPlant) else plant
        parts = {"V": self.value_parts} | {name: getattr(exact, f"{name}_parts") for name in _FIELDS}
        arrays = {
            "header": np.array(json.dumps(header)),
            "P": self.P,
            "r2": plant.r2,
            "operating_point": plant.operating_point,
            "operating_input": plant.operating_input,
            **{f"{name}_{k}": part for name, by_degree in parts.items() for k, part in by_degree.items()},
        }
        write_arrays(path, "solution", arrays)


def load_solution(path: str | os.PathLike[str], problem: Problem | None = None) -> HJISolution:
    """Read a solution from a file of `HJISolution.save`.

    Parameters
    ----------
    path : path-like
    problem : Problem, optional
        The exact plant. Without it a solution of a `PolynomialPlant` is complete; one of another plant
        evaluates V, its gradient and law, but its residual raises, because the file holds only the
        expansion.

    Raises
    ------
    InvalidInput
        Not there, not such a file, damaged, or of a newer version.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import tempfile
    >>> problem = fh.paper_arm().problem()
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fh.linear_law(problem, gamma=200.0).save(f"{folder}/law")
    ...     same = fh.load_solution(f"{folder}/law", problem)
    >>> same.gamma
    200.0
    """
    path = checked_path("The solution's file", path)
    try:
        return HJISolution(**_assembled(*read_arrays(path), problem))
    except (FlexhinfError, *_DAMAGED) as error:
        own = (error.found or error.what) if isinstance(error, FlexhinfError) else ""
        raise InvalidInput(
            "The solution cannot be read.",
            f"expected a {_FORMAT} file, version {_VERSION}, got {path}: "
            f"{own or f'damaged or not such a file ({type(error).__name__})'}",
            "solve again and save; files are written by HJISolution.save",
        ) from error


_FORMAT, _VERSION = "flexhinf solution", 1
_FIELDS = ("f", "g1", "g2", "h")
HIGHEST = 200  # degree of V; far beyond what converges, and even one state would take minutes
# What reading a damaged file may raise.
_DAMAGED = (KeyError, ValueError, TypeError, AttributeError, OverflowError, RecursionError)


def _assembled(arrays: dict[str, np.ndarray], whole: bool, problem: Problem | None) -> dict[str, Any]:
    header = json.loads(str(arrays.pop("header")))
    if header["format"] != _FORMAT or header["version"] != _VERSION:
        raise InvalidInput("Another format.", f"{header['format']!r}, version {header['version']!r}")
    if "digest" in header and not whole:
        raise InvalidInput("Damaged.", "damaged: the digest under it is missing")
    for name, part in arrays.items():
        if part.dtype != np.float64 or not np.isfinite(part).all():
            raise InvalidInput("Wrong numbers.", f"{name} is not made of finite float64 numbers")
    states, inputs, degree = header["states"], header["inputs"], header["degree"]
    gamma, memory = float(header["gamma"]), header["memory"]
    for record in header["records"]:
        for name in {"residual", "seconds", "error"} & record.keys():
            record[name] = float(record[name])
    records = tuple(DegreeRecord(**record) for record in header["records"])
    if not (
        isinstance(states, list)
        and isinstance(inputs, list)
        and all(isinstance(name, str) for name in [*states, *inputs, *(record.method for record in records)])
        and all(type(number) is int for number in (degree, memory, *(record.degree for record in records)))
        and (2 <= degree <= HIGHEST and all(2 <= record.degree <= degree for record in records))
        and (gamma > 0 and 0 <= memory <= 1 << 62)
    ):
        raise InvalidInput(
            "Wrong header.", "names, degree, gamma, memory or records of the header make no sense"
        )
    if arrays["P"].shape != (len(states), len(states)):
        raise InvalidInput("Wrong shapes.", f"P does not fit {len(states)} states")
    exact = PolynomialPlant.from_parts(
        len(states),
        **{name: _gather(arrays, name, 0, HIGHEST) for name in _FIELDS},
        r2=arrays.pop("r2"),
        state_names=states,
        operating_point=arrays.pop("operating_point"),
        input_names=inputs,
        operating_input=arrays.pop("operating_input"),
    )
    p, value = arrays.pop("P"), _gather(arrays, "V", 2, degree)
    if arrays:
        raise InvalidInput("Foreign arrays.", f"{next(iter(arrays))[:50]!r} does not belong into it")
    if any(part.shape != (count(len(states), k),) for k, part in value.items()):
        raise InvalidInput("Wrong shapes.", f"coefficients of V do not fit {len(states)} states")
    rows, columns = np.triu_indices(len(states))
    quadratic = np.where(rows == columns, 0.5, 1.0) * p[rows, columns]
    if 2 not in value or not np.allclose(p, p.T, 1e-12, 0) or not np.allclose(value[2], quadratic, 1e-12, 0):
        raise InvalidInput("Wrong numbers.", "P is not symmetric, or V_2 is not half its quadratic form")
    return {
        "gamma": gamma,
        "degree": degree,
        "P": p,
        "expansion": exact.expand(degree - 1),
        "problem": problem if problem is not None else (exact if header["polynomial"] is True else None),
        "value_parts": value,
        "records": records,
        "condition": float(header["condition"]),
        "memory": memory,
    }


def _gather(arrays: dict[str, np.ndarray], name: str, lowest: int, highest: int) -> dict[int, np.ndarray]:
    parts: dict[int, np.ndarray] = {}
    for key in [key for key in arrays if key.startswith(f"{name}_")]:
        k = int(key[len(name) + 1 :])
        if key != f"{name}_{k}" or not lowest <= k <= highest:
            raise InvalidInput("Foreign arrays.", f"{key[:50]!r} does not belong into it")
        parts[k] = arrays.pop(key)
    return parts
