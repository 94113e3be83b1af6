// C++ kernels of segmentation.py, which separates parts of any outline, size and colour from the
// background. A connected area of the image that deviates from the background is called a patch.
#pragma once
#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include <plate/view.hpp>

namespace plate {

// Minimum area of a part [px2]. A disc with a radius of 3 px has about this area.
constexpr double MIN_AREA_PX2 = 30;

// Minimum contrast of a part, relative to the maximum deviation of pixels that show the background.
constexpr double STRONG = 1.2;

// Minimum contrast of a part's second colour, relative to the contrast of its main colour.
constexpr double WEAKER = 0.35;

// Minimum contrast of a part's second colour, relative to the contrast of its main colour. This
// minimum applies if one colour is brighter and the other colour is darker than the plate. Bright
// halos, which image sharpening causes at edges, have less contrast.
constexpr double BRIGHTER = 0.25;

// An area of a patch counts as even if its brightness gradient is below this fraction of the
// patch's maximum gradient.
constexpr double EVEN = 0.3;

// Minimum covered fraction of a pixel between two colours of a part. A pixel with a smaller
// fraction does not belong to the part.
constexpr double BRIDGE = 0.3;

// Minimum step in the lightness L between two colours of a part, relative to the larger of their
// contrasts. This minimum applies if one colour is brighter and the other colour is darker than the
// plate.
constexpr double LEAP = 1.2;

// Call `visit(i)` for each pixel i that is not 0. Blocks of pixels that are all 0 are skipped.
template <class T, class Visit>
[[gnu::always_inline]] inline void each_set(const T* pixels, int count, Visit visit) {
    constexpr int BLOCK = 16;
    for (int first = 0; first < count; first += BLOCK) {
        const int end = std::min(first + BLOCK, count);
        if (end - first == BLOCK) {
            T any = 0;
            for (int i = 0; i < BLOCK; i++) any |= pixels[first + i];
            if (!any) continue;
        }
        for (int i = first; i < end; i++)
            if (pixels[i]) visit(i);
    }
}

// Call `visit(i, k)` for each pixel i that belongs to a patch k. The label of a pixel is the number
// of its patch, and must be below `patches`. Pixels outside of all patches have the label 0.
template <class Visit>
[[gnu::always_inline]] inline void each_labelled(const int32_t* labels, int count, int patches,
                                                 Visit visit) {
    each_set(labels, count, [&](int i) {
        if (labels[i] < 0 || labels[i] >= patches)
            throw std::out_of_range("labels: allowed: 0 to the number of patches, less 1");
        visit(i, labels[i]);
    });
}

// One histogram with 256 levels for each patch.
struct Histograms {
    std::vector<int> counts;

    explicit Histograms(int patches) : counts(256 * static_cast<size_t>(patches)) {}
    int* operator[](int patch) { return &counts[256 * static_cast<size_t>(patch)]; }
};

// Compute three values for each patch (count,). `contrast` is the median of the larger deviations
// from the background, or 0 if the patch is too small. `steepest` is the maximum brightness
// gradient. `bright` is true if most pixels are brighter than the background. All images have the
// shape (h, w).
inline void find_contrasts(View<const int32_t, 2> labels, View<const uint8_t, 2> away,
                           View<const uint8_t, 2> brighter, View<const uint8_t, 2> slope,
                           View<float, 1> contrast, float* steepest, bool* bright) {
    const int count = contrast.size(0), size = labels.size(0) * labels.size(1);
    Histograms histograms(count);
    std::vector<int> balance(count);
    std::fill_n(steepest, count, 0.f);
    each_labelled(labels.data, size, count, [&](int i, int k) {
        histograms[k][away.data[i]]++;
        steepest[k] = std::max<float>(steepest[k], slope.data[i]);
        balance[k] += brighter.data[i] ? 1 : -1;
    });
    for (int k = 0; k < count; k++) {
        contrast(k) = 0;
        bright[k] = balance[k] > 0;
        if (k == 0) continue;
        const int* histogram = histograms[k];
        int total = 0, above = 0;
        for (int level = 1; level < 256; level++) total += histogram[level];
        if (total < MIN_AREA_PX2) continue;
        // Deviations above half of the 90th percentile count as larger deviations.
        int high = 255, middle = 255;
        for (int passed = 0; high > 0 && passed + histogram[high] < 0.1 * total; high--)
            passed += histogram[high];
        const int low = high / 2;
        for (int level = low; level < 256; level++) above += histogram[level];
        for (int passed = 0; middle > low && 2 * (passed + histogram[middle]) < above; middle--)
            passed += histogram[middle];
        contrast(k) = middle;
    }
}

// Properties of patches (count,), from `find_contrasts`.
struct PatchContrasts {
    int count;
    const float *contrast, *steepest;
    const bool* bright;
};

// Write the fraction of each pixel that a part covers to `cover` (h, w). The fraction is the
// deviation of the pixel from the background, divided by the deviation of the part around the
// pixel. Outside of parts, the fraction is 0.
inline void find_cover(View<const uint8_t, 2> away, View<const uint8_t, 2> around,
                       View<const uint8_t, 2> brighter, View<const uint8_t, 2> slope,
                       View<const int32_t, 2> labels, const PatchContrasts& patches,
                       View<const uint8_t, 2> limit, View<float, 2> cover) {
    const int size = labels.size(0) * labels.size(1);
    std::fill_n(cover.data, size, 0.f);
    each_labelled(labels.data, size, patches.count, [&](int i, int k) {
        const float contrast = patches.contrast[k], here = away.data[i];
        const float full = std::min<float>(contrast, around.data[i]);
        const double strong = STRONG * limit.data[i];
        if (full <= strong) return;
        // A highlight on a dark part may differ less from the plate than the rest of the part.
        const bool highlight = (brighter.data[i] > 0) != patches.bright[k] &&
                               here > std::max(BRIGHTER * contrast, strong);
        // An area with a second colour of the part may have less contrast, but it differs clearly
        // from the background and is even.
        const bool weaker = here > WEAKER * contrast && slope.data[i] < EVEN * patches.steepest[k];
        cover.data[i] = highlight || weaker ? 1 : std::min(here / full, 1.f);
    });
}

// Add the pixels between two colours of a part to the mask (h, w) and to the cover. `near` is the
// mask after morphological closing with a kernel of 3 x 3 pixels, and `far` after closing with 5 x
// 5 pixels. A pixel of `far` is added if there is a step in lightness. A pixel of `near` is added
// if its covered fraction is large enough.
inline void bridge(View<uint8_t, 2> mask, View<float, 2> cover, View<const uint8_t, 2> near,
                   View<const uint8_t, 2> far, View<const uint8_t, 2> step,
                   View<const uint8_t, 2> around) {
    const int size = mask.size(0) * mask.size(1);
    each_set(far.data, size, [&](int i) {
        if (mask.data[i]) return;
        const bool leap = step.data[i] > LEAP * around.data[i];
        if (leap || (near.data[i] && cover.data[i] > BRIDGE)) mask.data[i] = 1, cover.data[i] = 1;
    });
}

}  // namespace plate
