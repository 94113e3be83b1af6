// Integration steps for a part that is modelled as a point and slides on the plate: Runge-Kutta
// 5(4), the event at which the slip vanishes, and the restart from zero slip.
//
// A sliding part at the position p with the velocity v obeys p' = v and v' = mu g w/|w|. The slip
// is w = v_s(p, t) - v, where v_s is the velocity of the plate's surface (pieces.hpp). The
// right-hand side is smooth while w is not 0.
#pragma once
#include <algorithm>
#include <cmath>

#include "plate/pieces.hpp"

namespace plate::sliding {

// Dormand and Prince, A family of embedded Runge-Kutta formulae, J. Comp. Appl. Math. 6 (1980),
// table 2: order 5 with an error estimate of order 4. The last stage of a step is identical to the
// first stage of the next step.
constexpr int STAGES = 7;
constexpr double C[STAGES] = {0., 1. / 5, 3. / 10, 4. / 5, 8. / 9, 1., 1.};
constexpr double B[] = {35. / 384, 0., 500. / 1113, 125. / 192, -2187. / 6784, 11. / 84};
constexpr double A[STAGES][STAGES - 1] = {
    {},
    {1. / 5},
    {3. / 40, 9. / 40},
    {44. / 45, -56. / 15, 32. / 9},
    {19372. / 6561, -25360. / 2187, 64448. / 6561, -212. / 729},
    {9017. / 3168, -355. / 33, 46732. / 5247, 49. / 176, -5103. / 18656},
    {B[0], B[1], B[2], B[3], B[4], B[5]},
};
constexpr double E[STAGES] = {
    B[0] - 5179. / 57600,   0.,
    B[2] - 7571. / 16695,   B[3] - 393. / 640,
    B[4] + 92097. / 339200, B[5] - 187. / 2100,
    -1. / 40};

// Maximum number of attempts of a restart, with shorter and shorter steps. After this number, the
// part remains stuck. At that point, the step is below the rounding error of the time (0.3^40 of
// its initial length).
constexpr int TRIES = 40;
// Tolerance of the time of an event, as a fraction of the initial interval that contains the event.
constexpr double ROOT = 1e-15;

// Return the weighted sum of vectors. The terms are added in the order of the indices.
template <int COUNT>
[[gnu::always_inline]] inline Vec weighted(const double* weights, const Vec* vectors) {
    Vec sum = weights[0] * vectors[0];
#pragma GCC unroll 8
    for (int i = 1; i < COUNT; i++)
        if (weights[i] != 0) sum = sum + weights[i] * vectors[i];
    return sum;
}

// Result of a trial step. If the slip reversed, `reversal` is the time of the stage that detected
// the reversal, as a fraction of the step. Otherwise `reversal` is 0. The other fields are the
// state and the friction [m/s2] at the end of the step, and the estimated errors of position [m]
// and velocity [m/s].
struct Step {
    double reversal;
    Point end;
    Vec force;
    double position_error, velocity_error;
};

// A stage of a Runge-Kutta step: velocity of the part, friction, and whether the component of the
// slip along n is still positive. The vector n is the direction of the slip at the start of the
// step.
struct Stage {
    Vec velocity, force;
    bool same_direction;
};

[[gnu::always_inline]] inline Stage stage(Table table, double t, int& k, const Point& part,
                                          double limit, Vec n) {
    const Vec w = slip(table, t, k, part);
    const double r = std::sqrt(dot(w, w)), scale = r > 0 ? limit / r : 0;
    return {part.velocity, scale * w, dot(w, n) > 0};
}

// Compute stage S of a Runge-Kutta step and all later stages. `v` and `f` contain the part's
// velocities and friction accelerations in the previous stages.
template <int S>
[[gnu::always_inline]] inline Step stages(Table table, double t, int k, double h, const Point& part,
                                          double limit, Vec n, Vec* v, Vec* f) {
    Point state;
    if constexpr (S == 1)
        state = {part.position + h * A[1][0] * v[0], part.velocity + h * A[1][0] * f[0]};
    else
        state = {part.position + h * weighted<S>(A[S], v),
                 part.velocity + h * weighted<S>(A[S], f)};
    const Stage result = stage(table, t + C[S] * h, k, state, limit, n);
    if (!result.same_direction) return {C[S], part, f[0], 0, 0};
    v[S] = result.velocity, f[S] = result.force;
    if constexpr (S + 1 < STAGES) {
        return stages<S + 1>(table, t, k, h, part, limit, n, v, f);
    } else {
        const Vec ep = weighted<STAGES>(E, v), ev = weighted<STAGES>(E, f);
        return {0, state, f[S], h * (std::abs(ep.x) + std::abs(ep.y)),
                h * (std::abs(ev.x) + std::abs(ev.y))};
    }
}

// Try a Runge-Kutta step of the length h [s]. `force` is the friction at the start [m/s2].
inline Step runge_kutta(Table table, double t, int k, double h, const Point& part, Vec force,
                        double limit) {
    Vec v[STAGES] = {part.velocity}, f[STAGES] = {force};
    const Vec n{force.x / limit, force.y / limit};
    return stages<1>(table, t, k, h, part, limit, n, v, f);
}

// Returns the state after tau [s] with constant friction [m/s2].
inline Point with_constant_friction(const Point& part, Vec force, double tau) {
    return {part.position + tau * (part.velocity + 0.5 * tau * force), part.velocity + tau * force};
}

// Returns the slip [m/s] after tau [s] with constant friction. The component x is along n, and the
// component y is perpendicular to n.
inline Vec slip_components(Table table, double t, int k, double tau, const Point& part, Vec force,
                           Vec n) {
    const Vec w = slip(table, t + tau, k, with_constant_friction(part, force, tau));
    return {w.x * n.x + w.y * n.y, w.y * n.x - w.x * n.y};
}

// Try a step in which the slip vector stays on a line. Friction is constant in such a step, so the
// step is exact.
inline Step line_step(Table table, double t, int k, double h, const Point& part, Vec force) {
    const Vec w = slip_components(table, t, k, h, part, force, force);
    return {w.x > 0 ? 0. : 1., with_constant_friction(part, force, h), force, 0, 0};
}

// Event at which the slip vanishes:
// - tau: time since the start of the step [s], or 0 if the slip does not vanish
// - rest: remaining slip perpendicular to its initial direction [m/s], which is 0 for a motion on a
//   line
// - error: upper bound of the velocity error [m/s] due to the assumption that the direction of
//   friction is constant
struct Landing {
    double tau, rest, error;
};

// Compute the time within the next h [s] at which the component of the slip along its present
// direction vanishes. Friction is assumed to be constant.
//
// `r` is the present slip [m/s]. A component of the slip along its present direction that is below
// `none` [m/s] counts as 0.
inline Landing landing(Table table, double t, int k, double h, const Point& part, Vec force,
                       double r, double limit, double none) {
    const Vec n{force.x / limit, force.y / limit};
    const Vec last = slip_components(table, t, k, h, part, force, n);
    if (last.x > 0) return {0, 0, 0};
    double low = 0, high = h, s_low = r, s_high = last.x, rest = last.y, tau = h;
    int side = 0;
    // Illinois method: regula falsi with a modification. If one end of the interval remains the
    // same twice, the function value at this end is halved.
    for (int i = 0; i < 60; i++) {
        if (high - low <= ROOT * h || s_high == 0) break;
        tau = (low * s_high - high * s_low) / (s_high - s_low);
        if (!(low < tau && tau < high)) {
            tau = 0.5 * (low + high);
            if (!(low < tau && tau < high)) break;
        }
        const Vec w = slip_components(table, t, k, tau, part, force, n);
        rest = w.y;
        if (w.x > 0) {
            low = tau, s_low = w.x;
            if (side == 1) s_high *= 0.5;
            side = 1;
        } else {
            high = tau, s_high = w.x;
            if (side == -1) s_low *= 0.5;
            side = -1;
        }
        if (std::abs(w.x) <= none) break;
    }
    const Vec half = slip_components(table, t, k, 0.5 * tau, part, force, n);
    rest = std::abs(rest);
    // The magnitude of the slip decreases approximately linearly to 0 at t = tau. Under this
    // assumption, the rate of the slip's angle is proportional to 1/(tau - t). The integral of this
    // rate is the logarithm in `angle`.
    double angle = rest > 0 ? rest / r * (1 + std::log(std::max(1.0, r / rest))) : 0;
    angle += half.x > 0 ? std::abs(half.y) / half.x : 1;
    return {tau, rest, limit * tau * angle};
}

// Return the direction of the acceleration of the plate's point q [m, plate frame] as a unit
// vector. The vector is 0 if the point does not accelerate.
inline Vec accel_direction(Table table, double t, int k, Vec q) {
    const Vec accel = stuck_part(table, t, k, q).accel;
    const double a = std::sqrt(dot(accel, accel));
    return a > 0 ? Vec{accel.x / a, accel.y / a} : Vec{0, 0};
}

// First step of a part that begins to slide: length of the step [s], state at its end, and friction
// at both ends [m/s2]. The length is 0 if the part does not slide.
struct Restart {
    double tau;
    Point end;
    Vec before, after;
};

// Compute a step of at most h [s] for a part whose slip is nearly 0. The function is called only if
// friction cannot hold the part.
//
// Let a be the acceleration of the plate's surface at the part. From the start of sliding, the
// direction of the slip follows the direction of a. Therefore the friction acceleration is mu g
// a/|a|. `allowed` is the maximum error of the velocity [m/s].
inline Restart restart(Table table, double t, int k, double h, const Point& part, double limit,
                       double allowed) {
    const Vec q = to_plate_frame(table, t, k, part.position), n0 = accel_direction(table, t, k, q);
    for (int i = 0; i < TRIES; i++) {
        const Vec n1 = accel_direction(table, t + 0.5 * h, k, q),
                  n2 = accel_direction(table, t + h, k, q);
        // Integrate the friction acceleration by Simpson's rule to the velocity u, and by the
        // corresponding rule to the position p.
        const Vec u = part.velocity + limit * h / 6 * (n0 + 4 * n1 + n2);
        const Vec p = part.position + h * (part.velocity + limit * h / 6 * (n0 + 2 * n1));
        int piece = k;
        const Vec w = slip(table, t + h, piece, {p, u});
        const double r = std::sqrt(dot(w, w));
        // If the direction of a rotates at the rate c, the direction of the slip lags behind by the
        // angle r c/|a|. The magnitude of the slip is r.
        const double error = r * (std::abs(n2.x - n0.x) + std::abs(n2.y - n0.y));
        if (error > allowed) {
            h *= std::max(0.1, std::min(0.7, 0.9 * std::pow(allowed / error, 1. / 3)));
            continue;
        }
        if (dot(w, n2) > 0) return {h, {p, u}, limit * n0, limit * n2};
        h *= 0.3;
    }
    return {0, part, {0, 0}, {0, 0}};
}

}  // namespace plate::sliding
