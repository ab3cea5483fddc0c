/* @NAME@ as a co-simulation FMU of FMI 3.0, made by flexhinf @VERSION@. All that is remembered is in the instance. */
#include "@NAME@_fmi3.h"
#include "@NAME@_model.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* References: reals, integers and booleans of the model follow each other, then the time. */
enum {
    FIRST_INTEGER = MODEL_REALS,
    FIRST_BOOLEAN = FIRST_INTEGER + MODEL_INTEGERS,
    TIME = FIRST_BOOLEAN + MODEL_BOOLEANS
};

typedef struct {
    model_instance model;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    double time;
    int starting; /* what is set changes outputs at once, until the initialisation ends */
} instance;

static void report(fmi3LogMessageCallback log, fmi3InstanceEnvironment environment, const char *text)
{
    if (log != NULL) {
        log(environment, fmi3Error, "logStatusError", text);
    }
}

static fmi3Status refuse(const instance *one, const char *text)
{
    if (one != NULL) {
        report(one->log, one->environment, text);
    }
    return fmi3Error;
}

/* Set-up ------------------------------------------------------------------------------------------------- */
EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t count, const fmi3String names[])
{
    (void)c;
    (void)on; /* errors alone are reported, and always */
    (void)count;
    (void)names;
    return fmi3OK;
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
                                                fmi3Boolean early, const fmi3ValueReference intermediate[],
                                                size_t count, fmi3InstanceEnvironment environment,
                                                fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    instance *one;
    (void)name;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)early;
    (void)intermediate;
    (void)update;
    if (events || count > 0) {
        report(log, environment, "there are no events and no intermediate values");
        return NULL;
    }
    if (token == NULL || strcmp(token, MODEL_GUID) != 0) {
        report(log, environment, "another instantiation token");
        return NULL;
    }
    one = calloc(1, sizeof *one);
    if (one == NULL) {
        report(log, environment, "no memory");
        return NULL;
    }
    if (model_refuses(&one->model)) {
        report(log, environment, "compiled with flags that change results");
        free(one);
        return NULL;
    }
    one->log = log;
    one->environment = environment;
    model_reset(&one->model);
    return one;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                 fmi3Boolean visible, fmi3Boolean logging,
                                                 fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    report(log, environment, "this FMU is for co-simulation");
    return NULL;
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                      fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                                      fmi3UnlockPreemptionCallback unlock)
{
    (void)update;
    (void)lock;
    (void)unlock;
    return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, log);
}

EXPORT void fmi3FreeInstance(fmi3Instance c) { free(c); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerant, fmi3Float64 tolerance,
                                              fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop)
{
    (void)tolerant;
    (void)tolerance;
    (void)stops;
    (void)stop;
    ((instance *)c)->time = start;
    ((instance *)c)->starting = 1;
    return fmi3OK;
}

EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    ((instance *)c)->starting = 0;
    model_begin(&((instance *)c)->model);
    return fmi3OK;
}

EXPORT fmi3Status fmi3Terminate(fmi3Instance c)
{
    (void)c;
    return fmi3OK;
}

EXPORT fmi3Status fmi3Reset(fmi3Instance c)
{
    ((instance *)c)->time = 0.0;
    ((instance *)c)->starting = 0;
    model_reset(&((instance *)c)->model);
    return fmi3OK;
}

/* Whether a reference is among the first ones; of a model, there may be none. */
static int within(fmi3ValueReference which, fmi3ValueReference count) { return which < count; }

