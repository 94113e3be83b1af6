// C++ kernels of levenberg_marquardt.py: the Levenberg-Marquardt method for few errors and many
// parameters.
#pragma once
#include <climits>
#include <cmath>
#include <functional>
#include <vector>

#include <plate/view.hpp>

namespace plate {

// Options of the damping. The unit of the damping is the mean squared length of the Jacobian's
// rows. With the default values, the search never stops because of slow progress.
struct Damping {
    double first = 1e-2, minimum = 1e-6;
    double maximum = 1e3;         // if the damping exceeds this value, the search stops
    double shrink = 3, grow = 4;  // factors after an accepted and after a rejected step
    int stall_steps = INT_MAX;    // if the last `stall_steps` steps leave more than
    double stall_fraction = 1;    // `stall_fraction` of the squared error, the search stops
};

// Result of a search: parameters (P,), errors (R,), negative Jacobian of the errors (R, P), and
// number of steps.
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

// Returns the maximum absolute error, or NaN if any error is NaN.
inline double worst(const std::vector<double>& error) {
    double maximum = 0;
    for (double value : error)
        if (std::abs(value) > maximum || std::isnan(value)) maximum = std::abs(value);
    return maximum;
}

// Computes damped steps of minimum norm for a Jacobian J:
//     step = J' (J J' + damping m I)^-1 error
// Here, m is the mean of the diagonal of J J', and I is the identity matrix. If there are fewer
// parameters than errors, an equivalent smaller system with J' J is solved. An object reuses its
// buffers for the next Jacobian.
template <class Number>
class LeastNormStep {
public:
    // Sets the Jacobian (R, P). The object refers to the memory of the Jacobian, so this memory
    // must remain valid.
    void take(const MatrixOf<Number>& of);

    // Returns the step (P,) for errors (R,).
    const std::vector<Number>& operator()(const std::vector<double>& error, double damping);

private:
    const MatrixOf<Number>* jacobian = nullptr;
    int count = 0;                      // number of unknowns
    double mean = 0;                    // mean of the diagonal
    MatrixOf<Number> tall, gram, root;  // rows are padded with zeros to whole vectors
    std::vector<Number> right, step;

    bool by_rows() const { return jacobian->rows <= jacobian->columns; }
    void add_rows(const std::vector<Number>& weight);
};

using Evaluate = std::function<void(std::vector<double>& parameters, std::vector<double>& error)>;

template <class Number>
using Slopes = std::function<void(MatrixOf<Number>& jacobian)>;

// Searches for parameters (P,) whose errors do not exceed `tolerance`. The search evaluates
// `start`, and then at most `iterations` other parameter vectors. `evaluate(parameters, error)`
// first changes the parameters to values that the rig can run. Then `evaluate` computes the errors
// (R,) of these parameters. `slopes(jacobian)` computes the negative derivatives (R, P) at the last
// evaluated parameters. The search calls `slopes` at the start and after each accepted step.
template <class Number>
FitOf<Number> levenberg_marquardt(const Evaluate& evaluate, const Slopes<Number>& slopes,
                                  std::vector<double> start, const Damping& damping,
                                  double tolerance, int iterations);

// Returns the condition number of the Jacobian, or infinity if the condition number exceeds 1e7.
double condition_of(const Matrix& jacobian);

}  // namespace plate
