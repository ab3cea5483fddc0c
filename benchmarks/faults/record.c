#include "bench.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Behind a notice the arm is watched for so long, s, and an ideal stop too. */
static const double WATCHED = 1.0;
/* Below these nothing moves, rad/s (m/s). */
static const double STILL = 0.05;
/* Time, s, in which the largest speed is forgotten by a factor of 2.7: swings are seen, and the past is not. */
static const double FORGOTTEN = 0.1;
/* Where no arm is any more, rad. */
static const double LOST = 1e3;
/* A joint whose distance from its command has changed by less is at its command, rad. */
static const double NEAR = 0.01;
/* Wrong motion by which a fault must be noticed, rad (m). */
static const double WRONG = 0.1;

static double largest(const double *speed)
{
    double most = 0.0;
    for (int i = 0; i < NOMINAL.n; ++i) { most = fmax(most, fabs(speed[i])); }
    return most;
}

static moment moment_of(const bench *b)
{
    moment now = {{0.0}, {0.0}};
    for (int i = 0; i < NOMINAL.n; ++i) {
        now.q[i] = b->arm.q[i];
        now.command[i] = (double)b->row.position[i];
    }
    return now;
}

static double way(const plant *p, const double *from)
{
    double most = 0.0;
    for (int i = 0; i < p->model.n; ++i) { most = fmax(most, fabs(p->q[i] - from[i])); }
    return most;
}

void record_begin(bench *b)
{
    memset(&b->found, 0, sizeof b->found);
    for (int i = 0; i < FIRSTS; ++i) { b->found.first[i] = -1.0; }
    b->found.hundred = -1.0;
    b->found.category = -1;
    b->found.fault = moment_of(b);
}

/* How far the arm goes where its drives are off and its brakes closed at this very instant. Without brakes it
 * falls; or healthy drives brake, as a brake that holds what they can give. */
static double ideal_stop(const bench *b, int drives_brake)
{
    plant twin = b->arm;
    double none[MOST] = {0.0}, most = 0.0;
    for (int i = 0; i < twin.model.n; ++i) {
        const int healthy = drives_brake && twin.powered[i] && twin.forced[i] == 0 && twin.gain[i] == 1.0 && !twin.shorted[i];
        if (twin.model.is.brake[i] < 0.0) {
            twin.model.is.brake[i] = healthy ? twin.weakened[i] * twin.model.is.largest[i] : 0.0;
        }
        twin.powered[i] = 0;
        twin.braked[i] = 1;
    }
    for (double s = 0.0; s < WATCHED; s += ARM_PERIOD) {
        plant_run(&twin, none, ARM_PERIOD, b->asked.refined);
        most = fmax(most, way(&twin, b->arm.q));
    }
    return most;
}

static void first(bench *b, int what, int holds)
{
    if (holds && b->found.first[what] < 0.0) { b->found.first[what] = b->t - b->asked.at; }
}

static void signals(bench *b, int code)
{
    int rejected = 0, unseen = 0;
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) {
        rejected += b->output.rejected[i];
        unseen += b->output.unseen[i] > 0;
    }
    if (code != ARM_OK && b->found.first_code == 0) { b->found.first_code = code; }
    first(b, FIRST_CODE, code != ARM_OK);
    first(b, FIRST_REJECTED, rejected > 0);
    first(b, FIRST_UNSEEN, unseen > 0);
    first(b, FIRST_PATH, b->output.path_rate < (arm_real)0.999);
    for (int bit = 0; bit < FIRSTS - FIRST_STATUS; ++bit) { first(b, FIRST_STATUS + bit, b->output.status >> bit & 1); }
}

static void notice(bench *b, int code)
{
    record *r = &b->found;
    const double sample = ARM_PERIOD;
    r->noticed = 1;
    r->early = b->t < b->asked.at - 1e-9;
    r->notice = moment_of(b);
    r->when = b->t - b->asked.at;
    r->code = code;
    r->status = b->output.status;
    r->stop = b->said.stop;
    r->category = b->said.category;
    r->wrong_at_notice = r->wrong;
    for (int i = 0; i < NOMINAL.n; ++i) { r->step = fmax(r->step, fabs(b->arm.v[i]) * sample); }
    r->ideal = ideal_stop(b, 0);
    r->held = ideal_stop(b, 1);
}

/* How far the arm goes behind a notice; where no brake holds it and it rested when its drives went off, it falls from
 * then on, which is counted apart. */
static void stopped(bench *b)
{
    record *r = &b->found;
    int braked = 1;
    for (int i = 0; i < NOMINAL.n; ++i) { braked = braked && NOMINAL.is.brake[i] >= 0.0; }
    if (!r->noticed || b->t - b->asked.at - r->when > WATCHED) { return; }
    if (!b->said.power && !r->falls) {
        memcpy(r->off, b->arm.q, sizeof r->off);
        r->falls = !braked && r->rest > 0 ? 2 : 1;
    }
    if (r->falls == 2) {
        r->fell = fmax(r->fell, way(&b->arm, r->off));
    } else {
        r->furthest = fmax(r->furthest, way(&b->arm, r->notice.q));
    }
}

/* How far a joint has moved away from its command, by its own motion: see verdict.py. */
static double wrong_motion(bench *b, int i, double away)
{
    record *r = &b->found;
    const double changed = away - (r->fault.q[i] - r->fault.command[i]), moved = b->arm.q[i] - r->last[i];
    r->last[i] = b->arm.q[i];
    r->going[i] = fabs(changed) < NEAR ? 0.0 : fmax(r->going[i] + copysign(moved, changed * moved), 0.0);
    return fmin(r->going[i], fabs(changed));
}

