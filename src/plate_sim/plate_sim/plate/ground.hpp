// How the plate carries parts, beyond one friction coefficient.
#pragma once

#include <algorithm>

namespace plate {

// What `GroundEffect` of ground.py says.
struct GroundEffect {
    double gravity_x, gravity_y, static_ratio, slope, heave;

    // Dynamic friction at a slip [m/s] over that at none: see `Ground.friction_slope`.
    double share(double slip) const {
        return slope < 0 ? 1 / (1 - slope * slip) : 1 + slope * slip;
    }

    // Weight on a plate that accelerates [m/s2] along x over that at rest: see `Ground.heave`.
    double weight(double accel) const { return std::max(0.0, 1 + heave * accel); }

    // Whether friction is the same at each slip and each motion of the plate.
    bool even() const { return slope == 0 && heave == 0; }
};

}  // namespace plate
