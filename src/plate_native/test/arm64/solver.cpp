// Force maps, the cycle map and its gradients, requests, proofs of what is unreachable.
#include <cmath>
#include <numbers>

#include "averages/unreachable.hpp"
#include "limits.hpp"
#include "averages/mean_force.hpp"
#include "averages/sinusoid_force.hpp"
#include "cycle_map/stick_slip.hpp"
#include "cycle_map/turning.hpp"
#include "averages/request.hpp"

#include "draws.hpp"

using namespace plate;

static void cycle_maps(Draws& draws) {
    const int count = 1 + draws.below(12), steps = 60;
    const Numbers position = draws.many(2 * count, -0.2, 0.2), spread = draws.many(3 * count, 1e-5, 9e-5);
    const Numbers velocity = draws.many(2 * count, -0.1, 0.1), spin = draws.many(count, -1, 1);
    const Numbers accel = draws.many(count, 1, 4), dt = draws.many(steps, 1e-3, 3e-3);
    const Numbers pose = draws.many(3 * steps, -0.01, 0.01), twist = draws.many(3 * steps, -0.6, 0.6);
    const Samples poses{pose.data(), steps, 3, 1}, twists{twist.data(), steps, 3, 1};
    const auto places = given<2>(position, {count, 2}), speeds = given<2>(velocity, {count, 2});
    for (const bool turning : {false, true}) {
        const int wide = (turning ? 3 : 2) * count;
        Matrix parts, past;
        const auto begin = [&] {
            const int rows = turning ? end_turning_rows::ROWS : stick_slip::ROWS;
            put_side_by_side(places, speeds, given<1>(accel, {count}), rows, parts);
            if (turning) put_rotations(given<1>(spin, {count}), given<2>(spread, {count, 3}), parts);
        };
        begin();
        turning ? end_turning(parts, poses, twists, dt.data()) : end_state(parts, poses, twists, dt.data());
        put(parts[0], parts.rows * parts.columns);
        begin();
        Numbers by_pose(2 * steps * wide), by_twist(3 * steps * wide), by_dt(steps * wide);
        const auto by = [&](auto gradient) {
            gradient(parts, count, poses, twists, dt.data(), 0.01, past,
                     shaped<double, 3>(by_pose, {2, steps, wide}),
                     shaped<double, 3>(by_twist, {3, steps, wide}),
                     shaped<double, 2>(by_dt, {steps, wide}));
        };
        turning ? by(end_turning_gradient) : by(end_state_gradient);
        put(by_pose), put(by_twist), put(by_dt);
    }
}

// As `force_rules` of sinusoid_force.py.
struct Nodes {
    Numbers waves, taylor;

    explicit Nodes(int number, int few, int usual, int pieces)
        : waves(2 * number * (few + usual)), taylor((DEGREE + 1) * number) {
        for (int j = 0; j < number; j++) {
            const int all = few + usual;
            for (int k = 0; k < all; k++) {
                const double share = k < few ? (k + 0.5) / few : (k - few + 0.5) / usual;
                const double angle = 2 * std::numbers::pi * (j + 1) * share;
                waves[j * all + k] = std::sin(angle);
                waves[(number + j) * all + k] = std::cos(angle);
            }
            double term = 1;
            for (int m = 0; m <= DEGREE; m++) {
                taylor[m * number + j] = m % 4 < 2 ? term : -term;
                term *= 2 * std::numbers::pi * (j + 1) / pieces / (m + 1);
            }
        }
    }
};

