// Exact motion of the plate during a cycle, for the event-driven simulation of parts that are
// modelled as points. A table contains the quintic pieces of the motion. The functions evaluate
// pose, twist and acceleration. pieces.py describes the table.
#pragma once
#include <algorithm>
#include <cmath>
#include <span>

#include "vectors.hpp"

namespace plate {

// A polynomial piece of the motion between two knots. Each piece is one row of a table (K, 24).
// pieces.py describes the columns.
struct Piece {
    double start, end, x[6], y[6], theta[6], centre_bound, radial_bound, rotates, periodic;
};
static_assert(sizeof(Piece) == 24 * sizeof(double));
using Table = std::span<const Piece>;

// Typical magnitudes of a cycle (see `tabulate` in pieces.py). O is the position of the plate's
// centre, and theta is its angle.
// - accel, spin_accel: upper bounds of |O''| and |theta''|
// - jerk, spin_jerk: upper bounds of |O'''| and |theta'''|
// - line: direction of the line along which the plate accelerates, or 0 if there is no such line
// - gravity: component of gravity along the plate
struct Scales {
    double accel, spin_accel, jerk, spin_jerk;
    Vec line, gravity;
};
static_assert(sizeof(Scales) == 8 * sizeof(double));

// A point part: position [m] and velocity [m/s].
struct Point {
    Vec position, velocity;
};

// The plate's motion counts as motion on a line if its acceleration perpendicular to the line is at
// most this fraction of its maximum acceleration. The fraction permits rounding errors.
constexpr double STRAIGHT = 1e-11;

// `value_at`, `rate_at` and `accel_at` return the value, the first derivative and the second
// derivative of the polynomial with coefficients c. The argument u [s] is the time since the
// polynomial's knot.
inline double value_at(const double* c, double u) {
    return c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))));
}
inline double rate_at(const double* c, double u) {
    return c[1] + u * (2 * c[2] + u * (3 * c[3] + u * (4 * c[4] + u * (5 * c[5]))));
}
inline double accel_at(const double* c, double u) {
    return 2 * c[2] + u * (6 * c[3] + u * (12 * c[4] + u * (20 * c[5])));
}

// Return the estimated index of the piece at the fraction `fraction` of the motion. The estimate
// assumes that all pieces have the same length.
inline int piece_at(Table table, double fraction) {
    const int last = static_cast<int>(table.size()) - 1;
    const double k = fraction * (last + 1);
    return k >= last ? last : k > 0 ? static_cast<int>(k) : 0;
}

// Return the index of the piece that contains the time t [s]. The search starts at piece k. Times
// outside the motion belong to the first or last piece.
inline int seek(Table table, double t, int k) {
    while (k > 0 && t < table[k].start) k--;
    while (k + 1 < static_cast<int>(table.size()) && t >= table[k].end) k++;
    return k;
}

// If t [s] is after the end of a closed cycle, subtract the period. Return the reduced time, and
// set k to the piece that contains this time. If t is not in piece k, the search starts at an
// estimated piece.
inline double locate(Table table, double t, int& k) {
    const double period = table.back().end;
    if (t >= period) {
        if (table[0].periodic == 0) {
            k = static_cast<int>(table.size()) - 1;
            return t;
        }
        t -= period;
    }
    if (t < table[k].start || t >= table[k].end) k = seek(table, t, piece_at(table, t / period));
    return t;
}

// Return the slip w = v_s - v [m/s] of a part with position P and velocity v at time t. The
// velocity of the plate's surface at P is v_s = O' + theta' x (P - O). The function sets k to the
// piece that contains t.
inline Vec slip(Table table, double t, int& k, const Point& part) {
    t = locate(table, t, k);
    const Piece& piece = table[k];
    const double u = t - piece.start;
    Vec w = Vec{rate_at(piece.x, u), rate_at(piece.y, u)} - part.velocity;
    if (piece.rotates != 0) {
        const double spin = rate_at(piece.theta, u);
        w.x -= spin * (part.position.y - value_at(piece.y, u));
        w.y += spin * (part.position.x - value_at(piece.x, u));
    }
    return w;
}

// Return the rate of change [m/s2] of the surface's velocity under a part with position P and
// velocity v. The rate of change is O'' + theta'' x (P - O) + theta' x (v - O').
inline Vec surface_rate(Table table, double t, int k, const Point& part) {
    t = locate(table, t, k);
    const Piece& piece = table[k];
    const double u = t - piece.start;
    Vec a{accel_at(piece.x, u), accel_at(piece.y, u)};
    if (piece.rotates != 0) {
        const double spin = rate_at(piece.theta, u), spin_accel = accel_at(piece.theta, u);
        const Vec arm{part.position.x - value_at(piece.x, u),
                      part.position.y - value_at(piece.y, u)};
        const Vec v{part.velocity.x - rate_at(piece.x, u), part.velocity.y - rate_at(piece.y, u)};
        a.x -= spin_accel * arm.y + spin * v.y;
        a.y += spin_accel * arm.x + spin * v.x;
    }
    return a;
}

// A part that sticks to the plate: its state and acceleration [m/s2].
struct StuckPart {
    Point part;
    Vec accel;
};

