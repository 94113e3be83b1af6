// How the plate carries parts, beyond one friction coefficient.
#pragma once

namespace plate {

// What `GroundEffect` of ground.py says.
struct GroundEffect {
    double gravity_x, gravity_y, static_ratio, slope;

    // Dynamic friction at a slip [m/s] over that at none: see `Ground.friction_slope`.
    double share(double slip) const {
        return slope < 0 ? 1 / (1 - slope * slip) : 1 + slope * slip;
    }
};

}  // namespace plate
