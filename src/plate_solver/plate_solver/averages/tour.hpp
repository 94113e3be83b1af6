// C++ kernels of tour.py, which orders the rotations of a sequence so that the velocity changes
// between them are small.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <plate/view.hpp>

namespace plate::rotations {

// Maximum number of rounds of the 2-opt method. Usually four rounds are sufficient.
constexpr int MAX_ROUNDS = 20;

// Returns the velocity change (J, J) [m/s] between each pair of twists (J, 3), at the corner of the
// plate where this change is largest. `half` contains the half side lengths of the plate [m].
inline Matrix changes(View<const double, 2> twists, const double* half) {
    const int count = twists.size(0);
    Matrix change(count, count);
    for (int i = 0; i < count; i++)
        for (int j = 0; j < i; j++) {
            double d[3], maximum = 0;
            for (int c = 0; c < 3; c++) d[c] = twists(i, c) - twists(j, c);
            for (double x : {-half[0], half[0]})
                for (double y : {-half[1], half[1]}) {
                    const double u = d[0] - d[2] * y, v = d[1] + d[2] * x;
                    maximum = std::max(maximum, u * u + v * v);
                }
            change[i][j] = change[j][i] = std::sqrt(maximum);
        }
    return change;
}

// Returns a short closed tour through all indices. The tour begins and ends at index 0. The
// distance between the indices i and j is change[i][j]. The initial tour always continues with the
// nearest unvisited index. Then the 2-opt method reverses sections of the tour as long as this
// makes the tour shorter.
inline std::vector<int> short_tour(const Matrix& change) {
    const int count = change.rows;
    std::vector<int> tour(count + 1);
    std::vector<char> free(count, true);
    for (int k = 1; k < count; k++) {
        free[tour[k - 1]] = false;
        double best = std::numeric_limits<double>::infinity();
        for (int j = 0; j < count; j++) {
            const double length = change[tour[k - 1]][j];
            if (free[j] && length < best) best = length, tour[k] = j;
        }
    }
    bool improved = true;
    for (int round = 0; round < MAX_ROUNDS && improved; round++) {
        improved = false;
        for (int i = 1; i < count - 1; i++)
            for (int j = i + 1; j < count; j++) {
                const int a = tour[i - 1], b = tour[i], c = tour[j], d = tour[j + 1];
                if (change[a][c] + change[b][d] < change[a][b] + change[c][d] - 1e-12) {
                    std::reverse(tour.begin() + i, tour.begin() + j + 1);
                    improved = true;
                }
            }
    }
    return tour;
}

}  // namespace plate::rotations
