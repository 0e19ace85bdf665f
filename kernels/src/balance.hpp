// Harmonic balance of dwells: Newton's method on the elongations of the nonlinear elements, and the response's slopes.
// Twins: dashpot.model.nonlinear.alternating, .linear_part, .balance and .harmonic_balance, dwell by dwell.
#pragma once
#include "laws.hpp"
#include "problem.hpp"

namespace DASHPOT_SET {

constexpr double BALANCE_TOLERANCE = 1e-10;
constexpr int BALANCE_ITERATIONS = 25, BALANCE_HALVINGS = 5, BALANCE_PATIENCE = 8, START_ROUNDS = 6;
constexpr double TINY_SPRING = 1e-10, LOOSE = 1e-12;

struct Number {
    double re, im;
};
INLINE Number operator*(Number a, Number b) { return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; }
INLINE Number operator*(Number a, double b) { return {a.re * b, a.im * b}; }
INLINE Number operator-(Number a, Number b) { return {a.re - b.re, a.im - b.im}; }
INLINE void add(Number &sum, Number a) { sum.re += a.re, sum.im += a.im; }
INLINE double size_of(Number a) { return __builtin_sqrt(a.re * a.re + a.im * a.im); }
INLINE double rough_size(Number a) { return __builtin_fabs(a.re) + __builtin_fabs(a.im); }

// Sums of products of (count,) numbers on boundaries of registers; count a multiple of 8.
INLINE double inner_product(const double *a, const double *b, int count) {
    V sum{};
    for (int k = 0; k < count; k += LANES) sum += load(a + k) * load(b + k);
    return total(sum);
}

// One period at `times` instants, a multiple of 4, and its harmonics.  Cosines and sines are even or odd about half a
// period and about a quarter of it, so that a quarter of them is enough: of the values, four sums and differences.
struct Period {
    int orders, times, quarter, stride;
    double *cosine, *sine, *folded;  // (2 orders + 1, stride) each and (4, stride)

    Period(Arena &arena, int orders_, int times_) : orders(orders_), times(times_), quarter(times_ / 4) {
        stride = (quarter + 8) / 8 * 8;
        cosine = arena.take<double>(static_cast<long>(2 * orders + 1) * stride);
        sine = arena.take<double>(static_cast<long>(2 * orders + 1) * stride);
        folded = arena.take<double>(4L * stride);
        double *circle = arena.take<double>(times);
        if (!arena.base) return;
        for (int k = 0; k < times; ++k) circle[k] = __builtin_cos(2 * 3.14159265358979323846 * k / times);
        for (int h = 0; h <= 2 * orders; ++h)
            for (int k = 0; k < stride; ++k) {
                const int at = static_cast<int>(static_cast<long>(h) * k % times);
                cosine[h * stride + k] = k <= quarter ? circle[at] : 0;
                sine[h * stride + k] = k <= quarter ? circle[(at + 3 * quarter) % times] : 0;
            }
        for (int k = 0; k < 4 * stride; ++k) folded[k] = 0;
    }

    // x (times,) of harmonics q (2 orders + 1,), or of their rates over the fundamental's frequency.
    void values(const double *q, bool rates, double *x) const {
        double *P[2] = {folded, folded + stride}, *M[2] = {folded + 2 * stride, folded + 3 * stride};
        for (int k = 0; k < 4 * stride; ++k) folded[k] = 0;
        for (int h = 0; h <= orders; ++h) {
            const double re = h ? q[2 * h - 1] : q[0], im = h ? q[2 * h] : 0;
            const double a = rates ? -h * im : re, b = rates ? -h * re : -im;
            const double *c = cosine + h * stride, *s = sine + h * stride;
            double *p = P[h % 2], *m = M[h % 2];
            for (int k = 0; k < stride; ++k) p[k] += a * c[k], m[k] += b * s[k];
        }
        const int half = times / 2;
        for (int k = 0; k <= quarter; ++k) {
            const double sum = P[0][k] + P[1][k], apart = P[0][k] - P[1][k];
            const double turned = M[0][k] + M[1][k], other = M[0][k] - M[1][k];
            x[k] = sum + turned;
            x[half - k] = apart - other;
            x[half + k] = apart + other;
            if (k) x[times - k] = sum - turned;
        }
    }
    // Means of g cos(hα) and g sin(hα) over the period, for h = 0 … most.
    void means(const double *g, int most, double *c, double *s) const {
        const int half = times / 2;
        double *ec = folded, *oc = folded + stride, *es = folded + 2 * stride, *os = folded + 3 * stride;
        for (int k = 1; k < quarter; ++k) {
            const double w = g[k], x = g[half - k], y = g[half + k], z = g[times - k];
            ec[k] = (w + z) + (x + y), oc[k] = (w + z) - (x + y);
            es[k] = (w - z) + (y - x), os[k] = (w - z) - (y - x);
        }
        ec[0] = g[0] + g[half], oc[0] = g[0] - g[half], es[0] = os[0] = 0;
        ec[quarter] = g[quarter] + g[3 * quarter], os[quarter] = g[quarter] - g[3 * quarter];
        oc[quarter] = es[quarter] = 0;
        for (int k = quarter + 1; k < stride; ++k) ec[k] = oc[k] = es[k] = os[k] = 0;
        for (int h = 0; h <= most; ++h) {
            c[h] = inner_product(h % 2 ? oc : ec, cosine + h * stride, stride) / times;
            s[h] = inner_product(h % 2 ? os : es, sine + h * stride, stride) / times;
        }
    }
};

// A^-1 into `inverse`, (n, n) complex; A is overwritten.  NaN where A is singular.
static void invert(Number *A, Number *inverse, int n) {
    for (int i = 0; i < n * n; ++i) inverse[i] = {i % (n + 1) == 0 ? 1.0 : 0.0, 0};
    for (int i = 0; i < n; ++i) {
        int best = i;
        for (int row = i + 1; row < n; ++row)
            if (rough_size(A[row * n + i]) > rough_size(A[best * n + i])) best = row;
        if (best != i)
            for (int j = 0; j < n; ++j) {
                const Number held = A[i * n + j], other = inverse[i * n + j];
                A[i * n + j] = A[best * n + j], A[best * n + j] = held;
                inverse[i * n + j] = inverse[best * n + j], inverse[best * n + j] = other;
            }
        const Number pivot = A[i * n + i];
        const double length = rough_size(pivot);
        if (length == 0) {
            for (int j = 0; j < n * n; ++j) inverse[j] = {NOT_A_NUMBER, NOT_A_NUMBER};
            return;
        }
        const Number part = {pivot.re / length, -pivot.im / length};
        const double scale = 1 / length / (part.re * part.re + part.im * part.im);
        const Number over = part * scale;
        for (int j = 0; j < n; ++j) A[i * n + j] = A[i * n + j] * over, inverse[i * n + j] = inverse[i * n + j] * over;
        for (int row = 0; row < n; ++row) {
            const Number factor = A[row * n + i];
            if (row == i || (factor.re == 0 && factor.im == 0)) continue;
            for (int j = 0; j < n; ++j) {
                A[row * n + j] = A[row * n + j] - factor * A[i * n + j];
                inverse[row * n + j] = inverse[row * n + j] - factor * inverse[i * n + j];
            }
        }
    }
}

// The equations of one dwell, δ - free + Z (p a - s δ) = 0, and the memory that solving them takes.
struct Equations {
    const dashpot::NonlinearRig &rig;
    const int n, r, e, H, W;
    Period period;
    Stack stack;
    unsigned *active;
    double *d, *v, *c, *s, *matrix, *step, *residual_at, *trial, *trial_a, *trial_slope, *trial_by_constant, *strength;
    Number *both, *work, *secant, *row, *X, *columns;
    // Of the dwell: what it is driven by, and its linear part.
    const double *p, *constants;
    double omega;
    const Number *factors, *U, *f;
    Number *inverse, *receptance, *share, *driven, *free;
    double *free_real;

