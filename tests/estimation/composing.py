"""A correction and a prediction of an estimator as one compiled program."""

import numpy as np

from flexhinf.codegen import Block, Buffer, Composer, Program, Slice, compile_program


def composed(estimator):
    """``step(belief, y, u)`` → corrected with y, then predicted with u; a belief is a mean (n,) and a matrix (n, n)."""
    plant, n, kind = estimator.plant, estimator.plant.n, type(estimator.initial)
    run, p, m = Composer(), len(plant.outputs), len(plant.inputs)
    shapes = {
        "mean": (n,), "spread": (n, n), "y": (p,), "u": (m,), "p": (plant.parameters.size,), "q": (n, n), "r": (p, p),
    }  # fmt: skip
    blocks = {name: Block(Slice(name, 0, int(np.prod(shape))), shape) for name, shape in shapes.items()}
    belief = kind(blocks["mean"], blocks["spread"])
    belief = estimator.measurement_update_on(run, belief, blocks["y"], blocks["u"], blocks["p"], blocks["r"])
    belief = estimator.time_update_on(run, belief, blocks["u"], blocks["p"], blocks["q"])
    for name, part in zip(("mean", "spread"), belief):
        run.copy(part, blocks[name])
    roles = {name: "state" if name in ("mean", "spread") else "in" for name in shapes}
    buffers = [Buffer(name, blocks[name].size, roles[name]) for name in shapes]
    kernel = compile_program(Program("filter", (*buffers, *run.buffers), tuple(run.body)))
    fixed = {"p": plant.parameters.vector(), "q": estimator.process_noise, "r": estimator.measurement_noise}

    def step(belief, y, u):
        mean, spread = belief
        arrays = {"mean": np.array(mean), "spread": np.array(spread), "y": y, "u": u, **fixed}
        assert kernel.run(arrays).fine
        return kind(arrays["mean"], arrays["spread"])

    return step
