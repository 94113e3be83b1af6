// What bindings check; and arrays whose rows are records: structs of numbers of eight bytes each.
#pragma once
#include <plate/bind.hpp>

#include <span>
#include <stdexcept>
#include <string>

namespace plate {

// Raise a ValueError that says what is wrong.
inline void require(bool right, const char* what) {
    if (!right) throw std::invalid_argument(what);
}

// The rows of an array as records.
template <class Record>
std::span<const Record> records(const char* name, const Array<const double, 2>& rows) {
    constexpr size_t width = sizeof(Record) / sizeof(double);
    if (rows.shape(1) != width)
        throw std::invalid_argument(std::string(name) + " has rows of " +
                                    std::to_string(rows.shape(1)) +
                                    ", allowed: " + std::to_string(width));
    return {reinterpret_cast<const Record*>(rows.data()), rows.shape(0)};
}

}  // namespace plate
