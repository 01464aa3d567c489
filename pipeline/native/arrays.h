// Arrays of numpy, as kernels take them and as they give them back.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <initializer_list>
#include <memory>
#include <utility>
#include <vector>

namespace nb = nanobind;

// Loops over many points are compiled twice by GCC, and the processor chooses as the module is loaded. Clang would leave
// out functions of the standard library that they call, and that of ziglang never chooses AVX2.
#if defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__) && !defined(LIDCAM_PLAIN)
#define LIDCAM_CLONED
#define LIDCAM_HOT __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define LIDCAM_HOT
#endif

// A part of such loops: compiled with each of them, for its processor.
#if defined(__GNUC__)
#define LIDCAM_PART static inline __attribute__((always_inline))
#else
#define LIDCAM_PART static inline
#endif

// Arrays that are read, perhaps read-only in numpy: C order, on this machine.
template <class T> using In1 = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <class T> using In2 = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <class T> using In3 = nb::ndarray<const T, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// How an array is made whose every element will be written: zeros cost a pass over it.
struct Unset {};
constexpr Unset unset;

// An array in C order that numpy takes over; zero at first.
template <class T> class Out {
  public:
    explicit Out(std::initializer_list<size_t> shape) : dimensions_(shape.size()) {
        data_ = std::make_unique<T[]>(counted(shape));
    }
    Out(std::initializer_list<size_t> shape, Unset) : dimensions_(shape.size()) { data_.reset(new T[counted(shape)]); }
    T *data() { return data_.get(); }
    T &operator[](size_t i) { return data_[i]; }
    T &operator()(size_t i, size_t j) { return data_[i * shape_[1] + j]; }
    // To be called once, with the interpreter's lock. Of the rows, only the first `rows` belong to it.
    nb::object numpy(size_t rows) {
        shape_[0] = rows;
        T *kept = data_.release();
        nb::capsule owner(kept, [](void *of) noexcept { delete[] static_cast<T *>(of); });
        return nb::cast(nb::ndarray<nb::numpy, T>(kept, dimensions_, shape_, owner));
    }
    nb::object numpy() { return numpy(shape_[0]); }

  private:
    size_t counted(std::initializer_list<size_t> shape) {
        size_t count = 1;
        for (size_t i = 0; i < dimensions_; i++) count *= shape_[i] = shape.begin()[i];
        return count;
    }
    size_t dimensions_, shape_[4] = {};
    std::unique_ptr<T[]> data_;
};

// A list that numpy takes over; with the interpreter's lock.
template <class T> nb::object numpy_of(std::vector<T> &values) {
    auto *kept = new std::vector<T>(std::move(values));
    nb::capsule owner(kept, [](void *of) noexcept { delete static_cast<std::vector<T> *>(of); });
    return nb::cast(nb::ndarray<nb::numpy, T, nb::ndim<1>>(kept->data(), {kept->size()}, owner));
}

// The name of an argument that has to have exactly the type that a kernel takes: nothing is copied in silence.
inline auto array(const char *name) { return nb::arg(name).noconvert(); }