    Equations(Arena &arena, const dashpot::NonlinearRig &given, const dashpot::Dwells &dwells)
        : rig(given), n(rig.n), r(rig.r), e(rig.bent), H(dwells.orders), W(2 * dwells.orders + 1),
          period(arena, dwells.orders, dwells.times), stack(arena, rig.laws, dwells.times) {
        const long unknowns = static_cast<long>(e) * W;
        active = arena.take<unsigned>(rig.laws.depth);
        d = arena.take<double>(dwells.times), v = arena.take<double>(dwells.times);
        c = arena.take<double>(2 * H + 1), s = arena.take<double>(2 * H + 1);
        matrix = arena.take<double>(unknowns * unknowns);
        step = arena.take<double>(unknowns);
        residual_at = arena.take<double>(unknowns), trial = arena.take<double>(unknowns);
        trial_a = arena.take<double>(unknowns), trial_slope = arena.take<double>(unknowns * W);
        trial_by_constant = arena.take<double>(static_cast<long>(W) * rig.constants), strength = arena.take<double>(e);
        both = arena.take<Number>(n * (n + r)), work = arena.take<Number>(n * n);
        secant = arena.take<Number>(e), row = arena.take<Number>(e), X = arena.take<Number>(n);
        columns = arena.take<Number>(static_cast<long>(e) * W);
        free_real = arena.take<double>(unknowns);
        inverse = arena.take<Number>(static_cast<long>(H + 1) * n * n);
        receptance = arena.take<Number>(static_cast<long>(H + 1) * e * e);
        share = arena.take<Number>(static_cast<long>(H + 1) * e), free = arena.take<Number>(static_cast<long>(H + 1) * e);
        driven = arena.take<Number>(static_cast<long>(H + 1) * n);
    }

    void at(const dashpot::Dwells &dwells, long k) {
        p = dwells.p + k * rig.elements, constants = dwells.constants + k * rig.constants, omega = dwells.omega[k];
        factors = reinterpret_cast<const Number *>(dwells.factors) + k * (H + 1) * rig.elements;
        U = reinterpret_cast<const Number *>(dwells.U) + k * (H + 1) * r;
        f = reinterpret_cast<const Number *>(dwells.f) + k * (H + 1) * rig.s;
        for (int i = 0; i < e; ++i) strength[i] = p[rig.chosen[i]];
    }
    // The linear part in the memory of results that are handed out.
    void into(const dashpot::BalanceAt &to, long k) {
        inverse = reinterpret_cast<Number *>(to.inverse) + k * (H + 1) * n * n;
        receptance = reinterpret_cast<Number *>(to.receptance) + k * (H + 1) * e * e;
        share = reinterpret_cast<Number *>(to.share) + k * (H + 1) * e;
        driven = reinterpret_cast<Number *>(to.driven) + k * (H + 1) * n;
        free = reinterpret_cast<Number *>(to.free) + k * (H + 1) * e;
        free_real = to.free_real + k * e * W;
    }

    INLINE Number of_order(const double *q, int h) { return h ? Number{q[2 * h - 1], q[2 * h]} : Number{q[0], 0}; }
    INLINE void put(double *q, int h, Number x) {
        if (h) q[2 * h - 1] = x.re, q[2 * h] = x.im;
        else q[0] = x.re;
    }
    const double *B(int i) const { return rig.B + rig.chosen[i] * n; }
    const double *D(int i) const { return rig.D + rig.chosen[i] * r; }

