// Composes J rotations of the plate to a closed motion, and computes the derivatives of this
// motion. At the end of a closed motion, the plate is again at its initial pose. The file family.py
// describes the knots, which are the times between the segments.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <vector>

#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate::rotations {

// Peak acceleration of a cubic ramp divided by its mean acceleration.
constexpr double RAMP_PEAK = 1.5;

inline View<const double, 2> view_of(const Matrix& matrix) {
    return {matrix[0], {matrix.rows, matrix.columns}};
}

inline double sum(const std::vector<double>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0);
}

// Durations (J + 1,) [s] of the ramps between the twists, and derivatives (J + 1, 3) of the
// durations with respect to the change of twist.
struct Ramps {
    std::vector<double> length;
    Matrix slope;
};

// Times of the knots (K,) [s], and the plate's twists at the knots (K, 3). Between two knots is a
// segment: a ramp or a hold.
struct Knots {
    std::vector<double> times;
    Matrix twists;

    int segments() const { return static_cast<int>(times.size()) - 1; }
};

// Computes the durations of the ramps between twists (J, 3). The first ramp begins at rest, and the
// last ramp ends at rest. Let d be the change of the twist in a ramp, and v the resulting velocity
// change of the fastest corner. The duration is
//
//     RAMP_PEAK max(|v|, |row . d| for each row of loads) / accel.
//
// `half` (2,) contains the half side lengths of the plate [m]. `loads` has the shape (m, 3).
inline Ramps ramps(View<const double, 2> twists, const double* half, View<const double, 2> loads,
                   double accel) {
    const int count = twists.size(0);
    Ramps result{std::vector<double>(count + 1), Matrix(count + 1, 3)};
    for (int j = 0; j <= count; j++) {
        double d[3] = {};
        for (int c = 0; c < 3; c++) {
            if (j < count) d[c] += twists(j, c);
            if (j > 0) d[c] -= twists(j - 1, c);
        }
        double maximum = -1, corner_x = 0, corner_y = 0;
        for (double x : {-half[0], half[0]})
            for (double y : {-half[1], half[1]}) {
                const double u = d[0] - d[2] * y, v = d[1] + d[2] * x, square = u * u + v * v;
                if (square > maximum) maximum = square, corner_x = x, corner_y = y;
            }
        double change = std::sqrt(maximum);
        int largest_load = -1;  // index of the row of `loads` that determines the duration
        for (int i = 0; i < loads.size(0); i++) {
            const double* row = loads[i];
            const double load = std::abs(row[0] * d[0] + row[1] * d[1] + row[2] * d[2]);
            if (load > change) change = load, largest_load = i;
        }
        result.length[j] = RAMP_PEAK * change / accel;
        double* slope = result.slope[j];
        if (largest_load >= 0) {
            const double* row = loads[largest_load];
            const double sign = row[0] * d[0] + row[1] * d[1] + row[2] * d[2] > 0 ? 1 : -1;
            for (int c = 0; c < 3; c++) slope[c] = RAMP_PEAK / accel * sign * row[c];
        } else if (change > 0) {
            // unit vector of the corner's velocity change
            const double ux = (d[0] - d[2] * corner_y) / change;
            const double uy = (d[1] + d[2] * corner_x) / change;
            slope[0] = RAMP_PEAK / accel * ux;
            slope[1] = RAMP_PEAK / accel * uy;
            slope[2] = RAMP_PEAK / accel * (uy * corner_x - ux * corner_y);
        }
    }
    return result;
}

// Computes the knots for rotations with the twists (J, 3). The relative durations `holds` (J + 1,)
// are scaled to fill the part of the period that the ramps do not use.
inline Knots place_knots(const std::vector<double>& holds, View<const double, 2> twists,
                     const std::vector<double>& ramp, double period) {
    const int count = twists.size(0);
    const double scale = (period - sum(ramp)) / sum(holds);
    Knots knots{std::vector<double>(2 * count + 3), Matrix(2 * count + 3, 3)};
    double t = 0;
    for (int j = 0; j < count; j++) {
        t += ramp[j];
        knots.times[2 * j + 1] = t;
        t += scale * holds[j];
        knots.times[2 * j + 2] = t;
        std::copy_n(twists[j], 3, knots.twists[2 * j + 1]);
        std::copy_n(twists[j], 3, knots.twists[2 * j + 2]);
    }
    knots.times[2 * count + 1] = t + ramp[count];
    knots.times[2 * count + 2] = period;
    return knots;
}

