// The limit of a single run: the closed loop of the paper's arm by hand, eight sigma points in one vector and the ninth
// beside it. Reads its numbers from standard input. Prints the least processor time of a step, ns, of the loop alone,
// with its noise given and no signal kept, and of a whole run, which draws the noise and keeps all signals; and what the
// run did.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <memory>
#include <vector>

typedef double Wide __attribute__((vector_size(64)));
typedef long long Bits __attribute__((vector_size(64)));

static inline double sine(double x) { return std::sin(x); }

// Within half a turn of the nearest multiple of pi: sin x = (-1)^k sin(x - k pi), an odd polynomial of degree 17.
static inline Wide sine(Wide x) {
    const double rounder = 6755399441055744.0;
    const Wide shifted = x * 0.31830988618379067 + rounder, k = shifted - rounder;
    const Wide r = (x - k * 3.141592653589793) - k * 1.2246467991473532e-16, s = r * r;
    Wide p = s * 2.8114572543455206e-15 - 7.6471637318198164e-13;
    p = p * s + 1.6059043836821613e-10;
    p = p * s - 2.5052108385441720e-08;
    p = p * s + 2.7557319223985893e-06;
    p = p * s - 1.9841269841269841e-04;
    p = p * s + 8.3333333333333332e-03;
    p = p * s - 1.6666666666666666e-01;
    Bits sign;
    std::memcpy(&sign, &shifted, sizeof sign);
    const Wide found = r + r * s * p;
    Bits bits;
    std::memcpy(&bits, &found, sizeof bits);
    bits ^= sign << 63;
    Wide result;
    std::memcpy(&result, &bits, sizeof result);
    return result;
}

template <class T> static inline void advance(T x[4], double u, const double p[5], double h) {
    T k[4][4], at[4];
    for (int s = 0; s < 4; ++s) {
        const double reach = s == 0 ? 0.0 : s == 3 ? h : 0.5 * h;
        for (int i = 0; i < 4; ++i) at[i] = s ? x[i] + reach * k[s - 1][i] : x[i];
        const T spring = at[0] - at[2];
        k[s][0] = at[1];
        k[s][1] = -p[0] * sine(at[0]) - p[1] * spring;
        k[s][2] = at[3];
        k[s][3] = p[2] * spring + p[3] * u - p[4] * at[3];
    }
    for (int i = 0; i < 4; ++i) x[i] += h / 6.0 * (k[0][i] + 2.0 * (k[1][i] + k[2][i]) + k[3][i]);
}

static inline double total(Wide v) {
    double sum = 0.0;
    for (int i = 0; i < 8; ++i) sum += v[i];
    return sum;
}

struct Filter {
    double x[4] = {0, 0, 0, 0}, P[4][4] = {{1e-4}, {0, 1e-4}, {0, 0, 1e-4}, {0, 0, 0, 1e-4}};

    void points(Wide X[4]) const {  // x plus and minus 2 L
        double L[4][4] = {};
        for (int j = 0; j < 4; ++j) {
            double d = P[j][j];
            for (int k = 0; k < j; ++k) d -= L[j][k] * L[j][k];
            L[j][j] = std::sqrt(d);
            const double inverse = 1.0 / L[j][j];
            for (int i = j + 1; i < 4; ++i) {
                double c = P[i][j];
                for (int k = 0; k < j; ++k) c -= L[i][k] * L[j][k];
                L[i][j] = c * inverse;
            }
        }
        for (int i = 0; i < 4; ++i) {
            const double a = 2 * L[i][0], b = 2 * L[i][1], c = 2 * L[i][2], d = 2 * L[i][3];
            X[i] = x[i] + Wide{a, b, c, d, -a, -b, -c, -d};
        }
    }

    void correct(double y, double r) {  // the output is the first state: the sums over points are columns of P
        const double innovation = y - x[0], spread = P[0][0] + r;
        double gain[4];
        for (int i = 0; i < 4; ++i) gain[i] = P[i][0] / spread;
        for (int i = 0; i < 4; ++i) {
            x[i] += gain[i] * innovation;
            for (int j = 0; j <= i; ++j) P[i][j] -= gain[i] * gain[j] * spread;
        }
    }

    void predict(double u, const double p[5], double h, double q) {
        Wide X[4];
        points(X);
        double centre[4] = {x[0], x[1], x[2], x[3]};
        advance(X, u, p, h);
        advance(centre, u, p, h);
        for (int i = 0; i < 4; ++i) {
            x[i] = 0.125 * total(X[i]);
            X[i] = X[i] - x[i];
            centre[i] -= x[i];
        }
        for (int i = 0; i < 4; ++i)
            for (int j = 0; j <= i; ++j)
                P[i][j] = 0.125 * total(X[i] * X[j]) + 2.0 * centre[i] * centre[j] + (i == j ? q : 0.0);
    }
};

