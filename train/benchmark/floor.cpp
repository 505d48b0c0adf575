// What learning would take, were it all in one program: PI^BB with homogeneous noise and control cost on via-points in the plane.
//
// Reads numbers from the standard input: K, T, dt, N, updates, repeats, eliteness, control weight, mean decay floor; then for each
// component the Gaussian (log scale, center of 2, root of the precision of 4, by rows) and its start (A of 4, b of 2) with the
// standard deviations of A and b (4 and 2); then the start of the motion, the goal, the number of via-points and these.
// Prints the seconds of one pass over N roll-outs, those of one learning run, the sum of the last states of the pass
// (for a test), and the costs before and after learning.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <iostream>
#include <random>
#include <vector>

using Numbers = std::vector<double>;
using Clock = std::chrono::steady_clock;

static const double VAST = 1e300;  // -ffast-math knows no infinity
static int K, T, N, n_updates, n_repeats, n_via;
static double dt, eliteness, weight, least;
static Numbers gauss, start, spread, via;  // 7 a component, 6 a component, 6 a component, 2 a point
static double x0[2], goal[2];

// One roll-out with parameters p (A 4, b 2 for each component); writes states 2 (T+1), velocities 2 T and features 3 K T.
static void roll(const double* p, double* x, double* v, double* g) {
    std::vector<double> h(K);
    x[0] = x0[0], x[1] = x0[1];
    for (int t = 0; t < T; ++t, x += 2, v += 2, g += 3 * K) {
        double highest = -VAST, total = 0;
        for (int k = 0; k < K; ++k) {
            const double* q = &gauss[7 * k];
            const double a = x[0] - q[1], b = x[1] - q[2];
            const double u = q[3] * a + q[4] * b, w = q[5] * a + q[6] * b;
            h[k] = q[0] - 0.5 * (u * u + w * w);
            highest = std::max(highest, h[k]);
        }
        for (int k = 0; k < K; ++k) total += h[k] = std::exp(h[k] - highest);
        double v0 = 0, v1 = 0;
        for (int k = 0; k < K; ++k) {
            const double* e = p + 6 * k;
            const double share = h[k] / total;
            v0 += share * (e[0] * x[0] + e[1] * x[1] + e[4]);
            v1 += share * (e[2] * x[0] + e[3] * x[1] + e[5]);
            g[3 * k] = share * x[0], g[3 * k + 1] = share * x[1], g[3 * k + 2] = share;
        }
        v[0] = v0, v[1] = v1;
        x[2] = x[0] + dt * v0, x[3] = x[1] + dt * v1;
    }
}

static double square(double a, double b) { return a * a + b * b; }

static double task_cost(const double* x, const double* v) {
    double cost = square(x[2 * T] - goal[0], x[2 * T + 1] - goal[1]);
    for (int l = 0; l < n_via; ++l) {
        double nearest = VAST;
        for (int t = 0; t <= T; ++t)
            nearest = std::min(nearest, square(x[2 * t] - via[2 * l], x[2 * t + 1] - via[2 * l + 1]));
        cost += nearest;
    }
    for (int t = 1; t < T; ++t) cost += 1e-4 * std::sqrt(square(v[2 * t] - v[2 * t - 2], v[2 * t + 1] - v[2 * t - 1]));
    return cost;
}

// Half the sum of Upsilon over time, one output row after the other.
static double control_cost(const double* now, const double* noise, const double* g) {
    double cost = 0;
    for (int i = 0; i < 6 * K; ++i) cost += 0.5 * weight * T * (now[i] - start[i]) * (now[i] - start[i]);
    for (int t = 0; t < T; ++t, g += 3 * K) {
        double size = 0;
        for (int f = 0; f < 3 * K; ++f) size += g[f] * g[f];
        for (int o = 0; o < 2; ++o) {
            double drift = 0, push = 0;
            for (int k = 0; k < K; ++k)
                for (int d = 0; d < 3; ++d) {
                    const int i = 6 * k + (d < 2 ? 2 * o + d : 4 + o);
                    drift += (now[i] - start[i]) * g[3 * k + d], push += noise[i] * g[3 * k + d];
                }
            cost += 0.5 * weight * (2 * drift + push) * push / size;
        }
    }
    return cost;
}

static Numbers learn(double& before, double& after) {
    std::mt19937_64 random(0);
    std::normal_distribution<double> normal;
    const int P = 6 * K;
    Numbers now = start, tried(P), noise(N * P), cost(N), x(2 * (T + 1)), v(2 * T), g(3 * K * T);
    roll(now.data(), x.data(), v.data(), g.data());
    before = task_cost(x.data(), v.data());
    for (int u = 1; u <= n_updates; ++u) {
        const double lr = std::sqrt(std::max(1.0 / u, least));
        for (int n = 0; n < N; ++n) {
            double* e = &noise[n * P];
            for (int i = 0; i < P; ++i) tried[i] = now[i] + (e[i] = lr * spread[i] * normal(random));
            roll(tried.data(), x.data(), v.data(), g.data());
            cost[n] = task_cost(x.data(), v.data()) + control_cost(now.data(), e, g.data());
        }
        const auto [low, high] = std::minmax_element(cost.begin(), cost.end());
        const double base = *low, range = std::max(*high - *low, 1e-300);
        double total = 0;
        for (double& c : cost) total += c = std::exp(-eliteness * (c - base) / range);
        for (int n = 0; n < N; ++n)
            for (int i = 0; i < P; ++i) now[i] += cost[n] / total * noise[n * P + i];
        roll(now.data(), x.data(), v.data(), g.data());  // the evaluation after each update
        after = task_cost(x.data(), v.data());
    }
    return now;
}

static double seconds(Clock::time_point begun) { return std::chrono::duration<double>(Clock::now() - begun).count(); }

int main() {
    std::cin >> K >> T >> dt >> N >> n_updates >> n_repeats >> eliteness >> weight >> least;
    gauss.resize(7 * K), start.resize(6 * K), spread.resize(6 * K);
    for (int k = 0; k < K; ++k) {
        for (int i = 0; i < 7; ++i) std::cin >> gauss[7 * k + i];
        for (int i = 0; i < 6; ++i) std::cin >> start[6 * k + i];
        for (int i = 0; i < 6; ++i) std::cin >> spread[6 * k + i];
    }
    std::cin >> x0[0] >> x0[1] >> goal[0] >> goal[1] >> n_via;
    via.resize(2 * n_via);
    for (double& number : via) std::cin >> number;
    if (!std::cin) return 1;

    Numbers x(2 * (T + 1) * N), v(2 * T * N), g(3 * K * T * N), passes, runs;
    double ends = 0, before = 0, after = 0;
    for (int r = 0; r < n_repeats; ++r) {
        auto begun = Clock::now();
        for (int n = 0; n < N; ++n) roll(start.data(), &x[2 * (T + 1) * n], &v[2 * T * n], &g[3 * K * T * n]);
        passes.push_back(seconds(begun));
        ends = x[2 * (T + 1) * N - 2] + x[2 * (T + 1) * N - 1];
        if (!n_updates) continue;
        begun = Clock::now();
        learn(before, after);
        runs.push_back(seconds(begun));
    }
    std::cout.precision(17);
    for (Numbers* times : {&passes, &runs}) {
        std::sort(times->begin(), times->end());
        for (double time : *times) std::cout << time << " ";
        std::cout << "\n";
    }
    std::cout << ends << " " << before << " " << after << "\n";
}
