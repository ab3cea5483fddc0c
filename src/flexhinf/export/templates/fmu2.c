/* @{name} as a co-simulation FMU of FMI 2.0, made by flexhinf @{version}. All that is remembered is in the instance. */
#include "@{name}_fmi2.h"
#include "@{name}_model.h"

#include <math.h>
#include <string.h>

typedef struct {
    model_instance model;
    fmi2CallbackFunctions call;
    char name[128];
    double time;
    int logs, starting; /* starting: what is set changes outputs at once, until the initialisation ends */
} instance;

#define ALLOCATE(one) (one)->call.allocateMemory(1, sizeof(instance))
#define RELEASE(one, place) (one)->call.freeMemory(place)

static fmi2Status refuse(const instance *one, const char *text)
{
    if (one != NULL && one->call.logger != NULL) {
        one->call.logger(one->call.componentEnvironment, one->name, fmi2Error, "logStatusError", text);
    }
    return fmi2Error;
}

{% include "fmu_shared.c" %}

/* Set-up ------------------------------------------------------------------------------------------------- */
EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String names[])
{
    (void)count;
    (void)names;
    ((instance *)c)->logs = on;
    return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                     const fmi2CallbackFunctions *call, fmi2Boolean visible, fmi2Boolean logging)
{
    instance *one;
    const char *against;
    (void)resources;
    (void)visible;
    if (call == NULL || call->allocateMemory == NULL || call->freeMemory == NULL || type != fmi2CoSimulation) {
        return NULL;
    }
    one = call->allocateMemory(1, sizeof *one);
    against = reason_against(one, guid);
    if (against != NULL) {
        if (call->logger != NULL) {
            call->logger(call->componentEnvironment, name, fmi2Error, "logStatusError", against);
        }
        if (one != NULL) {
            call->freeMemory(one);
        }
        return NULL;
    }
    one->call = *call;
    one->logs = logging;
    strncpy(one->name, name != NULL ? name : MODEL_NAME, sizeof one->name - 1);
    one->name[sizeof one->name - 1] = '\0';
    return one;
}

EXPORT void fmi2FreeInstance(fmi2Component c)
{
    if (c != NULL) {
        ((instance *)c)->call.freeMemory(c);
    }
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start,
                                      fmi2Boolean stops, fmi2Real stop)
{
    (void)tolerant;
    (void)tolerance;
    (void)stops;
    (void)stop;
    ((instance *)c)->time = start;
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    ((instance *)c)->starting = 1;
    return fmi2OK;
}

/* Variables: references of each type count from zero ----------------------------------------------------------- */
GETTER(Real, 0U, within(place, MODEL_REALS), one->model.real[place])
SETTER(Real, 0U, within(place, MODEL_SETTABLE), one->model.real[place] = value[i])
GETTER(Integer, 0U, within(place, MODEL_INTEGERS), one->model.integer[place])
SETTER(Integer, 0U, within(place, MODEL_SETTABLE_INTEGERS), one->model.integer[place] = value[i])
GETTER(Boolean, 0U, within(place, MODEL_BOOLEANS), one->model.boolean[place])
SETTER(Boolean, 0U, within(place, MODEL_SETTABLE_BOOLEANS), one->model.boolean[place] = value[i] != 0)

EXPORT fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference which[], size_t count, fmi2String value[])
{
    (void)which;
    (void)value;
    return count == 0 ? fmi2OK : refuse(c, "there are no strings");
}

EXPORT fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference which[], size_t count,
                                const fmi2String value[])
{
    (void)which;
    (void)value;
    return count == 0 ? fmi2OK : refuse(c, "there are no strings");
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)state;
    (void)size;
    return refuse(c, "states are not serialised");
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    (void)state;
    (void)bytes;
    (void)size;
    return refuse(c, "states are not serialised");
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    (void)bytes;
    (void)size;
    (void)state;
    return refuse(c, "states are not serialised");
}

EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference of[], size_t outputs,
                                               const fmi2ValueReference by[], size_t inputs, const fmi2Real along[],
                                               fmi2Real value[])
{
    (void)of;
    (void)outputs;
    (void)by;
    (void)inputs;
    (void)along;
    (void)value;
    return refuse(c, "there are no derivatives");
}

EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference which[], size_t count,
                                              const fmi2Integer order[], const fmi2Real value[])
{
    (void)which;
    (void)count;
    (void)order;
    (void)value;
    return refuse(c, "inputs are held over a step");
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference which[], size_t count,
                                               const fmi2Integer order[], fmi2Real value[])
{
    (void)which;
    (void)count;
    (void)order;
    (void)value;
    return refuse(c, "outputs have no derivatives");
}

/* Time ------------------------------------------------------------------------------------------------------ */
EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean final)
{
    (void)final;
    return advance(c, now, step);
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refuse(c, "no step is pending");
}

EXPORT fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind;
    (void)value;
    return refuse(c, "no step is pending");
}

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind == fmi2LastSuccessfulTime) {
        *value = ((instance *)c)->time;
        return fmi2OK;
    }
    return refuse(c, "no such status");
}

EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind;
    (void)value;
    return refuse(c, "no such status");
}

EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (kind == fmi2Terminated) {
        *value = 0;
        return fmi2OK;
    }
    return refuse(c, "no such status");
}

EXPORT fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind;
    (void)value;
    return refuse(c, "no such status");
}
