// C++ kernels of unreachable.py, which proves that no plate motion of N harmonics can exert the
// requested forces. The file unreachable.py defines the symbols T, g, s, n and lambda.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include <plate/length.hpp>
#include <plate/view.hpp>
#include <plate/wide.hpp>

namespace plate::unreachable {

constexpr double PI = std::numbers::pi;

// Number of sample points on each great circle. The great circles are on the unit sphere of the
// plate's twists.
constexpr int POINTS = 48;

// A proof divides the set of all great circles into cells. HALVINGS is the maximum number of
// successive subdivisions of a cell.
constexpr int HALVINGS = 4;

// Maximum number of pairs of points that a proof evaluates. A proof that needs more pairs is
// abandoned. The evaluation of this number of pairs takes some hundredths of a second.
constexpr double MAX_WORK = 2e8;

// Number of neighbouring middle points that `greatest_triple` processes together, with vector
// instructions.
constexpr int SIDE_BY_SIDE = 8;

constexpr double NOTHING = -std::numeric_limits<double>::infinity();

// Points on a great circle, in one array per coordinate.
struct Circle {
    std::vector<double> cosine, sine;  // cosine and sine of equally spaced angles
    std::vector<double> x, y, z;

    explicit Circle(int count) : cosine(count), sine(count), x(count), y(count), z(count) {
        for (int c = 0; c < count; c++) {
            const double angle = 2 * PI * c / count;
            cosine[c] = std::cos(angle), sine[c] = std::sin(angle);
        }
    }

    int count() const { return static_cast<int>(x.size()); }

