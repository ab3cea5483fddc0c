"""Filters of Dynamax in double precision, in an environment of their own: one line of JSON for each case.

Its functions of one step are called, since its passes over a whole sequence know no missing samples. Nothing of
flexhinf is imported.
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from typing import Any

import jax  # pyright: ignore[reportMissingImports]
import jax.numpy as jnp  # pyright: ignore[reportMissingImports]
import numpy as np
from dynamax.linear_gaussian_ssm import inference as linear  # pyright: ignore[reportMissingImports]
from dynamax.nonlinear_gaussian_ssm import inference_ukf as unscented  # pyright: ignore[reportMissingImports]

jax.config.update("jax_enable_x64", True)

#: α, β, κ of the unscented transform.
SCALING = (1.0, 2.0, 0.0)


@jax.jit
def kalman_correct(belief: Any, model: Any, y: Any) -> Any:
    """A measurement update of the linear filter."""
    p = model["c"].shape[0]
    return linear._condition_on(
        *belief, model["c"], jnp.zeros((p, 1)), jnp.zeros(p), model["r"], jnp.zeros(1), y
    )


@jax.jit
def kalman_predict(belief: Any, model: Any, u: Any) -> Any:
    """A time update of the linear filter."""
    f, g = model["f"], model["g"]
    return linear._predict(*belief, f, g[:, None], jnp.zeros(len(g)), model["q"], u)


def _weights(n: int) -> tuple[Any, ...]:
    spread = unscented._compute_lambda(SCALING[0], n, SCALING[2])
    return spread, *unscented._compute_weights(n, SCALING[0], SCALING[1], spread)


@jax.jit
def unscented_correct(belief: Any, model: Any, y: Any) -> Any:
    """A measurement update of the unscented filter."""
    weights, c = _weights(len(model["g"])), model["c"]
    return unscented._condition_on(*belief, lambda x, _: c @ x, model["r"], *weights, jnp.zeros(1), y)[1:]


@jax.jit
def unscented_predict(belief: Any, model: Any, u: Any) -> Any:
    """A time update of the unscented filter."""
    weights, f, g = _weights(len(model["g"])), model["f"], model["g"]
    return unscented._predict(*belief, lambda x, u: f @ x + g * u[0], model["q"], *weights, u)[:2]


METHODS = {
    "KalmanFilter": (kalman_correct, kalman_predict),
    "UnscentedKalmanFilter": (unscented_correct, unscented_predict),
}


def estimates(model: dict[str, Any], correct: Any, predict: Any) -> tuple[list[Any], list[Any]]:
    """Means and variances (N, n) after each sample's correction."""
    belief, means, variances = (jnp.zeros(len(model["g"])), model["p0"]), [], []
    for y, u in zip(np.asarray(model["y"]), np.asarray(model["u"]), strict=True):
        if not np.isnan(y[0]):
            belief = correct(belief, model, y)
        means.append(np.asarray(belief[0]).tolist())
        variances.append(np.diag(np.asarray(belief[1])).tolist())
        belief = predict(belief, model, jnp.array([u]))
    return means, variances


def main() -> None:
    """Answer until there is nothing more to read."""
    print(json.dumps({"dynamax": version("dynamax"), "jax": version("jax")}), flush=True)
    for line in sys.stdin:
        model = {name: jnp.array(values) for name, values in json.loads(line).items()}
        print(json.dumps({name: estimates(model, *both) for name, both in METHODS.items()}), flush=True)


if __name__ == "__main__":
    main()
