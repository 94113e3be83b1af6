// C++ kernels of raster.py, which draws the plate and the parts into an image. Only pixels that
// change are drawn.
//
// `places` contains for each pixel the point of the plate's plane that the pixel shows [m,
// plate_home]. `canvas` contains the grey value of each pixel. `light` contains the brightness of
// each pixel as a fraction of full light. The grey values of parts and plate are given for full
// light. Pixels at edges are collected in batches, and the covered fractions of a batch are
// computed together.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include <plate/view.hpp>
#include <plate/wide.hpp>

#include "vectors.hpp"

namespace plate::raster {

// Pose of the plate: position [m], and cosine and sine of the angle.
struct Pose {
    double x, y, cos, sin;
};

// Outlines of the parts. `Outlines` in raster.py describes the fields.
struct Outlines {
    View<const double, 2> edges;
    View<const int64_t, 1> pieces, first, hole, end;
};

// Shapes to draw. `Sprites` in raster.py describes the fields.
struct Sprites {
    View<const int64_t, 2> window;
    View<const double, 1> scale;
    View<const int64_t, 1> copies;
    View<const double, 3> path;
    View<const double, 1> radius;
    View<const double, 2> turn;
    View<const double, 1> grey, opacity;
};

// Add image noise to the canvas (n,), and write the rounded result to the image (n,). The noise is
// `noise` times the standard normal random numbers `bank` (n,).
PLATE_WIDE inline void expose(View<const float, 1> canvas, View<const float, 1> bank, float noise,
                              View<uint8_t, 1> image) {
    const float *__restrict from = canvas.data, *__restrict deviate = bank.data;
    uint8_t* __restrict to = image.data;
    const int count = canvas.size(0);
    for (int i = 0; i < count; i++) {
        const float value = from[i] + noise * deviate[i] + 0.5f;
        to[i] = std::min(std::max(static_cast<int>(value), 0), 255);
    }
}

// Batch of pixels at an edge. For each pixel, the batch contains the point of the plate's plane
// that the pixel shows [m], the covered fraction, and the index in the image.
struct Pixels {
    static constexpr int ROOM = 64;
    double x[ROOM]{}, y[ROOM]{}, cover[ROOM];
    int64_t index[ROOM];
    int count = 0;

    // Adds a pixel. Returns whether the batch has room for another pixel.
    bool add(int64_t pixel, double its_x, double its_y) {
        x[count] = its_x, y[count] = its_y, index[count] = pixel;
        return ++count < ROOM;
    }
};

// Position on the path of a moving shape. The path has `last` pieces of equal duration. For motion
// blur, the path is divided into `copies` intervals of equal duration. The position is in the
// middle of interval k. `piece` is the index of the piece that contains the position. `part` is the
// fraction of this piece before the position, from 0 to 1.
struct Along {
    int piece;
    double part;

