/* @NAME@ as a co-simulation FMU of FMI 2.0, made by flexhinf @VERSION@. All that is remembered is in the instance. */
#include "@NAME@_fmi2.h"
#include "@NAME@_model.h"

#include <math.h>
#include <string.h>

typedef struct {
    model_instance model;
    fmi2CallbackFunctions call;
    char name[128];
    double time;
    int logs, starting; /* starting: what is set changes outputs at once, until the initialisation ends */
} instance;

static fmi2Status refuse(const instance *one, const char *text)
{
    if (one != NULL && one->call.logger != NULL) {
        one->call.logger(one->call.componentEnvironment, one->name, fmi2Error, "logStatusError", text);
    }
    return fmi2Error;
}

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
    (void)resources;
    (void)visible;
    if (call == NULL || call->allocateMemory == NULL || call->freeMemory == NULL || type != fmi2CoSimulation) {
        return NULL;
    }
    if (guid == NULL || strcmp(guid, MODEL_GUID) != 0) {
        if (call->logger != NULL) {
            call->logger(call->componentEnvironment, name, fmi2Error, "logStatusError", "another GUID");
        }
        return NULL;
    }
    one = call->allocateMemory(1, sizeof *one);
    if (one == NULL) {
        return NULL;
    }
    if (model_refuses(&one->model)) {
        if (call->logger != NULL) {
            call->logger(call->componentEnvironment, name, fmi2Error, "logStatusError",
                         "compiled with flags that change results");
        }
        call->freeMemory(one);
        return NULL;
    }
    one->call = *call;
    one->logs = logging;
    strncpy(one->name, name != NULL ? name : MODEL_NAME, sizeof one->name - 1);
    one->name[sizeof one->name - 1] = '\0';
    one->time = 0.0;
    one->starting = 0;
    model_reset(&one->model);
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

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    ((instance *)c)->starting = 0;
    model_begin(&((instance *)c)->model);
    return fmi2OK;
}

EXPORT fmi2Status fmi2Terminate(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

EXPORT fmi2Status fmi2Reset(fmi2Component c)
{
    ((instance *)c)->time = 0.0;
    ((instance *)c)->starting = 0;
    model_reset(&((instance *)c)->model);
    return fmi2OK;
}

/* Whether a reference is among the first ones; of a model, there may be none. */
static int within(fmi2ValueReference which, fmi2ValueReference count) { return which < count; }

/* Variables ---------------------------------------------------------------------------------------------- */
EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference which[], size_t count, fmi2Real value[])
{
    instance *one = c;
    if (one->starting) {
        model_begin(&one->model);
    }
    for (size_t i = 0; i < count; ++i) {
        if (which[i] >= MODEL_REALS) {
            return refuse(one, "no such real variable");
        }
        value[i] = one->model.real[which[i]];
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference which[], size_t count, const fmi2Real value[])
{
    instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        if (which[i] >= MODEL_SETTABLE) {
            return refuse(one, "no such real input or parameter");
        }
        one->model.real[which[i]] = value[i];
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference which[], size_t count, fmi2Integer value[])
{
    const instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        if (!within(which[i], MODEL_INTEGERS)) {
            return refuse(one, "no such integer variable");
        }
        value[i] = one->model.integer[which[i]];
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference which[], size_t count,
                                 const fmi2Integer value[])
{
    instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        if (!within(which[i], MODEL_SETTABLE_INTEGERS)) {
            return refuse(one, "no such integer input or parameter");
        }
        one->model.integer[which[i]] = value[i];
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference which[], size_t count, fmi2Boolean value[])
{
    const instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        if (!within(which[i], MODEL_BOOLEANS)) {
            return refuse(one, "no such boolean variable");
        }
        value[i] = one->model.boolean[which[i]];
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference which[], size_t count,
                                 const fmi2Boolean value[])
{
    instance *one = c;
    for (size_t i = 0; i < count; ++i) {
        if (!within(which[i], MODEL_BOOLEANS)) {
            return refuse(one, "no such boolean variable");
        }
        one->model.boolean[which[i]] = value[i] != 0;
    }
    return fmi2OK;
}

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

/* States of the whole instance ----------------------------------------------------------------------------- */
EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    instance *one = c;
    if (*state == NULL) {
        *state = one->call.allocateMemory(1, sizeof *one);
    }
    if (*state == NULL) {
        return refuse(one, "no memory");
    }
    memcpy(*state, one, sizeof *one);
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    if (state == NULL) {
        return refuse(c, "no state");
    }
    memcpy(c, state, sizeof(instance));
    return fmi2OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (*state != NULL) {
        ((instance *)c)->call.freeMemory(*state);
        *state = NULL;
    }
    return fmi2OK;
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
    instance *one = c;
    const double periods = step / MODEL_PERIOD;
    const double whole = floor(periods + 0.5);
    (void)final;
    if (!(whole >= 1.0 && whole <= 1e9 && fabs(periods - whole) <= 1e-6)) {
        return refuse(one, "the communication step is no whole multiple of " MODEL_PERIOD_TEXT " s");
    }
    for (long k = 0; k < (long)whole; ++k) {
        if (!model_step(&one->model)) {
            return refuse(one, "a number is no longer finite");
        }
    }
    one->time = now + step;
    return fmi2OK;
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
