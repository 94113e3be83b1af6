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
    bool even() const { return first_point == end_point; }
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
    double moved[LANES];    // 1 if `glide` has advanced the part in this step, else 0
    double away[LANES];     // 0 if the part is on the plate, else infinite
    double mark[2][LANES];  // positions at an earlier time [m]
    // Slip at the start of the step, set by `set_slip` (glide.hpp). `size2` is the product `dot` of
    // the slip with itself. `edge2` is the squared ratio of the slip at the edge due to rotation to
    // the slip of the centre. `share` is half of `dv`, divided by the slip of the centre.
    double slip[3][LANES], size2[LANES], edge2[LANES], share[LANES];
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
struct Motion {
    double x, y, angle, vx, vy, spin;
};

inline Slip operator+(const Slip& a, const Slip& b) {
    return {a.x + b.x, a.y + b.y, a.turn + b.turn};
}
inline Slip operator-(const Slip& a, const Slip& b) {
    return {a.x - b.x, a.y - b.y, a.turn - b.turn};
}
inline Slip operator*(double scale, const Slip& a) {
    return {scale * a.x, scale * a.y, scale * a.turn};
}

[[gnu::always_inline]] inline double dot(const Slip& a, const Slip& b, double gyration2) {
    return a.x * b.x + a.y * b.y + gyration2 * a.turn * b.turn;
}

// `to_part` transforms a slip from plate_home to the frame of a part, and `from_part` transforms it
// back. Here, c and s are the cosine and sine of the part's angle.
inline Slip to_part(const Slip& a, double c, double s) {
    return {c * a.x + s * a.y, c * a.y - s * a.x, a.turn};
}
inline Slip from_part(const Slip& a, double c, double s) {
    return {c * a.x - s * a.y, s * a.x + c * a.y, a.turn};
}

