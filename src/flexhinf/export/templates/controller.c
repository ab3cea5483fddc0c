/* @NAME@: see @NAME@.h. Made by flexhinf @VERSION@; not to be edited.
 *
 * @SUMMARY@
 *
 * SPDX-License-Identifier: 0BSD */
#include "@NAME@.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

@ARITHMETIC@
/* a*b + c, rounded once where the compiler says that the processor has an instruction for it (on a PC with -mfma), and
 * twice elsewhere, or with -D@BIG@_PLAIN: no function of a library is ever called for it. Each of the two has its own bits
 * on every machine, and @NAME@_fused says which they are. */
#if !defined(@BIG@_PLAIN) && (defined(__GNUC__) || defined(__clang__)) && \
    (defined(__FMA__) || defined(__FMA4__) || defined(__FP_FAST_FMA@SUFFIX@) || \
     (defined(__ARM_FEATURE_FMA) && defined(__ARM_FP) && (__ARM_FP & @BYTES@)))
#define FUSED
#define FMA(a, b, c) __builtin_fma@F@((a), (b), (c))
#else
#define FMA(a, b, c) (((a) * (b)) + (c))
#endif

typedef @NAME@_real real;

const char @NAME@_version[] = "@VERSION@";
const char @NAME@_digest[] = "@DIGEST@";
#ifdef FUSED
const int @NAME@_fused = 1;
#else
const int @NAME@_fused = 0;
#endif

const @NAME@_param @NAME@_defaults = {
    {
@DEFAULTS@
    },
    @OLDEST@,
    @MISSING@
};

/* Where the parts of the memory begin. */
@PLACES@

static const real initial_memory[@BIG@_MEMORY] = {
@INITIAL@
};

/* The input before the first sample, within its limits. */
#define SAFE (initial_memory + AT_U)

/* The mark of a state that was initialised, and the largest count of samples without a measurement. */
#define INITIALISED 0x1d1e5e7au
#define MOST_UNSEEN 32767

@FUNCTIONS@
/* What every step returns after @NAME@_init found that other numbers come out than are written. */
#define REFUSED @BIG@_BAD_ARITHMETIC

/* The rules of samples: when memory changes, when it goes back, what is applied meanwhile. */
static int same(const real *one, const real *other, int count)
{
    for (int i = 0; i < count; ++i) {
        if (one[i] < other[i] || one[i] > other[i]) {
            return 0;
        }
    }
    return 1;
}

/* The other one (b) where a is no number. */
static real larger(real a, real b)
{
    return (a > b) ? a : b;
}

static real smaller(real a, real b)
{
    return (a < b) ? a : b;
}

/* An input (from) within the caller's limits and the design's; what is no number becomes the lower limit. */
static void limit(const @NAME@_param *param, const real *from, real *to)
{
    for (int i = 0; i < @BIG@_INPUTS; ++i) {
        const real least = @NAME@_defaults.value[@BIG@_P_LOWER + i], most = @NAME@_defaults.value[@BIG@_P_UPPER + i];
        const real above = larger(from[i], larger(param->value[@BIG@_P_LOWER + i], least));
        to[i] = larger(smaller(above, smaller(param->value[@BIG@_P_UPPER + i], most)), least);
@FINITE@    }
}

static void begin(@NAME@_state *state)
{
    @NAME@_copy(state->start, state->memory, @BIG@_MEMORY);
    @NAME@_copy(state->start, state->newer, @BIG@_MEMORY);
    @NAME@_copy(state->start, state->older, @BIG@_MEMORY);
    @NAME@_copy(state->start + AT_U, state->held, @BIG@_INPUTS);
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        state->unseen[i] = 0;
    }
    state->missing = 0;
    state->failed = 0;
    state->began_again = 0;
    state->samples = 0;
    state->waiting = 1;
    state->mark = INITIALISED;
}

int @NAME@_init(@NAME@_state *state)
{
    @NAME@_copy(initial_memory, state->start, @BIG@_MEMORY);
@FIRST_ESTIMATE@
    begin(state);
    state->refused = (@NAME@_exact() != 0) ? 0 : REFUSED;
    return state->refused;
}

