{# The part of the rehearsal that is about stops and starts. #}
enum { EVERY_REASON = @{2 ** (reasons | length) - 1}, LONGEST_UNSEEN = @{longest_unseen} };

/* What a step left says that these reasons are there, and no other; @{NAME}_STOP_SENSOR_LOST too by a sensor that is away. */
static void remember(int reasons)
{
{% if signs_at is not none %}
    state.memory[@{misplaced_at}] = ((reasons & @{NAME}_STOP_BAD_START) != 0) ? @{unity} : @{zero};
    for (int i = 0; i < @{signs}; ++i) {
        state.memory[@{signs_at} + i] = ((reasons & (@{NAME}_STOP_SENSOR_LOST << i)) != 0) ? @{unity} : @{zero};
    }
{% else %}
    state.unseen[@{NAME}_MEASUREMENTS - 1] = ((reasons & @{NAME}_STOP_SENSOR_LOST) != 0) ? LONGEST_UNSEEN + 1 : 0;
{% endif %}
}

/* A start, and a good step, after which nothing speaks against the next one. */
static void good(int stop_on)
{
    param = @{name}_defaults;
    param.stop_on = stop_on;
    param.category = 0;
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
    give();
    expect(step() == @{NAME}_OK, "OK after a start");
    remember(0);
{% if signs_at is not none %}
    state.memory[@{pauses_at}] = 0;
{% endif %}
    expect(@{name}_may_act(&state, &param, @{NAME}_OK, &output) == 1 && output.stop == 0, "power after a good step");
}

/* Which reasons a code and what is remembered are, of those that count: they end the power, and stay. */
static void stops_for(int code, int reasons)
{
    const @{name}_output before = output;
    const int counted = reasons & param.stop_on;
    for (int k = 0; k < 3; ++k) { /* at this sample, and after it, when nothing is wrong any more */
        expect(@{name}_may_act(&state, &param, code, &output) == ((counted == 0) ? 1 : 0), "power where nothing stops the robot");
        expect(output.stop == counted, "why the robot stops");
        for (int i = 0; i < @{NAME}_INPUTS && counted == 0; ++i) {
            expect(output.u[i] >= before.u[i] && output.u[i] <= before.u[i], "an input that a stop does not change");
        }
        code = @{NAME}_OK;
        remember(0);
        for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
            state.unseen[i] = 0;
        }
    }
}

static void reasons(void)
{
    static const int reason_of[@{reason_of | length}][2] = { /* codes of a step, and the reason that each is */
{% for row in reason_of %}
        {@{row[0]}, @{row[1]}}@{"," if not loop.last}
{% endfor %}
    };
    for (int k = 0; k < @{reason_of | length}; ++k) {
        good(EVERY_REASON);
        stops_for(reason_of[k][0], reason_of[k][1]);
        good(EVERY_REASON & ~reason_of[k][1]);
        stops_for(reason_of[k][0], reason_of[k][1]);
        good(reason_of[k][1]);
        stops_for(reason_of[k][0], reason_of[k][1]);
    }
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        for (int k = 0; k < 3; ++k) {
            good(EVERY_REASON);
            state.unseen[i] = (k == 0) ? LONGEST_UNSEEN : LONGEST_UNSEEN + 1;
            stops_for((k == 2) ? @{NAME}_WAITING : @{NAME}_OK, (k == 1) ? @{NAME}_STOP_SENSOR_LOST : 0);
        }
    }
{% if signs_at is not none %}
    for (int bit = @{NAME}_STOP_BAD_START; bit < EVERY_REASON; bit *= 2) {
        for (int k = 0; k < 3; ++k) { /* counted, not counted, and before the first measurement */
            good((k == 1) ? EVERY_REASON - bit : EVERY_REASON);
            remember(bit);
            stops_for((k == 2) ? @{NAME}_WAITING : @{NAME}_OK, (k == 2) ? 0 : bit);
        }
    }
    good(EVERY_REASON);
    state.memory[@{pauses_at}] = @{number(most_pauses)};
    stops_for(@{NAME}_OK, 0);
    state.memory[@{pauses_at}] = @{number(most_pauses)} + @{number(0.0625)};
    stops_for(@{NAME}_OK, @{NAME}_STOP_WRONG_PERIOD);
{% endif %}
    good(EVERY_REASON);
    state.mark ^= 1u; /* as by an overwritten memory */
    expect(@{name}_may_act(&state, &param, @{NAME}_OK, &output) == 0 && output.stop == @{NAME}_STOP_STEP_FAILED, "no power without a start");
    good(EVERY_REASON);
    param = @{name}_defaults;
}

