// Whole records: sums over the lines of each, the loads and polynomials of their ends beside inputs that are known or
// estimated line by line.  Twin: dashpot.estimate.likelihood.record_passes, whose names these are.
#pragma once
#include "output.hpp"

namespace DASHPOT_SET {

constexpr double UNSEEN = 1e-12;  // squared, of an input's size: what other inputs leave of it is rounding
constexpr int FOLDED = 8;         // powers of s in what sampling folds back
constexpr int BLOCK = 2048;       // lines after which sums over lanes are put away

// (j s)^power as a real number, times j where the power is odd.
INLINE V signed_power(V s, int power) {
    if (power < 0) return -1.0 / s;
    V size = all(power % 4 < 2 ? 1.0 : -1.0);
    for (int k = 0; k < power; ++k) size *= s;
    return size;
}

INLINE C as_power(V size, int power) { return power % 2 ? C{V{}, size} : C{size, V{}}; }

struct RecordWork {
    const dashpot::Records *problem;
    OutputWork out;
    // Columns of a record and behind them the residual, (columns + 1, channels); slopes and the residual beside the
    // ends, (unknowns + 1, channels); whitened responses to inputs and their orthonormal basis, (inputs, channels).
    C *F, *rows, *white_G, *basis, *triangle, *share, *by_load, *scratch;
    V *products, *of_columns, *of_basis, *term, *folded_power;
    int *place;  // of a channel among the adjoints, -1: it shows inputs alone

    int f() const { return problem->columns; }
    int M() const { return problem->output->all; }
    int channels() const { return problem->output->channels; }
    int stride() const { return problem->output->rig->stride; }

    void lay(Arena &arena, const dashpot::Records &records) {
        problem = &records;
        const int Cs = channels(), n = records.output->rig->n, most = (f() > M() ? f() : M()) + 1;
        out.lay(arena, *records.output);
        const int nq = out.count_inputs();
        F = arena.take<C>((f() + 1) * Cs), rows = arena.take<C>((M() + 1) * Cs);
        white_G = arena.take<C>(nq * Cs), basis = arena.take<C>(nq * Cs), triangle = arena.take<C>(nq * nq);
        share = arena.take<C>(nq * (f() + 1)), by_load = arena.take<C>(Cs * n), scratch = arena.take<C>(Cs);
        products = arena.take<V>(most * most), of_columns = arena.take<V>(f() * most);
        of_basis = arena.take<V>(Cs * records.terms * most);
        term = arena.take<V>(records.terms), folded_power = arena.take<V>(FOLDED);
        place = arena.take<int>(Cs);
        if (!arena.base) return;
        for (int c = 0; c < Cs; ++c) place[c] = -1;
        for (int k = 0; k < out.seeing; ++k) place[out.seen[k]] = k;
    }

    C complex_at(const double *packed, long k, int at) const {
        return {load(packed + 2 * k * stride() + at), load(packed + (2 * k + 1) * stride() + at)};
    }
    // Which repeat of the data, and which set of weights, belongs to parameter set k.
    long of_data(long k) const { return problem->one ? 0 : k; }
    long of_weights(long k) const { return problem->shared ? 0 : k; }
    V sd(long k, int c, int at) const { return load(problem->sd + (of_weights(k) * channels() + c) * stride() + at); }
    C root(long k, int c, int d, int at) const {
        return complex_at(problem->root, (of_weights(k) * channels() + c) * channels() + d, at);
    }
    C known_input(long k, int j, int at) const {
        return complex_at(problem->q, of_data(k) * out.count_inputs() + j, at);
    }

    // `count` columns of channels, (count, channels), get unit noise.
    void whiten(C *values, int count, long k, int at) {
        const int Cs = channels();
        for (int j = 0; j < count; ++j) {
            C *column = values + j * Cs;
            if (problem->sd) {
                for (int c = 0; c < Cs; ++c) column[c] = column[c] * sd(k, c, at);
                continue;
            }
            for (int c = 0; c < Cs; ++c) {
                scratch[c] = zero();
                for (int d = 0; d < Cs; ++d) add(scratch[c], root(k, c, d, at), column[d]);
            }
            for (int c = 0; c < Cs; ++c) column[c] = scratch[c];
        }
    }

