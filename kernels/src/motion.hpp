// Laws with a state, in settled dwells and along records, and the motion of a rig in time, segments side by side.
// Twins: dashpot.model.nonlinear.alternating (_with_state, rated_states) and .integration (Integrator.followed).
#pragma once
#include <initializer_list>

#include "dense.hpp"
#include "laws.hpp"
#include "problem.hpp"

namespace DASHPOT_SET {

constexpr int PERIOD_TURNS = 40, HISTORY_TURNS = 60, STEP_TURNS = 24;
constexpr double PERIOD_TOLERANCE = 1e-11, HISTORY_TOLERANCE = 1e-9, STEP_TOLERANCE = 1e-13, LEAST_SIZE = 1e-300;

INLINE long rounded(long count) { return (count + 7) / 8 * 8; }
INLINE double greater(double a, double b) { return a > b || a != a ? a : b; }  // what is no number stays

static double largest(const double *x, long count) {
    double most = 0;
    for (long k = 0; k < count; ++k) most = greater(__builtin_fabs(x[k]), most);
    return most;
}

// A law of the stack at some instants: slopes along what it does not name are 0.
struct Law {
    const dashpot::StateLaws &laws;
    Stack stack;
    unsigned *active, moved = 0;

    Law(Arena &arena, const dashpot::StateLaws &given, long instants)
        : laws(given), stack(arena, given.programs, static_cast<int>(rounded(instants))) {
        active = arena.take<unsigned>(given.programs.depth);
    }
    int state(int law) const { return 2 + laws.constants(law); }
    void at(int law, bool rate, const double *d, const double *v, const double *z, const double *constants,
            unsigned wanted) {
        const int row = rate ? laws.count + law : law;
        moved = law_at(laws.programs, row, {d, v, constants, z, state(law)}, wanted, stack, active);
    }
    const double *value() const { return stack.value(0); }
    const double *slope(int name) const { return moved >> name & 1 ? stack.slope(0, name) : nullptr; }
    double slope(int name, long k) const { return moved >> name & 1 ? stack.slope(0, name)[k] : 0; }
};

// The periodic solution of y_k+1 = stays_k y_k + added_k, (times, Q); `total` holds Q numbers.  What never slips keeps
// what it began with: nothing.
static void repeating(const double *stays, const double *added, double *y, double *total, int times, int Q) {
    double kept = 1;
    for (int q = 0; q < Q; ++q) total[q] = 0;
    for (int k = 0; k < times; ++k) {
        for (int q = 0; q < Q; ++q) total[q] = stays[k] * total[q] + added[k * Q + q];
        kept *= stays[k];
    }
    const bool loose = __builtin_fabs(1 - kept) < 1e-12;
    for (int q = 0; q < Q; ++q) total[q] = loose ? 0 : total[q] / (1 - kept);
    for (int k = 0; k < times; ++k)
        for (int q = 0; q < Q; ++q) y[k * Q + q] = total[q], total[q] = stays[k] * total[q] + added[k * Q + q];
}

struct SettledWork {
    Law law;
    double *stays, *added, *change, *tangents, *total, *d, *v, *z;

