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
    double start, end, x[6], y[6], theta[6], line, push, turns, wraps;
};
static_assert(sizeof(Piece) == 24 * sizeof(double));
using Table = std::span<const Piece>;

// Typical magnitudes of a cycle (see `tabulate` in pieces.py). O is the position of the plate's
// centre, and theta is its angle.
// - accel, push: upper bounds of |O''| and |theta''|
// - jerk, push_rate: upper bounds of |O'''| and |theta'''|
// - line: direction of the line along which the plate accelerates, or 0 if there is no such line
// - gravity: component of gravity along the plate
struct Scales {
    double accel, push, jerk, push_rate;
    Vec line, gravity;
};
static_assert(sizeof(Scales) == 8 * sizeof(double));

// A point part: position [m] and velocity [m/s].
struct Point {
    Vec place, velocity;
};

// The plate's motion counts as motion on a line if its acceleration perpendicular to the line is at
// most this fraction of its maximum acceleration. The fraction permits rounding errors.
constexpr double STRAIGHT = 1e-11;

// `place`, `slope` and `bend` return the value, the first derivative and the second derivative of
// the polynomial with coefficients c. The argument u [s] is the time since the polynomial's knot.
inline double place(const double* c, double u) {
    return c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))));
}
inline double slope(const double* c, double u) {
    return c[1] + u * (2 * c[2] + u * (3 * c[3] + u * (4 * c[4] + u * (5 * c[5]))));
}
inline double bend(const double* c, double u) {
    return 2 * c[2] + u * (6 * c[3] + u * (12 * c[4] + u * (20 * c[5])));
}

