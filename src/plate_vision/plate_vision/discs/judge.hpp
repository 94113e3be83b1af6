// C++ kernels of judge.py, which decides which measured discs are parts, and computes the
// properties of these parts.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <plate/length.hpp>

#include "discs/measure.hpp"
#include "discs/silhouette.hpp"

namespace plate {

// MAX_MISFIT is the maximum misfit of a part. The misfit is the deviation of the image from the
// part's expected silhouette, near the contour. In simulated images, parts have misfits of 0.02 to
// 0.05. If a part has a height that is not in the rig file, its misfit can be 0.2. The limit is
// larger in noisy images: NOISE_MISFIT times the ratio of image noise to the part's contrast is
// added. The misfit is already computed without the expected noise. However, the actual noise of
// about 50 pixels at a contour differs from the expected noise.
constexpr double MAX_MISFIT = 0.2, NOISE_MISFIT = 0.5;

// Maximum image noise that is used for the maximum misfit, as a fraction of the plate's brightness.
// A larger measured noise is probably a texture of the plate.
constexpr double WORST_NOISE = 0.12;

// Maximum misfit that light, noise and the pixel grid cause. If the misfit is larger, the
// difference is about the position error of the part, in units of its radius. For example, parts
// that are 10 mm high but are described as flat have a misfit of 0.18. The position errors of these
// parts are 0.15 to 0.2 radii.
constexpr double GOOD_MISFIT = 0.06;

// Minimum visible fraction of a part's contour. With a smaller fraction, the measured position is
// not reliable.
constexpr double MIN_SEEN = 0.3;

// A part counts as bright if its brightness exceeds the plate's brightness by at least this
// fraction. A part that is about as bright as the plate differs from the plate only in colour.
constexpr double EQUAL = 0.02;

// Limits for the properties of a part. `DetectorOptions` describes the fields.
struct Limits {
    double noise, tolerance, class_threshold, margin_px;
};

// Properties of a part. `NUMBERS` in judge.py describes the fields.
struct Judged {
    double x_px, y_px, radius_px, angle_rad, confidence, scatter_px, misfit;
};

// The discs that are parts: indices of the discs (m,), labels (m,) (0: black, 1: grey, 2: bright),
// and properties (m,).
struct Parts {
    std::vector<int64_t> rows, labels;
    std::vector<Judged> found;
};

// Select the discs (n,) that are parts. The inputs are:
// - parts (n,): silhouettes of parts at the discs
// - marks (n, 2): positions of the marks on the discs [px], NaN without a mark
// - light (n,): brightness of the discs, relative to the plate
// - depth (n,): distance of the discs from the plate's edge [px]
inline Parts judge(const Disc* discs, const Silhouette* parts, View<const double, 2> marks,
                   const double* light, const double* depth, const Limits& limits) {
    Parts kept;
    const double noise = std::min(limits.noise, WORST_NOISE);
    for (int k = 0; k < marks.size(0); k++) {
        const Disc& disc = discs[k];
        const double maximum =
            MAX_MISFIT + NOISE_MISFIT * noise / std::max(disc.darkness, noise);
        if (!(std::abs(disc.radius_px / parts[k].radius_px - 1) <= limits.tolerance &&
              disc.misfit < maximum && disc.seen > MIN_SEEN && depth[k] >= -limits.margin_px))
            continue;
        double top_x, top_y;
        parts[k].to_image(parts[k].lean_px[0], parts[k].lean_px[1], top_x, top_y);
        const double dx = marks(k, 0) - disc.x_px - top_x, dy = marks(k, 1) - disc.y_px - top_y;
        const double angle = std::isnan(dx) ? 0 : std::atan2(-dy, dx);
        const double odd_px = std::max(disc.misfit - GOOD_MISFIT, 0.0) * disc.radius_px;
        kept.rows.push_back(k);
        kept.labels.push_back(light[k] > 1 + EQUAL ? 2 : light[k] >= limits.class_threshold);
        kept.found.push_back({disc.x_px, disc.y_px, disc.radius_px, angle,
                              std::clamp(1 - disc.misfit / maximum, 0.0, 1.0),
                              length_of(disc.scatter_px, odd_px), disc.misfit});
    }
    return kept;
}

}  // namespace plate
