#define VIBRATIONS @{NAME}_VIBRATIONS

/* Eigenvalues of a symmetric matrix, on its diagonal after ten sweeps of Jacobi's turns. */
static void make_diagonal(double a[VIBRATIONS][VIBRATIONS])
{
    for (int sweep = 0; sweep < 10; ++sweep) {
        for (int p = 0; p + 1 < VIBRATIONS; ++p) {
            for (int q = p + 1; q < VIBRATIONS; ++q) {
                const double ratio = fabs(a[p][q]) > 0.0 ? (a[q][q] - a[p][p]) / (2.0 * a[p][q]) : INFINITY;
                const double tangent = copysign(1.0, ratio) / (fabs(ratio) + sqrt(ratio * ratio + 1.0));
                const double cosine = 1.0 / sqrt(tangent * tangent + 1.0);
                const double sine = tangent * cosine;
                for (int k = 0; k < VIBRATIONS; ++k) {
                    const double left = a[k][p];
                    const double right = a[k][q];
                    a[k][p] = cosine * left - sine * right;
                    a[k][q] = sine * left + cosine * right;
                }
                for (int k = 0; k < VIBRATIONS; ++k) {
                    const double above = a[p][k];
                    const double below = a[q][k];
                    a[p][k] = cosine * above - sine * below;
                    a[q][k] = sine * above + cosine * below;
                }
            }
        }
    }
}

/* Periods of the vibrations of the links at a pose while the motors are held, in samples, the longest first.
 * Returns 1 where one is longer than what is kept of the path, or where the springs do not hold the links.
 */
static int periods_at(const double *pose, double *periods)
{
    double mass[VIBRATIONS * VIBRATIONS];
    double stiffness[VIBRATIONS * VIBRATIONS];
    double lower[VIBRATIONS][VIBRATIONS] = {{0.0}};
    double a[VIBRATIONS][VIBRATIONS];
    int slow = 0;
    @{matrices}(@{matrices_arguments});
    for (int i = 0; i < VIBRATIONS; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = mass[i + j * VIBRATIONS];
            for (int k = 0; k < j; ++k) {
                sum -= lower[i][k] * lower[j][k];
            }
            lower[i][j] = i == j ? sqrt(sum) : sum / lower[j][j];
        }
    }
    /* the stiffness divided by the factor of the mass, from both sides */
    for (int j = 0; j < VIBRATIONS; ++j) {
        for (int i = 0; i < VIBRATIONS; ++i) {
            double sum = stiffness[i + j * VIBRATIONS];
            for (int k = 0; k < i; ++k) {
                sum -= lower[i][k] * a[k][j];
            }
            a[i][j] = sum / lower[i][i];
        }
    }
    for (int i = 0; i < VIBRATIONS; ++i) {
        for (int j = 0; j < VIBRATIONS; ++j) {
            for (int k = 0; k < j; ++k) {
                a[i][j] -= lower[j][k] * a[i][k];
            }
            a[i][j] /= lower[j][j];
        }
    }
    make_diagonal(a);
    for (int i = 0; i < VIBRATIONS; ++i) {
        const double longest = @{NAME}_KEPT - 2.0;
        double period = a[i][i] > 0.0 ? @{turn} / sqrt(a[i][i]) : INFINITY;
        int place = i;
        if (!(period <= longest)) {
            period = longest;
            slow = 1;
        }
        while (place > 0 && periods[place - 1] < period) {
            periods[place] = periods[place - 1];
            --place;
        }
        periods[place] = period;
    }
    return slow;
}

/* A row later by a number of samples, between two that are kept. */
static double later(double kept[@{NAME}_KEPT][@{NAME}_JOINTS], int newest, int joint, double by)
{
    const int whole = (int)by;
    const double part = by - whole;
    const int after = (newest - whole + @{NAME}_KEPT) % @{NAME}_KEPT;
    const int before = (after + @{NAME}_KEPT - 1) % @{NAME}_KEPT;
    return (1.0 - part) * kept[after][joint] + part * kept[before][joint];
}

/* The newest row of the path through one filter for each vibration. */
static void filtered(double kept[VIBRATIONS][@{NAME}_KEPT][@{NAME}_JOINTS], const @{name}_state *state,
                     const double *periods, double *row)
{
    const int newest = state->latest;
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        row[j] = state->streamed[j];
        for (int i = 0; i < VIBRATIONS; ++i) {
            kept[i][newest][j] = row[j];
            row[j] = (row[j] + 2.0 * later(kept[i], newest, j, 0.5 * periods[i]) + later(kept[i], newest, j, periods[i]))
                     / 4.0;
        }
    }
}

/* Periods are those of a first pass, as the arm is later than its path. Returns 1 where one was cut. */
static int shape(@{name}_state *state, double *shaped)
{
    double periods[VIBRATIONS];
    state->latest = (state->latest + 1) % @{NAME}_KEPT;
    int slow = periods_at(state->streamed, periods);
    filtered(state->first_pass, state, periods, shaped);
    slow |= periods_at(shaped, periods);
    filtered(state->second_pass, state, periods, shaped);
    return slow;
}

static void start_shaper(@{name}_state *state, const double *path)
{
    state->latest = 0;
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        state->streamed[j] = path[j];
        for (int i = 0; i < VIBRATIONS; ++i) {
            for (int k = 0; k < @{NAME}_KEPT; ++k) {
                state->first_pass[i][k][j] = path[j];
                state->second_pass[i][k][j] = path[j];
            }
        }
    }
}
