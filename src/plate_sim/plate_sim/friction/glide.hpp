// Time steps of discs that slide steadily, which is the most frequent case. The method is the
// explicit midpoint rule (see `stepping::midpoint`) with the friction from `disc::series`. The code
// processes several discs at the same time and has no branches. If a disc does not meet the
// conditions of the method in a step, `advance` computes this step.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/simd.hpp>

#include "friction/step.hpp"

namespace plate::gliding {

// Number of groups of parts whose calculations are interleaved. All these groups complete one stage
// of a step before the next stage begins. Therefore the processor need not wait for the square
// roots and sums of a single group.
constexpr int BLOCK = 16;

// Quantities of a group in the middle of a step:
// - x, y, turn: slip of the centre and relative spin
// - slip2: squared speed of the slip of the centre
// - edge2: the same as in `Group`
// - factor: `Group::dv` divided by the slip of the centre
// `force` and `torque` are the friction from `disc::series` in the present stage.
//
// Roots and quotients take long. Therefore they are computed as soon as the slip is known, and
// before the series, which does not need them.
struct Stages {
    double x[LANES], y[LANES], turn[LANES], slip2[LANES], edge2[LANES], factor[LANES];
    double force[LANES], torque[LANES];
};

}  // namespace plate::gliding

namespace plate {

// Set the constants of part i in its group. Return whether `glide` can advance the part. `step` is
// the length of a time step [s], and `on_plate` states whether the part is on the plate.
inline bool set_constants(const State& state, int i, const Body& body, double step, bool on_plate) {
    constexpr double never = std::numeric_limits<double>::quiet_NaN();
    const double dv = body.mu_g * step, minimum = stepping::DISC_STIFF / stepping::GENTLE * dv;
    const bool glides = on_plate && body.radius > 0 && body.is_uniform_disc();
    Group& group = state.group(i);
    const int lane = State::lane(i);
    group.dv[lane] = dv, group.minimum[lane] = glides && dv > 0 ? minimum * minimum : never;
    group.radius2[lane] = body.radius * body.radius, group.gyration2[lane] = body.gyration2;
    group.ratio[lane] = group.radius2[lane] / body.gyration2;
    group.off_plate[lane] = on_plate ? 0 : std::numeric_limits<double>::infinity();
    return glides;
}

// Set the slip of part i of a group at the start of a step.
[[gnu::always_inline]] inline void set_slip(Group& g, int i, const Slip& a) {
    g.slip[0][i] = a.x, g.slip[1][i] = a.y, g.slip[2][i] = a.spin;
    const double slip2 = a.x * a.x + a.y * a.y;
    g.size2[i] = slip2 + g.gyration2[i] * a.spin * a.spin;
    g.edge2[i] = g.radius2[i] * a.spin * a.spin / slip2;
    g.half_factor[i] = 0.5 * g.dv[i] / std::sqrt(slip2);
}

// Prepare all groups for a sequence of calls of `glide`, the first of which begins at `plate`.
[[gnu::always_inline]] inline void begin_glide(const PlateSample& plate, std::span<Group> groups) {
    for (Group& g : groups) {
#pragma omp simd
        for (int i = 0; i < LANES; i++)
            set_slip(g, i, stepping::slip(plate, g.state[X][i], g.state[Y][i], g.state[VX][i],
                                          g.state[VY][i], g.state[SPIN][i]));
    }
}

// Advance all discs that slide steadily by one time step. Return the number of these discs. If all
// discs slide steadily, the next step can follow at once, because the slip at the end of a step is
// the slip at the start of the next step. Otherwise call `begin_glide` before the next step.
//
// `plate` contains samples of the plate's motion at the start, in the middle and at the end of the
// step. `step` is the length of the step [s]. For other parts, intermediate values may be NaN or
// infinite, but their states do not change.
[[gnu::always_inline]] inline int glide(const PlateSample* plate, double step,
                                        const GroundEffect& ground, std::span<Group> groups) {
    using namespace gliding;
    using namespace stepping;
    const double fall_x = step * ground.gravity_x, fall_y = step * ground.gravity_y;
    const double half = 0.5 * step;
    double counts[LANES] = {};
    Stages stages[BLOCK];
    for (; !groups.empty(); groups = groups.subspan(std::min<size_t>(BLOCK, groups.size()))) {
        const int count = std::min<int>(BLOCK, groups.size());
        for (int k = 0; k < count; k++) {
            Stages& s = stages[k];
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const disc::DiscFriction friction = disc::series(groups[k].edge2[i]);
                s.force[i] = friction.force, s.torque[i] = friction.torque;
            }
        }
        for (int k = 0; k < count; k++) {
            const Group& g = groups[k];
            Stages& s = stages[k];
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const double vx = g.state[VX][i], vy = g.state[VY][i];
                const Slip free = slip(plate[1], g.state[X][i] + half * vx,
                                       g.state[Y][i] + half * vy, vx, vy, g.state[SPIN][i]);
                s.x[i] = free.x - 0.5 * fall_x - g.half_factor[i] * s.force[i] * g.slip[0][i];
                s.y[i] = free.y - 0.5 * fall_y - g.half_factor[i] * s.force[i] * g.slip[1][i];
                s.turn[i] = free.spin - g.half_factor[i] * s.torque[i] * g.ratio[i] * g.slip[2][i];
                s.slip2[i] = s.x[i] * s.x[i] + s.y[i] * s.y[i];
                s.edge2[i] = g.radius2[i] * s.turn[i] * s.turn[i] / s.slip2[i];
                s.factor[i] = g.dv[i] / std::sqrt(s.slip2[i]);
            }
        }
        for (int k = 0; k < count; k++) {
            Stages& s = stages[k];
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const disc::DiscFriction friction = disc::series(s.edge2[i]);
                s.force[i] = friction.force, s.torque[i] = friction.torque;
            }
        }
        for (int k = 0; k < count; k++) {
            Group& g = groups[k];
            const Stages& s = stages[k];
            // The loop writes the new states to a buffer. If the loop wrote to `g.state`, the
            // compiler would use masked stores, which are slow.
            double next[6][LANES];
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const double x = g.state[X][i], y = g.state[Y][i], angle = g.state[ANGLE][i];
                const double vx = g.state[VX][i], vy = g.state[VY][i], spin = g.state[SPIN][i];
                const double g2 = g.gyration2[i];
                const Slip a{g.slip[0][i], g.slip[1][i], g.slip[2][i]};
                const Slip b{s.x[i], s.y[i], s.turn[i]};
                const double ux = vx + fall_x + s.factor[i] * s.force[i] * b.x;
                const double uy = vy + fall_y + s.factor[i] * s.force[i] * b.y;
                const double uc = spin + s.factor[i] * s.torque[i] * g.ratio[i] * b.spin;
                const double px = x + half * (vx + ux), py = y + half * (vy + uy);
                const Slip z = slip(plate[2], px, py, ux, uy, uc);
                const double size2 = g.size2[i], edge2 = std::max(g.edge2[i], s.edge2[i]);
                set_slip(g, i, z);
                // Check that the disc slides fast enough, and nearly in one direction (see
                // `same_direction`). Like `size2`, the products `middle2` and `end2` are equal to
                // `dot` of a slip with itself.
                const double middle2 = s.slip2[i] + g2 * b.spin * b.spin, end2 = g.size2[i];
                const double ab = dot(a, b, g2), az = dot(a, z, g2);
                const double alignment =
                    std::min(ab * std::abs(ab) - STEADY * STEADY * size2 * middle2,
                             az * std::abs(az) - STEADY * STEADY * size2 * end2);
                const bool steady = (std::min(size2, middle2) >= g.minimum[i]) &
                                    (edge2 <= disc::SERIES) & (alignment > 0);
                g.glided[i] = steady ? 1.0 : 0.0;
                counts[i] += g.glided[i];
                next[X][i] = steady ? px : x;
                next[Y][i] = steady ? py : y;
                next[ANGLE][i] = steady ? angle + half * (spin + uc) : angle;
                next[VX][i] = steady ? ux : vx;
                next[VY][i] = steady ? uy : vy;
                next[SPIN][i] = steady ? uc : spin;
            }
            for (int row = 0; row < 6; row++) {
                Four values;
                load(values, next[row]), store(values, g.state[row]);
            }
        }
    }
    return static_cast<int>(counts[0] + counts[1] + counts[2] + counts[3]);
}

}  // namespace plate
