import casadi as ca
import pytest

from flexhinf.codegen.dependence import linear, nonzero, switches, varying

Z = ca.SX.sym("z", 2)
A, B = Z[0], Z[1]


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        (ca.SX(3.0), False),
        (A, True),
        (ca.sin(A) ** 2 + ca.cos(A) ** 2, False),
        ((A + B) ** 2 - A**2 - 2.0 * A * B - B**2, False),
        (1e-9 * ca.sin(A), True),
        (1.0 + 1e-9 * A, True),
        (ca.if_else(A > 1e3, 1.0, 0.0), True),  # no point is there
        (ca.log(A - 1e3), True),  # nor where this is a number
        (ca.fmax(A, B) + ca.fmin(A, B) - A - B, True),  # constant, but with a switch: not trusted
        (ca.sqrt(A**2) / A, True),
        (ca.atan2(ca.sin(A), ca.cos(A)) - A, True),  # zero, but where the angle jumps
        (ca.atan(ca.tan(A)) - A, True),
    ],
)
def test_varying(entry, expected):
    assert varying(ca.SX(entry), Z, ca.SX(10.0)).item() is expected


def test_rounding_is_judged_by_the_size_of_the_terms():
    entry = 3.0 * (ca.sin(A) + 1e8) - 3e8 - 3.0 * ca.sin(A)  # rounding of 1e8
    assert varying(entry, Z, ca.SX(1e8)).item() is False
    assert varying(entry, Z, ca.SX(1.0)).item() is True


def test_entries_keep_their_places():
    entries = ca.vertcat(ca.horzcat(A, 1.0, 2.0), ca.horzcat(3.0, 4.0, B))
    assert varying(entries, Z, ca.SX.ones(2, 3)).tolist() == [[True, False, False], [False, False, True]]
    entries = ca.vertcat(ca.horzcat(0.0, 1.0), ca.horzcat(A - A * 1.0, B))
    assert nonzero(entries, Z, ca.SX.ones(2, 2)).tolist() == [[False, True], [False, True]]
    assert varying(ca.SX.zeros(0, 3), Z, ca.SX.zeros(0, 3)).shape == (0, 3)


@pytest.mark.parametrize(
    ("expression", "zero_at"),
    [
        (ca.fabs(A - 2.0), [2.0, 0.0]),
        (ca.fmin(A, 3.0 * B), [3.0, 1.0]),
        (ca.if_else(A * B > 4.0, A, B), [2.0, 2.0]),
        (ca.sign(ca.sin(A)), [0.0, 1.0]),
        (ca.atan2(ca.sin(A), ca.cos(B)), [0.0, 4.0]),
        (ca.atan(B / (A - 1.0)), [1.0, 2.0]),
        (ca.atan(ca.tan(A)), [0.0, 1.0]),  # of a tangent the operand: where it is constant there is no pole
    ],
)
def test_switches_are_zero_where_the_code_switches(expression, zero_at):
    found = ca.Function("found", [Z], [switches(expression, Z)])
    assert min(abs(float(v)) for v in found(zero_at).elements()) == 0.0


def test_smooth_code_has_no_switches():
    assert switches(ca.exp(A) * ca.tanh(B) / 3.0 + ca.hypot(A, B) ** 2, Z).numel() == 0


@pytest.mark.parametrize(
    ("result", "expected"),
    [
        (3.0 * A + ca.sin(B) * A + B, True),
        (ca.SX(1.0), True),
        (A * A, False),
        (ca.floor(A), False),  # whose derivative is zero
        (ca.if_else(A > 0.0, 1.0, 2.0), False),
        (ca.fabs(A), False),
        (ca.sign(B) * A + ca.floor(B) - A / ca.exp(B) - 2.0 * A, True),  # whatever the second argument does
        (ca.atan2(ca.sin(A), ca.cos(A)), False),  # whose derivative is one
        (ca.atan2(ca.sin(A - B), ca.cos(A - B)), False),
        (ca.atan(ca.sin(A) / ca.cos(A)), False),
        (ca.atan(ca.tan(A)), False),
        (ca.asin(ca.sin(A)), False),
        (ca.acos(ca.cos(A)), False),
        (ca.sign(A), False),
        (ca.ceil(A), False),
        (ca.fmod(A, 2.0), False),
        (ca.remainder(A, 2.0), False),
        (ca.fmin(A, B), False),
        (ca.fmax(A, 1.0) + ca.fmin(A, 1.0), False),
        (ca.copysign(A, B), False),
        (ca.copysign(1.0, A), False),
        (ca.sqrt(A**2), False),
        (ca.if_else(A > 0.0, A, 2.0 * A), False),
        (ca.if_else(A > 0.0, 0.0, A) + ca.if_else(A > 0.0, A, 0.0), False),
        (1.0 / A, False),
    ],
)
def test_linear_in_the_first_argument(result, expected):
    assert linear(ca.Function("f", [A, B], [A, result])) is expected
