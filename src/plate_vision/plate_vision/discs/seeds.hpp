// C++ kernels of seeds.py, which estimates the centres of the parts in an image. The estimated
// centres are called seeds.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <vector>

#include "discs/silhouette.hpp"
#include "plate/light.hpp"

namespace plate {

// Minimum gradient of the darkness [1/px] at an edge, computed by the Sobel operator. This minimum
// is seven times the gradient that noise causes.
constexpr double MIN_SLOPE = 0.03;

// In a Hough transform, the edges vote for the centres of parts. MIN_VOTES is the minimum number of
// votes for a part, relative to the votes of a complete contour. The first value applies near
// another centre, the second value elsewhere. With the second value, the middle part of seven
// touching parts is detected, although only short, blurred sections of its contour are visible.
constexpr double MIN_VOTES[] = {0.12, 0.02};

// Minimum darkness by which a vote is divided. This minimum prevents large votes for bright places.
constexpr double MIN_TARGET = 0.1;

// Minimum distance between two centres, in units of the part's radius. The first value always
// applies. The second value applies to centres with fewer votes than MIN_VOTES[0]. The centres of
// touching parts have a distance of 2. The point in the middle of four parts in a square has a
// distance of 1.4 from their centres.
constexpr double SEPARATION[] = {1.3, 1.6};

// A coarse grid of pixels: position of its first pixel, and distance between its pixels [px].
struct Grid {
    int x, y, step;
};

// For each pixel of the grid, set `dark` (h, w) to 1 or 0. The value is 1 if the pixel is outside
// the plate, or darker than `threshold` times the brightness of the bare plate.
PLATE_WIDE inline void find_dark(const LitPlate& plate, double threshold, Grid grid,
                                 View<const bool, 2> outside, View<uint8_t, 2> dark) {
    float light[9];
    std::copy_n(plate.light.data, 9, light);
    for (int term = 0; term < TERMS; term++) light[term] *= static_cast<float>(threshold);
    const int columns = dark.size(1);
    std::vector<float> levels(columns), places(columns);
    std::vector<int> found(columns);
    float *__restrict level = levels.data(), *__restrict x = places.data();
    int* __restrict is_dark = found.data();
    for (int column = 0; column < columns; column++) x[column] = grid.x + column * grid.step;
    for (int row = 0; row < dark.size(0); row++) {
        const int y = grid.y + row * grid.step;
        const uint8_t* grey = plate.grey[y] + grid.x;
        for (int column = 0; column < columns; column++) level[column] = grey[column * grid.step];
        const bool* no_plate = outside[row];
        uint8_t* out = dark[row];
#pragma omp simd
        for (int column = 0; column < columns; column++)
            is_dark[column] = level[column] < bare(light, x[column], y);
        for (int column = 0; column < columns; column++)
            out[column] = is_dark[column] | static_cast<int>(no_plate[column]);
    }
}

// A blob of connected pixels: centre x, y, number of pixels, and bounding box x0, x1, y0, y1. The
// ends x1 and y1 are excluded.
struct Blob {
    double x, y, size, x0, x1, y0, y1;
};

// Return the blobs of connected pixels that are true in `core` (h, w). Before the call, `number`
// (h, w) must be 0. The function sets `number` to the number of each pixel's blob, from 1 on. The
// function sets all pixels of `core` to false.
inline std::vector<Blob> find_blobs(View<bool, 2> core, View<int32_t, 2> number) {
    const int height = core.size(0), width = core.size(1);
    struct Pixel {
        int x, y;
    };
    std::vector<Pixel> pixels;
    std::vector<Blob> found;
    const bool* end = core.data + static_cast<size_t>(height) * width;
    const auto next = [&](const bool* from) {
        return static_cast<bool*>(std::memchr(const_cast<bool*>(from), true, end - from));
    };
    for (bool* first = next(core.data); first; first = next(first)) {
        const int place = first - core.data;
        *first = false;
        pixels.assign(1, {place % width, place / width});
        for (size_t done = 0; done < pixels.size(); done++) {
            const Pixel at = pixels[done];
            const int bottom = std::min(at.y + 2, height), right = std::min(at.x + 2, width);
            for (int row = std::max(at.y - 1, 0); row < bottom; row++)
                for (int column = std::max(at.x - 1, 0); column < right; column++)
                    if (core(row, column)) {
                        core(row, column) = false;
                        pixels.push_back({column, row});
                    }
        }
        const double size = pixels.size();
        const int32_t own = found.size() + 1;
        int64_t x = 0, y = 0, x0 = width, x1 = 0, y0 = height, y1 = 0;
        for (const Pixel& pixel : pixels) {
            x += pixel.x, y += pixel.y;
            x0 = std::min<int64_t>(x0, pixel.x), x1 = std::max<int64_t>(x1, pixel.x + 1);
            y0 = std::min<int64_t>(y0, pixel.y), y1 = std::max<int64_t>(y1, pixel.y + 1);
            number(pixel.y, pixel.x) = own;
        }
        found.push_back({x / size, y / size, size, static_cast<double>(x0), static_cast<double>(x1),
                         static_cast<double>(y0), static_cast<double>(y1)});
    }
    return found;
}

// Hough transform. Each pixel at an edge votes for the centre of the part to whose silhouette the
// edge may belong. The first pixel of `votes` (h, w) is the pixel (x0, y0) of the image.
//
// The weight of a vote is the gradient at the edge, divided by the darkness at the centre for which
// the pixel votes. With this weight, the sum of the votes of a complete contour is its length [px],
// independent of blur.
inline void vote(const LitPlate& plate, int x0, int y0, const Silhouette& part,
                 View<float, 2> votes) {
    const int height = plate.height(), width = plate.width();
    const int rows = votes.size(0), columns = votes.size(1);
    for (int y = std::max(y0, 1); y < std::min(y0 + rows, height - 1); y++) {
        const uint8_t *above = plate.grey[y - 1], *here = plate.grey[y], *below = plate.grey[y + 1];
        const bool *usable_above = plate.usable[y - 1], *usable_below = plate.usable[y + 1];
        for (int x = std::max(x0, 1); x < std::min(x0 + columns, width - 1); x++) {
            const int a = above[x - 1], b = above[x], c = above[x + 1];
            const int d = here[x - 1], f = here[x + 1];
            const int g = below[x - 1], h = below[x], i = below[x + 1];
            const int right = a + 2 * d + g - c - 2 * f - i, down = a + 2 * b + c - g - 2 * h - i;
            const float rise = std::sqrt(static_cast<float>(right * right + down * down));
            const double light = 8.0 * bare(plate.light.data, x, y);
            if (rise < MIN_SLOPE * light) continue;
            if (!usable_above[x - 1] || !usable_above[x + 1]) continue;
            if (!usable_below[x - 1] || !usable_below[x + 1]) continue;
            double from_x, from_y;
            part.contour(-right, -down, from_x, from_y);
            const int to_x = std::rint(x - from_x), to_y = std::rint(y - from_y);
            if (to_x < x0 || to_x >= x0 + columns || to_y < y0 || to_y >= y0 + rows) continue;
            const uint8_t target =
                plate.grey(std::clamp(to_y, 0, height - 1), std::clamp(to_x, 0, width - 1));
            const double dark = 1 - target / light * 8;
            votes(to_y - y0, to_x - x0) += rise / light / std::max(dark, MIN_TARGET);
        }
    }
}

// Returns the squared distance [px^2] of a point from the nearest of `count` centres [px].
inline double nearest(const double* centres, int count, double x, double y) {
    double minimum = std::numeric_limits<double>::infinity();
    for (int k = 0; k < count; k++) {
        const double dx = centres[2 * k] - x, dy = centres[2 * k + 1] - y;
        minimum = std::min(minimum, dx * dx + dy * dy);
    }
    return minimum;
}

// Returns the centres x, y (n, 2) [px] of parts, in decreasing order of their votes. The first
// pixel of `votes` (h, w) is the pixel (x0, y0) of the image. Centres are searched only in grid
// cells where `merged` (rows, columns of the grid) is true. The distances between pixels with a
// maximum are above the limits in `SEPARATION`. Afterwards, each centre is corrected by less than a
// pixel.
inline std::vector<double> find_peaks(View<const float, 2> votes, int x0, int y0,
                                      View<const bool, 2> merged, const Grid& grid, double radius) {
    const double rim = 2 * std::numbers::pi * radius;
    const int rows = votes.size(0), columns = votes.size(1);
    struct Place {
        double count;
        int x, y;
    };
    std::vector<Place> places;
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++) {
            if (!(votes(y, x) > MIN_VOTES[1] * rim)) continue;
            const int right = x + x0 - grid.x, down = y + y0 - grid.y;
            const int row = down / grid.step, column = right / grid.step;
            if (right >= 0 && down >= 0 && row < merged.size(0) && column < merged.size(1) &&
                merged(row, column))
                places.push_back({votes(y, x), x, y});
        }
    std::vector<double> found;
    const double apart = SEPARATION[0] * radius * (SEPARATION[0] * radius);
    const double far = SEPARATION[1] * radius * (SEPARATION[1] * radius);
    const auto fewer = [](const Place& a, const Place& b) { return a.count < b.count; };
    while (!places.empty()) {
        const auto best = std::max_element(places.begin(), places.end(), fewer);
        const auto [count, x, y] = *best;
        if (count <= 0) break;
        best->count = 0;
        if (count < MIN_VOTES[0] * rim &&
            nearest(found.data(), found.size() / 2, x + x0, y + y0) < far)
            continue;
        // The centre is the weighted mean of the pixels at the maximum that have more than half of
        // its votes.
        double weight = 0, sx = 0, sy = 0;
        for (int j = std::max(y - 1, 0); j < std::min(y + 2, rows); j++)
            for (int i = std::max(x - 1, 0); i < std::min(x + 2, columns); i++) {
                const double more = std::max(votes(j, i) - 0.5 * votes(y, x), 0.0);
                weight += more;
                sx += more * i;
                sy += more * j;
            }
        found.insert(found.end(), {x0 + sx / weight, y0 + sy / weight});
        for (Place& place : places) {
            const int dx = place.x - x, dy = place.y - y;
            if (dx * dx + dy * dy <= apart) place.count = 0;
        }
    }
    return found;
}

}  // namespace plate
