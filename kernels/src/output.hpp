// The channels of K repeats: cost, slope and information of y = kappa G(theta) q + noise, inputs eliminated line by
// line, and its search.  Twin: dashpot.estimate.likelihood.objective.
#pragma once
#include "dense.hpp"
#include "equation.hpp"
#include "problem.hpp"
#include "search.hpp"

namespace DASHPOT_SET {

constexpr double BLIND = 1e-12;        // relative precision of "zero" for inputs that no channel of a line sees
constexpr double LOG_RESIDUAL = 0.5;   // nepers beyond which a residual of logarithms counts by its size
constexpr double UNSAFE = 1e-6;        // squared ratio of pivot and column below which rows are exchanged

struct OutputWork {
    const dashpot::Output *problem;
    Searcher search;
    double *p, *A, *y, *W, *inputs, *weight;
    C *both, *factors, *sides, *looks, *kappa, *G, *WG, *normal, *half, *q, *x, *r, *Wr, *J, *PJ, *onto, *force, *shown;
    V *gradient, *symmetric, *scale;
    int *slopes_of, slope_channels, seeing, *seen, sides_count;
    long packed_y, packed_W;

    int count_inputs() const { return problem->rig->r + problem->rig->s; }

    void lay(Arena &arena, const dashpot::Output &output) {
        problem = &output;
        const dashpot::Rig &rig = *output.rig;
        const int n = rig.n, nq = rig.r + rig.s, Cs = output.channels, M = output.all, stride = rig.stride;
        search.lay(arena, M);
        p = arena.take<double>(rig.elements);
        A = arena.take<double>(4 * n * (n + rig.r));
        const long packed = output.y ? stride : 0;
        y = arena.take<double>(2l * Cs * packed);
        W = arena.take<double>(2l * (output.diagonal ? Cs : Cs * Cs) * packed);
        inputs = arena.take<double>(2l * nq * packed);
        weight = arena.take<double>(1l * Cs * packed);
        both = arena.take<C>(n * (n + rig.r));
        factors = arena.take<C>(n * n);
        sides = arena.take<C>(n * (Cs + nq + 1));
        looks = arena.take<C>(Cs * n);
        kappa = arena.take<C>(Cs), shown = arena.take<C>(Cs), r = arena.take<C>(Cs), Wr = arena.take<C>(Cs);
        G = arena.take<C>(Cs * nq), WG = arena.take<C>(Cs * nq), half = arena.take<C>(Cs * nq);
        normal = arena.take<C>(nq * nq), q = arena.take<C>(nq), x = arena.take<C>(n);
        J = arena.take<C>(Cs * M), PJ = arena.take<C>(Cs * M), onto = arena.take<C>(nq * M);
        force = arena.take<C>(rig.elements);
        gradient = arena.take<V>(M), symmetric = arena.take<V>(M * M), scale = arena.take<V>(nq);
        slopes_of = arena.take<int>(Cs), seen = arena.take<int>(Cs);
        packed_y = packed_W = -1;
        slope_channels = seeing = sides_count = 0;
        if (!arena.base) return;
        for (int k = 0; k < n * (n + rig.r); ++k) both[k] = zero();
        for (int c = 0; c < Cs; ++c) {
            if (output.sees[c]) seen[seeing++] = c;
            if (output.sees[c] || output.gain[c] >= 0 || output.delay[c] >= 0) slopes_of[slope_channels++] = c;
        }
    }

