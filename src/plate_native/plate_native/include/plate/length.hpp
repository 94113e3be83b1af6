// Lengths of vectors, bitwise equal on all processors.
//
// C libraries round std::hypot differently. IEEE 754 fixes sums, products and square roots, so
// |(x, y)| = sqrt(x x + y y) has one value everywhere. A square overflows above 1e154 and loses
// digits below 1e-146. Only lengths that may reach these limits need `scaled_length`.
#pragma once
#include <algorithm>
#include <cmath>

namespace plate {

inline double length_of(double x, double y) { return std::sqrt(x * x + y * y); }

// |(x, y)| = m sqrt((x/m)^2 + (y/m)^2) with m = max(|x|, |y|), for any finite x and y.
inline double scaled_length(double x, double y) {
    const double most = std::max(std::abs(x), std::abs(y));
    return most > 0 ? most * length_of(x / most, y / most) : 0;
}

}  // namespace plate
