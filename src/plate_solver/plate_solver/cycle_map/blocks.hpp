// C++ kernels of blocks.py, which computes the motion of the parts during one cycle (cycle map) and
// its adjoint. The parts are processed in blocks of LANES parts.
//
// Single precision doubles the number of parts per vector instruction. The rounding error of a
// position is below 1e-7 m. After a search, its result is evaluated again in double precision.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/simd.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

constexpr int LANES = 8;
constexpr int STATE = 5 * LANES, TRACE = 5 * LANES;

namespace blocks {

// Offsets in the state of a block: position [m], velocity [m/s], and mu g dt [m/s]. The last value
// is the maximum velocity change that friction causes in a time step.
constexpr int X = 0, Y = LANES, VX = 2 * LANES, VY = 3 * LANES, BOUND = 4 * LANES;

// Offsets in the data that `trace` stores for each time step and block. The data are the derivative
// D of the velocity change with respect to the slip velocity, and the vector from the plate's
// centre to the part [m].
constexpr int XX = 0, XY = LANES, YY = 2 * LANES, ARM_X = 3 * LANES, ARM_Y = 4 * LANES;

// Value that is added to the squared slip velocity [m2/s2], to prevent 0/0 if the slip is zero.
constexpr float TINY = 1e-30f;

}  // namespace blocks

// Integrates the motion of the parts over n time steps. `state` (b, STATE) contains b blocks of
// parts. `pose` and `twist` (n, 3) are the plate's pose and twist in each step. The data for
// `adjoint` are written to `steps` (n, b, TRACE).
PLATE_WIDE inline void trace(View<float, 2> state, SamplesOf<float> pose, SamplesOf<float> twist,
                             float dt, View<float, 3> steps) {
    using namespace blocks;
    for (int k = 0; k < twist.count; k++) {
        const float px = pose(k, 0), py = pose(k, 1);
        const float u = twist(k, 0), v = twist(k, 1), w = twist(k, 2);
        for (int block = 0; block < state.size(0); block++) {
            float* __restrict parts = state[block];
            float* __restrict step = &steps(k, block, 0);
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const float rx = parts[X + i] - px, ry = parts[Y + i] - py;
                const float dx = u - w * ry - parts[VX + i], dy = v + w * rx - parts[VY + i];
                const float inverse = 1 / std::sqrt(dx * dx + dy * dy + TINY);
                float gain = parts[BOUND + i] * inverse;
                const float slips = gain < 1 ? 1.0f : 0.0f;
                gain = std::min(gain, 1.0f);
                const float a = dx * inverse * slips;  // unit vector of the slip
                const float b = dy * inverse * slips;
                step[XX + i] = gain * (1 - a * a);
                step[XY + i] = -gain * a * b;
                step[YY + i] = gain * (1 - b * b);
                step[ARM_X + i] = rx, step[ARM_Y + i] = ry;
                const float vx = parts[VX + i] + gain * dx, vy = parts[VY + i] + gain * dy;
                parts[VX + i] = vx, parts[VY + i] = vy;
                parts[X + i] += dt * vx, parts[Y + i] += dt * vy;
            }
        }
    }
}

// Computes the derivatives (bins, b, 2, 3 LANES) of the final positions with respect to the plate's
// twist. The positions are extrapolated with the final velocity by `coast` [s]. The derivatives
// include the change of the pose, because the pose is the integral of the twist. The steps are
// divided into bins of equal size. Each derivative is the sum over the steps of a bin.
// `end_state_gradient` (stick_slip.hpp) describes the equations of the backward pass. Here, (x, y)
// and (vx, vy) are the derivatives with respect to the part's position and velocity.
PLATE_WIDE inline void adjoint(View<const float, 3> steps, SamplesOf<float> twist, float dt,
                               float coast, View<float, 4> by_twist) {
    using namespace blocks;
    const int bins = by_twist.size(0), bin_steps = twist.count / bins;
    for (int block = 0; block < steps.size(1); block++)
        for (int axis = 0; axis < 2; axis++) {
            const Eight end_x = Eight{} + (axis == 0 ? 1.0f : 0.0f);
            const Eight end_y = Eight{} + (axis == 1 ? 1.0f : 0.0f);
            Eight x = end_x, y = end_y, vx = coast * x, vy = coast * y;
            for (int bin = bins - 1; bin >= 0; bin--) {
                Eight on_u{}, on_v{}, on_w{};
                for (int k = (bin + 1) * bin_steps - 1; k >= bin * bin_steps; k--) {
                    const float w = twist(k, 2);
                    const float* step = &steps(k, block, 0);
                    Eight xx, xy, yy, arm_x, arm_y;
                    load(xx, step + XX), load(xy, step + XY), load(yy, step + YY);
                    load(arm_x, step + ARM_X), load(arm_y, step + ARM_Y);
                    const Eight cx = vx + dt * x, cy = vy + dt * y;
                    const Eight gx = xx * cx + xy * cy, gy = xy * cx + yy * cy;
                    vx = cx - gx, vy = cy - gy;
                    // The twist of this step also shifts the plate in all later steps. For the
                    // motion relative to the plate, such a shift has the same effect as the
                    // opposite shift of the part. Therefore `end_x` minus `x` is the derivative
                    // with respect to a plate shift in x. Half of this step's own contribution,
                    // `more_x`, belongs to the time after the middle of the step.
                    const Eight more_x = w * gy, more_y = w * gx;
                    on_u += gx + dt * (end_x - x - 0.5f * more_x);
                    on_v += gy + dt * (end_y - y + 0.5f * more_y);
                    on_w += arm_x * gy - arm_y * gx;
                    x += more_x, y -= more_y;
                }
                float* on_twist = &by_twist(bin, block, axis, 0);
                store(on_u, on_twist), store(on_v, on_twist + LANES);
                store(on_w, on_twist + 2 * LANES);
            }
        }
}

}  // namespace plate
