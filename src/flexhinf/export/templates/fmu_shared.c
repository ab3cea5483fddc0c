/* What versions of the standard share ------------------------------------------------------------------------ */

/* Why there is no instance, or NULL; one that is made is at its start. */
static const char *reason_against(instance *one, const char *guid)
{
    if (guid == NULL || strcmp(guid, MODEL_GUID) != 0) {
        return "another @{"GUID" if v == 2 else "instantiation token"}";
    }
    if (one == NULL) {
        return "no memory";
    }
    if (model_refuses(&one->model)) {
        return "compiled with flags that change results";
    }
    one->time = 0.0;
    one->starting = 0;
    model_reset(&one->model);
    return NULL;
}

EXPORT fmi@{v}Status fmi@{v}ExitInitializationMode(fmi@{v}@{"Component" if v == 2 else "Instance"} c)
{
    ((instance *)c)->starting = 0;
    model_begin(&((instance *)c)->model);
    return fmi@{v}OK;
}

EXPORT fmi@{v}Status fmi@{v}Terminate(fmi@{v}@{"Component" if v == 2 else "Instance"} c)
{
    (void)c;
    return fmi@{v}OK;
}

EXPORT fmi@{v}Status fmi@{v}Reset(fmi@{v}@{"Component" if v == 2 else "Instance"} c)
{
    ((instance *)c)->time = 0.0;
    ((instance *)c)->starting = 0;
    model_reset(&((instance *)c)->model);
    return fmi@{v}OK;
}

/* Whether a place is among the first ones; of a model, there may be none. */
static int within(fmi@{v}ValueReference place, fmi@{v}ValueReference count) { return place < count; }

/* Functions that get and set the variables of a type. `first`: reference of the first one; the place of a smaller
 * reference is a large number. `good`: whether there is a variable at a place. `number`: the number that stands there. */
#define GETTER(type, first, good, number)                                                                             \
    EXPORT fmi@{v}Status fmi@{v}Get##type(fmi@{v}@{"Component" if v == 2 else "Instance"} c, const fmi@{v}ValueReference which[], size_t count,         \
                                        fmi@{v}##type value[]{% if v == 3 %}, size_t values{% endif %})                                                 \
    {                                                                                                                 \
        instance *one = c;                                                                                            \
        if (one->starting) {                                                                                          \
            model_begin(&one->model);                                                                                 \
        }                                                                                                             \
        for (size_t i = 0; i < count; ++i) {                                                                          \
            const fmi@{v}ValueReference place = which[i] - (first);                                                    \
            if ({% if v == 3 %}values != count || {% endif %}!(good)) {                                                                               \
                return refuse(one, "no such variable of type " #type);                                                \
            }                                                                                                         \
            value[i] = (number);                                                                                      \
        }                                                                                                             \
        return fmi@{v}OK;                                                                                              \
    }
#define SETTER(type, first, good, set)                                                                                \
    EXPORT fmi@{v}Status fmi@{v}Set##type(fmi@{v}@{"Component" if v == 2 else "Instance"} c, const fmi@{v}ValueReference which[], size_t count,         \
                                        const fmi@{v}##type value[]{% if v == 3 %}, size_t values{% endif %})                                           \
    {                                                                                                                 \
        instance *one = c;                                                                                            \
        for (size_t i = 0; i < count; ++i) {                                                                          \
            const fmi@{v}ValueReference place = which[i] - (first);                                                    \
            if ({% if v == 3 %}values != count || {% endif %}!(good)) {                                                                               \
                return refuse(one, "no such input or parameter of type " #type);                                      \
            }                                                                                                         \
            set;                                                                                                      \
        }                                                                                                             \
        return fmi@{v}OK;                                                                                              \
    }

EXPORT fmi@{v}Status fmi@{v}Get@{"FMUstate" if v == 2 else "FMUState"}(fmi@{v}@{"Component" if v == 2 else "Instance"} c, fmi@{v}@{"FMUstate" if v == 2 else "FMUState"} *state)
{
    const instance *one = c;
    if (*state == NULL) {
        *state = ALLOCATE(one);
    }
    if (*state == NULL) {
        return refuse(one, "no memory");
    }
    memcpy(*state, one, sizeof *one);
    return fmi@{v}OK;
}

EXPORT fmi@{v}Status fmi@{v}Set@{"FMUstate" if v == 2 else "FMUState"}(fmi@{v}@{"Component" if v == 2 else "Instance"} c, fmi@{v}@{"FMUstate" if v == 2 else "FMUState"} state)
{
    if (state == NULL) {
        return refuse(c, "no state");
    }
    memcpy(c, state, sizeof(instance));
    return fmi@{v}OK;
}

EXPORT fmi@{v}Status fmi@{v}Free@{"FMUstate" if v == 2 else "FMUState"}(fmi@{v}@{"Component" if v == 2 else "Instance"} c, fmi@{v}@{"FMUstate" if v == 2 else "FMUState"} *state)
{
    if (*state != NULL) {
        RELEASE((instance *)c, *state);
        *state = NULL;
    }
    return fmi@{v}OK;
}

static fmi@{v}Status advance(instance *one, double now, double step)
{
    const double periods = step / MODEL_PERIOD;
    const double whole = floor(periods + 0.5);
    if (!(whole >= 1.0 && whole <= 1e9 && fabs(periods - whole) <= 1e-6)) {
        return refuse(one, "the communication step is no whole multiple of " MODEL_PERIOD_TEXT " s");
    }
    for (long k = 0; k < (long)whole; ++k) {
        if (!model_step(&one->model)) {
            return refuse(one, "a number is no longer finite");
        }
    }
    one->time = now + step;
    return fmi@{v}OK;
}
