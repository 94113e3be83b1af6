// Step of a disc without spin whose slip reverses, on a plate that does not rotate.
//
// The slip is one vector w(t). Friction accelerates the disc by mu g along w/|w|. If t goes from 0
// to 1 over the step,
//
//     w(t) = s + a t + b t^2 - dv int_0^t w/|w|,    dv = mu g dt.
//
// If the plate accelerates much more than friction does, w is nearly straight. The step is split at
// the minimum of |w|. In both parts, w is approximated by a straight segment. The mean of w/|w|
// along a segment has a closed form, which is also valid near 0. Therefore the method needs no
// shorter steps. It is exact for a slip that reverses on a line. For a slip that rotates quickly,
// it is of second order.
#pragma once
#include <algorithm>
#include <cmath>

#include "plate/course.hpp"
#include "vectors.hpp"

namespace plate::reversing {

// Minimum rate of change of the slip at both ends of the step, as a multiple of the rate that
// static friction can cause.
constexpr double FAST = 2.0;
// Minimum cosine of the angle between the rates at both ends of the step.
constexpr double BENT = 0.9;
// Maximum number of iterations for a mean direction, and the change of the direction at which the
// iterations end. Each iteration multiplies the error by the ratio of friction to the change of the
// slip.
constexpr int ROUNDS = 8;
constexpr double CLOSE = 1e-4;
// If the line of a segment is closer to 0 than this fraction of the segment's length, the segment
// passes through 0.
constexpr double THIN = 1e-5;

// Mean of x/|x| over the segment from `from` to `to`. The result is n if both points are equal.
inline Vec heading(Vec from, Vec to, Vec n) {
    Vec d = to - from;
    const double length2 = dot(d, d);
    if (length2 <= 0) return n;
    const double scale = 1 / std::sqrt(length2);
    d = scale * d;
    const double a = std::sqrt(dot(from, from)), b = std::sqrt(dot(to, to));
    const double across = from.x * d.y - from.y * d.x, mean = scale * (b - a);
    if (across * across <= THIN * THIN * length2) return mean * d;
    // log(far) = asinh(end / |across|) - asinh(start / |across|), without cancellation
    const double start = dot(from, d), end = dot(to, d);
    double far = start < 0 && 0 < end ? (end + b) * (a - start) / (across * across) : 0;
    if (start >= 0)
        far = (end + b) / (start + a);
    else if (end <= 0)
        far = (a - start) / (b - end);
    const double side = scale * across * std::log(far);
    return {mean * d.x + side * d.y, mean * d.y - side * d.x};
}

// Whether the method applies, mean velocity of the disc in the step, and velocity at the end of the
// step [m/s].
struct Reversal {
    bool fits;
    Vec mean, end;
};

// Compute a step of a disc with the velocity v [m/s].
//
// `plate` contains samples of the plate's motion at the start, in the middle and at the end of the
// step. `fall`, `static_dv` and `dv` [m/s] are the velocity changes in the step by gravity along
// the plate, by static friction and by dynamic friction.
inline Reversal reversal(const PlateSample* plate, Vec fall, double static_dv, double dv, Vec v) {
    // The slip without friction is s + a t + b t^2, with t from 0 to 1. Its rate of change at t = 1
    // is z.
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
    // Compute the velocity u at the minimum of the slip, then the rest of the step.
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