int @NAME@_start(@NAME@_state *state, const @NAME@_param *param, const @NAME@_real *estimate,
                 const @NAME@_real *input)
{
    int code = @NAME@_init(state);
@START@
    if (input != NULL) {
        if (@NAME@_finite(input, @BIG@_INPUTS) != 0) {
            limit(param, input, state->start + AT_U);
        } else {
            code = @BIG@_BAD_START;
        }
    }@QUEUED@
    begin(state);
    if (code == @BIG@_BAD_START) { /* a step before another start says that there was none */
        state->mark = 0;
    }
    return (state->refused != 0) ? state->refused : code;
}

/* After a step that failed: where one did before from the same memory, go back to an earlier one. Returns the code. */
static int went_back(@NAME@_state *state)
{
    int at_start;
    int keeps_command = 0; /* if it is good, and once */
    if (state->failed == 0) {
        state->failed = 1;
        return @BIG@_BAD_RESULT;
    }
    if (@NAME@_finite(state->start, @BIG@_MEMORY) == 0) {
        @NAME@_copy(initial_memory, state->start, @BIG@_MEMORY);
    }
    if (@NAME@_finite(state->older, @BIG@_MEMORY) == 0) {
        @NAME@_copy(state->start, state->older, @BIG@_MEMORY);
    }
    at_start = same(state->older, state->start, @BIG@_MEMORY);
    if (at_start != 0) {
        if (state->began_again == 0) {
            keeps_command = 1;
        } else { /* the start itself is bad: as it was told, or overwritten */
            @NAME@_copy(initial_memory, state->start, @BIG@_MEMORY);
            @NAME@_copy(initial_memory, state->older, @BIG@_MEMORY);
        }
    }
    for (int i = 0; i < @BIG@_MEMORY; ++i) {
        int kept = 0;
        if (i >= AT_REFERENCE && i < AT_REFERENCE + @COMMANDED@) {
            kept = keeps_command;
        }
@STOP_KEPT@        if (kept == 0 || isfinite(state->memory[i]) == 0) {
            state->memory[i] = state->older[i];
        }
    }
    state->began_again = at_start;
    @NAME@_copy(state->start, state->older, @BIG@_MEMORY);
    @NAME@_copy(state->start, state->newer, @BIG@_MEMORY);
    return @BIG@_WENT_BACK;
}

/* Whether input i may be one that a step gave. */
static int possible_input(int i, real u)
{
    const real least = @NAME@_defaults.value[@BIG@_P_LOWER + i], most = @NAME@_defaults.value[@BIG@_P_UPPER + i];
    return (isfinite(u) != 0 && u >= least && u <= most) ? 1 : 0;
}

@COUNTED@/* What is applied: the last good input within the limits of now. Where it was overwritten, that of the start; where that
 * was too, the one before the first sample. */
static void hold(const @NAME@_state *state, const @NAME@_param *param, @NAME@_output *output)
{
    real last[@BIG@_INPUTS];
    for (int i = 0; i < @BIG@_INPUTS; ++i) {
        const real first = (possible_input(i, state->start[AT_U + i]) != 0) ? state->start[AT_U + i] : SAFE[i];
        last[i] = (possible_input(i, state->held[i]) != 0) ? state->held[i] : first;
    }
    limit(param, last, output->u);
    for (int i = 0; i < @BIG@_STATES; ++i) {
        output->estimate[i] = (isfinite(state->estimate[i]) != 0) ? state->estimate[i] : @ZERO@;
    }
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        output->unseen[i] = state->unseen[i];
    }
    output->status = 0;@STATUS@@DOUBTFUL@@REJECTED@
    output->path_rate = @PATH_RATE@;
}

