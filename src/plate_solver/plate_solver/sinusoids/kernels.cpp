// Python bindings of the kernels in descent.hpp.
#include "fit/fit_record.hpp"
#include "goal/ends_record.hpp"
#include "records.hpp"
#include "sinusoids/descent.hpp"

namespace plate {

using namespace sinusoids;
using descent::Motions;
using descent::Problem;

template <class Number = double>
static MatrixOf<Number> transposed(const Table& array) {
    MatrixOf<Number> result(array.shape(1), array.shape(0));
    for (int i = 0; i < result.rows; i++)
        for (int c = 0; c < result.columns; c++) result[i][c] = array(c, i);
    return result;
}

// Converts samples (n, h) of the basis motions at the instants at which limits are checked. The
// last `tail` instants belong to the tail of the cycle. These instants do not count for the heat of
// the motors.
static SampledBasis sampled_basis_of(const Table& pose, const Table& twist, const Table& accel,
                                     int tail) {
    check("twist", twist, {pose.shape(0), pose.shape(1)});
    check("accel", accel, {pose.shape(0), pose.shape(1)});
    if (tail < 0 || static_cast<size_t>(tail) >= pose.shape(0))
        throw nb::value_error("tail is not from 0 to the number of instants minus 1");
    const double heated = pose.shape(0) - tail;
    std::vector<double> weight(pose.shape(0), 1.0);
    std::fill(weight.end() - tail, weight.end(), 0.0);
    return {transposed(pose), transposed(twist), transposed(accel), matrix_of(pose),
            matrix_of(twist), matrix_of(accel),  std::move(weight), heated};
}

static Motions motions_of(Table pose, Table twist, Table twist_bins, Table check_pose,
                          Table check_twist, Table check_accel, int tail, Numbers scale, double dt,
                          nb::tuple limits) {
    const size_t size = pose.shape(1), bins = twist_bins.shape(0);
    check("twist", twist, {pose.shape(0), size});
    check("twist_bins", twist_bins, {bins, size});
    check("checks", check_pose, {check_pose.shape(0), size});
    check("scale", scale, {3});
    if (bins == 0 || pose.shape(0) % bins)
        throw nb::value_error("the number of steps is not a multiple of the number of bins");
    return {transposed<float>(pose), transposed<float>(twist), matrix_of<float>(twist_bins),
            sampled_basis_of(check_pose, check_twist, check_accel, tail),
            {scale(0), scale(1), scale(2)}, dt, limits_of(limits)};
}

// Converts two sets of samples of the settling motion. The first set (n, 3) is at the middles of
// the time steps. The second set (l, 3) is at the instants at which limits are checked.
static descent::Settling settling_of(Table pose, Table twist, Table check_pose, Table check_twist,
                                     Table check_accel) {
    for (const Table* each : {&pose, &twist}) check("settling", *each, {pose.shape(0), 3});
    for (const Table* each : {&check_pose, &check_twist, &check_accel})
        check("settling", *each, {check_pose.shape(0), 3});
    const auto moves = [](double value) { return value != 0; };
    return {transposed<float>(pose), transposed<float>(twist),
            {transposed(check_pose), transposed(check_twist), transposed(check_accel)},
            std::any_of(check_accel.data(), check_accel.data() + check_accel.size(), moves)};
}

static nb::tuple descend(const Motions& motions, const descent::Settling& settling,
                         Array<const float, 2> start, nb::tuple ends_record, double coast,
                         double max_use, Numbers theta, double tolerance, int iterations) {
    const bool turning = start.shape(1) == TURNING_STATE;
    const size_t ends = field<Numbers>(ends_record, "low").size(), axes = turning ? 3 : 2;
    const Problem problem{motions, settling, view(start), ends_of(ends_record, ends),
                          coast, max_use};
    if (!turning) check("start", start, {start.shape(0), STATE});
    const size_t parts = problem.ends.parts;
    if (ends != axes * parts || start.shape(0) * LANES < parts)
        throw nb::value_error("the numbers of parts, blocks and ends do not match");
    if (settling.pose.columns != motions.steps() ||
        settling.checked.pose.columns != motions.checks.count())
        throw nb::value_error("the sizes of settling and motions do not match");
    check("theta", theta, {3 * static_cast<size_t>(motions.size())});
    FitOf<float> fit;
    {
        nb::gil_scoped_release others_may_run;
        static thread_local descent::Workspace workspace;
        fit = descent::descend(problem, copied(theta), tolerance, iterations, workspace);
    }
    return fields_of(std::move(fit));
}

void bind_sinusoids(nb::module_& m) {
    m.attr("EXCESS_M") = EXCESS_M, m.attr("PENALTY_USE") = PENALTY_USE;
    nb::class_<Motions>(m, "Motions");
    nb::class_<descent::Settling>(m, "Settling");
    m.def("motions_of", motions_of);
    m.def("settling_of", settling_of);
    m.def("descend", descend);
}

}  // namespace plate