    // Copies of one repeat's data with lines side by side; lines that fill up the lanes weigh nothing.
    void pack(long repeat) {
        const dashpot::Output &output = *problem;
        const dashpot::Rig &rig = *output.rig;
        const int Cs = output.channels, nq = count_inputs(), lines = rig.lines, stride = rig.stride;
        if (packed_y != repeat) {
            packed_y = repeat;
            pack_complex(output.y + 2l * repeat * lines * Cs, Cs, y);
            if (output.inputs) pack_complex(output.inputs + 2l * repeat * lines * nq, nq, inputs);
        }
        const long of_weight = output.shared ? 0 : repeat;
        if (packed_W == of_weight) return;
        packed_W = of_weight;
        const double *from = output.W + 2l * of_weight * lines * Cs * Cs;
        if (!output.diagonal) {
            pack_complex(from, Cs * Cs, W);
            return;
        }
        for (int c = 0; c < Cs; ++c)
            for (int l = 0; l < stride; ++l) W[c * stride + l] = l < lines ? from[2 * (l * Cs * Cs + c * Cs + c)] : 0.0;
    }

    void pack_complex(const double *from, int count, double *to) const {
        const int lines = problem->rig->lines, stride = problem->rig->stride;
        for (int c = 0; c < count; ++c)
            for (int part = 0; part < 2; ++part)
                for (int l = 0; l < stride; ++l)
                    to[(2 * c + part) * stride + l] = l < lines ? from[2l * (l * count + c) + part] : 0.0;
    }

    void pack_weight(const double *from) {
        const int Cs = problem->channels, lines = problem->rig->lines, stride = problem->rig->stride;
        for (int c = 0; c < Cs; ++c)
            for (int l = 0; l < stride; ++l) weight[c * stride + l] = l < lines ? from[l * Cs + c] : 0.0;
    }

    C complex_at(const double *packed, int k, int at) const {
        const int stride = problem->rig->stride;
        return {load(packed + 2 * k * stride + at), load(packed + (2 * k + 1) * stride + at)};
    }

    INLINE C turned(C x, bool by_j) { return by_j ? C{-x.im, x.re} : x; }

    // What each channel shows of coordinates, before calibration: C_x with the forces of elements.
    void look(int at) {
        const dashpot::Output &output = *problem;
        const dashpot::Rig &rig = *output.rig;
        const int n = rig.n;
        for (int k = 0; k < seeing; ++k) {
            const int c = seen[k];
            const V rate = load(output.rate + c * rig.stride + at);
            for (int i = 0; i < n; ++i)
                looks[c * n + i] = turned({rate * output.on_x[c * n + i], V{}}, output.turned[c]);
            if (!output.has_force[c]) continue;
            for (int e = 0; e < rig.elements; ++e) {
                const double factor = output.force[c * rig.elements + e];
                if (factor == 0) continue;
                const C stiff = times_phi(rig, e, at, {all(factor * p[e]), V{}});
                for (int t = rig.join_start[e]; t < rig.join_start[e + 1]; ++t)
                    if (rig.join_point[t] < n)
                        looks[c * n + rig.join_point[t]] = looks[c * n + rig.join_point[t]] + stiff * rig.join_value[t];
            }
        }
    }

    // What channel c shows of input j directly.
    C direct(int c, int j, int at) const {
        const dashpot::Output &output = *problem;
        const dashpot::Rig &rig = *output.rig;
        C sum = turned({load(output.rate + c * rig.stride + at) * output.on_q[c * count_inputs() + j], V{}},
                       output.turned[c]);
        if (!output.has_force[c] || j >= rig.r) return sum;
        for (int e = 0; e < rig.elements; ++e) {
            const double factor = output.force[c * rig.elements + e];
            if (factor == 0) continue;
            for (int t = rig.join_start[e]; t < rig.join_start[e + 1]; ++t)
                if (rig.join_point[t] == rig.n + j)
                    sum = sum + times_phi(rig, e, at, {all(factor * p[e] * rig.join_value[t]), V{}});
        }
        return sum;
    }

