// Python bindings of the kernels in unreachable.hpp.
#include "averages/unreachable.hpp"
#include "records.hpp"

namespace plate {

void bind_unreachable(nb::module_& m) {
    m.def("circles", [](Table cells) {
        check("cells", cells, {cells.shape(0), 4});
        const size_t count = cells.shape(0), points = unreachable::POINTS;
        std::vector<double> circle_points(3 * count * points);
        unreachable::circles(
            view(cells), {circle_points.data(), {static_cast<int>(count), unreachable::POINTS, 3}});
        return to_numpy<3>(std::move(circle_points), {count, points, 3});
    });
    m.def("unit_slips", [](Box twists, Table position, double arm_m) {
        const size_t circles = twists.shape(0), points = twists.shape(1), parts = position.shape(0);
        check("twists", twists, {circles, points, 3}), check("position", position, {parts, 2});
        const int count = static_cast<int>(circles * points), wide = static_cast<int>(2 * parts);
        std::vector<double> slips(circles * points * 2 * parts);
        {
            nb::gil_scoped_release others_may_run;
            unreachable::unit_slips({twists.data(), {count, 3}}, view(position), arm_m,
                                    {slips.data(), {count, wide}});
        }
        return to_numpy<3>(std::move(slips), {circles, points, 2 * parts});
    });
    m.def("best_triple", [](Table value) {
        if (value.shape(1) == 0 || value.shape(1) % unreachable::SIDE_BY_SIDE)
            throw nb::value_error("the number of points on a circle is not a multiple of 8");
        unreachable::Best found;
        {
            nb::gil_scoped_release others_may_run;
            found = unreachable::best_triple(view(value));
        }
        const auto& [circle, first, second, opposite] = found.indices;
        return nb::make_tuple(found.triple, nb::make_tuple(circle, first, second, opposite));
    });
    m.def("proves", [](Table cells, Table position, double arm_m, Numbers separating,
                       double limit) {
        check("cells", cells, {cells.shape(0), 4});
        check("position", position, {position.shape(0), 2});
        check("separating", separating, {2 * position.shape(0)});
        nb::gil_scoped_release others_may_run;
        return unreachable::proves(view(cells), view(position), arm_m, separating.data(), limit);
    });
}

}  // namespace plate
