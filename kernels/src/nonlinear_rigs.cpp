// Rigs with nonlinear elements: arrays in, arrays out, for harmonic balance.
#include <cmath>
#include <optional>

#include <nanobind/stl/optional.h>

#include "arrays.hpp"
#include "problem.hpp"
#include "programs.hpp"
#include "threads.hpp"

namespace dashpot {

namespace {

using namespace nb::literals;

using MaybeComplex = std::optional<Complexes>;

// Elements and laws of one rig; the dwells come with each call.
struct CompiledRig {
    NonlinearRig rig{};
    std::vector<double> B, D, S, cell_value;
    std::vector<int> chosen, constant_start, cell_element, cell_place;
    OwnPrograms laws;

    // B (elements, n), D (elements, r), S (n, s); chosen (e,) the nonlinear elements; constant_start and step_start
    // (e + 1,), where the constants and the steps of their laws begin; code, which, number (steps,).
    CompiledRig(Reals B_, Reals D_, Reals S_, Integers chosen_, Integers constants, Integers starts, Integers code,
                Integers which, Reals number) {
        require(B_.ndim() == 2 && D_.ndim() == 2 && S_.ndim() == 2 && B_.shape(0) == D_.shape(0) &&
                    S_.shape(0) == B_.shape(1) && chosen_.size() > 0 && constants.size() == chosen_.size() + 1 &&
                    starts.size() == chosen_.size() + 1,
                "arrays of a rig have different sizes");
        laws.take(starts, code, which, number);
        const auto copied = [](const auto &from, auto &to) { to.assign(from.data(), from.data() + from.size()); };
        copied(B_, B), copied(D_, D), copied(S_, S), copied(chosen_, chosen);
        copied(constants, constant_start);
        rig.elements = static_cast<int>(B_.shape(0)), rig.n = static_cast<int>(B_.shape(1));
        rig.r = static_cast<int>(D_.shape(1)), rig.s = static_cast<int>(S_.shape(1));
        rig.bent = static_cast<int>(chosen.size()), rig.constants = constant_start.back();
        for (int element : chosen) require(element >= 0 && element < rig.elements, "there is no such element");
        for (int i = 0; i < rig.bent; ++i) laws.measure(i, 2 + constant_start[i + 1] - constant_start[i]);
        find_cells();
        rig.B = B.data(), rig.D = D.data(), rig.S = S.data(), rig.chosen = chosen.data();
        rig.constant_start = constant_start.data(), rig.laws = laws.view();
        rig.cells = static_cast<int>(cell_value.size());
        rig.cell_element = cell_element.data(), rig.cell_place = cell_place.data(), rig.cell_value = cell_value.data();
    }

    void find_cells() {
        const int width = rig.n + rig.r;
        for (int e = 0; e < rig.elements; ++e)
            for (int x = 0; x < rig.n; ++x)
                for (int y = 0; y < width; ++y) {
                    const double value =
                        B[e * rig.n + x] * (y < rig.n ? B[e * rig.n + y] : D[e * rig.r + y - rig.n]);
                    const bool linear = std::find(chosen.begin(), chosen.end(), e) == chosen.end();
                    if (value != 0 && linear)
                        cell_element.push_back(e), cell_place.push_back(x * width + y), cell_value.push_back(value);
                }
    }

    Dwells dwells(const Reals &p, const Reals &constants, const Reals &omega, const Complexes &factors,
                  const Complexes &U, const Complexes &f, int times) const {
        require(p.ndim() == 2 && factors.ndim() == 3 && U.ndim() == 3 && f.ndim() == 3, "dwells come in rows");
        const size_t N = p.shape(0), lines = factors.shape(1);
        require(p.shape(1) == B.size() / rig.n && constants.size() == N * rig.constants && omega.size() == N &&
                    factors.shape(0) == N && factors.shape(2) == p.shape(1) && U.shape(0) == N && U.shape(1) == lines &&
                    U.shape(2) == static_cast<size_t>(rig.r) && f.shape(0) == N && f.shape(1) == lines &&
                    f.shape(2) == static_cast<size_t>(rig.s),
                "arrays of dwells have different sizes");
        require(lines >= 2 && times >= 8 && times % 8 == 0, "a period has a fundamental and a multiple of 8 instants");
        Dwells given = {static_cast<int>(N), static_cast<int>(lines) - 1, times, p.data(), constants.data(),
                        omega.data(), numbers(factors), numbers(U), numbers(f), false};
        for (size_t k = 0; k < N; ++k)
            for (int element : chosen) given.feeds_back = given.feeds_back || p.data()[k * rig.elements + element] != 0;
        return given;
    }

