// Argument checks for bindings, and access to array rows as records. A record is a struct of 8-byte
// numbers.
#pragma once
#include <plate/bind.hpp>

#include <span>
#include <stdexcept>
#include <string>

namespace plate {

// If `right` is false, throw an error that Python receives as a ValueError with the text `what`.
inline void require(bool right, const char* what) {
    if (!right) throw std::invalid_argument(what);
}

// Return the rows of an array as records.
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