    Along(int k, int copies, int last) {
        const double fraction = (k + 0.5) / copies;
        piece = std::min(static_cast<int>(fraction * last), last - 1);
        part = fraction * last - piece;
    }
    double operator()(double from, double to) const { return from + part * (to - from); }
};

// Return the covered fraction of a pixel. `inside` is the distance of the pixel's centre from the
// edge [px], positive inside the shape.
[[gnu::always_inline]] inline double covered(double inside) {
    return std::min(std::max(inside + 0.5, 0.0), 1.0);
}

// Return the distances [m] of a point from the nearest edges of the plate along both axes of the
// plate. The distances are positive inside the plate.
[[gnu::always_inline]] inline Vec depths(const Pose& pose, const double half[2], double x,
                                        double y) {
    const double dx = x - pose.x, dy = y - pose.y;
    return {half[0] - std::abs(pose.cos * dx + pose.sin * dy),
            half[1] - std::abs(pose.cos * dy - pose.sin * dx)};
}

// Computes the fraction of each pixel that the plate covers, averaged over the poses of the plate.
PLATE_WIDE inline void cover_by_plate(Pixels& pixels, std::span<const Pose> poses,
                                      const double half[2], double scale) {
    double cover[Pixels::ROOM] = {};
    for (const Pose& pose : poses)
        for (int p = 0; p < Pixels::ROOM; p++) {
            const Vec inside = depths(pose, half, pixels.x[p], pixels.y[p]);
            cover[p] += covered(inside.x * scale) * covered(inside.y * scale);
        }
    for (int p = 0; p < Pixels::ROOM; p++) pixels.cover[p] = cover[p] / poses.size();
}

// Paints background and plate in the pixels with the indices `some`. raster.py describes the
// method.
inline void draw_plate(View<float, 1> canvas, View<const float, 1> light,
                       View<const double, 2> places, View<const int64_t, 1> some,
                       View<const double, 2> poses, int copies, double travel, const double half[2],
                       double scale, double background, double plate) {
    std::vector<Pose> pose(copies);
    const int last = poses.size(0) - 1;
    for (int k = 0; k < copies; k++) {
        double middle[3];
        for (int d = 0; d < 3; d++) {
            if (last == 0) {
                middle[d] = poses(0, d);
                continue;
            }
            const Along at(k, copies, last);
            middle[d] = at(poses(at.piece, d), poses(at.piece + 1, d));
        }
        pose[k] = {middle[0], middle[1], std::cos(middle[2]), std::sin(middle[2])};
    }
    const auto paint = [&](int64_t i, double cover) {
        canvas(i) = (background + (plate - background) * cover) * light(i);
    };
    Pixels pixels;
    const auto paint_edge = [&] {
        cover_by_plate(pixels, pose, half, scale);
        for (int p = 0; p < pixels.count; p++) paint(pixels.index[p], pixels.cover[p]);
        pixels.count = 0;
    };
    for (int p = 0; p < some.size(0); p++) {
        const int64_t i = some(p);
        const double x = places(i, 0), y = places(i, 1);
        const Vec first = depths(pose[0], half, x, y);
        const double depth = std::min(first.x, first.y) * scale;
        if (depth > 0.5 + travel * scale)
            paint(i, 1.0);
        else if (depth < -0.5 - travel * scale)
            paint(i, 0.0);
        else if (!pixels.add(i, x, y))
            paint_edge();
    }
    paint_edge();
}

// Positions at which a moving shape is drawn. The image of the shape is the average over these
// positions. `middle` is the point midway between the ends of the path. `spread` is the maximum
// distance of a position from `middle` [m].
struct Positions {
    std::vector<Vec> centre;
    Vec middle;
    double spread = 0.0;

    // Computes the positions of shape i. `path` (s, n, 2) contains the points of the paths of all n
    // shapes.
    Positions(View<const double, 3> path, int i, int copies) : centre(copies) {
        const int last = path.size(0) - 1;
        middle = {0.5 * (path(0, i, 0) + path(last, i, 0)),
                  0.5 * (path(0, i, 1) + path(last, i, 1))};
        for (int k = 0; k < copies; k++) {
            const Along at(k, copies, last);
            const int j = at.piece;
            centre[k] = {at(path(j, i, 0), path(j + 1, i, 0)),
                         at(path(j, i, 1), path(j + 1, i, 1))};
            const double dx = centre[k].x - middle.x, dy = centre[k].y - middle.y;
            spread = std::max(spread, std::sqrt(dx * dx + dy * dy));
        }
    }
};

// A shape is a disc with a radius [m], or a union of adjacent convex polygons with holes. In the
// outlines, the polygons have the indices `begin` to `hole` - 1, and the holes have the indices
// `hole` to `end` - 1. `scale` is the scale of the image [px/m].
struct Shape {
    const Outlines& outlines;
    int begin, hole, end;
    double radius, cos, sin, scale;