    SettledWork(Arena &arena, const dashpot::StateLaws &laws, const dashpot::SettledStates &at)
        : law(arena, laws, at.times) {
        const long Q = at.width + laws.constants(at.law), times = rounded(at.times);
        stays = arena.take<double>(times), change = arena.take<double>(times);
        added = arena.take<double>(times * Q), tangents = arena.take<double>(times * Q), total = arena.take<double>(Q);
        for (double **copy : {&d, &v, &z}) *copy = arena.take<double>(times);
        if (arena.base)
            for (double *copy : {d, v, z})
                for (long k = 0; k < times; ++k) copy[k] = 0;
    }
};

static unsigned long settled_workspace(const dashpot::StateLaws &laws, const dashpot::SettledStates &at) {
    Arena arena{nullptr, 0};
    SettledWork(arena, laws, at);
    return arena.used;
}

// dz/dt by the trapezoidal rule, all instants of the period at once by Newton's method.
static void settled_states(const dashpot::StateLaws &laws, const dashpot::SettledStates &at, long from, long to,
                           char *place) {
    Arena arena{place, 0};
    SettledWork work(arena, laws, at);
    Law &law = work.law;
    const int times = at.times, W = at.width, G = laws.constants(at.law), Q = W + G, state = law.state(at.law);
    for (long row = from; row < to; ++row) {
        const double half = 3.14159265358979323846 / (at.omega[row] * times), *g = at.constants + row * G;
        double *z = at.z + row * times, *stays = work.stays, *added = work.added;
        for (int k = 0; k < times; ++k) {
            work.d[k] = at.d[row * times + k], work.v[k] = at.v[row * times + k], work.z[k] = z[k];
        }
        const double size = greater(largest(work.d, times), LEAST_SIZE);
        const auto scale = [&](int k) { return 1 - half * law.slope(state, (k + 1) % times); };
        for (int turn = 0; turn < PERIOD_TURNS; ++turn) {
            law.at(at.law, true, work.d, work.v, work.z, g, 1u << state);
            const double *value = law.value();
            for (int k = 0; k < times; ++k) {
                const int next = (k + 1) % times;
                const double missing = work.z[next] - work.z[k] - half * (value[k] + value[next]);
                stays[k] = (1 + half * law.slope(state, k)) / scale(k), added[k] = -missing / scale(k);
            }
            repeating(stays, added, work.change, work.total, times, 1);
            for (int k = 0; k < times; ++k) work.z[k] += turn < 10 ? work.change[k] : 0.5 * work.change[k];
            const double left = largest(work.change, times) / size;
            if (left <= PERIOD_TOLERANCE || left != left) break;
        }
        for (int k = 0; k < times; ++k) z[k] = work.z[k];
        if (at.slopes) {
            law.at(at.law, true, work.d, work.v, work.z, g, ~0u);
            for (int k = 0; k < times; ++k) {
                const int next = (k + 1) % times;
                double *own = added + static_cast<long>(k) * Q;
                stays[k] = (1 + half * law.slope(state, k)) / scale(k);
                for (int w = 0; w < Q; ++w) own[w] = 0;
                for (const int when : {k, next}) {
                    const double by_d = half * law.slope(0, when) / scale(k);
                    const double by_v = half * law.slope(1, when) / scale(k) * at.omega[row];
                    const double *there = at.there + static_cast<long>(when) * W, *rate = at.rate + static_cast<long>(when) * W;
                    for (int w = 0; w < W; ++w) own[w] += by_d * there[w] + by_v * rate[w];
                    for (int j = 0; j < G; ++j) own[W + j] += half * law.slope(2 + j, when) / scale(k);
                }
            }
            repeating(stays, added, work.tangents, work.total, times, Q);
        }
        law.at(at.law, false, work.d, work.v, work.z, g, at.slopes ? ~0u : 0);
        for (int k = 0; k < times; ++k) at.force[row * times + k] = law.value()[k];
        for (int k = 0; at.slopes && k < times; ++k) {
            double *own = at.slopes + (row * times + k) * Q;
            const double by_z = law.slope(state, k), by_d = law.slope(0, k), by_v = law.slope(1, k) * at.omega[row];
            const double *there = at.there + static_cast<long>(k) * W, *rate = at.rate + static_cast<long>(k) * W;
            const double *tangent = work.tangents + static_cast<long>(k) * Q;
            for (int w = 0; w < W; ++w) own[w] = by_z * tangent[w] + by_d * there[w] + by_v * rate[w];
            for (int j = 0; j < G; ++j) own[W + j] = by_z * tangent[W + j] + law.slope(2 + j, k);
        }
    }
}

static unsigned long history_workspace(const dashpot::StateLaws &laws, int samples) {
    Arena arena{nullptr, 0};
    Law(arena, laws, samples), arena.take<double>(rounded(samples));
    return arena.used;
}

// dz/dt along a history that begins with none, by the trapezoidal rule, all samples at once by Newton's method; d and v
// hold a multiple of 8 numbers, and so does z.
static void state_history(const dashpot::StateLaws &laws, int which, const double *d, const double *v,
                          const double *constants, double h, int samples, double *z, char *place) {
    Arena arena{place, 0};
    Law law(arena, laws, samples);
    double *change = arena.take<double>(rounded(samples));
    const int state = law.state(which);
    const double half = h / 2, size = greater(largest(d, samples), LEAST_SIZE);
    for (long k = 0; k < rounded(samples); ++k) z[k] = 0;
    for (int turn = 0; turn < HISTORY_TURNS; ++turn) {
        law.at(which, true, d, v, z, constants, 1u << state);
        const double *value = law.value();
        change[0] = 0;
        for (int k = 1; k < samples; ++k) {
            const double missing = z[k] - z[k - 1] - half * (value[k] + value[k - 1]);
            change[k] = (missing + (1 + half * law.slope(state, k - 1)) * change[k - 1]) / (1 - half * law.slope(state, k));
        }
        for (int k = 1; k < samples; ++k) z[k] -= turn < 20 ? change[k] : 0.5 * change[k];
        const double left = largest(change, samples);
        if (!(left > HISTORY_TOLERANCE * size)) break;
    }
}

// A (rows, inner) B (inner, Q) added to C (rows, Q); entries of A stand `along` apart in a column, `across` in a row.
static void add_product(const double *A, int along, int across, const double *B, double *__restrict C, int rows, int inner,
                        int Q) {
    for (int i = 0; i < rows; ++i)
        for (int k = 0; k < inner; ++k) {
            const double a = A[i * along + k * across];
            if (a == 0) continue;
            for (int q = 0; q < Q; ++q) C[i * Q + q] += a * B[k * Q + q];
        }
}

// What one step of all segments holds: at the points, instant 4 s + k of segment s.
struct MotionWork {
    const dashpot::StateLaws &laws;
    const dashpot::SegmentedMotion &at;
    const int e, n, G, Q, most;
    const long instants;
    Law law;
    double *d, *v, *z, *a, *free_d, *free_v, *base;  // (e, instants) each but base (segments, 8 n)
    // Slopes of the unit forces and of the states: along d, v at all four points, the start's state, the constants.
    double *by_d, *by_v, *by_z0, *by_g, *held_d, *held_v, *held_z0, *held_g;
    double *matrix, *right, *slope, *after, *nodes, *of_base, *of_load, *of_d, *of_v, *of_a, *forces, *trial;
    double *now;  // (segments, states)
    int *of_state;  // (e,), -1 where there is none

