// C++ kernels of fit.py, which fits position, radius and darkness of round parts to their contours
// in the image.
//
// The model of a pixel's darkness is the part's darkness times the cover c(u) of the pixel:
//     c(u) = 1/2 + 3/4 u - 1/4 u^3
// Here, u is the pixel's depth inside the contour divided by the half width of the edge, limited to
// -1 to 1. The sum of the weighted squared errors of all pixels in a window is minimised by damped
// Gauss-Newton steps.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <plate/length.hpp>

#include "discs/measure.hpp"
#include "discs/silhouette.hpp"

namespace plate {

// Minimum, initial and maximum half width [px] of a disc's blurred edge. Across the edge, the cover
// of the pixels rises from 0 to 1 as a cubic. Without blur the half width is 0.5 px. With a blur of
// 0.6 px (standard deviation), the half width is 1.1 px.
constexpr double EDGE_PX[] = {0.4, 0.8, 4.5};

// EDGE_FRACTION is the maximum half width of the edge, as a fraction of the disc's radius. If
// EDGE_PX[2] is larger, EDGE_PX[2] is the maximum. MARGIN_FRACTION is the distance by which the
// window extends beyond the contour, as a fraction of the radius. If RIM_PX is larger, RIM_PX is
// this distance.
constexpr double EDGE_FRACTION = 0.6, MARGIN_FRACTION = 0.3;

inline double rim_of(const Silhouette& part) {
    return std::max(RIM_PX, MARGIN_FRACTION * part.radius_px);
}

// Maximum change of a disc's position or radius [px] in one iteration. The change is limited
// because the linearised model is valid only near the edge.
constexpr double MAX_STEP_PX = 1.0;

// The fit of a disc ends if a step changes position and radius by less than this value [px]. The
// next change would be about 0.001 px. A change of 0.001 px is a tenth of the error that the image
// noise causes.
constexpr double SETTLED_PX = 0.01;

constexpr int MAX_ITERATIONS = 25;

// Damping of the normal equations. Damping is added to the diagonal twice: as an absolute value,
// and as a fraction of the diagonal. With damping, the equations are solvable even if a disc is
// almost completely hidden.
constexpr double FIT_DAMPING = 1e-3;

// A pixel inside a part is ignored if the difference between its darkness and the part's darkness
// exceeds both of two limits. Such a pixel shows a mark, a highlight or a hole. The limits are
// ODD_FRACTION times the part's darkness, and ODD_SIGMAS standard deviations of the image noise.
constexpr double ODD_FRACTION = 0.25, ODD_SIGMAS = 4.0;

// Width [px] of the bands beside the blurred edge. Pixels in the edge and in these bands contribute
// to the misfit.
constexpr double CONTOUR_PX = 1.0;

// Permitted range of the darkness of a part's side faces, relative to the darkness of its top face.
// The range is limited because the fit cannot determine the darkness of side faces that are hardly
// visible.
constexpr double SIDE_RANGE[] = {0.3, 3.0};

// Larger pixel errors are limited to this fraction of the disc's darkness in the calculation of the
// misfit. Therefore a local defect of the edge does not cause the rejection of a disc.
constexpr double WORST_FRACTION = 0.4;

// Unknowns of a disc: x, y, radius, half width of the edge [px], darkness of the top face, and
// darkness of the side faces. If the part has no height, the last unknown is equal to the darkness
// of the top face and is not fitted.
enum Unknown { X, Y, RADIUS, EDGE, TOP, SIDE, UNKNOWNS };
constexpr int FLAT_UNKNOWNS = SIDE;
using DiscFit = std::array<double, UNKNOWNS>;

// The usable pixels around a disc, row by row:
// - x, y: positions of the pixels [px]
// - dark: darkness
// - rest: darkness minus the darkness of neighbouring discs
// - seen: fraction of the pixel that no neighbour covers
struct DiscWindow {
    int size = 0, maximum;
    double all = 0;  // number of all pixels in the window, including unusable pixels
    std::vector<float> numbers;