// Computes the pose (K, 3) at every knot by integration of the twists. The correction that closes
// the motion is not included.
inline Matrix knot_poses(const Knots& knots) {
    Matrix pose(knots.twists.rows, 3);
    for (int k = 1; k < pose.rows; k++) {
        const double h = knots.times[k] - knots.times[k - 1];
        const double *start = knots.twists[k - 1], *end = knots.twists[k];
        for (int c = 0; c < 3; c++) pose[k][c] = pose[k - 1][c] + 0.5 * h * (start[c] + end[c]);
    }
    return pose;
}

// The middle of a time step. Here, x is this time as a fraction of the segment, and y is this time
// as a fraction of the period. The closing function C(y) = y^3 (10 - 15 y + 6 y^2) rises smoothly
// from 0 to 1 during the period. `closing` is its value at this time. `closing_rate` and
// `closing_accel` are its first and second time derivatives.
struct Instant {
    double x, y, closing, closing_rate, closing_accel;

    [[gnu::always_inline]] Instant(const Knots& knots, int segment, int step, int steps) {
        const double start = knots.times[segment], period = knots.times.back();
        x = (step + 0.5) / steps;
        y = (start + (knots.times[segment + 1] - start) * x) / period;
        closing = y * (y * y) * (10 - 15 * y + 6 * y * y);
        closing_rate = 30 * y * y * ((1 - y) * (1 - y)) / period;
        closing_accel = 60 * y * (1 - y) * (1 - 2 * y) / (period * period);
    }
};

// Samples of a motion: pose, twist and acceleration (n, 3) at the middles of the time steps, and
// the step lengths dt (n,). `knot_pose` (K, 3) are the poses at the knots before the correction
// that closes the motion. Their last row is the gap between end and start.
struct MotionSamples {
    Matrix pose, twist, accel;
    std::vector<double> dt;
    Matrix knot_pose;
};

// Returns the number of time steps of a motion. Each ramp has steps[0] steps. Each hold, in which
// the twist is constant, has steps[1] steps.
inline int steps_of(const Knots& knots, const std::array<int, 2>& steps) {
    return knots.segments() / 2 * (steps[0] + steps[1]);
}

// Samples the motion. Let u be the twist and z the pose at the start of a segment of length h. Let d
// be the change of the twist in the segment, x the fraction of the segment from 0 to 1, and C the
// closing function (see `Instant`). Then
//
//     twist(x) = u + d (3 x^2 - 2 x^3)              - gap C'
//     pose(x)  = z + h (u x + d (x^3 - x^4/2))      - gap C
//     accel(x) = d 6 x (1 - x) / h                  - gap C''
inline MotionSamples motion(const Knots& knots, const std::array<int, 2>& steps) {
    const int n = steps_of(knots, steps), segments = knots.segments();
    MotionSamples samples{Matrix(n, 3), Matrix(n, 3), Matrix(n, 3), std::vector<double>(n),
                          knot_poses(knots)};
    const Matrix& knot_pose = samples.knot_pose;
    const double* gaps = knot_pose[segments];
    int i = 0;
    for (int k = 0; k < segments; k++) {
        const int count = steps[k % 2];
        const double h = knots.times[k + 1] - knots.times[k];
        const double *start = knots.twists[k], *end = knots.twists[k + 1], *pose = knot_pose[k];
        for (int step = 0; step < count; step++, i++) {
            const Instant now(knots, k, step, count);
            const double x = now.x, square = x * x;
            const double ramp_rate = h > 0 ? 6 * x * (1 - x) / h : 0.0;
            for (int c = 0; c < 3; c++) {
                const double u = start[c], d = end[c] - u, gap = gaps[c];
                const double z =
                    pose[c] + h * (u * x + d * (x * square - 0.5 * (square * square)));
                samples.pose[i][c] = z - gap * now.closing;
                samples.twist[i][c] = u + d * x * x * (3 - 2 * x) - gap * now.closing_rate;
                samples.accel[i][c] = d * ramp_rate - gap * now.closing_accel;
            }
            samples.dt[i] = h / count;
        }
    }
    return samples;
}

// Derivatives of R results with respect to the knots of a sequence. Each matrix has R columns. Row
// k of `time` contains the derivatives with respect to the time of knot k. Rows 3 k to 3 k + 2 of
// `twist` belong to the twist at knot k. The same rows of `pose` belong to the pose at knot k
// before the motion is closed.
struct ByKnots {
    Matrix time, twist, pose;

