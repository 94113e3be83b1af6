// Python bindings of the kernels in this folder.
#include "fit/fit_record.hpp"

namespace plate {

using namespace nb::literals;

static std::vector<double> numbers_of(nb::handle array) {
    const auto from = nb::cast<Numbers>(array);
    return {from.data(), from.data() + from.size()};
}

static void copy(const Table& from, Matrix& matrix) {
    matrix.resize(from.shape(0), from.shape(1));
    std::copy_n(from.data(), from.size(), matrix[0]);
}

static Matrix matrix_of(const Table& from) {
    Matrix matrix;
    copy(from, matrix);
    return matrix;
}

// Minimises errors that Python functions compute. `fit` in levenberg_marquardt.py describes the
// arguments.
static nb::tuple fit(nb::callable evaluate, nb::callable admissible, Numbers start,
                     double tolerance, int iterations) {
    nb::object slopes;
    const auto evaluate_there = [&](std::vector<double>& parameters, std::vector<double>& error) {
        std::vector<double> trial_parameters = parameters;
        const size_t count = trial_parameters.size();
        const nb::object trial = admissible(to_numpy<1>(std::move(trial_parameters), {count}));
        const nb::object answer = evaluate(trial);
        parameters = numbers_of(trial);
        error = numbers_of(answer[0]);
        slopes = answer[1];
        if (parameters.size() != count) throw nb::value_error("the number of parameters changes");
    };
    const auto slopes_there = [&](Matrix& jacobian) { copy(nb::cast<Table>(slopes()), jacobian); };
    return fields_of(levenberg_marquardt<double>(evaluate_there, slopes_there, numbers_of(nb::cast(start)),
                                         DAMPING, tolerance, iterations));
}

void bind_fit(nb::module_& m) {
    m.def("fit", fit);
    m.def("least_norm_step", [](Table jacobian, Numbers error, double damping) {
        check("error", error, {jacobian.shape(0)});
        const Matrix matrix = matrix_of(jacobian);
        LeastNormStep<double> least_norm_step;
        least_norm_step.take(matrix);
        std::vector<double> step =
            least_norm_step({error.data(), error.data() + error.size()}, damping);
        return to_numpy<1>(std::move(step), {jacobian.shape(1)});
    });
    m.def("condition_of", [](Table jacobian) {
        if (jacobian.size() == 0) throw nb::value_error("the Jacobian is empty");
        const Matrix matrix = matrix_of(jacobian);
        nb::gil_scoped_release others_may_run;
        return condition_of(matrix);
    });
}

}  // namespace plate