// Return the estimated index of the piece at the fraction `share` of the motion. The estimate
// assumes that all pieces have the same length.
inline int piece_at(Table table, double share) {
    const int last = static_cast<int>(table.size()) - 1;
    const double k = share * (last + 1);
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
        if (table[0].wraps == 0) {
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
    Vec w = Vec{slope(piece.x, u), slope(piece.y, u)} - part.velocity;
    if (piece.turns != 0) {
        const double spin = slope(piece.theta, u);
        w.x -= spin * (part.place.y - place(piece.y, u));
        w.y += spin * (part.place.x - place(piece.x, u));
    }
    return w;
}

// Return the rate of change [m/s2] of the surface's velocity under a part with position P and
// velocity v. The rate of change is O'' + theta'' x (P - O) + theta' x (v - O').
inline Vec surface_rate(Table table, double t, int k, const Point& part) {
    t = locate(table, t, k);
    const Piece& piece = table[k];
    const double u = t - piece.start;
    Vec a{bend(piece.x, u), bend(piece.y, u)};
    if (piece.turns != 0) {
        const double spin = slope(piece.theta, u), push = bend(piece.theta, u);
        const Vec arm{part.place.x - place(piece.x, u), part.place.y - place(piece.y, u)};
        const Vec v{part.velocity.x - slope(piece.x, u), part.velocity.y - slope(piece.y, u)};
        a.x -= push * arm.y + spin * v.y;
        a.y += push * arm.x + spin * v.x;
    }
    return a;
}

// A part that sticks to the plate: its state and acceleration [m/s2].
struct Ride {
    Point part;
    Vec accel;
};

// Return the state at time t of a part that sticks at the point q of the plate [m, plate frame].
// The function sets k to the piece that contains t.
inline Ride riding(Table table, double t, int& k, Vec q) {
    t = locate(table, t, k);
    const Piece& piece = table[k];
    const double u = t - piece.start;
    Vec r = q;
    double spin = 0, push = 0;
    if (piece.turns != 0) {
        const double theta = place(piece.theta, u), c = std::cos(theta), s = std::sin(theta);
        r = {c * q.x - s * q.y, s * q.x + c * q.y};
        spin = slope(piece.theta, u), push = bend(piece.theta, u);
    }
    return {{{place(piece.x, u) + r.x, place(piece.y, u) + r.y},
             {slope(piece.x, u) - spin * r.y, slope(piece.y, u) + spin * r.x}},
            {bend(piece.x, u) - push * r.y - spin * spin * r.x,
             bend(piece.y, u) + push * r.x - spin * spin * r.y}};
}

// Return the position [m] in the plate frame of a part that is at p [m, plate_home] at time t.
inline Vec in_plate(Table table, double t, int k, Vec p) {
    t = locate(table, t, k);
    const Piece& piece = table[k];
    const double u = t - piece.start;
    const Vec r = p - Vec{place(piece.x, u), place(piece.y, u)};
    if (piece.turns == 0) return r;
    const double theta = place(piece.theta, u), c = std::cos(theta), s = std::sin(theta);
    return {c * r.x + s * r.y, c * r.y - s * r.x};
}

// Return an upper bound of the acceleration [m/s2] of a part that sticks at the distance `radius`
// [m] from the plate's centre. The bound is valid for the whole piece.
inline double ride_bound(const Piece& piece, double radius) {
    return piece.line + radius * piece.push;
}

// Return Bezier point i (0 to 3) of the second derivative of a polynomial with coefficients c, for
// u from 0 to h.
inline double bezier(const double* c, double h, int i) {
    double point = 2 * c[2] + 2 * h * i * c[3];
    if (i >= 2) point += (i == 2 ? 4.0 : 12.0) * h * h * c[4];
    if (i == 3) point += 20 * h * h * h * c[5];
    return point;
}

// Compute the bounds `piece.line` and `piece.push` from the Bezier points of a piece. Raise the
// bounds in `scales` if necessary.
//
// O'' and theta'' are cubic polynomials of time, and a cubic stays in the convex hull of its Bezier
// points. Therefore the maximum norm of the points is an upper bound of O'' and theta''.
// Differences of consecutive points give upper bounds of O''' and theta'''. The bound of theta'
// follows from its values at both ends of the piece.
inline void bound(Piece& piece, Scales& scales) {
    const double h = piece.end - piece.start;
    double line = 0, push = 0, last = 0;
    Vec last_b{0, 0};
    for (int i = 0; i < 4; i++) {
        const Vec b{bezier(piece.x, h, i), bezier(piece.y, h, i)};
        const double turn = bezier(piece.theta, h, i), norm = std::sqrt(dot(b, b));
        line = std::max(line, norm), push = std::max(push, std::abs(turn));
        if (norm > scales.accel) scales.accel = norm, scales.line = {b.x / norm, b.y / norm};
        if (i > 0) {
            const Vec change = b - last_b;
            scales.jerk = std::max(scales.jerk, 3 / h * std::sqrt(dot(change, change)));
            scales.push_rate = std::max(scales.push_rate, 3 / h * std::abs(turn - last));
        }
        last_b = b, last = turn;
    }
    scales.push = std::max(scales.push, push);
    const double spin =
        std::max(std::abs(piece.theta[1]), std::abs(slope(piece.theta, h))) + 0.5 * h * push;
    piece.line = line, piece.push = push + spin * spin;
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
    bool turns = false;
    for (Piece& piece : table) {
        const double t = times[0], fall[] = {0.5 * t * t, t, 0.5};
        piece.start = t, piece.end = times[1];
        for (int i = 0; i < 6; i++, coefficients += 3) {
            piece.x[i] = coefficients[0];
            piece.y[i] = coefficients[1];
            piece.theta[i] = coefficients[2];
            turns |= coefficients[2] != 0;
        }
        for (int i = 0; i < 3; i++) {
            piece.x[i] -= gravity.x * fall[i];
            piece.y[i] -= gravity.y * fall[i];
        }
        bound(piece, scales);
        times++;
    }
    const bool wraps = closed && gravity.x == 0 && gravity.y == 0;
    for (Piece& piece : table) piece.turns = turns, piece.wraps = wraps;
    if (turns || !on_line(table, scales.line, scales.accel)) scales.line = {0, 0};
    scales.gravity = gravity;
    return scales;
}

}  // namespace plate
