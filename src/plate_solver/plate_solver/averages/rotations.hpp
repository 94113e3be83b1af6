// C++ kernels of rotations.py, which computes the average friction forces of a sequence of
// rotations.
//
// By the chain rule, the derivatives of the forces with respect to the parameters are a product.
// The first factor is the derivative of the forces with respect to the samples of the motion. The
// second factor is the derivative of the samples with respect to the parameters (sequence.hpp). A
// segment of the motion has two knots. The derivatives of each time step are added directly to the
// two knots of its segment.
#pragma once
#include "averages/mean_force.hpp"
#include "fit/levenberg_marquardt.hpp"
#include "rotations/family.hpp"

namespace plate::rotations {

// Options of the Levenberg-Marquardt method that also stop a slow search. A search stops if ten
// steps reduce the squared error by less than 10 %. With a stricter criterion, some searches for
// feasible forces would stop too early.
constexpr Damping PATIENT{.stall_steps = 10, .stall_fraction = 0.9};

// Average forces that a sequence of rotations must exert. `SequenceForces` in rotations.py
// describes the fields.
struct SequenceForces {
    Sequences family;
    View<const double, 2> position, velocity;  // (M, 2)
    // Indices of the R requested values in the list of all 3 M values. This list contains force x,
    // force y and curl of part 1, then of part 2, and so on.
    std::vector<int> rows;
    View<const double, 1> requested, scale;  // (R,)
};

// Computes the scaled errors (R,) of the average forces: requested value minus actual value. The
// plate moves with the twists (n, 3) during steps of length dt (n,) [s].
inline void missed(const SequenceForces& problem, View<const double, 2> twist, const double* dt,
                   std::vector<double>& error) {
    const int count = problem.position.size(0);
    Matrix mean(count, 3);
    step_forces(problem.position, problem.velocity, twist, dt, {mean[0], {count, 3}});
    error.resize(problem.rows.size());
    for (size_t r = 0; r < error.size(); r++)
        error[r] = (problem.requested(r) - mean[0][problem.rows[r]]) * problem.scale(r);
}

// Positions and velocities of the parts, as one array per coordinate.
struct Parts {
    std::vector<double> x, y, vx, vy;

