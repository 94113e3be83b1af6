// C++ kernels of contrast.py, which computes how much pixels deviate from the bare plate. Pixels
// may be darker or brighter than the plate in any channel.
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

// Returns the deviation of a pixel from the bare plate, from 0 to 1. The deviation is the maximum
// over the channels. If the pixel is darker than the plate, the difference is divided by the
// plate's level. If the pixel is brighter, the difference is divided by the plate's level or by 255
// minus this level, whichever is larger.
inline float deviation(const uint8_t* pixel, int channels, View<const float, 2> lights, int x,
                       int y) {
    float maximum = 0;
    for (int c = 0; c < channels; c++) {
        const float empty = bare(lights[c], x, y), gap = pixel[c] - empty;
        maximum = std::max(maximum, gap < 0 ? -gap / empty : gap / std::max(empty, 255 - empty));
    }
    return std::min(maximum, 1.f);
}

// Write 255 (1 - deviation) to the pixels of an image (h, w) within a box x0, y0, x1, y1.
inline void write_contrast(View<const uint8_t, 3> image, View<const float, 2> lights, int x0, int y0,
                           int x1, int y1, View<uint8_t, 2> out) {
    const int channels = image.size(2);
    for (int y = y0; y < y1; y++) {
        const uint8_t* row = image[y];
        for (int x = x0; x < x1; x++)
            out(y, x) = 255.5f - 255 * deviation(row + channels * x, channels, lights, x, y);
    }
}

// Set each pixel of a grid (h, w) to 1 if it deviates from the bare plate by more than a limit, and
// to 0 otherwise. The function uses the mean of each pixel and its three neighbours to the right
// and below. The noise of this mean is half as large as the noise of a pixel.
PLATE_WIDE inline void find_deviating(View<const uint8_t, 3> image, View<const float, 2> lights,
                                double limit, const std::array<int, 3>& grid,
                                View<uint8_t, 2> out) {
    const int height = image.size(0), width = image.size(1), channels = image.size(2);
    const int columns = out.size(1), stride = channels * grid[2];
    const float low = 1 - limit, high = 1 + limit;
    // `whole` is the number of columns that have a neighbour to the right. The last column of the
    // image has no such neighbour.
    const int whole = grid[0] + (columns - 1) * grid[2] + 1 < width ? columns : columns - 1;
    std::vector<float> means(columns), places(columns);
    std::vector<int> found(columns);
    float *__restrict mean = means.data(), *__restrict x = places.data();
    int* __restrict deviating = found.data();
    for (int column = 0; column < columns; column++) x[column] = grid[0] + column * grid[2];
    for (int row = 0; row < out.size(0); row++) {
        const int y = grid[1] + row * grid[2];
        std::fill_n(deviating, columns, 0);
        for (int c = 0; c < channels; c++) {
            const uint8_t* here = image[y] + channels * grid[0] + c;
            const uint8_t* under = y + 1 < height ? here + channels * width : here;
            for (int column = 0, at = 0; column < whole; column++, at += stride)
                mean[column] =
                    0.25f * (here[at] + here[at + channels] + under[at] + under[at + channels]);
            if (whole < columns)
                mean[whole] = 0.5f * (here[stride * whole] + under[stride * whole]);
            const float* light = lights[c];
#pragma omp simd
            for (int column = 0; column < columns; column++) {
                const float empty = bare(light, x[column], y);
                deviating[column] |= (mean[column] < low * empty) | (mean[column] > high * empty);
            }
        }
        std::copy_n(deviating, columns, out[row]);
    }
}

// Write the median brightness of discs to `out` (n,). The discs are at places (n, 2) [px] and have
// radii (n,) [px]. The brightness is relative to the bare plate and averaged over the channels.
// Only pixels within `inner` times the radius are used.
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
