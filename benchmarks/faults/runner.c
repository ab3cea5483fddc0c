/* Runs an exported controller on an arm with faults: each line of the standard input is a run, `key=value` with spaces
 * between; each line of the output is what was found, in JSON. `runner TRACE.csv` keeps the samples of the last run. */
#include "bench.h"
#include "decide.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Random numbers: SplitMix64 [Steele, Lea, Flood, OOPSLA 2014]; normal ones by Box and Muller. */
double uniform(bench *b, int stream)
{
    unsigned long long z = b->random[stream] += 0x9E3779B97F4A7C15ULL;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0;
}

double normal(bench *b, int stream)
{
    const double r = uniform(b, stream);
    return sqrt(-2.0 * log(1.0 - r)) * cos(6.283185307179586 * uniform(b, stream));
}

static bench here; /* too large for most stacks */

static double of_robot(void) { return uniform(&here, OF_ROBOT); }

/* Signals --------------------------------------------------------------------------------------------------------- */
static void measure(bench *b)
{
    double torque[MOST];
    plant_springs(&b->arm, torque);
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) {
        const sensor *s = &SENSORS[i];
        const int j = s->joint;
        const double values[] = {b->arm.q[j], b->arm.theta[j], torque[j], b->arm.theta[j] - b->arm.q[j], b->arm.v[j], b->arm.w[j]};
        double y = values[s->kind] + s->noise * normal(b, OF_NOISE);
        if (s->step > 0.0) { y = s->step * floor(y / s->step + 0.5); }
        b->y[b->k % HISTORY][i] = y;
    }
}

static void keep_input(bench *b, int late)
{
    for (int i = 0; i < NOMINAL.n; ++i) { b->queue[late][i] = (double)b->output.u[i]; }
}

/* The start ------------------------------------------------------------------------------------------------------- */
/* Where the links are measured, all of them: the controller begins at rest there, as in main.c; else at home. */
static int measured_links(const bench *b, double *q)
{
    int seen = 0;
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) {
        if (SENSORS[i].kind == LINK_POSITION) {
            q[SENSORS[i].joint] = b->given[i];
            ++seen;
        }
    }
    return seen == NOMINAL.n;
}

static int has_links(void)
{
    int seen = 0;
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) { seen += SENSORS[i].kind == LINK_POSITION; }
    return seen == NOMINAL.n;
}

static void start_controller(bench *b)
{
    arm_real rest[ARM_STATES + ARM_INPUTS + ARM_COMMANDS];
    double q[MOST];
    memcpy(q, HOME, sizeof(double) * (unsigned)NOMINAL.n);
    (void)measured_links(b, q);
    for (int i = 0; i < NOMINAL.n; ++i) { rest[i] = (arm_real)q[i]; }
    if (arm_rest(&arm_defaults, rest, rest) != ARM_OK ||
        arm_start(&b->controller, &arm_defaults, rest, rest + ARM_STATES) != ARM_OK) {
        fprintf(stderr, "the controller does not start\n");
        exit(1);
    }
    memcpy(b->input.r, rest, sizeof b->input.r);
    b->input.measured = 0; /* the input before the first sample */
    (void)arm_step(&b->controller, &arm_defaults, &b->input, &b->output);
    for (int k = 0; k < ARM_LATENCY; ++k) { keep_input(b, k); }
    if (b->asked.kind == fault_named("commanded")) {
        for (int i = 0; i < NOMINAL.n; ++i) {
            const double to = q[i] + (b->asked.joint < 0 || b->asked.joint == i ? b->asked.magnitude : 0.0);
            q[i] = fmin(fmax(to, NOMINAL.is.lower[i]), NOMINAL.is.upper[i]);
        }
    }
    moves_begin(b, q);
}

/* The arm rests on its brakes, or on what held it, while the exported look decides; one that moves goes on. The look
 * takes 50 ms where all is well; it may begin anew so often. */
enum { LONGEST_LOOK = 1000 };

static int looked_well(bench *b)
{
    int may = -1;
    (void)arm_init(&b->controller);
    for (int k = 0; k < LONGEST_LOOK && may < 0; ++k) {
        measure(b);
        fault_sensors(b);
        may = may_start(b);
        for (int i = 0; i < NOMINAL.n; ++i) {
            b->arm.q[i] += b->arm.v[i] * ARM_PERIOD;
            b->arm.theta[i] += b->arm.w[i] * ARM_PERIOD;
        }
    }
    return may > 0;
}

static void begin(bench *b, const request *asked)
{
    plant_model model;
    double q[MOST];
    memset(b, 0, sizeof *b);
    b->asked = *asked;
    for (int s = 0; s < STREAMS; ++s) { b->random[s] = asked->seed * 0x2545F4914F6CDD1DULL + (unsigned)s * 0xD1342543DE82EF95ULL; }
    plant_draw(&model, &LOWEST, &HIGHEST, of_robot);
    for (int i = 0; i < NOMINAL.n; ++i) {
        const double low = fmax(NOMINAL.is.lower[i], -3.0), high = fmin(NOMINAL.is.upper[i], 3.0);
        q[i] = has_links() ? low + (0.1 + 0.8 * uniform(b, OF_MOVES)) * (high - low) : HOME[i];
    }
    fault_starts(b, q);
    plant_begin(&b->arm, &model, q);
    b->acts = 1;
    b->on = asked->at <= 0.0;
    fault_moving(b);
    b->acts = looked_well(b);
    start_controller(b);
    record_begin(b);
}

