{# In nested form: one loop inside the other, for each monomial of a lower degree. #}
{% macro each(line, end) %}
for (int e = 0; e < @{end}; ++e) {
    @{line}
}
{% endmacro %}
{% macro sums(k) %}
{% set i, highest = "i%d" % (k + 1), degrees[-1] %}
@{R} sum@{k}[@{width}];
@{each("sum%d[e] = %s;" % (k, "row%d[e]" % k if k in degrees else zero), width)}{% if k in degrees %}
row@{k} = &row@{k}[@{columns}];
{% endif %}
{% if k < highest %}
for (int @{i} = @{"i%d" % k if k else "0"}; @{i} < @{n}; ++@{i}) {
{% if k + 1 == highest %}
@{each("sum%d[e] = FMA(x[%s], row%d[e], sum%d[e]);" % (k, i, highest, k), width) | indent(4, true)}    row@{highest} = &row@{highest}[@{columns}];
{% else %}
@{sums(k + 1) | indent(4, true)}@{each("sum%d[e] = FMA(x[%s], sum%d[e], sum%d[e]);" % (k, i, k + 1, k), width) | indent(4, true)}{% endif %}
}
{% endif %}
{% endmacro %}
{% set end = "((%d - first < %d) ? %d - first : %d)" % (values, width, values, width) if values > width else values %}
/* Polynomials in nested form */
static void @{name}(const @{R} *x, const @{R} *table, @{R} *target)
{
    for (int first = 0; first < @{values}; first += @{width}) {
{% for degree, before in begins %}
        const @{R} *row@{degree} = table + first{% if before %} + @{before}{% endif %};
{% endfor %}
@{sums(0) | indent(8, true)}@{each("target[first + e] = sum0[e];", end) | indent(8, true)}    }
}
