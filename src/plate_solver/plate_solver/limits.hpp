// C++ kernels of limits.py, which computes the utilisation of the rig's limits by a sampled motion.
// The utilisation is the ratio of a value to its limit.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/simd.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

constexpr int MOTORS = 4;

// SEARCH_USE is the largest permitted fraction of the rig's limits in a search. CYCLE_USE is the
// largest permitted fraction for a finished cycle. limits.py lists all such fractions.
constexpr double SEARCH_USE = 0.98, CYCLE_USE = 0.999;

// The rig's limits, or a fraction of these limits.
struct Limits {
    double motors[MOTORS][2][2];  // point of application [m] and direction of each motor
    double half[2];               // half side lengths of the plate [m]
    double stroke_m, speed, accel, arm_m;
    double levers[MOTORS][3];    // derivative of each motor's travel with respect to the pose
    double loads[3][MOTORS][3];  // motor force / peak force, per pose, twist and acceleration
    double heat;                 // peak force divided by continuous force
    bool forceful;               // whether force or heat can limit a motion
};

[[gnu::always_inline]] inline void keep_greatest(Four& maximum, const Four& value) {
    const Four size = value < 0 ? -value : value;
    maximum = size > maximum ? size : maximum;
}

inline double greatest(const Four& value) {
    return std::max(std::max(value[0], value[1]), std::max(value[2], value[3]));
}

// Returns the largest utilisation of the limits of stroke, speed and acceleration. A utilisation of
// 1 means exactly at the limit. The file limits.py defines these three ratios. R is the rotation
// matrix for the plate's angle theta. If `linear` is true, the displacement R p - p of a point p is
// linearised at theta = 0. Vector instructions compute the four motors together, and the four
// corners together.
PLATE_WIDE inline double motion_use(Samples pose, Samples twist, Samples accel,
                                    const Limits& limits, bool linear) {
    Four px, py, ex, ey, corner_x, corner_y, stroke{}, speed{}, peak{};
    for (int i = 0; i < MOTORS; i++) {
        px[i] = limits.motors[i][0][0], py[i] = limits.motors[i][0][1];
        ex[i] = limits.motors[i][1][0], ey[i] = limits.motors[i][1][1];
        corner_x[i] = i & 2 ? limits.half[0] : -limits.half[0];
        corner_y[i] = i & 1 ? limits.half[1] : -limits.half[1];
    }
    for (int k = 0; k < pose.count; k++) {
        const double angle = pose(k, 2), spin = twist(k, 2), spin_rate = accel(k, 2);
        double s = 0, c = 1;
        // For angles below 0.1 rad, Taylor series replace sine and cosine. The error of these
        // series is about 1e-9.
        if (!linear && std::abs(angle) < 0.1) {
            s = angle * (1 - angle * angle * (1.0 / 6 - angle * angle / 120));
            c = 1 - angle * angle * (0.5 - angle * angle / 24);
        } else if (!linear) {
            s = std::sin(angle), c = std::cos(angle);
        }
        const double tilt = linear ? angle : s;
        const Four along = ex * (c * px - tilt * py - px) + ey * (tilt * px + c * py - py);
        const Four across = ey * (c * px - s * py) - ex * (s * px + c * py);
        keep_greatest(stroke, ex * pose(k, 0) + ey * pose(k, 1) + along);
        keep_greatest(speed, ex * twist(k, 0) + ey * twist(k, 1) + spin * across);
        const Four x = c * corner_x - s * corner_y, y = s * corner_x + c * corner_y;
        const Four ax = accel(k, 0) - spin_rate * y - spin * spin * x;
        const Four ay = accel(k, 1) + spin_rate * x - spin * spin * y;
        keep_greatest(peak, ax * ax + ay * ay);
    }
    return std::max({greatest(stroke) / limits.stroke_m, greatest(speed) / limits.speed,
                     std::sqrt(greatest(peak)) / limits.accel});
}

// Returns the largest utilisation of the motors' peak force and continuous force. A utilisation of
// 1 means exactly at the limit. The file limits.py defines these two ratios. Vector instructions
// compute the four motors together.
PLATE_WIDE inline double force_use(Samples pose, Samples twist, Samples accel,
                                   View<const double, 1> weight, const Limits& limits) {
    Four loads[3][3], maximum{}, square{};
    for (int order = 0; order < 3; order++)
        for (int c = 0; c < 3; c++)
            for (int i = 0; i < MOTORS; i++) loads[order][c][i] = limits.loads[order][i][c];
    double total = 0;
    for (int k = 0; k < pose.count; k++) {
        const double sample_weight = weight(k % weight.size(0));
        Four force{};
        for (int c = 0; c < 3; c++) {
            force += loads[0][c] * pose(k, c) + loads[1][c] * twist(k, c);
            force += loads[2][c] * accel(k, c);
        }
        keep_greatest(maximum, force);
        square += sample_weight * force * force;
        total += sample_weight;
    }
    const double hottest = std::max(0.0, greatest(square / total));
    return std::max(greatest(maximum), limits.heat * std::sqrt(hottest));
}

// Returns the largest utilisation of any rig limit by the samples (n, 3) of a motion. A utilisation
// of 1 means exactly at the limit. The weight of a sample is the relative duration that it
// represents. The weights `weight` (m,) repeat after m samples.
inline double limit_use(Samples pose, Samples twist, Samples accel, View<const double, 1> weight,
                        const Limits& limits, bool linear) {
    const double used = motion_use(pose, twist, accel, limits, linear);
    if (!limits.forceful) return used;
    return std::max(used, force_use(pose, twist, accel, weight, limits));
}

}  // namespace plate
