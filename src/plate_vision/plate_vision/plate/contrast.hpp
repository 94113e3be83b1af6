// How far pixels are from the bare plate, darker or brighter, in any channel: see contrast.py.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include <plate/view.hpp>
#include <plate/wide.hpp>

#include "plate/light.hpp"

namespace plate {

// Deviation of a pixel from the bare plate, 0 to 1, the largest of all channels: relative to the
// plate; of brighter ones to what is between the plate and white, if that is more.
inline float deviation(const uint8_t* pixel, int channels, View<const float, 2> lights, int x,
                       int y) {
    float most = 0;
    for (int c = 0; c < channels; c++) {
        const float empty = bare(lights[c], x, y), gap = pixel[c] - empty;
        most = std::max(most, gap < 0 ? -gap / empty : gap / std::max(empty, 255 - empty));
    }
    return std::min(most, 1.f);
}

// Write 255 less the deviation, scaled to 255, into a box x0, y0, x1, y1 of an image (h, w).
inline void write_contrast(View<const uint8_t, 3> image, View<const float, 2> lights, int x0, int y0,
                           int x1, int y1, View<uint8_t, 2> out) {
    const int channels = image.size(2);
    for (int y = y0; y < y1; y++) {
        const uint8_t* row = image[y];
        for (int x = x0; x < x1; x++)
            out(y, x) = 255.5f - 255 * deviation(row + channels * x, channels, lights, x, y);
    }
}

// Write 0 within a width [px] of the line between two places [px], on a grid (h, w).
inline void clear_line(View<uint8_t, 2> odd, const std::array<int, 3>& grid, const double* begin,
                       const double* end, double width) {
    const double dx = end[0] - begin[0], dy = end[1] - begin[1];
    const double over = 1 / std::max(dx * dx + dy * dy, 1e-9);
    const auto index = [&](double place, int axis, int last) {
        return std::clamp<int>(std::ceil((place - grid[axis]) / grid[2]), 0, last);
    };
    const int top = index(std::min(begin[1], end[1]) - width, 1, odd.size(0));
    const int bottom = index(std::max(begin[1], end[1]) + width, 1, odd.size(0));
    const int left = index(std::min(begin[0], end[0]) - width, 0, odd.size(1));
    const int right = index(std::max(begin[0], end[0]) + width, 0, odd.size(1));
    for (int row = top; row < bottom; row++) {
        const double y = grid[1] + row * grid[2] - begin[1];
        for (int column = left; column < right; column++) {
            const double x = grid[0] + column * grid[2] - begin[0];
            const double way = std::clamp((x * dx + y * dy) * over, 0.0, 1.0);
            const double gap_x = x - way * dx, gap_y = y - way * dy;
            if (gap_x * gap_x + gap_y * gap_y <= width * width) odd(row, column) = 0;
        }
    }
}

// Write 1 where pixels deviate by more than a limit, 0 elsewhere, on a grid (h, w): of the mean of
// each pixel and its neighbours to the right and below, as the noise of that is half as large.
PLATE_WIDE inline void find_odd(View<const uint8_t, 3> image, View<const float, 2> lights,
                                double limit, const std::array<int, 3>& grid,
                                View<uint8_t, 2> out) {
    const int height = image.size(0), width = image.size(1), channels = image.size(2);
    const int columns = out.size(1), step = grid[2];
    const float low = 1 - limit, high = 1 + limit;
    std::vector<float> means(columns);
    for (int row = 0; row < out.size(0); row++) {
        const int y = grid[1] + row * step, below = std::min(y + 1, height - 1);
        uint8_t* __restrict odd = out[row];
        std::fill_n(odd, columns, 0);
        for (int c = 0; c < channels; c++) {
            const uint8_t *here = image[y] + c, *under = image[below] + c;
            for (int column = 0; column < columns; column++) {
                const int x = channels * (grid[0] + column * step);
                const int right = std::min(x + channels, channels * (width - 1));
                means[column] = 0.25f * (here[x] + here[right] + under[x] + under[right]);
            }
            const float *__restrict mean = means.data(), *__restrict light = lights[c];
#pragma omp simd
            for (int column = 0; column < columns; column++) {
                const float empty = bare(light, grid[0] + column * step, y);
                const bool darker = mean[column] < low * empty;
                const bool brighter = mean[column] > high * empty;
                odd[column] |= darker | brighter;
            }
        }
    }
}

// Whether four neighbours of a grid (h, w) deviate, all of which may count, and none of which is
// within a width (n,) [px] of the lines between `begin` and `end` (n, 2) [px].
inline bool any_odd(View<uint8_t, 2> odd, View<const bool, 2> counts, const std::array<int, 3>& grid,
                    View<const double, 2> begin, View<const double, 2> end, const double* width) {
    for (int k = 0; k < begin.size(0); k++) clear_line(odd, grid, begin[k], end[k], width[k]);
    for (int row = 1; row < odd.size(0); row++) {
        const uint8_t *above = odd[row - 1], *here = odd[row];
        const bool *counts_above = counts[row - 1], *counts_here = counts[row];
        int found = 0;
        for (int column = 1; column < odd.size(1); column++)
            found |= above[column - 1] & above[column] & here[column - 1] & here[column] &
                     counts_above[column] & counts_here[column];
        if (found) return true;
    }
    return false;
}

// Write the median brightness (n,) of the inner parts of discs at places (n, 2) [px] of radii (n,)
// [px], relative to the bare plate: the mean of all channels.
inline void find_brightness(View<const uint8_t, 3> image, View<const float, 2> lights,
                            View<const double, 2> places, const double* radii, double inner,
                            double* out) {
    const int height = image.size(0), width = image.size(1), channels = image.size(2);
    std::vector<float> levels;
    for (int k = 0; k < places.size(0); k++) {
        const double x0 = places(k, 0), y0 = places(k, 1), reach = inner * radii[k];
        levels.clear();
        const int top = std::max<int>(std::ceil(y0 - reach), 0);
        const int left = std::max<int>(std::ceil(x0 - reach), 0);
        for (int y = top; y <= std::min<int>(y0 + reach, height - 1); y++)
            for (int x = left; x <= std::min<int>(x0 + reach, width - 1); x++) {
                if ((x - x0) * (x - x0) + (y - y0) * (y - y0) > reach * reach) continue;
                float level = 0;
                for (int c = 0; c < channels; c++)
                    level += image(y, x, c) / std::max(bare(lights[c], x, y), 1.f);
                levels.push_back(level / channels);
            }
        out[k] = 1;
        if (levels.empty()) continue;
        const auto middle = levels.begin() + levels.size() / 2;
        std::nth_element(levels.begin(), middle, levels.end());
        out[k] = *middle;
    }
}

}  // namespace plate
