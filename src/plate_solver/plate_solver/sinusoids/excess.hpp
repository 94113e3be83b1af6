// Limit violations of a sinusoidal motion, and their gradients, for descent.hpp.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include <plate/products.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

#include "limits.hpp"

namespace plate::sinusoids {

// EXCESS_M is the displacement error [m] that is equivalent to a violation of a limit by 100 %.
// PENALTY_USE is the utilisation of a search's limit above which the search counts a violation.
constexpr double EXCESS_M = 2e-3, PENALTY_USE = 0.95;

// Samples of h basis motions of one degree of freedom at n instants. `pose`, `twist` and `accel`
// have the shape (h, n). The fields that end in `_at` are the transposed matrices (n, h).
struct SampledBasis {
    Matrix pose, twist, accel, pose_at, twist_at, accel_at;
    std::vector<double> weight;  // (n,): weight of each instant in the motors' heat
    double heated;               // sum of the weights

    int size() const { return pose.rows; }
    int count() const { return pose.columns; }
};

// Samples (3, n) of a motion: rows x, y and theta.
struct SampledMotion {
    Matrix pose, twist, accel;
};

// Limit violations (K,) as fractions of a limit, and their derivatives (K, 3 h) with respect to the
// coefficients (h, 3).
struct Excess {
    std::vector<double> value;
    Matrix slope;
    int found = 0;

