// Laws of nonlinear elements as programs for a stack of values with their slopes, over the instants of a period.
// Twin: dashpot.model.nonlinear.expression, whose rules these are.
#pragma once
#include "dense.hpp"
#include "problem.hpp"

namespace DASHPOT_SET {

// The stack of one thread: a value and its slopes along d, v, the constants and the state z, (times,) each.
struct Stack {
    double *memory, *of_first, *of_second, *result;
    int times, names;

    Stack(Arena &arena, const dashpot::Programs &laws, int instants) : times(instants), names(laws.names) {
        memory = arena.take<double>(static_cast<long>(laws.depth) * (1 + names) * times);
        of_first = arena.take<double>(times), of_second = arena.take<double>(times);
        result = arena.take<double>(times);
    }
    double *value(int slot) const { return memory + static_cast<long>(slot) * (1 + names) * times; }
    double *slope(int slot, int name) const { return value(slot) + static_cast<long>(1 + name) * times; }
};

INLINE double sign_of(double x) { return x > 0 ? 1.0 : x < 0 ? -1.0 : x; }

INLINE double whole_power(double x, int exponent) {
    double power = 1;
    for (int bit = exponent; bit; bit >>= 1, x *= x)
        if (bit & 1) power *= x;
    return power;
}

// e^x for x from 0 to 700, by Cephes' ratio of polynomials behind a division by powers of 2.
INLINE V exponential(V x) {
    const V magic = all(6755399441055744.0), shifted = x * 1.4426950408889634 + magic, n = shifted - magic;
    const V r = (x - n * 6.93145751953125e-1) - n * 1.42860682030941723212e-6, rr = r * r;
    const V p = r * ((1.26177193074810590878e-4 * rr + 3.02994407707441961300e-2) * rr + 1.0);
    const V q = ((3.00198505138664455042e-6 * rr + 2.52448340349684104192e-3) * rr + 2.27265548208155028766e-1) * rr + 2.0;
    Mask bits, zero;
    __builtin_memcpy(&bits, &shifted, sizeof bits), __builtin_memcpy(&zero, &magic, sizeof zero);
    bits = (bits - zero + 1023) << 52;
    V power;
    __builtin_memcpy(&power, &bits, sizeof power);
    return (1.0 + 2.0 * (p / (q - p))) * power;
}

// By Cephes: a ratio of polynomials near 0, else from e^2x.
INLINE V hyperbolic_tangent(V x) {
    const V size = x < 0 ? -x : x, twice = 2.0 * (size > 350 ? all(350) : size), z = x * x;
    const V far = 1.0 - 2.0 / (exponential(twice) + 1.0);
    const V p = (-9.64399179425052238628e-1 * z - 9.92877231001918586564e1) * z - 1.61468768441708447952e3;
    const V q = ((z + 1.12811678491632931402e2) * z + 2.23548839060100448583e3) * z + 4.84406305325125486048e3;
    return size < 0.625 ? x + x * z * (p / q) : x < 0 ? -far : far;
}

// Value and slope along the operand of a function of one operand.
static void function_of(dashpot::LawStep step, const double *x, double *value, double *along, int times) {
    using dashpot::LawCode;
    switch (step.code) {
        case LawCode::NEGATIVE:
            for (int k = 0; k < times; ++k) value[k] = -x[k], along[k] = -1;
            break;
        case LawCode::WHOLE_POWER:
            for (int k = 0; k < times; ++k) {
                const double below = whole_power(x[k], step.which - 1);
                value[k] = below * x[k], along[k] = step.which * below;
            }
            break;
        case LawCode::ABS:
            for (int k = 0; k < times; ++k) value[k] = __builtin_fabs(x[k]), along[k] = sign_of(x[k]);
            break;
        case LawCode::SIGN:
            for (int k = 0; k < times; ++k) value[k] = sign_of(x[k]), along[k] = 0;
            break;
        case LawCode::TANH:
            for (int k = 0; k < times; k += LANES) {
                const V tangent = hyperbolic_tangent(load(x + k));
                store(value + k, tangent), store(along + k, 1 - tangent * tangent);
            }
            break;
        case LawCode::EXP:
            for (int k = 0; k < times; ++k) along[k] = value[k] = __builtin_exp(x[k]);
            break;
        case LawCode::LOG:
            for (int k = 0; k < times; ++k) value[k] = __builtin_log(x[k]), along[k] = 1 / x[k];
            break;
        case LawCode::SQRT:
            for (int k = 0; k < times; ++k) value[k] = __builtin_sqrt(x[k]), along[k] = 0.5 / value[k];
            break;
        case LawCode::SIN:
            for (int k = 0; k < times; ++k) value[k] = __builtin_sin(x[k]), along[k] = __builtin_cos(x[k]);
            break;
        default:  // COS
            for (int k = 0; k < times; ++k) value[k] = __builtin_cos(x[k]), along[k] = -__builtin_sin(x[k]);
    }
}

// Value and slopes along both operands.
static void function_of_two(dashpot::LawCode code, const double *x, const double *y, double *value, double *along_x,
                            double *along_y, int times) {
    using dashpot::LawCode;
    switch (code) {
        case LawCode::PLUS:
            for (int k = 0; k < times; ++k) value[k] = x[k] + y[k], along_x[k] = 1, along_y[k] = 1;
            break;
        case LawCode::MINUS:
            for (int k = 0; k < times; ++k) value[k] = x[k] - y[k], along_x[k] = 1, along_y[k] = -1;
            break;
        case LawCode::TIMES:
            for (int k = 0; k < times; ++k) value[k] = x[k] * y[k], along_x[k] = y[k], along_y[k] = x[k];
            break;
        case LawCode::OVER:
            for (int k = 0; k < times; ++k)
                value[k] = x[k] / y[k], along_x[k] = 1 / y[k], along_y[k] = -x[k] / (y[k] * y[k]);
            break;
        default:  // POWER
            for (int k = 0; k < times; ++k) {
                const bool flat = y[k] == 0 || (x[k] == 0 && y[k] > 0 && y[k] < 1);
                value[k] = __builtin_pow(x[k], y[k]);
                along_x[k] = flat ? 0 : y[k] * __builtin_pow(x[k], y[k] - 1);
                along_y[k] = x[k] > 0 ? value[k] * __builtin_log(x[k]) : 0;
            }
    }
}

// Into slot `to`, at each instant: the value in slot `a`, where it is the less or the greater or what stands in `to` is
// above 0, else that in slot `b`; and the slopes of the chosen one.
static void choose(dashpot::LawCode code, int to, int a, int b, const Stack &stack, unsigned *active) {
    const int times = stack.times;
    const double *x = stack.value(a), *y = stack.value(b);
    double *first = stack.of_first;
    if (code == dashpot::LawCode::WHERE)
        for (int k = 0; k < times; ++k) first[k] = stack.value(to)[k] > 0;
    else if (code == dashpot::LawCode::MIN)
        for (int k = 0; k < times; ++k) first[k] = x[k] < y[k];
    else
        for (int k = 0; k < times; ++k) first[k] = x[k] > y[k];
    double *value = stack.value(to);
    for (int k = 0; k < times; ++k) value[k] = first[k] > 0 ? x[k] : y[k];
    for (int name = 0; name < stack.names; ++name) {
        const bool by_a = active[a] >> name & 1, by_b = active[b] >> name & 1;
        const double *along_a = stack.slope(a, name), *along_b = stack.slope(b, name);
        double *along = stack.slope(to, name);
        if (by_a && by_b)
            for (int k = 0; k < times; ++k) along[k] = first[k] > 0 ? along_a[k] : along_b[k];
        else if (by_a)
            for (int k = 0; k < times; ++k) along[k] = first[k] > 0 ? along_a[k] : 0;
        else if (by_b)
            for (int k = 0; k < times; ++k) along[k] = first[k] > 0 ? 0 : along_b[k];
    }
    active[to] = active[a] | active[b];
}

// What the names of a law stand for: d, v and the state z, (times,) each, and its constants, behind which z is numbered.
struct Named {
    const double *d, *v, *constants, *z = nullptr;
    int state = -1;
};

// The value of a program in slot 0 of the stack, and along which of the names in `wanted` (bits) it has slopes.
static unsigned law_at(const dashpot::Programs &laws, int row, const Named &named, unsigned wanted, const Stack &stack,
                       unsigned *active) {
    using dashpot::LawCode;
    const int times = stack.times;
    int top = 0;
    for (int at = laws.step_start[row]; at < laws.step_start[row + 1]; ++at) {
        const dashpot::LawStep step = laws.steps[at];
        if (step.code == LawCode::NUMBER || step.code == LawCode::NAME) {
            double *value = stack.value(top);
            const bool name = step.code == LawCode::NAME;
            const double *motion = !name ? nullptr : step.which == 0 ? named.d : step.which == 1 ? named.v
                                 : step.which == named.state ? named.z : nullptr;
            const double held = !name ? step.number : motion ? 0 : named.constants[step.which - 2];
            for (int k = 0; k < times; ++k) value[k] = motion ? motion[k] : held;
            active[top] = name ? wanted & 1u << step.which : 0;
            if (active[top])
                for (int k = 0; k < times; ++k) stack.slope(top, step.which)[k] = 1;
            ++top;
        } else if (step.code >= LawCode::WHERE && step.code <= LawCode::MAX) {
            const bool tested = step.code == LawCode::WHERE;
            top -= tested ? 2 : 1;
            choose(step.code, top - 1, tested ? top : top - 1, tested ? top + 1 : top, stack, active);
        } else if (step.code < LawCode::PLUS) {
            function_of(step, stack.value(top - 1), stack.result, stack.of_first, times);
            for (int name = 0; name < stack.names; ++name)
                if (active[top - 1] >> name & 1)
                    for (int k = 0; k < times; ++k) stack.slope(top - 1, name)[k] *= stack.of_first[k];
            for (int k = 0; k < times; ++k) stack.value(top - 1)[k] = stack.result[k];
        } else {
            --top;
            function_of_two(step.code, stack.value(top - 1), stack.value(top), stack.result, stack.of_first,
                            stack.of_second, times);
            for (int name = 0; name < stack.names; ++name) {
                const bool first = active[top - 1] >> name & 1, second = active[top] >> name & 1;
                double *a = stack.slope(top - 1, name);
                const double *b = stack.slope(top, name), *by_a = stack.of_first, *by_b = stack.of_second;
                if (first && second)
                    for (int k = 0; k < times; ++k) a[k] = by_a[k] * a[k] + by_b[k] * b[k];
                else if (first)
                    for (int k = 0; k < times; ++k) a[k] *= by_a[k];
                else if (second)
                    for (int k = 0; k < times; ++k) a[k] = by_b[k] * b[k];
            }
            active[top - 1] |= active[top];
            for (int k = 0; k < times; ++k) stack.value(top - 1)[k] = stack.result[k];
        }
    }
    return active[0];
}

}  // namespace DASHPOT_SET
