/* The controller @{name} as the model of an FMU: one sample per period, at its beginning. */
{% set guard = NAME ~ "_MODEL_H" %}
{% include "guard.h" %}

#include "@{name}.h"

#define MODEL_NAME "@{name}"
#define MODEL_GUID @{guid | quoted}
#define MODEL_PERIOD @{c.period}
#define MODEL_PERIOD_TEXT "@{period_text}"

enum {
    FIRST_Y = 0,
    FIRST_R = FIRST_Y + @{NAME}_MEASUREMENTS,
    FIRST_LOWER = FIRST_R + @{NAME}_COMMANDS,
    FIRST_UPPER = FIRST_LOWER + @{NAME}_INPUTS,
    FIRST_START = FIRST_UPPER + @{NAME}_INPUTS,
    STARTS = @{starts}, /* numbers of the estimate that can be set: those of the first state, or none */
    MODEL_SETTABLE = FIRST_START + STARTS,
    FIRST_U = MODEL_SETTABLE,
    FIRST_X = FIRST_U + @{NAME}_INPUTS,
    PATH_RATE = FIRST_X + @{NAME}_STATES,
    MODEL_REALS = PATH_RATE + 1,
    MISSING_LIMIT = 0,
    STOP_ON = 1,
    CATEGORY = 2,
    FIRST_FRESH = 3,
    MODEL_SETTABLE_INTEGERS = FIRST_FRESH + @{fresh},
    CODE = MODEL_SETTABLE_INTEGERS,
    STATUS = CODE + 1,
    STOP = STATUS + 1,
    FIRST_COUNT = STOP + 1, /* samples in doubt and rejected measurements, as far as the controller counts them */
    COUNTS = @{doubtful + rejected},
    MODEL_INTEGERS = FIRST_COUNT + COUNTS,
    MEASURED = 0,
    MODEL_SETTABLE_BOOLEANS = 1,
    POWER = MODEL_SETTABLE_BOOLEANS,
    MODEL_BOOLEANS = POWER + 1
};

typedef struct {
    @{name}_state state;
    @{name}_param param;
    double real[MODEL_REALS];
    int integer[MODEL_INTEGERS];
    int boolean[MODEL_BOOLEANS];
} model_instance;

/* Whether flags of the compiler change results: see @{name}.h. */
static int model_refuses(model_instance *model) { return @{name}_init(&model->state) != @{NAME}_OK; }

static void model_reset(model_instance *model)
{
    static const double start[MODEL_REALS] = {
@{start}
    };
    for (int i = 0; i < MODEL_REALS; ++i) {
        model->real[i] = start[i];
    }
    model->param = @{name}_defaults;
    for (int i = 0; i < MODEL_INTEGERS; ++i) {
        model->integer[i] = 0;
    }
    model->integer[MISSING_LIMIT] = model->param.missing_limit;
    model->integer[STOP_ON] = model->param.stop_on;
    model->integer[CATEGORY] = model->param.category;
    model->integer[CODE] = @{NAME}_OK;
    model->boolean[MEASURED] = 1;
    model->boolean[POWER] = 1;
    @{name}_init(&model->state);
}

static void model_begin(model_instance *model)
{
    int elsewhere = 0;
    model->param.missing_limit = model->integer[MISSING_LIMIT];
    model->param.stop_on = model->integer[STOP_ON];
    model->param.category = model->integer[CATEGORY];
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        model->param.value[@{NAME}_P_LOWER + i] = model->real[FIRST_LOWER + i];
        model->param.value[@{NAME}_P_UPPER + i] = model->real[FIRST_UPPER + i];
    }
    for (int i = 0; i < STARTS; ++i) {
        elsewhere = elsewhere || model->real[FIRST_START + i] != model->state.start[i];
    }
    if (elsewhere) {
        @{name}_start(&model->state, &model->param, model->real + FIRST_START, 0);
    }
    for (int i = 0; i < STARTS; ++i) {
        model->real[FIRST_X + i] = model->real[FIRST_START + i];
    }
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        const double first = model->state.held[i];
        const double above = first > model->real[FIRST_LOWER + i] ? first : model->real[FIRST_LOWER + i];
        model->real[FIRST_U + i] = above < model->real[FIRST_UPPER + i] ? above : model->real[FIRST_UPPER + i];
    }
}

/* Whatever the sample, the output is safe: there is nothing to refuse. */
static int model_step(model_instance *model)
{
    @{name}_input input = {0};
    @{name}_output output = {0};
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.y[i] = model->real[FIRST_Y + i];
    }
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        input.r[i] = model->real[FIRST_R + i];
    }
    input.measured = model->boolean[MEASURED];
{% if fresh %}
    for (int i = 0; i < @{fresh}; ++i) {
        input.fresh[i] = model->integer[FIRST_FRESH + i];
    }
{% endif %}
    model->integer[CODE] = @{name}_step(&model->state, &model->param, &input, &output);
    model->boolean[POWER] = @{name}_may_act(&model->state, &model->param, model->integer[CODE], &output); /* output.u is what acts */
    model->integer[STOP] = output.stop;
    model->integer[STATUS] = output.status;
{% if doubtful %}
    model->integer[FIRST_COUNT] = output.doubtful;
{% endif %}
{% if rejected %}
    for (int i = 0; i < @{rejected}; ++i) {
        model->integer[FIRST_COUNT + @{doubtful} + i] = output.rejected[i];
    }
{% endif %}
    model->real[PATH_RATE] = output.path_rate;
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        model->real[FIRST_U + i] = output.u[i];
    }
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        model->real[FIRST_X + i] = output.estimate[i];
    }
    return 1;
}

#endif