// A number of N(0, 1): Philox4x32-10 of (step, 0, 0, 0) with a key of zeros, and Box and Muller's transform.
static inline double normal(uint32_t step) {
    uint32_t c[4] = {step, 0, 0, 0}, key[2] = {0, 0};
    for (int round = 0; round < 10; ++round) {
        const uint64_t low = 0xD2511F53ull * c[0], high = 0xCD9E8D57ull * c[2];
        const uint32_t next[4] = {(uint32_t)(high >> 32) ^ c[1] ^ key[0], (uint32_t)high,
                                  (uint32_t)(low >> 32) ^ c[3] ^ key[1], (uint32_t)low};
        std::memcpy(c, next, sizeof c);
        key[0] += 0x9E3779B9u, key[1] += 0xBB67AE85u;
    }
    const auto uniform = [](uint64_t high, uint64_t low) { return (double)(((high << 21) ^ (low >> 11)) + 1) * 0x1p-53; };
    return std::sqrt(-2.0 * std::log(uniform(c[0], c[1]))) * std::cos(6.283185307179586 * uniform(c[2], c[3]));
}

struct Task {
    int steps, parts;
    double period, q, r, goal, deviation, model[5], plant[5], first[5], third[35];
    std::vector<double> noise;
};

struct Result {
    double highest = -INFINITY, peak = 0, squares = 0;
};

// Time, command, disturbances (2), measurement, input, estimate (4) and state (4) of every sample, in fresh memory.
struct Signals {
    std::unique_ptr<double[]> memory;
    double *time, *command, *load, *measured, *input, *estimate, *state;

    explicit Signals(size_t n) : memory(new double[14 * n]) {
        double *at = memory.get();
        time = at, command = at + n, load = at + 2 * n, measured = at + 4 * n, input = at + 5 * n;
        estimate = at + 6 * n, state = at + 10 * n;
    }
};

template <bool whole> static Result simulate(const Task &t, Signals *kept) {
    Filter filter;
    Result found;
    double x[4] = {0, 0, 0, 0}, integral = 0, previous = 0;
    for (int k = 0; k < t.steps; ++k) {
        const double y = x[0] + (whole ? t.deviation * normal(k) : t.noise[k]);
        filter.correct(y, t.r);
        if (k) integral += t.period * (0.5 * (previous + y) - t.goal);
        previous = y;
        const double w[5] = {filter.x[0], filter.x[1], filter.x[2], filter.x[3], integral};
        double u = 0.0;
        for (int i = 0, n = 0; i < 5; ++i) {
            u += t.first[i] * w[i];
            for (int j = i; j < 5; ++j)
                for (int l = j; l < 5; ++l) u += t.third[n++] * (w[i] * w[j]) * w[l];
        }
        found.highest = std::max(found.highest, x[0]), found.peak = std::max(found.peak, std::fabs(u));
        found.squares += (x[0] - t.goal) * (x[0] - t.goal);
        if (whole) {
            kept->time[k] = k * t.period, kept->command[k] = t.goal, kept->measured[k] = y, kept->input[k] = u;
            kept->load[2 * k] = kept->load[2 * k + 1] = 0.0;
            std::memcpy(kept->estimate + 4 * k, filter.x, sizeof x);
            std::memcpy(kept->state + 4 * k, x, sizeof x);
        }
        filter.predict(u, t.model, t.period, t.q);
        for (int s = 0; s < t.parts; ++s) advance(x, u, t.plant, t.period / t.parts);
    }
    return found;
}

static double seconds() {
    timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

int main() {
    auto number = [] { double value; return std::scanf("%lf", &value) == 1 ? value : NAN; };
    Task t;
    t.steps = (int)number(), t.parts = (int)number();
    for (double *value : {&t.period, &t.q, &t.r, &t.goal, &t.deviation}) *value = number();
    for (double *values : {t.model, t.plant, t.first}) for (int i = 0; i < 5; ++i) values[i] = number();
    for (double &value : t.third) value = number();
    t.noise.resize(t.steps);
    for (double &value : t.noise) value = number();
    double alone = INFINITY, whole = INFINITY;
    Result found, other;
    for (int repetition = 0; repetition < 20; ++repetition) {
        double start = seconds();
        found = simulate<false>(t, nullptr);
        alone = std::min(alone, seconds() - start);
        start = seconds();
        Signals kept(t.steps);
        other = simulate<true>(t, &kept);
        whole = std::min(whole, seconds() - start);
    }
    std::printf("%.3f %.3f\n", 1e9 * alone / t.steps, 1e9 * whole / t.steps);
    for (const Result &r : {found, other}) std::printf("%.17g %.17g %.17g\n", r.highest, r.peak, r.squares);
}