    void turn_to(double tilt, double turn) {
        const double cos_tilt = std::cos(tilt), sin_tilt = std::sin(tilt);
        const double cos_turn = std::cos(turn), sin_turn = std::sin(turn);
        for (int c = 0; c < count(); c++) {
            const double a = cosine[c], b = sine[c];
            x[c] = a * cos_tilt * cos_turn - b * sin_turn;
            y[c] = a * cos_tilt * sin_turn + b * cos_turn;
            z[c] = -a * sin_tilt;
        }
    }
};

// Computes sample points on the great circle in the middle of each cell (Q, 4). `points` has the
// shape (Q, POINTS, 3).
inline void circles(View<const double, 2> cells, View<double, 3> points) {
    Circle circle(POINTS);
    for (int q = 0; q < cells.size(0); q++) {
        circle.turn_to((cells(q, 0) + cells(q, 1)) / 2, (cells(q, 2) + cells(q, 3)) / 2);
        for (int c = 0; c < POINTS; c++) {
            double* point = points[q] + 3 * c;
            point[0] = circle.x[c], point[1] = circle.y[c], point[2] = circle.z[c];
        }
    }
}

// Computes the unit vectors (T, 2 M) of the slip at M parts, for T twists. The rotation rate in
// `twists` (T, 3) is multiplied by `arm_m`, so that all components have the same unit.
inline void unit_slips(View<const double, 2> twists, View<const double, 2> position, double arm_m,
                    View<double, 2> slips) {
    for (int t = 0; t < twists.size(0); t++) {
        const double spin = twists(t, 2) / arm_m;
        for (int i = 0; i < position.size(0); i++) {
            const double wx = twists(t, 0) - spin * position(i, 1);
            const double wy = twists(t, 1) + spin * position(i, 0);
            const double size = length_of(wx, wy);
            slips(t, 2 * i) = size > 0 ? wx / size : 0;
            slips(t, 2 * i + 1) = size > 0 ? wy / size : 0;
        }
    }
}

// Computes an upper bound of lambda . n(s) for each point s of a great circle. The bound is valid
// for all twists within the angle `radius` [rad] of the point. `separating` contains lambda.
PLATE_WIDE inline void upper(const Circle& circle, View<const double, 2> position, double arm_m,
                             const double* separating, double radius, double* __restrict maximum) {
    const int count = circle.count();
    const double *__restrict x = circle.x.data(), *__restrict y = circle.y.data();
    const double* __restrict z = circle.z.data();
    std::fill_n(maximum, count, 0.0);
    for (int i = 0; i < position.size(0); i++) {
        const double px = position(i, 0), py = position(i, 1);
        const double lx = separating[2 * i], ly = separating[2 * i + 1];
        const double weight = length_of(lx, ly);
        if (weight == 0) continue;
        const double reach = radius * std::sqrt(1 + (px * px + py * py) / (arm_m * arm_m));
#pragma omp simd
        for (int c = 0; c < count; c++) {
            const double spin = z[c] / arm_m, wx = x[c] - spin * py, wy = y[c] + spin * px;
            const double square = wx * wx + wy * wy;
            // Within the radius, the slip at the part can rotate by a certain maximum angle. The
            // bound is the contribution of the part if its slip is rotated towards lambda by this
            // angle.
            const double along = lx * wx + ly * wy, across = std::abs(lx * wy - ly * wx);
            const double free = std::sqrt(square - reach * reach);
            const bool all = (square <= reach * reach) |
                             ((along > 0) & (across * free <= along * reach));
            maximum[c] += all ? weight : (along * free + across * reach) / square;
        }
    }
}

// Returns the maximum of g(s_1) + g(s_2) - g(m) over the points of a great circle, where m is
// between s_1 and s_2. `values` (C,) contains g at equally spaced points. C must be a multiple of
// SIDE_BY_SIDE.
//
// The function g is odd, so -g(m) is the value at the opposite point -m. The function adds this
// value instead of subtracting g(m). Therefore upper bounds of the values give an upper bound of
// the maximum. The angle between s_1 and s_2 may be up to half a turn plus one step. Therefore the
// result is also valid for points between the given points.
PLATE_WIDE inline double greatest_triple(const double* values, int points) {
    const int half = points / 2, reach = half + 1;
    // The values on the circle, extended by `reach` values at each end, because the circle is
    // closed.
    std::vector<double> round(points + 2 * reach);
    for (int i = 0; i < static_cast<int>(round.size()); i++)
        round[i] = values[(i + points - reach) % points];
    std::vector<double> before((reach + 1) * SIDE_BY_SIDE);  // maximum before the middle point
    double triple = NOTHING;
    for (int m = 0; m < points; m += SIDE_BY_SIDE) {
        double maximum[SIDE_BY_SIDE], pair[SIDE_BY_SIDE];
        std::fill_n(maximum, SIDE_BY_SIDE, NOTHING), std::fill_n(pair, SIDE_BY_SIDE, NOTHING);
        for (int a = 0; a <= reach; a++) {
            const double* __restrict v = round.data() + reach + m - a;
            double* __restrict kept = before.data() + a * SIDE_BY_SIDE;
#pragma omp simd
            for (int i = 0; i < SIDE_BY_SIDE; i++) {
                maximum[i] = v[i] > maximum[i] ? v[i] : maximum[i];
                kept[i] = maximum[i];
            }
        }
        for (int a = 0; a <= reach; a++) {
            const double* __restrict v = round.data() + reach + m + a;
            const double* __restrict kept = before.data() + (reach - a) * SIDE_BY_SIDE;
#pragma omp simd
            for (int i = 0; i < SIDE_BY_SIDE; i++) {
                const double sum = v[i] + kept[i];
                pair[i] = sum > pair[i] ? sum : pair[i];
            }
        }
        for (int i = 0; i < SIDE_BY_SIDE; i++)
            triple = std::max(triple, pair[i] + values[(m + i + half) % points]);
    }
    return triple;
}

// The largest result of `greatest_triple` for several great circles. `indices` contains the index
// of the great circle with this result, and the indices of the three points that give it.
struct Best {
    double triple;
    std::array<int, 4> indices;
};

// Returns the indices of the three points on a great circle that belong to the result of
// `greatest_triple`.
inline std::array<int, 3> indices_of(const double* values, int points) {
    const int half = points / 2, reach = half + 1;
    std::vector<double> running(reach + 1);
    std::vector<int> where(reach + 1);
    double triple = NOTHING;
    std::array<int, 3> indices{};
    for (int m = 0; m < points; m++) {
        const int opposite = (m + half) % points;
        for (int a = 0; a <= reach; a++) {
            const int k = (m - a + points) % points;
            const bool more = a == 0 || values[k] > running[a - 1];
            running[a] = more ? values[k] : running[a - 1];
            where[a] = more ? k : where[a - 1];
        }
        for (int a = 0; a <= reach; a++) {
            const int k = (m + a) % points;
            const double total = values[k] + running[reach - a] + values[opposite];
            if (total > triple) triple = total, indices = {k, where[reach - a], opposite};
        }
    }
    return indices;
}

// Returns the largest result of `greatest_triple` for Q great circles with values (Q, C), and the
// indices of its points.
inline Best best_triple(View<const double, 2> value) {
    const int points = value.size(1);
    Best best{NOTHING, {}};
    for (int q = 0; q < value.size(0); q++) {
        const double triple = greatest_triple(value[q], points);
        if (triple > best.triple) best.triple = triple, best.indices[0] = q;
    }
    if (value.size(0)) {
        const std::array<int, 3> indices = indices_of(value[best.indices[0]], points);
        std::copy_n(indices.begin(), 3, best.indices.begin() + 1);
    }
    return best;
}

// Returns whether T is proven to be below `limit` on all great circles. Each row of `cells` (Q, 4)
// is a range of normals of great circles: minimum tilt, maximum tilt, minimum rotation, maximum
// rotation [rad]. A cell is subdivided until its upper bound of T is below the limit.
inline bool proves(View<const double, 2> cells, View<const double, 2> position, double arm_m,
                   const double* separating, double limit) {
    struct Cell {
        double low, high, left, right;
        int level;
    };
    std::vector<Circle> circles;
    for (int level = 0; level <= HALVINGS; level++) circles.emplace_back(POINTS << level);
    std::vector<double> maximum(POINTS << HALVINGS);
    double work = 0;
    for (int q = 0; q < cells.size(0); q++) {
        std::vector<Cell> waiting{{cells(q, 0), cells(q, 1), cells(q, 2), cells(q, 3), 0}};
        while (!waiting.empty()) {
            const auto [low, high, left, right, level] = waiting.back();
            waiting.pop_back();
            Circle& circle = circles[level];
            const int n = circle.count();
            const double tilt = (low + high) / 2, turn = (left + right) / 2;
            work += static_cast<double>(n) * n;
            circle.turn_to(tilt, turn);
            // `radius` is a sum of two angles. The first angle is an upper bound of the angle
            // between the middle circle's normal and the normal of any circle in the cell. The
            // second angle is half the spacing of the points on the circle.
            const double widest = high < PI / 2 ? std::max(std::sin(low), std::sin(high)) : 1.0;
            const double radius = length_of(high - low, widest * (right - left)) / 2 + PI / n;
            upper(circle, position, arm_m, separating, radius, maximum.data());
            if (greatest_triple(maximum.data(), n) < limit) continue;
            if (level == HALVINGS || work > MAX_WORK) return false;
            waiting.push_back({low, tilt, left, turn, level + 1});
            waiting.push_back({low, tilt, turn, right, level + 1});
            waiting.push_back({tilt, high, left, turn, level + 1});
            waiting.push_back({tilt, high, turn, right, level + 1});
        }
    }
    return true;
}

}  // namespace plate::unreachable
