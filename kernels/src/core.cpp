// The module: arrays in, arrays out; which instruction set; threads.
#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/complex.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "arrays.hpp"
#include "problem.hpp"
#include "threads.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace baseline { extern const dashpot::Loops LOOPS; }
#ifdef DASHPOT_HAS_avx2
namespace avx2 { extern const dashpot::Loops LOOPS; }
namespace avx512 { extern const dashpot::Loops LOOPS; }
#endif

namespace {

const dashpot::Loops *chosen = nullptr;

}  // namespace

const dashpot::Loops &dashpot::loops() { return *chosen; }

namespace {

using dashpot::Array, dashpot::array, dashpot::Complexes, dashpot::Flags, dashpot::Integers, dashpot::numbers,
    dashpot::Reals, dashpot::require, dashpot::Memory, dashpot::memory, dashpot::share;

std::vector<const dashpot::Loops *> available() {
    std::vector<const dashpot::Loops *> sets = {&baseline::LOOPS};
#ifdef DASHPOT_HAS_avx2
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        sets.push_back(&avx2::LOOPS);
        if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
            sets.push_back(&avx512::LOOPS);
    }
#endif
    return sets;
}

struct Rig {
    dashpot::Rig rig{};
    std::vector<double> T, p0, cell_value, join_value, tie_value, term_value, S, precision, mean;
    std::vector<int> cell_element, cell_letter, cell_place, letter, join_start, join_point, active_element, tie_start,
        tie_active, column_start, entry_row, term_start, term_active, known_element, row_start, row_column;
    Memory<double> factor, omega;

    Rig(Reals B, Reals D, Reals T_, Reals p0_, Reals S_, Integers letters, Reals factors, Flags imaginary,
        Reals omegas, Reals precisions, Reals means) {
        const int elements = B.shape(0), n = B.shape(1), r = D.shape(1), m = T_.shape(1), lines = omegas.shape(0);
        require(n > 0 && lines > 0 && D.shape(0) == B.shape(0) && T_.shape(0) == B.shape(0) &&
                    p0_.shape(0) == B.shape(0) && S_.shape(0) == B.shape(1) && letters.shape(0) == B.shape(0) &&
                    factors.shape(0) == 4 && factors.shape(1) == omegas.shape(0) && imaginary.shape(0) == 4 &&
                    precisions.shape(0) == T_.shape(1) && means.shape(0) == T_.shape(1),
                "arrays of a rig have different sizes");
        T.assign(T_.data(), T_.data() + T_.size()), p0.assign(p0_.data(), p0_.data() + p0_.size());
        S.assign(S_.data(), S_.data() + S_.size());
        precision.assign(precisions.data(), precisions.data() + m), mean.assign(means.data(), means.data() + m);
        const int stride = (lines + 7) / 8 * 8;
        factor = memory<double>(4 * stride), omega = memory<double>(stride);
        for (int l = 0; l < stride; ++l) {
            const int line = std::min(l, lines - 1);
            omega[l] = omegas.data()[line];
            for (int k = 0; k < 4; ++k) factor[k * stride + l] = factors.data()[k * lines + line];
        }
        for (int k = 0; k < 4; ++k) rig.imaginary[k] = imaginary.data()[k], rig.used[k] = false;
        join_start.push_back(0);
        for (int e = 0; e < elements; ++e) {
            const int own = static_cast<int>(letters.data()[e]);
            letter.push_back(own);
            for (int k = 0; k < n + r; ++k) {
                const double value = k < n ? B.data()[e * n + k] : D.data()[e * r + k - n];
                if (value != 0) join_point.push_back(k), join_value.push_back(value);
            }
            join_start.push_back(static_cast<int>(join_point.size()));
            if (own < 0) continue;
            rig.used[own] = true;
            for (int a = join_start[e]; a < join_start[e + 1]; ++a)
                for (int b = join_start[e]; b < join_start[e + 1]; ++b)
                    if (join_point[a] < n) {
                        cell_element.push_back(e), cell_letter.push_back(own);
                        cell_place.push_back(join_point[a] * (n + r) + join_point[b]);
                        cell_value.push_back(join_value[a] * join_value[b]);
                    }
        }
        std::vector<int> place(elements, -1);
        for (int e = 0; e < elements; ++e) {
            for (int j = 0; j < m; ++j)
                if (T[e * m + j] != 0 && place[e] < 0) {
                    place[e] = static_cast<int>(active_element.size());
                    active_element.push_back(e);
                }
            if (p0[e] != 0) known_element.push_back(e);
        }
        tie_start.push_back(0), column_start.push_back(0), term_start.push_back(0);
        for (int j = 0; j < m; ++j) {
            for (int e = 0; e < elements; ++e)
                if (T[e * m + j] != 0) tie_active.push_back(place[e]), tie_value.push_back(T[e * m + j]);
            tie_start.push_back(static_cast<int>(tie_active.size()));
            for (int i = 0; i < n; ++i) {
                const size_t before = term_active.size();
                for (int t = tie_start[j]; t < tie_start[j + 1]; ++t) {
                    const double value = B.data()[active_element[tie_active[t]] * n + i] * tie_value[t];
                    if (value != 0) term_active.push_back(tie_active[t]), term_value.push_back(value);
                }
                if (term_active.size() == before) continue;
                entry_row.push_back(i);
                term_start.push_back(static_cast<int>(term_active.size()));
            }
            column_start.push_back(static_cast<int>(entry_row.size()));
        }
        std::vector<unsigned char> present(n * (n + r));
        for (int place : cell_place) present[place] = 1;
        row_start.push_back(0);
        for (int i = 0; i < n; ++i) {
            for (int c = 0; c < n + r; ++c)
                if (present[i * (n + r) + c]) row_column.push_back(c);
            row_start.push_back(static_cast<int>(row_column.size()));
        }
        rig.row_start = row_start.data(), rig.row_column = row_column.data();
        rig.n = n, rig.r = r, rig.s = static_cast<int>(S_.shape(1)), rig.elements = elements, rig.unknowns = m;
        rig.lines = lines, rig.stride = stride, rig.T = T.data(), rig.p0 = p0.data(), rig.S = S.data();
        rig.cells = static_cast<int>(cell_value.size()), rig.cell_element = cell_element.data();
        rig.cell_letter = cell_letter.data(), rig.cell_place = cell_place.data(), rig.cell_value = cell_value.data();
        rig.factor = factor.get(), rig.letter = letter.data(), rig.join_start = join_start.data();
        rig.join_point = join_point.data(), rig.join_value = join_value.data();
        rig.active = static_cast<int>(active_element.size()), rig.active_element = active_element.data();
        rig.tie_start = tie_start.data(), rig.tie_active = tie_active.data(), rig.tie_value = tie_value.data();
        rig.column_start = column_start.data(), rig.entry_row = entry_row.data(), rig.term_start = term_start.data();
        rig.term_active = term_active.data(), rig.term_value = term_value.data();
        rig.known = static_cast<int>(known_element.size()), rig.known_element = known_element.data();
        rig.precision = precision.data(), rig.mean = mean.data();
    }
    Rig(const Rig &) = delete;
};

