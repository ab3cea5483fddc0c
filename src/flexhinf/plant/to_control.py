"""Plants as systems of python-control. Needs the extra ``control``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    import control


def python_control() -> Any:
    """The package, or an error that says how to get it."""
    try:
        import control
    except ImportError as error:
        raise InvalidInput(
            "python-control is not installed.", f"import control: {error}", "pip install 'flexhinf[control]'"
        ) from error
    return control


def nonlinear_system(
    flow: Callable[..., Any],
    output: Callable[..., Any],
    p: np.ndarray,
    signals: Mapping[str, Any],
    inputs: int,
) -> control.NonlinearIOSystem:
    """ẋ = flow(x, u, d, p), y = output(x, u, p) with (u, d) as the system's inputs, of which the first are u."""

    def dynamics(t: float, x: Any, v: Any, params: Any) -> np.ndarray:
        return np.ravel(np.asarray(flow(x, v[:inputs], v[inputs:], p), dtype=float))

    def measured(t: float, x: Any, v: Any, params: Any) -> np.ndarray:
        return np.ravel(np.asarray(output(x, v[:inputs], p), dtype=float))

    return python_control().nlsys(dynamics, measured, **signals)


def linear_system(
    matrices: tuple[np.ndarray, ...], feedthrough: np.ndarray, signals: Mapping[str, Any]
) -> control.StateSpace:
    """ẋ = A x + B u + G d, y = C x + D u, in deviations; (A, B, G, C) as `Model.linearise`."""
    a, b, g, c = matrices
    d = np.hstack([feedthrough, np.zeros((len(c), g.shape[1]))])
    return python_control().ss(a, np.hstack([b, g]), c, d, **signals)
