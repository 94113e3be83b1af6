// Levenberg-Marquardt for a few errors and many parameters: kernels of levenberg_marquardt.py.
#pragma once
#include <cmath>
#include <functional>
#include <vector>

#include <plate/view.hpp>

namespace plate {

// How the damping of steps changes, in units of the mean squared row of the Jacobian.
struct Damping {
    double first, least, most;  // a search that needs more than the most is given up
    double shrink, grow;        // factors after a step that was taken, and after one that was not
    int stall_steps;            // a search is given up where so many steps leave
    double stall_fraction;      // more than this fraction of the squared error
};

// Where each evaluation is expensive: it tries longer, and never counts as stalled.
constexpr Damping DAMPING{1e-2, 1e-6, 1e3, 3.0, 4.0, 1'000'000, 1.0};

// Parameters (P,), errors (R,), Jacobian (R, P) of minus these, and steps made.
template <class Number>
struct FitOf {
    std::vector<double> parameters, error;
    MatrixOf<Number> jacobian;
    int iterations = 0;
};

using Fit = FitOf<double>;

inline double squared(const std::vector<double>& error) {
    double total = 0;
    for (double value : error) total += value * value;
    return total;
}

// The greatest size of an error; NaN if one is.
inline double worst(const std::vector<double>& error) {
    double most = 0;
    for (double value : error)
        if (std::abs(value) > most || std::isnan(value)) most = std::abs(value);
    return most;
}

inline void transpose(const Matrix& matrix, Matrix& across) {
    across.resize(matrix.columns, matrix.rows);
    for (int i = 0; i < matrix.rows; i++)
        for (int c = 0; c < matrix.columns; c++) across[c][i] = matrix[i][c];
}

// Damped steps of least norm, J' (J J' + damping mean(diag) 1)^-1 error, or the same in the space of
// the parameters where that is the smaller one. Keeps its memory between Jacobians.
template <class Number>
class LeastNormStep {
public:
    // Takes a Jacobian (R, P), which has to stay where it is.
    void take(const MatrixOf<Number>& of);

    // The step (P,) for errors (R,).
    const std::vector<Number>& operator()(const std::vector<double>& error, double damping);

private:
    const MatrixOf<Number>* jacobian = nullptr;
    int count = 0;                      // of unknowns
    double mean = 0;                    // of the diagonal
    MatrixOf<Number> tall, gram, root;  // columns are filled up with zeros to whole vectors
    std::vector<Number> right, step;

    bool by_rows() const { return jacobian->rows <= jacobian->columns; }
    void add_rows(const std::vector<Number>& weight);
};

using Evaluate = std::function<void(std::vector<double>& parameters, std::vector<double>& error)>;

template <class Number>
using Slopes = std::function<void(MatrixOf<Number>& jacobian)>;

// Search from `start` (P,) for errors of at most `tolerance`, in at most so many `iterations` after
// the first evaluation. `evaluate(parameters, error)` brings parameters to the nearest ones that
// the rig can run and finds their errors (R,); `slopes(jacobian)` finds minus the derivative (R, P)
// of what was evaluated last, and is asked only where a step is taken.
template <class Number>
FitOf<Number> levenberg_marquardt(const Evaluate& evaluate, const Slopes<Number>& slopes,
                                  std::vector<double> start, const Damping& damping,
                                  double tolerance, int iterations);

// The condition number (infinite where it is beyond 1e7).
double condition_of(const Matrix& jacobian);

}  // namespace plate
