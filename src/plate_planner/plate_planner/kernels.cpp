// Python bindings of the kernels: the module `_kernels`.
#include <plate/bind.hpp>

#include "estimation/filter.hpp"

namespace plate {

using Numbers = Array<const double, 1>;
using Table = Array<const double, 2>;

NB_MODULE(_kernels, m) {
    m.def("stick_slip", [](Array<double, 2> state, Numbers bound, Table pose, Table twist,
                           Numbers begin, Numbers end, double dt) {
        const size_t count = state.shape(0), n = twist.shape(0);
        if (state.shape(1) != 5 || bound.size() != count || begin.size() != count ||
            end.size() != count || pose.shape(0) != n || pose.shape(1) != 3 || twist.shape(1) != 3)
            throw nb::value_error("shapes: state (K, 5), bound, begin and end (K,), pose and twist "
                                  "(n, 3)");
        nb::gil_scoped_release others_may_run;
        stick_slip(view(state), bound.data(), samples(pose), samples(twist), begin.data(),
                   end.data(), dt);
    }, nb::arg("state").noconvert(), nb::arg("bound"), nb::arg("pose"), nb::arg("twist"),
       nb::arg("begin"), nb::arg("end"), nb::arg("dt"));
}

}  // namespace plate