    MotionWork(Arena &arena, const dashpot::StateLaws &given, const dashpot::SegmentedMotion &motion)
        : laws(given), at(motion), e(given.count), n(motion.n), G(given.constant_start[given.count]), Q(motion.columns),
          most(given.programs.names), instants(rounded(4L * motion.segments)), law(arena, given, 4L * motion.segments) {
        const long each = e * instants;
        for (double **of : {&d, &v, &a, &free_d, &free_v, &by_z0, &held_z0}) *of = arena.take<double>(each);
        z = arena.take<double>(each);
        for (double **of : {&by_d, &by_v, &held_d, &held_v}) *of = arena.take<double>(4 * each);
        by_g = arena.take<double>(most * each), held_g = arena.take<double>(most * each);
        base = arena.take<double>(8L * n * at.segments);
        matrix = arena.take<double>(16L * e * e), right = arena.take<double>(4L * e * (Q + 1));
        slope = arena.take<double>(static_cast<long>(at.segments) * at.states * Q);
        after = arena.take<double>(static_cast<long>(at.states) * Q);
        nodes = arena.take<double>(8L * n), of_base = arena.take<double>(8L * n * Q);
        of_load = arena.take<double>(4L * n * at.unknowns);
        for (double **of : {&of_d, &of_v, &of_a}) *of = arena.take<double>(4L * e * Q);
        forces = arena.take<double>(at.elements + 2L * n), trial = arena.take<double>(each);
        now = arena.take<double>(static_cast<long>(at.segments) * at.states);
        of_state = arena.take<int>(e);
        if (!arena.base) return;
        int states = 0;
        for (int i = 0; i < e; ++i) of_state[i] = laws.stateful(i) ? states++ : -1;
        for (double *of : {d, v, z, a})
            for (long k = 0; k < each; ++k) of[k] = 0;
    }

