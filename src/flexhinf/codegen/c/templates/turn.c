{% import "turning.c" as turning with context %}
/* name(x): sin or cos; of the type @{R} */
static @{R} @{name}(@{R} x)
{
#ifdef FUSED
    const @{R} reach = @{number(reach[true])};
#else
    const @{R} reach = @{number(reach[false])};
#endif
    if (!(fabs@{f}(x) <= reach)) {
        return @{"cos" if of_cosine else "sin"}(x);
    }
@{turning.statements("x", {of_cosine: "return"}) | indent(4, true) | replace("    #", "#")}}
