// Python bindings of the kernels in this folder.
#include "goal/ends_record.hpp"
#include "records.hpp"

namespace plate {

void bind_goal(nb::module_& m) {
    m.def("end_errors", [](Numbers place, nb::tuple record) {
        std::vector<double> error;
        Matrix slope;
        end_errors(copied(place), ends_of(record, place.size()), error, slope);
        return nb::make_tuple(to_numpy(std::move(error)), to_numpy(std::move(slope)));
    });
}

}  // namespace plate