    float* x() { return numbers.data(); }
    float* y() { return x() + maximum; }
    float* dark() { return x() + 2 * maximum; }
    float* rest() { return x() + 3 * maximum; }
    float* seen() { return x() + 4 * maximum; }

    DiscWindow(const LitPlate& plate, double x_px, double y_px, const Silhouette& part) {
        const int x0 = std::rint(x_px), y0 = std::rint(y_px);
        const double rim = rim_of(part);
        const int reach = std::ceil(part.reach() + rim);
        const double square = part.lean_px[0] * part.lean_px[0] + part.lean_px[1] * part.lean_px[1];
        maximum = (2 * reach + 1) * (2 * reach + 1);
        numbers.resize(5 * static_cast<size_t>(maximum));
        const auto is_inside = [&](int column, int row) {
            const double across = column - x0, along = row - y0;
            double wx = part.across[0][0] * across + part.across[0][1] * along;
            double wy = part.across[1][0] * across + part.across[1][1] * along;
            double way = 0;
            if (square > 0) {
                way = (wx * part.lean_px[0] + wy * part.lean_px[1]) / square;
                way = std::clamp(way, 0.0, 1.0);
            }
            wx -= way * part.lean_px[0], wy -= way * part.lean_px[1];
            const double far = (1 + (part.growth - 1) * way) * part.radius_px + rim;
            return wx * wx + wy * wy <= far * far;
        };
        float *xs = x(), *ys = y(), *levels = dark();
        for (int row = y0 - reach; row <= y0 + reach; row++) {
            // The window is convex. Therefore the window contains all pixels between its first and
            // its last pixel in a row.
            int first = x0 - reach, last = x0 + reach;
            while (first <= last && !is_inside(first, row)) first++;
            while (last > first && !is_inside(last, row)) last--;
            all += last - first + 1;
            if (row < 0 || row >= plate.height()) continue;
            const int end = std::min(last, plate.width() - 1);
            const bool* usable = plate.usable[row];
            const uint8_t* grey = plate.grey[row];
            for (int column = std::max(first, 0); column <= end; column++) {
                xs[size] = column, ys[size] = row, levels[size] = grey[column];
                size += usable[column];
            }
        }
        to_darkness(plate.light.data);
    }

    // Convert grey levels to darkness.
    void to_darkness(const float* light);

    // Returns the index range (end excluded) of the pixels whose rows are within a distance [px] of
    // y_px.
    std::array<int, 2> rows(double y_px, double distance) {
        const float *begin = y(), *end = begin + size;
        const auto first = std::lower_bound(begin, end, static_cast<float>(y_px - distance));
        const auto last = std::upper_bound(first, end, static_cast<float>(y_px + distance));
        return {static_cast<int>(first - begin), static_cast<int>(last - begin)};
    }
};

PLATE_WIDE inline void levels_to_darkness(const float* __restrict x, const float* __restrict y,
                                          const float* light, int size, float* __restrict dark) {
#pragma omp simd
    for (int i = 0; i < size; i++) dark[i] = 1 - dark[i] / bare(light, x[i], y[i]);
}

inline void DiscWindow::to_darkness(const float* light) {
    levels_to_darkness(x(), y(), light, size, dark());
}

// Numbers of a pixel whose sums or products the fit needs. The first numbers are the derivatives of
// the disc's darkness with respect to the unknowns. The others are:
// - ERROR: error of the darkness
// - SQUARE: RIM times the squared error, which is limited by WORST_FRACTION
// - NEAR: 1 near the contour, else 0
// - RIM: visible fraction of the pixel near the contour, else 0
enum Number { ERROR = UNKNOWNS, SQUARE, NEAR, RIM, NUMBERS };

// All numbers of `Number` for each pixel of a window. Each row of numbers is padded with zeros
// to a multiple of eight.
struct PixelNumbers {
    std::vector<float> numbers;
    int size = 0;

