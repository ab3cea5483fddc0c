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
EXPORT int flexhinf_step(void *state, const double *y, double *r, double elapsed, int measured, double *u, double *estimate)
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
