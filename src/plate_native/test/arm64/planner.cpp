// What the planner believes of parts, propagated.
#include "estimation/filter.hpp"

#include "draws.hpp"

int main(int, char** words) {
    return repeat(words, [](Draws& draws) {
        const int count = 1 + draws.below(20), steps = 40;
        Numbers state = draws.many(5 * count, -0.3, 0.3);
        const Numbers bound = draws.many(count, 1, 5), pose = draws.many(3 * steps, -0.01, 0.01);
        const Numbers twist = draws.many(3 * steps, -0.5, 0.5);
        const Numbers begin = draws.many(count, 0, 0.02), end = draws.many(count, 0.05, 0.1);
        plate::stick_slip(shaped<double, 2>(state, {count, 5}), bound.data(),
                          {pose.data(), steps, 3, 1}, {twist.data(), steps, 3, 1}, begin.data(),
                          end.data(), 0.002);
        put(state);
    });
}