/* Variables ---------------------------------------------------------------------------------------------- */
EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference which[], size_t count, fmi3Float64 value[],
                                 size_t values)
{
    instance *one = c;
    if (one->starting) {
        model_begin(&one->model);
    }
    for (size_t i = 0; i < count; ++i) {
        if (values != count || (which[i] >= MODEL_REALS && which[i] != TIME)) {
            return refuse(one, "no such variable of type Float64");
        }
        value[i] = which[i] == TIME ? one->time : one->model.real[which[i]];
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference which[], size_t count,
                                 const fmi3Float64 value[], size_t values)
{
    instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        if (values != count || which[i] >= MODEL_SETTABLE) {
            return refuse(one, "no such input or parameter of type Float64");
        }
        one->model.real[which[i]] = value[i];
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference which[], size_t count, fmi3Int32 value[],
                               size_t values)
{
    const instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        const fmi3ValueReference place = which[i] - FIRST_INTEGER; /* of a smaller reference it is a large number */
        if (values != count || !within(place, MODEL_INTEGERS)) {
            return refuse(one, "no such variable of type Int32");
        }
        value[i] = one->model.integer[place];
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference which[], size_t count,
                               const fmi3Int32 value[], size_t values)
{
    instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        const fmi3ValueReference place = which[i] - FIRST_INTEGER;
        if (values != count || !within(place, MODEL_SETTABLE_INTEGERS)) {
            return refuse(one, "no such input or parameter of type Int32");
        }
        one->model.integer[place] = value[i];
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetBoolean(fmi3Instance c, const fmi3ValueReference which[], size_t count, fmi3Boolean value[],
                                 size_t values)
{
    const instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        const fmi3ValueReference place = which[i] - FIRST_BOOLEAN;
        if (values != count || !within(place, MODEL_BOOLEANS)) {
            return refuse(one, "no such variable of type Boolean");
        }
        value[i] = one->model.boolean[place] != 0;
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetBoolean(fmi3Instance c, const fmi3ValueReference which[], size_t count,
                                 const fmi3Boolean value[], size_t values)
{
    instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        const fmi3ValueReference place = which[i] - FIRST_BOOLEAN;
        if (values != count || !within(place, MODEL_BOOLEANS)) {
            return refuse(one, "no such input of type Boolean");
        }
        one->model.boolean[place] = value[i];
    }
    return fmi3OK;
}

/* There are no variables of the other types. */
#define NO_VARIABLES(type)                                                                                            \
    EXPORT fmi3Status fmi3Get##type(fmi3Instance c, const fmi3ValueReference which[], size_t count,                   \
                                    fmi3##type value[], size_t values)                                                \
    {                                                                                                                 \
        (void)which, (void)value, (void)values;                                                                       \
        return count == 0 ? fmi3OK : refuse(c, "there are no variables of type " #type);                              \
    }                                                                                                                 \
    EXPORT fmi3Status fmi3Set##type(fmi3Instance c, const fmi3ValueReference which[], size_t count,                   \
                                    const fmi3##type value[], size_t values)                                          \
    {                                                                                                                 \
        (void)which, (void)value, (void)values;                                                                       \
        return count == 0 ? fmi3OK : refuse(c, "there are no variables of type " #type);                              \
    }
NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(String)

/* A function that this FMU has no use for: refuses, unless there is nothing to do. */
#define NOTHING(name, arguments, unused, count, text)                                                                 \
    EXPORT fmi3Status name arguments                                                                                  \
    {                                                                                                                 \
        unused;                                                                                                       \
        return (count) == 0 ? fmi3OK : refuse(c, text);                                                               \
    }
#define WHICH fmi3Instance c, const fmi3ValueReference which[], size_t n
NOTHING(fmi3GetBinary, (WHICH, size_t sizes[], fmi3Binary value[], size_t values),
        ((void)which, (void)sizes, (void)value, (void)values), n, "there are no variables of type Binary")
NOTHING(fmi3SetBinary, (WHICH, const size_t sizes[], const fmi3Binary value[], size_t values),
        ((void)which, (void)sizes, (void)value, (void)values), n, "there are no variables of type Binary")
NOTHING(fmi3GetClock, (WHICH, fmi3Clock value[]), ((void)which, (void)value), n, "there are no clocks")
NOTHING(fmi3SetClock, (WHICH, const fmi3Clock value[]), ((void)which, (void)value), n, "there are no clocks")
NOTHING(fmi3GetIntervalDecimal, (WHICH, fmi3Float64 interval[], fmi3IntervalQualifier kind[]),
        ((void)which, (void)interval, (void)kind), n, "there are no clocks")
NOTHING(fmi3GetIntervalFraction, (WHICH, fmi3UInt64 top[], fmi3UInt64 bottom[], fmi3IntervalQualifier kind[]),
        ((void)which, (void)top, (void)bottom, (void)kind), n, "there are no clocks")
NOTHING(fmi3GetShiftDecimal, (WHICH, fmi3Float64 shift[]), ((void)which, (void)shift), n, "there are no clocks")
NOTHING(fmi3GetShiftFraction, (WHICH, fmi3UInt64 top[], fmi3UInt64 bottom[]),
        ((void)which, (void)top, (void)bottom), n, "there are no clocks")
NOTHING(fmi3SetIntervalDecimal, (WHICH, const fmi3Float64 interval[]), ((void)which, (void)interval), n,
        "there are no clocks")
NOTHING(fmi3SetIntervalFraction, (WHICH, const fmi3UInt64 top[], const fmi3UInt64 bottom[]),
        ((void)which, (void)top, (void)bottom), n, "there are no clocks")
NOTHING(fmi3SetShiftDecimal, (WHICH, const fmi3Float64 shift[]), ((void)which, (void)shift), n, "there are no clocks")
NOTHING(fmi3SetShiftFraction, (WHICH, const fmi3UInt64 top[], const fmi3UInt64 bottom[]),
        ((void)which, (void)top, (void)bottom), n, "there are no clocks")
NOTHING(fmi3GetOutputDerivatives,
        (WHICH, const fmi3Int32 order[], fmi3Float64 value[], size_t values),
        ((void)which, (void)order, (void)value, (void)values), n, "outputs have no derivatives")
NOTHING(fmi3GetDirectionalDerivative,
        (WHICH, const fmi3ValueReference by[], size_t inputs, const fmi3Float64 seed[], size_t seeds,
         fmi3Float64 value[], size_t values),
        ((void)which, (void)by, (void)inputs, (void)seed, (void)seeds, (void)value, (void)values), n,
        "there are no derivatives")
NOTHING(fmi3GetAdjointDerivative,
        (WHICH, const fmi3ValueReference by[], size_t inputs, const fmi3Float64 seed[], size_t seeds,
         fmi3Float64 value[], size_t values),
        ((void)which, (void)by, (void)inputs, (void)seed, (void)seeds, (void)value, (void)values), n,
        "there are no derivatives")
NOTHING(fmi3GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference which, size_t *count),
        ((void)which, (void)count), 1, "dependencies stand in modelDescription.xml")
NOTHING(fmi3GetVariableDependencies,
        (fmi3Instance c, fmi3ValueReference which, size_t element[], fmi3ValueReference by[], size_t by_element[],
         fmi3DependencyKind kind[], size_t count),
        ((void)which, (void)element, (void)by, (void)by_element, (void)kind, (void)count), 1,
        "dependencies stand in modelDescription.xml")
NOTHING(fmi3SerializedFMUStateSize, (fmi3Instance c, fmi3FMUState state, size_t *size), ((void)state, (void)size), 1,
        "states are not serialised")
NOTHING(fmi3SerializeFMUState, (fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size),
        ((void)state, (void)bytes, (void)size), 1, "states are not serialised")
NOTHING(fmi3DeserializeFMUState, (fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state),
        ((void)bytes, (void)size, (void)state), 1, "states are not serialised")
NOTHING(fmi3EnterConfigurationMode, (fmi3Instance c), (void)0, 1, "there are no structural parameters")
NOTHING(fmi3ExitConfigurationMode, (fmi3Instance c), (void)0, 1, "there are no structural parameters")
NOTHING(fmi3EnterEventMode, (fmi3Instance c), (void)0, 1, "there are no events")
NOTHING(fmi3EvaluateDiscreteStates, (fmi3Instance c), (void)0, 1, "there are no events")
NOTHING(fmi3UpdateDiscreteStates,
        (fmi3Instance c, fmi3Boolean *again, fmi3Boolean *ends, fmi3Boolean *nominals, fmi3Boolean *values,
         fmi3Boolean *timed, fmi3Float64 *next),
        ((void)again, (void)ends, (void)nominals, (void)values, (void)timed, (void)next), 1, "there are no events")
NOTHING(fmi3ActivateModelPartition, (fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time),
        ((void)clock, (void)time), 1, "there are no clocks")

/* Of model exchange, which some masters look for. */
NOTHING(fmi3EnterContinuousTimeMode, (fmi3Instance c), (void)0, 1, "this FMU is for co-simulation")
NOTHING(fmi3CompletedIntegratorStep, (fmi3Instance c, fmi3Boolean final, fmi3Boolean *has_event, fmi3Boolean *ends),
        ((void)final, (void)has_event, (void)ends), 1, "this FMU is for co-simulation")
NOTHING(fmi3SetTime, (fmi3Instance c, fmi3Float64 time), (void)time, 1, "this FMU is for co-simulation")
NOTHING(fmi3SetContinuousStates, (fmi3Instance c, const fmi3Float64 value[], size_t n), (void)value, n,
        "this FMU is for co-simulation")
NOTHING(fmi3GetContinuousStates, (fmi3Instance c, fmi3Float64 value[], size_t n), (void)value, n,
        "this FMU is for co-simulation")
NOTHING(fmi3GetNominalsOfContinuousStates, (fmi3Instance c, fmi3Float64 value[], size_t n), (void)value, n,
        "this FMU is for co-simulation")
NOTHING(fmi3GetContinuousStateDerivatives, (fmi3Instance c, fmi3Float64 value[], size_t n), (void)value, n,
        "this FMU is for co-simulation")
NOTHING(fmi3GetEventIndicators, (fmi3Instance c, fmi3Float64 value[], size_t n), (void)value, n,
        "this FMU is for co-simulation")
NOTHING(fmi3GetNumberOfContinuousStates, (fmi3Instance c, size_t *count), *count = 0, 0, "")
NOTHING(fmi3GetNumberOfEventIndicators, (fmi3Instance c, size_t *count), *count = 0, 0, "")

/* States of the whole instance ----------------------------------------------------------------------------- */
EXPORT fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    const instance *one = c;
    if (*state == NULL) {
        *state = calloc(1, sizeof *one);
    }
    if (*state == NULL) {
        return refuse(one, "no memory");
    }
    memcpy(*state, one, sizeof *one);
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    if (state == NULL) {
        return refuse(c, "no state");
    }
    memcpy(c, state, sizeof(instance));
    return fmi3OK;
}

EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

/* Time ------------------------------------------------------------------------------------------------------ */
EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance c) { return refuse(c, "there are no events to return from"); }

EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 now, fmi3Float64 step, fmi3Boolean final,
                             fmi3Boolean *has_event, fmi3Boolean *ends, fmi3Boolean *returned_early,
                             fmi3Float64 *reached)
{
    instance *one = c;
    const double periods = step / MODEL_PERIOD;
    const double whole = floor(periods + 0.5);
    (void)final;
    *has_event = false;
    *ends = false;
    *returned_early = false;
    *reached = one->time;
    if (!(whole >= 1.0 && whole <= 1e9 && fabs(periods - whole) <= 1e-6)) {
        return refuse(one, "the communication step is no whole multiple of " MODEL_PERIOD_TEXT " s");
    }
    for (long k = 0; k < (long)whole; ++k) {
        if (!model_step(&one->model)) {
            return refuse(one, "a number is no longer finite");
        }
    }
    one->time = now + step;
    *reached = one->time;
    return fmi3OK;
}
