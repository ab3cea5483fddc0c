{% macro of_runs() %}
{% for run in runs %}
@{caller(run)}
{%- if not loop.last %}
}, {
{% endif %}
{% endfor %}
{% endmacro %}
/* Test vector of @{name}: a run recorded by flexhinf @{version}, with samples that are missing or not finite.
 * Exit code 0 if every answer is that of the recording: inputs, estimates, codes and status. */
#include "@{name}.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { RUNS = @{runs | length}, EVERY = @{every}, PARTS = @{sizes | length} };

{% include "given.c" %}

/* How many rows are given: with -D@{NAME}_LOOP_ALONE those of the loop, to count what a usual step costs. */
#ifdef @{NAME}_LOOP_ALONE
#define GIVEN BEGUN
#else
#define GIVEN ROWS
#endif

/* The part of each row: parts have sizes and tolerances of their own. */
static const int part_of[ROWS] = {
@{in_lines(part_of_row)}
};
static const char *const names[PARTS] = { @{names_of_parts | quoted} };

/* Of the runs without and with fused multiply-adds, the one that this build repeats. */
#define RUN @{name ~ "_fused" if runs | length > 1 else 0}

/* Largest errors of inputs and estimates in each part, relative to the largest value of each signal there. */
static const @{name}_real tolerance[PARTS] = { @{row(allowed.inputs)} };
static const @{name}_real tolerance_of_estimates[PARTS] = { @{row(allowed.estimates)} };
{% if sums %}
static const @{name}_real tolerance_of_memory[PARTS] = { @{row(allowed.memory)} };
{% endif %}

/* What must come of each row in each run, and of every EVERY-th one what is estimated; the code, the counts and the status,
 * -1 where rounding may decide about it. */
static const @{name}_real expected_u[RUNS][ROWS][@{NAME}_INPUTS] = {{
{% call(run) of_runs() %}
@{matrix(run.u)}
{% endcall %}
}};
static const @{name}_real size_of_u[PARTS][@{NAME}_INPUTS] = {
@{matrix(sizes)}
};
static const @{name}_real expected_estimate[RUNS][(ROWS + EVERY - 1) / EVERY][@{NAME}_STATES] = {{
{% call(run) of_runs() %}
@{matrix(run.estimates)}
{% endcall %}
}};
static const @{name}_real size_of_estimate[PARTS][@{NAME}_STATES] = {
@{matrix(sizes_of_estimates)}
};
static const int expected_code[ROWS] = {
@{in_lines(codes)}
};
static const int expected_unseen[ROWS][@{NAME}_MEASUREMENTS] = {
@{integers(unseen)}
};
{% if code.rejected is not none and exact %}
static const int expected_rejected[ROWS][@{NAME}_MEASUREMENTS] = {
@{integers(rejected)}
};
{% endif %}
{% if code.doubt is not none and exact %}
static const int expected_doubtful[RUNS][ROWS] = {{
{% call(run) of_runs() %}
@{in_lines(run.doubtful)}
{% endcall %}
}};
{% endif %}
{% if code.slows or code.reacts %}
static const @{name}_real expected_rate[RUNS][ROWS] = {{
{% call(run) of_runs() %}
@{numbers(run.path_rate)}
{% endcall %}
}};
{% endif %}
static const int expected_status[RUNS][ROWS] = {{
{% call(run) of_runs() %}
@{in_lines(run.status)}
{% endcall %}
}};

{% if hashes %}
/* What must be remembered after each row, as a hash. */
static const uint32_t expected_memory[RUNS][ROWS] = {{
{% call(run) of_runs() %}
@{in_lines(run.hashes, 9)}
{% endcall %}
}};

{% endif %}
{% if adds %}
/* What must be remembered after each row, each number over its largest value, added up with factors. */
static const @{name}_real share_of_memory[@{NAME}_MEMORY] = {
@{numbers(shares)}
};
{% if sums %}
static const @{name}_real expected_sum[RUNS][ROWS] = {{
{% call(run) of_runs() %}
@{numbers(run.sums)}
{% endcall %}
}};
{% endif %}

{% endif %}
static @{name}_real worst[PARTS], worst_estimate[PARTS];

/* FNV-1a of the bits of numbers as doubles, a number at a time. */
static uint64_t hashed(uint64_t hash, double number)
{
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    return (hash ^ bits) * 0x100000001b3u;
}

static uint64_t hash_of(const @{name}_real *numbers, int count)
{
    uint64_t hash = 0xcbf29ce484222325u;
    for (int i = 0; i < count; ++i) {
        hash = hashed(hash, (double)numbers[i]);
    }
    return hash;
}

{% if library is not none %}
/* Whether this C library gives what that one gave with which the run was recorded: then every bit must be the same. */
static int same_library(void)
{
    uint64_t every = 0xcbf29ce484222325u;
{% for function, operands in library_calls %}
    {
        uint64_t hash = 0xcbf29ce484222325u;
        for (uint32_t i = 0; i < @{arguments.count}u; ++i) {
            const @{name}_real x = @{number(arguments.first)} + ((@{name}_real)i / @{number(arguments.steps)});
{% if operands == 2 %}
            const @{name}_real y = @{number(arguments.first)} + ((@{name}_real)((i * @{arguments.turn}u) % @{arguments.count}u) / @{number(arguments.steps)});
            const double found = (double)@{function}(x, y);
{% else %}
            const double found = (double)@{function}(x);
{% endif %}
            hash = hashed(hash, (isnan(found) != 0) ? 0.0 : found);
        }
        every = hashed(every, (double)(hash >> 32u));
    }
{% endfor %}
    return (every == @{library}) ? 1 : 0;
}

{% endif %}
/* The larger of an error and the largest before. NaN counts as more than any number, for good. */
static @{name}_real larger(@{name}_real before, @{name}_real error)
{
    if (error <= before) {
        return before;
    }
    return (error >= before) ? error : 1e30@{f};
}

{% if adds %}
static double sum_of_memory(void)
{
    double sum = 0;
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        sum += (double)share_of_memory[i] * (double)state.memory[i];
    }
    return sum;
}