    void resize(int pixels) {
        size = (pixels + 7) / 8 * 8;
        if (numbers.size() < static_cast<size_t>(NUMBERS) * size) numbers.resize(NUMBERS * size);
        for (int k = 0; k < NUMBERS; k++) std::fill(of(k) + pixels, of(k) + size, 0.f);
    }
    float* of(int number) { return numbers.data() + static_cast<size_t>(number) * size; }
    const float* of(int number) const {
        return numbers.data() + static_cast<size_t>(number) * size;
    }
};

// Returns the sum of eight numbers.
[[gnu::always_inline]] inline double total(const Eight& sum) {
    return ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
}

// Computes the rows FIRST to LAST - 1 of the normal equations, up to the diagonal, as sums over the
// pixels.
template <int FIRST, int LAST>
[[gnu::always_inline]] inline void add_products(const PixelNumbers& pixels,
                                                double (&normal)[UNKNOWNS][UNKNOWNS],
                                                double (&right)[UNKNOWNS]) {
    Eight sum[LAST - FIRST][LAST + 1] = {};
    const float* of[LAST];
    for (int a = 0; a < LAST; a++) of[a] = pixels.of(a);
    const float* errors = pixels.of(ERROR);
    for (int i = 0; i < pixels.size; i += 8) {
        Eight slope[LAST], error;
        load(error, errors + i);
#pragma GCC unroll 8
        for (int a = 0; a < LAST; a++) load(slope[a], of[a] + i);
#pragma GCC unroll 8
        for (int a = FIRST; a < LAST; a++) {
#pragma GCC unroll 8
            for (int b = 0; b <= a; b++) sum[a - FIRST][b] += slope[a] * slope[b];
            sum[a - FIRST][LAST] += slope[a] * error;
        }
    }
    for (int a = FIRST; a < LAST; a++) {
        for (int b = 0; b <= a; b++) normal[a][b] = total(sum[a - FIRST][b]);
        right[a] = total(sum[a - FIRST][LAST]);
    }
}

inline double first_darkness(DiscWindow& window, double x, double y, double radius,
                             std::vector<float>& inner) {
    inner.clear();
    const float *xs = window.x(), *ys = window.y(), *dark = window.dark();
    const auto [begin, end] = window.rows(y, CORE * radius);
    for (int i = begin; i < end; i++) {
        const double dx = xs[i] - x, dy = ys[i] - y;
        if (dx * dx + dy * dy < CORE * radius * (CORE * radius)) inner.push_back(dark[i]);
    }
    if (inner.empty()) return MIN_DARKNESS;
    const auto middle = inner.begin() + inner.size() / 2;
    std::nth_element(inner.begin(), middle, inner.end());
    return std::max<double>(*middle, MIN_DARKNESS);
}

// Returns the fraction of a pixel that a disc covers. The argument u is the pixel's depth inside
// the contour divided by the half width of the edge, from -1 to 1.
[[gnu::always_inline]] inline float cover_at(float u) {
    return 0.5f + u * (0.75f - 0.25f * u * u);
}

// A disc's contour in single precision, for the loops over pixels.
struct Contour {
    float ax, bx, ay, by, cx, cy, lx, ly, over, radius, more, scale, growth;

    Contour(const DiscFit& disc, const Silhouette& part)
        : ax(part.across[0][0]), bx(part.across[0][1]), ay(part.across[1][0]),
          by(part.across[1][1]), cx(disc[X]), cy(disc[Y]), lx(part.lean_px[0]), ly(part.lean_px[1]),
          over(1 / std::max(lx * lx + ly * ly, 1e-9f)), radius(disc[RADIUS]),
          more(part.growth - 1), scale(1 / disc[EDGE]), growth(part.growth) {}

