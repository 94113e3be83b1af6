// Implicit time step with Coulomb friction for a rigid footprint, which is the contact area of a
// part. The step is a convex problem with three unknowns.
//
// The slip d = (u, v, c) [m/s, m/s, rad/s] of a part is the twist of the plate at the part minus
// the twist of the part. `free` is the slip after a step without friction. With friction, the slip
// after the step minimises
//
//     1/2 |d - free|^2 + dv sum_i p_i |d_i|,    |d|^2 = u^2 + v^2 + gyration2 c^2,
//
// where d_i is the slip at point i of the footprint, p_i is the fraction of the weight at this
// point, and dv = mu g dt is the velocity step. By the optimality condition, the force at each
// point is mu p_i m g along the slip AFTER the step. At a point without slip, the force can have
// any direction, and any magnitude up to mu p_i m g. Therefore a part slips, rotates and sticks
// without overshooting, for any length of the step.
//
// A primal-dual Newton method solves the problem (Andersen, Christiansen, Conn and Overton 2000).
// The unknowns of this method are the slip and the forces at the points. The method converges,
// although the norms |d_i| are not smooth at 0. The iteration ends when the duality gap guarantees
// the accuracy.
//
// The terms of a sum over the points are computed for several points at the same time, and then
// added one by one. Therefore the sums do not depend on the processor's vector width.
#pragma once
#include <plate/view.hpp>
#include <plate/wide.hpp>

#include <algorithm>
#include <cmath>

#include "friction/disc.hpp"

namespace plate {

// Points of all footprints (7, n), one point per column. The rows are:
// - position x and y in the part's frame [m]
// - fraction p_i of the part's weight
// - size of the cell that the point represents (see `Footprint.blur`) [m]
// - force along x, force along y, and force of the blur in the last step [p_i mu m g]
//
// The forces of the last step are the initial values for the next step.
using Mesh = View<double, 2>;

}  // namespace plate

