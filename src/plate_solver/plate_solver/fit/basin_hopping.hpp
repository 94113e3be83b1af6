// Basin hopping: local searches from fresh starts and from perturbations of good results, until a
// result is good enough.
#pragma once
#include <limits>

namespace plate {

// Number of the first start.
constexpr int FIRST = 0;

// A hop counts as successful if its cost is below this factor times the best cost of the round. It
// resets the count of failed hops.
constexpr double BETTER = 0.99;

// Result of one start: solution, cost, number of steps, and whether it is good enough.
template <class Find>
struct Attempted {
    Find found;
    double cost;
    int steps;
    bool enough;
};

// Best result, total number of steps, and number of starts.
template <class Find>
struct Searched {
    Find best;
    int steps, tried;
};

// Runs the search. `propose(number, near, fresh)` returns a start near a result, or a fresh one.
// `attempt(start, number, least)` returns `Attempted<Find>`; `least` is the minimum cost so far
// (initially infinite). `tries`, `hops`, `rounds` and `failed` are described in basin_hopping.py.
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
