/* sin or cos in @{R} */
static @{R} @{name}(@{R} x)
{
{% if of_cosine %}
    return @{turned}(fabsf(x), 1u);
{% else %}
    return @{turned}(fabsf(x), 0u) * copysignf(1.0f, x);
{% endif %}
}
