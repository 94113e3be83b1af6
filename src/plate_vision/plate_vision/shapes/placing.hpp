// C++ kernels of groups.py: search for a part at all positions and angles in a group. A group is a
// patch of the image that shows several touching parts.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include <plate/length.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

// A contour point of a part counts as on the group's contour if its distance from this contour is
// below this value [px].
constexpr double NEAR_PX = 1.3;

// A point of a part counts as inside the group if its distance from the group is at most this value
// [px].
constexpr double OUTSIDE_PX = 1.6;

// Maximum fraction of a part's area that may be outside the group.
constexpr double MAX_OUTSIDE = 0.06;

// The number of a part's contour points on the group's contour is counted for each place. At
// excluded places, the count starts at this value. With this value, the number remains negative
// after the points are counted.
constexpr int16_t BARRED = -30'000;

// Number of places along a row of pixels that are processed together.
constexpr int PLACES = 16;

// Maximum width of the frame of pixels that is added around the group [px].
constexpr double MAX_MARGIN = 1e4;

// Returns 1 if a point of a part is outside the free area, else 0. `free` is the depth of the point
// in this area [px].
inline int is_outside(double free) { return free < -OUTSIDE_PX; }

// Returns 1 for a contour point of a part on the group's contour, -1 for a point outside the group,
// and 0 for other points. `border` is the depth of the point in the group [px].
inline int is_on_rim(double border) {
    if (border < -OUTSIDE_PX) return -1;
    return border < NEAR_PX;
}

// Returns the value of a field (h, w) at the pixel that is nearest to a point of a part. The result
// is -99 outside the field. `place` is the point in the part's frame, and `pose` is the pose of the
// part. The arguments c and s are the cosine and sine of the part's angle. `to_px` (2, 3) converts
// positions to pixels.
inline double level(View<const float, 2> field, View<const double, 2> to_px, const double* place,
                    const double* pose, double c, double s) {
    const double u = pose[0] + c * place[0] - s * place[1];
    const double v = pose[1] + s * place[0] + c * place[1];
    const double i = std::floor(to_px(0, 0) * u + to_px(0, 1) * v + to_px(0, 2) + 0.5);
    const double j = std::floor(to_px(1, 0) * u + to_px(1, 1) * v + to_px(1, 2) + 0.5);
    const bool inside = i >= 0 && j >= 0 && j < field.size(0) && i < field.size(1);
    return inside ? field(j, i) : -99;
}

// Result of `support`.
struct Support {
    double seen, outside;
};

// Compute how well a part at a pose agrees with the group. `seen` is the fraction of the part's
// contour points `rim` (n, 2) that are on the group's contour, minus the fraction outside the
// group. `outside` is the fraction of the part's inner points (m, 2) that are outside the free
// area.
inline Support support(View<const float, 2> free, View<const float, 2> border,
                       View<const double, 2> to_px, View<const double, 2> rim,
                       View<const double, 2> inner, const double* pose) {
    const double c = std::cos(pose[2]), s = std::sin(pose[2]);
    int seen = 0, out = 0;
    for (int k = 0; k < rim.size(0); k++)
        seen += is_on_rim(level(border, to_px, rim[k], pose, c, s));
    for (int k = 0; k < inner.size(0); k++)
        out += is_outside(level(free, to_px, inner[k], pose, c, s));
    return {static_cast<double>(seen) / rim.size(0), static_cast<double>(out) / inner.size(0)};
}

// Returns the maximum distance of points (n, 2) from `place` (2,).
inline double farthest(View<const double, 2> points, const double* place) {
    double maximum = 0;
    for (int k = 0; k < points.size(0); k++)
        maximum = std::max(maximum, length_of(points(k, 0) - place[0], points(k, 1) - place[1]));
    return maximum;
}

// Rotate the points (n, 2) of a part about the part's reference point, the pole. Write the offsets
// of the points from the pole to `offsets`. An offset is a difference of indices in a field that is
// `width` pixels wide.
inline void find_offsets(View<const double, 2> points, View<const double, 2> to_px,
                         const double* pole, double angle, int margin, int width,
                         std::vector<int>& offsets) {
    const double c = std::cos(angle), s = std::sin(angle), maximum = margin;
    for (int k = 0; k < points.size(0); k++) {
        const double x = points(k, 0) - pole[0], y = points(k, 1) - pole[1];
        const double u = c * x - s * y, v = s * x + c * y;
        const double i = std::floor(to_px(0, 0) * u + to_px(0, 1) * v + 0.5);
        const double j = std::floor(to_px(1, 0) * u + to_px(1, 1) * v + 0.5);
        if (!(std::abs(i) <= maximum && std::abs(j) <= maximum))
            throw std::invalid_argument("rim and inner: not all points are finite");
        offsets[k] = static_cast<int>(j) * width + static_cast<int>(i);
    }
}

