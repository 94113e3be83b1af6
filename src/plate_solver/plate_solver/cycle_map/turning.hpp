// C++ kernels of turning.py, which computes the motion of rotating parts during one cycle (cycle
// map). Some kernels process single parts, others process blocks of LANES parts.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/view.hpp>
#include <plate/wide.hpp>

#include "blocks.hpp"
#include "stick_slip.hpp"

namespace plate {

constexpr int TURNING_STATE = 10 * LANES, TURNING_TRACE = 11 * LANES;

namespace turning {

// Offsets in the state of a block: the offsets in namespace `blocks`, then rotation [rad], spin
// [rad/s] and second moments of the contact [m2].
using blocks::X, blocks::Y, blocks::VX, blocks::VY, blocks::BOUND;
constexpr int TURN = 5 * LANES, SPIN = 6 * LANES;
constexpr int SXX = 7 * LANES, SXY = 8 * LANES, SYY = 9 * LANES;

// Rows of the data stored per step:
// - derivatives (3, 3) of the changes of velocity and spin with respect to slip and relative spin,
//   row by row
// - vector from the plate's centre to the part [m]
constexpr int ARM_X = 9 * LANES, ARM_Y = 10 * LANES;

// J is the second moment of the contact in the sliding direction. If the squared slip velocity
// [m2/s2] is much smaller than SLOW2, J tends to its mean over all directions. The reason is that
// the direction of a very slow slip is uncertain.
constexpr double SLOW2 = 1e-4;

// Value that is added to the slip velocity, or to its square, in a denominator. It prevents 0/0.
constexpr double TINY = 1e-30;

}  // namespace turning

// Variant of `trace` for parts that rotate. `state` has the shape (b, TURNING_STATE), and `steps`
// has the shape (n, b, TURNING_TRACE).
//
// Let (dx, dy) be the slip velocity, dw the relative spin, and G = Sxx + Syy the squared radius of
// gyration. turning.py describes the friction model. In a step, velocity and spin change by
//
//     gain (dx, dy, j/G dw),    gain = min(1, mu g dt / q),    q^2 = dx^2 + dy^2 + j dw^2
//
// j depends on the direction of the slip and has the derivatives jx, jy. The derivatives of q^2/2
// with respect to (dx, dy, dw) are (bx, by, j dw). If the part slips, the derivatives of the gain
// are -gain/q^2 (bx, by, j dw), and `gain_drop` is gain/q^2. If it sticks, the gain is constant.
PLATE_WIDE inline void trace_turning(View<float, 2> state, SamplesOf<float> pose,
                                     SamplesOf<float> twist, float dt, View<float, 3> steps) {
    using namespace turning;
    constexpr float slow2 = SLOW2, tiny = TINY;
    for (int k = 0; k < twist.count; k++) {
        const float px = pose(k, 0), py = pose(k, 1);
        const float u = twist(k, 0), v = twist(k, 1), s = twist(k, 2);
        for (int block = 0; block < state.size(0); block++) {
            float* __restrict parts = state[block];
            float* __restrict step = &steps(k, block, 0);
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const float rx = parts[X + i] - px, ry = parts[Y + i] - py;
                const float dx = u - s * ry - parts[VX + i], dy = v + s * rx - parts[VY + i];
                const float dw = s - parts[SPIN + i];
                const float xx = parts[SXX + i], xy = parts[SXY + i], yy = parts[SYY + i];
                const float square = dx * dx + dy * dy;
                const float by_gyration2 = 1 / (xx + yy), by_square = 1 / (square + slow2);
                const float along = dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy;
                const float j = (along + slow2 * 0.5f * (xx + yy)) * by_square;
                const float jx = 2 * (dx * xx + dy * xy - dx * j) * by_square;
                const float jy = 2 * (dx * xy + dy * yy - dy * j) * by_square;
                const float inverse = 1 / std::sqrt(square + j * dw * dw + tiny);
                float g = parts[BOUND + i] * inverse;
                const float slips = g < 1 ? 1.0f : 0.0f;
                g = std::min(g, 1.0f);
                const float gain_drop = g * inverse * inverse * slips;
                const float bx = dx + 0.5f * dw * dw * jx, by = dy + 0.5f * dw * dw * jy;
                const float j_ratio = j * by_gyration2, dw_ratio = dw * by_gyration2;
                step[i] = g - gain_drop * dx * bx, step[LANES + i] = -gain_drop * dx * by;
                step[2 * LANES + i] = -gain_drop * dx * j * dw;
                step[3 * LANES + i] = -gain_drop * dy * bx;
                step[4 * LANES + i] = g - gain_drop * dy * by;
                step[5 * LANES + i] = -gain_drop * dy * j * dw;
                step[6 * LANES + i] = dw_ratio * (g * jx - gain_drop * j * bx);
                step[7 * LANES + i] = dw_ratio * (g * jy - gain_drop * j * by);
                step[8 * LANES + i] = j_ratio * (g - gain_drop * dw * j * dw);
                step[ARM_X + i] = rx, step[ARM_Y + i] = ry;
                const float vx = parts[VX + i] + g * dx, vy = parts[VY + i] + g * dy;
                const float spin = parts[SPIN + i] + g * j_ratio * dw;
                parts[VX + i] = vx, parts[VY + i] = vy, parts[SPIN + i] = spin;
                parts[X + i] += dt * vx, parts[Y + i] += dt * vy, parts[TURN + i] += dt * spin;
            }
        }
    }
}

