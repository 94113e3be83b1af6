// How the plate carries parts, beyond one friction coefficient.
#pragma once

namespace plate {

// Gravity along the plate [m/s2, plate_home], and static over dynamic friction.
struct GroundEffect {
    double gravity_x, gravity_y, static_ratio;
};

}  // namespace plate
