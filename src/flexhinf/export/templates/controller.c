/* @{name}: see @{name}.h. Made by flexhinf @{version}; not to be edited.
 *
 * @{origin | stated}
 *
 * SPDX-License-Identifier: 0BSD */
#include "@{name}.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

{% include "arithmetic.c" %}

/* a*b + c, rounded once where the compiler says that the processor has an instruction for it (on a PC with -mfma), and
 * twice elsewhere, or with -D@{NAME}_PLAIN: no function of a library is ever called for it. Each of the two has its own bits
 * on every machine, and @{name}_fused says which they are. */
#if !defined(@{NAME}_PLAIN) && (defined(__GNUC__) || defined(__clang__)) && \
    (defined(__FMA__) || defined(__FMA4__) || defined(__FP_FAST_FMA@{F}) || \
     (defined(__ARM_FEATURE_FMA) && defined(__ARM_FP) && (__ARM_FP & @{bytes})))
#define FUSED
#define FMA(a, b, c) __builtin_fma@{f}((a), (b), (c))
#else
#define FMA(a, b, c) (((a) * (b)) + (c))
#endif

#define real @{name}_real

const char @{name}_version[] = "@{version}";
const char @{name}_digest[] = "@{digest}";
#ifdef FUSED
const int @{name}_fused = 1;
#else
const int @{name}_fused = 0;
#endif

const @{name}_param @{name}_defaults = {
    {
@{defaults}
    },
    @{number(code.oldest)},
    @{missing},
    @{stop_on},
    @{category}
};

/* Where the parts of the memory begin. */
@{code.places.memory() | enumeration}

static const real @{name}_initial_memory[@{NAME}_MEMORY] = {
@{initial}
};

/* Before a stop. */
static const real @{name}_initial_stop[@{stop_size}] = {
@{initial_stop}
};

/* The input before the first sample, within its limits. */
#define SAFE (@{name}_initial_memory + @{NAME}_AT_U)

/* The mark of a state that was initialised, and the largest count of samples without a measurement. */
#define INITIALISED 0x1d1e5e7au
#define MOST_UNSEEN 32767

@{functions}
{% if code.predicts %}
{% if not plausible %}
static int @{name}_some(const real *y)
{
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        if (isfinite(y[i]) != 0) {
            return 1;
        }
    }
    return 0;
}

{% else %}
static int @{name}_believed(const @{name}_state *state, const @{name}_param *param, const real *y)
{
    real some[1];
    @{plausible}(y, state->memory, param->value, some);
    return (some[0] > @{zero}) ? 1 : 0;
}

/* What the caller says of the readings, for the step: those that are not fresh are missing, and a pause since the step
 * before is no jump: after a long one, what they are off by is taken in slowly, as at a start. */
static void @{name}_look(@{name}_state *state, const @{name}_input *input, real *y)
{
    const real periods = input->elapsed / @{NAME}_PERIOD;
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        real *const since = state->memory + @{NAME}_AT_READINGS_SINCE + i;
        y[i] = (input->fresh[i] >= 0) ? input->y[i] : HUGE_VAL@{F};
        state->memory[@{NAME}_AT_READINGS_FRESH + i] = (input->fresh[i] > 0) ? @{unity} : @{zero};
        if (periods > @{number(pause[0])} && isfinite(periods) != 0) {
            *since += (*since > @{zero}) ? periods - @{unity} : @{zero};
{% if "offset_known" in places %}
            if (periods > @{number(pause[1])}) {
                state->memory[@{NAME}_AT_OFFSET_KNOWN + i] = @{zero};
            }
{% endif %}
        }
    }
{% if "motion" in places %}
    for (int i = 0; i < @{pairs} && periods > @{number(pause[1])}; ++i) {
        state->memory[@{NAME}_AT_MOTION_KNOWN + i] = @{number(-pausing.settles)};
    }
{% endif %}
{% if signs %}
    if (periods > @{number(pause[1])} && isfinite(periods) != 0) {
        const real free[@{pausing.free | length}] = {@{row(pausing.free)}};
        @{name}_copy(free, state->memory + @{NAME}_AT_AWAY_WAY, @{pausing.free | length});
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            state->memory[@{NAME}_AT_OPPOSED_SAMPLES + i] = @{number(-pausing.settles)};
        }
        state->memory[@{NAME}_AT_PAUSES] += (periods > @{number(pausing.longest)}) ? @{unity} : @{zero};
    }
{% endif %}
}

