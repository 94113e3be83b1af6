// C++ kernels of bodies.py: simulation of all parts during cycles of the plate. Each time step
// computes friction, then contacts.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include <plate/view.hpp>
#include <plate/wide.hpp>

#include "contacts/resolve.hpp"
#include "friction/glide.hpp"
#include "plate/course.hpp"
#include "plate/ground.hpp"

namespace plate {

// Footprints and outlines of the parts. `Shapes` in bodies.py describes the fields.
struct Shapes {
    std::span<const Body> bodies;
    View<const double, 2> mesh;
    std::span<const contacts::Convex> pieces;
    contacts::Corners corners;
};

// Inputs and outputs of the simulation of one plate. `run_plates` in bodies.py describes the
// arrays, which have an additional first axis there. The shapes here are `states` (M, 6), `limit`
// (M,), `on_plate` (M,) and `record` (k, M, 6). The parts are in the caller's order.
struct Job {
    const double *times, *factors;  // arguments of `Course`
    int pieces, steps, cycles, every;
    GroundEffect ground;
    View<double, 2> states;
    const double* limit;
    View<bool, 1> on_plate;
    View<double, 3> record;
};

// Factor slightly above 1. The difference from 1 is larger than the rounding errors of a few sums
// and products.
constexpr double ROUNDED = 1 + 1e-12;

// Maximum number of time steps between two checks of the parts' positions.
constexpr int UNCHECKED = 16;

// GlideLimits to the motion of parts that are advanced by `glide` only.
struct GlideLimits {
    double gap;           // distance by which two parts may approach each other [m]
    const double* half;   // half sides of the plate (2,) [m]
    const double* reach;  // see `Course`
    double max_dv;        // maximum change of a part's velocity along an axis in a step [m/s]
};

// Minimum and maximum of four values over all parts on the plate. The values are x and y of the
// part, and its displacements along x and y from its reference position [m]. The reference
// is the part's position when the list of near pairs was made.
struct Extent {
    double low[4], high[4];
    double speed = 0;  // maximum velocity component of a part [m/s]

    [[gnu::always_inline]] explicit Extent(std::span<const Group> groups) {
        double lows[4][LANES], highs[4][LANES];
        std::fill_n(lows[0], 4 * LANES, contacts::INFINITE);
        std::fill_n(highs[0], 4 * LANES, -contacts::INFINITE);
        double speeds[LANES] = {};
        for (const Group& g : groups) {
#pragma omp simd
            for (int i = 0; i < LANES; i++) {
                const double x = g.state[X][i], y = g.state[Y][i];
                const double values[] = {x, y, x - g.reference[X][i], y - g.reference[Y][i]};
                for (int row = 0; row < 4; row++) {
                    lows[row][i] = std::min(lows[row][i], values[row] + g.off_plate[i]);
                    highs[row][i] = std::max(highs[row][i], values[row] - g.off_plate[i]);
                }
                speeds[i] = std::max(speeds[i], std::max(std::abs(g.state[VX][i]),
                                                         std::abs(g.state[VY][i])));
            }
        }
        for (int row = 0; row < 4; row++) {
            low[row] = *std::min_element(lows[row], lows[row] + LANES);
            high[row] = *std::max_element(highs[row], highs[row] + LANES);
        }
        speed = *std::max_element(speeds, speeds + LANES);
    }

    // Returns an upper bound of the distance [m] by which any two parts have approached each other
    // since they were at their reference positions.
    double approach() const {
        if (high[2] < low[2]) return 0.0;  // there are no parts
        const double wide = high[2] - low[2], tall = high[3] - low[3];
        return std::sqrt(wide * wide + tall * tall);
    }

    // Whether all parts are inside the edges of the plate by more than rounding errors.
    bool within(const PlateSample& plate, const double* half) const {
        const double x = std::max(std::abs(low[0] - plate.x), std::abs(high[0] - plate.x));
        const double y = std::max(std::abs(low[1] - plate.y), std::abs(high[1] - plate.y));
        const double turn = std::abs(plate.theta);  // upper bound of the sine of theta
        return ROUNDED * (x + turn * y) <= half[0] && ROUNDED * (y + turn * x) <= half[1];
    }