    nb::ndarray<nb::numpy, double> unit_forces(Reals constants, Reals omega, Reals q, int times, int threads) const {
        require(q.ndim() == 3 && q.shape(1) == chosen.size() && q.shape(2) >= 3 && q.shape(2) % 2 == 1 &&
                    omega.size() == q.shape(0) && constants.size() == q.shape(0) * rig.constants && times >= 8 &&
                    times % 8 == 0,
                "elongations have another size");
        Dwells given{};
        given.count = static_cast<int>(q.shape(0)), given.orders = static_cast<int>(q.shape(2)) / 2, given.times = times;
        given.constants = constants.data(), given.omega = omega.data();
        auto a = array({q.shape(0), q.shape(1), q.shape(2)});
        {
            nb::gil_scoped_release released;
            share(given.count, threads, loops().balance_workspace(rig, given, 0), [&](long from, long to, char *place) {
                loops().balance_forces(rig, given, q.data(), from, to, a.data, place);
            });
        }
        return a.array;
    }

    nb::ndarray<nb::numpy, double> linear_start(Reals p, Reals constants, Reals omega, Complexes factors, Complexes U,
                                                Complexes f, int times, int threads) const {
        const Dwells given = dwells(p, constants, omega, factors, U, f, times);
        auto q = array({p.shape(0), chosen.size(), static_cast<size_t>(2 * given.orders + 1)});
        {
            nb::gil_scoped_release released;
            share(given.count, threads, loops().balance_workspace(rig, given, 0), [&](long from, long to, char *place) {
                loops().balance_linear_start(rig, given, from, to, q.data, place);
            });
        }
        return q.array;
    }

    nb::tuple solve(Reals p, Reals constants, Reals omega, Complexes factors, Complexes U, Complexes f, Reals start,
                    int times, std::optional<Flags> hopeless, int threads) const {
        const Dwells given = dwells(p, constants, omega, factors, U, f, times);
        const size_t N = p.shape(0), H = given.orders + 1, e = chosen.size(), W = 2 * H - 1, n = rig.n;
        require(start.size() == N * e * W && (!hopeless || hopeless->size() == N), "a start has another size");
        auto inverse = array<std::complex<double>>({N, H, n, n}), receptance = array<std::complex<double>>({N, H, e, e});
        auto shares = array<std::complex<double>>({N, H, e}), driven = array<std::complex<double>>({N, H, n});
        auto free = array<std::complex<double>>({N, H, e});
        auto free_real = array({N, e, W}), q = array({N, e, W}), a = array({N, e, W}), slope = array({N, e, W, W});
        auto by_constant = array({N, W, static_cast<size_t>(rig.constants)}), error = array({N});
        std::copy(start.data(), start.data() + start.size(), q.data);
        const auto of = [](auto &array) { return reinterpret_cast<double *>(array.data); };
        const BalanceAt out = {of(inverse), of(receptance), of(shares), of(driven), of(free), free_real.data,
                               q.data,      a.data,         slope.data, by_constant.data, error.data};
        const auto *lost = hopeless ? reinterpret_cast<const unsigned char *>(hopeless->data()) : nullptr;
        {
            nb::gil_scoped_release released;
            share(given.count, threads, loops().balance_workspace(rig, given, 0), [&](long from, long to, char *place) {
                loops().balance_solve(rig, given, lost, from, to, out, place);
            });
        }
        return nb::make_tuple(inverse.array, receptance.array, shares.array, driven.array, free.array, free_real.array,
                              q.array, a.array, slope.array, by_constant.array, error.array);
    }

