// C++ kernels of mean_force.py, which computes the average friction force on a part during a
// period.
#pragma once
#include <algorithm>
#include <cmath>

#include <plate/simd.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

// Squared slip velocity [m2/s2] below which the friction force counts as 0.
constexpr double TINY_SQUARE = 1e-24;

// Nodes and weights of the Gauss-Legendre quadrature on the interval [-1, 1].
constexpr int NODE_COUNT = 8;
constexpr double NODES[NODE_COUNT] = {-0.9602898564975362,  -0.7966664774136267, -0.525532409916329,
                                      -0.18343464249564978, 0.18343464249564978, 0.525532409916329,
                                      0.7966664774136267,   0.9602898564975362};
constexpr double NODE_WEIGHTS[NODE_COUNT] = {0.10122853629037706, 0.22238103445337443,
                                             0.3137066458778869,  0.36268378337836166,
                                             0.36268378337836166, 0.3137066458778869,
                                             0.22238103445337443, 0.10122853629037706};

// A panel is an interval to which the Gauss-Legendre quadrature is applied. FAR is the minimum
// distance between a panel and the singularities of the integrand. The unit is half the length of
// the panel. The singularities are the complex times at which the slip is zero. At this distance,
// the relative error of the quadrature is (1.2 + 1.56)^-16 = 9e-8.
constexpr double FAR = 1.2;

// Maximum number of bisections of a polynomial piece of the slip. With this number, a time at which
// the slip's direction jumps is located to within 1e-9 of the piece's length.
constexpr int DEEPEST = 32;

struct Force {
    double x, y;
};

constexpr int EIGHT = 8;  // each sum has eight partial sums, for vector instructions

[[gnu::always_inline]] inline double sum_of_eight(const double* part) {
    return ((part[0] + part[4]) + (part[2] + part[6])) +
           ((part[1] + part[5]) + (part[3] + part[7]));
}

[[gnu::always_inline]] inline double sum_of_eight(const Four (&part)[2]) {
    const Four sum = part[0] + part[1];
    return (sum[0] + sum[2]) + (sum[1] + sum[3]);
}

// Computes the derivatives of a panel's contribution to the mean slip direction with respect to the
// coefficients of the slip. Adds these derivatives to `gradient` (3, DEGREE + 1).
template <int DEGREE>
[[gnu::always_inline]] inline void panel_slopes(const double (&slip)[DEGREE + 1][2], double middle,
                                                double half, double (*gradient)[DEGREE + 1]) {
    for (int n = 0; n < NODE_COUNT; n++) {
        const double s = middle + half * NODES[n];
        double wx = 0, wy = 0;
        for (int m = DEGREE; m >= 0; m--) wx = wx * s + slip[m][0], wy = wy * s + slip[m][1];
        const double square = wx * wx + wy * wy;
        if (!(square > TINY_SQUARE)) continue;
        const double inverse = 1 / std::sqrt(square);
        const double ux = wx * inverse, uy = wy * inverse;
        double power = half * NODE_WEIGHTS[n] * inverse;
        for (int m = 0; m <= DEGREE; m++) {
            gradient[0][m] += power * uy * uy;
            gradient[1][m] -= power * ux * uy;
            gradient[2][m] += power * ux * ux;
            power *= s;
        }
    }
}

