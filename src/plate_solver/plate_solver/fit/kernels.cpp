// Python bindings of the kernels in this folder.
#include "fit/fit_record.hpp"

namespace plate {

using namespace nb::literals;

// Minimises errors that Python functions compute. `fit` in levenberg_marquardt.py describes the
// arguments.
static nb::tuple fit(nb::callable evaluate, nb::callable admissible, Numbers start,
                     double tolerance, int iterations) {
    nb::object slopes;
    const auto evaluate_there = [&](std::vector<double>& parameters, std::vector<double>& error) {
        std::vector<double> trial_parameters = parameters;
        const size_t count = trial_parameters.size();
        const nb::object trial = admissible(to_numpy(std::move(trial_parameters)));
        const nb::object result = evaluate(trial);
        parameters = copied(nb::cast<Numbers>(trial));
        error = copied(nb::cast<Numbers>(result[0]));
        slopes = result[1];
        if (parameters.size() != count) throw nb::value_error("the number of parameters changes");
    };
    const auto slopes_there = [&](Matrix& jacobian) {
        jacobian = matrix_of(nb::cast<Table>(slopes()));
    };
    return fields_of(levenberg_marquardt<double>(evaluate_there, slopes_there, copied(start), {},
                                                 tolerance, iterations));
}

void bind_fit(nb::module_& m) {
    m.def("fit", fit);
    m.def("least_norm_step", [](Table jacobian, Numbers error, double damping) {
        check("error", error, {jacobian.shape(0)});
        const Matrix matrix = matrix_of(jacobian);
        LeastNormStep<double> least_norm_step;
        least_norm_step.take(matrix);
        return to_numpy(std::vector<double>(least_norm_step(copied(error), damping)));
    });
    m.def("condition_of", [](Table jacobian) {
        if (jacobian.size() == 0) throw nb::value_error("the Jacobian is empty");
        const Matrix matrix = matrix_of(jacobian);
        nb::gil_scoped_release others_may_run;
        return condition_of(matrix);
    });
}

}  // namespace plate
