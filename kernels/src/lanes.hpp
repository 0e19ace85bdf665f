// Lanes: as many neighbouring lines of a spectrum as a register holds, and complex numbers of them.
#pragma once

namespace DASHPOT_SET {

#if defined(__AVX512F__)
constexpr int LANES = 8;
#elif defined(__AVX__)
constexpr int LANES = 4;
#else
constexpr int LANES = 2;
#endif

typedef double V __attribute__((vector_size(8 * LANES)));
typedef long long Mask __attribute__((vector_size(8 * LANES)));

#define INLINE static inline __attribute__((always_inline))

INLINE V all(double x) { return V{} + x; }
INLINE V load(const double *from) { return *reinterpret_cast<const V *>(from); }
INLINE void store(double *to, V x) { *reinterpret_cast<V *>(to) = x; }
INLINE V larger(V a, V b) { return a > b ? a : b; }

INLINE double total(V x) {
    double sum = 0;
    for (int k = 0; k < LANES; ++k) sum += x[k];
    return sum;
}

INLINE bool any(Mask m) {
    long long some = 0;
    for (int k = 0; k < LANES; ++k) some |= m[k];
    return some != 0;
}

INLINE V square_root(V x) {
    V root;
    for (int k = 0; k < LANES; ++k) root[k] = __builtin_sqrt(x[k]);
    return root;
}

struct C {
    V re, im;
};

INLINE C zero() { return {V{}, V{}}; }
INLINE C operator+(C a, C b) { return {a.re + b.re, a.im + b.im}; }
INLINE C operator-(C a, C b) { return {a.re - b.re, a.im - b.im}; }
INLINE C operator-(C a) { return {-a.re, -a.im}; }
INLINE C operator*(C a, V b) { return {a.re * b, a.im * b}; }
INLINE C operator*(C a, double b) { return {a.re * b, a.im * b}; }
INLINE C operator*(C a, C b) { return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; }
INLINE C conj(C a) { return {a.re, -a.im}; }
INLINE V norm(C a) { return a.re * a.re + a.im * a.im; }
// x += a b, and x += conj(a) b
INLINE void add(C &x, C a, C b) {
    x.re += a.re * b.re;
    x.im += a.re * b.im;
    x.re -= a.im * b.im;
    x.im += a.im * b.re;
}
INLINE void add_conj(C &x, C a, C b) {
    x.re += a.re * b.re;
    x.im += a.re * b.im;
    x.re += a.im * b.im;
    x.im -= a.im * b.re;
}
INLINE void subtract(C &x, C a, C b) {
    x.re -= a.re * b.re;
    x.im -= a.re * b.im;
    x.re += a.im * b.im;
    x.im -= a.im * b.re;
}
INLINE void subtract_conj(C &x, C a, C b) {
    x.re -= a.re * b.re;
    x.im -= a.re * b.im;
    x.re -= a.im * b.im;
    x.im += a.im * b.re;
}
// Re(conj(a) b)
INLINE V dot(C a, C b) { return a.re * b.re + a.im * b.im; }
INLINE C inverse(C a) {
    const V scale = 1.0 / norm(a);
    return {a.re * scale, -a.im * scale};
}
INLINE C choose(Mask m, C a, C b) { return {m ? a.re : b.re, m ? a.im : b.im}; }

// Memory of one thread: asked for piece by piece, first without any to learn how much it takes.
struct Arena {
    char *base;
    unsigned long used;
    template <class T> T *take(long count) {
        char *here = base ? base + used : nullptr;
        used += (static_cast<unsigned long>(count > 0 ? count : 1) * sizeof(T) + 63) / 64 * 64;
        return reinterpret_cast<T *>(here);
    }
};

}  // namespace DASHPOT_SET
