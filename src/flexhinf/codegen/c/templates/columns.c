{# Columns that are `neighbours` in memory are copied row by row, unless there are too few. #}
{% macro copied(across, line) %}
for (int l = 0; l < @{lanes if read else "left"}; ++l) {
    for (int i = 0; i < count; ++i) {
        @{line(across)}
    }
}
{% endmacro %}
{% macro line(across) %}
{% if read %}
rows[i * @{lanes} + l] = matrix[i * along + @{across}];
{%- else %}
matrix[i * along + @{across}] = rows[i * @{lanes} + l];
{%- endif %}
{% endmacro %}
{% set single = "(l < left ? l : left - 1) * across" if read else "l * across" %}
/* Copy some columns of a matrix to rows of lanes, the last one again where there are too few; or back */
{% if read %}
static NOINLINE void @{name}(const @{R} *RESTRICT matrix, @{R} *RESTRICT rows, int count, int along, int across, int left)
{% else %}
static NOINLINE void @{name}(@{R} *RESTRICT matrix, const @{R} *RESTRICT rows, int count, int along, int across, int left)
{% endif %}
{
{% if neighbours %}
    if (left < @{lanes}) {
@{copied(single, line) | indent(8, true)}    } else {
        for (int i = 0; i < count; ++i) {
            for (int l = 0; l < @{lanes}; ++l) {
                @{line("l")}
            }
        }
    }
{% else %}
@{copied(single, line) | indent(4, true)}{% endif %}
}