    // Harmonics of the unit forces at elongations q (e, W), and with `slope` (e, W, W) theirs and by_constant (W, all).
    void alternate(const double *q, double *a, double *slope, double *by_constant) {
        for (int i = 0; i < e; ++i) {
            period.values(q + i * W, false, d);
            period.values(q + i * W, true, v);
            for (int k = 0; k < period.times; ++k) v[k] *= omega;
            const int first = rig.constant_start[i];
            const unsigned moved = law_at(rig.laws, i, {d, v, constants + first}, slope ? ~0u : 0, stack, active);
            harmonics(stack.value(0), a + i * W, 1);
            if (!slope) continue;
            double *own = slope + static_cast<long>(i) * W * W;
            for (int k = 0; k < W * W; ++k) own[k] = 0;
            if (moved & 1) modulate(stack.slope(0, 0), own);
            if (moved & 2) modulate_rates(stack.slope(0, 1), own);
            for (int j = first; j < rig.constant_start[i + 1]; ++j) {
                if (moved >> (2 + j - first) & 1) harmonics(stack.slope(0, 2 + j - first), by_constant + j, rig.constants);
                else
                    for (int w = 0; w < W; ++w) by_constant[w * rig.constants + j] = 0;
            }
        }
    }
    void harmonics(const double *values, double *to, int apart) {
        period.means(values, H, c, s);
        to[0] = c[0];
        for (int h = 1; h <= H; ++h) to[(2 * h - 1) * apart] = 2 * c[h], to[2 * h * apart] = -2 * s[h];
    }
    // The harmonics that δ's number w brings forth through g: a row of cosines and one of minus sines for each order.
    void modulate(const double *g, double *own) {
        period.means(g, 2 * H, c, s);
        own[0] += c[0];
        for (int h = 1; h <= H; ++h) {
            own[2 * h - 1] += c[h], own[2 * h] += -s[h];
            own[(2 * h - 1) * W] += 2 * c[h], own[2 * h * W] += -2 * s[h];
        }
        for (int i = 1; i <= H; ++i)
            for (int j = 1; j <= H; ++j) {
                const int less = i > j ? i - j : j - i, more = i + j;
                const double turned = i > j ? s[less] : i < j ? -s[less] : 0;
                double *cosines = own + (2 * i - 1) * W + 2 * j - 1, *sines = own + 2 * i * W + 2 * j - 1;
                cosines[0] += c[less] + c[more], cosines[1] += turned - s[more];
                sines[0] += -turned - s[more], sines[1] += c[less] - c[more];
            }
    }
    // The same through δ's rate: Re X_h goes with -h Im, Im with h Re.
    void modulate_rates(const double *g, double *own) {
        period.means(g, 2 * H, c, s);
        for (int h = 1; h <= H; ++h) own[2 * h - 1] += omega * h * -s[h], own[2 * h] += -omega * h * c[h];
        for (int i = 1; i <= H; ++i)
            for (int j = 1; j <= H; ++j) {
                const int less = i > j ? i - j : j - i, more = i + j;
                const double turned = i > j ? s[less] : i < j ? -s[less] : 0, rate = omega * j;
                double *cosines = own + (2 * i - 1) * W + 2 * j - 1, *sines = own + 2 * i * W + 2 * j - 1;
                cosines[0] += rate * (turned - s[more]), cosines[1] -= rate * (c[less] + c[more]);
                sines[0] += rate * (c[less] - c[more]), sines[1] -= rate * (-turned - s[more]);
            }
    }

    // Describing functions p a1 / δ1, their parts at least 0.
    void take_secants(const double *q, const double *a, double kept) {
        for (int i = 0; i < e; ++i) {
            const Number d1 = of_order(q + i * W, 1), a1 = of_order(a + i * W, 1);
            const double size = size_of(d1);
            Number ratio = a1 * Number{d1.re, -d1.im} * strength[i];
            if (size > 0) ratio = {ratio.re / (size * size), ratio.im / (size * size)};
            const bool known = size > 0 && __builtin_isfinite(ratio.re) && __builtin_isfinite(ratio.im);
            ratio = {known && ratio.re > 0 ? ratio.re : 0, known && ratio.im > 0 ? ratio.im : 0};
            secant[i] = {kept * secant[i].re + (1 - kept) * ratio.re, kept * secant[i].im + (1 - kept) * ratio.im};
        }
    }

    // [D | -R] of the linear elements at order h with the share of the nonlinear ones.
    void stiffness(int h) {
        const Number *phi = factors + static_cast<long>(h) * rig.elements;
        for (int k = 0; k < n * (n + r); ++k) both[k] = {};
        for (int k = 0; k < rig.cells; ++k)
            add(both[rig.cell_place[k]], phi[rig.cell_element[k]] * (p[rig.cell_element[k]] * rig.cell_value[k]));
        for (int i = 0; i < e; ++i)
            for (int x = 0; x < n; ++x) {
                if (B(i)[x] == 0) continue;
                for (int y = 0; y < n + r; ++y)
                    add(both[x * (n + r) + y], share[h * e + i] * (B(i)[x] * (y < n ? B(i)[y] : D(i)[y - n])));
            }
    }
    // Inverse, receptance, share, driven and free, for the secants.
    void linear_part() {
        double largest = 0, first = 0;
        for (int h = 0; h <= H; ++h) {
            for (int i = 0; i < e; ++i) share[h * e + i] = {secant[i].re, h * secant[i].im};
            stiffness(h);
            double size = 0;
            for (int x = 0; x < n; ++x)
                for (int y = 0; y < n; ++y) {
                    const double entry = size_of(both[x * (n + r) + y]);
                    if (entry > size) size = entry;
                }
            if (size > largest) largest = size;
            if (h == 0) first = size;
            invert_at(h, 0);
        }
        if (loose()) {
            stiffness(0);
            invert_at(0, TINY_SPRING * (first > LOOSE * largest ? first : largest));
        }
        for (int h = 0; h <= H; ++h) move(h);
    }
    void invert_at(int h, double spring) {
        Number *load = driven + h * n;
        for (int x = 0; x < n; ++x) {
            load[x] = {};
            for (int y = 0; y < n; ++y) work[x * n + y] = both[x * (n + r) + y];
            work[x * n + x].re += spring;
            for (int y = 0; y < r; ++y) add(load[x], both[x * (n + r) + n + y] * U[h * r + y] * -1.0);
            for (int y = 0; y < rig.s; ++y) add(load[x], f[h * rig.s + y] * rig.S[x * rig.s + y]);
        }
        invert(work, inverse + static_cast<long>(h) * n * n, n);
    }
    // Whether nothing holds the constant term: what is scaled to ones on its diagonal has a tiny singular value.
    bool loose() {
        stiffness(0);
        double power = 0;
        for (int x = 0; x < n; ++x)
            for (int y = 0; y < n; ++y) {
                const double a = size_of(both[x * (n + r) + x]), b = size_of(both[y * (n + r) + y]);
                if (a == 0) return true;
                const Number entry = inverse[x * n + y];
                power += (entry.re * entry.re + entry.im * entry.im) * a * b;
            }
        return !(power < 1 / (LOOSE * n) / (LOOSE * n));
    }
    void move(int h) {
        const Number *own = inverse + static_cast<long>(h) * n * n;
        for (int x = 0; x < n; ++x) {
            X[x] = {};
            for (int y = 0; y < n; ++y) add(X[x], own[x * n + y] * driven[h * n + y]);
        }
        for (int i = 0; i < e; ++i) {
            Number moved = {};
            for (int x = 0; x < n; ++x) add(moved, X[x] * B(i)[x]);
            for (int y = 0; y < r; ++y) add(moved, U[h * r + y] * D(i)[y]);
            free[h * e + i] = moved;
            put(free_real + i * W, h, moved);
            for (int j = 0; j < e; ++j) {
                Number by = {};
                for (int x = 0; x < n; ++x)
                    for (int y = 0; y < n; ++y)
                        if (B(i)[x] != 0 && B(j)[y] != 0) add(by, own[x * n + y] * (B(i)[x] * B(j)[y]));
                receptance[(h * e + i) * e + j] = by;
            }
        }
    }

