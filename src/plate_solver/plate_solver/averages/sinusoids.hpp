// C++ kernels of sinusoids.py, which searches for a sinusoidal plate motion with requested average
// forces (Method B). The result is a spline.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include <plate/products.hpp>
#include <plate/view.hpp>

#include "averages/sinusoid_force.hpp"
#include "fit/levenberg_marquardt.hpp"
#include "limits.hpp"
#include "sinusoids/excess.hpp"

namespace plate::averages {

using namespace sinusoids;

// Options of a Levenberg-Marquardt search with the first damping `first`.
constexpr Damping damping_from(double first) {
    return {.first = first,
            .minimum = 1e-9,
            .maximum = 1e2,
            .shrink = 8.0,
            .grow = 6.0,
            .stall_steps = 6,
            .stall_fraction = 0.7};
}

constexpr Damping FROM_RANDOM = damping_from(1.25e-3);   // for a start at a random motion
constexpr Damping FROM_SIMILAR = damping_from(1.25e-5);  // for a start near a solution

constexpr int FIRST = 0;  // number of the first start

// Maximum number of consecutive perturbations without success. After this number, a round of the
// search ends.
constexpr int HOPS = 12;

// Size of a perturbation as a fraction of the amplitude of the round's best motion.
constexpr double HOP = 0.15;

// A perturbation is successful if its cost is below this factor times the best cost of the round.
constexpr double BETTER = 0.99;

// At the end of a search, the quadrature ADAPTIVE evaluates the result again. If the force error
// then exceeds this fraction of the tolerance, the search continues with ADAPTIVE.
constexpr double SURE = 0.7;

// A continuation increases the requested forces from zero to their final values in this number of
// equal legs.
constexpr int LEGS = 3;

// Maximum number of search steps per leg of a continuation.
constexpr int LEG_STEPS = 8;

// A leg of a continuation ends if the force error is below this fraction of the requested forces.
constexpr double LEG_ERROR = 0.03;

// Weight of samples at equal time steps.
constexpr double EQUAL_WEIGHT[] = {1.0};

// Weights of the control points of a spline whose pieces have equal length. The mean square of a
// piece is at most the mean square of its six control points, because the six basis functions have
// equal integrals. The last control point of a piece is also the first of the next piece. Therefore
// this point counts twice.
constexpr double HULL_WEIGHT[] = {2.0, 1, 1, 1, 1};

// h sinusoidal motions of N harmonics. Each motion of the search is a linear combination of these h
// motions.
struct Motions {
    Matrix waves, taylor;  // the same as in `Rules`
    int few, pieces;
    Matrix span;                // (2 N, h)
    SampledBasis steps, knots, hull;   // basis at equal steps, at the knots, and at control points
    Matrix spline;              // (h, 6 k): powers of the time since the knot
    std::vector<double> times;  // (k + 1,): times of the knots [s]
    Limits limits;              // `SEARCH_USE` times the limits of the rig
    int candidates;             // number of random motions per fresh start

    int size() const { return span.columns; }

    // Returns the sample points of the quadratures.
    Rules rules() const {
        return {{waves[0], {waves.rows, waves.columns}}, few,
                {taylor[0], {taylor.rows, taylor.columns}}, pieces};
    }
};

// Input of the inversion.
struct Request {
    View<const double, 2> position, velocity, force;  // parts (M, 2) [m], [m/s], [mu m g]
    double tolerance;                                 // maximum error that counts as met [mu m g]
    int iterations, tries;                            // maximum steps per start, maximum starts
};

// Result of the search. `knots` contains the pose, twist and acceleration (3, k + 1) at the knots
// of the spline. `spline` (k, 6, 3) contains the coefficients. `error` (M, 2) contains the errors
// of the average forces [mu m g].
struct InversionResult {
    std::vector<double> theta;  // parameters (3 h,), at full amplitude
    SampledMotion knots;
    std::vector<double> spline, error;
    double worst, condition;
    int iterations, tries;
};

class Inversion {
public:
    // `pool` (S, 3 h) contains the parameters of S random motions.
    Inversion(const Motions& motions, View<const double, 2> pool, const Request& request)
        : motions(motions),
          rules(motions.rules()),
          pool(pool),
          request(request),
          size(motions.size()),
          parts(request.position.size(0)),
          slip_rows(motions.span.rows + 1, 2),
          samples_of(5, motions.waves.columns),
          gradient(3, motions.span.rows),
          basis_coefficients(size, 3),
          wave_coefficients(motions.span.rows, 3),
          by_span(3, size) {
        const double* velocity = request.velocity.data;
        moving = std::any_of(velocity, velocity + 2 * parts, [](double v) { return v != 0; });
        requested.assign(request.force.data, request.force.data + 2 * parts);
    }

