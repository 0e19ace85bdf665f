// Small real systems of one repeat: rows and columns scaled alike, elimination with row exchanges.
#pragma once
#include "lanes.hpp"

namespace DASHPOT_SET {

constexpr double NOT_A_NUMBER = __builtin_nan("");
constexpr double INFINITE = __builtin_inf();
constexpr double SINGULAR = 1e-14;

INLINE double size_of(double diagonal) {
    const double size = __builtin_sqrt(__builtin_fabs(diagonal));
    return size > 0 ? size : 1.0;
}

// A X = R for A (m, m) and R (m, k), both overwritten; NaN throughout where A is singular.
static void eliminate(double *__restrict A, double *__restrict R, int m, int k) {
    for (int i = 0; i < m; ++i) {
        int best = i;
        double most = __builtin_fabs(A[i * m + i]);
        for (int row = i + 1; row < m; ++row)
            if (__builtin_fabs(A[row * m + i]) > most) most = __builtin_fabs(A[row * m + i]), best = row;
        if (most == 0) {
            for (int j = 0; j < m * k; ++j) R[j] = NOT_A_NUMBER;
            return;
        }
        if (best != i) {
            for (int j = i; j < m; ++j) {
                const double held = A[i * m + j];
                A[i * m + j] = A[best * m + j], A[best * m + j] = held;
            }
            for (int j = 0; j < k; ++j) {
                const double held = R[i * k + j];
                R[i * k + j] = R[best * k + j], R[best * k + j] = held;
            }
        }
        const double pivot = 1 / A[i * m + i];
        for (int row = i + 1; row < m; ++row) {
            const double factor = A[row * m + i] * pivot;
            if (factor == 0) continue;  // even and odd harmonics of odd laws know nothing of each other
            for (int j = i + 1; j < m; ++j) A[row * m + j] -= factor * A[i * m + j];
            for (int j = 0; j < k; ++j) R[row * k + j] -= factor * R[i * k + j];
        }
    }
    for (int i = m - 1; i >= 0; --i) {
        for (int row = i + 1; row < m; ++row)
            if (A[i * m + row] != 0)
                for (int j = 0; j < k; ++j) R[i * k + j] -= A[i * m + row] * R[row * k + j];
        for (int j = 0; j < k; ++j) R[i * k + j] /= A[i * m + i];
    }
}

// x = A^-1 right; `scratch` holds m m + m numbers.
static void solve_scaled(const double *A, const double *right, double *x, int m, double *scratch) {
    double *scaled = scratch, *size = scratch + m * m;
    for (int i = 0; i < m; ++i) size[i] = size_of(A[i * m + i]), x[i] = right[i] / size[i];
    for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) scaled[i * m + j] = A[i * m + j] / (size[i] * size[j]);
    eliminate(scaled, x, m, 1);
    for (int i = 0; i < m; ++i) x[i] /= size[i];
}

// The inverse of the Cholesky factor of a symmetric A (m, m), in its lower triangle; false where A is not positive
// definite, of which the triangle is lost.
static bool inverse_factor(double *A, int m) {
    for (int i = 0; i < m; ++i) {
        for (int j = 0; j <= i; ++j) {
            double rest = A[i * m + j];
            for (int k = 0; k < j; ++k) rest -= A[i * m + k] * A[j * m + k];
            if (i == j && !(rest > 0)) return false;
            A[i * m + j] = i == j ? 1 / __builtin_sqrt(rest) : rest * A[j * m + j];  // diagonals already inverted
        }
    }
    for (int i = 0; i < m; ++i)
        for (int j = 0; j < i; ++j) {
            double sum = 0;
            for (int k = j; k < i; ++k) sum += A[i * m + k] * A[k * m + j];
            A[i * m + j] = -sum * A[i * m + i];
        }
    return true;
}