struct Limits {
    dashpot::Limits limits{};
    Limits(const Reals &lower, const Reals &upper, const Reals &longest, const std::optional<Flags> &logarithmic,
           int limit, double tolerance, int patience, size_t unknowns) {
        require(lower.size() == unknowns && upper.size() == unknowns && longest.size() == unknowns &&
                    (!logarithmic || logarithmic->size() == unknowns) && patience > 0,
                "limits are of another number of unknowns");
        limits.lower = lower.data(), limits.upper = upper.data(), limits.longest = longest.data();
        limits.limit = limit, limits.patience = patience, limits.tolerance = tolerance;
        limits.logarithmic = logarithmic ? reinterpret_cast<const unsigned char *>(logarithmic->data()) : nullptr;
    }
};

// Where a search ends, as arrays: x, cost, converged, iterations, history of the first row.
struct Ending {
    Array<double> x, cost, history, sum{}, gradient{}, symmetric{}, free{};
    Array<bool> converged;
    Array<int64_t> iterations;
    int rows = 0;
    size_t unknowns;
    dashpot::Ends ends;

    Ending(size_t count, size_t m, int limit)
        : x(array({count, m})), cost(array({count})), history(array({static_cast<size_t>(limit) + 1, m})),
          converged(array<bool>({count})), iterations(array<int64_t>({count})), unknowns(m) {
        ends = {x.data, cost.data, reinterpret_cast<unsigned char *>(converged.data),
                reinterpret_cast<long long *>(iterations.data), history.data, &rows};
    }
    void with_sums() {
        const size_t count = x.array.shape(0);
        sum = array({count}), gradient = array({count, unknowns}), symmetric = array({count, unknowns, unknowns});
        free = array({count, unknowns, unknowns});
        ends.sum = sum.data, ends.gradient = gradient.data, ends.symmetric = symmetric.data, ends.free = free.data;
    }
    nb::tuple sums() { return nb::make_tuple(sum.array, gradient.array, symmetric.array, free.array); }
    nb::tuple result() {
        return nb::make_tuple(x.array, cost.array, converged.array, iterations.array, history.array, rows);
    }
};

const long long *rows_of(const Integers &rows, size_t count, int repeats) {
    require(rows.size() == count, "there must be one row for each start");
    for (size_t k = 0; k < count; ++k)
        require(rows.data()[k] >= 0 && rows.data()[k] < repeats, "a row is none of the repeats");
    return reinterpret_cast<const long long *>(rows.data());
}

