// C++ kernels of family.py, which describes sequences of J rotations of the plate by parameters.
#pragma once
#include "limits.hpp"
#include "rotations/sequence.hpp"

namespace plate::rotations {

// Minimum duration of a rotation. The unit is the mean duration of the J rotations.
constexpr double SHORTEST = 0.02;

// Maximum speed of a rotation, in units of the usual speed (`RotationOptions.speed`).
constexpr double FASTEST = 2.5;

// Maximum fraction of the period for all ramps together. A ramp is the transition between two
// rotations.
constexpr double MAX_RAMPS = 0.9;

// A family of sequences of J rotations. `Sequences` in family.py describes the fields.
struct Sequences {
    int rotations;
    double scale[3];
    double period, accel;
    Matrix loads;  // (m, 3)
    std::array<int, 2> steps;
    Limits limits;

    int parameters() const { return 4 * rotations + 1; }
};

using Parameters = std::vector<double>;

// Returns the relative durations (J + 1,) of the J rotations and of the rest at the end of the
// period.
inline std::vector<double> holds_of(const Parameters& theta, const Sequences& family) {
    std::vector<double> holds(theta.begin(), theta.begin() + family.rotations + 1);
    for (double& hold : holds) hold *= 1.0 / family.rotations;
    return holds;
}

// Returns the plate's twists (J, 3) during the J rotations.
inline Matrix twists_of(const Parameters& theta, const Sequences& family) {
    Matrix twists(family.rotations, 3);
    for (int j = 0; j < family.rotations; j++)
        for (int c = 0; c < 3; c++)
            twists[j][c] = theta[family.rotations + 1 + 3 * j + c] * family.scale[c];
    return twists;
}

inline Ramps ramps_of(const Parameters& theta, const Sequences& family) {
    const Matrix twists = twists_of(theta, family);
    return ramps(view_of(twists), family.limits.half, view_of(family.loads), family.accel);
}

// Returns the times of the knots and the plate's twists at the knots (see `place_knots`).
inline Knots knots_of(const Parameters& theta, const Sequences& family) {
    const Matrix twists = twists_of(theta, family);
    return place_knots(holds_of(theta, family), view_of(twists), ramps_of(theta, family).length,
                    family.period);
}

// Parameters, and the knots and samples of their motion.
struct Run {
    Parameters theta;
    Knots knots;
    MotionSamples samples;
};

inline Run run_of(const Parameters& theta, const Sequences& family) {
    Knots knots = knots_of(theta, family);
    MotionSamples samples = motion(knots, family.steps);
    return {theta, std::move(knots), std::move(samples)};
}

// Changes the parameters so that the rig can run the motion. Durations are raised to at least
// SHORTEST. The twists are reduced until the motion is within the limits, in at most 8 attempts.
// Returns the changed parameters with the knots and samples of their motion.
inline Run runnable(Parameters theta, const Sequences& family) {
    const int count = family.rotations;
    for (int j = 0; j <= count; j++) theta[j] = std::max(theta[j], SHORTEST);
    double* speeds = theta.data() + count + 1;
    const auto slow_down = [&](double factor) {
        for (int p = 0; p < 3 * count; p++) speeds[p] /= factor;
    };
    for (int j = 0; j < count; j++) {
        double square = 0, *twist = speeds + 3 * j;
        for (int c = 0; c < 3; c++) square += twist[c] * twist[c];
        const double factor = std::max(std::sqrt(square) / FASTEST, 1.0);
        for (int c = 0; c < 3; c++) twist[c] /= factor;
    }
    for (int attempt = 0; attempt < 8; attempt++) {
        const double filled = sum(ramps_of(theta, family).length) / (MAX_RAMPS * family.period);
        if (filled > 1) slow_down(1.001 * filled);
        Run run = run_of(theta, family);
        const MotionSamples& samples = run.samples;
        const int n = samples.pose.rows;
        const Samples pose{samples.pose[0], n, 3, 1}, twist{samples.twist[0], n, 3, 1};
        const View<const double, 1> dt{samples.dt.data(), {n}};
        const double used =
            limit_use(pose, twist, {samples.accel[0], n, 3, 1}, dt, family.limits, true);
        if (used <= 1) return run;
        slow_down(1.01 * used);
    }
    return run_of(theta, family);
}

// Converts derivatives with respect to the knots to derivatives with respect to the parameters. Row
// r of `jacobian` contains the derivatives of the result with the index results[r].
inline void parameters_back(const Parameters& theta, const Sequences& family, const ByKnots& by,
                            const std::vector<int>& results, Matrix& jacobian) {
    const ByRotations found = rotations_back(holds_of(theta, family), ramps_of(theta, family),
                                            family.period, by);
    const int count = family.rotations;
    jacobian.resize(static_cast<int>(results.size()), family.parameters());
    for (int row = 0; row < jacobian.rows; row++) {
        const int r = results[row];
        for (int j = 0; j <= count; j++)
            jacobian[row][j] = found.hold[j][r] * (1.0 / count);
        for (int q = 0; q < 3 * count; q++)
            jacobian[row][count + 1 + q] = found.twist[q][r] * family.scale[q % 3];
    }
}

}  // namespace plate::rotations