void record_sample(bench *b, int code)
{
    record *r = &b->found;
    const plant *arm = &b->arm;
    const int stops = b->said.stop != 0u || !b->said.power;
    double distance = 0.0;
    if (b->on && !b->begun) {
        r->fault = moment_of(b);
        memcpy(r->last, arm->q, sizeof r->last);
    }
    if (b->acts || !r->noticed) { signals(b, code); }
    for (int i = 0; i < NOMINAL.n; ++i) {
        const double away = arm->q[i] - (double)b->row.position[i];
        distance = fmax(distance, fabs(away));
        if (b->on && !r->noticed) { r->wrong = fmax(r->wrong, wrong_motion(b, i, away)); }
        if (b->on) { r->speed = fmax(r->speed, fabs(arm->v[i]) / NOMINAL.is.speed_limit[i]); }
    }
    if (b->on) { r->beyond = fmax(r->beyond, distance); }
    if (r->hundred < 0.0 && r->wrong > WRONG) { r->hundred = b->t - b->asked.at; }
    if (stops && !r->noticed) { notice(b, code); }
    r->lost = r->lost || !(distance < LOST);
    r->rest = fmax(largest(arm->v), largest(arm->w)) < STILL ? r->rest + 1 : 0;
    if (b->on && r->rest == 0) { r->rested = b->t - b->asked.at; }
    stopped(b);
    r->moving = fmax(largest(arm->v), r->moving * exp(-ARM_PERIOD / FORGOTTEN));
    r->end = distance;
}

void record_print(const bench *b)
{
    const record *r = &b->found;
    printf("{\"seed\": %llu, \"noticed\": %d, \"early\": %d, \"when\": %.6g, \"code\": %d, \"status\": %d, \"stop\": %u, "
           "\"category\": %d, \"wrong\": %.4g, \"wrong_at_notice\": %.4g, \"hundred\": %.6g, \"furthest\": %.4g, "
           "\"fell\": %.4g, \"ideal\": %.4g, \"held\": %.4g, \"step\": %.3g, \"beyond\": %.4g, \"speed\": %.4g, \"end\": %.4g, \"moving\": %.3g, \"rest\": %d, "
           "\"rested\": %.4g, "
           "\"power\": %d, \"path\": %.3g, \"contact\": %.4g, \"lost\": %d, \"moves\": %d, \"first_code\": %d, \"first\": [",
           b->asked.seed, r->noticed, r->early, r->when, r->code, r->status, r->stop, r->category, r->wrong,
           r->wrong_at_notice, r->hundred, r->furthest, r->fell, r->ideal, r->held, r->step, r->beyond, r->speed, r->end, r->moving, r->rest, r->rested,
           b->acts, (double)b->output.path_rate, b->arm.contact, r->lost, r->moves, r->first_code);
    for (int i = 0; i < FIRSTS; ++i) { printf("%s%.5g", i > 0 ? ", " : "", r->first[i]); }
    printf("], \"at\": %.6g}\n", b->asked.at);
}

/* The trace ------------------------------------------------------------------------------------------------------- */
static FILE *traced;

void trace_open(const char *path)
{
    traced = fopen(path, "w");
    if (traced == NULL) { return; }
    fprintf(traced, "t,fault");
    const char *const joints[] = {"q", "v", "theta", "w", "command", "u", "applied", "estimate", "speed_estimate"};
    for (unsigned c = 0; c < sizeof joints / sizeof *joints; ++c) {
        for (int i = 0; i < NOMINAL.n; ++i) { fprintf(traced, ",%s_%d", joints[c], i); }
    }
    const char *const sensors[] = {"y", "old", "unseen", "rejected"};
    for (unsigned c = 0; c < sizeof sensors / sizeof *sensors; ++c) {
        for (int i = 0; i < ARM_MEASUREMENTS; ++i) { fprintf(traced, ",%s_%d", sensors[c], i); }
    }
    fprintf(traced, ",measured,code,status,path_rate,stop,category,power\n");
}

void trace_sample(const bench *b, int code)
{
    if (traced == NULL) { return; }
    fprintf(traced, "%.6f,%d", b->t, b->on);
    const double *const columns[] = {b->arm.q, b->arm.v, b->arm.theta, b->arm.w};
    for (int c = 0; c < 4; ++c) {
        for (int i = 0; i < NOMINAL.n; ++i) { fprintf(traced, ",%.9g", columns[c][i]); }
    }
    for (int i = 0; i < NOMINAL.n; ++i) { fprintf(traced, ",%.9g", (double)b->row.position[i]); }
    for (int i = 0; i < NOMINAL.n; ++i) { fprintf(traced, ",%.9g", (double)b->output.u[i]); }
    for (int i = 0; i < NOMINAL.n; ++i) { fprintf(traced, ",%.9g", b->applied[i]); }
    for (int i = 0; i < 2 * NOMINAL.n; ++i) { fprintf(traced, ",%.9g", (double)b->output.estimate[i]); }
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) { fprintf(traced, ",%.9g", b->given[i]); }
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) { fprintf(traced, ",%d", b->repeated[i]); }
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) { fprintf(traced, ",%d", b->output.unseen[i]); }
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) { fprintf(traced, ",%d", b->output.rejected[i]); }
    fprintf(traced, ",%d,%d,%d,%.6g,%u,%d,%d\n", b->input.measured, code, b->output.status, (double)b->output.path_rate,
            b->said.stop, b->said.category, b->said.power && b->acts);
}

void trace_close(void)
{
    if (traced != NULL) { (void)fclose(traced); }
    traced = NULL;
}