struct Equation {
    std::shared_ptr<Rig> rig;
    Complexes z, covariance;
    dashpot::Equation equation{};
    std::vector<int> place_row, place_column;
    std::vector<unsigned char> row_noisy;
    size_t m, repeats;

    Equation(std::shared_ptr<Rig> rig_, Complexes z_, Complexes covariance_)
        : rig(std::move(rig_)), z(std::move(z_)), covariance(std::move(covariance_)) {
        const int q = rig->rig.n + rig->rig.r + rig->rig.s;
        require(z.ndim() == 3 && covariance.ndim() == 4 && static_cast<int>(z.shape(2)) == q &&
                    static_cast<int>(z.shape(1)) == rig->rig.lines && covariance.shape(1) == z.shape(1) &&
                    static_cast<int>(covariance.shape(2)) == q && static_cast<int>(covariance.shape(3)) == q &&
                    (covariance.shape(0) == 1 || covariance.shape(0) == z.shape(0)),
                "states are of another size than their rig");
        m = rig->rig.unknowns, repeats = z.shape(0);
        std::vector<unsigned char> present(q * q);
        row_noisy.assign(q, 0);
        const std::complex<double> *from = covariance.data();
        for (size_t k = 0, at = 0; k < covariance.shape(0) * covariance.shape(1); ++k)
            for (int i = 0; i < q * q; ++i, ++at) present[i] |= from[at] != std::complex<double>(0);
        for (int i = 0; i < q * q; ++i)
            if (present[i]) place_row.push_back(i / q), place_column.push_back(i % q), row_noisy[i / q] = 1;
        equation.rig = &rig->rig, equation.repeats = static_cast<int>(repeats), equation.q = q;
        equation.z = numbers(z), equation.covariance = numbers(covariance), equation.shared = covariance.shape(0) == 1;
        equation.places = static_cast<int>(place_row.size());
        equation.place_row = place_row.data(), equation.place_column = place_column.data();
        equation.row_noisy = row_noisy.data();
    }
    Equation(const Equation &) = delete;

    nb::tuple evaluate(Reals theta, Integers rows, int threads) const {
        require(theta.ndim() == 2 && theta.shape(1) == m, "theta is of another number of unknowns");
        const size_t K = theta.shape(0);
        const long long *of = rows_of(rows, K, equation.repeats);
        auto cost = array({K}), gradient = array({K, m}), symmetric = array({K, m, m}), mixed = array({K, m, m});
        {
            nb::gil_scoped_release released;
            share(K, threads, chosen->equation_workspace(equation), [&](long from, long to, char *place) {
                chosen->equation_evaluate(equation, theta.data(), of, from, to, cost.data, gradient.data,
                                          symmetric.data, mixed.data, place);
            });
        }
        return nb::make_tuple(cost.array, gradient.array, symmetric.array, mixed.array);
    }

    nb::tuple lines(Reals theta, int threads) const {
        require(theta.ndim() == 2 && theta.shape(1) == m && theta.shape(0) == repeats, "theta is of another size");
        const size_t L = rig->rig.lines;
        auto information = array({repeats, L, m, m}), scores = array({repeats, L, m}), cost = array({repeats, L});
        {
            nb::gil_scoped_release released;
            share(repeats, threads, chosen->equation_workspace(equation), [&](long from, long to, char *place) {
                chosen->equation_lines(equation, theta.data(), from, to, information.data, scores.data, cost.data,
                                       place);
            });
        }
        return nb::make_tuple(information.array, scores.array, cost.array);
    }

    nb::tuple starts(int threads) const {
        auto clean = array({repeats, m}), weighted = array({repeats, m}), plain = array({repeats, m});
        {
            nb::gil_scoped_release released;
            share(repeats, threads, chosen->equation_workspace(equation), [&](long from, long to, char *place) {
                chosen->equation_starts(equation, from, to, clean.data, weighted.data, plain.data, place);
            });
        }
        return nb::make_tuple(clean.array, weighted.array, plain.array);
    }