    C along(const C *direction, const C *values) const {
        C sum = zero();
        for (int c = 0; c < channels(); ++c) add_conj(sum, direction[c], values[c]);
        return sum;
    }
    void take_out(C *values, const C *direction, C part) const {
        for (int c = 0; c < channels(); ++c) subtract(values[c], part, direction[c]);
    }
    V together(const C *a, const C *b) const {
        V sum = V{};
        for (int c = 0; c < channels(); ++c) sum += dot(a[c], b[c]);
        return sum;
    }

    // The rig at some lines: adjoints and responses to inputs, and behind them to the loads where there are some.
    void respond(long k, const dashpot::RecordsAt &given, int at, int record) {
        const dashpot::Output &output = *problem->output;
        const int n = output.rig->n, nq = out.count_inputs(), first = out.seeing;
        stiffness(*output.rig, out.A, at, out.both);
        out.look(at);
        const bool loaded = given.z != nullptr;
        const double *z = loaded && record >= 0 ? given.z + (k * problem->records + record) * f() : nullptr;
        const V s = load(problem->s + at);
        const int count = out.sides_count = first + nq + loaded;
        for (int i = 0; i < n; ++i) {
            C *row = out.sides + i * count;
            for (int side = 0; side < first; ++side) row[side] = out.looks[out.seen[side] * n + i];
            for (int j = 0; j < nq; ++j) row[first + j] = out.push(i, j);
            if (loaded) row[first + nq] = z ? C{all(z[i]), s * z[n + i]} : zero();
        }
        out.solve(count);
        if (output.calibrated) out.calibrate(given.psi + k * M(), given.sign + k * channels(), at);
        out.respond_to_inputs(first, at);
        for (int c = 0; c < channels(); ++c)
            for (int i = 0; i < n; ++i) {
                const C shown = place[c] < 0 ? zero() : out.sides[i * count + place[c]];
                by_load[c * n + i] = output.calibrated ? out.kappa[c] * shown : shown;
            }
    }

    // Sums of powers of s with real coefficients (…, FOLDED).
    C folded_at(const double *coefficients) const {
        C sum = zero();
        for (int power = 0; power < FOLDED; power += 2) {
            sum.re += folded_power[power] * coefficients[power];
            sum.im += folded_power[power + 1] * coefficients[power + 1];
        }
        return sum;
    }

    // Columns of loads and polynomials of a record, whitened, in F.
    void columns(long k, const double *folded, int at, int record) {
        const int Cs = channels(), n = problem->output->rig->n, nq = out.count_inputs(), inputs = problem->of_inputs;
        const V s = load(problem->s + at);
        const bool loads = problem->loads[record];
        for (int c = 0; c < Cs; ++c)
            for (int i = 0; i < n; ++i) {
                const C shown = loads ? by_load[c * n + i] : zero();
                F[i * Cs + c] = shown;
                F[(n + i) * Cs + c] = {-shown.im * s, shown.re * s};
            }
        if (folded && loads)
            for (int c = 0; c < Cs; ++c)
                for (int i = 0; i < 2 * n; ++i) {
                    const double *of = folded + (((k * problem->records + record) * Cs + c) * 2 * n + i) * FOLDED;
                    F[i * Cs + c] = F[i * Cs + c] + folded_at(of);
                }
        for (int p = 0; p < inputs; ++p)
            for (int c = 0; c < Cs; ++c) {
                C sum = zero();
                for (int j = 0; j < nq; ++j)
                    add(sum, out.G[c * nq + j], complex_at(problem->by_input, j * inputs + p, at));
                F[(2 * n + p) * Cs + c] = sum;
            }
        whiten(F, 2 * n + inputs, k, at);
        for (int p = 0; p < problem->fitted; ++p) {
            const int d = problem->fitted_channel[p], power = problem->fitted_power[p];
            const C value = as_power(signed_power(s, power), power);
            for (int c = 0; c < Cs; ++c) {
                C shown = zero();
                if (problem->root) shown = root(k, c, d, at) * value;
                else if (c == d) shown = value * sd(k, c, at);
                F[(2 * n + inputs + p) * Cs + c] = shown;
            }
        }
        for (int j = 0; j < f(); ++j)
            if (!problem->used[record * f() + j]) leave_out(j);
    }

