// Conversion of Python tuples and arrays to C++ structs, for the bindings.
#pragma once
#include <algorithm>
#include <initializer_list>
#include <string>
#include <type_traits>

#include <plate/bind.hpp>

#include "limits.hpp"

namespace plate {

using Numbers = Array<const double, 1>;
using Table = Array<const double, 2>;
using Box = Array<const double, 3>;

// Throws an error if an array does not have the required shape.
template <class Any>
void check(const char* name, const Any& array, std::initializer_list<size_t> expected) {
    std::string found, allowed;
    bool same = array.ndim() == expected.size();
    size_t axis = 0;
    for (size_t size : expected) {
        same = same && array.shape(axis++) == size;
        allowed += (allowed.empty() ? "" : ", ") + std::to_string(size);
    }
    if (same) return;
    for (axis = 0; axis < array.ndim(); axis++)
        found += (found.empty() ? "" : ", ") + std::to_string(array.shape(axis));
    const std::string says = name + (" has shape (" + found) + "), allowed: (" + allowed + ")";
    throw nb::value_error(says.c_str());
}

// Copies the array in the field `name` of a Python named tuple to the C array `target`. The arrays
// may have up to three axes. Throws an error if the shapes differ.
template <class Target>
void read(nb::handle record, const char* name, Target& target) {
    constexpr size_t AXES = std::rank_v<Target>;
    const size_t sizes[] = {std::extent_v<Target, 0>, std::extent_v<Target, 1>, std::extent_v<Target, 2>};
    const auto from = field<Array<const double, AXES>>(record, name);
    for (size_t axis = 0; axis < AXES; axis++)
        if (from.shape(axis) != sizes[axis])
            throw nb::value_error((std::string(name) + " has a wrong shape").c_str());
    std::copy_n(from.data(), from.size(), reinterpret_cast<double*>(&target));
}

inline std::vector<double> copied(const Numbers& array) {
    return {array.data(), array.data() + array.size()};
}

template <class Number = double>
MatrixOf<Number> matrix_of(const Table& array) {
    MatrixOf<Number> result(array.shape(0), array.shape(1));
    std::copy_n(array.data(), array.size(), result[0]);
    return result;
}

inline nb::object to_numpy(std::vector<double>&& numbers) {
    const size_t count = numbers.size();
    return nb::cast(to_numpy<1>(std::move(numbers), {count}));
}

template <class Number>
nb::object to_numpy(MatrixOf<Number>&& matrix) {
    const size_t rows = matrix.rows, columns = matrix.columns;
    return nb::cast(to_numpy<2>(std::move(matrix.numbers), {rows, columns}));
}

// Converts the Python tuple `Limits` to the C++ struct.
inline Limits limits_of(const nb::tuple& record) {
    Limits limits{
        .stroke_m = field<double>(record, "stroke_m"),
        .speed = field<double>(record, "speed"),
        .accel = field<double>(record, "accel"),
        .arm_m = field<double>(record, "arm_m"),
        .heat = field<double>(record, "heat"),
        .forceful = field<bool>(record, "forceful"),
    };
    read(record, "motors", limits.motors), read(record, "half", limits.half);
    read(record, "levers", limits.levers), read(record, "loads", limits.loads);
    return limits;
}

}  // namespace plate