static void average_forces(Draws& draws) {
    const int number = 2 + draws.below(2), cases = 8, rows = 2 * number, steps = 20;
    const Numbers motions = draws.many(3 * rows * cases, -0.5, 0.5);
    const Numbers position = draws.many(2 * cases, -0.2, 0.2), velocity = draws.many(2 * cases, -0.05, 0.05);
    const auto places = given<2>(position, {cases, 2}), speeds = given<2>(velocity, {cases, 2});
    Numbers force(2 * cases), mean(3 * cases), gradient(9 * steps * cases);
    const auto forces = shaped<double, 2>(force, {cases, 2});
    const int few = 8 * number, usual = 32 * number, pieces = 4 * number;
    const Nodes nodes(number, few, usual, pieces);
    const Rules rules{given<2>(nodes.waves, {rows, few + usual}), few,
                      given<2>(nodes.taylor, {DEGREE + 1, number}), pieces};
    sinusoid_forces(given<3>(motions, {cases, rows, 3}), places, speeds, rules, forces);
    put(force);
    const Numbers times = rising(draws, 5, 0.01, 0.05), factors = draws.many(5 * 18, -1, 1);
    spline_force(times.data(), given<3>(factors, {5, 6, 3}), places, speeds, forces);
    put(force);
    const Numbers twist = draws.many(3 * steps, -0.5, 0.5), dt = draws.many(steps, 0.001, 0.02);
    const auto twists = given<2>(twist, {steps, 3});
    step_forces(places, speeds, twists, dt.data(), shaped<double, 2>(mean, {cases, 3}));
    step_force_gradient(places, speeds, twists, dt.data(),
                        shaped<double, 3>(gradient, {3, steps, 3 * cases}));
    put(mean), put(gradient);
}

static void requests(Draws& draws) {
    const int count = 1 + draws.below(10);
    Numbers force = draws.many(2 * count, -2, 2);
    if (draws.below(4) == 0)
        for (double& one : force) one *= std::ldexp(1.0, draws.below(2000) - 1000);
    const Numbers position = draws.many(2 * count, -0.2, 0.2), slack = draws.many(2 * count, 0, 0.5);
    put(request_flags(given<2>(position, {count, 2}), given<2>(force, {count, 2}),
                      given<2>(position, {count, 2}), given<1>(position, {count}),
                      given<2>(slack, {count, 2}))
            .max_force);
}

static void limits_used(Draws& draws) {
    const int steps = 50;
    const Numbers pose = draws.many(3 * steps, -0.3, 0.3), twist = draws.many(3 * steps, -0.5, 0.5);
    const Numbers accel = draws.many(3 * steps, -50, 50), some = draws.many(sizeof(Limits) / sizeof(double), 0.1, 1);
    Limits limits{};
    std::copy_n(some.data(), some.size() - 1, reinterpret_cast<double*>(&limits));
    limits.heat = 3, limits.forceful = true;
    const Samples poses{pose.data(), steps, 3, 1}, twists{twist.data(), steps, 3, 1};
    const double weight[] = {2, 1, 1, 1, 1};
    put(limit_use(poses, twists, {accel.data(), steps, 3, 1}, {weight, {5}}, limits, false));
}

static void unreachables(Draws& draws) {
    const int count = 2 + draws.below(6), cells = 2, twists = 10;
    const Numbers position = draws.many(2 * count, -0.2, 0.2), separating = draws.many(2 * count, -1, 1);
    const Numbers twist = draws.many(3 * twists, -1, 1);
    const auto places = given<2>(position, {count, 2});
    Numbers slips(2 * count * twists), cell, points(3 * cells * unreachable::POINTS);
    unreachable::unit_slips(given<2>(twist, {twists, 3}), places, 0.1,
                            shaped<double, 2>(slips, {twists, 2 * count}));
    put(slips);
    for (int q = 0; q < cells; q++) {
        const double low = draws.in(0, 1.3), left = draws.in(0, 3);
        cell.insert(cell.end(), {low, low + 0.2, left, left + 0.2});
    }
    unreachable::circles(given<2>(cell, {cells, 4}),
                         shaped<double, 3>(points, {cells, unreachable::POINTS, 3}));
    put(points);
    const Numbers values = draws.many(cells * unreachable::POINTS, -1, 1);
    const auto best = unreachable::best_triple(given<2>(values, {cells, unreachable::POINTS}));
    put(best.triple), put(best.indices[1]);
    unreachable::Circle circle(unreachable::POINTS);
    circle.turn_to(cell[0], cell[2]);
    Numbers maximum(unreachable::POINTS);
    unreachable::upper(circle, places, 0.1, separating.data(), 0.1, maximum.data());
    put(maximum);
    put(unreachable::proves(given<2>(cell, {cells, 4}), places, 0.1, separating.data(), 1.0));
}

int main(int, char** words) {
    return repeat(words, [](Draws& draws) {
        for (auto check : {cycle_maps, average_forces, requests, limits_used, unreachables}) check(draws);
    });
}
