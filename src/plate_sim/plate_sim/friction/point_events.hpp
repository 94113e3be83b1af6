// C++ kernels of point_events.py: an event-driven simulation of parts that are modelled as points,
// with a given accuracy. The plate's motion is exact. This simulation is the reference for all
// other integrators.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "friction/runge_kutta.hpp"
#include "plate/pieces.hpp"

namespace plate::sliding {

// Allowed error of one step, as a fraction of the tolerance for a cycle. The errors of the steps
// add up, but each error decays during the following steps. Therefore the error of a cycle is about
// the tolerance.
constexpr double STEP_FRACTION = 0.05;
// A slow part is stopped if its remaining sliding distance is at most this fraction of the allowed
// error of a step.
constexpr double SNAP_FRACTION = 0.1;
// Determines which slip counts as zero (see `zero_slip`). While a slip that counts as zero
// vanishes, friction changes the part's velocity by at most ZERO_FRACTION e / T. Here, e is the
// allowed error of a step, and T is the period.
constexpr double ZERO_FRACTION = 0.2;
// A part with zero slip sticks only if friction can still hold it a short time later. AHEAD is this
// time as a fraction of the period.
constexpr double AHEAD = 1e-8;
// Minimum step, as a fraction of the period. The rounding error of the time is 1e-16 of the period.
constexpr double FLOOR = 1e-13;
// Maximum mean number of steps per cycle. If a motion needs more steps, the remainder of the motion
// is computed with coarse steps, without error control.
constexpr std::int64_t BUDGET = 50'000;
// Number of equal steps per cycle for the remainder of a motion that exceeds `BUDGET`.
constexpr int COARSE = 2000;
// Tolerance of the slip at an event, and of the slip perpendicular to a line of motion, as a
// fraction of a slip that counts as zero.
constexpr double FINE = 1e-3;
// Minimum friction [m/s2]. Smaller friction is neglected, because its direction would be a rounding
// error.
constexpr double MIN_LIMIT = 1e-60;
// Minimum number of intervals per piece of the motion in the search for the time at which a stuck
// part begins to slide.
constexpr int SCAN = 3;
// Minimum number of intervals per period in the search for the time at which a stuck part begins to
// slide.
constexpr int INTERVALS = 100;

// Typical magnitudes of a part's motion:
// - limit: friction acceleration mu g [m/s2]
// - period [s]
// - accel: approximate maximum acceleration of the plate's surface under the part [m/s2]
// - rate: maximum rate of change of this acceleration divided by `accel` [1/s]
struct Bounds {
    double limit, period, accel, rate;
};

// State of a sliding part at the start of a step:
// - slip, surface_accel: magnitudes of its slip [m/s] and of the surface's acceleration [m/s2]
// - power: scalar product of the surface's acceleration and the friction acceleration [m2/s4]
// - allowed: allowed error of the position [m]
// - on_line: whether the surface accelerates along one line only, and the slip is parallel to it
// - coarse: whether the maximum number of steps is exceeded
struct SlidingState {
    double slip, surface_accel, power, allowed;
    bool on_line, coarse;
};

// Times of the output samples: interval between samples [s], number of samples per cycle, and
// number of completed cycles. `gravity` is the component of gravity along a tilted plate [m/s2].
// The integration uses a frame that falls with this acceleration.
struct Grid {
    double step;
    int per_cycle, done;
    Vec gravity;

    // Time of sample j since the start of the current cycle [s].
    double time(int j) const { return (j - done * per_cycle) * step; }
};

// Output samples of one part: positions [m] and velocities [m/s]. Each sample consists of two
// numbers, and consecutive samples are `row` numbers apart. The first sample is an input.
struct Track {
    double *path, *speed;
    int count, row;

