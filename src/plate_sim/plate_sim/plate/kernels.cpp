// Python bindings of the kernels that evaluate the plate's motion.
#include <plate/bind.hpp>

#include "plate/pieces.hpp"
#include "records.hpp"

namespace plate {

using nb::arg;

void bind_plate(nb::module_& m) {
    m.def(
        "tabulate",
        [](Array<const double, 1> times, Array<const double, 3> coefficients, double gravity_x,
           double gravity_y, bool closed, Array<double, 2> table, Array<double, 1> scales) {
            const size_t count = coefficients.shape(0);
            require(coefficients.shape(1) == 6 && coefficients.shape(2) == 3 &&
                        times.shape(0) == count + 1,
                    "tabulate: times and pieces differ, allowed: (K + 1,), (K, 6, 3)");
            require(table.shape(0) == count && table.shape(1) == 24 && scales.shape(0) == 8,
                    "tabulate: shapes differ, allowed: table (K, 24), scales (8,)");
            *reinterpret_cast<Scales*>(scales.data()) =
                tabulate(times.data(), coefficients.data(), {gravity_x, gravity_y}, closed,
                         {reinterpret_cast<Piece*>(table.data()), count});
        },
        arg("times"), arg("coefficients"), arg("gravity_x"), arg("gravity_y"), arg("closed"),
        arg("table").noconvert(), arg("scales").noconvert());
}

}  // namespace plate