    void residual(const double *q, const double *a, double *left) {
        for (int h = 0; h <= H; ++h) {
            for (int j = 0; j < e; ++j)
                row[j] = of_order(a + j * W, h) * strength[j] - share[h * e + j] * of_order(q + j * W, h);
            for (int i = 0; i < e; ++i) {
                Number pulled = {};
                for (int j = 0; j < e; ++j) add(pulled, receptance[(h * e + i) * e + j] * row[j]);
                put(left + i * W, h, pulled);
            }
        }
        for (int k = 0; k < e * W; ++k) left[k] += q[k] - free_real[k];
    }
    double norm(const double *left) const {
        double sum = 0;
        for (int k = 0; k < e * W; ++k) sum += left[k] * left[k];
        return __builtin_sqrt(sum);
    }
    // ∂residual/∂q (e W, e W) for slopes ∂a/∂q (e, W, W).
    void linearise(const double *slope) {
        const long width = static_cast<long>(e) * W;
        for (int h = 0; h <= H; ++h) {
            for (int j = 0; j < e; ++j) {
                const double *re = slope + (static_cast<long>(j) * W + (h ? 2 * h - 1 : 0)) * W, *im = re + W;
                Number *inner = columns + j * W;
                for (int w = 0; w < W; ++w) inner[w] = {strength[j] * re[w], h ? strength[j] * im[w] : 0};
                const Number own = share[h * e + j];
                if (h == 0) inner[0] = inner[0] - own;
                else {
                    inner[2 * h - 1] = inner[2 * h - 1] - own;
                    inner[2 * h] = inner[2 * h] - Number{-own.im, own.re};
                }
            }
            for (int i = 0; i < e; ++i) {
                double *first = matrix + (static_cast<long>(i) * W + (h ? 2 * h - 1 : 0)) * width, *second = first + width;
                for (int j = 0; j < e; ++j) {
                    const Number by = receptance[(h * e + i) * e + j], *inner = columns + j * W;
                    for (int w = 0; w < W; ++w) first[j * W + w] = by.re * inner[w].re - by.im * inner[w].im;
                    if (h)
                        for (int w = 0; w < W; ++w) second[j * W + w] = by.re * inner[w].im + by.im * inner[w].re;
                }
            }
        }
        for (long k = 0; k < width; ++k) matrix[k * (width + 1)] += 1;
    }

    // Newton's method from q, whose forces come out with it; the last step over the elongation.
    double solve(bool feeds_back, bool hopeless, double *q, double *a, double *slope, double *by_constant) {
        const int width = e * W;
        alternate(q, a, slope, by_constant);
        for (int i = 0; i < e; ++i) secant[i] = {};
        take_secants(q, a, 0);
        linear_part();
        if (!feeds_back) {
            for (int k = 0; k < width; ++k) q[k] = free_real[k];
            alternate(q, a, slope, by_constant);
            return 0;
        }
        if (hopeless) return INFINITE;
        double error = INFINITE, scale = 0;
        residual(q, a, residual_at);
        for (int k = 0; k < width; ++k)
            if (__builtin_fabs(free_real[k]) > scale) scale = __builtin_fabs(free_real[k]);
        double mark = norm(residual_at);
        int idle = 0;
        for (int turn = 0; turn < BALANCE_ITERATIONS; ++turn) {
            linearise(slope);
            for (int k = 0; k < width; ++k) step[k] = residual_at[k];
            eliminate(matrix, step, width, 1);
            double size = scale, longest = 0;
            bool finite = true;
            for (int k = 0; k < width; ++k) {
                if (__builtin_fabs(q[k]) > size) size = __builtin_fabs(q[k]);
                if (__builtin_fabs(step[k]) > longest) longest = __builtin_fabs(step[k]);
                finite = finite && __builtin_isfinite(step[k]) && __builtin_isfinite(q[k]);
            }
            if (!(size > 0)) size = 1;
            error = finite ? longest / size : NOT_A_NUMBER;
            if (error <= BALANCE_TOLERANCE) {
                settle(q, a, slope);
                return error;
            }
            const double left = norm(residual_at);
            const bool fallen = !(left > 0.5 * mark);
            if (fallen) mark = left;
            idle = fallen ? 0 : idle + 1;
            if (!__builtin_isfinite(error) || idle > BALANCE_PATIENCE) return error;
            advance(error, size, left, q, a, slope, by_constant);
        }
        return error;
    }
    // The last, tiny step, which the forces follow to first order.
    void settle(double *q, double *a, const double *slope) {
        for (int i = 0; i < e; ++i)
            for (int w = 0; w < W; ++w) {
                const double *own = slope + (static_cast<long>(i) * W + w) * W;
                double moved = 0;
                for (int k = 0; k < W; ++k) moved += own[k] * step[i * W + k];
                a[i * W + w] -= moved;
            }
        for (int k = 0; k < e * W; ++k) q[k] -= step[k];
    }
    // The step, of at most half the elongation and halved where the residual grows.
    void advance(double error, double size, double left, double *q, double *a, double *slope, double *by_constant) {
        double factor = error > 0.5 ? 0.5 / error : 1;
        for (int k = 0; k < e * W; ++k) trial[k] = q[k];
        for (int turn = 0; turn <= BALANCE_HALVINGS; ++turn, factor /= 2) {
            for (int k = 0; k < e * W; ++k) q[k] = trial[k] - factor * step[k];
            alternate(q, a, slope, by_constant);
            residual(q, a, residual_at);
            if (norm(residual_at) <= left * (1 + 1e-9) + 1e-14 * size || !(error > 1e-9)) return;
        }
    }