    long place(int i, long instant) const { return i * instants + instant; }

    // States of a law with a rate over the step: one step of Newton's method on the collocation; the last change of z
    // over its size.
    double rated(int i, const double *begun) {
        const int state = law.state(i), count = laws.constants(i);
        const double *g = at.constants + laws.constant_start[i];
        double *own = z + i * instants, moved = 0, size = 0;
        law.at(i, true, d + i * instants, v + i * instants, own, g, ~0u);
        for (long s = 0; s < at.segments; ++s) {
            double left[16], inverse[16], missing[4], product[16];
            const long first = 4 * s;
            for (int j = 0; j < 4; ++j) {
                missing[j] = own[first + j] - begun[s * at.states + 2 * n + of_state[i]];
                for (int k = 0; k < 4; ++k) {
                    const double weight = at.h * at.within[4 * j + k];
                    missing[j] -= weight * law.value()[first + k];
                    left[4 * j + k] = (j == k) - weight * law.slope(state, first + k), inverse[4 * j + k] = j == k;
                }
            }
            eliminate(left, inverse, 4, 4);
            for (int j = 0; j < 4; ++j) {
                double change = 0, sum = 0;
                for (int k = 0; k < 4; ++k) change += inverse[4 * j + k] * missing[k], sum += inverse[4 * j + k];
                own[first + j] -= change;
                moved = greater(__builtin_fabs(change), moved), size = greater(__builtin_fabs(own[first + j]), size);
                held_z0[place(i, first + j)] = sum;
                for (int k = 0; k < 4; ++k) {
                    product[4 * j + k] = 0;
                    for (int l = 0; l < 4; ++l) product[4 * j + k] += inverse[4 * j + l] * at.h * at.within[4 * l + k];
                }
            }
            for (int j = 0; j < 4; ++j) {
                for (int k = 0; k < 4; ++k) {
                    held_d[4 * place(i, first + j) + k] = product[4 * j + k] * law.slope(0, first + k);
                    held_v[4 * place(i, first + j) + k] = product[4 * j + k] * law.slope(1, first + k);
                }
                for (int q = 0; q < count; ++q) {
                    double sum = 0;
                    for (int k = 0; k < 4; ++k) sum += product[4 * j + k] * law.slope(2 + q, first + k);
                    held_g[most * place(i, first + j) + q] = sum;
                }
            }
        }
        return moved / (size + LEAST_SIZE);
    }

    // Stop and play from point to point; the width is the first constant.
    void operated(int i, const double *begun) {
        const double width = at.constants[laws.constant_start[i]];
        const bool play = laws.operated[i] == dashpot::Operator::PLAY;
        for (long s = 0; s < at.segments; ++s) {
            double now = begun[s * at.states + 2 * n + of_state[i]], along[4] = {}, by_start = 1, by_width = 0;
            for (int k = 0; k < 4; ++k) {
                const long here = place(i, 4 * s + k);
                if (!play && k) now += d[here] - d[here - 1], along[k] += 1, along[k - 1] -= 1;
                const double centre = play ? d[here] : 0;
                const bool above = now > centre + width, below = now < centre - width;
                if (above || below) {
                    now = centre + (above ? width : -width), by_start = 0, by_width = above ? 1 : -1;
                    for (int l = 0; l < 4; ++l) along[l] = play && l == k;
                }
                z[here] = now, held_z0[here] = by_start, held_g[most * here] = by_width;
                for (int l = 0; l < 4; ++l) held_d[4 * here + l] = along[l], held_v[4 * here + l] = 0;
            }
        }
    }