{% endif %}
static int @{name}_predict(@{name}_state *state, const @{name}_param *param,
                          const @{name}_input *input{% if plausible %}, const real *y, int in_time{% endif %})
{
    real nothing[@{NAME}_MEASUREMENTS];
    int code;
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
{% if plausible %}
{# what is there is not believed, and counted #}
        nothing[i] = (in_time != 0) ? y[i] : HUGE_VAL@{F};
{% else %}
        nothing[i] = @{number(infinity)};
{% endif %}
    }
    code = @{code.call("nothing")};
    return (code == @{NAME}_OK) ? @{NAME}_PREDICTED : code;
}

{% endif %}
/* What every step returns after @{name}_init found that other numbers come out than are written. */
#define REFUSED @{NAME}_BAD_ARITHMETIC

/* The rules of samples: when memory changes, when it goes back, what is applied meanwhile. Two are not put into the
 * step: its stack, which lies below all that a sample needs, would grow by what they need. */
static int @{name}_same(const real *one, const real *other, int count)
{
    for (int i = 0; i < count; ++i) {
        if (one[i] < other[i] || one[i] > other[i]) {
            return 0;
        }
    }
    return 1;
}

/* The other one (b) where a is no number. */
static real @{name}_larger(real a, real b)
{
    return (a > b) ? a : b;
}

static real @{name}_smaller(real a, real b)
{
    return (a < b) ? a : b;
}

/* An input (from) within the caller's limits and the design's; what is no number becomes the lower limit. */
static void @{name}_limit(const @{name}_param *param, const real *from, real *to)
{
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        const real least = @{name}_defaults.value[@{NAME}_P_LOWER + i], most = @{name}_defaults.value[@{NAME}_P_UPPER + i];
        const real above = @{name}_larger(from[i], @{name}_larger(param->value[@{NAME}_P_LOWER + i], least));
        to[i] = @{name}_larger(@{name}_smaller(above, @{name}_smaller(param->value[@{NAME}_P_UPPER + i], most)), least);
{% if code.unlimited %}
        to[i] = (isfinite(to[i]) != 0) ? to[i] : SAFE[i];
{% endif %}
    }
}

/* The mean by which the time between steps is off, in periods: of the last some 32. A time that is none, or a long one,
 * counts as two periods too long. */
static real @{name}_slipped(real slip, real elapsed)
{
    const real periods = elapsed / @{NAME}_PERIOD;
    const real before = (slip >= @{number(-1.0)} && slip <= @{number(2.0)}) ? slip : @{zero};
    const real off = (periods >= @{zero} && periods <= @{number(3.0)}) ? periods - @{unity} : @{number(2.0)};
    return before + ((off - before) * @{number(0.03125)});
}

static void @{name}_begin(@{name}_state *state)
{
    @{name}_copy(state->start, state->memory, @{NAME}_MEMORY);
    @{name}_copy(state->start, state->newer, @{NAME}_MEMORY);
    @{name}_copy(state->start, state->older, @{NAME}_MEMORY);
    @{name}_copy(state->start + @{NAME}_AT_U, state->held, @{NAME}_INPUTS);
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        state->unseen[i] = 0;
    }
    state->slip = @{zero};
    @{name}_copy(@{name}_initial_stop, state->stop, @{stop_size});
    @{name}_copy(state->start + @{NAME}_AT_U, state->stop + @{stop_last}, @{NAME}_INPUTS);
    state->looks = 0;
    state->missing = 0;
    state->failed = 0;
    state->began_again = 0;
    state->samples = 0;
    state->waiting = 1;
    state->mark = INITIALISED;
}

