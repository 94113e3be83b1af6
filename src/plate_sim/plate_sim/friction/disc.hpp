// Friction force and torque on a disc with uniform pressure on the plate, in closed form.
//
// R is the radius of the disc. Relative to the plate, the centre slips with the speed s, and the
// disc rotates with the spin c. At the edge, the spin adds the slip w = R |c|. The mean slip speed
// of the disc's points is a complete elliptic integral of s and w. The derivatives of this mean
// with respect to s and w give force and torque (Farkas, Bartels, Unger and Wolf, PRL 90, 248302,
// 2003).
//
// For w <= s/2, a power series is used. With k = w/s the mean slip is s sum_n b_n k^2n, where b_n =
// binomial(1/2, n)^2/(n + 1). Otherwise the elliptic integrals are computed by the
// arithmetic-geometric mean (Abramowitz and Stegun 1964, 17.6), in a form that avoids cancellation.
#pragma once
#include <algorithm>
#include <cmath>
#include <numbers>

namespace plate {

// Twist of the plate minus the twist of a part, at the part's centre [m/s, m/s, rad/s].
struct Slip {
    double x, y, spin;
};

}  // namespace plate

namespace plate::disc {

// The velocity step is the maximum velocity change mu g dt that friction can cause in a time step.
// If the slip after a step is below this fraction of the velocity step, the part sticks.
constexpr double SNAP = 1e-3;
// `disc_slip_after` computes the direction n of the slip after a step. CLOSE is the tolerance of
// the slip's component perpendicular to n, as a fraction of the velocity step.
constexpr double CLOSE = 1e-9;
// The iteration of the arithmetic-geometric mean ends if half the difference of its two numbers,
// divided by their mean, is at most this value. At this point, the arithmetic and the geometric
// mean of the two numbers are equal up to rounding.
constexpr double MEANS = 2e-8;
// Maximum k^2 for which the power series is used. The omitted terms are below 2e-10 mu m g.
constexpr double SERIES = 0.25;

// Force [mu m g] and torque [mu m g R] on a disc.
struct DiscFriction {
    double force, torque;
};

// Returns the force, and the torque divided by k, from the power series. The series is valid for
// k^2 up to `SERIES`.
[[gnu::always_inline]] inline DiscFriction series(double k2) {
    double force = -0.00020234903786331415, torque = 0.0001563606201671064;
    force = -0.0002856692299246788 + k2 * force, torque = 0.0002142519224435091 + k2 * torque;
    force = -0.00042191147804260254 + k2 * force, torque = 0.0003047138452529907 + k2 * torque;
    force = -0.0006608963012695312 + k2 * force, torque = 0.00045436620712280273 + k2 * torque;
    force = -0.00112152099609375 + k2 * force, torque = 0.000720977783203125 + k2 * torque;
    force = -0.00213623046875 + k2 * force, torque = 0.0012461344401041667 + k2 * torque;
    force = -0.0048828125 + k2 * force, torque = 0.00244140625 + k2 * torque;
    force = -0.015625 + k2 * force, torque = 0.005859375 + k2 * torque;
    force = -0.125 + k2 * force, torque = 0.020833333333333332 + k2 * torque;
    return {1.0 + k2 * force, 0.25 + k2 * torque};
}

// Returns force and torque on a disc. The centre of the disc slips with the speed s [m/s]. Rotation
// adds the speed w [m/s] at its edge. Both speeds must be at least 0, and one of them must be above
// 0.
inline DiscFriction disc_force(double s, double w) {
    if (w * w <= SERIES * s * s) {
        const DiscFriction friction = series((w / s) * (w / s));
        return {friction.force, friction.torque * w / s};
    }
    const double k = s <= w ? s / w : w / s, k2 = std::min(k * k, 1 - 1e-15);
    double a = 1, b = std::sqrt(1 - k2), c = 0.5 * k2 / (1 + b);
    double total = 0, weight = 1;
    while (true) {
        total += weight * c * c;
        weight *= 2;
        const double product = a * b;
        a = 0.5 * (a + b), b = std::sqrt(product);
        if (!(c > MEANS * a)) break;  // this condition also ends the loop for NaN
        c = 0.5 * (a - b);
    }
    // K = pi/(2 a), and E = K (1 - k2/2 - total)
    const double rest = k2 > 0 ? total / k2 : 0;
    const double force = 2 / (3 * a) * (1.5 - 0.5 * k2 - (1 + k2) * rest);
    if (s <= w) return {k * force, 2 / (9 * a) * (3 - 3 * k2 + k2 * k2 - (4 - 2 * k2) * total)};
    return {force, 2 / (9 * a) * k * (1 + (2 - 4 * k2) * (k2 > 0 ? rest / k2 : 0.0625))};
}

// Return the slip of a disc after a time step with friction. `free` is the slip after the step
// without friction. `dv` is mu g dt [m/s]. `patch::slip_after` is the corresponding function for
// other footprints.
//
// By symmetry, there are two unknowns: the slip s of the centre, and g |c|, where g is the radius
// of gyration. The two unknowns form a vector in a plane. Let z be the vector of the slip without
// friction, divided by dv. Let y(n) be the friction force and torque on a disc whose slip has the
// direction of the unit vector n. The slip after the step is dv (z - y). The vector y is the point
// nearest to z in the convex set of all friction vectors. Therefore z - y(n) is parallel to n. The
// method of regula falsi computes the angle p of n.
inline Slip disc_slip_after(const Slip& free, double dv, double gyration2, double radius) {
    const double arm = std::sqrt(gyration2), edge_ratio = radius / arm;
    const double zx = std::sqrt(free.x * free.x + free.y * free.y) / dv;
    const double zy = arm * std::abs(free.spin) / dv;
    if (zx + 1.5 * zy / edge_ratio <= 1) return {0, 0, 0};
    if (free.spin == 0) {
        const double factor = zx - 1 > SNAP ? 1 - 1 / zx : 0;
        return {factor * free.x, factor * free.y, 0};
    }
    double low = 0, high = 0.5 * std::numbers::pi, s_low = -zy, s_high = zx, p = std::atan2(zy, zx);
    double nx = 1, ny = 0, yx = 0, yy = 0;
    int side = 0;
    // Illinois method: regula falsi with a modification. If one end of the interval remains the
    // same twice, the function value at this end is halved.
    for (int i = 0; i < 60; i++) {
        nx = std::cos(p), ny = std::sin(p);
        const DiscFriction friction = disc_force(nx, edge_ratio * ny);
        yx = friction.force, yy = friction.torque * edge_ratio;
        const double across = (zx - yx) * ny - (zy - yy) * nx;
        if (std::abs(across) <= CLOSE || high - low < 1e-15) break;
        if (across < 0) {
            low = p, s_low = across;
            if (side == 1) s_high *= 0.5;
            side = 1;
        } else {
            high = p, s_high = across;
            if (side == -1) s_low *= 0.5;
            side = -1;
        }
        p = (low * s_high - high * s_low) / (s_high - s_low);
        if (!(low < p && p < high)) p = 0.5 * (low + high);
    }
    const double size = (zx - yx) * nx + (zy - yy) * ny;
    if (size <= SNAP) return {0, 0, 0};
    const double factor = zx > 0 ? 1 - yx / zx : 0, spin_loss = dv * yy / arm;
    return {factor * free.x, factor * free.y, free.spin - (free.spin > 0 ? spin_loss : -spin_loss)};
}

}  // namespace plate::disc
