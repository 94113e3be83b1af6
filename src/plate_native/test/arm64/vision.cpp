// Discs and outlines in drawn images, and where a part may be in a group.
#include <algorithm>
#include <cmath>
#include <memory>

#include "discs/fit.hpp"
#include "discs/judge.hpp"
#include "discs/measure.hpp"
#include "shapes/outlines.hpp"
#include "shapes/placing.hpp"

#include "draws.hpp"

using namespace plate;

constexpr int PIXELS = 96;  // of an image [px]

static void discs(Draws& draws) {
    std::vector<std::uint8_t> grey(PIXELS * PIXELS);
    const int count = 3;
    const double radius = draws.in(6, 8);
    Numbers seeds;
    for (int k = 0; k < count; k++) seeds.insert(seeds.end(), {20 + 22. * k + draws.in(-3, 3), draws.in(30, 60)});
    for (int y = 0; y < PIXELS; y++)
        for (int x = 0; x < PIXELS; x++) {
            double level = 200 + draws.in(-3, 3);
            for (int k = 0; k < count; k++)
                level -= 120 * std::clamp(radius + 0.5 - length_of(x - seeds[2 * k], y - seeds[2 * k + 1]), 0.0, 1.0);
            grey[y * PIXELS + x] = static_cast<std::uint8_t>(std::max(level, 0.0));
        }
    for (double& seed : seeds) seed += draws.in(-0.8, 0.8);
    const float light[9] = {200, 1, 2, 0.5, 0.2, -0.3f, PIXELS / 2, PIXELS / 2, 2.f / PIXELS};
    const auto usable = std::make_unique<bool[]>(PIXELS * PIXELS), alone = std::make_unique<bool[]>(count);
    std::fill_n(usable.get(), PIXELS * PIXELS, true), std::fill_n(alone.get(), count, true);
    const LitPlate plate{{grey.data(), {PIXELS, PIXELS}}, {light, {9}}, {usable.get(), {PIXELS, PIXELS}}};
    const std::vector<Silhouette> shapes(
        count, {{{1, draws.in(-0.1, 0.1)}, {0, draws.in(0.9, 1.1)}}, radius, {draws.in(-1, 1), draws.in(-1, 1)}, 1.02});
    std::vector<Disc> found(count);
    Numbers dirt(count), marks = draws.many(2 * count, 20, 70), depth(count, 9.0), cast = draws.many(2 * count, -4, 4);
    const auto places = given<2>(seeds, {count, 2});
    const auto report = [&] {
        put(reinterpret_cast<const double*>(found.data()), 7 * found.size());
        for (const Judged& one : judge(found.data(), shapes.data(), given<2>(marks, {count, 2}), depth.data(),
                                       depth.data(), {0.01, 0.5, 0.5, 3}).found)
            put(&one.x_px, 7);
    };
    measure_alone(plate, places, shapes.data(), alone.get(), found.data(), dirt.data());
    put(dirt), report();
    fit_discs(plate, places, shapes.data(), {cast.data(), draws.below(2) ? 0.2 : 0, 1.5}, 0.01, found.data());
    report();
}

static void outlines(Draws& draws) {
    std::vector<float> field(PIXELS * PIXELS), free(PIXELS * PIXELS);
    const double radius = draws.in(15, 25), middle = PIXELS / 2 + draws.in(-3, 3);
    for (int y = 0; y < PIXELS; y++)
        for (int x = 0; x < PIXELS; x++) {
            const double inside = radius - length_of(x - middle, y - middle);
            field[y * PIXELS + x] = static_cast<float>(std::clamp(inside / 2 + draws.in(0.4, 0.6), 0.0, 1.0));
            free[y * PIXELS + x] = static_cast<float>(inside);
        }
    std::vector<std::int32_t> ring;
    const int number = 90, count = 64;
    for (int k = 0; k < number; k++) {
        const double angle = 6.283 * k / number;
        ring.push_back(static_cast<int>(middle + radius * std::cos(angle)) + 1);
        ring.push_back(static_cast<int>(middle + radius * std::sin(angle)) + 1);
    }
    Numbers points(2 * count);
    find_edge({field.data(), {PIXELS, PIXELS}}, {ring.data(), {number, 2}}, false, shaped<double, 2>(points, {count, 2}));
    put(points);
    const std::int64_t ends[] = {count};
    const OutlineMeasures measured = measure_outline(shaped<double, 2>(points, {count, 2}), {ends, {1}});
    put(&measured.area, 3), put(&measured.spectrum[0].real, 2 * HARMONICS);
    const Numbers edges = outline_edges(given<2>(points, {count, 2}), {ends, {1}});
    const View<const double, 2> rim = given<2>(edges, {static_cast<int>(edges.size() / 5), 5});
    Numbers moved = points;
    for (double& one : moved) one += draws.in(-1, 1);
    const double pose[] = {draws.in(-1, 1), draws.in(-1, 1), draws.in(-0.2, 0.2)};
    const auto infinite = std::numeric_limits<double>::infinity();
    const PoseFit fit = fit_pose(rim, given<2>(moved, {count, 2}), pose, 1, true, 8, infinite, infinite);
    put(&fit.x, 5);
    put(turn_scatter(rim, given<2>(moved, {count, 2}), &fit.x, 1, 1, infinite));
    const double to_px[] = {1, 0.01, middle, -0.01, 1, middle};
    const Numbers part = draws.many(40, -8, 8), inner = draws.many(30, -4, 4), turns = draws.many(6, -3, 3);
    for (const PlaceFound& one : search({free.data(), {PIXELS, PIXELS}}, {free.data(), {PIXELS, PIXELS}}, {to_px, {2, 3}},
                                        given<2>(part, {20, 2}), given<2>(inner, {15, 2}), &inner[0], 3,
                                        given<1>(turns, {6}), 3))
        put(&one.x, 4);
}

int main(int, char** words) {
    return repeat(words, [](Draws& draws) {
        for (auto check : {discs, outlines}) check(draws);
    });
}
