// All parts through cycles of the plate: friction, then contacts, step by step. See bodies.py.
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

#include "contacts/resolve.hpp"
#include "friction/step.hpp"
#include "plate/ground.hpp"
#include "plate/course.hpp"

namespace plate {

// What is needed of the footprints of parts: `Shapes` of bodies.py.
struct Shapes {
    std::span<const Body> bodies;
    View<const double, 2> mesh;
    std::span<const contacts::Convex> pieces;
    contacts::Corners corners;
};

// What one plate's parts are to do: as bodies.py says, states (M, 6), mu g (M,) and `here` (M,) in
// their own order, as are records (k, M, 6).
struct Job {
    const double *times, *factors;  // of `Course`
    int legs, steps, cycles, every;
    GroundEffect ground;
    View<double, 2> states;
    const double* limit;
    View<bool, 1> here;
    View<double, 3> record;
};

// More than what rounding makes of 1 in a few sums and products.
constexpr double ROUNDED = 1 + 1e-12;

// Where parts are [m], and how far they have moved from marks [m].
struct Extent {
    contacts::Bounds at, moved;
};

// Of all for which `away` (P,) is 0; it is infinite for the others.
PLATE_WIDE inline Extent extent(const View<double, 2>& state, int lanes, const double* mark_x,
                                const double* mark_y, const double* away) {
    double low[4][LANES], high[4][LANES];
    std::fill_n(low[0], 4 * LANES, contacts::INFINITE);
    std::fill_n(high[0], 4 * LANES, -contacts::INFINITE);
    const double *x = state[X], *y = state[Y];
    for (int first = 0; first < lanes; first += LANES)
        for (int k = 0; k < LANES; k++) {
            const int i = first + k;
            const double at[] = {x[i], y[i], x[i] - mark_x[i], y[i] - mark_y[i]};
            for (int row = 0; row < 4; row++) {
                low[row][k] = std::min(low[row][k], at[row] + away[i]);
                high[row][k] = std::max(high[row][k], at[row] - away[i]);
            }
        }
    for (int k = 1; k < LANES; k++)
        for (int row = 0; row < 4; row++) {
            low[row][0] = std::min(low[row][0], low[row][k]);
            high[row][0] = std::max(high[row][0], high[row][k]);
        }
    return {{low[0][0], high[0][0], low[1][0], high[1][0]},
            {low[2][0], high[2][0], low[3][0], high[3][0]}};
}

// Whether all within bounds is on a plate, and not on its edge but for rounding.
inline bool inside(const contacts::Bounds& at, const PlateSample& plate, const double* half) {
    const double x = std::max(std::abs(at.low_x - plate.x), std::abs(at.high_x - plate.x));
    const double y = std::max(std::abs(at.low_y - plate.y), std::abs(at.high_y - plate.y));
    const double turn = std::abs(plate.theta);  // its sine is no more, its cosine no more than 1
    return ROUNDED * (x + turn * y) <= half[0] && ROUNDED * (y + turn * x) <= half[1];
}

// Take parts whose centre is beyond the plate's edge away; return whether there were any.
inline bool drop(View<double, 2> state, View<bool, 1> here, const PlateSample& plate,
                 const double* half, double* away, double* least) {
    const double c = std::cos(plate.theta), s = std::sin(plate.theta);
    bool any = false;
    for (int i = 0; i < here.size(0); i++) {
        const double rx = state(X, i) - plate.x, ry = state(Y, i) - plate.y;
        const bool beyond =
            std::abs(c * rx + s * ry) > half[0] || std::abs(c * ry - s * rx) > half[1];
        if (here(i) && beyond) {
            here(i) = false;
            state(VX, i) = state(VY, i) = state(SPIN, i) = 0.0;
            away[i] = least[i] = contacts::INFINITE;
            any = true;
        }
    }
    return any;
}

// Advance parts through cycles of the plate, in place, as bodies.py says; return what overlaps most
// at the start: if by a greater share than `allowed` nothing has moved.
inline contacts::Overlap run(const Job& job, const Shapes& shapes, const contacts::Rules& rules,
                             double allowed, const double* half) {
    const int count = job.states.size(0);
    const int lanes = (count + LANES - 1) / LANES * LANES, columns = (count / LANES + 1) * LANES;
    const Course course(job.times, job.factors, job.legs);
    const double step = course.period() / job.steps;
    const std::vector<PlateSample> plate = samples(course, 2 * job.steps);
    std::vector<int> order(count);  // by place: results do not depend on the order of names
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int i, int j) {
        return std::pair(job.states(i, X), job.states(i, Y)) <
               std::pair(job.states(j, X), job.states(j, Y));
    });
    // Columns of parts, of none, and the last one of the walls
    AlignedNumbers numbers(6 * columns + (GLIDER + 2) * lanes);
    const View<double, 2> state{numbers.data(), {6, columns}}, gliders{state[6], {GLIDER, lanes}};
    double *done = gliders[GLIDER], *away = done + lanes;
    const auto kept = std::make_unique<bool[]>(count);
    const View<bool, 1> here{kept.get(), {count}};
    std::vector<Body> bodies(columns, Body{0, 1});
    std::fill_n(away, lanes, contacts::INFINITE);
    bool together = false;
    for (int i = 0; i < count; i++) {
        for (int row = 0; row < 6; row++) state(row, i) = job.states(order[i], row);
        bodies[i] = shapes.bodies[order[i]], bodies[i].mu_g = job.limit[order[i]];
        here(i) = job.here(order[i]);
        if (here(i)) away[i] = 0;
    }
    for (int i = 0; i < lanes; i++)
        together |= set_glider(gliders, i, bodies[i], step, away[i] == 0);
    together &= job.ground.slope == 0;
    const View<const double, 2> discs{gliders.data, gliders.shape};
    const int points = shapes.mesh.size(1);
    std::vector<double> forces(7 * points);
    std::copy_n(shapes.mesh.data, 4 * points, forces.data());
    const Mesh mesh{forces.data(), {7, points}};
    const View<const bool, 1> there{here.data, here.shape};
    contacts::NearPairs near(columns);
    contacts::Contacts contacts{state, bodies, there, {shapes.pieces, shapes.corners}, rules, step,
                                half};
    contacts::Overlap start;
    if (rules.meets) {
        near.find(state, bodies, there);
        start = contacts::deepest_overlap(state, bodies, contacts.outlines, near.pairs);
        if (start.first >= 0) start.first = order[start.first], start.second = order[start.second];
        if (start.share > allowed) return start;
    }
    const auto note = [&](double* record) {
        for (int i = 0; i < count; i++)
            for (int row = 0; row < 6; row++) record[6 * order[i] + row] = state(row, i);
    };
    int recorded = 0;
    for (int cycle = 0; cycle < job.cycles; cycle++) {
        for (int at = 0; at < job.steps; at++) {
            const PlateSample* now = &plate[2 * at];
            if (job.record.size(0) && (std::int64_t{cycle} * job.steps + at) % job.every == 0)
                note(job.record[recorded++]);
            const int moved =
                together ? glide(now, step, job.ground, state, discs, done) : 0;
            for (int i = 0; i < count && moved < count; i++)
                if (done[i] == 0 && here(i))
                    advance(course, at * step, step, now, job.ground, state, i, bodies[i], mesh);
            const Extent parts = extent(state, lanes, near.mark_x.data(), near.mark_y.data(), away);
            bool pushed = false;
            if (rules.meets) {
                double drift = near.approach(parts.moved);
                if (drift >= near.skin) {
                    near.find(state, bodies, there);
                    drift = 0.0;
                }
                const std::span pairs(near.pairs.data(), drift >= near.gap ? near.pairs.size() : 0);
                pushed = !pairs.empty() || rules.walls;
                if (pushed) contacts.resolve(pairs, now[2]);
            }
            if (!rules.walls && (pushed || !inside(parts.at, now[2], half)) &&
                drop(state, here, now[2], half, away, gliders[LEAST]) && rules.meets)
                near.find(state, bodies, there);
        }
    }
    if (job.record.size(0)) note(job.record[job.record.size(0) - 1]);
    note(job.states.data);
    for (int i = 0; i < count; i++) job.here(order[i]) = here(i);
    return start;
}

}  // namespace plate
