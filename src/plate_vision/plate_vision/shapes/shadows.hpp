// C++ kernels of shadows.py, which detects shadows of parts. In a shadow, the background is darker,
// but its chroma is unchanged. The edges of shadows are blurred.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <plate/view.hpp>

#include "shapes/segmentation.hpp"

namespace plate {

// Minimum lightness L of a shadow, relative to the plate's lightness.
constexpr double DARKEST = 0.45;

// Minimum number of pixels in the even area of a part, and in the even area of a shadow.
constexpr int MIN_UNIFORM = 12;

// Maximum deviation of a shadow from the background, relative to the deviation of the part that
// causes the shadow.
constexpr double LIGHTER = 0.8;

// The deviation of a patch's dark side is a quantile: DARKER is the fraction of the patch's even
// pixels that deviate more from the background.
constexpr double DARKER = 0.3;

// Pixels belong to the edge of a shadow if their deviation is in this range, relative to the
// deviation of the shadow.
constexpr double HALFWAY[] = {0.3, 0.7};

// Minimum number of pixels of a shadow's edge from which its slope is measured.
constexpr int MIN_SEEN = 4;

// Shadow candidates in an image. Three arrays (h, w) contain a value for each pixel:
// - like: whether the pixel has the colour of a darker plate
// - lit: whether the pixel is also light enough for a shadow
// - slope: gradient of the lightness [L/px]
//
// The other arrays (count,) contain a value for each patch:
// - steepest, largest: maximum gradient and maximum deviation of the pixels that are darker than
//   the plate
// - total: area [px2]
// - balance: number of pixels brighter than the plate, minus number of pixels in `like`
struct ShadowEdges {
    int count;
    View<bool, 2> like, lit;
    View<float, 2> slope;
    float *steepest, *largest;
    int64_t *total, *balance;
};

// Detect shadow candidates in an image. `lab` contains its colours, and `bare` the colours of the
// background (h, w, c). The other images have the shape (h, w). All results must be 0 before the
// call.
inline void find_shadow_edges(View<const uint8_t, 3> lab, View<const uint8_t, 3> bare,
                              double chroma, View<const uint8_t, 2> limit,
                              View<const int32_t, 2> labels, const ShadowEdges& found) {
    const int height = lab.size(0), width = lab.size(1), channels = lab.size(2);
    for (int y = 0; y < height; y++) {
        const uint8_t *row = lab[y], *upper = lab[std::max(y - 1, 0)];
        const uint8_t *plate_row = bare[y], *lower = lab[std::min(y + 1, height - 1)];
        each_labelled(labels[y], width, found.count, [&](int x, int k) {
            const int here = row[channels * x], plate = plate_row[channels * x];
            found.total[k]++;
            if (here >= plate) {
                found.balance[k]++;
                return;
            }
            const int left = row[channels * std::max(x - 1, 0)];
            const int right = row[channels * std::min(x + 1, width - 1)];
            const int up = upper[channels * x], down = lower[channels * x];
            const int across = right - left, along = down - up;
            const float slope =
                0.5f * std::sqrt(static_cast<float>(across * across + along * along));
            found.slope(y, x) = slope;
            if (std::max({left, right, up, down}) <= plate + limit(y, x)) {
                // No neighbour is brighter than the plate, so the pixel is not at the edge of a
                // highlight.
                found.steepest[k] = std::max(found.steepest[k], slope);
                found.largest[k] = std::max<float>(found.largest[k], plate - here);
            }
            if (channels == 3) {
                const float factor = static_cast<float>(here) / plate;
                double square = 0;
                for (int c = 1; c < 3; c++) {
                    const double expected = 128 + factor * (plate_row[3 * x + c] - 128.0);
                    square += (row[3 * x + c] - expected) * (row[3 * x + c] - expected);
                }
                if (chroma * std::sqrt(square) > limit(y, x)) return;
            }
            found.balance[k]--;
            found.like(y, x) = true;
            found.lit(y, x) = here >= DARKEST * plate;
        });
    }
}

// A patch may consist of a part (dark side) and its shadow (light side). For each patch (count,),
// compute how much both sides deviate from the background: `light` and `dark`. `bound` is the
// deviation that separates the two sides, or 0 if there is only one side.
//
// The pixels of even areas are separated by the method of Otsu (1979).
inline void part_sides(View<const uint8_t, 2> away, View<const bool, 2> like,
                       View<const float, 2> slope, const float* steepest,
                       View<const int32_t, 2> labels, View<float, 1> bound, float* light,
                       float* dark) {
    const int count = bound.size(0), size = labels.size(0) * labels.size(1);
    Histograms histograms(count), plains(count);
    each_labelled(labels.data, size, count, [&](int i, int k) {
        if (!(slope.data[i] < EVEN * steepest[k])) return;
        histograms[k][away.data[i]]++;
        plains[k][away.data[i]] += like.data[i];
    });
    for (int k = 0; k < count; k++) {
        bound(k) = light[k] = dark[k] = 0;
        if (k == 0) continue;
        const int *histogram = histograms[k], *plain = plains[k];
        int64_t total = 0, below = 0;
        double moment = 0, first = 0, maximum = 0;
        for (int level = 0; level < 256; level++) {
            total += histogram[level];
            moment += static_cast<double>(level) * histogram[level];
        }
        for (int level = 0; level < 255; level++) {
            below += histogram[level];
            first += static_cast<double>(level) * histogram[level];
            if (below < MIN_UNIFORM || total - below < MIN_UNIFORM) continue;
            const double low = first / below, high = (moment - first) / (total - below);
            const double between = below * (total - below) * ((high - low) * (high - low));
            if (between > maximum) {
                maximum = between;
                bound(k) = low > LIGHTER * high ? 0 : 0.5 * (low + high);
                light[k] = low;
            }
        }
        int level = 255;
        for (int64_t passed = 0; level > 0 && passed < DARKER * total; level--)
            passed += histogram[level];
        dark[k] = level;
        // The light side is a shadow only if at least half of its pixels have the colour of a
        // darker plate.
        int64_t under = 0, own = 0;
        for (int l = 0; l < static_cast<int>(bound(k)); l++) under += histogram[l], own += plain[l];
        if (2 * own < under) bound(k) = 0;
    }
}

// Compute two values for each patch. `fade` (count,) is the lightness gradient at the outer edge of
// the light side [L/px], or 0 if this edge is not visible. `way` (count, 2) is the unit vector from
// the dark side to the light side. Before the call, `way` must be 0.
inline void find_fade(View<const uint8_t, 2> away, View<const uint8_t, 2> around,
                      View<const bool, 2> like, View<const float, 2> slope,
                      View<const int32_t, 2> labels, View<const float, 1> bound,
                      const float* level, float* fade, View<double, 2> way) {
    struct Side {
        double count, x, y;
    };
    struct Patch {
        Side light, dark;
        int seen;
    };
    const int count = bound.size(0);
    std::vector<Patch> patches(count);
    std::fill_n(fade, count, 0.f);
    for (int y = 0; y < labels.size(0); y++)
        each_labelled(labels[y], labels.size(1), count, [&](int x, int k) {
            if (bound(k) == 0) return;
            const float here = away(y, x);
            Side& side = like(y, x) && here < bound(k) ? patches[k].light : patches[k].dark;
            side.count++, side.x += x, side.y += y;
            if (!like(y, x) || around(y, x) > bound(k)) return;
            if (HALFWAY[0] * level[k] < here && here < HALFWAY[1] * level[k]) {
                fade[k] += slope(y, x);
                patches[k].seen++;
            }
        });
    for (int k = 0; k < count; k++) {
        const auto& [light, dark, seen] = patches[k];
        fade[k] = seen >= MIN_SEEN ? fade[k] / seen : 0;
        if (light.count == 0 || dark.count == 0) continue;
        const double dx = light.x / light.count - dark.x / dark.count;
        const double dy = light.y / light.count - dark.y / dark.count;
        const double length = std::sqrt(dx * dx + dy * dy);
        if (length > 0) way(k, 0) = dx / length, way(k, 1) = dy / length;
    }
}

}  // namespace plate
