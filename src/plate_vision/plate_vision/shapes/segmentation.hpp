// Parts of any outline, size and colour: see segmentation.py.
#pragma once
#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include <plate/view.hpp>

namespace plate {

// Smallest part: a disc of 3 px radius.
constexpr double LEAST_AREA_PX2 = 30;

// Contrast of a part, relative to the deviation up to which a pixel may show the background.
constexpr double STRONG = 1.2;

// Least contrast of another colour of a part, relative to that of its main one.
constexpr double WEAKER = 0.35;

// The same of one on the other side of the plate's lightness: the halo of a sharpened edge has
// less.
constexpr double BRIGHTER = 0.25;

// Steepest slope of what is even, relative to the steepest of the patch.
constexpr double EVEN = 0.3;

// Least cover of a line of one pixel between two colours of a part.
constexpr double BRIDGE = 0.3;

// Least step in L from one colour of a part to another on the other side of the plate's, relative
// to the larger of their contrasts.
constexpr double LEAP = 1.2;

// Call `visit(i)` for each pixel that is not 0: most are.
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

// Call `visit(i, k)` for each pixel i of a patch: its number k is below `patches`, 0 outside.
template <class Visit>
[[gnu::always_inline]] inline void each_labelled(const int32_t* labels, int count, int patches,
                                                 Visit visit) {
    each_set(labels, count, [&](int i) {
        if (labels[i] < 0 || labels[i] >= patches)
            throw std::out_of_range("labels: allowed: 0 to the number of patches, less 1");
        visit(i, labels[i]);
    });
}

// How many pixels of a patch have each of 256 levels.
struct Histograms {
    std::vector<int> counts;

    explicit Histograms(int patches) : counts(256 * static_cast<size_t>(patches)) {}
    int* operator[](int patch) { return &counts[256 * static_cast<size_t>(patch)]; }
};

// Find of each patch (count,) the deviation that most of its inside has, the median of its upper
// half, 0 if it is too small; its steepest slope; whether most of it is brighter than the
// background. Images are (h, w).
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
        if (total < LEAST_AREA_PX2) continue;
        // The upper half of the range below the brightest tenth.
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

// What is known of patches (count,): as `find_contrasts` finds it.
struct PatchContrasts {
    int count;
    const float *contrast, *steepest;
    const bool* bright;
};

// Write how much of each pixel is part into `cover` (h, w): its deviation relative to that of the
// part around it; 0 where there is none.
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
        // A highlight on a dark part may differ less from the plate than the part.
        const bool highlight = (brighter.data[i] > 0) != patches.bright[k] &&
                               here > std::max(BRIGHTER * contrast, strong);
        // Of several colours the weaker: far from the background, but even.
        const bool weaker = here > WEAKER * contrast && slope.data[i] < EVEN * patches.steepest[k];
        cover.data[i] = highlight || weaker ? 1 : std::min(here / full, 1.f);
    });
}

// Add to a mask (h, w), and to the cover, what is between two colours of a part: where it is closed
// by `near` or `far` and there is a step in the light, or cover.
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
