// Basin hopping: fresh starts, and disturbances of what is already good, until one will do.
#pragma once
#include <limits>

namespace plate {

// Number of the first start.
constexpr int FIRST = 0;

// Cost over that of the round's best, below which a hop has helped: hops are counted anew.
constexpr double BETTER = 0.99;

// What is found from a start, its cost, the steps taken, and whether it will do.
template <class Find>
struct Attempted {
    Find found;
    double cost;
    int steps;
    bool enough;
};

// The best find, the steps of all starts, and how many these were.
template <class Find>
struct Searched {
    Find best;
    int steps, tried;
};

// Search by `propose(number, near, fresh)`, which returns a start: near a find, or afresh, and by
// `attempt(start, number, least)`, which returns `Attempted<Find>`; `least` is the least cost so
// far (infinite at first). `tries`, `hops`, `rounds` and `failed` are those of basin_hopping.py.
template <class Find, class Start, class Propose, class Attempt>
Searched<Find> basin_hopping(Propose&& propose, Attempt&& attempt, const Start& begin, int tries,
                             int hops, bool rounds, int failed) {
    Attempted<Find> now = attempt(begin, FIRST, std::numeric_limits<double>::infinity());
    Searched<Find> all{now.found, now.steps, FIRST + 1};
    double least = now.cost, near_cost = now.cost;
    Find near = now.found;
    while (!now.enough && all.tried < tries) {
        const bool fresh = failed >= hops;
        now = attempt(propose(all.tried, near, fresh), all.tried, least);
        all.steps += now.steps;
        all.tried++;
        if (now.enough || now.cost < least) all.best = now.found, least = now.cost;
        const bool helped = rounds && now.cost < BETTER * near_cost;
        failed = fresh || helped ? 0 : failed + 1;
        if (now.cost < near_cost || (fresh && rounds)) near = now.found, near_cost = now.cost;
    }
    return all;
}

}  // namespace plate
