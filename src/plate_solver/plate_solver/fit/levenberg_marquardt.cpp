// Implementation of levenberg_marquardt.hpp. Damped steps are computed by Cholesky's method. The
// condition number is computed by reduction to tridiagonal form and bisection of the eigenvalues.
#include "fit/levenberg_marquardt.hpp"

#include <algorithm>
#include <limits>

#include <plate/simd.hpp>
#include <plate/products.hpp>
#include <plate/wide.hpp>

namespace plate {

// Solves a symmetric linear system in place by Cholesky's method. On entry, the upper half of
// `root` (count, wide) contains the matrix, and `right` contains the right-hand side. The matrix is
// replaced by its Cholesky root, where matrix = root' root. The reciprocals of the root's diagonal
// are stored. `right` is replaced by the solution. The root is stored in the upper half so that
// loops run along rows. Each row is padded to a multiple of the vector length. Entries left of the
// diagonal that belong to the same vector are set to zero.
template <class Number>
[[gnu::always_inline]] inline void solve_of(MatrixOf<Number>& root, int count, Number* right) {
    constexpr int VECTOR = LANES_OF<Number>;
    const int wide = root.columns;
    for (int j = 0; j < count; j++) {
        Number* __restrict row = root[j];
        const int from = j / VECTOR * VECTOR;
        int k = 0;
        for (; k + 4 <= j; k += 4) {
            const Number *__restrict a = root[k], *__restrict b = root[k + 1];
            const Number *__restrict c = root[k + 2], *__restrict d = root[k + 3];
            const Number by_a = a[j], by_b = b[j], by_c = c[j], by_d = d[j];
#pragma omp simd
            for (int i = from; i < wide; i++)
                row[i] = row[i] - a[i] * by_a - b[i] * by_b - c[i] * by_c - d[i] * by_d;
        }
        for (; k < j; k++) {
            const Number* __restrict above = root[k];
            const Number factor = above[j];
#pragma omp simd
            for (int i = from; i < wide; i++) row[i] -= above[i] * factor;
        }
        const Number inverse = 1 / std::sqrt(std::max(row[j], std::numeric_limits<Number>::min()));
#pragma omp simd
        for (int i = from; i < wide; i++) row[i] *= inverse;
        std::fill(row + from, row + j, Number(0));
        row[j] = inverse;
    }
    for (int k = 0; k < count; k++) {
        const Number* __restrict row = root[k];
        const Number entry = right[k] *= row[k];
        for (int i = k + 1; i < wide; i++) right[i] -= row[i] * entry;
    }
    for (int i = count - 1; i >= 0; i--) {
        const Number* __restrict row = root[i];
        Number part[VECTOR] = {}, sum = 0;
        const Number entry = right[i];
        right[i] = 0;
        for (int k = i / VECTOR * VECTOR; k < wide; k += VECTOR)
            for (int lane = 0; lane < VECTOR; lane++) part[lane] += row[k + lane] * right[k + lane];
        for (Number term : part) sum += term;
        right[i] = (entry - sum) * row[i];
    }
}

PLATE_WIDE void solve(Matrix& root, int count, double* right) { solve_of(root, count, right); }

PLATE_WIDE void solve(MatrixOf<float>& root, int count, float* right) {
    solve_of(root, count, right);
}

template <class Number>
void LeastNormStep<Number>::take(const MatrixOf<Number>& of) {
    constexpr int VECTOR = LANES_OF<Number>;
    jacobian = &of;
    count = std::min(of.rows, of.columns);
    const int terms = std::max(of.rows, of.columns), wide = (count + VECTOR - 1) / VECTOR * VECTOR;
    tall.resize(terms, wide);
    for (int k = 0; k < terms; k++) {
        Number* row = tall[k];
        if (by_rows())
            for (int i = 0; i < count; i++) row[i] = of[i][k];
        else
            std::copy_n(of[k], count, row);
        std::fill(row + count, row + wide, Number(0));
    }
    gram.resize(wide, wide);
    square_product(tall[0], wide, terms, wide, gram[0]);
    mean = 0;
    for (int i = 0; i < count; i++) mean += gram[i][i] / count;
}

template <class Number>
const std::vector<Number>& LeastNormStep<Number>::operator()(const std::vector<double>& error,
                                                             double damping) {
    root.resize(gram.rows, gram.columns);
    std::copy_n(gram[0], gram.rows * gram.columns, root[0]);
    for (int i = 0; i < count; i++) root[i][i] += static_cast<Number>(damping * mean + 1e-30);
    right.assign(error.begin(), error.end());
    step.assign(jacobian->columns, Number(0));
    if (by_rows()) {
        right.resize(gram.columns);
        solve(root, count, right.data());
        add_rows(right);
    } else {
        add_rows(right);
        step.resize(gram.columns);
        solve(root, count, step.data());
        step.resize(count);
    }
    return step;
}

template <class Number>
void LeastNormStep<Number>::add_rows(const std::vector<Number>& weight) {
    Number* __restrict sum = step.data();
    for (int i = 0; i < jacobian->rows; i++) {
        const Number* __restrict row = (*jacobian)[i];
        const Number factor = weight[i];
        for (int c = 0; c < jacobian->columns; c++) sum[c] += factor * row[c];
    }
}

template class LeastNormStep<double>;

template <class Number>
FitOf<Number> levenberg_marquardt(const Evaluate& evaluate, const Slopes<Number>& slopes,
                                  std::vector<double> start, const Damping& damping,
                                  double tolerance, int iterations) {
    FitOf<Number> best{.parameters = std::move(start)};
    evaluate(best.parameters, best.error);
    slopes(best.jacobian);
    double cost = squared(best.error), factor = damping.first;
    std::vector<double> trial, trial_error, history(iterations + 1);
    LeastNormStep<Number> least_norm_step;
    bool moved = true;
    int& done = best.iterations;
    while (worst(best.error) > tolerance && done < iterations) {
        history[done] = cost;
        const int past = done - damping.stall_steps;
        if (past >= 0 && cost > damping.stall_fraction * history[past]) break;
        done++;
        if (moved) least_norm_step.take(best.jacobian);
        trial = best.parameters;
        const std::vector<Number>& step = least_norm_step(best.error, factor);
        for (size_t p = 0; p < trial.size(); p++) trial[p] += step[p];
        evaluate(trial, trial_error);
        const double trial_cost = squared(trial_error);
        moved = trial_cost < cost;
        if (moved) {
            best.parameters.swap(trial), best.error.swap(trial_error);
            cost = trial_cost;
            slopes(best.jacobian);
            factor = std::max(factor / damping.shrink, damping.minimum);
        } else {
            factor *= damping.grow;
            if (factor > damping.maximum) break;
        }
    }
    return best;
}

template FitOf<double> levenberg_marquardt(const Evaluate&, const Slopes<double>&,
                                           std::vector<double>, const Damping&, double, int);
template FitOf<float> levenberg_marquardt(const Evaluate&, const Slopes<float>&,
                                          std::vector<double>, const Damping&, double, int);

// A symmetric tridiagonal matrix. `diagonal` (n,) is its diagonal. `off_diagonal2` (n,) contains
// the squares of the off-diagonal entries, from index 1 on. The entry off_diagonal2[0] is zero.
struct Tridiagonal {
    std::vector<double> diagonal, off_diagonal2;

