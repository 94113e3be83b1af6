// `Fit` as a named tuple of Python: for bindings.
#pragma once
#include "fit/levenberg_marquardt.hpp"
#include "records.hpp"

namespace plate {

// The fields of `Fit` of Python.
template <class Number>
nb::tuple fields_of(FitOf<Number>&& fit) {
    const size_t rows = fit.error.size(), columns = fit.parameters.size();
    return nb::make_tuple(to_numpy<1>(std::move(fit.parameters), {columns}),
                          to_numpy<1>(std::move(fit.error), {rows}),
                          to_numpy<2>(std::move(fit.jacobian.numbers), {rows, columns}),
                          fit.iterations);
}

}  // namespace plate
