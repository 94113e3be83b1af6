// C++ kernels of simplex.py. The file simplex.py describes the linear programme, which computes
// fractions of time for rotations. The kernels use the revised simplex method.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <plate/products.hpp>
#include <plate/view.hpp>

namespace plate::library {

// A column enters the basis only if its gain per unit exceeds this value. The gain has the unit of
// the costs.
constexpr double OPTIMAL = 1e-9;

// Minimum absolute value of a pivot. A basis is unusable if an entry of its inverse is 1 / PIVOT or
// larger.
constexpr double PIVOT = 1e-9;

// Number of pivots after which the inverse of the basis is recomputed.
constexpr int REFRESH = 40;

// Inverts a matrix by the Gauss-Jordan method with column pivoting. Returns whether the matrix is
// regular.
PLATE_WIDE inline bool invert_matrix(Matrix& matrix, Matrix& inverse) {
    const int rows = matrix.rows;
    inverse.resize(rows, rows);
    std::fill_n(inverse[0], rows * rows, 0.0);
    for (int i = 0; i < rows; i++) inverse[i][i] = 1;
    for (int j = 0; j < rows; j++) {
        int pivot = j;
        for (int i = j + 1; i < rows; i++)
            if (std::abs(matrix[i][j]) > std::abs(matrix[pivot][j])) pivot = i;
        if (!(std::abs(matrix[pivot][j]) > 0)) return false;
        double* __restrict pivot_row = matrix[j], *__restrict pivot_inverse = inverse[j];
        if (pivot != j) {
            std::swap_ranges(pivot_row, pivot_row + rows, matrix[pivot]);
            std::swap_ranges(pivot_inverse, pivot_inverse + rows, inverse[pivot]);
        }
        const double first = pivot_row[j];
        for (int c = j; c < rows; c++) pivot_row[c] /= first;
        for (int c = 0; c < rows; c++) pivot_inverse[c] /= first;
        for (int i = 0; i < rows; i++) {
            const double factor = matrix[i][j];
            if (i == j || factor == 0) continue;
            double *__restrict row = matrix[i], *__restrict row_inverse = inverse[i];
#pragma omp simd
            for (int c = j; c < rows; c++) row[c] -= factor * pivot_row[c];
#pragma omp simd
            for (int c = 0; c < rows; c++) row_inverse[c] -= factor * pivot_inverse[c];
        }
    }
    return true;
}

// Returns the product of a matrix and a vector. The entries of the vector are `stride` numbers
// apart.
inline void times_vector(const Matrix& matrix, const double* vector, int stride, double* result) {
    for (int i = 0; i < matrix.rows; i++) {
        const double* row = matrix[i];
        double total = 0;
        for (int c = 0; c < matrix.columns; c++) total += row[c] * vector[c * stride];
        result[i] = total;
    }
}

struct Entering {
    int column;
    double sense, gain;
};

// A linear programme, and the state of the simplex method. `amount` (R,) contains the amounts of
// the basis columns in the current solution.
struct Programme {
    View<const double, 2> matrix;          // (R, K)
    View<const double, 1> right_side, price;   // (R,), (K + 2 R,)
    View<int64_t, 1> basis;                // (R,): indices, see `TimeFractions.basis`
    View<double, 1> sense;                 // (R,)
    Matrix chosen, inverse;
    std::vector<double> amount, dual, value, column;