    // From rows of the start of all repeats, within `far` times their largest starts; what runs off that far has not
    // converged.  With cost, slope and matrices at the end.
    nb::tuple search(Reals start, Integers rows, double far, int limit, double tolerance, int patience,
                     int threads) const {
        require(start.ndim() == 2 && start.shape(1) == m && start.shape(0) == repeats, "the start is of another size");
        const size_t K = rows.size();
        const long long *of = rows_of(rows, K, equation.repeats);
        std::vector<double> upper(m, 0.0), lower(m), endless(m, INFINITY), from(K * m);
        for (size_t k = 0; k < repeats * m; ++k)
            upper[k % m] = std::max(upper[k % m], std::fabs(start.data()[k]));  // NaN is no larger
        for (size_t j = 0; j < m; ++j) {
            upper[j] = upper[j] > 0 ? far * upper[j] : INFINITY;
            lower[j] = -upper[j];
        }
        for (size_t k = 0; k < K * m; ++k) from[k] = start.data()[of[k / m] * m + k % m];
        dashpot::Limits limits{};
        limits.lower = lower.data(), limits.upper = upper.data(), limits.longest = endless.data();
        limits.limit = limit, limits.patience = patience, limits.tolerance = tolerance;
        Ending ending(K, m, limit);
        ending.with_sums();
        {
            nb::gil_scoped_release released;
            share(K, threads, chosen->equation_workspace(equation), [&](long first, long last, char *place) {
                chosen->equation_descend(equation, from.data(), of, first, last, limits, ending.ends, place);
            });
        }
        for (size_t k = 0; k < K * m; ++k)
            if (!(std::fabs(ending.x.data[k]) < upper[k % m])) ending.converged.data[k / m] = false;
        return nb::make_tuple(ending.result(), ending.sums());
    }
};

// What the channels show of a rig, without any data.
struct Channels {
    std::shared_ptr<Rig> rig;
    dashpot::Output output{};
    Memory<double> rate;
    std::vector<double> on_x, on_q, force, precision, mean;
    std::vector<unsigned char> turned, sees, has_force;
    std::vector<int> gain, delay;
    size_t M, count;

    Channels(std::shared_ptr<Rig> rig_, const Integers &derivative, const Reals &on_x_, const Reals &on_q_,
             const Reals &force_, const Integers &gain_, const Integers &delay_, bool calibrated,
             const Reals &precision_, const Reals &mean_)
        : rig(std::move(rig_)) {
        const dashpot::Rig &own = rig->rig;
        const size_t n = own.n, nq = own.r + own.s;
        count = derivative.size();
        require(on_x_.size() == count * n && on_q_.size() == count * nq && force_.size() == count * own.elements &&
                    gain_.size() == count && delay_.size() == count,
                "channels are of another size than their rig");
        on_x.assign(on_x_.data(), on_x_.data() + on_x_.size()), on_q.assign(on_q_.data(), on_q_.data() + on_q_.size());
        force.assign(force_.data(), force_.data() + force_.size());
        rate = memory<double>(count * own.stride);
        int gains = 0, delays = 0;
        for (size_t c = 0; c < count; ++c) {
            const int64_t power = derivative.data()[c];
            turned.push_back(power == 1);
            for (int l = 0; l < own.stride; ++l) {
                const double omega = rig->omega[l];
                rate[c * own.stride + l] = power == 0 ? 1.0 : power == 1 ? omega : -omega * omega;
            }
            bool moves = false, forces = false;
            for (size_t i = 0; i < n; ++i) moves = moves || on_x[c * n + i] != 0;
            for (int e = 0; e < own.elements; ++e) forces = forces || force[c * own.elements + e] != 0;
            sees.push_back(moves || forces), has_force.push_back(forces);
            gain.push_back(static_cast<int>(gain_.data()[c])), delay.push_back(static_cast<int>(delay_.data()[c]));
            gains = std::max(gains, gain.back() + 1), delays = std::max(delays, delay.back() + 1);
        }
        M = own.unknowns + gains + delays;
        require(precision_.size() == M && mean_.size() == M, "priors are of another number of unknowns");
        precision.assign(precision_.data(), precision_.data() + M), mean.assign(mean_.data(), mean_.data() + M);
        output.rig = &own, output.channels = static_cast<int>(count);
        output.gains = gains, output.delays = delays, output.all = static_cast<int>(M), output.rate = rate.get();
        output.turned = turned.data(), output.omega = rig->omega.get(), output.on_x = on_x.data();
        output.on_q = on_q.data(), output.force = force.data(), output.sees = sees.data();
        output.has_force = has_force.data(), output.gain = gain.data(), output.delay = delay.data();
        output.calibrated = calibrated || gains || delays, output.precision = precision.data(), output.mean = mean.data();
    }
    Channels(const Channels &) = delete;
};

struct Output {
    Channels shown;
    Complexes y, W;
    std::optional<Complexes> inputs;
    dashpot::Output output{};
    size_t M, channels, repeats;
    const std::shared_ptr<Rig> &rig;