    // Unit forces at the points in `to` (e, instants), with their slopes; the last change of states over their size.
    double unit_forces(const double *begun, double *to) {
        double left = 0;
        for (int i = 0; i < e; ++i) {
            const bool stateful = of_state[i] >= 0;
            const int count = laws.constants(i);
            if (laws.rated(i)) left = greater(rated(i, begun), left);
            else if (stateful) operated(i, begun);
            law.at(i, false, d + i * instants, v + i * instants, stateful ? z + i * instants : d + i * instants,
                   at.constants + laws.constant_start[i], ~0u);
            for (long k = 0; k < 4L * at.segments; ++k) {
                const long here = place(i, k);
                const double by_z = stateful ? law.slope(law.state(i), k) : 0;
                to[here] = law.value()[k], by_z0[here] = stateful ? by_z * held_z0[here] : 0;
                for (int l = 0; l < 4; ++l) {
                    const bool same = l == k % 4;
                    by_d[4 * here + l] = (same ? law.slope(0, k) : 0) + (stateful ? by_z * held_d[4 * here + l] : 0);
                    by_v[4 * here + l] = (same ? law.slope(1, k) : 0) + (stateful ? by_z * held_v[4 * here + l] : 0);
                }
                for (int q = 0; q < count; ++q)
                    by_g[most * here + q] = law.slope(2 + q, k) + (stateful ? by_z * held_g[most * here + q] : 0);
            }
        }
        return left;
    }

    // 1 - ∂a/∂d reach_d - ∂a/∂v reach_v over the points of one segment, (4 e, 4 e).
    void take_matrix(long s) {
        const int size = 4 * e;
        for (int j = 0; j < size * size; ++j) matrix[j] = j % (size + 1) == 0;
        for (int k = 0; k < 4; ++k)
            for (int i = 0; i < e; ++i)
                for (int l = 0; l < 4; ++l) {
                    const long here = 4 * place(i, 4 * s + k) + l;
                    const double *far_d = at.reach_d + (l * e + i) * size, *far_v = at.reach_v + (l * e + i) * size;
                    double *row = matrix + (k * e + i) * size;
                    if (by_d[here] != 0)
                        for (int j = 0; j < size; ++j) row[j] -= by_d[here] * far_d[j];
                    if (by_v[here] != 0)
                        for (int j = 0; j < size; ++j) row[j] -= by_v[here] * far_v[j];
                }
    }

    void start_from(const double *begun) {
        for (int i = 0; i < e; ++i)
            for (long k = 0; k < 4L * at.segments; ++k) {
                d[place(i, k)] = free_d[place(i, k)], v[place(i, k)] = free_v[place(i, k)];
                if (of_state[i] >= 0) z[place(i, k)] = begun[k / 4 * at.states + 2 * n + of_state[i]];
            }
        unit_forces(begun, a);
    }

    // Forces at the points of a step by Newton's method on the forces; whether it ends.  `a` and z hold where it begins.
    bool solve(const double *begun) {
        const int size = 4 * e;
        for (int turn = 0; turn < STEP_TURNS; ++turn) {
            for (long s = 0; s < at.segments; ++s)
                for (int k = 0; k < 4; ++k)
                    for (int i = 0; i < e; ++i) {
                        double moved_d = 0, moved_v = 0;
                        for (int l = 0; l < 4; ++l)
                            for (int j = 0; j < e; ++j) {
                                const double force = a[place(j, 4 * s + l)];
                                moved_d += at.reach_d[(k * e + i) * size + l * e + j] * force;
                                moved_v += at.reach_v[(k * e + i) * size + l * e + j] * force;
                            }
                        const long here = place(i, 4 * s + k);
                        d[here] = free_d[here] + moved_d, v[here] = free_v[here] + moved_v;
                    }
            double left = unit_forces(begun, trial), moved = 0, most_force = 0;
            for (long s = 0; s < at.segments; ++s) {
                take_matrix(s);
                for (int k = 0; k < 4; ++k)
                    for (int i = 0; i < e; ++i) right[k * e + i] = trial[place(i, 4 * s + k)] - a[place(i, 4 * s + k)];
                eliminate(matrix, right, size, 1);
                for (int k = 0; k < 4; ++k)
                    for (int i = 0; i < e; ++i) {
                        double &force = a[place(i, 4 * s + k)];
                        force += right[k * e + i];
                        moved = greater(__builtin_fabs(right[k * e + i]), moved);
                        most_force = greater(__builtin_fabs(force), most_force);
                    }
            }
            left = greater(moved / (most_force + LEAST_SIZE), left);
            if (!(left > STEP_TOLERANCE)) return left == left;
        }
        return false;
    }

