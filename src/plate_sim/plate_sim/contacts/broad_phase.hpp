// Which parts may touch: a list of close pairs that stays good over many steps.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "contacts/impulses.hpp"

namespace plate::contacts {

// Pairs nearer than this share of the greatest reach are listed; until two parts have moved so far
// towards each other, no other pair can touch.
constexpr double SKIN = 0.25;

struct Pair {
    int i, j;
};

// Least and greatest of some x and y [m].
struct Bounds {
    double low_x, high_x, low_y, high_y;
};

// The pairs of parts on the plate (`here`, (M,)) whose rims are near.
struct NearPairs {
    std::vector<Pair> pairs;
    double skin = INFINITE;  // parts may move so far [m] towards each other until it is out of date
    double gap = INFINITE;   // the least gap [m] of any two, at most the skin
    AlignedNumbers mark_x, mark_y;  // where parts were when it was made, room for all columns
    std::vector<int> order;         // all parts in order of x then

    explicit NearPairs(int columns) : mark_x(columns), mark_y(columns) {}

    // List them anew.
    void find(const State& state, Bodies bodies, View<const bool, 1> here) {
        const int count = here.size(0);
        const double *x = state[X], *y = state[Y];
        std::copy_n(x, state.size(1), mark_x.data()), std::copy_n(y, state.size(1), mark_y.data());
        for (int i = order.size(); i < count; i++) order.push_back(i);
        double most = 0.0;
        for (int a = 0; a < count; a++) {
            const int i = order[a];
            most = std::max(most, bodies[i].reach);
            int b = a;
            for (; b > 0 && x[i] < x[order[b - 1]]; b--)  // insertion: quick where little changed
                order[b] = order[b - 1];
            order[b] = i;
        }
        skin = gap = SKIN * most;
        pairs.clear();
        for (int a = 0; a < count; a++) {
            const int i = order[a];
            if (!here(i)) continue;
            const double size = bodies[i].reach + skin;
            for (int b = a + 1; b < count; b++) {
                const int j = order[b];
                const double dx = x[j] - x[i], dy = y[j] - y[i];
                if (dx >= size + most) break;
                const double reach = size + bodies[j].reach, distance2 = dx * dx + dy * dy;
                if (here(j) && distance2 < reach * reach) {
                    pairs.push_back({i, j});
                    gap = std::min(gap, std::sqrt(distance2) - bodies[i].reach - bodies[j].reach);
                }
            }
        }
    }

    // Bound on how far [m] any two parts moved towards each other since the list was made, by how
    // far parts have moved along x and y at least and at most.
    static double approach(const Bounds& moved) {
        if (moved.high_x < moved.low_x) return 0.0;  // there are none
        const double wide = moved.high_x - moved.low_x, high = moved.high_y - moved.low_y;
        return std::sqrt(wide * wide + high * high);
    }
};

}  // namespace plate::contacts
