// Contacts between parts, and between parts and walls, in one time step.
//
// The inputs are the pairs of near parts from the broad phase. Each Gauss-Seidel pass applies the
// collision of each touching pair, and of each part at a wall. The passes change velocities and
// positions in place. The passes end when the maximum overlap is small enough.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "contacts/broad_phase.hpp"
#include "contacts/discs.hpp"
#include "contacts/impulses.hpp"
#include "contacts/manifold.hpp"

namespace plate::contacts {

// Maximum number of Gauss-Seidel passes over the near pairs in a time step.
constexpr int SWEEPS = 24;

// The Gauss-Seidel passes end when no overlap exceeds this depth [m], which is a hundredth of a
// pixel.
constexpr double OVERLAP = 1e-5;

// Each pass examines all pairs whose gap is below this fraction of the sum of their radii. Such
// pairs do not touch yet, but other parts may push them together.
constexpr double MARGIN = 0.03;

// Estimated maximum distance by which two parts approach each other in a pass, as a multiple of the
// deepest overlap.
constexpr double PUSHES = 4.0;

// A convex piece of a part, as a range of corners. `first` is the index of its first corner, and
// `end` is the index after its last corner.
struct Convex {
    std::int64_t first, end;
};

// Outlines of all parts except discs. `corners` contains the corners in the parts' frames. The
// buffer `placed` contains the corners in the frame plate_home.
struct Outlines {
    std::span<const Convex> pieces;
    Corners corners;
    std::vector<Corner> placed;

    Outlines(std::span<const Convex> the_pieces, Corners the_corners)
        : pieces(the_pieces), corners(the_corners), placed(the_corners.size()) {}

    // Return the corners of a piece in plate_home.
    Corners operator[](int piece) const { return outline(piece, piece + 1); }

    // Return the corners of the pieces with the indices `first` to `end` - 1 in plate_home.
    Corners outline(int first, int end) const {
        return {placed.data() + pieces[first].first, placed.data() + pieces[end - 1].end};
    }

    // Compute the corners of part i in plate_home.
    void place(const State& state, const Body& body, int i) {
        if (body.end_piece == body.first_piece) return;
        const auto first = pieces[body.first_piece].first, end = pieces[body.end_piece - 1].end;
        place_corners(corners.subspan(first, end - first), state(X, i), state(Y, i),
                      std::cos(state(ANGLE, i)), std::sin(state(ANGLE, i)), &placed[first]);
    }
};

// Contact of two parts: maximum depth of the overlap [m], and contact points. If only one of the
// parts is a disc, the disc is the first part.
struct Touch {
    int i, j;
    double depth = 0.0;
    Manifold contact{};
};

// Return the deepest contact of two parts. At least one of the parts is not a disc.
inline Touch touch(const State& state, Bodies bodies, int i, int j, Outlines& outlines) {
    if (bodies[j].radius > 0 && !(bodies[i].radius > 0)) std::swap(i, j);
    const Body &a = bodies[i], &b = bodies[j];
    const bool disc = a.radius > 0;
    outlines.place(state, a, i);
    outlines.place(state, b, j);
    Touch maximum{i, j};
    for (int q = b.first_piece; q < b.end_piece; q++) {
        for (int p = a.first_piece; p < (disc ? a.first_piece + 1 : a.end_piece); p++) {
            const Manifold contact =
                disc ? disc_polygon(state(X, i), state(Y, i), a.radius, outlines[q])
                     : polygon_polygon(outlines[p], outlines[q]);
            double depth = 0.0;
            for (int k = 0; k < contact.count; k++) depth = std::max(depth, contact.depth[k]);
            if (depth > maximum.depth) maximum.depth = depth, maximum.contact = contact;
        }
    }
    return maximum;
}

// The pair of overlapping parts with the maximum relative depth: indices of the parts, depth of the
// overlap [m], and `relative_depth`. The relative depth is the depth divided by `slim` of the
// slimmer part. The values are -1, -1, 0, 0 if no parts overlap.
struct Overlap {
    int first = -1, second = -1;
    double depth = 0.0, relative_depth = 0.0;
};

inline Overlap deepest_overlap(const State& state, Bodies bodies, Outlines& outlines,
                               const std::vector<Pair>& pairs) {
    Overlap worst;
    for (auto [i, j] : pairs) {
        double depth;
        if (bodies[i].radius > 0 && bodies[j].radius > 0) {
            depth = overlap(state, bodies, i, j);
        } else {
            const Touch maximum = touch(state, bodies, i, j, outlines);
            i = maximum.i, j = maximum.j, depth = maximum.depth;
        }
        const double relative_depth = depth / std::min(bodies[i].slim, bodies[j].slim);
        if (relative_depth > worst.relative_depth) worst = {i, j, depth, relative_depth};
    }
    return worst;
}

// Resolves all contacts of the parts. All steps have equal length.
struct Contacts {
    State state;
    Bodies bodies;
    View<const bool, 1> on_plate;  // (M,): whether each part is on the plate
    Outlines outlines;
    Rules rules;
    double step;                // duration of a step [s]
    const double* half;         // half sides of the plate (2,) [m]
    std::vector<Pair> close{};  // work buffer
    std::vector<int> edge{};