// For each of `count` places in a row of the field: move a part to the place, and sum the values of
// the field at all points of the part. The sum is added to `total` (count,). `row` points to the
// first place. `offsets` contains the indices of the points relative to the place. Elements after
// the end of `total` are also changed, up to a multiple of PLACES.
PLATE_WIDE inline void add_rows(const int16_t* row, const std::vector<int>& offsets,
                                int16_t* __restrict total, int count) {
    for (int first = 0; first < count; first += PLACES) {
        int16_t sum[PLACES];
        std::copy_n(total + first, PLACES, sum);
        for (int offset : offsets) {
            const int16_t* __restrict values = row + first + offset;
            for (int i = 0; i < PLACES; i++) sum[i] += values[i];
        }
        std::copy_n(sum, PLACES, total + first);
    }
}

// A possible place of a part: x, y [m], the angle with the largest `Support.seen` [rad], and this
// largest value as `seen`.
struct PlaceFound {
    double x, y, angle, seen;
};

// Return all places where a part may be located. groups.py describes the search.
//
// At a given angle, the pixels of a part have the same offsets at all places. Therefore the pixels
// are counted for a whole row of places together.
inline std::vector<PlaceFound> search(View<const float, 2> free, View<const float, 2> border,
                                      View<const double, 2> to_px, View<const double, 2> rim,
                                      View<const double, 2> inner, const double* pole, double depth,
                                      View<const double, 1> turns, int stride) {
    const int height = free.size(0), width = free.size(1);
    const double scale = std::max(length_of(to_px(0, 0), to_px(0, 1)),
                                  length_of(to_px(1, 0), to_px(1, 1)));
    const double reach = scale * std::max(farthest(rim, pole), farthest(inner, pole));
    if (!(reach < MAX_MARGIN)) throw std::invalid_argument("the part is too large");
    // the frame around the field is wide enough for a part at any place
    const int margin = 2 + static_cast<int>(reach);
    constexpr double FAR = -std::numeric_limits<double>::infinity();
    const int framed = width + 2 * margin;
    const size_t all = static_cast<size_t>(height + 2 * margin) * framed + PLACES;
    std::vector<int16_t> outside(all, is_outside(FAR)), on_rim(all, is_on_rim(FAR));
    std::vector<int> begin(height, width), end(height);  // range of possible places in each row
    for (int j = 0; j < height; j++)
        for (int i = 0; i < width; i++) {
            const int at = (margin + j) * framed + margin + i;
            outside[at] = is_outside(free(j, i));
            on_rim[at] = is_on_rim(border(j, i));
            if (free(j, i) >= depth) begin[j] = std::min(begin[j], i), end[j] = i + 1;
        }
    const int maximum = 2 * MAX_OUTSIDE * inner.size(0);
    std::vector<int16_t> best(height * width), counts(width + PLACES);
    std::vector<int> best_turn(height * width), inner_at(inner.size(0)), rim_at(rim.size(0));
    for (int turn = 0; turn < turns.size(0); turn++) {
        find_offsets(inner, to_px, pole, turns(turn), margin, framed, inner_at);
        find_offsets(rim, to_px, pole, turns(turn), margin, framed, rim_at);
        for (int j = 0; j < height; j += stride) {
            const int count = end[j] - begin[j], first = (margin + j) * framed + margin + begin[j];
            if (count <= 0) continue;
            std::fill_n(counts.begin(), count, 0);
            add_rows(&outside[first], inner_at, counts.data(), count);
            bool fits = false;
            for (int k = 0; k < count; k++) {
                const int i = begin[j] + k;
                const bool tried = i % stride == 0 && free(j, i) >= depth && counts[k] <= maximum;
                counts[k] = tried ? 0 : BARRED;
                fits |= tried;
            }
            if (!fits) continue;
            add_rows(&on_rim[first], rim_at, counts.data(), count);
            for (int k = 0; k < count; k++) {
                const int at = j * width + begin[j] + k;
                if (counts[k] > best[at]) best[at] = counts[k], best_turn[at] = turn;
            }
        }
    }
    const double a = to_px(0, 0), b = to_px(0, 1), c0 = to_px(0, 2);
    const double d = to_px(1, 0), e = to_px(1, 1), f0 = to_px(1, 2);
    const double det = a * e - b * d;
    std::vector<PlaceFound> found;
    for (int j = 0; j < height; j++)
        for (int i = 0; i < width; i++) {
            const int at = j * width + i;
            if (best[at] == 0) continue;
            const double angle = turns(best_turn[at]);
            const double u = (e * (i - c0) - b * (j - f0)) / det;
            const double v = (a * (j - f0) - d * (i - c0)) / det;
            const double c = std::cos(angle), s = std::sin(angle);
            found.push_back({u - c * pole[0] + s * pole[1], v - s * pole[0] - c * pole[1], angle,
                             static_cast<double>(best[at]) / rim.size(0)});
        }
    return found;
}

}  // namespace plate
