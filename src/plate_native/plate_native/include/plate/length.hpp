// Lengths of vectors, bitwise equal on all processors.
//
// The rounding of std::hypot depends on the C library. IEEE 754 defines the rounding of sums,
// products and square roots. Therefore |(x, y)| = sqrt(x x + y y) has the same value on all
// processors. The square of a number above 1e154 overflows, and the square of a number below 1e-146
// loses digits. Only lengths that may reach these limits need `scaled_length`.
#pragma once
#include <algorithm>
#include <cmath>

namespace plate {

inline double length_of(double x, double y) { return std::sqrt(x * x + y * y); }

// Returns |(x, y)| = m sqrt((x/m)^2 + (y/m)^2) with m = max(|x|, |y|). The formula is valid for any
// finite x and y.
inline double scaled_length(double x, double y) {
    const double most = std::max(std::abs(x), std::abs(y));
    return most > 0 ? most * length_of(x / most, y / most) : 0;
}

}  // namespace plate