    Output(std::shared_ptr<Rig> rig_, Complexes y_, Complexes W_, std::optional<Complexes> inputs_,
           Integers derivative, Reals on_x, Reals on_q, Reals force, Integers gain, Integers delay, bool calibrated,
           Reals precision, Reals mean)
        : shown(std::move(rig_), derivative, on_x, on_q, force, gain, delay, calibrated, precision, mean),
          y(std::move(y_)), W(std::move(W_)), inputs(std::move(inputs_)), output(shown.output), M(shown.M),
          channels(shown.count), rig(shown.rig) {
        const size_t nq = rig->rig.r + rig->rig.s, L = rig->rig.lines;
        require(y.ndim() == 3 && W.ndim() == 4, "data are of another size than their rig");
        repeats = y.shape(0);
        require(y.shape(1) == L && y.shape(2) == channels && W.shape(1) == L && W.shape(2) == channels &&
                    W.shape(3) == channels && (W.shape(0) == 1 || W.shape(0) == repeats) &&
                    (!inputs || (inputs->ndim() == 3 && inputs->shape(0) == repeats && inputs->shape(1) == L &&
                                 inputs->shape(2) == nq)),
                "data are of another size than their rig");
        bool diagonal = true;
        const std::complex<double> *weight = W.data();
        for (size_t k = 0, at = 0; k < W.shape(0) * L; ++k)
            for (size_t i = 0; i < channels; ++i)
                for (size_t j = 0; j < channels; ++j, ++at)
                    if (i != j && weight[at] != std::complex<double>(0)) diagonal = false;
        output.repeats = static_cast<int>(repeats);
        output.y = numbers(y), output.W = numbers(W), output.inputs = inputs ? numbers(*inputs) : nullptr;
        output.shared = W.shape(0) == 1, output.diagonal = diagonal;
    }
    Output(const Output &) = delete;

    void check(const Reals &psi, const Reals &sign, const std::optional<Reals> &weight) const {
        require(psi.ndim() == 2 && psi.shape(1) == M && sign.ndim() == 2 && sign.shape(1) == channels &&
                    sign.shape(0) == psi.shape(0) && (!weight || weight->size() == rig->rig.lines * channels),
                "psi, signs or weights are of another size");
    }

    nb::tuple evaluate(Reals psi, Reals sign, Integers rows, std::optional<Reals> weight, bool slopes,
                       int threads) const {
        check(psi, sign, weight);
        const size_t K = psi.shape(0), some = slopes ? K : 0;
        const long long *of = rows_of(rows, K, output.repeats);
        auto cost = array({K}), gradient = array({some, M}), information = array({some, M, M});
        const int kind = weight ? dashpot::LOGARITHMS : dashpot::SQUARES;
        const double *weights = weight ? weight->data() : nullptr;
        {
            nb::gil_scoped_release released;
            share(K, threads, chosen->output_workspace(output), [&](long from, long to, char *place) {
                chosen->output_evaluate(output, psi.data(), sign.data(), of, from, to, kind, weights, slopes, cost.data,
                                        gradient.data, information.data, place);
            });
        }
        return nb::make_tuple(cost.array, gradient.array, information.array);
    }

    nb::tuple lines(Reals psi, Reals sign, int threads) const {
        check(psi, sign, std::nullopt);
        require(psi.shape(0) == repeats, "psi is of another number of repeats");
        const size_t L = rig->rig.lines;
        auto information = array({repeats, L, M, M}), scores = array({repeats, L, M}), cost = array({repeats, L});
        {
            nb::gil_scoped_release released;
            share(repeats, threads, chosen->output_workspace(output), [&](long from, long to, char *place) {
                chosen->output_lines(output, psi.data(), sign.data(), from, to, information.data, scores.data,
                                     cost.data, place);
            });
        }
        return nb::make_tuple(information.array, scores.array, cost.array);
    }

    nb::tuple descend(Reals start, Reals sign, Integers rows, std::optional<Reals> weight, Reals lower, Reals upper,
                      Reals longest, std::optional<Flags> logarithmic, int limit, double tolerance, int patience,
                      int threads) const {
        check(start, sign, weight);
        const size_t K = start.shape(0);
        const long long *of = rows_of(rows, K, output.repeats);
        const Limits limits(lower, upper, longest, logarithmic, limit, tolerance, patience, M);
        Ending ending(K, M, limit);
        const int kind = weight ? dashpot::LOGARITHMS : dashpot::SQUARES;
        const double *weights = weight ? weight->data() : nullptr;
        {
            nb::gil_scoped_release released;
            share(K, threads, chosen->output_workspace(output), [&](long from, long to, char *place) {
                chosen->output_descend(output, start.data(), sign.data(), of, from, to, kind, weights, limits.limits,
                                       ending.ends, place);
            });
        }
        return ending.result();
    }
};

// Whole records among the lines; arrays over lines hold them side by side, records filled up to a multiple of 8.
struct Records {
    Channels shown;
    Memory<double> s, y, by_input, sd, root, q;
    std::vector<int> start, owner, line, fitted_channel, fitted_power, powers;
    std::vector<unsigned char> loads, used;
    dashpot::Records records{};
    size_t M, f, terms, count, repeats, lines = 0;

