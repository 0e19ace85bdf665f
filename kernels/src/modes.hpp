// Modes of a small rig with the deviations of their frequencies and damping ratios.
// Twin: dashpot.estimate.inference.derived.mode_values with dashpot.model.modes; damped pencils of regular masses only.
#pragma once
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

namespace dashpot {

constexpr double EPSILON = 2.220446049250313e-16;

// A complex number whose product does not look for infinities, as that of std::complex does.
struct Z {
    double re = 0, im = 0;
};
inline Z operator+(Z a, Z b) { return {a.re + b.re, a.im + b.im}; }
inline Z operator-(Z a, Z b) { return {a.re - b.re, a.im - b.im}; }
inline Z operator-(Z a) { return {-a.re, -a.im}; }
inline Z operator*(Z a, Z b) { return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; }
inline Z operator*(Z a, double b) { return {a.re * b, a.im * b}; }
inline Z conj(Z a) { return {a.re, -a.im}; }
inline double size(Z a) { return std::hypot(a.re, a.im); }
inline Z operator/(Z a, Z b) {
    const double scale = size(b);
    const Z unit = {b.re / scale, -b.im / scale};
    return a * unit * (1 / scale);
}
inline Z root(Z a) {
    const double length = size(a), real = std::sqrt((length + std::fabs(a.re)) / 2);
    if (real == 0) return {};
    const double other = std::fabs(a.im) / (2 * real), sign = a.im < 0 ? -1.0 : 1.0;
    return a.re >= 0 ? Z{real, sign * other} : Z{other, sign * real};
}

// A = Q T Q^H, T upper triangular; A (N, N) becomes T.  False where the steps do not end.
class Schur {
  public:
    Schur(std::vector<Z> &A, int N) : A(A), Q(static_cast<size_t>(N) * N), N(N) {
        for (int i = 0; i < N; ++i) Q[i * N + i] = {1, 0};
    }
    bool solve() {
        hessenberg();
        int last = N - 1, turns = 0;
        while (last > 0) {
            const int first = start_of_block(last);
            if (first == last) {
                --last, turns = 0;
            } else {
                if (++turns > 60) return false;
                step(first, last, turns % 12 == 0 ? A[last * N + last] + Z{size(A[last * N + last - 1]), 0} : shift(last));
            }
        }
        return true;
    }
    // Eigenvector k, (N,), of A as it was.
    std::vector<Z> vector(int k) const {
        double norm = 0;
        for (int i = 0; i < N * N; ++i) norm = std::max(norm, size(A[i]));
        std::vector<Z> x(N), v(N);
        x[k] = {1, 0};
        for (int i = k - 1; i >= 0; --i) {
            Z sum;
            for (int j = i + 1; j <= k; ++j) sum = sum + A[i * N + j] * x[j];
            Z apart = A[i * N + i] - A[k * N + k];
            if (size(apart) < EPSILON * norm) apart = {EPSILON * norm, 0};
            x[i] = -(sum / apart);
        }
        for (int i = 0; i < N; ++i)
            for (int j = 0; j <= k; ++j) v[i] = v[i] + Q[i * N + j] * x[j];
        return v;
    }

  private:
    std::vector<Z> &A;
    std::vector<Z> Q;
    int N;

