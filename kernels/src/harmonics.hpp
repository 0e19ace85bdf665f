// Sums of samples against sines and cosines, one pass: values (N, channels) at even times, any number of frequencies.
#pragma once
#include "lanes.hpp"

namespace DASHPOT_SET {

constexpr long SEED_EVERY = 512;  // steps of the rotation, after which it begins anew: rounding stays near 1e-14
constexpr int MOST_CHANNELS = 64;

// Sums over samples `from` to `to` of y exp(j turn k), k the index of the sample less `origin`; (frequencies, channels)
// complex, added to `sums`; of y itself, (channels,), and the largest |y|.  `turns` are cycles between samples.
static void harmonic_sums(const double *values, long from, long to, int channels, const double *turns,
                          int frequencies, double origin, double *sums, double *plain, double *largest) {
    const long step = LANES;  // samples of a group: `channels` vectors hold them
    const long groups = (to - from) / step;
    C rotor[MOST_CHANNELS], along[MOST_CHANNELS];
    V mean[MOST_CHANNELS], most[MOST_CHANNELS];
    auto rotation = [](double cycles, double &re, double &im) {
        cycles -= __builtin_floor(cycles);
        re = __builtin_cos(6.283185307179586476925 * cycles);
        im = __builtin_sin(6.283185307179586476925 * cycles);
    };
    for (long group = 0; group < groups; group += SEED_EVERY) {
        const long end = group + SEED_EVERY < groups ? group + SEED_EVERY : groups;
        const double *first = values + (from + group * step) * channels;
        for (int f = 0; f < frequencies; ++f) {
            double re, im;
            rotation(turns[f] * step, re, im);
            const C advance = {all(re), all(im)};
            for (int v = 0; v < channels; ++v) {
                along[v] = zero(), mean[v] = most[v] = V{};
                for (int l = 0; l < LANES; ++l) {
                    const long sample = from + group * step + (v * LANES + l) / channels;
                    rotation(turns[f] * (sample - origin), re, im);
                    rotor[v].re[l] = re, rotor[v].im[l] = im;
                }
            }
            const double *here = first;
            for (long g = group; g < end; ++g, here += step * channels)
                for (int v = 0; v < channels; ++v) {
                    V y;
                    __builtin_memcpy(&y, here + v * LANES, sizeof(V));
                    along[v].re += y * rotor[v].re;
                    along[v].im += y * rotor[v].im;
                    rotor[v] = rotor[v] * advance;
                    if (f) continue;
                    mean[v] += y;
                    most[v] = larger(most[v], larger(y, -y));
                }
            for (int v = 0; v < channels; ++v)
                for (int l = 0; l < LANES; ++l) {
                    const int c = (v * LANES + l) % channels;
                    sums[2 * (f * channels + c)] += along[v].re[l];
                    sums[2 * (f * channels + c) + 1] += along[v].im[l];
                    if (f) continue;
                    plain[c] += mean[v][l];
                    if (most[v][l] > largest[c]) largest[c] = most[v][l];
                }
        }
    }
    for (long sample = from + groups * step; sample < to; ++sample)
        for (int f = 0; f < frequencies; ++f) {
            double re, im;
            rotation(turns[f] * (sample - origin), re, im);
            for (int c = 0; c < channels; ++c) {
                const double y = values[sample * channels + c];
                sums[2 * (f * channels + c)] += y * re;
                sums[2 * (f * channels + c) + 1] += y * im;
                if (f) continue;
                plain[c] += y;
                if (__builtin_fabs(y) > largest[c]) largest[c] = __builtin_fabs(y);
            }
        }
}

}  // namespace DASHPOT_SET
