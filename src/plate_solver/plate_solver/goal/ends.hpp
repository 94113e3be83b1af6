// C++ kernels of ends.py, which computes the errors of the parts' positions and angles at the end
// of a cycle.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <plate/view.hpp>

namespace plate {

// A part at a distance b [m] beyond a wall has the error b + b^2 / STEEP_M. At b = STEEP_M, the
// error is 2 b. Without the second term, the search could move a part that is at its target over
// the edge, to reduce large errors of other parts.
constexpr double STEEP_M = 0.01;

// Requested end coordinates (C,) of M parts. `Ends` in ends.py describes the fields.
struct Ends {
    std::vector<double> low, high, weight, edge_low, edge_high;
    std::vector<std::array<int, 2>> pair;
    std::vector<double> clear;
    int parts;
};

// Computes the errors (R,) of end coordinates (C,) [m, rad], and the negative derivatives (R, C) of
// the errors. The first C rows belong to the coordinates. Each further row belongs to a pair of
// parts that are too close to each other.
inline void end_errors(const std::vector<double>& end, const Ends& ends, std::vector<double>& error,
                       Matrix& slope) {
    const int size = end.size(), count = ends.parts, pairs = ends.pair.size();
    error.assign(size + pairs, 0.0);
    slope.resize(size + pairs, size);
    std::fill_n(slope[0], (size + pairs) * size, 0.0);
    for (int j = 0; j < size; j++) {
        const double value = end[j];
        if (value < ends.low[j] || value > ends.high[j]) {
            const double nearest = value < ends.low[j] ? ends.low[j] : ends.high[j];
            error[j] += ends.weight[j] * (nearest - value);
            slope[j][j] += ends.weight[j];
        }
        if (value < ends.edge_low[j]) {
            const double beyond = ends.edge_low[j] - value;
            error[j] += beyond + beyond * beyond / STEEP_M;
            slope[j][j] += 1 + 2 * beyond / STEEP_M;
        } else if (value > ends.edge_high[j]) {
            const double beyond = value - ends.edge_high[j];
            error[j] -= beyond + beyond * beyond / STEEP_M;
            slope[j][j] += 1 + 2 * beyond / STEEP_M;
        }
    }
    int rows = size;
    for (int k = 0; k < pairs; k++) {
        const auto [a, b] = ends.pair[k];
        const double dx = end[b] - end[a], dy = end[count + b] - end[count + a];
        const double distance = std::max(std::sqrt(dx * dx + dy * dy), 1e-9);
        if (distance < ends.clear[k]) {
            error[rows] = ends.clear[k] - distance;
            slope[rows][b] = dx / distance, slope[rows][a] = -dx / distance;
            slope[rows][count + b] = dy / distance, slope[rows][count + a] = -dy / distance;
            rows++;
        }
    }
    error.resize(rows);
    slope.rows = rows;
}

}  // namespace plate