{% if code.rests %}
#ifndef @{NAME}_WITHOUT_REST
{% endif %}
/* Samples of protective stops, as computed elsewhere. */
static void stops(void)
{
    enum { CASES = @{decisions | length}, KEPT = @{stop_size} };
    static const @{name}_real before[CASES][KEPT] = {
@{matrix(decisions | map(attribute="before"))}
    };
    static const @{name}_real after[CASES][KEPT] = {
@{matrix(decisions | map(attribute="after"))}
    };
    static const @{name}_real given[CASES][@{NAME}_INPUTS] = {
@{matrix(decisions | map(attribute="u"))}
    };
    static const @{name}_real acts[CASES][@{NAME}_INPUTS] = {
@{matrix(decisions | map(attribute="acts"))}
    };
{% if signs_at is not none %}
    static const @{name}_real seen[CASES][@{readings.stop - readings.start}] = {
@{matrix(decisions | map(attribute="readings"))}
    };
{% endif %}
    static const int said[CASES][3] = { /* reasons, category, power */
{% for one in decisions %}
        {@{one.reasons}, @{one.category}, @{one.power}}@{"," if not loop.last}
{% endfor %}
    };
    for (int k = 0; k < CASES; ++k) {
        const int failed = ((said[k][0] & @{NAME}_STOP_STEP_FAILED) != 0) ? @{NAME}_STOPPED : @{NAME}_OK;
        const int code = ((said[k][0] & @{NAME}_STOP_WRONG_PERIOD) != 0) ? @{NAME}_BAD_PERIOD : failed;
        expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
        param.category = said[k][1];
        param.stop_on = EVERY_REASON;
        remember(said[k][0]);
        for (int i = 0; i < KEPT; ++i) {
            state.stop[i] = before[k][i];
        }
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            output.u[i] = given[k][i];
        }
{% if signs_at is not none %}
        for (int i = 0; i < @{readings.stop - readings.start}; ++i) {
            state.memory[@{readings.start} + i] = seen[k][i];
        }
{% endif %}
        expect(@{name}_may_act(&state, &param, code, &output) == said[k][2], "power in a stop");
        for (int i = 0; i < KEPT; ++i) {
            expect(near(state.stop[i], after[k][i]), "what is remembered of a stop");
        }
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            expect(near(output.u[i], acts[k][i]), "the input that acts in a stop");
        }
        param = @{name}_defaults;
    }
}
{% if code.rests %}
#endif
{% endif %}

{% if beginnings %}
/* Readings before a start: the robot at rest, and others. */
static const @{name}_real before_start[@{beginnings | length}][@{NAME}_MEASUREMENTS] = {
@{matrix(beginnings | map(attribute="y"))}
};

{% endif %}
static int look_at(int row, int *why)
{
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.y[i] = {% if beginnings %}before_start[row][i]{% else %}first_y[i]{% endif %};
    }
{% if not beginnings %}
    (void)row;
{% endif %}
    *why = -1;
    return @{name}_at_rest(&state, &param, &input, why);
}

/* A robot that rests may be started after some samples, which begin anew where a reading is missing. */
static void looks(void)
{
    enum { SAMPLES = @{looks} };
    int why;
    for (int k = 0; k <= @{NAME}_MEASUREMENTS; ++k) {
        state.looks = SAMPLES; /* as before a start elsewhere */
        expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
        give();
        for (int anew = 0; anew < 2; ++anew) {
            for (int j = 1; j < SAMPLES; ++j) {
                expect(look_at(0, &why) == @{NAME}_WAITING && why == 0, "WAITING until readings were looked at");
            }
            for (int j = 0; j < 2 && anew == 1; ++j) {
                expect(look_at(0, &why) == @{NAME}_OK && why == @{0 if checkable else NAME ~ "_START_NOT_CHECKED"}, "OK where the robot rests");
            }
            give();
            input.measured = (k < @{NAME}_MEASUREMENTS) ? 1 : 0;
            input.y[k % @{NAME}_MEASUREMENTS] = (k < @{NAME}_MEASUREMENTS) ? (@{name}_real)NAN : first_y[0];
            expect(@{name}_at_rest(&state, &param, &input, &why) == @{NAME}_WAITING && why == @{NAME}_START_MISSING, "a reading that is missing");
            give();
        }
    }
{% if beginnings %}
{% if start_twists %}
#ifndef @{NAME}_WITHOUT_REST
{% endif %}
    {
        static const int said[@{beginnings | length}][2] = { /* whether the robot at rest was looked at before, and what is wrong */
{% for one in beginnings %}
            {@{one.looked}, @{one.why}}@{"," if not loop.last}
{% endfor %}
        };
        for (int k = 0; k < @{beginnings | length}; ++k) {
            const int waits = (said[k][0] + 1 < SAMPLES) ? @{NAME}_WAITING : @{NAME}_OK;
            int code;
            expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
            if (said[k][0] != 0) {
                (void)look_at(0, &why);
            }
            code = look_at(k, &why);
            expect(code == ((said[k][1] == 0) ? waits : @{NAME}_BAD_START), "BAD_START where a reading is wrong");
            expect(code == @{NAME}_OK || why == said[k][1], "what is wrong with a start");
            expect(state.looks == ((said[k][1] == 0) ? said[k][0] + 1 : 0), "looks that begin anew");
        }
    }
{% if start_twists %}
#endif
{% endif %}
{% endif %}
    give();
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
}
