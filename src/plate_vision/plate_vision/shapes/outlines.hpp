// C++ kernels of outlines.py, which measures the outlines of patches with an accuracy of a fraction
// of a pixel, and fits polygons to these outlines. A patch is a connected area of the image that
// deviates from the bare plate.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <plate/length.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

#include "plate/light.hpp"

namespace plate {

// Number of harmonics of an outline's spectrum, from the 0th harmonic on. A hexagon differs from a
// disc in the 6th and 12th harmonic, and a square differs from a disc in the 4th, 8th, 12th and
// 16th harmonic.
constexpr int HARMONICS = 17;

// The exact edge is searched within REACH_PX [px] on both sides of a patch's contour. STEPS is the
// number of samples in this range.
constexpr double REACH_PX = 2.5;
constexpr int STEPS = 11;

// Minimum difference between the first and the last sample across an edge, relative to the
// difference between part and surround. Where two parts touch, the difference is smaller, because
// there is no edge. At such places, the contour of the patch is used instead.
constexpr double MIN_STEP = 0.25;

// Maximum squared error of a point in a sum of squares. The unit is the sum of two squares: the
// unit of the fit, and a tenth of the part's size. The maximum limits the effect of outliers.
constexpr double CLIP = 16.0;

// A fit has converged if a step changes its parameters by less than this value [units of the fit,
// usually pixels].
constexpr double STILL = 0.003;

// `turn_scatter` assumes at least this RMS deviation of the points from a type's outline [units of
// the fit].
constexpr double MIN_ERROR = 0.1;

// Assumed number of neighbouring points whose errors are correlated.
constexpr double TOGETHER = 2.0;

// Number of points that are processed together by vector instructions.
constexpr int POINTS = 8;

struct Complex {
    double real, imag;