    int rows() const { return matrix.size(0); }
    int count() const { return matrix.size(1); }
    int simplex(int pivots);

private:
    bool restart();
    Entering best_column();
    void find_column(int q, double direction);
    void pivot_on(int leave, double amount_in);
};

// Computes the inverse and the amounts of the basis, and sets `sense`. Returns whether the basis is
// usable. If the amount of a column is negative, the column is multiplied by -1. For a column of
// the matrix, `sense` becomes -1, so the rotation is reversed. The slack variable of an unmet
// amount is replaced by the slack variable of the exceeded amount, or the other way round.
inline bool Programme::restart() {
    chosen.resize(rows(), rows());
    std::fill_n(chosen[0], rows() * rows(), 0.0);
    for (int j = 0; j < rows(); j++) {
        const int q = static_cast<int>(basis(j)), slack = q - count();
        if (slack < 0)
            for (int i = 0; i < rows(); i++) chosen[i][j] = matrix(i, q);
        else
            chosen[slack % rows()][j] = slack < rows() ? 1 : -1;
    }
    if (!invert_matrix(chosen, inverse)) return false;
    double maximum = 0;
    for (int i = 0; i < rows() * rows(); i++) maximum = std::max(maximum, std::abs(inverse[0][i]));
    times_vector(inverse, right_side.data, 1, amount.data());
    for (int i = 0; i < rows(); i++) {
        sense(i) = 1;
        if (!(amount[i] < 0)) continue;
        amount[i] = -amount[i];
        for (int c = 0; c < rows(); c++) inverse[i][c] = -inverse[i][c];
        if (basis(i) < count())
            sense(i) = -1;
        else
            basis(i) += basis(i) < count() + rows() ? rows() : -rows();
    }
    return maximum * PIVOT < 1;
}

// Returns the column with the largest gain, its direction, and its gain per unit.
inline Entering Programme::best_column() {
    for (int c = 0; c < rows(); c++) dual[c] = 0;
    for (int i = 0; i < rows(); i++) {
        const double cost = price(basis(i));
        for (int c = 0; c < rows(); c++) dual[c] += cost * inverse[i][c];
    }
    product(dual.data(), 1, matrix.data, count(), rows(), 1, count(), value.data(), count());
    int best = -1;
    double gain = 0;
    for (int j = 0; j < count(); j++) {
        const double gain_of_column = std::abs(value[j]) - price(j);
        if (gain_of_column > gain) best = j, gain = gain_of_column;
    }
    double sense = best < 0 || value[best] > 0 ? 1 : -1;
    for (int i = 0; i < rows(); i++) {
        const int over = count() + i, under = count() + rows() + i;
        if (dual[i] - price(over) > gain) best = over, gain = dual[i] - price(over), sense = 1;
        if (-dual[i] - price(under) > gain) best = under, gain = -dual[i] - price(under), sense = 1;
    }
    return {best, sense, gain};
}

// Computes the coefficients that express column q, times `direction`, as a combination of the basis
// columns.
inline void Programme::find_column(int q, double direction) {
    if (q < count()) {
        times_vector(inverse, matrix.data + q, count(), column.data());
        for (double& entry : column) entry *= direction;
    } else {
        const bool over = q < count() + rows();
        const int c = over ? q - count() : q - count() - rows();
        for (int i = 0; i < rows(); i++) column[i] = over ? inverse[i][c] : -inverse[i][c];
    }
}

// Replaces column `leave` of the basis by the column of the last `find_column` call. The amount of
// the new column is `amount_in`.
inline void Programme::pivot_on(int leave, double amount_in) {
    double* __restrict pivot_row = inverse[leave];
    for (int i = 0; i < rows(); i++) {
        if (i == leave) continue;
        amount[i] = std::max(amount[i] - amount_in * column[i], 0.0);
        const double factor = column[i] / column[leave];
        if (factor == 0) continue;
        double* __restrict row = inverse[i];
        for (int c = 0; c < rows(); c++) row[c] -= factor * pivot_row[c];
    }
    for (int c = 0; c < rows(); c++) pivot_row[c] /= column[leave];
    amount[leave] = amount_in;
}

// Improves the basis and the directions `sense` in place, with at most `pivots` pivots. Returns the
// number of pivots, or -1 if the basis is unusable.
inline int Programme::simplex(int pivots) {
    amount.resize(rows()), dual.resize(rows()), value.resize(count()), column.resize(rows());
    bool fits = restart();
    for (int done = 0; done < pivots; done++) {
        if (done % REFRESH == REFRESH - 1) fits = restart();
        if (!fits) return -1;
        const Entering entering = best_column();
        if (entering.gain <= OPTIMAL) return done;
        find_column(entering.column, entering.sense);
        int leave = -1;
        double amount_in = std::numeric_limits<double>::infinity();
        for (int i = 0; i < rows(); i++)
            if (column[i] > PIVOT && amount[i] < amount_in * column[i])
                amount_in = amount[i] / column[i], leave = i;
        // the solution is unbounded; valid costs and prices exclude this
        if (leave < 0) return done;
        pivot_on(leave, amount_in);
        basis(leave) = entering.column;
        sense(leave) = entering.sense;
    }
    return pivots;
}

}  // namespace plate::library
