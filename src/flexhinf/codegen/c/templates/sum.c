{# Rows, columns and terms of a sum go together: what is loaded serves all of them. There are at least `tall` rows and
   `wide` columns that do: compilers make vectors of loops of that many. The last of them are then computed again with
   those before, so that none is left over; `plus` must not be the target. One and one set no condition. #}
{% set width = wide if wide > 1 else "((columns - j < %d) ? columns - j : %d)" % (WIDE, WIDE) %}
{% macro ahead(place, number) %}@{place}{% if number %} + @{number}{% endif %}{% endmacro %}
{% macro last(first, end, together) %}
{% if together > 1 %}(@{end} - @{first} < @{together}) ? @{end} - @{together} : @{first}{% else %}@{first}{% endif %}
{% endmacro %}
{% macro terms(count) %}
const @{R} *value = right + k * columns + j;
{% for k in range(count) %}
{% set weight = " * weights[%s]" % ahead("k", k) if weighted else "" %}
{% for a in range(tall) %}
const @{R} factor@{a}@{k} = left[@{"(k + %d)" % k if k else "k"} * rows + @{ahead("first", a)}]@{weight};
{% endfor %}
{% endfor %}
for (int e = 0; e < @{width}; ++e) {
{% for a in range(tall) %}
{% set total = namespace(text="part[%d][e]" % a) %}
{% for k in range(count) %}
{% set place = "%d * columns + e" % k if k > 1 else "columns + e" if k else "e" %}
{% set total.text = "FMA(factor%d%d, value[%s], %s)" % (a, k, place, total.text) %}
{% endfor %}
    part[@{a}][e] = @{total.text};
{% endfor %}
}
{% endmacro %}
{% macro given() %}
{% if weighted %}const @{R} *weights, {% endif -%}
{% if added %}const @{R} *plus, {% endif -%}
{% endmacro %}
/* sum_k w_k l_k^T r_k + plus of (count, rows) and (count, columns) */
static NOINLINE void @{name}(const @{R} *left, const @{R} *right, @{given()}@{R} *target, int count, int rows, int columns)
{
    for (int block = 0; block < columns; block += @{WIDE}) {
        const int j = @{last("block", "columns", wide)};
        for (int band = @{"block" if symmetric else "0"}; band < rows; band += @{tall}) {
            const int first = @{last("band", "rows", tall)};
            @{R} part[@{tall}][@{WIDE}] = { 0 };
            for (int k = 0; k + @{TERMS} <= count; k += @{TERMS}) {
@{terms(TERMS) | indent(16, true)}            }
            for (int k = count - count % @{TERMS}; k < count; ++k) {
@{terms(1) | indent(16, true)}            }
            for (int i = first; i < first + @{tall}; ++i) {
                for (int e = 0; e < @{width}; ++e) {
                    target[i * columns + j + e] = part[i - first][e]{% if added %} + plus[i * columns + j + e]{% endif %};
                }
            }
        }
    }
{% if symmetric %}
    for (int i = 0; i < rows; ++i) {
        for (int j = 0; j < i; ++j) {
            target[j * columns + i] = target[i * columns + j];
        }
    }
{% endif %}
}
