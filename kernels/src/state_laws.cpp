// Laws with a state and motions in time: arrays in, arrays out.
#include <optional>

#include <nanobind/stl/optional.h>

#include "arrays.hpp"
#include "problem.hpp"
#include "programs.hpp"
#include "threads.hpp"

namespace dashpot {

namespace {

using namespace nb::literals;

using MaybeReals = std::optional<Reals>;

struct CompiledLaws {
    StateLaws laws{};
    std::vector<int> constant_start;
    std::vector<Operator> operators;
    OwnPrograms programs;

    // constants (e + 1,), where those of each law begin; operated (e,): 0, 1 for stop, 2 for play; starts (2 e + 1,),
    // where the steps of the unit forces and then of the rates begin; code, which, number (steps,).
    CompiledLaws(Integers constants, Integers operated, Integers starts, Integers code, Integers which, Reals number) {
        const size_t e = operated.size();
        require(e > 0 && constants.size() == e + 1 && starts.size() == 2 * e + 1, "arrays of laws have different sizes");
        programs.take(starts, code, which, number);
        constant_start.assign(constants.data(), constants.data() + e + 1);
        laws.count = static_cast<int>(e);
        laws.constant_start = constant_start.data();
        for (size_t i = 0; i < e; ++i) {
            require(operated.data()[i] >= 0 && operated.data()[i] <= 2, "there is no such operator");
            operators.push_back(static_cast<Operator>(operated.data()[i]));
        }
        laws.operated = operators.data();
        for (int i = 0; i < laws.count; ++i) {
            const int own = laws.constants(i);
            programs.measure(i, 3 + own);
            const bool rated = programs.start[laws.count + i] < programs.start[laws.count + i + 1];
            if (rated) programs.measure(laws.count + i, 3 + own);
            require(operators[i] == Operator::NONE || (own > 0 && !rated), "an operator has a width and no rate");
        }
        laws.programs = programs.view();
    }
    void require_rated(int law) const { require(law >= 0 && law < laws.count && laws.rated(law), "there is no such rate"); }

    // d, v (N, times), constants (N, …), omega (N,), there and rate (times, W), start as d: state, force, slopes.
    nb::tuple settled(int law, Reals d, Reals v, Reals constants, Reals omega, Reals there, Reals rate, bool slopes,
                      MaybeReals start, int threads) const {
        require_rated(law);
        require(d.ndim() == 2 && there.ndim() == 2, "dwells come in rows");
        const size_t N = d.shape(0), times = d.shape(1), W = there.shape(1), G = laws.constants(law);
        require(v.size() == N * times && constants.size() == N * G && omega.size() == N && there.shape(0) == times &&
                    rate.size() == times * W && (!start || start->size() == N * times) && times > 1,
                "arrays of dwells have different sizes");
        auto z = array({N, times}), force = array({N, times}), along = array({slopes ? N : 0, times, W + G});
        if (start) std::copy(start->data(), start->data() + N * times, z.data);
        const SettledStates at = {law, static_cast<int>(times), static_cast<int>(W), d.data(), v.data(), constants.data(),
                                  omega.data(), there.data(), rate.data(), z.data, force.data, slopes ? along.data : nullptr};
        {
            nb::gil_scoped_release released;
            share(static_cast<long>(N), threads, loops().settled_workspace(laws, at), [&](long from, long to, char *place) {
                loops().settled_states(laws, at, from, to, place);
            });
        }
        return nb::make_tuple(z.array, force.array, along.array);
    }

    // d, v (samples,), constants (…,): the state, (samples,).
    nb::ndarray<nb::numpy, double> history(int law, Reals d, Reals v, Reals constants, double step) const {
        require_rated(law);
        const size_t N = d.size(), padded = (N + 7) / 8 * 8;
        require(N > 0 && v.size() == N && constants.size() == static_cast<size_t>(laws.constants(law)),
                "arrays of a history have different sizes");
        auto z = array({N});
        {
            nb::gil_scoped_release released;
            Memory<double> copies = memory<double>(3 * padded);
            std::fill(copies.get(), copies.get() + 3 * padded, 0.0);
            double *own_d = copies.get(), *own_v = own_d + padded, *own_z = own_v + padded;
            std::copy(d.data(), d.data() + N, own_d), std::copy(v.data(), v.data() + N, own_v);
            Memory<char> work = memory<char>(loops().history_workspace(laws, static_cast<int>(N)));
            loops().state_history(laws, law, own_d, own_v, constants.data(), step, static_cast<int>(N), own_z, work.get());
            std::copy(own_z, own_z + N, z.data);
        }
        return z.array;
    }

