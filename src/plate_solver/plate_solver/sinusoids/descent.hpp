// One descent of a sinusoidal motion on the cycle map: kernels of descent.py.
#pragma once
#include <algorithm>
#include <vector>

#include <plate/products.hpp>
#include <plate/view.hpp>

#include "fit/levenberg_marquardt.hpp"
#include "limits.hpp"
#include "maps/blocks.hpp"
#include "maps/turning.hpp"
#include "requests/ends.hpp"
#include "sinusoids/limits.hpp"

namespace plate::descent {

using namespace sinusoids;

// Where what is left is much more than what a cycle can do, a step gains little of it.
constexpr Damping DAMPING{1e-2, 1e-6, 1e3, 3.0, 4.0, 6, 0.9999};

// A basis of h sinusoidal motions, and the limits that it presses against.
struct Motions {
    Matrix pose, twist;            // (h, n): the basis at the middles of steps
    Matrix pose_bins, twist_bins;  // (bins, h): its means over bins of steps
    Looks looks;                   // where limits are looked at
    double scale[3];               // coefficients of a parameter along x, y and theta
    double dt;                     // length of a step [s]
    Limits limits;

    int size() const { return pose.rows; }
    int steps() const { return pose.columns; }
    int bins() const { return pose_bins.rows; }
};

// What the plate does without the basis: on its way to rest from the state in which it begins.
struct Settling {
    Matrix pose, twist;  // (3, n) at the middles of steps
    Looked looked;       // where limits are looked at
    bool moves;          // whether it does anything
};

// What a descent is to do.
struct Problem {
    const Motions& motions;
    const Settling& settling;
    View<const double, 2> start;  // parts in blocks, (b, STATE) or (b, TURNING_STATE)
    Ends ends;
    double coast;  // [s]
    double most;   // fraction of the limits that may be used on the way

    int blocks() const { return start.size(0); }
    bool turning() const { return start.size(1) == TURNING_STATE; }
    int axes() const { return turning() ? 3 : 2; }
};

// Memory of a descent: what is written anew at each evaluation.
struct Room {
    AlignedNumbers steps, by_twist, by_pose;
    std::vector<double> own, place;
    Matrix state, pose, twist, on_twist, on_pose, ends, by_place, used;
    Looked looked;
    Excess excess;
};

class Descent {
public:
    Descent(const Problem& problem, Room& room)
        : problem(problem), motions(problem.motions), room(room), blocks(problem.blocks()),
          axes(problem.axes()) {
        const int trace = problem.turning() ? TURNING_TRACE : TRACE;
        room.steps.resize(motions.steps() * blocks * trace);
        room.by_twist.resize(motions.bins() * blocks * axes * 3 * LANES);
        room.by_pose.resize(motions.bins() * blocks * axes * 2 * LANES);
        room.own.resize(3 * motions.size());
        room.place.resize(axes * problem.ends.parts);
        steps = {room.steps.data(), {motions.steps(), blocks, trace}};
        if (problem.settling.moves) settling_use = use_of(problem.settling.looked);
    }

    // Scale a motion to what limits it may use; find its errors [m].
    void evaluate(std::vector<double>& theta, std::vector<double>& error) {
        const Limits& limits = motions.limits;
        look_at(theta);
        const Looked& at = room.looked;
        const double use = use_of(at);
        if (use > problem.most) {
            const double share = (problem.most - settling_use) / (use - settling_use);
            for (double& value : theta) value *= std::max(share, 0.0);
            look_at(theta);
        }
        combine(room.own.data(), motions.pose, room.pose);
        combine(room.own.data(), motions.twist, room.twist);
        if (problem.settling.moves) {
            add_to(room.pose, problem.settling.pose);
            add_to(room.twist, problem.settling.twist);
        }
        move_parts();
        end_errors(room.place, problem.ends, error, room.by_place);
        const int looks = motions.looks.count();
        room.excess.begin(most_excesses(looks) + most_force_excesses(looks), 3 * motions.size());
        excess(at, motions.looks, limits, room.used, room.excess);
        if (limits.forceful) force_excess(at, motions.looks, limits, room.excess);
        for (int k = 0; k < room.excess.found; k++)
            error.push_back(-EXCESS_M * room.excess.value[k]);
    }

    // Minus the derivatives (R + K, 3 h) of the errors of the motion that was evaluated last.
    void slopes(Matrix& jacobian) {
        find_slopes_of_ends();
        const int rows = room.by_place.rows, wide = 3 * motions.size();
        jacobian.resize(rows + room.excess.found, wide);
        for (int r = 0; r < rows; r++) {
            double* __restrict row = jacobian[r];
            std::fill_n(row, wide, 0.0);
            for (int c = 0; c < room.by_place.columns; c++) {
                const double factor = room.by_place[r][c];
                if (factor == 0) continue;  // most are
                const double* __restrict end = room.ends[c];
                for (int p = 0; p < wide; p++) row[p] += factor * end[p];
            }
        }
        for (int k = 0; k < room.excess.found; k++)
            for (int p = 0; p < wide; p++)
                jacobian[rows + k][p] =
                    EXCESS_M * room.excess.slope[k][p] * motions.scale[p % 3];
    }

private:
    const Problem& problem;
    const Motions& motions;
    Room& room;
    int blocks, axes;
    double settling_use = 0;  // fraction of the limits
    View<double, 3> steps;

