// What Python sees of the kernels of this chapter.
#include "records.hpp"
#include "requests/ends_record.hpp"
#include "requests/request.hpp"

namespace plate {

void bind_requests(nb::module_& m) {
    m.attr("FARTHEST_M") = FARTHEST_M, m.attr("FASTEST_MPS") = FASTEST_MPS;
    m.def("end_errors", [](Numbers place, nb::tuple record) {
        const EndsRecord ends(record, place.size());
        std::vector<double> error;
        Matrix slope;
        end_errors({place.data(), place.data() + place.size()}, ends.view(), error, slope);
        const size_t rows = slope.rows, columns = slope.columns;
        return nb::make_tuple(to_numpy<1>(std::move(error), {rows}),
                              to_numpy<2>(std::move(slope.numbers), {rows, columns}));
    });
    m.def("request_flags", [](Table position, Table force, Table velocity, Numbers curl,
                              Table tolerance) {
        const size_t count = curl.size();
        check("position", position, {count, 2});
        check("force", force, {count, 2});
        check("velocity", velocity, {count, 2});
        check("tolerance", tolerance, {count, 2});
        const RequestFlags flags = request_flags(view(position), view(force), view(velocity),
                                                 view(curl), view(tolerance));
        return nb::make_tuple(flags.sound, flags.moving, flags.curled, flags.slack, flags.within,
                              flags.loaded);
    });
}

}  // namespace plate
