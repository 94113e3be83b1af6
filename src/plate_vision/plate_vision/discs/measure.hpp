// Measurement of round parts without neighbours: centre, radius and darkness. dark.py describes the
// method.
#pragma once
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <vector>

#include <plate/length.hpp>

#include "discs/silhouette.hpp"
#include "plate/light.hpp"

namespace plate {

// Distance [px] by which the evaluated window extends beyond a part's radius. This distance is a
// sum: 0.7 px for the rounding of the window's position, 1 px for the error of the estimated centre
// (seed), and 1.3 px for the blurred edge.
constexpr double RIM_PX = 3.0;

// Distance [px] from a part's contour at which the outer ring of the window begins. The outer ring
// must show bare plate.
constexpr double RIM_CLEAR_PX = 2.2;

// Radius of the inner area of a disc, in units of the part's radius. The inner area does not
// contain the blurred edge. The disc's darkness is the mean over the inner area, or the median if
// there may be a mark.
constexpr double CORE = 0.6;

// Minimum darkness of a pixel that contributes to the moments. If the noise is 2 grey levels and
// the plate's brightness is 200, this minimum is 4 standard deviations. Without this minimum, the
// noise at the border of the window would increase the error of the centre by half.
constexpr double MIN_DARKENING = 0.04;

// Minimum darkness of a part. A fitted disc that is less dark counts as a shadow. The value is also
// the minimum of darknesses by which other values are divided.
constexpr double MIN_DARKNESS = 0.05;

// A measured disc. `DISC` in measure.py describes the fields.
struct Disc {
    double x_px, y_px, radius_px, darkness, misfit, scatter_px, seen;
};

// A round window of pixels around a seed. The positions of the pixels are relative to its centre
// [px].
struct RoundWindow {
    // Sums over the pixels of the window. Each term is the pixel's darkness times the pixel's
    // factor for this sum.
    enum Sum { MASS, RIGHT, DOWN, WIDE, RIM, FLAT, ASKEW, SUMS = 8 };

    struct Pixel {
        float factors[SUMS];
        bool inner;
    };
    std::vector<float> x, y;
    std::vector<int> offsets;  // offsets of the pixels in the image's memory, from the centre pixel
    std::vector<Pixel> pixels;
    int reach, inner = 0;

    RoundWindow(double radius, int width) : reach(radius + RIM_PX) {
        const float outer = (radius + RIM_PX) * (radius + RIM_PX);
        const float clear = (radius + RIM_CLEAR_PX) * (radius + RIM_CLEAR_PX);
        const float core = CORE * radius * (CORE * radius);
        for (int row = -reach; row <= reach; row++)
            for (int column = -reach; column <= reach; column++) {
                const float right = column, down = row, square = right * right + down * down;
                if (square > outer) continue;
                x.push_back(right), y.push_back(down);
                offsets.push_back(row * width + column);
                const float rim = square > clear;
                pixels.push_back({{1, right, down, square, rim, right * right - down * down,
                                   2 * right * down}, square <= core});
                inner += square <= core;
            }
    }
};

PLATE_WIDE inline void darkness_at(const LitPlate& plate, const RoundWindow& window, int x0, int y0,
                                   std::vector<float>& level, std::vector<float>& darkness) {
    const uint8_t* middle = &plate.grey(y0, x0);
    const int count = window.x.size();
    const float left = x0, top = y0, *light = plate.light.data;
    const float *__restrict x = window.x.data(), *__restrict y = window.y.data();
    float *__restrict here = level.data(), *__restrict dark = darkness.data();
    for (int i = 0; i < count; i++) here[i] = middle[window.offsets[i]];
#pragma omp simd
    for (int i = 0; i < count; i++) dark[i] = 1 - here[i] / bare(light, left + x[i], top + y[i]);
}

// The radii of windows are rounded to multiples of this step [px], so that several discs can use
// the same window.
constexpr double WINDOW_STEP_PX = 0.5;

// Measure the discs that `alone` (n,) selects, in round windows at seeds (n, 2) [px]. `parts` (n,)
// are the silhouettes of parts at the seeds. `dirt` (n,) receives the dark area [px2] in the outer
// ring of each window. Discs at the border of the image are not measured.
inline void measure_alone(const LitPlate& plate, View<const double, 2> seeds,
                          const Silhouette* parts, const bool* alone, Disc* discs, double* dirt) {
    std::map<int, RoundWindow> windows;
    std::vector<float> level, darkness;
    for (int k = 0; k < seeds.size(0); k++) {
        if (!alone[k]) continue;
        const int size = std::rint(parts[k].radius_px / WINDOW_STEP_PX);
        const RoundWindow& window =
            windows.try_emplace(size, size * WINDOW_STEP_PX, plate.width()).first->second;
        const int64_t x0 = std::rint(seeds(k, 0)), y0 = std::rint(seeds(k, 1));
        const int64_t reach = window.reach;
        if (x0 < reach || y0 < reach || x0 >= plate.width() - reach || y0 >= plate.height() - reach)
            continue;
        level.resize(window.x.size()), darkness.resize(window.x.size());
        darkness_at(plate, window, x0, y0, level, darkness);
        float sum[RoundWindow::SUMS] = {}, inner = 0;
        for (size_t i = 0; i < darkness.size(); i++) {
            const RoundWindow::Pixel& pixel = window.pixels[i];
            inner += pixel.inner ? darkness[i] : 0;
            const float dark = darkness[i] > static_cast<float>(MIN_DARKENING) ? darkness[i] : 0;
            for (int s = 0; s < RoundWindow::SUMS; s++) sum[s] += dark * pixel.factors[s];
        }
        const float mass = std::max(sum[RoundWindow::MASS], 1e-6f);
        const float right = sum[RoundWindow::RIGHT] / mass, down = sum[RoundWindow::DOWN] / mass;
        const float wide = sum[RoundWindow::WIDE] / mass - right * right - down * down;
        // Consider an ellipse with the half axes a and b. `flat` / `wide` and `askew` / `wide` are
        // (a^2 - b^2) / (a^2 + b^2) times the cosine and the sine of twice its direction. If the
        // values differ from the values of the silhouette, there is a shadow or another object.
        const float flat = sum[RoundWindow::FLAT] / mass - right * right + down * down;
        const float askew = sum[RoundWindow::ASKEW] / mass - 2 * right * down;
        const auto [expected_flat, expected_askew] = parts[k].flatness();
        const double oblong = length_of(flat / wide - expected_flat, askew / wide - expected_askew);
        // The darkness is the mean over the inner area. The error of the seed is so small that all
        // pixels of the inner area are on the disc.
        const float dark = std::max(inner / window.inner, static_cast<float>(MIN_DARKNESS));
        const double area = mass / (std::numbers::pi * dark);
        discs[k] = {x0 + static_cast<double>(right), y0 + static_cast<double>(down),
                    std::sqrt(area), dark, std::max(std::abs(2.0 * wide / area - 1), oblong), 0, 1};
        dirt[k] = sum[RoundWindow::RIM];
    }
}

// Set `near` (n,) to true for each of the centres (n, 2) [px] whose distance from another centre is
// below `distance_px`.
inline void crowded(View<const double, 2> centre, double distance_px, bool* near) {
    std::fill_n(near, centre.size(0), false);
    for (int i = 0; i < centre.size(0); i++)
        for (int j = 0; j < i; j++) {
            const double dx = centre(i, 0) - centre(j, 0), dy = centre(i, 1) - centre(j, 1);
            if (dx * dx + dy * dy < distance_px * distance_px) near[i] = near[j] = true;
        }
}

}  // namespace plate