    // A column that the record at hand does not have.
    void leave_out(int j) {
        for (int c = 0; c < channels(); ++c) F[j * channels() + c] = zero();
    }

    // Directions of the inputs by Gram and Schmidt; an input that is not seen beside the others has none of its own.
    void find_inputs() {
        const int Cs = channels(), nq = out.count_inputs();
        for (int j = 0; j < nq; ++j) {
            C *left = basis + j * Cs;
            for (int c = 0; c < Cs; ++c) left[c] = white_G[j * Cs + c];
            for (int i = 0; i < j; ++i) {
                triangle[i * nq + j] = along(basis + i * Cs, left);
                take_out(left, basis + i * Cs, triangle[i * nq + j]);
            }
            const V square = together(left, left), whole = together(white_G + j * Cs, white_G + j * Cs);
            const Mask seen = square > UNSEEN * whole;
            const V size = square_root(seen ? square : all(1.0));
            for (int c = 0; c < Cs; ++c) left[c] = choose(seen, left[c] * (1.0 / size), zero());
            triangle[j * nq + j] = {seen ? size : V{}, V{}};
        }
    }

    // What estimated inputs explain of `count` columns is taken out of them; their shares are kept where asked.
    void without_inputs(C *values, int count, C *shares) {
        const int Cs = channels(), nq = out.count_inputs();
        for (int k = 0; k < count; ++k) {
            C *column = values + k * Cs;
            for (int i = 0; i < nq; ++i) out.onto[i] = along(basis + i * Cs, column);
            for (int i = 0; i < nq; ++i) take_out(column, basis + i * Cs, out.onto[i]);
            if (shares)
                for (int i = 0; i < nq; ++i) shares[i * count + k] = out.onto[i];
        }
    }

    // F: columns of the record and the residual of the rig without them, whitened, inputs taken out.
    void observe(long k, const dashpot::RecordsAt &given, int at, int record) {
        const int Cs = channels(), nq = out.count_inputs();
        const V s = load(problem->s + at);
        for (int p = 0; p < problem->terms; ++p) term[p] = signed_power(s, problem->powers[p]);
        if (given.folded)
            for (int power = 0; power < FOLDED; ++power) folded_power[power] = signed_power(s, power);
        respond(k, given, at, record);
        if (record >= 0) columns(k, given.folded, at, record);
        else
            for (int j = 0; j < f(); ++j) leave_out(j);
        C *residual = F + f() * Cs;
        for (int c = 0; c < Cs; ++c) residual[c] = complex_at(problem->y, of_data(k) * Cs + c, at);
        for (int j = 0; j < nq; ++j)
            for (int c = 0; c < Cs; ++c) white_G[j * Cs + c] = out.G[c * nq + j];
        if (problem->q) {
            for (int j = 0; j < nq; ++j) take_out(residual, white_G + j * Cs, known_input(k, j, at));
            whiten(residual, 1, k, at);
            return;
        }
        whiten(residual, 1, k, at);
        whiten(white_G, nq, k, at);
        find_inputs();
        without_inputs(F, f() + 1, share);
    }

