/* The rule that judges: the exported functions, called as the exported main.c does. Whoever exports another one changes
 * these functions and nothing else. A rule may leave power on while it stops the arm (category 1, until it takes the
 * power away, or 2): `stop` then says that it has noticed, and output.u acts meanwhile. */
#ifndef FAULTS_DECIDE_H
#define FAULTS_DECIDE_H

#include "bench.h"

/* Before the start, once per sample, while drives have no power: whether the arm may start. Below 0: not known yet. */
static int may_start(bench *b)
{
    int why = 0;
    const int code = arm_at_rest(&b->controller, &arm_defaults, &b->input, &why);
    b->refused = why;
    return code == ARM_WAITING ? -1 : code == ARM_OK;
}

/* Before a step: what main.c says of time. What is fresh it does not know. */
static void decide_before(bench *b)
{
    b->input.elapsed = (arm_real)b->elapsed;
    b->input.age = 0;
}

/* After a step: whether drives may have power. It is asked until it says no: nothing steps behind that. */
static decision decide(bench *b, int code)
{
    decision said = {1, 0u, -1};
    said.power = arm_may_act(&b->controller, &arm_defaults, code, &b->output);
    said.stop = (unsigned int)b->output.stop;
    if (said.stop != 0u) { said.category = arm_defaults.category; }
    return said;
}

#endif
