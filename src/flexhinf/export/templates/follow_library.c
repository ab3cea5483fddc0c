/* What `CompiledFollower` calls of @{name}_follow. */
#include "@{name}_follow.h"
#include <stddef.h>
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
typedef @{name}_real real;
typedef struct { @{name}_follow_state state; @{name}_follow_options options; } follower;
enum { N = @{NAME}_FOLLOW_JOINTS };
static void tolerances_of(@{name}_follow_tolerance *one, const real *numbers)
{
    for (int j = 0; j < N; ++j) {
        one->position[j] = numbers[j];
        one->velocity[j] = numbers[N + j];
    }
}
EXPORT size_t follow_size(void) { return sizeof(follower); }
EXPORT size_t follow_point_size(void) { return sizeof(@{name}_follow_point); }
EXPORT int follow_waits(const follower *one) { return one->state.has_next; }
EXPORT int follow_reset(follower *one, const real *q, const real *numbers, int partial, int limited)
{
    tolerances_of(&one->options.path, numbers);
    tolerances_of(&one->options.goal, numbers + 2 * N);
    one->options.goal_time = numbers[4 * N];
    one->options.timeout = numbers[4 * N + 1];
    one->options.stop_time = numbers[4 * N + 2];
    one->options.partial = partial;
{% if limited %}
    one->options.limited = limited;
{% else %}
    (void)limited;
{% endif %}
    return @{name}_follow_init(&one->state, q);
}
/* The points stay where they are while they are followed: the caller keeps them. */
EXPORT int follow_start(follower *one, const void *points, int count, const int *moves, const real *numbers, int starts)
{
    @{name}_follow_goal goal = {0};
    int result;
    goal.points = points;
    goal.count = count;
    for (int j = 0; j < N; ++j) {
        goal.moves[j] = moves[j];
    }
    tolerances_of(&goal.path, numbers);
    tolerances_of(&goal.goal, numbers + 2 * N);
    goal.begins = numbers[4 * N];
    goal.goal_time = numbers[4 * N + 1];
    result = @{name}_follow_check(&one->options, &goal);
    if (result == @{NAME}_FOLLOW_SUCCESSFUL && starts != 0) {
        result = @{name}_follow_start(&one->state, &one->options, &goal);
    }
    return result;
}
EXPORT void follow_cancel(follower *one) { @{name}_follow_cancel(&one->state, &one->options); }
EXPORT int follow_step(follower *one, const real *estimate, const real *rates, real *row, real *desired)
{
    @{name}_follow_input input = {0};
    @{name}_follow_output output;
    int result;
    for (int j = 0; j < N; ++j) {
        input.position[j] = estimate[j];
        input.velocity[j] = estimate[N + j];
    }
    input.speed = rates[0];
    input.path_rate = rates[1];
    result = @{name}_follow_step(&one->state, &one->options, &@{name}_defaults, &input, &output);
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        row[i] = output.r[i];
    }
    for (int j = 0; j < N; ++j) {
        desired[j] = output.position[j];
        desired[N + j] = output.velocity[j];
    }
    return result;
}
EXPORT int follow_row(const real *before, const real *r)
{
    return @{name}_follow_row(&@{name}_defaults, before, r);
}
