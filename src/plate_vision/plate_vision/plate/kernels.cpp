// Bindings of the chapter `plate`.
#include "plate/binding.hpp"
#include "plate/region.hpp"

namespace plate {

void bind_plate(nb::module_& m) {
    m.def("region_depth", [](In<double, 2> edges, In<double, 2> bows, In<double, 1> x,
                             In<double, 1> y) {
        const size_t count = x.shape(0);
        require(edges.shape(1) == 3 && y.shape(0) == count &&
                    (bows.shape(0) == 0 || bows.shape(0) == edges.shape(0)) && bows.shape(1) >= 3,
                "shapes: edges (n, 3), bows (n, >= 3) or none, x and y (m,)");
        std::vector<double> depth(count);
        {
            nb::gil_scoped_release others_may_run;
            region_depth(view(edges), view(bows), x.data(), y.data(), count, depth.data());
        }
        return to_numpy<1>(std::move(depth), {count});
    });
    m.def("fit_light", [](In<uint8_t, 2> grey, In<int64_t, 1> rows, In<int64_t, 1> columns,
                          In<float, 2> design, double min_grey) {
        const size_t count = rows.shape(0);
        require(count > 0 && columns.shape(0) == count && design.shape(0) == TERMS &&
                    design.shape(1) == count,
                "shapes: rows and columns (n,), design (6, n), n >= 1");
        for (size_t i = 0; i < count; i++)
            require(0 <= rows(i) && rows(i) < static_cast<int64_t>(grey.shape(0)) &&
                        0 <= columns(i) && columns(i) < static_cast<int64_t>(grey.shape(1)),
                    "samples outside the image");
        std::vector<float> surface;
        {
            nb::gil_scoped_release others_may_run;
            surface = fit_light(view(grey), view(rows), view(columns), view(design), min_grey);
        }
        const size_t size = surface.size();
        return to_numpy<1>(std::move(surface), {size});
    });
    m.def("bare", [](In<float, 1> light, double x_px, double y_px) {
        require(light.shape(0) == 9, "shape: light (9,)");
        return bare(light.data(), x_px, y_px);
    });
}

}  // namespace plate
