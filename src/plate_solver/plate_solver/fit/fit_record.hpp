// Converts `Fit` to a Python tuple, for the bindings.
#pragma once
#include "fit/levenberg_marquardt.hpp"
#include "records.hpp"

namespace plate {

// Returns the fields of the Python tuple `Fit`.
template <class Number>
nb::tuple fields_of(FitOf<Number>&& fit) {
    const size_t rows = fit.error.size(), columns = fit.parameters.size();
    return nb::make_tuple(to_numpy<1>(std::move(fit.parameters), {columns}),
                          to_numpy<1>(std::move(fit.error), {rows}),
                          to_numpy<2>(std::move(fit.jacobian.numbers), {rows, columns}),
                          fit.iterations);
}

}  // namespace plate