    Parts(View<const double, 2> position, View<const double, 2> velocity) {
        for (int i = 0; i < position.size(0); i++) {
            x.push_back(position(i, 0)), y.push_back(position(i, 1));
            vx.push_back(velocity(i, 0)), vy.push_back(velocity(i, 1));
        }
    }
};

// Rows of the matrix `slopes` in `step_slopes`. Each row contains one derivative of force x (X),
// force y (Y) or curl with respect to the twist (u, v, spin). For example, XY is d force x / d v.
// The rows of the curl are used only if curls are requested.
enum Row { XX, XY, YY, X_SPIN, Y_SPIN, CURL_U, CURL_V, CURL_SPIN };

// Computes the contribution of one time step, which takes `fraction` of the period. `slopes` (8, M)
// receives the derivatives of each part's force and curl with respect to the twist. The force and
// the curl during the step are added to `force` (3, M).
template <bool TURNING>
[[gnu::always_inline]] inline void step_slopes(const double (&twist)[3], const Parts& parts,
                                               double fraction, Matrix& slopes, Matrix& force) {
    const int count = slopes.columns;
    const double u = twist[0], v = twist[1], spin = twist[2];
    const double *__restrict px = parts.x.data(), *__restrict py = parts.y.data();
    const double *__restrict vx = parts.vx.data(), *__restrict vy = parts.vy.data();
    double *__restrict by_xx = slopes[XX], *__restrict by_xy = slopes[XY];
    double* __restrict by_yy = slopes[YY];
    double *__restrict x_spin = slopes[X_SPIN], *__restrict y_spin = slopes[Y_SPIN];
    double *__restrict curl_u = slopes[CURL_U], *__restrict curl_v = slopes[CURL_V];
    double* __restrict curl_spin = slopes[CURL_SPIN];
    double *__restrict fx = force[0], *__restrict fy = force[1], *__restrict curls = force[2];
#pragma omp simd
    for (int i = 0; i < count; i++) {
        const double x = px[i], y = py[i];
        const double dx = u - spin * y - vx[i], dy = v + spin * x - vy[i];
        const double square = dx * dx + dy * dy;
        const double inverse = 1 / std::sqrt(std::max(square, TINY_SQUARE));
        const double a = dx * inverse, b = dy * inverse;
        const double own = square > TINY_SQUARE ? fraction * inverse : 0.0;
        const double xx = own * (1 - a * a), xy = -own * a * b, yy = own * (1 - b * b);
        by_xx[i] = xx, by_xy[i] = xy, by_yy[i] = yy;
        x_spin[i] = x * xy - y * xx, y_spin[i] = x * yy - y * xy;
        fx[i] += a;
        fy[i] += b;
        if constexpr (TURNING) {
            const double curl = spin * inverse, gx = -own * a * curl, gy = -own * b * curl;
            curl_u[i] = gx, curl_v[i] = gy, curl_spin[i] = x * gy - y * gx + own;
            curls[i] += curl;
        }
    }
}

// Adds the contribution of segment k to the derivatives with respect to its two knots. `total` (5,
// 8 M) contains five weighted sums over the derivatives of the segment's steps. `force` (3, M)
// contains the sums of the steps' forces and curls. The results are ordered: force x of all parts,
// force y of all parts, curls of all parts.
inline void to_knots(int k, double steps_period, const double* gap, const Matrix& total,
                     const Matrix& force, ByKnots& by) {
    constexpr int ROW[3][3] = {{XX, XY, X_SPIN}, {XY, YY, Y_SPIN}, {CURL_U, CURL_V, CURL_SPIN}};
    const int count = force.columns, last = by.time.rows - 1;
    for (int axis = 0; axis * count < by.results(); axis++) {
        double *__restrict time = by.time[k] + axis * count;
        double *__restrict next_time = by.time[k + 1] + axis * count;
        for (int i = 0; i < count; i++) {
            const double by_length = force[axis][i] / steps_period;
            time[i] -= by_length;
            next_time[i] += by_length;
        }
        for (int c = 0; c < 3; c++) {
            const int first = ROW[axis][c] * count;
            double* __restrict start = by.twist[3 * k + c] + axis * count;
            double* __restrict end = by.twist[3 * (k + 1) + c] + axis * count;
            double* __restrict by_gap = by.pose[3 * last + c] + axis * count;
            for (int i = 0; i < count; i++) {
                start[i] += total[0][first + i];
                end[i] += total[1][first + i];
                by_gap[i] -= total[2][first + i];
                time[i] -= gap[c] * total[3][first + i];
                next_time[i] -= gap[c] * total[4][first + i];
            }
        }
    }
}

// Returns the derivatives of the average forces with respect to the knots. The forces are ordered:
// force x of all parts, force y of all parts and, if TURNING, the curls of all parts.
template <bool TURNING>
[[gnu::always_inline]] inline ByKnots forces_back(const Sequences& family, const Knots& knots,
                                                  const Parts& parts) {
    constexpr int WEIGHTS = 5, ROWS = TURNING ? 8 : 5;
    const int count = static_cast<int>(parts.x.size()), segments = knots.segments();
    const double period = knots.times.back();
    const Matrix poses = knot_poses(knots);
    const double* gap = poses[segments];
    ByKnots by(knots, (TURNING ? 3 : 2) * count);
    Matrix slopes(8, count), force(3, count), total(WEIGHTS, ROWS * count);
    for (int k = 0; k < segments; k++) {
        const int steps = family.steps[k % 2];
        const double fraction = (knots.times[k + 1] - knots.times[k]) / (steps * period);
        const double *start = knots.twists[k], *end = knots.twists[k + 1];
        std::fill(total.numbers.begin(), total.numbers.end(), 0.0);
        std::fill(force.numbers.begin(), force.numbers.end(), 0.0);
        for (int step = 0; step < steps; step++) {
            const Instant now(knots, k, step, steps);
            const double x = now.x, s = x * x * (3 - 2 * x);
            const double weight[WEIGHTS] = {1 - s, s, now.closing_rate,
                                            now.closing_accel * (1 - x), now.closing_accel * x};
            double twist[3];
            for (int c = 0; c < 3; c++)
                twist[c] = start[c] * (1 - s) + end[c] * s - gap[c] * now.closing_rate;
            step_slopes<TURNING>(twist, parts, fraction, slopes, force);
            const double* __restrict flat = slopes[0];
            for (int w = 0; w < WEIGHTS; w++) {
                double* __restrict sum = total[w];
#pragma omp simd
                for (int i = 0; i < ROWS * count; i++) sum[i] += weight[w] * flat[i];
            }
        }
        to_knots(k, steps * period, gap, total, force, by);
    }
    knot_poses_back(knots, by);
    return by;
}

// Computes the derivatives (R, P) of R results of `step_forces` with respect to the P parameters of
// the sequence. `rows` contains the indices of these results. `knots` contains the knots of the
// sequence with the parameters `theta`.
PLATE_WIDE inline void force_slopes(const Parameters& theta, const Sequences& family,
                                    const Knots& knots, View<const double, 2> position,
                                    View<const double, 2> velocity,
                                    const std::vector<int>& rows, Matrix& jacobian) {
    const int count = position.size(0);
    const Parts parts(position, velocity);
    bool turning = false;
    std::vector<int> results;  // index of each row in the results of `forces_back`
    for (int row : rows) {
        results.push_back(row % 3 * count + row / 3);
        turning = turning || row % 3 == 2;
    }
    const ByKnots by = turning ? forces_back<true>(family, knots, parts)
                               : forces_back<false>(family, knots, parts);
    parameters_back(theta, family, by, results, jacobian);
}

// Adjusts the parameters of a sequence until its average forces match the request.
inline Fit descend(const SequenceForces& problem, Parameters theta, double tolerance,
                   int iterations) {
    Run run;
    const auto evaluate = [&](Parameters& trial, std::vector<double>& error) {
        run = runnable(std::move(trial), problem.family);
        trial = run.theta;
        missed(problem, view_of(run.samples.twist), run.samples.dt.data(), error);
    };
    const auto slopes = [&](Matrix& jacobian) {
        force_slopes(run.theta, problem.family, run.knots, problem.position, problem.velocity,
                     problem.rows, jacobian);
        for (int r = 0; r < jacobian.rows; r++)
            for (int p = 0; p < jacobian.columns; p++) jacobian[r][p] *= problem.scale(r);
    };
    return levenberg_marquardt<double>(evaluate, slopes, std::move(theta), PATIENT, tolerance,
                                       iterations);
}

}  // namespace plate::rotations
