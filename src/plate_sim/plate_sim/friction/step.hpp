// Time step of a part with a contact area, which slides and rotates, moves with the plate, or
// begins to stick.
//
// The midpoint rule, which is of second order, advances a part that slides steadily. If the
// friction changes only a little with the slip, the explicit form of the rule is used. If the
// friction changes much with the slip, the implicit form is used. If the direction of the slip
// changes quickly, the step is bisected, at most `HALVINGS` times. If the slip reverses, the step
// is split just before the reversal. The shortest substeps use the implicit Euler method
// (patch.hpp). A part that sticks at both ends of a step moves exactly with the plate. Therefore a
// sticking part does not creep.
//
// In most steps, most parts are discs that slide steadily. `glide` (glide.hpp) advances these discs
// together. `advance` advances the other parts one by one.
#pragma once
#include <plate/view.hpp>
#include <plate/wide.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>

#include "friction/disc.hpp"
#include "friction/patch.hpp"
#include "friction/reversal.hpp"
#include "plate/course.hpp"
#include "plate/ground.hpp"

namespace plate {

// Rows of a part's state in plate_home: position [m], angle [rad], velocity [m/s] and spin [rad/s].
constexpr int X = 0, Y = 1, ANGLE = 2, VX = 3, VY = 4, SPIN = 5;

// Number of parts in an SIMD vector.
constexpr int LANES = 4;

// Constants of a part. `BODY` in step.py describes the fields. The struct has the same size as ten
// numbers of type double.
struct Body {
    double mu_g, gyration2, radius, reach, slim, mass_inverse;
    std::int64_t first_point, end_point, first_piece, end_piece;

    // Whether the body is a disc with uniform pressure.
    bool is_uniform_disc() const { return first_point == end_point; }
};
static_assert(sizeof(Body) == 10 * sizeof(double));

// Group of parts that are advanced together: their states, and constants for `glide` (glide.hpp).
struct Group {
    double state[6][LANES];
    // `dv` is mu g times the step [m/s]. `minimum` is the minimum squared slip for `glide` [m2/s2].
    // For parts that are not discs on the plate, `minimum` is NaN, so that every comparison with it
    // is false. `radius2` and `gyration2` are the squared radius and the squared radius of gyration
    // [m2]. `ratio` is radius2 / gyration2.
    double dv[LANES], minimum[LANES], radius2[LANES], gyration2[LANES], ratio[LANES];
    double glided[LANES];        // 1 if `glide` has advanced the part in this step, else 0
    double off_plate[LANES];     // 0 if the part is on the plate, else infinite
    double reference[2][LANES];  // positions at an earlier time [m]
    // Slip at the start of the step, set by `set_slip` (glide.hpp). `size2` is the product `dot` of
    // the slip with itself. `edge2` is the squared ratio of the slip at the edge due to rotation to
    // the slip of the centre. `half_factor` is half of `dv`, divided by the slip of the centre.
    double slip[3][LANES], size2[LANES], edge2[LANES], half_factor[LANES];
};

// States of all parts, in groups. The last entry represents the walls.
struct State {
    std::span<Group> groups;

    Group& group(int i) const { return groups[static_cast<unsigned>(i) / LANES]; }
    static int lane(int i) { return static_cast<unsigned>(i) % LANES; }
    double& operator()(int row, int i) const { return group(i).state[row][lane(i)]; }
    int walls() const { return static_cast<int>(groups.size()) * LANES - 1; }
};

}  // namespace plate

