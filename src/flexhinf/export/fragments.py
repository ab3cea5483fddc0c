"""Pieces of exported C and its comments that stand there only where the controller's options need them."""

from __future__ import annotations

from flexhinf.codegen.c.algebra import SIXTEEN

#: What the header says before the parameters of the model.
NAMED = "\n\n/* Parameters of the estimator's model, with their units. */\n"

#: What a start assumes.
BEGINS = (
    "the estimate begins at the state that is stated with the constants @BIG@_X_ above. The robot must be there, at "
    "rest: the estimator trusts it, and from another place the first inputs may be as large as their limits. Call "
    "@NAME@_start where it is elsewhere"
)

#: Before the memory for columns that are computed side by side.
ALIGNMENT = f"""#if {SIXTEEN}
    __attribute__((aligned(16))) /* vectors are read from it as a whole */
#endif
"""
ROOM = "    @NAME@_real columns[@BIG@_COLUMNS];\n"

#: The estimate before the first sample: that of the belief, or none where it is no part of the memory.
KNOWN_ESTIMATE = "    @NAME@_copy(initial_memory, state->estimate, @BIG@_STATES);"
NO_ESTIMATE = """    for (int i = 0; i < @BIG@_STATES; ++i) {
        state->estimate[i] = @ZERO@;
    }"""

#: The estimate at the start, where it can be set.
START = """    if (estimate != NULL) {
        if (@NAME@_finite(estimate, @BIG@_STATES) != 0) {
            @NAME@_copy(estimate, state->start, @BIG@_STATES);
            @NAME@_copy(estimate, state->estimate, @BIG@_STATES);@HOLD@
        } else {
            code = @BIG@_BAD_START;
        }
    }"""

#: Inputs that wait at the start.
QUEUED = """
    for (int i = 0; i < @BIG@_LATENCY * @BIG@_INPUTS; ++i) {
        state->start[AT_QUEUE + i] = state->start[AT_U@WHICH@];
    }"""

#: The input that holds it there.
HOLD = """
            if (same(estimate, initial_memory, @BIG@_STATES) == 0) {
                real held[@BIG@_INPUTS];
                @HOLDING@;
                if (@NAME@_finite(held, @BIG@_INPUTS) != 0) {
                    limit(param, held, state->start + AT_U);
                }
            }"""

#: Which numbers the compiled source computes, by type.
BITS = {
    "double": "1 with fused multiply-adds, which it uses where the compiler has them as instructions, and those of "
    "Controller.step in Python on such a processor; 0 with two roundings, and those of "
    "Controller.fresh(fused=False).",
    "float": "1 with fused multiply-adds, which it uses where the compiler has them as instructions; 0 with two "
    "roundings. The last digits of the two differ, and both from the simulation, which is in double.",
}

#: What the header says where an input has no limits.
UNLIMITED = (
    "Nothing limits {}: this controller may ask for any value. Set the limits from @BIG@_P_LOWER and "
    "@BIG@_P_UPPER on."
)