int @{name}_init(@{name}_state *state)
{
    @{name}_copy(@{name}_initial_memory, state->start, @{NAME}_MEMORY);
{% if code.starts_anywhere %}
    @{name}_copy(@{name}_initial_memory, state->estimate, @{NAME}_STATES);
{% else %}
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        state->estimate[i] = @{zero};
    }
{% endif %}
    @{name}_begin(state);
    state->refused = (@{name}_exact() != 0) ? 0 : REFUSED;
    return state->refused;
}

int @{name}_start(@{name}_state *state, const @{name}_param *param, const @{name}_real *estimate,
                 const @{name}_real *input)
{
    int code = @{name}_init(state);
{% if code.starts_anywhere %}
    if (estimate != NULL) {
        if (@{name}_finite(estimate, @{NAME}_STATES) != 0) {
            @{name}_copy(estimate, state->start, @{NAME}_STATES);
            @{name}_copy(estimate, state->estimate, @{NAME}_STATES);
{% if holding %}
            if (@{name}_same(estimate, @{name}_initial_memory, @{NAME}_STATES) == 0) {
                real held[@{NAME}_INPUTS];
                @{holding};
                if (@{name}_finite(held, @{NAME}_INPUTS) != 0) {
                    @{name}_limit(param, held, state->start + @{NAME}_AT_U);
                }
            }
{% endif %}
        } else {
            code = @{NAME}_BAD_START;
        }
    }
{% else %}
    (void)estimate;
{% endif %}
    if (input != NULL) {
        if (@{name}_finite(input, @{NAME}_INPUTS) != 0) {
            @{name}_limit(param, input, state->start + @{NAME}_AT_U);
        } else {
            code = @{NAME}_BAD_START;
        }
    }
{% if "swung" in places %}
    @{name}_copy(state->start + @{NAME}_AT_U, state->start + @{NAME}_AT_SWUNG, @{NAME}_INPUTS); /* where a swing begins */
    @{name}_copy(state->start + @{NAME}_AT_U, state->start + @{NAME}_AT_SWUNG + @{NAME}_INPUTS, @{NAME}_INPUTS);
{% endif %}
{% if "queue" in places %}
    for (int i = 0; i < @{NAME}_LATENCY * @{NAME}_INPUTS; ++i) {
        state->start[@{NAME}_AT_QUEUE + i] = state->start[@{NAME}_AT_U{% if code.sizes.u > 1 %} + i % @{NAME}_INPUTS{% endif %}];
    }
{% endif %}
    @{name}_begin(state);
    if (code == @{NAME}_BAD_START) { /* a step before another start says that there was none */
        state->mark = 0;
    }
    return (state->refused != 0) ? state->refused : code;
}

/* After a step that failed: where one did before from the same memory, go back to an earlier one. Returns the code. */
static NOINLINE int @{name}_went_back(@{name}_state *state)
{
    int at_start;
    int keeps_command = 0; /* if it is good, and once */
    if (state->failed == 0) {
        state->failed = 1;
        return @{NAME}_BAD_RESULT;
    }
    if (@{name}_finite(state->start, @{NAME}_MEMORY) == 0) {
        @{name}_copy(@{name}_initial_memory, state->start, @{NAME}_MEMORY);
    }
    if (@{name}_finite(state->older, @{NAME}_MEMORY) == 0) {
        @{name}_copy(state->start, state->older, @{NAME}_MEMORY);
    }
    at_start = @{name}_same(state->older, state->start, @{NAME}_MEMORY);
    if (at_start != 0) {
        if (state->began_again == 0) {
            keeps_command = 1;
        } else { /* the start itself is bad: as it was told, or overwritten */
            @{name}_copy(@{name}_initial_memory, state->start, @{NAME}_MEMORY);
            @{name}_copy(@{name}_initial_memory, state->older, @{NAME}_MEMORY);
        }
    }
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        int kept = 0;
        if (i >= @{NAME}_AT_REFERENCE && i < @{NAME}_AT_REFERENCE + @{places["reference"].stop - places["reference"].start}) {
            kept = keeps_command;
        }
{% if "stop" in places %}
        const real now = state->memory[i];
        if (i >= @{NAME}_AT_STOP_BRAKED && i <= @{NAME}_AT_STOP_PATH_RATE && now >= @{zero} && now <= @{unity}) {
            kept = 1; /* a brake under way goes on */
        }
{% endif %}
        if (kept == 0 || isfinite(state->memory[i]) == 0) {
            state->memory[i] = state->older[i];
        }
    }
    state->began_again = at_start;
    @{name}_copy(state->start, state->older, @{NAME}_MEMORY);
    @{name}_copy(state->start, state->newer, @{NAME}_MEMORY);
    return @{NAME}_WENT_BACK;
}