    // Searches for a motion with the requested average forces. `warm` (3 h,) contains the
    // parameters of the previous solution, or is null if there is no previous solution.
    InversionResult invert(const double* warm) {
        is_warm = warm;
        auto [fit, steps, tried] =
            search(warm ? std::vector<double>(warm, warm + 3 * size) : random_start(FIRST));
        InversionResult result = finished(fit, steps, tried);
        if (result.worst > request.tolerance && worst(fit.error) <= request.tolerance) {
            fit = descend(PANELS, requested, fit.parameters, FROM_SIMILAR, request.tolerance / 3,
                          request.iterations);
            steps += fit.iterations;
            result = finished(fit, steps, tried);
        }
        if (result.worst > request.tolerance && worst(fit.error) <= request.tolerance) {
            // The error of the finished motion exceeds the tolerance: search again from other
            // starts.
            is_warm = false, reverse_order = true;
            const auto [next_fit, more_steps, more_tries] = search(random_start(FIRST));
            result = finished(next_fit, steps + more_steps, tried + more_tries);
        }
        return result;
    }

private:
    const Motions& motions;
    const Rules rules;
    const View<const double, 2> pool;
    const Request request;
    const int size, parts;
    // If `backwards` is true, the search uses the random motions in reverse order.
    bool moving, is_warm = false, reverse_order = false;
    std::vector<double> requested;
    Matrix slip_rows, samples_of, gradient, basis_coefficients, wave_coefficients, by_span,
        force_jacobian;  // buffers
    SampledMotion checked;

    const double* random(int number) const {
        return pool[reverse_order ? pool.size(0) - 1 - number : number];
    }

    // Result of one start: motion, cost, number of steps, and whether all errors are within the
    // tolerance.
    struct Attempted {
        Fit fit;
        double cost;
        int steps;
        bool enough;
    };

    // Result of a search: best motion, total number of steps, and total number of starts.
    struct Searched {
        Fit best;
        int steps, tried;
    };

    // Searches by basin hopping. Each step of a round perturbs the round's best motion. The round
    // ends after `HOPS` consecutive perturbations without success. Then a new round begins at a
    // random motion.
    Searched search(const std::vector<double>& begin) {
        Attempted last = attempted(begin, FIRST, std::numeric_limits<double>::infinity());
        Attempted near = last;
        Searched all{last.fit, last.steps, FIRST + 1};
        double minimum = last.cost;
        int failed = 0;
        while (!last.enough && all.tried < request.tries) {
            const bool new_round = failed >= HOPS;
            last = attempted(
                new_round ? continued_start(all.tried) : perturbed(all.tried, near.fit.parameters),
                all.tried, minimum);
            all.steps += last.steps;
            all.tried++;
            if (last.enough || last.cost < minimum) all.best = last.fit, minimum = last.cost;
            failed = new_round || last.cost < BETTER * near.cost ? 0 : failed + 1;
            if (last.cost < near.cost || new_round) near = last;
        }
        return all;
    }

    // Runs a Levenberg-Marquardt search from one start. Unless the start is the previous solution,
    // the search uses the quadrature USUAL. If its result is within the tolerance or better than
    // `minimum`, the quadrature ADAPTIVE evaluates the result again. If necessary, the search then
    // continues with ADAPTIVE. `minimum` is the minimum cost of all previous starts.
    Attempted attempted(const std::vector<double>& start, int number, double minimum) {
        const double tolerance = request.tolerance;
        const bool from_previous = number == FIRST && is_warm;
        Fit fit =
            descend(from_previous ? ADAPTIVE : USUAL, requested, start,
                    from_previous ? FROM_SIMILAR : FROM_RANDOM, tolerance / 3, request.iterations);
        int steps = fit.iterations;
        double cost = squared(fit.error), max_error = worst(fit.error);
        if (max_error <= tolerance || cost < minimum) {
            cost = force_error(ADAPTIVE, requested, fit.parameters, fit.error, nullptr);
            if (max_error <= 30 * tolerance && worst(fit.error) > SURE * tolerance) {
                fit = descend(ADAPTIVE, requested, fit.parameters, FROM_SIMILAR, tolerance / 3,
                              request.iterations);
                steps += fit.iterations;
                cost = squared(fit.error);
            }
        }
        max_error = worst(fit.error);
        return {std::move(fit), cost, steps, max_error <= tolerance};
    }