// Returns the mean f of the slip's unit vector for s from `first` to `first` + 1. The slip w is a
// polynomial of s. A Gauss-Legendre panel is bisected if the slip nearly vanishes in or near the
// panel. If `gradient` is not null, the derivatives with respect to the coefficients of w are added
// to `gradient`. The rows of `gradient` are d f_x / d w_x, d f_x / d w_y = d f_y / d w_x, and d f_y
// / d w_y.
template <int DEGREE>
[[gnu::always_inline]] inline Force mean_direction(const double (&slip)[DEGREE + 1][2],
                                                   double first, double (*gradient)[DEGREE + 1]) {
    Force force{0, 0};
    int level = 0;         // number of bisections
    long long number = 0;  // number of panels of the same length to the left
    double half = 0.5;     // half of the panel's length
    while (true) {
        const double middle = first + static_cast<double>(2 * number + 1) * half;
        double s[NODE_COUNT], wx[NODE_COUNT] = {}, wy[NODE_COUNT] = {}, ax[NODE_COUNT] = {},
                              ay[NODE_COUNT] = {}, distance[NODE_COUNT];
#pragma omp simd
        for (int n = 0; n < NODE_COUNT; n++) s[n] = middle + half * NODES[n];
#pragma GCC unroll 16
        for (int m = DEGREE; m >= 0; m--)
#pragma omp simd
            for (int n = 0; n < NODE_COUNT; n++) {
                ax[n] = ax[n] * s[n] + wx[n], ay[n] = ay[n] * s[n] + wy[n];
                wx[n] = wx[n] * s[n] + slip[m][0], wy[n] = wy[n] * s[n] + slip[m][1];
            }
        const double near = FAR * half * FAR * half;
#pragma omp simd
        for (int n = 0; n < NODE_COUNT; n++) {
            const double square = wx[n] * wx[n] + wy[n] * wy[n];
            const bool moves = square > TINY_SQUARE;
            const double weight = moves ? half * NODE_WEIGHTS[n] / std::sqrt(square) : 0.0;
            const double beyond = square - near * (ax[n] * ax[n] + ay[n] * ay[n]);
            distance[n] = moves ? beyond : 0.0;
            wx[n] *= weight, wy[n] *= weight;
        }
        bool fine = true;
        for (int n = 0; n < NODE_COUNT; n++) fine = fine && distance[n] >= 0;
        if (!fine && level < DEEPEST) {
            level++, number *= 2, half /= 2;
            continue;
        }
        force.x += sum_of_eight(wx);
        force.y += sum_of_eight(wy);
        if (gradient) panel_slopes<DEGREE>(slip, middle, half, gradient);
        number++;
        for (; level > 0 && number % 2 == 0; level--) number /= 2, half *= 2;
        if (level == 0) return force;
    }
}

// Computes the average friction forces (M, 2) [mu m g] on M parts during a spline motion of the
// plate. `PlateCycle` describes the times (K + 1,) and the coefficients (K, 6, 3) of the spline.
PLATE_WIDE inline void spline_force(const double* times, View<const double, 3> coefficients,
                                    View<const double, 2> position, View<const double, 2> velocity,
                                    View<double, 2> force) {
    constexpr int DEGREE = 4;  // degree of the derivative of a quintic spline
    const int pieces = coefficients.size(0);
    double slip[DEGREE + 1][2];
    for (int i = 0; i < position.size(0); i++) {
        const double x = position(i, 0), y = position(i, 1);
        Force total{0, 0};
        for (int k = 0; k < pieces; k++) {
            const double step = times[k + 1] - times[k];
            double power = 1;
            for (int m = 0; m <= DEGREE; m++) {  // polynomial in s, 0 to 1 in the piece
                const double u3 = (m + 1) * coefficients(k, m + 1, 2);
                slip[m][0] = power * ((m + 1) * coefficients(k, m + 1, 0) - y * u3);
                slip[m][1] = power * ((m + 1) * coefficients(k, m + 1, 1) + x * u3);
                power *= step;
            }
            slip[0][0] -= velocity(i, 0);
            slip[0][1] -= velocity(i, 1);
            const Force mean = mean_direction<DEGREE>(slip, 0.0, nullptr);
            total.x += mean.x * step;
            total.y += mean.y * step;
        }
        force(i, 0) = total.x / times[pieces];
        force(i, 1) = total.y / times[pieces];
    }
}

inline double total_time(const double* dt, int count) {
    double total = 0;
    for (int k = 0; k < count; k++) total += dt[k];
    return total;
}

