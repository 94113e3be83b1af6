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

// Quantities of a group at the start (prefix a) and in the middle (prefix b) of a step:
// - ax, ay, ac: slip of the centre and relative spin
// - a2: squared speed of the slip of the centre
// - ak2: squared ratio of the slip at the edge due to rotation to the slip speed of the centre
// `force` and `torque` are the friction from `disc::series` in the present stage.
struct Stages {
    double ax[LANES], ay[LANES], ac[LANES], a2[LANES], ak2[LANES];
    double bx[LANES], by[LANES], bc[LANES], b2[LANES], bk2[LANES];
    double force[LANES], torque[LANES];
};

}  // namespace plate::gliding

namespace plate {

// Set the constants of part i in its group. Return whether `glide` can advance the part. `step` is
// the length of a time step [s], and `here` states whether the part is on the plate.
inline bool describe(const State& state, int i, const Body& body, double step, bool here) {
    constexpr double none = std::numeric_limits<double>::infinity();
    const double dv = body.mu_g * step, minimum = stepping::DISC_STIFF / stepping::GENTLE * dv;
    const bool glides = here && body.radius > 0 && body.even();
    Group& group = state.group(i);
    const int lane = State::lane(i);
    group.dv[lane] = dv, group.minimum[lane] = glides && dv > 0 ? minimum * minimum : none;
    group.radius2[lane] = body.radius * body.radius, group.gyration2[lane] = body.gyration2;
    group.ratio[lane] = group.radius2[lane] / body.gyration2;
    group.away[lane] = here ? 0 : none;
    return glides;
}

// Advance all discs that slide steadily by one time step. Return the number of these discs.
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
    double all[LANES] = {};
    Stages stages[BLOCK];
    for (; !groups.empty(); groups = groups.subspan(std::min<size_t>(BLOCK, groups.size()))) {
        const int count = std::min<int>(BLOCK, groups.size());
        for (int k = 0; k < count; k++) {
            const Group& g = groups[k];
            Stages& s = stages[k];
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const Slip a = slip(plate[0], g.state[X][i], g.state[Y][i], g.state[VX][i],
                                    g.state[VY][i], g.state[SPIN][i]);
                s.ax[i] = a.x, s.ay[i] = a.y, s.ac[i] = a.turn;
                s.a2[i] = a.x * a.x + a.y * a.y;
                s.ak2[i] = g.radius2[i] * a.turn * a.turn / s.a2[i];
            }
        }
        for (int k = 0; k < count; k++) {
            Stages& s = stages[k];
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const disc::Push push = disc::series(s.ak2[i]);
                s.force[i] = push.force, s.torque[i] = push.torque;
            }
        }
        for (int k = 0; k < count; k++) {
            const Group& g = groups[k];
            Stages& s = stages[k];
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const double vx = g.state[VX][i], vy = g.state[VY][i];
                const double share = 0.5 * g.dv[i] / std::sqrt(s.a2[i]);
                const Slip free = slip(plate[1], g.state[X][i] + half * vx,
                                       g.state[Y][i] + half * vy, vx, vy, g.state[SPIN][i]);
                s.bx[i] = free.x - 0.5 * fall_x - share * s.force[i] * s.ax[i];
                s.by[i] = free.y - 0.5 * fall_y - share * s.force[i] * s.ay[i];
                s.bc[i] = free.turn - share * s.torque[i] * g.ratio[i] * s.ac[i];
                s.b2[i] = s.bx[i] * s.bx[i] + s.by[i] * s.by[i];
                s.bk2[i] = g.radius2[i] * s.bc[i] * s.bc[i] / s.b2[i];
            }
        }
        for (int k = 0; k < count; k++) {
            Stages& s = stages[k];
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const disc::Push push = disc::series(s.bk2[i]);
                s.force[i] = push.force, s.torque[i] = push.torque;
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
                const Slip a{s.ax[i], s.ay[i], s.ac[i]}, b{s.bx[i], s.by[i], s.bc[i]};
                const double share = g.dv[i] / std::sqrt(s.b2[i]);
                const double ux = vx + fall_x + share * s.force[i] * b.x;
                const double uy = vy + fall_y + share * s.force[i] * b.y;
                const double uc = spin + share * s.torque[i] * g.ratio[i] * b.turn;
                const double px = x + half * (vx + ux), py = y + half * (vy + uy);
                const Slip z = slip(plate[2], px, py, ux, uy, uc);
                // Check that the disc slides fast enough, and nearly in one direction (see
                // `alike`). `size2` is equal to `dot(a, a, g2)`.
                const double size2 = s.a2[i] + g2 * a.turn * a.turn;
                const double middle2 = s.b2[i] + g2 * b.turn * b.turn, end2 = dot(z, z, g2);
                const double ab = dot(a, b, g2), az = dot(a, z, g2);
                const double turn = std::min(ab * std::abs(ab) - STEADY * STEADY * size2 * middle2,
                                             az * std::abs(az) - STEADY * STEADY * size2 * end2);
                const bool steady = (std::min(size2, middle2) >= g.minimum[i]) &
                                    (std::max(s.ak2[i], s.bk2[i]) <= disc::SERIES) & (turn > 0);
                g.moved[i] = steady ? 1.0 : 0.0;
                all[i] += g.moved[i];
                next[X][i] = steady ? px : x;
                next[Y][i] = steady ? py : y;
                next[ANGLE][i] = steady ? angle + half * (spin + uc) : angle;
                next[VX][i] = steady ? ux : vx;
                next[VY][i] = steady ? uy : vy;
                next[SPIN][i] = steady ? uc : spin;
            }
            for (int row = 0; row < 6; row++) {
                Four own;
                load(own, next[row]), store(own, g.state[row]);
            }
        }
    }
    return static_cast<int>(all[0] + all[1] + all[2] + all[3]);
}

}  // namespace plate
