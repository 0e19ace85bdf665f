// The equation of motion of K repeats: cost, slope and matrices of sum e^H Omega(theta) e and its search.
// Twins: dashpot.estimate.linear.gram, .least_squares (starts) and .instrumental_variables.
#pragma once
#include "dense.hpp"
#include "problem.hpp"
#include "search.hpp"

namespace DASHPOT_SET {

constexpr double FLOOR = 1e-13;  // of the noise, for channels that are exact beside noisy ones

// Letter matrices at parameters p, (4, n (n + r)).
static void assemble(const dashpot::Rig &rig, const double *theta, double *p, double *A) {
    for (int e = 0; e < rig.elements; ++e) {
        double sum = rig.p0[e];
        for (int j = 0; j < rig.unknowns; ++j) sum += rig.T[e * rig.unknowns + j] * theta[j];
        p[e] = sum;
    }
    const int size = rig.n * (rig.n + rig.r);
    for (int k = 0; k < 4 * size; ++k) A[k] = 0;
    for (int k = 0; k < rig.cells; ++k)
        A[rig.cell_letter[k] * size + rig.cell_place[k]] += rig.cell_value[k] * p[rig.cell_element[k]];
}

// Dynamic stiffness and input stiffness at some lines, (n, n + r); entries that are 0 throughout are left as they are.
static inline void stiffness(const dashpot::Rig &rig, const double *A, int line, C *both) {
    const int size = rig.n * (rig.n + rig.r);
    V phi[4];
    int real[4], turned[4], reals = 0, turneds = 0;
    for (int l = 0; l < 4; ++l)
        if (rig.used[l]) {
            phi[l] = load(rig.factor + l * rig.stride + line);
            if (rig.imaginary[l]) turned[turneds++] = l; else real[reals++] = l;
        }
    for (int row = 0; row < rig.n; ++row)
        for (int place = rig.row_start[row]; place < rig.row_start[row + 1]; ++place) {
            const int k = row * (rig.n + rig.r) + rig.row_column[place];
            C sum = zero();
            for (int i = 0; i < reals; ++i) sum.re += phi[real[i]] * A[real[i] * size + k];
            for (int i = 0; i < turneds; ++i) sum.im += phi[turned[i]] * A[turned[i] * size + k];
            both[k] = sum;
        }
}

INLINE C times_phi(const dashpot::Rig &rig, int element, int line, C x) {
    const int letter = rig.letter[element];
    if (letter < 0) return zero();  // a nonlinear law
    const V phi = load(rig.factor + letter * rig.stride + line);
    return rig.imaginary[letter] ? C{-x.im * phi, x.re * phi} : C{x.re * phi, x.im * phi};
}

// COORDINATES: their number where it is small, so that loops over them unroll; 0 where the rig says it.
template <int COORDINATES> struct EquationWork {
    const dashpot::Equation *problem;
    Searcher search;
    double *p, *A, *z, *sigma;  // z (q, 2, stride), sigma (places, 2, stride)
    C *both, *spread, *Se, *e, *u, *zhat, *entry, *Q, *w, *h, *omega, *by_omega, *by_noise;
    V *noise_gradient;
    V *pivot;
    double *measured;            // unit forces of all elements, (elements, 2, stride)
    V *gradient, *symmetric, *mixed;
    double *numbers;
    long packed_z, packed_sigma;
    unsigned char *present;  // (n, n + r), of both

    void lay(Arena &arena, const dashpot::Equation &equation) {
        problem = &equation;
        const dashpot::Rig &rig = *equation.rig;
        const int n = COORDINATES ? COORDINATES : rig.n, q = equation.q, m = rig.unknowns;
        search.lay(arena, m);
        p = arena.take<double>(rig.elements);
        A = arena.take<double>(4 * n * (n + rig.r));
        z = arena.take<double>(2l * q * rig.stride);
        sigma = arena.take<double>(2l * equation.places * rig.stride);
        measured = arena.take<double>(2l * rig.elements * rig.stride);
        both = arena.take<C>(n * (n + rig.r));
        spread = arena.take<C>(q * n);
        Se = arena.take<C>(n * n);
        e = arena.take<C>(n), u = arena.take<C>(n), h = arena.take<C>(n);
        zhat = arena.take<C>(q);
        entry = arena.take<C>(rig.column_start[m]);
        Q = arena.take<C>(n * m);
        omega = arena.take<C>(n * n);
        by_omega = arena.take<C>(rig.elements * n), by_noise = arena.take<C>(rig.elements * q);
        noise_gradient = arena.take<V>(m);
        w = arena.take<C>(rig.elements);
        pivot = arena.take<V>(n);
        gradient = arena.take<V>(m);
        symmetric = arena.take<V>(m * m);
        mixed = arena.take<V>(m * m);
        numbers = arena.take<double>(6 * m * m + 8 * m);
        packed_z = packed_sigma = -1;
        present = arena.take<unsigned char>(n * (n + rig.r));
        if (!arena.base) return;
        for (int k = 0; k < n * (n + rig.r); ++k) present[k] = 0, both[k] = zero();
        for (int i = 0; i < n; ++i)
            for (int place = rig.row_start[i]; place < rig.row_start[i + 1]; ++place)
                present[i * (n + rig.r) + rig.row_column[place]] = 1;
    }

    // Copies of one repeat's data with lines side by side.
    void pack(long repeat) {
        const dashpot::Equation &equation = *problem;
        const dashpot::Rig &rig = *equation.rig;
        const int q = equation.q, stride = rig.stride, lines = rig.lines;
        const long of_covariance = equation.shared ? 0 : repeat;
        if (packed_z != repeat) {
            packed_z = repeat;
            const double *from = equation.z + 2l * repeat * lines * q;
            for (int c = 0; c < q; ++c)
                for (int l = 0; l < stride; ++l)
                    for (int part = 0; part < 2; ++part)
                        z[(2 * c + part) * stride + l] = l < lines ? from[2 * (l * q + c) + part] : 0.0;
            for (int at = 0; at < stride; at += LANES)
                for (int k = 0; k < rig.elements; ++k) {
                    const C a = unit_force(k, at, [&](int c) { return state(c, at); });
                    store(measured + 2 * k * stride + at, a.re);
                    store(measured + (2 * k + 1) * stride + at, a.im);
                }
        }
        if (packed_sigma != of_covariance) {
            packed_sigma = of_covariance;
            const double *from = equation.covariance + 2l * of_covariance * lines * q * q;
            for (int k = 0; k < equation.places; ++k) {
                const int place = equation.place_row[k] * q + equation.place_column[k];
                for (int l = 0; l < stride; ++l)
                    for (int part = 0; part < 2; ++part)
                        sigma[(2 * k + part) * stride + l] =
                            from[2 * ((l < lines ? l : lines - 1) * q * q + place) + part];
            }
        }
    }

    C state(int c, int at) const {
        const int stride = problem->rig->stride;
        return {load(z + 2 * c * stride + at), load(z + (2 * c + 1) * stride + at)};
    }
    C measured_force(int k, int at) const {
        const int stride = problem->rig->stride;
        return {load(measured + 2 * k * stride + at), load(measured + (2 * k + 1) * stride + at)};
    }
    template <class State> C unit_force(int element, int at, State state) const {
        const dashpot::Rig &rig = *problem->rig;
        C sum = zero();
        for (int k = rig.join_start[element]; k < rig.join_start[element + 1]; ++k) {
            const C x = state(rig.join_point[k]);
            sum.re += x.re * rig.join_value[k];
            sum.im += x.im * rig.join_value[k];
        }
        return times_phi(rig, element, at, sum);
    }

    // Sigma H^H and Se = H Sigma H^H = L diag(pivot) L^H, at some lines.
    void noise(int at) {
        const dashpot::Equation &equation = *problem;
        const dashpot::Rig &rig = *equation.rig;
        const int n = COORDINATES ? COORDINATES : rig.n, points = n + rig.r, stride = rig.stride, q = equation.q;
        for (int c = 0; c < q; ++c)
            if (equation.row_noisy[c])
                for (int i = 0; i < n; ++i) spread[c * n + i] = zero();
        for (int k = 0; k < equation.places; ++k) {
            const int row = equation.place_row[k], column = equation.place_column[k];
            const C here = {load(sigma + 2 * k * stride + at), load(sigma + (2 * k + 1) * stride + at)};
            for (int i = 0; i < n; ++i) {
                if (column >= points)
                    spread[row * n + i] = spread[row * n + i] - here * rig.S[i * rig.s + column - points];
                else if (present[i * points + column])
                    add_conj(spread[row * n + i], both[i * points + column], here);
            }
        }
        V most = V{};
        for (int i = 0; i < n; ++i)
            for (int k = 0; k <= i; ++k) {
                C sum = zero();
                for (int place = rig.row_start[i]; place < rig.row_start[i + 1]; ++place) {
                    const int c = rig.row_column[place];
                    if (equation.row_noisy[c]) add(sum, both[i * points + c], spread[c * n + k]);
                }
                for (int c = points; c < q; ++c)
                    if (equation.row_noisy[c]) sum = sum - spread[c * n + k] * rig.S[i * rig.s + c - points];
                if (i == k) {
                    sum.im = V{};
                    most = larger(most, sum.re);
                }
                Se[i * n + k] = sum;
            }
        for (int i = 0; i < n; ++i) {
            const V noise = Se[i * n + i].re;
            Se[i * n + i].re = noise + FLOOR * (noise > 0 ? noise : most);
        }
        for (int k = 0; k < n; ++k) {
            pivot[k] = 1.0 / Se[k * n + k].re;
            for (int i = k + 1; i < n; ++i) {
                const C factor = Se[i * n + k] * pivot[k];
                for (int j = k + 1; j <= i; ++j) subtract(Se[i * n + j], factor, conj(Se[j * n + k]));
            }
            for (int i = k + 1; i < n; ++i) Se[i * n + k] = Se[i * n + k] * pivot[k];
        }
    }

    void even() {
        const int n = COORDINATES ? COORDINATES : problem->rig->n;
        for (int i = 0; i < n; ++i) {
            pivot[i] = all(1.0);
            for (int k = 0; k < i; ++k) Se[i * n + k] = zero();
        }
    }

    INLINE void forward(const C *L, C *x, int n, int first = 0) {
        for (int i = first + 1; i < n; ++i)
            for (int k = first; k < i; ++k) subtract(x[i], L[i * n + k], x[k]);
    }
    INLINE void backward(const C *L, const V *pivot, C *x, int n) {
        for (int i = n - 1; i >= 0; --i) {
            x[i] = x[i] * pivot[i];
            for (int k = i + 1; k < n; ++k) subtract_conj(x[i], L[k * n + i], x[k]);
        }
    }

    // Omega times each column of the regressors of unit forces `w`, and the entries of that regressor.
    template <class Force> void weighted_columns(Force force) {
        const dashpot::Rig &rig = *problem->rig;
        const int n = COORDINATES ? COORDINATES : rig.n, m = rig.unknowns;
        for (int j = 0; j < m; ++j) {
            C *here = Q + j * n;
            for (int i = 0; i < n; ++i) here[i] = zero();
            for (int k = rig.column_start[j]; k < rig.column_start[j + 1]; ++k) {
                entry[k] = regressor(k, force);
                here[rig.entry_row[k]] = entry[k];
            }
            if (rig.column_start[j] == rig.column_start[j + 1]) continue;
            forward(Se, here, n, rig.entry_row[rig.column_start[j]]);
            backward(Se, pivot, here, n);
        }
    }

    template <class Force> C regressor(int k, Force force) const {
        const dashpot::Rig &rig = *problem->rig;
        C sum = zero();
        for (int t = rig.term_start[k]; t < rig.term_start[k + 1]; ++t)
            sum = sum + force(rig.active_element[rig.term_active[t]]) * rig.term_value[t];
        return sum;
    }

    // Adds the sums of some lines at theta, whose letter matrices stand in A, to gradient, symmetric and mixed.
    V sums(int at, bool with_mixed) {
        const dashpot::Equation &equation = *problem;
        const dashpot::Rig &rig = *equation.rig;
        const int n = COORDINATES ? COORDINATES : rig.n, m = rig.unknowns, q = equation.q, points = n + rig.r;
        stiffness(rig, A, at, both);
        noise(at);
        for (int c = 0; c < q; ++c) zhat[c] = state(c, at);
        for (int i = 0; i < n; ++i) {
            C sum = zero();
            for (int place = rig.row_start[i]; place < rig.row_start[i + 1]; ++place)
                add(sum, both[i * points + rig.row_column[place]], zhat[rig.row_column[place]]);
            for (int c = 0; c < rig.s; ++c) sum = sum - zhat[points + c] * rig.S[i * rig.s + c];
            e[i] = u[i] = sum;
        }
        forward(Se, u, n);
        V cost = V{};
        for (int i = 0; i < n; ++i) cost += norm(u[i]) * pivot[i];
        backward(Se, pivot, u, n);
        for (int c = 0; c < q; ++c)
            if (equation.row_noisy[c])
                for (int i = 0; i < n; ++i) subtract(zhat[c], spread[c * n + i], u[i]);
        for (int a = 0; a < rig.active; ++a) {
            const int k = rig.active_element[a];
            w[k] = unit_force(k, at, [&](int c) { return zhat[c]; });
        }
        weighted_columns([&](int k) { return w[k]; });
        for (int k = 0; k < m; ++k)
            for (int i = 0; i < n; ++i) gradient[k] -= dot(Q[k * n + i], e[i]);
        for (int j = 0; j < m; ++j)
            for (int place = rig.column_start[j]; place < rig.column_start[j + 1]; ++place) {
                const int row = rig.entry_row[place];
                const C own = entry[place];
                for (int k = 0; k <= j; ++k) symmetric[k * m + j] += dot(Q[k * n + row], own);
                if (!with_mixed) continue;
                const C seen = regressor(place, [&](int element) { return measured_force(element, at); });
                for (int k = 0; k < m; ++k) mixed[k * m + j] += dot(Q[k * n + row], seen);
            }
        return 2.0 * cost;
    }

    void clear(bool with_mixed) {
        const int m = problem->rig->unknowns;
        for (int k = 0; k < m; ++k) gradient[k] = V{};
        for (int k = 0; k < m * m; ++k) symmetric[k] = V{};
        if (with_mixed)
            for (int k = 0; k < m * m; ++k) mixed[k] = V{};
    }

    // Everything at theta, with priors.
    void evaluate(const double *theta, Quadratic &out) {
        const dashpot::Rig &rig = *problem->rig;
        const int m = rig.unknowns;
        assemble(rig, theta, p, A);
        clear(true);
        V cost = V{};
        for (int at = 0; at < rig.lines; at += LANES) cost += sums(at, true);
        out.cost = total(cost);
        for (int k = 0; k < m; ++k) {
            const double away = theta[k] - rig.mean[k];
            out.cost += rig.precision[k] * away * away;
            out.gradient[k] = 2 * total(gradient[k]) - rig.precision[k] * away;
            for (int j = 0; j < m; ++j) {
                if (j >= k) out.symmetric[k * m + j] = out.symmetric[j * m + k] = 2 * total(symmetric[k * m + j]);
                out.free[k * m + j] = 2 * total(mixed[k * m + j]);
            }
        }
        for (int k = 0; k < m; ++k) {
            out.symmetric[k * m + k] += rig.precision[k];
            out.free[k * m + k] += rig.precision[k];
        }
    }

    // 2 Re Phi^H Omega Phi and 2 Re Phi^H Omega h of the measured amplitudes; with `cleaned` also what noise adds.
    void normal(const double *at_theta, double *N, double *right, double *noiseN, double *noise_right) {
        const dashpot::Rig &rig = *problem->rig;
        const int n = COORDINATES ? COORDINATES : rig.n, m = rig.unknowns;
        if (at_theta) assemble(rig, at_theta, p, A);
        clear(noiseN != nullptr);
        for (int k = 0; k < m; ++k) noise_gradient[k] = V{};
        for (int at = 0; at < rig.lines; at += LANES) {
            if (at_theta) {
                stiffness(rig, A, at, both);
                noise(at);
            } else {
                even();
            }
            for (int i = 0; i < n; ++i) {
                C sum = zero();
                for (int c = 0; c < rig.s; ++c) sum = sum + state(n + rig.r + c, at) * rig.S[i * rig.s + c];
                h[i] = sum;
            }
            for (int k = 0; k < rig.known; ++k) {
                const int element = rig.known_element[k];
                const C a = measured_force(element, at) * rig.p0[element];
                for (int t = rig.join_start[element]; t < rig.join_start[element + 1]; ++t)
                    if (rig.join_point[t] < n) h[rig.join_point[t]] = h[rig.join_point[t]] - a * rig.join_value[t];
            }
            weighted_columns([&](int element) { return measured_force(element, at); });
            for (int k = 0; k < m; ++k)
                for (int i = 0; i < n; ++i) gradient[k] += dot(Q[k * n + i], h[i]);
            for (int j = 0; j < m; ++j)
                for (int place = rig.column_start[j]; place < rig.column_start[j + 1]; ++place)
                    for (int k = 0; k <= j; ++k)
                        symmetric[k * m + j] += dot(Q[k * n + rig.entry_row[place]], entry[place]);
            if (noiseN) noise_sums(at);
        }
        for (int k = 0; k < m; ++k) {
            right[k] = 2 * total(gradient[k]);
            if (noiseN) noise_right[k] = 2 * total(noise_gradient[k]);
            for (int j = k; j < m; ++j) {
                N[k * m + j] = N[j * m + k] = 2 * total(symmetric[k * m + j]);
                if (noiseN) noiseN[k * m + j] = noiseN[j * m + k] = 2 * total(mixed[k * m + j]);
            }
        }
    }

    // What noise adds to the sums of some lines: (B Omega B^T) o E[conj(a) a^T], to mixed and noise_gradient.
    void noise_sums(int at) {
        const dashpot::Equation &equation = *problem;
        const dashpot::Rig &rig = *equation.rig;
        const int n = COORDINATES ? COORDINATES : rig.n, m = rig.unknowns, q = equation.q, points = n + rig.r, stride = rig.stride;
        V real_line;  // lines that only fill up the lanes count nothing
        for (int k = 0; k < LANES; ++k) real_line[k] = at + k < rig.lines;
        for (int j = 0; j < n; ++j) {
            C *here = u;
            for (int i = 0; i < n; ++i) here[i] = {all(i == j), V{}};
            forward(Se, here, n);
            backward(Se, pivot, here, n);
            for (int i = 0; i < n; ++i) omega[i * n + j] = here[i];
        }
        auto prepare = [&](int element) {
            C *left = by_omega + element * n, *noise = by_noise + element * q;
            for (int i = 0; i < n; ++i) left[i] = zero();
            for (int i = 0; i < q; ++i) noise[i] = zero();
            for (int t = rig.join_start[element]; t < rig.join_start[element + 1]; ++t) {
                const int point = rig.join_point[t];
                if (point < n)
                    for (int i = 0; i < n; ++i) left[i] = left[i] + omega[point * n + i] * rig.join_value[t];
                const C reading = conj(times_phi(rig, element, at, {real_line * rig.join_value[t], V{}}));
                for (int k = 0; k < equation.places; ++k)
                    if (equation.place_column[k] == point)
                        add(noise[equation.place_row[k]], reading,
                            {load(sigma + 2 * k * stride + at), load(sigma + (2 * k + 1) * stride + at)});
            }
        };
        auto pair = [&](int element, int other) {
            C meeting = zero(), own = zero();
            for (int t = rig.join_start[other]; t < rig.join_start[other + 1]; ++t) {
                const int point = rig.join_point[t];
                if (point < n) meeting = meeting + by_omega[element * n + point] * rig.join_value[t];
                own = own + by_noise[element * q + point] * rig.join_value[t];
            }
            own = times_phi(rig, other, at, own);
            return meeting.re * own.re - meeting.im * own.im;
        };
        for (int a = 0; a < rig.active; ++a) prepare(rig.active_element[a]);
        for (int k = 0; k < m; ++k)
            for (int t = rig.tie_start[k]; t < rig.tie_start[k + 1]; ++t) {
                const int element = rig.active_element[rig.tie_active[t]];
                for (int c = 0; c < rig.s; ++c) {
                    C left = zero();
                    for (int i = 0; i < n; ++i) left = left + by_omega[element * n + i] * rig.S[i * rig.s + c];
                    const C noise = by_noise[element * q + points + c];
                    noise_gradient[k] += rig.tie_value[t] * (left.re * noise.re - left.im * noise.im);
                }
                for (int o = 0; o < rig.known; ++o)
                    noise_gradient[k] -=
                        rig.tie_value[t] * rig.p0[rig.known_element[o]] * pair(element, rig.known_element[o]);
                for (int j = k; j < m; ++j)
                    for (int o = rig.tie_start[j]; o < rig.tie_start[j + 1]; ++o)
                        mixed[k * m + j] += rig.tie_value[t] * rig.tie_value[o] *
                                            pair(element, rig.active_element[rig.tie_active[o]]);
            }
    }
};

static unsigned long equation_workspace(const dashpot::Equation &problem) {
    Arena arena{nullptr, 0};
    EquationWork<0> work;
    work.lay(arena, problem);
    return arena.used;
}

// Calls run(work) with the workspace laid out in `memory`.
template <class Run> static void with_work(const dashpot::Equation &problem, char *memory, Run run) {
    auto lay_and_run = [&](auto work) {
        Arena arena{memory, 0};
        work.lay(arena, problem);
        run(work);
    };
    switch (problem.rig->n) {
        case 1: return lay_and_run(EquationWork<1>());
        case 2: return lay_and_run(EquationWork<2>());
        case 3: return lay_and_run(EquationWork<3>());
        case 4: return lay_and_run(EquationWork<4>());
        default: return lay_and_run(EquationWork<0>());
    }
}

static void equation_evaluate(const dashpot::Equation &problem, const double *theta, const long long *rows, long from,
                              long to, double *cost, double *gradient, double *symmetric, double *mixed, char *memory) {
    const int m = problem.rig->unknowns;
    with_work(problem, memory, [&](auto &work) {
        for (long k = from; k < to; ++k) {
            work.pack(rows[k]);
            Quadratic out{0, gradient + k * m, symmetric + k * m * m, mixed + k * m * m};
            work.evaluate(theta + k * m, out);
            cost[k] = out.cost;
        }
    });
}

static void equation_lines(const dashpot::Equation &problem, const double *theta, long from, long to,
                           double *information, double *scores, double *cost, char *memory) {
    const dashpot::Rig &rig = *problem.rig;
    const int m = rig.unknowns;
    with_work(problem, memory, [&](auto &work) {
        for (long k = from; k < to; ++k) {
            work.pack(k);
            assemble(rig, theta + k * m, work.p, work.A);
            for (int at = 0; at < rig.lines; at += LANES) {
                work.clear(false);
                const V costs = work.sums(at, false);
                for (int lane = 0; lane < LANES && at + lane < rig.lines; ++lane) {
                    const long line = k * rig.lines + at + lane;
                    cost[line] = costs[lane];
                    for (int i = 0; i < m; ++i) {
                        scores[line * m + i] = 2 * work.gradient[i][lane];
                        for (int j = i; j < m; ++j)
                            information[(line * m + i) * m + j] = information[(line * m + j) * m + i] =
                                2 * work.symmetric[i * m + j][lane];
                    }
                }
            }
        }
    });
}

static bool finite(const double *x, int count) {
    for (int k = 0; k < count; ++k)
        if (!__builtin_isfinite(x[k])) return false;
    return true;
}

// Starts of the iterative estimators from one repeat's data: cleaned of noise, weighted, plain; (unknowns,) each.
template <class Work> static void start_of(Work &work, double *clean, double *weighted, double *plain) {
    const dashpot::Rig &rig = *work.problem->rig;
    const int m = rig.unknowns;
    double *N = work.numbers, *noiseN = N + m * m, *matrix = noiseN + m * m, *scratch = matrix + m * m;
    double *right = scratch + m * m + m, *noise_right = right + m, *size = noise_right + m, *few = size + m;
    work.normal(nullptr, N, right, nullptr, nullptr);
    // Parameters with a prior are held there: the plain sums have no scale to weigh them by.
    int free = 0;
    for (int i = 0; i < m; ++i) {
        plain[i] = rig.mean[i];
        if (rig.precision[i] > 0) continue;
        int column = 0;
        noise_right[free] = right[i];
        for (int j = 0; j < m; ++j) {
            if (rig.precision[j] > 0) noise_right[free] -= N[i * m + j] * rig.mean[j];
            else matrix[column++] = N[i * m + j];
        }
        for (int j = 0; j < column; ++j) noiseN[free * column + j] = matrix[j];
        ++free;
    }
    if (free) {
        solve_scaled(noiseN, noise_right, size, free, scratch);
        for (int i = 0, k = 0; i < m; ++i)
            if (!(rig.precision[i] > 0)) plain[i] = size[k++];
    }
    for (int i = 0; i < m; ++i) weighted[i] = plain[i];
    for (int turn = 0; turn < 2; ++turn) {
        work.normal(weighted, N, right, nullptr, nullptr);
        for (int i = 0; i < m; ++i) {
            N[i * m + i] += rig.precision[i];
            right[i] += rig.precision[i] * rig.mean[i];
        }
        solve_scaled(N, right, clean, m, scratch);
        if (finite(clean, m))
            for (int i = 0; i < m; ++i) weighted[i] = clean[i];
    }
    work.normal(weighted, N, right, noiseN, noise_right);
    for (int i = 0; i < m; ++i) {
        N[i * m + i] += rig.precision[i];
        right[i] += rig.precision[i] * rig.mean[i];
        const double diagonal = __builtin_fabs(N[i * m + i]);
        size[i] = __builtin_sqrt(diagonal > 1e-300 ? diagonal : 1e-300);
    }
    // Where the noise taken out leaves no positive definite matrix, it is left in.
    for (int i = 0; i < m * m; ++i) matrix[i] = N[i] / (size[i / m] * size[i % m]);
    const double raw = smallest_eigenvalue(matrix, m, few);
    for (int i = 0; i < m * m; ++i) matrix[i] = (N[i] - noiseN[i]) / (size[i / m] * size[i % m]);
    if (definite(matrix, m, 0.05 * raw)) {
        for (int i = 0; i < m * m; ++i) N[i] -= noiseN[i];
        for (int i = 0; i < m; ++i) right[i] -= noise_right[i];
    }
    solve_scaled(N, right, clean, m, scratch);
    if (!finite(clean, m))
        for (int i = 0; i < m; ++i) clean[i] = weighted[i];
}

static void equation_starts(const dashpot::Equation &problem, long from, long to, double *clean, double *weighted,
                            double *plain, char *memory) {
    const int m = problem.rig->unknowns;
    with_work(problem, memory, [&](auto &work) {
        for (long row = from; row < to; ++row) {
            work.pack(row);
            start_of(work, clean + row * m, weighted + row * m, plain + row * m);
        }
    });
}

static void equation_descend(const dashpot::Equation &problem, const double *start, const long long *rows, long from,
                             long to, const dashpot::Limits &limits, const dashpot::Ends &ends, char *memory) {
    const int m = problem.rig->unknowns;
    with_work(problem, memory, [&](auto &work) {
        auto evaluate = [&](const double *theta, Quadratic &out) { work.evaluate(theta, out); };
        for (long k = from; k < to; ++k) {
            work.pack(rows[k]);
            minimise(work.search, evaluate, start + k * m, limits, ends, k, k == 0);
        }
    });
}

// Sum over lines of inflation * bread I bread, and its diagonal line by line.
static void line_shares(const double *information, const double *inflation, const double *bread, long lines, int m,
                        double *shares, double *diagonals) {
    double *sum = shares;
    for (int i = 0; i < m * m; ++i) sum[i] = 0;
    for (long l = 0; l < lines; ++l) {
        const double *I = information + l * m * m;
        double *diagonal = diagonals + l * m;
        const double factor = inflation[l];
        for (int i = 0; i < m; ++i) {
            double all = 0;
            for (int a = 0; a < m; ++a) {
                double row = 0;
                for (int b = 0; b < m; ++b) row += I[a * m + b] * bread[i * m + b];
                all += row * bread[i * m + a];
            }
            diagonal[i] = factor * all;
        }
        for (int i = 0; i < m * m; ++i) sum[i] += factor * I[i];
    }
}

}  // namespace DASHPOT_SET