/* Whether input i may be one that a step gave. */
static int @{name}_possible_input(int i, real u)
{
    const real least = @{name}_defaults.value[@{NAME}_P_LOWER + i], most = @{name}_defaults.value[@{NAME}_P_UPPER + i];
    return (isfinite(u) != 0 && u >= least && u <= most) ? 1 : 0;
}

{% if code.rejected is not none or code.doubt is not none %}
/* A count; 0 where the memory was overwritten by what is none. */
static int @{name}_counted(real number)
{
    return (number > @{zero} && number <= @{most_counted}) ? (int)number : 0;
}

{% endif %}
/* What is applied: the last good input within the limits of now. Where it was overwritten, that of the start; where that
 * was too, the one before the first sample. */
static NOINLINE void @{name}_hold(const @{name}_state *state, const @{name}_param *param, @{name}_output *output)
{
    real last[@{NAME}_INPUTS];
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        const real first = (@{name}_possible_input(i, state->start[@{NAME}_AT_U + i]) != 0) ? state->start[@{NAME}_AT_U + i] : SAFE[i];
        last[i] = (@{name}_possible_input(i, state->held[i]) != 0) ? state->held[i] : first;
    }
    @{name}_limit(param, last, output->u);
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        output->estimate[i] = (isfinite(state->estimate[i]) != 0) ? state->estimate[i] : @{zero};
    }
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        output->unseen[i] = state->unseen[i];
    }
    output->status = 0;
{% if "status" in places %}
    static const int bits[@{flags | length}] = {
{% for rows in flags | batch(4) %}
        @{rows | join(", ")}@{"," if not loop.last}
{% endfor %}
    };
    for (int i = 0; i < @{flags | length}; ++i) {
        output->status += (state->memory[@{NAME}_AT_STATUS + i] > @{zero}) ? bits[i] : 0;
    }
{% endif %}
{% if code.doubt is not none %}
    output->status += (state->memory[@{NAME}_AT_DOUBT] > @{zero}) ? @{NAME}_DOUBTFUL_ESTIMATE : 0;
    output->doubtful = @{name}_counted(state->memory[@{NAME}_AT_DOUBT + 1]);
{% endif %}
{% if code.rejected is not none %}
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        output->rejected[i] = @{name}_counted(state->memory[@{NAME}_AT_REJECTED + i]);
    }
{% endif %}
    output->path_rate = {% if "stop" in places %}@{name}_smaller(@{name}_larger(state->memory[@{NAME}_AT_STOP_PATH_RATE], @{zero}), @{unity}){% else %}@{unity}{% endif %};
}

