/* The plant @{name} as the model of an FMU: @{sub_steps} steps of the classical Runge-Kutta method per period of
 * @{period_text} s. */
{% set guard = NAME ~ "_MODEL_H" %}
{% include "guard.h" %}

#include <math.h>
#include <stdbool.h>

{% include "arithmetic.c" %}

#define MODEL_NAME "@{name}"
#define MODEL_GUID @{guid | quoted}
#define MODEL_PERIOD @{period}
#define MODEL_PERIOD_TEXT "@{period_text}"

enum {
    STATES = @{n},
    INPUTS = @{m},
    DISTURBANCES = @{d},
    PARAMETERS = @{p},
    OUTPUTS = @{y},
    SUB_STEPS = @{sub_steps},
    FIRST_U = 0,
    FIRST_D = FIRST_U + INPUTS,
    FIRST_P = FIRST_D + DISTURBANCES,
    FIRST_START = FIRST_P + PARAMETERS,
    MODEL_SETTABLE = FIRST_START + STATES,
    FIRST_Y = MODEL_SETTABLE,
    FIRST_X = FIRST_Y + OUTPUTS,
    MODEL_REALS = FIRST_X + STATES,
    MODEL_SETTABLE_INTEGERS = 0,
    MODEL_INTEGERS = 0,
    MODEL_BOOLEANS = 0,
    MODEL_SETTABLE_BOOLEANS = 0
};

typedef struct {
    double real[MODEL_REALS];
    int integer[1], boolean[1];
} model_instance;

#define FMA(a, b, c) ((a) * (b) + (c))
typedef double real;

@{functions}
/* Whether flags of the compiler change results. */
static int model_refuses(model_instance *model)
{
    (void)model;
    return !@{name}_exact();
}

static void model_flow(const model_instance *model, const double *x, double *slope)
{
    const double *r = model->real;
    @{flow}
}

static void model_output(model_instance *model)
{
    double *r = model->real;
    @{output}
}

static void model_begin(model_instance *model)
{
    for (int i = 0; i < STATES; ++i) {
        model->real[FIRST_X + i] = model->real[FIRST_START + i];
    }
    model_output(model);
}

static void model_reset(model_instance *model)
{
    static const double start[MODEL_SETTABLE] = {
@{start}
    };
    for (int i = 0; i < MODEL_SETTABLE; ++i) {
        model->real[i] = start[i];
    }
    model_begin(model);
}

static int model_step(model_instance *model)
{
    double *x = model->real + FIRST_X;
    const double h = MODEL_PERIOD / SUB_STEPS;
    for (int k = 0; k < SUB_STEPS; ++k) {
        double slope[4][STATES], at[STATES];
        static const double share[3] = {0.5, 0.5, 1.0};
        model_flow(model, x, slope[0]);
        for (int stage = 1; stage < 4; ++stage) {
            for (int i = 0; i < STATES; ++i) {
                at[i] = x[i] + share[stage - 1] * h * slope[stage - 1][i];
            }
            model_flow(model, at, slope[stage]);
        }
        for (int i = 0; i < STATES; ++i) {
            x[i] += h / 6.0 * (slope[0][i] + 2.0 * (slope[1][i] + slope[2][i]) + slope[3][i]);
        }
    }
    for (int i = 0; i < STATES; ++i) {
        if (!isfinite(x[i])) {
            return 0;
        }
    }
    model_output(model);
    return 1;
}

#endif
