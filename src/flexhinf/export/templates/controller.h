{% import "prose.txt" as prose with context %}
/* @{name}: a sampled controller of @{period_text} s, made by flexhinf @{version}.
 *
{% if c.mode.moving %}
 * @{prose.first() | starred}
 *
{% endif %}
 * @{code.facts | stated}
 *
 * SPDX-License-Identifier: 0BSD (use it in any product; flexhinf claims no rights in what it writes for you)
 *
 * Call @{name}_init once, then @{name}_step once per sample, from one thread; a step without it says so. No memory is
 * allocated, nothing is static but constants; several controllers are several states. Compiled with flags that change
 * results, such as -ffast-math, it refuses to run: the compiler or @{name}_init says so.
 */
{% set guard = NAME ~ "_H" %}
{% include "guard.h" %}

#ifdef __cplusplus
extern "C" {
#endif

typedef @{real} @{name}_real;

/* Which code this header belongs to: @{name}_digest of the source that is linked must be the same text. */
#define @{NAME}_VERSION "@{version}"
#define @{NAME}_DIGEST "@{digest}"
extern const char @{name}_version[]; /* of flexhinf */
extern const char @{name}_digest[];  /* SHA-256 of header and source */

/* Which bits the compiled source computes: @{prose.bits()} */
extern const int @{name}_fused;

/* Sampling period, s. */
#define @{NAME}_PERIOD @{number(c.period)}

enum {
    @{NAME}_LATENCY = @{c.mode.latency}, /* samples from a measurement until the input computed from it acts */
    @{NAME}_MEASUREMENTS = @{code.sizes.y},
    @{NAME}_COMMANDS = @{c.commanded | length},
    @{NAME}_INPUTS = @{code.sizes.u},
    @{NAME}_STATES = @{code.sizes.estimate},
    @{NAME}_PARAMETERS = @{code.sizes.data},
    @{NAME}_MEMORY = @{code.sizes.memory},
    @{NAME}_WORK = @{[1, code.scratch] | max}{% if columns %},
    @{NAME}_COLUMNS = @{columns}{% endif +%}
};

/* @{prose.elements() | starred} */
{% for rows in signals %}
@{rows | enumeration}
{% endfor %}

/* First elements of the parameters, with how many there are. */
@{code.places.numbers() | enumeration}
{% if parameters %}

/* Parameters of the estimator's model, with their units. */
@{parameters | enumeration}
{% endif %}

/* What a step returns: the first of these that holds. README.md says what the caller does then. */
@{codes | enumeration}

/* What it says of itself: bits of output.status.
 * @{prose.reactions() | starred} */
@{status | enumeration}

/* Why the drives may not act: bits of output.stop, which stay until @{name}_init or @{name}_start. */
@{stops | enumeration}

/* Numbers of the controller. Those of @{name}_defaults are the design's. */
typedef struct {
    @{name}_real value[@{NAME}_PARAMETERS];
    @{name}_real oldest;     /* s: an older measurement counts as missing */
    int missing_limit;      /* samples without a measurement, one after the other, until the output is held */
    int stop_on;            /* bits of what stops the robot; 0: nothing */
    int category;           /* of that stop by IEC 60204-1: 0, power off at once; 1, controlled stop, then off; 2, then held */
} @{name}_param;

extern const @{name}_param @{name}_defaults;

/* What @{name}_check returns; of several faults the gravest. */
enum {
    @{NAME}_PARAM_OK = 0,
    /* a limit wider, a rate faster or a gap longer than the design's, a parameter of the model@{prose.tolerated()}, or another
     * number that is not the design's */
    @{NAME}_PARAM_BEYOND_DESIGN = 1,
    /* a stiffness or a motor inertia that is not positive; a mass, friction or variance below zero; a lower limit that
     * is not below the upper one */
    @{NAME}_PARAM_NOT_PHYSICAL = 2,
    @{NAME}_PARAM_NOT_FINITE = 3 /* NaN, or infinite where the design's number is not */
};

/* Whether parameters may be used; no step asks. Where they may not, *place is the first number of the gravest fault:
 * an element of value, @{NAME}_PARAMETERS for oldest, and one more each for the whole numbers behind it; place may be a null pointer. Not there
 * with -D@{NAME}_WITHOUT_CHECK. */
int @{name}_check(const @{name}_param *param, int *place);

{% if c.mode.checks_measurements %}
/* An element of y is missing where it is below param.value[@{NAME}_P_MEASUREMENT_LOWER + i] or
 * above _UPPER, in its unit, or moved by more than _RATE per s since it was last plausible; output.rejected counts it.
 * The line "measurements:" above has the limits of the design; HUGE_VAL is none. Where no element is plausible, the
 * sample counts as one without a measurement. */

{% endif %}
/* What one sample is given.
 *
 * @{prose.command() | starred} */
typedef struct {
    @{name}_real y[@{NAME}_MEASUREMENTS]; /* measurements{% if code.predicts %}, not finite (NAN) where a sensor gave nothing{% endif %} */
    @{name}_real r[@{code.sizes.r}]; /* commands, see above */
    /* of the measurements when the step begins, s; 0 if that is not known. Above oldest, below 0, or NAN: there is no
     * measurement */
    @{name}_real age;
    /* since the step before, s, by a clock that does not make the period; 0 if that is not known. Where its mean over
     * some 32 steps is off by more than a tenth of the period, nothing is computed: @{NAME}_BAD_PERIOD */
    @{name}_real elapsed;
    int measured; /* 0 where there is no measurement */
{% if c.mode.checks_measurements %}
    /* of each measurement: 1, it was measured since the step before; -1, it is the one of then, and counts as missing; 0,
     * that is not known */
    int fresh[@{NAME}_MEASUREMENTS];
{% endif %}
} @{name}_input;

/* What it gives. */
typedef struct {
    @{name}_real u[@{NAME}_INPUTS]; /* inputs of the plant, always finite and within their limits */
    @{name}_real estimate[@{NAME}_STATES]; /* estimated state; that of the start before the first sample */
    /* samples since each measurement was last there, finite and in time; counts to 32767. One that is missing for long
     * may be a broken sensor */
    int unseen[@{NAME}_MEASUREMENTS];
    int stop;   /* why the drives may not act, as above; @{name}_may_act writes it */
    int status; /* bits of the last good sample, as above, from @{NAME}_OUTSIDE_WORKSPACE on */
    /* fraction of a period by which the time along a path advances: 1 but for braking, 0 after
     * @{NAME}_NOT_INITIALISED */
    @{name}_real path_rate;
{% if code.doubt is not none %}
    /* samples since the start with @{NAME}_DOUBTFUL_ESTIMATE; float counts to 2^24 */
    int doubtful;
{% endif %}
{% if code.rejected is not none %}
    /* how often each measurement was rejected since the start; float counts to 2^24 */
    int rejected[@{NAME}_MEASUREMENTS];
{% endif %}
} @{name}_output;

/* What is remembered between samples, and memory to work in. Its parts are not for the caller. */
typedef struct {
    @{name}_real memory[@{NAME}_MEMORY], newer[@{NAME}_MEMORY], older[@{NAME}_MEMORY], start[@{NAME}_MEMORY];
    @{name}_real after[@{NAME}_MEMORY];
    @{name}_real estimate[@{NAME}_STATES], estimated[@{NAME}_STATES];
    @{name}_real u[@{NAME}_INPUTS], held[@{NAME}_INPUTS];
    @{name}_real work[@{NAME}_WORK];
    @{name}_real slip, stop[@{stop_size}];
{% if columns %}
{% if code.lanes > 1 %}
#if @{sixteen}
    __attribute__((aligned(16))) /* vectors are read from it as a whole */
#endif
{% endif %}
    @{name}_real columns[@{NAME}_COLUMNS];
{% endif %}
    @{name}_real looked[@{NAME}_MEASUREMENTS];
    int unseen[@{NAME}_MEASUREMENTS];
    int looks;
    int missing, failed, began_again, samples, waiting, refused;
    unsigned int mark;
} @{name}_state;

/* Pointers lead to objects of the caller. None is checked: only those may be null of which it is said.
 *
 * Forget everything: @{prose.beginning()}.
 * Until there is a good measurement the output is the input before the first sample: @{c.first_input.text}.
 *
 * Returns @{NAME}_OK; or @{NAME}_BAD_ARITHMETIC where a flag of the compiler, or a setting of the processor,
 * makes other numbers of what is written: then every step returns that too, and holds the output of the start.
 * It looks at the context that calls it: on a processor whose interrupts have settings of their own (FPDSCR of a
 * Cortex-M), these must be the same. */
int @{name}_init(@{name}_state *state);

/* As @{name}_init: @{prose.other_beginning()}, and from another input; estimate and input may be null pointers. One with a number that is
 * not finite is refused with @{NAME}_BAD_START, and every step then returns @{NAME}_NOT_INITIALISED. The first output then
 * continues from that input as far as the design says (rate limit, bumpless start). Without an input it is @{prose.first_input()}. */
int @{name}_start(@{name}_state *state, const @{name}_param *param, const @{name}_real *estimate,
                 const @{name}_real *input);

/* One sample. Returns one of the codes above; whatever the code, the output is finite, and within the limits of param
 * and those of @{name}_defaults, whichever is narrower. It is no safe state: where samples fail, it is the last one.
 * After @{NAME}_STOPPED a measurement in time resumes the step: nothing latches.{% if code.unlimited +%}
 * @{prose.unlimited() | starred}{% endif %} */
int @{name}_step(@{name}_state *state, const @{name}_param *param, const @{name}_input *input, @{name}_output *output);

/* Before the start: whether the robot rests where the controller can begin. Call it once per sample with what is measured,
 * drives off or brakes closed. Returns @{NAME}_WAITING until the readings of @{look} s agree, then @{NAME}_OK; and
 * @{NAME}_BAD_START where they do not, and *why says what to look at: {% if not checkable %}nothing tells here whether an encoder's zero is
 * right, so that bit is set with @{NAME}_OK too. {% endif %}It begins anew with @{name}_init, a missing reading and a bad one. */
enum {
    @{NAME}_START_MISSING = 1,      /* a reading is not there */
    @{NAME}_START_MOVES = 2,        /* the robot moves */
    @{NAME}_START_OUT_OF_RANGE = 4, /* a joint is beyond its range, or its encoder has another zero or unit */
    @{NAME}_START_TWISTED = 8,      /* motor and link are apart by more than weight and friction twist the spring: an encoder's zero, a sign, something that leans on the arm */
    @{NAME}_START_NOT_CHECKED = 16  /* no second reading of the joint tells whether the place is true: home the arm */
};
int @{name}_at_rest(@{name}_state *state, const @{name}_param *param, const @{name}_input *input, int *why);

/* Whether the drives may have power: call it after each step, and obey. From the code of the step, its status, sensors that
 * are missing or refused, and measured speeds. What it once found stays: output->stop says it, and a new start alone
 * ends it. Returns 1, and output->u is what acts; during a controlled stop that is not the controller's. Returns 0 for
 * power off, from then on: then output->u is @{code.stop.stop_text}, and brakes close. Steps go on as before. */
int @{name}_may_act(@{name}_state *state, const @{name}_param *param, int code, @{name}_output *output);
{% if code.standstill is not none %}

/* The robot at rest at link positions (q): writes its state, @{NAME}_STATES numbers, and behind it the input that holds
 * it there, with which @{name}_start begins; q may be the beginning of r. Motors stand where springs hold the weight.
 * {% if code.rests %}All of r is the command that rests there. {% endif %}Returns @{NAME}_BAD_COMMAND where a number is not finite. Not there with -D@{NAME}_WITHOUT_REST. */
int @{name}_rest(const @{name}_param *param, const @{name}_real *q, @{name}_real *r);
{% endif %}
{% if code.slows %}

/* Where the controller brakes, a row of the motion (r) is played more slowly, by path_rate: this makes it the command
 * of that slower motion; call it once for a row that comes from your path. Velocities fall with the rate, and with its
 * square what accelerates: what motors are ahead by, and what inputs have beside what speed and weight need. At rate 1
 * nothing changes. What the braking itself needs is not in it. Returns @{NAME}_BAD_COMMAND where a number is not finite.
 * Not there with -D@{NAME}_WITHOUT_REST. */
int @{name}_slowed(const @{name}_param *param, @{name}_real path_rate, @{name}_real *r);
{% endif %}

#ifdef __cplusplus
}
#endif

#endif
