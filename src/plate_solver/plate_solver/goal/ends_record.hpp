// Converts the Python tuple `Ends` to the C++ struct, for the bindings.
#pragma once
#include "goal/ends.hpp"
#include "records.hpp"

namespace plate {

// Converts the requested values of `size` end coordinates, and checks the shapes of the arrays.
inline Ends ends_of(const nb::tuple& record, size_t size) {
    const auto of_coordinates = [&](const char* name) {
        const auto values = field<Numbers>(record, name);
        check(name, values, {size});
        return copied(values);
    };
    const auto pair = field<Array<const int64_t, 2>>(record, "pair");
    Ends ends{
        .low = of_coordinates("low"),
        .high = of_coordinates("high"),
        .weight = of_coordinates("weight"),
        .edge_low = of_coordinates("edge_low"),
        .edge_high = of_coordinates("edge_high"),
        .clear = copied(field<Numbers>(record, "clear")),
        .parts = field<int>(record, "parts"),
    };
    check("pair", pair, {ends.clear.size(), 2});
    if (ends.parts < 0 || size < 2 * static_cast<size_t>(ends.parts))
        throw nb::value_error("there are more parts than end coordinates");
    for (size_t k = 0; k < pair.size(); k++)
        if (pair.data()[k] < 0 || pair.data()[k] >= ends.parts)
            throw nb::value_error("a pair contains the index of a part that does not exist");
    for (size_t k = 0; k < pair.shape(0); k++)
        ends.pair.push_back({static_cast<int>(pair(k, 0)), static_cast<int>(pair(k, 1))});
    return ends;
}

}  // namespace plate
