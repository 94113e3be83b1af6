// Contact points of two rigid parts in the plane. The parts are discs or convex polygons.
//
// The contact of two convex polygons is at the side whose outward normal gives the maximum
// separation (method of separating axes: Gottschalk, Lin and Manocha 1996). The side with the
// maximum separation is called the reference side. The nearest side of the other polygon is clipped
// to the reference side.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "vectors.hpp"

namespace plate::contacts {

constexpr double INFINITE = std::numeric_limits<double>::infinity();

// A side of the second part becomes the reference side only if its separation is larger than the
// separation by the first part's side. The difference must exceed this value [m].
constexpr double PREFER = 1e-6;

// Contact of two parts:
// - number of points (0 to 2)
// - unit normal from the second part to the first
// - points [m] in the middle of the overlap, and depth of the overlap [m] at each point
struct Manifold {
    int count = 0;
    Vec normal{};
    Vec point[2]{};
    double depth[2]{};
};

// A corner of a convex piece of a part. (x, y) is its position. (out_x, out_y) is the outward
// normal of the side that begins at the corner. `open` is 1 if this side belongs to the part's
// outline, and 0 if it adjoins another piece of the part.
struct Corner {
    double x, y, out_x, out_y, open;
};
static_assert(sizeof(Corner) == 5 * sizeof(double));
using Corners = std::span<const Corner>;

// Returns the index of the corner that follows corner k.
inline int next(int k, Corners corners) {
    return k + 1 < static_cast<int>(corners.size()) ? k + 1 : 0;
}

// Return the contact of a disc (first part) and a convex polygon.
inline Manifold disc_polygon(double cx, double cy, double radius, Corners corners) {
    double maximum = -INFINITE;
    int side = -1;
    for (int k = 0; k < static_cast<int>(corners.size()); k++) {
        const Corner& corner = corners[k];
        const double distance = corner.out_x * (cx - corner.x) + corner.out_y * (cy - corner.y);
        if (distance >= radius || (distance > 0 && corner.open == 0)) return {};
        if (distance > maximum && corner.open != 0) maximum = distance, side = k;
    }
    if (side < 0) return {};
    double nx = corners[side].out_x, ny = corners[side].out_y;
    if (maximum > 0) {
        // The nearest point of the polygon is on this side or at one of its ends.
        const Corner &a = corners[side], &b = corners[next(side, corners)];
        const double along = (a.x - cx) * ny - (a.y - cy) * nx;
        const double beyond = (cx - b.x) * ny - (cy - b.y) * nx;
        if (along < 0 || beyond < 0) {
            const Corner& end = along < 0 ? a : b;
            const double x = cx - end.x, y = cy - end.y;
            maximum = std::sqrt(x * x + y * y);
            if (maximum >= radius) return {};
            nx = x / maximum, ny = y / maximum;
        }
    }
    const double depth = radius - maximum, arm = radius - 0.5 * depth;
    return {1, {nx, ny}, {{cx - arm * nx, cy - arm * ny}}, {depth}};
}

// Maximum separation `gap` of two polygons along the normal of an open side of the first polygon,
// and the index of this side. The gap is negative if the polygons overlap. If any side separates
// the polygons, the gap is set to 0.
struct Separation {
    double gap;
    int side;

