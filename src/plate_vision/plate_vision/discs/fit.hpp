// Centres, radii and darkness of round parts that touch others: see fit.py.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "discs/measure.hpp"

namespace plate {

// Least, first and greatest half width [px] of a disc's edge, where its cover rises from 0 to 1 as
// a cubic: 0.5 are sharp pixels, 1.1 a lens with a blur of 0.6 px (standard deviation).
constexpr double EDGE_PX[] = {0.4, 0.8, 3.0};

// Largest change of a centre or radius [px] in one iteration: edges are seen only when near.
constexpr double MAX_STEP_PX = 1.0;

// Change [px] of centre and radius after which the fit has converged: the next change would be a
// tenth of it, and a tenth of the effect of the image's noise.
constexpr double SETTLED_PX = 0.01;

constexpr int MAX_ITERATIONS = 25;

// Added to the normal equations, also as a fraction of their diagonal: keeps them solvable when
// hardly anything of a disc is seen.
constexpr double FIT_DAMPING = 1e-3;

// Unknowns of a disc: x, y, radius, half width of the edge [px], darkness.
enum Unknown { X, Y, RADIUS, EDGE, DARKNESS, UNKNOWNS };
using DiscFit = std::array<double, UNKNOWNS>;

// The usable pixels around a disc: their places [px], their darkness, that less the neighbours',
// and how little these cover.
struct DiscWindow {
    std::vector<float> x, y, dark, rest, seen;
    int size = 0;

    DiscWindow(const LitPlate& plate, double x_px, double y_px, double radius) {
        const int x0 = std::rint(x_px), y0 = std::rint(y_px), reach = std::ceil(radius + RIM_PX);
        const double far = (radius + RIM_PX) * (radius + RIM_PX);
        const int most = (2 * reach + 1) * (2 * reach + 1);
        for (auto* list : {&x, &y, &dark, &rest, &seen}) list->resize(most);
        const int bottom = std::min(y0 + reach + 1, plate.height());
        const int right = std::min(x0 + reach + 1, plate.width());
        for (int row = std::max(y0 - reach, 0); row < bottom; row++)
            for (int column = std::max(x0 - reach, 0); column < right; column++) {
                const int across = column - x0, along = row - y0;
                if (!plate.usable(row, column) || across * across + along * along > far) continue;
                x[size] = column, y[size] = row;
                dark[size] = 1 - plate.grey(row, column) / bare(plate.light.data, column, row);
                size++;
            }
    }
};

// What is added up of a pixel is the products of its numbers, those of the first five with all:
// the slopes of the disc's darkness in its unknowns; the error, one, and the square of the error.
enum Product { ERROR = UNKNOWNS, ONE, SQUARE, PRODUCTS };
struct Slopes {
    float of[PRODUCTS];
};
static_assert(sizeof(Slopes) == sizeof(Eight));

inline double first_darkness(const DiscWindow& window, double x, double y, double radius) {
    double total = 0;
    int count = 0;
    for (int i = 0; i < window.size; i++) {
        const double dx = window.x[i] - x, dy = window.y[i] - y;
        if (dx * dx + dy * dy < CORE * radius * (CORE * radius)) total += window.dark[i], count++;
    }
    return std::max(total / std::max(count, 1), MIN_DARKNESS);
}

// How much of a pixel a disc covers, by how deep it is inside: a cubic from 0 to 1.
[[gnu::always_inline]] inline float cover_at(float u) {
    return 0.5f + u * (0.75f - 0.25f * u * u);
}

// Take the neighbours' darkness off a window.
PLATE_WIDE inline void without_others(DiscWindow& window, const std::vector<DiscFit>& discs,
                                      const std::vector<int>& neighbours) {
    const int size = window.size;
    const float *__restrict x = window.x.data(), *__restrict y = window.y.data();
    float *__restrict rest = window.rest.data(), *__restrict seen = window.seen.data();
    std::copy_n(window.dark.data(), size, rest);
    std::fill_n(seen, size, 1.f);
    for (int j : neighbours) {
        const DiscFit& disc = discs[j];
        const float cx = disc[X], cy = disc[Y], darkness = disc[DARKNESS];
        const float square = disc[RADIUS] * disc[RADIUS];
        const float scale = 0.5 / (disc[RADIUS] * disc[EDGE]);
#pragma omp simd
        for (int i = 0; i < size; i++) {
            const float dx = x[i] - cx, dy = y[i] - cy;
            const float u = std::min(std::max((square - dx * dx - dy * dy) * scale, -1.f), 1.f);
            const float cover = cover_at(u);
            rest[i] -= darkness * cover;
            seen[i] *= 1 - cover;
        }
    }
}

// Add up the normal equations, lower half, of one disc; return its misfit.
//
// How deep a pixel is inside is taken from the square of its distance, (r2 - d2) / 2r, which is
// r - d at the edge: no root.
PLATE_WIDE inline double sum_up(const DiscWindow& window, const DiscFit& disc,
                                std::vector<Slopes>& slopes, double (&normal)[UNKNOWNS][UNKNOWNS],
                                double (&right)[UNKNOWNS]) {
    const float cx = disc[X], cy = disc[Y], darkness = disc[DARKNESS];
    const float squared = disc[RADIUS] * disc[RADIUS];
    const float scale = 0.5 / (disc[RADIUS] * disc[EDGE]);
    const float inverse = 1 / disc[RADIUS], steep = 0.75 * disc[DARKNESS] / disc[EDGE];
    const float *__restrict x = window.x.data(), *__restrict y = window.y.data();
    const float *__restrict rest = window.rest.data(), *__restrict seen = window.seen.data();
    slopes.resize(window.size);
    Slopes* __restrict slope = slopes.data();
#pragma omp simd
    for (int i = 0; i < window.size; i++) {
        const float dx = x[i] - cx, dy = y[i] - cy, weight = seen[i];
        const float u = std::min(std::max((squared - dx * dx - dy * dy) * scale, -1.f), 1.f);
        const float cover = cover_at(u), error = (rest[i] - darkness * cover) * weight;
        const float gr = steep * (1 - u * u) * weight;
        slope[i].of[X] = gr * dx * inverse;
        slope[i].of[Y] = gr * dy * inverse;
        slope[i].of[RADIUS] = gr;
        slope[i].of[EDGE] = -gr * u;
        slope[i].of[DARKNESS] = cover * weight;
        slope[i].of[ERROR] = error;
        slope[i].of[ONE] = 1;
        slope[i].of[SQUARE] = error * error;
    }
    Eight sum[UNKNOWNS] = {};
    for (const Slopes& pixel : slopes) {
        Eight all;
        load(all, pixel.of);
        for (int a = 0; a < UNKNOWNS; a++) sum[a] += pixel.of[a] * all;
    }
    for (int a = 0; a < UNKNOWNS; a++) {
        for (int b = 0; b <= a; b++) normal[a][b] = sum[a][b];
        right[a] = sum[a][ERROR];
    }
    const float square = sum[DARKNESS][SQUARE], all = sum[DARKNESS][ONE];
    return std::sqrt(square / std::max(all, 1.f)) / std::max(disc[DARKNESS], MIN_DARKNESS);
}

// Make one step of a disc by its normal equations; return the change [px].
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
    disc[EDGE] = std::clamp(disc[EDGE], EDGE_PX[0], EDGE_PX[2]);
    return change;
}

