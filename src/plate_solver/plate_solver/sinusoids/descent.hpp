// C++ kernels of descent.py: one Levenberg-Marquardt search for a sinusoidal plate motion that
// moves the parts to requested positions.
#pragma once
#include <algorithm>
#include <vector>

#include <plate/products.hpp>
#include <plate/view.hpp>

#include "cycle_map/blocks.hpp"
#include "cycle_map/turning.hpp"
#include "fit/levenberg_marquardt.hpp"
#include "goal/ends.hpp"
#include "limits.hpp"
#include "sinusoids/excess.hpp"

namespace plate::descent {

using namespace sinusoids;

// Options of the Levenberg-Marquardt method. One cycle often moves the parts by only a small
// fraction of the distance to their targets. With an initial damping of 1e-2, the first steps would
// be too long, and most of the first five would be rejected.
constexpr Damping DAMPING{.first = 1.0, .stall_steps = 6, .stall_fraction = 0.9999};

// A basis of h sinusoidal motions, and the rig's limits. The matrices for the motion of the parts
// have single precision.
struct Motions {
    MatrixOf<float> pose, twist;  // (h, n): basis at the middles of steps
    MatrixOf<float> twist_bins;   // (bins, h): means of `twist` over bins of steps
    SampledBasis checks;          // basis at the instants at which limits are checked
    double scale[3];              // coefficients of a parameter along x, y and theta
    double dt;                    // length of a step [s]
    Limits limits;

    int size() const { return pose.rows; }
    int steps() const { return pose.columns; }
    int bins() const { return twist_bins.rows; }
};

// Settling motion: the plate moves from its initial state to rest. The sinusoidal motion is added
// to the settling motion.
struct Settling {
    MatrixOf<float> pose, twist;  // (3, n) at the middles of steps
    SampledMotion checked;        // motion at the instants at which limits are checked
    bool moves;                   // whether the motion is not zero
};

// Input of a descent.
struct Problem {
    const Motions& motions;
    const Settling& settling;
    View<const float, 2> start;  // parts in blocks, (b, STATE) or (b, TURNING_STATE)
    Ends ends;
    double coast;    // time by which the final positions are extrapolated [s]
    double max_use;  // largest permitted utilisation of any limit (1: exactly at the limit)

    int blocks() const { return start.size(0); }
    bool turning() const { return start.size(1) == TURNING_STATE; }
    int axes() const { return turning() ? 3 : 2; }
};

// Buffers of a descent. Each evaluation overwrites them.
struct Workspace {
    AlignedNumbers<float> steps, by_twist;
    std::vector<float> single;
    std::vector<double> coefficients, end;
    MatrixOf<float> state, pose, twist, by_coefficient, end_slopes;
    Matrix by_end, used;
    SampledMotion checked;
    Excess excess;
};

class Descent {
public:
    Descent(const Problem& problem, Workspace& workspace)
        : problem(problem), motions(problem.motions), workspace(workspace),
          blocks(problem.blocks()),
          axes(problem.axes()) {
        const int trace = problem.turning() ? TURNING_TRACE : TRACE;
        workspace.steps.resize(motions.steps() * blocks * trace);
        workspace.by_twist.resize(motions.bins() * blocks * axes * 3 * LANES);
        workspace.coefficients.resize(3 * motions.size());
        workspace.end.resize(axes * problem.ends.parts);
        steps = {workspace.steps.data(), {motions.steps(), blocks, trace}};
        if (problem.settling.moves) settling_use = use_of(problem.settling.checked);
    }

    // Scales a motion down to the permitted utilisation of the limits, and computes its errors [m].
    void evaluate(std::vector<double>& theta, std::vector<double>& error) {
        const Limits& limits = motions.limits;
        sample_checks(theta);
        const SampledMotion& checked = workspace.checked;
        const double use = use_of(checked);
        if (use > problem.max_use) {
            const double factor = (problem.max_use - settling_use) / (use - settling_use);
            for (double& value : theta) value *= std::max(factor, 0.0);
            sample_checks(theta);
        }
        workspace.single.assign(workspace.coefficients.begin(), workspace.coefficients.end());
        combine(workspace.single.data(), motions.pose, workspace.pose);
        combine(workspace.single.data(), motions.twist, workspace.twist);
        if (problem.settling.moves) {
            add_to(workspace.pose, problem.settling.pose);
            add_to(workspace.twist, problem.settling.twist);
        }
        move_parts();
        end_errors(workspace.end, problem.ends, error, workspace.by_end);
        const int checks = motions.checks.count();
        workspace.excess.begin(max_excesses(checks) + max_force_excesses(checks),
                               3 * motions.size());
        excess(checked, motions.checks, limits, workspace.used, workspace.excess);
        if (limits.forceful) force_excess(checked, motions.checks, limits, workspace.excess);
        for (int k = 0; k < workspace.excess.found; k++)
            error.push_back(-EXCESS_M * workspace.excess.value[k]);
    }