    Separation(Corners flat, Corners other) : gap(-INFINITE), side(-1) {
        for (int k = 0; k < static_cast<int>(flat.size()); k++) {
            const double nx = flat[k].out_x, ny = flat[k].out_y;
            double minimum = INFINITE;
            for (const Corner& corner : other)
                minimum =
                    std::min(minimum, nx * (corner.x - flat[k].x) + ny * (corner.y - flat[k].y));
            if (minimum >= 0) {
                gap = 0.0, side = k;
                return;
            }
            if (minimum > gap && flat[k].open != 0) gap = minimum, side = k;
        }
    }
};

// Return the contact of the reference side of the polygon `flat` with the polygon `other`. The
// normal points to `other`.
inline Manifold clip(Corners flat, int side, Corners other) {
    const double x0 = flat[side].x, y0 = flat[side].y;
    const double nx = flat[side].out_x, ny = flat[side].out_y, tx = -ny, ty = nx;
    // k is the side of the other polygon whose normal is most nearly opposite to the reference
    // normal.
    double facing = INFINITE;
    int k = 0;
    for (int i = 0; i < static_cast<int>(other.size()); i++) {
        const double cosine = nx * other[i].out_x + ny * other[i].out_y;
        if (cosine < facing) facing = cosine, k = i;
    }
    const Corner &end = flat[next(side, flat)], &a = other[k], &b = other[next(k, other)];
    const double length = tx * (end.x - x0) + ty * (end.y - y0);
    // Coordinates of the other side's ends, along the reference side (`along`) and perpendicular to
    // the reference side (`out`).
    const double along[] = {tx * (a.x - x0) + ty * (a.y - y0), tx * (b.x - x0) + ty * (b.y - y0)};
    const double out[] = {nx * (a.x - x0) + ny * (a.y - y0), nx * (b.x - x0) + ny * (b.y - y0)};
    Manifold contact{0, {nx, ny}};
    for (int i = 0; i < 2; i++) {
        double s = along[i], d = out[i];
        const double bound = std::min(std::max(s, 0.0), length);
        if (bound != s) {
            const auto [low, high] = std::minmax(along[0], along[1]);
            if (low == high || !(low <= bound && bound <= high)) continue;
            d = out[0] + (out[1] - out[0]) * (bound - along[0]) / (along[1] - along[0]);
            s = bound;
        }
        if (d < 0) {
            contact.point[contact.count] = {x0 + s * tx + 0.5 * d * nx, y0 + s * ty + 0.5 * d * ny};
            contact.depth[contact.count++] = -d;
        }
    }
    if (contact.count) return contact;
    // If no point of the clipped side is inside `flat`, use the deepest corner of `other`.
    for (const Corner& corner : other) {
        const double d = nx * (corner.x - x0) + ny * (corner.y - y0);
        if (-d > contact.depth[0])
            contact = {1, {nx, ny}, {{corner.x - 0.5 * d * nx, corner.y - 0.5 * d * ny}}, {-d}};
    }
    return contact;
}

// Return the contact of two convex polygons.
inline Manifold polygon_polygon(Corners first, Corners second) {
    const Separation of_first(first, second);
    if (of_first.gap >= 0) return {};
    const Separation of_second(second, first);
    if (of_second.gap >= 0 || (of_first.side < 0 && of_second.side < 0)) return {};
    if (of_second.side >= 0 && (of_first.side < 0 || of_first.gap + PREFER < of_second.gap))
        return clip(second, of_second.side, first);
    Manifold contact = clip(first, of_first.side, second);
    contact.normal = {-contact.normal.x, -contact.normal.y};
    return contact;
}

// Return the contact of an outline and a wall. `wall` is a point on the wall, and n is the wall's
// inward normal.
inline Manifold polygon_wall(Corners outline, Vec wall, Vec n) {
    Manifold contact{0, n};
    for (const Corner& corner : outline) {
        const double depth = n.x * (wall.x - corner.x) + n.y * (wall.y - corner.y);
        if (depth <= 0) continue;
        // Keep the two contact points with the greatest depth.
        int index = contact.count;
        if (index < 2) {
            contact.count++;
        } else {
            index = contact.depth[0] < contact.depth[1] ? 0 : 1;
            if (depth <= contact.depth[index]) continue;
        }
        contact.point[index] = {corner.x + 0.5 * depth * n.x, corner.y + 0.5 * depth * n.y};
        contact.depth[index] = depth;
    }
    return contact;
}

// Transform a part's corners from the part's frame to the frame plate_home.
inline void place_corners(Corners corners, double x, double y, double cosine, double sine,
                          Corner* placed) {
    for (const auto& [a, b, u, v, open] : corners)
        *placed++ = {x + cosine * a - sine * b, y + sine * a + cosine * b,
                     cosine * u - sine * v, sine * u + cosine * v, open};
}

}  // namespace plate::contacts
