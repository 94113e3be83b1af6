// Friction of a disc that presses evenly on the plate, without quadrature: see disc.py.
//
// Its centre slips at s, its rim, by the spin, at w = R |c|. The mean slip over the disc is the
// mean distance from a point at s/w radii to the points of a disc, which complete elliptic
// integrals give; force and torque are its derivatives by s and w (Farkas, Bartels, Unger and Wolf,
// PRL 90, 248302, 2003). Where the rim slips less than half as fast as the centre their power
// series is short; else the integrals come from arithmetic and geometric means (Abramowitz and
// Stegun 1964, 17.6), arranged so that no digits cancel.
//
// With k = w/s the mean distance is s sum_n b_n k^2n, b_n = binomial(1/2, n)^2/(n + 1).
#pragma once
#include <algorithm>
#include <cmath>
#include <numbers>

namespace plate {

// Twist of the plate less that of a part, at its centre [m/s, m/s, rad/s].
struct Slip {
    double x, y, turn;
};

}  // namespace plate

namespace plate::disc {

// Slips below this share of the velocity step are none: then the part sticks.
constexpr double SNAP = 1e-3;
// Error of the direction times the slip after a step, as a share of the velocity step.
constexpr double CLOSE = 1e-9;
// Means of numbers that differ by this share are equal to rounding.
constexpr double MEANS = 2e-8;
// Greatest k^2 at which the series is summed: what is left out is below 2e-10 mu m g there.
constexpr double SERIES = 0.25;

// Force [mu m g] and torque [mu m g R] on a disc.
struct Push {
    double force, torque;
};

// Force, and torque over k, for k^2 up to `SERIES`.
[[gnu::always_inline]] inline Push series(double k2) {
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

// On a disc whose centre slips at s and rim at w [m/s]: both at least 0, and not both 0.
inline Push disc_force(double s, double w) {
    if (w * w <= SERIES * s * s) {
        const Push push = series((w / s) * (w / s));
        return {push.force, push.torque * w / s};
    }
    const double k = s <= w ? s / w : w / s, k2 = std::min(k * k, 1 - 1e-15);
    double a = 1, b = std::sqrt(1 - k2), c = 0.5 * k2 / (1 + b);
    double total = 0, weight = 1;
    while (true) {
        total += weight * c * c;
        weight *= 2;
        const double product = a * b;
        a = 0.5 * (a + b), b = std::sqrt(product);
        if (!(c > MEANS * a)) break;  // a NaN ends it too
        c = 0.5 * (a - b);
    }
    // K = pi/(2 a), and E = K (1 - k2/2 - total)
    const double rest = k2 > 0 ? total / k2 : 0;
    const double force = 2 / (3 * a) * (1.5 - 0.5 * k2 - (1 + k2) * rest);
    if (s <= w) return {k * force, 2 / (9 * a) * (3 - 3 * k2 + k2 * k2 - (4 - 2 * k2) * total)};
    return {force, 2 / (9 * a) * k * (1 + (2 - 4 * k2) * (k2 > 0 ? rest / k2 : 0.0625))};
}

// As `patch::slip_after`, for a disc.
//
// By symmetry two unknowns are left, the slip s of the centre and g |c|, g the radius of gyration:
// the slip after the step is the free one, less dv times the nearest point of the set of forces
// that friction can give. That point is sought by its normal's direction.
inline Slip disc_slip_after(const Slip& free, double dv, double gyration2, double radius) {
    const double arm = std::sqrt(gyration2), rim = radius / arm;
    const double zx = std::sqrt(free.x * free.x + free.y * free.y) / dv;
    const double zy = arm * std::abs(free.turn) / dv;
    if (zx + 1.5 * zy / rim <= 1) return {0, 0, 0};
    if (free.turn == 0) {
        const double share = zx - 1 > SNAP ? 1 - 1 / zx : 0;
        return {share * free.x, share * free.y, 0};
    }
    double low = 0, high = 0.5 * std::numbers::pi, s_low = -zy, s_high = zx, p = std::atan2(zy, zx);
    double nx = 1, ny = 0, yx = 0, yy = 0;
    int side = 0;
    // Illinois: regula falsi that halves the value at an end that stays
    for (int i = 0; i < 60; i++) {
        nx = std::cos(p), ny = std::sin(p);
        const Push push = disc_force(nx, rim * ny);
        yx = push.force, yy = push.torque * rim;
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
    const double share = zx > 0 ? 1 - yx / zx : 0, turn = dv * yy / arm;
    return {share * free.x, share * free.y, free.turn - (free.turn > 0 ? turn : -turn)};
}

}  // namespace plate::disc
