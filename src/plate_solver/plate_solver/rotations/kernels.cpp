// What Python sees of the kernels of rotations.
#include <stdexcept>

#include "fit/fit_record.hpp"
#include "records.hpp"
#include "rotations/average.hpp"
#include "rotations/plan.hpp"
#include "rotations/simplex.hpp"

namespace plate {

using namespace rotations;
using nb::arg;

static nb::object to_numpy(std::vector<double>&& numbers) {
    const size_t count = numbers.size();
    return nb::cast(to_numpy<1>(std::move(numbers), {count}));
}

static nb::object to_numpy(Matrix&& matrix) {
    const size_t rows = matrix.rows, columns = matrix.columns;
    return nb::cast(to_numpy<2>(std::move(matrix.numbers), {rows, columns}));
}

static std::vector<double> copied(const Numbers& array) {
    return {array.data(), array.data() + array.size()};
}

// `Sequences` of Python, whose arrays it keeps.
class SequencesRecord {
public:
    explicit SequencesRecord(const nb::tuple& record)
        : basis(nb::cast<Box>(field(record, 0))), loads(nb::cast<Table>(field(record, 4))) {
        check("basis", basis, {basis.shape(0), basis.shape(1), 3});
        check("loads", loads, {loads.shape(0), 3});
        const nb::tuple steps = nb::cast<nb::tuple>(field(record, 5));
        family = {
            .basis = view(basis),
            .hold_scale = nb::cast<double>(field(record, 1)),
            .period = nb::cast<double>(field(record, 2)),
            .accel = nb::cast<double>(field(record, 3)),
            .loads = view(loads),
            .steps = steps_from(steps),
            .limits = limits_of(nb::cast<nb::tuple>(field(record, 6))),
        };
        if (family.count() < 1) throw nb::value_error("there are no rotations");
    }

    const Sequences& operator*() const { return family; }

    // The parameters in an array.
    Parameters parameters(const Numbers& theta) const {
        check("parameters", theta, {static_cast<size_t>(family.parameters())});
        return copied(theta);
    }

    static std::array<int, 2> steps_from(const nb::tuple& pair) {
        const std::array<int, 2> steps{nb::cast<int>(field(pair, 0)), nb::cast<int>(field(pair, 1))};
        if (steps[0] < 1 || steps[1] < 1) throw nb::value_error("a segment has at least one step");
        return steps;
    }

private:
    Box basis;
    Table loads;
    Sequences family;
};

static Line line_from(const Numbers& times, const Table& knots) {
    check("knots", knots, {times.size(), 3});
    if (times.size() < 3 || times.size() % 2 == 0)
        throw nb::value_error("a line of J rotations has 2 J + 3 knots");
    Line line{copied(times), Matrix(static_cast<int>(knots.shape(0)), 3)};
    std::copy_n(knots.data(), knots.size(), line.knots[0]);
    return line;
}

static nb::tuple line_to_python(Line&& line) {
    return nb::make_tuple(to_numpy(std::move(line.times)), to_numpy(std::move(line.knots)));
}

static nb::tuple moved_to_python(Moved&& moved) {
    std::vector<double> gap(moved.gap.begin(), moved.gap.end());
    return nb::make_tuple(to_numpy(std::move(moved.pose)), to_numpy(std::move(moved.twist)),
                          to_numpy(std::move(moved.accel)), to_numpy(std::move(moved.dt)),
                          to_numpy(std::move(gap)));
}

// Rows of results by parameters, from derivatives by knots that `by_knots(line)` makes.
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

// Rows of results that are asked for, of a mask (3 M,).
static std::vector<int> rows_of(const Array<const bool, 1>& asked, size_t parts) {
    check("asked", asked, {3 * parts});
    std::vector<int> rows;
    for (size_t row = 0; row < 3 * parts; row++)
        if (asked.data()[row]) rows.push_back(static_cast<int>(row));
    return rows;
}

static nb::object slopes_of_forces(Numbers theta, nb::tuple record, Numbers times, Table knots,
                                   Table position, Table velocity, Array<const bool, 1> asked) {
    const SequencesRecord family(record);
    const size_t parts = position.shape(0);
    check("position", position, {parts, 2}), check("velocity", velocity, {parts, 2});
    const Line line = line_from(times, knots);
    if (line.segments() != 2 * (*family).count() + 2)
        throw nb::value_error("these are not the knots of so many rotations");
    const Parameters own = family.parameters(theta);
    const std::vector<int> rows = rows_of(asked, parts);
    Matrix jacobian;
    {
        nb::gil_scoped_release others_may_run;
        force_slopes(own, *family, line, view(position), view(velocity), rows, jacobian);
    }
    return to_numpy(std::move(jacobian));
}

// `SequenceForces` of Python, whose arrays it keeps.
class ForcesRecord {
public:
    explicit ForcesRecord(const nb::tuple& record)
        : family(nb::cast<nb::tuple>(field(record, 0))), position(nb::cast<Table>(field(record, 1))),
          velocity(nb::cast<Table>(field(record, 2))), wanted(nb::cast<Numbers>(field(record, 4))),
          scale(nb::cast<Numbers>(field(record, 5))) {
        const size_t parts = position.shape(0);
        check("position", position, {parts, 2}), check("velocity", velocity, {parts, 2});
        std::vector<int> rows = rows_of(nb::cast<Array<const bool, 1>>(field(record, 3)), parts);
        check("wanted", wanted, {rows.size()}), check("scale", scale, {rows.size()});
        problem = {*family,      view(position), view(velocity), std::move(rows),
                   view(wanted), view(scale)};
    }

