// C++ kernels of dark.py: measurement of round parts that are clearly darker than the plate.
// Isolated parts are measured by a fast method, all other parts by a fit of the contour.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "discs/fit.hpp"
#include "discs/marks.hpp"
#include "discs/measure.hpp"
#include "plate/region.hpp"

namespace plate {

// Width [px] of a part's blurred edge outside its contour. Up to this distance, a neighbouring part
// affects the pixels of a window.
constexpr double BLUR_PX = 1.5;

// A silhouette counts as round if the distance of its farthest point from the centre is below this
// multiple of its radius. The silhouette of a flat part has this ratio if the camera's line of
// sight to the part is 34 degrees from vertical.
constexpr double ROUND = 1.2;

// Maximum dark area [px2] in the outer ring of the pixel window around a single part. Twice this
// area would shift the measured centre of a part with a radius of 8 px by 0.05 px.
constexpr double RIM_DIRT_PX2 = 0.5;

// Maximum misfit of a part that is measured by moments of the darkness. With a larger misfit, the
// part is not evenly dark.
constexpr double EVEN_MISFIT = 0.06;

// Returns the distances (n,) [px] of image points (n, >= 2) [px] from the plate's edge. The
// distances are negative outside the plate.
inline std::vector<double> depths(View<const double, 2> edges, View<const double, 2> bows,
                                  View<const double, 2> places) {
    const int count = places.size(0);
    std::vector<double> x(count), y(count), depth(count);
    for (int k = 0; k < count; k++) x[k] = places(k, 0), y[k] = places(k, 1);
    region_depth(edges, bows, x.data(), y.data(), count, depth.data());
    return depth;
}

// Measure discs (n,) at seeds (n, 2) [px]. `parts` (n,) are the silhouettes of parts at the seeds.
// `alone` (n,) is set to true for discs that are measured by moments. `marks` (n, 2) receives the
// positions of the marks on the discs [px]. `noise` is the standard deviation of the image noise,
// as a fraction of the bare plate's brightness.
inline void measure_dark(LitPlate plate, double noise, View<const double, 2> edges,
                         View<const double, 2> bows, View<const double, 2> seeds,
                         const Silhouette* parts, Disc* discs, View<double, 2> marks, bool* alone) {
    const int count = seeds.size(0);
    const std::vector<uint8_t> painted = without_marks(plate, noise, seeds, parts, marks);
    if (!painted.empty()) plate.grey.data = painted.data();
    std::vector<double> reach(count), dirt(count, std::numeric_limits<double>::infinity());
    for (int k = 0; k < count; k++) reach[k] = parts[k].reach();
    const double near = 2 * *std::max_element(reach.begin(), reach.end()) + RIM_PX + BLUR_PX;
    crowded(seeds, near, alone);
    const std::vector<double> depth = depths(edges, bows, seeds);
    for (int k = 0; k < count; k++)
        alone[k] = !alone[k] && depth[k] - SEAM_PX >= reach[k] + RIM_PX + 1 &&
                   parts[k].growth == 1 && reach[k] < ROUND * parts[k].radius_px;
    measure_alone(plate, seeds, parts, alone, discs, dirt.data());
    std::vector<int> others;
    std::vector<double> places;
    std::vector<Silhouette> shapes;
    for (int k = 0; k < count; k++) {
        alone[k] &= dirt[k] <= RIM_DIRT_PX2 * discs[k].darkness && discs[k].misfit < EVEN_MISFIT;
        if (alone[k]) continue;
        others.push_back(k);
        places.insert(places.end(), {seeds(k, 0), seeds(k, 1)});
        shapes.push_back(parts[k]);
    }
    const int rest = others.size();
    std::vector<Disc> fitted(rest);
    fit_discs(plate, {places.data(), {rest, 2}}, shapes.data(), {}, noise, fitted.data());
    for (int i = 0; i < rest; i++) discs[others[i]] = fitted[i];
}

}  // namespace plate
