// Python bindings of limits.hpp.
#include "records.hpp"

namespace plate {

void bind_limits(nb::module_& m) {
    m.attr("MARGIN") = MARGIN, m.attr("CERTAIN") = CERTAIN;
    m.def("limit_use", [](Table pose, Table twist, Table accel, Numbers weight, nb::tuple record,
                          bool linear) {
        check("pose", pose, {pose.shape(0), 3});
        check("twist", twist, {pose.shape(0), 3});
        check("accel", accel, {pose.shape(0), 3});
        if (weight.size() == 0) throw nb::value_error("weight is empty");
        const Limits limits = limits_of(record);
        nb::gil_scoped_release others_may_run;
        return limit_use(samples(pose), samples(twist), samples(accel), view(weight), limits,
                         linear);
    });
}

}  // namespace plate
