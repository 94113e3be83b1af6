// A step in which nothing turns and the plate accelerates much more than friction can: in one go.
//
// The slip of a disc that does not turn, on a plate that does not, is one vector; friction is mu g
// along it. Up to where it is least and from there on it is taken to change evenly: the mean of its
// direction along a straight line is known, also close by its zero. So a slip that reverses on a
// line is followed exactly, one that turns quickly to second order, and none needs a shorter step.
#pragma once
#include <algorithm>
#include <cmath>

#include "plate/course.hpp"
#include "vectors.hpp"

namespace plate::reversing {

// Least change of the slip in a step, over what friction takes off, at both ends of the step.
constexpr double FAST = 2.0;
// Least cosine of the angle between both.
constexpr double BENT = 0.9;
// Corrections of a mean direction, at most, until it changes by less: each makes its error smaller
// by friction's share of the slip's change.
constexpr int ROUNDS = 8;
constexpr double CLOSE = 1e-4;
// A line whose distance from zero is a smaller share of its length goes through zero.
constexpr double THIN = 1e-5;

// Mean of the direction of all points on the line from a to b; n where they are one.
inline Vec heading(Vec from, Vec to, Vec n) {
    Vec d = to - from;
    const double length2 = dot(d, d);
    if (length2 <= 0) return n;
    const double scale = 1 / std::sqrt(length2);
    d = scale * d;
    const double a = std::sqrt(dot(from, from)), b = std::sqrt(dot(to, to));
    const double across = from.x * d.y - from.y * d.x, mean = scale * (b - a);
    if (across * across <= THIN * THIN * length2) return mean * d;
    // asinh of both ends' places along the line over their distance from it
    const double start = dot(from, d), end = dot(to, d);
    double far = start < 0 && 0 < end ? (end + b) * (a - start) / (across * across) : 0;
    if (start >= 0)
        far = (end + b) / (start + a);
    else if (end <= 0)
        far = (a - start) / (b - end);
    const double side = scale * across * std::log(far);
    return {mean * d.x + side * d.y, mean * d.y - side * d.x};
}

// Whether the slip changes fast enough; mean velocity in the step, and velocity at its end [m/s].
struct Reversal {
    bool fits;
    Vec mean, end;
};

// Step a disc at a velocity v [m/s].
//
// plate: samples of the plate's motion at the step's start, middle and end. fall [m/s]: what
// gravity gives along the plate. static_dv, dv [m/s]: what static and dynamic friction can give.
inline Reversal reversal(const PlateSample* plate, Vec fall, double static_dv, double dv, Vec v) {
    // The slip without friction: s + a t + b t^2, t from 0 to 1
    const Vec s = Vec{plate[0].vx, plate[0].vy} - v;
    const Vec m = Vec{plate[1].vx, plate[1].vy} - v - 0.5 * fall;
    const Vec e = Vec{plate[2].vx, plate[2].vy} - v - fall;
    const Vec a = 4 * m - e - 3 * s, b = 2 * (s + e) - 4 * m, z = a + 2 * b;
    const double a2 = dot(a, a), z2 = dot(z, z), product = dot(a, z);
    const double least = (FAST * static_dv) * (FAST * static_dv);
    if (!(std::min(a2, z2) > least && product > 0 && product * product > BENT * BENT * a2 * z2))
        return {false, v, v};
    const double s2 = dot(s, s);
    double t = 0;
    Vec n{0, 0}, w = s;
    if (s2 > 0 && dot(s, a) < 0) {
        n = (1 / std::sqrt(s2)) * s;
        for (int i = 0; i < ROUNDS; i++) {
            const double before = t;
            const Vec r = a + t * b - dv * n;
            t = std::min(std::max(-dot(s, r) / dot(r, r), 0.0), 1.0);
            w = s + t * r;
            n = heading(s, w, n);
            if (std::abs(t - before) <= CLOSE) break;
        }
    }
    // Velocity where the slip is least, and from there on
    const Vec u = v + t * (fall + dv * n);
    const double left = 1 - t, kick = left * dv;
    const Vec g = left * (a + (1 + t) * b);
    const double size = std::sqrt(dot(g, g));
    Vec p = size > 0 ? Vec{g.x / size, g.y / size} : Vec{0, 0};
    for (int i = 0; left > 0 && i < ROUNDS; i++) {
        const Vec q = p;
        p = heading(w, w + g - kick * p, p);
        if (std::abs(p.x - q.x) + std::abs(p.y - q.y) <= CLOSE) break;
    }
    const Vec end = u + left * fall + kick * p;
    return {true, 0.5 * (t * (v + u) + left * (u + end)), end};
}

}  // namespace plate::reversing