int @{name}_step(@{name}_state *state, const @{name}_param *param, const @{name}_input *input, @{name}_output *output)
{
    int in_time = 0;
    int code;
{% if plausible %}
    real y[@{NAME}_MEASUREMENTS];
{% else %}
    const real *const y = input->y;
{% endif %}
    if (input->measured != 0 && input->age >= @{zero} && input->age <= param->oldest{% if code.predicts and not plausible %} && @{name}_some(input->y) != 0{% endif %}) {
        in_time = 1;
    }
    if (state->mark != INITIALISED) {
        @{name}_limit(param, SAFE, output->u);
        for (int i = 0; i < @{NAME}_STATES; ++i) {
            output->estimate[i] = @{zero};
        }
        for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
            output->unseen[i] = MOST_UNSEEN;
        }
        output->status = 0;
        output->path_rate = @{zero};
{% if code.doubt is not none %}
        output->doubtful = 0;
{% endif %}
{% if code.rejected is not none %}
        for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
            output->rejected[i] = 0;
        }
{% endif %}
        return @{NAME}_NOT_INITIALISED;
    }
{% if plausible %}
    @{name}_look(state, input, y);
{% endif %}
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        const int before = state->unseen[i];
        const int more = (before >= 0 && before < MOST_UNSEEN) ? before + 1 : MOST_UNSEEN;
        state->unseen[i] = (in_time != 0 && isfinite(y[i]) != 0) ? 0 : more;
    }
    if (input->elapsed >= @{zero} && input->elapsed <= @{zero}) {
        state->slip = @{zero};
    } else {
        state->slip = @{name}_slipped(state->slip, input->elapsed);
    }
    if (state->refused == REFUSED) {
        code = REFUSED;
    } else if (state->slip > @{number(0.1)} || state->slip < @{number(-0.1)}) {
        code = @{NAME}_BAD_PERIOD;
    } else if (in_time != 0{% if plausible %} && @{name}_believed(state, param, y) != 0{% endif %}) {
        code = @{code.call("y")};
        if (code == @{NAME}_BAD_COMMAND) { /* its measurement was not used, and counts as none */
            if (state->waiting != 0) {
                code = @{NAME}_WAITING;
            } else if (state->missing < param->missing_limit && state->missing >= 0) {
                state->missing += 1;
            } else if (param->missing_limit > 0) {
                code = @{NAME}_STOPPED;
            } else {
                /* no sample may be missing: each says so by itself */
            }
        } else if (code != @{NAME}_BAD_MEASUREMENT) {
            state->missing = 0;
        } else {
            /* as it was */
        }
    } else if (state->waiting != 0) {
        code = @{NAME}_WAITING;
    } else if (state->missing < param->missing_limit && state->missing >= 0) {
        state->missing += 1;
        code = {% if code.predicts %}@{name}_predict(state, param, input{% if plausible %}, y, in_time{% endif %}){% else %}@{NAME}_STOPPED{% endif %};
    } else {
        code = @{NAME}_STOPPED;
    }
    if (code == @{NAME}_OK{% if code.predicts %} || code == @{NAME}_PREDICTED{% endif %}) {
        state->failed = 0;
        state->waiting = 0;
        @{name}_limit(param, state->u, state->held);
        state->samples = (state->samples >= 0 && state->samples < @{spacing}) ? state->samples + 1 : 1;
        if (state->samples == @{spacing}) {
            @{name}_copy(state->newer, state->older, @{NAME}_MEMORY);
            @{name}_copy(state->memory, state->newer, @{NAME}_MEMORY);
            state->began_again = 0;
        }
    } else if (code == @{NAME}_BAD_RESULT) {
        code = @{name}_went_back(state);
    } else {
        /* nothing was computed, and nothing changes */
    }
    @{name}_hold(state, param, output);
    return code;
}

{% if signs %}
/* What speaks against a start by these readings, bit by bit. */
static int @{name}_start_faults(const @{name}_state *state, const @{name}_param *param, const real *y)
{
    int found = 0;
    static const real moved[@{NAME}_MEASUREMENTS] = {@{start.moved}};
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        const int beyond = (y[i] < param->value[@{NAME}_P_MEASUREMENT_LOWER + i] || y[i] > param->value[@{NAME}_P_MEASUREMENT_UPPER + i]) ? 1 : 0;
        found |= (beyond != 0) ? @{NAME}_START_OUT_OF_RANGE : 0;
        found |= (state->looks > 0 && fabs@{f}(y[i] - state->looked[i]) > moved[i]) ? @{NAME}_START_MOVES : 0;
    }
{% if start.pairs %}
#ifndef @{NAME}_WITHOUT_REST
    {
        static const int links[@{start.links | length}] = {@{start.links | join(", ")}}; /* places in y */
        real rest[@{NAME}_STATES + @{NAME}_INPUTS];
        for (int i = 0; i < @{start.links | length}; ++i) {
            rest[i] = y[links[i]];
        }
        (void)@{name}_rest(param, rest, rest);
{% for pair in start.pairs %}
        found |= (fabs@{f}((@{pair.measured}) - (@{pair.model})) > @{pair.most}) ? @{NAME}_START_TWISTED : 0;
{% endfor %}
    }
