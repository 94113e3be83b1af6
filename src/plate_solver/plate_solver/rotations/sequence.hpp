// Composes J rotations of the plate to a closed motion, and computes the derivatives of this
// motion. At the end of a closed motion, the plate is again at its initial pose. The file family.py
// contains the formulas, and describes the knots, which are the times between the segments.
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

// Times of the knots (K,) [s], and the plate's twists at the knots (K, 3).
struct Line {
    std::vector<double> times;
    Matrix knots;

    int segments() const { return static_cast<int>(times.size()) - 1; }
};

// Computes the durations of the ramps between twists (J, 3). The first ramp begins at rest, and the
// last ramp ends at rest. `half` (2,) contains the half side lengths of the plate [m]. The
// durations limit the acceleration of the plate's corners to `accel`. The durations also limit the
// products of the rows of `loads` (m, 3) and the plate's acceleration to `accel`.
inline Ramps ramps(View<const double, 2> twists, const double* half, View<const double, 2> loads,
                   double accel) {
    const int count = twists.size(0);
    Ramps found{std::vector<double>(count + 1), Matrix(count + 1, 3)};
    for (int j = 0; j <= count; j++) {
        double d[3] = {};
        for (int c = 0; c < 3; c++) {
            if (j < count) d[c] += twists(j, c);
            if (j > 0) d[c] -= twists(j - 1, c);
        }
        double maximum = -1, at_x = 0, at_y = 0;
        for (double x : {-half[0], half[0]})
            for (double y : {-half[1], half[1]}) {
                const double u = d[0] - d[2] * y, v = d[1] + d[2] * x, square = u * u + v * v;
                if (square > maximum) maximum = square, at_x = x, at_y = y;
            }
        double change = std::sqrt(maximum);
        int which = -1;
        for (int i = 0; i < loads.size(0); i++) {
            const double* row = loads[i];
            const double load = std::abs(row[0] * d[0] + row[1] * d[1] + row[2] * d[2]);
            if (load > change) change = load, which = i;
        }
        found.length[j] = RAMP_PEAK * change / accel;
        double* slope = found.slope[j];
        if (which >= 0) {
            const double* row = loads[which];
            const double way = row[0] * d[0] + row[1] * d[1] + row[2] * d[2] > 0 ? 1 : -1;
            for (int c = 0; c < 3; c++) slope[c] = RAMP_PEAK / accel * way * row[c];
        } else if (change > 0) {
            const double gx = (d[0] - d[2] * at_y) / change, gy = (d[1] + d[2] * at_x) / change;
            slope[0] = RAMP_PEAK / accel * gx;
            slope[1] = RAMP_PEAK / accel * gy;
            slope[2] = RAMP_PEAK / accel * (gy * at_x - gx * at_y);
        }
    }
    return found;
}

// Computes the knots for rotations with the twists (J, 3). The relative durations `holds` (J + 1,)
// are scaled to fill the part of the period that the ramps do not use.
inline Line timeline(const std::vector<double>& holds, View<const double, 2> twists,
                     const std::vector<double>& ramp, double period) {
    const int count = twists.size(0);
    const double scale = (period - sum(ramp)) / sum(holds);
    Line line{std::vector<double>(2 * count + 3), Matrix(2 * count + 3, 3)};
    double t = 0;
    for (int j = 0; j < count; j++) {
        t += ramp[j];
        line.times[2 * j + 1] = t;
        t += scale * holds[j];
        line.times[2 * j + 2] = t;
        std::copy_n(twists[j], 3, line.knots[2 * j + 1]);
        std::copy_n(twists[j], 3, line.knots[2 * j + 2]);
    }
    line.times[2 * count + 1] = t + ramp[count];
    line.times[2 * count + 2] = period;
    return line;
}

// Computes the pose (K, 3) at every knot by integration of the twists. The correction that closes
// the motion is not included.
inline Matrix knot_poses(const Line& line) {
    Matrix pose(line.knots.rows, 3);
    for (int k = 1; k < pose.rows; k++) {
        const double h = line.times[k] - line.times[k - 1];
        const double *before = line.knots[k - 1], *here = line.knots[k];
        for (int c = 0; c < 3; c++) pose[k][c] = pose[k - 1][c] + 0.5 * h * (before[c] + here[c]);
    }
    return pose;
}

// The middle of a time step. Here, x is this time as a fraction of the segment, and y is this time
// as a fraction of the period. The closing function rises smoothly from 0 to 1 during the period.
// `bump` is its value at this time. `rate` and `accel` are its first and second time derivatives.
struct Place {
    double x, y, bump, rate, accel;

    [[gnu::always_inline]] Place(const Line& line, int segment, int part, int parts) {
        const double from = line.times[segment], period = line.times.back();
        x = (part + 0.5) / parts;
        y = (from + (line.times[segment + 1] - from) * x) / period;
        bump = y * (y * y) * (10 - 15 * y + 6 * y * y);
        rate = 30 * y * y * ((1 - y) * (1 - y)) / period;
        accel = 60 * y * (1 - y) * (1 - 2 * y) / (period * period);
    }
};