    Complex operator*(const Complex& by) const {
        return {real * by.real - imag * by.imag, real * by.imag + imag * by.real};
    }
    void operator+=(const Complex& more) { real += more.real, imag += more.imag; }
};

// Compute the similarity of each pixel (h, w, c) to the patch, and write it to `field` (h, w). The
// similarity is 1 for the median colour of the patch and 0 for the median colour of its surround.
// Write the patch's median colour to `colour` (c,).
//
// `mask`, `inner` and `around` (h + 2, w + 2) have a frame of one pixel. `mask` is 1 in the patch.
// `inner` is 1 in the area that certainly belongs to the patch. `around` is 1 in the area that may
// belong to the patch.
inline void contrast(View<const uint8_t, 3> pixels, View<const uint8_t, 2> mask,
                     View<const uint8_t, 2> inner, View<const uint8_t, 2> around,
                     View<float, 2> field, double* colour) {
    const int height = pixels.size(0), width = pixels.size(1), channels = pixels.size(2);
    std::vector<int> counts(2 * 256 * channels);
    bool sure = false;
    for (int y = 1; y <= height; y++)
        sure |= std::any_of(inner[y] + 1, inner[y] + 1 + width, [](uint8_t one) { return one; });
    const View<const uint8_t, 2>& core = sure ? inner : mask;
    for (int y = 0; y < height; y++) {
        const uint8_t *own = core[y + 1] + 1, *near = around[y + 1] + 1, *pixel = pixels[y];
        for (int x = 0; x < width; x++, pixel += channels) {
            if (!own[x] && near[x]) continue;
            int* count = &counts[own[x] ? 0 : 256 * channels];
            for (int k = 0; k < channels; k++) count[256 * k + pixel[k]]++;
        }
    }
    std::vector<double> middle(2 * channels), way(channels);
    double square = 0;
    for (int side = 0; side < 2; side++) {
        int total = 0;
        const int* count = &counts[side * 256 * channels];
        for (int level = 0; level < 256; level++) total += count[level];
        for (int k = 0; k < channels; k++, count += 256) {
            int level = 0;
            for (int passed = count[0]; 2 * passed < total; passed += count[level]) level++;
            middle[side * channels + k] = total ? level : 255 - middle[k];
        }
    }
    for (int k = 0; k < channels; k++) {
        colour[k] = middle[k];
        way[k] = middle[k] - middle[channels + k];
        square += way[k] * way[k];
    }
    square = std::max(square, 1.0);
    for (int i = 0; i < height * width; i++) {
        double along = 0;
        for (int k = 0; k < channels; k++)
            along += (pixels.data[channels * i + k] - middle[channels + k]) * way[k];
        field.data[i] = along / square;
    }
}

// Returns the value of a field (h, w) at a point, by bilinear interpolation.
inline double sample(View<const float, 2> field, double x, double y) {
    x = std::min(std::max(x, 0.0), field.size(1) - 1.001);
    y = std::min(std::max(y, 0.0), field.size(0) - 1.001);
    const int i = x, j = y;
    const double u = x - i, v = y - j;
    return (1 - v) * ((1 - u) * field(j, i) + u * field(j, i + 1)) +
           v * ((1 - u) * field(j + 1, i) + u * field(j + 1, i + 1));
}

// Locate the edge near a closed ring of pixels (k, 2). Write evenly spaced points of the edge to
// `thinned` (count, 2). At the edge, the field has the mean of its values inside and outside the
// ring. The ring consists of the outermost pixels of a patch, or of the pixels around a hole. The
// coordinates of the ring include a frame of one pixel.
inline void find_edge(View<const float, 2> field, View<const int32_t, 2> ring, bool hole,
                      View<double, 2> thinned) {
    struct Point {
        double x, y;
    };
    const int number = ring.size(0);
    std::vector<Point> at(number), moved(number);
    double twice = 0;
    for (int i = 0; i < number; i++) at[i] = {ring(i, 0) - 1.0, ring(i, 1) - 1.0};
    for (int i = 0; i < number; i++) {
        const Point &a = at[i], &b = at[(i + 1) % number];
        twice += a.x * b.y - b.x * a.y;
    }
    const double sense = (twice > 0) != hole ? 1 : -1;
    for (int i = 0; i < number; i++) {
        const Point before = at[(i + 2 * number - 2) % number], after = at[(i + 2) % number];
        const Point here = at[i];
        double x = sense * (after.y - before.y), y = sense * (before.x - after.x);
        const double length = std::sqrt(x * x + y * y);
        moved[i] = here;
        if (length == 0) continue;
        x /= length, y /= length;
        // The edge of the patch is expected half-way between the centre of the ring's pixel and the
        // centre of its outer neighbour.
        const double step = 0.5 / std::max(std::abs(x), std::abs(y));
        const auto level = [&](double way) {
            return sample(field, here.x + way * x, here.y + way * y);
        };
        const double first = level(step - REACH_PX), last = level(step + REACH_PX);
        double best = step;
        if (first - last > MIN_STEP) {
            const double half = 0.5 * (first + last);
            double gap = std::numeric_limits<double>::infinity(), old = first;
            for (int k = 1; k < STEPS; k++) {
                const double way = step - REACH_PX + 2 * REACH_PX * k / (STEPS - 1);
                const double now = level(way);
                if (old >= half && half > now) {
                    const double cross =
                        way - 2 * REACH_PX / (STEPS - 1) * (half - now) / (old - now);
                    if (std::abs(cross - step) < gap) {
                        gap = std::abs(cross - step);
                        best = cross;
                    }
                }
                old = now;
            }
        }
        moved[i] = {here.x + best * x, here.y + best * y};
    }
    std::vector<double> way(number + 1);
    for (int i = 0; i < number; i++) {
        const Point &a = moved[i], &b = moved[(i + 1) % number];
        way[i + 1] = way[i] + length_of(b.x - a.x, b.y - a.y);
    }
    for (int k = 0, i = 0; k < thinned.size(0); k++) {
        const double wanted = way[number] * k / thinned.size(0);
        while (way[i + 1] <= wanted && i < number - 1) i++;
        const double u = (wanted - way[i]) / std::max(way[i + 1] - way[i], 1e-9);
        const Point &a = moved[i], &b = moved[(i + 1) % number];
        thinned(k, 0) = (1 - u) * a.x + u * b.x;
        thinned(k, 1) = (1 - u) * a.y + u * b.y;
    }
}

// Properties of an outline. `Outline` in outlines.py describes these properties.
struct OutlineMeasures {
    double area, x, y;
    std::array<Complex, HARMONICS> spectrum;
};

// Compute the properties of an outline that consists of rings of points (n, 2). `ends` (k,)
// contains the index after the last point of each ring. If the points of a ring have the wrong
// sense of rotation, their order is reversed.
inline OutlineMeasures measure_outline(View<double, 2> points, View<const int64_t, 1> ends) {
    double whole = 0, x = 0, y = 0;
    const double x0 = points(0, 0), y0 = points(0, 1);
    for (int ring = 0, first = 0; ring < ends.size(0); ring++) {
        const int end = ends(ring);
        double twice = 0, mx = 0, my = 0;
        for (int i = first; i < end; i++) {
            const int j = i + 1 < end ? i + 1 : first;
            const double ax = points(i, 0) - x0, ay = points(i, 1) - y0;
            const double bx = points(j, 0) - x0, by = points(j, 1) - y0;
            const double cross = ax * by - bx * ay;
            twice += cross;
            mx += cross * (ax + bx) / 3;
            my += cross * (ay + by) / 3;
        }
        if ((twice > 0) != (first == 0)) {
            for (int i = first, j = end - 1; i < j; i++, j--)
                std::swap_ranges(points[i], points[i] + 2, points[j]);
            twice = -twice, mx = -mx, my = -my;
        }
        whole += twice, x += mx, y += my;
        first = end;
    }
    x = x0 + x / whole, y = y0 + y / whole;
    OutlineMeasures found{0.5 * whole, x, y, {}};
    for (int ring = 0, first = 0; ring < ends.size(0); ring++) {
        const int end = ends(ring);
        for (int i = first; i < end; i++) {
            const int j = i + 1 < end ? i + 1 : first;
            const double ax = points(i, 0) - x, ay = points(i, 1) - y;
            const double bx = points(j, 0) - x, by = points(j, 1) - y;
            const double mx = 0.5 * (ax + bx), my = 0.5 * (ay + by), square = mx * mx + my * my;
            if (square == 0) continue;
            const double radius = std::sqrt(square);
            const Complex turn{mx / radius, -my / radius};
            // Let r be the distance of the edge's middle from the centre of the outline, and phi
            // the polar angle. The term is r^4 / 4 d(phi). Twice the area of the triangle between
            // edge and centre is r^2 d(phi).
            Complex term{0.25 * square * (ax * by - bx * ay), 0};
            for (Complex& wave : found.spectrum) {
                wave += term;
                term = term * turn;
            }
        }
        first = end;
    }
    return found;
}

// Returns the edges (e, 5) of rings of points (n, 2). `Outline.edges` describes the columns.
inline std::vector<double> outline_edges(View<const double, 2> points,
                                         View<const int64_t, 1> ends) {
    std::vector<double> edges;
    for (int ring = 0, first = 0; ring < ends.size(0); ring++) {
        const int end = ends(ring);
        for (int i = first; i < end; i++) {
            const int j = i + 1 < end ? i + 1 : first;
            const double x = points(j, 0) - points(i, 0), y = points(j, 1) - points(i, 1);
            const double length = std::sqrt(x * x + y * y);
            if (length > 0)
                edges.insert(edges.end(),
                             {points(i, 0), points(i, 1), x / length, y / length, length});
        }
        first = end;
    }
    return edges;
}

// Points and their distances from edges. The arrays are padded to a multiple of POINTS.
struct Places {
    int size;
    std::vector<double> x, y;
    // Signed distance of each point, and the components of its gradient, which is a unit vector.
    std::vector<double> distance, right, down;