    // Returns an eigenvalue with a relative error of up to 1e-10. `index` is its position in
    // ascending order, from 0. If the eigenvalue is below `minimum`, the result is any number up to
    // `minimum`. The search begins with the interval from 0 to `high`. Each step divides the
    // interval by four shifts and selects one of the five parts. The number of negative pivots of
    // the shifted matrix is the number of eigenvalues below the shift.
    double eigenvalue(int index, double minimum, double high) const {
        double low = 0;
        while (high - low > 1e-10 * high && high > minimum) {
            const double step = (high - low) / 5;
            const Four one{1, 1, 1, 1}, tiny = 1e-300 * one;
            const Four shift = low + step * Four{1, 2, 3, 4};
            Four pivot = one, below{};
            for (size_t i = 0; i < diagonal.size(); i++) {
                pivot = diagonal[i] - shift - off_diagonal2[i] / pivot;
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

// Reduces a symmetric matrix to tridiagonal form by Householder reflections. The matrix is
// overwritten.
PLATE_WIDE void make_tridiagonal(Matrix& square, Tridiagonal& result) {
    const int count = square.rows;
    std::vector<double> normal(count), product(count);
    double *__restrict v = normal.data(), *__restrict p = product.data();
    result.off_diagonal2.assign(count, 0.0);
    for (int k = 0; k + 1 < count; k++) {
        const double* row = square[k];
        double length2 = 0;
        for (int i = k + 1; i < count; i++) length2 += row[i] * row[i];
        result.off_diagonal2[k + 1] = length2;
        if (length2 == 0) continue;
        const double length = std::sqrt(length2);
        const double factor = 1 / (length2 + length * std::abs(row[k + 1]));
        for (int i = k + 1; i < count; i++) v[i] = row[i], p[i] = 0;
        v[k + 1] += v[k + 1] < 0 ? -length : length;
        for (int i = k + 1; i < count; i++) {
            const double* __restrict other = square[i];
            const double scale = factor * v[i];
#pragma omp simd
            for (int j = k + 1; j < count; j++) p[j] += scale * other[j];
        }
        double along = 0;
        for (int i = k + 1; i < count; i++) along += p[i] * v[i];
        for (int i = k + 1; i < count; i++) p[i] -= factor / 2 * along * v[i];
        for (int i = k + 1; i < count; i++) {
            double* __restrict other = square[i];
            const double vi = v[i], pi = p[i];
#pragma omp simd
            for (int j = k + 1; j < count; j++) other[j] -= vi * p[j] + pi * v[j];
        }
    }
    result.diagonal.resize(count);
    for (int i = 0; i < count; i++) result.diagonal[i] = square[i][i];
}

double condition_of(const Matrix& jacobian) {
    Matrix across, square;
    const bool wide = jacobian.rows <= jacobian.columns;
    if (wide) across.resize(jacobian.columns, jacobian.rows);
    for (int i = 0; wide && i < jacobian.rows; i++)
        for (int c = 0; c < jacobian.columns; c++) across[c][i] = jacobian[i][c];
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
    const double maximum = matrix.eigenvalue(count - 1, 0, 2 * trace);
    const double minimum = matrix.eigenvalue(0, 1e-15 * maximum, 2 * trace);
    return minimum > 1e-14 * maximum ? std::sqrt(maximum / minimum)
                                     : std::numeric_limits<double>::infinity();
}

}  // namespace plate
