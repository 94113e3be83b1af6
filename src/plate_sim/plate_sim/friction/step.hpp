// One step of one finite part: it slides and turns, rides with the plate, or comes to stick.
//
// Friction at the middle of the step moves a part that slides steadily (midpoint rule: second
// order; explicit, or implicit where friction changes much with the slip). Where the slip turns
// quickly the step is halved, at most `HALVINGS` times; where it reverses the step is cut just
// before. The shortest are implicit Euler steps. A part that sticks at both ends of a step rides
// with the plate exactly, so it cannot creep.
//
// Discs that slide steadily are most of all parts in most steps: `glide` moves them all at once,
// without branches, several per instruction; `advance` does what is left, part by part.
#pragma once
#include <plate/view.hpp>
#include <plate/wide.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "friction/disc.hpp"
#include "friction/patch.hpp"
#include "friction/reversal.hpp"
#include "plate/course.hpp"
#include "plate/ground.hpp"

namespace plate {

// Rows of a state (6, P): place [m], angle [rad] and their rates, in plate_home, of P parts.
constexpr int X = 0, Y = 1, ANGLE = 2, VX = 3, VY = 4, SPIN = 5;

// What does not change of a part: a record of BODY in step.py, or the same bytes as ten numbers.
struct Body {
    double mu_g, gyration2, radius, reach, slim, mass_inverse;
    std::int64_t first_point, end_point, first_piece, end_piece;

    // Whether it is a disc that presses evenly on the plate.
    bool even() const { return first_point == end_point; }
};
static_assert(sizeof(Body) == 10 * sizeof(double));

}  // namespace plate

namespace plate::stepping {

// How often a step is halved where the slip turns: friction reverses on time to 1/512 of it.
constexpr int HALVINGS = 9;
// Least cosine of the slip's turn to the middle and the end of a step that is not halved.
constexpr double STEADY = 0.9;
// A slip below this share of mu g dt counts as none: it comes from rounding, not from sliding.
constexpr double STUCK = 1e-3;
// Friction that changes by less than this share of the slip in a step needs no implicit rule.
constexpr double GENTLE = 0.5;
// A disc's friction changes at most about so much [mu g] when its slip changes by its own size.
constexpr double DISC_STIFF = 3.0;
// Discs that `glide` takes through each stage of a step before the next stage: one vector of them
// then does not wait for the roots of another.
constexpr int BLOCK = 64;

// State of one part: place [m], angle [rad], and their rates, plate_home.
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

// A vector in the axes of a part at an angle with cosine c and sine s, and back.
inline Slip to_part(const Slip& a, double c, double s) {
    return {c * a.x + s * a.y, c * a.y - s * a.x, a.turn};
}
inline Slip from_part(const Slip& a, double c, double s) {
    return {c * a.x - s * a.y, s * a.x + c * a.y, a.turn};
}

// Whether two slips have nearly the same direction.
inline bool alike(const Slip& a, const Slip& b, double gyration2) {
    const double product = dot(a, b, gyration2);
    return product > 0 &&
           product * product > STEADY * STEADY * dot(a, a, gyration2) * dot(b, b, gyration2);
}

// Twist of the plate at (x, y) less that of a part: equation (2).
[[gnu::always_inline]] inline Slip slip(const PlateSample& plate, double x, double y, double vx,
                                       double vy, double spin) {
    return {plate.vx - plate.spin * (y - plate.y) - vx, plate.vy + plate.spin * (x - plate.x) - vy,
            plate.spin - spin};
}

// The motion h [s] later if the velocity changes evenly to (vx, vy, spin).
inline Motion moved(const Motion& m, double h, double vx, double vy, double spin) {
    return {m.x + 0.5 * h * (m.vx + vx), m.y + 0.5 * h * (m.vy + vy),
            m.angle + 0.5 * h * (m.spin + spin), vx, vy, spin};
}

// As `patch::friction`, in plate_home, for a part at `angle` [rad]; also for discs.
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

// As `patch::slip_after`, in plate_home, for a part at `angle` [rad]; also for discs.
inline Slip slip_after(const Slip& free, double angle, double dv, const Body& body,
                       const Mesh& mesh) {
    if (body.even()) return disc::disc_slip_after(free, dv, body.gyration2, body.radius);
    const double c = std::cos(angle), s = std::sin(angle);
    const Slip left = patch::slip_after(to_part(free, c, s), dv, body.gyration2, mesh,
                                        body.first_point, body.end_point);
    return from_part(left, c, s);
}

// Whether friction that can give dv [m/s] takes all of a slip.
inline bool holds(const Slip& slip, double angle, double dv, const Body& body, const Mesh& mesh) {
    constexpr double MOST = (1 + disc::SNAP) * (1 + disc::SNAP);
    if (slip.x * slip.x + slip.y * slip.y > MOST * dv * dv) return false;
    const Slip left = slip_after(slip, angle, dv, body, mesh);
    return left.x == 0 && left.y == 0 && left.turn == 0;
}

// The slip in the middle of a step, and what friction there adds to the twist.
struct Middle {
    Slip half, push;
};

// `slip` is that at the start, at `angle` [rad]; `free` that in the middle, `turn` [rad] on, if
// there were no friction.
inline Middle midpoint(const Slip& slip, const Slip& free, double angle, double turn, double dv,
                       const Body& body, const Mesh& mesh) {
    patch::Friction now = friction(slip, angle, body, mesh);
    if (dv * now.stiff <= GENTLE) {
        const Slip half = free - 0.5 * dv * now.push;
        now = friction(half, angle + turn, body, mesh);
        if (dv * now.stiff <= GENTLE) return {half, dv * now.push};
    }
    const Slip half = slip_after(free, angle + turn, 0.5 * dv, body, mesh);
    return {half, 2 * (free - half)};
}

// Whether a step serves, the motion after it, and, if it does not, at what share of it the slip is
// about to reverse; else 0.
struct Attempt {
    bool fine;
    Motion after;
    double ahead = 0;
};

// Whether friction can hold a stuck part through a step, and its motion then.
//
// fall [m/s]: what gravity gives along the plate. static_dv [m/s]: what static friction can give.
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
    // Also at the end of the step, where it may come loose: the velocity is about a parabola.
    turn = middle.theta - start.theta;
    const Slip half =
        slip(middle, middle.x + rx - turn * ry, middle.y + ry + turn * rx, m.vx, m.vy, m.spin);
    return {holds(3 * gain - 4 * half - pull, m.angle, static_dv, body, mesh), after};
}