// Variant of `adjoint` for positions and rotations. `by_twist` has the shape (bins, b, 3, 3
// LANES).
PLATE_WIDE inline void adjoint_turning(View<const float, 3> steps, SamplesOf<float> twist, float dt,
                                       float coast, View<float, 4> by_twist) {
    using namespace turning;
    const int bins = by_twist.size(0), bin_steps = twist.count / bins;
    for (int block = 0; block < steps.size(1); block++)
        for (int axis = 0; axis < 3; axis++) {
            const Eight end_x = Eight{} + (axis == 0 ? 1.0f : 0.0f);
            const Eight end_y = Eight{} + (axis == 1 ? 1.0f : 0.0f);
            const Eight turn = Eight{} + (axis == 2 ? 1.0f : 0.0f);
            Eight x = end_x, y = end_y, vx = coast * x, vy = coast * y, spin = coast * turn;
            for (int bin = bins - 1; bin >= 0; bin--) {
                Eight on_u{}, on_v{}, on_w{};
                for (int k = (bin + 1) * bin_steps - 1; k >= bin * bin_steps; k--) {
                    const float s = twist(k, 2);
                    const float* step = &steps(k, block, 0);
                    Eight d[9], arm_x, arm_y;
                    for (int c = 0; c < 9; c++) load(d[c], step + c * LANES);
                    load(arm_x, step + ARM_X), load(arm_y, step + ARM_Y);
                    const Eight cx = vx + dt * x, cy = vy + dt * y, cw = spin + dt * turn;
                    const Eight gx = d[0] * cx + d[3] * cy + d[6] * cw;
                    const Eight gy = d[1] * cx + d[4] * cy + d[7] * cw;
                    const Eight gw = d[2] * cx + d[5] * cy + d[8] * cw;
                    vx = cx - gx, vy = cy - gy, spin = cw - gw;
                    const Eight more_x = s * gy, more_y = s * gx;
                    on_u += gx + dt * (end_x - x - 0.5f * more_x);
                    on_v += gy + dt * (end_y - y + 0.5f * more_y);
                    on_w += arm_x * gy - arm_y * gx + gw;
                    x += more_x, y -= more_y;
                }
                float* on_twist = &by_twist(bin, block, axis, 0);
                store(on_u, on_twist), store(on_v, on_twist + LANES);
                store(on_w, on_twist + 2 * LANES);
            }
        }
}

namespace end_turning_rows {

// Rows of the matrix of parts: the rows in namespace `stick_slip`, then rotation [rad], spin
// [rad/s] and second moments of the contact [m2].
using stick_slip::X, stick_slip::Y, stick_slip::VX, stick_slip::VY, stick_slip::ACCEL;
constexpr int TURN = 5, SPIN = 6, SXX = 7, SXY = 8, SYY = 9, ROWS = 10;

// Rows of the data stored per step:
// - derivatives (3, 3) of the changes of velocity and spin
// - vector from the plate's centre to the part
// - derivatives of velocity and spin with respect to dt
// - velocity and spin
constexpr int ARM_X = 9, ARM_Y = 10, BY_DT = 11, AFTER = 14, PAST = 17;

}  // namespace end_turning_rows