// Return the state at time t of a part that sticks at the point q of the plate [m, plate frame].
// The function sets k to the piece that contains t.
inline StuckPart stuck_part(Table table, double t, int& k, Vec q) {
    t = locate(table, t, k);
    const Piece& piece = table[k];
    const double u = t - piece.start;
    Vec r = q;
    double spin = 0, spin_accel = 0;
    if (piece.rotates != 0) {
        const double theta = value_at(piece.theta, u), c = std::cos(theta), s = std::sin(theta);
        r = {c * q.x - s * q.y, s * q.x + c * q.y};
        spin = rate_at(piece.theta, u), spin_accel = accel_at(piece.theta, u);
    }
    return {{{value_at(piece.x, u) + r.x, value_at(piece.y, u) + r.y},
             {rate_at(piece.x, u) - spin * r.y, rate_at(piece.y, u) + spin * r.x}},
            {accel_at(piece.x, u) - spin_accel * r.y - spin * spin * r.x,
             accel_at(piece.y, u) + spin_accel * r.x - spin * spin * r.y}};
}

// Return the position [m] in the plate frame of a part that is at p [m, plate_home] at time t.
inline Vec to_plate_frame(Table table, double t, int k, Vec p) {
    t = locate(table, t, k);
    const Piece& piece = table[k];
    const double u = t - piece.start;
    const Vec r = p - Vec{value_at(piece.x, u), value_at(piece.y, u)};
    if (piece.rotates == 0) return r;
    const double theta = value_at(piece.theta, u), c = std::cos(theta), s = std::sin(theta);
    return {c * r.x + s * r.y, c * r.y - s * r.x};
}

// Return an upper bound of the acceleration [m/s2] of a part that sticks at the distance `radius`
// [m] from the plate's centre. The bound is valid for the whole piece.
inline double ride_bound(const Piece& piece, double radius) {
    return piece.centre_bound + radius * piece.radial_bound;
}

// Return Bezier point i (0 to 3) of the second derivative of a polynomial with coefficients c, for
// u from 0 to h.
inline double bezier(const double* c, double h, int i) {
    double point = 2 * c[2] + 2 * h * i * c[3];
    if (i >= 2) point += (i == 2 ? 4.0 : 12.0) * h * h * c[4];
    if (i == 3) point += 20 * h * h * h * c[5];
    return point;
}

// Compute the bounds `piece.centre_bound` and `piece.radial_bound` from the Bezier points of a
// piece. Raise the bounds in `scales` if necessary.
//
// O'' and theta'' are cubic polynomials of time, and a cubic stays in the convex hull of its Bezier
// points. Therefore the maximum norm of the points is an upper bound of O'' and theta''.
// Differences of consecutive points give upper bounds of O''' and theta'''. The bound of theta'
// follows from its values at both ends of the piece.
inline void bound(Piece& piece, Scales& scales) {
    const double h = piece.end - piece.start;
    double centre_accel = 0, spin_accel = 0, previous = 0;
    Vec previous_b{0, 0};
    for (int i = 0; i < 4; i++) {
        const Vec b{bezier(piece.x, h, i), bezier(piece.y, h, i)};
        const double theta_accel = bezier(piece.theta, h, i), norm = std::sqrt(dot(b, b));
        centre_accel = std::max(centre_accel, norm);
        spin_accel = std::max(spin_accel, std::abs(theta_accel));
        if (norm > scales.accel) scales.accel = norm, scales.line = {b.x / norm, b.y / norm};
        if (i > 0) {
            const Vec change = b - previous_b;
            scales.jerk = std::max(scales.jerk, 3 / h * std::sqrt(dot(change, change)));
            scales.spin_jerk = std::max(scales.spin_jerk, 3 / h * std::abs(theta_accel - previous));
        }
        previous_b = b, previous = theta_accel;
    }
    scales.spin_accel = std::max(scales.spin_accel, spin_accel);
    const double spin = std::max(std::abs(piece.theta[1]), std::abs(rate_at(piece.theta, h))) +
                        0.5 * h * spin_accel;
    piece.centre_bound = centre_accel, piece.radial_bound = spin_accel + spin * spin;
}

// Whether the plate accelerates only along the unit vector n. `accel` is the plate's maximum
// acceleration [m/s2].
inline bool on_line(Table table, Vec n, double accel) {
    for (const Piece& piece : table) {
        const double h = piece.end - piece.start;
        double across = std::abs(n.y * piece.x[5] - n.x * piece.y[5]);
        for (int i = 4; i > 1; i--)
            across = std::abs(n.y * piece.x[i] - n.x * piece.y[i]) + h * across;
        if (across > STRAIGHT * accel) return false;
    }
    return true;
}

// Fill a table from the knots (K + 1,) [s] and the coefficients (K, 6, 3) of a cycle. Return the
// `Scales` of the cycle.
inline Scales tabulate(const double* times, const double* coefficients, Vec gravity, bool closed,
                       std::span<Piece> table) {
    Scales scales{};
    bool rotates = false;
    for (Piece& piece : table) {
        const double t = times[0], gravity_terms[] = {0.5 * t * t, t, 0.5};
        piece.start = t, piece.end = times[1];
        for (int i = 0; i < 6; i++, coefficients += 3) {
            piece.x[i] = coefficients[0];
            piece.y[i] = coefficients[1];
            piece.theta[i] = coefficients[2];
            rotates |= coefficients[2] != 0;
        }
        for (int i = 0; i < 3; i++) {
            piece.x[i] -= gravity.x * gravity_terms[i];
            piece.y[i] -= gravity.y * gravity_terms[i];
        }
        bound(piece, scales);
        times++;
    }
    const bool periodic = closed && gravity.x == 0 && gravity.y == 0;
    for (Piece& piece : table) piece.rotates = rotates, piece.periodic = periodic;
    if (rotates || !on_line(table, scales.line, scales.accel)) scales.line = {0, 0};
    scales.gravity = gravity;
    return scales;
}

}  // namespace plate
