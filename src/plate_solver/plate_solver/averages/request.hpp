// C++ kernels of request.py, which checks a request for average forces on the parts.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/length.hpp>
#include <plate/view.hpp>

namespace plate {

// Maximum accepted coordinate [m] and velocity [m/s] of a part. The file request.py imports both
// constants.
constexpr double FARTHEST_M = 1e3, FASTEST_MPS = 1e3;

// Compiled counterpart of `RequestFlags` in request.py.
struct RequestFlags {
    bool is_valid = true, parts_move = false, has_curl = false, has_tolerance = false;
    bool zero_is_enough = true;
    double max_force = 0;
};

// Computes the flags of a request with position, force, velocity, tolerance (M, 2) and curl (M,).
inline RequestFlags request_flags(View<const double, 2> position, View<const double, 2> force,
                                  View<const double, 2> velocity, View<const double, 1> curl,
                                  View<const double, 2> tolerance) {
    RequestFlags flags;
    for (int i = 0; i < force.size(0); i++) {
        flags.has_curl |= !std::isnan(curl(i));
        flags.is_valid &= !std::isinf(curl(i));
        double minimum = 0;
        for (int axis = 0; axis < 2; axis++) {
            const double requested = std::abs(force(i, axis)), free = tolerance(i, axis);
            flags.is_valid &= std::abs(position(i, axis)) <= FARTHEST_M;
            flags.is_valid &= std::abs(velocity(i, axis)) <= FASTEST_MPS;
            flags.is_valid &= std::isfinite(requested) && free >= 0;
            flags.parts_move |= velocity(i, axis) != 0;
            flags.has_tolerance |= free != 0;
            flags.zero_is_enough &= requested <= free;
            // `minimum` is the length of the vector (|force x| - tolerance x, |force y| - tolerance
            // y), where negative components count as 0. `scaled_length` avoids an overflow.
            minimum = scaled_length(minimum, std::max(requested - free, 0.0));
        }
        flags.max_force = std::max(flags.max_force, minimum);
    }
    return flags;
}

}  // namespace plate
