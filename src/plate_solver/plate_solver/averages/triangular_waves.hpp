// Closed form of the force map for triangular waves: kernels of triangular_waves.py.
#pragma once
#include <cmath>

#include <plate/length.hpp>

#include "averages/mean_force.hpp"

namespace plate {

// Relative tolerance of two special cases. In the first case, the component of the slip across its
// change counts as 0, so that the slip reverses at once. In the second case, the change of the slip
// counts as 0.
constexpr double STRAIGHT = 1e-12;

// Mean direction of a slip that changes linearly from p to q: equation (20). The integral of the
// component along the change is the difference of the magnitudes of q and p. The integral of the
// component across the change is a logarithm, which is computed by asinh without cancellation.
inline Force mean_direction_between(Force p, Force q) {
    const double first = length_of(p.x, p.y), last = length_of(q.x, q.y);
    const double dx = q.x - p.x, dy = q.y - p.y, change = length_of(dx, dy);
    if (change <= STRAIGHT * (first + last))
        return first > 0 ? Force{p.x / first, p.y / first} : Force{0, 0};
    const double ex = dx / change, ey = dy / change;
    const double along_p = ex * p.x + ey * p.y, along_q = ex * q.x + ey * q.y;
    const double across = ex * p.y - ey * p.x, size = std::abs(across);
    const double mean_along = (last - first) / change;
    double mean_across = 0;
    if (size > STRAIGHT * change)
        mean_across = across * (std::asinh(along_q / size) - std::asinh(along_p / size)) / change;
    return {ex * mean_along - ey * mean_across, ey * mean_along + ex * mean_across};
}

// Average forces (C, 2) [mu m g] of C cases. Each case has one motion (2 N, 3) and one part at
// rest. kinks (K + 1, 2 N): values of the waves at their kinks. shares (K,): lengths of the
// intervals as fractions of the period.
inline void triangular_forces(View<const double, 3> coefficients, View<const double, 2> position,
                              View<const double, 2> kinks, const double* shares,
                              View<double, 2> force) {
    for (int i = 0; i < coefficients.size(0); i++) {
        const double x = position(i, 0), y = position(i, 1);
        Force total{0, 0}, p{0, 0};
        for (int k = 0; k < kinks.size(0); k++) {
            Force q{0, 0};
            for (int j = 0; j < kinks.size(1); j++) {
                const double spin = coefficients(i, j, 2);
                q.x += kinks(k, j) * (coefficients(i, j, 0) - y * spin);
                q.y += kinks(k, j) * (coefficients(i, j, 1) + x * spin);
            }
            if (k > 0) {
                const Force mean = mean_direction_between(p, q);
                total.x += shares[k - 1] * mean.x;
                total.y += shares[k - 1] * mean.y;
            }
            p = q;
        }
        force(i, 0) = total.x, force(i, 1) = total.y;
    }
}

}  // namespace plate
