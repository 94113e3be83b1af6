// Python bindings of the kernels in sinusoids.hpp.
#include "averages/rules_record.hpp"
#include "averages/sinusoids.hpp"
#include "records.hpp"

namespace plate {

using averages::InversionResult;
using averages::Inversion;
using averages::Motions;
using averages::Request;
using sinusoids::SampledBasis;

static Matrix matrix_of(View<const double, 2> from) {
    Matrix result(from.size(0), from.size(1));
    std::copy_n(from.data, from.size(0) * from.size(1), result[0]);
    return result;
}

// Returns the transpose of `rows` rows of an array. The first of these rows has the index `first`.
static Matrix across(const Table& array, size_t first, size_t rows) {
    const int count = static_cast<int>(rows), size = static_cast<int>(array.shape(1));
    Matrix result(size, count);
    for (int k = 0; k < count; k++)
        for (int h = 0; h < size; h++) result[h][k] = array.data()[(first + k) * size + h];
    return result;
}

// Converts the samples (n, h) of the h basis motions: pose, twist and acceleration.
static SampledBasis sampled_basis_of(const Table& pose, const Table& twist, const Table& accel,
                                     size_t size) {
    const size_t n = pose.shape(0);
    for (const Table* basis : {&pose, &twist, &accel}) check("basis", *basis, {n, size});
    return {across(pose, 0, n), across(twist, 0, n), across(accel, 0, n)};
}

// Converts a Python `SinusoidBasis` to `Motions`. `hull` (3 c, h) contains the control points of
// pose, twist and acceleration.
static Motions motions_of(nb::tuple rules_record, nb::handle basis, Table hull, nb::tuple limits,
                          int candidates) {
    const auto table = [&](const char* name) { return field<Table>(basis, name); };
    const Table span = table("span"), spline = table("spline");
    const nb::tuple knots = field<nb::tuple>(basis, "knots");
    const Numbers times = field<Numbers>(basis, "times");
    const RulesRecord record(rules_record, span.shape(0));
    const Rules& rules = *record;
    const size_t size = span.shape(1), pieces = times.size() - 1, third = hull.shape(0) / 3;
    check("span", span, {span.shape(0), size}), check("hull", hull, {3 * third, size});
    check("spline", spline, {6 * pieces, size});
    if (candidates < 1 || third == 0 || size == 0) throw nb::value_error("there are no motions");
    return {
        .waves = matrix_of(rules.waves),
        .taylor = matrix_of(rules.taylor),
        .few = rules.few,
        .pieces = rules.pieces,
        .span = matrix_of(span),
        .steps = sampled_basis_of(table("pose"), table("twist"), table("accel"), size),
        .knots = sampled_basis_of(item<Table>(knots, 0), item<Table>(knots, 1),
                                  item<Table>(knots, 2), size),
        .hull = {across(hull, 0, third), across(hull, third, third),
                 across(hull, 2 * third, third)},
        .spline = across(spline, 0, 6 * pieces),
        .times = {times.data(), times.data() + times.size()},
        .limits = limits_of(limits),
        .candidates = candidates,
    };
}

// Converts samples (3, n) to an array (n, 3). The last sample is a copy of the first, so that the
// cycle closes exactly.
static nb::object closed(const Matrix& path) {
    const int n = path.columns;
    std::vector<double> samples(3 * n);
    for (int k = 0; k < n; k++)
        for (int c = 0; c < 3; c++) samples[3 * k + c] = path[c][k == n - 1 ? 0 : k];
    return nb::cast(to_numpy<2>(std::move(samples), {static_cast<size_t>(n), 3}));
}

// Returns the fields of the Python tuple `InversionResult`.
static nb::tuple fields_of(InversionResult&& found) {
    const size_t size = found.theta.size(), pieces = found.spline.size() / 18;
    const size_t parts = found.error.size() / 2;
    return nb::make_tuple(to_numpy<1>(std::move(found.theta), {size}), closed(found.knots.pose),
                          closed(found.knots.twist), closed(found.knots.accel),
                          to_numpy<3>(std::move(found.spline), {pieces, 6, 3}),
                          to_numpy<2>(std::move(found.error), {parts, 2}), found.worst,
                          found.condition, found.iterations, found.tries);
}

static nb::tuple invert(Table warm, Table pool, Table position, Table velocity, Table force,
                        const Motions& motions, double tolerance, int iterations, int tries) {
    const size_t parts = position.shape(0), size = 3 * static_cast<size_t>(motions.size());
    check("warm", warm, {warm.shape(0), size}), check("pool", pool, {pool.shape(0), size});
    for (const Table* array : {&position, &velocity, &force}) check("parts", *array, {parts, 2});
    if (parts == 0 || pool.shape(0) == 0 || iterations < 0)
        throw nb::value_error("there is no part, no random motion, or no step");
    const Request request{view(position), view(velocity), view(force),
                          tolerance,      iterations,     tries};
    InversionResult found;
    {
        nb::gil_scoped_release others_may_run;
        Inversion inversion(motions, view(pool), request);
        found = inversion.invert(warm.shape(0) ? warm.data() : nullptr);
    }
    return fields_of(std::move(found));
}

void bind_average_sinusoids(nb::module_& m) {
    nb::class_<Motions>(m, "AveragedMotions");
    m.def("averaged_motions", motions_of);
    m.def("invert", invert);
}

}  // namespace plate
