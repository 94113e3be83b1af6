// Python bindings of limits.hpp.
#include <vector>

#include "records.hpp"

namespace plate {

void bind_limits(nb::module_& m) {
    m.attr("SEARCH_USE") = SEARCH_USE, m.attr("CYCLE_USE") = CYCLE_USE;
    m.def("limit_use", [](Box pose, Box twist, Box accel, Numbers weight, nb::tuple record,
                          bool linear) {
        const size_t motions = pose.shape(0), count = pose.shape(1);
        check("pose", pose, {motions, count, 3});
        check("twist", twist, {motions, count, 3});
        check("accel", accel, {motions, count, 3});
        if (weight.size() == 0) throw nb::value_error("weight is empty");
        const Limits limits = limits_of(record);
        std::vector<double> used(motions);
        {
            nb::gil_scoped_release others_may_run;
            const auto one = [&](const Box& all, size_t k) {
                return Samples{all.data() + 3 * count * k, static_cast<int>(count), 3, 1};
            };
            for (size_t k = 0; k < motions; k++)
                used[k] = limit_use(one(pose, k), one(twist, k), one(accel, k), view(weight),
                                    limits, linear);
        }
        return to_numpy(std::move(used));
    });
}

}  // namespace plate
