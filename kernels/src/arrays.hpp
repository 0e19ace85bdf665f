// Arrays of NumPy as the module takes and makes them.
#pragma once
#include <algorithm>
#include <complex>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace dashpot {

namespace nb = nanobind;

using Reals = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Complexes = nb::ndarray<const std::complex<double>, nb::c_contig, nb::device::cpu>;
using Integers = nb::ndarray<const int64_t, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<const bool, nb::c_contig, nb::device::cpu>;

inline const double *numbers(const Complexes &array) { return reinterpret_cast<const double *>(array.data()); }

template <class T = double> struct Array {
    T *data;
    nb::ndarray<nb::numpy, T> array;
};
template <class T = double> Array<T> array(std::vector<size_t> shape) {
    size_t count = 1;
    for (size_t size : shape) count *= size;
    T *data = new T[std::max<size_t>(count, 1)]();
    nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return {data, nb::ndarray<nb::numpy, T>(data, shape.size(), shape.data(), owner)};
}

inline void require(bool right, const char *what) {
    if (!right) throw std::invalid_argument(what);
}

void bind_small_rigs(nb::module_ &module);
void bind_nonlinear_rigs(nb::module_ &module);
void bind_state_laws(nb::module_ &module);

}  // namespace dashpot
