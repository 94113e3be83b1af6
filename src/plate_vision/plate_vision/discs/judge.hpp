// Which measured discs are parts, and what is told of them: see judge.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "discs/measure.hpp"
#include "discs/silhouette.hpp"

namespace plate {

// Largest deviation of a part from its silhouette, at the contour: drawn ones have 0.02 to 0.05,
// those with a height that the rig file does not know up to 0.2. To it this multiple of the image's
// noise over the part's contrast is added: it remains when the mean noise of 50 pixels is
// subtracted.
constexpr double MAX_MISFIT = 0.2, NOISE_MISFIT = 0.5;

// Largest noise, relative to the plate's brightness, that makes up for a misfit: more is a texture
// of the plate.
constexpr double WORST_NOISE = 0.12;

// Misfit that light, noise and the edges of pixels explain. What is beyond, times the radius, is
// about the error of the place: parts 10 mm high that are taken for flat have a misfit of 0.18, and
// are off by 0.15 to 0.2 radii.
constexpr double GOOD_MISFIT = 0.06;

// Least fraction of a part's contour that is seen: of less the place is not sure.
constexpr double LEAST_SEEN = 0.3;

// Brightness relative to the plate within which a part is neither darker nor brighter: its colour
// is another.
constexpr double EQUAL = 0.02;

// By what a part is judged: see `DetectorOptions`.
struct Limits {
    double noise, tolerance, class_threshold, margin_px;
};

// A part, as `NUMBERS` of judge.py.
struct Judged {
    double x_px, y_px, radius_px, angle_rad, confidence, scatter_px, misfit;
};

// Those of measured discs (n,) that are parts: which (m,), what they are (m,), and their labels (m,):
// 0 black, 1 grey, 2 bright.
struct Parts {
    std::vector<int64_t> rows, labels;
    std::vector<Judged> found;
};

// Judge discs by their silhouettes (n,), the places of their marks (n, 2) [px], NaN without one,
// their brightness relative to the plate (n,), and their distance from its edge (n,) [px].
inline Parts judge(const Disc* discs, const Silhouette* parts, View<const double, 2> marks,
                   const double* light, const double* depth, const Limits& limits) {
    Parts kept;
    const double noise = std::min(limits.noise, WORST_NOISE);
    for (int k = 0; k < marks.size(0); k++) {
        const Disc& disc = discs[k];
        const double most =
            MAX_MISFIT + NOISE_MISFIT * noise / std::max(disc.darkness, noise);
        if (!(std::abs(disc.radius_px / parts[k].radius_px - 1) <= limits.tolerance &&
              disc.misfit < most && disc.seen > LEAST_SEEN && depth[k] >= -limits.margin_px))
            continue;
        double top_x, top_y;
        parts[k].to_image(parts[k].lean_px[0], parts[k].lean_px[1], top_x, top_y);
        const double dx = marks(k, 0) - disc.x_px - top_x, dy = marks(k, 1) - disc.y_px - top_y;
        const double angle = std::isnan(dx) ? 0 : std::atan2(-dy, dx);
        const double odd_px = std::max(disc.misfit - GOOD_MISFIT, 0.0) * disc.radius_px;
        kept.rows.push_back(k);
        kept.labels.push_back(light[k] > 1 + EQUAL ? 2 : light[k] >= limits.class_threshold);
        kept.found.push_back({disc.x_px, disc.y_px, disc.radius_px, angle,
                              std::clamp(1 - disc.misfit / most, 0.0, 1.0),
                              std::hypot(disc.scatter_px, odd_px), disc.misfit});
    }
    return kept;
}

}  // namespace plate
