// Python bindings of the kernels in this folder.
#include "fit/basin_hopping.hpp"
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

// Minimises the errors of Python functions: `fit` in levenberg_marquardt.py.
static nb::tuple fit(nb::callable evaluate, nb::callable admissible, Numbers start,
                     double tolerance, int iterations) {
    nb::object slopes;
    const auto evaluate_there = [&](std::vector<double>& parameters, std::vector<double>& error) {
        std::vector<double> wanted = parameters;
        const size_t count = wanted.size();
        const nb::object trial = admissible(to_numpy<1>(std::move(wanted), {count}));
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

static nb::tuple hop(nb::callable propose, nb::callable attempt, nb::object problem,
                     nb::object begin, int tries, int hops, bool rounds, int failed) {
    const auto propose_one = [&](int number, const nb::object& near, bool fresh) {
        return propose(problem, number, near, fresh);
    };
    const auto attempt_one = [&](const nb::object& start, int number, double least) {
        const nb::object answer = attempt(problem, start, number, least), enough = answer[3];
        return Attempted<nb::object>{answer[0], nb::cast<double>(answer[1]),
                                     nb::cast<int>(answer[2]), bool(nb::bool_(nb::handle(enough)))};
    };
    auto found = basin_hopping<nb::object>(propose_one, attempt_one, begin, tries, hops, rounds,
                                           failed);
    return nb::make_tuple(found.best, found.steps, found.tried);
}

void bind_fit(nb::module_& m) {
    m.def("fit", fit);
    m.def("basin_hopping", hop, "propose"_a, "attempt"_a, "problem"_a.none(), "begin"_a.none(),
          "tries"_a, "hops"_a, "rounds"_a, "failed"_a);
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
