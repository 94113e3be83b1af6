// C++ kernel of filter.py, which predicts the states of the parts.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

// Value that is added to a denominator, to prevent a division by zero if the slip is zero.
constexpr double TINY = 1e-300;

// Number of states that vector instructions propagate together. The last group is filled with
// states that do not move.
constexpr int LANES = 8;

// Propagates states (K, 5) in place by implicit Coulomb steps. The columns are x, y [m] and vx, vy
// [m/s]. The fifth column is not changed. One step of length dt is
//     d = surface - v
//     v += d min(1, bound dt / |d|)
//     x += v dt
// Here, d is the slip, and `surface` is the velocity of the plate at the part.
//
// `bound` (K,) is mu g [m/s2], above 0. `pose` and `twist` (n, 3) are the pose and twist of the
// plate at the middles of n steps of length dt [s]. Each state is propagated from the time `begin`
// to the time `end` (K,) [s since the start of the first step].
PLATE_WIDE inline void stick_slip(View<double, 2> state, const double* bound, Samples pose,
                                  Samples twist, const double* begin, const double* end,
                                  double dt) {
    const int count = state.size(0), lanes = (count + LANES - 1) / LANES * LANES;
    Matrix own(7, lanes);
    for (int i = 0; i < count; i++) {
        for (int c = 0; c < 4; c++) own[c][i] = state(i, c);
        own[4][i] = bound[i], own[5][i] = begin[i], own[6][i] = end[i];
    }
    double *__restrict x = own[0], *__restrict y = own[1];
    double *__restrict vx = own[2], *__restrict vy = own[3];
    const double *__restrict max_accel = own[4], *__restrict from = own[5];
    const double* __restrict to = own[6];
    for (int k = 0; k < twist.count; k++) {
        const double along = twist(k, 0), across = twist(k, 1), turn = twist(k, 2);
        const double centre_x = pose(k, 0), centre_y = pose(k, 1);
        const double first = k * dt, last = (k + 1) * dt;
        for (int block = 0; block < lanes; block += LANES)
#pragma omp simd
            for (int i = block; i < block + LANES; i++) {
                const double h = std::max(std::min(last, to[i]) - std::max(first, from[i]), 0.0);
                const double maximum = max_accel[i] * h;
                const double dx = along - turn * (y[i] - centre_y) - vx[i];
                const double dy = across + turn * (x[i] - centre_x) - vy[i];
                const double fraction =
                    maximum / std::max(std::sqrt(dx * dx + dy * dy), maximum + TINY);
                vx[i] += fraction * dx;
                vy[i] += fraction * dy;
                x[i] += h * vx[i];
                y[i] += h * vy[i];
            }
    }
    for (int i = 0; i < count; i++)
        for (int c = 0; c < 4; c++) state(i, c) = own[c][i];
}

}  // namespace plate