int @NAME@_step(@NAME@_state *state, const @NAME@_param *param, const @NAME@_input *input, @NAME@_output *output)
{
    int in_time = 0;
    int code;
    if (input->measured != 0 && input->age >= @ZERO@ && input->age <= param->oldest@THERE@) {
        in_time = 1;
    }
    if (state->mark != INITIALISED) {
        limit(param, SAFE, output->u);
        for (int i = 0; i < @BIG@_STATES; ++i) {
            output->estimate[i] = @ZERO@;
        }
        for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
            output->unseen[i] = MOST_UNSEEN;
        }
        output->status = 0;
        output->path_rate = @ZERO@;@NONE_DOUBTFUL@@NONE_REJECTED@
        return @BIG@_NOT_INITIALISED;
    }
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        const int before = state->unseen[i];
        const int more = (before >= 0 && before < MOST_UNSEEN) ? before + 1 : MOST_UNSEEN;
        state->unseen[i] = (in_time != 0 && isfinite(input->y[i]) != 0) ? 0 : more;
    }
    if (state->refused == REFUSED) {
        code = REFUSED;
    } else if (in_time != 0@BELIEVED@) {
        code = @MEASURED@;
        if (code == @BIG@_BAD_COMMAND) { /* its measurement was not used, and counts as none */
            if (state->waiting != 0) {
                code = @BIG@_WAITING;
            } else if (state->missing < param->missing_limit && state->missing >= 0) {
                state->missing += 1;
            } else if (param->missing_limit > 0) {
                code = @BIG@_STOPPED;
            } else {
                /* no sample may be missing: each says so by itself */
            }
        } else if (code != @BIG@_BAD_MEASUREMENT) {
            state->missing = 0;
        } else {
            /* as it was */
        }
    } else if (state->waiting != 0) {
        code = @BIG@_WAITING;
    } else if (state->missing < param->missing_limit && state->missing >= 0) {
        state->missing += 1;
        code = @PREDICTED@;
    } else {
        code = @BIG@_STOPPED;
    }
    if (code == @BIG@_OK@OR_PREDICTED@) {
        state->failed = 0;
        state->waiting = 0;
        limit(param, state->u, state->held);
        state->samples = (state->samples >= 0 && state->samples < @SPACING@) ? state->samples + 1 : 1;
        if (state->samples == @SPACING@) {
            @NAME@_copy(state->newer, state->older, @BIG@_MEMORY);
            @NAME@_copy(state->memory, state->newer, @BIG@_MEMORY);
            state->began_again = 0;
            state->samples = 0;
        }
    } else if (code == @BIG@_BAD_RESULT) {
        code = went_back(state);
    } else {
        /* nothing was computed, and nothing changes */
    }
    hold(state, param, output);
    return code;
}

#ifndef @BIG@_WITHOUT_CHECK
/* Numbers that may differ from the design's: of which other they are less (-1: of none), what is physical, and what the
 * design was made for. */
#define RANGES @COUNT@
#define ANY -HUGE_VAL@SUFFIX@, HUGE_VAL@SUFFIX@
static const struct {
    int place, below;
    real least, most, low, high;
} ranges[RANGES] = {
@RANGES@
};

static real number(const @NAME@_param *param, int place)
{
    return (place < @BIG@_PARAMETERS)    ? param->value[place]
           : (place == @BIG@_PARAMETERS) ? param->oldest
                                         : (real)param->missing_limit;
}

int @NAME@_check(const @NAME@_param *param, int *place)
{
    int worst = @BIG@_PARAM_OK;
    int row = 0;
    for (int i = 0; i < @BIG@_PARAMETERS + 2; ++i) {
        const real value = number(param, i), design = number(&@NAME@_defaults, i);
        int found = @BIG@_PARAM_BEYOND_DESIGN;
        int equal = 0;
        if (value >= design && value <= design) {
            equal = 1;
            found = @BIG@_PARAM_OK;
        }
        if (row < RANGES && ranges[row].place == i) {
            const int below = ranges[row].below;
            found = @BIG@_PARAM_OK;
            if (value < ranges[row].low || value > ranges[row].high) {
                found = @BIG@_PARAM_BEYOND_DESIGN;
            }
            if (value < ranges[row].least || value > ranges[row].most ||
                (below >= 0 && value >= number(param, below))) {
                found = @BIG@_PARAM_NOT_PHYSICAL;
            }
            row += 1;
        }
        if (isfinite(value) == 0 && equal == 0) {
            found = @BIG@_PARAM_NOT_FINITE;
        }
        if (found > worst) {
            worst = found;
            if (place != NULL) {
                *place = i;
            }
        }
    }
    return worst;
}
#endif@STANDSTILL@
