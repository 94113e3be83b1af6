// Conversion of Python arrays to C++ views without copies. The type, the number of axes and the
// memory order of the arrays are checked.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <climits>
#include <utility>
#include <vector>

#include "view.hpp"

namespace plate {

namespace nb = nanobind;

template <class T, nb::ssize_t N>
using Array = nb::ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

// Converts an array to a view with the required number of axes.
template <class Source>
struct Viewed {
    const Source& array;

    template <class T, int N>
    operator View<T, N>() const {
        if (array.size() > INT_MAX)
            throw nb::value_error("an array has more numbers than allowed: 2^31 - 1");
        View<T, N> result{array.data(), {}};
        for (int axis = 0; axis < N; axis++) result.shape[axis] = static_cast<int>(array.shape(axis));
        return result;
    }
};

template <class Source>
Viewed<Source> view(const Source& array) {
    return {array};
}

// Returns a field of a Python named tuple.
template <class T>
T field(nb::handle record, const char* name) {
    return nb::cast<T>(record.attr(name));
}

// Returns an item of a Python tuple.
template <class T>
T item(const nb::tuple& items, size_t at) {
    if (at >= items.size()) throw nb::value_error("a tuple has too few items");
    return nb::cast<T>(items[at]);
}

// Returns a view of an array (n, 3) as samples of a motion.
template <class Number>
SamplesOf<Number> samples(const Array<const Number, 2>& array) {
    return {array.data(), static_cast<int>(array.shape(0)), 3, 1};
}

// Returns a NumPy array that takes over the memory of a vector.
template <int N, class T = double, class Memory = std::allocator<T>>
nb::ndarray<nb::numpy, T, nb::ndim<N>> to_numpy(std::vector<T, Memory>&& numbers,
                                                std::array<size_t, N> shape) {
    using Kept = std::vector<T, Memory>;
    auto* kept = new Kept(std::move(numbers));
    nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<Kept*>(p); });
    return {kept->data(), N, shape.data(), owner};
}

}  // namespace plate