    // -Bᵀ (a ∂p/∂θ) at the points of a segment whose states there are `nodes`, (4 n, unknowns).
    void unit_loads(long s, long step) {
        const int E = at.elements, m = at.unknowns, r = at.r;
        double *pull = forces + E, *acceleration = pull + n;
        for (int k = 0; k < 4 * n * m; ++k) of_load[k] = 0;
        for (int k = 0; k < 4; ++k) {
            const double *x = nodes + 2 * n * k, *rate = x + n;
            const double *u = at.inputs + (4 * step + k) * 2 * r, *du = u + r;
            for (int j = 0; j < n; ++j) {
                pull[j] = at.force[(4 * step + k) * n + j];
                for (int l = 0; l < n; ++l) pull[j] -= at.K[j * n + l] * x[l] + at.C[j * n + l] * rate[l];
                for (int i = 0; i < e; ++i)
                    pull[j] -= a[place(i, 4 * s + k)] * at.p[at.chosen[i]] * at.B[at.chosen[i] * n + j];
            }
            for (int j = 0; j < n; ++j) {
                acceleration[j] = 0;
                for (int l = 0; l < n; ++l) acceleration[j] += at.inertia[j * n + l] * pull[l];
            }
            for (int element = 0; element < E; ++element) {
                if (at.power[element] < 0) continue;
                const double *of = at.power[element] == 0 ? x : at.power[element] == 1 ? rate : acceleration;
                const double *input = at.power[element] == 0 ? u : du;
                double moved = 0;
                for (int j = 0; j < n; ++j) moved += of[j] * at.B[element * n + j];
                for (int j = 0; j < r && at.power[element] < 2; ++j) moved += input[j] * at.D[element * r + j];
                forces[element] = moved;
            }
            for (int i = 0; i < e; ++i) forces[at.chosen[i]] = a[place(i, 4 * s + k)];
            for (int element = 0; element < E; ++element)
                for (int j = 0; j < n; ++j) {
                    const double along = at.B[element * n + j] * forces[element];
                    if (along == 0) continue;
                    double *load = of_load + (k * n + j) * m;
                    for (int q = 0; q < m; ++q) load[q] -= along * at.T[element * m + q];
                }
        }
    }