#endif
{% endif %}
    return found;
}

{% endif %}
int @{name}_at_rest(@{name}_state *state, const @{name}_param *param, const @{name}_input *input, int *why)
{
    int code = @{NAME}_WAITING;
    *why = 0;
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        if (input->measured == 0 || isfinite(input->y[i]) == 0) {
            *why = @{NAME}_START_MISSING;
        }
    }
{% if signs %}
    if (*why == 0) {
        *why = @{name}_start_faults(state, param, input->y);
        code = (*why == 0) ? code : @{NAME}_BAD_START;
    }
{% else %}
    (void)param;
{% endif %}
    if (*why != 0) {
        state->looks = 0;
    } else {
        if (state->looks == 0) {
            @{name}_copy(input->y, state->looked, @{NAME}_MEASUREMENTS);
        }
        state->looks += (state->looks < @{start.samples}) ? 1 : 0;
        if (state->looks == @{start.samples}) {
            code = @{NAME}_OK;
            *why = @{0 if checkable else NAME ~ "_START_NOT_CHECKED"};
        }
    }
    return code;
}

/* Reasons of a stop at this sample, 1 or 0 each. */
static void @{name}_reasons(const @{name}_state *state, const @{name}_param *param, int code, real *reasons)
{
{% if signs %}
    const int longest = (int)param->value[@{NAME}_P_LONGEST_UNSEEN];
{% else %}
    const int longest = @{longest_unseen};
{% endif %}
    int counted = param->stop_on; /* bit by bit, the lowest first */
    int lost = 0;
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        lost += (state->unseen[i] > longest) ? 1 : 0;
    }
    for (int i = 0; i < @{reasons | length}; ++i) {
        reasons[i] = @{zero};
    }
    reasons[0] = (code == @{NAME}_BAD_PERIOD{% if signs %} || state->memory[@{NAME}_AT_PAUSES] > @{number(pauses)}{% endif %}) ? @{unity} : @{zero};
    reasons[1] = (@{fails}) ? @{unity} : @{zero};
    if (code != @{NAME}_WAITING) {
        reasons[3] = (lost > 0) ? @{unity} : @{zero};
{% if signs %}
        reasons[2] = state->memory[@{NAME}_AT_MISPLACED];
        for (int i = 0; i < @{signs}; ++i) {
            reasons[3 + i] = @{name}_larger(reasons[3 + i], state->memory[@{NAME}_AT_STATUS_SENSOR_LOST + i]);
        }
{% endif %}
    }
    for (int i = 0; i < @{reasons | length}; ++i) {
        reasons[i] = ((counted % 2) == 1) ? reasons[i] : @{zero};
        counted /= 2;
    }
}

int @{name}_may_act(@{name}_state *state, const @{name}_param *param, int code, @{name}_output *output)
{
    real reasons[@{reasons | length}], hold[@{NAME}_INPUTS], acts[@{NAME}_INPUTS], next[@{stop_size}];
    const real category = (real)param->category;
    int power = 0;
    int bit = 1;
    output->stop = 0;
    if (state->mark != INITIALISED) {
        output->stop = @{NAME}_STOP_STEP_FAILED;
        return 0;
    }
    @{name}_reasons(state, param, code, reasons);
    @{name}_copy(state->stop + @{stop_last}, hold, @{NAME}_INPUTS);
{% if code.rests %}
#ifndef @{NAME}_WITHOUT_REST
    if (@{name}_same(reasons, @{name}_initial_stop, @{reasons | length}) == 0) { /* what holds it where it is commanded */
        real rest[@{NAME}_STATES + @{NAME}_INPUTS];
        if (@{name}_rest(param, state->memory + @{NAME}_AT_REFERENCE, rest) == @{NAME}_OK) {
            @{name}_copy(rest + @{NAME}_STATES, hold, @{NAME}_INPUTS);
        }
    }
#endif
{% endif %}
    @{decided}(state->stop, reasons, output->u, hold, state->memory@{" + " + NAME + "_AT_READINGS_LAST" if signs else ""}, &category, param->value, acts, next);
    @{name}_copy(acts, output->u, @{NAME}_INPUTS);
    @{name}_copy(next, state->stop, @{stop_size});
    for (int i = 0; i < @{reasons | length}; ++i) {
        output->stop += (state->stop[i] > @{zero}) ? bit : 0;
        bit *= 2;
    }
    if (state->stop[@{reasons | length}] > @{zero}) {
        power = 1;
    }
    return power;
}