#: What a command is: positions, or a motion; and where the model says what rests.
STANDING = "input.r are the positions to go to. A jump is a step, and zeros are positions too."
MOVING = (
    "input.r is a motion: the state and the input that the robot has on its way when the output acts{latency}. At rest "
    "it is an equilibrium and the input that holds it, never positions alone: with zeros behind them they are another "
    "motion, the robot swings, and every step returns @BIG@_OK.{resting} On the way positions must not jump, nor their "
    "velocities and accelerations: a quintic in time, for instance. In Python fh.Moving(plan, robot.inverse_dynamics) "
    "gives all these numbers, .state(t) and .input(t), and robot.operating_point(q) those of rest."
)
MOVING_FIRST = "The command input.r is {} numbers of one motion: never write positions alone into it.{}"
RESTING_FIRST = " @NAME@_rest computes all of them for a robot that rests at given link positions."
RESTING = (
    " At link positions q these are q, 0, q + g/K (of each joint the weight g and the spring K), 0, and the input that "
    "holds g: @NAME@_rest computes them."
)
#: The command of a motion that is played more slowly; as the header declares it, and its definition.
SLOWER = (
    " Its velocities and inputs must become those of the slower motion, or the robot swings far past its path: "
    "@NAME@_slowed computes them."
)
SLOWED_DECLARED = """

/* Where the controller brakes, a row of the motion (r) is played more slowly, by path_rate: this makes it the command
 * of that slower motion; call it once for a row that comes from your path. Velocities fall with the rate, and with its
 * square what accelerates: what motors are ahead by, and what inputs have beside what speed and weight need. At rate 1
 * nothing changes. What the braking itself needs is not in it. Returns @BIG@_BAD_COMMAND where a number is not finite.
 * Not there with -D@BIG@_WITHOUT_REST. */
int @NAME@_slowed(const @NAME@_param *param, @NAME@_real path_rate, @NAME@_real *r);"""
SLOWED_MOTION = """

int @NAME@_slowed(const @NAME@_param *param, @NAME@_real path_rate, @NAME@_real *r)
{
    static const bool is_velocity[@BIG@_STATES] = {@IS_VELOCITY@};
    const real square = path_rate * path_rate;
    real rest[@BIG@_STATES + @BIG@_INPUTS];
    int code = @BIG@_BAD_COMMAND;
    if (@NAME@_finite(r, @BIG@_COMMANDS) != 0 && isfinite(path_rate) != 0) {
        code = @NAME@_rest(param, r, rest);
    }
    if (code == @BIG@_OK && path_rate < @UNITY@) {
        real held[@BIG@_INPUTS], slower[@BIG@_INPUTS];
        @HOLDING_FAST@;
        for (int i = 0; i < @BIG@_STATES; ++i) {
            r[i] = rest[i] + ((is_velocity[i] ? path_rate : square) * (r[i] - rest[i]));
        }
        @HOLDING_SLOW@;
        for (int i = 0; i < @BIG@_INPUTS; ++i) {
            r[@BIG@_STATES + i] = slower[i] + (square * (r[@BIG@_STATES + i] - held[i]));
        }
    }
    return code;
}"""

#: The command that rests; as the header declares it, and its definition.
STANDSTILL_DECLARED = """

/* The robot at rest at link positions (q): writes its state, @BIG@_STATES numbers, and behind it the input that holds
 * it there, with which @NAME@_start begins; q may be the beginning of r. Motors stand where springs hold the weight.
 * {}Returns @BIG@_BAD_COMMAND where a number is not finite. Not there with -D@BIG@_WITHOUT_REST. */
int @NAME@_rest(const @NAME@_param *param, const @NAME@_real *q, @NAME@_real *r);"""
RESTING_COMMAND = "All of r is the command that rests there. "
STANDSTILL = """

#ifndef @BIG@_WITHOUT_REST
@TRACED@

int @NAME@_rest(const @NAME@_param *param, const @NAME@_real *q, @NAME@_real *r)
{
    @CALL@(q, param->value, r);
    return (@NAME@_finite(r, @BIG@_STATES + @BIG@_INPUTS) != 0) ? @BIG@_OK : @BIG@_BAD_COMMAND;
}@SLOWED@
#endif"""

#: Which measurements a controller believes, with and without a check.
BELIEVED_ALL = (
    "The controller believes every finite measurement that is in time, one that jumps or a sensor that is stuck too. "
    "Check sensors before the step, or export a controller that refuses what the robot file rules out: "
    "`--check-measurements`."
)
BELIEVED_SOME = (
    "A measurement that its gate or its limits refuse counts as missing, and is counted in `output.rejected`. A sensor "
    "that is stuck at a place within them is believed."
)

#: What a controller does about the bits of its status; and how a workspace is braked at.
REPORTED = (
    "This controller reports and does not react: it takes every finite command, and output.path_rate stays 1. One that "
    "reacts is another export: Controller(..., supervision=...) in Python."
)
REACTED = (
    "What it does about it stands above, in the line reactions. Where it brakes, output.path_rate falls from 1 to 0 "
    "and stays there: the program that makes the command advances its time along the path by path_rate periods a "
    "sample, and one that does not read it is not braked."
)
EDGE = (
    " It brakes where a command leaves the workspace, not before: at a speed v the command comes to rest up to "
    "v * {:g} s beyond, and the robot may swing past that place. Where the workspace ends with the mechanical limits, "
    "that is beyond them: keep paths further inside than you see it swing, or narrow the box, param.value + "
    "@BIG@_P_WORKSPACE: the least positions, then the largest. A first command outside of it is reported and followed, "
    "so that an arm can be led back: look at it before the start."
)
BEGIN_AGAIN = (
    " To begin again where the robot then rests: @NAME@_start with output.estimate and output.u. Another reaction is "
    "another export: Controller(..., supervision=...) in Python."
)

#: The path rate, also where the memory was overwritten.
SLOWED = "smaller(larger(state->memory[AT_STOP_PATH_RATE], @ZERO@), @UNITY@)"