    // After a time step, apply collisions until near pairs, and parts at the walls, neither
    // approach each other nor overlap. The state is changed in place. The last entries of the state
    // and of the bodies represent the walls.
    void resolve(std::span<const Pair> pairs, const PlateSample& plate) {
        const int wall = state.walls();
        const double twist[] = {plate.x, plate.y, plate.theta, plate.vx, plate.vy, plate.spin};
        for (int row = 0; row < 6; row++) state(row, wall) = twist[row];
        const double c = std::cos(plate.theta), s = std::sin(plate.theta);
        close.resize(pairs.size() + 1), edge.resize(on_plate.size(0) + 1);
        int count = 0, wall_count = 0;
        double margin = 0.0, pushed = INFINITE;
        for (int sweep = 0; sweep < SWEEPS; sweep++) {
            if (pushed > margin) {
                margin = INFINITE;
                count = close_pairs(pairs, margin);
                if (rules.walls) wall_count = near_walls(c, s, margin);
                pushed = 0.0;
            }
            double deepest = 0.0;
            for (int row = 0; row < count; row++) {
                // The order of the pairs alternates from pass to pass, so that pushes propagate in
                // both directions.
                const auto [i, j] = close[sweep % 2 == 0 ? row : count - 1 - row];
                const bool discs = bodies[i].radius > 0 && bodies[j].radius > 0;
                deepest = std::max(deepest, discs ? collide_discs(state, bodies, i, j, rules, step)
                                                  : collide_parts(i, j));
            }
            for (int k = 0; k < wall_count; k++)
                deepest = std::max(deepest, collide_with_walls(edge[k], c, s));
            if (deepest <= OVERLAP) break;
            pushed += PUSHES * deepest;
        }
    }

  private:
    // Fill `close` with the pairs whose gap is at most MARGIN times the sum of their radii. Return
    // the number of these pairs. Reduce `margin` to the minimum approach [m] after which another
    // pair could touch.
    int close_pairs(std::span<const Pair> pairs, double& margin) {
        int count = 0;
        for (const auto [i, j] : pairs) {
            const double dx = state(X, i) - state(X, j), dy = state(Y, i) - state(Y, j);
            const double reach = bodies[i].reach + bodies[j].reach, size = (1 + MARGIN) * reach;
            margin = std::min(margin, MARGIN * reach);
            close[count] = {i, j};
            // The code avoids a branch here, because the processor would often mispredict it.
            count += dx * dx + dy * dy < size * size;
        }
        return count;
    }

    // Fill `edge` with the parts whose distance from a wall is at most MARGIN times their radius.
    // Return the number of these parts.
    int near_walls(double c, double s, double& margin) {
        const int wall = state.walls();
        int count = 0;
        for (int i = 0; i < on_plate.size(0); i++) {
            const double reach = bodies[i].reach, size = (1 + MARGIN) * reach;
            const double rx = state(X, i) - state(X, wall), ry = state(Y, i) - state(Y, wall);
            const bool near = std::abs(c * rx + s * ry) + size > half[0] ||
                              std::abs(c * ry - s * rx) + size > half[1];
            edge[count] = i;
            count += on_plate(i) && near;
            margin = std::min(margin, MARGIN * reach);
        }
        return count;
    }

    // If two parts touch, apply their collision. At least one of the parts is not a disc. Return
    // the depth [m] of their overlap.
    double collide_parts(int i, int j) {
        const double dx = state(X, i) - state(X, j), dy = state(Y, i) - state(Y, j);
        const double size = bodies[i].reach + bodies[j].reach;
        if (dx * dx + dy * dy >= size * size) return 0.0;
        const Touch maximum = touch(state, bodies, i, j, outlines);
        if (maximum.depth > KEPT || closes(state, maximum.i, maximum.j, maximum.contact))
            collide(state, bodies, maximum.i, maximum.j, maximum.contact, rules, step);
        return maximum.depth;
    }

    // Apply the collisions of a part with the walls. Return the maximum depth [m] of the overlap of
    // the part and a wall.
    double collide_with_walls(int i, double c, double s) {
        const Body& body = bodies[i];
        const int wall = state.walls();
        double deepest = 0.0;
        for (int side = 0; side < 4; side++) {
            const double sign = side % 2 ? -1.0 : 1.0, far = half[side / 2];
            const Vec out = side < 2 ? Vec{sign * c, sign * s} : Vec{-sign * s, sign * c};
            const Vec wall_point{state(X, wall) + far * out.x, state(Y, wall) + far * out.y};
            const double distance =
                (wall_point.x - state(X, i)) * out.x + (wall_point.y - state(Y, i)) * out.y;
            if (distance >= body.reach) continue;
            if (body.radius > 0) {
                const double depth = body.radius - distance;
                deepest = std::max(deepest, depth);
                collide_with_wall(state, bodies, i, depth, -out.x, -out.y, rules, step);
                continue;
            }
            outlines.place(state, body, i);
            const Manifold contact = polygon_wall(
                outlines.outline(body.first_piece, body.end_piece), wall_point, {-out.x, -out.y});
            for (int k = 0; k < contact.count; k++) deepest = std::max(deepest, contact.depth[k]);
            if (contact.count > 0) collide(state, bodies, i, wall, contact, rules, step);
        }
        return deepest;
    }
};

}  // namespace plate::contacts