    // Elongations with each nonlinear element replaced by its secant.
    void linear_start(double *q) {
        for (int i = 0; i < e; ++i) secant[i] = {};
        for (int turn = 0; turn < START_ROUNDS; ++turn) {
            linear_part();
            bool moves = false;
            for (int i = 0; i < e; ++i)
                for (int h = 0; h <= H; ++h) {
                    const Number x = free[h * e + i];
                    const bool finite = __builtin_isfinite(x.re) && __builtin_isfinite(x.im);
                    put(q + i * W, h, finite ? x : Number{});
                    moves = moves || (finite && (x.re != 0 || x.im != 0));
                }
            if (!moves) {
                for (int i = 0; i < e; ++i) secant[i] = {strength[i], 0};
                continue;
            }
            alternate(q, trial_a, nullptr, nullptr);
            take_secants(q, trial_a, 0.5);
        }
    }
};

// Slopes of the response of one dwell along Q directions of the parameters, the constants and the inputs.  A complex row
// is Q real parts and Q imaginary ones, filled up to P, a multiple of 8.
struct ResponseSlopes {
    Equations &at;
    const int Q, P;
    // Rows: (n), (H + 1, n), (e, H + 1), (n), (1), (most inputs); real ones: (e, W) each of δ and of ∂a/∂q dδ.
    double *load, *moved, *by_constant, *motion, *force, *inputs, *bent, *pulled;
    int *tie_element, *tie_column, ties;
    double *tie_value;

    ResponseSlopes(Arena &arena, Equations &equations, int directions)
        : at(equations), Q(directions), P((directions + 7) / 8 * 8), ties(0) {
        const long H = at.H + 1, row = 2 * P, most = at.r > at.rig.s ? at.r : at.rig.s;
        load = arena.take<double>(at.n * row), moved = arena.take<double>(H * at.n * row);
        by_constant = arena.take<double>(at.e * H * row), motion = arena.take<double>(at.n * row);
        force = arena.take<double>(row), inputs = arena.take<double>(most * row);
        bent = arena.take<double>(static_cast<long>(at.e) * at.W * P);
        pulled = arena.take<double>(static_cast<long>(at.e) * at.W * P);
        tie_element = arena.take<int>(static_cast<long>(at.rig.elements) * Q);
        tie_column = arena.take<int>(static_cast<long>(at.rig.elements) * Q);
        tie_value = arena.take<double>(static_cast<long>(at.rig.elements) * Q);
    }
    // Which parameters each direction moves.
    void along(const double *along_p) {
        ties = 0;
        for (int j = 0; j < at.rig.elements; ++j)
            for (int q = 0; q < Q; ++q)
                if (along_p[j * Q + q] != 0)
                    tie_element[ties] = j, tie_column[ties] = q, tie_value[ties++] = along_p[j * Q + q];
    }

    // The elongations' slopes; a (H + 1, elements); dU and df (H + 1, …, Q) or null.
    void solve(const Number *a, const double *along_constants, const Number *dU, const Number *df, bool feeds_back,
               const double *slope, const double *constants_at) {
        constants_along(constants_at, along_constants);
        for (int h = 0; h <= at.H; ++h) explicit_part(h, a + h * at.rig.elements, dU, df);
        if (feeds_back) {
            at.linearise(slope);
            eliminate(at.matrix, bent, at.e * at.W, P);
        }
        for (int i = 0; i < at.e; ++i)
            for (int w = 0; w < at.W; ++w) {
                const double *own = slope + (static_cast<long>(i) * at.W + w) * at.W;
                double *to = pulled + (static_cast<long>(i) * at.W + w) * P;
                for (int q = 0; q < P; ++q) to[q] = 0;
                for (int u = 0; u < at.W; ++u) {
                    const double *by = bent + (static_cast<long>(i) * at.W + u) * P;
                    if (own[u] != 0)
                        for (int q = 0; q < P; ++q) to[q] += own[u] * by[q];
                }
            }
    }
    // Slopes of the coordinates at order h, into `motion`.
    void move(int h) {
        const int n = at.n;
        clear(load, n);
        for (int i = 0; i < at.e; ++i) {
            const long re = (static_cast<long>(i) * at.W + (h ? 2 * h - 1 : 0)) * P, im = h ? re + P : -1;
            const Number own = at.share[h * at.e + i];
            for (int q = 0; q < P; ++q) {
                const double x = bent[re + q], y = h ? bent[im + q] : 0;
                force[q] = at.strength[i] * pulled[re + q] - (own.re * x - own.im * y);
                force[P + q] = (h ? at.strength[i] * pulled[im + q] : 0) - (own.re * y + own.im * x);
            }
            for (int x = 0; x < n; ++x) add_real(load + x * 2 * P, force, at.B(i)[x]);
        }
        const Number *own = at.inverse + static_cast<long>(h) * n * n;
        for (int k = 0; k < n * 2 * P; ++k) motion[k] = moved[h * n * 2 * P + k];
        for (int x = 0; x < n; ++x)
            for (int y = 0; y < n; ++y) add_row(motion + x * 2 * P, load + y * 2 * P, own[x * n + y] * -1.0);
    }
    // Slopes of the unit force of element j at order h, into `force`; after `move`.
    void force_of(int h, int j, const Number *dU) {
        clear(force, 1);
        for (int i = 0; i < at.e; ++i)
            if (at.rig.chosen[i] == j) {
                const double *rows = by_constant + (static_cast<long>(i) * (at.H + 1) + h) * 2 * P;
                const long re = (static_cast<long>(i) * at.W + (h ? 2 * h - 1 : 0)) * P;
                for (int q = 0; q < P; ++q) force[q] = rows[q] + pulled[re + q];
                if (h)
                    for (int q = 0; q < P; ++q) force[P + q] = rows[P + q] + pulled[re + P + q];
                return;
            }
        const Number phi = at.factors[static_cast<long>(h) * at.rig.elements + j];
        for (int x = 0; x < at.n; ++x) add_row(force, motion + x * 2 * P, phi * at.rig.B[j * at.n + x]);
        if (!dU) return;
        split(dU, h, at.r);
        for (int y = 0; y < at.r; ++y) add_row(force, inputs + y * 2 * P, phi * at.rig.D[j * at.r + y]);
    }