    Point at(int j) const {
        const double *p = path + j * row, *v = speed + j * row;
        return {{p[0], p[1]}, {v[0], v[1]}};
    }
    void put(int j, const Point& part) const {
        double *p = path + j * row, *v = speed + j * row;
        p[0] = part.position.x, p[1] = part.position.y, v[0] = part.velocity.x,
        v[1] = part.velocity.y;
    }
};

// Convert the state of a part from the falling frame to plate_home. The argument t [s] is the time
// since the start of the fall.
inline Point to_plate_home(const Point& part, double t, Vec gravity) {
    return {part.position + 0.5 * t * t * gravity, part.velocity + t * gravity};
}

// Return the largest slip [m/s] that counts as zero. The argument a is the acceleration of the
// surface. A slip r vanishes after about r/max(a, limit). For the returned slip, friction changes
// the velocity in this time by at most ZERO_FRACTION allowed / period. The result is also at most the
// velocity change by friction in a period.
inline double zero_slip(double limit, double a, double allowed, double period) {
    return std::min(ZERO_FRACTION * allowed / period * std::max(1.0, a / limit), limit * period);
}

// Whether a slip r [m/s] counts as zero if the surface has the acceleration a [m/s2]. One of two
// conditions must be true: the stopping distance r^2/(2 (limit - a)) is at most `SNAP_FRACTION` of the
// allowed error, or the slip is at most `zero_slip`.
inline bool counts_as_zero(double r, double limit, double a, double allowed, double period) {
    return r * r <= 2 * SNAP_FRACTION * allowed * (limit - a) ||
           r <= zero_slip(limit, a, allowed, period);
}

// Return the squared acceleration [m2/s4] of the plate's point q [m, plate frame].
inline double squared_accel(Table table, double t, int k, Vec q) {
    const Vec accel = stuck_part(table, t, k, q).accel;
    return dot(accel, accel);
}

// Whether friction of at most `limit` [m/s2] can hold a part at q [m, plate frame].
inline bool holds(Table table, double t, int k, Vec q, double limit) {
    return squared_accel(table, t, k, q) <= limit * limit;
}

// Return the step h [s], limited to `room` [s] and to the end of the present piece of the motion. A
// step that is longer than two pieces may pass the end of the piece.
inline double to_knot(Table table, double t, int k, double h, double room) {
    h = std::min(h, room);
    const double minimum = FLOOR * table.back().end;
    if (table[k].end - t <= minimum && k + 1 < static_cast<int>(table.size())) k++;
    const double gap = table[k].end - t;
    return gap > minimum && gap < h && h < 2 * (table[k].end - table[k].start) ? gap : h;
}

// Whether the slip may nearly vanish within a step, although it does not reverse at any stage of
// the step. The magnitude of the slip is approximated by a cubic. The cubic has the correct values
// and rates at both ends of the step.
inline bool may_stop(Table table, double t, int k, double h, const Step& result,
                     const SlidingState& now, const Bounds& bounds) {
    const double r = now.slip, limit = bounds.limit;
    const double down = h * (now.power / limit - limit);
    if (down >= 0) return false;
    const Vec w = slip(table, t + h, k, result.end), a = surface_rate(table, t + h, k, result.end);
    const double r_end = std::sqrt(dot(w, w)), up = h * (dot(result.force, a) / limit - limit);
    if (up <= 0) return false;
    // The cubic is r + down s + b s^2 + c s^3, with s from 0 to 1 during the step.
    const double b = 3 * (r_end - r) - 2 * down - up, c = 2 * (r - r_end) + down + up;
    const double root = std::sqrt(std::max(0.0, b * b - 3 * c * down));
    const double s = b + root > 0 ? -down / (b + root) : 0.5;
    const double minimum = r + s * (down + s * (b + s * c)), turn = bounds.rate * h;
    // The error of the cubic (Hermite interpolation) is at most h^4/384 times the fourth derivative
    // of the slip. The fourth derivative is about accel rate^3. The factor 0.01 is about four times
    // 1/384, as a safety margin.
    return minimum < 0.01 * bounds.accel * h * (turn * (turn * turn));
}

// A completed step: length [s], state and friction at its end, and recommended length of the next
// step, `hint` [s].
struct SlideStep {
    double h;
    Point end;
    Vec force;
    double hint;
};

// Compute one step of a sliding part. The length of the step is at most h [s]. If the slip vanishes
// during the step, the step ends at this time.
inline SlideStep slide(Table table, double t, int k, double h, double hint, const Point& part,
                       Vec force, const SlidingState& now, const Bounds& bounds) {
    const double limit = bounds.limit, period = bounds.period, first = h;
    const double zero = zero_slip(limit, now.surface_accel, now.allowed, period);
    while (true) {
        const Step result = now.on_line ? line_step(table, t, k, h, part, force)
                                        : runge_kutta(table, t, k, h, part, force, limit);
        const bool forced = h <= FLOOR * period || now.coarse;
        if (result.reversal > 0) {
            const auto [tau, rest, error] = landing(table, t, k, result.reversal * h, part, force,
                                                    now.slip, limit, FINE * zero);
            const bool fits = tau > 0 && period * error <= now.allowed && rest <= zero;
            if (fits || forced) {
                if (fits && !now.coarse) h = tau;
                return {h, with_constant_friction(part, force, h), force, hint};
            }
            h = hint = tau > 0 ? 0.7 * tau : 0.4 * result.reversal * h;
            continue;
        }
        const double error = result.position_error + period * result.velocity_error;
        if (error > now.allowed && !forced) {
            h = hint = h * std::max(0.2, 0.9 * std::pow(now.allowed / error, 0.2));
            continue;
        }
        if (!forced && may_stop(table, t, k, h, result, now, bounds)) {
            h = hint = 0.5 * h;
            continue;
        }
        // The error of a step is proportional to h^5. The next step is at most 6 times longer,
        // because the error is near 0 for a straight motion. An error near 0 gives no information
        // about longer steps.
        const double growth =
            error * 4000 < now.allowed ? 6 : 0.9 * std::pow(now.allowed / error, 0.2);
        const bool unchanged = h == first && first == hint;
        return {h, result.end, result.force,
                unchanged || growth < 1 ? h * growth : std::max(hint, h * growth)};
    }
}

// Search for a time [s] after `low`, up to `high`, at which friction cannot hold a sticking part.
// Return this time, or -1 if no checked time meets this condition.
//
// Three times are checked: the middle of the interval, the peak of a parabola, and the end of the
// interval. The parabola passes through the squared accelerations at the start, in the middle and
// at the end.
inline double first_release(Table table, double low, double high, int k, Vec q, double limit) {
    const double middle = 0.5 * (low + high), maximum = limit * limit;
    const double a = squared_accel(table, low, k, q), b = squared_accel(table, middle, k, q);
    const double c = squared_accel(table, high, k, q);
    if (b > maximum) return middle;
    const double bend = a - 2 * b + c;
    if (bend < 0 && std::abs(a - c) < -2 * bend) {
        const double peak = middle + 0.25 * (high - low) * (a - c) / bend;
        if (squared_accel(table, peak, k, q) > maximum) return peak;
    }
    return c > maximum ? high : -1;
}

// Return the time [s] until which friction holds a part at q [m, plate frame]. The result is at
// most the period.
inline double release(Table table, double t, int k, Vec q, double limit) {
    const double period = table.back().end, radius = std::sqrt(dot(q, q));
    for (int piece = k; piece < static_cast<int>(table.size()); piece++) {
        const double end = table[piece].end;
        double low = std::max(t, table[piece].start);
        if (low >= end || ride_bound(table[piece], radius) <= limit) continue;
        const double width = std::min((end - table[piece].start) / SCAN, period / INTERVALS);
        while (low < end) {
            const double high = std::min(low + width, end);
            double free = first_release(table, low, high, piece, q, limit);
            if (free < 0) {
                low = high;
                continue;
            }
            while (free - low > 1e-15 * period) {
                const double middle = 0.5 * (low + free);
                if (!(low < middle && middle < free)) break;
                if (holds(table, middle, piece, q, limit))
                    low = middle;
                else
                    free = middle;
            }
            return low;
        }
    }
    return period;
}

// Write the output samples of a part that sticks at q, from sample j up to the time `until` [s].
// Return the index of the next sample.
inline int emit_stuck(Table table, double until, int k, Vec q, const Grid& grid, int j,
                      const Track& track) {
    for (; j < track.count - 1; j++) {
        const double time = grid.time(j);
        if (time > until) break;
        track.put(j, to_plate_home(stuck_part(table, time, k, q).part, time, grid.gravity));
    }
    return j;
}

// Write the output samples during a sliding step. A quintic polynomial interpolates position,
// velocity and acceleration of both ends of the step. Return the index of the next sample.
inline int emit(double t, double h, const Point& start, Vec before, const Point& end, Vec after,
                const Grid& grid, int j, const Track& track) {
    if (j >= track.count - 1 || grid.time(j) > t + h) return j;
    const Vec p = start.position, v = start.velocity;
    const double hh = h * h;
    const Vec d = end.position - p - h * v - 0.5 * hh * before;
    const Vec s = h * (end.velocity - v - h * before), b = hh * (after - before);
    const Vec x3 = 10 * d - 4 * s + 0.5 * b, x4 = -15 * d + 7 * s - b, x5 = 6 * d - 3 * s + 0.5 * b;
    for (; j < track.count - 1; j++) {
        const double tau = grid.time(j) - t;
        if (tau > h) break;
        const double u = tau / h, cube = u * u / h;
        const Vec position =
            p + tau * (v + 0.5 * tau * before) + u * u * u * (x3 + u * (x4 + u * x5));
        const Vec velocity = v + tau * before + cube * (3 * x3 + u * (4 * x4 + u * 5 * x5));
        track.put(j, to_plate_home({position, velocity}, t + tau, grid.gravity));
    }
    return j;
}

// Compute the output samples of a part from its first sample. Return the number of steps.
//
// `limit` and `static_limit` are the maximum accelerations by dynamic and by static friction
// [m/s2]. `tolerance` is the allowed error of the displacement in one cycle [m].
inline std::int64_t run_part(Table table, const Scales& scales, double limit, double static_limit,
                             double tolerance, int cycles, const Track& track) {
    const double period = table.back().end;
    const bool periodic = table[0].periodic != 0;
    const int count = (track.count - 1) / cycles;
    Point part = track.at(0);
    // `accel` is the approximate maximum acceleration of the surface under the part [m/s2]. `rate`
    // is the maximum rate of change of this acceleration divided by `accel` [1/s].
    const double arm = std::sqrt(dot(part.position, part.position));
    const double accel = scales.accel + arm * scales.spin_accel;
    const double jerk = scales.jerk + arm * scales.spin_jerk, rate = accel > 0 ? jerk / accel : 0;
    const Bounds bounds{limit, period, accel, rate};
    const double max_step =
        rate * period < 0.5 ? period
                            : std::max(1 / rate, period / std::max<double>(COARSE, table.size()));
    bool stuck = false;
    int done = 0, k = 0, j = 1;
    std::int64_t steps = 0;
    double t = 0, hint = 0.25 * max_step;
    Vec q{0, 0}, w = slip(table, t, k, part), rate_under = surface_rate(table, t, k, part);
    while (done < cycles) {
        steps++;
        const Grid grid{period / count, count, done, scales.gravity};
        const double left = period - t, r = std::sqrt(dot(w, w));
        const double a = std::sqrt(dot(rate_under, rate_under));
        const bool stops_at_period = done == cycles - 1 || !periodic;
        const double room = stops_at_period ? left : period;
        // The allowed error of a step cannot be smaller than the rounding errors of the state.
        const double size = std::abs(part.position.x) + std::abs(part.position.y) +
                            period * (std::abs(part.velocity.x) + std::abs(part.velocity.y));
        const double allowed = std::max(STEP_FRACTION * tolerance, 1e-15 * size);
        const bool coarse = steps > BUDGET * cycles;
        double h = 0;
        Point end = part;
        Vec before{0, 0}, after{0, 0};
        if (!stuck && !coarse && counts_as_zero(r, limit, a, allowed, period)) {
            q = to_plate_frame(table, t, k, part.position);
            stuck = holds(table, t + AHEAD * period, k, q, static_limit);
            if (!stuck) {
                const Restart result = restart(table, t, k, std::min(0.5 * max_step, room), part,
                                               limit, allowed / period);
                h = hint = result.tau, end = result.end, before = result.before,
                after = result.after;
                stuck = h == 0;
            }
        } else if (!stuck) {
            if (r > 0) before = {limit * w.x / r, limit * w.y / r};
            const Vec line = scales.line;
            const bool on_line = std::abs(w.x * line.y - w.y * line.x) <=
                                     FINE * zero_slip(limit, a, allowed, period) &&
                                 (line.x != 0 || line.y != 0);
            if (on_line) {
                before = (dot(w, line) > 0 ? limit : -limit) * line;
                hint = max_step;
            }
            hint = coarse ? period / COARSE : std::min(hint, max_step);
            const double first = on_line ? std::min(hint, room) : to_knot(table, t, k, hint, room);
            const SlidingState now{r, a, dot(before, rate_under), allowed, on_line, coarse};
            const SlideStep result = slide(table, t, k, first, hint, part, before, now, bounds);
            h = result.h, end = result.end, after = result.force, hint = result.hint;
        }
        if (stuck) {
            const double until = release(table, t + AHEAD * period, k, q, static_limit);
            j = emit_stuck(table, until, k, q, grid, j, track);
            h = until - t;
            end = stuck_part(table, until, k, q).part;
            stuck = until >= period;
            hint = 0.1 * max_step;
        } else {
            j = emit(t, h, part, before, end, after, grid, j, track);
        }
        part = end;
        t += h;
        if (t >= period || (h >= left && stops_at_period)) {
            t = std::max(0.0, t - period);
            done++;
            k = 0;
            if (!periodic) {  // convert the state from the falling frame to plate_home
                const Point fallen =
                    with_constant_friction({part.position, {0, 0}}, scales.gravity, period);
                part = {fallen.position, end.velocity + fallen.velocity};
            }
        }
        w = slip(table, t, k, part);
        rate_under = surface_rate(table, t, k, part);
    }
    track.put(track.count - 1, part);
    return steps;
}

// Compute positions `path` (rows, M, 2) and velocities `speed` (rows, M, 2) of M parts from their
// first rows. Return the total number of steps.
//
// `limit` (M,) is mu g of each part [m/s2]. `static_ratio` is the ratio of static to dynamic
// friction. `checked` (M,) becomes false for each part whose motion needed more than the maximum
// number of steps.
inline std::int64_t run_points(Table table, const Scales& scales, const double* limit,
                               double static_ratio, double tolerance, int cycles, double* path,
                               double* speed, int rows, int count, bool* checked) {
    std::int64_t steps = 0;
    for (int i = 0; i < count; i++) {
        const Track track{path + 2 * i, speed + 2 * i, rows, 2 * count};
        checked[i] = true;
        if (limit[i] <= MIN_LIMIT) {
            const double dt = cycles * table.back().end / (rows - 1);
            const auto [position, velocity] = track.at(0);
            for (int j = 1; j < rows; j++)
                track.put(j, to_plate_home({position + j * dt * velocity, velocity}, j * dt,
                                           scales.gravity));
        } else {
            const std::int64_t result = run_part(table, scales, limit[i], static_ratio * limit[i],
                                                 tolerance, cycles, track);
            checked[i] = result <= BUDGET * cycles;
            steps += result;
        }
    }
    return steps;
}

}  // namespace plate::sliding
