{# Every number is a variable, which a register holds. #}
/* L^T of A = L L^T of a small matrix, with a variable for each number */
static void @{name}(const @{R} *source, @{R} *target)
{
{% for i in range(n) %}
{% for j in range(i, n) %}
    @{R} a@{i}@{j} = source[@{i * n + j}];
{% endfor %}
{% endfor %}
{% for i in range(n) %}
    @{R} moved@{i} = fabs@{f}(a@{i}@{i});
{% endfor %}
{% for i in range(n) %}
    const @{R} least@{i} = @{tolerance} * moved@{i};
{% endfor %}
{% for j in range(n) %}
    const @{R} inverse@{j} = (a@{j}@{j} <= least@{j} && a@{j}@{j} >= -@{tolerance} * moved@{j}) ? @{zero} : @{one} / sqrt@{f}(a@{j}@{j});
{% for i in range(j, n) %}
    a@{j}@{i} *= inverse@{j};
{% endfor %}
{% for i in range(j + 1, n) %}
    const @{R} ratio@{j}@{i} = a@{j}@{i} * inverse@{j};
    moved@{i} = FMA(ratio@{j}@{i} * ratio@{j}@{i}, moved@{j}, moved@{i});
{% endfor %}
{% for k in range(j + 1, n) %}
{% for i in range(k, n) %}
    a@{k}@{i} = FMA(-a@{j}@{k}, a@{j}@{i}, a@{k}@{i});
{% endfor %}
{% endfor %}
{% endfor %}
{% for i in range(n) %}
{% for j in range(n) %}
    target[@{i * n + j}] = {% if j >= i %}a@{i}@{j}{% else %}@{zero}{% endif %};
{% endfor %}
{% endfor %}
}
