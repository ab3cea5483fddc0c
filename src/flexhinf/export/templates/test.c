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

enum { ROWS = @{codes | length}, RUNS = @{runs | length}, EVERY = @{every}, PARTS = @{sizes | length}, BEGUN = @{begun} };

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

/* How often each row is given: once, but where something must last. From row BEGUN on the controller is provoked: it starts
 * elsewhere, with other numbers, and nothing closes the loop. */
static const int given_times[ROWS] = {
@{in_lines(repeats)}
};

/* Measurements, whether there is one, and commands; what must come of them in each run, and of every EVERY-th row what is
 * estimated; of each row the code, the counts, and the status, -1 where rounding may decide about it. */
static const @{name}_real given_y[ROWS][@{NAME}_MEASUREMENTS] = {
@{matrix(y)}
};
static const int given_measured[ROWS] = {
@{in_lines(measured)}
};
static const @{name}_real given_r[ROWS][@{code.sizes.r}] = {
@{matrix(r)}
};
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
static const uint64_t expected_memory[RUNS][ROWS] = {{
{% call(run) of_runs() %}
@{in_lines(run.hashes, 5)}
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
{% if provocation is not none %}
/* Numbers that are not the design's, and where the controller starts. */
static const @{name}_real other_numbers[@{NAME}_PARAMETERS] = {
@{numbers(provocation.numbers)}
};
{% if provocation.state is not none %}
static const @{name}_real other_state[@{NAME}_STATES] = {@{row(provocation.state)}};
{% endif %}
{% if provocation.noises %}
/* Places of variances, which are others from each of these rows on. */
enum { NOISES = @{provocation.noises | length} };
static const int noise[@{provocation.noise | length}] = {
@{in_lines(provocation.noise | list)}
};
static const int noise_from[NOISES] = {
@{in_lines(provocation.noises | list)}
};
static const @{name}_real noise_is[NOISES][@{provocation.noise | length}] = {
@{matrix(provocation.noises.values())}
};
{% endif %}
static const @{name}_real other_input[@{NAME}_INPUTS] = {@{row(provocation.input)}};

{% if provocation.memories %}
/* Before which rows the memory is replaced, by which of the bases, and the first of the numbers in which it differs. */
static const int replaced[@{replaced | length}][3] = {
@{integers(replaced)}
};
static const @{name}_real bases[@{bases | length}][@{NAME}_MEMORY] = {
{% for memory in bases %}
    {
@{numbers(memory)}
    }@{"," if not loop.last}
{% endfor %}
};
enum { CHANGED = @{changed | length - 1} };
static const int changed_place[CHANGED + 1] = {
@{in_lines(changed)}
};
static const @{name}_real changed_to[CHANGED + 1] = {
@{numbers(changed_to)}
};

{% endif %}
{% endif %}
static @{name}_state state;
static @{name}_param param;
static @{name}_input input;
static @{name}_output output;
static @{name}_real worst[PARTS], worst_estimate[PARTS];
static int wrong_codes;

static void expect(int holds)
{
    wrong_codes += (holds != 0) ? 0 : 1;
}

/* The larger of an error and the largest before. NaN counts as more than any number, for good. */
static @{name}_real larger(@{name}_real before, @{name}_real error)
{
    if (error <= before) {
        return before;
    }
    return (error >= before) ? error : 1e30@{f};
}

{% if adds %}
static @{name}_real sum_of_memory(void)
{
    @{name}_real sum = 0;
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        sum += share_of_memory[i] * state.memory[i];
    }
    return sum;
}

{% endif %}
static void provoke(void)
{
{% if provocation is not none %}
    for (int i = 0; i < @{NAME}_PARAMETERS; ++i) {
        param.value[i] = other_numbers[i];
    }
    expect(@{name}_start(&state, &param, @{"other_state" if provocation.state is not none else "NULL"}, other_input) == @{NAME}_OK);
{% if exact %}
    expect(fabs@{f}(sum_of_memory() - @{number(shares_at_start)}) <= @{number(1e-9)} * @{NAME}_MEMORY);
{% endif %}
{% endif %}
}

/* No answer depends on what a step leaves in the memory to work in. */
static void spoil(int row)
{
    const @{name}_real number = (row % 2 == 0) ? (@{name}_real)NAN : 1000;
    for (int i = 0; i < @{NAME}_WORK; ++i) {
        state.work[i] = number;
    }
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        state.after[i] = number;
    }
}