// Make one step of h [s].
//
// last: it has to be fine enough. none: slip [m/s] that counts as none.
inline Attempt attempt(const PlateSample* plate, double h, bool last, double none,
                       const GroundEffect& ground, const Motion& m, const Body& body,
                       const Mesh& mesh) {
    const double slow = body.mu_g * h, g2 = body.gyration2, static_dv = ground.static_ratio * slow;
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
    if (ground.slope != 0) [[unlikely]] {  // by the slip in the middle: over a disc, the rms
        const double speed = std::sqrt(dot(middle, middle, g2));
        dv = slow * ground.share(std::max(0.0, speed - 0.5 * slow * ground.share(speed)));
    }
    const auto [half, push] = midpoint(start, middle, m.angle, 0.5 * h * m.spin, dv, body, mesh);
    Motion after = moved(m, h, m.vx + fall.x + push.x, m.vy + fall.y + push.y, m.spin + push.turn);
    const Slip end = slip(plate[2], after.x, after.y, after.vx, after.vy, after.spin);
    bool loose = true;
    if (stuck) {  // it comes loose: from 0 the slip grows about as a parabola, at first along this
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

// A shorter part of a step than `size`: up to where the slip vanishes, or half of it.
inline int shorter(int size, double ahead) {
    return ahead > 0 ? std::max(1, std::min(size - 1, static_cast<int>(size * ahead))) : size >> 1;
}

// The motion after a step that is cut until each part of it is fine enough.
//
// first: the plate at its start. ahead: as `attempt` returns it for the whole step.
inline Motion advance_in_parts(const Course& course, double start, double step, double none,
                               const PlateSample& first, double ahead, const GroundEffect& ground,
                               Motion motion, const Body& body, const Mesh& mesh) {
    constexpr int FINEST = 1 << HALVINGS;
    PlateSample plate[3] = {first};
    int done = 0, size = shorter(FINEST, ahead);
    bool to_end = ahead > 0;
    while (true) {
        const double t = start + done * step / FINEST, h = step * size / FINEST;
        plate[1] = course.at(t + 0.5 * h);
        plate[2] = course.at(t + h);
        const Attempt made = attempt(plate, h, size == 1, none, ground, motion, body, mesh);
        if (!made.fine) {
            size = shorter(size, made.ahead), to_end = made.ahead > 0;
            continue;
        }
        motion = made.after;
        done += size;
        if (done == FINEST) return motion;
        // Where the slip was to vanish just ahead the finest part passes that, then all the rest.
        size = !to_end ? 2 * size : size > 1 ? 1 : FINEST - done;
        to_end = to_end && size == 1;
        size = std::min(size, FINEST - done);
        plate[0] = plate[2];
    }
}

// Whether a disc at no spin is at rest or turns its slip round so quickly that `reversal` serves,
// and its motion after a step of h [s].
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

// Parts that `glide` moves at once: states have a multiple of so many columns.
constexpr int LANES = 4;

// What `glide` needs of the parts, rows of (5, P): mu g times the step [m/s]; the square of the
// slip [m2/s2] from which on friction changes little in a step, infinite where there is no disc;
// squared radius and radius of gyration [m2], and the former over the latter.
constexpr int DV = 0, LEAST = 1, RADIUS2 = 2, GYRATION2 = 3, RATIO = 4, GLIDER = 5;

// Fill column i of it for a body, that is there or not; return whether it may glide.
inline bool set_glider(const View<double, 2>& gliders, int i, const Body& body, double step,
                       bool here) {
    const double dv = body.mu_g * step, least = stepping::DISC_STIFF / stepping::GENTLE * dv;
    const bool can = here && body.radius > 0 && body.even();
    gliders(DV, i) = dv;
    gliders(LEAST, i) = can && dv > 0 ? least * least : std::numeric_limits<double>::infinity();
    gliders(RADIUS2, i) = body.radius * body.radius, gliders(GYRATION2, i) = body.gyration2;
    gliders(RATIO, i) = gliders(RADIUS2, i) / body.gyration2;
    return can;
}

// Move the discs that slide steadily through a step, as `advance` would; return how many.
//
// plate: samples of the plate's motion at the step's start, middle and end. step [s]. state (6, P):
// changed. done (P,): set to 1 where the disc has been moved, else to 0. NaN and infinity mark
// lanes that do not glide.
PLATE_WIDE inline int glide(const PlateSample* plate, double step, const GroundEffect& ground,
                            View<double, 2> state, View<const double, 2> gliders, double* done) {
    using namespace stepping;
    const PlateSample start = plate[0], middle = plate[1], end = plate[2];
    const double fall_x = step * ground.gravity_x, fall_y = step * ground.gravity_y;
    const double half = 0.5 * step;
    double all = 0;
    for (int first = 0; first < gliders.size(1); first += BLOCK) {
        double *__restrict x = state[X] + first, *__restrict vx = state[VX] + first;
        double *__restrict y = state[Y] + first, *__restrict vy = state[VY] + first;
        double *__restrict angle = state[ANGLE] + first, *__restrict spin = state[SPIN] + first;
        const double* __restrict dv = gliders[DV] + first;
        const double* __restrict least = gliders[LEAST] + first;
        const double* __restrict ratio = gliders[RATIO] + first;
        const double* __restrict radius2 = gliders[RADIUS2] + first;
        const double* __restrict gyration2 = gliders[GYRATION2] + first;
        double* __restrict moved = done + first;
        const int count = LANES * std::min(BLOCK / LANES, (gliders.size(1) - first) / LANES);
        // Slips at the start and in the middle, and squares of (speed of the rim / of the centre)
        double ax[BLOCK], ay[BLOCK], ac[BLOCK], a2[BLOCK], ak2[BLOCK];
        double bx[BLOCK], by[BLOCK], bc[BLOCK], b2[BLOCK], bk2[BLOCK];
#pragma omp simd
        for (int i = 0; i < count; i++) {
            const Slip a = slip(start, x[i], y[i], vx[i], vy[i], spin[i]);
            ax[i] = a.x, ay[i] = a.y, ac[i] = a.turn;
            a2[i] = a.x * a.x + a.y * a.y;
            ak2[i] = radius2[i] * a.turn * a.turn / a2[i];
        }
#pragma omp simd
        for (int i = 0; i < count; i++) {
            const disc::Push push = disc::series(ak2[i]);
            const double share = 0.5 * dv[i] / std::sqrt(a2[i]);
            const double px = x[i] + half * vx[i], py = y[i] + half * vy[i];
            const Slip free = slip(middle, px, py, vx[i], vy[i], spin[i]);
            bx[i] = free.x - 0.5 * fall_x - share * push.force * ax[i];
            by[i] = free.y - 0.5 * fall_y - share * push.force * ay[i];
            bc[i] = free.turn - share * push.torque * ratio[i] * ac[i];
            b2[i] = bx[i] * bx[i] + by[i] * by[i];
            bk2[i] = radius2[i] * bc[i] * bc[i] / b2[i];
        }
#pragma omp simd reduction(+ : all)
        for (int i = 0; i < count; i++) {
            const double g2 = gyration2[i];
            const Slip a{ax[i], ay[i], ac[i]}, b{bx[i], by[i], bc[i]};
            const disc::Push push = disc::series(bk2[i]);
            const double share = dv[i] / std::sqrt(b2[i]);
            const double ux = vx[i] + fall_x + share * push.force * b.x;
            const double uy = vy[i] + fall_y + share * push.force * b.y;
            const double uc = spin[i] + share * push.torque * ratio[i] * b.turn;
            const double px = x[i] + half * (vx[i] + ux), py = y[i] + half * (vy[i] + uy);
            const Slip z = slip(end, px, py, ux, uy, uc);
            // Does it slide fast enough, and nearly in one direction? (`alike`)
            const double size2 = a2[i] + g2 * a.turn * a.turn;  // as `dot(a, a, g2)`
            const double middle2 = b2[i] + g2 * b.turn * b.turn, end2 = dot(z, z, g2);
            const double ab = dot(a, b, g2), az = dot(a, z, g2);
            const double turn = std::min(ab * std::abs(ab) - STEADY * STEADY * size2 * middle2,
                                         az * std::abs(az) - STEADY * STEADY * size2 * end2);
            const bool steady = (std::min(size2, middle2) >= least[i]) &
                                (std::max(ak2[i], bk2[i]) <= disc::SERIES) & (turn > 0);
            moved[i] = steady ? 1.0 : 0.0;
            all += moved[i];
            x[i] = steady ? px : x[i];
            y[i] = steady ? py : y[i];
            angle[i] = steady ? angle[i] + half * (spin[i] + uc) : angle[i];
            vx[i] = steady ? ux : vx[i];
            vy[i] = steady ? uy : vy[i];
            spin[i] = steady ? uc : spin[i];
        }
    }
    return static_cast<int>(all);
}

// Advance part i by a step, in place.
//
// start, step [s]: when the step begins in the course, and its length. plate: samples at
// its start, middle and end.
inline void advance(const Course& course, double start, double step, const PlateSample* plate,
                    const GroundEffect& ground, View<double, 2> state, int i, const Body& body,
                    const Mesh& mesh) {
    using namespace stepping;
    const Motion motion{state(X, i),  state(Y, i),  state(ANGLE, i),
                        state(VX, i), state(VY, i), state(SPIN, i)};
    const double none = STUCK * body.mu_g * step;
    Attempt made{false, motion};
    if (body.radius > 0 && motion.spin == 0 && body.even() && ground.slope == 0)
        made = reverse(plate, step, ground, motion, body);
    if (!made.fine) made = attempt(plate, step, false, none, ground, motion, body, mesh);
    if (!made.fine)
        made.after = advance_in_parts(course, start, step, none, plate[0], made.ahead, ground,
                                      motion, body, mesh);
    state(X, i) = made.after.x, state(Y, i) = made.after.y, state(ANGLE, i) = made.after.angle;
    state(VX, i) = made.after.vx, state(VY, i) = made.after.vy, state(SPIN, i) = made.after.spin;
}

}  // namespace plate
