/* Records what @{name} answers to the rows of its test vector, at an export: it is not shipped. */
#include "@{name}.h"

#include <math.h>
#include <stdio.h>

{% include "given.c" %}

static FILE *answers;

static void say(double number)
{
    (void)fwrite(&number, sizeof number, 1, answers);
}

static void say_all(int code)
{
    say(code);
    say(output.status);
    say((double)output.path_rate);
    say({% if code.doubt is not none %}output.doubtful{% else %}0{% endif %});
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        say(output.unseen[i]);
        say({% if code.rejected is not none %}output.rejected[i]{% else %}0{% endif %});
    }
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        say((double)output.u[i]);
    }
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        say((double)output.estimate[i]);
    }
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        say((double)state.memory[i]);
    }
}

int rehearse(void);

int main(void)
{
    answers = fopen("answers", "wb");
    param = @{name}_defaults;
    if (answers == NULL || @{name}_init(&state) != @{NAME}_OK) {
        printf("flags of the compiler change results\n");
        return 1;
    }
    for (int row = 0; row < ROWS; ++row) {
        if (row == BEGUN) {
            provoke();
        }
        say_all(step(row));
    }
    if (fclose(answers) != 0) {
        return 1;
    }
    (void)rehearse();
    return 0;
}
