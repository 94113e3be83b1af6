// Python bindings of family.hpp and sequence.hpp.
#include <stdexcept>

#include "rotations/sequences_record.hpp"

namespace plate {

using namespace rotations;

static nb::tuple line_to_python(Line&& line) {
    return nb::make_tuple(to_numpy(std::move(line.times)), to_numpy(std::move(line.knots)));
}

static nb::tuple moved_to_python(Moved&& moved) {
    std::vector<double> gap(moved.gap.begin(), moved.gap.end());
    return nb::make_tuple(to_numpy(std::move(moved.pose)), to_numpy(std::move(moved.twist)),
                          to_numpy(std::move(moved.accel)), to_numpy(std::move(moved.dt)),
                          to_numpy(std::move(gap)));
}

// Returns derivatives with respect to the parameters, one row per result. `by_knots(line)` computes
// the derivatives with respect to the knots.
template <class ByKnotsOf>
static nb::object slopes_of(const nb::tuple& record, const Numbers& theta, ByKnotsOf&& by_knots) {
    const SequencesRecord family(record);
    const Parameters own = family.parameters(theta);
    Matrix jacobian;
    {
        nb::gil_scoped_release others_may_run;
        const ByKnots by = by_knots(*family, line_of(own, *family));
        std::vector<int> results(by.results());
        std::iota(results.begin(), results.end(), 0);
        parameters_back(own, *family, by, results, jacobian);
    }
    return to_numpy(std::move(jacobian));
}

static nb::object pull_back_samples(Numbers theta, nb::tuple record, Box by_pose, Box by_twist,
                                    Table by_dt) {
    const size_t n = by_dt.shape(0), results = by_dt.shape(1);
    check("by_pose", by_pose, {by_pose.shape(0) == 2 ? 2u : 3u, n, results});
    check("by_twist", by_twist, {3, n, results});
    return slopes_of(record, theta, [&](const Sequences& family, const Line& line) {
        if (steps_of(line, family.steps) != static_cast<int>(n))
            throw std::invalid_argument("there are not as many derivatives as steps");
        return pull_back(line, family.steps, view(by_pose), view(by_twist), view(by_dt));
    });
}

void bind_rotations(nb::module_& m) {
    m.def("ramps", [](Table twists, Numbers half, Table loads, double accel) {
        check("twists", twists, {twists.shape(0), 3}), check("half", half, {2});
        check("loads", loads, {loads.shape(0), 3});
        Ramps found = ramps(view(twists), half.data(), view(loads), accel);
        return nb::make_tuple(to_numpy(std::move(found.length)), to_numpy(std::move(found.slope)));
    });
    m.def("timeline", [](Numbers holds, Table twists, Numbers ramp, double period) {
        check("twists", twists, {twists.shape(0), 3});
        check("holds", holds, {twists.shape(0) + 1}), check("ramp", ramp, {twists.shape(0) + 1});
        return line_to_python(timeline(copied(holds), view(twists), copied(ramp), period));
    });
    m.def("knot_poses", [](Numbers times, Table knots) {
        return to_numpy(knot_poses(line_from(times, knots)));
    });
    m.def("motion", [](Numbers times, Table knots, nb::tuple counts) {
        return moved_to_python(
            motion(line_from(times, knots), SequencesRecord::steps_from(counts)));
    });
    m.def("line_of", [](Numbers theta, nb::tuple record) {
        const SequencesRecord family(record);
        return line_to_python(line_of(family.parameters(theta), *family));
    });
    m.def("runnable", [](Numbers theta, nb::tuple record) {
        const SequencesRecord family(record);
        Run run;
        {
            Parameters start = family.parameters(theta);
            nb::gil_scoped_release others_may_run;
            run = runnable(std::move(start), *family);
        }
        return nb::make_tuple(to_numpy(std::move(run.theta)), line_to_python(std::move(run.line)),
                              moved_to_python(std::move(run.moved)));
    });
    m.def("pull_back", pull_back_samples);
    m.def("gap_slopes", [](Numbers theta, nb::tuple record) {
        return slopes_of(record, theta,
                         [](const Sequences&, const Line& line) { return gap_back(line); });
    });
}

}  // namespace plate