  private:
    void clear(double *rows, int count) {
        for (int k = 0; k < count * 2 * P; ++k) rows[k] = 0;
    }
    inline void add_row(double *to, const double *from, Number by) {
        if (by.re == 0 && by.im == 0) return;
        for (int q = 0; q < P; ++q) {
            to[q] += by.re * from[q] - by.im * from[P + q];
            to[P + q] += by.re * from[P + q] + by.im * from[q];
        }
    }
    inline void add_real(double *to, const double *from, double by) {
        if (by != 0)
            for (int q = 0; q < 2 * P; ++q) to[q] += by * from[q];
    }
    // Directions of the inputs at order h as rows.
    void split(const Number *directions, int h, int count) {
        clear(inputs, count);
        for (int y = 0; y < count; ++y)
            for (int q = 0; q < Q; ++q) {
                const Number x = directions[(static_cast<long>(h) * count + y) * Q + q];
                inputs[y * 2 * P + q] = x.re, inputs[y * 2 * P + P + q] = x.im;
            }
    }
    // ∂a/∂g dg at fixed motion.
    void constants_along(const double *constants_at, const double *along) {
        const int G = at.rig.constants;
        clear(by_constant, at.e * (at.H + 1));
        for (int i = 0; i < at.e; ++i)
            for (int j = at.rig.constant_start[i]; j < at.rig.constant_start[i + 1]; ++j)
                for (int q = 0; q < Q; ++q) {
                    const double by = along[j * Q + q];
                    for (int h = 0; by != 0 && h <= at.H; ++h) {
                        double *rows = by_constant + (static_cast<long>(i) * (at.H + 1) + h) * 2 * P;
                        rows[q] += by * constants_at[(h ? 2 * h - 1 : 0) * G + j];
                        if (h) rows[P + q] += by * constants_at[2 * h * G + j];
                    }
                }
    }
    // What the loads move at fixed nonlinear forces, and the right side for the elongations.
    void explicit_part(int h, const Number *a, const Number *dU, const Number *df) {
        const int n = at.n, r = at.r;
        clear(load, n);
        for (int k = 0; k < ties; ++k)
            for (int x = 0; x < n; ++x) {
                const double by = -tie_value[k] * at.rig.B[tie_element[k] * n + x];
                load[x * 2 * P + tie_column[k]] += by * a[tie_element[k]].re;
                load[x * 2 * P + P + tie_column[k]] += by * a[tie_element[k]].im;
            }
        for (int i = 0; i < at.e; ++i)
            for (int x = 0; x < n; ++x)
                add_real(load + x * 2 * P, by_constant + (static_cast<long>(i) * (at.H + 1) + h) * 2 * P,
                         -at.strength[i] * at.B(i)[x]);
        if (df) {
            split(df, h, at.rig.s);
            for (int x = 0; x < n; ++x)
                for (int y = 0; y < at.rig.s; ++y)
                    add_real(load + x * 2 * P, inputs + y * 2 * P, at.rig.S[x * at.rig.s + y]);
        }
        if (dU) {
            split(dU, h, r);
            at.stiffness(h);
            for (int x = 0; x < n; ++x)
                for (int y = 0; y < r; ++y)
                    add_row(load + x * 2 * P, inputs + y * 2 * P, at.both[x * (n + r) + n + y] * -1.0);
        }
        double *to = moved + static_cast<long>(h) * n * 2 * P;
        const Number *own = at.inverse + static_cast<long>(h) * n * n;
        clear(to, n);
        for (int x = 0; x < n; ++x)
            for (int y = 0; y < n; ++y) add_row(to + x * 2 * P, load + y * 2 * P, own[x * n + y]);
        for (int i = 0; i < at.e; ++i) {
            clear(force, 1);
            for (int x = 0; x < n; ++x) add_real(force, to + x * 2 * P, at.B(i)[x]);
            for (int y = 0; dU && y < r; ++y) add_real(force, inputs + y * 2 * P, at.D(i)[y]);
            double *rows = bent + (static_cast<long>(i) * at.W + (h ? 2 * h - 1 : 0)) * P;
            for (int q = 0; q < (h ? 2 : 1) * P; ++q) rows[q] = force[q];
        }
    }
};

// What channels show of the dwells of repeats, and its slopes.
struct Shown {
    Equations &at;
    ResponseSlopes &slopes;
    const dashpot::NonlinearLines &lines;
    double *q, *a, *slope, *by_constant, *row;
    Number *U, *f, *X, *forces;  // (H + 1, r), (H + 1, s), (H + 1, n), (H + 1, elements)

