// Converts the Python tuple `Ends` to the C++ struct, for the bindings.
#pragma once
#include "goal/ends.hpp"
#include "records.hpp"

namespace plate {

// Converts the requested values of `size` end coordinates, and checks the shapes of the arrays.
inline Ends ends_of(const nb::tuple& record, size_t size) {
    const auto numbers = [&](size_t at) {
        const auto values = nb::cast<Numbers>(field(record, at));
        if (at < 5) check("an array of ends", values, {size});
        return copied(values);
    };
    const auto pair = nb::cast<Array<const int64_t, 2>>(field(record, 5));
    Ends ends{numbers(0), numbers(1), numbers(2), numbers(3), numbers(4), {}, numbers(6),
              nb::cast<int>(field(record, 7))};
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
