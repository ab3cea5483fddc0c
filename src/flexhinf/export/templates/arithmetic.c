/* What is computed is what is written: every operation rounded once, to its own type, in its own place, with numbers
 * that are not finite. Then the numbers are those of the simulation. What a compiler says of its flags is read here;
 * what it keeps to itself, @{name}_exact finds. */
#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "@{name} must see numbers that are not finite: compile without -ffast-math, -ffinite-math-only, /fp:fast"
#endif
#if defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__NO_SIGNED_ZEROS__)
#error "@{name} computes what is written: compile without -funsafe-math-optimizations and the flags that it stands for"
#endif
#if (defined(__FLT_EVAL_METHOD__) && __FLT_EVAL_METHOD__ != 0 && __FLT_EVAL_METHOD__ != 16) || \
    (defined(_M_IX86) && (!defined(_M_IX86_FP) || _M_IX86_FP < 2)) /* FLT_EVAL_METHOD; 16 is about _Float16 alone */
#error "@{name} rounds to its own type, not to a wider one: compile for a 32-bit PC with -msse2 -mfpmath=sse"
#endif
/* Constants and numbers have the size of this type: no -fsingle-precision-constant. */
typedef char @{name}_type_of_constants[(sizeof(1.0@{f}) == @{bytes} && sizeof(@{real}) == @{bytes}) ? 1 : -1];

/* Sums and products as they are written: compilers fuse some of them unless they are told not to. GCC's vectors of
 * straight lines do even so (alternate sums and differences of products, vfmaddsub), so it makes none. Where a rule forbids
 * this pragma, give GCC the two flags -ffp-contract=off -fno-tree-slp-vectorize, and -D@{NAME}_WITHOUT_PRAGMA. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__) && !defined(@{NAME}_WITHOUT_PRAGMA)
#pragma GCC optimize("fp-contract=off", "no-tree-slp-vectorize")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif

/* Whether two numbers are the same. */
static int @{name}_is(@{real} one, @{real} other)
{
    return (one >= other && one <= other) ? 1 : 0;
}

/* Whether the program computes so: what a compiler may change with flags for which it defines no macro (clang: those of
 * -funsafe-math-optimizations, -ffp-contract=fast, -fno-honor-nans), and what a processor may be set to (numbers below
 * the normal ones as 0, directed rounding), gives another answer here. Nothing of it is known before it runs. */
static int @{name}_exact(void)
{
    volatile @{real} given[9];
    volatile @{real} computed[3];
    given[0] = 1.0@{f};
    given[1] = @{number(precision.eps)};
    given[2] = @{number(precision.eps)} / 4.0@{f};
    given[3] = -0.0@{f};
    given[4] = (@{real})NAN;
    given[5] = HUGE_VAL@{F};
    given[6] = @{number(precision.tiny)};
    given[7] = 5.0@{f};
    given[8] = 0.5@{f};
    const @{real} one = given[0], step = given[1], small = given[2], zero = given[3], nan = given[4], huge = given[5];
    const @{real} least = given[6], five = given[7], half = given[8], again = given[0], other = one + given[1];
    computed[0] = 5.0@{f} / 6.0@{f};
    computed[1] = other * other;
    computed[2] = least * half;
    const @{real} ratio = computed[0], square = computed[1], tiny = computed[2];
    int wrong = 0;
    wrong += 1 - @{name}_is(one + small, one); /* to nearest */
    wrong += 1 - @{name}_is(one - small / 4.0@{f}, one); /* to its own type */
    wrong += 1 - @{name}_is((one + small) - one, 0.0@{f}); /* not in another order */
    wrong += 1 - @{name}_is((one - step) - one, -step);
    wrong += 1 - @{name}_is((one + step) * (again + step) - square, 0.0@{f}); /* products rounded before sums */
    wrong += 1 - @{name}_is(five / 6.0@{f}, ratio); /* no product with a reciprocal */
    wrong += (copysign@{f}(one, zero + 0.0@{f}) > 0.0@{f}) ? 0 : 1; /* zeros with signs */
    wrong += (tiny > 0.0@{f}) ? 0 : 1; /* numbers below the normal ones */
    wrong += 1 - @{name}_is(tiny + tiny, least);
    wrong += (isfinite(nan) == 0) ? 0 : 1;
    wrong += (isnan(nan) != 0) ? 0 : 1;
    wrong += (nan <= one) ? 1 : 0;
    wrong += (nan > one) ? 1 : 0;
    wrong += (isfinite(huge) == 0) ? 0 : 1;
    wrong += (isfinite(-huge) == 0) ? 0 : 1;
    wrong += (huge > @{number(precision.max)}) ? 0 : 1;
    return (wrong == 0) ? 1 : 0;
}