    // Returns the radius [m] of a circle around the centre that is inside the shape. The function
    // ignores holes.
    double inner_radius() const {
        if (begin == hole) return radius;
        double inner = 0.0;
        for (int piece = begin; piece < hole; piece++) {
            double minimum = std::numeric_limits<double>::infinity();
            for (int e = outlines.pieces(piece); e < outlines.pieces(piece + 1); e++)
                minimum = std::min(minimum, outlines.edges(e, 2));
            inner = std::max(inner, minimum);
        }
        return inner;
    }
};

// Computes the fraction of each pixel that the polygons with the indices `begin` to `end` - 1
// cover. The coordinates x, y are the pixels' points in the part's frame [m].
[[gnu::always_inline]] inline void polygons_cover(const double* x, const double* y,
                                                  const Shape& shape, int begin, int end,
                                                  double* cover) {
    constexpr int ROOM = Pixels::ROOM;
    const auto& [edges, pieces, first, hole, last] = shape.outlines;
    for (int p = 0; p < ROOM; p++) cover[p] = 0.0;
    for (int piece = begin; piece < end; piece++) {
        double inside[ROOM];
        for (int p = 0; p < ROOM; p++) inside[p] = std::numeric_limits<double>::infinity();
        for (int e = pieces(piece); e < pieces(piece + 1); e++) {
            const double nx = edges(e, 0), ny = edges(e, 1), far = edges(e, 2);
            for (int p = 0; p < ROOM; p++)
                inside[p] = std::min(inside[p], far - nx * x[p] - ny * y[p]);
        }
        for (int p = 0; p < ROOM; p++) cover[p] += covered(inside[p] * shape.scale);
    }
    for (int p = 0; p < ROOM; p++) cover[p] = std::min(cover[p], 1.0);
}

// Computes the fraction of each pixel that a shape covers, as a sum over all positions of the
// shape's centre.
PLATE_WIDE inline void cover_by_part(Pixels& pixels, std::span<const Vec> centres,
                                     const Shape& shape) {
    constexpr int ROOM = Pixels::ROOM;
    double sum[ROOM] = {}, x[ROOM], y[ROOM], own[ROOM], lost[ROOM];
    const double c = shape.cos, s = shape.sin;
    for (const Vec& centre : centres) {
        for (int p = 0; p < ROOM; p++) {
            const double dx = pixels.x[p] - centre.x, dy = pixels.y[p] - centre.y;
            x[p] = c * dx + s * dy, y[p] = c * dy - s * dx;
            own[p] = covered((shape.radius - std::sqrt(dx * dx + dy * dy)) * shape.scale);
        }
        if (shape.begin < shape.hole)
            polygons_cover(x, y, shape, shape.begin, shape.hole, own);
        if (shape.hole < shape.end) {
            polygons_cover(x, y, shape, shape.hole, shape.end, lost);
            for (int p = 0; p < ROOM; p++) own[p] -= lost[p];
        }
        for (int p = 0; p < ROOM; p++) sum[p] += std::max(own[p], 0.0);
    }
    for (int p = 0; p < ROOM; p++) pixels.cover[p] = sum[p];
}

// Blends the shapes into the canvas (height, width) one after the other. raster.py describes the
// method.
inline void draw_parts(View<float, 2> canvas, View<const float, 2> light,
                       View<const double, 3> places, const Sprites& sprites,
                       const Outlines& outlines) {
    const int width = canvas.size(1);
    for (int i = 0; i < sprites.grey.size(0); i++) {
        const int copies = sprites.copies(i);
        const double grey = sprites.grey(i), opacity = sprites.opacity(i);
        const Shape shape{outlines,
                          static_cast<int>(outlines.first(i)),
                          static_cast<int>(outlines.hole(i)),
                          static_cast<int>(outlines.end(i)),
                          sprites.radius(i),
                          sprites.turn(i, 0),
                          sprites.turn(i, 1),
                          sprites.scale(i)};
        const Positions at(sprites.path, i, copies);
        const double outer = shape.radius + at.spread + 1 / shape.scale;
        double inner = 0.0;
        if (shape.hole == shape.end) inner = shape.inner_radius() - at.spread - 0.5 / shape.scale;
        const auto blend = [&](int64_t pixel, double cover) {
            const double fraction = opacity * cover / copies;
            canvas.data[pixel] += fraction * (grey * light.data[pixel] - canvas.data[pixel]);
        };
        Pixels pixels;
        const auto blend_edge = [&] {
            cover_by_part(pixels, at.centre, shape);
            for (int p = 0; p < pixels.count; p++) blend(pixels.index[p], pixels.cover[p]);
            pixels.count = 0;
        };
        const int64_t* window = sprites.window[i];
        for (int row = window[0]; row < window[1]; row++) {
            for (int column = window[2]; column < window[3]; column++) {
                const int64_t pixel = row * width + column;
                const double x = places(row, column, 0), y = places(row, column, 1);
                const double dx = x - at.middle.x, dy = y - at.middle.y;
                const double square = dx * dx + dy * dy;
                if (square > outer * outer) continue;
                if (inner >= 0 && square < inner * inner)
                    blend(pixel, copies);
                else if (!pixels.add(pixel, x, y))
                    blend_edge();
            }
        }
        blend_edge();
    }
}

}  // namespace plate::raster