// Measure discs (n,), neighbours among them, from first guesses of their centres (n, 2) [px] and
// of the radius [px].
inline void fit_discs(const LitPlate& plate, View<const double, 2> seeds, double radius,
                      Disc* discs) {
    const int count = seeds.size(0);
    std::vector<DiscWindow> windows;
    std::vector<DiscFit> fits;
    for (int k = 0; k < count; k++) {
        const double x = seeds(k, 0), y = seeds(k, 1);
        windows.emplace_back(plate, x, y, radius);
        fits.push_back({x, y, radius, EDGE_PX[1], first_darkness(windows[k], x, y, radius)});
        discs[k].misfit = 1;
    }
    const double near = (2 * radius + 2 * RIM_PX) * (2 * radius + 2 * RIM_PX);
    std::vector<char> moved(count, true), moves(count);
    std::vector<int> neighbours;
    std::vector<Slopes> slopes;
    double normal[UNKNOWNS][UNKNOWNS], right[UNKNOWNS];
    for (int iteration = 0; iteration < MAX_ITERATIONS; iteration++) {
        bool still = true;
        std::fill(moves.begin(), moves.end(), false);
        for (int k = 0; k < count; k++) {
            bool stale = moved[k];
            neighbours.clear();
            for (int j = 0; j < count; j++) {
                const double dx = seeds(k, 0) - seeds(j, 0), dy = seeds(k, 1) - seeds(j, 1);
                if (j != k && dx * dx + dy * dy < near) {
                    neighbours.push_back(j);
                    stale |= moved[j];
                }
            }
            if (!stale) continue;
            without_others(windows[k], fits, neighbours);
            discs[k].misfit = sum_up(windows[k], fits[k], slopes, normal, right);
            if (improve(fits[k], normal, right, radius) >= SETTLED_PX) {
                moves[k] = true;
                still = false;
            }
        }
        moved.swap(moves);
        if (still) break;
    }
    for (int k = 0; k < count; k++)
        discs[k] = {fits[k][X], fits[k][Y], fits[k][RADIUS], fits[k][DARKNESS], discs[k].misfit};
}

}  // namespace plate
