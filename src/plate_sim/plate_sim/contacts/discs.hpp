// Collisions of two discs, and of a disc with a wall. The file impulses.hpp contains the general
// method. For discs, its result has a closed form.
//
// The normal impulse passes through the centre of a disc, so it does not rotate the disc. Friction
// between the edges does not change the speed at which the discs approach. Therefore one normal
// impulse J and one tangential impulse J_t are sufficient:
//
//     J = (1 + e) c / (1/m1 + 1/m2)
//     J_t = u / (1/m1 + 1/m2 + r1^2/I1 + r2^2/I2), limited to mu_c J
//
// - e: restitution
// - c: closing speed, which is the speed at which the discs approach each other
// - u: relative tangential speed at the contact
// - m1, m2 and I1, I2: masses and moments of inertia of the discs
// - r1, r2: distances of the contact from the centres
// - mu_c: friction coefficient between the edges
//
// Both impulses act at the time of the contact, which is within the time step.
#pragma once
#include <algorithm>
#include <cmath>

#include "contacts/impulses.hpp"

namespace plate::contacts {

// Change a part's velocity by `speed` [m/s] along n. The position changes as if the velocity had
// changed `elapsed` [s] earlier.
inline void change_velocity(const State& state, int i, double speed, double nx, double ny,
                            double elapsed) {
    state(VX, i) += speed * nx;
    state(VY, i) += speed * ny;
    state(X, i) += elapsed * speed * nx;
    state(Y, i) += elapsed * speed * ny;
}

// Change a part's spin by `spin` [rad/s]. The angle changes as if the spin had changed `elapsed`
// [s] earlier.
inline void change_spin(const State& state, int i, double spin, double elapsed) {
    state(SPIN, i) += spin;
    state(ANGLE, i) += elapsed * spin;
}

// Return the depth [m] of the overlap of two discs, or 0 if they do not overlap.
inline double overlap(const State& state, Bodies bodies, int i, int j) {
    const double dx = state(X, i) - state(X, j), dy = state(Y, i) - state(Y, j);
    const double size = bodies[i].radius + bodies[j].radius;
    const double overlap2 = size * size - dx * dx - dy * dy;
    return overlap2 > 0 ? overlap2 / (size + std::sqrt(dx * dx + dy * dy)) : 0.0;
}

// If two discs touch, apply their collision to the state. Return the depth [m] of their overlap.
// `step` is the length of the time step [s].
inline double collide_discs(const State& state, Bodies bodies, int i, int j, const Rules& rules,
                            double step) {
    double dx = state(X, i) - state(X, j), dy = state(Y, i) - state(Y, j);
    const double ri = bodies[i].radius, rj = bodies[j].radius, size = ri + rj;
    const double distance2 = dx * dx + dy * dy, overlap2 = size * size - distance2;
    if (overlap2 <= 0) return 0.0;
    const double wx = state(VX, i) - state(VX, j), wy = state(VY, i) - state(VY, j);
    const double closing = -(wx * dx + wy * dy);
    double distance = std::sqrt(distance2), elapsed = 0.0;
    const double depth = overlap2 / (size + distance);
    if (closing > 0) {  // solve |d - ago w| = size for the time since the first touch
        elapsed =
            overlap2 / (closing + std::sqrt(closing * closing + (wx * wx + wy * wy) * overlap2));
        const bool within = elapsed <= step;
        if (!within) elapsed = step;
        dx -= elapsed * wx, dy -= elapsed * wy;
        distance = within ? size : std::sqrt(dx * dx + dy * dy);
    } else if (depth <= KEPT) {
        return depth;
    }
    // If both centres coincide, the normal is arbitrary.
    const double nx = distance > 0 ? dx / distance : 1.0, ny = distance > 0 ? dy / distance : 0.0;
    const double mi = bodies[i].mass_inverse, mj = bodies[j].mass_inverse, inverse_mass = mi + mj;
    double remaining = depth - KEPT;
    if (closing > 0) {
        const double speed_change = (1 + rules.restitution) * std::max(0.0, -(wx * nx + wy * ny));
        remaining -= elapsed * speed_change;
        change_velocity(state, i, mi * speed_change / inverse_mass, nx, ny, elapsed);
        change_velocity(state, j, -mj * speed_change / inverse_mass, nx, ny, elapsed);
        if (rules.friction > 0) {
            const double arm = distance - ri;
            const double ti = mi * ri / bodies[i].gyration2, tj = mj * arm / bodies[j].gyration2;
            const double along = wy * nx - wx * ny - ri * state(SPIN, i) - arm * state(SPIN, j);
            const double maximum = rules.friction * speed_change / inverse_mass;
            const double tangential_impulse =
                std::min(std::max(-along / (inverse_mass + ri * ti + arm * tj), -maximum), maximum);
            change_velocity(state, i, mi * tangential_impulse, -ny, nx, elapsed);
            change_velocity(state, j, -mj * tangential_impulse, -ny, nx, elapsed);
            change_spin(state, i, -ti * tangential_impulse, elapsed);
            change_spin(state, j, -tj * tangential_impulse, elapsed);
        }
    }
    if (remaining > 0) {
        remaining /= inverse_mass;
        state(X, i) += mi * remaining * nx;
        state(Y, i) += mi * remaining * ny;
        state(X, j) -= mj * remaining * nx;
        state(Y, j) -= mj * remaining * ny;
    }
    return depth;
}

// Apply the collision of a disc with a wall to the state. `depth` [m] is the overlap of the disc
// and the wall. The vector n is the wall's inward normal. The last entry of the state is the
// plate's pose and twist.
inline void collide_with_wall(const State& state, Bodies bodies, int i, double depth, double nx,
                              double ny, const Rules& rules, double step) {
    const int wall = state.walls();
    const double radius = bodies[i].radius;
    const double rx = state(X, i) - state(X, wall), ry = state(Y, i) - state(Y, wall);
    double wx = state(VX, i) - state(VX, wall), wy = state(VY, i) - state(VY, wall);
    const double spin = state(SPIN, wall), arm = radius - 0.5 * depth;
    const double closing = -nx * (wx + spin * (ry - arm * ny)) - ny * (wy - spin * (rx - arm * nx));
    double remaining = depth - KEPT;
    if (closing > 0) {
        const double elapsed = std::min(depth / closing, step);
        // contact point at the time of the contact
        const double px = rx - elapsed * wx - radius * nx, py = ry - elapsed * wy - radius * ny;
        wx += spin * py, wy -= spin * px;
        const double speed_change = (1 + rules.restitution) * std::max(0.0, -(wx * nx + wy * ny));
        remaining -= elapsed * speed_change;
        change_velocity(state, i, speed_change, nx, ny, elapsed);
        if (rules.friction > 0) {
            const double spin_per_impulse = radius / bodies[i].gyration2;
            const double along = wy * nx - wx * ny - radius * state(SPIN, i);
            const double maximum = rules.friction * speed_change;
            const double tangential_impulse =
                std::min(std::max(-along / (1 + radius * spin_per_impulse), -maximum), maximum);
            change_velocity(state, i, tangential_impulse, -ny, nx, elapsed);
            change_spin(state, i, -spin_per_impulse * tangential_impulse, elapsed);
        }
    }
    if (remaining > 0) {
        state(X, i) += remaining * nx;
        state(Y, i) += remaining * ny;
    }
}

}  // namespace plate::contacts