    // Computes the negative derivatives (R + K, 3 h) of R position errors and K limit violations.
    // The derivatives belong to the motion of the last `evaluate` call.
    void slopes(MatrixOf<float>& jacobian) {
        find_slopes_of_ends();
        const int rows = workspace.by_end.rows, columns = 3 * motions.size();
        jacobian.resize(rows + workspace.excess.found, columns);
        for (int r = 0; r < rows; r++) {
            float* __restrict row = jacobian[r];
            std::fill_n(row, columns, 0.0f);
            for (int c = 0; c < workspace.by_end.columns; c++) {
                const float factor = workspace.by_end[r][c];
                if (factor == 0) continue;  // most factors are 0
                const float* __restrict end_slope = workspace.end_slopes[c];
                for (int p = 0; p < columns; p++) row[p] += factor * end_slope[p];
            }
        }
        for (int k = 0; k < workspace.excess.found; k++)
            for (int p = 0; p < columns; p++)
                jacobian[rows + k][p] =
                    EXCESS_M * workspace.excess.slope[k][p] * motions.scale[p % 3];
    }

private:
    const Problem& problem;
    const Motions& motions;
    Workspace& workspace;
    int blocks, axes;
    double settling_use = 0;  // largest utilisation of any limit by the settling motion
    View<float, 3> steps;

    double use_of(const SampledMotion& motion) const {
        const std::vector<double>& weight = motions.checks.weight;
        return limit_use(samples(motion.pose), samples(motion.twist), samples(motion.accel),
                         {weight.data(), {static_cast<int>(weight.size())}}, motions.limits, true);
    }

    // Computes the motion at the instants at which limits are checked.
    void sample_checks(const std::vector<double>& theta) {
        for (size_t p = 0; p < theta.size(); p++)
            workspace.coefficients[p] = theta[p] * motions.scale[p % 3];
        sample_motion(workspace.coefficients.data(), motions.checks, workspace.checked);
        if (!problem.settling.moves) return;
        add_to(workspace.checked.pose, problem.settling.checked.pose);
        add_to(workspace.checked.twist, problem.settling.checked.twist);
        add_to(workspace.checked.accel, problem.settling.checked.accel);
    }

    template <class Number>
    static void add_to(MatrixOf<Number>& path, const MatrixOf<Number>& more) {
        for (int axis = 0; axis < path.rows; axis++)
            for (int k = 0; k < path.columns; k++) path[axis][k] += more[axis][k];
    }

    // Simulates the motion of the parts during the cycle. Extrapolates their final positions and
    // rotations by the time `coast`. The result contains x of all parts, y of all parts, and the
    // rotations of all parts.
    void move_parts() {
        constexpr int COORDINATE[] = {blocks::X, blocks::Y, turning::TURN};
        constexpr int RATE[] = {blocks::VX, blocks::VY, turning::SPIN};
        const int parts = problem.ends.parts, columns = problem.start.size(1);
        workspace.state.resize(blocks, columns);
        std::copy_n(problem.start.data, blocks * columns, workspace.state[0]);
        const View<float, 2> state{workspace.state[0], {blocks, columns}};
        const auto trace = problem.turning() ? trace_turning : plate::trace;
        trace(state, samples(workspace.pose), samples(workspace.twist), motions.dt, steps);
        for (int axis = 0; axis < axes; axis++)
            for (int i = 0; i < parts; i++) {
                const float* part = state[i / LANES] + i % LANES;
                workspace.end[axis * parts + i] =
                    part[COORDINATE[axis]] + problem.coast * part[RATE[axis]];
            }
    }

    // Computes the derivatives (C, 3 h) of the final positions and rotations with respect to the
    // parameters.
    void find_slopes_of_ends() {
        const int size = motions.size(), bins = motions.bins(), parts = problem.ends.parts;
        const View<float, 4> by_twist{workspace.by_twist.data(), {bins, blocks, axes, 3 * LANES}};
        const auto adjoint = problem.turning() ? adjoint_turning : plate::adjoint;
        adjoint({steps.data, steps.shape}, samples(workspace.twist), motions.dt, problem.coast,
                by_twist);
        const int columns = blocks * axes * 3 * LANES;
        workspace.by_coefficient.resize(size, columns);
        product(motions.twist_bins[0], size, workspace.by_twist.data(), columns, bins, size,
                columns, workspace.by_coefficient[0], columns);
        workspace.end_slopes.resize(axes * parts, 3 * size);
        for (int axis = 0; axis < axes; axis++)
            for (int i = 0; i < parts; i++) {
                const int column = (i / LANES * axes + axis) * 3 * LANES + i % LANES;
                float* row = workspace.end_slopes[axis * parts + i];
                for (int h = 0; h < size; h++)
                    for (int c = 0; c < 3; c++)
                        row[3 * h + c] =
                            motions.scale[c] * workspace.by_coefficient[h][column + c * LANES];
            }
    }
};

// Improves the parameters (3 h,) until no error exceeds `tolerance` [m] or the progress stalls. The
// result contains the errors of the final positions and rotations, followed by the limit
// violations.
inline FitOf<float> descend(const Problem& problem, std::vector<double> theta, double tolerance,
                            int iterations, Workspace& workspace) {
    Descent descent(problem, workspace);
    return levenberg_marquardt<float>(
        [&](auto& parameters, auto& error) { descent.evaluate(parameters, error); },
        [&](MatrixOf<float>& jacobian) { descent.slopes(jacobian); }, std::move(theta), DAMPING,
        tolerance, iterations);
}

}  // namespace plate::descent
