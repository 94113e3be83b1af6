// Broad phase of collision detection: makes a list of pairs of parts that are near each other. The
// list stays valid for many time steps.
//
// The skin is a safety distance around the parts. Parts are sorted by x, and all pairs with a gap
// below the width of the skin are listed. No other pair can touch until two parts have approached
// each other by this width.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "contacts/impulses.hpp"

namespace plate::contacts {

// Width of the skin, as a fraction of the maximum reach of the parts.
constexpr double SKIN = 0.25;

struct Pair {
    int i, j;
};

// Pairs of parts with a small gap. The list contains only parts on the plate. `on_plate` (M,)
// states which parts are on the plate.
struct NearPairs {
    std::vector<Pair> pairs;
    double skin = INFINITE;  // maximum approach of two parts for which the list is valid [m]
    double gap = INFINITE;   // minimum gap [m] of any two parts, at most the skin
    std::vector<double> x, y;  // reference positions: those when the list was made [m]
    std::vector<int> order;    // indices of the parts, sorted by x when the list was made

    // Rebuild the list.
    void find(const State& state, Bodies bodies, View<const bool, 1> on_plate) {
        const int count = on_plate.size(0);
        x.resize(count), y.resize(count);
        for (int i = 0; i < count; i++) {
            Group& group = state.group(i);
            x[i] = group.reference[X][State::lane(i)] = state(X, i);
            y[i] = group.reference[Y][State::lane(i)] = state(Y, i);
        }
        for (int i = order.size(); i < count; i++) order.push_back(i);
        double maximum = 0.0;
        for (int a = 0; a < count; a++) {
            const int i = order[a];
            maximum = std::max(maximum, bodies[i].reach);
            int b = a;
            // An insertion sort is fast here, because the order of the parts changes little between
            // two lists.
            for (; b > 0 && x[i] < x[order[b - 1]]; b--)
                order[b] = order[b - 1];
            order[b] = i;
        }
        skin = gap = SKIN * maximum;
        pairs.clear();
        for (int a = 0; a < count; a++) {
            const int i = order[a];
            if (!on_plate(i)) continue;
            const double size = bodies[i].reach + skin;
            for (int b = a + 1; b < count; b++) {
                const int j = order[b];
                const double dx = x[j] - x[i], dy = y[j] - y[i];
                if (dx >= size + maximum) break;
                const double reach = size + bodies[j].reach, distance2 = dx * dx + dy * dy;
                if (on_plate(j) && distance2 < reach * reach) {
                    pairs.push_back({i, j});
                    gap = std::min(gap, std::sqrt(distance2) - bodies[i].reach - bodies[j].reach);
                }
            }
        }
    }
};

}  // namespace plate::contacts