static int step(int row)
{
    int code = 0;
{% if provocation is not none and provocation.memories %}
    for (int k = 0; k < @{replaced | length}; ++k) {
        if (row == replaced[k][0]) {
            const int end = (k + 1 < @{replaced | length}) ? replaced[k + 1][2] : CHANGED;
            for (int i = 0; i < @{NAME}_MEMORY; ++i) {
                state.memory[i] = bases[replaced[k][1]][i];
            }
            for (int i = replaced[k][2]; i < end; ++i) {
                state.memory[changed_place[i]] = changed_to[i];
            }
            state.failed = 0;
        }
    }
{% if provocation.noises %}
    for (int k = 0; k < NOISES; ++k) {
        for (int i = 0; i < @{provocation.noise | length} && row == BEGUN + noise_from[k]; ++i) {
            param.value[noise[i]] = noise_is[k][i];
        }
    }
{% endif %}
{% endif %}
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.y[i] = given_y[row][i];
    }
    for (int i = 0; i < @{code.sizes.r}; ++i) {
        input.r[i] = given_r[row][i];
    }
    input.measured = given_measured[row];
    spoil(row);
    for (int times = given_times[row]; times > 0; --times) {
        code = @{name}_step(&state, &param, &input, &output);
    }
    return code;
}

/* What a step says beside inputs and estimates. */
static void compare_counts(int row)
{
    if (expected_status[RUN][row] >= 0) {
        expect({% if exact %}output.status{% else %}(output.status & ~@{NAME}_DOUBTFUL_ESTIMATE){% endif %} == expected_status[RUN][row]);
    }
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        expect(output.unseen[i] == expected_unseen[row][i]);
{% if code.rejected is not none and exact %}
        expect(output.rejected[i] == expected_rejected[row][i]);
{% endif %}
    }
{% if code.doubt is not none and exact %}
    expect(output.doubtful == expected_doubtful[RUN][row]);
{% endif %}
{% if code.slows or code.reacts %}
    expect(fabs@{f}(output.path_rate - expected_rate[RUN][row]) <= @{"0" if exact else "0.05F"});
{% else %}
    expect(output.path_rate >= 1 && output.path_rate <= 1);
{% endif %}
}

/* FNV-1a of the bits of numbers as doubles, a number at a time. */
static uint64_t hash_of(const @{name}_real *numbers, int count)
{
    uint64_t hash = 0xcbf29ce484222325u;
    for (int i = 0; i < count; ++i) {
        const double number = (double)numbers[i];
        uint64_t bits;
        memcpy(&bits, &number, sizeof bits);
        hash = (hash ^ bits) * 0x100000001b3u;
    }
    return hash;
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
    param = @{name}_defaults;
    if (@{name}_init(&state) != @{NAME}_OK) {
        printf("@{name}: flags of the compiler change results: FAILED\n");
        return 1;
    }
    expect(hash_of(@{name}_defaults.value, @{NAME}_PARAMETERS) == @{tables[0]}); /* the numbers of the design, all of them */
    expect(hash_of(state.start, @{NAME}_MEMORY) == @{tables[1]});
    for (int row = 0; row < GIVEN; ++row) {
        if (row == BEGUN) {
            provoke();
        }
        expect(step(row) == expected_code[row]);
        samples += given_times[row];
        compare(row);
        compare_counts(row);
{% if sums %}
        expect(fabs@{f}(sum_of_memory() - expected_sum[RUN][row]) <= tolerance[part_of[row]] * @{NAME}_MEMORY);
{% endif %}
{% if hashes %}
        expect(hash_of(state.memory, @{NAME}_MEMORY) == expected_memory[RUN][row]);
{% endif %}
    }
    passed = (wrong_codes == 0) ? 1 : 0;
    for (int part = 0; part < PARTS; ++part) {
        if (!(worst[part] <= tolerance[part] && worst_estimate[part] <= tolerance_of_estimates[part])) {
            passed = 0;
        }
        printf("@{name}%s: largest relative error %.3g (allowed %.3g), of estimates %.3g (allowed %.3g)\n", names[part],
               (double)worst[part], (double)tolerance[part], (double)worst_estimate[part],
               (double)tolerance_of_estimates[part]);
    }
    printf("@{name}: %d samples, wrong codes %d: %s\n", samples, wrong_codes, (passed != 0) ? "passed" : "FAILED");
    return (passed != 0) ? 0 : 1;
}