// Samples of a motion: pose, twist and acceleration (n, 3) at the middles of the time steps, and
// the step lengths dt (n,). `corners` (K, 3) are the poses at the knots before the correction that
// closes the motion. Their last row is the gap between end and start.
struct Moved {
    Matrix pose, twist, accel;
    std::vector<double> dt;
    Matrix corners;
};

// Returns the number of time steps of a motion. Each ramp has steps[0] steps. Each hold, in which
// the twist is constant, has steps[1] steps.
inline int steps_of(const Line& line, const std::array<int, 2>& steps) {
    return line.segments() / 2 * (steps[0] + steps[1]);
}

inline Moved motion(const Line& line, const std::array<int, 2>& steps) {
    const int n = steps_of(line, steps), segments = line.segments();
    Moved moved{Matrix(n, 3), Matrix(n, 3), Matrix(n, 3), std::vector<double>(n), knot_poses(line)};
    const Matrix& corners = moved.corners;
    const double* gaps = corners[segments];
    int i = 0;
    for (int k = 0; k < segments; k++) {
        const int parts = steps[k % 2];
        const double h = line.times[k + 1] - line.times[k];
        const double *from = line.knots[k], *to = line.knots[k + 1], *corner = corners[k];
        for (int part = 0; part < parts; part++, i++) {
            const Place at(line, k, part, parts);
            const double x = at.x, square = x * x, bend = h > 0 ? 6 * x * (1 - x) / h : 0.0;
            for (int c = 0; c < 3; c++) {
                const double u = from[c], d = to[c] - u, gap = gaps[c];
                const double z =
                    corner[c] + h * (u * x + d * (x * square - 0.5 * (square * square)));
                moved.pose[i][c] = z - gap * at.bump;
                moved.twist[i][c] = u + d * x * x * (3 - 2 * x) - gap * at.rate;
                moved.accel[i][c] = d * bend - gap * at.accel;
            }
            moved.dt[i] = h / parts;
        }
    }
    return moved;
}

// Derivatives of R results with respect to the knots of a sequence. Each matrix has R columns. Row
// k of `time` contains the derivatives with respect to the time of knot k. Rows 3 k to 3 k + 2 of
// `knot` belong to the twist at knot k. The same rows of `corner` belong to the pose at knot k
// before the motion is closed.
struct ByKnots {
    Matrix time, knot, corner;

    ByKnots(const Line& line, int results)
        : time(line.segments() + 1, results),
          knot(3 * (line.segments() + 1), results),
          corner(3 * (line.segments() + 1), results) {}

    int results() const { return time.columns; }
};

// Applies the chain rule to `knot_poses`: adds the effect of the knots' poses (`corner`) to the
// derivatives with respect to the times and twists of the knots.
PLATE_WIDE inline void corners_back(const Line& line, ByKnots& by) {
    const int results = by.results();
    std::vector<double> totals(results);
    for (int c = 0; c < 3; c++) {
        double* __restrict total = totals.data();
        std::fill_n(total, results, 0.0);
        for (int k = line.segments(); k > 0; k--) {
            const double mean = 0.5 * (line.knots[k - 1][c] + line.knots[k][c]);
            const double h = line.times[k] - line.times[k - 1];
            const double* __restrict corner = by.corner[3 * k + c];
            double *__restrict knot = by.knot[3 * k + c], *__restrict time = by.time[k];
            double *__restrict before = by.knot[3 * (k - 1) + c];
            double* __restrict time_before = by.time[k - 1];
#pragma omp simd
            for (int r = 0; r < results; r++) {
                total[r] += corner[r];
                before[r] += 0.5 * h * total[r];
                knot[r] += 0.5 * h * total[r];
                time[r] += mean * total[r];
                time_before[r] -= mean * total[r];
            }
        }
    }
}

