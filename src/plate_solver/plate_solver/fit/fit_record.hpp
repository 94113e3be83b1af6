// Converts `Fit` to a Python tuple, for the bindings.
#pragma once
#include "fit/levenberg_marquardt.hpp"
#include "records.hpp"

namespace plate {

// Returns the fields of the Python tuple `Fit`.
template <class Number>
nb::tuple fields_of(FitOf<Number>&& fit) {
    return nb::make_tuple(to_numpy(std::move(fit.parameters)), to_numpy(std::move(fit.error)),
                          to_numpy(std::move(fit.jacobian)), fit.iterations);
}

}  // namespace plate