    // sides <- D^-1 sides, (n, count) by rows; D symmetric, its pivots where they are safe, else rows exchanged.
    void solve(int count) {
        const dashpot::Rig &rig = *problem->rig;
        const int n = rig.n, points = n + rig.r;
        for (int i = 0; i < n; ++i)
            for (int j = 0; j < n; ++j) factors[i * n + j] = both[i * points + j];
        Mask unsafe = {};
        for (int k = 0; k < n; ++k) {
            V most = V{};
            for (int j = k + 1; j < n; ++j) most = larger(most, norm(factors[k * n + j]));
            unsafe |= ~(norm(factors[k * n + k]) > UNSAFE * most);
            const C pivot = inverse(factors[k * n + k]);
            for (int i = k + 1; i < n; ++i) {
                const C factor = factors[k * n + i] * pivot;
                for (int j = i; j < n; ++j) subtract(factors[i * n + j], factor, factors[k * n + j]);
                factors[i * n + k] = factor;
            }
            factors[k * n + k] = pivot;
        }
        if (any(unsafe)) return solve_with_exchanges(count);
        for (int i = 1; i < n; ++i)
            for (int k = 0; k < i; ++k)
                for (int c = 0; c < count; ++c) subtract(sides[i * count + c], factors[i * n + k], sides[k * count + c]);
        for (int i = n - 1; i >= 0; --i)
            for (int c = 0; c < count; ++c) {
                C sum = sides[i * count + c];
                for (int k = i + 1; k < n; ++k) subtract(sum, factors[i * n + k], sides[k * count + c]);
                sides[i * count + c] = sum * factors[i * n + i];
            }
    }

    void solve_with_exchanges(int count) {
        const dashpot::Rig &rig = *problem->rig;
        const int n = rig.n, points = n + rig.r;
        for (int i = 0; i < n; ++i)
            for (int j = 0; j < n; ++j) factors[i * n + j] = both[i * points + j];
        for (int k = 0; k < n; ++k) {
            for (int i = k + 1; i < n; ++i) {
                const Mask swap = norm(factors[i * n + k]) > norm(factors[k * n + k]);
                if (!any(swap)) continue;
                for (int j = k; j < n; ++j) exchange(swap, factors[k * n + j], factors[i * n + j]);
                for (int c = 0; c < count; ++c) exchange(swap, sides[k * count + c], sides[i * count + c]);
            }
            const C pivot = inverse(factors[k * n + k]);
            for (int i = k + 1; i < n; ++i) {
                const C factor = factors[i * n + k] * pivot;
                for (int j = k + 1; j < n; ++j) subtract(factors[i * n + j], factor, factors[k * n + j]);
                for (int c = 0; c < count; ++c) subtract(sides[i * count + c], factor, sides[k * count + c]);
            }
            factors[k * n + k] = pivot;
        }
        for (int i = n - 1; i >= 0; --i)
            for (int c = 0; c < count; ++c) {
                C sum = sides[i * count + c];
                for (int k = i + 1; k < n; ++k) subtract(sum, factors[i * n + k], sides[k * count + c]);
                sides[i * count + c] = sum * factors[i * n + i];
            }
    }

    INLINE void exchange(Mask swap, C &a, C &b) {
        const C first = choose(swap, b, a), second = choose(swap, a, b);
        a = first, b = second;
    }

    void calibrate(const double *psi, const double *sign, int at) {
        const dashpot::Output &output = *problem;
        const dashpot::Rig &rig = *output.rig;
        for (int c = 0; c < output.channels; ++c) {
            kappa[c] = {all(sign[c]), V{}};
            if (output.gain[c] >= 0) kappa[c].re *= psi[rig.unknowns + output.gain[c]];
            if (output.delay[c] < 0) continue;
            const double late = psi[rig.unknowns + output.gains + output.delay[c]];
            for (int k = 0; k < LANES; ++k) {
                const double phase = -output.omega[at + k] * late, size = kappa[c].re[k];
                kappa[c].re[k] = size * __builtin_cos(phase);
                kappa[c].im[k] = size * __builtin_sin(phase);
            }
        }
    }

    // Force on coordinate i per unit of input j.
    C push(int i, int j) const {
        const dashpot::Rig &rig = *problem->rig;
        return j < rig.r ? -both[i * (rig.n + rig.r) + rig.n + j] : C{all(rig.S[i * rig.s + j - rig.r]), V{}};
    }

