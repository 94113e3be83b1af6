// Effects of the plate's surface that a constant friction coefficient does not describe. ground.py
// describes these effects.
#pragma once

#include <algorithm>

namespace plate {

// Compiled counterpart of `GroundEffect` in ground.py.
struct GroundEffect {
    double gravity_x, gravity_y, static_ratio, slope, heave;

    // Return the dynamic friction at a slip speed [m/s], as a fraction of the friction at zero slip
    // (see `Ground.friction_slope`).
    double friction_factor(double slip) const {
        return slope < 0 ? 1 / (1 - slope * slip) : 1 + slope * slip;
    }

    // Return the weight of a part at a plate acceleration along x [m/s2], as a fraction of the
    // weight at rest (see `Ground.heave`).
    double weight(double accel) const { return std::max(0.0, 1 + heave * accel); }

    // Whether friction is independent of the slip and of the plate's motion.
    bool is_constant() const { return slope == 0 && heave == 0; }
};

}  // namespace plate
