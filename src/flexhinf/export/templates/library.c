/* What `flexhinf.load_compiled` reads and calls of @NAME@. */
#include "@NAME@.h"
#include <stddef.h>
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
/* What is read in the file, before any of it is run: the instructions that the compiler may have used, and what it is. */
EXPORT const char flexhinf_manifest[] =
    "@MARK@"
@INSTRUCTIONS@
    "\n" @DESCRIPTION@;
EXPORT size_t flexhinf_state_size(void) { return sizeof(@NAME@_state); }
EXPORT int flexhinf_fused(void) { return @NAME@_fused; }
EXPORT int flexhinf_start(void *state, const double *estimate, const double *input)
{
    return @NAME@_start(state, &@NAME@_defaults, estimate, input);
}
/* One sample. Then r is the command that holds: of a refused one the last good one, after going back the older one. */
EXPORT int flexhinf_step(void *state, const double *y, double *r, int measured, double *u, double *estimate)
{
    const @NAME@_state *after = state;
    @NAME@_input input = {0};
    @NAME@_output output;
    int code;
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        input.y[i] = y[i];
    }
    for (int i = 0; i < @BIG@_COMMANDS; ++i) {
        input.r[i] = r[i];
    }
    input.measured = measured;
    code = @NAME@_step(state, &@NAME@_defaults, &input, &output);
    for (int i = 0; i < @BIG@_COMMANDS; ++i) {
        r[i] = after->memory[@REFERENCE@ + i];
    }
    for (int i = 0; i < @BIG@_INPUTS; ++i) {
        u[i] = output.u[i];
    }
    for (int i = 0; i < @BIG@_STATES; ++i) {
        estimate[i] = output.estimate[i];
    }
    return code;
}
