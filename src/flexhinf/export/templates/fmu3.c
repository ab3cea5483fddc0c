/* @{name} as a co-simulation FMU of FMI 3.0, made by flexhinf @{version}. All that is remembered is in the instance. */
#include "@{name}_fmi3.h"
#include "@{name}_model.h"

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

#define ALLOCATE(one) ((void)(one), calloc(1, sizeof(instance)))
#define RELEASE(one, place) ((void)(one), free(place))

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

{% include "fmu_shared.c" %}

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
    const char *against;
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
    one = calloc(1, sizeof *one);
    against = reason_against(one, token);
    if (against != NULL) {
        report(log, environment, against);
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

/* Variables: references of the types follow each other -------------------------------------------------------- */
GETTER(Float64, 0U, within(place, MODEL_REALS) || place == TIME, place == TIME ? one->time : one->model.real[place])
SETTER(Float64, 0U, within(place, MODEL_SETTABLE), one->model.real[place] = value[i])
GETTER(Int32, FIRST_INTEGER, within(place, MODEL_INTEGERS), one->model.integer[place])
SETTER(Int32, FIRST_INTEGER, within(place, MODEL_SETTABLE_INTEGERS), one->model.integer[place] = value[i])
GETTER(Boolean, FIRST_BOOLEAN, within(place, MODEL_BOOLEANS), one->model.boolean[place] != 0)
SETTER(Boolean, FIRST_BOOLEAN, within(place, MODEL_SETTABLE_BOOLEANS), one->model.boolean[place] = value[i])

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

/* Time ------------------------------------------------------------------------------------------------------ */
EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance c) { return refuse(c, "there are no events to return from"); }

EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 now, fmi3Float64 step, fmi3Boolean final,
                             fmi3Boolean *has_event, fmi3Boolean *ends, fmi3Boolean *returned_early,
                             fmi3Float64 *reached)
{
    instance *one = c;
    const fmi3Status status = advance(one, now, step);
    (void)final;
    *has_event = false;
    *ends = false;
    *returned_early = false;
    *reached = one->time;
    return status;
}