    Records(std::shared_ptr<Rig> rig, Integers start_, Integers owner_, Integers line_, Reals s_, Flags loads_,
            Flags used_, std::optional<Reals> by_inputs, Integers fitted_channel_, Integers fitted_power_,
            Integers powers_, Reals ys, std::optional<Reals> sds, std::optional<Reals> roots, std::optional<Reals> qs,
            Integers derivative, Reals on_x, Reals on_q, Reals force, Integers gain, Integers delay, bool calibrated,
            Reals precision, Reals mean)
        : shown(std::move(rig), derivative, on_x, on_q, force, gain, delay, calibrated, precision, mean),
          s(copied(s_)), y(copied(ys)), by_input(copied(by_inputs)), sd(copied(sds)), root(copied(roots)),
          q(copied(qs)), start(list(start_)), owner(list(owner_)), line(list(line_)),
          fitted_channel(list(fitted_channel_)), fitted_power(list(fitted_power_)), powers(list(powers_)),
          loads(loads_.data(), loads_.data() + loads_.size()), used(used_.data(), used_.data() + used_.size()) {
        const dashpot::Rig &own = shown.rig->rig;
        const size_t Cs = shown.count, nq = own.r + own.s, stride = own.stride;
        require(used_.ndim() == 2 && used_.shape(0) == loads.size() && ys.ndim() == 4 && (sds || roots),
                "records are of another size than their rig");
        M = shown.M, f = used_.shape(1), terms = powers.size(), count = loads.size(), repeats = ys.shape(0);
        const size_t of_inputs = f - 2 * own.n - fitted_channel.size();
        auto fits = [&](const std::optional<Reals> &values, size_t each) {
            return !values || (values->size() == values->shape(0) * each &&
                               (values->shape(0) == 1 || values->shape(0) == repeats));
        };
        require(own.lines == own.stride && s_.size() == stride && line.size() == stride && fits(ys, 2 * Cs * stride) &&
                    fits(sds, Cs * stride) && fits(roots, 2 * Cs * Cs * stride) && fits(qs, 2 * nq * stride) &&
                    start.size() == owner.size() + 1 && start.front() == 0 &&
                    start.back() == static_cast<int>(stride) && fitted_power.size() == fitted_channel.size() &&
                    f >= 2 * own.n + fitted_channel.size() &&
                    (of_inputs == 0 || (by_inputs && qs && by_inputs->size() == 2 * nq * of_inputs * stride)) &&
                    (terms == 0 || sds),
                "records are of another size than their rig");
        for (size_t k = 0; k < owner.size(); ++k)
            require(start[k] % 8 == 0 && start[k] <= start[k + 1] && owner[k] < static_cast<int>(count),
                    "segments of records are none");
        for (int place : line) lines = std::max(lines, static_cast<size_t>(place + 1));
        records.output = &shown.output, records.records = static_cast<int>(count);
        records.segments = static_cast<int>(owner.size()), records.columns = static_cast<int>(f);
        records.of_inputs = static_cast<int>(of_inputs), records.fitted = static_cast<int>(fitted_channel.size());
        records.terms = static_cast<int>(terms), records.start = start.data(), records.owner = owner.data();
        records.line = line.data(), records.lines = static_cast<int>(lines), records.s = s.get();
        records.loads = loads.data(), records.used = used.data();
        records.by_input = by_input.get(), records.fitted_channel = fitted_channel.data();
        records.fitted_power = fitted_power.data(), records.powers = powers.data(), records.one = repeats == 1;
        records.shared = (sds ? sds : roots)->shape(0) == 1, records.y = y.get(), records.sd = sd.get();
        records.root = root.get(), records.q = q.get();
    }
    Records(const Records &) = delete;

    static std::vector<int> list(const Integers &numbers) {
        return std::vector<int>(numbers.data(), numbers.data() + numbers.size());
    }

    // Null where there is nothing.
    static Memory<double> copied(const std::optional<Reals> &numbers) {
        if (!numbers) return nullptr;
        Memory<double> place = memory<double>(numbers->size());
        std::copy_n(numbers->data(), numbers->size(), place.get());
        return place;
    }

    using Fit = std::optional<Reals>;
    dashpot::RecordsAt at(const Reals &psi, const Reals &sign, const Fit &folded, const Fit &z, const Fit &t,
                          const Fit &folded_slopes) const {
        const dashpot::Rig &own = shown.rig->rig;
        const size_t K = psi.shape(0), Cs = shown.count;
        auto fits = [&](const Fit &values, size_t each) { return !values || values->size() == K * count * each; };
        require(psi.ndim() == 2 && psi.shape(1) == M && sign.ndim() == 2 && sign.shape(0) == K &&
                    sign.shape(1) == Cs && (repeats == 1 || repeats == K) && fits(folded, Cs * 2 * own.n * 8) &&
                    fits(z, f) && fits(t, Cs * terms) && fits(folded_slopes, Cs * own.unknowns * 8),
                "psi, signs or coefficients are of another size");
        return {psi.data(), sign.data(), folded ? folded->data() : nullptr, z ? z->data() : nullptr,
                t ? t->data() : nullptr, folded_slopes ? folded_slopes->data() : nullptr};
    }