    // Returns a number of steps after which `approach` is still below the gap, and the parts are
    // still `within` the plate. The estimate is one step too low, which covers rounding errors.
    int safe_steps(const GlideLimits& limits, double step) const {
        const double move = step * (speed + UNCHECKED * limits.max_dv), turn = limits.reach[2];
        const double x = std::max(-low[0], high[0]) + limits.reach[0];
        const double y = std::max(-low[1], high[1]) + limits.reach[1];
        // Each part moves by at most `move` along each axis in a step. Two parts approach each
        // other by at most sqrt(8) times this distance.
        const double apart = (limits.gap - approach()) / (std::sqrt(8.0) * move);
        const double margin =
            std::min(limits.half[0] - (x + turn * y), limits.half[1] - (y + turn * x));
        const double steps = std::min(apart, margin / ((1 + turn) * move));
        return steps > 1 ? static_cast<int>(std::min<double>(steps, UNCHECKED)) - 1 : 0;
    }
};

// Computes up to `maximum` time steps with `glide`. The function stops for one of three reasons:
// - `glide` cannot advance all `count` parts.
// - Two parts may have approached each other by the gap or more.
// - A part is not clearly inside the edges of the plate.
//
// The last two conditions are not checked in steps in which the parts cannot fulfil them, because
// the check takes a fifth of the time of a step.
//
// Returns the number of complete steps. If this number is below `maximum`, `glide` has already
// advanced its parts in the next step.
PLATE_WIDE inline int glide_steps(std::span<Group> groups, const PlateSample* plate, double step,
                                  const GroundEffect& ground, const GlideLimits& limits, int count,
                                  int maximum) {
    begin_glide(plate[0], groups);
    int unchecked = 0;
    for (int made = 0; made < maximum; made++, plate += 2) {
        if (glide(plate, step, ground, groups) < count) return made;
        if (unchecked-- > 0) continue;
        const Extent extent(groups);
        if (extent.approach() >= limits.gap || !extent.within(plate[2], limits.half)) return made;
        unchecked = extent.safe_steps(limits, step);
    }
    return maximum;
}

// Removes all parts whose centres are beyond an edge of the plate. Returns whether any part was
// removed.
inline bool drop(const State& state, View<bool, 1> on_plate, const PlateSample& plate,
                 const double* half) {
    const double c = std::cos(plate.theta), s = std::sin(plate.theta);
    bool any = false;
    for (int i = 0; i < on_plate.size(0); i++) {
        const double rx = state(X, i) - plate.x, ry = state(Y, i) - plate.y;
        const bool beyond =
            std::abs(c * rx + s * ry) > half[0] || std::abs(c * ry - s * rx) > half[1];
        if (on_plate(i) && beyond) {
            on_plate(i) = false;
            state(VX, i) = state(VY, i) = state(SPIN, i) = 0.0;
            Group& group = state.group(i);
            group.off_plate[State::lane(i)] = contacts::INFINITE;
            group.minimum[State::lane(i)] = std::numeric_limits<double>::quiet_NaN();
            any = true;
        }
    }
    return any;
}

// Simulates the parts during cycles of the plate, in place. bodies.py describes the method. Returns
// the deepest overlap at the start. If its relative depth exceeds `allowed`, no part is moved.
inline contacts::Overlap run(const Job& job, const Shapes& shapes, const contacts::Rules& rules,
                             double allowed, const double* half) {
    const int count = job.states.size(0);
    const Course course(job.times, job.factors, job.pieces);
    const double step = course.period() / job.steps;
    const std::vector<PlateSample> plate = samples(course, 2 * job.steps);
    // The parts are sorted by position, so that the result does not depend on the caller's order.
    std::vector<int> order(count);
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int i, int j) {
        return std::pair(job.states(i, X), job.states(i, Y)) <
               std::pair(job.states(j, X), job.states(j, Y));
    });
    std::vector<Group, Aligned<Group>> groups(count / LANES + 1);
    const State state{groups};
    std::vector<Body> bodies(state.walls() + 1, Body{0, 1});
    const auto kept = std::make_unique<bool[]>(count);
    const View<bool, 1> on_plate{kept.get(), {count}};
    bool any_glides = false;
    double max_dv = 0;
    for (int i = 0; i <= state.walls(); i++) {
        if (i < count) {
            for (int row = 0; row < 6; row++) state(row, i) = job.states(order[i], row);
            bodies[i] = shapes.bodies[order[i]], bodies[i].mu_g = job.limit[order[i]];
            on_plate(i) = job.on_plate(order[i]);
            max_dv = std::max(max_dv, bodies[i].mu_g);
        }
        any_glides |= set_constants(state, i, bodies[i], step, i < count && on_plate(i));
    }
    any_glides &= job.ground.is_constant();
    max_dv =
        step * (max_dv + std::max(std::abs(job.ground.gravity_x), std::abs(job.ground.gravity_y)));
    // `parts` contains the groups with parts. `groups` also contains the walls, which are not
    // parts.
    const std::span<Group> parts(groups.data(), (count + LANES - 1) / LANES);
    const int points = shapes.mesh.size(1);
    std::vector<double> forces(7 * points);
    std::copy_n(shapes.mesh.data, 4 * points, forces.data());
    const Mesh mesh{forces.data(), {7, points}};
    const View<const bool, 1> const_on_plate{on_plate.data, on_plate.shape};
    contacts::NearPairs near;
    contacts::Contacts contacts{
        state, bodies, const_on_plate, {shapes.pieces, shapes.corners}, rules, step, half};
    contacts::Overlap start;
    if (rules.meets) {
        near.find(state, bodies, const_on_plate);
        start = contacts::deepest_overlap(state, bodies, contacts.outlines, near.pairs);
        if (start.first >= 0) start.first = order[start.first], start.second = order[start.second];
        if (start.relative_depth > allowed) return start;
    }
    const auto record_state = [&](double* record) {
        for (int i = 0; i < count; i++)
            for (int row = 0; row < 6; row++) record[6 * order[i] + row] = state(row, i);
    };
    int recorded = 0, remaining = std::count(on_plate.data, on_plate.data + count, true);
    for (std::int64_t made = 0; made < std::int64_t{job.cycles} * job.steps;) {
        int k = made % job.steps, end = job.steps;
        if (job.record.size(0)) {
            const int since = made % job.every;
            if (since == 0) record_state(job.record[recorded++]);
            end = std::min(end, k + job.every - since);
        }
        if (any_glides) {
            // If the plate has walls, contacts are checked in every step.
            const GlideLimits limits{rules.walls ? 0 : near.gap, half, course.reach, max_dv};
            const int glided =
                glide_steps(parts, &plate[2 * k], step, job.ground, limits, remaining, end - k);
            made += glided, k += glided;
            if (k == end) continue;
        }
        const PlateSample* now = &plate[2 * k];
        for (int i = 0; i < count; i++)
            if (state.group(i).glided[State::lane(i)] == 0 && on_plate(i))
                advance(course, k * step, step, now, job.ground, state, i, bodies[i], mesh);
        const Extent extent(parts);
        bool resolved = false;
        if (rules.meets) {
            double drift = extent.approach();
            if (drift >= near.skin) {
                near.find(state, bodies, const_on_plate);
                drift = 0.0;
            }
            const std::span pairs(near.pairs.data(), drift >= near.gap ? near.pairs.size() : 0);
            resolved = !pairs.empty() || rules.walls;
            if (resolved) contacts.resolve(pairs, now[2]);
        }
        if (!rules.walls && (resolved || !extent.within(now[2], half)) &&
            drop(state, on_plate, now[2], half)) {
            remaining = std::count(on_plate.data, on_plate.data + count, true);
            if (rules.meets) near.find(state, bodies, const_on_plate);
        }
        made++;
    }
    if (job.record.size(0)) record_state(job.record[job.record.size(0) - 1]);
    record_state(job.states.data);
    for (int i = 0; i < count; i++) job.on_plate(order[i]) = on_plate(i);
    return start;
}

}  // namespace plate