    ByKnots(const Knots& knots, int results)
        : time(knots.segments() + 1, results),
          twist(3 * (knots.segments() + 1), results),
          pose(3 * (knots.segments() + 1), results) {}

    int results() const { return time.columns; }
};

// Applies the chain rule to `knot_poses`: adds the effect of the knots' poses (`pose`) to the
// derivatives with respect to the times and twists of the knots. The pose at knot k adds to the
// poses at all later knots, so the derivatives with respect to these poses are summed backwards.
PLATE_WIDE inline void knot_poses_back(const Knots& knots, ByKnots& by) {
    const int results = by.results();
    std::vector<double> totals(results);
    for (int c = 0; c < 3; c++) {
        double* __restrict total = totals.data();
        std::fill_n(total, results, 0.0);
        for (int k = knots.segments(); k > 0; k--) {
            const double mean = 0.5 * (knots.twists[k - 1][c] + knots.twists[k][c]);
            const double h = knots.times[k] - knots.times[k - 1];
            const double* __restrict pose = by.pose[3 * k + c];
            double *__restrict end_twist = by.twist[3 * k + c], *__restrict end_time = by.time[k];
            double *__restrict start_twist = by.twist[3 * (k - 1) + c];
            double* __restrict start_time = by.time[k - 1];
#pragma omp simd
            for (int r = 0; r < results; r++) {
                total[r] += pose[r];
                start_twist[r] += 0.5 * h * total[r];
                end_twist[r] += 0.5 * h * total[r];
                end_time[r] += mean * total[r];
                start_time[r] -= mean * total[r];
            }
        }
    }
}

// Converts derivatives with respect to the samples of `motion` to derivatives with respect to the
// knots. `by_pose` has the shape (3, n, R), or (2, n, R) if the results do not depend on the
// plate's angle theta. `by_twist` has the shape (3, n, R), and `by_dt` has the shape (n, R).
//
// The function applies the chain rule to the equations of `motion`. Let q and g be the derivatives
// of a result with respect to the pose and the twist of a sample. Let S = 3 x^2 - 2 x^3 and
// R = x^3 - x^4/2. The sample contributes to the derivatives with respect to
//
//     twist at the start of the segment:  g (1 - S) + q h (x - R)
//     twist at the end of the segment:    g S + q h R
//     pose at the start of the segment:   q
//     gap:                                -(q C + g C')
//     length h:                           q (u x + d R), plus by_dt / number of steps
//     time t of the sample:               -gap (q C' + g C'')
//
// The length is the difference of the knots' times, and t = (1 - x) start time + x end time.
PLATE_WIDE inline ByKnots pull_back(const Knots& knots, const std::array<int, 2>& steps,
                                    View<const double, 3> by_pose, View<const double, 3> by_twist,
                                    View<const double, 2> by_dt) {
    const int results = by_dt.size(1), segments = knots.segments(), pose_axes = by_pose.size(0);
    ByKnots by(knots, results);
    const Matrix poses = knot_poses(knots);
    const double* gaps = poses[segments];
    std::vector<double> length_slopes(results), time_slopes(results);
    double *__restrict by_h = length_slopes.data(), *__restrict by_t = time_slopes.data();
    int i = 0;
    for (int k = 0; k < segments; k++) {
        const int count = steps[k % 2];
        const double h = knots.times[k + 1] - knots.times[k];
        for (int step = 0; step < count; step++, i++) {
            const Instant now(knots, k, step, count);
            const double x = now.x, start_weight = 1 - x;
            const double s = x * x * (3 - 2 * x), rise = x * (x * x) - 0.5 * ((x * x) * (x * x));
            const double* __restrict sample_dt = by_dt[i];
#pragma omp simd
            for (int r = 0; r < results; r++) by_h[r] = sample_dt[r] / count, by_t[r] = 0;
            for (int c = 0; c < 3; c++) {
                const double u = knots.twists[k][c], d = knots.twists[k + 1][c] - u, gap = gaps[c];
                const double mean_twist = u * x + d * rise;
                const double* __restrict twist = &by_twist(c, i, 0);
                double* __restrict start = by.twist[3 * k + c];
                double* __restrict end = by.twist[3 * (k + 1) + c];
                double* __restrict by_gap = by.pose[3 * segments + c];
                if (c < pose_axes) {
                    const double* __restrict pose = &by_pose(c, i, 0);
                    double* __restrict start_pose = by.pose[3 * k + c];
#pragma omp simd
                    for (int r = 0; r < results; r++) {
                        const double g = twist[r], q = pose[r];
                        start[r] += g * (1 - s) + q * h * (x - rise);
                        end[r] += g * s + q * h * rise;
                        by_h[r] += q * mean_twist;
                        by_t[r] -= gap * (q * now.closing_rate + g * now.closing_accel);
                        start_pose[r] += q;
                        by_gap[r] -= q * now.closing + g * now.closing_rate;
                    }
                } else {
#pragma omp simd
                    for (int r = 0; r < results; r++) {
                        const double g = twist[r];
                        start[r] += g * (1 - s);
                        end[r] += g * s;
                        by_t[r] -= gap * (g * now.closing_accel);
                        by_gap[r] -= g * now.closing_rate;
                    }
                }
            }
            double *__restrict start_time = by.time[k], *__restrict end_time = by.time[k + 1];
#pragma omp simd
            for (int r = 0; r < results; r++) {
                start_time[r] += by_t[r] * start_weight - by_h[r];
                end_time[r] += by_t[r] * x + by_h[r];
            }
        }
    }
    knot_poses_back(knots, by);
    return by;
}