    // G: what the channels show of each input, whose response stands in `sides` from column `first` on.
    void respond_to_inputs(int first, int at) {
        const dashpot::Output &output = *problem;
        const int n = output.rig->n, nq = count_inputs();
        for (int c = 0; c < output.channels; ++c)
            for (int j = 0; j < nq; ++j) {
                C sum = direct(c, j, at);
                if (output.sees[c])
                    for (int i = 0; i < n; ++i) add(sum, looks[c * n + i], sides[i * sides_count + first + j]);
                G[c * nq + j] = output.calibrated ? kappa[c] * sum : sum;
            }
    }

    // Shown amplitudes, residuals, motion x and inputs q at some lines; the adjoints stand in `sides`.
    void respond(const double *psi, const double *sign, int at, bool adjoint) {
        const dashpot::Output &output = *problem;
        const dashpot::Rig &rig = *output.rig;
        const int n = rig.n, nq = count_inputs(), Cs = output.channels;
        const bool given = output.inputs != nullptr;
        stiffness(rig, A, at, both);
        look(at);
        const int first = adjoint ? seeing : 0, count = sides_count = first + (given ? 1 : nq);
        if (given)
            for (int j = 0; j < nq; ++j) q[j] = complex_at(inputs, j, at);
        for (int i = 0; i < n; ++i) {
            C *row = sides + i * count;
            if (adjoint)
                for (int k = 0; k < seeing; ++k) row[k] = looks[seen[k] * n + i];
            C driven = zero();
            for (int j = 0; j < nq; ++j) {
                if (given) add(driven, push(i, j), q[j]);
                else row[first + j] = push(i, j);
            }
            if (given) row[first] = driven;
        }
        solve(count);
        if (output.calibrated) calibrate(psi, sign, at);
        if (given) {
            for (int i = 0; i < n; ++i) x[i] = sides[i * count + first];
            for (int c = 0; c < Cs; ++c) {
                C sum = zero();
                for (int j = 0; j < nq; ++j) add(sum, direct(c, j, at), q[j]);
                if (output.sees[c])
                    for (int i = 0; i < n; ++i) add(sum, looks[c * n + i], x[i]);
                shown[c] = output.calibrated ? kappa[c] * sum : sum;
            }
        } else {
            respond_to_inputs(first, at);
            estimate_inputs(at);
            for (int c = 0; c < Cs; ++c) {
                C sum = zero();
                for (int j = 0; j < nq; ++j) add(sum, G[c * nq + j], q[j]);
                shown[c] = sum;
            }
            for (int i = 0; i < n; ++i) {
                C sum = zero();
                for (int j = 0; j < nq; ++j) add(sum, sides[i * count + first + j], q[j]);
                x[i] = sum;
            }
        }
        for (int c = 0; c < Cs; ++c) r[c] = complex_at(y, c, at) - shown[c];
    }

    // out <- W in, (channels, count) by rows.
    void weigh(const C *in, C *out, int count, int at) const {
        const int Cs = problem->channels, stride = problem->rig->stride;
        if (problem->diagonal) {
            for (int c = 0; c < Cs; ++c) {
                const V own = load(W + c * stride + at);
                for (int k = 0; k < count; ++k) out[c * count + k] = in[c * count + k] * own;
            }
            return;
        }
        for (int c = 0; c < Cs; ++c) {
            for (int k = 0; k < count; ++k) out[c * count + k] = zero();
            for (int d = 0; d < Cs; ++d) {
                const C own = complex_at(W, c * Cs + d, at);
                for (int k = 0; k < count; ++k) add(out[c * count + k], own, in[d * count + k]);
            }
        }
    }

