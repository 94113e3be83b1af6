// C++ kernels of marks.py. A mark is a spot beside the centre of a part. The position of the mark
// shows the part's angle.
#pragma once
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "discs/measure.hpp"
#include "discs/silhouette.hpp"

namespace plate {

// Radius of a mark, in units of the part's radius.
constexpr double MARK_RADIUS = 0.3;

// Permitted range of the distance between a mark's centre and the seed, in units of the part's
// radius. The seed is the estimated centre of the part. The nominal distance is 0.5. The range also
// allows for the position error of the seed.
constexpr double MARK_PLACE[] = {0.25, 0.75};

// Permitted range of a mark's area, relative to the area of a disc with `MARK_RADIUS`. Smaller
// spots are noise, and larger spots are other objects.
constexpr double MARK_AREA[] = {0.5, 1.6};

// Maximum distance between a mark's centre and the pixels that belong to the mark, in units of the
// mark's radius. This maximum includes the mark's blurred edge, but not the part's edge.
constexpr double MARK_REACH = 1.5;

// Minimum difference between the brightness of a mark and of its part, relative to the part's
// darkness. The contrast of a grey mark on a black part is 0.5. The contrast of a black mark on a
// grey part is 1.
constexpr double CONTRAST = 0.3;

// Minimum contrast of a mark, relative to the standard deviation of the image's noise.
constexpr double MARK_SIGMAS = 6;

// A pixel belongs to a mark if the pixel deviates from the part's grey level by more than this
// fraction of the mark's contrast. Smaller deviations count as noise. For a noise of 2 grey levels,
// this limit is five standard deviations.
constexpr double MARK_NOISE = 0.25;

// Maximum brightness of a mark, relative to the bare plate. A brighter spot counts as a highlight.
constexpr double SHINE = 0.85;

// Number of iterations that compute the mark's centre. Each iteration computes the centroid of the
// pixels around the previous centre.
constexpr int ROUNDS = 4;

// The rectangle of pixels that contains a round spot: ranges of rows and columns. The ends are
// excluded.
struct Box {
    int top, bottom, left, right;