    nb::tuple slopes(Reals p, Reals constants, Reals omega, Complexes factors, Complexes U, Complexes f,
                     Complexes inverse, Complexes receptance, Complexes shares, Reals slope, Reals by_constant,
                     Complexes a, Reals along_p, Reals along_constants, MaybeComplex along_U, MaybeComplex along_f,
                     int threads) const {
        const Dwells given = dwells(p, constants, omega, factors, U, f, 8);
        const size_t N = p.shape(0), H = given.orders + 1, e = chosen.size(), W = 2 * H - 1, n = rig.n;
        const size_t E = rig.elements, Q = along_p.ndim() == 2 ? along_p.shape(1) : 0;
        require(Q > 0 && along_p.shape(0) == E && along_constants.size() == rig.constants * Q, "directions differ");
        require(inverse.size() == N * H * n * n && receptance.size() == N * H * e * e && shares.size() == N * H * e &&
                    slope.size() == N * e * W * W && by_constant.size() == N * W * rig.constants && a.size() == N * H * E,
                "arrays of a response have different sizes");
        bool same = false;
        for (const auto &[along, width] : {std::pair{&along_U, rig.r}, std::pair{&along_f, rig.s}}) {
            if (!*along) continue;
            const size_t whole = H * width * Q;
            require((*along)->size() == whole || (*along)->size() == N * whole, "directions of inputs differ");
        }
        require(along_U.has_value() == along_f.has_value(), "directions go along all inputs or none");
        if (along_U) same = along_U->shape(0) == 1 && along_f->shape(0) == 1;
        require(!along_U || same || (along_U->shape(0) == N && along_f->shape(0) == N), "directions of inputs differ");
        auto dX = array<std::complex<double>>({N, H, n, Q}), d_forces = array<std::complex<double>>({N, H, E, Q});
        auto d_delta = array({N, e, W, Q});
        const auto in = [](const auto &array) { return const_cast<double *>(reinterpret_cast<const double *>(array.data())); };
        const BalanceAt at = {in(inverse), in(receptance), in(shares), nullptr,   nullptr,        nullptr,
                              nullptr,     nullptr,        in(slope),  in(by_constant), nullptr};
        const Directions along = {static_cast<int>(Q), along_p.data(), along_constants.data(),
                                  along_U ? numbers(*along_U) : nullptr, along_f ? numbers(*along_f) : nullptr, same,
                                  numbers(a), reinterpret_cast<double *>(dX.data),
                                  reinterpret_cast<double *>(d_forces.data), d_delta.data};
        {
            nb::gil_scoped_release released;
            const int count = static_cast<int>(Q);
            share(given.count, threads, loops().balance_workspace(rig, given, count), [&](long from, long to, char *place) {
                loops().balance_slopes(rig, given, at, along, from, to, place);
            });
        }
        return nb::make_tuple(dX.array, d_forces.array, d_delta.array);
    }

