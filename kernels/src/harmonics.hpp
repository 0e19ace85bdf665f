// Sums of samples against sines and cosines, one pass: values (N, channels) at even times, any number of frequencies.
#pragma once
#include "lanes.hpp"

namespace DASHPOT_SET {

constexpr int STEPS = 512;  // groups of LANES samples whose waves come from one table, turned as a whole to their place
constexpr int TOGETHER = 2;  // frequencies that are summed in one sweep
constexpr int MOST_CHANNELS = 64;
constexpr int AHEAD = 512;  // numbers, that are fetched while these are summed

struct Turn {
    double re, im;
};

INLINE Turn turn_of(double cycles) {
    cycles -= __builtin_floor(cycles);
    return {__builtin_cos(6.283185307179586476925 * cycles), __builtin_sin(6.283185307179586476925 * cycles)};
}

INLINE Turn times(Turn a, Turn b) { return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; }

// Waves of the first group of a block, (STEPS, count): each power of two of them is the last ones turned on.
static void tabulate(const double *turns, int count, Turn *table) {
    for (int f = 0; f < count; ++f) {
        table[f] = {1, 0};
        for (int known = 1; known < STEPS; known *= 2) {
            const Turn on = turn_of(turns[f] * LANES * known);
            for (int g = 0; g < known; ++g) table[(known + g) * count + f] = times(table[g * count + f], on);
        }
    }
}

// Vectors of a group whose lanes hold different channels; 0 where the number of channels says it.
constexpr int kinds(int channels) { return channels && LANES % channels == 0 ? 1 : channels; }

// Of `groups` groups at `here`: sums of y times the waves of `table`, (FREQUENCIES, vectors) as real and imaginary
// parts.  With `trend` also sums of y and of their partial sums, and the largest |y|, by kinds of vectors.
template <int CHANNELS, int FREQUENCIES, bool trend>
static inline void sweep(const double *here, long groups, int channels, const Turn *table, C *waves, V *mean,
                         V *partial, V *most) {
    const int vectors = CHANNELS ? CHANNELS : channels;
    constexpr int HELD = CHANNELS ? CHANNELS : MOST_CHANNELS;
    C sum[FREQUENCIES][HELD];
    constexpr int KINDS = kinds(CHANNELS);
    V total[HELD], sums[HELD], largest[KINDS ? KINDS : MOST_CHANNELS];
    for (int v = 0; v < vectors; ++v) {
        for (int f = 0; f < FREQUENCIES; ++f) sum[f][v] = zero();
        if (trend) total[v] = sums[v] = V{};
    }
    for (int v = 0; trend && v < (KINDS ? KINDS : vectors); ++v) largest[v] = most[v];
    for (long g = 0; g < groups; ++g, here += LANES * vectors, table += FREQUENCIES)
        for (int v = 0; v < vectors; ++v) {
            V y;
            __builtin_memcpy(&y, here + v * LANES, sizeof(V));
            __builtin_prefetch(here + v * LANES + AHEAD);
            for (int f = 0; f < FREQUENCIES; ++f) {
                sum[f][v].re += y * table[f].re;
                sum[f][v].im += y * table[f].im;
            }
            if (trend) {
                total[v] += y;
                sums[v] += total[v];
                V &most_of_kind = largest[KINDS == 1 ? 0 : v];
                most_of_kind = larger(most_of_kind, larger(y, -y));
            }
        }
    for (int v = 0; v < vectors; ++v) {
        for (int f = 0; f < FREQUENCIES; ++f) waves[f * vectors + v] = sum[f][v];
        if (trend) mean[v] = total[v], partial[v] = sums[v];
    }
    for (int v = 0; trend && v < (KINDS ? KINDS : vectors); ++v) most[v] = largest[v];
}

// What a vector of lanes adds to the sums of its channels: sample `offset` of a group and channel c at the same place.
template <class Add> INLINE void each_lane(int channels, Add add) {
    for (int offset = 0; offset < LANES; ++offset)
        for (int c = 0; c < channels; ++c) {
            const int place = offset * channels + c;
            add(offset, c, place / LANES, place % LANES);
        }
}

// As harmonic_sums, of FREQUENCIES of them and whole groups only; the sums without waves where `trend`.
template <int CHANNELS, int FREQUENCIES, bool trend>
static void groups_of(const double *values, long from, long groups, int channels, const double *turns, double origin,
                      double *sums, double *plain, double *moment, double *largest) {
    Turn table[STEPS * FREQUENCIES];
    tabulate(turns, FREQUENCIES, table);
    C block[FREQUENCIES * MOST_CHANNELS], waves[FREQUENCIES * MOST_CHANNELS];
    V mean[MOST_CHANNELS], partial[MOST_CHANNELS], most[MOST_CHANNELS], total[MOST_CHANNELS], moments[MOST_CHANNELS];
    for (int v = 0; v < channels; ++v) most[v] = total[v] = moments[v] = V{};
    for (int k = 0; k < FREQUENCIES * channels; ++k) waves[k] = zero();
    Turn place[FREQUENCIES], on[FREQUENCIES];
    for (int f = 0; f < FREQUENCIES; ++f) {
        place[f] = turn_of(turns[f] * (from - origin));
        on[f] = turn_of(turns[f] * LANES * STEPS);
    }
    for (long group = 0; group < groups; group += STEPS) {
        const long first = from + group * LANES, count = groups - group < STEPS ? groups - group : STEPS;
        sweep<CHANNELS, FREQUENCIES, trend>(values + first * channels, count, channels, table, block, mean, partial,
                                           most);
        for (int f = 0; f < FREQUENCIES; ++f) {
            const C turned = {all(place[f].re), all(place[f].im)};
            for (int v = 0; v < channels; ++v) add(waves[f * channels + v], turned, block[f * channels + v]);
            place[f] = times(place[f], on[f]);
        }
        for (int v = 0; trend && v < channels; ++v) {
            total[v] += mean[v];
            moments[v] += mean[v] * (first - origin) + (mean[v] * static_cast<double>(count) - partial[v]) * static_cast<double>(LANES);
        }
    }
    for (int f = 0; f < FREQUENCIES; ++f) {
        const Turn each = turn_of(turns[f]);
        Turn own = {1, 0};
        int at = 0;
        each_lane(channels, [&](int offset, int c, int v, int l) {
            for (; at < offset; ++at) own = times(own, each);
            const Turn sum = times({waves[f * channels + v].re[l], waves[f * channels + v].im[l]}, own);
            sums[2 * (f * channels + c)] += sum.re;
            sums[2 * (f * channels + c) + 1] += sum.im;
        });
    }
    if (!trend) return;
    each_lane(channels, [&](int offset, int c, int v, int l) {
        plain[c] += total[v][l];
        moment[c] += moments[v][l] + offset * total[v][l];
    });
    for (int v = 0; v < (kinds(CHANNELS) ? kinds(CHANNELS) : channels); ++v)
        for (int l = 0; l < LANES; ++l) {
            const int c = (v * LANES + l) % channels;
            if (most[v][l] > largest[c]) largest[c] = most[v][l];
        }
}

// Sums over samples `from` to `to` of y exp(j turn k), k the index of the sample less `origin`; (frequencies, channels)
// complex, added to `sums`; of y, and of y times the index less `origin`, (channels,), and the largest |y|.
// `turns` are cycles between samples.
template <int CHANNELS>
static void harmonic_sums_of(const double *values, long from, long to, int channels, const double *turns,
                             int frequencies, double origin, double *sums, double *plain, double *moment,
                             double *largest) {
    const long groups = (to - from) / LANES;
    for (int f = 0; f < frequencies; f += TOGETHER) {
        auto run = frequencies - f < TOGETHER ? (f ? groups_of<CHANNELS, 1, false> : groups_of<CHANNELS, 1, true>)
                                              : (f ? groups_of<CHANNELS, 2, false> : groups_of<CHANNELS, 2, true>);
        run(values, from, groups, channels, turns + f, origin, sums + 2 * f * channels, plain, moment, largest);
    }
    for (long sample = from + groups * LANES; sample < to; ++sample)
        for (int f = 0; f < frequencies; ++f) {
            const Turn own = turn_of(turns[f] * (sample - origin));
            for (int c = 0; c < channels; ++c) {
                const double y = values[sample * channels + c];
                sums[2 * (f * channels + c)] += y * own.re;
                sums[2 * (f * channels + c) + 1] += y * own.im;
                if (f) continue;
                plain[c] += y;
                moment[c] += y * (sample - origin);
                if (__builtin_fabs(y) > largest[c]) largest[c] = __builtin_fabs(y);
            }
        }
}
static void harmonic_sums(const double *values, long from, long to, int channels, const double *turns, int frequencies,
                          double origin, double *sums, double *plain, double *moment, double *largest) {
    auto run = channels == 1   ? harmonic_sums_of<1>
               : channels == 2 ? harmonic_sums_of<2>
               : channels == 3 ? harmonic_sums_of<3>
               : channels == 4 ? harmonic_sums_of<4>
                               : harmonic_sums_of<0>;
    run(values, from, to, channels, turns, frequencies, origin, sums, plain, moment, largest);
}

}  // namespace DASHPOT_SET