namespace plate::stepping {

// Maximum number of bisections of a step. With this number, the time of a reversal is exact to
// 1/512 of the step.
constexpr int HALVINGS = 9;
// Minimum cosine of the angle between the slip at the start of a step and the slip in the middle or
// at the end. If a cosine is smaller, the step is bisected.
constexpr double STEADY = 0.9;
// A slip below this fraction of mu g dt is a rounding error and counts as 0.
constexpr double STUCK = 1e-3;
// If the slip changes, the friction changes, too. The explicit midpoint rule is used if the
// resulting velocity change in a step is less than this fraction of the slip's change.
constexpr double GENTLE = 0.5;
// Approximate upper bound of the following product: the derivative of a disc's friction with
// respect to the slip, times the slip. The unit of the product is mu g.
constexpr double DISC_STIFF = 3.0;

// State of one part: position [m], angle [rad], and their rates, in plate_home.
struct PartState {
    double x, y, angle, vx, vy, spin;
};

inline Slip operator+(const Slip& a, const Slip& b) {
    return {a.x + b.x, a.y + b.y, a.spin + b.spin};
}
inline Slip operator-(const Slip& a, const Slip& b) {
    return {a.x - b.x, a.y - b.y, a.spin - b.spin};
}
inline Slip operator*(double scale, const Slip& a) {
    return {scale * a.x, scale * a.y, scale * a.spin};
}

[[gnu::always_inline]] inline double dot(const Slip& a, const Slip& b, double gyration2) {
    return a.x * b.x + a.y * b.y + gyration2 * a.spin * b.spin;
}

// `to_part` transforms a slip from plate_home to the frame of a part, and `from_part` transforms it
// back. Here, c and s are the cosine and sine of the part's angle.
inline Slip to_part(const Slip& a, double c, double s) {
    return {c * a.x + s * a.y, c * a.y - s * a.x, a.spin};
}
inline Slip from_part(const Slip& a, double c, double s) {
    return {c * a.x - s * a.y, s * a.x + c * a.y, a.spin};
}

// Whether the cosine of the angle between two slips exceeds `STEADY`.
inline bool same_direction(const Slip& a, const Slip& b, double gyration2) {
    const double product = dot(a, b, gyration2);
    return product > 0 &&
           product * product > STEADY * STEADY * dot(a, a, gyration2) * dot(b, b, gyration2);
}

// Return the slip of a part at (x, y): the twist of the plate at this point minus the twist of the
// part (equation (2)).
[[gnu::always_inline]] inline Slip slip(const PlateSample& plate, double x, double y, double vx,
                                       double vy, double spin) {
    return {plate.vx - plate.spin * (y - plate.y) - vx, plate.vy + plate.spin * (x - plate.x) - vy,
            plate.spin - spin};
}

// Return the state after h [s] if the velocity changes linearly to (vx, vy, spin).
inline PartState after_linear_change(const PartState& m, double h, double vx, double vy,
                                     double spin) {
    return {m.x + 0.5 * h * (m.vx + vx), m.y + 0.5 * h * (m.vy + vy),
            m.angle + 0.5 * h * (m.spin + spin), vx, vy, spin};
}

// Return the friction on a disc or another part at `angle` [rad], in plate_home. `patch::Friction`
// describes the result.
inline patch::Friction friction(const Slip& slip, double angle, const Body& body,
                                const Mesh& mesh) {
    if (body.is_uniform_disc()) {
        const double s2 = slip.x * slip.x + slip.y * slip.y;
        const double size2 = s2 + body.gyration2 * slip.spin * slip.spin;
        if (size2 <= 0) return {{0, 0, 0}, std::numeric_limits<double>::infinity()};
        const double s = std::sqrt(s2);
        const disc::DiscFriction disc_friction =
            disc::disc_force(s, body.radius * std::abs(slip.spin));
        const double factor = s > 0 ? disc_friction.force / s : 0;
        const double torque = disc_friction.torque * (body.radius / body.gyration2);
        return {{factor * slip.x, factor * slip.y, slip.spin > 0 ? torque : -torque},
                DISC_STIFF / std::sqrt(size2)};
    }
    const double c = std::cos(angle), s = std::sin(angle);
    const patch::Friction part_friction = patch::friction(to_part(slip, c, s), body.gyration2, mesh,
                                                          body.first_point, body.end_point);
    return {from_part(part_friction.force, c, s), part_friction.stiffness};
}

// Return the slip after a step, in plate_home, for a disc or another part at `angle` [rad].
// `patch::slip_after` describes the method.
inline Slip slip_after(const Slip& free, double angle, double dv, const Body& body,
                       const Mesh& mesh) {
    if (body.is_uniform_disc()) return disc::disc_slip_after(free, dv, body.gyration2, body.radius);
    const double c = std::cos(angle), s = std::sin(angle);
    const Slip left = patch::slip_after(to_part(free, c, s), dv, body.gyration2, mesh,
                                        body.first_point, body.end_point);
    return from_part(left, c, s);
}

// Whether friction can stop a slip in one step. Friction changes the velocity by at most dv [m/s]
// in the step.
inline bool can_stop(const Slip& slip, double angle, double dv, const Body& body,
                     const Mesh& mesh) {
    constexpr double MAX_SLIP = (1 + disc::SNAP) * (1 + disc::SNAP);
    if (slip.x * slip.x + slip.y * slip.y > MAX_SLIP * dv * dv) return false;
    const Slip left = slip_after(slip, angle, dv, body, mesh);
    return left.x == 0 && left.y == 0 && left.spin == 0;
}

// Slip in the middle of a step, and change of the part's twist by friction during the step.
struct Middle {
    Slip half, change;
};

// Apply the midpoint rule. `slip` is the slip at the start of the step, when the part's angle is
// `angle` [rad]. `free` is the slip in the middle of the step without friction, when the part's
// angle is `angle + turn`. `before` is the friction at the start, which is computed if it is not
// yet known.
inline Middle midpoint(const Slip& slip, const Slip& free, double angle, double turn, double dv,
                       const Body& body, const Mesh& mesh,
                       std::optional<patch::Friction>& before) {
    if (!before) before = friction(slip, angle, body, mesh);
    if (dv * before->stiffness <= GENTLE) {
        const Slip half = free - 0.5 * dv * before->force;
        const patch::Friction now = friction(half, angle + turn, body, mesh);
        if (dv * now.stiffness <= GENTLE) return {half, dv * now.force};
    }
    const Slip half = slip_after(free, angle + turn, 0.5 * dv, body, mesh);
    return {half, 2 * (free - half)};
}

// Result of a trial step: whether the step is accurate enough (`accurate`), and the state at its
// end. If the slip reverses, `reversal_fraction` is the estimated fraction of the step before the
// reversal. Otherwise `reversal_fraction` is 0.
struct Attempt {
    bool accurate;
    PartState after;
    double reversal_fraction = 0;
};

// Move a stuck part with the plate. `accurate` is true if static friction can hold the part.
//
// `fall` and `static_dv` [m/s] are the velocity changes in the step by gravity along the plate and
// by static friction.
inline Attempt move_with_plate(const PlateSample* plate, Vec fall, double static_dv,
                               const PartState& m, const Body& body, const Mesh& mesh) {
    const PlateSample &start = plate[0], &middle = plate[1], &end = plate[2];
    double rotation = end.theta - start.theta;
    const double rx = m.x - start.x, ry = m.y - start.y;
    const double c = std::cos(rotation), s = std::sin(rotation);
    const double qx = c * rx - s * ry, qy = s * rx + c * ry;
    const PartState after{
        end.x + qx, end.y + qy, m.angle + rotation, end.vx - end.spin * qy, end.vy + end.spin * qx,
        end.spin};
    const Slip gain{after.vx - m.vx, after.vy - m.vy, after.spin - m.spin},
        fall_slip{fall.x, fall.y, 0};
    if (!can_stop(gain - fall_slip, m.angle, static_dv, body, mesh)) return {false, after};
    // At the end of the step, the plate may accelerate so much that the part begins to slide.
    // Therefore the rate of change of the slip at the end is checked, too. Without friction, the
    // slip is approximated by the parabola a s + b s^2, with s from 0 to 1. `half` is the value of
    // the parabola at s = 1/2, and `gain` is the value at s = 1. From these values, a = 4 half -
    // gain and b = 2 gain - 4 half. The rate of the parabola at s = 1 is a + 2 b = 3 gain - 4 half.
    rotation = middle.theta - start.theta;
    const Slip half = slip(middle, middle.x + rx - rotation * ry, middle.y + ry + rotation * rx,
                           m.vx, m.vy, m.spin);
    return {can_stop(3 * gain - 4 * half - fall_slip, m.angle, static_dv, body, mesh), after};
}

// Try one step of h [s].
//
// If `last` is true, the step is always accepted, and the implicit Euler method is used if
// necessary. A slip of up to `zero_slip` [m/s] counts as 0. `before` keeps the friction at the
// start for shorter steps with the same start.
inline Attempt attempt(const PlateSample* plate, double h, bool last, double zero_slip,
                       const GroundEffect& ground, const PartState& m, const Body& body,
                       const Mesh& mesh, std::optional<patch::Friction>& before) {
    const double weight = ground.weight((plate[2].vx - plate[0].vx) / h), g2 = body.gyration2;
    const double max_dv = body.mu_g * h * weight, static_dv = ground.static_ratio * max_dv;
    const Vec fall{h * ground.gravity_x, h * ground.gravity_y};
    if (max_dv <= 0) return {true, after_linear_change(m, h, m.vx + fall.x, m.vy + fall.y, m.spin)};
    Slip start = slip(plate[0], m.x, m.y, m.vx, m.vy, m.spin);
    const double size2 = start.x * start.x + start.y * start.y + g2 * (start.spin * start.spin);
    const bool stuck = size2 <= zero_slip * zero_slip;
    if (stuck) {
        const Attempt riding = move_with_plate(plate, fall, static_dv, m, body, mesh);
        if (riding.accurate) return riding;
    }
    const Slip middle = slip(plate[1], m.x + 0.5 * h * m.vx, m.y + 0.5 * h * m.vy,
                             m.vx + 0.5 * fall.x, m.vy + 0.5 * fall.y, m.spin);
    double dv = max_dv;
    // The friction coefficient depends on the slip speed. Use its value at the RMS slip of the part
    // in the middle of the step.
    if (ground.slope != 0) [[unlikely]] {
        const double speed = std::sqrt(dot(middle, middle, g2));
        dv = max_dv * ground.friction_factor(
                          std::max(0.0, speed - 0.5 * max_dv * ground.friction_factor(speed)));
    }
    const auto [half, change] =
        midpoint(start, middle, m.angle, 0.5 * h * m.spin, dv, body, mesh, before);
    PartState after = after_linear_change(m, h, m.vx + fall.x + change.x, m.vy + fall.y + change.y,
                                          m.spin + change.spin);
    const Slip end = slip(plate[2], after.x, after.y, after.vx, after.vy, after.spin);
    bool slides = true;
    if (stuck) {
        // the slip grows as the parabola in `move_with_plate`, from the rate a at the start
        start = 4 * half - end;
        slides =
            static_dv <= dv || !can_stop(4 * middle - end - change, m.angle, static_dv, body, mesh);
    }
    if (slides && same_direction(start, half, g2) && same_direction(start, end, g2))
        return {true, after};
    const double product = dot(start, end, g2);
    const double reversal_fraction = product < 0 && !stuck ? size2 / (size2 - product) : 0;
    if (last) {
        const Slip free =
            slip(plate[2], m.x + h * m.vx, m.y + h * m.vy, m.vx + fall.x, m.vy + fall.y, m.spin);
        const double final_angle = m.angle + h * m.spin;
        Slip left = slip_after(free, final_angle, static_dv, body, mesh);
        if (static_dv > dv && (left.x != 0 || left.y != 0 || left.spin != 0))
            left = slip_after(free, final_angle, dv, body, mesh);
        after =
            after_linear_change(m, h, m.vx + fall.x + free.x - left.x,
                                m.vy + fall.y + free.y - left.y, m.spin + free.spin - left.spin);
    }
    return {last, after, reversal_fraction};
}

// Return a shorter substep than `size`: the time before the reversal or, without a reversal, half
// of `size`. The unit is the length of the finest substep.
inline int shorter(int size, double reversal_fraction) {
    return reversal_fraction > 0
               ? std::max(1, std::min(size - 1, static_cast<int>(size * reversal_fraction)))
               : size >> 1;
}

// Split a step into substeps until each substep is accurate enough. Return the state at the end of
// the step.
//
// `first` is the state of the plate at the start of the step. `reversal_fraction` and `before` are
// results of the `attempt` for the whole step.
inline PartState advance_in_parts(const Course& course, double start, double step, double zero_slip,
                                  const PlateSample& first, double reversal_fraction,
                                  const GroundEffect& ground, PartState motion, const Body& body,
                                  const Mesh& mesh, std::optional<patch::Friction> before) {
    constexpr int FINEST = 1 << HALVINGS;
    PlateSample plate[3] = {first};
    int done = 0, size = shorter(FINEST, reversal_fraction), piece = course.piece_at(start, 0);
    bool to_end = reversal_fraction > 0;
    while (true) {
        const double t = start + done * step / FINEST, h = step * size / FINEST;
        plate[1] = course.at(t + 0.5 * h, piece);
        plate[2] = course.at(t + h, piece);
        const Attempt result =
            attempt(plate, h, size == 1, zero_slip, ground, motion, body, mesh, before);
        if (!result.accurate) {
            size = shorter(size, result.reversal_fraction), to_end = result.reversal_fraction > 0;
            continue;
        }
        motion = result.after;
        before.reset();
        done += size;
        if (done == FINEST) return motion;
        // If a substep ends just before a reversal, the next substep has the minimum length and
        // passes the reversal. After the reversal, one more substep computes the rest of the step.
        size = !to_end ? 2 * size : size > 1 ? 1 : FINEST - done;
        to_end = to_end && size == 1;
        size = std::min(size, FINEST - done);
        plate[0] = plate[2];
    }
}

// Compute a step of h [s] of a disc without spin by `reversal`. The result is not `accurate` if the
// plate rotates, or if the method does not apply.
inline Attempt reverse(const PlateSample* plate, double h, const GroundEffect& ground,
                       const PartState& m, const Body& body) {
    if (plate[0].spin != 0 || plate[1].spin != 0 || plate[2].spin != 0) return {false, m};
    const double dv = body.mu_g * h;
    const reversing::Reversal result =
        reversing::reversal(plate, {h * ground.gravity_x, h * ground.gravity_y},
                            ground.static_ratio * dv, dv, {m.vx, m.vy});
    return {
        result.fits,
        {m.x + h * result.mean.x, m.y + h * result.mean.y, m.angle, result.end.x, result.end.y, 0}};
}

}  // namespace plate::stepping