    // Inputs under the loads z, line by line.
    void inputs(long k, const double *z, int at) {
        const int nq = out.count_inputs(), n = problem->output->rig->n, wide = f() + 1, of_inputs = problem->of_inputs;
        C *q = out.q;
        if (problem->q) {
            for (int j = 0; j < nq; ++j) {
                q[j] = known_input(k, j, at);
                for (int p = 0; z && p < of_inputs; ++p)
                    q[j] = q[j] + complex_at(problem->by_input, j * of_inputs + p, at) * z[2 * n + p];
            }
            return;
        }
        for (int j = nq - 1; j >= 0; --j) {
            C rest = share[j * wide + f()];
            for (int p = 0; z && p < f(); ++p) rest = rest - share[j * wide + p] * z[p];
            for (int i = j + 1; i < nq; ++i) subtract(rest, triangle[j * nq + i], q[i]);
            const V pivot = triangle[j * nq + j].re;
            q[j] = choose(pivot != 0, rest * (1.0 / (pivot != 0 ? pivot : all(1.0))), zero());
        }
    }

    // Takes what the ends add, with coefficients z (columns,) and t (channels, terms), out of a column of channels.
    void without_ends(C *column, const double *z, const double *t, int stride_z, int stride_t, long k, int at) {
        const int Cs = channels(), terms = problem->terms;
        for (int j = 0; j < f(); ++j)
            for (int c = 0; c < Cs; ++c) column[c] = column[c] - F[j * Cs + c] * z[j * stride_z];
        for (int c = 0; c < Cs && terms; ++c) {
            C sum = zero();
            for (int p = 0; p < terms; ++p)
                sum = sum + as_power(term[p], problem->powers[p]) * t[(c * terms + p) * stride_t];
            column[c] = column[c] - sum * sd(k, c, at);
        }
    }

    // rows: slopes under the whole motion and the residual beside its loads.
    void slopes(long k, const dashpot::RecordsAt &given, int at, int record) {
        const dashpot::Output &output = *problem->output;
        const int Cs = channels(), n = output.rig->n, m = output.rig->unknowns, nq = out.count_inputs();
        const int first = out.seeing;
        observe(k, given, at, record);
        const long owner = k * problem->records + record;
        const double *z = record >= 0 ? given.z + owner * f() : nullptr;
        inputs(k, z, at);
        const int sides = out.sides_count;
        for (int i = 0; i < n; ++i) {
            out.x[i] = out.sides[i * sides + first + nq];
            for (int j = 0; j < nq; ++j) add(out.x[i], out.sides[i * sides + first + j], out.q[j]);
        }
        if (output.gains || output.delays) {
            const V s = load(problem->s + at);
            for (int c = 0; c < Cs; ++c) {
                out.shown[c] = zero();
                for (int j = 0; j < nq; ++j) add(out.shown[c], out.G[c * nq + j], out.q[j]);
                for (int i = 0; z && i < n; ++i) add(out.shown[c], by_load[c * n + i], {all(z[i]), s * z[n + i]});
            }
        }
        out.slopes(given.psi + k * M(), at);
        for (int j = 0; j < M(); ++j)
            for (int c = 0; c < Cs; ++c) rows[j * Cs + c] = out.J[c * M() + j];
        if (given.folded_slopes && record >= 0 && problem->loads[record])
            for (int c = 0; c < Cs; ++c)
                for (int j = 0; j < m; ++j)
                    rows[j * Cs + c] =
                        rows[j * Cs + c] + folded_at(given.folded_slopes + ((owner * Cs + c) * m + j) * FOLDED);
        whiten(rows, M(), k, at);
        if (!problem->q) without_inputs(rows, M(), nullptr);
        C *residual = rows + M() * Cs;
        for (int c = 0; c < Cs; ++c) residual[c] = F[f() * Cs + c];
        if (z) without_ends(residual, z, given.t + owner * Cs * problem->terms, 1, 1, k, at);
    }

    // Products of `wide` columns with the powers of each channel, added to of_basis.
    void add_basis(const C *columns, int wide, long k, int at) {
        const int Cs = channels(), terms = problem->terms;
        for (int c = 0; c < Cs && terms; ++c) {
            const V weight = sd(k, c, at);
            for (int p = 0; p < terms; ++p) {
                const V power = term[p] * weight;
                V *sums = of_basis + (c * terms + p) * wide;
                const bool turned = problem->powers[p] % 2 != 0;
                for (int j = 0; j < wide; ++j)
                    sums[j] += power * (turned ? columns[j * Cs + c].im : columns[j * Cs + c].re);
            }
        }
    }