    std::vector<double> perturbed(int number, std::vector<double> theta) const {
        const double hop = HOP * std::sqrt(squared(theta) / static_cast<double>(theta.size()));
        const double* direction = random(number % pool.size(0));
        for (int p = 0; p < 3 * size; p++) theta[p] += hop * direction[p];
        return theta;
    }

    // Returns the start of a new round: a random motion, adapted by a continuation with increasing
    // fractions of the requested forces.
    std::vector<double> continued_start(int number) {
        std::vector<double> theta = random_start(number), part = requested;
        const double leg_tolerance = LEG_ERROR * std::sqrt(squared(requested) / (2 * parts));
        for (int leg = 1; leg < LEGS; leg++) {
            for (int r = 0; r < 2 * parts; r++) part[r] = requested[r] * leg / LEGS;
            theta = descend(USUAL, part, theta, FROM_RANDOM, leg_tolerance, LEG_STEPS).parameters;
        }
        return theta;
    }

    // Compares some random motions of the pool and their opposites, which are the motions times -1.
    // Returns the motion with the smallest force error.
    std::vector<double> random_start(int number) {
        const int count = pool.size(0), maximum = motions.candidates;
        // Every round compares other motions of the pool.
        const int first = number / (HOPS + 1) * maximum % count;
        double minimum = 1e300, sign = 1;
        int index = first;
        std::vector<double> error;
        for (int i = first; i < std::min(first + maximum, count); i++) {
            std::vector<double> theta(random(i), random(i) + 3 * size);
            if (moving) to_full_amplitude(theta);
            const double cost = force_error(FEW, requested, theta, error, nullptr);
            if (cost < minimum) minimum = cost, index = i, sign = 1;
            // f is the requested force. The motion exerts the force g = f - error, and the opposite
            // motion exerts -g. Therefore the squared error of the opposite motion is |f + g|^2 =
            // |f - g|^2 + 4 f.g
            double opposite = cost;
            for (int r = 0; r < 2 * parts; r++)
                opposite += 4 * requested[r] * (requested[r] - error[r]);
            if (opposite < minimum) minimum = opposite, index = i, sign = -1;
        }
        std::vector<double> theta(random(index), random(index) + 3 * size);
        for (double& value : theta) value *= sign;
        return theta;
    }

    // Adjusts a motion until its average forces match `force` (2 M,). `grid` selects the
    // quadrature.
    Fit descend(int grid, const std::vector<double>& force, std::vector<double> theta,
                const Damping& damping, double tolerance, int iterations) {
        const auto evaluate = [&](std::vector<double>& trial, std::vector<double>& error) {
            if (moving) to_full_amplitude(trial);
            // The same call computes the derivatives for `slopes`, because the derivatives add
            // little computing time.
            force_error(grid, force, trial, error, &force_jacobian);
        };
        const auto slopes = [&](Matrix& jacobian) { std::swap(jacobian, force_jacobian); };
        return levenberg_marquardt<double>(evaluate, slopes, std::move(theta), damping, tolerance,
                                           iterations);
    }

    // Converts parameters (3 h,) to the coefficients (h, 3) of the basis motions.
    void set_coefficients(const std::vector<double>& theta) {
        std::copy(theta.begin(), theta.end(), basis_coefficients[0]);
        for (int h = 0; h < size; h++) basis_coefficients[h][2] /= motions.limits.arm_m;
    }

    // Scales the parameters so that the sampled motion exactly reaches the most restrictive limit
    // of the rig.
    void to_full_amplitude(std::vector<double>& theta) {
        set_coefficients(theta);
        const double used = use_of(motions.steps, {EQUAL_WEIGHT, {1}}, true);
        if (used > 0)
            for (double& value : theta) value /= used;
    }

    double use_of(const SampledBasis& basis, View<const double, 1> weight, bool linear) {
        sample_motion(basis_coefficients[0], basis, checked);
        return limit_use(samples(checked.pose), samples(checked.twist), samples(checked.accel),
                         weight, motions.limits, linear);
    }

