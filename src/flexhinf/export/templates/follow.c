/* @{name}_follow: see @{name}_follow.h. Made by flexhinf @{version}; not to be edited. SPDX-License-Identifier: 0BSD */
#include "@{name}_follow.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>

@{arithmetic}

#define FMA(a, b, c) (((a) * (b)) + (c))
#define JOINTS @{NAME}_FOLLOW_JOINTS
#define SAMPLES @{NAME}_FOLLOW_SAMPLES

#define scalar @{name}_real

const @{name}_follow_options @{name}_follow_defaults = {
    {{@{row(usual[0, 0])}}, {@{row(usual[0, 1])}}},
    {{@{row(usual[1, 0])}}, {@{row(usual[1, 1])}}},
    @{number(goal_time)},
    @{number(timeout)},
    @{number(stop_time)},
    @{partial},
    1
};

/* What the joints and their drives are fixed to: ranges, speeds, jumps, and what a goal may ask of drives. */
@{constants}

/* What the largest inputs twist springs by; and places of motors in a row. */
static const scalar @{name}_follow_twists[JOINTS] = {@{row_of_twists}};
static const int @{name}_follow_motors[JOINTS] = {@{motors | join(", ")}};

/* Weights of the samples before the newest one, from it back, for the position and four derivatives. */
static const scalar @{name}_follow_weights[SAMPLES - 1][5] = {
@{matrix(weights.T[1:])}
};

@{functions}

/* The smoothed path, beside its newest sample, so that one at rest leaves no rounding in the derivatives. */
static void @{name}_follow_smooth(scalar path[SAMPLES][JOINTS], int newest, scalar motion[5][JOINTS])
{
    for (int j = 0; j < JOINTS; ++j) {
        scalar sums[5] = {@{zero}, @{zero}, @{zero}, @{zero}, @{zero}};
        int i = newest;
        for (int sample = 0; sample < SAMPLES - 1; ++sample) {
            scalar way;
            i = (i > 0) ? i - 1 : SAMPLES - 1;
            way = path[i][j] - path[newest][j];
            for (int k = 0; k < 5; ++k) {
                sums[k] += @{name}_follow_weights[sample][k] * way;
            }
        }
        sums[0] += path[newest][j];
        for (int k = 0; k < 5; ++k) {
            motion[k][j] = sums[k];
        }
    }
}

{% if limited %}
/* The inputs of drives on a motion. */
static void @{name}_follow_commanded(scalar motion[5][JOINTS], scalar inputs[JOINTS])
{
    scalar row[@{NAME}_STATES + @{NAME}_INPUTS];
    @{called}(motion[0], motion[1], motion[2], motion[3], motion[4], @{name}_defaults.value, row, row + @{NAME}_STATES);
    for (int j = 0; j < JOINTS; ++j) {
        inputs[j] = row[@{NAME}_STATES + j];
    }
}

{% endif %}
@{machine}

int @{name}_follow_init(@{name}_follow_state *state, const @{name}_real *q)
{
    static const @{name}_follow_state none = {0};
    int code = (@{name}_follow_exact() != 0) ? @{NAME}_OK : @{NAME}_BAD_ARITHMETIC;
    *state = none;
    if (@{name}_follow_stand_at(state, q) == 0) {
        code = @{NAME}_BAD_COMMAND;
    }
    return code;
}

void @{name}_follow_cancel(@{name}_follow_state *state, const @{name}_follow_options *options)
{
    @{name}_follow_cancel_goal(state, options, 0);
}

int @{name}_follow_step(@{name}_follow_state *state, const @{name}_follow_options *options, const @{name}_param *param,
                       const @{name}_follow_input *input, @{name}_follow_output *output)
{
    scalar motion[5][JOINTS];
    @{name}_follow_sample(state, options, input, motion, output);
    @{called}(motion[0], motion[1], motion[2], motion[3], motion[4], param->value, output->r, output->r + @{NAME}_STATES);
    return @{name}_follow_judge(state, options, input, output);
}

int @{name}_follow_stream(const @{name}_param *param, @{name}_real *spent, long periods, const @{name}_real *before, const @{name}_real *r)
{
    scalar rest[@{NAME}_STATES + @{NAME}_INPUTS];
    int code = @{name}_rest(param, r, rest);
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        if (isfinite(r[i]) == 0) {
            code = @{NAME}_BAD_COMMAND;
        }
    }
    for (int j = 0; j < JOINTS; ++j) {
        if (!(fabs@{f}(r[@{name}_follow_motors[j]] - rest[@{name}_follow_motors[j]]) <= @{name}_follow_twists[j])) {
            code = @{NAME}_BAD_COMMAND;
        }
    }
    if (code == @{NAME}_OK && @{name}_follow_streams(spent, periods, before, r) == 0) {
        code = @{NAME}_BAD_COMMAND;
    }
    return code;
}

int @{name}_follow_row(const @{name}_param *param, const @{name}_real *before, const @{name}_real *r)
{
    scalar spent[JOINTS] = {0};
    return @{name}_follow_stream(param, spent, 1, before, r);
}
