{% import "turning.c" as turning with context %}
/* void name(x, sine, cosine), or with one result, of a row of lanes: as the functions ones of a number */
static void @{name}(const @{R} *RESTRICT x{% for of_cosine in ones %}, @{R} *RESTRICT @{"cosine" if of_cosine else "sine"}{% endfor %})
{
    int far = 0;
    for (int l = 0; l < @{lanes}; ++l) {
@{turning.statements("x[l]", begins) | indent(8, true) | replace("        #", "#")}    }
    for (int l = 0; l < @{lanes}; ++l) {
        far += (fabs@{f}(x[l]) <= @{reach[false]}) ? 0 : 1;
    }
    if (far > 0) {
        for (int l = 0; l < @{lanes}; ++l) {
{% for of_cosine, one_of in ones.items() %}
            @{"cosine" if of_cosine else "sine"}[l] = @{one_of}(x[l]);
{% endfor %}
        }
    }
}