    static void put_away(V *sums, long count, double *to) {
        for (long k = 0; k < count; ++k) to[k] += total(sums[k]), sums[k] = V{};
    }

    // each(at, record) for all groups of lines, close(record) where their sums are to be put away.
    template <class Each, class Close> void over_lines(Each each, Close close) {
        for (int k = 0; k < problem->segments; ++k)
            for (int first = problem->start[k]; first < problem->start[k + 1]; first += BLOCK) {
                const int last = first + BLOCK < problem->start[k + 1] ? first + BLOCK : problem->start[k + 1];
                for (int at = first; at < last; at += LANES) each(at, problem->owner[k]);
                close(problem->owner[k]);
            }
    }

    void begin(long k, const dashpot::RecordsAt &given) {
        assemble(*problem->output->rig, given.psi + k * M(), out.p, out.A);
    }
};

// Symmetric sums that stand in their upper half.
static void mirror(double *sums, int wide) {
    for (int i = 0; i < wide; ++i)
        for (int j = 0; j < i; ++j) sums[i * wide + j] = sums[j * wide + i];
}

static unsigned long records_workspace(const dashpot::Records &problem) {
    Arena arena{nullptr, 0};
    RecordWork work;
    work.lay(arena, problem);
    return arena.used;
}

// First pass: products of columns and residual, (K, records, columns + 1, columns + 1), and those with the powers of
// each channel, (K, records, channels, terms, columns + 1).
static void records_columns(const dashpot::Records &problem, const dashpot::RecordsAt &given, long from, long to,
                            double *columns, double *basis, char *memory) {
    Arena arena{memory, 0};
    RecordWork work;
    work.lay(arena, problem);
    const int f = problem.columns, wide = f + 1, Cs = work.channels();
    const long of_basis = 1l * Cs * problem.terms * wide;
    for (int k = 0; k < wide * wide; ++k) work.products[k] = V{};
    for (long k = 0; k < of_basis; ++k) work.of_basis[k] = V{};
    for (long k = from; k < to; ++k) {
        work.begin(k, given);
        work.over_lines(
            [&](int at, int record) {
                if (record < 0) return;
                work.observe(k, given, at, record);
                for (int i = 0; i < f; ++i)
                    for (int j = i; j < wide; ++j)
                        work.products[i * wide + j] += work.together(work.F + i * Cs, work.F + j * Cs);
                work.add_basis(work.F, wide, k, at);
            },
            [&](int record) {
                if (record < 0) return;
                const long owner = k * problem.records + record;
                RecordWork::put_away(work.products, wide * wide, columns + owner * wide * wide);
                RecordWork::put_away(work.of_basis, of_basis, basis + owner * of_basis);
            });
        for (int record = 0; record < problem.records; ++record)
            mirror(columns + (k * problem.records + record) * wide * wide, wide);
    }
}

// Second pass: products of slopes and residual with each other, (K, M + 1, M + 1), with the columns, (K, records,
// columns, M + 1), and with the powers, (K, records, channels, terms, M + 1).
static void records_slopes(const dashpot::Records &problem, const dashpot::RecordsAt &given, long from, long to,
                           double *products, double *columns, double *basis, char *memory) {
    Arena arena{memory, 0};
    RecordWork work;
    work.lay(arena, problem);
    const int f = problem.columns, wide = work.M() + 1, Cs = work.channels();
    const long of_basis = 1l * Cs * problem.terms * wide;
    for (int k = 0; k < wide * wide; ++k) work.products[k] = V{};
    for (int k = 0; k < f * wide; ++k) work.of_columns[k] = V{};
    for (long k = 0; k < of_basis; ++k) work.of_basis[k] = V{};
    for (long k = from; k < to; ++k) {
        work.begin(k, given);
        work.over_lines(
            [&](int at, int record) {
                work.slopes(k, given, at, record);
                for (int i = 0; i < wide; ++i)
                    for (int j = i; j < wide; ++j)
                        work.products[i * wide + j] += work.together(work.rows + i * Cs, work.rows + j * Cs);
                if (record < 0) return;
                for (int i = 0; i < f; ++i)
                    for (int j = 0; j < wide; ++j)
                        work.of_columns[i * wide + j] += work.together(work.F + i * Cs, work.rows + j * Cs);
                work.add_basis(work.rows, wide, k, at);
            },
            [&](int record) {
                RecordWork::put_away(work.products, wide * wide, products + k * wide * wide);
                if (record < 0) return;
                const long owner = k * problem.records + record;
                RecordWork::put_away(work.of_columns, f * wide, columns + owner * f * wide);
                RecordWork::put_away(work.of_basis, of_basis, basis + owner * of_basis);
            });
        mirror(products + k * wide * wide, wide);
    }
}

// Products of each line with what the ends explain of slopes and residual taken out: z (K, records, columns, M + 1),
// t (K, records, channels, terms, M + 1).
static void records_lines(const dashpot::Records &problem, const dashpot::RecordsAt &given, const double *z,
                          const double *t, long from, long to, double *information, double *scores, double *cost,
                          char *memory) {
    Arena arena{memory, 0};
    RecordWork work;
    work.lay(arena, problem);
    const int f = problem.columns, M = work.M(), wide = M + 1, Cs = work.channels();
    for (long k = from; k < to; ++k) {
        work.begin(k, given);
        work.over_lines(
            [&](int at, int record) {
                work.slopes(k, given, at, record);
                const long owner = k * problem.records + record;
                for (int j = 0; j < wide && record >= 0; ++j)
                    work.without_ends(work.rows + j * Cs, z + owner * f * wide + j,
                                      t + owner * Cs * problem.terms * wide + j, wide, wide, k, at);
                for (int i = 0; i < wide; ++i)
                    for (int j = i; j < wide; ++j)
                        work.products[i * wide + j] = 2.0 * work.together(work.rows + i * Cs, work.rows + j * Cs);
                for (int lane = 0; lane < LANES; ++lane) {
                    if (problem.line[at + lane] < 0) continue;
                    const long line = k * problem.lines + problem.line[at + lane];
                    cost[line] = work.products[M * wide + M][lane];
                    for (int i = 0; i < M; ++i) {
                        scores[line * M + i] = work.products[i * wide + M][lane];
                        for (int j = i; j < M; ++j)
                            information[(line * M + i) * M + j] = information[(line * M + j) * M + i] =
                                work.products[i * wide + j][lane];
                    }
                }
            },
            [](int) {});
    }
}

// Whitened residuals of the whole motion, (K, lines, channels, 2).
static void records_residuals(const dashpot::Records &problem, const dashpot::RecordsAt &given, long from, long to,
                              double *residuals, char *memory) {
    Arena arena{memory, 0};
    RecordWork work;
    work.lay(arena, problem);
    const int f = problem.columns, Cs = work.channels();
    for (long k = from; k < to; ++k) {
        work.begin(k, given);
        work.over_lines(
            [&](int at, int record) {
                work.observe(k, given, at, record);
                const long owner = k * problem.records + record;
                C *left = work.F + f * Cs;
                if (record >= 0)
                    work.without_ends(left, given.z + owner * f, given.t + owner * Cs * problem.terms, 1, 1, k, at);
                for (int lane = 0; lane < LANES; ++lane) {
                    if (problem.line[at + lane] < 0) continue;
                    double *to_line = residuals + 2 * (k * problem.lines + problem.line[at + lane]) * Cs;
                    for (int c = 0; c < Cs; ++c)
                        to_line[2 * c] = left[c].re[lane], to_line[2 * c + 1] = left[c].im[lane];
                }
            },
            [](int) {});
    }
}

}  // namespace DASHPOT_SET
