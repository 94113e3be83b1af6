// The region of the plate in an image: see region.py.
#pragma once
#include <algorithm>
#include <limits>

#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

// Minimum distance of a usable pixel from the plate's edge [px]. Nearer pixels show both the plate
// and its surround.
constexpr double SEAM_PX = 1;

// Maximum distance from the middle of an edge at which the polynomial of a bent edge is evaluated
// [half lengths of the edge]. At larger distances, the polynomial is continued by a constant.
constexpr double BOW_REACH = 1.05;

// Compute `Region.depth` (count,) of points: their distance from the nearest edge [px]. It is
// negative outside the region.
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