{% endif %}
/* Whether a number is the expected one, or rounding may decide about it. */
static int agrees(int said, int expected)
{
    return (expected < 0 || said == expected) ? 1 : 0;
}

/* What a step says beside inputs and estimates. */
static void compare_counts(int row)
{
    expect(agrees({% if exact %}output.status{% else %}output.status & ~@{NAME}_DOUBTFUL_ESTIMATE{% endif %}, expected_status[RUN][row]));
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        expect(agrees(output.unseen[i], expected_unseen[row][i]));
{% if code.rejected is not none and exact %}
        expect(agrees(output.rejected[i], expected_rejected[row][i]));
{% endif %}
    }
{% if code.doubt is not none and exact %}
    expect(output.doubtful == expected_doubtful[RUN][row]);
{% endif %}
{% if code.slows or code.reacts %}
    expect(fabs@{f}(output.path_rate - expected_rate[RUN][row]) <= @{number(allowed.rate)});
{% else %}
    expect(output.path_rate >= 1 && output.path_rate <= 1);
{% endif %}
}


static void compare(int row)
{
    const int part = part_of[row];
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        const @{name}_real away = output.u[i] - expected_u[RUN][row][i];
        worst[part] = larger(worst[part], fabs@{f}(away) / size_of_u[part][i]);
    }
    for (int i = 0; i < @{NAME}_STATES && row % EVERY == 0; ++i) {
        const @{name}_real away = output.estimate[i] - expected_estimate[RUN][row / EVERY][i];
        worst_estimate[part] = larger(worst_estimate[part], fabs@{f}(away) / size_of_estimate[part][i]);
    }
}

int main(void)
{
    int passed, samples = 0;
    const int exact = {% if not hashes %}0{% elif not sums %}1{% elif library is none %}0{% else %}same_library(){% endif %};
    param = @{name}_defaults;
    if (@{name}_init(&state) != @{NAME}_OK) {
        printf("@{name}: flags of the compiler change results: FAILED\n");
        return 1;
    }
    expect(strcmp(@{name}_version, "@{version}") == 0 && strcmp(@{name}_digest, @{NAME}_DIGEST) == 0); /* of its header */
    expect(hash_of(@{name}_defaults.value, @{NAME}_PARAMETERS) == @{tables[0]}); /* the numbers of the design, all of them */
    expect(hash_of(state.start, @{NAME}_MEMORY) == @{tables[1]});
    for (int row = 0; row < GIVEN; ++row) {
        if (row == BEGUN) {
            provoke();
{% if provocation is not none and exact %}
            expect(fabs(sum_of_memory() - @{double(shares_at_start)}) <= @{double(allowed.start)} * @{NAME}_MEMORY);
{% endif %}
        }
        expect(agrees(step(row), expected_code[row]));
        samples += given_times[row];
        compare(row);
        compare_counts(row);
{% if sums %}
        expect(fabs(sum_of_memory() - (double)expected_sum[RUN][row]) <= (double)tolerance_of_memory[part_of[row]] * @{NAME}_MEMORY);
{% endif %}
{% if hashes %}
        expect(!exact || (uint32_t)(hash_of(state.memory, @{NAME}_MEMORY) >> 32u) == expected_memory[RUN][row]);
{% endif %}
    }
    passed = (wrong_codes == 0) ? 1 : 0;
    for (int part = 0; part < PARTS; ++part) {
        const @{name}_real most = exact ? 0 : tolerance[part], most_of_estimates = exact ? 0 : tolerance_of_estimates[part];
        if (!(worst[part] <= most && worst_estimate[part] <= most_of_estimates)) {
            passed = 0;
        }
        printf("@{name}%s: largest relative error %.3g (allowed %.3g), of estimates %.3g (allowed %.3g)\n", names[part],
               (double)worst[part], (double)most, (double)worst_estimate[part], (double)most_of_estimates);
    }
    printf("@{name}: %d samples, wrong codes %d: %s\n", samples, wrong_codes, (passed != 0) ? "passed" : "FAILED");
    return (passed != 0) ? 0 : 1;
}