    nb::tuple columns(Reals psi, Reals sign, Fit folded, int threads) const {
        const dashpot::RecordsAt given = at(psi, sign, folded, std::nullopt, std::nullopt, std::nullopt);
        const size_t K = psi.shape(0), Cs = shown.count;
        auto products = array({K, count, f + 1, f + 1}), basis = array({K, count, Cs, terms, f + 1});
        {
            nb::gil_scoped_release released;
            share(K, threads, chosen->records_workspace(records), [&](long from, long to, char *place) {
                chosen->records_columns(records, given, from, to, products.data, basis.data, place);
            });
        }
        return nb::make_tuple(products.array, basis.array);
    }

    nb::tuple slopes(Reals psi, Reals sign, Fit folded, Reals z, Reals t, Fit folded_slopes, int threads) const {
        const dashpot::RecordsAt given = at(psi, sign, folded, z, t, folded_slopes);
        const size_t K = psi.shape(0), Cs = shown.count;
        auto products = array({K, M + 1, M + 1}), columns = array({K, count, f, M + 1});
        auto basis = array({K, count, Cs, terms, M + 1});
        {
            nb::gil_scoped_release released;
            share(K, threads, chosen->records_workspace(records), [&](long from, long to, char *place) {
                chosen->records_slopes(records, given, from, to, products.data, columns.data, basis.data, place);
            });
        }
        return nb::make_tuple(products.array, columns.array, basis.array);
    }

    nb::tuple by_line(Reals psi, Reals sign, Fit folded, Reals z, Reals t, Fit folded_slopes, Reals of_columns,
                      Reals of_basis, int threads) const {
        const dashpot::RecordsAt given = at(psi, sign, folded, z, t, folded_slopes);
        const size_t K = psi.shape(0);
        require(of_columns.size() == K * count * f * (M + 1) &&
                    of_basis.size() == K * count * shown.count * terms * (M + 1),
                "coefficients are of another size");
        auto information = array({K, lines, M, M}), scores = array({K, lines, M}), cost = array({K, lines});
        {
            nb::gil_scoped_release released;
            share(K, threads, chosen->records_workspace(records), [&](long from, long to, char *place) {
                chosen->records_lines(records, given, of_columns.data(), of_basis.data(), from, to, information.data,
                                      scores.data, cost.data, place);
            });
        }
        return nb::make_tuple(information.array, scores.array, cost.array);
    }

    nb::ndarray<nb::numpy, std::complex<double>> residuals(Reals psi, Reals sign, Fit folded, Reals z, Reals t,
                                                           int threads) const {
        const dashpot::RecordsAt given = at(psi, sign, folded, z, t, std::nullopt);
        const size_t K = psi.shape(0);
        auto residual = array<std::complex<double>>({K, lines, shown.count});
        {
            nb::gil_scoped_release released;
            share(K, threads, chosen->records_workspace(records), [&](long from, long to, char *place) {
                chosen->records_residuals(records, given, from, to, reinterpret_cast<double *>(residual.data), place);
            });
        }
        return residual.array;
    }
};

nb::tuple line_shares(Reals information, Reals inflation, Reals bread, int threads) {
    require(information.ndim() == 4 && inflation.ndim() == 2 && bread.ndim() == 3 &&
                information.shape(2) == information.shape(3) && bread.shape(0) == information.shape(0) &&
                bread.shape(1) == information.shape(2) && bread.shape(2) == information.shape(2) &&
                inflation.shape(1) == information.shape(1) &&
                (inflation.shape(0) == 1 || inflation.shape(0) == information.shape(0)),
            "information, inflation and bread have different sizes");
    const size_t K = information.shape(0), L = information.shape(1), m = information.shape(2);
    auto sums = array({K, m, m}), diagonals = array({K, L, m});
    const bool shared = inflation.shape(0) == 1;
    {
        nb::gil_scoped_release released;
        share(K, threads, 64, [&](long from, long to, char *) {
            for (long k = from; k < to; ++k)
                chosen->line_shares(information.data() + k * L * m * m, inflation.data() + (shared ? 0 : k) * L,
                                    bread.data() + k * m * m, static_cast<long>(L), static_cast<int>(m),
                                    sums.data + k * m * m, diagonals.data + k * L * m);
        });
    }
    return nb::make_tuple(sums.array, diagonals.array);
}

void set_instructions(const std::string &name) {
    for (const dashpot::Loops *set : available())
        if (name == set->name) {
            chosen = set;
            return;
        }
    throw std::invalid_argument("this processor does not have the instruction set " + name);
}

}  // namespace

