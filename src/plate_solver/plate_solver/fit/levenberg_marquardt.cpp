// What levenberg_marquardt.hpp declares.
#include "fit/levenberg_marquardt.hpp"

#include <algorithm>
#include <limits>

#include <plate/four.hpp>
#include <plate/products.hpp>
#include <plate/wide.hpp>

namespace plate {

// Solve (a' a + damping mean(diag) 1) x = right in place, for a (terms, count), by Cholesky's
// method. Of each pair of entries the one of the upper half is kept: then loops go along rows.
PLATE_WIDE void solve_damped(const double* a, int terms, int count, double damping, double* right,
                             Matrix& square) {
    square.resize(count, count);
    square_product(a, count, terms, count, square[0]);
    double diagonal = 0;
    for (int i = 0; i < count; i++) diagonal += square[i][i];
    const double more = damping * diagonal / count + 1e-30;
    for (int i = 0; i < count; i++) square[i][i] += more;
    for (int j = 0; j < count; j++) {
        double* __restrict own = square[j];
        for (int k = 0; k < j; k++) {
            const double* __restrict above = square[k];
            const double factor = above[j];
#pragma omp simd
            for (int i = j; i < count; i++) own[i] -= above[i] * factor;
        }
        own[j] = std::sqrt(std::max(own[j], 1e-300));
        for (int i = j + 1; i < count; i++) own[i] /= own[j];
    }
    for (int k = 0; k < count; k++) {
        const double* __restrict own = square[k];
        right[k] /= own[k];
        for (int i = k + 1; i < count; i++) right[i] -= own[i] * right[k];
    }
    for (int i = count - 1; i >= 0; i--) {
        for (int k = i + 1; k < count; k++) right[i] -= square[i][k] * right[k];
        right[i] /= square[i][i];
    }
}

const std::vector<double>& LeastNormStep::operator()(const Matrix& jacobian,
                                                     const std::vector<double>& error,
                                                     double damping) {
    step.assign(jacobian.columns, 0.0);
    if (jacobian.rows <= jacobian.columns) {
        transpose(jacobian, across);
        weights = error;
        solve_damped(across[0], across.rows, across.columns, damping, weights.data(), square);
        add_rows(jacobian, weights);
    } else {
        add_rows(jacobian, error);
        solve_damped(jacobian[0], jacobian.rows, jacobian.columns, damping, step.data(), square);
    }
    return step;
}

void LeastNormStep::add_rows(const Matrix& jacobian, const std::vector<double>& weight) {
    double* __restrict sum = step.data();
    for (int i = 0; i < jacobian.rows; i++) {
        const double* __restrict row = jacobian[i];
        for (int c = 0; c < jacobian.columns; c++) sum[c] += weight[i] * row[c];
    }
}

Fit levenberg_marquardt(const Evaluate& evaluate, const Slopes& slopes, std::vector<double> start,
                        const Damping& damping, double tolerance, int iterations) {
    Fit best{.parameters = std::move(start)};
    evaluate(best.parameters, best.error);
    slopes(best.jacobian);
    double cost = squared(best.error), factor = damping.first;
    std::vector<double> trial, trial_error, history(iterations + 1);
    LeastNormStep least_norm_step;
    int& done = best.iterations;
    while (worst(best.error) > tolerance && done < iterations) {
        history[done] = cost;
        const int past = done - damping.stall_steps;
        if (past >= 0 && cost > damping.stall_fraction * history[past]) break;
        done++;
        trial = best.parameters;
        const std::vector<double>& step = least_norm_step(best.jacobian, best.error, factor);
        for (size_t p = 0; p < trial.size(); p++) trial[p] += step[p];
        evaluate(trial, trial_error);
        const double trial_cost = squared(trial_error);
        if (trial_cost < cost) {
            best.parameters.swap(trial), best.error.swap(trial_error);
            cost = trial_cost;
            slopes(best.jacobian);
            factor = std::max(factor / damping.shrink, damping.least);
        } else {
            factor *= damping.grow;
            if (factor > damping.most) break;
        }
    }
    return best;
}

// A symmetric matrix of three diagonals: the middle one (n,), and squares of that beside it, the
// first of which is zero.
struct Tridiagonal {
    std::vector<double> middle, beside2;

