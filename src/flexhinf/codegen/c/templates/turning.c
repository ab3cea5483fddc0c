{# Sine and cosine of an x within the reach: reduction, and two polynomials, one of them by the quadrant. The sign of x,
   which is that of zero too, is that of its sine. Coefficients are those of emit/sines.py; the steps stand in both, as
   LLVM takes the quadrant from the bits of k, and C has no bits of a number that MISRA allows. #}
{% macro remainder(parts) %}
{% set total = namespace(text="size") %}
{% for part in parts %}
{% set total.text = "FMA(-k, %s, %s)" % (number(part), total.text) %}
{% endfor %}
const @{R} r = @{total.text};
{% endmacro %}
{% macro horner(name, coefficients) %}
@{R} @{name} = @{number(coefficients[0])};
{% for coefficient in coefficients[1:] %}
@{name} = FMA(@{name}, z, @{number(coefficient)});
{% endfor %}
{% endmacro %}
{% macro statements(x, results) %}
const @{R} size = fabs@{f}(@{x});
const @{R} k = FMA(size, @{number(2.0 / pi)}, @{number(rounder)}) - @{number(rounder)};
const @{R} m = k - @{number(4.0)} * (((k * @{number(0.25)} - @{number(0.375)}) + @{number(rounder)}) - @{number(rounder)});
#ifdef FUSED
@{remainder(half_pi[true])}#else
@{remainder(half_pi[false])}#endif
const @{R} z = r * r;
@{horner("odd", sine)}@{horner("even", cosine)}const @{R} s = FMA(odd, z * r, r);
const @{R} c = FMA(even, z * z, FMA(z, @{number(-0.5)}, @{number(1.0)}));
{% for of_cosine, begin in results.items() %}
{% set quadrant = "(m * (m - %s) < %s || m > %s)" % (number(2.0), zero, number(2.5)) %}
{% if of_cosine %}
const @{R} cv = @{quadrant} ? s : c;
@{begin} (m > @{number(0.5)} && m < @{number(2.5)}) ? -cv : cv;
{% else %}
const @{R} sv = @{quadrant} ? c : s;
@{begin} ((m > @{number(1.5)}) ? -sv : sv) * copysign@{f}(@{number(1.0)}, @{x});
{% endif %}
{% endfor %}
{% endmacro %}