    // As dashpot.model.nonlinear.integration hands them over: states (samples, S, x), slopes (samples or 1, S, x, Q),
    // unit forces (steps, S, 4, e) and states of laws (steps, S, 4, z).
    nb::tuple follow(double h, Reals within, Reals grown, Reals driven, Reals pulled, Reals reach_d, Reals reach_v,
                     Reals offset_moved, Reals forced, Reals moved_d, Reals moved_v, Reals force, Reals inputs, Reals B,
                     Reals D, Reals T, Reals p, Reals constants, Reals by_unknowns, Reals K, Reals C, Reals inertia,
                     Integers power, Integers chosen, Integers first, Reals begun, int steps, int substeps, int columns,
                     bool whole, MaybeReals guess_a, MaybeReals guess_z) const {
        require(B.ndim() == 2 && D.ndim() == 2 && T.ndim() == 2 && begun.ndim() == 2 && offset_moved.ndim() == 3 &&
                    forced.ndim() == 3,
                "arrays of a motion have other axes");
        const size_t E = B.shape(0), n = B.shape(1), r = D.shape(1), m = T.shape(1), o = offset_moved.shape(2);
        const size_t S = begun.shape(0), x = begun.shape(1), e = laws.count, all = forced.shape(0), G = constants.size();
        size_t z = 0;
        for (int i = 0; i < laws.count; ++i) z += laws.stateful(i);
        require(within.size() == 16 && grown.size() == 16 * n * n && driven.size() == 32 * n * n &&
                    pulled.size() == 32 * n * e && reach_d.size() == 16 * e * e && reach_v.size() == 16 * e * e &&
                    offset_moved.size() == 8 * n * o && forced.size() == 8 * n * all && moved_d.size() == 4 * e * all &&
                    moved_v.size() == 4 * e * all && force.size() == 4 * n * all && inputs.size() == 8 * r * all &&
                    D.shape(0) == E && T.shape(0) == E && p.size() == E && by_unknowns.size() == G * m &&
                    G == static_cast<size_t>(constant_start.back()) && K.size() == n * n && C.size() == n * n &&
                    inertia.size() == n * n && power.size() == E && chosen.size() == e && first.size() == S && all > 0,
                "arrays of a motion have different sizes");
        require(x == 2 * n + z && steps > 0 && substeps > 0 && steps % substeps == 0, "states or steps do not suit the rig");
        const size_t N = steps, samples = N / substeps + 1, Q = columns;
        require(columns >= 0 && (Q == 0 || Q == x || Q == x + m + o), "slopes have other columns");
        require((!guess_a || guess_a->size() == N * S * 4 * e) && (!guess_z || guess_z->size() == N * S * 4 * z) &&
                    guess_a.has_value() == guess_z.has_value(),
                "forces to begin with have another size");
        for (size_t s = 0; s < S; ++s) require(first.data()[s] >= 0, "there is no such step");
        std::vector<int> powers(power.data(), power.data() + E), bent(chosen.data(), chosen.data() + e);
        for (int element : bent) require(element >= 0 && element < static_cast<int>(E), "there is no such element");
        auto state = array({samples, S, x}), slopes = array({whole ? samples : 1, S, x, Q});
        auto a = array({N, S, 4, e}), held = array({N, S, 4, z});
        const SegmentedMotion at = {
            static_cast<int>(n), static_cast<int>(r), static_cast<int>(E), static_cast<int>(m), static_cast<int>(o),
            static_cast<int>(x), static_cast<int>(S), steps, substeps, columns, h, within.data(), grown.data(),
            driven.data(), pulled.data(), reach_d.data(), reach_v.data(), offset_moved.data(), forced.data(),
            moved_d.data(), moved_v.data(), force.data(), inputs.data(), B.data(), D.data(), T.data(), p.data(),
            constants.data(), by_unknowns.data(), K.data(), C.data(), inertia.data(), powers.data(), bent.data(),
            reinterpret_cast<const long long *>(first.data()), static_cast<long long>(all) - 1, begun.data(),
            guess_a ? guess_a->data() : nullptr, guess_z ? guess_z->data() : nullptr, state.data, slopes.data, a.data,
            held.data, whole};
        {
            nb::gil_scoped_release released;
            Memory<char> work = memory<char>(loops().motion_workspace(laws, at));
            loops().follow_motion(laws, at, work.get());
        }
        return nb::make_tuple(state.array, slopes.array, a.array, held.array);
    }
};

}  // namespace

void bind_state_laws(nb::module_ &module) {
    nb::class_<CompiledLaws>(module, "StateLaws", "Laws of a rig, some with a state, in dwells and along records.")
        .def(nb::init<Integers, Integers, Integers, Integers, Integers, Reals>(), "constant_start"_a, "operated"_a,
             "step_start"_a, "code"_a, "which"_a, "number"_a)
        .def("settled", &CompiledLaws::settled, "law"_a, "d"_a, "v"_a, "constants"_a, "omega"_a, "there"_a, "rate"_a,
             "slopes"_a, "start"_a.none(), "threads"_a = 1)
        .def("history", &CompiledLaws::history, "law"_a, "d"_a, "v"_a, "constants"_a, "step"_a)
        .def("follow", &CompiledLaws::follow, "h"_a, "within"_a, "grown"_a, "driven"_a, "pulled"_a, "reach_d"_a,
             "reach_v"_a, "offset_moved"_a, "forced"_a, "moved_d"_a, "moved_v"_a, "force"_a, "inputs"_a, "B"_a, "D"_a,
             "T"_a, "p"_a, "constants"_a, "by_unknowns"_a, "K"_a, "C"_a, "inertia"_a, "power"_a, "chosen"_a, "first"_a,
             "begun"_a, "steps"_a, "substeps"_a, "columns"_a, "whole"_a, "guess_a"_a.none(), "guess_z"_a.none());
}

}  // namespace dashpot
