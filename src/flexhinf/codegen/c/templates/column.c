/* Copy one column of a matrix, along apart, to contiguous memory; or back */
{% if read %}
static void @{name}(const @{R} *matrix, @{R} *column, int count, int along)
{
    for (int i = 0; i < count; ++i) {
        column[i] = matrix[i * along];
    }
}
{% else %}
static void @{name}(@{R} *matrix, const @{R} *column, int count, int along)
{
    for (int i = 0; i < count; ++i) {
        matrix[i * along] = column[i];
    }
}
{% endif %}
