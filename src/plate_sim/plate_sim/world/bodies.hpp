// All parts through cycles of the plate: friction, then contacts, step by step. See bodies.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include <plate/view.hpp>

#include "contacts/resolve.hpp"
#include "friction/step.hpp"
#include "plate/ground.hpp"
#include "plate/pieces.hpp"

namespace plate {

// What is needed of the footprints of parts: `Shapes` of bodies.py.
struct Shapes {
    std::span<const Body> bodies;
    View<const double, 2> discs;
    Mesh mesh;
    std::span<const contacts::Convex> pieces;
    contacts::Corners corners;
};

// Take parts whose centre is beyond the plate's edge away; return whether there were any.
inline bool drop(View<double, 2> state, View<bool, 1> here, double* glides,
                 const PlateSample& plate, const double* half) {
    const double c = std::cos(plate.theta), s = std::sin(plate.theta);
    bool any = false;
    for (int i = 0; i < here.size(0); i++) {
        const double rx = state(X, i) - plate.x, ry = state(Y, i) - plate.y;
        const bool beyond =
            std::abs(c * rx + s * ry) > half[0] || std::abs(c * ry - s * rx) > half[1];
        if (here(i) && beyond) {
            here(i) = false;
            state(VX, i) = state(VY, i) = state(SPIN, i) = glides[i] = 0.0;
            any = true;
        }
    }
    return any;
}

// Set a record (M, 6) to the states of parts.
inline void note(View<double, 2> state, int count, double* record) {
    for (int i = 0; i < count; i++)
        for (int row = 0; row < 6; row++) *record++ = state(row, i);
}

// Advance parts through cycles of the plate, in place, as bodies.py says; return what overlaps most
// at the start: if by a greater share than `allowed` nothing has moved.
inline contacts::Overlap run(Table table, int steps, int cycles, int every,
                             const GroundEffect& ground, View<double, 2> state,
                             const Shapes& shapes, const contacts::Rules& rules,
                             double allowed, const double* half, View<bool, 1> here,
                             View<double, 3> record) {
    const int count = here.size(0), lanes = shapes.discs.size(1);
    const double step = table.back().end / steps;
    const std::vector<PlateSample> plate = samples(table, 2 * steps);
    std::vector<double> rows(shapes.discs.data, shapes.discs.data + 4 * lanes), moved(lanes);
    const View<double, 2> discs{rows.data(), {4, lanes}};
    const View<double, 1> done{moved.data(), {lanes}};
    bool together = false;
    for (int i = 0; i < count; i++) {
        discs(3, i) *= here(i);
        together |= discs(3, i) != 0;
    }
    const View<const bool, 1> there{here.data, here.shape};
    contacts::NearPairs near;
    contacts::Contacts contacts{state, shapes.bodies, there, {shapes.pieces, shapes.corners}, rules,
                                step, half};
    contacts::Overlap start;
    if (rules.meets) {
        near.find(state, shapes.bodies, there);
        start = contacts::deepest_overlap(state, shapes.bodies, contacts.outlines, near.pairs);
        if (start.share > allowed) return start;
    }
    int recorded = 0;
    for (int cycle = 0; cycle < cycles; cycle++) {
        for (int at = 0; at < steps; at++) {
            const PlateSample* now = &plate[2 * at];
            if (record.size(0) && (std::int64_t{cycle} * steps + at) % every == 0)
                note(state, count, record[recorded++]);
            std::fill(moved.begin(), moved.end(), 0.0);
            if (together && ground.slope == 0)
                glide(now, step, ground, state, {discs.data, discs.shape}, done);
            for (int i = 0; i < count; i++)
                if (done(i) == 0 && here(i))
                    advance(table, at * step, step, now, ground, state, i, shapes.bodies[i],
                            shapes.mesh);
            if (rules.meets) {
                double drift = near.approach(state, there);
                if (drift >= near.skin) {
                    near.find(state, shapes.bodies, there);
                    drift = 0.0;
                }
                const std::span pairs(near.pairs.data(), drift >= near.gap ? near.pairs.size() : 0);
                if (!pairs.empty() || rules.walls) contacts.resolve(pairs, now[2]);
            }
            if (!rules.walls && drop(state, here, discs[3], now[2], half) && rules.meets)
                near.find(state, shapes.bodies, there);
        }
    }
    if (record.size(0)) note(state, count, record[record.size(0) - 1]);
    return start;
}

}  // namespace plate
