// Levenberg and Marquardt's search of one repeat; the twin of dashpot.numerics.levenberg_marquardt, step for step, but
// for what its rigs are too small to ask for: ends in the rounding of the cost, and Newton's matrix later for very many
// unknowns.
#pragma once
#include "dense.hpp"
#include "problem.hpp"

namespace DASHPOT_SET {

constexpr double ROUNDING = 1e-5;  // standard deviations

// Cost, minus half its slope, half the curvature of Gauss and Newton, and the matrix of the full step.
struct Quadratic {
    double cost, *gradient, *symmetric, *free;
};

struct Searcher {
    int m;
    double *x, *trial, *step, *spread, *matrix, *scratch, *at;
    Quadratic around, there, near;

    void lay(Arena &arena, int unknowns) {
        m = unknowns;
        double **vectors[] = {&x, &trial, &step, &spread, &at};
        for (double **vector : vectors) *vector = arena.take<double>(m);
        matrix = arena.take<double>(m * m);
        scratch = arena.take<double>(2 * m * m + 2 * m);
        Quadratic *points[] = {&around, &there, &near};
        for (Quadratic *point : points) {
            point->gradient = arena.take<double>(m);
            point->symmetric = arena.take<double>(m * m);
            point->free = arena.take<double>(m * m);
        }
    }
};

// `evaluate(x, out)` fills all four parts of `out`.  An unknown whose bounds meet stays there: for the others it is
// known, and by itself a parabola.
template <class Evaluate> static void evaluate_at(Searcher &w, const dashpot::Limits &limits, Evaluate &evaluate,
                                                  const double *x, Quadratic &out) {
    const int m = w.m;
    const unsigned char *log = limits.logarithmic;
    auto known = [&](int j) { return limits.lower[j] >= limits.upper[j]; };
    for (int j = 0; j < m; ++j) {
        const double value = known(j) ? limits.lower[j] : x[j];
        w.at[j] = log && log[j] ? __builtin_exp(value) : value;
    }
    evaluate(w.at, out);
    for (int j = 0; log && j < m; ++j) {
        const double chain = log[j] ? w.at[j] : 1.0;
        out.gradient[j] *= chain;
        for (int i = 0; i < m; ++i) {
            const double both = (log[i] ? w.at[i] : 1.0) * chain;
            out.symmetric[i * m + j] *= both;
            out.free[i * m + j] *= both;
        }
    }
    for (int j = 0; j < m; ++j) {
        if (!known(j)) continue;
        out.gradient[j] = limits.lower[j] - x[j];
        for (int i = 0; i < m; ++i) {
            out.symmetric[i * m + j] = out.symmetric[j * m + i] = i == j;
            out.free[i * m + j] = out.free[j * m + i] = i == j;
        }
    }
    if (!__builtin_isfinite(out.cost)) out.cost = INFINITE;
}

// Newton's matrix as `free` of `around`, by differences of the slope, where it is positive definite; whether it is.
template <class Evaluate> static bool curved(Searcher &w, const dashpot::Limits &limits, Evaluate &evaluate) {
    const int m = w.m;
    double *curvature = w.matrix, *spread = w.step, *scaled = w.scratch;
    for (int j = 0; j < m; ++j) spread[j] = 1 / __builtin_sqrt(w.around.symmetric[j * m + j]);
    for (int j = 0; j < m; ++j) {
        const double width = 1e-4 * (__builtin_isfinite(spread[j]) ? spread[j] : 1.0);
        for (int i = 0; i < m; ++i) w.trial[i] = w.x[i] + (i == j ? width : 0.0);
        evaluate_at(w, limits, evaluate, w.trial, w.near);
        for (int i = 0; i < m; ++i) curvature[i * m + j] = (w.around.gradient[i] - w.near.gradient[i]) / width;
    }
    bool finite = true;
    for (int i = 0; i < m; ++i)
        for (int j = 0; j <= i; ++j) {
            const double mean = (curvature[i * m + j] + curvature[j * m + i]) / 2;
            curvature[i * m + j] = curvature[j * m + i] = mean;
            scaled[i * m + j] = scaled[j * m + i] = mean * spread[i] * spread[j];
            finite = finite && __builtin_isfinite(scaled[i * m + j]);
        }
    if (!finite || !definite(scaled, m, 1e-6)) return false;
    for (int i = 0; i < m * m; ++i) w.around.free[i] = curvature[i];
    return true;
}

static void next_step(Searcher &w, const dashpot::Limits &limits, double damping, bool newton) {
    const int m = w.m;
    const double *S = w.around.symmetric, *chosen = newton || damping == 0 ? w.around.free : S;
    for (int i = 0; i < m * m; ++i) w.matrix[i] = chosen[i];
    double *gradient = w.spread;  // of what is not held; the deviations come after it
    for (int j = 0; j < m; ++j) w.matrix[j * m + j] += damping * S[j * m + j], gradient[j] = w.around.gradient[j];
    for (int j = 0; j < m; ++j) {
        const bool held = (w.x[j] <= limits.lower[j] && w.around.gradient[j] < 0) ||
                          (w.x[j] >= limits.upper[j] && w.around.gradient[j] > 0);
        if (!held) continue;
        for (int i = 0; i < m; ++i) w.matrix[i * m + j] = w.matrix[j * m + i] = i == j;
        gradient[j] = 0;
    }
    solve_scaled(w.matrix, gradient, w.step, m, w.scratch);
    deviations(S, w.spread, m, w.scratch);
}

INLINE double clipped(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

// By how much a step would lower the cost were it the parabola that Gauss and Newton take it for.
INLINE double promised(const Searcher &w) {
    const int m = w.m;
    double fall = 0, bent = 0;
    for (int i = 0; i < m; ++i) {
        const double step = w.trial[i] - w.x[i];
        double row = 0;
        for (int j = 0; j < m; ++j) row += w.around.symmetric[i * m + j] * (w.trial[j] - w.x[j]);
        fall += w.around.gradient[i] * step;
        bent += step * row;
    }
    return 2 * fall - bent;
}

INLINE double calmer(double damping, double gained, double promise) {
    double kept = gained / promise;
    if (__builtin_isnan(kept)) kept = 0;
    const double factor = kept > 0.75 ? 1.0 / 3 : kept > 0.25 ? 0.7 : 1.0;
    return damping * factor > 1e-7 ? damping * factor : 0.0;
}

template <class Evaluate>
static void minimise(Searcher &w, Evaluate &evaluate, const double *start, const dashpot::Limits &limits,
                     const dashpot::Ends &ends, long row, bool history) {
    const int m = w.m;
    bool usable = true;
    for (int j = 0; j < m; ++j) {
        w.x[j] = clipped(start[j], limits.lower[j], limits.upper[j]);
        usable = usable && __builtin_isfinite(w.x[j]);
    }
    int written = 0;
    auto write = [&]() {
        if (!history || !ends.history) return;
        for (int j = 0; j < m; ++j) ends.history[written * m + j] = w.x[j];
        *ends.history_rows = ++written;
    };
    write();
    double cost = INFINITE, damping = 0;
    bool converged = false, curvature = false;
    long long iterations = 0;
    if (usable) {
        evaluate_at(w, limits, evaluate, w.x, w.around);
        cost = w.around.cost;
        double allowance = 0.1;
        for (int turn = 0; turn < limits.limit; ++turn) {
            if (turn && turn % limits.patience == 0) allowance *= 10;
            bool newton = false;
            if (turn >= limits.patience) {
                newton = curved(w, limits, evaluate);
                curvature = true;
                if (newton && turn == limits.patience) damping = 0;
            }
            next_step(w, limits, damping, newton);
            bool finite = true;
            for (int j = 0; j < m; ++j) {
                finite = finite && __builtin_isfinite(w.step[j]);
                const double step = __builtin_isnan(w.step[j]) ? 0.0 : w.step[j];
                w.trial[j] = clipped(w.x[j] + clipped(step, -limits.longest[j], limits.longest[j]),
                                     limits.lower[j], limits.upper[j]);
            }
            evaluate_at(w, limits, evaluate, w.trial, w.there);
            const bool better = finite && w.there.cost <= w.around.cost * (1 + 1e-12) + 1e-12;
            double near = limits.tolerance * allowance;
            if (near > ROUNDING) near = ROUNDING;
            if (near < limits.tolerance) near = limits.tolerance;
            bool small = true;
            for (int j = 0; j < m; ++j) {
                const double reach = near * w.spread[j], least = 1e-13 * __builtin_fabs(w.x[j]);
                small = small && __builtin_fabs(w.trial[j] - w.x[j]) <= (reach > least ? reach : least);
            }
            const double calm = calmer(damping, w.around.cost - w.there.cost, promised(w));
            const bool done = small && finite && (damping == 0 || !better);
            if (better) {
                damping = small ? 0.0 : calm;
                double *x = w.x;
                w.x = w.trial, w.trial = x;
                const Quadratic around = w.around;
                w.around = w.there, w.there = around;
            } else {
                damping = damping * 3 > 1e-5 ? damping * 3 : 1e-5;
            }
            ++iterations;
            cost = w.around.cost;
            write();
            if (done) converged = true;
            if (done || damping > 1e14) break;
        }
    }
    if (ends.symmetric) {
        // The search may have put Newton's matrix in the place of `free`.
        if (curvature || !__builtin_isfinite(cost)) evaluate(w.x, w.around);
        ends.sum[row] = w.around.cost;
        for (int j = 0; j < m; ++j) ends.gradient[row * m + j] = w.around.gradient[j];
        for (int j = 0; j < m * m; ++j) {
            ends.symmetric[row * m * m + j] = w.around.symmetric[j];
            ends.free[row * m * m + j] = w.around.free[j];
        }
    }
    for (int j = 0; j < m; ++j) ends.x[row * m + j] = w.x[j];
    ends.cost[row] = cost;
    ends.converged[row] = converged;
    ends.iterations[row] = iterations;
}

}  // namespace DASHPOT_SET
