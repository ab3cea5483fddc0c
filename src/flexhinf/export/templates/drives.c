{# What main.c and the templates do about their drives. #}
{% macro begin_with() %}
/* @{name}_init, unless header and source are of two exports: nothing may act where it does not return
 * @{NAME}_OK. The robot must be where @{name}.h says; where it is elsewhere, call @{name}_start behind this. */
static int begin_with(@{name}_state *memory)
{
    return (strcmp(@{name}_digest, @{NAME}_DIGEST) == 0) ? @{name}_init(memory) : @{NAME}_NOT_INITIALISED;
}
{% endmacro %}

{# How they begin when drives become enabled: at rest where the links are measured, or as it is designed. #}
{% macro begin_here() %}
/* 1 of a recorded robot: its drives are enabled at once, it is where @{name}.h says, and nothing stops it. */
#ifndef @{NAME}_ENABLED
#define @{NAME}_ENABLED 0
#endif

{% if links is none %}
/* When the drives become enabled, as at first: the robot must be where @{name}.h says. Whether that is done: not before it is measured. */
{% else %}
/* When the drives become enabled: the robot rests where it is measured, and the command is that. Whether that is done: not before it is measured. */
{% endif %}
static int begin_here(@{name}_input *input, @{name}_output *output)
{
    const int measured = input->measured;
{% if links is none %}
    if (begin_with(&state) != @{NAME}_OK) {
        return 0;
    }
    @{rest_at_home("input->r" | safe)} /* the command until there is another */
{% else %}
    @{name}_real rest[@{NAME}_STATES + @{NAME}_INPUTS] = {0};
    static const int links[] = {@{links | join(", ")}}; /* which measurements are the links' positions */
    for (int i = 0; i < @{links | length}; ++i) {
        rest[i] = input->y[links[i]];
    }
    if (measured == 0 || @{name}_rest(&@{name}_defaults, rest, rest) != @{NAME}_OK ||
        @{name}_start(&state, &@{name}_defaults, rest, rest + @{NAME}_STATES) != @{NAME}_OK) {
        return 0;
    }
{% if code.rests %}
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        input->r[i] = rest[i];
    }
{% else %}
{% for place in tracked %}
    input->r[@{loop.index0}] = rest[@{place}];
{% endfor %}
{% endif %}
{% endif %}
    input->measured = 0; /* the input before the first sample */
    (void)@{name}_step(&state, &@{name}_defaults, input, output);
    input->measured = measured;
    return 1;
}

/* Whether the drives are enabled and it has begun there; until then, what is computed is not heard. It looks for @{look} s
 * whether the robot rests where it can begin: enable the drives after that. */
static int still_enabled(int enabled, @{name}_input *input, @{name}_output *output)
{
    int now = enabled, why = 0;
    if (now == 0 && @{name}_at_rest(&state, &@{name}_defaults, input, &why) == @{NAME}_OK && drives_enabled() != 0) {
        now = begin_here(input, output);
    } else if (now != 0) {
        now = (drives_enabled() != 0) ? 1 : 0;
    } else {
        refused(why);
    }
    return now;
}

/* Whether drives hear what is computed, so that @{name}_may_act decides: with them off, an arm that is turned by hand stops
 * nothing. A stop that has begun goes on. */
static int is_heard(int enabled, const @{name}_output *output)
{
    return (@{NAME}_ENABLED == 0 && (enabled != 0 || output->stop != 0)) ? 1 : 0;
}
{% endmacro %}

{# The statement that makes a command rest at `home`. #}
{% macro rest_at_home(r) %}
{% if code.rests %}
@{name}_rest(&@{name}_defaults, home, @{r});
{%- else %}
for (int i = 0; i < @{NAME}_COMMANDS; ++i) { @{r}[i] = home[i]; }
{%- endif %}
{% endmacro %}
