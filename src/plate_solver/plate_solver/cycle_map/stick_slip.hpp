// C++ kernels of stick_slip.py, which computes the motion of the parts during one cycle (cycle map)
// and its derivatives with respect to the plate's motion.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

namespace stick_slip {

// Rows of the matrix of parts: position [m], velocity [m/s], and friction acceleration mu g [m/s2].
constexpr int X = 0, Y = 1, VX = 2, VY = 3, ACCEL = 4, ROWS = 5;

// Rows of the data that `end_state_gradient` stores for each time step:
// - vector from the plate's centre to the part
// - derivative D of the velocity change with respect to the slip velocity
// - friction acceleration during slip
// - velocity
constexpr int ARM_X = 0, ARM_Y = 1, XX = 2, XY = 3, YY = 4, FX = 5, FY = 6;
constexpr int AFTER_X = 7, AFTER_Y = 8, PAST = 9;

// Value that is added to the magnitude of the slip velocity in a denominator, to prevent 0/0.
constexpr double TINY = 1e-300;

}  // namespace stick_slip

// Writes the parts to a matrix with one part per column. The first five rows are filled. The number
// of columns is rounded up to a multiple of four. The additional columns are zero.
inline void put_side_by_side(View<const double, 2> position, View<const double, 2> velocity,
                             View<const double, 1> friction_accel, int rows, Matrix& parts) {
    using namespace stick_slip;
    const int count = position.size(0);
    parts.resize(rows, (count + 3) / 4 * 4);
    std::fill_n(parts[0], rows * parts.columns, 0.0);
    for (int i = 0; i < count; i++) {
        parts[X][i] = position(i, 0), parts[Y][i] = position(i, 1);
        parts[VX][i] = velocity(i, 0), parts[VY][i] = velocity(i, 1);
        parts[ACCEL][i] = friction_accel(i);
    }
}

// Integrates the motion of the parts over n time steps of length dt (n,) [s]. `pose` and `twist`
// (n, 3) are the plate's pose and twist in each step. Each column of `parts` is one part.
PLATE_WIDE inline void end_state(Matrix& parts, Samples pose, Samples twist, const double* dt) {
    using namespace stick_slip;
    const int width = parts.columns;
    double *__restrict px = parts[X], *__restrict py = parts[Y];
    double *__restrict vx = parts[VX], *__restrict vy = parts[VY];
    const double* __restrict accel = parts[ACCEL];
    for (int k = 0; k < twist.count; k++) {
        const double u = twist(k, 0), v = twist(k, 1), w = twist(k, 2), h = dt[k];
        const double x = pose(k, 0), y = pose(k, 1);
#pragma omp simd
        for (int i = 0; i < width; i++) {
            const double dx = u - w * (py[i] - y) - vx[i];
            const double dy = v + w * (px[i] - x) - vy[i];
            const double bound = accel[i] * h;
            const double gain = bound / (std::max(std::sqrt(dx * dx + dy * dy), bound) + TINY);
            vx[i] += gain * dx;
            vy[i] += gain * dy;
            px[i] += h * vx[i];
            py[i] += h * vy[i];
        }
    }
}