NB_MODULE(_core, module) {
    nb::set_leak_warnings(false);  // what a user holds on to until the interpreter ends is no fault
    chosen = available().back();
    if (const char *asked = std::getenv("DASHPOT_KERNEL_SET"))
        for (const dashpot::Loops *set : available())
            if (std::string(asked) == set->name) chosen = set;

    nb::class_<Rig>(module, "Rig", "A rig at its lines: incidence, ties, laws and priors.")
        .def(nb::init<Reals, Reals, Reals, Reals, Reals, Integers, Reals, Flags, Reals, Reals, Reals>(), "B"_a, "D"_a,
             "T"_a, "p0"_a, "S"_a, "letters"_a, "factors"_a, "imaginary"_a, "omega"_a, "precision"_a, "mean"_a);
    nb::class_<Equation>(module, "Equation", "The equation of motion of K repeats whose states are measured.")
        .def(nb::init<std::shared_ptr<Rig>, Complexes, Complexes>(), "rig"_a, "z"_a, "covariance"_a)
        .def("evaluate", &Equation::evaluate, "theta"_a, "rows"_a, "threads"_a = 1)
        .def("lines", &Equation::lines, "theta"_a, "threads"_a = 1)
        .def("starts", &Equation::starts, "threads"_a = 1)
        .def("search", &Equation::search, "start"_a, "rows"_a, "far"_a, "limit"_a, "tolerance"_a, "patience"_a,
             "threads"_a = 1);
    nb::class_<Output>(module, "Output", "The channels of K repeats with their weights.")
        .def(nb::init<std::shared_ptr<Rig>, Complexes, Complexes, std::optional<Complexes>, Integers, Reals, Reals,
                      Reals, Integers, Integers, bool, Reals, Reals>(),
             "rig"_a, "y"_a, "W"_a, "inputs"_a.none(), "derivative"_a, "on_x"_a, "on_q"_a, "force"_a, "gain"_a,
             "delay"_a, "calibrated"_a, "precision"_a, "mean"_a)
        .def("evaluate", &Output::evaluate, "psi"_a, "sign"_a, "rows"_a, "weight"_a.none(), "slopes"_a,
             "threads"_a = 1)
        .def("lines", &Output::lines, "psi"_a, "sign"_a, "threads"_a = 1)
        .def("descend", &Output::descend, "start"_a, "sign"_a, "rows"_a, "weight"_a.none(), "lower"_a, "upper"_a,
             "longest"_a, "logarithmic"_a.none(), "limit"_a, "tolerance"_a, "patience"_a, "threads"_a = 1);
    nb::class_<Records>(module, "Records", "Whole records among the lines: their sums, beside loads and polynomials.")
        .def(nb::init<std::shared_ptr<Rig>, Integers, Integers, Integers, Reals, Flags, Flags, std::optional<Reals>,
                      Integers, Integers, Integers, Reals, std::optional<Reals>, std::optional<Reals>,
                      std::optional<Reals>, Integers, Reals, Reals, Reals, Integers, Integers, bool, Reals, Reals>(),
             "rig"_a, "start"_a, "owner"_a, "line"_a, "s"_a, "loads"_a, "used"_a, "by_input"_a.none(),
             "fitted_channel"_a, "fitted_power"_a, "powers"_a, "y"_a, "sd"_a.none(), "root"_a.none(), "q"_a.none(),
             "derivative"_a, "on_x"_a, "on_q"_a, "force"_a, "gain"_a, "delay"_a, "calibrated"_a, "precision"_a,
             "mean"_a)
        .def("columns", &Records::columns, "psi"_a, "sign"_a, "folded"_a.none(), "threads"_a = 1)
        .def("slopes", &Records::slopes, "psi"_a, "sign"_a, "folded"_a.none(), "z"_a, "t"_a, "folded_slopes"_a.none(),
             "threads"_a = 1)
        .def("by_line", &Records::by_line, "psi"_a, "sign"_a, "folded"_a.none(), "z"_a, "t"_a,
             "folded_slopes"_a.none(), "of_columns"_a, "of_basis"_a, "threads"_a = 1)
        .def("residuals", &Records::residuals, "psi"_a, "sign"_a, "folded"_a.none(), "z"_a, "t"_a, "threads"_a = 1);
    dashpot::bind_small_rigs(module);
    dashpot::bind_nonlinear_rigs(module);
    dashpot::bind_state_laws(module);
    module.def("line_shares", &line_shares, "information"_a, "inflation"_a, "bread"_a, "threads"_a = 1);
    module.def("instruction_sets", [] {
        std::vector<std::string> names;
        for (const dashpot::Loops *set : available()) names.push_back(set->name);
        return names;
    });
    module.def("instruction_set", [] { return std::string(chosen->name); });
    module.def("set_instructions", &set_instructions, "name"_a);
}