// Writes the spin (M,) and the second moments xx, xy, yy (M, 3) of the parts to the matrix that
// `put_side_by_side` has filled.
inline void put_rotations(View<const double, 1> spin, View<const double, 2> spread, Matrix& parts) {
    using namespace end_turning_rows;
    std::fill_n(parts[SXX], parts.columns, 1.0), std::fill_n(parts[SYY], parts.columns, 1.0);
    for (int i = 0; i < spin.size(0); i++) {
        parts[SPIN][i] = spin(i);
        for (int c = 0; c < 3; c++) parts[SXX + c][i] = spread(i, c);
    }
}

// Variant of `end_state` for parts that rotate. Each column of `parts` is one part.
PLATE_WIDE inline void end_turning(Matrix& parts, Samples pose, Samples twist, const double* dt) {
    using namespace end_turning_rows;
    using turning::SLOW2, turning::TINY;
    const int width = parts.columns;
    double *__restrict px = parts[X], *__restrict py = parts[Y], *__restrict angle = parts[TURN];
    double *__restrict vx = parts[VX], *__restrict vy = parts[VY], *__restrict w = parts[SPIN];
    const double *__restrict xx = parts[SXX], *__restrict xy = parts[SXY];
    const double *__restrict yy = parts[SYY], *__restrict accel = parts[ACCEL];
    for (int k = 0; k < twist.count; k++) {
        const double u = twist(k, 0), v = twist(k, 1), s = twist(k, 2), h = dt[k];
        const double x = pose(k, 0), y = pose(k, 1);
#pragma omp simd
        for (int i = 0; i < width; i++) {
            const double dw = s - w[i], gyration2 = xx[i] + yy[i];
            const double dx = u - s * (py[i] - y) - vx[i], dy = v + s * (px[i] - x) - vy[i];
            const double square = dx * dx + dy * dy;
            const double along = dx * dx * xx[i] + 2 * dx * dy * xy[i] + dy * dy * yy[i];
            const double j = (along + SLOW2 * 0.5 * gyration2) / (square + SLOW2);
            const double bound = accel[i] * h;
            const double gain = bound / (std::max(std::sqrt(square + j * dw * dw), bound) + TINY);
            vx[i] += gain * dx;
            vy[i] += gain * dy;
            w[i] += gain * j / gyration2 * dw;
            px[i] += h * vx[i];
            py[i] += h * vy[i];
            angle[i] += h * w[i];
        }
    }
}