    Box(View<const uint8_t, 2> grey, double x, double y, double reach)
        : top(std::max(0, static_cast<int>(y - reach))),
          bottom(std::min(grey.size(0), static_cast<int>(y + reach) + 2)),
          left(std::max(0, static_cast<int>(x - reach))),
          right(std::min(grey.size(1), static_cast<int>(x + reach) + 2)) {}
};

// Returns the median of numbers. The function changes the order of the numbers.
inline double median(std::vector<double>& numbers) {
    const auto middle = numbers.begin() + numbers.size() / 2;
    std::nth_element(numbers.begin(), middle, numbers.end());
    if (numbers.size() % 2) return *middle;
    return (*std::max_element(numbers.begin(), middle) + *middle) / 2;
}

// Detect the marks on parts. `found` (n, 2) receives the positions of the marks [px], or NaN for a
// part without a mark. `level` (n, 2) receives the part's grey level and the mark's contrast.
// `noise` is the image noise as a fraction of the bare plate's brightness.
inline void find_marks(const LitPlate& plate, View<const double, 2> seeds, const double* radii,
                       double noise, View<double, 2> found, View<double, 2> level) {
    std::vector<double> inner;
    for (int i = 0; i < seeds.size(0); i++) {
        const double radius = radii[i], mark = MARK_RADIUS * radius, core = CORE * radius;
        const int size = static_cast<int>(core) + 1;
        const double u = seeds(i, 0), v = seeds(i, 1);
        found(i, 0) = found(i, 1) = NAN;
        level(i, 0) = level(i, 1) = 0;
        inner.clear();
        const int bottom = std::min(plate.height(), static_cast<int>(v) + size + 2);
        const int right = std::min(plate.width(), static_cast<int>(u) + size + 2);
        for (int r = std::max(0, static_cast<int>(v) - size); r < bottom; r++)
            for (int c = std::max(0, static_cast<int>(u) - size); c < right; c++)
                if ((c - u) * (c - u) + (r - v) * (r - v) <= core * core)
                    inner.push_back(plate.grey(r, c));
        if (inner.empty()) continue;
        const double empty = bare(plate.light.data, u, v);
        const auto [darkest, lightest] = std::minmax_element(inner.begin(), inner.end());
        const double below = *darkest, above = *lightest;
        const double clear = MARK_SIGMAS * noise * empty;
        // This check is done first, because it is fast: it does not need the median.
        if (above - below < std::max(CONTRAST * (empty - above), clear)) continue;
        const double part = median(inner);
        const double contrast = above - part > part - below ? above - part : below - part;
        if (std::abs(contrast) < std::max(CONTRAST * std::abs(empty - part), clear)) continue;
        double x = u, y = v, mass = 0;
        for (int turn = 0; turn < ROUNDS; turn++) {
            // Only pixels whose `excess` is above MARK_NOISE are used. The first iteration uses
            // such pixels within `core` [px] of the part's centre. The other iterations use only
            // such pixels near the last centre of the mark.
            const double reach = turn == 0 ? core : MARK_REACH * mark, at_x = x, at_y = y;
            const Box box(plate.grey, at_x, at_y, reach);
            x = y = 0, mass = 1e-9;
            for (int r = box.top; r < box.bottom; r++)
                for (int c = box.left; c < box.right; c++) {
                    const double excess = (plate.grey(r, c) - part) / contrast;
                    const double dx = c - at_x, dy = r - at_y;
                    if (excess > MARK_NOISE && dx * dx + dy * dy <= reach * reach) {
                        mass += excess;
                        x += excess * c;
                        y += excess * r;
                    }
                }
            x /= mass, y /= mass;
        }
        const double place = std::sqrt((x - u) * (x - u) + (y - v) * (y - v));
        const double area = mass / (std::numbers::pi * (mark * mark));
        if (MARK_PLACE[0] * radius <= place && place <= MARK_PLACE[1] * radius &&
            MARK_AREA[0] <= area && area <= MARK_AREA[1]) {
            found(i, 0) = x, found(i, 1) = y;
            level(i, 0) = part, level(i, 1) = contrast;
        }
    }
}

// Paint over a mark at (x, y) [px] with the grey level of its part. `level` contains this grey
// level and the contrast of the mark.
inline void paint_mark(View<uint8_t, 2> grey, double x, double y, const double* level,
                       double radius) {
    const double reach = MARK_REACH * MARK_RADIUS * radius;
    const Box box({grey.data, grey.shape}, x, y, reach);
    for (int r = box.top; r < box.bottom; r++)
        for (int c = box.left; c < box.right; c++) {
            const bool beside = (c - x) * (c - x) + (r - y) * (r - y) > reach * reach;
            if (!beside && (grey(r, c) - level[0]) / level[1] > 0)
                grey(r, c) = static_cast<uint8_t>(level[0]);
        }
}

// Detect the marks on the top faces of parts at seeds (n, 2) [px]. `marks` (n, 2) receives the
// positions of the marks [px]. Return the image with the marks painted over, or an empty result if
// there are no marks. A highlight is a spot that is about as bright as the plate or brighter.
// Highlights are painted over, too, but their positions are NaN because they are not marks.
inline std::vector<uint8_t> without_marks(const LitPlate& plate, double noise,
                                          View<const double, 2> seeds, const Silhouette* parts,
                                          View<double, 2> marks) {
    const int count = seeds.size(0);
    std::vector<double> tops(2 * count), radii(count), levels(2 * count);
    for (int k = 0; k < count; k++) {
        parts[k].to_image(parts[k].lean_px[0], parts[k].lean_px[1], tops[2 * k], tops[2 * k + 1]);
        tops[2 * k] += seeds(k, 0), tops[2 * k + 1] += seeds(k, 1);
        radii[k] = parts[k].growth * parts[k].radius_px;
    }
    const View<double, 2> level{levels.data(), {count, 2}};
    find_marks(plate, {tops.data(), {count, 2}}, radii.data(), noise, marks, level);
    std::vector<uint8_t> painted;
    for (int k = 0; k < count; k++) {
        if (std::isnan(marks(k, 0))) continue;
        if (painted.empty())
            painted.assign(plate.grey.data, plate.grey.data + plate.height() * plate.width());
        paint_mark({painted.data(), plate.grey.shape}, marks(k, 0), marks(k, 1), level[k], radii[k]);
        const double light = bare(plate.light.data, marks(k, 0), marks(k, 1));
        if (level(k, 0) + level(k, 1) > SHINE * light) marks(k, 0) = marks(k, 1) = NAN;
    }
    return painted;
}

}  // namespace plate
