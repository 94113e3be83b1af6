// Python bindings of family.hpp and sequence.hpp.
#include <stdexcept>

#include "rotations/sequences_record.hpp"

namespace plate {

using namespace rotations;

// Returns the fields of the Python tuple `Run`.
static nb::tuple fields_of(Run&& run) {
    MotionSamples& samples = run.samples;
    return nb::make_tuple(to_numpy(std::move(run.theta)), to_numpy(std::move(run.knots.times)),
                          to_numpy(std::move(run.knots.twists)), to_numpy(std::move(samples.pose)),
                          to_numpy(std::move(samples.twist)), to_numpy(std::move(samples.accel)),
                          to_numpy(std::move(samples.dt)), to_numpy(std::move(samples.knot_pose)));
}

// Returns derivatives with respect to the parameters, one row per result. `by_knots(family, knots)`
// computes the derivatives with respect to the knots.
template <class ByKnotsOf>
static nb::object slopes_of(const nb::tuple& record, const Numbers& theta, ByKnotsOf&& by_knots) {
    const Sequences family = sequences_of(record);
    const Parameters own = parameters_of(theta, family);
    Matrix jacobian;
    {
        nb::gil_scoped_release others_may_run;
        const ByKnots by = by_knots(family, knots_of(own, family));
        std::vector<int> results(by.results());
        std::iota(results.begin(), results.end(), 0);
        parameters_back(own, family, by, results, jacobian);
    }
    return to_numpy(std::move(jacobian));
}

static nb::object pull_back_samples(Numbers theta, nb::tuple record, Box by_pose, Box by_twist,
                                    Table by_dt) {
    const size_t n = by_dt.shape(0), results = by_dt.shape(1);
    check("by_pose", by_pose, {by_pose.shape(0) == 2 ? 2u : 3u, n, results});
    check("by_twist", by_twist, {3, n, results});
    return slopes_of(record, theta, [&](const Sequences& family, const Knots& knots) {
        if (steps_of(knots, family.steps) != static_cast<int>(n))
            throw std::invalid_argument("there are not as many derivatives as steps");
        return pull_back(knots, family.steps, view(by_pose), view(by_twist), view(by_dt));
    });
}

void bind_rotations(nb::module_& m) {
    m.def("ramps", [](Table twists, Numbers half, Table loads, double accel) {
        check("twists", twists, {twists.shape(0), 3}), check("half", half, {2});
        check("loads", loads, {loads.shape(0), 3});
        Ramps found = ramps(view(twists), half.data(), view(loads), accel);
        return nb::make_tuple(to_numpy(std::move(found.length)), to_numpy(std::move(found.slope)));
    });
    m.def("run_of", [](Numbers theta, nb::tuple record) {
        const Sequences family = sequences_of(record);
        return fields_of(run_of(parameters_of(theta, family), family));
    });
    m.def("runnable", [](Numbers theta, nb::tuple record) {
        const Sequences family = sequences_of(record);
        Parameters start = parameters_of(theta, family);
        Run run;
        {
            nb::gil_scoped_release others_may_run;
            run = runnable(std::move(start), family);
        }
        return fields_of(std::move(run));
    });
    m.def("pull_back", pull_back_samples);
    m.def("gap_slopes", [](Numbers theta, nb::tuple record) {
        return slopes_of(record, theta,
                         [](const Sequences&, const Knots& knots) { return gap_back(knots); });
    });
}

}  // namespace plate
