// Conversion and check of Python arrays that are arguments of the vision kernels. The shapes are
// checked, so that no kernel accesses memory outside an array.
#pragma once
#include <array>
#include <stdexcept>

#include <plate/bind.hpp>

#include "plate/light.hpp"

namespace plate {

template <class T, nb::ssize_t N>
using In = Array<const T, N>;

inline void require(bool right, const char* what) {
    if (!right) throw std::invalid_argument(what);
}

// Whether arrays have the same size along their first two axes.
template <class First, class... Others>
bool same_pixels(const First& first, const Others&... others) {
    return ((others.shape(0) == first.shape(0) && others.shape(1) == first.shape(1)) && ...);
}

inline LitPlate lit_plate(const In<uint8_t, 2>& grey, const In<float, 1>& light,
                          const In<bool, 2>& usable) {
    require(light.shape(0) == 9 && same_pixels(grey, usable),
            "shapes: grey and usable (H, W), light (9,)");
    return {view(grey), view(light), view(usable)};
}

// Throw an error if the arrays that describe the edges of a region have wrong shapes. region.py
// describes these arrays.
inline void require_edges(const In<double, 2>& edges, const In<double, 2>& bows) {
    require(edges.shape(1) == 3 && bows.shape(1) >= 3 &&
                (bows.shape(0) == 0 || bows.shape(0) == edges.shape(0)),
            "shapes: edges (n, 3), bows (n, >= 3) or none");
}

// Throw an error unless `lights` contains nine numbers for each channel of an image (h, w, c).
inline void require_lights(const In<uint8_t, 3>& image, const In<float, 2>& lights) {
    require(lights.shape(0) == image.shape(2) && lights.shape(1) == 9 && image.shape(0) > 0 &&
                image.shape(1) > 0,
            "shapes: image (h, w, c), lights (c, 9)");
}

// Throw an error unless a grid with these numbers of rows and columns is inside an image (h, w,
// ...).
template <class Image>
void require_grid(const std::array<int, 3>& grid, int64_t rows, int64_t columns,
                  const Image& image) {
    require(grid[0] >= 0 && grid[1] >= 0 && grid[2] > 0 && rows > 0 && columns > 0 &&
                grid[0] + (columns - 1) * grid[2] < static_cast<int64_t>(image.shape(1)) &&
                grid[1] + (rows - 1) * grid[2] < static_cast<int64_t>(image.shape(0)),
            "grid: allowed: inside the image");
}

}  // namespace plate
