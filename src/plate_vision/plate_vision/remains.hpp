// C++ kernels of remains.py, which detects objects on the plate that are not parts.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "discs/silhouette.hpp"
#include "plate/contrast.hpp"

namespace plate {

// Width [px] of a part's blurred edge. Pixels within this distance of a part belong to the part.
constexpr double CLEAR_PX = 2.5;

// Set the pixels of a grid `deviating` (h, w) to 0 where there are parts. `parts` (n,) are the
// silhouettes of the parts at `places` (n, 2) [px].
inline void clear_parts(View<uint8_t, 2> deviating, const std::array<int, 3>& grid,
                        View<const double, 2> places, const Silhouette* parts) {
    for (int k = 0; k < places.size(0); k++) {
        // `width` is the maximum distance between a point of the part and the line from the part's
        // place to the middle of its top.
        const double x0 = places(k, 0), y0 = places(k, 1);
        double dx, dy;
        parts[k].to_image(parts[k].lean_px[0], parts[k].lean_px[1], dx, dy);
        const double square = dx * dx + dy * dy, over = 1 / std::max(square, 1e-9);
        const double width = parts[k].reach() + CLEAR_PX - std::sqrt(square);
        const auto index = [&](double place, int axis) {
            return std::clamp<int>(std::ceil((place - grid[axis]) / grid[2]), 0,
                                   deviating.size(1 - axis));
        };
        const int top = index(y0 + std::min(dy, 0.0) - width, 1);
        const int bottom = index(y0 + std::max(dy, 0.0) + width, 1);
        const int left = index(x0 + std::min(dx, 0.0) - width, 0);
        const int right = index(x0 + std::max(dx, 0.0) + width, 0);
        for (int row = top; row < bottom; row++) {
            const double y = grid[1] + row * grid[2] - y0;
            for (int column = left; column < right; column++) {
                const double x = grid[0] + column * grid[2] - x0;
                const double way = std::clamp((x * dx + y * dy) * over, 0.0, 1.0);
                const double gap_x = x - way * dx, gap_y = y - way * dy;
                if (gap_x * gap_x + gap_y * gap_y <= width * width) deviating(row, column) = 0;
            }
        }
    }
}

// Whether any four neighbouring pixels of a grid deviate from the bare plate by more than a limit.
// Pixels of parts are ignored. Only pixels that are true in `counts` (h, w) are evaluated. `parts`
// (n,) are the silhouettes of the parts at `places` (n, 2) [px].
inline bool any_deviating(View<const uint8_t, 3> image, View<const float, 2> lights, double limit,
                    View<const bool, 2> counts, const std::array<int, 3>& grid,
                    View<const double, 2> places, const Silhouette* parts) {
    const int rows = counts.size(0), columns = counts.size(1);
    std::vector<uint8_t> pixels(static_cast<size_t>(rows) * columns);
    const View<uint8_t, 2> deviating{pixels.data(), counts.shape};
    find_deviating(image, lights, limit, grid, deviating);
    clear_parts(deviating, grid, places, parts);
    for (int row = 1; row < rows; row++) {
        const uint8_t *above = deviating[row - 1], *here = deviating[row];
        const bool *counts_above = counts[row - 1], *counts_here = counts[row];
        int found = 0;
        for (int column = 1; column < columns; column++)
            found |= above[column - 1] & above[column] & here[column - 1] & here[column] &
                     counts_above[column] & counts_here[column];
        if (found) return true;
    }
    return false;
}

}  // namespace plate
