/* @NAME@: see @NAME@.h. Made by flexhinf @VERSION@; not to be edited. */
#include "@NAME@.h"

#include <math.h>

@ARITHMETIC@
/* a·b + c, rounded once where the processor can: then the numbers are those of the simulation, bit by bit. Compile
 * with -D@BIG@_PLAIN for two roundings, -D@BIG@_FUSED for one whatever it costs. Not every <math.h> says what the
 * compiler knows: the macro with underscores is the compiler's. */
#if defined(FP_FAST_FMA@SUFFIX@) || defined(__FP_FAST_FMA@SUFFIX@) || defined(__x86_64__) || \
    defined(__SSE2_MATH__)
#define FAST_FMA
#endif
#if !defined(@BIG@_PLAIN) && (defined(@BIG@_FUSED) || defined(FAST_FMA))
#define FUSED
#define FMA(a, b, c) fma@F@(a, b, c)
#else
#define FMA(a, b, c) ((a) * (b) + (c))
#endif

typedef @NAME@_real real;

const @NAME@_param @NAME@_defaults = {
    {
@DEFAULTS@
    },
    @OLDEST@,
    @MISSING@
};

static const real initial_memory[@BIG@_MEMORY] = {
@INITIAL@
};

/* The input before the first sample, within its limits. */
#define SAFE (initial_memory + @U@)

/* The mark of a state that was initialised. */
#define INITIALISED 0x1d1e5e7au

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

/* An input (from) within the limits of now. */
static void limit(const @NAME@_param *param, const real *from, real *to)
{
    for (int i = 0; i < @BIG@_INPUTS; ++i) {
        const real low = param->value[@BIG@_P_LOWER + i], high = param->value[@BIG@_P_UPPER + i];
        const real above = (from[i] > low) ? from[i] : low;
        to[i] = (above < high) ? above : high;
    }
}

static void begin(@NAME@_state *state)
{
    @NAME@_copy(state->start, state->memory, @BIG@_MEMORY);
    @NAME@_copy(state->start, state->newer, @BIG@_MEMORY);
    @NAME@_copy(state->start, state->older, @BIG@_MEMORY);
    @NAME@_copy(state->start + @U@, state->held, @BIG@_INPUTS);
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
    for (int i = 0; i < @BIG@_STATES; ++i) {
        state->estimate[i] = @ZERO@;
    }
    begin(state);
    state->refused = @NAME@_exact() ? 0 : REFUSED;
    return state->refused;
}

int @NAME@_start(@NAME@_state *state, const @NAME@_param *param, const @NAME@_real *estimate,
                 const @NAME@_real *input)
{
    @NAME@_init(state);
@START@
    if (input != 0 && @NAME@_finite(input, @BIG@_INPUTS)) {
        limit(param, input, state->start + @U@);
    }@QUEUED@
    begin(state);
    return state->refused;
}

/* After a step that failed: where one did before from the same memory, go back to an earlier one, and say so. */
static int went_back(@NAME@_state *state)
{
    int start;
    if (!state->failed) {
        state->failed = 1;
        return 0;
    }
    if (!@NAME@_finite(state->start, @BIG@_MEMORY)) {
        @NAME@_copy(initial_memory, state->start, @BIG@_MEMORY);
    }
    if (!@NAME@_finite(state->older, @BIG@_MEMORY)) {
        @NAME@_copy(state->start, state->older, @BIG@_MEMORY);
    }
    start = same(state->older, state->start, @BIG@_MEMORY);
    if (start && state->began_again) { /* the start itself is bad: as it was told, or its memory was overwritten */
        @NAME@_copy(initial_memory, state->start, @BIG@_MEMORY);
        @NAME@_copy(initial_memory, state->older, @BIG@_MEMORY);
    }
    for (int i = 0; i < @BIG@_MEMORY; ++i) {
        const int command = i >= @REFERENCE@ && i < @REFERENCE@ + @COMMANDED@;
        const int keep = command && start && !state->began_again && isfinite(state->memory[i]);
        if (!keep) {
            state->memory[i] = state->older[i];
        }
    }
    state->began_again = start;
    @NAME@_copy(state->start, state->older, @BIG@_MEMORY);
    @NAME@_copy(state->start, state->newer, @BIG@_MEMORY);
    return 1;
}

/* What is applied: the last good input; where even that was lost, the safe one within the limits of now. */
static void hold(const @NAME@_state *state, const @NAME@_param *param, @NAME@_output *output)
{
    for (int i = 0; i < @BIG@_INPUTS; ++i) {
        const real low = param->value[@BIG@_P_LOWER + i], high = param->value[@BIG@_P_UPPER + i];
        const int good = state->held[i] >= low && state->held[i] <= high && isfinite(state->held[i]);
        real u = good ? state->held[i] : SAFE[i];
        if (u < low) {
            u = low;
        }
        if (u > high) {
            u = high;
        }
        output->u[i] = u;
    }
    for (int i = 0; i < @BIG@_STATES; ++i) {
        output->estimate[i] = isfinite(state->estimate[i]) ? state->estimate[i] : @ZERO@;
    }
    output->status = 0;@STATUS@
    output->path_rate = @PATH_RATE@;
}

int @NAME@_step(@NAME@_state *state, const @NAME@_param *param, const @NAME@_input *input, @NAME@_output *output)
{
    const int in_time = input->measured != 0 && input->age <= param->oldest@THERE@;
    int code;
    if (state->mark != INITIALISED) {
        limit(param, SAFE, output->u);
        for (int i = 0; i < @BIG@_STATES; ++i) {
            output->estimate[i] = @ZERO@;
        }
        output->status = 0;
        output->path_rate = @ZERO@;
        return @BIG@_NOT_INITIALISED;
    }
    if (state->refused == REFUSED) {
        code = REFUSED;
    } else if (in_time) {
        code = @MEASURED@;
        if (code != @BIG@_BAD_MEASUREMENT) {
            state->missing = 0;
        }
    } else if (state->waiting) {
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
        @NAME@_copy(state->u, state->held, @BIG@_INPUTS);
        state->samples = (state->samples >= 0 && state->samples < @SPACING@) ? state->samples + 1 : 1;
        if (state->samples == @SPACING@) {
            @NAME@_copy(state->newer, state->older, @BIG@_MEMORY);
            @NAME@_copy(state->memory, state->newer, @BIG@_MEMORY);
            state->began_again = 0;
            state->samples = 0;
        }
    } else if (code == @BIG@_BAD_RESULT && went_back(state)) {
        code = @BIG@_WENT_BACK;
    }
    hold(state, param, output);
    return code;
}@STANDSTILL@