    Shown(Arena &arena, Equations &equations, ResponseSlopes &along, const dashpot::NonlinearLines &given)
        : at(equations), slopes(along), lines(given) {
        const long H = at.H + 1, width = static_cast<long>(at.e) * at.W;
        a = arena.take<double>(width), slope = arena.take<double>(width * at.W), q = arena.take<double>(width);
        by_constant = arena.take<double>(static_cast<long>(at.W) * at.rig.constants);
        row = arena.take<double>(2 * slopes.P);
        U = arena.take<Number>(H * at.r), f = arena.take<Number>(H * at.rig.s);
        X = arena.take<Number>(H * at.n), forces = arena.take<Number>(H * at.rig.elements);
    }

    // Dwell `dwell` of repeat k.
    void run(const dashpot::Dwells &dwells, long k, int dwell) {
        const long place = k * lines.dwells + dwell, width = static_cast<long>(at.e) * at.W;
        begin(dwells, k, dwell);
        if (lines.start)
            for (int i = 0; i < width; ++i) q[i] = lines.start[place * width + i];
        else at.linear_start(q);
        lines.error[place] = at.solve(dwells.feeds_back, false, q, a, slope, by_constant);
        for (int i = 0; i < width; ++i) lines.delta[place * width + i] = q[i];
        motion();
        const Number *dU = lines.along_U ? reinterpret_cast<const Number *>(lines.along_U) + static_cast<long>(dwell) * (at.H + 1) * at.r * slopes.Q : nullptr;
        const Number *df = lines.along_f ? reinterpret_cast<const Number *>(lines.along_f) + static_cast<long>(dwell) * (at.H + 1) * at.rig.s * slopes.Q : nullptr;
        slopes.solve(forces, lines.along_constants, dU, df, dwells.feeds_back, slope, by_constant);
        for (int i = 0; i < width; ++i)
            for (int d = 0; d < slopes.Q; ++d)
                lines.d_delta[(place * width + i) * slopes.Q + d] = slopes.bent[static_cast<long>(i) * slopes.P + d];
        for (int l = lines.first[dwell]; l < lines.first[dwell + 1]; ++l) {
            slopes.move(lines.order[l]);
            for (int c = 0; c < lines.channels; ++c) channel(k, lines.line[l], lines.order[l], c, dU);
        }
    }

