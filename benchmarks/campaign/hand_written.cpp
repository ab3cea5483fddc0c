// The limit of a single run: the closed loop of the paper's arm by hand, eight sigma points in one vector and the ninth
// beside it. Reads its numbers from standard input, prints the best nanoseconds a step and what the run did.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
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

int main() {
    auto number = [] { double value; return std::scanf("%lf", &value) == 1 ? value : NAN; };
    const int steps = (int)number(), parts = (int)number();
    const double period = number(), q = number(), r = number(), goal = number();
    double model[5], plant[5], first[5], third[35];
    for (double *values : {model, plant, first}) for (int i = 0; i < 5; ++i) values[i] = number();
    for (double &value : third) value = number();
    std::vector<double> noise(steps);
    for (double &value : noise) value = number();
    double best = INFINITY, highest = 0, peak = 0, squares = 0;
    for (int repetition = 0; repetition < 60; ++repetition) {
        const auto start = std::chrono::steady_clock::now();
        Filter filter;
        double x[4] = {0, 0, 0, 0}, integral = 0, previous = 0;
        highest = -INFINITY, peak = squares = 0;
        for (int k = 0; k < steps; ++k) {
            const double y = x[0] + noise[k];
            filter.correct(y, r);
            if (k) integral += period * (0.5 * (previous + y) - goal);
            previous = y;
            const double w[5] = {filter.x[0], filter.x[1], filter.x[2], filter.x[3], integral};
            double u = 0.0;
            for (int i = 0, n = 0; i < 5; ++i) {
                u += first[i] * w[i];
                for (int j = i; j < 5; ++j)
                    for (int l = j; l < 5; ++l) u += third[n++] * (w[i] * w[j]) * w[l];
            }
            highest = std::max(highest, x[0]), peak = std::max(peak, std::fabs(u));
            squares += (x[0] - goal) * (x[0] - goal);
            filter.predict(u, model, period, q);
            for (int s = 0; s < parts; ++s) advance(x, u, plant, period / parts);
        }
        const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - start;
        best = std::min(best, 1e9 * spent.count() / steps);
    }
    std::printf("%.3f %.17g %.17g %.17g\n", best, highest, peak, squares);
}