    // Returns the depth of a pixel inside the contour, divided by the half width of the edge. The
    // function also sets a vector (wx, wy) and its length `far` [px, disc's frame]. The vector
    // points to the pixel. The vector begins at the nearest point of the line from the centre of
    // the part's base to the centre of its top.
    template <bool LEANS>
    [[gnu::always_inline]] float depth(float x, float y, float& wx, float& wy, float& far) const {
        const float dx = x - cx, dy = y - cy;
        wx = ax * dx + bx * dy, wy = ay * dx + by * dy;
        float r = radius;
        if constexpr (LEANS) {
            const float way = std::min(std::max((wx * lx + wy * ly) * over, 0.f), 1.f);
            wx -= way * lx, wy -= way * ly;
            r *= 1 + more * way;
        }
        far = std::sqrt(wx * wx + wy * wy);
        return (r - far) * scale;
    }
    // Returns the depth of a pixel inside the contour of the part's top face, divided by the half
    // width of the edge.
    [[gnu::always_inline]] float top_depth(float x, float y) const {
        const float dx = x - cx, dy = y - cy;
        const float wx = ax * dx + bx * dy - lx, wy = ay * dx + by * dy - ly;
        const float r = radius * growth;
        return (r - std::sqrt(wx * wx + wy * wy)) * scale;
    }
};

[[gnu::always_inline]] inline float within(float u) { return std::min(std::max(u, -1.f), 1.f); }

// Shadows that one lamp causes. `cast` (n, 2) contains the displacement of each part's shadow [px,
// disc's frame]. `darkness` is the darkness of the plate in a shadow. `edge_px` is the half width
// of a shadow's blurred edge [px].
struct Shadows {
    const double* cast = nullptr;
    double darkness = 0, edge_px = 1;

    bool any() const { return darkness > 0; }

