"""An operation in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

import casadi
import numpy as np

from flexhinf.codegen.operations import OperationKind, nowhere, register
from flexhinf.scalars import deviations


def written(writer, y, x):
    """Lines of LLVM that compute it, in any number of lanes; the name of the result."""
    return writer.library("atan2", y, x)


in_c = "atan2{f}({0.bare}, {1.bare})"  # of the type's suffix, and of the operands without brackets
where = {"switches": lambda y, x: [y], "poles": nowhere, "angle": True}  # at y = 0 it jumps by whole turns
where |= {"difference": deviations.angle}  # how far it moves with its operands, to all digits
register(OperationKind(casadi.OP_ATAN2, np.arctan2, written, in_c, library="atan2", costs=True, **where))