// Computes the derivatives of the final positions with respect to pose (2, n, 2 M), twist (3, n, 2
// M) and dt (n, 2 M). The positions are extrapolated with the final velocity by `coast` [s]. The
// last axis contains x of all `count` parts, then y. `parts` is overwritten; `past` is a buffer.
//
// The forward pass computes, in each step of length h, for a part at x with velocity v:
//
//     r = x - plate centre,    d = (u - w r_y, v + w r_x) - v,    v' = v + gain d,    x' = x + h v'
//
// It stores the derivative D of `gain d` with respect to the slip velocity d. If the part sticks,
// D is the unit matrix. Otherwise D = gain (1 - d d^T / |d|^2). The backward pass transforms the
// derivatives of a final position with respect to x' (a) and v' (b) to those with respect to x and
// v. By the chain rule, with c = b + h a and g = D c:
//
//     b <- c - g                   d contains -v
//     a <- a + w (g_y, -g_x)       d contains w (-r_y, r_x)
//     by twist: (g_x, g_y, r_x g_y - r_y g_x)
//     by pose:  w (-g_y, g_x)
//     by dt:    a . v' + c . mu g d / |d|, where the second term is only for slip
PLATE_WIDE inline void end_state_gradient(Matrix& parts, int count, Samples pose, Samples twist,
                                          const double* dt, double coast, Matrix& past,
                                          View<double, 3> by_pose, View<double, 3> by_twist,
                                          View<double, 2> by_dt) {
    using namespace stick_slip;
    const int width = parts.columns, n = twist.count;
    double *__restrict px = parts[X], *__restrict py = parts[Y];
    double *__restrict vx = parts[VX], *__restrict vy = parts[VY];
    const double* __restrict accel = parts[ACCEL];
    past.resize(n * PAST, width);
    for (int k = 0; k < n; k++) {
        const double u = twist(k, 0), v = twist(k, 1), w = twist(k, 2), h = dt[k];
        const double x = pose(k, 0), y = pose(k, 1);
        double* __restrict stored = past[k * PAST];
#pragma omp simd
        for (int i = 0; i < width; i++) {
            const double rx = px[i] - x, ry = py[i] - y;
            const double dx = u - w * ry - vx[i], dy = v + w * rx - vy[i];
            const double bound = accel[i] * h, d = std::sqrt(dx * dx + dy * dy);
            const double inverse = 1 / (std::max(d, bound) + TINY);
            const double gain = bound * inverse;
            const bool slips = d > bound;
            const double a = dx * inverse, b = dy * inverse;  // unit vector of the slip
            stored[ARM_X * width + i] = rx, stored[ARM_Y * width + i] = ry;
            stored[XX * width + i] = slips ? gain * (1 - a * a) : 1.0;
            stored[XY * width + i] = slips ? -gain * a * b : 0.0;
            stored[YY * width + i] = slips ? gain * (1 - b * b) : 1.0;
            stored[FX * width + i] = slips ? accel[i] * a : 0.0;
            stored[FY * width + i] = slips ? accel[i] * b : 0.0;
            vx[i] += gain * dx;
            vy[i] += gain * dy;
            stored[AFTER_X * width + i] = vx[i], stored[AFTER_Y * width + i] = vy[i];
            px[i] += h * vx[i];
            py[i] += h * vy[i];
        }
    }
    for (int axis = 0; axis < 2; axis++) {
        // Adjoints at the end of step k: derivatives of the extrapolated final position with
        // respect to position (a) and velocity (b). The adjoints overwrite the rows X, Y, VX and VY
        // of `parts`.
        double *__restrict ax = px, *__restrict ay = py, *__restrict bx = vx, *__restrict by = vy;
        std::fill_n(ax, width, 1.0 - axis), std::fill_n(ay, width, 1.0 * axis);
        std::fill_n(bx, width, coast * ax[0]), std::fill_n(by, width, coast * ay[0]);
        for (int k = n - 1; k >= 0; k--) {
            const double h = dt[k], w = twist(k, 2);
            const double* __restrict stored = past[k * PAST];
            double* __restrict on_dt = &by_dt(k, axis * count);
            double* __restrict on_u = &by_twist(0, k, axis * count);
            double* __restrict on_v = &by_twist(1, k, axis * count);
            double* __restrict on_w = &by_twist(2, k, axis * count);
            double* __restrict on_x = &by_pose(0, k, axis * count);
            double* __restrict on_y = &by_pose(1, k, axis * count);
#pragma omp simd
            for (int i = 0; i < count; i++) {
                const double* part = stored + i;
                const double cx = bx[i] + h * ax[i], cy = by[i] + h * ay[i];
                on_dt[i] = ax[i] * part[AFTER_X * width] + ay[i] * part[AFTER_Y * width] +
                           cx * part[FX * width] + cy * part[FY * width];
                const double gx = part[XX * width] * cx + part[XY * width] * cy;
                const double gy = part[XY * width] * cx + part[YY * width] * cy;
                bx[i] = cx - gx, by[i] = cy - gy;
                ax[i] += w * gy;
                ay[i] -= w * gx;
                on_u[i] = gx, on_v[i] = gy;
                on_w[i] = part[ARM_X * width] * gy - part[ARM_Y * width] * gx;
                on_x[i] = -w * gy, on_y[i] = w * gx;
            }
        }
    }
}

}  // namespace plate