    const SequenceForces& operator*() const { return problem; }

    SequencesRecord family;

private:
    Table position, velocity;
    Numbers wanted, scale;
    SequenceForces problem;
};

static nb::tuple correct(nb::tuple record, Numbers theta, double tolerance, int iterations) {
    const ForcesRecord problem(record);
    Parameters start = problem.family.parameters(theta);
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

// Whether all columns of a basis are some of K + 2 R.
static void check_basis(const View<const int64_t, 1>& basis, size_t columns) {
    for (int i = 0; i < basis.size(0); i++)
        if (basis(i) < 0 || basis(i) >= static_cast<int64_t>(columns))
            throw nb::value_error("the basis has a column that there is not");
}

static int improve(Table matrix, Numbers wanted, Numbers price, Array<int64_t, 1> basis,
                   Array<double, 1> sense, int pivots) {
    const size_t rows = matrix.shape(0), columns = matrix.shape(1) + 2 * rows;
    check("wanted", wanted, {rows}), check("price", price, {columns});
    check("basis", basis, {rows}), check("sense", sense, {rows});
    check_basis({basis.data(), {static_cast<int>(rows)}}, columns);
    nb::gil_scoped_release others_may_run;
    Programme programme{view(matrix), view(wanted), view(price), view(basis), view(sense)};
    return programme.simplex(pivots);
}

static nb::object chosen(Table matrix, Array<const int64_t, 1> basis) {
    const int rows = static_cast<int>(matrix.shape(0));
    check("basis", basis, {matrix.shape(0)});
    check_basis(view(basis), matrix.shape(1) + 2 * matrix.shape(0));
    Matrix result(rows, rows);
    columns_of(view(matrix), view(basis), {result[0], {rows, rows}});
    return to_numpy(std::move(result));
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
    m.def("force_slopes", slopes_of_forces);
    m.def("fit_mean_force", correct);
    m.def("mean_force_error", miss);
    m.def("columns_of", chosen);
    m.def("simplex", improve, arg("matrix"), arg("wanted"), arg("price"),
          arg("basis").noconvert(), arg("sense").noconvert(), arg("pivots"));
    m.def("short_tour", [](Table twists, Numbers half) {
        check("twists", twists, {twists.shape(0), 3}), check("half", half, {2});
        if (twists.shape(0) == 0) throw nb::value_error("a tour begins somewhere");
        const std::vector<int> tour = short_tour(changes(view(twists), half.data()));
        nb::list places;
        for (size_t k = 1; k < twists.shape(0); k++) places.append(tour[k]);
        return places;
    });
}

}  // namespace plate