    // p (K, elements), constants (K, …), omega (R,), factors (R, H + 1, elements), q (K, lines, r + s); dwell and order
    // (lines,); along_U and along_f (R, H + 1, …, Q).  What the channels show, its slopes, δ, its slopes, errors.
    nb::tuple lines(Reals p, Reals constants, Reals omega, Complexes factors, Complexes q, std::optional<Reals> start,
                    int times, Reals along_p, Reals along_constants, MaybeComplex along_U, MaybeComplex along_f,
                    Integers dwell, Integers order, Complexes rates, Reals on_x, Reals on_q, Reals force,
                    int threads) const {
        require(p.ndim() == 2 && factors.ndim() == 3 && q.ndim() == 3 && along_p.ndim() == 2 && rates.ndim() == 2,
                "lines have other axes");
        const size_t K = p.shape(0), R = omega.size(), H = factors.shape(1), L = q.shape(1), C = rates.shape(1);
        const size_t E = rig.elements, e = chosen.size(), W = 2 * H - 1, Q = along_p.shape(1), n = rig.n;
        const size_t r = rig.r, s = rig.s, G = rig.constants;
        require(p.shape(1) == E && constants.size() == K * G && factors.shape(0) == R && factors.shape(2) == E &&
                    q.shape(0) == K && q.shape(2) == r + s && (!start || start->size() == K * R * e * W) &&
                    along_p.shape(0) == E && along_constants.size() == G * Q && dwell.size() == L &&
                    order.size() == L && rates.shape(0) == L && on_x.size() == C * n && on_q.size() == C * (r + s) &&
                    force.size() == C * E && along_U.has_value() == along_f.has_value() &&
                    (!along_U || (along_U->size() == R * H * r * Q && along_f->size() == R * H * s * Q)),
                "arrays of lines have different sizes");
        require(Q > 0 && H >= 2 && times >= 8 && times % 8 == 0, "a period has a fundamental and a multiple of 8 instants");
        std::vector<int> first(R + 1, 0), line(L), orders(L);
        for (size_t l = 0; l < L; ++l) {
            require(dwell.data()[l] >= 0 && dwell.data()[l] < static_cast<int64_t>(R) && order.data()[l] >= 0 &&
                        order.data()[l] < static_cast<int64_t>(H),
                    "a line has no such dwell or order");
            ++first[dwell.data()[l] + 1];
        }
        for (size_t k = 0; k < R; ++k) first[k + 1] += first[k];
        std::vector<int> next(first.begin(), first.end() - 1);
        for (size_t l = 0; l < L; ++l) {
            const int place = next[dwell.data()[l]]++;
            line[place] = static_cast<int>(l), orders[place] = static_cast<int>(order.data()[l]);
        }
        Dwells given = {static_cast<int>(K * R), static_cast<int>(H) - 1, times, p.data(), constants.data(),
                        omega.data(), numbers(factors), nullptr, nullptr, false};
        for (size_t k = 0; k < K; ++k)
            for (int element : chosen) given.feeds_back = given.feeds_back || p.data()[k * E + element] != 0;
        auto shown = array<std::complex<double>>({K, L, C}), slopes = array<std::complex<double>>({K, L, C, Q});
        auto delta = array({K * R, e, W}), d_delta = array({K * R, e, W, Q}), error = array({K * R});
        const auto maybe = [](const MaybeComplex &array) { return array ? numbers(*array) : nullptr; };
        const NonlinearLines asked = {
            static_cast<int>(L), static_cast<int>(R), static_cast<int>(C), static_cast<int>(Q), first.data(),
            line.data(), orders.data(), numbers(rates), on_x.data(), on_q.data(), force.data(), numbers(q),
            start ? start->data() : nullptr, along_p.data(), along_constants.data(), maybe(along_U), maybe(along_f),
            reinterpret_cast<double *>(shown.data), reinterpret_cast<double *>(slopes.data), delta.data, d_delta.data,
            error.data};
        {
            nb::gil_scoped_release released;
            const unsigned long space = loops().balance_workspace(rig, given, static_cast<int>(Q));
            share(given.count, threads, space, [&](long from, long to, char *place) {
                loops().balance_lines(rig, given, asked, from, to, place);
            });
        }
        return nb::make_tuple(shown.array, slopes.array, delta.array, d_delta.array, error.array);
    }
};

}  // namespace

void bind_nonlinear_rigs(nb::module_ &module) {
    nb::class_<CompiledRig>(module, "NonlinearRig", "A rig with nonlinear elements, for harmonic balance of its dwells.")
        .def(nb::init<Reals, Reals, Reals, Integers, Integers, Integers, Integers, Integers, Reals>(), "B"_a, "D"_a,
             "S"_a, "chosen"_a, "constant_start"_a, "step_start"_a, "code"_a, "which"_a, "number"_a)
        .def("unit_forces", &CompiledRig::unit_forces, "constants"_a, "omega"_a, "q"_a, "times"_a, "threads"_a = 1)
        .def("linear_start", &CompiledRig::linear_start, "p"_a, "constants"_a, "omega"_a, "factors"_a, "U"_a, "f"_a,
             "times"_a, "threads"_a = 1)
        .def("solve", &CompiledRig::solve, "p"_a, "constants"_a, "omega"_a, "factors"_a, "U"_a, "f"_a, "start"_a,
             "times"_a, "hopeless"_a.none(), "threads"_a = 1)
        .def("slopes", &CompiledRig::slopes, "p"_a, "constants"_a, "omega"_a, "factors"_a, "U"_a, "f"_a, "inverse"_a,
             "receptance"_a, "share"_a, "slope"_a, "by_constant"_a, "a"_a, "along_p"_a, "along_constants"_a,
             "along_U"_a.none(), "along_f"_a.none(), "threads"_a = 1)
        .def("lines", &CompiledRig::lines, "p"_a, "constants"_a, "omega"_a, "factors"_a, "q"_a, "start"_a.none(),
             "times"_a, "along_p"_a, "along_constants"_a, "along_U"_a.none(), "along_f"_a.none(), "dwell"_a, "order"_a,
             "rates"_a, "on_x"_a, "on_q"_a, "force"_a, "threads"_a = 1);
}

}  // namespace dashpot
