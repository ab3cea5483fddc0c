"""A correction and a prediction of an estimator as one compiled program."""

import numpy as np

from flexhinf.codegen import Block, Buffer, Composer, Program, Slice, compile_program


def composed(estimator):
    """``step(belief, y, u)`` → corrected with y, then predicted with u; only a mean (n,) and a matrix (n, n) count."""
    plant, n, kind = estimator.plant, estimator.plant.n, type(estimator.initial)
    run, p, m = Composer(), len(plant.outputs), len(plant.inputs)
    kept = {name: np.shape(part) for name, part in estimator.initial._asdict().items()}
    shapes = {
        **kept, "y": (p,), "u": (m,), "p": (plant.parameters.size,), "q": (n, n), "r": (p, p),
    }  # fmt: skip
    blocks = {name: Block(Slice(name, 0, int(np.prod(shape))), shape) for name, shape in shapes.items()}
    belief = kind(*(blocks[name] for name in kept))
    belief = estimator.measurement_update_on(run, belief, blocks["y"], blocks["u"], blocks["p"], blocks["r"])
    belief = estimator.time_update_on(run, belief, blocks["u"], blocks["p"], blocks["q"])
    for name, part in belief._asdict().items():
        run.copy(part, blocks[name])
    buffers = [Buffer(name, blocks[name].size, "state" if name in kept else "in") for name in shapes]
    kernel = compile_program(Program("filter", (*buffers, *run.buffers), tuple(run.body)))
    fixed = {"p": plant.parameters.vector(), "q": estimator.process_noise, "r": estimator.measurement_noise}

    def step(belief, y, u):
        arrays = {name: np.array(part) for name, part in estimator.initial._asdict().items()}
        arrays |= {name: np.array(part) for name, part in zip(kept, belief)}
        assert kernel.run({**arrays, "y": y, "u": u, **fixed}).fine
        return kind(*(arrays[name] for name in kept))

    return step
