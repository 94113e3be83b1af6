// Python bindings of request.hpp, mean_force.hpp, near_zero_slip.hpp and sinusoid_force.hpp.
#include "averages/mean_force.hpp"
#include "averages/request.hpp"
#include "averages/rules_record.hpp"
#include "records.hpp"

namespace plate {

using nb::arg;

static View<double, 2> pairs(std::vector<double>& numbers) {
    return {numbers.data(), {static_cast<int>(numbers.size() / 2), 2}};
}

static void check_parts(const Table& position, const Table& velocity) {
    check("position", position, {position.shape(0), 2});
    check("velocity", velocity, {position.shape(0), 2});
}

// Checks that the coefficients of a slip have the shape (2 N + 1, 2). Returns 2 N.
static size_t waves_of(const Table& slip) {
    check("slip", slip, {slip.shape(0) / 2 * 2 + 1, 2});
    return slip.shape(0) - 1;
}

void bind_force_maps(nb::module_& m) {
    m.attr("FARTHEST_M") = FARTHEST_M, m.attr("FASTEST_MPS") = FASTEST_MPS;
    m.def("request_flags", [](Table position, Table force, Table velocity, Numbers curl,
                              Table tolerance) {
        const size_t count = curl.size();
        check("position", position, {count, 2});
        check("force", force, {count, 2});
        check("velocity", velocity, {count, 2});
        check("tolerance", tolerance, {count, 2});
        const RequestFlags flags = request_flags(view(position), view(force), view(velocity),
                                                 view(curl), view(tolerance));
        return nb::make_tuple(flags.is_valid, flags.parts_move, flags.has_curl, flags.has_tolerance,
                              flags.zero_is_enough, flags.max_force);
    });
    m.def("spline_force", [](Numbers times, Box coefficients, Table position, Table velocity) {
        check("coefficients", coefficients, {coefficients.shape(0), 6, 3});
        check("times", times, {coefficients.shape(0) + 1}), check_parts(position, velocity);
        std::vector<double> force(position.size());
        {
            nb::gil_scoped_release others_may_run;
            spline_force(times.data(), view(coefficients), view(position), view(velocity),
                         pairs(force));
        }
        return to_numpy<2>(std::move(force), {position.shape(0), 2});
    });
    m.def("step_forces", [](Table position, Table velocity, Table twist, Numbers dt) {
        check_parts(position, velocity), check("twist", twist, {dt.size(), 3});
        const size_t count = position.shape(0);
        std::vector<double> mean(3 * count);
        {
            nb::gil_scoped_release others_may_run;
            step_forces(view(position), view(velocity), view(twist), dt.data(),
                        {mean.data(), {static_cast<int>(count), 3}});
        }
        return to_numpy<2>(std::move(mean), {count, 3});
    });
    m.def("step_force_gradient", [](Table position, Table velocity, Table twist, Numbers dt) {
        check_parts(position, velocity), check("twist", twist, {dt.size(), 3});
        const size_t n = twist.shape(0), columns = 3 * position.shape(0);
        std::vector<double> gradient(3 * n * columns);
        {
            nb::gil_scoped_release others_may_run;
            step_force_gradient(
                view(position), view(velocity), view(twist), dt.data(),
                {gradient.data(), {3, static_cast<int>(n), static_cast<int>(columns)}});
        }
        return to_numpy<3>(std::move(gradient), {3, n, columns});
    });
    m.def("find_dips", [](Numbers square, int n, Array<double, 1> found) {
        if (n < 2) throw nb::value_error("n is not at least 2");
        check("square", square, {static_cast<size_t>(n)});
        check("found", found, {static_cast<size_t>(n)});
        return near_zero_slip::find_dips(square.data(), n, found.data());
    }, arg("square"), arg("n"), arg("found").noconvert());
    m.def("branch_point", [](Table slip, double real, double imag, double close) {
        waves_of(slip);
        const auto point = near_zero_slip::branch_point(view(slip), {real, imag}, close);
        return nb::make_tuple(point.middle.real, point.middle.imag, point.b, point.isolated);
    });
    m.def("slip_at", [](Table coefficients, double x, double y, double vx, double vy,
                        Array<double, 2> slip) {
        check("coefficients", coefficients, {coefficients.shape(0), 3});
        check("slip", slip, {coefficients.shape(0) + 1, 2});
        slip_at(view(coefficients), x, y, vx, vy, view(slip));
    }, arg("coefficients"), arg("x"), arg("y"), arg("vx"), arg("vy"), arg("slip").noconvert());
    m.def("force_of", [](Table slip, nb::tuple rules, int grid, Array<double, 2> work,
                         Array<double, 2> gradient) {
        const size_t waves = waves_of(slip);
        const RulesRecord rule(rules, waves);
        check("work", work, {5, static_cast<size_t>((*rule).waves.size(1))});
        if (gradient.size() > 0) check("gradient", gradient, {3, waves});
        const Force force = force_of(view(slip), *rule, grid, view(work), view(gradient));
        return nb::make_tuple(force.x, force.y);
    }, arg("slip"), arg("rule"), arg("grid"), arg("work").noconvert(),
       arg("gradient").noconvert());
    m.def("sinusoid_forces", [](Box coefficients, Table position, Table velocity,
                                nb::tuple rules) {
        const size_t count = position.shape(0), waves = coefficients.shape(1);
        check("coefficients", coefficients, {count, waves, 3}), check_parts(position, velocity);
        const RulesRecord rule(rules, waves);
        std::vector<double> force(2 * count);
        {
            nb::gil_scoped_release others_may_run;
            sinusoid_forces(view(coefficients), view(position), view(velocity), *rule,
                            pairs(force));
        }
        return to_numpy<2>(std::move(force), {count, 2});
    });
}

}  // namespace plate