// Returns the derivatives of the three components of the gap with respect to the knots.
inline ByKnots gap_back(const Knots& knots) {
    ByKnots by(knots, 3);
    for (int c = 0; c < 3; c++) by.pose[3 * knots.segments() + c][c] = 1;
    knot_poses_back(knots, by);
    return by;
}

// Derivatives of R results with respect to the relative durations, as `hold` (J + 1, R), and with
// respect to the twists, as `twist` (3 J, R).
struct ByRotations {
    Matrix hold, twist;
};

// Converts derivatives with respect to the knots of `place_knots` to derivatives with respect to
// the relative durations `holds` (J + 1,) and the twists (J, 3).
//
// Let a_k be the derivative of a result with respect to the length of segment k. A longer segment
// shifts all later knots, so a_k is the sum of the derivatives with respect to their times. The
// holds have the lengths `scale` holds_j, and scale = (period - sum of all ramps) / sum of holds.
// Let m = sum_j a_j holds_j / (sum of holds) be the weighted mean over the holds. Then
//
//     derivative with respect to holds_j             = scale (a_j - m)
//     derivative with respect to the length of ramp j = a_j - m
PLATE_WIDE inline ByRotations rotations_back(const std::vector<double>& holds, const Ramps& ramp,
                                             double period, const ByKnots& by) {
    const int results = by.results(), count = static_cast<int>(holds.size()) - 1;
    const double total = sum(holds), scale = (period - sum(ramp.length)) / total;
    ByRotations result{Matrix(count + 1, results), Matrix(3 * count, results)};
    Matrix by_ramp(count + 1, results), sums(2, results);
    double *__restrict by_length = sums[0], *__restrict mean = sums[1];
    for (int k = 2 * count + 1; k >= 0; k--) {
        const bool is_hold = k % 2;
        const double* __restrict time = by.time[k + 1];
        double* __restrict segment = is_hold ? result.hold[k / 2] : by_ramp[k / 2];
        const double fraction = holds[k / 2] / total;
        if (is_hold) {
#pragma omp simd
            for (int r = 0; r < results; r++) {
                by_length[r] += time[r];
                segment[r] = scale * by_length[r];
                mean[r] += fraction * by_length[r];
            }
        } else {
#pragma omp simd
            for (int r = 0; r < results; r++) segment[r] = by_length[r] += time[r];
        }
    }
    for (int j = 0; j <= count; j++) {
        double* __restrict hold = result.hold[j];
        const double* __restrict ramp_length = by_ramp[j];
#pragma omp simd
        for (int r = 0; r < results; r++) hold[r] -= scale * mean[r];
        for (int c = 0; c < 3; c++) {
            const double slope = ramp.slope[j][c];
            if (j < count) {
                const double *__restrict start = by.twist[3 * (2 * j + 1) + c];
                const double *__restrict end = by.twist[3 * (2 * j + 2) + c];
                double* __restrict twist = result.twist[3 * j + c];
#pragma omp simd
                for (int r = 0; r < results; r++)
                    twist[r] += (ramp_length[r] - mean[r]) * slope + start[r] + end[r];
            }
            if (j > 0) {
                double* __restrict twist = result.twist[3 * (j - 1) + c];
#pragma omp simd
                for (int r = 0; r < results; r++) twist[r] -= (ramp_length[r] - mean[r]) * slope;
            }
        }
    }
    return result;
}

}  // namespace plate::rotations
