// C++ kernels of light.py, which fits the brightness of the bare plate in an image.
#pragma once
#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include <plate/simd.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate {

// Percentile of the pixels' brightness that is the first estimate of the plate's brightness. The
// estimate is correct if parts cover less than 3/4 of the plate.
constexpr double BRIGHT_PERCENTILE = 75;

// The brightness is fitted twice. Only pixels with a brightness in these ranges count as bare
// plate. The first range is relative to the first estimate. The first range includes a shading of
// +-15 %, but excludes a part with 2/3 of the plate's brightness. The second range is relative to
// the result of the first fit. The second range also excludes the blurred edges of parts.
constexpr std::pair<double, double> BRIGHT_RANGES[] = {{0.72, 1.3}, {0.92, 1.08}};

// Value that is added to the diagonal of the normal equations. With this value, the fit is solvable
// for images that are one pixel high or wide. The value has no effect on other images.
constexpr double RIDGE = 1e-9;

// Minimum fraction of the sampled pixels that must show the bare plate.
constexpr double MIN_FRACTION = 0.1;

// Standard deviation of a normal distribution, divided by the lower quartile of the absolute
// values.
constexpr double SIGMA_OF_QUARTILE = 3.1383;

// Minimum noise of an image [grey levels]. The rounding to whole grey levels causes this noise.
constexpr double MIN_NOISE = 0.3;

// Number of coefficients of a quadratic function of two coordinates.
constexpr int TERMS = 6;

// An image, the brightness of the bare plate, and the usable pixels. `LitPlate` in light.py
// describes the fields.
struct LitPlate {
    View<const uint8_t, 2> grey;
    View<const float, 1> light;
    View<const bool, 2> usable;

    int height() const { return grey.size(0); }
    int width() const { return grey.size(1); }
};

// Returns the brightness of the bare plate [grey levels] at a pixel. `light` is the field of
// `LitPlate`.
[[gnu::always_inline]] inline float bare(const float* light, float x_px, float y_px) {
    const float u = (x_px - light[6]) * light[8], v = (y_px - light[7]) * light[8];
    return u * (light[1] + light[3] * u) + (light[0] + v * (light[2] + light[5] * v)) +
           u * (light[4] * v);
}

// Solves a positive definite system of linear equations. `right` is replaced by the solution.
template <int SIZE>
void solve(double (&normal)[SIZE][SIZE], double (&right)[SIZE]) {
    for (int i = 0; i < SIZE; i++)
        for (int j = i + 1; j < SIZE; j++) {
            const double factor = normal[j][i] / normal[i][i];
            for (int k = i; k < SIZE; k++) normal[j][k] -= factor * normal[i][k];
            right[j] -= factor * right[i];
        }
    for (int i = SIZE - 1; i >= 0; i--) {
        for (int k = i + 1; k < SIZE; k++) right[i] -= normal[i][k] * right[k];
        right[i] /= normal[i][i];
    }
}

// A pixel that is used for the fit: the terms of the quadratic function at this pixel, the grey
// level, and padding.
struct LightSample {
    float terms[TERMS], value, none;
};
static_assert(sizeof(LightSample) == sizeof(Eight));

// Compute the normal equations from those samples whose value is between `low` and `high` times the
// fitted value. Return the number of these samples. Vector instructions compute eight sums
// together.
PLATE_WIDE inline int light_equations(const std::vector<LightSample>& samples,
                                      const std::vector<float>& fitted, double low, double high,
                                      double (&normal)[TERMS][TERMS], double (&right)[TERMS]) {
    Eight sum[TERMS] = {};
    int kept = 0;
    for (size_t i = 0; i < samples.size(); i++) {
        const LightSample& sample = samples[i];
        const bool plate = low * fitted[i] < sample.value && sample.value < high * fitted[i];
        const float weight = plate;
        kept += plate;
        Eight all;
        load(all, sample.terms);
        for (int a = 0; a < TERMS; a++) sum[a] += sample.terms[a] * weight * all;
    }
    for (int a = 0; a < TERMS; a++) {
        right[a] = sum[a][TERMS];
        for (int b = 0; b <= a; b++) normal[a][b] = normal[b][a] = sum[a][b];
    }
    return kept;
}

// Fit a quadratic function to the brightness of the pixels that show the bare plate. The pixels are
// given by `rows` and `columns` (n,). `design` (TERMS, n) contains the terms of the function at the
// pixels. Return the coefficients of the function, and the noise relative to the mean brightness.
// If no bright plate is visible, return an empty result.
inline std::vector<float> fit_light(View<const uint8_t, 2> grey, View<const int64_t, 1> rows,
                                    View<const int64_t, 1> columns, View<const float, 2> design,
                                    double min_grey) {
    const int count = rows.size(0);
    std::vector<LightSample> samples(count);
    int levels[256] = {};
    for (int i = 0; i < count; i++) {
        const uint8_t level = grey(rows(i), columns(i));
        for (int a = 0; a < TERMS; a++) samples[i].terms[a] = design(a, i);
        samples[i].value = level;
        levels[level]++;
    }
    int guess = 0, darker = levels[0];
    while (darker <= static_cast<int>(count * BRIGHT_PERCENTILE / 100)) darker += levels[++guess];
    if (guess < min_grey) return {};
    std::vector<float> fitted(count, guess);
    double normal[TERMS][TERMS], right[TERMS];
    for (auto [low, high] : BRIGHT_RANGES) {
        const int kept = light_equations(samples, fitted, low, high, normal, right);
        if (kept < std::max(2.0 * TERMS, MIN_FRACTION * count)) return {};
        for (int a = 0; a < TERMS; a++) normal[a][a] += RIDGE * count;
        solve(normal, right);
        std::fill(fitted.begin(), fitted.end(), 0.f);
        for (int a = 0; a < TERMS; a++) {
            const float factor = right[a], *term = design[a];
            for (int i = 0; i < count; i++) fitted[i] += factor * term[i];
        }
    }
    if (*std::min_element(fitted.begin(), fitted.end()) < 0.5 * min_grey) return {};
    // The noise is computed from the lower quartile of the deviations. Therefore objects that cover
    // up to half of the plate have no effect.
    double level = 0;
    for (int i = 0; i < count; i++) {
        level += fitted[i] / count;
        fitted[i] = std::abs(samples[i].value - fitted[i]);
    }
    std::nth_element(fitted.begin(), fitted.begin() + count / 4, fitted.end());
    const double noise = std::max(SIGMA_OF_QUARTILE * fitted[count / 4], MIN_NOISE);
    std::vector<float> surface(right, right + TERMS);
    surface.push_back(noise / level);
    return surface;
}

}  // namespace plate