    explicit Places(int count) : size(count) {
        for (auto* list : {&x, &y, &distance, &right, &down})
            list->resize((count + POINTS - 1) / POINTS * POINTS);
    }
    int padded() const { return x.size(); }
};

// For each point, the nearest edge among the edges processed so far: squared distance, index of the
// edge, and vector from the edge to the point.
struct Nearest {
    double minimum[POINTS], edge[POINTS] = {}, right[POINTS] = {}, down[POINTS] = {};

    Nearest() { std::fill_n(minimum, POINTS, std::numeric_limits<double>::infinity()); }

    [[gnu::always_inline]] void keep(int i, double distance, double its, double dx, double dy) {
        const bool nearer = distance < minimum[i];
        minimum[i] = nearer ? distance : minimum[i];
        edge[i] = nearer ? its : edge[i];
        right[i] = nearer ? dx : right[i];
        down[i] = nearer ? dy : down[i];
    }
};

// Compute the signed distances of points from edges (e, 5). The distance of a point outside the
// outline is positive. Also compute the gradients of the distances, which are unit vectors. An edge
// with negative length is a circle around the edge's start. The radius of the circle is the
// absolute value of the length.
PLATE_WIDE inline void edge_distances(View<const double, 2> edges, Places& places) {
    for (int first = 0; first < places.padded(); first += POINTS) {
        const double *__restrict x = &places.x[first], *__restrict y = &places.y[first];
        Nearest nearest;
        for (int e = 0; e < edges.size(0); e++) {
            const double* edge = edges[e];
            const double x0 = edge[0], y0 = edge[1], ux = edge[2], uy = edge[3], length = edge[4];
            if (length < 0) {
#pragma omp simd
                for (int i = 0; i < POINTS; i++) {
                    const double vx = x[i] - x0, vy = y[i] - y0;
                    const double out = 1 + length / std::max(std::sqrt(vx * vx + vy * vy), 1e-12);
                    const double dx = out * vx, dy = out * vy;
                    nearest.keep(i, dx * dx + dy * dy, e, dx, dy);
                }
                continue;
            }
#pragma omp simd
            for (int i = 0; i < POINTS; i++) {
                const double vx = x[i] - x0, vy = y[i] - y0, across = ux * vy - uy * vx;
                const double along = std::min(std::max(vx * ux + vy * uy, 0.0), length);
                const double dx = vx - along * ux, dy = vy - along * uy;
                // If the nearest point is the common corner of two edges, the distances are equal.
                // In this case, the small additional term selects the edge whose line is farther
                // from the point. The selected edge gives the correct sign.
                nearest.keep(i, dx * dx + dy * dy - 1e-6 * across * across, e, dx, dy);
            }
        }
        for (int i = 0; i < POINTS; i++) {
            const double* edge = edges[static_cast<int>(nearest.edge[i])];
            const double vx = x[i] - edge[0], vy = y[i] - edge[1];
            double ux = edge[2], uy = edge[3], side;
            if (edge[4] < 0) {
                // (ux, uy) is the tangent of the circle, which is perpendicular to the outward
                // direction.
                const double size = std::max(std::sqrt(vx * vx + vy * vy), 1e-12);
                ux = -vy / size, uy = vx / size;
                side = size > -edge[4] ? 1 : -1;
            } else {
                side = ux * vy - uy * vx < 0 ? 1 : -1;
            }
            const double right = nearest.right[i], down = nearest.down[i];
            const double square = right * right + down * down;
            const double length = std::sqrt(square);
            const bool on_edge = square < 1e-20;
            places.distance[first + i] = on_edge ? 0 : side * length;
            places.right[first + i] = on_edge ? uy : side * right / length;
            places.down[first + i] = on_edge ? -ux : side * down / length;
        }
    }
}

// Compute the unsigned distances of points from edges (e, 5) of positive length.
PLATE_WIDE inline void rim_distances(View<const double, 2> edges, Places& places) {
    for (int first = 0; first < places.padded(); first += POINTS) {
        const double *__restrict x = &places.x[first], *__restrict y = &places.y[first];
        double minimum[POINTS];
        std::fill_n(minimum, POINTS, 1e30);
        for (int e = 0; e < edges.size(0); e++) {
            const double* edge = edges[e];
            const double x0 = edge[0], y0 = edge[1], ux = edge[2], uy = edge[3], length = edge[4];
#pragma omp simd
            for (int i = 0; i < POINTS; i++) {
                const double vx = x[i] - x0, vy = y[i] - y0;
                const double along = std::min(std::max(vx * ux + vy * uy, 0.0), length);
                const double dx = vx - along * ux, dy = vy - along * uy;
                minimum[i] = std::min(minimum[i], dx * dx + dy * dy);
            }
        }
        for (int i = 0; i < POINTS; i++) places.distance[first + i] = std::sqrt(minimum[i]);
    }
}

// Result of `fit_pose`:
// - x, y [m], angle [rad]: pose of the polygon
// - swell: growth, which is the mean signed distance of the points from the polygon, positive
//   outside [m]
// - rest: root mean square residual [m]
struct PoseFit {
    double x, y, angle, swell, rest;
};

// Fit a polygon with edges (e, 5) to points (n, 2) by Gauss-Newton steps. `fit_pose` in outlines.py
// describes the arguments.
//
// The error of a point is its signed distance from the polygon minus the growth `swell`. The weight
// of a point is min(1, unit / |error|) (Huber's weight).
inline PoseFit fit_pose(View<const double, 2> edges, View<const double, 2> points,
                        const double* pose, double unit, bool turns, int steps, double hopeless,
                        double gate) {
    const int number = points.size(0);
    const bool gated = gate < std::numeric_limits<double>::infinity();
    double x = pose[0], y = pose[1], angle = pose[2], swell = 0, square = 0, rest = 0;
    for (int i = 0; i < number; i++) {
        const double dx = points(i, 0) - x, dy = points(i, 1) - y;
        square += dx * dx + dy * dy;
    }
    const double lever = std::sqrt(square / number);
    const double worst = CLIP * (unit * unit + lever * lever / 100);
    Places places(number);
    for (int step = 0; step <= steps; step++) {
        const double c = std::cos(angle), s = std::sin(angle);
        for (int i = 0; i < number; i++) {
            const double dx = points(i, 0) - x, dy = points(i, 1) - y;
            places.x[i] = c * dx + s * dy;
            places.y[i] = -s * dx + c * dy;
        }
        edge_distances(edges, places);
        double a[4][4] = {}, g[4] = {};
        rest = 0;
        for (int i = 0; i < number; i++) {
            const double error = places.distance[i] - swell;
            if (std::abs(error) > gate) continue;
            const double nx = places.right[i], ny = places.down[i];
            rest += std::min(error * error, worst);
            const double weight = std::min(1.0, unit / std::max(std::abs(error), 1e-12));
            const double row[4] = {-(c * nx - s * ny), -(s * nx + c * ny),
                                   turns ? nx * places.y[i] - ny * places.x[i] : 0, -1};
            for (int j = 0; j < 4; j++) {
                g[j] += weight * row[j] * error;
                for (int k = 0; k < 4; k++) a[j][k] += weight * row[j] * row[k];
            }
        }
        if (step == steps || (step >= 2 && rest > number * hopeless * hopeless)) break;
        if (!turns) a[2][2] = 1;
        if (gated) {
            for (int j = 0; j < 3; j++) a[3][j] = a[j][3] = 0;
            a[3][3] = 1, g[3] = 0;
        }
        for (int j = 0; j < 4; j++) a[j][j] += 1e-9 * a[j][j] + 1e-15;
        solve(a, g);
        x -= g[0], y -= g[1], angle -= g[2], swell -= g[3];
        const double moved = std::max(
            {std::abs(g[0]), std::abs(g[1]), lever * std::abs(g[2]), std::abs(g[3])});
        if (moved < STILL * unit) break;
    }
    return {x, y, angle, swell, std::sqrt(rest / number)};
}

// Returns the standard deviation of a fitted angle [rad]. `angle_sd` in classes.py describes the
// method.
inline double turn_scatter(View<const double, 2> edges, View<const double, 2> points,
                           const double* fit, double full, double unit, double gate) {
    const int count = points.size(0);
    double lever = 0;
    for (int i = 0; i < count; i++) {
        const double dx = points(i, 0) - fit[0], dy = points(i, 1) - fit[1];
        lever += dx * dx + dy * dy;
    }
    lever /= count;
    const double step = unit / std::sqrt(lever), maximum = CLIP * unit * unit;
    double squares[3] = {};
    int number = 0;
    std::vector<char> near(count);
    Places places(count);
    for (int k = 0; k < 3; k++) {
        const double turn = fit[2] + std::array{0.0, step, -step}[k];
        const double c = std::cos(turn), s = std::sin(turn);
        for (int i = 0; i < count; i++) {
            const double dx = points(i, 0) - fit[0], dy = points(i, 1) - fit[1];
            places.x[i] = c * dx + s * dy;
            places.y[i] = -s * dx + c * dy;
        }
        edge_distances(edges, places);
        for (int i = 0; i < count; i++) {
            const double error = places.distance[i] - fit[3];
            if (k == 0) number += near[i] = !(std::abs(error) > gate);
            if (near[i]) squares[k] += std::min(error * error, maximum);
        }
    }
    if (!number) return std::numeric_limits<double>::infinity();
    for (double& square : squares) square /= number;
    const double rest = std::max(squares[0], MIN_ERROR * unit * (MIN_ERROR * unit));
    const double bend = (squares[1] + squares[2] - 2 * squares[0]) / (2 * step * step);
    if (bend <= 0) return std::numeric_limits<double>::infinity();
    return std::sqrt(TOGETHER * rest / (number * bend) * std::max(full / bend, 1.0));
}

}  // namespace plate