// Square roots of the diagonal of A^-1, A a sum of squares; 0 where it is singular to rounding.  `scratch` holds
// m m + m numbers.
static void deviations(const double *A, double *sd, int m, double *scratch) {
    double *scaled = scratch, *size = scratch + m * m;
    for (int i = 0; i < m; ++i) size[i] = 1 / size_of(A[i * m + i]);
    for (int i = 0; i < m; ++i)
        for (int j = 0; j <= i; ++j) scaled[i * m + j] = A[i * m + j] * size[i] * size[j];
    bool regular = inverse_factor(scaled, m);
    for (int i = 0; i < m && regular; ++i) {
        double variance = 0;  // the largest numbers of the inverse stand on its diagonal
        for (int k = i; k < m; ++k) variance += scaled[k * m + i] * scaled[k * m + i];
        regular = variance < 1 / SINGULAR;
        sd[i] = __builtin_sqrt(variance) * size[i];
    }
    for (int i = 0; i < m && !regular; ++i) sd[i] = 0;
}

// Whether A - shift is positive definite; A (m, m) is overwritten.
static bool definite(double *A, int m, double shift) {
    for (int i = 0; i < m; ++i) A[i * m + i] -= shift;
    for (int k = 0; k < m; ++k) {
        if (!(A[k * m + k] > 0)) return false;
        for (int i = k + 1; i < m; ++i) {
            const double factor = A[i * m + k] / A[k * m + k];
            for (int j = k + 1; j <= i; ++j) A[i * m + j] -= factor * A[j * m + k];
        }
    }
    return true;
}

// Smallest eigenvalue of a symmetric matrix (m, m), which is overwritten, to six digits: Householder to three
// diagonals, then bisection by Sturm's count; `scratch` holds 3 m numbers.
static double smallest_eigenvalue(double *A, int m, double *scratch) {
    double *d = scratch, *off = scratch + m, *v = scratch + 2 * m;
    for (int i = 0; i < m * m; ++i)
        if (!__builtin_isfinite(A[i])) A[i] = 0;
    for (int k = 0; k + 2 < m; ++k) {
        double norm = 0;
        for (int i = k + 1; i < m; ++i) norm += A[i * m + k] * A[i * m + k];
        norm = __builtin_sqrt(norm);
        if (norm == 0) continue;
        const double first = A[(k + 1) * m + k], alpha = first > 0 ? -norm : norm;
        double length = 0;
        for (int i = k + 1; i < m; ++i) {
            v[i] = A[i * m + k] - (i == k + 1 ? alpha : 0.0);
            length += v[i] * v[i];
        }
        if (length == 0) continue;
        // A <- H A H, H = 1 - 2 v v^T / length, on rows and columns behind k.
        double vpv = 0;
        for (int i = k + 1; i < m; ++i) {
            double sum = 0;
            for (int j = k + 1; j < m; ++j) sum += A[i * m + j] * v[j];
            off[i] = 2 * sum / length;
            vpv += off[i] * v[i];
        }
        for (int i = k + 1; i < m; ++i) off[i] -= vpv / length * v[i];
        for (int i = k + 1; i < m; ++i)
            for (int j = k + 1; j < m; ++j) A[i * m + j] -= v[i] * off[j] + off[i] * v[j];
        A[(k + 1) * m + k] = A[k * m + k + 1] = alpha;
        for (int i = k + 2; i < m; ++i) A[i * m + k] = A[k * m + i] = 0;
    }
    double low = INFINITE, high = -INFINITE;
    for (int i = 0; i < m; ++i) {
        d[i] = A[i * m + i];
        const double left = i ? __builtin_fabs(A[i * m + i - 1]) : 0.0;
        const double right = i + 1 < m ? __builtin_fabs(A[i * m + i + 1]) : 0.0;
        if (d[i] - left - right < low) low = d[i] - left - right;
        if (d[i] + left + right > high) high = d[i] + left + right;
    }
    for (int i = 0; i + 1 < m; ++i) off[i] = A[i * m + i + 1] * A[i * m + i + 1];
    const double width = high - low;
    for (int turn = 0; turn < 60; ++turn) {
        const double middle = (low + high) / 2;
        if (high - low <= 1e-15 * width || high - low <= 1e-6 * __builtin_fabs(middle)) break;
        double q = d[0] - middle;
        bool below = q < 0;
        for (int i = 1; i < m && !below; ++i) {
            q = d[i] - middle - off[i - 1] / (q == 0 ? 1e-300 : q);
            below = q < 0;
        }
        (below ? high : low) = middle;
    }
    return (low + high) / 2;
}

}  // namespace DASHPOT_SET
