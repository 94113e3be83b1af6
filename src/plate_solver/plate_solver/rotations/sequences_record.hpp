// Converts the Python tuple `Sequences` to the C++ struct, for the bindings.
#pragma once
#include "records.hpp"
#include "rotations/family.hpp"

namespace plate::rotations {

using plate::to_numpy;

inline nb::object to_numpy(std::vector<double>&& numbers) {
    const size_t count = numbers.size();
    return nb::cast(to_numpy<1>(std::move(numbers), {count}));
}

inline nb::object to_numpy(Matrix&& matrix) {
    const size_t rows = matrix.rows, columns = matrix.columns;
    return nb::cast(to_numpy<2>(std::move(matrix.numbers), {rows, columns}));
}

inline std::vector<double> copied(const Numbers& array) {
    return {array.data(), array.data() + array.size()};
}

// Owns the arrays of the Python tuple `Sequences` while their views are in use.
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

    // Converts a Python array to a vector of parameters. Throws an error if its size is wrong.
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

inline Line line_from(const Numbers& times, const Table& knots) {
    check("knots", knots, {times.size(), 3});
    if (times.size() < 3 || times.size() % 2 == 0)
        throw nb::value_error("a line of J rotations has 2 J + 3 knots");
    Line line{copied(times), Matrix(static_cast<int>(knots.shape(0)), 3)};
    std::copy_n(knots.data(), knots.size(), line.knots[0]);
    return line;
}

}  // namespace plate::rotations
