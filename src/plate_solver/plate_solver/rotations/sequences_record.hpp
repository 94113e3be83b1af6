// Converts the Python tuple `Sequences` to the C++ struct, for the bindings.
#pragma once
#include "records.hpp"
#include "rotations/family.hpp"

namespace plate::rotations {

inline Sequences sequences_of(const nb::tuple& record) {
    const Table loads = nb::cast<Table>(field(record, 4));
    check("loads", loads, {loads.shape(0), 3});
    const nb::tuple steps = nb::cast<nb::tuple>(field(record, 5));
    Sequences family{
        .rotations = nb::cast<int>(field(record, 0)),
        .period = nb::cast<double>(field(record, 2)),
        .accel = nb::cast<double>(field(record, 3)),
        .loads = matrix_of(loads),
        .steps = {nb::cast<int>(field(steps, 0)), nb::cast<int>(field(steps, 1))},
        .limits = limits_of(nb::cast<nb::tuple>(field(record, 6))),
    };
    read("scale", field(record, 1), family.scale);
    if (family.rotations < 1) throw nb::value_error("there are no rotations");
    if (family.steps[0] < 1 || family.steps[1] < 1)
        throw nb::value_error("a segment has at least one step");
    return family;
}

// Converts a Python array to a vector of parameters. Throws an error if its size is wrong.
inline Parameters parameters_of(const Numbers& theta, const Sequences& family) {
    check("parameters", theta, {static_cast<size_t>(family.parameters())});
    return copied(theta);
}

}  // namespace plate::rotations
