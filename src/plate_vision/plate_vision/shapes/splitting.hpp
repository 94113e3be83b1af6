// C++ kernels of splitting.py, which separates touching parts: a patch of the image is split at
// narrow places, called necks.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <utility>
#include <vector>

#include <plate/view.hpp>

namespace plate {

// Minimum half width of an area that is separated from a wider area. THIN_PX is in pixels. THINNER
// is relative to the half width of the wider area. An area below both minima, for example a wire or
// an irregular edge, is not separated.
constexpr double THIN_PX = 2.2, THINNER = 0.3;

// Maximum number of necks that are kept for a patch.
constexpr int MAX_NECKS = 200;

// The neck between two parts: numbers of the parts, from 1 on, and width of the neck relative to
// the width of the narrower part.
struct Neck {
    double one, other, width;
};

// Pixels are sorted by their rounded distance. MAX_STEPS is the maximum number of different rounded
// distances.
constexpr double MAX_STEPS = 1e6;

struct Basins {
    int count;
    std::vector<Neck> necks;
};

// Returns the indices of the pixels (h, w) with a depth above 0. The deepest pixels are first. A
// counting sort with depths rounded to multiples of 1 / `levels` determines the order. Pixels with
// the same rounded depth are in the order of their rows.
inline std::vector<int> from_the_deepest(View<const float, 2> depth, int levels) {
    const int size = depth.size(0) * depth.size(1);
    std::vector<int> inside(size), steps;
    int count = 0, top = 0;
    for (int i = 0; i < size; i++) {
        inside[count] = i;
        count += depth.data[i] > 0;
    }
    inside.resize(count), steps.reserve(count);
    for (int i : inside) {
        const double step = static_cast<double>(depth.data[i]) * levels;
        if (!(step < MAX_STEPS)) throw std::invalid_argument("the patch is too deep");
        steps.push_back(step);
        top = std::max(top, steps.back());
    }
    std::vector<int> start(top + 2), order(count);
    for (int step : steps) start[top - step + 1]++;
    for (int k = 0; k <= top; k++) start[k + 1] += start[k];
    for (int k = 0; k < count; k++) order[start[top - steps[k]]++] = inside[k];
    return order;
}

// Computes the watershed of the distance `depth` (h, w). A flood begins at each peak and spreads
// downwards. The function sets `labels` (h, w), which must be 0 before the call, to the number of
// each pixel's basin. The function returns the number of basins and the necks between the basins.
//
// Where two floods meet, there is a saddle. The floods are merged, unless both peaks are
// sufficiently high above the saddle.
inline Basins find_basins(View<const float, 2> depth, double neck, double min_drop, int levels,
                          View<int32_t, 2> labels) {
    const int height = depth.size(0), width = depth.size(1);
    struct Flood {
        int parent;  // index of the flood into which this flood was merged, or its own index
        double peak;
    };
    struct Meeting {
        int one, other;
        double saddle;
    };
    std::vector<Flood> floods(1);
    std::vector<Meeting> meetings;
    const auto root = [&](int flood) {
        while (floods[flood].parent != flood) flood = floods[flood].parent;
        return flood;
    };
    const std::vector<int> order = from_the_deepest(depth, levels);
    for (int pixel : order) {
        const int y = pixel / width, x = pixel % width;
        const float here = depth.data[pixel];
        int own = 0, nearest = 0;
        double best = 0;
        for (int dy = -1; dy <= 1; dy++)
            for (int dx = -1; dx <= 1; dx++) {
                if (y + dy < 0 || y + dy >= height || x + dx < 0 || x + dx >= width) continue;
                const int beside = pixel + dy * width + dx;
                int other = labels.data[beside];
                if (other == 0) continue;
                const double higher = depth.data[beside] - here;
                const double rise = dx && dy ? higher / std::sqrt(2.0) : higher;
                if (nearest == 0 || rise > best) nearest = other, best = rise;
                other = root(other);
                if (own == 0 || own == other) {
                    own = other;
                    continue;
                }
                const double lower = std::min(floods[own].peak, floods[other].peak);
                const double wider = std::max(floods[own].peak, floods[other].peak);
                const bool thin = lower < THIN_PX && lower < THINNER * wider;
                if (here >= neck * lower || lower - here < min_drop || thin) {
                    if (floods[own].peak < floods[other].peak) std::swap(own, other);
                    floods[other].parent = own;
                } else if (meetings.size() < MAX_NECKS) {
                    const bool known =
                        std::any_of(meetings.begin(), meetings.end(), [&](const Meeting& old) {
                            const int a = root(old.one), b = root(old.other);
                            return (a == own && b == other) || (a == other && b == own);
                        });
                    if (!known) meetings.push_back({own, other, here});
                }
            }
        if (own == 0) {
            nearest = floods.size();
            floods.push_back({nearest, here});
        }
        labels.data[pixel] = nearest;
    }
    Basins found{};
    std::vector<int> number(floods.size());
    for (size_t k = 1; k < floods.size(); k++)
        if (floods[k].parent == static_cast<int>(k)) number[k] = ++found.count;
    for (int pixel : order) labels.data[pixel] = number[root(labels.data[pixel])];
    for (const auto& [one, other, saddle] : meetings) {
        const int a = root(one), b = root(other);
        const double narrower = std::min(floods[a].peak, floods[b].peak);
        found.necks.push_back({static_cast<double>(number[a]), static_cast<double>(number[b]),
                               saddle / narrower});
    }
    return found;
}

}  // namespace plate
