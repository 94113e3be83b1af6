// C++ kernels of region.py, which describes the region of an image that shows the plate.
#pragma once
#include <algorithm>
#include <limits>

#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

// Minimum distance of a usable pixel from the plate's edge [px]. Pixels that are nearer to the edge
// show both the plate and the surround of the plate.
constexpr double SEAM_PX = 1;

// A polynomial describes an edge that the lens bends. The polynomial is evaluated up to this
// distance from the middle of the edge, in units of half the edge's length. Beyond this distance,
// its value is constant.
constexpr double BOW_REACH = 1.05;

// Compute the distance of each point from the nearest edge of the region [px]. The distance is
// negative outside the region. `Region.depth` describes the method.
PLATE_WIDE inline void region_depth(View<const double, 2> edges, View<const double, 2> bows,
                                    const double* __restrict x, const double* __restrict y,
                                    int count, double* __restrict depth) {
    std::fill_n(depth, count, std::numeric_limits<double>::infinity());
    for (int e = 0; e < edges.size(0); e++) {
        const double *edge = edges[e], *bow = bows.size(0) ? bows[e] : nullptr;
#pragma omp simd
        for (int i = 0; i < count; i++) {
            double inside = edge[0] * x[i] + edge[1] * y[i] + edge[2];
            if (bow) {
                double place = bow[0] + bow[1] * x[i] + bow[2] * y[i];
                place = std::min(std::max(place, -BOW_REACH), BOW_REACH);
                double bent = 0;
                for (int k = 3; k < bows.size(1); k++) bent = bent * place + bow[k];
                inside -= bent;
            }
            depth[i] = std::min(depth[i], inside);
        }
    }
}

}  // namespace plate
