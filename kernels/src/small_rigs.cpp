// Stages of one small rig, in which NumPy would spend its time on being called: states, inverses, modes.
#include <cmath>
#include <optional>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "arrays.hpp"
#include "modes.hpp"

#define DASHPOT_SET small_rigs
#include "dense.hpp"

namespace dashpot {

namespace {

using namespace nb::literals;

// One line's weighted means; twin: dashpot.estimate.preparation.point_states.combined_by_point.
struct Point {
    std::vector<double> weight, information;
    std::vector<int> exactly;

    Point(size_t channels, size_t entries) : weight(channels), information(entries), exactly(entries) {}

    // P (entries, channels) and the variances of the states; false where two exact channels show one entry.
    bool combine(const std::complex<double> *reading, const int64_t *entry, const bool *used,
                 const std::complex<double> *V, std::complex<double> *P, std::complex<double> *spread) {
        const size_t channels = weight.size(), entries = information.size();
        std::fill(information.begin(), information.end(), 0.0);
        std::fill(exactly.begin(), exactly.end(), 0);
        const auto seen = [&](size_t c) { return used[c] && entry[c] >= 0 && reading[c] != std::complex<double>(0); };
        const auto exact = [&](size_t c) { return V[c * channels + c].real() <= 0; };
        for (size_t c = 0; c < channels; ++c)
            if (seen(c) && exact(c) && ++exactly[entry[c]] > 1) return false;
        for (size_t c = 0; c < channels; ++c) {
            weight[c] = 0;
            if (!seen(c) || (!exact(c) && exactly[entry[c]])) continue;
            weight[c] = exact(c) ? 1.0 : std::norm(reading[c]) / V[c * channels + c].real();
            information[entry[c]] += weight[c];
        }
        for (size_t c = 0; c < channels; ++c)
            if (weight[c] != 0) P[entry[c] * channels + c] = weight[c] / information[entry[c]] / reading[c];
        for (size_t e = 0; e < entries; ++e) spread[e * entries + e] = exactly[e] ? 0.0 : 1 / information[e];
        return true;
    }
};

// Whether `count` covariances of channels have nothing off their diagonals.
bool uncorrelated(const std::complex<double> *V, size_t count, size_t channels) {
    for (size_t k = 0, at = 0; k < count; ++k)
        for (size_t i = 0; i < channels; ++i)
            for (size_t j = 0; j < channels; ++j, ++at)
                if (i != j && V[at] != std::complex<double>(0)) return false;
    return true;
}

// z = P y at one line; a channel has a share in its own entry alone.
void weigh(const std::complex<double> *P, const int64_t *entry, const std::complex<double> *y, size_t channels,
           std::complex<double> *z) {
    for (size_t i = 0; i < channels; ++i) {
        if (entry[i] < 0) continue;
        const std::complex<double> share = P[entry[i] * channels + i];
        std::complex<double> &sum = z[entry[i]];
        sum = {sum.real() + (share.real() * y[i].real() - share.imag() * y[i].imag()),
               sum.imag() + (share.real() * y[i].imag() + share.imag() * y[i].real())};
    }
}

// reading, used (lines, channels); entry (channels,), -1 where a channel shows none; V (K or 1, lines, channels,
// channels); y (K, lines, channels).  States, their covariance and P; None where channels are correlated or two exact
// ones show one entry.
nb::object point_states(Complexes reading, Integers entry, Flags used, Complexes V, Complexes y, size_t entries) {
    require(reading.ndim() == 2 && used.ndim() == 2 && V.ndim() == 4 && y.ndim() == 3, "states need lines of channels");
    const size_t K = y.shape(0), S = V.shape(0), L = y.shape(1), c = y.shape(2), q = entries;
    require(reading.shape(0) == L && reading.shape(1) == c && used.shape(0) == L && used.shape(1) == c &&
                entry.size() == c && (S == 1 || S == K) && V.shape(1) == L && V.shape(2) == c && V.shape(3) == c,
            "readings, flags, covariance and amplitudes have different sizes");
    for (size_t k = 0; k < c; ++k) require(entry.data()[k] < static_cast<int64_t>(q), "a channel shows no such entry");
    auto z = array<std::complex<double>>({K, L, q}), spread = array<std::complex<double>>({S, L, q, q});
    auto P = array<std::complex<double>>({S, L, q, c});
    bool simple = true;
    {
        nb::gil_scoped_release released;
        simple = uncorrelated(V.data(), S * L, c);
        Point point(c, q);
        for (size_t k = 0; simple && k < S * L; ++k)
            simple = point.combine(reading.data() + k % L * c, entry.data(), used.data() + k % L * c,
                                   V.data() + k * c * c, P.data + k * q * c, spread.data + k * q * q);
        for (size_t k = 0; simple && k < K * L; ++k)
            weigh(P.data + (S == 1 ? k % L : k) * q * c, entry.data(), y.data() + k * c, c, z.data + k * q);
    }
    if (!simple) return nb::none();
    return nb::make_tuple(z.array, spread.array, P.array);
}

// Inverses of information matrices (..., m, m); twin: dashpot.numerics.small_systems.scaled_inverse.
nb::object scaled_inverse(Reals matrix) {
    require(matrix.ndim() >= 2 && matrix.shape(matrix.ndim() - 1) == matrix.shape(matrix.ndim() - 2),
            "an inverse is that of square matrices");
    std::vector<size_t> shape;
    for (size_t axis = 0; axis < matrix.ndim(); ++axis) shape.push_back(matrix.shape(axis));
    const size_t m = shape.back(), count = m ? matrix.size() / (m * m) : 0;
    auto inverse = array(shape);
    {
        nb::gil_scoped_release released;
        std::vector<double> scaled(m * m), scale(m);
        for (size_t k = 0; k < count; ++k) {
            const double *A = matrix.data() + k * m * m;
            double *out = inverse.data + k * m * m;
            for (size_t i = 0; i < m; ++i) scale[i] = small_rigs::size_of(A[i * m + i]);
            for (size_t i = 0; i < m * m; ++i) {
                scaled[i] = A[i] / (scale[i / m] * scale[i % m]);
                out[i] = i % (m + 1) == 0;
            }
            small_rigs::eliminate(scaled.data(), out, static_cast<int>(m), static_cast<int>(m));
            // Of a matrix with ones on its diagonal: entries that large are rounding, not information.
            bool regular = true;
            for (size_t i = 0; i < m * m; ++i) regular = regular && std::fabs(out[i]) < 1 / small_rigs::SINGULAR;
            for (size_t i = 0; i < m * m; ++i)
                out[i] = regular ? out[i] / (scale[i / m] * scale[i % m]) : small_rigs::NOT_A_NUMBER;
        }
    }
    return nb::cast(inverse.array);
}

// Eigenvalues, natural frequencies, damping ratios, deviations of both and shapes, of one rig; None where the twin is
// to decide.
nb::object mode_values(Reals B, Integers letters, Reals T, Reals p0, Reals theta, Reals covariance) {
    const size_t elements = B.shape(0), n = B.ndim() == 2 ? B.shape(1) : 0, m = T.ndim() == 2 ? T.shape(1) : 0;
    require(n > 0 && letters.size() == elements && T.shape(0) == elements && p0.size() == elements &&
                theta.size() == m && covariance.size() == m * m,
            "arrays of a rig have different sizes");
    static_assert(sizeof(long long) == sizeof(int64_t));
    const ModalRig rig = {static_cast<int>(n), static_cast<int>(elements), static_cast<int>(m), B.data(), T.data(),
                          p0.data(), reinterpret_cast<const long long *>(letters.data())};
    ModeTable table;
    bool solved;
    {
        nb::gil_scoped_release released;
        solved = Modes(rig, theta.data(), covariance.data()).solve(table);
    }
    if (!solved) return nb::none();
    const size_t count = table.count;
    const auto copied = [&](const std::vector<double> &from) {
        auto to = array({count});
        std::copy(from.begin(), from.end(), to.data);
        return to.array;
    };
    const auto complex = [&](const std::vector<Z> &from, std::vector<size_t> shape) {
        auto to = array<std::complex<double>>(shape);
        for (size_t k = 0; k < from.size(); ++k) to.data[k] = {from[k].re, from[k].im};
        return to.array;
    };
    return nb::make_tuple(complex(table.eigenvalues, {count}), copied(table.frequency), copied(table.damping),
                          copied(table.frequency_sd), copied(table.damping_sd), complex(table.shapes, {count, n}));
}

}  // namespace

void bind_small_rigs(nb::module_ &module) {
    module.def("point_states", &point_states, "reading"_a, "entry"_a, "used"_a, "covariance"_a, "amplitudes"_a,
               "entries"_a);
    module.def("scaled_inverse", &scaled_inverse, "matrix"_a);
    module.def("mode_values", &mode_values, "B"_a, "letters"_a, "T"_a, "p0"_a, "theta"_a, "covariance"_a);
}

}  // namespace dashpot
