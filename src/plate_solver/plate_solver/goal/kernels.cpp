// Python bindings of the kernels in this folder.
#include "goal/ends_record.hpp"
#include "records.hpp"

namespace plate {

void bind_goal(nb::module_& m) {
    m.def("end_errors", [](Numbers place, nb::tuple record) {
        const EndsRecord ends(record, place.size());
        std::vector<double> error;
        Matrix slope;
        end_errors({place.data(), place.data() + place.size()}, ends.view(), error, slope);
        const size_t rows = slope.rows, columns = slope.columns;
        return nb::make_tuple(to_numpy<1>(std::move(error), {rows}),
                              to_numpy<2>(std::move(slope.numbers), {rows, columns}));
    });
}

}  // namespace plate
