/* What versions of the standard share ------------------------------------------------------------------------ */

/* Why there is no instance, or NULL; one that is made is at its start. */
static const char *reason_against(instance *one, const char *guid)
{
    if (guid == NULL || strcmp(guid, MODEL_GUID) != 0) {
        return "another @TOKEN@";
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

EXPORT fmi@V@Status fmi@V@ExitInitializationMode(fmi@V@@INSTANCE@ c)
{
    ((instance *)c)->starting = 0;
    model_begin(&((instance *)c)->model);
    return fmi@V@OK;
}

EXPORT fmi@V@Status fmi@V@Terminate(fmi@V@@INSTANCE@ c)
{
    (void)c;
    return fmi@V@OK;
}

EXPORT fmi@V@Status fmi@V@Reset(fmi@V@@INSTANCE@ c)
{
    ((instance *)c)->time = 0.0;
    ((instance *)c)->starting = 0;
    model_reset(&((instance *)c)->model);
    return fmi@V@OK;
}

/* Whether a place is among the first ones; of a model, there may be none. */
static int within(fmi@V@ValueReference place, fmi@V@ValueReference count) { return place < count; }

/* Functions that get and set the variables of a type. `first`: reference of the first one; the place of a smaller
 * reference is a large number. `good`: whether there is a variable at a place. `number`: the number that stands there. */
#define GETTER(type, first, good, number)                                                                             \
    EXPORT fmi@V@Status fmi@V@Get##type(fmi@V@@INSTANCE@ c, const fmi@V@ValueReference which[], size_t count,         \
                                        fmi@V@##type value[]@VALUES@)                                                 \
    {                                                                                                                 \
        instance *one = c;                                                                                            \
        if (one->starting) {                                                                                          \
            model_begin(&one->model);                                                                                 \
        }                                                                                                             \
        for (size_t i = 0; i < count; ++i) {                                                                          \
            const fmi@V@ValueReference place = which[i] - (first);                                                    \
            if (@OTHER_COUNT@!(good)) {                                                                               \
                return refuse(one, "no such variable of type " #type);                                                \
            }                                                                                                         \
            value[i] = (number);                                                                                      \
        }                                                                                                             \
        return fmi@V@OK;                                                                                              \
    }
#define SETTER(type, first, good, set)                                                                                \
    EXPORT fmi@V@Status fmi@V@Set##type(fmi@V@@INSTANCE@ c, const fmi@V@ValueReference which[], size_t count,         \
                                        const fmi@V@##type value[]@VALUES@)                                           \
    {                                                                                                                 \
        instance *one = c;                                                                                            \
        for (size_t i = 0; i < count; ++i) {                                                                          \
            const fmi@V@ValueReference place = which[i] - (first);                                                    \
            if (@OTHER_COUNT@!(good)) {                                                                               \
                return refuse(one, "no such input or parameter of type " #type);                                      \
            }                                                                                                         \
            set;                                                                                                      \
        }                                                                                                             \
        return fmi@V@OK;                                                                                              \
    }

EXPORT fmi@V@Status fmi@V@Get@STATE@(fmi@V@@INSTANCE@ c, fmi@V@@STATE@ *state)
{
    const instance *one = c;
    if (*state == NULL) {
        *state = ALLOCATE(one);
    }
    if (*state == NULL) {
        return refuse(one, "no memory");
    }
    memcpy(*state, one, sizeof *one);
    return fmi@V@OK;
}

EXPORT fmi@V@Status fmi@V@Set@STATE@(fmi@V@@INSTANCE@ c, fmi@V@@STATE@ state)
{
    if (state == NULL) {
        return refuse(c, "no state");
    }
    memcpy(c, state, sizeof(instance));
    return fmi@V@OK;
}

EXPORT fmi@V@Status fmi@V@Free@STATE@(fmi@V@@INSTANCE@ c, fmi@V@@STATE@ *state)
{
    if (*state != NULL) {
        RELEASE((instance *)c, *state);
        *state = NULL;
    }
    return fmi@V@OK;
}

static fmi@V@Status advance(instance *one, double now, double step)
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
    return fmi@V@OK;
}
