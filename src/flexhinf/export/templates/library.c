/* What `flexhinf.load_compiled` reads and calls of @{name}. */
#include "@{name}.h"
#include <stddef.h>
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
/* What is read in the file, before any of it is run: the instructions that the compiler may have used, and what it is. */
EXPORT const char flexhinf_manifest[] =
    "@{mark}"
{% for macro, set in instructions %}
#ifdef @{macro}
    " @{set}"
#endif
{% endfor %}
    "\n" @{description | c_string};
EXPORT size_t flexhinf_state_size(void) { return sizeof(@{name}_state); }
EXPORT int flexhinf_fused(void) { return @{name}_fused; }
EXPORT int flexhinf_start(void *state, const double *estimate, const double *input)
{
    return @{name}_start(state, &@{name}_defaults, estimate, input);
}
/* One sample. Then r is the command that holds: of a refused one the last good one, after going back the older one. */
EXPORT int flexhinf_step(void *state, const double *y, const int *fresh, double *r, double elapsed, int measured, double *u,
                         double *estimate)
{
    const @{name}_state *after = state;
    @{name}_input input = {0};
    @{name}_output output;
    int code;
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.y[i] = y[i];
    }
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        input.r[i] = r[i];
    }
{% if c.mode.checks_measurements %}
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.fresh[i] = fresh[i];
    }
{% else %}
    (void)fresh;
{% endif %}
    input.elapsed = elapsed;
    input.measured = measured;
    code = @{name}_step(state, &@{name}_defaults, &input, &output);
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        r[i] = after->memory[@{c.memory.places["reference"].start} + i];
    }
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        u[i] = output.u[i];
    }
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        estimate[i] = output.estimate[i];
    }
    return code;
}
/* Whether the drives may have power after a step with this code, and why not (stop); u is what acts. */
EXPORT int flexhinf_may_act(void *state, int code, double *u, int *stop)
{
    @{name}_output output = {0};
    int power;
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        output.u[i] = u[i];
    }
    power = @{name}_may_act(state, &@{name}_defaults, code, &output);
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        u[i] = output.u[i];
    }
    *stop = output.stop;
    return power;
}
/* Whether the robot rests where it can be started, by one reading after the other; why not in why. */
EXPORT int flexhinf_at_rest(void *state, const double *y, int *why)
{
    @{name}_input input = {0};
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.y[i] = y[i];
    }
    input.measured = 1;
    return @{name}_at_rest(state, &@{name}_defaults, &input, why);
}
