// Evaluation of the plate's pose and twist at any time of a motion. The coordinates x, y and theta
// are evaluated together in one vector. The simulation of parts with a contact area uses this code.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include <plate/simd.hpp>
#include <plate/wide.hpp>

namespace plate {

// State of the plate at one time: pose [m, m, rad] and twist [m/s, m/s, rad/s].
struct PlateSample {
    double x, y, theta, vx, vy, spin;
};

// Motion of the plate between two knots. `start` and `end` are times [s]. `pose` and `twist`
// contain polynomial coefficients, one row per power of the time since `start`. Each row contains
// the coefficients for x, y [m] and theta [rad], and a zero for padding.
struct CoursePiece {
    double start, end, pose[6][4], twist[5][4];

    // Pose and twist at time t [s].
    [[gnu::always_inline]] PlateSample at(double t) const {
        const double u = t - start;
        Four p, v, next;
        load(p, pose[5]), load(v, twist[4]);
        for (int power = 4; power >= 0; power--) load(next, pose[power]), p = next + u * p;
        for (int power = 3; power >= 0; power--) load(next, twist[power]), v = next + u * v;
        return {p[0], p[1], p[2], v[0], v[1], v[2]};
    }
};

// A whole motion.
struct Course {
    std::vector<CoursePiece> pieces;
    double reach[3] = {};  // upper bounds of |x|, |y| [m] and |theta| [rad] during the motion

    // Constructs the motion from K + 1 knot times [s] and coefficients (K, 6, 3).
    Course(const double* times, const double* factors, int count) : pieces(count) {
        for (CoursePiece& piece : pieces) {
            piece.start = times[0], piece.end = times[1], times++;
            for (int power = 0; power < 6; power++)
                for (int axis = 0; axis < 4; axis++) {
                    piece.pose[power][axis] = axis < 3 ? *factors++ : 0;
                    if (power > 0) piece.twist[power - 1][axis] = power * piece.pose[power][axis];
                }
            for (int axis = 0; axis < 3; axis++) {
                double bound = 0;
                for (int power = 5; power >= 0; power--)
                    bound = bound * (piece.end - piece.start) + std::abs(piece.pose[power][axis]);
                reach[axis] = std::max(reach[axis], bound);
            }
        }
    }

    double period() const { return pieces.back().end; }

    // Index of the piece that contains the time t [s]. For times outside the motion, it is the
    // first or last piece. The search begins at the piece k.
    int piece_at(double t, int k) const {
        const int last = static_cast<int>(pieces.size()) - 1;
        while (k > 0 && t < pieces[k].start) k--;
        while (k < last && t >= pieces[k].end) k++;
        return k;
    }

    // Pose and twist at time t [s]. For times outside the motion, the first or last piece is
    // extrapolated. `k` is the index of a piece near t, and is set to the piece at t.
    PlateSample at(double t, int& k) const {
        k = piece_at(t, k);
        return pieces[k].at(t);
    }
};

// Divide a motion into `steps` equal time steps, and return the (steps + 1) samples at their
// boundaries.
PLATE_WIDE inline std::vector<PlateSample> samples(const Course& course, int steps) {
    std::vector<PlateSample> rows(steps + 1);
    const double period = course.period();
    const CoursePiece *piece = &course.pieces.front(), *last = &course.pieces.back();
    for (int k = 0; k <= steps; k++) {
        const double t = period * k / steps;
        while (piece != last && t >= piece->end) piece++;
        rows[k] = piece->at(t);
    }
    return rows;
}

}  // namespace plate
