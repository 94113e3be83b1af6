// Converts the Python tuple `Ends` to the C++ struct, for the bindings.
#pragma once
#include "goal/ends.hpp"
#include "records.hpp"

namespace plate {

// Owns the arrays of the Python tuple `Ends` while their views are in use. The constructor checks
// the shapes. `size` is the number of coordinates.
class EndsRecord {
public:
    EndsRecord(const nb::tuple& record, size_t size)
        : low(numbers(record, 0)), high(numbers(record, 1)), weight(numbers(record, 2)),
          edge_low(numbers(record, 3)), edge_high(numbers(record, 4)),
          pair(nb::cast<Array<const int64_t, 2>>(field(record, 5))), clear(numbers(record, 6)),
          parts(nb::cast<int>(field(record, 7))) {
        for (const Numbers* each : {&low, &high, &weight, &edge_low, &edge_high})
            check("an array of ends", *each, {size});
        check("pair", pair, {clear.size(), 2});
        if (parts < 0 || size < 2 * static_cast<size_t>(parts))
            throw nb::value_error("there are more parts than end coordinates");
        for (size_t k = 0; k < pair.size(); k++)
            if (pair.data()[k] < 0 || pair.data()[k] >= parts)
                throw nb::value_error("a pair contains the index of a part that does not exist");
    }

    Ends view() const {
        using plate::view;
        return {view(low), view(high), view(weight), view(edge_low), view(edge_high),
                view(pair), view(clear), parts};
    }

private:
    Numbers low, high, weight, edge_low, edge_high;
    Array<const int64_t, 2> pair;
    Numbers clear;
    int parts;

    static Numbers numbers(const nb::tuple& record, int at) {
        return nb::cast<Numbers>(field(record, at));
    }
};

}  // namespace plate