    // Slopes behind the step of one segment from those before it, in their place.
    void take_slopes(long s, long step) {
        const int x = at.states, m = at.unknowns, size = 4 * e;
        double *own = slope + s * x * Q;
        for (int j = 0; j < 8 * n * Q; ++j) of_base[j] = 0;
        for (int j = 0; j < size * Q; ++j) of_d[j] = of_v[j] = of_a[j] = 0;
        add_product(at.grown, 1, 8 * n, own, of_base, 8 * n, 2 * n, Q);
        for (int k = 0; k < 4; ++k)
            for (int i = 0; i < e; ++i)
                if (of_state[i] >= 0) {
                    const double weight = by_z0[place(i, 4 * s + k)], *from = own + (2 * n + of_state[i]) * Q;
                    for (int q = 0; q < Q; ++q) of_a[(k * e + i) * Q + q] += weight * from[q];
                }
        const bool unknowns = Q > x;
        if (unknowns) {
            for (int k = 0; k < 4; ++k)
                for (int i = 0; i < e; ++i)
                    for (int g = 0; g < laws.constants(i); ++g) {
                        const double weight = by_g[most * place(i, 4 * s + k) + g];
                        const double *along = at.by_unknowns + (laws.constant_start[i] + g) * m;
                        for (int q = 0; q < m; ++q) of_a[(k * e + i) * Q + x + q] += weight * along[q];
                    }
            unit_loads(s, step);
            for (int j = 0; j < 8 * n; ++j) {
                double *to = of_base + j * Q + x;
                for (int l = 0; l < 4 * n; ++l) {
                    const double weight = at.driven[j * 4 * n + l];
                    for (int q = 0; q < m; ++q) to[q] += weight * of_load[l * m + q];
                }
                for (int q = 0; q < at.offsets; ++q) to[m + q] += at.offset_moved[j * at.offsets + q];
            }
        }
        for (int k = 0; k < 4; ++k)
            for (int i = 0; i < e; ++i) {
                const double *B = at.B + at.chosen[i] * n;
                add_product(B, n, 1, of_base + 2 * n * k * Q, of_d + (k * e + i) * Q, 1, n, Q);
                add_product(B, n, 1, of_base + (2 * n * k + n) * Q, of_v + (k * e + i) * Q, 1, n, Q);
            }
        for (int k = 0; k < 4; ++k)
            for (int i = 0; i < e; ++i)
                for (int l = 0; l < 4; ++l) {
                    const double of_this = by_d[4 * place(i, 4 * s + k) + l], of_rate = by_v[4 * place(i, 4 * s + k) + l];
                    if (of_this == 0 && of_rate == 0) continue;
                    const double *along = of_d + (l * e + i) * Q, *rate = of_v + (l * e + i) * Q;
                    for (int q = 0; q < Q; ++q) of_a[(k * e + i) * Q + q] += of_this * along[q] + of_rate * rate[q];
                }
        take_matrix(s);
        eliminate(matrix, of_a, size, Q);
        for (int j = 0; j < 2 * n; ++j)
            for (int q = 0; q < Q; ++q) after[j * Q + q] = of_base[(6 * n + j) * Q + q];
        add_product(at.pulled + 3L * 2 * n * size, size, 1, of_a, after, 2 * n, size, Q);
        add_product(at.reach_d, size, 1, of_a, of_d, size, size, Q);
        add_product(at.reach_v, size, 1, of_a, of_v, size, size, Q);
        for (int i = 0; i < e; ++i) {
            if (of_state[i] < 0) continue;
            const long end = place(i, 4 * s + 3);
            double *to = after + (2 * n + of_state[i]) * Q;
            const double *from = own + (2 * n + of_state[i]) * Q;
            for (int q = 0; q < Q; ++q) to[q] = held_z0[end] * from[q];
            for (int l = 0; l < 4; ++l) {
                const double of_this = held_d[4 * end + l], of_rate = held_v[4 * end + l];
                for (int q = 0; q < Q; ++q)
                    to[q] += of_this * of_d[(l * e + i) * Q + q] + of_rate * of_v[(l * e + i) * Q + q];
            }
            for (int g = 0; unknowns && g < laws.constants(i); ++g)
                for (int q = 0; q < m; ++q)
                    to[x + q] += held_g[most * end + g] * at.by_unknowns[(laws.constant_start[i] + g) * m + q];
        }
        for (int j = 0; j < x * Q; ++j) own[j] = after[j];
    }
};

static unsigned long motion_workspace(const dashpot::StateLaws &laws, const dashpot::SegmentedMotion &at) {
    Arena arena{nullptr, 0};
    MotionWork(arena, laws, at);
    return arena.used;
}

// One pass over all segments; no numbers where the forces of a step have no one answer.
static void follow_motion(const dashpot::StateLaws &laws, const dashpot::SegmentedMotion &at, char *place) {
    Arena arena{place, 0};
    MotionWork work(arena, laws, at);
    const int n = at.n, e = laws.count, x = at.states, Q = at.columns, size = 4 * e, states = x - 2 * n;
    const long S = at.segments;
    for (long k = 0; k < S * x; ++k) at.state[k] = work.now[k] = at.begun[k];
    for (long k = 0; k < S * x * Q; ++k) work.slope[k] = k % (static_cast<long>(x) * Q) % (Q + 1) == 0;
    if (at.whole)
        for (long k = 0; k < S * x * Q; ++k) at.slopes[k] = work.slope[k];
    for (int step = 0; step < at.steps; ++step) {
        const auto index = [&](long s) {
            const long long here = at.first[s] + step;
            return static_cast<long>(here < at.last ? here : at.last);
        };
        for (long s = 0; s < S; ++s) {
            double *base = work.base + 8L * n * s;
            for (int j = 0; j < 8 * n; ++j) base[j] = at.forced[index(s) * 8 * n + j];
            for (int y = 0; y < 2 * n; ++y)
                for (int j = 0; j < 8 * n; ++j) base[j] += work.now[s * x + y] * at.grown[y * 8 * n + j];
            for (int k = 0; k < 4; ++k)
                for (int i = 0; i < e; ++i) {
                    const double *B = at.B + at.chosen[i] * n;
                    double d = at.moved_d[(index(s) * 4 + k) * e + i], v = at.moved_v[(index(s) * 4 + k) * e + i];
                    for (int j = 0; j < n; ++j) d += base[2 * n * k + j] * B[j], v += base[2 * n * k + n + j] * B[j];
                    work.free_d[work.place(i, 4 * s + k)] = d, work.free_v[work.place(i, 4 * s + k)] = v;
                }
        }
        const double *known_a = at.guess_a ? at.guess_a + step * S * size : nullptr;
        const double *known_z = at.guess_z ? at.guess_z + step * S * 4 * states : nullptr;
        bool guessed = known_a;
        for (long k = 0; guessed && k < S * size; ++k) guessed = __builtin_isfinite(known_a[k]);
        if (guessed)
            for (long k = 0; k < 4 * S; ++k)
                for (int i = 0; i < e; ++i) {
                    work.a[work.place(i, k)] = known_a[k * e + i];
                    if (work.of_state[i] >= 0) work.z[work.place(i, k)] = known_z[k * states + work.of_state[i]];
                }
        else work.start_from(work.now);
        if (!work.solve(work.now) && guessed) work.start_from(work.now), work.solve(work.now);
        for (long s = 0; s < S; ++s) {
            for (int j = 0; j < 8 * n; ++j) {
                double moved = work.base[8L * n * s + j];
                const double *row = at.pulled + static_cast<long>(j) * size;
                for (int k = 0; k < 4; ++k)
                    for (int i = 0; i < e; ++i) moved += row[k * e + i] * work.a[work.place(i, 4 * s + k)];
                work.nodes[j] = moved;
            }
            if (Q) work.take_slopes(s, index(s));
            for (int j = 0; j < 2 * n; ++j) work.now[s * x + j] = work.nodes[6 * n + j];
            for (int i = 0; i < e; ++i)
                if (work.of_state[i] >= 0) work.now[s * x + 2 * n + work.of_state[i]] = work.z[work.place(i, 4 * s + 3)];
            for (int k = 0; k < 4; ++k)
                for (int i = 0; i < e; ++i) {
                    const long here = (step * S + s) * 4 + k;
                    at.a[here * e + i] = work.a[work.place(i, 4 * s + k)];
                    if (work.of_state[i] >= 0) at.z[here * states + work.of_state[i]] = work.z[work.place(i, 4 * s + k)];
                }
        }
        if ((step + 1) % at.substeps) continue;
        const long sample = (step + 1) / at.substeps;
        for (long k = 0; k < S * x; ++k) at.state[sample * S * x + k] = work.now[k];
        if (at.whole)
            for (long k = 0; k < S * x * Q; ++k) at.slopes[sample * S * x * Q + k] = work.slope[k];
    }
    for (long k = 0; !at.whole && k < S * x * Q; ++k) at.slopes[k] = work.slope[k];
}

}  // namespace DASHPOT_SET