    // Clears the result. Reserves memory for up to `maximum` violations.
    void begin(int maximum, int columns) {
        found = 0;
        if (value.size() < static_cast<size_t>(maximum)) value.resize(maximum);
        slope.resize(maximum, columns);
    }
};

template <class Number>
SamplesOf<Number> samples(const MatrixOf<Number>& path) {
    return {path[0], path.columns, 1, path.columns};
}

// Computes `path` (3, n) as the product of the transposed coefficients (3, h) and the basis (h, n).
template <class Number>
void combine(const Number* coefficients, const MatrixOf<Number>& basis, MatrixOf<Number>& path) {
    path.resize(3, basis.columns);
    product(coefficients, 3, basis[0], basis.columns, basis.rows, 3, basis.columns, path[0],
            basis.columns);
}

inline void sample_motion(const double* coefficients, const SampledBasis& basis,
                          SampledMotion& motion) {
    combine(coefficients, basis.pose, motion.pose);
    combine(coefficients, basis.twist, motion.twist);
    combine(coefficients, basis.accel, motion.accel);
}

// Maximum number of violations that `excess` and `force_excess` can add.
inline int max_excesses(int checks) { return checks * (2 * MOTORS + 4); }
inline int max_force_excesses(int checks) { return (checks + 1) * MOTORS; }

// Adds the violations of the motors' strokes and speeds, and of the corners' accelerations. Let q =
// (x, y, theta) be the pose, l the lever of a motor, and b the acceleration of a corner. The
// violations are the positive values of
//     |l . q| / stroke - PENALTY_USE,    |l . q'| / speed limit - PENALTY_USE,
//     |b| / acceleration limit - PENALTY_USE.
// `used` is a buffer.
PLATE_WIDE inline void excess(const SampledMotion& motion, const SampledBasis& basis,
                              const Limits& limits, Matrix& used, Excess& result) {
    const int n = basis.count(), size = basis.size();
    used.resize(2 * MOTORS + 4, n);
    for (int i = 0; i < MOTORS; i++)
        for (int order = 0; order < 2; order++) {
            const Matrix& state = order ? motion.twist : motion.pose;
            const double limit = order ? limits.speed : limits.stroke_m;
            const double *__restrict x = state[0], *__restrict y = state[1];
            const double *__restrict angle = state[2], *lever = limits.levers[i];
            double* __restrict out = used[2 * i + order];
#pragma omp simd
            for (int k = 0; k < n; k++)
                out[k] = std::abs(lever[0] * x[k] + lever[1] * y[k] + lever[2] * angle[k]) / limit;
        }
    const double* __restrict ax = motion.accel[0], *__restrict ay = motion.accel[1];
    const double* __restrict aw = motion.accel[2], *__restrict spin = motion.twist[2];
    for (int corner = 0; corner < 4; corner++) {
        const double cx = corner & 1 ? limits.half[0] : -limits.half[0];
        const double cy = corner & 2 ? limits.half[1] : -limits.half[1];
        double* __restrict out = used[2 * MOTORS + corner];
#pragma omp simd
        for (int k = 0; k < n; k++) {
            const double bx = ax[k] - aw[k] * cy - spin[k] * spin[k] * cx;
            const double by = ay[k] + aw[k] * cx - spin[k] * spin[k] * cy;
            out[k] = std::sqrt(bx * bx + by * by);
        }
    }
    for (int k = 0; k < n; k++) {
        for (int i = 0; i < MOTORS; i++)
            for (int order = 0; order < 2; order++) {
                const double use = used[2 * i + order][k];
                if (!(use > PENALTY_USE)) continue;
                const Matrix& state = order ? motion.twist : motion.pose;
                const double* by = order ? basis.twist_at[k] : basis.pose_at[k];
                const double limit = order ? limits.speed : limits.stroke_m;
                const double* lever = limits.levers[i];
                const double q = lever[0] * state[0][k] + lever[1] * state[1][k] +
                                 lever[2] * state[2][k];
                double* slope = result.slope[result.found];
                for (int h = 0; h < size; h++) {
                    const double factor = (q > 0 ? by[h] : -by[h]) / limit;
                    for (int d = 0; d < 3; d++) slope[3 * h + d] = factor * lever[d];
                }
                result.value[result.found++] = use - PENALTY_USE;
            }
        for (int corner = 0; corner < 4; corner++) {
            const double length = used[2 * MOTORS + corner][k];
            if (!(length > PENALTY_USE * limits.accel)) continue;
            const double cx = corner & 1 ? limits.half[0] : -limits.half[0];
            const double cy = corner & 2 ? limits.half[1] : -limits.half[1];
            const double bx = ax[k] - aw[k] * cy - spin[k] * spin[k] * cx;
            const double by = ay[k] + aw[k] * cx - spin[k] * spin[k] * cy;
            const double ux = bx / length / limits.accel, uy = by / length / limits.accel;
            const double turn = uy * cx - ux * cy, rate = -2 * spin[k] * (ux * cx + uy * cy);
            const double *by_twist = basis.twist_at[k], *by_accel = basis.accel_at[k];
            double* slope = result.slope[result.found];
            for (int h = 0; h < size; h++) {
                slope[3 * h] = ux * by_accel[h];
                slope[3 * h + 1] = uy * by_accel[h];
                slope[3 * h + 2] = turn * by_accel[h] + rate * by_twist[h];
            }
            result.value[result.found++] = length / limits.accel - PENALTY_USE;
        }
    }
}

// Adds a violation. The gradient of the violation is `factor` times `rows` (3, h).
[[gnu::always_inline]] inline void add(double value, const Matrix& rows, double factor,
                                       Excess& result) {
    double* slope = result.slope[result.found];
    for (int h = 0; h < rows.columns; h++)
        for (int d = 0; d < 3; d++) slope[3 * h + d] = factor * rows[d][h];
    result.value[result.found++] = value;
}

// Adds the violations of the motors' peak forces and of their root mean square forces.
PLATE_WIDE inline void force_excess(const SampledMotion& motion, const SampledBasis& basis,
                                    const Limits& limits, Excess& result) {
    const int checks = basis.count(), size = basis.size();
    Matrix force_slope(3, size), heat_slope(3, size);
    for (int i = 0; i < MOTORS; i++) {
        const double *on_pose = limits.loads[0][i], *on_twist = limits.loads[1][i];
        const double* on_accel = limits.loads[2][i];
        double square = 0;
        std::fill_n(heat_slope[0], 3 * size, 0.0);
        for (int k = 0; k < checks; k++) {
            const double *__restrict pose = basis.pose_at[k], *__restrict twist = basis.twist_at[k];
            const double* __restrict accel = basis.accel_at[k];
            double force = 0;
            for (int d = 0; d < 3; d++)
                force += on_pose[d] * motion.pose[d][k] + on_twist[d] * motion.twist[d][k] +
                         on_accel[d] * motion.accel[d][k];
            const double weight = basis.weight[k] / basis.heated;
            square += weight * force * force;
            for (int d = 0; d < 3; d++) {
                double* __restrict slope = force_slope[d], *__restrict sum = heat_slope[d];
#pragma omp simd
                for (int h = 0; h < size; h++) {
                    slope[h] =
                        on_pose[d] * pose[h] + on_twist[d] * twist[h] + on_accel[d] * accel[h];
                    sum[h] += weight * force * slope[h];
                }
            }
            if (std::abs(force) > PENALTY_USE)
                add(std::abs(force) - PENALTY_USE, force_slope, force > 0 ? 1 : -1, result);
        }
        const double heat = limits.heat * std::sqrt(square);
        if (heat > PENALTY_USE)
            add(heat - PENALTY_USE, heat_slope, limits.heat * limits.heat / heat, result);
    }
}

}  // namespace plate::sinusoids
