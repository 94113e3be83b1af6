// C++ kernels of catalogue.py, which fits part types to measured outlines.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <vector>

#include "shapes/outlines.hpp"

namespace plate {

// Number of angles at which the spectra of two outlines are compared.
constexpr int ANGLES = 96;

// Maximum number of candidate angles from which the fit of a type to an outline starts.
constexpr int STARTS = 4;

// Minimum correlation of the spectra at a candidate angle, relative to the correlation at the best
// angle.
constexpr double LIKELY = 0.4;

// Maximum number of Gauss-Newton steps of a fit.
constexpr int FIT_STEPS = 5;

// Two outlines agree if their distance is below this value [px]. If a fit agrees with the measured
// outline, no other angle is tried.
constexpr double EXACT = 0.15;

// Computes the correlation of two spectra (HARMONICS,) for each of the TURNS angles by which one
// outline is rotated.
PLATE_WIDE inline void correlate(const Complex* seen, const Complex* known,
                                 std::array<double, ANGLES>& alike) {
    double turn_x[ANGLES], turn_y[ANGLES], wave_x[ANGLES], wave_y[ANGLES];
    for (int i = 0; i < ANGLES; i++) {
        const double angle = 2 * std::numbers::pi * i / ANGLES;
        turn_x[i] = std::cos(angle), turn_y[i] = std::sin(angle);
        wave_x[i] = 1, wave_y[i] = 0;
        alike[i] = 0;
    }
    for (int k = 1; k < HARMONICS; k++) {
        const Complex both = seen[k] * Complex{known[k].real, -known[k].imag};
#pragma omp simd
        for (int i = 0; i < ANGLES; i++) {
            const double x = wave_x[i] * turn_x[i] - wave_y[i] * turn_y[i];
            const double y = wave_x[i] * turn_y[i] + wave_y[i] * turn_x[i];
            wave_x[i] = x, wave_y[i] = y;
            alike[i] += both.real * x - both.imag * y;
        }
    }
}

// Returns candidate angles [rad] by which the first outline may be rotated relative to the second
// outline. The inputs are the spectra (HARMONICS,) of both outlines. The most likely angle is the
// first. `symmetry` is the number of angles within a full turn at which the second outline is the
// same, or 0 for a disc.
inline std::vector<double> likely_turns(const Complex* seen, const Complex* known, int symmetry) {
    if (symmetry == 0) return {0};
    std::array<double, ANGLES> alike, sector;
    correlate(seen, known, alike);
    const int size = (ANGLES + symmetry - 1) / symmetry;
    for (int i = 0; i < size; i++) {
        const double before = alike[(i + ANGLES - 1) % ANGLES], after = alike[(i + 1) % ANGLES];
        const bool peak = !(alike[i] < before || alike[i] < after);
        sector[i] = peak ? alike[i] : -std::numeric_limits<double>::infinity();
    }
    std::vector<int> order(size);
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(),
                     [&](int a, int b) { return sector[a] > sector[b]; });
    std::vector<double> found;
    for (int i = 0; i < std::min(size, STARTS); i++) {
        if (i > 0 && !(sector[order[i]] >= LIKELY * sector[order[0]])) break;
        found.push_back(2 * std::numbers::pi / ANGLES * order[i]);
    }
    return found;
}

// The outline of a part type: edges (e, 5), contour points with outward unit vectors, as `samples`
// (n, 4), centre, and spectrum. `Template` in catalogue.py describes the fields.
struct TypeOutline {
    View<const double, 2> edges, samples;
    const double* centre;
    const Complex* spectrum;
    int symmetry;
};

// A measured outline: edges, centre and spectrum.
struct SeenOutline {
    View<const double, 2> edges;
    const double* centre;
    const Complex* spectrum;
};

// Fit a part type to a measured outline, from each candidate angle. `fit_template` in catalogue.py
// describes the arguments.
inline PoseFit lay_on(const TypeOutline& type, const SeenOutline& seen, double unit,
                      double hopeless) {
    constexpr double FAR = std::numeric_limits<double>::infinity();
    const auto& samples = type.samples;
    const int count = samples.size(0);
    PoseFit best{0, 0, 0, 0, FAR};
    double square = 0;
    for (int i = 0; i < count; i++)
        for (int axis = 0; axis < 2; axis++) square += samples(i, axis) * samples(i, axis);
    const double reach = std::sqrt(square / count);
    const double worst = CLIP * (unit * unit + reach * reach / 100);
    Places places(count);
    for (double angle : likely_turns(seen.spectrum, type.spectrum, type.symmetry)) {
        double c = std::cos(angle), s = std::sin(angle);
        const double start[] = {seen.centre[0] - c * type.centre[0] + s * type.centre[1],
                                seen.centre[1] - s * type.centre[0] - c * type.centre[1], angle};
        PoseFit fit = fit_pose(type.edges, seen.edges, start, unit, type.symmetry != 0, FIT_STEPS,
                               hopeless, FAR);
        if (fit.rest >= std::min(best.rest, hopeless)) {
            best.rest = std::min(best.rest, fit.rest);
            continue;
        }
        // Also compute the distances from the type's contour points to the measured outline.
        c = std::cos(fit.angle), s = std::sin(fit.angle);
        for (int i = 0; i < count; i++) {
            const double x = samples(i, 0) + fit.swell * samples(i, 2);
            const double y = samples(i, 1) + fit.swell * samples(i, 3);
            places.x[i] = fit.x + c * x - s * y;
            places.y[i] = fit.y + s * x + c * y;
        }
        rim_distances(seen.edges, places);
        double rest = 0;
        for (int i = 0; i < count; i++)
            rest += std::min(places.distance[i] * places.distance[i], worst);
        fit.rest = std::sqrt(0.5 * (fit.rest * fit.rest + rest / count));
        if (fit.rest < best.rest) best = fit;
        if (best.rest < EXACT * unit) break;
    }
    return best;
}

}  // namespace plate