/* The drives never had power. */
static void refuse(bench *b)
{
    b->said = (decision){0, ARM_STOP_BAD_START, 0};
    record_sample(b, ARM_BAD_START);
    b->found.rest = 1;
}

/* The loop -------------------------------------------------------------------------------------------------------- */
static int sample(bench *b)
{
    double u[MOST];
    measure(b);
    fault_sensors(b);
    moves_step(b);
    decide_before(b);
    memcpy(u, b->queue[0], sizeof u); /* what acts now, where the design knows of a latency */
    const int code = arm_step(&b->controller, &arm_defaults, &b->input, &b->output);
    b->said = decide(b, code);
    if (b->asked.never) { b->said = (decision){1, 0u, -1}; }
    b->acts = b->said.power;
    if (ARM_LATENCY == 0) {
        keep_input(b, 0);
        memcpy(u, b->queue[0], sizeof u);
    }
    for (int k = 0; k + 1 < ARM_LATENCY; ++k) { memcpy(b->queue[k], b->queue[k + 1], sizeof b->queue[k]); }
    if (ARM_LATENCY > 0) { keep_input(b, ARM_LATENCY - 1); }
    memcpy(b->applied, u, sizeof u);
    return code;
}

/* Whoever stops the arm closes its brakes. */
static void cut_power(bench *b)
{
    for (int i = 0; i < NOMINAL.n; ++i) {
        b->arm.powered[i] = 0;
        b->arm.braked[i] = 1;
    }
}

static int goes_on(const bench *b)
{
    const record *r = &b->found;
    if (r->lost) { return 0; }
    if (r->noticed) { return b->t - b->asked.at - r->when < 1.25; }
    if (b->asked.moves > 0) { return b->found.moves < b->asked.moves || b->active || b->t < b->rests_until; }
    return b->t < b->asked.at + b->asked.lasts;
}

static void run(bench *b, const request *asked)
{
    int code = 0;
    begin(b, asked);
    const int started = b->acts;
    if (!started) { refuse(b); }
    while (started && goes_on(b)) {
        b->on = b->t >= b->asked.at - 1e-9;
        if (b->acts) { code = sample(b); }
        fault_inputs(b, b->applied);
        fault_arm(b);
        record_sample(b, code); /* with an ideal stop, whose drives still had power */
        trace_sample(b, code);
        if (!b->acts) { cut_power(b); }
        b->elapsed = fault_period(b);
        b->begun = b->on;
        plant_run(&b->arm, b->applied, b->elapsed, b->asked.refined);
        b->t += b->elapsed;
        ++b->k;
    }
}

/* Lines ----------------------------------------------------------------------------------------------------------- */
static int understood(request *r, const char *key, const char *value)
{
    const double number = strtod(value, NULL);
    if (strcmp(key, "kind") == 0) { r->kind = fault_named(value); }
    else if (strcmp(key, "seed") == 0) { r->seed = strtoull(value, NULL, 10); }
    else if (strcmp(key, "links") == 0) { r->links = (int)number; }
    else if (strcmp(key, "motors") == 0) { r->motors = (int)number; }
    else if (strcmp(key, "joint") == 0) { r->joint = (int)number; }
    else if (strcmp(key, "other") == 0) { r->other = (int)number; }
    else if (strcmp(key, "magnitude") == 0) { r->magnitude = number; }
    else if (strcmp(key, "at") == 0) { r->at = number; }
    else if (strcmp(key, "lasts") == 0) { r->lasts = number; }
    else if (strcmp(key, "speed") == 0) { r->speed = number; }
    else if (strcmp(key, "moves") == 0) { r->moves = (int)number; }
    else if (strcmp(key, "never") == 0) { r->never = (int)number; }
    else if (strcmp(key, "refined") == 0) { r->refined = (int)number; }
    else { return 0; }
    return r->kind >= 0;
}

static int read_request(char *line, request *r)
{
    *r = (request){.joint = -1, .at = 1.0, .lasts = 3.6, .speed = 1.0, .refined = 1};
    for (char *word = strtok(line, " \n"); word != NULL; word = strtok(NULL, " \n")) {
        char *value = strchr(word, '=');
        if (value == NULL) { return 0; }
        *value = '\0';
        if (!understood(r, word, value + 1)) { return 0; }
    }
    return r->joint < NOMINAL.n && r->other >= 0 && r->other < NOMINAL.n;
}

int main(int count, char **words)
{
    char line[1024];
    for (int i = 0; i < NOMINAL.n; ++i) { /* a limit that the robot file does not state is that of the design */
        if (NOMINAL.is.effort_limit[i] <= 0.0) { NOMINAL.is.effort_limit[i] = (double)arm_defaults.value[ARM_P_UPPER + i]; }
    }
    plant_complete(&NOMINAL);
    for (plant_model *each = &LOWEST; each != NULL; each = each == &LOWEST ? &HIGHEST : NULL) {
        memcpy(each->is.effort_limit, NOMINAL.is.effort_limit, sizeof each->is.effort_limit);
        memcpy(each->is.largest, NOMINAL.is.largest, sizeof each->is.largest);
        memcpy(each->is.brake, NOMINAL.is.brake, sizeof each->is.brake);
    }
    while (fgets(line, sizeof line, stdin) != NULL) {
        request asked;
        if (!read_request(line, &asked)) {
            fprintf(stderr, "not understood: %s\n", line);
            return 2;
        }
        if (count > 1) { trace_open(words[1]); }
        run(&here, &asked);
        trace_close();
        record_print(&here);
        (void)fflush(stdout);
    }
    return 0;
}
