// Python bindings of the friction kernels.
#include <nanobind/stl/pair.h>
#include <cmath>

#include <plate/bind.hpp>

#include "friction/disc.hpp"
#include "friction/point_events.hpp"
#include "records.hpp"

namespace plate {

using nb::arg;

void bind_friction(nb::module_& m) {
    m.def(
        "disc_force",
        [](double s, double w) {
            const disc::DiscFriction friction = disc::disc_force(s, w);
            return std::pair(friction.force, friction.torque);
        },
        arg("s"), arg("w"));
    m.def(
        "run_points",
        [](Array<const double, 2> table, Array<const double, 1> scales,
           Array<const double, 1> limit, double static_ratio, double tolerance, int cycles,
           Array<double, 3> path, Array<double, 3> speed, Array<bool, 1> checked) {
            const size_t count = limit.shape(0);
            for (const auto& array : {path, speed})
                require(array.shape(0) > 0 && array.shape(0) == path.shape(0) &&
                            array.shape(1) == count && array.shape(2) == 2,
                        "run_points: path and speed differ, allowed: (samples, M, 2)");
            require(table.shape(0) > 0 && scales.shape(0) == 8 && checked.shape(0) == count,
                    "run_points: shapes differ, allowed: table (K, 24), scales (8,), checked (M,)");
            require(cycles > 0, "run_points: no cycles, allowed: at least 1");
            require(tolerance > 0, "run_points: tolerance is not above 0");
            for (size_t k = 0; k < table.size(); k++)
                require(std::isfinite(table.data()[k]), "run_points: table is not finite");
            const Table pieces = records<Piece>("table", table);
            nb::gil_scoped_release others_may_run;
            return sliding::run_points(pieces, *reinterpret_cast<const Scales*>(scales.data()),
                                       limit.data(), static_ratio, tolerance, cycles, path.data(),
                                       speed.data(), static_cast<int>(path.shape(0)),
                                       static_cast<int>(count), checked.data());
        },
        arg("table"), arg("scales"), arg("limit"), arg("static"), arg("tolerance"), arg("cycles"),
        arg("path").noconvert(), arg("speed").noconvert(), arg("checked").noconvert());
}

}  // namespace plate
