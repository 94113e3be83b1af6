// Impulses between rotating rigid parts, and removal of their overlaps.
//
// If touching parts approach each other, normal impulses at one or two points stop the approach.
// The minimum impulses are computed for both points together. The impulses are multiplied by 1 + e,
// where e is the restitution. This method never adds energy, for any shapes of the parts. For e =
// 0, the result is the nearest velocity without approach in the energy norm. For e = 1, the initial
// velocity is reflected at the result for e = 0. Then friction acts at each point. An impulse of up
// to mu_c times the normal impulse reduces the tangential speed, but never reverses it. Both parts
// receive their impulses at the same point and at the time of the contact, which is within the time
// step. Therefore momentum and angular momentum are conserved. If many parts touch each other, an
// overlap may remain. A displacement, which does not change the velocities, removes this overlap.
//
// The file discs.hpp contains a simpler method for two discs.
#pragma once
#include <algorithm>
#include <cmath>
#include <span>

#include <plate/view.hpp>

#include "contacts/manifold.hpp"
#include "friction/step.hpp"

namespace plate::contacts {

// An overlap of up to this depth [m] is not removed, because a displacement would change the
// angular momentum of the parts. The overlap disappears when the parts separate.
constexpr double KEPT = 5e-6;

// Maximum number of impulse iterations in a collision. More than one iteration can be necessary if
// a contact point is not on the line between the centres. In this case, friction changes the
// closing speed.
constexpr int REBOUNDS = 20;

// The closing speed is the speed at which two parts approach each other. A closing speed below this
// fraction of its initial value counts as 0.
constexpr double ROUNDING = 1e-12;

// Two contact points count as one point if the relative determinant of their compliance matrix is
// below this value.
constexpr double RANK = 1e-9;

// Constants of the bodies, in the order of the state's columns. The last body represents the walls.
using Bodies = std::span<const Body>;

// Rules of contacts: restitution, friction coefficient, whether parts can collide with each other,
// and whether the plate has walls.
struct Rules {
    double restitution, friction;
    bool meets, walls;
};

// 1/mass [1/kg] and 1/inertia [1/(kg m2)] of two parts.
struct Inertia {
    double first, first_turn, second, second_turn;
};

// Vectors from the centres of two parts to a contact point [m].
struct Arm {
    Vec first, second;
};

// Return the velocity [m/s] of a part's point. (x, y) is the vector from the part's centre to the
// point [m].
inline Vec velocity(const State& state, int i, double x, double y) {
    return {state(VX, i) - state(SPIN, i) * y, state(VY, i) + state(SPIN, i) * x};
}

// Return the closing speed of two parts at contact point k [m/s].
inline double closing_speed(const State& state, int i, int j, const Manifold& contact, int k) {
    const auto [px, py] = contact.point[k];
    const Vec a = velocity(state, i, px - state(X, i), py - state(Y, i));
    const Vec b = velocity(state, j, px - state(X, j), py - state(Y, j));
    return contact.normal.x * (b.x - a.x) + contact.normal.y * (b.y - a.y);
}

// Whether the closing speed of two parts is positive at any contact point.
inline bool closes(const State& state, int i, int j, const Manifold& contact) {
    for (int k = 0; k < contact.count; k++)
        if (closing_speed(state, i, j, contact, k) > 0) return true;
    return false;
}

// Return the time [s] since the first contact of two approaching parts. The time is estimated from
// the depths of the overlap and the closing speeds. The result is at most `step`.
inline double time_since_contact(const State& state, int i, int j, const Manifold& contact,
                                 double step) {
    double elapsed = 0.0;
    for (int k = 0; k < contact.count; k++) {
        const double closing = closing_speed(state, i, j, contact, k);
        if (closing > 0) elapsed = std::max(elapsed, std::min(contact.depth[k] / closing, step));
    }
    return elapsed;
}

// Return the vectors from the centres to contact point k at the time of the contact, which was
// `elapsed` [s] earlier. If `radius` is not 0, the first part is a disc. `wall` states whether the
// second body is a wall.
inline Arm arm_of(const State& state, int i, int j, double radius, bool wall,
                  const Manifold& contact, int k, double elapsed) {
    Arm arm;
    if (radius > 0) {
        arm.first = {-radius * contact.normal.x, -radius * contact.normal.y};
    } else {
        auto [px, py] = contact.point[k];
        const Vec a = velocity(state, i, px - state(X, i), py - state(Y, i));
        const Vec b = velocity(state, j, px - state(X, j), py - state(Y, j));
        const double weight = wall ? 0.0 : 0.5;
        px -= elapsed * (weight * a.x + (1 - weight) * b.x);
        py -= elapsed * (weight * a.y + (1 - weight) * b.y);
        arm.first = {px - state(X, i) + elapsed * state(VX, i),
                     py - state(Y, i) + elapsed * state(VY, i)};
    }
    const double wx = state(VX, i) - state(VX, j), wy = state(VY, i) - state(VY, j);
    arm.second = {arm.first.x + state(X, i) - state(X, j) - elapsed * wx,
                  arm.first.y + state(Y, i) - state(Y, j) - elapsed * wy};
    return arm;
}

// Return the speed [m/s] along n of the first part relative to the second part at a contact point.
inline double speed(const State& state, int i, int j, const Arm& arm, Vec n) {
    const Vec a = velocity(state, i, arm.first.x, arm.first.y);
    const Vec b = velocity(state, j, arm.second.x, arm.second.y);
    return n.x * (a.x - b.x) + n.y * (a.y - b.y);
}

// Return the compliance [1/kg]: the change of the relative speed at the point `arm` by an impulse
// of 1 N s along n at the point `other`. It is
//     1/m1 + 1/m2 + (a x n)(c x n)/I1 + (b x n)(d x n)/I2
// where a, b are the vectors of `arm`, and c, d are the vectors of `other`.
inline double compliance(const Arm& arm, const Arm& other, Vec n, const Inertia& inertia) {
    const double a = arm.first.x * n.y - arm.first.y * n.x;
    const double b = arm.second.x * n.y - arm.second.y * n.x;
    const double c = other.first.x * n.y - other.first.y * n.x;
    const double d = other.second.x * n.y - other.second.y * n.x;
    return inertia.first + inertia.second + inertia.first_turn * a * c +
           inertia.second_turn * b * d;
}

// Apply an impulse along n to both parts. The impulse changes their velocities (row VX) or their
// positions (row X).
inline void apply_impulse(const State& state, int i, int j, const Arm& arm, Vec n, double impulse,
                          const Inertia& inertia, int row) {
    const auto [a, b] = arm;
    state(row, i) += impulse * inertia.first * n.x;
    state(row + 1, i) += impulse * inertia.first * n.y;
    state(row + 2, i) += impulse * inertia.first_turn * (a.x * n.y - a.y * n.x);
    state(row, j) -= impulse * inertia.second * n.x;
    state(row + 1, j) -= impulse * inertia.second * n.y;
    state(row + 2, j) -= impulse * inertia.second_turn * (b.x * n.y - b.y * n.x);
}

// Minimum impulses j >= 0 along n at two contact points after which the parts do not approach at
// either point. The impulses j solve
//     j >= 0,  v + H j >= 0,  j . (v + H j) = 0
// Here, v = (v0, v1) are the relative speeds [m/s] along n at the points, and H is the matrix of
// compliances.
struct MinimumImpulses {
    double impulse[2] = {0.0, 0.0};