namespace plate {

// Advance part i by a step, in place.
//
// `start` is the time in the course at which the step begins [s], and `step` is the length of the
// step [s]. `plate` contains samples of the plate's motion at the start, in the middle and at the
// end of the step.
PLATE_WIDE inline void advance(const Course& course, double start, double step,
                               const PlateSample* plate, const GroundEffect& ground,
                               const State& state, int i, const Body& body, const Mesh& mesh) {
    using namespace stepping;
    const PartState motion{state(X, i),  state(Y, i),  state(ANGLE, i),
                           state(VX, i), state(VY, i), state(SPIN, i)};
    const double zero_slip = STUCK * body.mu_g * step;
    Attempt result{false, motion};
    if (body.radius > 0 && motion.spin == 0 && body.is_uniform_disc() && ground.is_constant())
        result = reverse(plate, step, ground, motion, body);
    std::optional<patch::Friction> before;
    if (!result.accurate)
        result = attempt(plate, step, false, zero_slip, ground, motion, body, mesh, before);
    if (!result.accurate)
        result.after =
            advance_in_parts(course, start, step, zero_slip, plate[0], result.reversal_fraction,
                             ground, motion, body, mesh, before);
    const PartState& after = result.after;
    state(X, i) = after.x, state(Y, i) = after.y, state(ANGLE, i) = after.angle;
    state(VX, i) = after.vx, state(VY, i) = after.vy, state(SPIN, i) = after.spin;
}

}  // namespace plate