    // q by generalised least squares and half = W G (G^H W G)^-1.
    void estimate_inputs(int at) {
        const int nq = count_inputs(), Cs = problem->channels;
        weigh(G, WG, nq, at);
        for (int i = 0; i < nq; ++i)
            for (int j = 0; j <= i; ++j) {
                C sum = zero();
                for (int c = 0; c < Cs; ++c) add_conj(sum, G[c * nq + i], WG[c * nq + j]);
                normal[i * nq + j] = sum;
            }
        for (int i = 0; i < nq; ++i) {
            const V power = normal[i * nq + i].re;
            scale[i] = 1.0 / square_root(power > 0 ? power : all(1.0));
        }
        for (int i = 0; i < nq; ++i) {
            for (int j = 0; j <= i; ++j) normal[i * nq + j] = normal[i * nq + j] * (scale[i] * scale[j]);
            normal[i * nq + i].re += BLIND;
        }
        // L diag L^H; the pivots' inverses stand on the diagonal.
        for (int k = 0; k < nq; ++k) {
            const V pivot = 1.0 / normal[k * nq + k].re;
            normal[k * nq + k].re = pivot;
            for (int i = k + 1; i < nq; ++i) {
                const C factor = normal[i * nq + k] * pivot;
                for (int j = k + 1; j <= i; ++j) subtract(normal[i * nq + j], factor, conj(normal[j * nq + k]));
            }
            for (int i = k + 1; i < nq; ++i) normal[i * nq + k] = normal[i * nq + k] * pivot;
        }
        for (int j = 0; j < nq; ++j) q[j] = zero();
        for (int c = 0; c < Cs; ++c) {
            C *row = half + c * nq;  // conj of the solution of this channel
            for (int j = 0; j < nq; ++j) row[j] = conj(WG[c * nq + j]) * scale[j];
            for (int i = 1; i < nq; ++i)
                for (int k = 0; k < i; ++k) subtract(row[i], normal[i * nq + k], row[k]);
            for (int i = nq - 1; i >= 0; --i) {
                row[i] = row[i] * normal[i * nq + i].re;
                for (int k = i + 1; k < nq; ++k) subtract_conj(row[i], normal[k * nq + i], row[k]);
            }
            for (int j = 0; j < nq; ++j) {
                row[j] = row[j] * scale[j];
                add(q[j], row[j], complex_at(y, c, at));
                row[j] = conj(row[j]);
            }
        }
    }

    // Slopes of what is shown at fixed inputs, (channels, all).
    void slopes(const double *psi, int at) {
        const dashpot::Output &output = *problem;
        const dashpot::Rig &rig = *output.rig;
        const int n = rig.n, m = rig.unknowns, M = output.all, count = sides_count;
        for (int a = 0; a < rig.active; ++a) {
            const int e = rig.active_element[a];
            C sum = zero();
            for (int t = rig.join_start[e]; t < rig.join_start[e + 1]; ++t) {
                const int point = rig.join_point[t];
                sum = sum + (point < n ? x[point] : q[point - n]) * rig.join_value[t];
            }
            force[a] = times_phi(rig, e, at, sum);
        }
        for (int c = 0; c < output.channels * M; ++c) J[c] = zero();
        for (int k = 0; k < seeing; ++k) {
            const int c = seen[k];
            C *row = J + c * M;
            for (int j = 0; j < m; ++j)
                for (int t = rig.tie_start[j]; t < rig.tie_start[j + 1]; ++t) {
                    const int a = rig.tie_active[t], e = rig.active_element[a];
                    C effect = {all(output.force[c * rig.elements + e]), V{}};
                    for (int u = rig.join_start[e]; u < rig.join_start[e + 1]; ++u)
                        if (rig.join_point[u] < n)
                            effect = effect - sides[rig.join_point[u] * count + k] * rig.join_value[u];
                    row[j] = row[j] + effect * force[a] * rig.tie_value[t];
                }
            if (output.calibrated)
                for (int j = 0; j < m; ++j) row[j] = row[j] * kappa[c];
        }
        for (int k = 0; k < slope_channels; ++k) {
            const int c = slopes_of[k];
            if (output.gain[c] >= 0) J[c * M + m + output.gain[c]] = shown[c] * (1 / psi[m + output.gain[c]]);
            if (output.delay[c] >= 0) {
                const V omega = load(output.omega + at);
                J[c * M + m + output.gains + output.delay[c]] = {shown[c].im * omega, -shown[c].re * omega};
            }
        }
    }

