// Time step of a disc whose slip reverses its direction. The disc and the plate do not rotate.
//
// The slip w(t) is the velocity of the plate minus the velocity of the disc. Friction accelerates
// the disc by mu g along w/|w|. The time t is 0 at the start and 1 at the end of the step. The slip
// without friction is s + a t + b t^2. With friction, the slip is
//
//     w(t) = s + a t + b t^2 - dv int_0^t w/|w|, dv = mu g dt.
//
// If the plate accelerates much more than mu g, the path of the vector w is nearly straight. The
// step is split at the minimum of |w|. Before and after this time, the path of w is approximated by
// a straight segment. The mean of w/|w| along a segment has a closed form, which is also valid near
// w = 0. Therefore the method does not need shorter steps. The method is exact for a slip that
// reverses on a line. For a slip that rotates quickly, the method is of second order.
#pragma once
#include <algorithm>
#include <cmath>

#include "plate/course.hpp"
#include "vectors.hpp"

namespace plate::reversing {

// Minimum rate of change of the slip without friction, as a multiple of the acceleration by static
// friction. If the rate is lower at one end of the step, the method is not used.
constexpr double FAST = 2.0;
// Minimum cosine of the angle between the rates of change of the slip at both ends of the step.
constexpr double BENT = 0.9;
// ROUNDS is the maximum number of iterations for the mean of w/|w| along a segment. The iterations
// end if the result changes by at most CLOSE. Each iteration multiplies the error by about the
// ratio of the friction acceleration to the rate of change of the slip.
constexpr int ROUNDS = 8;
constexpr double CLOSE = 1e-4;
// If the distance of a segment's line from the point w = 0 is below this fraction of the segment's
// length, the line counts as passing through w = 0.
constexpr double THIN = 1e-5;

// Return the mean of x/|x| over the points x of the segment from `from` to `to`. If both ends are
// equal, return n.
inline Vec mean_direction(Vec from, Vec to, Vec n) {
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

// Result of a step: whether the method is applicable (`fits`), mean velocity of the disc during the
// step, and velocity at its end [m/s].
struct Reversal {
    bool fits;
    Vec mean, end;
};

// Compute a time step of a disc with the initial velocity v [m/s].
//
// `plate` contains samples of the plate's motion at the start, in the middle and at the end of the
// step. `fall`, `static_dv` and `dv` [m/s] are the velocity changes in the step by gravity along
// the plate, by static friction and by dynamic friction.
inline Reversal reversal(const PlateSample* plate, Vec fall, double static_dv, double dv, Vec v) {
    // The slip without friction is s + a t + b t^2, with t from 0 to 1. Let z be the rate of change
    // of this slip at t = 1.
    const Vec s = Vec{plate[0].vx, plate[0].vy} - v;
    const Vec m = Vec{plate[1].vx, plate[1].vy} - v - 0.5 * fall;
    const Vec e = Vec{plate[2].vx, plate[2].vy} - v - fall;
    const Vec a = 4 * m - e - 3 * s, b = 2 * (s + e) - 4 * m, z = a + 2 * b;
    const double a2 = dot(a, a), z2 = dot(z, z), product = dot(a, z);
    const double minimum = (FAST * static_dv) * (FAST * static_dv);
    if (!(std::min(a2, z2) > minimum && product > 0 && product * product > BENT * BENT * a2 * z2))
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
            n = mean_direction(s, w, n);
            if (std::abs(t - before) <= CLOSE) break;
        }
    }
    // u is the velocity of the disc at the minimum of the slip. The following lines compute the
    // rest of the step.
    const Vec u = v + t * (fall + dv * n);
    const double remaining = 1 - t, remaining_dv = remaining * dv;
    const Vec g = remaining * (a + (1 + t) * b);
    const double size = std::sqrt(dot(g, g));
    Vec p = size > 0 ? Vec{g.x / size, g.y / size} : Vec{0, 0};
    for (int i = 0; remaining > 0 && i < ROUNDS; i++) {
        const Vec q = p;
        p = mean_direction(w, w + g - remaining_dv * p, p);
        if (std::abs(p.x - q.x) + std::abs(p.y - q.y) <= CLOSE) break;
    }
    const Vec end = u + remaining * fall + remaining_dv * p;
    return {true, 0.5 * (t * (v + u) + remaining * (u + end)), end};
}

}  // namespace plate::reversing