    // Computes the force error (2 M,), which is the requested force minus the average force. If
    // `jacobian` is not null, it receives d force / d theta (2 M, 3 h). Returns the sum of the
    // squared errors.
    double force_error(int grid, const std::vector<double>& force,
                       const std::vector<double>& theta, std::vector<double>& error,
                       Matrix* jacobian) {
        const Matrix& span = motions.span;
        const int waves = span.rows;
        const double per_arm = 1 / motions.limits.arm_m;
        set_coefficients(theta);
        for (int j = 0; j < waves; j++)
            for (int c = 0; c < 3; c++) {
                double total = 0;
                for (int h = 0; h < size; h++) total += span[j][h] * basis_coefficients[h][c];
                wave_coefficients[j][c] = total;
            }
        const View<double, 2> slip{slip_rows[0], {waves + 1, 2}};
        const View<double, 2> work{samples_of[0], {5, samples_of.columns}};
        const View<double, 2> by_slip{gradient[0], {jacobian ? 3 : 0, waves}};
        error.resize(2 * parts);
        if (jacobian) jacobian->resize(2 * parts, 3 * size);
        double cost = 0;
        for (int i = 0; i < parts; i++) {
            const double *position = request.position[i], *velocity = request.velocity[i];
            slip_at({wave_coefficients[0], {waves, 3}}, position[0], position[1], velocity[0],
                    velocity[1], slip);
            const Force mean_force = force_of({slip.data, slip.shape}, rules, grid, work, by_slip);
            error[2 * i] = force[2 * i] - mean_force.x,
                      error[2 * i + 1] = force[2 * i + 1] - mean_force.y;
            cost += error[2 * i] * error[2 * i] + error[2 * i + 1] * error[2 * i + 1];
            if (!jacobian) continue;
            for (int row = 0; row < 3; row++) {
                double* __restrict sum = by_span[row];
                std::fill_n(sum, size, 0.0);
                for (int j = 0; j < waves; j++) {
                    const double factor = gradient[row][j], *__restrict basis = span[j];
                    for (int h = 0; h < size; h++) sum[h] += factor * basis[h];
                }
            }
            for (int axis = 0; axis < 2; axis++) {
                const double *by_x = by_span[axis], *by_y = by_span[axis + 1];
                double* row = (*jacobian)[2 * i + axis];
                for (int h = 0; h < size; h++) {
                    row[3 * h] = by_x[h];
                    row[3 * h + 1] = by_y[h];
                    row[3 * h + 2] = (position[0] * by_y[h] - position[1] * by_x[h]) * per_arm;
                }
            }
        }
        return cost;
    }

    // Converts parameters to a spline within the limits, and evaluates its forces.
    InversionResult finished(const Fit& fit, int iterations, int tries) {
        InversionResult result{.theta = fit.parameters, .iterations = iterations, .tries = tries};
        to_full_amplitude(result.theta);
        set_coefficients(result.theta);
        // Four rounds suffice, because the utilisation of the limits is nearly proportional to the
        // factor. Only the rotation of the plate has a quadratic effect.
        for (int round = 0; round < 4; round++) {
            const double used = SEARCH_USE * use_of(motions.hull, {HULL_WEIGHT, {5}}, false);
            if (used <= CYCLE_USE) break;
            const double factor = 0.9999 * CYCLE_USE / used;
            for (int k = 0; k < 3 * size; k++) basis_coefficients[0][k] *= factor;
        }
        sample_motion(basis_coefficients[0], motions.knots, result.knots);
        const int powers = motions.spline.columns, pieces = powers / 6;
        Matrix spline;
        combine(basis_coefficients[0], motions.spline, spline);
        result.spline.resize(3 * powers);
        for (int k = 0; k < powers; k++)
            for (int c = 0; c < 3; c++) result.spline[3 * k + c] = spline[c][k];
        Matrix force(parts, 2);
        spline_force(motions.times.data(), {result.spline.data(), {pieces, 6, 3}}, request.position,
                     request.velocity, {force[0], {parts, 2}});
        result.error.resize(2 * parts);
        for (int r = 0; r < 2 * parts; r++) result.error[r] = requested[r] - force[0][r];
        result.worst = worst(result.error);
        result.condition = condition_of(fit.jacobian);
        return result;
    }
};

}  // namespace plate::averages