  private:
    void begin(const dashpot::Dwells &dwells, long k, int dwell) {
        at.p = dwells.p + k * at.rig.elements, at.constants = dwells.constants + k * at.rig.constants;
        at.omega = dwells.omega[dwell];
        at.factors = reinterpret_cast<const Number *>(dwells.factors) + static_cast<long>(dwell) * (at.H + 1) * at.rig.elements;
        for (int i = 0; i < at.e; ++i) at.strength[i] = at.p[at.rig.chosen[i]];
        for (int i = 0; i < (at.H + 1) * at.r; ++i) U[i] = {};
        for (int i = 0; i < (at.H + 1) * at.rig.s; ++i) f[i] = {};
        for (int l = lines.first[dwell]; l < lines.first[dwell + 1]; ++l) {
            const Number *inputs = input(k, lines.line[l]);
            for (int y = 0; y < at.r; ++y) U[lines.order[l] * at.r + y] = inputs[y];
            for (int y = 0; y < at.rig.s; ++y) f[lines.order[l] * at.rig.s + y] = inputs[at.r + y];
        }
        at.U = U, at.f = f;
    }
    const Number *input(long k, int line) const {
        return reinterpret_cast<const Number *>(lines.q) + (k * lines.count + line) * (at.r + at.rig.s);
    }
    // X and the unit forces of all elements at every order.
    void motion() {
        const int n = at.n, E = at.rig.elements;
        for (int h = 0; h <= at.H; ++h) {
            Number *x = X + h * n, *load = at.X;
            for (int i = 0; i < n; ++i) load[i] = at.driven[h * n + i];
            for (int j = 0; j < at.e; ++j) {
                const Number rest = at.of_order(a + j * at.W, h) * at.strength[j] - at.share[h * at.e + j] * at.of_order(q + j * at.W, h);
                for (int i = 0; i < n; ++i) add(load[i], rest * -at.B(j)[i]);
            }
            for (int i = 0; i < n; ++i) {
                x[i] = {};
                for (int j = 0; j < n; ++j) add(x[i], at.inverse[(static_cast<long>(h) * n + i) * n + j] * load[j]);
            }
            for (int j = 0; j < E; ++j) {
                Number stretched = {};
                for (int i = 0; i < n; ++i) add(stretched, x[i] * at.rig.B[j * n + i]);
                for (int i = 0; i < at.r; ++i) add(stretched, U[h * at.r + i] * at.rig.D[j * at.r + i]);
                forces[h * E + j] = at.factors[static_cast<long>(h) * E + j] * stretched;
            }
            for (int j = 0; j < at.e; ++j) forces[h * E + at.rig.chosen[j]] = at.of_order(a + j * at.W, h);
        }
    }
    void channel(long k, int line, int h, int c, const Number *dU) {
        const int n = at.n, E = at.rig.elements, inputs = at.r + at.rig.s, P = slopes.P;
        const Number rate = reinterpret_cast<const Number *>(lines.rates)[line * lines.channels + c];
        Number direct = {};
        for (int i = 0; i < 2 * P; ++i) row[i] = 0;
        for (int i = 0; i < n; ++i) {
            const double by = lines.on_x[c * n + i];
            if (by == 0) continue;
            add(direct, X[h * n + i] * by);
            for (int d = 0; d < 2 * P; ++d) row[d] += by * slopes.motion[i * 2 * P + d];
        }
        for (int i = 0; i < inputs; ++i) add(direct, input(k, line)[i] * lines.on_q[c * inputs + i]);
        Number shown = rate * direct;
        for (int d = 0; d < P; ++d) {
            const Number turned = rate * Number{row[d], row[P + d]};
            row[d] = turned.re, row[P + d] = turned.im;
        }
        for (int j = 0; j < E; ++j) {
            const double by = lines.force[c * E + j];
            if (by == 0) continue;
            const Number unit = forces[h * E + j];
            add(shown, unit * (by * at.p[j]));
            slopes.force_of(h, j, dU);
            for (int d = 0; d < 2 * P; ++d) row[d] += by * at.p[j] * slopes.force[d];
            for (int t = 0; t < slopes.ties; ++t)
                if (slopes.tie_element[t] == j) {
                    row[slopes.tie_column[t]] += by * slopes.tie_value[t] * unit.re;
                    row[P + slopes.tie_column[t]] += by * slopes.tie_value[t] * unit.im;
                }
        }
        const long place = (k * lines.count + line) * lines.channels + c;
        reinterpret_cast<Number *>(lines.shown)[place] = shown;
        Number *to = reinterpret_cast<Number *>(lines.slopes) + place * slopes.Q;
        for (int d = 0; d < slopes.Q; ++d) to[d] = {row[d], row[P + d]};
    }
};

static unsigned long balance_workspace(const dashpot::NonlinearRig &rig, const dashpot::Dwells &dwells, int directions) {
    Arena arena{nullptr, 0};
    Equations equations(arena, rig, dwells);
    ResponseSlopes slopes(arena, equations, directions);
    const dashpot::NonlinearLines none{};
    Shown shown(arena, equations, slopes, none);
    return arena.used;
}

static void balance_forces(const dashpot::NonlinearRig &rig, const dashpot::Dwells &dwells, const double *q, long from,
                           long to, double *a, char *work) {
    Arena arena{work, 0};
    Equations equations(arena, rig, dwells);
    const long width = static_cast<long>(equations.e) * equations.W;
    for (long k = from; k < to; ++k) {
        equations.constants = dwells.constants + k * rig.constants, equations.omega = dwells.omega[k];
        equations.alternate(q + k * width, a + k * width, nullptr, nullptr);
    }
}

static void balance_linear_start(const dashpot::NonlinearRig &rig, const dashpot::Dwells &dwells, long from, long to,
                                 double *q, char *work) {
    Arena arena{work, 0};
    Equations equations(arena, rig, dwells);
    for (long k = from; k < to; ++k) {
        equations.at(dwells, k);
        equations.linear_start(q + k * equations.e * equations.W);
    }
}

static void balance_solve(const dashpot::NonlinearRig &rig, const dashpot::Dwells &dwells,
                          const unsigned char *hopeless, long from, long to, const dashpot::BalanceAt &out, char *work) {
    Arena arena{work, 0};
    Equations equations(arena, rig, dwells);
    const long width = static_cast<long>(equations.e) * equations.W;
    for (long k = from; k < to; ++k) {
        equations.at(dwells, k);
        equations.into(out, k);
        out.error[k] = equations.solve(dwells.feeds_back, hopeless && hopeless[k], out.q + k * width, out.a + k * width,
                                       out.slope + k * width * equations.W,
                                       out.by_constant + k * equations.W * rig.constants);
    }
}

static void balance_slopes(const dashpot::NonlinearRig &rig, const dashpot::Dwells &dwells, const dashpot::BalanceAt &at,
                           const dashpot::Directions &along, long from, long to, char *work) {
    Arena arena{work, 0};
    Equations equations(arena, rig, dwells);
    ResponseSlopes slopes(arena, equations, along.count);
    const int Q = along.count, P = slopes.P, H = equations.H + 1, n = rig.n, E = rig.elements;
    const long width = static_cast<long>(equations.e) * equations.W;
    slopes.along(along.along_p);
    for (long k = from; k < to; ++k) {
        equations.at(dwells, k);
        equations.into(at, k);
        const long dwell = along.same ? 0 : k;
        const Number *dU = along.along_U ? reinterpret_cast<const Number *>(along.along_U) + dwell * H * rig.r * Q : nullptr;
        const Number *df = along.along_f ? reinterpret_cast<const Number *>(along.along_f) + dwell * H * rig.s * Q : nullptr;
        slopes.solve(reinterpret_cast<const Number *>(along.a) + k * H * E, along.along_constants, dU, df,
                     dwells.feeds_back, at.slope + k * width * equations.W,
                     at.by_constant + k * equations.W * rig.constants);
        for (int i = 0; i < width; ++i)
            for (int q = 0; q < Q; ++q)
                along.d_delta[(k * width + i) * Q + q] = slopes.bent[static_cast<long>(i) * P + q];
        for (int h = 0; h < H; ++h) {
            slopes.move(h);
            Number *dX = reinterpret_cast<Number *>(along.dX) + (k * H + h) * n * Q;
            for (int i = 0; i < n * Q; ++i) {
                const double *own = slopes.motion + i / Q * 2 * P + i % Q;
                dX[i] = {own[0], own[P]};
            }
            for (int j = 0; j < E; ++j) {
                slopes.force_of(h, j, dU);
                Number *d_force = reinterpret_cast<Number *>(along.d_forces) + ((k * H + h) * E + j) * Q;
                for (int q = 0; q < Q; ++q) d_force[q] = {slopes.force[q], slopes.force[P + q]};
            }
        }
    }
}

static void balance_lines(const dashpot::NonlinearRig &rig, const dashpot::Dwells &dwells,
                          const dashpot::NonlinearLines &lines, long from, long to, char *work) {
    Arena arena{work, 0};
    Equations equations(arena, rig, dwells);
    ResponseSlopes slopes(arena, equations, lines.directions);
    Shown shown(arena, equations, slopes, lines);
    slopes.along(lines.along_p);
    for (long place = from; place < to; ++place)
        shown.run(dwells, place / lines.dwells, static_cast<int>(place % lines.dwells));
}

}  // namespace DASHPOT_SET