#: A brake under way goes on where the memory goes back; its numbers, from 0 to 1, are never what is not finite. A
#: command that is held goes back, with the flag that it is.
STOP_KEPT = """        const real now = state->memory[i];
        if (i >= AT_STOP_BRAKED && i <= AT_STOP_PATH_RATE && now >= @ZERO@ && now <= @UNITY@) {
            kept = 1; /* a brake under way goes on */
        }
"""

#: Where the design states no limits, infinite ones of the caller are none that an input can have.
FINITE = "        to[i] = (isfinite(to[i]) != 0) ? to[i] : SAFE[i];\n"

#: Bits of the status, whose numbers are a part of the memory.
STATUS_BITS = """
    static const int bits[6] = {
        @BIG@_OUTSIDE_WORKSPACE, @BIG@_LIMIT_CYCLE, @BIG@_SATURATION, @BIG@_REACTING, @BIG@_FOLLOWING_ERROR,
        @BIG@_BLOCKED
    };
    for (int i = 0; i < 6; ++i) {
        output->status += (state->memory[AT_STATUS + i] > @ZERO@) ? bits[i] : 0;
    }"""

#: Whether the estimate is in doubt, and at how many samples it was, which are a part of the memory.
DOUBTFUL_DECLARED = """
    /* samples since the start with @BIG@_DOUBTFUL_ESTIMATE; float counts to 2^24 */
    int doubtful;"""
DOUBTFUL = """
    output->status += (state->memory[AT_DOUBT] > @ZERO@) ? @BIG@_DOUBTFUL_ESTIMATE : 0;
    output->doubtful = counted(state->memory[AT_DOUBT + 1]);"""

#: A count that the memory holds, up to one that int and real hold.
COUNTED = """/* A count; 0 where the memory was overwritten by what is none. */
static int counted(real number)
{
    return (number > @ZERO@ && number <= @MOST@) ? (int)number : 0;
}

"""
MOST_COUNTED = {"double": 2.0**31 - 1.0, "float": 2.0**24}

#: Counts of rejected measurements (by a gate, or by their limits), which are a part of the memory.
REJECTED_DECLARED = """
    /* how often each measurement was rejected since the start; float counts to 2^24 */
    int rejected[@BIG@_MEASUREMENTS];"""
REJECTED = """
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {{
        output->rejected[i] = {};
    }}"""

#: Of a bit that a controller does not watch.
NEVER = "always 0 here, not watched"

#: What these bits say.
STATUS = (
    "the command is outside of the positions that the design is for",
    "an input, or a tracked position, swings to and fro while the command rests",
    "an input has been at a limit for long",
    "the command is replaced, or the path rate falls",
    "the estimate is in doubt: rounding may move it by over 0.001 of its standard deviation, or it was repaired",
    "a tracked position is far from its command",
    "something blocks a joint that is far from its command, by more than the model explains; it lets go",
)

#: Whether something is measured; and the step where nothing is, in which a finite result has a code of its own.
PREDICTION = """
static int @NAME@_some(const real *y)
{
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        if (isfinite(y[i]) != 0) {
            return 1;
        }
    }
    return 0;
}

@PLAUSIBLE@static int @NAME@_predict(@NAME@_state *state, const @NAME@_param *param,
                          const @NAME@_input *input@ALSO_IN_TIME@)
{
    real nothing[@BIG@_MEASUREMENTS];
    int code;
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        nothing[i] = @NOTHING@;
    }
    code = @PREDICTED_CALL@;
    return (code == @BIG@_OK) ? @BIG@_PREDICTED : code;
}
"""

#: Of a sample in which nothing is plausible: what is there is not believed, and counted.
NOT_BELIEVED = "(in_time != 0) ? input->y[i] : HUGE_VAL@SUFFIX@"

#: Whether something that is measured is plausible.
PLAUSIBLE = """static int @NAME@_believed(const @NAME@_state *state, const @NAME@_param *param, const real *y)
{
    real some[1];
    @CALL@(y, state->memory + AT_SEEN, @LIMITS@, some);
    return (some[0] > @ZERO@) ? 1 : 0;
}

"""

#: What the header says of limits of measurements.
PLAUSIBLE_TEXT = """/* An element of y is missing where it is below param.value[@BIG@_P_MEASUREMENT_LOWER + i] or
 * above _UPPER, in its unit, or moved by more than _RATE per s since it was last plausible; output.rejected counts it.
 * The line "measurements:" above has the limits of the design; HUGE_VAL is none. Where no element is plausible, the
 * sample counts as one without a measurement. */

"""
