// Selection of the parts among measured discs, and the parts' properties: see judge.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <plate/length.hpp>

#include "discs/measure.hpp"
#include "discs/silhouette.hpp"

namespace plate {

// MAX_MISFIT is the maximum misfit of a part. The misfit is the part's deviation from its
// silhouette at the contour. Drawn parts have misfits of 0.02 to 0.05. Parts with a height that is
// not in the rig file have up to 0.2. NOISE_MISFIT times the ratio of the image's noise to the
// part's contrast is added to the maximum. This term allows for the random part of the noise: the
// misfit is computed without the expected noise, but the actual noise of the 50 pixels at a contour
// differs from it.
constexpr double MAX_MISFIT = 0.2, NOISE_MISFIT = 0.5;

// Maximum noise in the calculation of the maximum misfit, relative to the plate's brightness. If
// the measured noise is larger, a texture of the plate is assumed to be its cause.
constexpr double WORST_NOISE = 0.12;

// Maximum misfit that light, noise and the edges of pixels cause. The excess of the misfit over
// this value is about the error of the place, in radii. For example, parts that are 10 mm high but
// are assumed flat have a misfit of 0.18, and their places have errors of 0.15 to 0.2 radii.
constexpr double GOOD_MISFIT = 0.06;

// Minimum visible fraction of a part's contour. With a smaller fraction, the place is not reliable.
constexpr double MIN_SEEN = 0.3;

// Minimum excess of a bright part's brightness over the plate's brightness, as a fraction of the
// plate's brightness. A part that is about as bright as the plate differs from it in colour only.
constexpr double EQUAL = 0.02;

// Limits for the properties of a part: see `DetectorOptions`.
struct Limits {
    double noise, tolerance, class_threshold, margin_px;
};

// Properties of a part, as in `NUMBERS` of judge.py.
struct Judged {
    double x_px, y_px, radius_px, angle_rad, confidence, scatter_px, misfit;
};

// The parts among measured discs (n,): their indices (m,), their labels (m,) (0 black, 1 grey, 2
// bright), and their properties (m,).
struct Parts {
    std::vector<int64_t> rows, labels;
    std::vector<Judged> found;
};

// Select the parts among discs. Input: the discs' silhouettes (n,), the places of their marks (n,
// 2) [px] (NaN without a mark), their brightness relative to the plate (n,), and their distance
// from the plate's edge (n,) [px].
inline Parts judge(const Disc* discs, const Silhouette* parts, View<const double, 2> marks,
                   const double* light, const double* depth, const Limits& limits) {
    Parts kept;
    const double noise = std::min(limits.noise, WORST_NOISE);
    for (int k = 0; k < marks.size(0); k++) {
        const Disc& disc = discs[k];
        const double most =
            MAX_MISFIT + NOISE_MISFIT * noise / std::max(disc.darkness, noise);
        if (!(std::abs(disc.radius_px / parts[k].radius_px - 1) <= limits.tolerance &&
              disc.misfit < most && disc.seen > MIN_SEEN && depth[k] >= -limits.margin_px))
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
                              length_of(disc.scatter_px, odd_px), disc.misfit});
    }
    return kept;
}

}  // namespace plate
