// Types for the processor's vector instructions. The operators + - * / are applied to each number
// of a vector.
#pragma once
#include <cstring>

namespace plate {

using Four = double __attribute__((vector_size(4 * sizeof(double))));
using Eight = float __attribute__((vector_size(8 * sizeof(float))));

// Loads four or eight numbers from memory. The memory need not be aligned.
template <class Vector, class Number>
[[gnu::always_inline]] inline void load(Vector& vector, const Number* from) {
    static_assert(sizeof(vector[0]) == sizeof(Number));
    std::memcpy(&vector, from, sizeof vector);
}

template <class Vector, class Number>
[[gnu::always_inline]] inline void store(const Vector& vector, Number* to) {
    static_assert(sizeof(vector[0]) == sizeof(Number));
    std::memcpy(to, &vector, sizeof vector);
}

}  // namespace plate