    // The eigenvalue that has `index` others below it, to 1e-10 of itself; where it is less than
    // `least`, a number below that. It is between 0 and `high`, which four pivots at a time narrow
    // down: as many of a shifted matrix are negative as there are eigenvalues below the shift.
    double eigenvalue(int index, double least, double high) const {
        double low = 0;
        while (high - low > 1e-10 * high && high > least) {
            const double step = (high - low) / 5;
            const Four one{1, 1, 1, 1}, tiny = 1e-300 * one;
            const Four shift = low + step * Four{1, 2, 3, 4};
            Four pivot = one, below{};
            for (size_t i = 0; i < middle.size(); i++) {
                pivot = middle[i] - shift - beside2[i] / pivot;
                pivot = pivot == 0 ? tiny : pivot;
                below += pivot < 0 ? one : 0 * one;
            }
            int first = 0;
            while (first < 4 && below[first] <= index) first++;
            if (first < 4) high = shift[first];
            if (first > 0) low = shift[first - 1];
        }
        return high;
    }
};

// Make a symmetric matrix tridiagonal by Householder's reflections. It is lost.
PLATE_WIDE void make_tridiagonal(Matrix& square, Tridiagonal& result) {
    const int count = square.rows;
    std::vector<double> normal(count), product(count);
    double *__restrict v = normal.data(), *__restrict p = product.data();
    result.beside2.assign(count, 0.0);
    for (int k = 0; k + 1 < count; k++) {
        const double* row = square[k];
        double length2 = 0;
        for (int i = k + 1; i < count; i++) length2 += row[i] * row[i];
        result.beside2[k + 1] = length2;
        if (length2 == 0) continue;
        const double length = std::sqrt(length2);
        const double factor = 1 / (length2 + length * std::abs(row[k + 1]));
        for (int i = k + 1; i < count; i++) v[i] = row[i], p[i] = 0;
        v[k + 1] += v[k + 1] < 0 ? -length : length;
        for (int i = k + 1; i < count; i++) {
            const double* __restrict own = square[i];
            const double share = factor * v[i];
#pragma omp simd
            for (int j = k + 1; j < count; j++) p[j] += share * own[j];
        }
        double along = 0;
        for (int i = k + 1; i < count; i++) along += p[i] * v[i];
        for (int i = k + 1; i < count; i++) p[i] -= factor / 2 * along * v[i];
        for (int i = k + 1; i < count; i++) {
            double* __restrict own = square[i];
            const double vi = v[i], pi = p[i];
#pragma omp simd
            for (int j = k + 1; j < count; j++) own[j] -= vi * p[j] + pi * v[j];
        }
    }
    result.middle.resize(count);
    for (int i = 0; i < count; i++) result.middle[i] = square[i][i];
}

double condition_of(const Matrix& jacobian) {
    Matrix across, square;
    const bool wide = jacobian.rows <= jacobian.columns;
    if (wide) transpose(jacobian, across);
    const Matrix& tall = wide ? across : jacobian;
    const int count = tall.columns;
    square.resize(count, count);
    square_product(tall[0], count, tall.rows, count, square[0]);
    for (int i = 0; i < count; i++)
        for (int j = 0; j < i; j++) square[i][j] = square[j][i];
    double trace = 0;
    for (int i = 0; i < count; i++) trace += square[i][i];
    Tridiagonal matrix;
    make_tridiagonal(square, matrix);
    const double most = matrix.eigenvalue(count - 1, 0, 2 * trace);
    const double least = matrix.eigenvalue(0, 1e-15 * most, 2 * trace);
    return least > 1e-14 * most ? std::sqrt(most / least) : std::numeric_limits<double>::infinity();
}

}  // namespace plate