#ifndef @{NAME}_WITHOUT_CHECK
/* Numbers that may differ from the design's: of which other they are less (-1: of none), what is physical, and what the
 * design was made for. */
#define RANGES @{ranges | length}
#define ANY -HUGE_VAL@{F}, HUGE_VAL@{F}
static const struct {
    int place, below;
    real least, most, low, high;
} @{name}_ranges[RANGES] = {
@{range_rows(ranges, code.real)}
};

static real @{name}_number(const @{name}_param *param, int place)
{
    const int whole[3] = {param->missing_limit, param->stop_on, param->category};
    return (place < @{NAME}_PARAMETERS)    ? param->value[place]
           : (place == @{NAME}_PARAMETERS) ? param->oldest
                                         : (real)whole[place - @{NAME}_PARAMETERS - 1];
}

int @{name}_check(const @{name}_param *param, int *place)
{
    int worst = @{NAME}_PARAM_OK;
    int row = 0;
    for (int i = 0; i < @{NAME}_PARAMETERS + 4; ++i) {
        const real value = @{name}_number(param, i), design = @{name}_number(&@{name}_defaults, i);
        int found = @{NAME}_PARAM_BEYOND_DESIGN;
        int equal = 0;
        if (value >= design && value <= design) {
            equal = 1;
            found = @{NAME}_PARAM_OK;
        }
        if (row < RANGES && @{name}_ranges[row].place == i) {
            const int below = @{name}_ranges[row].below;
            found = @{NAME}_PARAM_OK;
            if (value < @{name}_ranges[row].low || value > @{name}_ranges[row].high) {
                found = @{NAME}_PARAM_BEYOND_DESIGN;
            }
            if (value < @{name}_ranges[row].least || value > @{name}_ranges[row].most ||
                (below >= 0 && value >= @{name}_number(param, below))) {
                found = @{NAME}_PARAM_NOT_PHYSICAL;
            }
            row += 1;
        }
        if (isfinite(value) == 0 && equal == 0) {
            found = @{NAME}_PARAM_NOT_FINITE;
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
#endif
{% if code.standstill is not none %}

#ifndef @{NAME}_WITHOUT_REST
@{standstill.functions}

int @{name}_rest(const @{name}_param *param, const @{name}_real *q, @{name}_real *r)
{
    @{standstill.call}(q, param->value, r);
    return (@{name}_finite(r, @{NAME}_STATES + @{NAME}_INPUTS) != 0) ? @{NAME}_OK : @{NAME}_BAD_COMMAND;
}
{% if code.slows %}

int @{name}_slowed(const @{name}_param *param, @{name}_real path_rate, @{name}_real *r)
{
    static const bool is_velocity[@{NAME}_STATES] = {@{standstill.is_velocity | join(", ")}};
    const real square = path_rate * path_rate;
    real rest[@{NAME}_STATES + @{NAME}_INPUTS];
    int code = @{NAME}_BAD_COMMAND;
    if (@{name}_finite(r, @{NAME}_COMMANDS) != 0 && isfinite(path_rate) != 0) {
        code = @{name}_rest(param, r, rest);
    }
    if (code == @{NAME}_OK && path_rate < @{unity}) {
        real held[@{NAME}_INPUTS], slower[@{NAME}_INPUTS];
        @{standstill.holding_fast};
        for (int i = 0; i < @{NAME}_STATES; ++i) {
            r[i] = rest[i] + ((is_velocity[i] ? path_rate : square) * (r[i] - rest[i]));
        }
        @{standstill.holding_slow};
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            r[@{NAME}_STATES + i] = slower[i] + (square * (r[@{NAME}_STATES + i] - held[i]));
        }
    }
    return code;
}
{% endif %}
#endif
{% endif %}