    // Adds the sums of some lines to gradient and symmetric; the cost of these lines is the result.
    V squares(const double *psi, const double *sign, int at, bool with_slopes) {
        const dashpot::Output &output = *problem;
        const int Cs = output.channels, M = output.all, nq = count_inputs();
        respond(psi, sign, at, with_slopes);
        weigh(r, Wr, 1, at);
        V cost = V{};
        for (int c = 0; c < Cs; ++c) cost += dot(r[c], Wr[c]);
        if (!with_slopes) return 2.0 * cost;
        slopes(psi, at);
        weigh(J, PJ, M, at);
        if (!output.inputs)
            for (int j = 0; j < nq; ++j)
                for (int k = 0; k < M; ++k) {
                    C sum = zero();
                    for (int c = 0; c < Cs; ++c) add_conj(sum, G[c * nq + j], PJ[c * M + k]);
                    onto[j * M + k] = sum;
                }
        if (!output.inputs)
            for (int c = 0; c < Cs; ++c)
                for (int j = 0; j < nq; ++j)
                    for (int k = 0; k < M; ++k) subtract(PJ[c * M + k], half[c * nq + j], onto[j * M + k]);
        for (int i = 0; i < slope_channels; ++i) {
            const int c = slopes_of[i];
            for (int k = 0; k < M; ++k) {
                const C own = J[c * M + k];
                gradient[k] += dot(own, Wr[c]);
                for (int j = k; j < M; ++j) symmetric[k * M + j] += dot(own, PJ[c * M + j]);
            }
        }
        return 2.0 * cost;
    }

    // As `squares`, of the residuals ln y - ln shown, large ones counting by their size.
    V logarithms(const double *psi, const double *sign, int at, bool with_slopes) {
        const dashpot::Output &output = *problem;
        const int Cs = output.channels, M = output.all, stride = output.rig->stride;
        respond(psi, sign, at, with_slopes);
        if (with_slopes) slopes(psi, at);
        V cost = V{};
        for (int c = 0; c < Cs; ++c) {
            const C measured = complex_at(y, c, at);
            const V weighed = load(weight + c * stride + at);
            const Mask counts = ((measured.re != 0) | (measured.im != 0)) & (weighed > 0);
            if (!any(counts)) continue;
            const C per_shown = inverse(shown[c]), ratio = measured * per_shown;
            C rho = zero();
            for (int k = 0; k < LANES; ++k) {
                if (!counts[k]) continue;
                rho.re[k] = 0.5 * __builtin_log(ratio.re[k] * ratio.re[k] + ratio.im[k] * ratio.im[k]);
                rho.im[k] = __builtin_atan2(ratio.im[k], ratio.re[k]);
            }
            const V stretch = square_root(1.0 + norm(rho) / (LOG_RESIDUAL * LOG_RESIDUAL));
            const V counted = counts ? weighed : V{};
            cost += counted * (stretch - 1.0);
            if (!with_slopes) continue;
            const V share = counted / stretch;
            C *row = J + c * M;
            for (int k = 0; k < M; ++k) row[k] = choose(counts, row[k] * per_shown, zero());
            for (int k = 0; k < M; ++k) {
                const C own = row[k] * share;
                gradient[k] += dot(own, rho);
                for (int j = k; j < M; ++j) symmetric[k * M + j] += dot(own, row[j]);
            }
        }
        return 4 * LOG_RESIDUAL * LOG_RESIDUAL * cost;
    }

    void clear() {
        const int M = problem->all;
        for (int k = 0; k < M; ++k) gradient[k] = V{};
        for (int k = 0; k < M * M; ++k) symmetric[k] = V{};
    }

