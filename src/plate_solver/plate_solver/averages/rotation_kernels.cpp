// Python bindings of the kernels in rotations.hpp and tour.hpp.
#include "averages/rotations.hpp"
#include "averages/tour.hpp"
#include "fit/fit_record.hpp"
#include "rotations/sequences_record.hpp"

namespace plate {

using namespace rotations;

// Returns the indices of the entries of `mask` (3 M,) that are true.
static std::vector<int> rows_of(const Array<const bool, 1>& mask, size_t parts) {
    check("rows", mask, {3 * parts});
    std::vector<int> rows;
    for (size_t row = 0; row < 3 * parts; row++)
        if (mask.data()[row]) rows.push_back(static_cast<int>(row));
    return rows;
}

static nb::object slopes_of_forces(Numbers theta, nb::tuple record, Table position, Table velocity,
                                   Array<const bool, 1> mask) {
    const Sequences family = sequences_of(record);
    const size_t parts = position.shape(0);
    check("position", position, {parts, 2}), check("velocity", velocity, {parts, 2});
    const Parameters own = parameters_of(theta, family);
    const std::vector<int> rows = rows_of(mask, parts);
    Matrix jacobian;
    {
        nb::gil_scoped_release others_may_run;
        force_slopes(own, family, knots_of(own, family), view(position), view(velocity), rows,
                     jacobian);
    }
    return to_numpy(std::move(jacobian));
}

// Owns the arrays of the Python tuple `SequenceForces` while their views are in use.
class ForcesRecord {
public:
    explicit ForcesRecord(const nb::tuple& record)
        : position(field<Table>(record, "position")), velocity(field<Table>(record, "velocity")),
          requested(field<Numbers>(record, "requested")), scale(field<Numbers>(record, "scale")) {
        const size_t parts = position.shape(0);
        check("position", position, {parts, 2}), check("velocity", velocity, {parts, 2});
        std::vector<int> rows = rows_of(field<Array<const bool, 1>>(record, "rows"), parts);
        check("requested", requested, {rows.size()}), check("scale", scale, {rows.size()});
        problem = {sequences_of(field<nb::tuple>(record, "family")), view(position),
                   view(velocity), std::move(rows), view(requested), view(scale)};
    }

    const SequenceForces& operator*() const { return problem; }

private:
    Table position, velocity;
    Numbers requested, scale;
    SequenceForces problem;
};

static nb::tuple correct(nb::tuple record, Numbers theta, double tolerance, int iterations) {
    const ForcesRecord problem(record);
    Parameters start = parameters_of(theta, (*problem).family);
    Fit found;
    {
        nb::gil_scoped_release others_may_run;
        found = descend(*problem, std::move(start), tolerance, iterations);
    }
    return fields_of(std::move(found));
}

static nb::object miss(nb::tuple record, Table twist, Numbers dt) {
    const ForcesRecord problem(record);
    check("twist", twist, {dt.size(), 3});
    std::vector<double> error;
    {
        nb::gil_scoped_release others_may_run;
        missed(*problem, view(twist), dt.data(), error);
    }
    return to_numpy(std::move(error));
}

void bind_average_rotations(nb::module_& m) {
    m.def("force_slopes", slopes_of_forces);
    m.def("fit_mean_force", correct);
    m.def("mean_force_error", miss);
    m.def("short_tour", [](Table twists, Numbers half) {
        check("twists", twists, {twists.shape(0), 3}), check("half", half, {2});
        if (twists.shape(0) == 0) throw nb::value_error("a tour needs at least one twist");
        const std::vector<int> tour = short_tour(changes(view(twists), half.data()));
        nb::list places;
        for (size_t k = 1; k < twists.shape(0); k++) places.append(tour[k]);
        return places;
    });
}

}  // namespace plate
