// The simulated world: discs and squares that slide and collide, and points by the exact motion.
#include <algorithm>
#include <memory>

#include "friction/point_events.hpp"
#include "world/bodies.hpp"

#include "draws.hpp"

using namespace plate;

constexpr double RADIUS_M = 0.01, SIDE_M = 0.02;

// Pieces (K, 6, 3) of a motion that starts at home: low powers first.
static Numbers motion(Draws& draws, int pieces, bool turns) {
    Numbers factors(18 * pieces);
    for (int k = 0; k < pieces; k++)
        for (int power = 0; power < 6; power++)
            for (int axis = 0; axis < (turns ? 3 : 2); axis++) {
                const double most[] = {1e-3, 0.2, 5, 100, 1e3, 1e4};
                factors[18 * k + 3 * power + axis] = draws.in(-most[power], most[power]);
            }
    return factors;
}

static void bodies(Draws& draws) {
    const int count = 16, pieces = 3, steps = 60;
    const Numbers times = rising(draws, pieces, 0.03, 0.05), factors = motion(draws, pieces, true);
    const Numbers limit = draws.many(count, 1, 4);
    std::vector<Body> all(count);
    const double half = SIDE_M / 2, least = RADIUS_M * RADIUS_M / 2;
    const Numbers mesh{-half / 2, half / 2, half / 2, -half / 2, -half / 2, -half / 2, half / 2, half / 2,
                       0.25, 0.25, 0.25, 0.25, half, half, half, half};
    const std::vector<contacts::Convex> convex{{0, 4}};
    const std::vector<contacts::Corner> corners{
        {-half, -half, 0, -1, 0}, {half, -half, 1, 0, 0}, {half, half, 0, 1, 0}, {-half, half, -1, 0, 0}};
    Numbers state(6 * count);
    const auto here = std::make_unique<bool[]>(count);
    for (int i = 0; i < count; i++) {
        const bool square = i == 0;
        all[i] = {1, square ? SIDE_M * SIDE_M / 6 : least, square ? 0 : RADIUS_M, square ? 1.5 * half : RADIUS_M,
                  square ? 1.0 : 0.0, 20, 0, square ? 4 : 0, 0, square ? 1 : 0};
        const double place[] = {0.03 * (i % 4) - 0.045, 0.03 * (i / 4) - 0.045};
        for (int row = 0; row < 6; row++)
            state[6 * i + row] = row < 2 ? place[row] + draws.in(-4e-3, 4e-3) : draws.in(-0.05, 0.05);
        here[i] = true;
    }
    const double edge[] = {0.09, 0.08};
    const Job job{times.data(), factors.data(), pieces, steps, 3, 1, {0.01, 0.02, 1.1, 0.02, 0.001},
                  shaped<double, 2>(state, {count, 6}), limit.data(), {here.get(), {count}}, {}};
    const Shapes shapes{all, given<2>(mesh, {4, 4}), convex, corners};
    put(run(job, shapes, {0.3, 0.2, true, draws.below(2) == 0}, 1.0, edge).depth);
    put(state);
}

static void points(Draws& draws) {
    const int count = 5, pieces = 1, rows = 10;  // of two the second would begin with a jump
    const bool turns = draws.below(3) > 0;
    const Numbers times = rising(draws, pieces, 0.03, 0.05), factors = motion(draws, pieces, turns);
    const Numbers limit = draws.many(count, 1, 4);
    std::vector<Piece> table(pieces);
    const Scales scales = tabulate(times.data(), factors.data(), {0.01, 0.02}, false, table);
    Numbers path = draws.many(2 * rows * count, -0.2, 0.2), speed(2 * rows * count);
    bool checked[count];
    put(sliding::run_points(table, scales, limit.data(), 1.2, 1e-6, 1, path.data(), speed.data(), rows,
                            count, checked));
    put(path), put(speed);
}

int main(int, char** words) {
    return repeat(words, [](Draws& draws) {
        for (auto check : {bodies, points}) check(draws);
    });
}