// Converts derivatives with respect to the samples of `motion` to derivatives with respect to the
// knots. `by_pose` has the shape (3, n, R), or (2, n, R) if the results do not depend on the
// plate's angle theta. `by_twist` has the shape (3, n, R), and `by_dt` has the shape (n, R).
PLATE_WIDE inline ByKnots pull_back(const Line& line, const std::array<int, 2>& steps,
                                    View<const double, 3> by_pose, View<const double, 3> by_twist,
                                    View<const double, 2> by_dt) {
    const int results = by_dt.size(1), segments = line.segments(), posed = by_pose.size(0);
    ByKnots by(line, results);
    const Matrix corners = knot_poses(line);
    const double* gaps = corners[segments];
    std::vector<double> lengths(results), shifts(results);
    double *__restrict by_h = lengths.data(), *__restrict by_t = shifts.data();
    int i = 0;
    for (int k = 0; k < segments; k++) {
        const int parts = steps[k % 2];
        const double h = line.times[k + 1] - line.times[k];
        for (int part = 0; part < parts; part++, i++) {
            const Place at(line, k, part, parts);
            const double x = at.x, y_share = 1 - x;
            const double s = x * x * (3 - 2 * x), rise = x * (x * x) - 0.5 * ((x * x) * (x * x));
            const double* __restrict longer = by_dt[i];
#pragma omp simd
            for (int r = 0; r < results; r++) by_h[r] = longer[r] / parts, by_t[r] = 0;
            for (int c = 0; c < 3; c++) {
                const double u = line.knots[k][c], d = line.knots[k + 1][c] - u, gap = gaps[c];
                const double way = u * x + d * rise;
                const double* __restrict twist = &by_twist(c, i, 0);
                double* __restrict from = by.knot[3 * k + c];
                double* __restrict to = by.knot[3 * (k + 1) + c];
                double* __restrict end = by.corner[3 * segments + c];
                if (c < posed) {
                    const double* __restrict pose = &by_pose(c, i, 0);
                    double* __restrict corner = by.corner[3 * k + c];
#pragma omp simd
                    for (int r = 0; r < results; r++) {
                        const double g = twist[r], q = pose[r];
                        from[r] += g * (1 - s) + q * h * (x - rise);
                        to[r] += g * s + q * h * rise;
                        by_h[r] += q * way;
                        by_t[r] -= gap * (q * at.rate + g * at.accel);
                        corner[r] += q;
                        end[r] -= q * at.bump + g * at.rate;
                    }
                } else {
#pragma omp simd
                    for (int r = 0; r < results; r++) {
                        const double g = twist[r];
                        from[r] += g * (1 - s);
                        to[r] += g * s;
                        by_t[r] -= gap * (g * at.accel);
                        end[r] -= g * at.rate;
                    }
                }
            }
            double *__restrict time = by.time[k], *__restrict next_time = by.time[k + 1];
#pragma omp simd
            for (int r = 0; r < results; r++) {
                time[r] += by_t[r] * y_share - by_h[r];
                next_time[r] += by_t[r] * x + by_h[r];
            }
        }
    }
    corners_back(line, by);
    return by;
}

// Returns the derivatives of the three components of the gap with respect to the knots.
inline ByKnots gap_back(const Line& line) {
    ByKnots by(line, 3);
    for (int c = 0; c < 3; c++) by.corner[3 * line.segments() + c][c] = 1;
    corners_back(line, by);
    return by;
}

// Derivatives of R results with respect to the relative durations, as `hold` (J + 1, R), and with
// respect to the twists, as `twist` (3 J, R).
struct ByRotations {
    Matrix hold, twist;
};

// Converts derivatives with respect to the knots of `timeline` to derivatives with respect to the
// relative durations `holds` (J + 1,) and the twists (J, 3).
PLATE_WIDE inline ByRotations timeline_back(const std::vector<double>& holds, const Ramps& ramp,
                                            double period, const ByKnots& by) {
    const int results = by.results(), count = static_cast<int>(holds.size()) - 1;
    const double total = sum(holds), scale = (period - sum(ramp.length)) / total;
    ByRotations found{Matrix(count + 1, results), Matrix(3 * count, results)};
    Matrix by_ramp(count + 1, results), sums(2, results);
    // `after` contains the derivatives with respect to the duration of segment k. A longer segment
    // shifts all later knots.
    double *__restrict after = sums[0], *__restrict shared = sums[1];
    for (int k = 2 * count + 1; k >= 0; k--) {
        const double* __restrict time = by.time[k + 1];
        double* __restrict of = k % 2 ? found.hold[k / 2] : by_ramp[k / 2];
        const double share = holds[k / 2] / total;
        if (k % 2) {
#pragma omp simd
            for (int r = 0; r < results; r++) {
                after[r] += time[r];
                of[r] = scale * after[r];
                shared[r] += share * after[r];
            }
        } else {
#pragma omp simd
            for (int r = 0; r < results; r++) of[r] = after[r] += time[r];
        }
    }
    for (int j = 0; j <= count; j++) {
        double* __restrict hold = found.hold[j];
        const double* __restrict longer = by_ramp[j];
#pragma omp simd
        for (int r = 0; r < results; r++) hold[r] -= scale * shared[r];
        for (int c = 0; c < 3; c++) {
            const double slope = ramp.slope[j][c];
            if (j < count) {
                const double *__restrict begin = by.knot[3 * (2 * j + 1) + c];
                const double *__restrict end = by.knot[3 * (2 * j + 2) + c];
                double* __restrict twist = found.twist[3 * j + c];
#pragma omp simd
                for (int r = 0; r < results; r++)
                    twist[r] += (longer[r] - shared[r]) * slope + begin[r] + end[r];
            }
            if (j > 0) {
                double* __restrict twist = found.twist[3 * (j - 1) + c];
#pragma omp simd
                for (int r = 0; r < results; r++) twist[r] -= (longer[r] - shared[r]) * slope;
            }
        }
    }
    return found;
}

}  // namespace plate::rotations