    // Returns the contour of a disc's shadow. This contour encloses all positions of the disc along
    // the shadow's displacement.
    Contour contour(const DiscFit& disc, const Silhouette& part, int k) const {
        DiscFit soft = disc;
        soft[EDGE] = edge_px;
        Silhouette drawn = part;
        drawn.growth = 1;
        drawn.lean_px[0] = cast[2 * k], drawn.lean_px[1] = cast[2 * k + 1];
        return Contour(soft, drawn);
    }
};

// Pixels that a disc does not reach are skipped. This margin [px] allows for rounding errors.
constexpr double SAFE_PX = 0.1;

// Subtract the darkness of neighbouring discs from the pixels of a window. Reduce the weight of
// pixels that neighbours or their shadows cover. `stretch` (n,) contains `Silhouette::stretch` of
// each disc.
PLATE_WIDE inline void without_others(DiscWindow& window, const std::vector<DiscFit>& discs,
                                      const Silhouette* parts, const std::vector<double>& stretch,
                                      const Shadows& shadows, const std::vector<int>& neighbours) {
    const int size = window.size;
    const float *__restrict x = window.x(), *__restrict y = window.y();
    float *__restrict rest = window.rest(), *__restrict seen = window.seen();
    std::copy_n(window.dark(), size, rest);
    std::fill_n(seen, size, 1.f);
    for (int j : neighbours) {
        const Contour contour(discs[j], parts[j]);
        const float side = discs[j][SIDE], flat = discs[j][TOP], more = flat - side;
        if (!parts[j].is_high()) {
            const double far = (discs[j][RADIUS] + discs[j][EDGE]) * stretch[j] + SAFE_PX;
            const auto [begin, end] = window.rows(discs[j][Y], far);
#pragma omp simd
            for (int i = begin; i < end; i++) {
                float wx, wy, far;
                const float cover =
                    cover_at(within(contour.depth<false>(x[i], y[i], wx, wy, far)));
                rest[i] -= flat * cover;
                seen[i] *= 1 - cover;
            }
        } else {
#pragma omp simd
            for (int i = 0; i < size; i++) {
                float wx, wy, far;
                const float cover = cover_at(within(contour.depth<true>(x[i], y[i], wx, wy, far)));
                const float top = std::min(cover_at(within(contour.top_depth(x[i], y[i]))), cover);
                rest[i] -= side * cover + more * top;
                seen[i] *= 1 - cover;
            }
        }
        if (!shadows.any()) continue;
        const Contour shadow = shadows.contour(discs[j], parts[j], j);
#pragma omp simd
        for (int i = 0; i < size; i++) {
            float wx, wy, far;
            seen[i] *= 1 - cover_at(within(shadow.depth<true>(x[i], y[i], wx, wy, far)));
        }
    }
}

// Computes the normal equations of one disc (lower half) as sums over the pixels. Sets the misfit,
// the standard deviation of the position, and the visible fraction of the contour in `out`.
//
// The misfit is the root mean square error of the darkness at the contour, divided by the disc's
// darkness. The squared noise is subtracted from the mean square error. `noise` is the standard
// deviation of the image noise, in units of darkness. If SHADOW is true, the plate within the
// shadow's contour `cast` is darker by `shade`.
template <bool SHADOW, bool HIGH>
[[gnu::always_inline]] inline void sum_up(DiscWindow& window, const DiscFit& disc, const Silhouette& part,
                              const Contour& cast, float shade, double noise,
                              PixelNumbers& pixels,
                              double (&normal)[UNKNOWNS][UNKNOWNS], double (&right)[UNKNOWNS],
                              Disc& out) {
    const Contour contour(disc, part);
    const float side = disc[SIDE], flat = disc[TOP], more = flat - side;
    const float steep = 0.75 / disc[EDGE];
    const float near = 1 + CONTOUR_PX / disc[EDGE];
    const float dark = std::max(std::max(disc[SIDE], disc[TOP]), MIN_DARKNESS);
    const float threshold = std::max<float>(ODD_FRACTION * dark, ODD_SIGMAS * noise);
    const float worst = WORST_FRACTION * dark;
    const float *__restrict x = window.x(), *__restrict y = window.y();
    const float *__restrict rest = window.rest(), *__restrict seen = window.seen();
    pixels.resize(window.size);
    float *__restrict in_x = pixels.of(X), *__restrict in_y = pixels.of(Y);
    float *__restrict in_radius = pixels.of(RADIUS), *__restrict in_edge = pixels.of(EDGE);
    float *__restrict in_side = pixels.of(SIDE), *__restrict in_top = pixels.of(TOP);
    float *__restrict errors = pixels.of(ERROR), *__restrict squares = pixels.of(SQUARE);
    float *__restrict near_by = pixels.of(NEAR), *__restrict rims = pixels.of(RIM);
#pragma omp simd
    for (int i = 0; i < window.size; i++) {
        float wx, wy, far;
        const float depth = contour.depth<HIGH>(x[i], y[i], wx, wy, far), u = within(depth);
        const float cover = cover_at(u);
        float top = cover, level = flat;
        if constexpr (HIGH) {
            top = std::min(cover_at(within(contour.top_depth(x[i], y[i]))), cover);
            level = side + more * (top / std::max(cover, 1e-6f));
        }
        // `beside` is the part of the shadow that the disc does not hide.
        float beside = 0, under = 0;
        if constexpr (SHADOW) {
            float sx, sy, beyond;
            const float shadow = cast.depth<true>(x[i], y[i], sx, sy, beyond);
            beside = std::max(cover_at(within(shadow)) - cover, 0.f);
            under = beside > 0 ? shade : 0;
        }
        const float gap = rest[i] - level * cover - shade * beside;
        const float kept = depth > 1 && std::abs(gap) > threshold ? 0.f : 1.f;
        const float weight = seen[i] * kept;
        const float error = gap * weight, gr = (level - under) * steep * (1 - u * u) * weight;
        const float rim = std::abs(depth) < near ? seen[i] : 0.f;
        const float inverse = 1 / std::max(far, 1e-3f);
        near_by[i] = std::abs(depth) < near ? 1.f : 0.f;
        rims[i] = rim;
        in_x[i] = gr * (contour.ax * wx + contour.ay * wy) * inverse;
        in_y[i] = gr * (contour.bx * wx + contour.by * wy) * inverse;
        in_radius[i] = gr;
        in_edge[i] = -gr * u;
        in_top[i] = top * weight;
        if constexpr (HIGH) in_side[i] = (cover - top) * weight;
        errors[i] = error;
        const float known = std::min(std::abs(gap), worst);
        squares[i] = rim * known * known;
    }
    add_products<0, EDGE>(pixels, normal, right);
    add_products<EDGE, HIGH ? int{UNKNOWNS} : FLAT_UNKNOWNS>(pixels, normal, right);
    if constexpr (!HIGH) {
        std::fill_n(normal[SIDE], UNKNOWNS, 0);
        right[SIDE] = 0;
    }
    Eight all_square = {}, all_rim = {}, all_near = {};
    for (int i = 0; i < pixels.size; i += 8) {
        Eight eight;
        load(eight, squares + i), all_square += eight;
        load(eight, rims + i), all_rim += eight;
        load(eight, near_by + i), all_near += eight;
    }
    double square = total(all_square);
    const double weights = total(all_rim), count = total(all_near);
    square /= std::max(weights, 1.0);
    out.misfit = std::sqrt(std::max(square - noise * noise, 0.0)) / dark;
    const double whole = std::max(count, 1.0) * std::max(window.all, 1.0) / window.size;
    out.seen = window.size ? std::min(weights / whole, 1.0) : 0;
    // Use the mean of the diagonal entries for x and y.
    const double slopes_xy = 0.5 * (normal[X][X] + normal[Y][Y]);
    out.scatter_px = std::sqrt(std::max(square, noise * noise) / std::max(slopes_xy, 1e-9));
}

// The macro defines one function for each kind of disc, because PLATE_WIDE cannot be applied to a
// template.
#define PLATE_SUM_UP(name, SHADOW, HIGH)                                                         \
    PLATE_WIDE inline void name(DiscWindow& window, const DiscFit& disc,                         \
                                const Silhouette& part, const Contour& cast, float shade,        \
                                double noise, PixelNumbers& pixels,                              \
                                double (&normal)[UNKNOWNS][UNKNOWNS], double (&right)[UNKNOWNS], \
                                Disc& out) {                                                     \
        sum_up<SHADOW, HIGH>(window, disc, part, cast, shade, noise, pixels, normal, right, out); \
    }
PLATE_SUM_UP(sum_up_flat, false, false)
PLATE_SUM_UP(sum_up_high, false, true)
PLATE_SUM_UP(sum_up_shadowed, true, false)
PLATE_SUM_UP(sum_up_high_shadowed, true, true)
#undef PLATE_SUM_UP

// Solve the damped normal equations of a disc, and apply the step. Return the maximum change of
// position and radius [px].
inline double improve(DiscFit& disc, double (&normal)[UNKNOWNS][UNKNOWNS],
                      double (&right)[UNKNOWNS], double first_radius) {
    for (int i = 0; i < UNKNOWNS; i++) {
        normal[i][i] = normal[i][i] * (1 + FIT_DAMPING) + FIT_DAMPING;
        for (int j = 0; j < i; j++) normal[j][i] = normal[i][j];
    }
    solve(normal, right);
    const double change =
        std::max({std::abs(right[X]), std::abs(right[Y]), std::abs(right[RADIUS])});
    const double step = std::min(1.0, MAX_STEP_PX / std::max(change, 1e-9));
    for (int i = 0; i < UNKNOWNS; i++) disc[i] += step * right[i];
    disc[RADIUS] = std::clamp(disc[RADIUS], 0.5 * first_radius, 1.5 * first_radius);
    const double max_edge = std::max(EDGE_PX[2], EDGE_FRACTION * first_radius);
    disc[EDGE] = std::clamp(disc[EDGE], EDGE_PX[0], max_edge);
    const double top = std::max(disc[TOP], MIN_DARKNESS);
    disc[SIDE] = std::clamp(disc[SIDE], SIDE_RANGE[0] * top, SIDE_RANGE[1] * top);
    return change;
}

// Measure discs (n,), which may have neighbours. The inputs are the seeds (n, 2) [px], the
// silhouettes (n,) of the parts at the seeds, and the shadows that the parts cast. `noise` is the
// standard deviation of the image's noise, as darkness.
inline void fit_discs(const LitPlate& plate, View<const double, 2> seeds, const Silhouette* parts,
                      const Shadows& shadows, double noise, Disc* discs) {
    const int count = seeds.size(0);
    std::vector<DiscWindow> windows;
    std::vector<DiscFit> fits;
    std::vector<double> reach, stretch;
    std::vector<float> inner;
    windows.reserve(count);
    for (int k = 0; k < count; k++) {
        const double x = seeds(k, 0), y = seeds(k, 1), radius = parts[k].radius_px;
        double to_x, to_y;
        parts[k].to_image(parts[k].lean_px[0], parts[k].lean_px[1], to_x, to_y);
        windows.emplace_back(plate, x, y, parts[k]);
        const double dark =
            first_darkness(windows[k], x + 0.5 * to_x, y + 0.5 * to_y, radius, inner);
        fits.push_back({x, y, radius, EDGE_PX[1], dark, dark});
        stretch.push_back(parts[k].stretch());
        const double cast =
            shadows.any() ? length_of(shadows.cast[2 * k], shadows.cast[2 * k + 1]) : 0;
        reach.push_back(parts[k].reach() + stretch[k] * cast + rim_of(parts[k]));
        discs[k].misfit = 1;
    }
    std::vector<std::vector<int>> neighbours(count);
    for (int k = 0; k < count; k++)
        for (int j = 0; j < k; j++) {
            const double dx = seeds(k, 0) - seeds(j, 0), dy = seeds(k, 1) - seeds(j, 1);
            const double near = reach[k] + reach[j];
            if (dx * dx + dy * dy < near * near)
                neighbours[k].push_back(j), neighbours[j].push_back(k);
        }
    std::vector<char> moved(count, true), moves(count);
    PixelNumbers pixels;
    double normal[UNKNOWNS][UNKNOWNS], right[UNKNOWNS];
    for (int iteration = 0; iteration < MAX_ITERATIONS; iteration++) {
        bool still = true;
        std::fill(moves.begin(), moves.end(), false);
        for (int k = 0; k < count; k++) {
            bool stale = moved[k];
            for (int j : neighbours[k]) stale |= moved[j];
            if (!stale) continue;
            without_others(windows[k], fits, parts, stretch, shadows, neighbours[k]);
            const bool high = parts[k].is_high();
            const Contour cast = shadows.any() ? shadows.contour(fits[k], parts[k], k)
                                               : Contour(fits[k], parts[k]);
            const auto add = shadows.any() ? (high ? sum_up_high_shadowed : sum_up_shadowed)
                                           : (high ? sum_up_high : sum_up_flat);
            add(windows[k], fits[k], parts[k], cast, shadows.darkness, noise, pixels, normal, right,
                discs[k]);
            if (improve(fits[k], normal, right, parts[k].radius_px) >= SETTLED_PX) {
                moves[k] = true;
                still = false;
            }
        }
        moved.swap(moves);
        if (still) break;
    }
    for (int k = 0; k < count; k++) {
        const DiscFit& fit = fits[k];
        discs[k].x_px = fit[X], discs[k].y_px = fit[Y], discs[k].radius_px = fit[RADIUS];
        discs[k].darkness = fit[TOP];
    }
}

}  // namespace plate
