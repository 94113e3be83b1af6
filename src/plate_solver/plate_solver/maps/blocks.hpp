// The cycle map in blocks of LANES parts, and its adjoint: kernels of blocks.py.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/four.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

constexpr int LANES = 16;
constexpr int STATE = 5 * LANES, TRACE = 5 * LANES;

namespace blocks {

// Rows of a state: place [m], velocity [m/s], mu g dt [m/s].
constexpr int X = 0, Y = LANES, VX = 2 * LANES, VY = 3 * LANES, BOUND = 4 * LANES;

// Rows of a trace: the derivative of the velocity's change by the slip, and the way from the plate
// to the part [m].
constexpr int XX = 0, XY = LANES, YY = 2 * LANES, ARM_X = 3 * LANES, ARM_Y = 4 * LANES;

// Keeps 0/0 away [m2/s2].
constexpr double TINY = 1e-30;

// Lanes are reckoned with by so many, and only where there are parts.
constexpr int GROUP = 8;

}  // namespace blocks

// How many lanes of a block have parts.
inline int lanes_used(int parts, int block) { return std::min(LANES, parts - block * LANES); }

// Move parts (b, STATE) through samples (n, 3) of the plate's motion; write down in (n, b, TRACE)
// what `adjoint` needs.
PLATE_WIDE inline void trace(View<double, 2> state, int parts, Samples pose, Samples twist,
                             double dt, View<double, 3> steps) {
    using namespace blocks;
    for (int k = 0; k < twist.count; k++) {
        const double px = pose(k, 0), py = pose(k, 1);
        const double u = twist(k, 0), v = twist(k, 1), w = twist(k, 2);
        for (int block = 0; block < state.size(0); block++) {
            double* __restrict own = state[block];
            double* __restrict step = &steps(k, block, 0);
            for (int lane = 0; lane < lanes_used(parts, block); lane += GROUP)
#pragma omp simd
                for (int i = lane; i < lane + GROUP; i++) {
                    const double rx = own[X + i] - px, ry = own[Y + i] - py;
                    const double dx = u - w * ry - own[VX + i], dy = v + w * rx - own[VY + i];
                    const double inverse = 1 / std::sqrt(dx * dx + dy * dy + TINY);
                    double gain = own[BOUND + i] * inverse;
                    const double slips = gain < 1 ? 1.0 : 0.0;
                    gain = std::min(gain, 1.0);
                    const double a = dx * inverse * slips;  // unit vector of a slip
                    const double b = dy * inverse * slips;
                    step[XX + i] = gain * (1 - a * a);
                    step[XY + i] = -gain * a * b;
                    step[YY + i] = gain * (1 - b * b);
                    step[ARM_X + i] = rx, step[ARM_Y + i] = ry;
                    const double vx = own[VX + i] + gain * dx, vy = own[VY + i] + gain * dy;
                    own[VX + i] = vx, own[VY + i] = vy;
                    own[X + i] += dt * vx, own[Y + i] += dt * vy;
                }
        }
    }
}

// Derivatives of where parts would be if they kept their last velocity for `coast` [s], by twist
// (bins, b, 2, 3 LANES) and pose (bins, b, 2, 2 LANES): each the sum over a bin of as many steps.
PLATE_WIDE inline void adjoint(View<const double, 3> steps, int parts, Samples twist, double dt,
                               double coast, View<double, 4> by_twist, View<double, 4> by_pose) {
    using namespace blocks;
    const int bins = by_twist.size(0), each = twist.count / bins;
    for (int block = 0; block < steps.size(1); block++)
        for (int axis = 0; axis < 2; axis++) {
            alignas(64) double own[4 * LANES] = {};
            std::fill_n(own + axis * LANES, LANES, 1.0);
            std::fill_n(own + (2 + axis) * LANES, LANES, coast);
            for (int bin = bins - 1; bin >= 0; bin--)
                for (int lane = 0; lane < lanes_used(parts, block); lane += 4) {
                    Four x, y, vx, vy, on_u{}, on_v{}, on_w{}, on_x{}, on_y{};
                    load(x, own + X + lane), load(y, own + Y + lane);
                    load(vx, own + VX + lane), load(vy, own + VY + lane);
                    for (int k = (bin + 1) * each - 1; k >= bin * each; k--) {
                        const double w = twist(k, 2);
                        const double* step = &steps(k, block, lane);
                        Four xx, xy, yy, arm_x, arm_y;
                        load(xx, step + XX), load(xy, step + XY), load(yy, step + YY);
                        load(arm_x, step + ARM_X), load(arm_y, step + ARM_Y);
                        const Four cx = vx + dt * x, cy = vy + dt * y;
                        const Four gx = xx * cx + xy * cy, gy = xy * cx + yy * cy;
                        vx = cx - gx, vy = cy - gy;
                        x += w * gy, y -= w * gx;
                        on_u += gx, on_v += gy, on_w += arm_x * gy - arm_y * gx;
                        on_x -= w * gy, on_y += w * gx;
                    }
                    store(x, own + X + lane), store(y, own + Y + lane);
                    store(vx, own + VX + lane), store(vy, own + VY + lane);
                    double* on_twist = &by_twist(bin, block, axis, lane);
                    double* on_pose = &by_pose(bin, block, axis, lane);
                    store(on_u, on_twist), store(on_v, on_twist + LANES);
                    store(on_w, on_twist + 2 * LANES);
                    store(on_x, on_pose), store(on_y, on_pose + LANES);
                }
        }
}

}  // namespace plate