    double use_of(const Looked& at) const {
        const std::vector<double>& weight = motions.looks.weight;
        return limit_use(samples(at.pose), samples(at.twist), samples(at.accel),
                         {weight.data(), {static_cast<int>(weight.size())}}, motions.limits, true);
    }

    // Finds the motion of parameters where limits are looked at.
    void look_at(const std::vector<double>& theta) {
        for (size_t p = 0; p < theta.size(); p++) room.own[p] = theta[p] * motions.scale[p % 3];
        look(room.own.data(), motions.looks, room.looked);
        if (!problem.settling.moves) return;
        add_to(room.looked.pose, problem.settling.looked.pose);
        add_to(room.looked.twist, problem.settling.looked.twist);
        add_to(room.looked.accel, problem.settling.looked.accel);
    }

    static void add_to(Matrix& path, const Matrix& more) {
        for (int axis = 0; axis < path.rows; axis++)
            for (int k = 0; k < path.columns; k++) path[axis][k] += more[axis][k];
    }

    // Where parts end, `coast` after the motion: x of all, y of all, turns of all.
    void move_parts() {
        constexpr int PLACE[] = {blocks::X, blocks::Y, turning::TURN};
        constexpr int RATE[] = {blocks::VX, blocks::VY, turning::SPIN};
        const int parts = problem.ends.parts, wide = problem.start.size(1);
        room.state.resize(blocks, wide);
        std::copy_n(problem.start.data, blocks * wide, room.state[0]);
        const View<double, 2> state{room.state[0], {blocks, wide}};
        const auto trace = problem.turning() ? trace_turning : plate::trace;
        trace(state, parts, samples(room.pose), samples(room.twist), motions.dt, steps);
        for (int axis = 0; axis < axes; axis++)
            for (int i = 0; i < parts; i++) {
                const double* own = state[i / LANES] + i % LANES;
                room.place[axis * parts + i] = own[PLACE[axis]] + problem.coast * own[RATE[axis]];
            }
    }

    // The derivatives (C, 3 h) of where parts end, by the parameters.
    void find_slopes_of_ends() {
        const int size = motions.size(), bins = motions.bins(), parts = problem.ends.parts;
        const View<double, 4> by_twist{room.by_twist.data(), {bins, blocks, axes, 3 * LANES}};
        const View<double, 4> by_pose{room.by_pose.data(), {bins, blocks, axes, 2 * LANES}};
        const auto adjoint = problem.turning() ? adjoint_turning : plate::adjoint;
        adjoint({steps.data, steps.shape}, parts, samples(room.twist), motions.dt, problem.coast,
                by_twist, by_pose);
        const int each = blocks * axes * LANES;
        onto_basis(motions.twist_bins, room.by_twist.data(), 3 * each, room.on_twist);
        onto_basis(motions.pose_bins, room.by_pose.data(), 2 * each, room.on_pose);
        room.ends.resize(axes * parts, 3 * size);
        for (int axis = 0; axis < axes; axis++)
            for (int i = 0; i < parts; i++) {
                const int at = i / LANES * axes + axis, lane = i % LANES;
                double* row = room.ends[axis * parts + i];
                for (int h = 0; h < size; h++) {
                    const double* on_twist = room.on_twist[h] + at * 3 * LANES + lane;
                    const double* on_pose = room.on_pose[h] + at * 2 * LANES + lane;
                    row[3 * h] = motions.scale[0] * (on_twist[0] + on_pose[0]);
                    row[3 * h + 1] = motions.scale[1] * (on_twist[LANES] + on_pose[LANES]);
                    row[3 * h + 2] = motions.scale[2] * on_twist[2 * LANES];
                }
            }
    }

    // result (h, wide) = basis' (h, bins) times derivatives (bins, wide).
    static void onto_basis(const Matrix& basis, const double* derivatives, int wide,
                           Matrix& result) {
        result.resize(basis.columns, wide);
        product(basis[0], basis.columns, derivatives, wide, basis.rows, basis.columns, wide,
                result[0], wide);
    }
};

// Improve a motion (3 h,) until no part misses more than `tolerance` [m], or it helps no more. The
// errors of the result are those of the ends, and then limits that are exceeded.
inline Fit descend(const Problem& problem, std::vector<double> theta, double tolerance,
                   int iterations, Room& room) {
    Descent descent(problem, room);
    return levenberg_marquardt(
        [&](auto& parameters, auto& error) { descent.evaluate(parameters, error); },
        [&](Matrix& jacobian) { descent.slopes(jacobian); }, std::move(theta), DAMPING, tolerance,
        iterations);
}

}  // namespace plate::descent