    MinimumImpulses(const Arm arms[2], Vec n, const Inertia& inertia, double v0, double v1,
                    int count) {
        const double h00 = compliance(arms[0], arms[0], n, inertia);
        const double j0 = std::max(0.0, -v0 / h00);
        impulse[0] = j0;
        if (count == 1) return;
        const double h11 = compliance(arms[1], arms[1], n, inertia);
        const double h01 = compliance(arms[0], arms[1], n, inertia);
        if (v0 < 0 && v1 + h01 * j0 >= 0) return;
        const double j1 = std::max(0.0, -v1 / h11);
        const double det = h00 * h11 - h01 * h01;
        if (v1 < 0 && v0 + h01 * j1 >= 0)
            impulse[0] = 0.0, impulse[1] = j1;
        else if (det > RANK * h00 * h11)
            impulse[0] = std::max(0.0, (h01 * v1 - h11 * v0) / det),
            impulse[1] = std::max(0.0, (h01 * v0 - h00 * v1) / det);
        else
            impulse[0] = 0.5 * j0, impulse[1] = 0.5 * j1;
    }
};

// Apply impulses until the parts do not approach at any contact point. The arguments v0, v1 are the
// relative speeds [m/s] along n at the points.
inline void bounce(const State& state, int i, int j, const Arm arms[2], Vec n,
                   const Inertia& inertia, int count, double v0, double v1, const Rules& rules) {
    const Vec t{-n.y, n.x};
    const double zero_speed = ROUNDING * std::max(std::abs(v0), std::abs(v1));
    const double rebound = 1 + rules.restitution;
    for (int iteration = 0; iteration < REBOUNDS; iteration++) {
        if (v0 >= -zero_speed && v1 >= -zero_speed) break;
        const MinimumImpulses minimum(arms, n, inertia, v0, v1, count);
        for (int k = 0; k < count; k++)
            apply_impulse(state, i, j, arms[k], n, rebound * minimum.impulse[k], inertia, VX);
        for (int k = 0; k < count; k++) {
            const double maximum = rules.friction * rebound * minimum.impulse[k];
            if (maximum > 0) {
                const double friction =
                    -speed(state, i, j, arms[k], t) / compliance(arms[k], arms[k], t, inertia);
                apply_impulse(state, i, j, arms[k], t,
                              std::min(std::max(friction, -maximum), maximum), inertia, VX);
            }
        }
        // Friction may have caused a new closing speed, so compute the speeds again for the next
        // iteration.
        v0 = speed(state, i, j, arms[0], n);
        v1 = count == 2 ? speed(state, i, j, arms[1], n) : 0.0;
    }
}

// Apply the collision of two parts, or of a part and a wall, to the state.
//
// The arguments i and j are the indices of the bodies. At most one of these bodies is a disc, and
// the disc is i. A wall is always j. In this case, i is not a disc. The last body represents the
// walls. The last column of the state contains the pose and twist of the plate. `step` is the
// length of the time step [s].
inline void collide(const State& state, Bodies bodies, int i, int j, Manifold contact,
                    const Rules& rules, double step) {
    const Body &a = bodies[i], &b = bodies[j];
    const double elapsed = time_since_contact(state, i, j, contact, step);
    const int count = contact.count;
    const Vec n = contact.normal;
    Arm arms[2]{};
    for (int k = 0; k < count; k++)
        arms[k] = arm_of(state, i, j, a.radius, b.mass_inverse == 0, contact, k, elapsed);
    const Inertia inertia{a.mass_inverse, a.mass_inverse / a.gyration2, b.mass_inverse,
                          b.mass_inverse / b.gyration2};
    double before[3][2], v[2] = {0.0, 0.0};
    for (int d = 0; d < 3; d++) before[d][0] = state(VX + d, i), before[d][1] = state(VX + d, j);
    for (int k = 0; k < count; k++) v[k] = speed(state, i, j, arms[k], n);
    bounce(state, i, j, arms, n, inertia, count, v[0], v[1], rules);
    for (int d = 0; d < 3; d++) {
        state(X + d, i) += elapsed * (state(VX + d, i) - before[d][0]);
        state(X + d, j) += elapsed * (state(VX + d, j) - before[d][1]);
    }
    for (int k = 0; k < count; k++)
        contact.depth[k] -= elapsed * (speed(state, i, j, arms[k], n) - v[k]);
    for (int k = 0; k < count; k++) {
        const double remaining = contact.depth[k] - KEPT;
        if (remaining > 0) {
            const double displacement = remaining / compliance(arms[k], arms[k], n, inertia);
            apply_impulse(state, i, j, arms[k], n, displacement, inertia, X);
            if (count == 2 && k == 0)
                contact.depth[1] -= displacement * compliance(arms[0], arms[1], n, inertia);
        }
    }
}

}  // namespace plate::contacts
