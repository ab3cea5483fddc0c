/* The rule that judges: that of the exported main.c, which reads the code and `unseen`. Whoever exports another one
 * changes these two functions and nothing else. A rule may leave power on while it stops the arm (category 1, until it
 * takes the power away, or 2): `stop` then says that it has noticed, and output.u acts meanwhile. */
#ifndef FAULTS_DECIDE_H
#define FAULTS_DECIDE_H

#include "bench.h"

/* Before a step: what main.c says of time (b->elapsed) and of what is fresh (b->repeated). It says nothing. */
static void decide_before(bench *b)
{
    b->input.elapsed = 0;
    b->input.age = 0;
}

/* Samples that a sensor may be without a measurement, as in main.c. */
enum { LONGEST_UNSEEN = 10 };

/* After a step: whether drives may have power. It is asked until it says no: nothing steps behind that. */
static decision decide(bench *b, int code)
{
    decision said = {1, 0u, -1};
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) {
        if (b->output.unseen[i] > LONGEST_UNSEEN && code != ARM_WAITING) { said.stop = 1u; }
    }
    if (code == ARM_STOPPED || code == ARM_BAD_PERIOD || code == ARM_WENT_BACK || code == ARM_NOT_INITIALISED) {
        said.stop |= 2u;
    }
    if (said.stop != 0u) {
        said.power = 0;
        said.category = 0;
    }
    return said;
}

#endif
