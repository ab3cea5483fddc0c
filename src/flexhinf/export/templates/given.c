{# What is given to a controller, row by row: of the test vector, and of the program that records what comes of it. #}
enum { ROWS = @{codes | length}, BEGUN = @{begun} };

/* How often each row is given: once, but where something must last. From row BEGUN on the controller is provoked: it starts
 * elsewhere, with other numbers, and nothing closes the loop. */
static const int given_times[ROWS] = {
@{in_lines(repeats)}
};

/* Measurements, whether there is one, and commands. */
static const @{name}_real given_y[ROWS][@{NAME}_MEASUREMENTS] = {
@{matrix(y)}
};
static const int given_measured[ROWS] = {
@{in_lines(measured)}
};
static const @{name}_real given_r[ROWS][@{code.sizes.r}] = {
@{matrix(r)}
};

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
static int wrong_codes;

static void expect(int holds)
{
    wrong_codes += (holds != 0) ? 0 : 1;
}

static void provoke(void)
{
{% if provocation is not none %}
    for (int i = 0; i < @{NAME}_PARAMETERS; ++i) {
        param.value[i] = other_numbers[i];
    }
    expect(@{name}_start(&state, &param, @{"other_state" if provocation.state is not none else "NULL"}, other_input) == @{NAME}_OK);
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
{% if c.mode.checks_measurements %}
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.fresh[i] = (given_times[row] > 1) ? 1 : 0; /* the same frame again, which is a new one */
    }
{% endif %}
    spoil(row);
    for (int times = given_times[row]; times > 0; --times) {
        code = @{name}_step(&state, &param, &input, &output);
    }
    return code;
}