    // Everything at psi, with priors; without slopes the cost alone.
    void evaluate(const double *psi, const double *sign, int kind, bool with_slopes, Quadratic &out) {
        const dashpot::Output &output = *problem;
        const dashpot::Rig &rig = *output.rig;
        const int M = output.all;
        assemble(rig, psi, p, A);
        if (with_slopes) clear();
        V cost = V{};
        for (int at = 0; at < rig.lines; at += LANES)
            cost += kind == dashpot::SQUARES ? squares(psi, sign, at, with_slopes)
                                             : logarithms(psi, sign, at, with_slopes);
        out.cost = total(cost);
        for (int k = 0; k < M; ++k) {
            const double away = psi[k] - output.mean[k];
            out.cost += output.precision[k] * away * away;
            if (!with_slopes) continue;
            out.gradient[k] = 2 * total(gradient[k]) - output.precision[k] * away;
            for (int j = k; j < M; ++j)
                out.symmetric[k * M + j] = out.symmetric[j * M + k] = 2 * total(symmetric[k * M + j]);
            out.symmetric[k * M + k] += output.precision[k];
        }
    }
};

static unsigned long output_workspace(const dashpot::Output &problem) {
    Arena arena{nullptr, 0};
    OutputWork work;
    work.lay(arena, problem);
    return arena.used;
}

// Weights of logarithms: (lines, channels) of all rows, or those of each row.
static void output_evaluate(const dashpot::Output &problem, const double *psi, const double *sign,
                            const long long *rows, long from, long to, int kind, const double *weight, bool slopes,
                            double *cost, double *gradient, double *information, char *memory) {
    Arena arena{memory, 0};
    OutputWork work;
    work.lay(arena, problem);
    const int M = problem.all;
    if (weight) work.pack_weight(weight);
    for (long k = from; k < to; ++k) {
        work.pack(rows[k]);
        Quadratic out{0, gradient + k * M, information + k * M * M, nullptr};
        work.evaluate(psi + k * M, sign + k * problem.channels, kind, slopes, out);
        cost[k] = out.cost;
    }
}

static void output_lines(const dashpot::Output &problem, const double *psi, const double *sign, long from, long to,
                         double *information, double *scores, double *cost, char *memory) {
    Arena arena{memory, 0};
    OutputWork work;
    work.lay(arena, problem);
    const dashpot::Rig &rig = *problem.rig;
    const int M = problem.all;
    for (long k = from; k < to; ++k) {
        work.pack(k);
        assemble(rig, psi + k * M, work.p, work.A);
        for (int at = 0; at < rig.lines; at += LANES) {
            work.clear();
            const V costs = work.squares(psi + k * M, sign + k * problem.channels, at, true);
            for (int lane = 0; lane < LANES && at + lane < rig.lines; ++lane) {
                const long line = k * rig.lines + at + lane;
                cost[line] = costs[lane];
                for (int i = 0; i < M; ++i) {
                    scores[line * M + i] = 2 * work.gradient[i][lane];
                    for (int j = i; j < M; ++j)
                        information[(line * M + i) * M + j] = information[(line * M + j) * M + i] =
                            2 * work.symmetric[i * M + j][lane];
                }
            }
        }
    }
}

static void output_descend(const dashpot::Output &problem, const double *start, const double *sign,
                           const long long *rows, long from, long to, int kind, const double *weight,
                           const dashpot::Limits &limits, const dashpot::Ends &ends, char *memory) {
    Arena arena{memory, 0};
    OutputWork work;
    work.lay(arena, problem);
    const int M = problem.all;
    if (weight) work.pack_weight(weight);
    const double *signs = sign;
    auto evaluate = [&](const double *psi, Quadratic &out) {
        work.evaluate(psi, signs, kind, true, out);
        for (int k = 0; k < M * M; ++k) out.free[k] = out.symmetric[k];
    };
    for (long k = from; k < to; ++k) {
        work.pack(rows[k]);
        signs = sign + k * problem.channels;
        minimise(work.search, evaluate, start + k * M, limits, ends, k, k == 0);
    }
}

}  // namespace DASHPOT_SET
