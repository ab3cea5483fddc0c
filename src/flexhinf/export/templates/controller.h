/* @NAME@: a sampled controller of @PERIOD_TEXT@ s, made by flexhinf @VERSION@.
 *
@FIRST_LINES@ * @SUMMARY@
 *
 * SPDX-License-Identifier: 0BSD (use it in any product; flexhinf claims no rights in what it writes for you)
 *
 * Call @NAME@_init once, then @NAME@_step once per sample, from one thread; a step without it says so. No memory is
 * allocated, nothing is static but constants; several controllers are several states. Compiled with flags that change
 * results, such as -ffast-math, it refuses to run: the compiler or @NAME@_init says so.
 */
#ifndef @BIG@_H
#define @BIG@_H

#ifdef __cplusplus
extern "C" {
#endif

typedef @REAL@ @NAME@_real;

/* Which code this header belongs to: @NAME@_digest of the source that is linked must be the same text. */
#define @BIG@_VERSION "@VERSION@"
#define @BIG@_DIGEST "@DIGEST@"
extern const char @NAME@_version[]; /* of flexhinf */
extern const char @NAME@_digest[];  /* SHA-256 of header and source */

/* Which bits the compiled source computes: @BITS@ */
extern const int @NAME@_fused;

/* Sampling period, s. */
#define @BIG@_PERIOD @PERIOD@

enum {
    @BIG@_LATENCY = @LATENCY@, /* samples from a measurement until the input computed from it acts */
    @BIG@_MEASUREMENTS = @P@,
    @BIG@_COMMANDS = @K@,
    @BIG@_INPUTS = @M@,
    @BIG@_STATES = @N@,
    @BIG@_PARAMETERS = @DATA@,
    @BIG@_MEMORY = @MEMORY@,
    @BIG@_WORK = @WORK@@COLUMNS@
};

/* @ELEMENTS@ */
@SIGNALS@

/* First elements of the parameters, with how many there are. */
@OFFSETS@@NAMED@

/* What a step returns: the first of these that holds. README.md says what the caller does then. */
@CODES@

/* What it says of itself: bits of output.status.
 * @SAYS@ */
@STATUS@

/* Numbers of the controller. Those of @NAME@_defaults are the design's. */
typedef struct {
    @NAME@_real value[@BIG@_PARAMETERS];
    @NAME@_real oldest;     /* s: an older measurement counts as missing */
    int missing_limit;      /* samples without a measurement, one after the other, until the output is held */
} @NAME@_param;

extern const @NAME@_param @NAME@_defaults;

/* What @NAME@_check returns; of several faults the gravest. */
enum {
    @BIG@_PARAM_OK = 0,
    /* a limit wider, a rate faster or a gap longer than the design's, a parameter of the model@TOLERANCES@, or another
     * number that is not the design's */
    @BIG@_PARAM_BEYOND_DESIGN = 1,
    /* a stiffness or a motor inertia that is not positive; a mass, friction or variance below zero; a lower limit that
     * is not below the upper one */
    @BIG@_PARAM_NOT_PHYSICAL = 2,
    @BIG@_PARAM_NOT_FINITE = 3 /* NaN, or infinite where the design's number is not */
};

/* Whether parameters may be used; no step asks. Where they may not, *place is the first number of the gravest fault:
 * an element of value, @BIG@_PARAMETERS for oldest, one more for missing_limit; place may be a null pointer. Not there
 * with -D@BIG@_WITHOUT_CHECK. */
int @NAME@_check(const @NAME@_param *param, int *place);

@PLAUSIBLE@/* What one sample is given.
 *
 * @COMMAND@ */
typedef struct {
    @NAME@_real y[@BIG@_MEASUREMENTS]; /* measurements@GAPS@ */
    @NAME@_real r[@R@]; /* commands, see above */
    /* of the measurements when the step begins, s; 0 if that is not known. Above oldest, below 0, or NAN: there is no
     * measurement */
    @NAME@_real age;
    int measured; /* 0 where there is no measurement */
} @NAME@_input;

/* What it gives. */
typedef struct {
    @NAME@_real u[@BIG@_INPUTS]; /* inputs of the plant, always finite and within their limits */
    @NAME@_real estimate[@BIG@_STATES]; /* estimated state; that of the start before the first sample */
    /* samples since each measurement was last there, finite and in time; counts to 32767. One that is missing for long
     * may be a broken sensor */
    int unseen[@BIG@_MEASUREMENTS];
    int status; /* bits of the last good sample, as above, from @BIG@_OUTSIDE_WORKSPACE on */
    /* fraction of a period by which the time along a path advances: 1 but for braking, 0 after
     * @BIG@_NOT_INITIALISED */
    @NAME@_real path_rate;@DOUBTFUL@@REJECTED@
} @NAME@_output;

/* What is remembered between samples, and memory to work in. Its parts are not for the caller. */
typedef struct {
    @NAME@_real memory[@BIG@_MEMORY], newer[@BIG@_MEMORY], older[@BIG@_MEMORY], start[@BIG@_MEMORY];
    @NAME@_real after[@BIG@_MEMORY];
    @NAME@_real estimate[@BIG@_STATES], estimated[@BIG@_STATES];
    @NAME@_real u[@BIG@_INPUTS], held[@BIG@_INPUTS];
    @NAME@_real work[@BIG@_WORK];
@ROOM@    int unseen[@BIG@_MEASUREMENTS];
    int missing, failed, began_again, samples, waiting, refused;
    unsigned int mark;
} @NAME@_state;

/* Forget everything: @BEGINS@. Until there is a good measurement the output is the input before the first sample: @FIRST@.
 *
 * Returns @BIG@_OK; or @BIG@_BAD_ARITHMETIC where a flag of the compiler, or a setting of the processor,
 * makes other numbers of what is written: then every step returns that too, and holds the output of the start.
 * It looks at the context that calls it: on a processor whose interrupts have settings of their own (FPDSCR of a
 * Cortex-M), these must be the same. */
int @NAME@_init(@NAME@_state *state);

/* As @NAME@_init: @SETS@, and from another input; estimate and input may be null pointers. One with a number that is
 * not finite is refused with @BIG@_BAD_START, and every step then returns @BIG@_NOT_INITIALISED. The first output then
 * continues from that input as far as the design says (rate limit, bumpless start). Without an input it is @HELD@. */
int @NAME@_start(@NAME@_state *state, const @NAME@_param *param, const @NAME@_real *estimate,
                 const @NAME@_real *input);

/* One sample. Returns one of the codes above; whatever the code, the output is finite, and within the limits of param
 * and those of @NAME@_defaults, whichever is narrower. It is no safe state: where samples fail, it is the last one.
 * After @BIG@_STOPPED a measurement in time resumes the step: nothing latches.@UNLIMITED@ */
int @NAME@_step(@NAME@_state *state, const @NAME@_param *param, const @NAME@_input *input, @NAME@_output *output);@STANDSTILL@

#ifdef __cplusplus
}
#endif

#endif