// Whether the cosine of the angle between two slips exceeds `STEADY`.
inline bool alike(const Slip& a, const Slip& b, double gyration2) {
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
inline Motion moved(const Motion& m, double h, double vx, double vy, double spin) {
    return {m.x + 0.5 * h * (m.vx + vx), m.y + 0.5 * h * (m.vy + vy),
            m.angle + 0.5 * h * (m.spin + spin), vx, vy, spin};
}

// Return the friction on a disc or another part at `angle` [rad], in plate_home. `patch::Friction`
// describes the result.
inline patch::Friction friction(const Slip& slip, double angle, const Body& body,
                                const Mesh& mesh) {
    if (body.even()) {
        const double s2 = slip.x * slip.x + slip.y * slip.y;
        const double size2 = s2 + body.gyration2 * slip.turn * slip.turn;
        if (size2 <= 0) return {{0, 0, 0}, std::numeric_limits<double>::infinity()};
        const double s = std::sqrt(s2);
        const disc::Push push = disc::disc_force(s, body.radius * std::abs(slip.turn));
        const double share = s > 0 ? push.force / s : 0;
        const double torque = push.torque * (body.radius / body.gyration2);
        return {{share * slip.x, share * slip.y, slip.turn > 0 ? torque : -torque},
                DISC_STIFF / std::sqrt(size2)};
    }
    const double c = std::cos(angle), s = std::sin(angle);
    const patch::Friction found = patch::friction(to_part(slip, c, s), body.gyration2, mesh,
                                                  body.first_point, body.end_point);
    return {from_part(found.push, c, s), found.stiff};
}

// Return the slip after a step, in plate_home, for a disc or another part at `angle` [rad].
// `patch::slip_after` describes the method.
inline Slip slip_after(const Slip& free, double angle, double dv, const Body& body,
                       const Mesh& mesh) {
    if (body.even()) return disc::disc_slip_after(free, dv, body.gyration2, body.radius);
    const double c = std::cos(angle), s = std::sin(angle);
    const Slip left = patch::slip_after(to_part(free, c, s), dv, body.gyration2, mesh,
                                        body.first_point, body.end_point);
    return from_part(left, c, s);
}

// Whether friction can stop a slip in one step. Friction changes the velocity by at most dv [m/s]
// in the step.
inline bool holds(const Slip& slip, double angle, double dv, const Body& body, const Mesh& mesh) {
    constexpr double MAX_SLIP = (1 + disc::SNAP) * (1 + disc::SNAP);
    if (slip.x * slip.x + slip.y * slip.y > MAX_SLIP * dv * dv) return false;
    const Slip left = slip_after(slip, angle, dv, body, mesh);
    return left.x == 0 && left.y == 0 && left.turn == 0;
}

// Slip in the middle of a step, and change of the part's twist by friction during the step.
struct Middle {
    Slip half, push;
};

// Apply the midpoint rule. `slip` is the slip at the start of the step, when the part's angle is
// `angle` [rad]. `free` is the slip in the middle of the step without friction, when the part's
// angle is `angle + turn`. `before` is the friction at the start, which is computed if it is not
// yet known.
inline Middle midpoint(const Slip& slip, const Slip& free, double angle, double turn, double dv,
                       const Body& body, const Mesh& mesh,
                       std::optional<patch::Friction>& before) {
    if (!before) before = friction(slip, angle, body, mesh);
    if (dv * before->stiff <= GENTLE) {
        const Slip half = free - 0.5 * dv * before->push;
        const patch::Friction now = friction(half, angle + turn, body, mesh);
        if (dv * now.stiff <= GENTLE) return {half, dv * now.push};
    }
    const Slip half = slip_after(free, angle + turn, 0.5 * dv, body, mesh);
    return {half, 2 * (free - half)};
}

// Result of a trial step: whether the step is accurate enough (`fine`), and the state at its end.
// If the slip reverses, `ahead` is the estimated fraction of the step before the reversal.
// Otherwise `ahead` is 0.
struct Attempt {
    bool fine;
    Motion after;
    double ahead = 0;
};

// Move a stuck part with the plate. `fine` is true if static friction can hold the part.
//
// `fall` and `static_dv` [m/s] are the velocity changes in the step by gravity along the plate and
// by static friction.
inline Attempt ride(const PlateSample* plate, Vec fall, double static_dv, const Motion& m,
                    const Body& body, const Mesh& mesh) {
    const PlateSample &start = plate[0], &middle = plate[1], &end = plate[2];
    double turn = end.theta - start.theta;
    const double rx = m.x - start.x, ry = m.y - start.y, c = std::cos(turn), s = std::sin(turn);
    const double qx = c * rx - s * ry, qy = s * rx + c * ry;
    const Motion after{end.x + qx, end.y + qy, m.angle + turn,
                       end.vx - end.spin * qy, end.vy + end.spin * qx, end.spin};
    const Slip gain{after.vx - m.vx, after.vy - m.vy, after.spin - m.spin}, pull{fall.x, fall.y, 0};
    if (!holds(gain - pull, m.angle, static_dv, body, mesh)) return {false, after};
    // At the end of the step, the plate may accelerate so much that the part begins to slide.
    // Therefore the rate of change of the slip at the end is checked, too. Without friction, the
    // slip is approximated by the parabola a s + b s^2, with s from 0 to 1. `half` is the value of
    // the parabola at s = 1/2, and `gain` is the value at s = 1. From these values, a = 4 half -
    // gain and b = 2 gain - 4 half. The rate of the parabola at s = 1 is a + 2 b = 3 gain - 4 half.
    turn = middle.theta - start.theta;
    const Slip half =
        slip(middle, middle.x + rx - turn * ry, middle.y + ry + turn * rx, m.vx, m.vy, m.spin);
    return {holds(3 * gain - 4 * half - pull, m.angle, static_dv, body, mesh), after};
}

// Try one step of h [s].
//
// If `last` is true, the step is always accepted, and the implicit Euler method is used if
// necessary. A slip of up to `none` [m/s] counts as 0. `before` keeps the friction at the start for
// shorter steps with the same start.
inline Attempt attempt(const PlateSample* plate, double h, bool last, double none,
                       const GroundEffect& ground, const Motion& m, const Body& body,
                       const Mesh& mesh, std::optional<patch::Friction>& before) {
    const double weight = ground.weight((plate[2].vx - plate[0].vx) / h), g2 = body.gyration2;
    const double slow = body.mu_g * h * weight, static_dv = ground.static_ratio * slow;
    const Vec fall{h * ground.gravity_x, h * ground.gravity_y};
    if (slow <= 0) return {true, moved(m, h, m.vx + fall.x, m.vy + fall.y, m.spin)};
    Slip start = slip(plate[0], m.x, m.y, m.vx, m.vy, m.spin);
    const double size2 = start.x * start.x + start.y * start.y + g2 * (start.turn * start.turn);
    const bool stuck = size2 <= none * none;
    if (stuck) {
        const Attempt riding = ride(plate, fall, static_dv, m, body, mesh);
        if (riding.fine) return riding;
    }
    const Slip middle = slip(plate[1], m.x + 0.5 * h * m.vx, m.y + 0.5 * h * m.vy,
                             m.vx + 0.5 * fall.x, m.vy + 0.5 * fall.y, m.spin);
    double dv = slow;
    // The friction coefficient depends on the slip speed. Use its value at the RMS slip of the part
    // in the middle of the step.
    if (ground.slope != 0) [[unlikely]] {
        const double speed = std::sqrt(dot(middle, middle, g2));
        dv = slow * ground.share(std::max(0.0, speed - 0.5 * slow * ground.share(speed)));
    }
    const auto [half, push] =
        midpoint(start, middle, m.angle, 0.5 * h * m.spin, dv, body, mesh, before);
    Motion after = moved(m, h, m.vx + fall.x + push.x, m.vy + fall.y + push.y, m.spin + push.turn);
    const Slip end = slip(plate[2], after.x, after.y, after.vx, after.vy, after.spin);
    bool loose = true;
    if (stuck) {  // the slip grows as the parabola in `ride`, from the rate a at the start
        start = 4 * half - end;
        loose = static_dv <= dv || !holds(4 * middle - end - push, m.angle, static_dv, body, mesh);
    }
    if (loose && alike(start, half, g2) && alike(start, end, g2)) return {true, after};
    const double product = dot(start, end, g2);
    const double ahead = product < 0 && !stuck ? size2 / (size2 - product) : 0;
    if (last) {
        const Slip free =
            slip(plate[2], m.x + h * m.vx, m.y + h * m.vy, m.vx + fall.x, m.vy + fall.y, m.spin);
        const double turned = m.angle + h * m.spin;
        Slip left = slip_after(free, turned, static_dv, body, mesh);
        if (static_dv > dv && (left.x != 0 || left.y != 0 || left.turn != 0))
            left = slip_after(free, turned, dv, body, mesh);
        after = moved(m, h, m.vx + fall.x + free.x - left.x, m.vy + fall.y + free.y - left.y,
                      m.spin + free.turn - left.turn);
    }
    return {last, after, ahead};
}

// Return a shorter substep than `size`: the time before the reversal or, without a reversal, half
// of `size`. The unit is the length of the finest substep.
inline int shorter(int size, double ahead) {
    return ahead > 0 ? std::max(1, std::min(size - 1, static_cast<int>(size * ahead))) : size >> 1;
}

// Split a step into substeps until each substep is accurate enough. Return the state at the end of
// the step.
//
// `first` is the state of the plate at the start of the step. `ahead` and `before` are results of
// the `attempt` for the whole step.
inline Motion advance_in_parts(const Course& course, double start, double step, double none,
                               const PlateSample& first, double ahead, const GroundEffect& ground,
                               Motion motion, const Body& body, const Mesh& mesh,
                               std::optional<patch::Friction> before) {
    constexpr int FINEST = 1 << HALVINGS;
    PlateSample plate[3] = {first};
    int done = 0, size = shorter(FINEST, ahead), leg = course.leg_at(start, 0);
    bool to_end = ahead > 0;
    while (true) {
        const double t = start + done * step / FINEST, h = step * size / FINEST;
        plate[1] = course.at(t + 0.5 * h, leg);
        plate[2] = course.at(t + h, leg);
        const Attempt made = attempt(plate, h, size == 1, none, ground, motion, body, mesh, before);
        if (!made.fine) {
            size = shorter(size, made.ahead), to_end = made.ahead > 0;
            continue;
        }
        motion = made.after;
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

// Compute a step of h [s] of a disc without spin by `reversal`. The result is not `fine` if the
// plate rotates, or if the method does not apply.
inline Attempt reverse(const PlateSample* plate, double h, const GroundEffect& ground,
                       const Motion& m, const Body& body) {
    if (plate[0].spin != 0 || plate[1].spin != 0 || plate[2].spin != 0) return {false, m};
    const double dv = body.mu_g * h;
    const reversing::Reversal made =
        reversing::reversal(plate, {h * ground.gravity_x, h * ground.gravity_y},
                            ground.static_ratio * dv, dv, {m.vx, m.vy});
    return {made.fits,
            {m.x + h * made.mean.x, m.y + h * made.mean.y, m.angle, made.end.x, made.end.y, 0}};
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
    const Motion motion{state(X, i),  state(Y, i),  state(ANGLE, i),
                        state(VX, i), state(VY, i), state(SPIN, i)};
    const double none = STUCK * body.mu_g * step;
    Attempt made{false, motion};
    if (body.radius > 0 && motion.spin == 0 && body.even() && ground.even())
        made = reverse(plate, step, ground, motion, body);
    std::optional<patch::Friction> before;
    if (!made.fine) made = attempt(plate, step, false, none, ground, motion, body, mesh, before);
    if (!made.fine)
        made.after = advance_in_parts(course, start, step, none, plate[0], made.ahead, ground,
                                      motion, body, mesh, before);
    state(X, i) = made.after.x, state(Y, i) = made.after.y, state(ANGLE, i) = made.after.angle;
    state(VX, i) = made.after.vx, state(VY, i) = made.after.vy, state(SPIN, i) = made.after.spin;
}

}  // namespace plate