// Variant of `end_state_gradient` for positions and rotations. `trace_turning` describes the
// derivatives of a step, and `end_state_gradient` describes the backward pass. The shapes are
// `by_pose` (2, n, 3 M), `by_twist` (3, n, 3 M) and `by_dt` (n, 3 M).
PLATE_WIDE inline void end_turning_gradient(Matrix& parts, int count, Samples pose, Samples twist,
                                            const double* dt, double coast, Matrix& past,
                                            View<double, 3> by_pose, View<double, 3> by_twist,
                                            View<double, 2> by_dt) {
    using namespace end_turning_rows;
    using turning::SLOW2, turning::TINY;
    const int width = parts.columns, n = twist.count;
    double *__restrict px = parts[X], *__restrict py = parts[Y], *__restrict angle = parts[TURN];
    double *__restrict vx = parts[VX], *__restrict vy = parts[VY], *__restrict w = parts[SPIN];
    const double *__restrict xx = parts[SXX], *__restrict xy = parts[SXY];
    const double *__restrict yy = parts[SYY], *__restrict accel = parts[ACCEL];
    past.resize(n * PAST, width);
    for (int k = 0; k < n; k++) {
        const double u = twist(k, 0), v = twist(k, 1), s = twist(k, 2), h = dt[k];
        const double x = pose(k, 0), y = pose(k, 1);
        double* __restrict stored = past[k * PAST];
#pragma omp simd
        for (int i = 0; i < width; i++) {
            double* part = stored + i;
            const double rx = px[i] - x, ry = py[i] - y, dw = s - w[i];
            const double dx = u - s * ry - vx[i], dy = v + s * rx - vy[i];
            const double gyration2 = xx[i] + yy[i], square = dx * dx + dy * dy;
            const double along = dx * dx * xx[i] + 2 * dx * dy * xy[i] + dy * dy * yy[i];
            const double j = (along + SLOW2 * 0.5 * gyration2) / (square + SLOW2);
            const double jx = 2 * (dx * xx[i] + dy * xy[i] - dx * j) / (square + SLOW2);
            const double jy = 2 * (dx * xy[i] + dy * yy[i] - dy * j) / (square + SLOW2);
            const double q = std::sqrt(square + j * dw * dw), bound = accel[i] * h;
            const bool slips = q > bound;
            const double inverse = 1 / (std::max(q, bound) + TINY);
            const double g = bound * inverse;
            const double gain_drop = slips ? g * inverse * inverse : 0.0;
            const double bx = dx + 0.5 * dw * dw * jx, by = dy + 0.5 * dw * dw * jy;
            const double j_ratio = j / gyration2, dw_ratio = dw / gyration2;
            part[0] = g - gain_drop * dx * bx, part[width] = -gain_drop * dx * by;
            part[2 * width] = -gain_drop * dx * j * dw;
            part[3 * width] = -gain_drop * dy * bx, part[4 * width] = g - gain_drop * dy * by;
            part[5 * width] = -gain_drop * dy * j * dw;
            part[6 * width] = dw_ratio * (g * jx - gain_drop * j * bx);
            part[7 * width] = dw_ratio * (g * jy - gain_drop * j * by);
            part[8 * width] = j_ratio * (g - gain_drop * dw * j * dw);
            part[ARM_X * width] = rx, part[ARM_Y * width] = ry;
            const double force = slips ? accel[i] * inverse : 0.0;
            part[BY_DT * width] = force * dx, part[(BY_DT + 1) * width] = force * dy;
            part[(BY_DT + 2) * width] = force * j_ratio * dw;
            vx[i] += g * dx;
            vy[i] += g * dy;
            w[i] += g * j_ratio * dw;
            part[AFTER * width] = vx[i], part[(AFTER + 1) * width] = vy[i];
            part[(AFTER + 2) * width] = w[i];
            px[i] += h * vx[i];
            py[i] += h * vy[i];
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        // Adjoints at the end of step k: derivatives of the extrapolated final position or rotation
        // with respect to position and angle (a), and velocity and spin (b). The adjoints overwrite
        // rows of `parts`.
        double *__restrict ax = px, *__restrict ay = py, *__restrict aw = angle;
        double *__restrict bx = vx, *__restrict by = vy, *__restrict bw = w;
        std::fill_n(ax, width, axis == 0 ? 1.0 : 0.0), std::fill_n(bx, width, coast * ax[0]);
        std::fill_n(ay, width, axis == 1 ? 1.0 : 0.0), std::fill_n(by, width, coast * ay[0]);
        std::fill_n(aw, width, axis == 2 ? 1.0 : 0.0), std::fill_n(bw, width, coast * aw[0]);
        for (int k = n - 1; k >= 0; k--) {
            const double h = dt[k], s = twist(k, 2);
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
                const double cw = bw[i] + h * aw[i];
                on_dt[i] = ax[i] * part[AFTER * width] + ay[i] * part[(AFTER + 1) * width] +
                           aw[i] * part[(AFTER + 2) * width] + cx * part[BY_DT * width] +
                           cy * part[(BY_DT + 1) * width] + cw * part[(BY_DT + 2) * width];
                const double gx = part[0] * cx + part[3 * width] * cy + part[6 * width] * cw;
                const double gy = part[width] * cx + part[4 * width] * cy + part[7 * width] * cw;
                const double gw =
                    part[2 * width] * cx + part[5 * width] * cy + part[8 * width] * cw;
                bx[i] = cx - gx, by[i] = cy - gy, bw[i] = cw - gw;
                ax[i] += s * gy;
                ay[i] -= s * gx;
                on_u[i] = gx, on_v[i] = gy;
                on_w[i] = part[ARM_X * width] * gy - part[ARM_Y * width] * gx + gw;
                on_x[i] = -s * gy, on_y[i] = s * gx;
            }
        }
    }
}

}  // namespace plate
