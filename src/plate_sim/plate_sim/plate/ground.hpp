// Surface effects beyond one friction coefficient, as described in ground.py.
#pragma once

#include <algorithm>

namespace plate {

// Compiled counterpart of `GroundEffect` in ground.py.
struct GroundEffect {
    double gravity_x, gravity_y, static_ratio, slope, heave;

    // Dynamic friction at a slip [m/s], as a fraction of the friction at zero slip. See
    // `Ground.friction_slope`.
    double share(double slip) const {
        return slope < 0 ? 1 / (1 - slope * slip) : 1 + slope * slip;
    }

    // Weight at a plate acceleration along x [m/s2], as a fraction of the weight at rest. See
    // `Ground.heave`.
    double weight(double accel) const { return std::max(0.0, 1 + heave * accel); }

    // Whether friction is independent of the slip and of the plate's motion.
    bool even() const { return slope == 0 && heave == 0; }
};

}  // namespace plate
