// C++ kernels of sinusoid_force.py, which computes the average friction force during sinusoidal
// plate motions.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/simd.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

#include "averages/mean_force.hpp"
#include "averages/near_zero_slip.hpp"

namespace plate {

constexpr int DEGREE = 10;  // degree of the Taylor polynomials

// Quadrature of the force over a period:
// - PANELS: adaptive panels
// - ADAPTIVE: the usual number of equal steps, with a correction where the slip nearly vanishes
// - FEW: a small number of equal steps
// - USUAL: the usual number of equal steps, without correction
enum Grid { PANELS = -2, ADAPTIVE = -1, FEW = 0, USUAL = 1 };

// Values of N harmonics at the sample points, and their Taylor coefficients. `Rules` in
// sinusoid_force.py describes the fields.
struct Rules {
    View<const double, 2> waves;  // (2 N, K)
    int few;
    View<const double, 2> taylor;  // (DEGREE + 1, N)
    int pieces;
};

// Computes the coefficients (2 N + 1, 2) of the slip velocity. The slip velocity is the velocity of
// the plate relative to a part at (x, y) with velocity (vx, vy). The last row is the constant term.
// `coefficients` (2 N, 3) are the coefficients of the plate's twist in plate_home.
[[gnu::always_inline]] inline void slip_at(View<const double, 2> coefficients, double x, double y,
                                           double vx, double vy, View<double, 2> slip) {
    const int rows = coefficients.size(0);
    for (int j = 0; j < rows; j++) {
        const double* own = coefficients[j];
        slip(j, 0) = own[0] - y * own[2];
        slip(j, 1) = own[1] + x * own[2];
    }
    slip(rows, 0) = -vx, slip(rows, 1) = -vy;
}

// Returns the mean of the slip's unit vector over the nodes from `start` to `stop` (exclusive). The
// number of nodes must be a multiple of eight. The function writes four rows of `work`: slip x,
// slip y, the squared slip, and 1 / |slip|.
[[gnu::always_inline]] inline Force equal_steps(View<const double, 2> slip,
                                                View<const double, 2> waves, int start, int stop,
                                                View<double, 2> work) {
    const int n = stop - start, rows = slip.size(0) - 1;
    double *__restrict wx = work[0], *__restrict wy = work[1];
    double *__restrict square = work[2], *__restrict inverse = work[3];
    for (int k = 0; k < n; k += EIGHT) {
        Four x[2], y[2];
        x[0] = x[1] = slip(rows, 0) + Four{}, y[0] = y[1] = slip(rows, 1) + Four{};
        for (int j = 0; j < rows; j++) {
            const double *wave = waves[j] + start + k, ax = slip(j, 0), ay = slip(j, 1);
            Four first, second;
            load(first, wave), load(second, wave + 4);
            x[0] += ax * first, y[0] += ay * first;
            x[1] += ax * second, y[1] += ay * second;
        }
        store(x[0], wx + k), store(x[1], wx + k + 4);
        store(y[0], wy + k), store(y[1], wy + k + 4);
    }
    double fx[EIGHT] = {}, fy[EIGHT] = {};
    for (int k = 0; k < n; k += EIGHT)
#pragma omp simd
        for (int i = 0; i < EIGHT; i++) {
            const double u = wx[k + i], v = wy[k + i], d = u * u + v * v;
            const double r = 1 / std::sqrt(std::max(d, TINY_SQUARE));
            square[k + i] = d, inverse[k + i] = r;
            fx[i] += r * u;
            fy[i] += r * v;
        }
    return {sum_of_eight(fx) / n, sum_of_eight(fy) / n};
}

// Computes the derivatives of the result of `equal_steps` with respect to the slip's coefficients,
// and adds them to `gradient` (3, 2 N). `work` is overwritten.
[[gnu::always_inline]] inline void step_slopes(View<const double, 2> waves, int start, int stop,
                                               View<double, 2> work, View<double, 2> gradient) {
    const int n = stop - start;
    double *__restrict xx = work[0], *__restrict xy = work[1], *__restrict yy = work[2];
    const double* __restrict inverse = work[3];
#pragma omp simd
    for (int k = 0; k < n; k++) {
        const double r = inverse[k], ux = xx[k] * r, uy = xy[k] * r;
        const double g = yy[k] > TINY_SQUARE ? r / n : 0.0;
        xx[k] = g * uy * uy, xy[k] = -g * ux * uy, yy[k] = g * ux * ux;
    }
    for (int j = 0; j < waves.size(0); j += 2) {
        const double *even = waves[j] + start, *odd = waves[j + 1] + start;
        Four by_even[3][2] = {}, by_odd[3][2] = {};
        for (int k = 0; k < n; k += EIGHT)
            for (int half = 0; half < 2; half++) {
                const int index = k + 4 * half;
                Four slope, first, second;
                load(first, even + index), load(second, odd + index);
                for (int row = 0; row < 3; row++) {
                    load(slope, work[row] + index);
                    by_even[row][half] += slope * first;
                    by_odd[row][half] += slope * second;
                }
            }
        for (int row = 0; row < 3; row++) {
            gradient(row, j) += sum_of_eight(by_even[row]);
            gradient(row, j + 1) += sum_of_eight(by_odd[row]);
        }
    }
}

// Returns the mean of the slip's unit vector over the period. Each piece of the period is
// integrated by adaptive quadrature. If `gradient` (3, 2 N) is not empty, it receives the
// derivatives with respect to the slip's coefficients.
PLATE_WIDE inline Force by_panels(View<const double, 2> slip, const Rules& rule,
                                  View<double, 2> gradient) {
    const int number = rule.taylor.size(1);
    const bool sloped = gradient.size(0) > 0;
    std::fill_n(gradient.data, gradient.size(0) * gradient.size(1), 0.0);
    double power[DEGREE + 1][2], local[3][DEGREE + 1];
    Force total{0, 0};
    for (int piece = 0; piece < rule.pieces; piece++) {
        const double middle = 2 * near_zero_slip::PI * (piece + 0.5) / rule.pieces;
        std::fill_n(&power[0][0], 2 * (DEGREE + 1), 0.0);
        power[0][0] = slip(2 * number, 0), power[0][1] = slip(2 * number, 1);
        for (int j = 0; j < number; j++) {
            const double s = std::sin((j + 1) * middle), c = std::cos((j + 1) * middle);
            for (int axis = 0; axis < 2; axis++) {
                const double a = slip(j, axis), b = slip(number + j, axis);
                const double value = a * s + b * c, rate = a * c - b * s;
                for (int m = 0; m <= DEGREE; m++)
                    power[m][axis] += rule.taylor(m, j) * (m % 2 ? rate : value);
            }
        }
        std::fill_n(&local[0][0], 3 * (DEGREE + 1), 0.0);
        const Force mean = mean_direction<DEGREE>(power, -0.5, sloped ? local : nullptr);
        total.x += mean.x / rule.pieces;
        total.y += mean.y / rule.pieces;
        for (int j = 0; j < (sloped ? number : 0); j++) {
            const double s = std::sin((j + 1) * middle), c = std::cos((j + 1) * middle);
            for (int row = 0; row < 3; row++) {
                double value = 0, rate = 0;
                for (int m = 0; m <= DEGREE; m++)
                    (m % 2 ? rate : value) += rule.taylor(m, j) * local[row][m];
                gradient(row, j) += (value * s + rate * c) / rule.pieces;
                gradient(row, number + j) += (value * c - rate * s) / rule.pieces;
            }
        }
    }
    return total;
}

// Returns the average friction force [mu m g] for a slip with coefficients (2 N + 1, 2) [m/s].
// `grid` selects the quadrature (see `Grid`). `work` (5, K) is a buffer. If `gradient` (3, 2 N) is
// not empty, it receives the derivatives [s/m] with respect to the first 2 N rows of `slip`. The
// rows of `gradient` are d f_x / d slip_x, d f_x / d slip_y = d f_y / d slip_x, and d f_y / d
// slip_y.
PLATE_WIDE inline Force force_of(View<const double, 2> slip, const Rules& rule, int grid,
                                 View<double, 2> work, View<double, 2> gradient) {
    if (grid == PANELS) return by_panels(slip, rule, gradient);
    const bool few = grid == FEW;
    const int start = few ? 0 : rule.few, stop = few ? rule.few : rule.waves.size(1);
    const int n = stop - start, half_rows = rule.waves.size(0) / 2;
    Force force = equal_steps(slip, rule.waves, start, stop, work);
    const int dips = grid == ADAPTIVE ? near_zero_slip::find_dips(work[2], n, work[4]) : 0;
    if (gradient.size(0)) {
        std::fill_n(gradient.data, gradient.size(0) * gradient.size(1), 0.0);
        step_slopes(rule.waves, start, stop, work, gradient);
    }
    for (int dip = 0; dip < dips; dip++) {
        const int k = start + static_cast<int>(work(4, dip));
        const near_zero_slip::Complex start_point{rule.waves(half_rows, k), rule.waves(0, k)};
        const near_zero_slip::Excess more = near_zero_slip::excess(slip, start_point, n, gradient);
        if (!more.valid) return by_panels(slip, rule, gradient);
        force.x -= more.x;
        force.y -= more.y;
    }
    return force;
}

// Computes the average friction forces (C, 2) [mu m g] for C pairs of a plate motion (2 N, 3) and a
// part.
inline void sinusoid_forces(View<const double, 3> coefficients, View<const double, 2> position,
                            View<const double, 2> velocity, const Rules& rule,
                            View<double, 2> force) {
    const int rows = coefficients.size(1);
    Matrix slip(rows + 1, 2), work(5, rule.waves.size(1));
    const View<double, 2> own{slip[0], {rows + 1, 2}}, samples{work[0], {5, work.columns}};
    const View<double, 2> none{nullptr, {0, 0}};
    for (int i = 0; i < coefficients.size(0); i++) {
        slip_at({coefficients[i], {rows, 3}}, position(i, 0), position(i, 1), velocity(i, 0),
                velocity(i, 1), own);
        const Force found = force_of({own.data, own.shape}, rule, ADAPTIVE, samples, none);
        force(i, 0) = found.x, force(i, 1) = found.y;
    }
}

}  // namespace plate
