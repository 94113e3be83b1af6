// Converts the Python tuple `Sequences` to the C++ struct, for the bindings.
#pragma once
#include "records.hpp"
#include "rotations/family.hpp"

namespace plate::rotations {

inline Sequences sequences_of(const nb::tuple& record) {
    const Table loads = field<Table>(record, "loads");
    check("loads", loads, {loads.shape(0), 3});
    const nb::tuple steps = field<nb::tuple>(record, "steps");
    Sequences family{
        .rotations = field<int>(record, "rotations"),
        .period = field<double>(record, "period"),
        .accel = field<double>(record, "accel"),
        .loads = matrix_of(loads),
        .steps = {item<int>(steps, 0), item<int>(steps, 1)},
        .limits = limits_of(field<nb::tuple>(record, "limits")),
    };
    read(record, "scale", family.scale);
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
