// Sums of samples against sines and cosines, one pass: values (N, channels) at even times, any number of frequencies.
#pragma once
#include "lanes.hpp"

namespace DASHPOT_SET {

constexpr int STEPS = 512;  // groups of LANES samples that are summed by Horner's rule before their phase is set anew
constexpr int MOST_CHANNELS = 64;

struct Turn {
    double re, im;
};

INLINE Turn turn_of(double cycles) {
    cycles -= __builtin_floor(cycles);
    return {__builtin_cos(6.283185307179586476925 * cycles), __builtin_sin(6.283185307179586476925 * cycles)};
}

// The first `groups` groups at `here`: waves at one frequency by Horner's rule, sum <- sum back + y, where `back` turns
// by a group backwards.  With `trend` also the sums of y and of their partial sums, and the largest |y|; without it,
// what comes behind these groups is fetched meanwhile.
template <int CHANNELS, bool trend>
static inline void sweep(const double *here, long groups, int channels, Turn back, C *waves, V *mean, V *partial,
                         V *most) {
    const int vectors = CHANNELS ? CHANNELS : channels;
    constexpr int HELD = CHANNELS ? CHANNELS : MOST_CHANNELS;
    C sum[HELD];
    V total[HELD], sums[HELD], largest[HELD];
    for (int v = 0; v < vectors; ++v) sum[v] = zero(), total[v] = sums[v] = V{}, largest[v] = most[v];
    const V re = all(back.re), im = all(back.im);
    const long ahead = groups * LANES * vectors;
    for (long g = 0; g < groups; ++g, here += LANES * vectors)
        for (int v = 0; v < vectors; ++v) {
            V y;
            __builtin_memcpy(&y, here + v * LANES, sizeof(V));
            const V real = y + sum[v].re * re - sum[v].im * im;
            sum[v].im = sum[v].re * im + sum[v].im * re;
            sum[v].re = real;
            if (trend) {
                total[v] += y;
                sums[v] += total[v];
                largest[v] = larger(largest[v], larger(y, -y));
            } else {
                __builtin_prefetch(here + ahead + v * LANES);
            }
        }
    for (int v = 0; v < vectors; ++v) {
        waves[v] = sum[v];
        if (trend) mean[v] = total[v], partial[v] = sums[v], most[v] = largest[v];
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
    C waves[MOST_CHANNELS];
    V mean[MOST_CHANNELS], partial[MOST_CHANNELS], most[MOST_CHANNELS];
    for (int v = 0; v < channels; ++v) most[v] = V{};
    for (long group = 0; group < groups; group += STEPS) {
        const long count = groups - group < STEPS ? groups - group : STEPS;
        const double *here = values + (from + group * LANES) * channels;
        const double start = from + group * LANES - origin;
        for (int f = 0; f < frequencies; ++f) {
            const Turn back = turn_of(-turns[f] * LANES);
            if (f)
                sweep<CHANNELS, false>(here, count, channels, back, waves, mean, partial, most);
            else
                sweep<CHANNELS, true>(here, count, channels, back, waves, mean, partial, most);
            // Horner's rule leaves the last group unturned.
            const double last = start + (count - 1) * LANES;
            const Turn first = turn_of(turns[f] * last), each = turn_of(turns[f]);
            Turn own = first;
            for (int offset = 0; offset < LANES; ++offset) {
                for (int c = 0; c < channels; ++c) {
                    const int place = offset * channels + c, v = place / LANES, l = place % LANES;
                    const double re = waves[v].re[l], im = waves[v].im[l];
                    sums[2 * (f * channels + c)] += re * own.re - im * own.im;
                    sums[2 * (f * channels + c) + 1] += re * own.im + im * own.re;
                    if (f) continue;
                    plain[c] += mean[v][l];
                    moment[c] += (start + offset) * mean[v][l] + LANES * (count * mean[v][l] - partial[v][l]);
                }
                own = {own.re * each.re - own.im * each.im, own.re * each.im + own.im * each.re};
            }
        }
    }
    for (int v = 0; v < channels; ++v)
        for (int l = 0; l < LANES; ++l) {
            const int c = (v * LANES + l) % channels;
            if (most[v][l] > largest[c]) largest[c] = most[v][l];
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