namespace plate::patch {

// Tolerance of the slip after a step, as a fraction of dv = mu g dt. An error of mu by the same
// fraction has the same effect.
constexpr double SLACK = 1e-6;
// Rounding error of the duality gap, as a fraction of the slip times dv.
constexpr double ROUNDING = 1e-14;
// If the slip after a step is below this fraction of dv = mu g dt, the part sticks.
constexpr double SNAP = 1e-3;
// Maximum number of Newton iterations. Usually 1 to 12 iterations are necessary. If a part on
// several feet rotates about one of the feet, one case in 5000 does not converge.
constexpr int ITERATIONS = 30;
// Value that is added to a squared slip [m2/s2], to avoid a division by 0.
constexpr double TINY = 1e-200;
// The friction at a point is smoothed if the slip of the point is below this fraction of dv. Then
// Newton's method converges.
constexpr double ROUND = 1e-4;
// The terms of a sum are computed together for this number of points. Then the terms are added one
// by one.
constexpr int BLOCK = 64;
// If a part has fewer points than this number, for example a part on feet, each point is computed
// and added separately.
constexpr int FEW = 6;

// Points of a part: the consecutive columns of `Mesh` that belong to the part.
struct Points {
    const double *__restrict x, *__restrict y, *__restrict weight, *__restrict blur;
    double *__restrict fx, *__restrict fy, *__restrict fb;
    int count;
};

[[gnu::always_inline]] inline Points points_of(const Mesh& mesh, int first, int end) {
    return {mesh[0] + first, mesh[1] + first, mesh[2] + first, mesh[3] + first,
            mesh[4] + first, mesh[5] + first, mesh[6] + first, end - first};
}

// Friction caused by a slip, in the part's axes: the force [mu m g], the torque/(m gyration2) [mu g
// / m], and an upper bound of the derivative of the friction with respect to the slip [mu g /
// (m/s)].
struct Friction {
    Slip force;
    double stiffness;
};

// Return the friction at point i. The caller must still divide the torque and the bound by
// gyration2.
[[gnu::always_inline]] inline Friction friction_at(const Slip& d, double gyration2,
                                                   const Points& points, int i) {
    const double x = points.x[i], y = points.y[i], b = points.blur[i];
    const double u = d.x - d.spin * y, v = d.y + d.spin * x, w = d.spin * b;
    const double factor = points.weight[i] / std::sqrt(u * u + v * v + w * w + TINY);
    return {{factor * u, factor * v, factor * (x * v - y * u + b * w)},
            factor * (gyration2 + x * x + y * y)};
}

PLATE_WIDE inline Friction friction(const Slip& d, double gyration2, const Mesh& mesh, int first,
                                    int end) {
    double fx = 0, fy = 0, fc = 0, stiffness = 0;
    for (; first < end; first += BLOCK) {
        const Points points = points_of(mesh, first, std::min(end, first + BLOCK));
        if (points.count < FEW) {
            for (int i = 0; i < points.count; i++) {
                const Friction point = friction_at(d, gyration2, points, i);
                fx += point.force.x, fy += point.force.y, fc += point.force.spin;
                stiffness += point.stiffness;
            }
            break;
        }
        double ax[BLOCK], ay[BLOCK], ac[BLOCK], change[BLOCK];
#pragma omp simd
        for (int i = 0; i < points.count; i++) {
            const Friction point = friction_at(d, gyration2, points, i);
            ax[i] = point.force.x, ay[i] = point.force.y, ac[i] = point.force.spin;
            change[i] = point.stiffness;
        }
        for (int i = 0; i < points.count; i++)
            fx += ax[i], fy += ay[i], fc += ac[i], stiffness += change[i];
    }
    return {{fx, fy, fc / gyration2}, stiffness / gyration2};
}

// Set the points' forces to unit vectors along their slips.
[[gnu::always_inline]] inline void point_along(const Slip& d, double dv, const Points& points) {
    const double round2 = (ROUND * dv) * (ROUND * dv);
#pragma omp simd
    for (int i = 0; i < points.count; i++) {
        const double u = d.x - d.spin * points.y[i], v = d.y + d.spin * points.x[i];
        const double w = d.spin * points.blur[i];
        const double inverse = 1 / std::sqrt(u * u + v * v + w * w + round2);
        points.fx[i] = u * inverse, points.fy[i] = v * inverse, points.fb[i] = w * inverse;
    }
}

// Sums over the points for a Newton step. Each term is weighted with p_i and multiplied by dv.
// - g: directions of the points' slips
// - w: forces at the points
// - gap: duality gap
// - hxx to hcc: symmetric part of (1 - z n')/|d_i| in the coordinates (u, v, c), where z is the
//   force and n is the direction of the slip at the point
struct Sums {
    Slip g, w;
    double gap, hxx, hyy, hxy, hxc, hyc, hcc;
};

[[gnu::always_inline]] inline Sums sum_up(const Slip& d, double dv, const Mesh& mesh, int first,
                                          int end) {
    const double round2 = (ROUND * dv) * (ROUND * dv), round = ROUND * dv;
    Sums sum{};
    for (; first < end; first += BLOCK) {
        const Points points = points_of(mesh, first, std::min(end, first + BLOCK));
        double gx[BLOCK], gy[BLOCK], gc[BLOCK], wx[BLOCK], wy[BLOCK], wc[BLOCK], gap[BLOCK];
        double hxx[BLOCK], hyy[BLOCK], hxy[BLOCK], hxc[BLOCK], hyc[BLOCK];
        double hcc_squares[BLOCK], hcc_products[BLOCK];
#pragma omp simd
        for (int i = 0; i < points.count; i++) {
            // (nx, ny, nb) is the direction of the slip at the point, and (zx, zy, zb) is the
            // force.
            const double x = points.x[i], y = points.y[i], b = points.blur[i];
            const double u = d.x - d.spin * y, v = d.y + d.spin * x, w = d.spin * b;
            const double norm = std::sqrt(u * u + v * v + w * w + round2), inverse = 1 / norm;
            const double nx = u * inverse, ny = v * inverse, nb = w * inverse;
            const double p = dv * points.weight[i], zx = points.fx[i], zy = points.fy[i],
                         zb = points.fb[i];
            const double sphere_height = std::sqrt(std::max(0.0, 1 - zx * zx - zy * zy - zb * zb));
            gap[i] = p * (norm - zx * u - zy * v - zb * w - round * sphere_height);
            wx[i] = p * zx;
            wy[i] = p * zy;
            wc[i] = p * (x * zy - y * zx + b * zb);
            gx[i] = p * nx;
            gy[i] = p * ny;
            gc[i] = p * (x * ny - y * nx + b * nb);
            const double q = p * inverse;
            const double axx = q * (1 - zx * nx), ayy = q * (1 - zy * ny), abb = q * (1 - zb * nb);
            const double axy = -0.5 * q * (zx * ny + zy * nx);
            const double axb = -0.5 * q * (zx * nb + zb * nx);
            const double ayb = -0.5 * q * (zy * nb + zb * ny);
            hxx[i] = axx;
            hyy[i] = ayy;
            hxy[i] = axy;
            hxc[i] = -y * axx + x * axy + b * axb;
            hyc[i] = -y * axy + x * ayy + b * ayb;
            hcc_squares[i] = y * y * axx + x * x * ayy + b * b * abb;
            hcc_products[i] = 2 * (b * x * ayb - b * y * axb - x * y * axy);
        }
        for (int i = 0; i < points.count; i++) {
            sum.gap += gap[i];
            sum.w.x += wx[i], sum.w.y += wy[i], sum.w.spin += wc[i];
            sum.g.x += gx[i], sum.g.y += gy[i], sum.g.spin += gc[i];
            sum.hxx += hxx[i], sum.hyy += hyy[i], sum.hxy += hxy[i];
            sum.hxc += hxc[i], sum.hyc += hyc[i];
            sum.hcc += hcc_squares[i];
            sum.hcc += hcc_products[i];
        }
    }
    return sum;
}

// Update the forces at the points for a Newton step that changes the slip d by s.
[[gnu::always_inline]] inline void change_forces(const Slip& d, const Slip& s, double dv,
                                                 const Points& points) {
    const double round2 = (ROUND * dv) * (ROUND * dv);
#pragma omp simd
    for (int i = 0; i < points.count; i++) {
        const double x = points.x[i], y = points.y[i], b = points.blur[i];
        const double u = d.x - d.spin * y, v = d.y + d.spin * x, w = d.spin * b;
        const double inverse = 1 / std::sqrt(u * u + v * v + w * w + round2);
        const double nx = u * inverse, ny = v * inverse, nb = w * inverse;
        const double tu = (s.x - s.spin * y) * inverse, tv = (s.y + s.spin * x) * inverse;
        const double tw = s.spin * b * inverse, along = nx * tu + ny * tv + nb * tw;
        const double zx = nx + tu - points.fx[i] * along, zy = ny + tv - points.fy[i] * along;
        const double zb = nb + tw - points.fb[i] * along;
        const double size = std::max(1.0, std::sqrt(zx * zx + zy * zy + zb * zb));
        points.fx[i] = zx / size, points.fy[i] = zy / size, points.fb[i] = zb / size;
    }
}

// Solve the linear system [[a, b, c], [b, d, e], [c, e, f]] s = right. The matrix is symmetric and
// positive definite.
inline Slip solve(double a, double b, double c, double d, double e, double f, Slip right) {
    const double l1 = b / a, l2 = c / a;
    d -= l1 * b;
    e -= l1 * c;
    f -= l2 * c;
    right.y -= l1 * right.x;
    right.spin -= l2 * right.x;
    const double l3 = e / d;
    f -= l3 * e;
    const double s3 = (right.spin - l3 * right.y) / f, s2 = right.y / d - l3 * s3;
    return {(right.x - b * s2 - c * s3) / a, s2, s3};
}

// Return the slip after a time step, in the part's frame. The slip is 0 if the part sticks.
//
// `free` is the slip after the step without friction. `dv` is mu g dt [m/s], above 0. The points of
// the part have the indices `first` to `end` - 1 in the mesh. The function updates the forces at
// these points.
PLATE_WIDE inline Slip slip_after(const Slip& free, double dv, double gyration2, const Mesh& mesh,
                                  int first, int end) {
    const Points all = points_of(mesh, first, end);
    double max_radius2 = 0, spread = 0;
    for (int i = 0; i < all.count; i++) {
        const double r2 = all.x[i] * all.x[i] + all.y[i] * all.y[i];
        max_radius2 = std::max(max_radius2, r2);
        spread += all.weight[i] * r2;
    }
    // The part sticks if forces that vary linearly over the footprint can stop it. This condition
    // is sufficient for sticking, and detects nearly all cases.
    const double force_slope = free.spin * gyration2 / spread;
    if (std::sqrt(free.x * free.x + free.y * free.y) +
            std::abs(force_slope) * std::sqrt(max_radius2) <=
        dv)
        return {0, 0, 0};
    Slip d = free;
    const double size2 = free.x * free.x + free.y * free.y + gyration2 * free.spin * free.spin;
    if (size2 > 16 * dv * dv) {  // use forces along the slip, because a fast part keeps sliding
        const double factor = 1 - dv / std::sqrt(size2);
        d = {factor * free.x, factor * free.y, factor * free.spin};
        point_along(d, dv, all);
    }
    const double max_gap = 0.5 * ((SLACK * dv) * (SLACK * dv)) + ROUNDING * dv * std::sqrt(size2);
    Slip w{};
    for (int i = 0; i < ITERATIONS; i++) {
        const Sums sum = sum_up(d, dv, mesh, first, end);
        w = sum.w;
        const double ex = d.x - free.x + w.x, ey = d.y - free.y + w.y;
        const double ec = d.spin - free.spin + w.spin / gyration2;
        if (sum.gap + 0.5 * (ex * ex + ey * ey + gyration2 * ec * ec) <= max_gap) break;
        const Slip s =
            solve(1 + sum.hxx, sum.hxy, sum.hxc, 1 + sum.hyy, sum.hyc, gyration2 + sum.hcc,
                  {free.x - d.x - sum.g.x, free.y - d.y - sum.g.y,
                   gyration2 * (free.spin - d.spin) - sum.g.spin});
        change_forces(d, s, dv, all);
        d = {d.x + s.x, d.y + s.y, d.spin + s.spin};
    }
    if (d.x * d.x + d.y * d.y + gyration2 * d.spin * d.spin <= (SNAP * dv) * (SNAP * dv))
        return {0, 0, 0};
    return {free.x - w.x, free.y - w.y, free.spin - w.spin / gyration2};
}

}  // namespace plate::patch
