{# Every number is a variable, which a register holds. The weight goes with the row; of a symmetric sum with the larger
   index, as on and left of the diagonal. #}
{% set w, r = ("w" if weighted else "l"), ("l" if symmetric else "r") %}
{% macro ahead(place, number) %}@{place}{% if number %} + @{number}{% endif %}{% endmacro %}
{% macro given() %}
{% if not symmetric %}const @{R} *right, {% endif -%}
{% if weighted %}const @{R} *weights, {% endif -%}
{% if added %}const @{R} *plus, {% endif -%}
{% endmacro %}
/* sum_k w_k l_k^T r_k + plus of a few rows and columns, with a variable for each sum */
static void @{name}(const @{R} *left, @{given()}@{R} *target, int count)
{
{% for i, j in places %}
    @{R} sum@{i}@{j} = @{zero};
{% endfor %}
    for (int k = 0; k < count; ++k) {
{% for i in range(rows) %}
        const @{R} l@{i} = left[@{ahead("%d * k" % rows, i)}];
{% endfor %}
{% for i in range(rows if weighted else 0) %}
        const @{R} w@{i} = l@{i} * weights[k];
{% endfor %}
{% for j in range(0 if symmetric else columns) %}
        const @{R} r@{j} = right[@{ahead("%d * k" % columns, j)}];
{% endfor %}
{% for i, j in places %}
        sum@{i}@{j} = FMA(@{w}@{j if symmetric else i}, @{r}@{i if symmetric else j}, sum@{i}@{j});
{% endfor %}
    }
{% for i, j in places %}
    target[@{i * columns + j}] = sum@{i}@{j}{% if added %} + plus[@{i * columns + j}]{% endif %};
{% if symmetric and j > i %}
    target[@{j * columns + i}] = target[@{i * columns + j}];
{% endif %}
{% endfor %}
}