// Computes the average force x, force y and curl of PARTS consecutive parts together. The first of
// these parts has the index `first`.
template <int PARTS>
[[gnu::always_inline]] inline void step_forces_from(int first, View<const double, 2> position,
                                                    View<const double, 2> velocity,
                                                    View<const double, 2> twist, const double* dt,
                                                    double total, View<double, 2> mean) {
    double x[PARTS], y[PARTS], vx[PARTS], vy[PARTS];
    double fx[PARTS] = {}, fy[PARTS] = {}, curl[PARTS] = {};
    for (int i = 0; i < PARTS; i++) {
        x[i] = position(first + i, 0), y[i] = position(first + i, 1);
        vx[i] = velocity(first + i, 0), vy[i] = velocity(first + i, 1);
    }
    for (int k = 0; k < twist.size(0); k++) {
        const double u = twist(k, 0), v = twist(k, 1), w = twist(k, 2), h = dt[k];
#pragma omp simd
        for (int i = 0; i < PARTS; i++) {
            const double dx = u - w * y[i] - vx[i], dy = v + w * x[i] - vy[i];
            const double square = dx * dx + dy * dy;
            const double weight = square > TINY_SQUARE ? h / std::sqrt(square) : 0.0;
            fx[i] += weight * dx;
            fy[i] += weight * dy;
            curl[i] += weight * w;
        }
    }
    for (int i = 0; i < PARTS; i++) {
        double* result = mean[first + i];
        result[0] = fx[i] / total, result[1] = fy[i] / total, result[2] = curl[i] / total;
    }
}

// Computes the average force x, force y [mu m g] and curl [mu m g / m] at M parts, as `mean` (M,
// 3). The plate moves with the twists (n, 3) during steps of length dt (n,) [s].
PLATE_WIDE inline void step_forces(View<const double, 2> position, View<const double, 2> velocity,
                                   View<const double, 2> twist, const double* dt,
                                   View<double, 2> mean) {
    const double total = total_time(dt, twist.size(0));
    const int count = position.size(0);
    int i = 0;
    for (; i + 8 <= count; i += 8)
        step_forces_from<8>(i, position, velocity, twist, dt, total, mean);
    for (; i + 4 <= count; i += 4)
        step_forces_from<4>(i, position, velocity, twist, dt, total, mean);
    for (; i + 2 <= count; i += 2)
        step_forces_from<2>(i, position, velocity, twist, dt, total, mean);
    if (i < count) step_forces_from<1>(i, position, velocity, twist, dt, total, mean);
}

// Computes the derivatives (3, n, 3 M) of the results of `step_forces` with respect to the twists.
// Before the call, all entries of `gradient` must be zero.
inline void step_force_gradient(View<const double, 2> position, View<const double, 2> velocity,
                                View<const double, 2> twist, const double* dt,
                                View<double, 3> gradient) {
    const int count = position.size(0), n = twist.size(0);
    const double total = total_time(dt, n);
    for (int k = 0; k < n; k++) {
        const double w = twist(k, 2), fraction = dt[k] / total;
        for (int i = 0; i < count; i++) {
            const double x = position(i, 0), y = position(i, 1);
            const double dx = twist(k, 0) - w * y - velocity(i, 0);
            const double dy = twist(k, 1) + w * x - velocity(i, 1);
            const double square = dx * dx + dy * dy;
            if (square <= TINY_SQUARE) continue;
            const double inverse = 1 / std::sqrt(square);
            const double ux = dx * inverse, uy = dy * inverse, scale = fraction * inverse;
            const double curl = w * inverse;
            const double by_u[3] = {scale * (1 - ux * ux), -scale * ux * uy, -scale * ux * curl};
            const double by_v[3] = {-scale * ux * uy, scale * (1 - uy * uy), -scale * uy * curl};
            for (int row = 0; row < 3; row++) {
                gradient(0, k, 3 * i + row) = by_u[row];
                gradient(1, k, 3 * i + row) = by_v[row];
                gradient(2, k, 3 * i + row) = x * by_v[row] - y * by_u[row];
            }
            gradient(2, k, 3 * i + 2) += scale;
        }
    }
}

}  // namespace plate