    // Householder's reflections 1 - 2 v v^H / v^H v from both sides.
    void hessenberg() {
        std::vector<Z> v(N);
        for (int k = 0; k + 2 < N; ++k) {
            double length = 0;
            for (int i = k + 1; i < N; ++i) v[i] = A[i * N + k], length += v[i].re * v[i].re + v[i].im * v[i].im;
            length = std::sqrt(length);
            if (length == 0) continue;
            const double head = size(v[k + 1]);
            v[k + 1] = v[k + 1] + (head > 0 ? v[k + 1] * (length / head) : Z{length, 0});
            const double scale = 1 / (length * (length + head));
            for (int j = k; j < N; ++j) {
                Z sum;
                for (int i = k + 1; i < N; ++i) sum = sum + conj(v[i]) * A[i * N + j];
                for (int i = k + 1; i < N; ++i) A[i * N + j] = A[i * N + j] - v[i] * sum * scale;
            }
            for (std::vector<Z> *matrix : {&A, &Q})
                for (int i = 0; i < N; ++i) {
                    Z *row = matrix->data() + i * N, sum;
                    for (int j = k + 1; j < N; ++j) sum = sum + row[j] * v[j];
                    for (int j = k + 1; j < N; ++j) row[j] = row[j] - sum * conj(v[j]) * scale;
                }
        }
    }
    // First row of the block that ends at `last` and that no negligible entry divides.
    int start_of_block(int last) {
        for (int l = last; l > 0; --l) {
            Z &below = A[l * N + l - 1];
            if (size(below) <= EPSILON * (size(A[(l - 1) * N + l - 1]) + size(A[l * N + l]))) {
                below = {};
                return l;
            }
        }
        return 0;
    }
    // Wilkinson's: the eigenvalue of the last two rows that is nearer to the last entry.
    Z shift(int last) const {
        const Z a = A[(last - 1) * N + last - 1], b = A[(last - 1) * N + last], c = A[last * N + last - 1],
                d = A[last * N + last];
        const Z half = (a - d) * 0.5, bc = b * c, under = root(half * half + bc);
        const Z plus = half + under, minus = half - under;
        const Z larger = size(plus) > size(minus) ? plus : minus;
        return size(larger) > 0 ? d - bc / larger : d;
    }
    void step(int first, int last, Z shift) {
        Z x = A[first * N + first] - shift, y = A[(first + 1) * N + first];
        for (int k = first; k < last; ++k) {
            const double head = size(x), tail = size(y), length = std::hypot(head, tail);
            if (length > 0) {
                const double c = head / length;
                const Z s = (head > 0 ? x * conj(y) * (1 / head) : conj(y)) * (1 / length);
                Z *above = A.data() + k * N, *below = above + N;
                for (int j = std::max(first, k - 1); j < N; ++j) {
                    const Z held = above[j];
                    above[j] = held * c + s * below[j];
                    below[j] = below[j] * c - conj(s) * held;
                }
                rotate(A, std::min(k + 2, last) + 1, k, c, s);
                rotate(Q, N, k, c, s);
            }
            if (k + 1 < last) x = A[(k + 1) * N + k], y = A[(k + 2) * N + k];
        }
    }
    void rotate(std::vector<Z> &matrix, int rows, int k, double c, Z s) const {
        for (int i = 0; i < rows; ++i) {
            Z *row = matrix.data() + i * N + k;
            const Z held = row[0];
            row[0] = held * c + conj(s) * row[1];
            row[1] = row[1] * c - s * held;
        }
    }
};

// The rig as it stands: incidence B (elements, n), letters M, C, K, H as 0 to 3, ties T (elements, unknowns).
struct ModalRig {
    int n, elements, unknowns;
    const double *B, *T, *p0;
    const long long *letters;
};

struct ModeTable {
    int count = 0;
    std::vector<Z> eigenvalues, shapes;
    std::vector<double> frequency, damping, frequency_sd, damping_sd;
};

// Sum over j of a_i M_ij b_j.
inline Z product(const std::vector<double> &M, const Z *a, const Z *b, int n) {
    Z sum;
    for (int i = 0; i < n; ++i) {
        Z row;
        for (int j = 0; j < n; ++j) row = row + b[j] * M[i * n + j];
        sum = sum + a[i] * row;
    }
    return sum;
}

class Modes {
  public:
    Modes(const ModalRig &rig, const double *theta, const double *covariance)
        : rig(rig), theta(theta), covariance(covariance), n(rig.n) {
        for (std::vector<double> &matrix : letter) matrix.assign(n * n, 0.0);
    }
    // False where the twin is to decide: coupled or missing masses, motions that nothing holds, nothing at all.
    bool solve(ModeTable &table) {
        assemble();
        if (!regular() || !find()) return false;
        const int count = static_cast<int>(values.size());
        std::vector<int> order(count);
        std::iota(order.begin(), order.end(), 0);
        std::vector<double> magnitude(count);
        for (int k = 0; k < count; ++k) magnitude[k] = std::nearbyint(size(values[k]) * 1e9) / 1e9;
        std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
            return magnitude[a] < magnitude[b] || (magnitude[a] == magnitude[b] && values[a].im < values[b].im);
        });
        table.count = count;
        for (int k : order) append(table, values[k], shapes.data() + k * n);
        return true;
    }

  private:
    const ModalRig &rig;
    const double *theta, *covariance;
    int n;
    std::vector<double> letter[4], length;
    double rate = 1;
    std::vector<Z> values, shapes;

    void assemble() {
        for (int e = 0; e < rig.elements; ++e) {
            if (rig.letters[e] < 0) continue;  // a nonlinear law
            double p = rig.p0[e];
            for (int j = 0; j < rig.unknowns; ++j) p += rig.T[e * rig.unknowns + j] * theta[j];
            const double *b = rig.B + e * n;
            for (int i = 0; i < n; ++i)
                for (int j = 0; j < n; ++j) letter[rig.letters[e]][i * n + j] += p * b[i] * b[j];
        }
    }
    // Whether every coordinate has a mass of its own; `length` are its roots, `rate` the unit of the eigenvalues.
    bool regular() {
        double stiffest = 0, heaviest = 0;
        length.resize(n);
        for (int i = 0; i < n; ++i)
            for (int j = 0; j < n; ++j) {
                const int at = i * n + j;
                for (const std::vector<double> &matrix : letter)
                    if (!std::isfinite(matrix[at])) return false;
                if (i != j && letter[0][at] != 0) return false;
                stiffest = std::max(stiffest, std::hypot(letter[2][at], letter[3][at]));
                heaviest = std::max(heaviest, std::fabs(letter[0][at]));
                if (i != j) continue;
                if (letter[0][at] == 0) return false;
                length[i] = std::sqrt(std::fabs(letter[0][at]));
            }
        if (stiffest == 0) return false;
        rate = std::sqrt(stiffest / heaviest);
        return true;
    }
    // Eigenvalues with Im >= 0 and their shapes, from [0 1; -K -C] in coordinates of unit mass.
    bool find() {
        const int N = 2 * n;
        std::vector<Z> A(static_cast<size_t>(N) * N);
        for (int i = 0; i < n; ++i) {
            A[i * N + n + i] = {1, 0};
            const double turn = letter[0][i * n + i] < 0 ? 1.0 : -1.0;
            for (int j = 0; j < n; ++j) {
                const int at = i * n + j;
                const double by = turn / (length[i] * length[j] * rate);
                A[(n + i) * N + j] = {letter[2][at] * by / rate, letter[3][at] * by / rate};
                A[(n + i) * N + n + j] = {letter[1][at] * by, 0};
            }
        }
        Schur schur(A, N);
        if (!schur.solve()) return false;
        for (int k = 0; k < N; ++k) {
            Z value = A[k * N + k];
            const double magnitude = size(value);
            if (!(magnitude >= 1e-6)) return false;
            if (value.im < -1e-9 * magnitude) continue;
            if (value.im <= 1e-9 * magnitude) value.im = 0;
            values.push_back(value * rate);
            const std::vector<Z> vector = schur.vector(k);
            for (int i = 0; i < n; ++i) shapes.push_back(vector[i] * (1 / length[i]));
        }
        return true;
    }
    void append(ModeTable &table, Z value, Z *shape) const {
        int largest = 0;
        for (int i = 1; i < n; ++i)
            if (size(shape[i]) > size(shape[largest])) largest = i;
        const Z unit = shape[largest];
        if (size(unit) > 0)
            for (int i = 0; i < n; ++i) shape[i] = shape[i] / unit;
        const double magnitude = size(value);
        table.eigenvalues.push_back(value);
        table.shapes.insert(table.shapes.end(), shape, shape + n);
        table.frequency.push_back(magnitude / (2 * M_PI));
        table.damping.push_back(-value.re / magnitude + 0.0);
        deviations(table, value, shape, magnitude);
    }
    // dlambda/dp_i = -phi_i (b_i . shape)^2 / shape^T (2 lambda M + C) shape, and what follows through T.
    void deviations(ModeTable &table, Z value, const Z *shape, double magnitude) const {
        const Z below = value * 2.0 * product(letter[0], shape, shape, n) + product(letter[1], shape, shape, n);
        const Z factor[4] = {value * value, value, {1, 0}, {0, 1}};
        const int m = rig.unknowns;
        std::vector<Z> slope(m);
        for (int e = 0; e < rig.elements; ++e) {
            if (rig.letters[e] < 0) continue;
            Z stretch;
            for (int i = 0; i < n; ++i) stretch = stretch + shape[i] * rig.B[e * n + i];
            const Z sensitivity = -(factor[rig.letters[e]] * stretch * stretch) / below;
            for (int j = 0; j < m; ++j) slope[j] = slope[j] + sensitivity * rig.T[e * m + j];
        }
        std::vector<double> grow(m), damp(m);
        for (int j = 0; j < m; ++j) {
            const double growth = (value.re * slope[j].re + value.im * slope[j].im) / magnitude;
            grow[j] = growth / (2 * M_PI);
            damp[j] = -slope[j].re / magnitude + value.re * growth / (magnitude * magnitude);
        }
        table.frequency_sd.push_back(deviation(grow));
        table.damping_sd.push_back(deviation(damp));
    }
    // NaN where the variance is the rounding of terms that are far larger.
    double deviation(const std::vector<double> &slope) const {
        const int m = rig.unknowns;
        double variance = 0, terms = 0;
        for (int i = 0; i < m; ++i)
            for (int j = 0; j < m; ++j) {
                const double term = slope[i] * covariance[i * m + j] * slope[j];
                variance += term, terms += std::fabs(term);
            }
        if (variance <= 1e-13 * terms && terms > 0) return std::nan("");
        return std::isnan(variance) ? variance : std::sqrt(std::max(variance, 0.0));
    }
};

}  // namespace dashpot
